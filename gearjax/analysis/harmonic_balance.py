"""Periodic response as a Fourier series in every coordinate: harmonic balance.

It solves for a root, by Newton's method of optimistix, and is differentiated by the implicit function theorem.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from gearjax import arguments
from gearjax.analysis.equation import Equation
from gearjax.analysis.modes import StructureEquation
from gearjax.analysis.periodic import Periodic
from gearjax.analysis.return_map import Problem
from gearjax.checks import ParameterError, SceneError
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike, Float, Scalar


@arguments.checked(harmonics=arguments.whole(1), samples=arguments.whole(3))
def harmonic_balance(
    scene: Scene,
    torque: ArrayLike,
    period: ArrayLike,
    *,
    harmonics: int = 16,
    samples: int | None = None,
    guess: ArrayLike | None = None,
    max_steps: int = 60,
) -> Periodic:
    """The motion that repeats after a period as a Fourier series, forces by alternating between time and frequency.

    Args:
        scene: the scene, with compliance, load and inertia.
        torque: size of the load torque [N m].
        period: common period of everything that drives it [s].
        harmonics: of the series.
        samples: of the period at which forces are evaluated; 16 per harmonic without.
        guess: transmission error over the period to start from, shape (n,) [rad]; of bodies on supports all
            coordinates, shape (n, coordinate) [rad, m]. The static one without.
        max_steps: of Newton's method.

    Raises:
        SceneError: the scene lacks a part, or there are too few samples.
        ParameterError: the guess has another shape.
    """
    samples = 16 * harmonics if samples is None else samples
    if harmonics < 1 or samples < 2 * harmonics + 1:
        raise SceneError(f"harmonics = {harmonics}, samples = {samples}: needs at least 2 harmonics + 1 samples")
    problem = Problem.of(scene, torque, period)
    if guess is not None:
        names, shape = problem.scene.coordinates, jnp.shape(guess)
        wanted = shape[:1] if problem.scene.output_alone else (*shape[:1], len(names))
        if not shape or shape != wanted:
            words = (
                "(n,), transmission error" if problem.scene.output_alone else f"(n, {len(names)}), {', '.join(names)}"
            )
            raise ParameterError("guess", shape, f"is a shape: give {words} over the period")
        guess = jnp.asarray(guess, scene.dtype).reshape(shape[0], -1)
    return _harmonic_balance(problem, harmonics, samples, guess, max_steps)


class Series(NamedTuple):
    """A Fourier series at even places of its period: a mean, cosines, sines.

    Args:
        places: parts of the period, shape (n,).
        values, rates: of each function and its derivative by the angle over its order, shape (n, function).
        orders: of the functions, shape (function,).
        weights: of the places in each coefficient, shape (function, n).
    """

    places: Array
    values: Array
    rates: Array
    orders: Array
    weights: Array

    @classmethod
    def of(cls, harmonics: int, samples: int, dtype: jnp.dtype) -> "Series":
        """A series of some harmonics at some places."""
        places, order = np.arange(samples) / samples, np.arange(1, harmonics + 1)
        angle = 2 * np.pi * places[:, None] * order[None, :]
        values = np.concatenate([np.ones((samples, 1)), np.cos(angle), np.sin(angle)], axis=1)
        rates = np.concatenate([np.zeros((samples, 1)), -np.sin(angle), np.cos(angle)], axis=1)
        shares = np.concatenate([[1 / samples], np.full(2 * harmonics, 2 / samples)])
        parts = places, values, rates, np.concatenate([[0.0], order, order]), shares[:, None] * values.T
        return cls(*(jnp.asarray(part, dtype) for part in parts))

    def motion(self, numbers: Float[Array, "function coordinate"], period: Scalar) -> tuple[Array, Array, Array]:
        """Coordinates, velocities and accelerations, shape (n, coordinate)."""
        rate = (2 * jnp.pi / period * self.orders)[:, None]
        return self.values @ numbers, self.rates @ (rate * numbers), -self.values @ (rate**2 * numbers)


def _equation(problem: Problem) -> Equation | StructureEquation:
    of = Equation if problem.scene.output_alone else StructureEquation
    return of.of(problem.scene, problem.torque)


def _lacking(equation: Equation | StructureEquation, time: Scalar, motion: tuple[Array, Array, Array]) -> Array:
    """What the equation of motion lacks at one time, scaled as the coordinates are, shape (coordinate,)."""
    place, speed, acceleration = (part * jnp.atleast_1d(equation.scale) for part in motion)
    if isinstance(equation, StructureEquation):
        return equation.lacking(equation.excitation(time), place, speed, acceleration) / equation.scale
    own = equation.acceleration(equation.excitation(time), place[0], speed[0]) - acceleration[0]
    return (own / (equation.scale * equation.frequency**2))[None]


@eqx.filter_jit
def _harmonic_balance(problem: Problem, harmonics: int, samples: int, guess: Array | None, max_steps: int) -> Periodic:
    equation, period = _equation(problem), problem.period
    series = Series.of(harmonics, samples, period.dtype)

    def left(numbers: Array, problem: Problem) -> Array:
        """Coefficients of what the equation of motion lacks."""
        equation, motion = _equation(problem), series.motion(numbers, problem.period)
        found = jax.vmap(lambda time, *now: _lacking(equation, time, now))(series.places * problem.period, *motion)
        return series.weights @ found

    scale = jnp.atleast_1d(equation.scale)[None]
    if guess is None:
        rest = jnp.atleast_1d(equation.initial(jnp.zeros_like(period), "equilibrium")[0])
        curve = jnp.broadcast_to(rest, (samples, *rest.shape))
    else:
        begins = jnp.linspace(0.0, 1.0, guess.shape[0] + 1).astype(period.dtype)[:-1]
        curve = jax.vmap(lambda one: jnp.interp(series.places, begins, one), 1, 1)(guess) / scale
    solver = optimistix.Newton(rtol=1e-10, atol=1e-10)
    start = series.weights @ curve
    numbers = optimistix.root_find(left, solver, start, problem, max_steps=max_steps, throw=False).value
    rest = jnp.abs(left(numbers, problem)).max() / jnp.abs(numbers).max()
    place, speed = (part * scale for part in series.motion(numbers, period)[:2])
    unknown = jnp.full((2 * place.shape[1],), jnp.nan, period.dtype)
    state, supported = jnp.stack([place[0], speed[0]]), not problem.scene.output_alone
    return Periodic(
        series.places * period,
        place[:, 0],
        speed[:, 0],
        jax.lax.complex(unknown, unknown),
        rest,
        jnp.where((rest <= 1e-6) & jnp.isfinite(rest), 0, 1),
        state if supported else state[:, 0],
        place[:, 1:] if supported else None,
        problem.scene.coordinates,
    )
