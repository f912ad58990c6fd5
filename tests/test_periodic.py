"""Periodic motions against published and exact ones: the clearance oscillator, jumps and hysteresis."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from tests.test_dynamics import RADIUS, TORQUE, oscillator

__all__ = ["oscillator"]
STIFFNESS, MASS = 1e8, 1.0
NATURAL = np.sqrt(STIFFNESS / MASS)
FORCE = TORQUE / RADIUS / STIFFNESS / RADIUS  # static deflection [rad]


def clearance(scene, ratio=0.05, kappa=0.2):
    """``x'' + 2 z x' + (1 + kappa cos W t) g(x) = F``: one perfect pair, damped in the clearance too, no back flank."""
    return dataclasses.replace(
        scene,
        errors={},
        compliance=gj.HarmonicStiffness(STIFFNESS, [kappa], [0.0]),
        inertia=gj.EquivalentMass(MASS),
        damping=gj.DampingRatio(ratio * np.sqrt(2), "always"),
    )


def turning(scene, ratio):
    """At a mesh frequency of ``ratio`` times the natural frequency, and its period."""
    speed = ratio * NATURAL / scene.system.orders["mesh"]
    moved = dataclasses.replace(scene, system=dataclasses.replace(scene.system, input_speed=speed))
    return moved, 2 * np.pi / (ratio * NATURAL)


@pytest.fixture(scope="module")
def sweeps(request):
    scene = clearance(request.getfixturevalue("scene_of_one_pair"))
    ratios = np.linspace(0.80, 0.95, 16)
    speeds = ratios * NATURAL / scene.system.orders["mesh"]
    up = gj.speed_sweep(scene, TORQUE, speeds, periods=150)
    down = gj.speed_sweep(scene, TORQUE, speeds[::-1], periods=150)
    upper = {round(float(ratio), 2): end for ratio, end in zip(ratios, down.ends[::-1], strict=True)}
    return ratios, np.asarray(up.std) / FORCE, np.asarray(down.std)[::-1] / FORCE, upper


@pytest.fixture(scope="module")
def scene_of_one_pair():
    from gearjax.reproduce import two_kv

    full = two_kv.scene()
    return dataclasses.replace(
        full, system=dataclasses.replace(full.system, planets=1), errors={}, reference=None, backlash=None
    )


@pytest.mark.slow
def test_jumps_and_hysteresis(sweeps):
    """Down at 0.83 to 0.84 on the way down, up at 0.90 to 0.91 on the way up; peak 1.477 at 0.837 (RK4 sweeps)."""
    ratios, up, down, _ = sweeps
    np.testing.assert_allclose(up[0], down[0], rtol=1e-6)
    np.testing.assert_allclose(up[-1], down[-1], rtol=1e-6)
    jump_up = ratios[np.argmax(np.diff(up))]
    jump_down = ratios[np.argmax(np.diff(down))]
    assert jump_up == pytest.approx(0.90, abs=1e-9)
    assert jump_down == pytest.approx(0.83, abs=1e-9)
    assert down.max() == pytest.approx(1.477, abs=0.015)
    both = (ratios > 0.835) & (ratios < 0.905)
    assert (down[both] > 1.1 * up[both]).all(), "two stable motions"


@pytest.mark.slow
def test_shooting(scene_of_one_pair, sweeps):
    """rms 1.44290291 at 0.85; multipliers of size 0.6910 with the product exp(-4 pi z / W)."""
    scene, period = turning(clearance(scene_of_one_pair), 0.85)
    guess = sweeps[3][0.85]
    found = [gj.shooting(scene, TORQUE, period, steps=n, guess=guess) for n in (512, 1024, 2048)]
    values = np.array([float(motion.std) / FORCE for motion in found])
    assert all(int(motion.result) == 0 and bool(motion.stable) for motion in found)
    assert values[-1] == pytest.approx(1.44290291, abs=2e-5)
    assert abs(values[-1] - 1.44290291) < 0.5 * abs(values[0] - 1.44290291)
    multipliers = np.asarray(found[-1].multipliers)
    np.testing.assert_allclose(np.abs(multipliers), 0.6910, atol=2e-4)
    assert multipliers.prod().real == pytest.approx(np.exp(-4 * np.pi * 0.05 / 0.85), rel=1e-6)


@pytest.mark.slow
def test_the_lower_branch_is_another_motion(scene_of_one_pair, sweeps):
    scene, period = turning(clearance(scene_of_one_pair), 0.88)
    upper = gj.shooting(scene, TORQUE, period, guess=sweeps[3][0.88])
    lower = gj.shooting(scene, TORQUE, period)
    assert bool(upper.stable)
    assert bool(lower.stable)
    assert float(upper.std) > 1.2 * float(lower.std)


@pytest.mark.slow
def test_harmonic_balance_agrees_with_shooting(scene_of_one_pair, sweeps):
    """Error at W = 0.85: 2.2e-4 with 8 harmonics, 3.0e-5 with 16, 1.1e-6 with 32 (relative)."""
    scene, period = turning(clearance(scene_of_one_pair), 0.85)
    start = gj.shooting(scene, TORQUE, period, guess=sweeps[3][0.85])
    for harmonics, allowed in ((8, 1e-3), (16, 1.5e-4), (32, 2e-5)):
        found = gj.harmonic_balance(scene, TORQUE, period, harmonics=harmonics, guess=start.te)
        assert int(found.result) == 0
        assert float(found.std) / FORCE == pytest.approx(1.44290291, rel=allowed)


@pytest.mark.slow
def test_linear_frequency_response(oscillator):
    """A pair that never opens, driven by its eccentricity: amplitude and phase to 1e-6 by both solvers."""
    from tests.test_dynamics import MASS as HEAVY
    from tests.test_dynamics import SIZE, SLOW
    from tests.test_dynamics import STIFFNESS as STIFF

    damped = dataclasses.replace(oscillator, damping=gj.DampingRatio(0.3))
    factor = 60.0
    fast = dataclasses.replace(
        damped, system=dataclasses.replace(damped.system, input_speed=factor * damped.system.input_speed)
    )
    rate = factor * SLOW
    damping = 0.3 * np.sqrt(2 * STIFF * HEAVY)
    gain = (STIFF + 1j * damping * rate) / (STIFF - HEAVY * rate**2 + 1j * damping * rate)
    expected = SIZE * abs(gain) / RADIUS / np.sqrt(2)
    period = 2 * np.pi / rate
    torque = 2000.0
    assert float(gj.harmonic_balance(fast, torque, period, harmonics=2).std) == pytest.approx(expected, rel=1e-9)
    errors = [abs(float(gj.shooting(fast, torque, period, steps=n).std) / expected - 1) for n in (1024, 2048)]
    assert errors[1] < 1e-6
    assert errors[1] < errors[0] / 3


@pytest.mark.slow
@pytest.mark.parametrize("solve", [gj.shooting, gj.harmonic_balance])
def test_implicit_gradients(scene_of_one_pair, solve):
    """Of the alternating part with respect to torque and stiffness ratio: reverse, forward and central differences."""
    base, period = turning(clearance(scene_of_one_pair), 0.6)
    steps = {"steps": 128} if solve is gj.shooting else {"harmonics": 8}

    def measure(numbers):
        scene = dataclasses.replace(base, compliance=gj.HarmonicStiffness(STIFFNESS * numbers[1], [0.2], [0.0]))
        return solve(scene, TORQUE * numbers[0], period, **steps).std / FORCE

    at = jnp.array([1.0, 1.02])
    forward, reverse = jax.jacfwd(measure)(at), jax.jacrev(measure)(at)
    step = 1e-5
    central = jnp.stack([(measure(at + step * e) - measure(at - step * e)) / (2 * step) for e in jnp.eye(2)])
    np.testing.assert_allclose(forward, reverse, rtol=1e-7)
    np.testing.assert_allclose(forward, central, rtol=1e-5)


def test_refusals(scene_of_one_pair):
    scene, period = turning(clearance(scene_of_one_pair), 0.85)
    moving = scene, TORQUE, period
    with pytest.raises(gj.SceneError, match="multiple of 8"):
        gj.shooting(clearance(scene_of_one_pair), TORQUE, 0.01, steps=100)
    with pytest.raises(gj.SceneError, match="samples"):
        gj.harmonic_balance(clearance(scene_of_one_pair), TORQUE, 0.01, harmonics=8, samples=10)
    with pytest.raises(gj.ParameterError, match=r"guess = \(0,\): is a shape: give the transmission error over"):
        gj.harmonic_balance(*moving, harmonics=8, guess=np.zeros(0))
    with pytest.raises(gj.SceneError, match="inertia"):
        gj.shooting(dataclasses.replace(scene_of_one_pair, inertia=None), TORQUE, 0.01)


@pytest.mark.slow
def test_an_output_that_rests_without_load_is_periodic(scene):
    """Any place in the clearance is a place of rest, so that the return map has no isolated solution there."""
    own = dataclasses.replace(scene, errors={}, reference=None, backlash=gj.InitialBacklash(20e-6))
    period = 2 * np.pi / float(own.system.input_speed * own.system.orders["mesh"])
    found = gj.periodic_motion(own, 0.0, period, steps=64), gj.harmonic_balance(own, 0.0, period, harmonics=3)
    for motion in found:
        assert int(motion.result) == 0
        assert float(motion.residual) == 0.0
        assert not np.any(motion.te)
    assert found[0].periods == 1
