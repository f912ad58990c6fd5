"""Metrics of a record, and extremes that fall between its samples.

A transmission error is the largest of several smooth curves: its lowest points are kinks, where the contacting
pair changes, and a sampled record misses them by slope times spacing (0.0022 arcmin at 1 ms for Wang et al. 2020).
`extremes` finds them: tangents at the samples bound the extreme of each interval, the intervals with the best bounds
are bisected on the slope, and the value is taken where the tangents at the turning point meet. What is left matters
where an interval hides two turning points, or where more than `MOST_INTERVALS` intervals bound higher than the best.
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

FEWEST = 20.0  # angles per turn of what turns fastest, below which extremes between them are missed
MOST_INTERVALS = 32
HALVINGS = 30  # of an interval


class FewAngles(UserWarning):
    """Extremes of a curve may be missed: it was looked at too few angles."""


def angles_per_turn(theta: Float[Array, "... n"], fastest_order: float) -> float:
    """Fewest angles per turn of what turns fastest; infinite for a single angle.

    Args:
        theta: input angles, increasing, shape (n,) [rad].
        fastest_order: its turns per turn of the input.
    """
    angles = np.asarray(theta)
    if angles.shape[-1] < 2 or fastest_order <= 0:
        return math.inf
    return float(2 * math.pi / (np.diff(angles, axis=-1).max() * fastest_order))


def few_angles(theta: Float[Array, "... n"], fastest_order: float) -> str | None:
    """What a reader of the extremes should know, ``None`` where there are angles enough."""
    fewest = angles_per_turn(theta, fastest_order)
    if fewest > FEWEST * (1 - 1e-3):
        return None
    angles = np.asarray(theta)
    needed = math.ceil(FEWEST * fastest_order * float((angles[..., -1] - angles[..., 0]).max()) / (2 * math.pi)) + 1
    return (
        f"only {fewest:.3g} angles per turn of what turns fastest ({fastest_order:.4g} per turn of the input): "
        f"peak-to-peak and amplitude may miss extremes, {needed} even angles would do"
    )


def warn_of_few_angles(theta: Float[Array, "... n"], fastest_order: float) -> None:
    """Warn where extremes between the angles may be missed; single and two angles are not taken for a curve, and inside
    a trace nothing is known."""
    if not is_concrete(theta) or theta.shape[-1] < 3:
        return
    words = few_angles(theta, fastest_order)
    if words is not None:
        warnings.warn(words, FewAngles, stacklevel=3)


class Extremes(eqx.Module):
    """Highest and lowest value of a curve, and where they are."""

    maximum: Scalar
    minimum: Scalar
    theta_maximum: Scalar
    theta_minimum: Scalar


class TurningPoints(NamedTuple):
    """Local highest points of a curve between its samples.

    The value at such a point is where the tangents on its two sides meet: exact at a kink, and above a smooth top by
    the square of the angle between the sides. With the place held fixed it is a convex combination of the curve on
    both sides, whose weights cancel the slope, and a constant: differentiable in the curve's parameters.

    Args:
        ends: angles on both sides, shape (m, 2) [rad].
        weights: weights of the curve there, adding to 1, or -1 for lowest points, shape (m, 2).
        lift: the constant, shape (m,).
        heights: the values, minus infinity where there is no turning point, shape (m,).
    """

    ends: Float[Array, "m 2"]
    weights: Float[Array, "m 2"]
    lift: Float[Array, " m"]
    heights: Float[Array, " m"]

    def values(self, curve: Callable[[Scalar], Scalar]) -> Float[Array, " m"]:
        """The values as a function of what the curve depends on, shape (m,)."""
        places = jax.lax.stop_gradient(self)
        sides = jax.vmap(jax.vmap(curve))(places.ends)
        return (places.weights * sides).sum(axis=1) + places.lift


SlopeAndValue = Callable[[Scalar], tuple[Scalar, Scalar]]


def slope_and_value(curve: Callable[[Any, Scalar], Scalar], physics: Any) -> SlopeAndValue:
    """Slope and value of ``curve(physics, theta)`` at one angle."""

    def at(angle: Scalar) -> tuple[Scalar, Scalar]:
        value, slope = jax.jvp(lambda a: curve(physics, a), (angle,), (jnp.ones_like(angle),))
        return slope, value

    return at


def turning_points(
    at: SlopeAndValue,
    sign: float | Scalar,
    samples: tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]],
    intervals: Int[Array, " m"],
    *,
    splits: int = 0,
    halvings: int = 0,
) -> TurningPoints:
    """The turning points of some intervals between samples; of ``sign`` times the curve.

    An interval is first split where the tangents at its ends meet, which is at once the kink of two straight curves and
    the middle of a parabola, then halved, where differences of values would be too small; the side that turns is kept.

    Args:
        at: slope and value of the curve.
        sign: 1 for the highest points, -1 for the lowest.
        samples: angles, slopes and values of the curve, shape (n,) each, at least two.
        intervals: numbers of the intervals, shape (m,).
        splits: how often an interval is split by tangents, quick and rough.
        halvings: how often it is then halved; in float32 at most 9 times.
    """

    def signed(angle: Scalar) -> tuple[Scalar, Scalar]:
        slope, value = at(angle)
        return sign * slope, sign * value

    def halve(_, state):
        return cut(state, state[0].mean())

    def split(_, state):
        ends, slopes, values = state
        rise, fall, span = slopes[0], -slopes[1], ends[1] - ends[0]
        turning = _turning(rise, fall)
        place = (values[1] - values[0] + fall * span) / jnp.where(turning, rise + fall, 1.0)
        # within the middle 90 %: what is left shrinks even where a curve is bent on one side and straight on the other
        place = jnp.where(turning, jnp.clip(place, 0.05 * span, 0.95 * span), 0.5 * span)
        return cut(state, ends[0] + place)

    def cut(state, middle):
        slope, value = signed(middle)

        def keep(pair, new):
            return jnp.where(slope > 0, jnp.stack([new, pair[1]]), jnp.stack([pair[0], new]))

        return tuple(keep(pair, new) for pair, new in zip(state, (middle, slope, value), strict=True))

    def locate(interval: Int[Array, ""]):
        ends, slopes, values = (jnp.stack([part[interval], part[interval + 1]]) for part in samples)
        state = ends, sign * slopes, sign * values
        if splits:
            state = jax.lax.fori_loop(0, splits, split, state)
        if halvings:
            state = jax.lax.fori_loop(
                0, halvings if samples[0].dtype == jnp.float64 else min(halvings, 9), halve, state
            )
        ends, slopes, values = state
        rise, fall = slopes[0], -slopes[1]
        turning = _turning(rise, fall)
        total = jnp.where(turning, rise + fall, 1.0)
        share = jnp.where(turning, fall / total, 0.5)
        weights = jnp.stack([share, 1.0 - share])
        lift = jnp.where(turning, rise * fall * (ends[1] - ends[0]) / total, 0.0)
        return ends, sign * weights, lift, jnp.where(turning, (weights * values).sum() + lift, -jnp.inf)

    return TurningPoints(*jax.vmap(locate)(intervals))


def _turning(rise: Scalar, fall: Scalar) -> Bool[Array, ""]:
    """Whether a curve that rises at one end of an interval and falls at the other turns within it."""
    return (rise >= 0) & (fall >= 0) & (rise + fall > 0)


def extremes_of_samples(theta: Float[Array, " n"], values: Float[Array, " n"]) -> Extremes:
    """Highest and lowest of the samples, which costs nothing where a value between them would cost a solve."""
    high, low = jnp.argmax(values), jnp.argmin(values)
    return Extremes(values[high], values[low], theta[high], theta[low])


def extremes(
    curve: Callable[[Any, Scalar], Scalar], physics: Any, theta: Float[Array, " n"], values: Float[Array, " n"]
) -> Extremes:
    """Extremes of ``curve(physics, theta)`` over the span of ``theta``, kinks between samples included.

    Differentiable in ``physics``.

    Args:
        curve: the curve.
        physics: its parameters, a pytree of arrays.
        theta: where it was sampled, increasing, shape (n,).
        values: the samples, shape (n,).
    """
    if theta.shape[0] < 2:
        return Extremes(values[0], values[0], theta[0], theta[0])
    frozen, theta = jax.lax.stop_gradient((physics, theta))
    at = slope_and_value(curve, frozen)
    slopes, frozen_values = jax.vmap(at)(theta)

    def best_turning_point(sign: Scalar, bounds: Float[Array, " interval"]) -> TurningPoints:
        """The highest turning point, of the intervals whose tangents meet highest."""
        intervals = highest_intervals(bounds, MOST_INTERVALS)
        points = turning_points(at, sign, (theta, slopes, frozen_values), intervals, halvings=HALVINGS)
        return jax.tree.map(lambda part: part[jnp.argmax(points.heights)], points)

    signs = jnp.array([1.0, -1.0], values.dtype)  # the highest value, and the highest of the negative
    bounds = jnp.stack(tangent_bounds(theta, frozen_values, slopes))
    points = jax.lax.stop_gradient(jax.vmap(best_turning_point)(signs, bounds))
    refined = signs * points.values(lambda angle: curve(physics, angle))
    at_sample = jnp.stack([jnp.argmax(values), jnp.argmin(values)])
    sampled = values[at_sample]
    better = (points.heights > -jnp.inf) & (signs * refined > signs * sampled)
    best = jnp.where(better, refined, sampled)
    where = jnp.where(better, points.ends.mean(axis=1), theta[at_sample])
    return Extremes(best[0], best[1], where[0], where[1])


def tangent_bounds(
    theta: Float[Array, " n"], values: Float[Array, " n"], slopes: Float[Array, " n"]
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Where the tangents at both ends of each interval meet, of the curve and of its negative; minus infinity without
    a turning point between."""
    step = theta[1:] - theta[:-1]
    rise, fall = slopes[:-1], -slopes[1:]
    turning = rise * fall > 0
    meet = (fall * values[:-1] + rise * values[1:] + rise * fall * step) / jnp.where(turning, rise + fall, 1.0)
    top = turning & (rise > 0)
    return jnp.where(top, meet, -jnp.inf), jnp.where(turning & ~top, -meet, -jnp.inf)


def highest_intervals(bounds: Float[Array, " m"], number: int) -> Int[Array, " k"]:
    """Numbers of the intervals with the highest bounds, at most one of each of four times ``number`` equal groups.

    Faster than sorting them all, and neighbours do not crowd out other tops.
    """
    count = bounds.shape[0]
    groups = min(count, 4 * number)
    size = 1 << max(0, -(-count // groups) - 1).bit_length()
    groups = -(-count // size)
    filled = jnp.concatenate([bounds, jnp.full((groups * size - count,), -jnp.inf, bounds.dtype)])
    tops, places = filled.reshape(groups, size), jnp.arange(groups * size, dtype=jnp.int32).reshape(groups, size)
    while size > 1:  # the better half of each group
        size //= 2
        better = tops[:, :size] >= tops[:, size:]
        tops = jnp.where(better, tops[:, :size], tops[:, size:])
        places = jnp.where(better, places[:, :size], places[:, size:])
    chosen = jax.lax.top_k(tops[:, 0], min(number, groups))[1]
    return jnp.minimum(places[chosen, 0], count - 1)


@jax.custom_jvp
def top(values: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Highest value along the last axis, with the derivative of the one that is highest: the built-in derivative
    compares values with their maximum, which fused code may round differently."""
    return values.max(axis=-1)


@top.defjvp
def _top_jvp(primals: tuple, tangents: tuple) -> tuple:
    (values,), (slopes,) = primals, tangents
    where = jnp.argmax(values, axis=-1, keepdims=True)
    return top(values), jnp.take_along_axis(slopes, where, axis=-1)[..., 0]


def root(square: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root whose derivative at zero is zero: the deviation of a constant record."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def deviation(record: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Standard deviation of each record."""
    centred = record - record.mean(axis=-1, keepdims=True)
    return root((centred * centred).mean(axis=-1))


def load_sharing(
    layout: Layout, forces: Float[Array, "... n contact"], carriers: Int[Array, "... n"] | int
) -> Float[Array, "... n"]:
    """`load_sharing_factor` of the pairs of a mesh; of a train the largest one of its meshes, whose pairs on the side
    that carries more could carry."""
    carried = layout.per_pair(forces)
    if not layout.mesh:
        return load_sharing_factor(carried, carriers)
    meshes = np.array([layout.mesh[members[0]] for members in layout.members])
    return jnp.stack([_sharing_of(layout, forces, carried, meshes == mesh) for mesh in set(layout.mesh)]).max(axis=0)


def _sharing_of(
    layout: Layout, forces: Float[Array, "... n contact"], carried: Float[Array, "... n pair"], inside: np.ndarray
) -> Float[Array, "... n"]:
    """Of the pairs inside one mesh of a train."""
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
    """Load of the most loaded pair over the mean load of those that could carry, 1 (even) to their number (one carries
    all), shape (n,).

    The mesh load factor ``K_gamma`` of ISO 6336-1 for planet wheels, at each sample; nan without load.

    Args:
        carried: force of each pair, shape (n, pair) [N].
        carriers: number of pairs that could carry, shape (n,) or one for all.
    """
    total = carried.sum(axis=-1)
    loaded = total > 0
    able = jnp.asarray(carriers, carried.dtype)
    return jnp.where(loaded, able * carried.max(axis=-1) / jnp.where(loaded, total, 1.0), jnp.nan)
