"""The exponentially fitted steps: exact between changes of contact, second order, windows, gradients, refusals."""

import dataclasses

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis import chebyshev
from gearjax.analysis.equation import Equation, turning_rate
from gearjax.analysis.fast import march
from gearjax.analysis.fast.fitted import ExponentialFit, OscillatorTerm, State
from gearjax.analysis.fast.oscillator import Oscillator
from gearjax.analysis.fast.signals import Forcing, at_nodes
from gearjax.units import arcmin
from tests.test_dynamics import ALPHA, MASS, PHASE, RADIUS, SIZE, STIFFNESS, TORQUE, exact, oscillator, still

__all__ = ["oscillator", "still"]
RK4 = gj.RungeKutta4()
PUSHED = SIZE * np.sin(PHASE - ALPHA)


def resting(scene, ratio):
    """One pair that never opens, in a reducer that hardly turns: a constant push."""
    damping = None if ratio == 0 else gj.DampingRatio(ratio)
    return dataclasses.replace(scene, system=dataclasses.replace(scene.system, input_speed=1e-9), damping=damping)


@pytest.mark.parametrize("ratio", [0.0, 0.1, 2**0.5, 3.0])
@pytest.mark.parametrize("per_sample", [1, 3])
def test_exact_for_a_linear_oscillator_at_any_step(oscillator, ratio, per_sample):
    """Long steps: position and velocity to rounding, undamped to overdamped (critical at sqrt 2)."""
    ts = jnp.arange(101.0) * (0.2 * per_sample / np.sqrt(STIFFNESS / MASS))
    step = gj.FixedStep(per_sample=per_sample)
    motion = gj.simulate(resting(oscillator, ratio), ts, TORQUE, start="zero", stepper=step)
    rest = PUSHED - TORQUE / RADIUS / STIFFNESS
    decay = 0.5 * ratio * np.sqrt(2 * STIFFNESS / MASS) + 0j
    swing = np.sqrt(STIFFNESS / MASS - decay**2 + 1e-6j)
    time = np.asarray(ts)
    own = np.exp(-decay * time) * (np.cos(swing * time) + decay / swing * np.sin(swing * time))
    np.testing.assert_allclose(motion.te * RADIUS, rest * (1 - own.real), rtol=0, atol=1e-9 * abs(rest))
    rate = STIFFNESS / MASS / swing * np.exp(-decay * time) * np.sin(swing * time)
    np.testing.assert_allclose(
        motion.velocity * RADIUS, rest * rate.real, rtol=0, atol=1e-8 * abs(rest) * np.sqrt(STIFFNESS / MASS)
    )


@pytest.mark.slow
def test_second_order(oscillator):
    """Where the gaps move, in position and in velocity."""
    damped = dataclasses.replace(oscillator, damping=gj.DampingRatio(0.1))
    ts = jnp.linspace(0.0, 0.02, 11)
    truth = gj.simulate(damped, ts, TORQUE, start="zero", stepper=gj.FixedStep(2e-6, solver=RK4))
    np.testing.assert_allclose(truth.te, exact(np.asarray(ts), 0.1), rtol=0, atol=1e-12)
    errors = []
    for steps in (12, 24, 48):
        motion = gj.simulate(damped, ts, TORQUE, start="zero", stepper=gj.FixedStep(per_sample=steps))
        errors.append([float(abs(getattr(motion, n) - getattr(truth, n)).max()) for n in ("te", "velocity")])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders[:, 0], 2.0, atol=0.15)
    assert (orders[:, 1] > 1.8).all()


@pytest.mark.slow
@pytest.mark.parametrize("torque", [30.0, 300.0])
def test_one_contact_that_opens_and_closes(scene, torque):
    """The whole reducer: contacts open and close, and the error still falls with the step."""
    ts = jnp.linspace(0.0, 0.2, 201)
    truth = gj.simulate(scene, ts, torque, stepper=gj.FixedStep(per_sample=512, solver=RK4))
    errors = []
    for steps in (10, 40, 160):
        motion = gj.simulate(scene, ts, torque, stepper=gj.FixedStep(per_sample=steps))
        errors.append(float(abs(motion.te - truth.te).max()) / arcmin)
    assert errors[0] < 2e-3
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < 1e-4
    np.testing.assert_allclose(motion.forces, truth.forces, rtol=0, atol=2.0)
    assert float(motion.peak_to_peak) == pytest.approx(float(truth.peak_to_peak), rel=1e-4)
    assert float(abs(motion.velocity - truth.velocity).max()) < 2e-3 * float(abs(truth.velocity).max())


@pytest.mark.slow
def test_smooth_laws(scene, with_contact):
    ts = jnp.linspace(0.0, 0.05, 51)
    for law in (gj.SoftplusContact(5e-7), gj.QuadraticContact(5e-7)):
        soft = with_contact(scene, law)
        fitted = gj.simulate(soft, ts, 100.0, stepper=gj.FixedStep(per_sample=64))
        other = gj.simulate(soft, ts, 100.0, stepper=gj.FixedStep(per_sample=64, solver=RK4))
        assert float(abs(fitted.te - other.te).max()) / arcmin < 2e-4


@pytest.mark.slow
def test_the_scheme_as_a_solver_of_diffrax(oscillator):
    """diffeqsolve with even steps and all steps saved gives the same as the scan."""
    ts = jnp.linspace(0.0, 0.002, 41)
    stiff = STIFFNESS / MASS
    pull = stiff * PUSHED - TORQUE / RADIUS / MASS
    step = float(ts[1])

    def state(_, position, args):
        assert args is None
        zero = jnp.zeros(())
        return State(step**2 * (pull - stiff * position), jnp.asarray(stiff * step**2), zero, zero + 1.0)

    solution = diffrax.diffeqsolve(
        OscillatorTerm(state), ExponentialFit(), 0.0, 40.0, 1.0, jnp.zeros(2), saveat=diffrax.SaveAt(steps=True)
    )
    motion = gj.simulate(resting(oscillator, 0), ts, TORQUE, start="zero", stepper=gj.FixedStep(per_sample=1))
    assert solution.ys is not None
    np.testing.assert_allclose(solution.ys[:40, 0], motion.te[1:] * RADIUS, rtol=0, atol=1e-14)
    np.testing.assert_allclose(solution.ys[:40, 1] / step, motion.velocity[1:] * RADIUS, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
def test_windows_agree_with_one_go(scene):
    ts = jnp.linspace(0.0, 1.0, 1001)
    whole = gj.simulate(scene, ts, 100.0, stepper=gj.FixedStep(per_sample=16))
    cut = gj.simulate(scene, ts, 100.0, stepper=gj.FixedStep(per_sample=16, windows=gj.Windows(7, 0.06)))
    assert 0 < float(cut.defect) < 1e-10
    for name in ("te", "velocity", "forces", "highest", "lowest"):
        one, other = getattr(whole, name), getattr(cut, name)
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-6 * float(abs(one).max()))
    shorter = gj.simulate(scene, ts, 100.0, stepper=gj.FixedStep(per_sample=16, windows=gj.Windows(7, 0.03)))
    assert float(shorter.defect) > 100 * float(cut.defect), "a shorter warm-up is further apart, and says so"


@pytest.mark.slow
def test_windows_that_do_not_agree_are_replaced(scene):
    light = dataclasses.replace(scene, damping=gj.DampingRatio(1e-3))
    ts = jnp.linspace(0.0, 0.5, 501)
    whole = gj.simulate(light, ts, 100.0, stepper=gj.FixedStep(per_sample=16))
    cut = gj.FixedStep(per_sample=16, windows=gj.Windows(8, 0.02))
    with pytest.warns(UserWarning, match="rad where they meet: computed again without windows"):
        motion = gj.simulate(light, ts, 100.0, stepper=cut)
    np.testing.assert_array_equal(motion.te, whole.te)
    for program, given in (
        (lambda scene: gj.simulate(scene, ts, 100.0, stepper=cut), light),
        (lambda torque: gj.simulate(light, ts, torque, stepper=cut), 100.0),  # a known scene inside a trace
    ):
        traced = jax.jit(program)(given)
        np.testing.assert_allclose(traced.te, whole.te, rtol=0, atol=1e-9 * arcmin)
        assert float(traced.defect) > 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("factor", [20, 120])
def test_fast_bodies(scene, factor):
    """Bodies that turn by up to 0.05 rad per step, alone, in a batch, and with a speed that is not known."""
    fast = dataclasses.replace(
        scene,
        system=dataclasses.replace(scene.system, input_speed=factor * scene.system.input_speed),
        compliance=gj.HarmonicStiffness(STIFFNESS, [], []),
    )
    ts = np.linspace(0.0, 0.01, 26)
    steps = gj.FixedStep(per_sample=10)
    truth = gj.simulate(fast, ts, 100.0, stepper=gj.FixedStep(per_sample=160, solver=RK4))
    alone = gj.simulate(fast, ts, 100.0, stepper=steps)
    assert float(abs(alone.te - truth.te).max()) < 2e-3 * float(abs(truth.te).max())
    batch = jax.jit(jax.vmap(lambda torque: gj.simulate(fast, ts, torque, stepper=steps)))(jnp.array([30.0, 100.0]))
    assert batch.result.tolist() == [0, 0]
    np.testing.assert_allclose(batch.te[1], alone.te, rtol=0, atol=1e-12)
    if factor == 20:
        traced = jax.jit(lambda scene: gj.simulate(scene, ts, 100.0, stepper=steps))(fast)
        assert int(traced.result) == 0
        np.testing.assert_allclose(traced.te, alone.te, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_the_default_is_the_same_inside_a_trace(scene):
    """A known scene and known times stay known there, and choose the same steps."""
    ts = np.linspace(0.0, 0.02, 21)
    expected = gj.simulate(scene, ts, 100.0)
    found = jax.jit(lambda torque: gj.simulate(scene, ts, torque))(100.0)
    np.testing.assert_allclose(found.te, expected.te, rtol=1e-12)
    np.testing.assert_allclose(found.peak_to_peak, expected.peak_to_peak, rtol=1e-12)


def test_the_default_takes_windows_where_they_pay(scene):
    from gearjax.analysis.choice import suitable_step

    windows = suitable_step(scene, 3.0).windows
    assert windows is not None
    assert windows.number % 8 == 0, "whole vectors"
    assert suitable_step(scene, 0.05).windows is None
    assert suitable_step(dataclasses.replace(scene, damping=None), 3.0).windows is None
    assert suitable_step(dataclasses.replace(scene, load=gj.SinusoidalLoad("mesh")), 3.0).windows is None


def turned(scene: gj.Scene, phase) -> gj.Scene:
    """The scene with another eccentricity of planet 2, at a phase [rad]."""
    return dataclasses.replace(scene, errors={**scene.errors, "planet_2": gj.Eccentricity("planet_2", 20e-6, phase)})


@pytest.mark.slow
@pytest.mark.parametrize("windows", [None, gj.Windows(4, 0.01)])
def test_hessians(scene, windows):
    """Forward over reverse, alone and batched, against differences of gradients."""
    ts = jnp.linspace(0.0, 0.05, 101)
    stepper = gj.FixedStep(per_sample=16, windows=windows)

    def square(numbers):
        motion = gj.simulate(turned(scene, numbers[0]), ts, 100.0 * numbers[1], stepper=stepper)
        return ((motion.te / arcmin) ** 2).mean()

    points = jnp.array([[0.3, 1.0], [2.0, 0.7]])
    steps = 1e-4 * jnp.eye(2)
    slope = jax.jit(jax.vmap(jax.grad(square)))
    central = jnp.stack([(slope(points + way[None]) - slope(points - way[None])) / 2e-4 for way in steps], axis=1)
    tolerance = 1e-7 * float(abs(central).max())
    np.testing.assert_allclose(jax.hessian(square)(points[0]), central[0], rtol=0, atol=tolerance)
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.hessian(square)))(points), central, rtol=0, atol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("windows", [None, gj.Windows(6, 0.03)])
def test_gradients_of_statistics(scene, windows):
    """Reverse and forward mode against central differences, jitted and batched."""
    ts = jnp.linspace(0.0, 0.3, 151)
    stepper = gj.FixedStep(per_sample=32, windows=windows)

    def metrics(phase):
        motion = gj.simulate(turned(scene, phase), ts, 100.0, stepper=stepper)
        return jnp.stack([motion.std, motion.mean]) / arcmin

    phases = jnp.array([0.3, 2.0])
    forward = jax.jit(jax.vmap(jax.jacfwd(metrics)))(phases)
    reverse = jax.jit(jax.vmap(jax.jacrev(metrics)))(phases)
    step = 1e-5
    both = jax.jit(jax.vmap(metrics))
    central = (both(phases + step) - both(phases - step)) / (2 * step)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(forward, central, rtol=0, atol=1e-6 * float(abs(central).max()))


@pytest.mark.slow
def test_gradients_of_what_drives_the_teeth(scene):
    """With respect to the speed, which moves everything, and to the stiffness and its harmonics alone."""
    ts = np.linspace(0.0, 0.05, 26)

    def metrics(numbers):
        speed, mean, harmonic, phase = numbers
        moved = dataclasses.replace(
            scene,
            system=dataclasses.replace(scene.system, input_speed=speed * scene.system.input_speed),
            compliance=gj.HarmonicStiffness(mean * STIFFNESS, [harmonic], [phase]),
        )
        motion = gj.simulate(moved, ts, 100.0, stepper=gj.FixedStep(per_sample=32))
        return jnp.stack([motion.std, motion.te[-1]]) / arcmin

    given, step = jnp.array([0.8, 1.3, 0.3, -1.0]), 1e-6
    reverse = jax.jit(jax.jacrev(metrics))(given)
    value = jax.jit(metrics)
    central = [(value(given + step * way) - value(given - step * way)) / (2 * step) for way in np.eye(4)]
    np.testing.assert_allclose(reverse, np.stack(central, axis=-1), rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_windows_warm_up_from_the_quasi_static_solution(scene):
    """Which they know from the nodes of their blocks."""
    with_all = dataclasses.replace(scene, inertia=gj.EquivalentMass(MASS), damping=gj.DampingRatio(0.1))
    step, time = jnp.asarray(2e-5), jnp.asarray(0.3)
    spacing = march.Spacing(100, 16, *march.suitable_block(0.001, step.dtype, batched=False))

    @jax.jit
    def both(scene):
        equation = Equation.of(scene, jnp.asarray(30.0))
        forcing = Forcing.of(Oscillator(equation, step), time)
        warm = march.warm_start(forcing, time, spacing, march.nodes_of(forcing, time, spacing)[0])

        def resting(time):
            return equation.resting(time, equation.springs(time)[1], equation.torque_at(time)) / equation.scale

        return jnp.stack(warm), jnp.stack([resting(time), resting(time + step) - resting(time)])

    warm, known = both(with_all)
    np.testing.assert_allclose(warm, known, rtol=1e-8)


@pytest.mark.parametrize("blocks", [1, 7, 300])
def test_nodes_of_blocks_from_fewer_nodes(scene, blocks):
    """Slow signals at the nodes of blocks, as they are, to rounding."""
    with_all = dataclasses.replace(scene, inertia=gj.EquivalentMass(MASS), damping=gj.DampingRatio(0.1))
    step, steps, number = jnp.asarray(5e-5), 192, 6
    assert float(turning_rate(scene)) * float(step) * steps <= chebyshev.reach(number, chebyshev.accuracy(step.dtype))

    @jax.jit
    def both(scene):
        equation = Equation.of(scene, jnp.asarray(30.0))
        forcing = Forcing.of(Oscillator(equation, step), jnp.zeros(()))
        places = steps * np.arange(blocks)[:, None] + chebyshev.nodes(steps, number)[None, :]
        times = 0.3 + jnp.asarray(places) * step
        direct = jax.vmap(jax.vmap(lambda time: forcing.columns(equation.instant(time))))(times)
        return at_nodes(forcing, jnp.asarray(0.3), steps, number, blocks), jnp.stack(direct, axis=1)

    found, direct = (np.asarray(part) for part in both(with_all))
    assert found.shape == direct.shape == (blocks, 8, number)  # gaps of four flanks, and what their dampers push
    swing = np.abs(direct).max(axis=(0, 2))[:, None]
    np.testing.assert_allclose(found / swing, direct / swing, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_steps_between_samples_make_long_blocks():
    """A prime number of steps between samples would leave blocks of a single step."""
    ts = np.array([0.0, 1.0])
    for fewest in range(1, 4000):
        each = gj.FixedStep(step=1 / fewest).steps(ts)
        assert fewest <= each <= fewest + 16
        spacing = march.Spacing(samples=2, each=each, block=march.Block(96, 12), signals=march.Signals.TABLE)
        assert min(each, 48) <= spacing.steps <= 96
    assert gj.FixedStep(step=1 / 2000).steps(ts) == 2000


@pytest.mark.slow
def test_a_sweep_compiles_once(scene):
    """Damping, mass, speed, stiffness and sizes of errors are numbers: other values take the same program."""
    from gearjax.analysis.dynamics import _simulate

    ts = jnp.linspace(0.0, 0.02, 21)
    stepper = gj.FixedStep(per_sample=25)
    gj.simulate(scene, ts, 30.0, stepper=stepper)
    before = _simulate._cached._cache_size()
    for factor in (0.7, 1.2):
        other = dataclasses.replace(
            scene,
            system=dataclasses.replace(scene.system, input_speed=factor * scene.system.input_speed),
            damping=gj.DampingRatio(0.1 * factor),
            inertia=gj.EquivalentMass(MASS * factor),
            compliance=gj.HarmonicStiffness(STIFFNESS * factor, [0.1 * factor], [0.2]),
        )
        gj.simulate(other, ts, 30.0 * factor, stepper=stepper)
    assert _simulate._cached._cache_size() == before


@pytest.mark.slow
def test_uneven_samples(scene):
    ts = jnp.array([0.0, 0.001, 0.003, 0.0031, 0.01])
    fine = gj.simulate(scene, ts, 100.0, stepper=gj.AdaptiveStep())
    np.testing.assert_allclose(gj.simulate(scene, ts, 100.0).te, fine.te, rtol=0, atol=2e-4 * arcmin)
    with pytest.raises(gj.SceneError, match=r"not evenly spaced.*RungeKutta4"):
        gj.simulate(scene, ts, 100.0, stepper=gj.FixedStep(4e-5))
    traced = jax.jit(lambda ts: gj.simulate(scene, ts, 100.0, stepper=gj.FixedStep(per_sample=64)).result)(ts)
    assert int(traced) == 5
