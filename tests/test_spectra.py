"""Spectra of a run are of whole cycles, so that lines are lines; shipped configurations run without a warning."""

import csv
import dataclasses
import functools
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax import results
from gearjax.cli import main
from gearjax.results import spectra
from gearjax.results.store import NAME
from gearjax.units import arcmin
from tests.conftest import ROOT


def case_of(scene, analysis: str, torque: float = 0.0) -> results.Case:
    """One case of a short run, 0.2 s at 2 ms where the errors repeat after 15.8 s."""
    run = gj.Run(0.2, 101, (analysis,), (torque,) if torque else (), settle=0.0)
    return next(results.run_cases(dataclasses.replace(scene, run=run)))


def lines_of(scene, case, **changed) -> results.OrderLines:
    run = dataclasses.replace(gj.Run(0.2, 101, ("no_load",)), **changed)
    found = results.order_lines(dataclasses.replace(scene, run=run), case)
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("analysis", "torque"), [("no_load", 0.0), ("static", 300.0)])
def test_a_spectrum_of_a_short_run_is_of_a_whole_cycle(scene, analysis, torque):
    found = lines_of(scene, case_of(scene, analysis, torque))
    assert found.whole
    np.testing.assert_allclose(found.order[:4], [0, 1, 2, 3], rtol=1e-12, atol=1e-12)
    if torque:  # both pairs carry: all that is left of the errors are sines of the crank, which turns 26 times
        assert found.amplitude[26] / arcmin == pytest.approx(0.6544, abs=1e-4)
        others = np.delete(found.amplitude, [0, 26])
        assert others.max() < 1e-9 * found.amplitude[26]


def test_a_motion_without_damping_is_remarked_on(scene):
    run = gj.Run(0.2, 201, ("dynamic",), (100.0,), settle=0.0)
    damped = dataclasses.replace(scene, run=run)
    assert not any("[damping]" in words for words in results.remarks(damped))
    for damping in (None, gj.DampingRatio(0.0)):
        lines = results.remarks(dataclasses.replace(damped, damping=damping))
        assert any("without [damping]" in words for words in lines)


@pytest.mark.slow
def test_gears_whose_teeth_are_alike_repeat_after_a_mesh():
    pair = gj.load(ROOT / "configs" / "helical" / "guo_2018.toml")
    mesh = 2 * np.pi / 19 / float(pair.system.input_speed)
    run = gj.Run(mesh, 33, ("no_load",), settle=0.0)
    alike = {name: error for name, error in pair.errors.items() if error.on_flank}
    assert 0 < len(alike) < len(pair.errors)
    for errors, cycle in ((alike, mesh), ({}, mesh), (dict(pair.errors), 47 * 19 * mesh)):
        case = next(results.run_cases(dataclasses.replace(pair, errors=errors, run=run)))
        assert case.cycle == pytest.approx(cycle, rel=1e-9)


@pytest.mark.slow
def test_whole_cycles_in_a_record_are_used(scene):
    """Two and a bit: the last two, which are those of any other two."""
    spacing = 15.8 / 790
    run = gj.Run(2.25 * 15.8 - 0.5 * spacing, round(2.25 * 790), ("no_load",))
    long = dataclasses.replace(scene, run=dataclasses.replace(run, duration=spacing * (run.samples - 1)))
    case = next(results.run_cases(long))
    found = results.order_lines(long, case)
    short = lines_of(scene, case_of(scene, "no_load"), duration=spacing * 10, samples=11)
    assert found is not None
    assert found.whole
    assert len(found.order) == 790 + 1
    np.testing.assert_allclose(found.amplitude[:200:2], short.amplitude[:100], atol=1e-12)
    assert found.amplitude[1::2].max() < 1e-12  # nothing between the orders of one turn of the output


@pytest.mark.slow
def test_without_whole_cycles_a_window_is_used(scene, monkeypatch):
    case = case_of(scene, "no_load")
    alternating = dataclasses.replace(scene, load=gj.SinusoidalLoad(1.6))
    assert not lines_of(alternating, case).whole
    assert lines_of(dataclasses.replace(scene, load=gj.SinusoidalLoad("mesh")), case).whole
    monkeypatch.setattr("gearjax.results.spectra.MOST_SAMPLES", 1000)
    assert not lines_of(scene, case).whole
    few = dataclasses.replace(scene, run=gj.Run(100.0, 5, ("no_load",)))
    assert (
        results.order_lines(few, dataclasses.replace(case, result=gj.transmission_error(few, np.arange(5.0)))) is None
    )


@pytest.mark.slow
def test_a_motion_is_continued_to_a_whole_cycle_after_it_has_settled(scene):
    """Under a torque at which both pairs carry: lines at the crank and at the mesh, nothing between to 1e-5."""
    run = gj.Run(0.2, 201, ("dynamic",), (300.0,), settle=0.05)
    moving = dataclasses.replace(scene, run=run)
    found = results.order_lines(moving, next(results.run_cases(moving)))
    assert found is not None
    assert found.whole
    assert found.amplitude[1300] / arcmin == pytest.approx(0.2139, abs=1e-3)
    between = np.delete(found.amplitude, [*range(5), *range(26 - 3, 26 + 4), *range(1300 - 60, 1300 + 61)])[:1150]
    assert between.max() < 1e-5 * found.amplitude[1300]


@pytest.mark.slow
def test_pieces_of_a_motion_are_the_motion(scene, monkeypatch):
    """Where damping makes a motion forget its start; where it does not, or pieces do not agree, there are none."""
    run, times = gj.Run(0.1, 101, ("dynamic",), (100.0,), settle=0.0), np.arange(1000) * 0.99e-3
    whole = np.asarray(gj.simulate(scene, times, 100.0).te)
    pieces = spectra._moved(scene, run, times, 100.0)
    assert 0 < np.abs(pieces - whole).max() < 1e-5 * np.ptp(whole)
    monkeypatch.setattr(spectra, "MEET", -1.0)
    np.testing.assert_array_equal(spectra._moved(scene, run, times, 100.0), whole)
    free = dataclasses.replace(scene, damping=gj.DampingRatio(1e-3))
    np.testing.assert_array_equal(spectra._moved(free, run, times, 100.0), gj.simulate(free, times, 100.0).te)


def test_a_part_of_a_cycle_is_told_in_the_table(scene):
    case = case_of(scene, "no_load")
    assert (case.span, case.as_json()["cycle_s"]) == ("0.2 of 15.8", pytest.approx(15.8))
    assert dataclasses.replace(case, window=15.8).span == "15.8"


COMMANDS = [
    ("run", "two_kv/wang_2020.toml"),
    ("identify", "two_kv/measured.toml"),
    ("run", "rv_cycloidal/hu_2020.toml"),
    ("run", "involute_rv/yang_2019.toml"),
    ("run", "helical/guo_2018.toml"),
    ("run", "helical/blankenship_1995.toml"),
    ("run", "helical/guo_2018_measured.toml"),
    ("run", "helical/two_stage.toml"),
    ("optimise", "two_kv/wang_2020_phases.toml"),
    ("optimise", "rv_cycloidal/hu_2020_phases.toml"),
    ("tolerance", "two_kv/wang_2020_tolerance.toml"),
    ("tolerance", "rv_cycloidal/hu_2020_tolerance.toml"),
    ("optimise", "helical/guo_2018_optimise.toml"),
    ("tolerance", "helical/guo_2018_tolerance.toml"),
    ("run", "elliptic/dong_2020.toml"),
    ("run", "elliptic/two_lobes.toml"),
    ("optimise", "elliptic/dong_2020_phases.toml"),
    ("tolerance", "elliptic/dong_2020_tolerance.toml"),
]
AS_SHIPPED = [
    ("run", "two_kv/wang_2020.toml"),
    ("tolerance", "elliptic/dong_2020_tolerance.toml"),
]
SMALLER = {
    # a quarter of a turn of the crank, a twelfth, and an eighth for the phases
    "rv_cycloidal/hu_2020.toml": {"run": {"duration": "0.01282051282051282 s", "samples": 201}},
    "involute_rv/yang_2019.toml": {"run": {"duration": "0.005649717514124295 s", "samples": 401}},
    # one of 47 turns of the pinion, and one of three meshes
    "helical/guo_2018.toml": {"run": {"duration": "1.1811023617 s", "samples": 381}},
    "helical/guo_2018_measured.toml": {"run": {"duration": "0.0285171103830 s", "samples": 609}},
    "helical/two_stage.toml": {"run": {"duration": "0.02 s", "samples": 401}},
    "helical/blankenship_1995.toml": {"run": {"duration": "0.0004 s", "samples": 65}},
    "two_kv/wang_2020_phases.toml": {
        "run": {"duration": "1.58 s", "samples": 1581, "torques": ["100 N*m"]},
        "optimise": {"grid_step": "30 deg", "starts": 30},
    },
    "rv_cycloidal/hu_2020_phases.toml": {
        "run": {"duration": "0.00641025641025641 s", "samples": 101},
        "optimise": {"starts": 2},
    },
    "two_kv/wang_2020_tolerance.toml": {
        "run": {"duration": "1.58 s", "samples": 159},
        "tolerance": {"samples": 2048},
        "tolerance.sensitivity": {"samples": 128},
        "tolerance.assembly": {"units": 100},
    },
    "rv_cycloidal/hu_2020_tolerance.toml": {"tolerance": {"samples": 200}},
    "helical/guo_2018_tolerance.toml": {"tolerance": {"samples": 200}},
}
"""What is changed, by section."""
WRITTEN = {
    ("run", "rv_cycloidal/hu_2020.toml"): {"stage.png", "contact_forces.png", "disc.csv", "disc.dxf", "results.nc"},
    ("run", "helical/guo_2018_measured.toml"): {"plane_of_action.png", "measured.png", "results.nc"},
    ("run", "elliptic/dong_2020.toml"): {"pair.png", "contact_forces.png", "results.nc"},
    ("run", "involute_rv/yang_2019.toml"): {"pair.png", "contact_forces.png", "results.nc"},
    ("tolerance", "two_kv/wang_2020_tolerance.toml"): {
        "histograms.png",
        "convergence.png",
        "sensitivity.png",
        "allocation.png",
        "assembly.png",
        "tolerance.json",
        NAME,
    },
}


@pytest.mark.slow
def test_a_run_says_once_what_its_samples_miss(tmp_path, config_text, capsys):
    """Of what turns fastest, or else of the waves of the stiffness in motion."""
    for samples, words in (
        ("2", "angles per cycle of the fastest order"),
        ("301", "the stiffness has 247 waves in the record"),
    ):
        text = config_text.replace("samples = 3001", f"samples = {samples}")
        (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
        with pytest.raises(SystemExit, match="0"):
            main(["run", str(tmp_path / "mine.toml"), "--json"])
        told = capsys.readouterr().err
        assert told.count(words) == 1
        assert told.count("raise run.samples") == 1
        assert "warning" not in told


def test_every_shipped_configuration_has_its_command():
    paths = [path for path in (ROOT / "configs").rglob("*.toml") if not path.with_suffix(".csv").exists()]
    files = {str(path.relative_to(ROOT / "configs")) for path in paths}  # others stand beside a recording
    assert {name for _, name in COMMANDS} == files


@pytest.mark.parametrize(("word", "name"), [command for command in COMMANDS if command[0] != "identify"])
def test_the_samples_of_shipped_configurations_miss_nothing(word, name):
    """As they are shipped: most of the commands below run shorter ones."""
    scene = gj.load(ROOT / "configs" / name)
    if word != "tolerance":  # whose samples are gear sets, not angles
        assert results.remarks(scene) == []
    entries = SMALLER.get(name, {}).get("run", {})
    if "duration" in entries:  # a part of the record, with samples as far apart
        times, seconds = scene.run.times, float(entries["duration"].partition(" ")[0])
        assert seconds / (entries["samples"] - 1) == pytest.approx(float(times[1] - times[0]), rel=1e-6)


def made_smaller(name: str, folder: Path) -> Path:
    """A copy of a configuration and of the files beside it, with less to compute."""
    shutil.copytree((ROOT / "configs" / name).parent, folder)
    path = folder / Path(name).name
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    for section, entries in SMALLER.get(name, {}).items():
        table = tables
        for word in section.split("."):
            table = table[word]
        assert table.keys() >= entries.keys()
        table.update(entries)
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("word", "name"), AS_SHIPPED)
def test_shipped_configurations_run_as_a_user_runs_them(tmp_path, word, name):
    """A run and a study, each as a process of its own, whole: no warning and no note."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "default"}
    command = [sys.executable, "-W", "error", "-m", "gearjax", word, str(ROOT / "configs" / name), "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr[-2000:]
    says_and_writes(word, name, done.stdout, done.stderr, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize(("word", "name"), [command for command in COMMANDS if command not in AS_SHIPPED])
def test_shipped_configurations_run_without_a_warning(tmp_path, capsys, monkeypatch, word, name):
    """Within this process, where warnings are errors and programs are shared; with less to compute.

    A motion of a whole cycle, only for its spectrum, is computed for those above. Yields are of fewer gear sets.
    """
    monkeypatch.setattr("gearjax.results.tolerance.allocate", functools.partial(gj.allocate, n=256, judged=2048))
    monkeypatch.setattr("gearjax.results.spectra.MOST_SAMPLES", 20_000)
    with pytest.raises(SystemExit) as ended:
        main([word, str(made_smaller(name, tmp_path / "configs")), "--out", str(tmp_path / "out")])
    told = capsys.readouterr()
    assert ended.value.code == 0, told.err[-2000:]
    says_and_writes(word, name, told.out, told.err, tmp_path / "out")


def says_and_writes(word: str, name: str, printed: str, said: str, folder: Path) -> None:
    """The examples draw the stage, or the pair, and write the disc."""
    words = re.compile("note:|warning|gearjax: error", re.IGNORECASE)
    assert [line for line in said.splitlines() if words.search(line)] == []
    assert WRITTEN.get((word, name), set()) <= {path.name for path in folder.rglob("*")}
    if name == "two_kv/wang_2020_tolerance.toml":
        answers_everything(printed, json.loads((folder / "tolerance.json").read_text(encoding="utf-8")))
    if name == "helical/guo_2018_optimise.toml":
        swings_less(printed, folder)


def swings_less(printed: str, folder: Path) -> None:
    """Reliefs in micrometres, with which the TE swings a third as far, and what errors of them cost."""
    assert "8.7 % of the span between the bounds off to either side: " in printed
    with (folder / "starts.csv").open(encoding="utf-8") as file:
        first = next(csv.DictReader(file))
    assert 5 < float(first["errors.tip.amount[0] [um]"]) < 10
    with (folder / "metrics.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    before, after = (
        sum(float(row["peak_to_peak [arcmin]"]) for row in rows if row["stage"] == stage)
        for stage in ("before", "after")
    )
    assert after < 0.35 * before


def answers_everything(printed: str, report: dict) -> None:
    """The example of a study asks for all that there is."""
    for words in ("2048 gear sets", "Sobol first", "mislead", "halved", "Cheapest tolerances", "matched", "at random"):
        assert words in printed
    numbers = report["sensitivity"]["no_load.peak_to_peak"]["numbers"]["errors.revolution.phase"]
    assert set(numbers) == {"linear", "first", "first_error", "total", "total_error", "one_at_a_time"}
    assert report["assembly"]["matched"]["mean"] < report["assembly"]["random"]["mean"]
    assert set(report["allocation"]) >= {"factors", "cost", "cost_before", "yield", "met"}
