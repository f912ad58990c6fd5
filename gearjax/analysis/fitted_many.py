"""The exponentially fitted scheme for many degrees of freedom, by splitting off the dampers.

Between changes of contact ``M q'' + C q' + K q = F``, springs and dampers of the closed contacts included. With the
step h, ``Z = h^2 M^-1 K`` and ``A = h M^-1 C``

    q+ - q = e^-A (q - q- + p) + p,     p = (1 - cos sqrt Z) Z^-1 h^2 M^-1 (F - K q)

(Gautschi 1961, Hochbruck and Lubich 1999, the dampers by Strang splitting): exact for undamped oscillators under
constant F, of second order with dampers and where contacts open or close. Both functions are entire, so that a few
products of matrix and vector are enough: no modes, no factors.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import diffrax
import jax.numpy as jnp

from gearjax.analysis.fitted import OscillatorTerm
from gearjax.typing import Array, Float

TERMS = 8  # of a series; enough for 1 rad of the fastest mode per step and a damping exponent of 1


class States(NamedTuple):
    """The oscillator of the current contact state, per step.

    Args:
        push: ``h^2 M^-1 (F - K q)``, shape (dof,).
        stiffness: ``Z``, shape (dof, dof).
        damping: ``A``, shape (dof, dof).
    """

    push: Float[Array, " dof"]
    stiffness: Float[Array, "dof dof"]
    damping: Float[Array, "dof dof"]


class ExponentialFitMany(diffrax.AbstractSolver):
    """The scheme as a solver of diffrax, for even steps of one unit of time.

    Its term is an `OscillatorTerm` whose vector field is `States`; the solution holds positions and velocities per
    step, shape (2, dof).
    """

    term_structure: ClassVar = OscillatorTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 2

    def init(self, terms, t0, t1, y0, args):
        """The last change of position, from position and velocity per step."""
        now = terms.vf(t0, y0, args)
        return _odd(now, _decayed(now, -1.0, y0[1])) - _even(now, now.push)

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del made_jump
        now = terms.vf(t0, y0, args)
        pushed = _even(now, now.push)
        change = _decayed(now, 1.0, _decayed(now, 1.0, solver_state + pushed)) + pushed
        # half of the damping, the oscillator alone, the other half
        begun = _inverse_odd(now, change - pushed)
        y1 = jnp.stack([y0[0] + change, _decayed(now, 1.0, _cosine(now, begun) + _odd(now, now.push))])
        return y1, None, {"y0": y0, "y1": y1}, change, diffrax.RESULTS.successful


def _series(matrix: Array, vector: Array, ratios: list[float]) -> Array:
    """``sum c_k matrix^k vector`` by Horner's rule; each coefficient over the one before, after a first of 1."""
    total = vector
    for ratio in reversed(ratios):
        total = vector + ratio * (matrix @ total)
    return total


def _decayed(now: States, sign: float, vector: Array) -> Array:
    """``e^(-sign A/2)`` times a vector."""
    return _series(now.damping, vector, [-0.5 * sign / k for k in range(1, TERMS + 4)])


def _cosine(now: States, vector: Array) -> Array:
    """``cos sqrt Z`` times a vector."""
    return _series(now.stiffness, vector, [-1 / ((2 * k - 1) * 2 * k) for k in range(1, TERMS)])


def _odd(now: States, vector: Array) -> Array:
    """``sin(sqrt Z) / sqrt Z`` times a vector."""
    return _series(now.stiffness, vector, [-1 / (2 * k * (2 * k + 1)) for k in range(1, TERMS)])


def _even(now: States, vector: Array) -> Array:
    """``(1 - cos sqrt Z) / Z`` times a vector."""
    return 0.5 * _series(now.stiffness, vector, [-1 / ((2 * k + 1) * (2 * k + 2)) for k in range(1, TERMS)])


def _inverse_odd(now: States, vector: Array) -> Array:
    """``sqrt Z / sin sqrt Z`` times a vector."""
    identity = jnp.eye(vector.shape[0], dtype=vector.dtype)
    return jnp.linalg.solve(_odd(now, identity), vector)
