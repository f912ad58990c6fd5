"""Populations of gear sets whose levers vary with the angle: their curves follow from few angles, as all others do."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.tolerance.curves import Curves
from gearjax.units import um
from tests.test_varied_systems import drawn

MEASURES = ["no_load.peak_to_peak", "backlash.peak_to_peak", "static.maximum@20Nm", "static.minimum@-5Nm"]


@pytest.fixture(scope="module")
def tolerances():
    scene = dataclasses.replace(gj.load("configs/elliptic/two_lobes.toml"), reference=None)
    spread = {
        "errors.driver.amplitude": gj.Rayleigh(12 * um),
        "errors.driver.phase": gj.UniformPhase(),
        "errors.driven.amplitude": gj.Rayleigh(18 * um),
        "errors.driven.phase": gj.UniformPhase(),
        "compliance.mean": gj.Uniform(1e8, 2e8),
    }
    return gj.Tolerances(scene, spread)


@pytest.fixture(scope="module")
def theta(tolerances):
    return np.linspace(0.0, float(tolerances.scene.system.cycle), 361)


def touching(scene, angle):
    """Positions of the output at which the contacts touch [rad]."""
    contacts = scene.anchored().contacts(angle, "mean")
    return contacts.gap / contacts.lever


@pytest.mark.slow
def test_few_angles_give_the_curves_of_all(tolerances, theta):
    examples = jax.tree.map(lambda *leaves: jnp.stack(leaves), *drawn(tolerances, 24))
    curves = Curves.of(examples, jnp.asarray(theta), "mean", True)
    assert curves.levers_vary
    assert curves.weights is not None
    assert curves.weights.shape[1] < 24
    for scene in drawn(tolerances, 3):
        touch = np.asarray(jax.vmap(lambda angle, scene=scene: touching(scene, angle))(jnp.asarray(theta)))
        for analysis, torque in (("no_load", None), ("backlash", None), ("static", 20.0)):
            curve = np.asarray(curves.curve(scene, analysis, torque))
            if torque is None:
                side = np.asarray(scene.layout.side)
                low, high = touch[:, side > 0].max(axis=1), touch[:, side < 0].min(axis=1)
                exact = low if analysis == "no_load" else high - low
            else:
                exact = np.asarray(gj.transmission_error(scene, theta, torque, extremes="samples").te)
            np.testing.assert_allclose(curve, exact, rtol=0, atol=1e-10 * np.abs(exact).max())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")
@pytest.mark.parametrize(("number", "off"), [(41, 1e-4), (361, 2e-5)])
def test_extremes_between_the_samples_are_those_of_each_gear_set(number, off, tolerances, theta):
    theta = np.linspace(theta[0], theta[-1], number)
    found = gj.monte_carlo(tolerances, MEASURES, n=6, theta=theta).values
    at_samples = gj.monte_carlo(tolerances, MEASURES, n=6, theta=theta, extremes="samples").values
    for scene, values, sampled in zip(drawn(tolerances, 6), found, at_samples, strict=True):
        play = gj.backlash(scene, theta)
        te, pressed, back = (gj.transmission_error(scene, theta, torque) for torque in (None, 20.0, -5.0))
        exact = te.peak_to_peak, play.peak_to_peak, pressed.extremes.maximum, back.extremes.minimum
        exact = np.array(exact, dtype=float)
        np.testing.assert_allclose(values, exact, rtol=off, atol=1e-6 * np.abs(exact).max())
        assert (np.abs(values - sampled) > 1e-6 * np.abs(values)).any()
