"""Dynamics against exact solutions, conservation, convergence orders, and published figures."""

import dataclasses

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.choice import suitable_step
from gearjax.analysis.equation import Equation
from gearjax.reproduce import two_kv
from gearjax.units import arcmin

RADIUS = float(two_kv.scene().system.radius)
MASS, STIFFNESS, TORQUE = 3.0, 9.245e7, 300.0


@pytest.fixture
def still(scene) -> gj.Scene:
    """Perfect bodies and constant stiffness."""
    return dataclasses.replace(scene, errors={}, compliance=gj.HarmonicStiffness(STIFFNESS, [], []))


@pytest.fixture
def oscillator(scene) -> gj.Scene:
    """One pair that never opens, excited by one eccentricity: a linear oscillator."""
    return dataclasses.replace(
        scene,
        system=dataclasses.replace(scene.system, planets=1),
        errors={"planet_1": gj.Eccentricity("planet_1", SIZE, PHASE)},
        reference=None,
        backlash=None,
        compliance=gj.HarmonicStiffness(STIFFNESS, [], []),
        damping=None,
    )


SIZE, PHASE, ALPHA = 100e-6, 1.0, np.radians(35.266)
SLOW = 2 * np.pi * 26 / 15.8  # rad/s


def exact(ts, ratio=0.0, stiffness=STIFFNESS, torque=TORQUE):
    """``m x'' + c x' + k x = k e + c e' - T / r`` from rest at zero, e = SIZE sin(SLOW t + PHASE - ALPHA) [rad]."""
    damping = ratio * np.sqrt(2 * stiffness * MASS)
    rise = SIZE * np.exp(1j * (PHASE - ALPHA))
    forced = rise * (stiffness + 1j * damping * SLOW) / (stiffness - MASS * SLOW**2 + 1j * damping * SLOW)
    still = -torque / RADIUS / stiffness
    start, speed = forced.imag + still, (1j * SLOW * forced).imag
    decay = damping / (2 * MASS)
    swing = np.sqrt(stiffness / MASS - decay**2)
    own = -start * np.cos(swing * ts) - (speed + decay * start) / swing * np.sin(swing * ts)
    return ((forced * np.exp(1j * SLOW * ts)).imag + still + np.exp(-decay * ts) * own) / RADIUS


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.4])
def test_linear_oscillator(oscillator, ratio):
    ts = jnp.linspace(0.0, 0.05, 201)
    damped = oscillator if ratio == 0 else dataclasses.replace(oscillator, damping=gj.DampingRatio(ratio))
    motion = gj.simulate(damped, ts, TORQUE, start="zero", stepper=gj.FixedStep(1e-6, solver=gj.RungeKutta4()))
    assert float(motion.forces.min()) > 100.0, "the pair stays closed"
    np.testing.assert_allclose(motion.te, exact(np.asarray(ts), ratio), rtol=0, atol=2e-12)


@pytest.mark.slow
def test_a_jammed_pair_has_two_springs_and_one_damper(oscillator):
    """Both flanks closed: ``m x'' + c x' + 2 k x = k (e + u) + c e' - T / r``, u the edge of the back flank."""
    jammed = dataclasses.replace(
        oscillator,
        errors={"planet_1": gj.Eccentricity("planet_1", SIZE, np.pi)},
        backlash=gj.InitialBacklash(0.0),
        damping=gj.DampingRatio(0.2),
    )
    ts = jnp.linspace(0.0, 0.02, 201)
    motion = gj.simulate(jammed, ts, 50.0, start="zero", stepper=gj.FixedStep(1e-6, solver=gj.RungeKutta4()))
    assert float(motion.forces.min()) > 100.0, "both flanks stay closed"
    damping, time = 0.2 * np.sqrt(2 * STIFFNESS * MASS), np.asarray(ts)
    rise, edge = (SIZE * np.exp(1j * (np.pi + sign * ALPHA)) for sign in (-1, 1))
    forced = (STIFFNESS * (rise + edge) + 1j * damping * SLOW * rise) / (
        2 * STIFFNESS - MASS * SLOW**2 + 1j * damping * SLOW
    )
    still, decay = -50.0 / RADIUS / (2 * STIFFNESS), damping / (2 * MASS)
    swing = np.sqrt(2 * STIFFNESS / MASS - decay**2)
    start, speed = forced.imag + still, (1j * SLOW * forced).imag
    own = -start * np.cos(swing * time) - (speed + decay * start) / swing * np.sin(swing * time)
    expected = ((forced * np.exp(1j * SLOW * time)).imag + still + np.exp(-decay * time) * own) / RADIUS
    np.testing.assert_allclose(motion.te, expected, rtol=0, atol=2e-12)


@pytest.mark.slow
def test_gradients_of_the_linear_oscillator(oscillator):
    """d x / d T and d x / d k at a time, against the exact solution."""
    ts = jnp.linspace(0.0, 0.002, 21)

    def last(torque, stiffness):
        scene = dataclasses.replace(oscillator, compliance=gj.HarmonicStiffness(stiffness, [], []))
        return gj.simulate(scene, ts, torque, start="zero", stepper=gj.FixedStep(5e-7)).te[-1]

    torque, stiffness = jnp.asarray(TORQUE), jnp.asarray(STIFFNESS)
    by_torque = exact(0.002, torque=TORQUE + 1) - exact(0.002)  # linear in the torque
    step = 1e-5 * STIFFNESS
    by_stiffness = (exact(0.002, stiffness=STIFFNESS + step) - exact(0.002, stiffness=STIFFNESS - step)) / (2 * step)
    for derivative in (jax.grad, jax.jacfwd):
        assert float(derivative(last, 0)(torque, stiffness)) == pytest.approx(by_torque, rel=1e-9)
        assert float(derivative(last, 1)(torque, stiffness)) == pytest.approx(by_stiffness, rel=1e-7)


@pytest.mark.slow
def test_fourth_order(oscillator):
    ts = jnp.linspace(0.0, 0.01, 11)
    errors = []
    for steps in (12, 24, 48):
        motion = gj.simulate(
            oscillator, ts, TORQUE, start="zero", stepper=gj.FixedStep(per_sample=steps, solver=gj.RungeKutta4())
        )
        errors.append(float(abs(motion.te - exact(np.asarray(ts))).max()))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.1)


@pytest.mark.slow
def test_other_diffrax_solvers_step_too(oscillator):
    ts = jnp.linspace(0.0, 0.01, 11)
    for solver in (diffrax.Tsit5(), diffrax.Dopri8()):
        motion = gj.simulate(oscillator, ts, TORQUE, start="zero", stepper=gj.FixedStep(1e-5, solver=solver))
        np.testing.assert_allclose(motion.te, exact(np.asarray(ts)), rtol=0, atol=1e-11)


@pytest.mark.slow
def test_energy_is_conserved_without_damping(still):
    """From rest at the touching point: two springs that open and close once per swing."""
    undamped = dataclasses.replace(still, damping=None)

    def drift(step):
        motion = gj.simulate(undamped, jnp.linspace(0.0, 0.5, 501), TORQUE, start="zero", stepper=gj.FixedStep(step))
        x, v = np.asarray(motion.te) * RADIUS, np.asarray(motion.velocity) * RADIUS
        energy = 0.5 * MASS * v**2 + STIFFNESS * np.minimum(x, 0) ** 2 + TORQUE / RADIUS * x
        return np.ptp(energy) / ((TORQUE / RADIUS) ** 2 / (2 * STIFFNESS))

    assert drift(5e-6) < 1e-5
    assert drift(5e-6) < drift(2e-5) / 4  # the kink of the contact lowers the order to two


@pytest.mark.slow
def test_free_flight_through_the_backlash(still):
    """Perfect bodies, torque reversed: constant acceleration until the back flanks close."""
    ts = jnp.linspace(0.0, 0.0004, 41)
    motion = gj.simulate(still, ts, -TORQUE, start="zero", stepper=gj.FixedStep(1e-6))
    flight = 0.5 * TORQUE / RADIUS / MASS * np.asarray(ts) ** 2
    free = flight < 150e-6
    assert free.sum() > 20
    np.testing.assert_allclose(np.asarray(motion.te)[free] * RADIUS, flight[free], rtol=1e-9, atol=1e-15)


@pytest.mark.slow
def test_equilibrium_is_where_it_comes_to_rest(still):
    """With constant gaps the motion settles on the static equilibrium; started there it stays."""
    ts = jnp.linspace(0.0, 0.2, 101)
    static = gj.transmission_error(still, jnp.zeros(1), 100.0).te[0]
    settled = gj.simulate(still, ts, 100.0, start="zero")
    assert float(settled.te[-1]) == pytest.approx(float(static), rel=1e-9)
    started = gj.simulate(still, ts, 100.0)
    np.testing.assert_allclose(started.te, static, rtol=1e-12)


@pytest.mark.slow
def test_start_from_equilibrium_has_no_transient(scene):
    ts = jnp.linspace(0.0, 0.02, 2001)
    static = gj.transmission_error(scene, scene.system.input_speed * ts, 100.0)
    smooth = gj.simulate(scene, ts, 100.0)
    rough = gj.simulate(scene, ts, 100.0, start="zero")
    assert float(abs(smooth.te - static.te).max()) < 0.25 * arcmin  # the stiffness varies by 13 %
    assert float(abs(rough.te - static.te).max()) > 0.5 * arcmin


@pytest.mark.slow
def test_fixed_steps_agree_with_the_adaptive_yardstick(scene):
    ts = jnp.linspace(0.0, 0.3, 301)
    for torque in (3.0, 30.0, 300.0):
        fixed = gj.simulate(scene, ts, torque)
        adaptive = gj.simulate(scene, ts, torque, stepper=gj.AdaptiveStep())
        assert float(abs(fixed.te - adaptive.te).max()) / arcmin < 2e-4


@pytest.mark.slow
def test_settle_is_left_out(scene):
    ts = jnp.linspace(0.0, 0.3, 301)
    rough = gj.simulate(scene, ts, 300.0, start="zero")
    settled = gj.simulate(scene, ts, 300.0, start="zero", settle=0.05)
    assert int(settled.settled.sum()) == 251
    assert float(settled.mean) == pytest.approx(float(rough.te[50:].mean()), rel=1e-12)
    assert float(settled.std) == pytest.approx(float(rough.te[50:].std()), rel=1e-9)
    assert float(rough.peak_to_peak) > 1.3 * float(settled.peak_to_peak)


@pytest.mark.slow
def test_settle_may_leave_a_single_sample(scene):
    ts = jnp.linspace(0.0, 0.1, 11)
    motion = gj.simulate(scene, ts, 100.0, settle=0.095)
    assert float(motion.amplitude) == pytest.approx(abs(float(motion.te[-1])), rel=1e-12)
    assert float(motion.peak_to_peak) == 0.0
    assert float(motion.mean) == pytest.approx(float(motion.te[-1]), rel=1e-12)


@pytest.mark.slow
def test_fast_harmonics_and_strong_damping_need_short_steps(scene):
    ts = jnp.linspace(0.0, 0.02, 21)
    fast = dataclasses.replace(
        scene, compliance=gj.HarmonicStiffness(STIFFNESS, [0.1] + [0.0] * 58 + [0.5], [0.0] * 60)
    )
    damped = dataclasses.replace(scene, damping=gj.DampingRatio(20.0))
    alternating = dataclasses.replace(scene, load=gj.SinusoidalLoad(1e5))
    for changed in (fast, damped, alternating):
        with pytest.raises(gj.SceneError, match=r"too long for the fastest motion.*FixedStep"):
            gj.simulate(changed, ts, 100.0, stepper=gj.FixedStep(4e-5))
    for changed in (fast, damped):
        step = suitable_step(changed, 0.02)
        found = gj.simulate(changed, ts, 100.0, stepper=step)
        finer = gj.simulate(changed, ts, 100.0, stepper=gj.FixedStep(step.step / 4))
        assert float(abs(found.te - finer.te).max()) / arcmin < 5e-3


@pytest.mark.slow
def test_long_intervals_between_samples_are_cut(scene):
    """A thousand steps between two samples: the same motion as with samples in between."""
    few = gj.simulate(scene, jnp.linspace(0.0, 0.08, 3), 100.0, stepper=gj.FixedStep(per_sample=1024))
    many = gj.simulate(scene, jnp.linspace(0.0, 0.08, 9), 100.0, stepper=gj.FixedStep(per_sample=256))
    np.testing.assert_allclose(few.te, many.te[::4], rtol=1e-12)
    assert float(few.peak_to_peak) == pytest.approx(float(many.peak_to_peak), rel=1e-12)


@pytest.mark.slow
def test_extremes_between_samples(scene):
    """Samples 1 ms apart miss the vibration at 1.5 kHz; the metrics do not."""
    coarse = gj.simulate(scene, jnp.linspace(0.0, 0.1, 11), 300.0, start="zero", stepper=gj.FixedStep(5e-6))
    fine = gj.simulate(scene, jnp.linspace(0.0, 0.1, 20001), 300.0, start="zero", stepper=gj.FixedStep(5e-6))
    assert float(coarse.peak_to_peak) == pytest.approx(float(fine.peak_to_peak), rel=1e-9)
    assert float(coarse.peak_to_peak) == pytest.approx(float(np.ptp(np.asarray(fine.te))), rel=1e-4)
    assert float(np.ptp(np.asarray(coarse.te))) < 0.95 * float(coarse.peak_to_peak)


@pytest.mark.slow
def test_stiffness_harmonics_of_any_length(scene):
    """Each harmonic shows at its multiple of the mesh frequency under a load that keeps both pairs closed."""
    rich = gj.HarmonicStiffness(STIFFNESS, [0.08, 0.0, 0.04], [0.3, 0.0, 1.0])
    even = dataclasses.replace(scene, errors={}, compliance=rich)
    mesh = float(scene.system.input_speed) * scene.system.orders["mesh"] / (2 * np.pi)
    ts = jnp.arange(4096.0) * (20 / mesh / 4096)
    motion = gj.simulate(even, ts, 3000.0)
    late = np.asarray(motion.te)[2048:]
    lines = np.abs(np.fft.rfft(late - late.mean())) * 2 / 2048
    assert lines[10] > 20 * lines[15]
    assert lines[30] > 3 * lines[20]


@pytest.mark.slow
def test_sinusoidal_loads(scene):
    """At the crank frequency the output runs from the driving to the back flanks and over, fig. 7a."""
    alternating = dataclasses.replace(scene, load=gj.SinusoidalLoad("crank"))
    ts = jnp.linspace(0.0, 1.3, 2601)
    motion = gj.simulate(alternating, ts, 30.0)
    play = gj.backlash(scene, scene.system.input_speed * ts)
    slack = 30.0 / (STIFFNESS * RADIUS**2)
    assert float((play.lower - motion.te).max()) < 1.5 * slack
    assert float(motion.te.max() - motion.te.min()) > 0.9 * float(play.backlash.min())
    crank = float(scene.system.input_speed) * scene.system.orders["crank"] / (2 * np.pi)
    same = dataclasses.replace(scene, load=gj.SinusoidalLoad(crank))
    np.testing.assert_allclose(gj.simulate(same, ts[:200], 30.0).te, motion.te[:200], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_times_come_from_the_step_number(scene):
    """In float32 the mesh phase after 3 s is that of float64: a sum of steps would be 0.4 rad off."""
    ts = np.linspace(2.9, 3.0, 101)
    double = gj.simulate(scene, jnp.asarray(ts), 300.0, settle=0.03)
    single_scene = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    single = gj.simulate(single_scene, jnp.asarray(ts, jnp.float32), jnp.float32(300.0), settle=jnp.float32(0.03))
    assert single.te.dtype == jnp.float32
    assert np.abs(np.asarray(single.te) - np.asarray(double.te))[30:].max() / arcmin < 2e-3


@pytest.mark.parametrize(("slot", "name"), [("inertia", "inertia"), ("load", "load"), ("compliance", "compliance")])
def test_a_missing_part_is_named(scene, slot, name):
    bare = dataclasses.replace(scene, **{slot: None})
    with pytest.raises(gj.SceneError, match=rf'"dynamic" needs \[{name}\], which this scene does not list'):
        gj.simulate(bare, jnp.linspace(0.0, 0.1, 11), 30.0)


@pytest.mark.slow
def test_refusals(scene):
    ts = jnp.linspace(0.0, 0.01, 11)
    with pytest.raises(gj.SceneError, match="start = "):
        gj.simulate(scene, ts, 30.0, start="anywhere")
    with pytest.raises(gj.SceneError, match="must increase"):
        gj.simulate(scene, ts[::-1], 30.0)
    with pytest.raises(gj.SceneError, match="at least two sample times"):
        gj.simulate(scene, ts[:1], 30.0)
    with pytest.raises(gj.SceneError, match="settle = 5 s"):
        gj.simulate(scene, ts, 30.0, settle=5.0)
    with pytest.raises(gj.SceneError, match=r"too long for the fastest motion .*: it must be at most"):
        gj.simulate(scene, ts, 30.0, stepper=gj.FixedStep(1e-3))
    with pytest.raises(gj.SceneError, match="step = -1 s"):
        gj.FixedStep(-1.0)
    with pytest.raises(gj.SceneError, match="per_sample = 0"):
        gj.FixedStep(per_sample=0)
    with pytest.raises(gj.SceneError, match="there is no equilibrium to start from"):
        gj.simulate(dataclasses.replace(scene, backlash=None), ts, -30.0)


@pytest.mark.slow
def test_faults_are_codes_in_batches(scene):
    """A batch does not raise: the sample with a step too long for it is marked, the others are right."""
    ts = jnp.linspace(0.0, 0.01, 11)

    def run(mass):
        light = dataclasses.replace(scene, inertia=gj.EquivalentMass(mass))
        motion = gj.simulate(light, ts, 30.0, stepper=gj.FixedStep(4e-5))
        return motion.result, motion.te

    codes, te = jax.vmap(run)(jnp.array([3.0, 1e-3, 10.0]))
    assert codes.tolist() == [0, 2, 0]
    np.testing.assert_allclose(te[2], jax.jit(run)(jnp.asarray(10.0))[1], rtol=1e-12)


def test_natural_frequency(scene):
    expected = np.sqrt(2 * STIFFNESS * 1.13 / MASS)
    assert float(Equation.of(scene, jnp.zeros(())).frequency) == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [1e-2, 1.0, 1e4])
@pytest.mark.parametrize("torque", [1e-3, 1e5])
def test_extremes_stay_finite(scene, mass, torque):
    heavy = dataclasses.replace(scene, inertia=gj.EquivalentMass(mass))
    step = 0.3 / float(Equation.of(heavy, jnp.zeros(())).frequency)
    motion = gj.simulate(heavy, jnp.linspace(0.0, 0.02, 21), torque, stepper=gj.FixedStep(step))
    assert bool(jnp.isfinite(motion.te).all())
