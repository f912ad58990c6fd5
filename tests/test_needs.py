"""What a tolerance study takes of memory, disk and time: told beforehand, refused with what would fit."""

import dataclasses
import json
import re
import subprocess
import sys
import tracemalloc

import jax
import pytest
import tomli_w

import gearjax as gj
from gearjax import memory
from gearjax.checks import GearjaxError
from gearjax.config import loads_tolerance
from gearjax.memory import GIB, free_memory
from gearjax.results import needs as room
from gearjax.results.needs import _contacts, affordable, needs
from gearjax.results.tolerance import shifts
from tests.conftest import ROOT
from tests.test_matrix import GEAR_SETS, RUN
from tests.test_tolerance_command import command, small


def section(**words):
    return loads_tolerance(small(**words))[2]


def wide(angles: int, **words) -> str:
    text = small(**words)
    assert "samples = 201" in text
    return text.replace("samples = 201", f"samples = {angles}")


@pytest.fixture
def sixteen(monkeypatch):
    """A machine with 16 GiB of free memory."""
    monkeypatch.setattr(room, "free_memory", lambda: 16 * GIB)


@pytest.mark.usefixtures("sixteen")
@pytest.mark.parametrize("sampler", ["monte_carlo", "latin_hypercube", "sobol"])
def test_a_study_that_is_too_large_is_refused_without_taking_anything(tmp_path, capsys, sampler):
    config = tmp_path / "study.toml"
    text = small(samples=1_000_000_000).replace('sampler = "sobol"', f'sampler = "{sampler}"')
    config.write_text(text)
    tracemalloc.start()
    try:
        assert command(str(config), "--out", str(tmp_path / "out"), "--json") == 2
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 100e6
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    assert "tolerance.samples = 1000000000: needs about" in shown.err
    assert "16 GiB are free; at most" in shown.err
    fits = int(shown.err.split("at most ")[1].split()[0])
    assert 1e8 <= fits < 5e8
    affordable(loads_tolerance(text.replace("1000000000", str(fits)))[2], 2, None)  # and it does fit
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("sixteen")
def test_too_many_angles_are_refused_with_how_many_fit(tmp_path, capsys):
    config = tmp_path / "study.toml"
    config.write_text(wide(10_000_000))
    assert command(str(config), "--json") == 2
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert "run.samples = 10000000: needs about" in shown
    fits = int(shown.split("at most ")[1].split()[0])
    affordable(loads_tolerance(wide(fits))[2], len(jax.local_devices()), None)  # those of the command
    with pytest.raises(GearjaxError, match=r"run.samples = 10000000"):
        shifts(loads_tolerance(wide(10_000_000))[2])  # of gearjax tradeoff


def test_samples_asked_for_in_python_count_too(monkeypatch, population):
    monkeypatch.setattr(memory, "_free", lambda: iter([16 * GIB]))

    def amplitude(scene):
        return scene.errors["planet_1"].amplitude

    with pytest.raises(gj.ParameterError, match=r"n = 4000000000: needs about 45 GiB .* at most 1400000000 fit"):
        gj.monte_carlo(population, amplitude, n=4 * 10**9)
    assert gj.monte_carlo(population, amplitude, n=10).samples == 10


@pytest.mark.usefixtures("sixteen")
def test_extremes_between_samples_of_rv_reducers_are_told():
    text = (ROOT / "configs" / "rv_cycloidal" / "hu_2020_tolerance.toml").read_text(encoding="utf-8")
    samples, between = (
        needs(loads_tolerance(text.replace('extremes = "samples"', f'extremes = "{word}"'))[2], 2)
        for word in ("samples", "between")
    )
    assert 5 * samples.seconds < between.seconds < 15 * samples.seconds
    assert between.memory["run.samples"] == pytest.approx(4 * samples.memory["run.samples"], rel=0.01)


@pytest.mark.usefixtures("sixteen")
@pytest.mark.parametrize(
    ("words", "named"),
    [
        ({"samples": 10**9, "chunk": 1}, r"tolerance.chunk = 1: .*raise it"),
        ({"samples": 12 * 10**7, "chunk": 2**24}, r"tolerance.chunk = 16777216: .*at most"),
    ],
)
def test_chunks_count_too(words, named):
    with pytest.raises(GearjaxError, match=named):
        affordable(section(**words), 2, None)


@pytest.mark.usefixtures("sixteen")
def test_further_studies_count_too():
    with pytest.raises(GearjaxError, match=r"tolerance.sensitivity.samples = 16777216: .*at most"):
        affordable(dataclasses.replace(section(), sensitivity=2**24), 2, None)


def test_the_time_of_further_studies_is_told():
    asked = section(samples=10**6)
    alone, further = (needs(dataclasses.replace(asked, sensitivity=number), 2) for number in (0, 10**6))
    assert alone.further == 0.0
    assert "sensitivities" not in alone.words(stored=False)
    free = len(asked.tolerances.paths)
    assert further.seconds == alone.seconds
    assert free * alone.seconds < further.further < 1.1 * (free + 3) * alone.seconds
    assert re.search(r"and roughly .* s, and .* for sensitivities, without compiling$", further.words(stored=False))


def test_slices_of_a_train_take_longer_than_those_of_a_pair():
    times = {}
    for name in ("helical_pair", "helical_train"):
        tables, number = GEAR_SETS[name].tables, GEAR_SETS[name].numbers["amplitude"].path
        spread = {"kind": "normal", "mean": "5 um", "std": "1 um"}
        study = {"samples": 100, "measures": [{"name": "static.peak_to_peak", "torque": "100 N*m"}], number: spread}
        given = loads_tolerance(tomli_w.dumps(tables | {"run": RUN | {"analyses": ["static"]}, "tolerance": study}))[2]
        times[name] = needs(given, 2).seconds / _contacts(given.tolerances.scene)
    assert times["helical_train"] > 5 * times["helical_pair"]


def test_the_disk_is_looked_at(tmp_path, monkeypatch):
    monkeypatch.setattr(room, "free_memory", lambda: None)
    asked = section(samples=10**8, chunk=16384)
    affordable(asked, 2, None)
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1e9}))
    with pytest.raises(GearjaxError, match=r"take 2.6 GiB on disk, 0.93 GiB are free .*; at most 35000000 fit"):
        affordable(asked, 2, tmp_path / "out")
    affordable(section(samples=3 * 10**7, chunk=16384), 2, tmp_path / "out")


def test_what_is_stored_already_needs_no_room(tmp_path, monkeypatch):
    monkeypatch.setattr(room, "free_memory", lambda: None)
    asked = section(samples=10**6, chunk=10**5)
    marks = tmp_path / room.NAME / "done" / "c"
    marks.mkdir(parents=True)
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 4e6}))
    with pytest.raises(GearjaxError, match="on disk"):
        affordable(asked, 2, tmp_path)
    for index in range(9):
        (marks / str(index)).touch()
    affordable(asked, 2, tmp_path)


@pytest.mark.slow
def test_the_stored_size_is_the_one_told(tmp_path, capsys):
    config, out = tmp_path / "study.toml", tmp_path / "out"
    config.write_text(small(samples=2000, chunk=1000))
    assert command(str(config), "--out", str(out), "--json") == 0
    shown = capsys.readouterr().err
    assert "the study needs about" in shown
    assert "on disk and roughly" in shown
    told = needs(loads_tolerance(config.read_text())[2], 1)
    chunks = [path for path in (out / room.NAME).rglob("*") if path.is_file() and path.parent.name == "c"]
    assert len(chunks) == told.files
    rounded = sum(-(-path.stat().st_size // room.BLOCK) * room.BLOCK for path in chunks)
    assert rounded == told.disk


def test_limits_of_a_control_group_count(tmp_path, monkeypatch):
    free = free_memory()
    assert free is None or free > 0
    group = tmp_path / "group"
    group.mkdir()
    (group / "memory.max").write_text("2000000\n")
    (group / "memory.current").write_text("1500000\n")
    (group / "memory.stat").write_text("anon 500000\nfile 1000000\n")
    monkeypatch.setattr(memory, "_groups", lambda: iter([(group, "memory.max", "memory.current")]))
    assert free_memory() == 1_500_000
    (group / "memory.max").write_text("max\n")
    assert free_memory() == pytest.approx(free, rel=0.9)


WHOLE_RUN = """
import pathlib, resource, sys
from gearjax.cli import main
try:
    main(["tolerance", sys.argv[1], "--json"])
except SystemExit:
    status = pathlib.Path("/proc/self/status")
    if status.exists():  # there getrusage counts the memory of whoever started this process, too
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        peak = int(line.split()[1]) * 1024
    else:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes on macOS
    print("\\n", peak)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("samples", "angles", "words"),
    [
        (200, 201, {}),
        (1_000_000, 21, {"extremes": "samples", "chunk": 16384}),
        (16, 20_001, {"extremes": "samples"}),  # its memory is that of the curves of the examples, however few samples
    ],
)
def test_a_study_takes_what_it_is_said_to_take(tmp_path, samples, angles, words):
    """Peak memory of a whole run lies below what was told, and above half of it."""
    config = tmp_path / "study.toml"
    config.write_text(wide(angles, samples=samples, **words))
    ended = subprocess.run([sys.executable, "-c", WHOLE_RUN, str(config)], capture_output=True, text=True, cwd=ROOT)
    printed, peak = ended.stdout.rsplit("\n", 2)[0], float(ended.stdout.split()[-1])
    assert json.loads(printed)["samples"] == samples
    told = sum(needs(loads_tolerance(config.read_text())[2], 2).memory.values())
    assert 0.5 * told < peak < told
