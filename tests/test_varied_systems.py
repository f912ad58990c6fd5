"""Tolerance studies in which numbers of the gear set itself vary, against the analyses of each sample."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.studies.select import pick
from gearjax.tolerance.sampling import points
from gearjax.units import arcmin, um
from tests.test_matrix import GEAR_SETS, Case

MEASURES = ("no_load.mean", "no_load.peak_to_peak", "no_load.maximum")


def drawn(tolerances, number):
    """The first gear sets of a study with key 0."""
    rows = tolerances.values(points("monte_carlo", 0, tolerances.paths, number, 0, number))
    return [tolerances.with_values(jnp.asarray(row)) for row in rows]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")
@pytest.mark.parametrize("extremes", ["samples", "between"])
@pytest.mark.parametrize("gear_set", GEAR_SETS)
def test_each_sample_is_that_of_its_own_gear_set(gear_set, extremes):
    case = Case(gear_set, "system", "amplitude")
    tolerances = gj.Tolerances(case.scene, {number.path: gj.Uniform(*number.ends) for number in case.numbers})
    found = gj.monte_carlo(tolerances, MEASURES, n=3, theta=case.theta, extremes=extremes).values
    assert np.ptp(found[:, 1]) > 0
    for scene, values in zip(drawn(tolerances, 3), found, strict=True):
        te = gj.transmission_error(scene, case.theta)
        ends = (te.te.max(), te.te.min()) if extremes == "samples" else (te.extremes.maximum, te.extremes.minimum)
        expected = float(te.te.mean()), float(ends[0] - ends[1]), float(ends[0])
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-9 * float(jnp.abs(te.te).max()))


@pytest.mark.slow
def test_matched_assembly_of_varied_centre_distances_is_the_best_of_all_phases():
    scene, theta = gj.load("configs/elliptic/dong_2020_tolerance.toml"), np.linspace(0.0, 2 * np.pi, 181)
    spread = {
        "errors.driver.amplitude": gj.Rayleigh(12 * um),
        "system.centre_distance_error": gj.Normal(20 * um, 10 * um),
    }
    where, units = "errors.driver.phase", 4
    population = gj.Tolerances(scene, spread | {where: gj.UniformPhase()})
    measure = gj.Measure("no_load", "peak_to_peak", limit=2 * arcmin)
    found = gj.matched_assembly(population, measure, where=where, units=units, theta=theta)
    phases = jnp.linspace(-np.pi, np.pi, 721)
    free = pick(scene, where)

    @jax.jit
    def best(one):
        return jax.vmap(lambda phase: gj.transmission_error(free.set(one, phase[None]), theta).peak_to_peak)(
            phases
        ).min()

    for value, one in zip(found.matched, drawn(population, units), strict=True):
        assert value == pytest.approx(float(best(one)), abs=0.02 * arcmin)
