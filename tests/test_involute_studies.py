"""Populations of involute RV reducers: fast curves of contacts that go from tooth to tooth are what analyses give."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.studies.select import pick
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.measures import Measures
from gearjax.units import mm, um
from tests.conftest import ROOT
from tests.involute import system


@pytest.mark.slow
@pytest.mark.parametrize("sets", [None, 2])
def test_compensation_moves_numbers_of_errors(sets):
    """Tip relief that nothing asks for goes, under the scene's own errors and under given sets of them."""
    springs = gj.HarmonicStiffness(mean=2e9, relative_amplitudes=[], phases=[])
    errors = {"tip": gj.TipRelief("gear_1", 2 * um, 0.3 * mm)}
    backlash = gj.InitialBacklash(initial=40 * um)
    scene = gj.Scene(system(pairs=7, profile_points=3), errors, backlash=backlash, compliance=springs)
    given = None if sets is None else [errors, {"tip": gj.TipRelief("gear_1", 1 * um, 0.3 * mm)}]
    theta, path = np.linspace(0.0, 0.02, 4), "errors.tip.amount[0]"
    design = gj.compensate(scene, theta, 50.0, [path], bounds={path: (0.0, 5 * um)}, error_sets=given)
    assert design.values[path] == pytest.approx(0.0, abs=1e-3 * um)
    known = -gj.transmission_error(design.scene, theta, torque=50.0).te.mean()
    np.testing.assert_allclose(design.after.mean_lag, known, rtol=1e-9)
    assert float(design.after.mean_lag.max()) < 0.99 * float(design.before.mean_lag.min())
    calm = dataclasses.replace(scene, errors={"tip": gj.TipRelief("gear_1", 0.0, 0.3 * mm)})
    path = "errors.tip.length"
    with pytest.raises(gj.GearjaxError, match="does not depend on it"):  # there is no relief that it would bound
        gj.compensate(calm, theta, 50.0, [path], bounds={path: (0.1 * mm, 0.4 * mm)})


@pytest.mark.slow
def test_a_population_is_measured_as_its_analyses_do(rng):
    """Random teeth, over many angles: each member's metrics are those of the public functions."""
    base = gj.load(ROOT / "configs" / "involute_rv" / "yang_2019.toml")
    teeth = gj.Positions(body="gear_1", outward=jnp.zeros(0), around=jnp.asarray(rng.normal(size=236) * um))
    scene = dataclasses.replace(
        base,
        system=dataclasses.replace(base.system, profile_points=1, pairs=13),
        errors=base.errors | {"teeth": teeth},
        compliance=gj.HarmonicStiffness(mean=2e8, relative_amplitudes=[], phases=[]),
        run=None,
    )
    varied = {
        "errors.gear_1.phase": gj.UniformPhase(),
        "errors.ring.phase": gj.UniformPhase(),
        "errors.teeth.around[16]": gj.Uniform(-3 * um, 3 * um),
        "errors.gear_1.amplitude": gj.Uniform(1 * um, 6 * um),
    }
    theta = np.linspace(0.0, 1.3, 1601)
    named = [Measure.named(name) for name in ("no_load.peak_to_peak", "static.std@100Nm", "backlash.minimum")]
    measures = Measures(named, gj.Tolerances(scene, varied), theta, "samples")
    assert measures.curves is not None  # quick ones are what is tested
    for row in ([0.3, 2.0, 1 * um, 2 * um], [3.0, 5.0, -2 * um, 5 * um]):
        member = pick(scene, list(varied)).set(scene, jnp.asarray(row))
        known = [
            gj.transmission_error(member, theta, extremes="samples").peak_to_peak,
            gj.transmission_error(member, theta, torque=100.0, extremes="samples").std,
            gj.backlash(member, theta).backlash.min(),
        ]
        found, code = measures(jnp.asarray(row))
        assert int(code) == 0
        np.testing.assert_allclose(found, known, rtol=1e-8)
