"""Periodic response as a Fourier series: harmonic balance.

The unknowns are Fourier coefficients of lines (`gearjax.analysis.modes.lines`): of the approach at each contact if
levers are constant and contacts are few, otherwise of the coordinates. The structure with the mean springs of its
contacts answers the inputs of the lines by its receptance, harmonic by harmonic. The inputs are evaluated in time, and
fast Fourier transforms take one to the other. Newton's method finds the coefficients, and the implicit function theorem
gives their derivatives (`jax.lax.custom_root`). For many coefficients, such as those of a hunting period, no matrix is
formed: GMRES solves for each step. It needs few iterations, because the mean springs are a part of the receptance.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax import arguments
from gearjax.analysis.equation import LENGTH_SCALE
from gearjax.analysis.modes import Driving, Lines, StructureEquation
from gearjax.analysis.periodic import Periodic
from gearjax.analysis.return_map import Problem
from gearjax.batches import in_batches
from gearjax.checks import ParameterError, SceneError
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike, Bool, Complex, Float, Scalar

TOLERANCE = 1e-10  # of Newton's method, relative
ROUNDED = 1e-6  # residual below which a step that does not make it smaller is the last: in float32 it is rounding
MATRIX = 2000  # unknowns up to which Newton's method has a matrix
ROUGH = 1e-3  # relative error of its steps without a matrix; the next step corrects it
KRYLOV = (12, 3), (40, 3)  # iterations of GMRES before it restarts and its starts, in easy and in hard equations
SLOWEST = 0.5  # share of the residual that a step without a matrix may leave; more means that it leads nowhere
BALANCED = 1e-6  # residual up to which a motion counts as a solution
AT_ONCE = 256  # places whose excitation and static equilibrium are found together


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

    The ``residual`` of the result contains the harmonics of the series alone: what further harmonics would change shows
    in a second run with more of them, or by `shooting`.

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
    samples = check_samples(harmonics, samples)
    problem = Problem.of(scene, torque, period)
    if guess is not None:
        names, shape = problem.scene.coordinates, jnp.shape(guess)
        wanted = shape[:1] if problem.scene.output_alone else (*shape[:1], len(names))
        if not shape or 0 in shape or shape != wanted:
            words = "the transmission error over the period, shape (n,)"
            if not problem.scene.output_alone:
                words = f"{', '.join(names)} over the period, shape (n, {len(names)})"
            raise ParameterError("guess", shape, f"is a shape: give {words}")
        guess = jnp.asarray(guess, scene.dtype).reshape(shape[0], -1)
    return _harmonic_balance(problem, harmonics, samples, guess, max_steps)


def check_samples(harmonics: int, samples: int | None) -> int:
    """The number of samples per period, by default 16 per harmonic; refused if too few for the harmonics."""
    samples = 16 * harmonics if samples is None else samples
    if harmonics < 1 or samples < 2 * harmonics + 1:
        raise SceneError(f"harmonics = {harmonics}, samples = {samples}: needs at least 2 harmonics + 1 samples")
    return samples


class Balance(eqx.Module):
    """The equations of harmonic balance.

    The dynamic stiffness of each harmonic, including mean springs and dampers of the contacts, is
    ``Z = K + i w C - w^2 M``. Inputs act through G, and the lines see ``L Z^-1 G``.

    Args:
        lines: lines of the contacts.
        table: excitation at even places of the period, the first axis of each leaf.
        answers: complex displacement of the coordinates per input of a line, ``Z^-1 G``, of the mean and each harmonic.
        forced: complex displacement of the coordinates by the inputs that do not depend on the motion [rad, m].
        size: scaling of the lines [m, rad].
        period: the period [s].
        rest: coordinates of the static equilibrium at these places, shape (n, coordinate) [rad, m]; where there is
            none, those of the first place.
        carries: whether each contact carries in that equilibrium, shape (n, contact).
        rests: whether there is an equilibrium at all of these places.
    """

    lines: Lines
    table: Driving
    answers: Complex[Array, "harmonic coordinate line"]
    forced: Complex[Array, "harmonic coordinate"]
    size: Float[Array, " line"]
    period: Scalar
    rest: Float[Array, "n coordinate"]
    carries: Bool[Array, "n contact"]
    rests: Bool[Array, ""]

    @classmethod
    def of(cls, problem: Problem, harmonics: int, samples: int) -> "Balance":
        """The equations for a number of harmonics, with forces evaluated at a number of even places."""
        period = problem.period
        equation = StructureEquation.of(problem.scene, problem.torque)
        lines = Lines.of(equation, equation.excitation(jnp.zeros_like(period)))
        lengths = jnp.full(lines.seen.shape[:1], LENGTH_SCALE, equation.scale.dtype)

        def at(time: Scalar) -> tuple[Driving, Array, Array]:
            now = equation.excitation(time)
            return lines.driven(now), *equation.resting(now.jacobian, now.gap, now.springs, now.torque)

        times = places(samples, period.dtype) * period
        table, rest, forces = in_batches(at, times, AT_ONCE)
        rests = jnp.isfinite(rest).all()
        rest = jnp.where(jnp.isfinite(rest), rest, rest[:1])
        answers = _answers(lines, 2 * jnp.pi / period * jnp.arange(harmonics + 1).astype(period.dtype))
        answers, known = jnp.split(answers, [len(lines.seen)], axis=2)
        forced = jnp.einsum("hci,hi->hc", known, amplitudes(jax.vmap(lines.known)(table), harmonics))
        size = lengths if lines.apart else equation.scale
        return cls(lines, table, answers, forced, size, period, rest, forces > 0, rests)

    @property
    def samples(self) -> int:
        """Number of places at which forces are evaluated."""
        return self.table.gap.shape[0]

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return self.answers.shape[0] - 1

    @property
    def scale(self) -> Float[Array, " coordinate"]:
        """Coordinates per scaled coordinate [rad, m]."""
        return self.lines.equation.scale

    def seen(self, place: Float[Array, "n coordinate"]) -> Float[Array, "n line"]:
        """The scaled unknown curves of the lines, from the coordinates over time."""
        return place @ self.lines.seen.T / self.size[None]

    def coefficients(self, curves: Float[Array, "n column"]) -> Float[Array, "function column"]:
        """Mean, cosines and sines of curves at the even places."""
        waves = amplitudes(curves, self.harmonics)
        return jnp.concatenate([waves.real, -waves[1:].imag])

    def waves(self, numbers: Float[Array, "function column"]) -> Complex[Array, "harmonic column"]:
        """Complex amplitudes of the mean and each harmonic, from the coefficients."""
        mean, cosine, sine = jnp.split(numbers, [1, self.harmonics + 1])
        return jax.lax.complex(jnp.concatenate([mean, cosine]), jnp.concatenate([jnp.zeros_like(mean), -sine]))

    def values(self, waves: Complex[Array, "harmonic column"]) -> Float[Array, "n column"]:
        """Values of curves at the even places, from complex amplitudes."""
        return jnp.fft.irfft(waves.at[1:].multiply(0.5) * self.samples, self.samples, axis=0)

    def rates(self, waves: Complex[Array, "harmonic column"]) -> Float[Array, "n column"]:
        """Rates of curves at the even places, from complex amplitudes."""
        order = 2 * jnp.pi / self.period * jnp.arange(self.harmonics + 1).astype(self.period.dtype)[:, None]
        return self.values(jax.lax.complex(-order * waves.imag, order * waves.real))

    def answer(
        self, numbers: Float[Array, "function line"], carries: Bool[Array, "n contact"] | None = None
    ) -> Complex[Array, "harmonic coordinate"]:
        """Complex amplitudes of the coordinates that follow from the curves of the lines [rad, m].

        Args:
            numbers: coefficients of the curves, scaled.
            carries: contacts that carry whatever the curves are; ``None`` for those that touch.
        """
        lines, waves = self.lines, self.waves(numbers * self.size[None])
        seen = self.values(waves)
        rate = self.rates(waves) if lines.hears_speed else jnp.zeros_like(seen)

        def at(now: Driving, seen: Array, rate: Array, carries: Array | None) -> Array:
            return lines.inputs(now, lines.sight(seen, rate), carries)

        inputs = amplitudes(jax.vmap(at)(self.table, seen, rate, carries), self.harmonics)
        return jnp.einsum("hci,hi->hc", self.answers, inputs) + self.forced

    def lacking(self, numbers: Float[Array, "function line"]) -> Float[Array, "function line"]:
        """Residual: the curves that follow from the inputs, minus the given curves."""
        answer = self.answer(numbers) @ self.lines.seen.T.astype(self.answers.dtype)
        return jnp.concatenate([answer.real, -answer.imag[1:]]) / self.size[None] - numbers

    def motion(self, waves: Complex[Array, "harmonic coordinate"], rest: Scalar, balanced: float) -> Periodic:
        """The motion of some complex amplitudes of the coordinates, with what they lack in the equation of motion."""
        scene, place, speed = self.lines.equation.scene, self.values(waves), self.rates(waves)
        unknown = jnp.full((2 * place.shape[1],), jnp.nan, self.period.dtype)
        state, supported = jnp.stack([place[0], speed[0]]), not scene.output_alone
        return Periodic(
            places(self.samples, self.period.dtype) * self.period,
            place[:, 0],
            speed[:, 0],
            jax.lax.complex(unknown, unknown),
            rest,
            jnp.where((rest <= balanced) & jnp.isfinite(rest), 0, 1),
            state if supported else state[:, 0],
            place[:, 1:] if supported else None,
            scene.coordinates,
        )


def places(samples: int, dtype: jnp.dtype) -> Float[Array, " n"]:
    """Even places of a period, as fractions of it."""
    return jnp.arange(samples).astype(dtype) / samples


def amplitudes(curves: Float[Array, "n column"], harmonics: int) -> Complex[Array, "harmonic column"]:
    """Complex amplitudes of the mean and each harmonic of curves at even places of a period."""
    waves = jnp.fft.rfft(curves, axis=0)[: harmonics + 1] / curves.shape[0]
    return waves.at[1:].multiply(2.0)


def _answers(lines: Lines, rates: Float[Array, " harmonic"]) -> Complex[Array, "harmonic coordinate input"]:
    """Complex displacement of the coordinates per input of the lines at some angular frequencies [rad/s]."""
    size, mass = lines.equation.scale, lines.equation.structure.mass
    stiffness, damping = lines.whole

    def of(rate: Scalar) -> Array:
        both = jnp.outer(size, size)
        whole = jax.lax.complex((stiffness - rate**2 * mass) * both, rate * damping * both)
        answer = jnp.linalg.solve(whole, (size[:, None] * lines.acting).astype(whole.dtype))
        return size.astype(answer.dtype)[:, None] * answer

    return jax.vmap(of)(rates)


def _root(lacking: Callable[[Array], Array], start: Array, max_steps: int) -> tuple[Array, Scalar]:
    """Coefficients at which nothing is lacking, by Newton's method, and what is lacking over the largest of them.

    The latter has no derivative. The coefficients have those of the implicit function theorem.
    """
    begin = jax.lax.stop_gradient(start)
    by_matrix = start.size <= MATRIX

    def search(lacking: Callable[[Array], Array], begin: Array) -> tuple[Array, Array]:
        def step(now: Newton) -> Newton:
            numbers = now.numbers - now.way
            if by_matrix:
                slope, left = jax.jacfwd(lambda flat: (lacking(flat.reshape(begin.shape)).ravel(),) * 2, has_aux=True)(
                    numbers.ravel()
                )
                way = jnp.linalg.solve(slope, left)
            else:
                left, along = jax.linearize(lacking, numbers)
                way = _without_matrix(along, left, ROUGH)
            largest = jnp.abs(left).max()
            rest = largest / jnp.where(largest == 0, 1.0, jnp.abs(numbers).max())  # zero also where nothing moves
            return Newton(now.steps + 1, numbers, way.reshape(begin.shape), rest, now.rest)

        def going_on(now: Newton) -> Array:
            leads = True if by_matrix else now.rest < SLOWEST * now.before
            rounded = (now.rest < ROUNDED) & (now.rest >= now.before)
            unfinished = (now.rest > TOLERANCE) & jnp.isfinite(now.rest) & leads & ~rounded
            return (now.steps < 0) | ((now.steps < max_steps) & unfinished)

        unknown = jnp.full_like(begin[0, 0], jnp.inf)
        first = Newton(jnp.asarray(-1), begin, jnp.zeros_like(begin), unknown, unknown)
        found = jax.lax.while_loop(going_on, step, first)
        return found.numbers, found.rest

    def solve(linear: Callable[[Array], Array], right: Array) -> Array:
        if not by_matrix:
            # the tolerance of GMRES depends on the right side, which has no transpose of its own
            accurate = partial(_without_matrix, accuracy=TOLERANCE)
            return jax.lax.custom_linear_solve(linear, right, accurate, transpose_solve=accurate)
        slope = jax.jacfwd(lambda flat: linear(flat.reshape(right.shape)).ravel())(jnp.zeros_like(right).ravel())
        return jnp.linalg.solve(slope, right.ravel()).reshape(right.shape)

    numbers, rest = jax.lax.custom_root(lacking, begin, search, solve, has_aux=True)
    return numbers, jax.lax.stop_gradient(rest)


class Newton(NamedTuple):
    """Newton's method on the way.

    Args:
        steps: number of steps taken, -1 before the first evaluation.
        numbers: coefficients.
        way: the step that follows, to be subtracted.
        rest: what is lacking, over the largest coefficient.
        before: the same a step before.
    """

    steps: Array
    numbers: Array
    way: Array
    rest: Scalar
    before: Scalar


def _without_matrix(linear: Callable[[Array], Array], right: Array, accuracy: float) -> Array:
    """Solution of linear equations by GMRES, to a relative accuracy.

    An iteration takes time with the size of its basis, whether filled or not, and easy equations need a small one only.
    """
    tolerance = max(accuracy, 10 * float(jnp.finfo(right.dtype).eps))

    def solve(size: int, starts: int, begin: Array) -> Array:
        return jax.scipy.sparse.linalg.gmres(
            linear, right, begin, tol=tolerance, restart=size, maxiter=starts, solve_method="incremental"
        )[0]

    first = solve(*KRYLOV[0], jnp.zeros_like(right))
    left = jnp.linalg.norm(right - linear(first)) > tolerance * jnp.linalg.norm(right)
    return jax.lax.cond(left, lambda begin: solve(*KRYLOV[1], begin), lambda begin: begin, first)


@eqx.filter_jit
def _harmonic_balance(problem: Problem, harmonics: int, samples: int, guess: Array | None, max_steps: int) -> Periodic:
    period = problem.period
    balance = Balance.of(problem, harmonics, samples)
    if guess is None:
        curve = balance.seen(jax.lax.stop_gradient(balance.rest))
    else:
        begins, ends = places(guess.shape[0], period.dtype), places(samples, period.dtype)
        curve = balance.seen(jax.vmap(lambda one: jnp.interp(ends, begins, one, period=1.0), 1, 1)(guess))
    numbers, rest = _root(lambda numbers: balance.lacking(numbers), balance.coefficients(curve), max_steps)
    return balance.motion(balance.answer(numbers), rest, BALANCED)
