"""Periodic response of a scene whose excitation has one period: shooting method, and sweeps over speed.

The shooting method solves for the initial state by Newton's method. The implicit function theorem gives its derivatives
(`jax.lax.custom_root`), so that the iterations do not enter a gradient. A period is integrated in two places of the
program only, with its slopes in the loop and with its states at the end, because each of them takes seconds to compile.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.period import check_repeats
from gearjax.analysis.return_map import OfOutput, OfStructure, Problem, check_steps, eigenvalues, return_map, turned
from gearjax.checks import ParameterError, SceneError, is_concrete, nearest
from gearjax.evaluate import evaluated
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float, Int, Scalar

TOLERANCE = 1e-10  # of Newton's method, of scaled numbers


class Periodic(eqx.Module):
    """One period of a periodic motion.

    Args:
        ts: times, shape (n,) [s]; the end of the period is left out.
        te: transmission error, shape (n,) [rad].
        velocity: rate of the transmission error, shape (n,) [rad/s].
        multipliers: Floquet multipliers, complex, two for each coordinate, shape (2 coordinate,); the motion is stable
            if all are inside the unit circle. They have no derivatives; harmonic balance gives nan.
        residual: residual of the equation, relative to the motion.
        result: 0 converged, 1 not converged; from `periodic_motion` 2 if the motion does not repeat; 3 if the steps are
            too long for the motion, of a scene whose numbers are traced: otherwise such steps are refused.
        start: state at the start of the period, in the form of ``guess`` of `shooting`: shape (2,), with supports
            (2, coordinate).
        moved: displacements in the other coordinates, shape (n, coordinate) [m, rad]; ``None`` if there are none.
        coordinates: names of the coordinates: the output, then the others.
        periods: number of periods of the excitation after which the motion repeats.
    """

    ts: Float[Array, " n"]
    te: Float[Array, " n"]
    velocity: Float[Array, " n"]
    multipliers: Array
    residual: Scalar
    result: Int[Array, ""]
    start: Float[Array, "2 ..."]
    moved: Float[Array, "n coordinate"] | None = None
    coordinates: tuple[str, ...] = eqx.field(static=True, default=("output",))
    periods: int = eqx.field(static=True, default=1)

    @property
    def q(self) -> Float[Array, "... n coordinate"]:
        """Displacement from the ideal motion in each coordinate, the output's first [rad, m]."""
        te = self.te[..., None]
        return te if self.moved is None else jnp.concatenate([te, self.moved], axis=-1)

    @property
    def stable(self) -> Array:
        """Whether a small disturbance of the motion dies out."""
        return (jnp.abs(self.multipliers) < 1).all()

    @property
    def peak_to_peak(self) -> Scalar:
        """Highest minus lowest sample of the transmission error [rad]."""
        return self.te[jnp.argmax(self.te)] - self.te[jnp.argmin(self.te)]

    @property
    def std(self) -> Scalar:
        """Root mean square of the alternating part of the transmission error [rad]."""
        alternating = self.te - self.te.mean()
        return jnp.sqrt((alternating * alternating).mean())


@arguments.checked(steps=arguments.whole(8), settle=arguments.whole(0))
def shooting(
    scene: Scene,
    torque: ArrayLike,
    period: ArrayLike,
    *,
    steps: int = 512,
    guess: ArrayLike | None = None,
    settle: int = 0,
    max_steps: int = 40,
) -> Periodic:
    """Motion that repeats after a period, by the shooting method: Newton's method on the initial state.

    Args:
        scene: the scene, with compliance, load and inertia.
        torque: size of the load torque [N m].
        period: common period of the whole excitation [s].
        steps: steps per period, of the exponentially fitted scheme, or of constant modes as in `simulate`; a
            multiple of 8.
        guess: transmission error [rad] and its rate [rad/s] as initial guess, shape (2,); for bodies on supports all
            coordinates [rad, m] and their rates, shape (2, coordinate). By default the static equilibrium.
        settle: number of periods to integrate from the guess before Newton's method; motions with impacts may need it.
        max_steps: largest number of steps of Newton's method.

    Raises:
        SceneError: the scene lacks a part, ``steps`` is not a multiple of 8, or the steps are too long for its fastest
            motion.
    """
    if steps < 8 or steps % 8:
        raise SceneError(f"steps = {steps}: must be a multiple of 8")
    problem = Problem.of(scene, torque, period)
    if guess is not None:
        names = problem.scene.coordinates
        wanted, words = (
            ((2,), "transmission error") if problem.scene.output_alone else ((2, len(names)), ", ".join(names))
        )
        if jnp.shape(guess) != wanted:
            raise ParameterError("guess", jnp.shape(guess), f"is a shape: give {words} and their rates, shape {wanted}")
        guess = jnp.asarray(guess, scene.dtype).reshape(2, -1)
    check_resolved(problem, steps)
    return shoot(problem, steps, guess, settle, max_steps)


@eqx.filter_jit
def shoot(problem: Problem, steps: int, guess: Array | None, settle: int, max_steps: int) -> Periodic:
    """Newton's method on the initial state; arguments as for `shooting`, with a guess of shape (2, coordinate).

    With ``max_steps`` zero, the motion over one period from the guess is returned.
    """
    motion = return_map(problem, steps)
    start = motion.resting() if guess is None else guess / motion.scale
    if settle:
        start = jax.lax.scan(lambda state, _: (motion.end(state), None), start, None, length=settle)[0]

    state, slope = _returning(motion, start, max_steps)
    course = motion.course(state)
    left = jnp.abs(course.states[-1] - state).max()
    size = jnp.abs(course.states[:, 0]).max()
    states = course.states[:-1] * motion.scale[None]
    supported = not problem.scene.output_alone
    return Periodic(
        problem.period / steps * jnp.arange(steps).astype(state.dtype),
        states[:, 0, 0],
        states[:, 1, 0],
        jax.lax.stop_gradient(eigenvalues(slope)),
        left / jnp.where(left == 0, 1.0, size),
        jnp.where(motion.resolved, jnp.where((left <= 1e-6 * size) & jnp.isfinite(left), 0, 1), 3),
        states[0] if supported else states[0, :, 0],
        states[:, 0, 1:] if supported else None,
        problem.scene.coordinates,
    )


class Newton(NamedTuple):
    """Newton's method on the way.

    Args:
        steps: number of steps taken, -1 before the first evaluation.
        state: scaled state at the start of the period, shape (2 coordinate,).
        lacking: its change over the period.
        slope: derivative of ``lacking``.
        way: the next step.
    """

    steps: Array
    state: Float[Array, " number"]
    lacking: Float[Array, " number"]
    slope: Float[Array, "number number"]
    way: Float[Array, " number"]


def _returning(motion: OfOutput | OfStructure, start: Array, max_steps: int) -> tuple[Array, Array]:
    """State that returns after a period, and the slope of the return map there, which has no derivative.

    With ``max_steps`` zero the state is the start.
    """
    begin = jax.lax.stop_gradient(start).ravel()
    unit = jnp.eye(len(begin), dtype=begin.dtype)

    def lacking(flat: Array) -> Array:
        return motion.end(flat.reshape(start.shape)).ravel() - flat

    def search(_: Callable[[Array], Array], begin: Array) -> tuple[Array, Array]:
        def there(now: Newton) -> Array:
            small = TOLERANCE * (1 + jnp.abs(now.state))
            return ((jnp.abs(now.way) <= small) & (jnp.abs(now.lacking) <= small)).all()

        def going_on(now: Newton) -> Array:
            lost = (now.steps >= 0) & ~jnp.isfinite(now.lacking).all()
            return (now.steps < max_steps) & ~there(now) & ~lost

        def step(now: Newton) -> Newton:
            state = now.state + now.way
            end, slope = motion.end_and_slope(state)
            left, slope = end - state, slope - unit
            # what rests, or flies freely, may do so anywhere: where nothing is lacking, no step is asked for
            way = jnp.where((left == 0).all(), 0.0, -jnp.linalg.solve(slope, left))
            return Newton(now.steps + 1, state, left, slope, way)

        first = Newton(jnp.asarray(-1), begin, jnp.full_like(begin, jnp.inf), unit, jnp.zeros_like(begin))
        found = jax.lax.while_loop(going_on, step, first)
        # the last step is so small that the period need not be computed again for it
        return jnp.where(there(found), found.state + found.way, found.state), found.slope

    def solve(linear: Callable[[Array], Array], right: Array) -> Array:
        return jnp.linalg.solve(jax.jacfwd(linear)(jnp.zeros_like(right)), right)

    if max_steps:
        flat, slope = jax.lax.custom_root(lacking, begin, search, solve, has_aux=True)
    else:
        _, slope = search(lacking, begin)
        flat = start.ravel()
    return flat.reshape(start.shape), jax.lax.stop_gradient(slope) + unit


class Sweep(eqx.Module):
    """Settled motion over a sweep of speeds; each speed starts from the final state of the speed before.

    Args:
        speeds: input speeds in the order of the sweep, shape (n,) [rad/s].
        std: root mean square of the alternating part of the TE over the last period, shape (n,) [rad].
        peak_to_peak: peak-to-peak value of the TE over the last period, shape (n,) [rad].
        ends: transmission error [rad] and its rate [rad/s] after the last period, shape (n, 2); for bodies on supports
            all coordinates [rad, m] and their rates, shape (n, 2, coordinate).
        result: 0, or 1 where the motion is lost, shape (n,); 3 if the steps are too long for the motion, of a scene
            whose numbers are traced: otherwise such steps are refused.
    """

    speeds: Float[Array, " n"]
    std: Float[Array, " n"]
    peak_to_peak: Float[Array, " n"]
    ends: Float[Array, "n ..."]
    result: Int[Array, " n"]


def at_speeds(scene: Scene, speeds: ArrayLike, order: str) -> Float[Array, " n"]:
    """Checked input speeds of motions that repeat with an order [rad/s].

    Raises:
        SceneError: the scene lacks a part.
        ParameterError: there is no such order, or there are no speeds.
    """
    require(scene, "dynamic", "compliance", "load", "inertia")
    speeds = jnp.asarray(speeds, scene.dtype)
    if speeds.ndim != 1 or speeds.shape[0] == 0:
        raise ParameterError("speeds", speeds.shape, "is a shape: give input speeds of shape (n,)")
    if order not in scene.system.orders:
        raise ParameterError("order", order, nearest(order, scene.system.orders))
    return speeds


@arguments.checked(periods=arguments.whole(1), steps=arguments.whole(8))
def speed_sweep(
    scene: Scene, torque: ArrayLike, speeds: ArrayLike, *, periods: int = 100, steps: int = 128, order: str = "mesh"
) -> Sweep:
    """Settled motion at one input speed after the other.

    The sweep shows jumps where a branch of motions ends, and hysteresis between upward and downward sweeps.

    Args:
        scene: the scene, with compliance, load and inertia; its whole excitation must repeat with the order.
        torque: size of the load torque [N m].
        speeds: input speeds in the order of the sweep, shape (n,) [rad/s].
        periods: number of periods computed at each speed.
        steps: steps per period, as in `shooting`, a multiple of 8.
        order: name of the order that gives the period.

    Raises:
        SceneError: the scene lacks a part, ``steps`` is not a multiple of 8, or the steps are too long for its fastest
            motion at a speed.
        ParameterError: there is no such order, or a speed is not positive.
    """
    speeds = at_speeds(scene, speeds, order)
    if steps % 8:
        raise SceneError(f"steps = {steps}: must be a multiple of 8")
    turns, physics = scene.system.orders[order], scene.precomputed(*MODELLED)
    check_repeats(scene, 2 * np.pi / turns, speeds)
    torque = jnp.asarray(torque, scene.dtype)
    check_resolved_at(physics, torque, turns, speeds, steps)
    sweep = _speed_sweep(physics, torque, speeds, periods, steps, turns)
    return dataclasses.replace(sweep, ends=sweep.ends[..., 0]) if scene.output_alone else sweep


def at_speed(scene: Scene, torque: Scalar, turns: float, speed: Scalar) -> Problem:
    """Problem of a periodic motion with the period of an order, at an input speed."""
    turning = eqx.tree_at(lambda s: s.system.input_speed, scene, speed)
    return Problem(turning, torque, 2 * jnp.pi / (turns * speed))


def check_resolved(problem: Problem, steps: int) -> None:
    """Refuse steps that are too long for a periodic motion, if its numbers are known.

    Raises:
        SceneError: tells how many steps are enough.
    """
    if is_concrete(problem):
        check_steps(steps, float(evaluated(turned, problem)))


def check_resolved_at(scene: Scene, torque: Scalar, turns: float, speeds: Array, steps: int) -> None:
    """Refuse steps that are too long for the motion at one of several input speeds [rad/s], if all is known.

    Raises:
        SceneError: names the speed, and tells how many steps are enough.
    """
    if not is_concrete((scene, torque, speeds)):
        return
    found = np.asarray(evaluated(_turned_at, scene, torque, turns, speeds))
    place = int(np.argmax(found))
    check_steps(steps, float(found[place]), f" at speeds[{place}] = {float(speeds[place]):.4g} rad/s")


def _turned_at(scene: Scene, torque: Scalar, turns: float, speeds: Array) -> Array:
    return jax.vmap(lambda speed: turned(at_speed(scene, torque, turns, speed)))(speeds)


@eqx.filter_jit
def _speed_sweep(scene: Scene, torque: Scalar, speeds: Array, periods: int, steps: int, turns: float) -> Sweep:
    def at(state: Array, speed: Scalar) -> tuple[Array, tuple[Array, Array, Array, Array]]:
        motion = return_map(at_speed(scene, torque, turns, speed), steps)
        state = jax.lax.scan(
            lambda state, _: (motion.end(state), None), state / motion.scale, None, length=periods - 1
        )[0]
        course = motion.course(state)
        path, output = course.states[:-1, 0, 0], motion.scale[0, 0]
        spread = course.highest.max() - course.lowest.min()
        state = course.states[-1] * motion.scale
        result = jnp.where(motion.resolved, jnp.where(jnp.isfinite(state).all(), 0, 1), 3)
        return state, (path.std() * output, spread * output, state, result)

    first = return_map(at_speed(scene, torque, turns, scene.system.input_speed), steps)
    return Sweep(speeds, *jax.lax.scan(at, first.resting() * first.scale, speeds)[1])
