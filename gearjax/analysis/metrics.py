"""Metrics of a record, and extremes between its samples.

A transmission error is the largest of several smooth curves. Its lowest points are kinks where the contacting pair
changes; a sampled record misses them by slope times spacing (0.0022 arcmin at 1 ms for Wang et al. 2020). `extremes`
finds them. The tangents at the samples bound the extreme of each interval, the intervals with the best bounds are
bisected on the slope, and the value is taken where the tangents at the turning point meet. An extreme can still be
missed if an interval has two turning points, or if more than `MOST_INTERVALS` intervals have higher bounds.
"""

import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import is_concrete
from gearjax.contact import Layout
from gearjax.typing import Array, Bool, Float, Int, Scalar

FEWEST = 20.0  # angles per turn of the fastest rotation; with fewer, extremes between them may be missed
MOST_INTERVALS = 32
HALVINGS = 30  # bisections of an interval


class FewAngles(UserWarning):
    """Extremes of a curve may be missed, because it was evaluated at too few angles."""


def angles_per_turn(theta: Float[Array, "... n"], fastest_order: float) -> float:
    """Smallest number of angles per turn of the fastest rotation; infinite for a single angle.

    Args:
        theta: input angles, increasing, shape (n,) [rad].
        fastest_order: order of the fastest rotation, in turns per turn of the input.
    """
    angles = np.asarray(theta)
    if angles.shape[-1] < 2 or fastest_order <= 0:
        return math.inf
    return float(2 * math.pi / (np.diff(angles, axis=-1).max() * fastest_order))


def few_angles(theta: Float[Array, "... n"], fastest_order: float) -> str | None:
    """Warning about the extremes in words; ``None`` if there are enough angles."""
    fewest = angles_per_turn(theta, fastest_order)
    if fewest > FEWEST * (1 - 1e-3):
        return None
    angles = np.asarray(theta)
    needed = math.ceil(FEWEST * fastest_order * float((angles[..., -1] - angles[..., 0]).max()) / (2 * math.pi)) + 1
    return (
        f"only {fewest:.3g} angles per cycle of the fastest order ({fastest_order:.4g} cycles per turn of the input): "
        f"peak-to-peak and amplitude may miss extremes; {needed} evenly spaced angles are enough"
    )


def warn_of_few_angles(theta: Float[Array, "... n"], fastest_order: float) -> None:
    """Warn if extremes between the angles may be missed.

    One or two angles are not a curve, and traced angles are not known: neither gives a warning.
    """
    if not is_concrete(theta) or theta.shape[-1] < 3:
        return
    words = few_angles(theta, fastest_order)
    if words is not None:
        warnings.warn(words, FewAngles, stacklevel=3)


class Extremes(eqx.Module):
    """Highest and lowest value of a curve, and the input angles of both [rad]."""

    maximum: Scalar
    minimum: Scalar
    theta_maximum: Scalar
    theta_minimum: Scalar


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
    splits: int = 0,
    halvings: int = 0,
) -> TurningPoints:
    """Turning points of ``signs`` times the curve in some intervals between samples.

    An interval is first split where the tangents at its ends meet: for two straight lines this is their kink, and for a
    parabola its middle. Then it is halved, because differences of values become too small for tangents. Of each split
    the side with the turning point is kept.

    Args:
        at: function that returns slope and value of the curve.
        signs: 1 for maxima, -1 for minima, of each interval, shape (...,).
        samples: input angles, slopes and values of the curve, shape (n,) each, at least two.
        intervals: numbers of the intervals, shape (...,).
        splits: number of splits by tangents, which are quick and rough.
        halvings: number of halvings after the splits; in float32 at most 9 are made.
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

    def halve(_: Any, state: _Sides) -> _Sides:
        return cut(state, state.ends[0] + 0.5 * state.span)

    both = [(part[intervals], part[intervals + 1]) for part in samples]
    state = _Sides(both[0], *((signs * part[0], signs * part[1]) for part in both[1:]))
    if splits:
        state = jax.lax.fori_loop(0, splits, split, state)
    if halvings:
        number = halvings if samples[0].dtype == jnp.float64 else min(halvings, 9)
        state = jax.lax.fori_loop(0, number, halve, state)
    return state.turning_points(signs)


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


def extremes_of_samples(theta: Float[Array, " n"], values: Float[Array, " n"]) -> Extremes:
    """Highest and lowest value of the samples; unlike values between them, these need no further solution."""
    high, low = jnp.argmax(values), jnp.argmin(values)
    return Extremes(values[high], values[low], theta[high], theta[low])


def extremes(
    curve: Callable[[Any, Scalar], Scalar], physics: Any, theta: Float[Array, " n"], values: Float[Array, " n"]
) -> Extremes:
    """Extremes of ``curve(physics, theta)`` over the span of ``theta``, including kinks between samples.

    Differentiable in ``physics``.

    Args:
        curve: the curve.
        physics: its parameters, a pytree of arrays.
        theta: input angles of the samples, increasing, shape (n,).
        values: values of the samples, shape (n,).
    """
    if theta.shape[0] < 2:
        return Extremes(values[0], values[0], theta[0], theta[0])
    frozen, theta = jax.lax.stop_gradient((physics, theta))
    at = slope_and_value(curve, frozen)
    slopes, frozen_values = jax.vmap(at)(theta)

    bounds = tangent_bounds(theta, frozen_values, slopes)
    intervals = jnp.stack([highest_intervals(side, MOST_INTERVALS) for side in bounds])
    signs = jnp.array([1.0, -1.0], values.dtype)  # maximum of the curve, and maximum of its negative
    each = jnp.broadcast_to(signs[:, None], intervals.shape)
    points = turning_points(at, each, (theta, slopes, frozen_values), intervals, halvings=HALVINGS)
    highest = jnp.argmax(points.heights, axis=1)
    points = jax.lax.stop_gradient(jax.tree.map(lambda part: part[jnp.arange(2), highest], points))
    sides = jax.vmap(curve, in_axes=(None, 0))(physics, points.ends.reshape(-1))
    refined = signs * points.values(sides.reshape(points.ends.shape))
    at_sample = jnp.stack([jnp.argmax(values), jnp.argmin(values)])
    sampled = values[at_sample]
    better = (points.heights > -jnp.inf) & (signs * refined > signs * sampled)
    best = jnp.where(better, refined, sampled)
    where = jnp.where(better, points.ends.mean(axis=1), theta[at_sample])
    return Extremes(best[0], best[1], where[0], where[1])


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


def highest_intervals(bounds: Float[Array, " m"], number: int) -> Int[Array, " k"]:
    """Numbers of the intervals with the highest bounds, at most one from each of four times ``number`` equal groups.

    This is faster than sorting all intervals, and the neighbours of one top cannot displace other tops.
    """
    count = bounds.shape[0]
    groups = min(count, 4 * number)
    size = 1 << max(0, -(-count // groups) - 1).bit_length()
    groups = -(-count // size)
    filled = jnp.concatenate([bounds, jnp.full((groups * size - count,), -jnp.inf, bounds.dtype)])
    tops, places = filled.reshape(groups, size), jnp.arange(groups * size, dtype=jnp.int32).reshape(groups, size)
    while size > 1:  # keeps the higher half of each group, until one is left
        size //= 2
        better = tops[:, :size] >= tops[:, size:]
        tops = jnp.where(better, tops[:, :size], tops[:, size:])
        places = jnp.where(better, places[:, :size], places[:, size:])
    chosen = jax.lax.top_k(tops[:, 0], min(number, groups))[1]
    return jnp.minimum(places[chosen, 0], count - 1)


@jax.custom_jvp
def top(values: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Highest value along the last axis, with the derivative of that value.

    The built-in derivative of `max` compares each value with the maximum; in fused code the two may be rounded
    differently, and then no value matches.
    """
    return values.max(axis=-1)


@top.defjvp
def _top_jvp(primals: tuple, tangents: tuple) -> tuple:
    (values,), (slopes,) = primals, tangents
    where = jnp.argmax(values, axis=-1, keepdims=True)
    return top(values), jnp.take_along_axis(slopes, where, axis=-1)[..., 0]


def root(square: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root with derivative zero at zero, so that the deviation of a constant record has a gradient."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def deviation(record: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Standard deviation of each record."""
    centred = record - record.mean(axis=-1, keepdims=True)
    return root((centred * centred).mean(axis=-1))


def load_sharing(
    layout: Layout, forces: Float[Array, "... n contact"], carriers: Int[Array, "... n"] | int
) -> Float[Array, "... n"]:
    """`load_sharing_factor` of the pairs of a mesh; for a train the largest factor of its meshes.

    In a mesh of a train, the pairs that could carry are those of the side with the larger total force.
    """
    carried = layout.per_pair(forces)
    if not layout.mesh:
        return load_sharing_factor(carried, carriers)
    meshes = np.array([layout.mesh[members[0]] for members in layout.members])
    return jnp.stack([_sharing_of(layout, forces, carried, meshes == mesh) for mesh in set(layout.mesh)]).max(axis=0)


def _sharing_of(
    layout: Layout, forces: Float[Array, "... n contact"], carried: Float[Array, "... n pair"], inside: np.ndarray
) -> Float[Array, "... n"]:
    """Load sharing factor of the pairs inside one mesh of a train."""
    driving, back = (pairs[inside[pairs]] for pairs in layout.pairs_by_side)
    able = max(len(driving), len(back))
    if len(back) and len(back) != len(driving):
        within = inside[np.asarray(layout.pair)]
        pressed = [(forces * (within & (np.asarray(layout.side) == side))).sum(axis=-1) for side in (1, -1)]
        able = jnp.where(pressed[0] >= pressed[1], len(driving), len(back))
    return load_sharing_factor(carried[..., np.flatnonzero(inside)], able)


def load_sharing_factor(
    carried: Float[Array, "... n pair"], carriers: Int[Array, "... n"] | int
) -> Float[Array, "... n"]:
    """Load of the most loaded pair over the mean load of the pairs that could carry, shape (n,).

    It is 1 if the load is shared evenly, and the number of these pairs if one pair carries all. For planet wheels it is
    the mesh load factor ``K_gamma`` of ISO 6336-1 at each sample; nan without load.

    Args:
        carried: force of each pair, shape (n, pair) [N].
        carriers: number of pairs that could carry, shape (n,), or one number for all samples.
    """
    total = carried.sum(axis=-1)
    loaded = total > 0
    able = jnp.asarray(carriers, carried.dtype)
    return jnp.where(loaded, able * carried.max(axis=-1) / jnp.where(loaded, total, 1.0), jnp.nan)
