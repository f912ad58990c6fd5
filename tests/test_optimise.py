"""``gearjax optimise`` and its section of a configuration."""

import csv
import json
import re

import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.config import loads_optimise, with_numbers
from gearjax.progress import silent
from gearjax.results.optimisation import in_common, optimise
from gearjax.studies.select import numbers, pick
from gearjax.units import arcmin, deg, um
from tests.conftest import ROOT
from tests.test_cli import command
from tests.test_matrix import GEAR_SETS

CONFIG = ROOT / "configs" / "two_kv" / "wang_2020_phases.toml"
TEXT = CONFIG.read_text(encoding="utf-8")
PHASES = [f"errors.{body}.phase" for body in ("planet_1", "planet_2", "revolution", "output_wheel")]
FAST = (
    TEXT.replace('duration = "15.8 s" ', 'duration = "2 s" ')
    .replace("samples = 15801", "samples = 401")
    .replace('analyses = ["no_load", "static", "dynamic"]', 'analyses = ["no_load"]')
    .replace('grid_step = "10 deg"', 'grid_step = "60 deg"')
    .replace("starts = 300", "starts = 8")
    .replace('torques = ["30 N*m", "100 N*m", "300 N*m"]', 'torques = ["100 N*m"]')
)


@pytest.fixture(scope="module")
def fast(tmp_path_factory):
    path = tmp_path_factory.mktemp("optimise") / "fast.toml"
    path.write_text(FAST, encoding="utf-8")
    return path


@pytest.mark.slow
def test_json_and_files(capsys, tmp_path, fast):
    """One run with files: the JSON, the tables and a configuration that holds what was found."""
    folder = tmp_path / "out"
    code, out, err = command(capsys, "optimise", fast, "--json", "--out", folder)
    assert code == 0
    found = json.loads(out)
    assert found["objective"] == "no_load_amplitude"
    assert found["window_s"] == 2.0
    grid, gradient = found["grid"], found["gradient"]
    assert grid["combinations"] == 6**4
    assert set(grid["phases_deg"]) == set(gradient["phases_deg"]) == set(PHASES)
    assert all(abs(round(phase / 60) * 60 - phase) < 1e-9 for phase in grid["phases_deg"].values())
    assert gradient["starts"] == 8
    assert gradient["evaluations"] == 8 * 42
    assert 1 <= gradient["within_1_percent"] <= 8
    assert set(gradient["spans_within_1_percent"]) == set(PHASES)
    assert gradient["failed"] == 0
    assert min(grid["seconds"], grid["compile_seconds"], gradient["seconds"], gradient["compile_seconds"]) > 0
    assert gradient["objective_arcmin"] < grid["objective_arcmin"] < found["objective_before_arcmin"]
    assert found["after"]["amplitude_arcmin"] == pytest.approx(gradient["objective_arcmin"], rel=1e-9)
    assert found["before"]["amplitude_arcmin"] == pytest.approx(found["objective_before_arcmin"], rel=1e-9)
    assert [case["torque_Nm"] for case in found["after"]["cases"]] == [0.0]
    assert "8 of 8 starts descended and polished" in err
    names = {"before_after.png", "search.png", "starts.csv", "metrics.csv", "optimised.toml", "written.json"}
    assert {path.name for path in folder.iterdir()} == names
    with (folder / "starts.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    best = min(float(row["objective [arcmin]"]) for row in rows)
    assert best == pytest.approx(gradient["objective_arcmin"], rel=1e-6)
    assert "errors.planet_1.phase [deg]" in rows[0]
    scene = gj.load(folder / "optimised.toml")
    theta = scene.system.input_speed * np.linspace(0, 2, 401)
    amplitude = float(gj.transmission_error(scene, theta).amplitude / arcmin)
    assert amplitude == pytest.approx(gradient["objective_arcmin"], rel=1e-9)


def test_what_good_ends_have_in_common(rng):
    """Phases that turn together by chance: their difference is told, and how far each spans; a bad end is left out."""
    paths = tuple(PHASES[:3])
    turns = np.linspace(0.0, 5.5, 20)
    ends = np.stack([turns, turns + np.pi + rng.uniform(-0.05, 0.05, 20), 1.0 + rng.uniform(-0.1, 0.1, 20)], axis=1)
    ends = np.concatenate([(ends + np.pi) % (2 * np.pi) - np.pi, [[0.0, 0.0, -2.0]]])
    labels, objectives = np.zeros(21, dtype=int), np.append(np.full(20, 1.0), 1.1)
    search = gj.Minimisation(paths, ends, ends, objectives, labels >= 0, labels, labels, ends, 1, 0.0, 0.0)
    spans, alike = in_common(search, [True] * 3)
    assert list(spans) == list(paths)
    assert spans[paths[0]] == pytest.approx(5.5)
    assert spans[paths[2]] < 0.2
    assert alike == {paths[:2]: pytest.approx(180, abs=2)}


@pytest.mark.slow
def test_an_optimum_of_zero_is_told_and_drawn(capsys, tmp_path):
    """Without any eccentricity nothing is left, of which a rise could be a share."""
    names = ("planet_1", "planet_2", "revolution", "output_wheel")
    paths = [f"errors.{name}.amplitude" for name in names]
    bounds = "".join(f'"{path}" = ["0 um", "10 um"]\n' for path in paths)
    text = FAST.partition("[optimise]")[0]
    section = f'[optimise]\nobjective = "no_load_amplitude"\nwhere = {json.dumps(paths)}\nstarts = 4\n'
    path = tmp_path / "zero.toml"
    path.write_text(f"{text}{section}[optimise.bounds]\n{bounds}", encoding="utf-8")
    code, out, _ = command(capsys, "optimise", path, "--out", tmp_path / "out", "--json")
    assert code == 0
    found = json.loads(out)
    assert found["gradient"]["objective_arcmin"] == pytest.approx(0.0, abs=1e-6)
    assert np.abs(list(found["sensitivity"]["gradient_arcmin"].values())).max() < 1e-6
    scene, asked = loads_optimise(path.read_text(encoding="utf-8"))
    optimisation = optimise(asked, scene, silent)
    assert re.fullmatch(r"\+0\.\d+ arcmin", optimisation.rise_shown(optimisation.sensitivity.rises[0]))
    assert optimisation.rise_shown(0.123) == "+12.3 %"


@pytest.mark.slow
def test_tables_without_a_grid(capsys, tmp_path):
    path = tmp_path / "no_grid.toml"
    text = FAST.replace('grid_step = "60 deg"', "").replace('["no_load"]', '["no_load", "static"]')
    path.write_text(text, encoding="utf-8")
    code, out, _ = command(capsys, "optimise", path, "--out", tmp_path / "out")
    assert code == 0
    assert "of 8 starts within 1 % of the best" in out
    assert "assembled without error or 10 deg off to either side" in out
    assert "grid" not in out


@pytest.mark.slow
def test_an_even_load_has_no_unit(capsys, tmp_path):
    """Load sharing of an involute reducer by its flanks: no angle in any table, file or figure."""
    path, folder = tmp_path / "even.toml", tmp_path / "out"
    errors = {
        "tip": {"kind": "tip_relief", "body": "gear_1", "amount": ["0.5 um"], "length": "0.3 mm"},
        "slope": {"kind": "profile_slope", "body": "gear_1", "slope": ["0 um"]},
    }
    asked = {
        "objective": "static_load_sharing",
        "torque": "100 N*m",
        "where": ["errors.tip.amount[0]", "errors.slope.slope[0]"],
        "bounds": {"errors.tip.amount[0]": ["0 um", "3 um"], "errors.slope.slope[0]": ["-2 um", "2 um"]},
        "starts": 4,
    }
    run = {"duration": "0.02 s", "samples": 61, "analyses": ["static"], "torques": ["100 N*m"]}
    tables = GEAR_SETS["involute_rv"].tables | {"errors": errors, "run": run, "optimise": asked}
    tables["compliance"] = tables["compliance"] | {"mean": "2e9 N/m"}  # the seven candidates are enough
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    code, out, err = command(capsys, "optimise", path, "--json", "--out", folder)
    assert code == 0, err
    report = json.loads(out)
    assert not any("objective" in key and "arcmin" in key for part in (report, report["gradient"]) for key in part)
    assert 1 < report["gradient"]["objective"] < report["objective_before"]
    best = gj.load(folder / "optimised.toml")
    known = gj.transmission_error(best, best.system.input_speed * best.run.times, torque=100.0).load_sharing.max()
    assert report["gradient"]["objective"] == pytest.approx(float(known), rel=1e-9)
    assert "objective [-]" in (folder / "starts.csv").read_text(encoding="utf-8").splitlines()[0]


def test_the_section():
    _, section = loads_optimise(TEXT)
    assert section.where == tuple(PHASES)
    assert section.window == 15.8
    assert section.objective.theta.shape == (15801,)
    assert section.grid_step == dict.fromkeys(PHASES, 10 * deg)
    assert (section.starts, section.seed) == (300, 0)
    objective = (
        '[{ name = "no_load_amplitude" }, { name = "static_order", torque = "30 N*m", order = 26, weight = 2.0 }]'
    )
    other = TEXT.replace('objective = "no_load_amplitude"\n', f"objective = {objective}\n")
    other = other.replace('grid_step = "10 deg"', 'window = "3 s"')
    other = other.replace('"errors.planet_1.phase"', '"errors.planet_1.amplitude"')
    other += '[optimise.bounds]\n"errors.planet_1.amplitude" = ["5 um", "20 um"]\n'
    _, section = loads_optimise(other)
    assert section.bounds == {"errors.planet_1.amplitude": pytest.approx((5 * um, 20 * um))}
    assert section.grid_step == {}
    assert section.objective.theta.shape == (3001,)
    assert [term.name for term in section.objective.terms] == ["no_load_amplitude", "static_order"]
    assert [float(term.weight) for term in section.objective.terms] == [1.0, 2.0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("starts = 300", "start = 300", 'did you mean "starts"'),
        ("starts = 300", "starts = 0", "optimise.starts = 0: must be a whole number from 1"),
        ('"errors.planet_1.phase"', '"errors.planet_1.phas"', 'did you mean "errors.planet_1.phase"'),
        ('"errors.planet_1.phase"', '"errors.planet_2.phase"', "is listed twice"),
        ('"errors.planet_1.phase"', '"errors.planet_1.amplitude"', "optimise.grid_step.errors.planet_1.amplitude"),
        ('grid_step = "10 deg"', 'grid_step = "10 um"', "is a length; needs an angle"),
        ('grid_step = "10 deg"', 'grid_step = "-10 deg"', "must be above 0"),
        ('grid_step = "10 deg"', "grid_step = 10", "has no unit"),
        ('objective = "no_load_amplitude"\n', 'objective = "no_load_amplitud"\n', 'did you mean "no_load_amplitude"'),
        ('objective = "no_load_amplitude"\n', 'objective = "static_std"\n', "needs a torque"),
        ('objective = "no_load_amplitude"\n', 'torque = "3 N*m"\nobjective = "no_load_std"\n', "takes no torque"),
        ('objective = "no_load_amplitude"\n', "", "optimise.objective"),
        ('objective = "no_load_amplitude"\n', 'objective = [{ name = "no_load_std", weight = -1 }]\n', "above 0"),
        ('objective = "no_load_amplitude"\n', 'objective = "no_load_order"\norder = "crnk"\n', '"crank"'),
        (
            'objective = "no_load_amplitude"\n',
            'objective = [{ name = "no_load_std" }, { name = "static_load_sharing", torque = "9 N*m" }]\n',
            "adds angles to load sharing",
        ),
        ("starts = 300", 'starts = 300\nwindow = "3 m"', "is a length; needs a time"),
        ("starts = 300", "starts = 300\nseed = -1", "must be a whole number from 0"),
        ("starts = 300", 'starts = 300\n[optimise.bounds]\n"errors.planet_1.phase" = ["1 deg"]', "must be a pair"),
        (
            "starts = 300",
            'starts = 300\n[optimise.bounds]\n"system.module" = ["1 mm", "2 mm"]',
            "is not in optimise.where",
        ),
        ("[run]", "[runs]", 'did you mean "run"'),
    ],
)
def test_mistakes(old, new, words):
    assert old in TEXT
    with pytest.raises(gj.GearjaxError) as caught:
        loads_optimise(TEXT.replace(old, new))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_mistakes_of_the_command(capsys, tmp_path, config_text):
    path = tmp_path / "plain.toml"
    path.write_text(config_text, encoding="utf-8")
    code, out, err = command(capsys, "optimise", path, "--json")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "no [optimise]" in err
    path.write_text(
        FAST.replace('"errors.planet_1.phase"', '"damping.ratio"').replace('grid_step = "60 deg"', "")
        + '[optimise.bounds]\n"damping.ratio" = [0.05, 0.2]\n',
        encoding="utf-8",
    )
    code, out, err = command(capsys, "optimise", path, "--json")
    assert (code, out) == (2, "")
    assert '"damping.ratio": the objective no_load_amplitude does not depend on it' in err.splitlines()[-1]


def test_other_numbers_in_a_configuration(config_text):
    """Every kind of number survives the way into a file and back."""
    scene = gj.loads(config_text)
    values = {
        "errors.planet_1.phase": -1.2345678901234,
        "errors.planet_2.amplitude": 1.5e-5,
        "compliance.phases[0]": 0.7,
        "compliance.relative_amplitudes[0]": 0.11,
        "damping.ratio": 0.2,
        "inertia.mass": 2.5,
        "system.input_speed": 20.0,
    }
    text = with_numbers(config_text, values, numbers(scene))
    assert "published" not in text
    again = gj.loads(text)
    np.testing.assert_allclose(pick(again, list(values)).get(again), list(values.values()), rtol=1e-13)
