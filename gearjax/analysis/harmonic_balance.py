"""Periodic response as a Fourier series: harmonic balance.

The unknowns are Fourier coefficients of the output, or of the approaches at the contacts of a structure
(`gearjax.analysis.modes.lines`). Newton's method of optimistix finds them, and the implicit function theorem gives
their derivatives.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from gearjax import arguments
from gearjax.analysis.equation import LENGTH_SCALE, Equation
from gearjax.analysis.modes import Lines, StructureEquation
from gearjax.analysis.periodic import Periodic
from gearjax.analysis.return_map import Problem
from gearjax.checks import ParameterError, SceneError
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike, Complex, Float, Scalar


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
    """Motion that repeats after a period, as a Fourier series; the contact forces are evaluated in time.

    Args:
        scene: the scene, with compliance, load and inertia.
        torque: size of the load torque [N m].
        period: common period of everything that drives it [s].
        harmonics: number of harmonics of the series.
        samples: number of times per period at which forces are evaluated; by default 16 per harmonic.
        guess: transmission error over the period as initial guess, shape (n,) [rad]; for bodies on supports all
            coordinates, shape (n, coordinate) [rad, m]. By default the static equilibrium.
        max_steps: largest number of steps of Newton's method.

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
            words = "the transmission error over the period, shape (n,)"
            if not problem.scene.output_alone:
                words = f"{', '.join(names)} over the period, shape (n, {len(names)})"
            raise ParameterError("guess", shape, f"is a shape: give {words}")
        guess = jnp.asarray(guess, scene.dtype).reshape(shape[0], -1)
    return _harmonic_balance(problem, harmonics, samples, guess, max_steps)


class Series(NamedTuple):
    """A Fourier series (mean, cosines, sines) and the even places of its period at which it is evaluated.

    Args:
        places: places as fractions of the period, shape (n,).
        values: value of each function at each place, shape (n, function).
        rates: derivative of each function with respect to its angle (order times phase), shape (n, function).
        orders: orders of the functions, shape (function,).
        weights: weights of the values at the places in each coefficient, shape (function, n).
    """

    places: Array
    values: Array
    rates: Array
    orders: Array
    weights: Array

    @classmethod
    def of(cls, harmonics: int, samples: int, dtype: jnp.dtype) -> "Series":
        """A series with a number of harmonics, at a number of places."""
        places, order = np.arange(samples) / samples, np.arange(1, harmonics + 1)
        angle = 2 * np.pi * places[:, None] * order[None, :]
        values = np.concatenate([np.ones((samples, 1)), np.cos(angle), np.sin(angle)], axis=1)
        rates = np.concatenate([np.zeros((samples, 1)), -np.sin(angle), np.cos(angle)], axis=1)
        shares = np.concatenate([[1 / samples], np.full(2 * harmonics, 2 / samples)])
        parts = places, values, rates, np.concatenate([[0.0], order, order]), shares[:, None] * values.T
        return cls(*(jnp.asarray(part, dtype) for part in parts))

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.orders) // 2

    def apart(self, numbers: Float[Array, "function column"]) -> tuple[Array, Array, Array]:
        """Coefficients of the mean, of cosines and of sines."""
        return numbers[0], numbers[1 : self.harmonics + 1], numbers[self.harmonics + 1 :]

    def motion(self, numbers: Float[Array, "function coordinate"], period: Scalar) -> tuple[Array, Array, Array]:
        """Coordinates, velocities and accelerations, shape (n, coordinate)."""
        rate = (2 * jnp.pi / period * self.orders)[:, None]
        return self.values @ numbers, self.rates @ (rate * numbers), -self.values @ (rate**2 * numbers)


class OfOutput:
    """Harmonic balance of a scene whose output alone moves: unknowns are its coefficients, shape (function, 1)."""

    def __init__(self, problem: Problem, series: Series):
        self.equation, self.series, self.period = Equation.of(problem.scene, problem.torque), series, problem.period

    def seen(self, place: Float[Array, "n 1"]) -> Float[Array, "n 1"]:
        """The scaled unknown curves, from the coordinates over time."""
        return place / self.equation.scale

    def resting(self) -> Float[Array, " 1"]:
        """Scaled coordinates of the static equilibrium."""
        return self.equation.initial(jnp.zeros_like(self.period), "equilibrium")[:1]

    @property
    def scale(self) -> Float[Array, " 1"]:
        """Coordinates per scaled coordinate."""
        return self.equation.scale[None]

    def lacking(self, numbers: Float[Array, "function 1"]) -> Float[Array, "function 1"]:
        """Residual of the equation of motion, as the static displacement that it would cause."""
        equation = self.equation

        def at(time: Scalar, place: Array, speed: Array, acceleration: Array) -> Array:
            now, size = equation.excitation(time), equation.scale
            own = equation.acceleration(now, place[0] * size, speed[0] * size) / size
            return (own - acceleration[0])[None] / equation.frequency**2

        times = self.series.places * self.period
        return self.series.weights @ jax.vmap(at)(times, *self.series.motion(numbers, self.period))

    def coordinates(self, numbers: Float[Array, "function 1"]) -> Float[Array, "function 1"]:
        """Coefficients of the coordinates [rad]."""
        return numbers * self.equation.scale


class OfStructure:
    """Harmonic balance of bodies on supports: unknowns are coefficients of lines (`modes.Lines`).

    The coefficients have shape (function, line). If levers are constant, a line is the approach of one contact, however
    many coordinates move behind it. The dynamic stiffness of each harmonic, including mean springs of the contacts, is
    ``Z = K + i w C - w^2 M``. The lines respond to the inputs by the receptance ``L Z^-1 G``.
    """

    def __init__(self, problem: Problem, series: Series):
        equation = StructureEquation.of(problem.scene, problem.torque)
        self.equation, self.series, self.period = equation, series, problem.period
        self.lines = Lines.of(equation, jnp.zeros_like(problem.period))
        lengths = jnp.full(self.lines.seen.shape[:1], LENGTH_SCALE, equation.scale.dtype)
        self.size = lengths if self.lines.apart else equation.scale
        self.answers = self._answers()

    @property
    def scale(self) -> Float[Array, " coordinate"]:
        """Coordinates per scaled coordinate [rad, m]."""
        return self.equation.scale

    def seen(self, place: Float[Array, "n coordinate"]) -> Float[Array, "n line"]:
        """The scaled unknown curves of the lines, from the coordinates over time."""
        return place @ self.lines.seen.T / self.size[None]

    def resting(self) -> Float[Array, " line"]:
        """Scaled lines of the static equilibrium."""
        place = self.equation.initial(jnp.zeros_like(self.period), "equilibrium")[0] * self.scale
        return self.seen(place[None])[0]

    def _answers(self) -> Complex[Array, "harmonic coordinate input"]:
        """Complex displacement of the coordinates per input of the lines, ``Z^-1 G``, of the mean and each harmonic."""
        lines, parts, size = self.lines, self.equation.structure, self.scale
        stiffness, damping = lines.whole
        rates = 2 * jnp.pi / self.period * jnp.arange(self.series.harmonics + 1).astype(size.dtype)

        def of(rate: Scalar) -> Array:
            real, imaginary = stiffness - rate**2 * parts.mass, rate * damping
            both = jnp.outer(size, size)
            whole = jax.lax.complex(real * both, imaginary * both)
            answer = jnp.linalg.solve(whole, (size[:, None] * lines.acting).astype(whole.dtype))
            return size.astype(answer.dtype)[:, None] * answer

        return jax.vmap(of)(rates)

    def _inputs(self, numbers: Float[Array, "function line"]) -> Float[Array, "function input"]:
        """Coefficients of the inputs (forces) that follow from the curves."""
        lines = self.lines
        seen, rate, _ = self.series.motion(numbers * self.size[None], self.period)

        def at(time: Scalar, seen: Array, rate: Array) -> Array:
            now = lines.driving(time)
            return jnp.concatenate([lines.inputs(now, lines.sight(seen, rate)), lines.known(now)])

        return self.series.weights @ jax.vmap(at)(self.series.places * self.period, seen, rate)

    def lacking(self, numbers: Float[Array, "function line"]) -> Float[Array, "function line"]:
        """Residual: the curves that follow from the inputs, minus the given curves."""
        return self.coordinates(numbers) @ self.lines.seen.T / self.size[None] - numbers

    def coordinates(self, numbers: Float[Array, "function line"]) -> Float[Array, "function coordinate"]:
        """Coefficients of the coordinates that follow from the curves [rad, m]."""
        mean, cosine, sine = self.series.apart(self._inputs(numbers))
        waves = jax.lax.complex(cosine, -sine)
        amplitudes = jnp.einsum("hci,hi->hc", self.answers[1:], waves)
        still = (self.answers[0].real @ mean)[None]
        return jnp.concatenate([still, amplitudes.real, -amplitudes.imag])


def _posed(problem: Problem, series: Series) -> OfOutput | OfStructure:
    return (OfOutput if problem.scene.springs_apart else OfStructure)(problem, series)


@eqx.filter_jit
def _harmonic_balance(problem: Problem, harmonics: int, samples: int, guess: Array | None, max_steps: int) -> Periodic:
    period, series = problem.period, Series.of(harmonics, samples, problem.period.dtype)
    posed = _posed(problem, series)
    if guess is None:
        rest = posed.resting()
        curve = jnp.broadcast_to(rest, (samples, *rest.shape))
    else:
        begins = jnp.linspace(0.0, 1.0, guess.shape[0] + 1).astype(period.dtype)[:-1]
        curve = posed.seen(jax.vmap(lambda one: jnp.interp(series.places, begins, one, period=1.0), 1, 1)(guess))
    solver, start = optimistix.Newton(rtol=1e-10, atol=1e-10), series.weights @ curve

    def left(numbers: Array, problem: Problem) -> Array:
        """Coefficients of the residual."""
        return _posed(problem, series).lacking(numbers)

    numbers = optimistix.root_find(left, solver, start, problem, max_steps=max_steps, throw=False).value
    rest = jnp.abs(posed.lacking(numbers)).max() / jnp.abs(numbers).max()
    place, speed, _ = series.motion(posed.coordinates(numbers), period)
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
