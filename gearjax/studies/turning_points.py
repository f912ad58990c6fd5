"""Turning points of curves between samples, many at once and differentiable: what a search follows.

`gearjax.analysis.extremes` finds the highest one more closely, from values alone. Here slopes are known anyway, as the
derivatives of every turning point need them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from gearjax.typing import Array, Bool, Float, Int, Scalar


class TurningPoints(NamedTuple):
    """Local maxima of a curve between its samples.

    The value at a turning point is taken where the tangents on its two sides meet. This is exact at a kink; at a smooth
    top it is too high by an amount that goes with the square of the angle between the two sides. With the place held
    fixed, the value is a constant plus a convex combination of the curve on both sides, whose weights cancel the slope.
    It is therefore differentiable in the parameters of the curve.

    Args:
        ends: input angles on both sides, shape (..., 2) [rad].
        weights: weights of the curve at these angles, with sum 1, or -1 for minima, shape (..., 2).
        lift: the constant, shape (...,).
        heights: values of the maxima, minus infinity if there is no turning point, shape (...,).
    """

    ends: Float[Array, "*shape 2"]
    weights: Float[Array, "*shape 2"]
    lift: Float[Array, "*shape"]
    heights: Float[Array, "*shape"]

    def values(self, sides: Float[Array, "*shape 2"]) -> Float[Array, "*shape"]:
        """Values at the turning points, shape (...,), differentiable in the parameters of the curve.

        Args:
            sides: values of the curve at `ends`, shape (..., 2).
        """
        return (self.weights * sides).sum(axis=-1) + self.lift


SlopeAndValue = Callable[[Scalar], tuple[Scalar, Scalar]]


def slope_and_value(curve: Callable[[Any, Scalar], Scalar], physics: Any) -> SlopeAndValue:
    """A function that returns slope and value of ``curve(physics, theta)`` at one angle."""

    def at(angle: Scalar) -> tuple[Scalar, Scalar]:
        value, slope = jax.jvp(lambda a: curve(physics, a), (angle,), (jnp.ones_like(angle),))
        return slope, value

    return at


def turning_points(
    at: SlopeAndValue,
    signs: Float[Array, "*shape"],
    samples: tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]],
    intervals: Int[Array, "*shape"],
    *,
    splits: int,
) -> TurningPoints:
    """Turning points of ``signs`` times the curve in some intervals between samples.

    An interval is first split where the tangents at its ends meet: for two straight lines this is their kink, and for a
    parabola its middle. Of each split the side with the turning point is kept.

    Args:
        at: function that returns slope and value of the curve.
        signs: 1 for maxima, -1 for minima, of each interval, shape (...,).
        samples: input angles, slopes and values of the curve, shape (n,) each, at least two.
        intervals: numbers of the intervals, shape (...,).
        splits: number of splits.
    """
    # all intervals go through each step together: a loop for each of them would be traced again for every batch axis
    every = jax.vmap(at)

    def cut(state: _Sides, middle: Array) -> _Sides:
        slope, value = every(middle.reshape(-1))
        slope, value = signs * slope.reshape(middle.shape), signs * value.reshape(middle.shape)
        rises = slope > 0

        def keep(pair: tuple[Array, Array], new: Array) -> tuple[Array, Array]:
            return jnp.where(rises, new, pair[0]), jnp.where(rises, pair[1], new)

        return _Sides(*(keep(pair, new) for pair, new in zip(state, (middle, slope, value), strict=True)))

    def split(_: Any, state: _Sides) -> _Sides:
        start, span, turning = state.ends[0], state.span, state.turning
        rise, fall = state.slopes[0], -state.slopes[1]
        place = (state.values[1] - state.values[0] + fall * span) / jnp.where(turning, rise + fall, 1.0)
        # within the middle 90 %, so that the interval shrinks even if the curve is bent on one side only
        place = jnp.where(turning, jnp.clip(place, 0.05 * span, 0.95 * span), 0.5 * span)
        return cut(state, start + place)

    both = [(part[intervals], part[intervals + 1]) for part in samples]
    state = _Sides(both[0], *((signs * part[0], signs * part[1]) for part in both[1:]))
    return jax.lax.fori_loop(0, splits, split, state).turning_points(signs)


class _Sides(NamedTuple):
    """Both sides of intervals: their input angles, and slopes and values of a curve there."""

    ends: tuple[Array, Array]
    slopes: tuple[Array, Array]
    values: tuple[Array, Array]

    @property
    def span(self) -> Array:
        """Length of the intervals [rad]."""
        return self.ends[1] - self.ends[0]

    @property
    def turning(self) -> Bool[Array, "*shape"]:
        """Whether the curve, which rises at one end of an interval and falls at the other, turns within it."""
        rise, fall = self.slopes[0], -self.slopes[1]
        return (rise >= 0) & (fall >= 0) & (rise + fall > 0)

    def turning_points(self, signs: Array) -> TurningPoints:
        """The maxima where the tangents at both ends meet."""
        rise, fall, turning = self.slopes[0], -self.slopes[1], self.turning
        total = jnp.where(turning, rise + fall, 1.0)
        share = jnp.where(turning, fall / total, 0.5)
        lift = jnp.where(turning, rise * fall * self.span / total, 0.0)
        heights = jnp.where(turning, share * self.values[0] + (1.0 - share) * self.values[1] + lift, -jnp.inf)
        weights = jnp.stack([signs * share, signs * (1.0 - share)], axis=-1)
        return TurningPoints(jnp.stack(self.ends, axis=-1), weights, lift, heights)


def tangent_bounds(
    theta: Float[Array, " n"], values: Float[Array, " n"], slopes: Float[Array, " n"]
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Values at which the tangents at both ends of each interval meet, for the curve and for its negative.

    They are minus infinity for intervals without a turning point.
    """
    step = theta[1:] - theta[:-1]
    rise, fall = slopes[:-1], -slopes[1:]
    turning = rise * fall > 0
    meet = (fall * values[:-1] + rise * values[1:] + rise * fall * step) / jnp.where(turning, rise + fall, 1.0)
    top = turning & (rise > 0)
    return jnp.where(top, meet, -jnp.inf), jnp.where(turning & ~top, -meet, -jnp.inf)
