"""Objectives of gear sets as they are made: their mean, its gradients, and searches under scatter."""

import json
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.checks import GearjaxError, ParameterError
from gearjax.cli import main
from gearjax.config import loads_optimise, read_file, read_tables
from gearjax.studies.select import pick
from gearjax.studies.values import values
from gearjax.units import arcmin, um
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, meshes_of, scene_of

CROWN, SLOPE = "errors.crowning.amount[0]", "errors.slope.slope[0]"
TORQUE = 600.0
BOUNDS = {CROWN: (0.0, 30 * um)}


@pytest.fixture(scope="module")
def scene():
    """A helical pair whose crowning is to be found, with a helix slope that differs from pair to pair."""
    errors = {
        "tip": gj.TipRelief("pinion", [8 * um], 8e-3),
        "root": gj.RootRelief("pinion", [8 * um], 8e-3),
        "crowning": gj.Crowning("pinion", [6 * um]),
        "slope": gj.HelixSlope("pinion", [0.0]),
    }
    return scene_of(GUO_1, errors, gj.LineStiffness(1.3e10), slices=8)


@pytest.fixture(scope="module")
def theta(scene):
    return meshes_of(scene.system, 20)


@pytest.fixture(scope="module")
def population(scene):
    return gj.Tolerances(scene, {SLOPE: gj.Normal(0.0, 12 * um), CROWN: gj.Normal(6 * um, 1 * um)})


def objective(scene, theta, scatter=None):
    return gj.Objective.of("static_peak_to_peak", scene, theta, TORQUE, scatter=scatter)


@pytest.mark.slow
def test_it_is_the_mean_of_the_gear_sets_one_by_one(scene, theta, population):
    drawn = population.scatter(6, around=[CROWN])
    both, alone = pick(scene, [SLOPE, CROWN]), pick(scene, [CROWN])
    crown = 9 * um
    apart = np.asarray(drawn.values) + np.array([0.0, crown])
    for kind in ("hard", "sampled", "refined"):
        each = values(objective(scene, theta), scene, both, kind)(apart)
        whole = values(objective(scene, theta, drawn), scene, alone, kind)(np.array([[crown]]))
        assert whole[0] == pytest.approx(each.mean(), rel=1e-12), kind
    absolute = np.asarray(population.scatter(6).values)
    np.testing.assert_allclose(absolute, np.asarray(drawn.values) + np.array([0.0, 6 * um]), rtol=1e-12)


def test_the_numbers_drawn_are_those_of_the_distributions(population):
    values = np.asarray(population.scatter(512, seed=3).values)
    np.testing.assert_allclose(values.mean(axis=0), [0.0, 6 * um], atol=0.1 * um)
    np.testing.assert_allclose(values.std(axis=0), [12 * um, 1 * um], rtol=0.02)
    assert not np.array_equal(values, np.asarray(population.scatter(512, seed=4).values))
    np.testing.assert_array_equal(values, np.asarray(population.scatter(512, seed=3).values))


@pytest.mark.slow
def test_gradients_are_differences_under_jit_and_vmap(scene, theta, population):
    whole, free = objective(scene, theta, population.scatter(5, around=[CROWN])), pick(scene, [CROWN])

    def at(amount):
        return whole.smooth(free.set(scene, amount), 1e-7) / arcmin

    slope = jax.jit(jax.vmap(jax.grad(at)))(jnp.array([[20 * um]]))[0, 0]
    ends = jax.jit(jax.vmap(at))(jnp.array([[20 * um + 1e-9], [20 * um - 1e-9]]))
    assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / 2e-9, rel=1e-5)


@pytest.mark.slow
def test_crowning_pays_for_pairs_that_are_not_aligned(scene, theta, population):
    """The search finds the minimum of a fine grid, and it is better on pairs that the search has not seen."""
    free = pick(scene, [CROWN], BOUNDS)
    made = objective(scene, theta, population.scatter(24, around=[CROWN]))
    found = gj.minimise(made, scene, where=[CROWN], bounds=BOUNDS, starts=3)
    plain = gj.minimise(objective(scene, theta), scene, where=[CROWN], bounds=BOUNDS, starts=3)
    fresh = objective(scene, theta, population.scatter(200, around=[CROWN], seed=9))
    ideal, real = values(fresh, scene, free)(np.stack([plain.best, found.best]))
    assert real < 0.95 * ideal
    grid = np.linspace(0.0, 30 * um, 61)[:, None]
    every = values(made, scene, free)(grid)
    assert found.objective <= every.min() * (1 + 1e-6)
    assert found.best[0] > plain.best[0] + 2 * um


@pytest.mark.slow
def test_other_studies_take_it(scene, theta, population):
    made = objective(scene, theta, population.scatter(4, around=[CROWN]))
    grid = gj.grid_search(made, scene, where=[CROWN], step={CROWN: 10 * um}, bounds=BOUNDS)
    assert np.isfinite(grid.objectives).all()
    around = gj.local_sensitivity(made, scene, where=[CROWN], bounds=BOUNDS)
    assert np.isfinite(around.gradient).all()


@pytest.mark.slow
def test_wrong_input_is_refused_in_one_line(population, scene, theta):
    with pytest.raises(ParameterError, match=r"around = .*is not toleranced"):
        population.scatter(4, around=["errors.crowning.length"])
    with pytest.raises(ParameterError, match=r"number = .*at least 1"):
        population.scatter(0)
    overwritten = objective(scene, theta, population.scatter(4))
    with pytest.raises(GearjaxError, match="does not depend on it"):
        gj.minimise(overwritten, scene, where=[CROWN], bounds=BOUNDS, starts=2)


# from a configuration -------------------------------------------------------------------------------------------------


def tables(**optimise):
    given = read_tables(read_file(ROOT / "configs" / "helical" / "guo_2018_optimise.toml"))
    given["system"] |= {"slices": 6}
    given["run"] |= {"samples": 22, "torques": ["600 N*m"]}
    given["compliance"] = {"kind": "line_stiffness", "per_length": "13 N/mm/um"}
    given["errors"] = {
        **{key: part | {"amount": ["8 um"]} for key, part in given["errors"].items()},
        "crowning": {"kind": "crowning", "body": "pinion", "amount": ["2 um"]},
        "slope": {"kind": "helix_slope", "body": "pinion", "slope": ["0 um"]},
    }
    given["tolerance"] = {
        "samples": 100,
        "measures": [{"name": "static.peak_to_peak", "torque": "600 N*m", "limit": "1 arcmin"}],
        SLOPE: {"kind": "normal", "mean": "0 um", "std": "12 um"},
        CROWN: {"kind": "normal", "mean": "2 um", "std": "0.5 um"},
    }
    bounds = {CROWN: ["0 um", "30 um"]}
    own = {"objective": "static_peak_to_peak", "torque": "600 N*m", "where": [CROWN], "bounds": bounds, "starts": 2}
    given["optimise"] = own | optimise
    return given


@pytest.mark.slow
def test_a_configuration_takes_its_gear_sets_from_the_tolerance_section(tmp_path, capsys):
    _, section = loads_optimise(tomli_w.dumps(tables(scatter=8)))
    drawn = section.objective.scatter
    assert drawn is not None
    assert drawn.around == tuple(path == CROWN for path in drawn.free.paths)
    assert len(drawn.values) == section.scatter == 8
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(tables(scatter=8)), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["optimise", str(path), "--json"])
    assert ended.value.code == 0
    told = json.loads(capsys.readouterr().out)["scatter"]
    assert told["gear_sets"] == 8
    assert told["other_gear_sets"] == 256
    assert told["other_gear_sets_after_arcmin"] < told["other_gear_sets_before_arcmin"]


def test_without_a_tolerance_section_it_is_refused():
    lacking = {key: part for key, part in tables(scatter=8).items() if key != "tolerance"}
    with pytest.raises(ParameterError, match=re.escape("optimise.scatter = 8: needs [tolerance]")):
        loads_optimise(tomli_w.dumps(lacking))
    with pytest.raises(ParameterError, match=r"optimise.scatter = 0: must be a whole number from 1 to"):
        loads_optimise(tomli_w.dumps(tables(scatter=0)))
