"""Growth of disturbances: known rates, chaos under torque that reverses at mesh frequency, and its warnings."""

import dataclasses
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import arcmin
from tests.test_dynamics import MASS, STIFFNESS, TORQUE, oscillator, still
from tests.test_fitted import resting

__all__ = ["oscillator", "still"]
TIMES = jnp.linspace(0.0, 1.0, 1001)


@pytest.fixture(scope="module")
def reversing(scene):
    """Torque that reverses with every tooth, across a backlash of 0.2 mm (chaotic in an independent study)."""
    return dataclasses.replace(
        scene, load=gj.SinusoidalLoad("mesh"), backlash=gj.InitialBacklash(2e-4), inertia=gj.EquivalentMass(3.0)
    )


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.5])
def test_a_linear_oscillator_forgets_with_its_damping(oscillator, ratio):
    """One pair in contact: c / 2m, and 0 undamped; the number of steps does not matter."""
    expected = -0.5 * ratio * np.sqrt(2 * STIFFNESS / MASS)
    for number in (16, 40):
        rate = gj.growth_rate(resting(oscillator, ratio), TIMES, TORQUE, stepper=gj.FixedStep(per_sample=number))
        assert float(rate) == pytest.approx(expected, rel=5e-3, abs=2.0)


@pytest.mark.slow
def test_overdamped_it_is_the_slower_rate(oscillator):
    decay = 0.5 * 3.0 * np.sqrt(2 * STIFFNESS / MASS)
    slow = -decay + np.sqrt(decay**2 - STIFFNESS / MASS)
    assert float(gj.growth_rate(resting(oscillator, 3.0), TIMES, TORQUE)) == pytest.approx(slow, rel=5e-3)


@pytest.mark.slow
def test_reversal_at_mesh_frequency_is_chaotic(reversing):
    """Two motions a rounding apart differ by arcminutes within half a second, and the rate says so."""
    rate = float(gj.growth_rate(reversing, TIMES, 30.0))
    assert 20 < rate < 300
    heavier = dataclasses.replace(reversing, inertia=gj.EquivalentMass(3.0 * (1 + 1e-13)))
    apart = np.abs(np.asarray(gj.simulate(reversing, TIMES, 30.0).te - gj.simulate(heavier, TIMES, 30.0).te))
    assert apart[:10].max() < 1e-9 * arcmin
    assert apart.max() > 0.5 * arcmin


def slopes(scene):
    """Gradients of a statistic with respect to the mass, as a user may ask for them."""

    def spread(mass):
        return gj.simulate(dataclasses.replace(scene, inertia=gj.EquivalentMass(mass)), TIMES, 30.0).std

    three = jnp.asarray(3.0)
    return [
        lambda: jax.grad(spread)(three),
        lambda: jax.jit(jax.jacfwd(spread))(three),
        lambda: jax.jit(jax.vmap(jax.grad(spread)))(jnp.array([3.0, 3.1])),
    ]


def done(slope):
    value = jax.block_until_ready(slope())
    jax.effects_barrier()  # warnings arrive before this
    return np.asarray(value)


@pytest.mark.slow
def test_its_gradients_warn(reversing):
    for slope in slopes(reversing):
        with pytest.warns(UserWarning, match=r"grows at .* 1/s: gradients of its samples mean nothing"):
            done(slope)


@pytest.mark.slow
def test_reversal_at_crank_frequency_forgets(reversing):
    calm = dataclasses.replace(reversing, load=gj.SinusoidalLoad("crank"))
    assert float(gj.growth_rate(calm, TIMES, 30.0)) < -50
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for slope in slopes(calm)[:1]:
            assert np.isfinite(done(slope)).all()


def test_refusals(scene):
    with pytest.raises(gj.SceneError, match="fitted scheme"):
        gj.growth_rate(scene, TIMES, 30.0, stepper=gj.FixedStep(1e-5, solver=gj.RungeKutta4()))
    with pytest.raises(gj.SceneError, match=r"needs \[inertia\]"):
        gj.growth_rate(dataclasses.replace(scene, inertia=None, damping=None), TIMES, 30.0)
