"""Extremes of a curve between its samples.

A transmission error is the largest of several smooth curves. Its lowest points are kinks where the contacting pair
changes; a sampled record misses them by slope times spacing (0.0022 arcmin at 1 ms for Wang et al. 2020). `extremes`
finds them from values of the curve alone, which takes half the time to compile that a search by slopes takes: each
sample that is higher than its neighbours brackets a top; the brackets with the highest bounds are looked at in equal
parts and then shrunk by golden sections. Slopes are needed for derivatives only. An extreme can still be missed if it
is narrower than a part, `PARTS` of which make a spacing, or if more than `MOST_BRACKETS` brackets have higher bounds.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.dependence import changes
from gearjax.typing import Array, Float, Int, Scalar

MOST_BRACKETS = 32
GOLDEN = 0.381966011250105  # share of the longer side of a bracket at which the next point is taken
PARTS = 4  # of the spacing on each side of a top: golden sections alone may end at the lower one of two kinks
SECTIONS, FEW_SECTIONS = 61, 26  # in float64 and in float32: a bracket shrinks to the rounding of its angles
BESIDE, BESIDE_SINGLE = 1e-7, 2e-3  # distance from an extreme to where slopes are taken, over the spacing; float32


class Extremes(eqx.Module):
    """Highest and lowest value of a curve, and the input angles of both [rad], which have no derivatives."""

    maximum: Scalar
    minimum: Scalar
    theta_maximum: Scalar
    theta_minimum: Scalar


Curve = Callable[[Any, Scalar], Scalar]


def extremes_of_samples(theta: Float[Array, " n"], values: Float[Array, " n"]) -> Extremes:
    """Highest and lowest value of the samples; unlike values between them, these need no further solution."""
    high, low = jnp.argmax(values), jnp.argmin(values)
    return Extremes(values[high], values[low], theta[high], theta[low])


def extremes(curve: Curve, physics: Any, theta: Float[Array, " n"], values: Float[Array, " n"]) -> Extremes:
    """Extremes of ``curve(physics, theta)`` over the span of ``theta``, including kinks between samples.

    The values are twice differentiable in ``physics`` and, where an extreme is at an end of the record, once in
    ``theta``; not in ``values``. The places have no derivatives. The extremes are nan if a sample is.

    Args:
        curve: the curve. It must not close over traced arrays: these belong to its parameters.
        physics: its parameters, a pytree of arrays.
        theta: input angles of the samples, increasing, shape (n,).
        values: values of the samples, shape (n,).
    """
    if theta.shape[0] < 2:
        return Extremes(values[0], values[0], theta[0], theta[0])
    ends = theta[jnp.array([0, -1])]
    frozen, theta, samples = jax.lax.stop_gradient((physics, theta, values))
    signs = jnp.array([1.0, -1.0], values.dtype)  # the maximum of the curve, and the maximum of its negative
    signed = jnp.stack([samples, -samples])
    tops = jax.vmap(lambda side: highest(bounds_of_tops(theta, side), MOST_BRACKETS))(signed)

    def every(places: Float[Array, "sign k"]) -> Float[Array, "sign k"]:
        found = jax.vmap(curve, (None, 0))(frozen, places.reshape(-1))
        return signs[:, None] * found.reshape(places.shape)

    brackets = _shrunk(every, _around(theta, signed, tops))
    best = jnp.argmax(brackets.height, axis=1)
    place, height = (part[jnp.arange(2), best] for part in (brackets.middle, brackets.height))
    height = jnp.where(jnp.isnan(samples).any(), jnp.nan, height)  # no equilibrium there: the extremes are not known
    found = _at((physics, ends), curve=curve, places=place, sides=_sides(theta, place), values=signs * height)
    return Extremes(found[0], found[1], place[0], place[1])


def bounds_of_tops(theta: Float[Array, " n"], values: Float[Array, " n"]) -> Float[Array, " n"]:
    """Where the curve beside each sample may reach, minus infinity for samples that are lower than a neighbour.

    Between two samples it is where the lines through the samples before and behind meet, as at a kink. Beyond the ends
    of the record the curve is taken to fall as steeply as its first and last samples differ.
    """
    number = values.shape[0]
    theta = _continued(theta, theta[1] - theta[0], theta[-1] - theta[-2])
    values = _continued(values, jnp.abs(values[1] - values[0]), -jnp.abs(values[-1] - values[-2]))

    def meet(first: int) -> Array:
        """Of the lines through the first two and the last two of four points in a row."""
        before, left, right, behind = ((theta[k : k + number], values[k : k + number]) for k in range(first, first + 4))
        rise, fall = (left[1] - before[1]) / (left[0] - before[0]), (right[1] - behind[1]) / (behind[0] - right[0])
        step, turning = right[0] - left[0], (rise > 0) & (fall > 0)
        place = (right[1] - left[1] + fall * step) / jnp.where(turning, rise + fall, 1.0)
        return jnp.where(turning, left[1] + rise * jnp.clip(place, 0.0, step), -jnp.inf)

    before, own, behind = (values[k : k + number] for k in (1, 2, 3))
    reach = jnp.maximum(own, jnp.maximum(meet(0), meet(1)))
    return jnp.where((own >= before) & (own >= behind), reach, -jnp.inf)


def _continued(part: Float[Array, " n"], first: Scalar, last: Scalar) -> Float[Array, " m"]:
    """The array with two more elements at each end, at these differences."""
    return jnp.concatenate([part[:1] - 2 * first, part[:1] - first, part, part[-1:] + last, part[-1:] + 2 * last])


class _Brackets(NamedTuple):
    """Brackets of tops: input angles of both ends and of the highest known point [rad], and its height."""

    left: Float[Array, "sign k"]
    middle: Float[Array, "sign k"]
    right: Float[Array, "sign k"]
    height: Float[Array, "sign k"]


def _around(theta: Float[Array, " n"], signed: Float[Array, "sign n"], tops: Int[Array, "sign k"]) -> _Brackets:
    """From the sample before to the sample behind each top; a top at an end of the record has one of them only."""
    left, right = theta[jnp.maximum(tops - 1, 0)], theta[jnp.minimum(tops + 1, theta.shape[0] - 1)]
    return _Brackets(left, theta[tops], right, jnp.take_along_axis(signed, tops, axis=1))


def _shrunk(every: Callable[[Array], Array], whole: _Brackets) -> _Brackets:
    """The highest point of each bracket by equal parts, and its top by golden sections of the parts beside this point.

    All steps are one loop over all brackets: the curve is compiled once, and traced once for every axis of a batch.
    """
    looks = 2 * (PARTS - 1)
    before, behind = (whole.middle - whole.left) / PARTS, (whole.right - whole.middle) / PARTS

    def look(number: Array) -> Array:
        """The place of one look: first those before the middle."""
        on_left = number < PARTS - 1
        return jnp.where(on_left, whole.middle - (number + 1) * before, whole.middle + (number - PARTS + 2) * behind)

    def step(number: Array, now: _Brackets) -> _Brackets:
        right_is_longer = now.right - now.middle > now.middle - now.left
        section = now.middle + GOLDEN * (jnp.where(right_is_longer, now.right, now.left) - now.middle)
        looking = number < looks
        place = jnp.where(looking, look(number.astype(section.dtype)), section)
        found = every(place)
        higher = found > now.height
        middle, height = jnp.where(higher, place, now.middle), jnp.maximum(found, now.height)
        low, high = jnp.minimum(place, now.middle), jnp.maximum(place, now.middle)
        # golden sections: of the two points inside, the lower one is the new end on its side
        left = jnp.where(higher == right_is_longer, low, now.left)
        right = jnp.where(higher == right_is_longer, now.right, high)
        # looks: the parts beside the highest point
        own_left = jnp.where(middle > whole.middle, behind, before)
        own_right = jnp.where(middle < whole.middle, before, behind)
        return _Brackets(
            jnp.where(looking, middle - own_left, left), middle, jnp.where(looking, middle + own_right, right), height
        )

    sections = SECTIONS if whole.middle.dtype == jnp.float64 else FEW_SECTIONS
    return jax.lax.fori_loop(0, looks + sections, step, whole)


def _sides(theta: Float[Array, " n"], places: Float[Array, " sign"]) -> Float[Array, "side sign"]:
    """Input angles just before and just behind extremes, within the span of ``theta``."""
    # Rounding of the values hides where an extreme is, in float32 the more so: both sides must be beyond that. Then the
    # mean of both sides, by which their slopes cancel, is that of the true place at a smooth extreme too.
    share, precision = BESIDE if theta.dtype == jnp.float64 else BESIDE_SINGLE, jnp.finfo(theta.dtype).eps
    spread = share * (theta[-1] - theta[0]) / (theta.shape[0] - 1)
    spread = jnp.maximum(spread, 16 * precision * jnp.abs(places))
    return jnp.clip(jnp.stack([places - spread, places + spread]), theta[0], theta[-1])


@eqx.filter_custom_jvp
def _at(parameters: tuple[Any, Array], *, curve: Curve, places: Array, sides: Array, values: Array) -> Array:
    """Values of the extremes, with the derivatives of the curve there, the places held fixed."""
    del parameters, curve, places, sides
    return values


@_at.def_jvp
def _at_jvp(
    primals: tuple, tangents: tuple, *, curve: Curve, places: Array, sides: Array, values: Array
) -> tuple[Array, Array]:
    """At a kink the derivative is the mean of both sides, weighted so that the slopes cancel.

    The place of a kink moves with the parameters, and by these weights the movement does not count. In the derivative
    of this mean it does: there the sides go with the place.
    """
    ((physics, ends),), ((moves, ends_move),) = primals, tangents
    moved = _moved(physics, curve=curve, places=places, sides=sides)
    beside = sides + (moved - places)[None]
    before, behind = _slopes(curve, physics, beside)
    kinked = before * behind < 0
    share = jnp.where(kinked, behind / jnp.where(kinked, behind - before, 1.0), 0.5)
    found = _along(curve, physics, moves, jnp.where(kinked[None], beside, moved[None]))
    change = share * found[0] + (1.0 - share) * found[1]
    if ends_move is not None:  # an extreme at an end of the record goes with it
        change = change + jnp.where(places == ends[0], before * ends_move[0], 0.0)
        change = change + jnp.where(places == ends[1], behind * ends_move[1], 0.0)
    # called again and not given back as they are: the values themselves have derivatives when this is differentiated
    return _at((physics, ends), curve=curve, places=places, sides=sides, values=values), change


def _slopes(curve: Curve, physics: Any, points: Float[Array, "side sign"]) -> Float[Array, "side sign"]:
    """Slopes of the curve by the angle."""

    def slope(angle: Scalar) -> Scalar:
        return jax.jvp(lambda a: curve(physics, a), (angle,), (jnp.ones_like(angle),))[1]

    return jax.vmap(slope)(points.reshape(-1)).reshape(points.shape)


def _along(curve: Curve, physics: Any, moves: Any, points: Float[Array, "side sign"]) -> Float[Array, "side sign"]:
    """Change of the curve at fixed angles, as the parameters that have a tangent move."""

    def values(physics: Any) -> Array:
        return jax.vmap(curve, (None, 0))(physics, points.reshape(-1)).reshape(points.shape)

    return changes(values, physics, moves)[1]


@eqx.filter_custom_jvp
def _moved(physics: Any, *, curve: Curve, places: Array, sides: Array) -> Array:
    """The places of the extremes, as they move with the parameters."""
    del physics, curve, sides
    return places


@_moved.def_jvp
def _moved_jvp(primals: tuple, tangents: tuple, *, curve: Curve, places: Array, sides: Array) -> tuple[Array, Array]:
    """Where the lines through both sides meet; for a smooth extreme, where the slope vanishes."""
    (physics,), (moves,) = primals, tangents
    before, behind = _slopes(curve, physics, sides)
    kinked = before * behind < 0
    rise = _along(curve, physics, moves, sides)
    at_kink = (rise[1] - rise[0]) / jnp.where(kinked, before - behind, 1.0)

    def slope(physics: Any, angle: Scalar) -> Scalar:
        return _slopes(curve, physics, angle[None, None])[0, 0]

    tilt = _along(slope, physics, moves, places[None])[0]
    bend = _slopes(slope, physics, places[None])[0]
    smooth = (sides[0] < places) & (places < sides[1]) & (bend != 0)
    at_top = jnp.where(smooth, -tilt / jnp.where(smooth, bend, 1.0), 0.0)
    return _moved(physics, curve=curve, places=places, sides=sides), jnp.where(kinked, at_kink, at_top)


def highest(bounds: Float[Array, " m"], number: int) -> Int[Array, " k"]:
    """Numbers of the highest bounds, at most one from each of four times ``number`` equal groups.

    This is faster than sorting them all, and the neighbours of one top cannot displace other tops.
    """
    count = bounds.shape[0]
    groups = min(count, 4 * number)
    size = -(-count // groups)
    groups = -(-count // size)
    filled = jnp.concatenate([bounds, jnp.full((groups * size - count,), -jnp.inf, bounds.dtype)])
    filled = filled.reshape(groups, size)
    chosen = jax.lax.top_k(filled.max(axis=1), min(number, groups))[1]
    inside = jax.lax.argmax(filled, 1, jnp.int32)
    return jnp.minimum(chosen * size + inside[chosen], count - 1)
