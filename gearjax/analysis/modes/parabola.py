"""Steps of a linear structure under inputs that are parabolas in time: exact for modes of any rate.

    x' = A x + B u(t),     u is the parabola through u_n-1, u_n and u_n+1 on the step from n to n + 1

    x_n+1 = E x_n + W_ u_n-1 + W0 u_n + W+ u_n+1
    E = e^(h A),  W+ = (phi_2 / 2 + phi_3) h B,  W0 = (phi_1 - 2 phi_3) h B,  W_ = (phi_3 - phi_2 / 2) h B

with ``phi_k = int_0^1 e^((1 - s) h A) s^(k-1) / (k-1)! ds`` (Hochbruck and Ostermann 2010). One matrix exponential
gives all four (Al-Mohy and Higham 2011, theorem 2.1). Rigid, overdamped and repeated modes need no special case, and
derivatives with respect to mass, stiffness and damping are those of the exponential.

If the slope of the input changes by s within the step, at the time ``theta h``, two parabolas contain the kink, that of
this step and that of the next. Together they miss, to leading order,

    (W+ + W0 + W_) s h (1/12 - theta (1 - theta) / 2),       and for a jump by j:  (W+ + W0 + W_) j (1/2 - theta).

The first is ``(1 - theta)^2 / 2`` minus ``5/12 (1 - theta)`` of this parabola and ``-theta / 12`` of the next; the
second is ``1 - theta`` minus ``5/12`` and ``1/12``.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import jax
import jax.numpy as jnp

from gearjax.elimination import solved_definite
from gearjax.structure import Structure
from gearjax.typing import Array, Float, Scalar

SMALL, TERMS = 0.5, 14  # norm of a matrix for which so many terms of the series are enough
MOST_SQUARINGS = 32  # of the exponential; a support of 1e18 N/m needs some twenty


class Weights(NamedTuple):
    """Matrices of a step: effect of the state, shape (state, state), and of three inputs, shape (state, input)."""

    kept: Array
    after: Array
    now: Array
    before: Array

    @property
    def kink(self) -> Array:
        """Effect of the correction for a kink or a jump of the inputs, ``W+ + W0 + W_``."""
        return self.after + self.now + self.before


def weights(matrix: Float[Array, "state state"], inputs: Float[Array, "state input"]) -> Weights:
    """Weights of a step.

    Args:
        matrix: ``h A``.
        inputs: ``h B``.
    """
    states, number = inputs.shape
    size = jnp.max(jnp.abs(inputs))
    size = jnp.where(size > 0, size, 1.0)
    wide = jnp.zeros((states + 3 * number,) * 2, matrix.dtype)
    wide = wide.at[:states, :states].set(matrix).at[:states, states : states + number].set(inputs / size)
    wide = wide.at[states : states + 2 * number, states + number :].set(jnp.eye(2 * number, dtype=matrix.dtype))
    rows = exponential(wide)[:states]
    one, two, three = (size * rows[:, states + k * number : states + (k + 1) * number] for k in range(3))
    return Weights(rows[:, :states], 0.5 * two + three, one - 2 * three, three - 0.5 * two)


def exponential(matrix: Float[Array, "state state"]) -> Float[Array, "state state"]:
    """Matrix exponential, by its series and squarings (Moler and Van Loan 2003).

    The exponential of JAX is not used: in batches that are shared between devices it never ends (jaxlib 0.10 on CPUs).
    """
    size = jax.lax.stop_gradient(jnp.abs(matrix).sum(axis=0).max())
    squarings = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(size, SMALL) / SMALL)), 0, MOST_SQUARINGS)
    small, unit = matrix * 2.0**-squarings, jnp.eye(len(matrix), dtype=matrix.dtype)
    series = unit
    for term in range(TERMS, 0, -1):
        series = unit + (small @ series) / term

    def square(power: Array, number: Array) -> tuple[Array, None]:
        return jax.lax.cond(number < squarings, lambda part: part @ part, lambda part: part, power), None

    return jax.lax.scan(square, series, jnp.arange(MOST_SQUARINGS).astype(size.dtype))[0]


class Scaled(NamedTuple):
    """First-order form of the structure, with positions and velocities scaled to numbers of similar size.

    Args:
        matrix: ``h A``, shape (state, state).
        inputs: ``h B``, per force on each coordinate, shape (state, coordinate).
        place: matrix from a state to the coordinates, shape (coordinate, state) [rad, m].
        speed: matrix from a state to the velocities, shape (coordinate, state) [rad/s, m/s].
        back: matrix from coordinates and velocities to a state, shape (state, 2 coordinate).
    """

    matrix: Array
    inputs: Array
    place: Array
    speed: Array
    back: Array

    @classmethod
    def of(cls, structure: Structure, stiffness: Array, damping: Array, step: Scalar) -> "Scaled":
        """Scale positions by the root of their mass, and velocities also by their rate, if it is above one per step.

        Args:
            structure: structure that gives the masses.
            stiffness, damping: matrices of the structure and of mean springs and dampers of the contacts, shape
                (coordinate, coordinate).
            step: length of a step [s].
        """
        root = jnp.sqrt(jnp.diagonal(structure.mass))
        mass = structure.mass / jnp.outer(root, root)
        parts = [stiffness / jnp.outer(root, root), damping / jnp.outer(root, root), jnp.diag(1 / root)]
        springs, dampers, pushes = jnp.split(solved_definite(mass, jnp.concatenate(parts, axis=1)), 3, axis=1)
        springs, dampers = step**2 * springs, step * dampers
        rate = jnp.sqrt(jnp.maximum(jnp.abs(jnp.diagonal(springs)), 1.0))
        nothing = jnp.zeros_like(mass)
        per_rate = 1 / rate[:, None]
        matrix = jnp.block([[nothing, jnp.diag(rate)], [-per_rate * springs, -per_rate * dampers * rate[None, :]]])
        pushed = step**2 * per_rate * pushes
        place = jnp.concatenate([jnp.diag(1 / root), nothing], axis=1)
        speed = jnp.concatenate([nothing, jnp.diag(rate / root) / step], axis=1)
        back = jnp.block([[jnp.diag(root), nothing], [nothing, jnp.diag(root / rate) * step]])
        return cls(matrix, jnp.concatenate([nothing, pushed]), place, speed, back)


class ForcedTerm(diffrax.AbstractTerm):
    """A term of diffrax whose vector field is the input of a structure.

    Args:
        push: ``push(time, state, args)``, the input u, shape (input,), for steps of one unit of time.
    """

    push: Callable[[Any, Array, Any], Array]

    def vf(self, t, y, args):
        return self.push(t, y, args)

    def contr(self, t0, t1, **kwargs):
        return t1 - t0

    def prod(self, vf, control):
        return control * vf


class ExponentialParabola(diffrax.AbstractSolver):
    """The scheme as a solver of diffrax, for ``x' = A x + B u(t, x)`` and even steps of one unit of time.

    It is of third order, and exact if u is a parabola in time. Its term is a `ForcedTerm`. Kinks are not corrected.

    Args:
        matrix: ``h A`` with the step h, shape (state, state).
        inputs: ``h B``, shape (state, input).
    """

    term_structure: ClassVar = ForcedTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = diffrax.LocalLinearInterpolation
    matrix: Array
    inputs: Array
    weights: Weights

    def __init__(self, matrix: Array, inputs: Array):
        self.matrix, self.inputs, self.weights = matrix, inputs, weights(matrix, inputs)

    def order(self, terms):
        return 3

    def init(self, terms, t0, t1, y0, args):
        """Inputs now, and those a step before, extrapolated by their slope."""
        now = terms.vf(t0, y0, args)
        along = jnp.ones_like(t0), self.matrix @ y0 + self.inputs @ now
        _, slope = jax.jvp(lambda time, state: terms.vf(time, state, args), (t0, y0), along)
        return now, now - slope

    def func(self, terms, t0, y0, args):
        return self.matrix @ y0 + self.inputs @ terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del made_jump
        now, before = solver_state
        part = self.weights
        free = part.kept @ y0 + part.now @ now + part.before @ before
        after = terms.vf(t1, free + part.after @ (2 * now - before), args)
        y1 = free + part.after @ after
        return y1, None, {"y0": y0, "y1": y1}, (after, now), diffrax.RESULTS.successful
