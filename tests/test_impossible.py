"""Gear sets of a population that cannot be made: counted, told with the reason of their part, refused if all are."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import GearjaxError
from gearjax.cli import main
from gearjax.config import loads_tolerance
from gearjax.results.tolerance import prepared
from gearjax.studies.select import numbers, pick
from gearjax.tolerance.impossible import impossible, make_anew
from gearjax.units import mm
from tests.conftest import ROOT

STUDY = """
[run]
duration = "1 s"
samples = 101
analyses = ["no_load"]

[tolerance]
samples = 40
measures = ["static.peak_to_peak@100Nm"]
"compliance.relative_amplitudes[0]" = {{kind = "uniform", low = {low}, high = {high}}}
"""


def configuration(low: float, high: float) -> str:
    text = (ROOT / "configs/two_kv/wang_2020.toml").read_text()
    return text[: text.index("[run]")] + STUDY.format(low=low, high=high)


def population(low: float, high: float) -> gj.Tolerances:
    return loads_tolerance(configuration(low, high))[2].tolerances


def test_stiffness_below_zero_is_counted():
    """The stiffness 1 + a cos is negative somewhere if a is above 1."""
    rows = np.linspace(0.5, 1.5, 11)[:, None] + 1e-3
    found = impossible(population(0.1, 1.5), rows)
    assert (found.looked_at, found.refused, found.sample) == (11, 6, 5)
    assert "the stiffness becomes negative" in found.reason
    assert found.told.startswith("impossible: 6 of the first 11 gear sets cannot be made")
    assert impossible(population(0.1, 1.5), rows[:5]).told is None


def test_parts_check_numbers_together():
    """Pins that each fit, but not with their eccentricity, undercut the disc."""
    scene = gj.load(ROOT / "configs/rv_cycloidal/hu_2020.toml")
    spreads = {"system.pin_radius": gj.Uniform(2 * mm, 6 * mm), "system.eccentricity": gj.Uniform(1.4 * mm, 1.7 * mm)}
    many = gj.Tolerances(scene, spreads)
    order = [many.paths.index(path) for path in spreads]
    rows = np.array([[3 * mm, 1.5 * mm], [6 * mm, 1.7 * mm]])[:, np.argsort(order)]
    found = impossible(many, rows)
    assert (found.refused, found.sample) == (1, 1)
    assert "undercuts the disc" in found.reason


PATHS = [path for path in sorted(ROOT.glob("configs/*/*.toml")) if "[system]" in path.read_text()]
CONFIGS = [str(path.relative_to(ROOT / "configs")) for path in PATHS]


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGS)
def test_gear_sets_as_they_are_can_be_made(name):
    """With every number of every part free, none of the parts refuses to be made anew."""
    scene = gj.load(ROOT / "configs" / name)
    free = pick(scene, list(numbers(scene)))
    make_anew(free.set(scene, jnp.asarray(free.get(scene))), free.paths)


def test_numbers_out_of_their_own_bounds_are_failures_of_another_kind():
    assert impossible(population(0.1, 1.5), np.array([[np.nan], [0.5]])).refused == 0


def test_a_study_of_impossible_gear_sets_is_refused():
    section = loads_tolerance(configuration(1.2, 1.5))[2]
    with pytest.raises(GearjaxError, match=r"^tolerance: none of the first 8 gear sets can be made: relative_ampl"):
        prepared(section)


@pytest.mark.slow
def test_the_command_tells_how_many(tmp_path, capsys):
    (tmp_path / "gears.toml").write_text(configuration(0.5, 1.5))
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["tolerance", str(tmp_path / "gears.toml"), "--json"])
    told = json.loads(capsys.readouterr().out)["impossible"]
    assert told["looked_at"] == 40
    assert 0.2 < told["refused"] / 40 < 0.8
