"""Dynamics at the extremes: each with what is expected, never nan, never a silent wrong number."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.choice import suitable_step
from gearjax.units import arcmin
from tests.test_dynamics import MASS, RADIUS, STIFFNESS, still

__all__ = ["still"]
TS = jnp.linspace(0.0, 0.05, 51)


def finite(motion) -> bool:
    return bool(jnp.isfinite(motion.te).all() & jnp.isfinite(motion.forces).all() & jnp.isfinite(motion.velocity).all())


@pytest.mark.slow
def test_zero_torque_rests_on_the_first_contact(still):
    motion = gj.simulate(still, TS, 0.0)
    np.testing.assert_allclose(motion.te, 0.0, atol=1e-15)
    assert finite(motion)


@pytest.mark.parametrize("torque", [1e-6, 1e6])
def test_tiny_and_huge_torques_settle_on_the_static_deflection(still, torque):
    """Heavily damped, so that it settles within the record; a huge torque closes both pairs."""
    damped = dataclasses.replace(still, damping=gj.DampingRatio(1.0))
    motion = gj.simulate(damped, TS, torque, start="zero")
    expected = -torque / (2 * STIFFNESS * RADIUS**2)
    assert float(motion.te[-1]) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.0, 1 / np.sqrt(2), 10 / np.sqrt(2)])
def test_undamped_critical_and_overdamped(still, ratio):
    """Two pairs and two dampers: 1/sqrt(2) each is critical. Against the exact solution from rest at zero."""
    damped = dataclasses.replace(still, damping=None if ratio == 0 else gj.DampingRatio(ratio))
    step = suitable_step(damped, 0.01).step
    motion = gj.simulate(damped, jnp.linspace(0.0, 0.01, 101), 300.0, start="zero", stepper=gj.FixedStep(step / 8))
    assert finite(motion)
    swing, decay = np.sqrt(2 * STIFFNESS / MASS), ratio * np.sqrt(2 * STIFFNESS / MASS)
    time = np.asarray(motion.ts)
    root = np.sqrt(swing**2 - decay**2 + 0j) + 1e-9
    own = np.exp(-decay * time) * (np.cos(root * time) + decay / root * np.sin(root * time))
    rest = -300.0 / RADIUS / (2 * STIFFNESS)
    np.testing.assert_allclose(motion.te * RADIUS, rest * (1 - own.real), rtol=0, atol=2e-3 * abs(rest))


@pytest.mark.slow
def test_overdamped_by_an_implicit_solver_of_diffrax(still):
    """For scenes whose damping is far faster than what one wants to see."""
    import diffrax

    damped = dataclasses.replace(still, damping=gj.DampingRatio(20.0))
    implicit = gj.AdaptiveStep(1e-7, 1e-7, solver=diffrax.Kvaerno5())
    slow = gj.simulate(damped, TS, 300.0, start="zero", stepper=implicit)
    exact = gj.simulate(damped, TS, 300.0, start="zero")
    np.testing.assert_allclose(slow.te, exact.te, rtol=0, atol=1e-4 * float(abs(exact.te).max()))


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "mass"), [(1e3, 1e-3), (1e3, 1e3), (1e12, 1e3), (1e12, 1e-3)])
def test_soft_stiff_light_and_heavy(still, stiffness, mass):
    """The deflection scales with 1 / k, the time with sqrt(m / k): the same motion in scaled numbers."""
    other = dataclasses.replace(
        still, compliance=gj.HarmonicStiffness(stiffness, [], []), inertia=gj.EquivalentMass(mass), backlash=None
    )
    stopped = dataclasses.replace(still.system, input_speed=1e-9)
    base = dataclasses.replace(still, system=stopped, compliance=gj.HarmonicStiffness(STIFFNESS, [], []), backlash=None)
    other = dataclasses.replace(other, system=stopped)
    time = np.sqrt(mass / stiffness) / np.sqrt(MASS / STIFFNESS)
    steps = gj.FixedStep(per_sample=32)
    one = gj.simulate(base, TS[:11], 100.0, start="zero", stepper=steps)
    two = gj.simulate(other, TS[:11] * time, 100.0, start="zero", stepper=steps)
    np.testing.assert_allclose(two.te * stiffness, one.te * STIFFNESS, rtol=1e-6, atol=1e-8 * 100.0 / RADIUS**2)


@pytest.mark.slow
def test_no_backlash_negative_and_infinite(scene):
    """Zero: the flanks touch on both sides. Negative, by eccentric bodies: both flanks loaded at once. Infinite: as if
    there were no back flanks."""
    tight = dataclasses.replace(scene, backlash=gj.InitialBacklash(0.0))
    cycle = np.linspace(0.0, 15.8, 1581)
    worst = cycle[int(np.argmin(gj.backlash(tight, scene.system.input_speed * jnp.asarray(cycle)).backlash))]
    jammed = gj.simulate(tight, TS + worst, 30.0)
    assert finite(jammed)
    forces = np.asarray(jammed.forces)
    assert (forces[:, :2].sum(axis=1) > 0).all()
    assert (forces[:, 2:].sum(axis=1) > 0).all(), "flanks of both sides at once"
    assert finite(gj.simulate(tight, TS, 30.0))
    far = gj.simulate(dataclasses.replace(scene, backlash=gj.InitialBacklash(1.0)), TS, 30.0)
    without = gj.simulate(dataclasses.replace(scene, backlash=None), TS, 30.0)
    np.testing.assert_allclose(far.te, without.te, rtol=0, atol=1e-12)
    assert not np.asarray(far.forces[:, 2:]).any()


@pytest.mark.slow
@pytest.mark.parametrize("order", ["crank", "mesh"])
def test_torque_reversal(scene, order):
    """Between the lower and the upper edge of the backlash, and impacts; finite, and the load reverses."""
    alternating = dataclasses.replace(scene, load=gj.SinusoidalLoad(order))
    ts = jnp.linspace(0.0, 0.7, 701)
    motion = gj.simulate(alternating, ts, 30.0)
    assert finite(motion)
    play = gj.backlash(scene, scene.system.input_speed * ts)
    assert float(motion.te.max() - motion.te.min()) > 0.8 * float(play.backlash.min())


@pytest.mark.parametrize(
    "width", [1e-12, *(pytest.param(width, marks=pytest.mark.slow) for width in (1e-9, 1e-6, 1e-3))]
)
def test_smoothing_from_nothing_to_a_millimetre(scene, with_contact, width):
    hard = gj.simulate(scene, TS, 100.0)
    soft = gj.simulate(with_contact(scene, gj.QuadraticContact(width)), TS, 100.0)
    assert finite(soft)
    if width <= 1e-9:
        assert float(abs(soft.te - hard.te).max()) / arcmin < 1e-3


@pytest.mark.slow
def test_float32_over_a_full_cycle(scene):
    """15.8 s: metrics within 1e-3 arcmin of float64."""
    ts = np.linspace(0.0, 15.8, 3161)
    double = gj.simulate(scene, jnp.asarray(ts), 100.0, settle=0.05)
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    other = gj.simulate(single, jnp.asarray(ts, jnp.float32), jnp.float32(100.0), settle=jnp.float32(0.05))
    assert other.te.dtype == jnp.float32
    for name in ("peak_to_peak", "amplitude", "mean", "std"):
        assert float(getattr(other, name)) / arcmin == pytest.approx(float(getattr(double, name)) / arcmin, abs=1e-3)


@pytest.mark.slow
def test_a_thousand_turns_of_the_output_later(still):
    """The mesh phase at step n is that of time n h: 1,000 output turns on, the motion is that of the first turn."""
    waved = dataclasses.replace(still, compliance=gj.HarmonicStiffness(STIFFNESS, [0.13], [0.4]))
    speed = float(waved.system.input_speed)
    period = 2 * np.pi / (speed * waved.system.orders["mesh"])
    turns = round(1000 / waved.system.orders["output"] * waved.system.orders["mesh"]) * period
    assert turns * speed * waved.system.orders["output"] / (2 * np.pi) == pytest.approx(1000, rel=1e-6)
    first = gj.simulate(waved, TS, 100.0, settle=0.03)
    later = gj.simulate(waved, TS + turns, 100.0, settle=0.03)
    # the phase error of 1e-9 turns that is allowed would show as 1e-9 of the swing
    swing = float(first.te.max() - first.te.min())
    np.testing.assert_allclose(later.te, first.te, rtol=0, atol=2 * np.pi * 1e-9 * swing + 1e-9 * swing)


@pytest.mark.slow
def test_far_from_equilibrium(scene):
    """From the ideal position under a load that wants it 30 times the usual deflection away."""
    motion = gj.simulate(scene, jnp.linspace(0.0, 0.1, 101), 1e4, start="zero")
    assert finite(motion)
    equilibrium = gj.simulate(scene, jnp.linspace(0.0, 0.1, 101), 1e4)
    assert float(abs(motion.te[-1] - equilibrium.te[-1])) < 1e-3 * float(abs(motion.te).max())


@pytest.mark.slow
def test_a_gradient_at_a_change_of_contact(still):
    """At the touching point the derivative is one of the two one-sided ones, or between them."""

    def last(torque):
        return gj.simulate(still, TS[:6], torque, start="zero", stepper=gj.FixedStep(2e-5)).te[-1]

    slope = float(jax.grad(last)(jnp.asarray(0.0)))
    step = 1e-6
    left, right = (float(last(sign * step) - last(0.0)) / (sign * step) for sign in (-1, 1))
    low, high = sorted((left, right))
    assert low * (1 - 1e-3 * np.sign(low)) - 1e-12 <= slope <= high * (1 + 1e-3 * np.sign(high)) + 1e-12


@pytest.mark.slow
def test_one_bad_scene_in_a_thousand(scene):
    """Its code says so, the others are untouched."""
    ts = jnp.linspace(0.0, 0.004, 5)
    masses = jnp.full((1000,), MASS).at[417].set(1e-9)

    def run(mass):
        light = dataclasses.replace(scene, inertia=gj.EquivalentMass(mass))
        motion = gj.simulate(light, ts, 30.0, stepper=gj.FixedStep(per_sample=25))
        return motion.result, motion.te

    codes, te = jax.jit(jax.vmap(run))(masses)
    assert np.flatnonzero(np.asarray(codes)).tolist() == [417]
    np.testing.assert_allclose(np.delete(np.asarray(te), 417, axis=0), np.broadcast_to(te[0], (999, 5)), rtol=1e-12)


@pytest.mark.slow
def test_quasi_static_is_close_where_everything_is_slow(scene):
    """Ten times slower: the followed position, and closer with the first correction for inertia and damping."""
    slow = dataclasses.replace(
        scene, system=dataclasses.replace(scene.system, input_speed=0.1 * scene.system.input_speed)
    )
    ts = jnp.linspace(0.0, 0.5, 501)
    truth = gj.simulate(slow, ts, 300.0)
    plain, corrected = (gj.simulate(slow, ts, 300.0, stepper=gj.QuasiStatic(inertia)) for inertia in (False, True))
    off = [float(jnp.sqrt(((motion.te - truth.te)[50:] ** 2).mean())) / arcmin for motion in (plain, corrected)]
    assert off[0] < 0.02
    assert off[1] < 0.5 * off[0]
