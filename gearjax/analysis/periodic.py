"""Periodic response of a scene whose excitation has one period: shooting, harmonic balance, sweeps over speed.

Both solve for a root, by Newton's method of optimistix, and are differentiated by the implicit function theorem: the
iterations leave no trace in a gradient.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from gearjax import arguments
from gearjax.analysis import march
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.equation import Equation
from gearjax.analysis.oscillator import Oscillator
from gearjax.analysis.tables import MOST_NODES
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.scene import Scene, require, require_output_alone
from gearjax.typing import Array, ArrayLike, Float, Int, Scalar


class Periodic(eqx.Module):
    """One period of a periodic motion.

    Args:
        ts: times, shape (n,) [s]; the end of the period is left out.
        te: transmission error, shape (n,) [rad].
        velocity: its rate, shape (n,) [rad/s].
        multipliers: Floquet multipliers, complex, shape (2,): the motion is stable where both are within the unit
            circle; not a number from harmonic balance.
        residual: what is left of the equation, relative to the motion.
        result: 0 converged, 1 not.
    """

    ts: Float[Array, " n"]
    te: Float[Array, " n"]
    velocity: Float[Array, " n"]
    multipliers: Array
    residual: Scalar
    result: Int[Array, ""]

    @property
    def stable(self) -> Array:
        """Whether a disturbance dies out."""
        return (jnp.abs(self.multipliers) < 1).all()

    @property
    def peak_to_peak(self) -> Scalar:
        """Highest minus lowest sample [rad]."""
        return self.te[jnp.argmax(self.te)] - self.te[jnp.argmin(self.te)]

    @property
    def std(self) -> Scalar:
        """Root mean square of the alternating part [rad]."""
        alternating = self.te - self.te.mean()
        return jnp.sqrt((alternating * alternating).mean())


@arguments.checked(steps=arguments.whole(8))
def shooting(
    scene: Scene,
    torque: ArrayLike,
    period: ArrayLike,
    *,
    steps: int = 512,
    guess: Float[Array, "2"] | None = None,
    max_steps: int = 40,
) -> Periodic:
    """The motion that repeats after a period, by Newton's method on its start.

    Args:
        scene: the scene, with compliance, load and inertia.
        torque: size of the load torque [N m].
        period: common period of everything that drives it [s].
        steps: of the exponentially fitted scheme per period, a multiple of 8.
        guess: transmission error [rad] and its rate [rad/s] to start from; the equilibrium without.
        max_steps: of Newton's method.

    Raises:
        SceneError: the scene lacks a part, or steps is no multiple of 8.
    """
    if steps < 8 or steps % 8:
        raise SceneError(f"steps = {steps}: must be a multiple of 8")
    if guess is not None and jnp.shape(guess) != (2,):
        raise ParameterError("guess", jnp.shape(guess), "is a shape: give a transmission error and its rate")
    return _shooting(_problem(scene, torque, period), steps, guess, max_steps)


class _Problem(NamedTuple):
    """What a periodic motion depends on."""

    scene: Scene
    torque: Scalar
    period: Scalar


def _problem(scene: Scene, torque: ArrayLike, period: ArrayLike) -> _Problem:
    """The arguments of a user, checked."""
    require(scene, "dynamic", "compliance", "load", "inertia")
    require_output_alone(scene, "periodic motion")
    physics, dtype = scene.physics(*MODELLED), scene.dtype
    return _Problem(physics, jnp.asarray(torque, dtype), jnp.asarray(period, dtype))


def _over_a_period(state: Float[Array, "2"], problem: _Problem, steps: int) -> march.March:
    """The march over one period, from a scaled position and a velocity times step."""
    equation = Equation.of(problem.scene, problem.torque)
    start = jnp.zeros_like(problem.period)
    drive = march.Drive.of(Oscillator(equation, problem.period / steps), start)
    spacing = march.Spacing(steps + 1, 1, march.Block(max(steps // 8, 8), MOST_NODES), march.Signals.TABLE)
    carry, _ = march.begin(drive, start, spacing.signals, state)
    return march.march(drive, start, carry, spacing)


@eqx.filter_jit
def _shooting(problem: _Problem, steps: int, guess: Array | None, max_steps: int) -> Periodic:
    equation, period = Equation.of(problem.scene, problem.torque), problem.period
    step = period / steps
    if guess is None:
        first = equation.initial(jnp.zeros_like(period), "equilibrium")
        start = first * equation.per_step(step)
    else:
        start = guess / equation.scale * jnp.stack([jnp.ones_like(step), step])

    def end(state: Array, problem: _Problem) -> Array:
        found = _over_a_period(state, problem, steps)
        return jnp.stack([found.positions[-1], found.speeds[-1]])

    solver = optimistix.Newton(rtol=1e-10, atol=1e-10)
    solution = optimistix.root_find(
        lambda state, problem: end(state, problem) - state, solver, start, problem, max_steps=max_steps, throw=False
    )
    state = solution.value
    found = _over_a_period(state, problem, steps)
    left = jnp.abs(jnp.stack([found.positions[-1], found.speeds[-1]]) - state).max()
    size = jnp.abs(found.positions).max()
    map_ = jax.jacfwd(lambda state: end(state, problem))(jax.lax.stop_gradient(state))
    return Periodic(
        step * jnp.arange(steps).astype(step.dtype),
        found.positions[:-1] * equation.scale,
        found.speeds[:-1] * (equation.scale / step),
        _eigenvalues(map_),
        left / size,
        jnp.where((left <= 1e-6 * size) & jnp.isfinite(left), 0, 1),
    )


def _eigenvalues(matrix: Float[Array, "2 2"]) -> Array:
    """Of a two by two matrix, complex."""
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    square = half * half - determinant
    real, imaginary = (jnp.sqrt(jnp.maximum(sign * square, 0.0)) for sign in (1.0, -1.0))
    return jax.lax.complex(jnp.stack([half + real, half - real]), jnp.stack([imaginary, -imaginary]))


@arguments.checked(harmonics=arguments.whole(1), samples=arguments.whole(3))
def harmonic_balance(
    scene: Scene,
    torque: ArrayLike,
    period: ArrayLike,
    *,
    harmonics: int = 16,
    samples: int | None = None,
    guess: Float[Array, " n"] | None = None,
    max_steps: int = 60,
) -> Periodic:
    """The motion that repeats after a period as a Fourier series, forces by alternating between time and frequency.

    Args:
        scene: the scene, with compliance, load and inertia.
        torque: size of the load torque [N m].
        period: common period of everything that drives it [s].
        harmonics: of the series.
        samples: of the period at which forces are evaluated; 16 per harmonic without.
        guess: transmission error over the period to start from, shape (n,) [rad]; the static one without.
        max_steps: of Newton's method.

    Raises:
        SceneError: the scene lacks a part, or there are too few samples.
    """
    samples = 16 * harmonics if samples is None else samples
    if harmonics < 1 or samples < 2 * harmonics + 1:
        raise SceneError(f"harmonics = {harmonics}, samples = {samples}: needs at least 2 harmonics + 1 samples")
    return _harmonic_balance(_problem(scene, torque, period), harmonics, samples, guess, max_steps)


@eqx.filter_jit
def _harmonic_balance(problem: _Problem, harmonics: int, samples: int, guess: Array | None, max_steps: int) -> Periodic:
    period = problem.period
    places = np.arange(samples) / samples
    order = np.arange(1, harmonics + 1)
    angle = 2 * np.pi * order[:, None] * places[None, :]
    basis = jnp.asarray(np.concatenate([np.ones((1, samples)), np.cos(angle), np.sin(angle)]), period.dtype)
    turned = jnp.asarray(np.concatenate([np.zeros((1, samples)), -np.sin(angle), np.cos(angle)]), period.dtype)
    multiple = jnp.asarray(np.concatenate([[0.0], order, order]), period.dtype)
    weights = jnp.asarray(np.concatenate([[1 / samples], np.full(2 * harmonics, 2 / samples)]), period.dtype)
    ts = jnp.asarray(places, period.dtype) * period

    def left(numbers: Array, problem: _Problem) -> Array:
        """Coefficients of what the equation of motion lacks, scaled."""
        equation = Equation.of(problem.scene, problem.torque)
        rate = 2 * jnp.pi / problem.period
        place, speed = numbers @ basis, (multiple * rate * numbers) @ turned
        acceleration = -((multiple * rate) ** 2 * numbers) @ basis
        times = jnp.asarray(places, rate.dtype) * problem.period
        forced = jax.vmap(
            lambda t, x, v: equation.acceleration(equation.excitation(t), x * equation.scale, v * equation.scale)
        )(times, place, speed)
        return weights * (basis @ (forced / equation.scale - acceleration)) / equation.frequency**2

    equation = Equation.of(problem.scene, problem.torque)
    if guess is None:
        curve = jnp.broadcast_to(equation.initial(jnp.zeros_like(period), "equilibrium")[0], (samples,))
    else:
        curve = jnp.interp(ts, jnp.linspace(0.0, 1.0, guess.shape[0] + 1).astype(ts.dtype)[:-1] * period, guess)
        curve = curve / equation.scale
    solver = optimistix.Newton(rtol=1e-10, atol=1e-10)
    solution = optimistix.root_find(left, solver, weights * (basis @ curve), problem, max_steps=max_steps, throw=False)
    numbers = solution.value
    rest = jnp.abs(left(numbers, problem)).max() / jnp.abs(numbers).max()
    return Periodic(
        ts,
        (numbers @ basis) * equation.scale,
        ((multiple * 2 * jnp.pi / period * numbers) @ turned) * equation.scale,
        jax.lax.complex(*(jnp.full((2,), jnp.nan, period.dtype) for _ in range(2))),
        rest,
        jnp.where((rest <= 1e-6) & jnp.isfinite(rest), 0, 1),
    )


class Sweep(eqx.Module):
    """Settled motion over a sweep of speeds, each starting where the one before ended.

    Args:
        speeds: input speeds in the order of the sweep, shape (n,) [rad/s].
        std: root mean square of the alternating part over the last period, shape (n,) [rad].
        peak_to_peak: of the last period, shape (n,) [rad].
        ends: transmission error [rad] and its rate [rad/s] after it, shape (n, 2).
    """

    speeds: Float[Array, " n"]
    std: Float[Array, " n"]
    peak_to_peak: Float[Array, " n"]
    ends: Float[Array, "n 2"]


@arguments.checked(periods=arguments.whole(1), steps=arguments.whole(8))
def speed_sweep(
    scene: Scene, torque: ArrayLike, speeds: ArrayLike, *, periods: int = 100, steps: int = 128, order: str = "mesh"
) -> Sweep:
    """Settled motion at one input speed after the other: with jumps where a branch ends, and hysteresis between an
    upward and a downward sweep.

    Args:
        scene: the scene, with compliance, load and inertia; everything that drives it repeats with the order.
        torque: size of the load torque [N m].
        speeds: input speeds in the order of the sweep, shape (n,) [rad/s].
        periods: computed at each speed.
        steps: of the exponentially fitted scheme per period, a multiple of 8.
        order: name of the order whose period counts.

    Raises:
        SceneError: the scene lacks a part, or steps is no multiple of 8.
        ParameterError: no such order, or speeds that are not positive.
    """
    require(scene, "dynamic", "compliance", "load", "inertia")
    require_output_alone(scene, "periodic motion")
    speeds = jnp.asarray(speeds, scene.dtype)
    if speeds.ndim != 1 or speeds.shape[0] == 0:
        raise ParameterError("speeds", speeds.shape, "is a shape: give input speeds of shape (n,)")
    if steps % 8:
        raise SceneError(f"steps = {steps}: must be a multiple of 8")
    if order not in scene.system.orders:
        raise ParameterError("order", order, nearest(order, scene.system.orders))
    turns = scene.system.orders[order]
    return _speed_sweep(scene.physics(*MODELLED), jnp.asarray(torque, scene.dtype), speeds, periods, steps, turns)


@eqx.filter_jit
def _speed_sweep(scene: Scene, torque: Scalar, speeds: Array, periods: int, steps: int, turns: float) -> Sweep:
    equation = Equation.of(scene, torque)

    def at(state: Array, speed: Scalar) -> tuple[Array, tuple[Array, Array, Array]]:
        turning = eqx.tree_at(lambda s: s.system.input_speed, scene, speed)
        period = 2 * jnp.pi / (turns * speed)
        step = period / steps

        def once(state, _):
            found = _over_a_period(state, _Problem(turning, torque, period), steps)
            return jnp.stack([found.positions[-1], found.speeds[-1]]), None

        state = jax.lax.scan(once, state * jnp.stack([jnp.ones_like(step), step]), None, length=periods - 1)[0]
        found = _over_a_period(state, _Problem(turning, torque, period), steps)
        path = found.positions[:-1]
        state = jnp.stack([found.positions[-1], found.speeds[-1] / step])
        spread = found.highest.max() - found.lowest.min()
        return state, (path.std() * equation.scale, spread * equation.scale, state * equation.scale)

    first = equation.initial(jnp.zeros_like(torque), "equilibrium") * jnp.stack(
        [jnp.ones_like(torque), equation.frequency]
    )
    _, (std, spread, ends) = jax.lax.scan(at, first, speeds)
    return Sweep(speeds, std, spread, ends)
