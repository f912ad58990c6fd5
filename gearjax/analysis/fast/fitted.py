"""Exponentially fitted two-step scheme, exact for the oscillator of the current contact state.

While no contact opens or closes, the output obeys ``x'' + d x' + w x = F``. With the step h, ``u = d h / 2`` and
``z = w h^2``, the exact solution for constant F satisfies

    x+ - x = e^(-2u) (x - x-) + 2 e^(-u) D(z) h^2 (F - w x),     D(z) = (cosh u - cos sqrt(z - u^2)) / z

(Gautschi 1961; here with damping). D is an entire function of z, so that no square root is needed, and a step needs one
force. The scheme is of second order if F changes, or if a contact opens or closes within a step.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import jax.numpy as jnp

from gearjax.typing import Array


class State(NamedTuple):
    """Oscillator of the current contact state, per step.

    Args:
        push: ``h^2 (F - w x)``, acceleration without the part of the damper, times the step squared.
        stiffness: ``z = w h^2``.
        damping: ``u = d h / 2``.
        decay: ``e^-u``.
    """

    push: Array
    stiffness: Array
    damping: Array
    decay: Array


def advance(change: Array, state: State) -> Array:
    """Change of position over the next step, from the change over the last step."""
    kept = state.decay * state.decay
    return kept * change + 2 * state.decay * _even(state.stiffness, state.damping) * state.push


def velocity(change: Array, state: State, rise: Array | float = 0.0) -> Array:
    """Velocity times step, from the change of position over the step that follows.

    Args:
        change: change of position over the step.
        state: oscillator at the start of the step.
        rise: growth of the push over the step by its excitation alone, at a fixed position.
    """
    even, odd = _even(state.stiffness, state.damping), _odd(state.stiffness, state.damping)
    pushed = (even + state.damping * odd) * state.push + rise * _ramp(state, 1.0) / state.decay
    return (change / state.decay - pushed) / _sine(state.stiffness, state.damping)


def change_before(speed: Array, state: State, rise: Array | float = 0.0) -> Array:
    """Change of position over the step before, from velocity times step; other arguments as for `velocity`."""
    even, odd = _even(state.stiffness, state.damping), _odd(state.stiffness, state.damping)
    moved = speed * _sine(state.stiffness, state.damping) - (even - state.damping * odd) * state.push
    return moved / state.decay + rise * _ramp(state, -1.0)


def _ramp(state: State, sign: float) -> Array:
    """Change of position by a push that grows linearly from zero, over a step forwards (sign 1) or backwards (-1)."""
    damping = sign * state.damping
    even, odd = _even(state.stiffness, damping), _odd(state.stiffness, damping)
    kept = state.decay if sign > 0 else 1 / state.decay
    stiff = state.stiffness > 1e-4
    left = 1.0 - kept * (_sine(state.stiffness, damping) + 2 * damping * (even + damping * odd))
    return jnp.where(stiff, left / jnp.where(stiff, state.stiffness, 1.0), 1 / 6 - damping / 12)


def velocity_after(change: Array, state: State) -> Array:
    """Velocity times step at the end of a step, from the change of position over it and the state at its start."""
    even, odd = _even(state.stiffness, state.damping), _odd(state.stiffness, state.damping)
    push = state.push - state.stiffness * change
    return (state.decay * change + (even - state.damping * odd) * push) / _sine(state.stiffness, state.damping)


def _even(stiffness: Array, damping: Array) -> Array:
    """``(cosh u - cos sqrt(z - u^2)) / z``."""
    return _divided(stiffness, damping, (1 / 2, 12.0, 30.0, 56.0, 90.0))


def _odd(stiffness: Array, damping: Array) -> Array:
    """``(sinh(u) / u - sin(s) / s) / z`` with ``s^2 = z - u^2``."""
    return _divided(stiffness, damping, (1 / 6, 20.0, 42.0, 72.0, 110.0))


def _divided(stiffness: Array, damping: Array, ratios: tuple[float, ...]) -> Array:
    """Divided difference of a power series between ``-u^2`` and ``z - u^2``.

    ``ratios`` are its first coefficient, then the ratios of each coefficient to the next.
    """
    low = -damping * damping
    high = stiffness + low
    coefficient, total = ratios[0], ratios[0]
    mixed = power = jnp.ones_like(stiffness)
    for ratio in ratios[1:]:
        coefficient = -coefficient / ratio
        power = power * low
        mixed = mixed * high + power  # sum of high^i low^j over i + j
        total = total + coefficient * mixed
    return jnp.asarray(total, stiffness.dtype)


def _sine(stiffness: Array, damping: Array) -> Array:
    """``sin(s) / s`` with ``s^2 = z - u^2``."""
    place = stiffness - damping * damping
    total = jnp.ones_like(place)
    for ratio in (210, 156, 110, 72, 42, 20, 6):
        total = 1.0 - place * total / ratio
    return total


class OscillatorTerm(diffrax.AbstractTerm):
    """A term of diffrax whose vector field is the `State` of an oscillator at a time and position.

    Args:
        state: ``state(time, position, args)``, the `State` for steps of one unit of time.
    """

    state: Callable[[Any, Array, Any], Any]

    def vf(self, t, y, args):
        return self.state(t, y[0], args)

    def contr(self, t0, t1, **kwargs):
        return t1 - t0

    def prod(self, vf, control):
        return jnp.stack([control * vf.push, vf.push])


class ExponentialFit(diffrax.AbstractSolver):
    """The scheme as a solver of diffrax, for one degree of freedom and even steps of one unit of time.

    Its term is an `OscillatorTerm`. The solution is the position and the velocity per step, shape (2,).
    """

    term_structure: ClassVar = OscillatorTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 2

    def init(self, terms, t0, t1, y0, args):
        return change_before(y0[1], terms.vf(t0, y0, args))

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del made_jump
        now = terms.vf(t0, y0, args)
        change = advance(solver_state, now)
        y1 = jnp.stack([y0[0] + change, velocity_after(change, now)])
        return y1, None, {"y0": y0, "y1": y1}, change, diffrax.RESULTS.successful
