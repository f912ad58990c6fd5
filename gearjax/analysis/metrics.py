"""Metrics of a record, and extremes that fall between its samples.

A transmission error is the largest of several smooth curves: its lowest points are kinks, where the contacting
pair changes, and a sampled record misses them by slope times spacing (0.0022 arcmin at 1 ms for Wang et al. 2020).
`extremes` finds them: tangents at the samples bound the extreme of each interval, the intervals with the best bounds
are bisected on the slope, and the value is taken between the two tangents at the turning point. What is left matters
where an interval hides two turning points, or where more than `MOST_INTERVALS` intervals bound higher than the best.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.typing import Array, Bool, Float, Int, Scalar

MOST_INTERVALS = 16


class Extremes(eqx.Module):
    """Highest and lowest value of a curve, and where they are."""

    maximum: Scalar
    minimum: Scalar
    theta_maximum: Scalar
    theta_minimum: Scalar


def extremes(
    curve: Callable[[Any, Scalar], Scalar], physics: Any, theta: Float[Array, " n"], values: Float[Array, " n"]
) -> Extremes:
    """Extremes of ``curve(physics, theta)`` over the span of ``theta``, kinks between samples included.

    Differentiable in ``physics``, at kinks too: the value is a fixed convex combination of the curve on both sides of
    the turning point, whose weights cancel the slope.

    Args:
        curve: the curve.
        physics: its parameters, a pytree of arrays.
        theta: where it was sampled, increasing, shape (n,).
        values: the samples, shape (n,).
    """
    if theta.shape[0] < 2:
        return Extremes(values[0], values[0], theta[0], theta[0])
    frozen, theta = jax.lax.stop_gradient((physics, theta))

    def slope_and_value(angle: Scalar) -> tuple[Scalar, Scalar]:
        value, slope = jax.jvp(lambda a: curve(frozen, a), (angle,), (jnp.ones_like(angle),))
        return slope, value

    slopes, frozen_values = jax.vmap(slope_and_value)(theta)
    signs = jnp.array([1.0, -1.0], values.dtype)  # the highest value, and the highest of the negative

    def turning_point(sign: Scalar, interval: Int[Array, ""]) -> tuple[Float[Array, "2"], Float[Array, "2"], Scalar]:
        """Both sides of the turning point of an interval, the weights of the curve there, and its value."""
        ends = jnp.stack([theta[interval], theta[interval + 1]])

        def halve(_, ends):
            middle = ends.mean()
            rising = sign * slope_and_value(middle)[0] > 0
            return jnp.where(rising, jnp.stack([middle, ends[1]]), jnp.stack([ends[0], middle]))

        ends = jax.lax.fori_loop(0, 30 if theta.dtype == jnp.float64 else 9, halve, ends)
        slope, value = jax.vmap(slope_and_value)(ends)
        rise, fall = sign * slope[0], -sign * slope[1]
        turning = (rise > 0) & (fall > 0)
        share = jnp.where(turning, fall / jnp.where(turning, rise + fall, 1.0), 0.5)
        weights = jnp.stack([share, 1.0 - share])
        return ends, weights, jnp.where(turning, sign * (weights * value).sum(), -jnp.inf)

    def best_turning_point(sign: Scalar) -> tuple[Float[Array, "2"], Float[Array, "2"], Bool[Array, ""]]:
        """The highest turning point of the intervals whose tangents meet highest, and whether there is one."""
        bounds = _bounds(theta, sign * frozen_values, sign * slopes)
        intervals = jax.lax.top_k(bounds, min(MOST_INTERVALS, bounds.shape[0]))[1]
        ends, weights, heights = jax.vmap(turning_point, in_axes=(None, 0))(sign, intervals)
        best = jnp.argmax(heights)
        return ends[best], weights[best], heights[best] > -jnp.inf

    ends, weights, turning = jax.lax.stop_gradient(jax.vmap(best_turning_point)(signs))
    refined = (weights * jax.vmap(jax.vmap(lambda angle: curve(physics, angle)))(ends)).sum(axis=1)
    at_sample = jnp.stack([jnp.argmax(values), jnp.argmin(values)])
    sampled = values[at_sample]
    better = turning & (signs * refined > signs * sampled)
    found = jnp.where(better, refined, sampled)
    where = jnp.where(better, ends.mean(axis=1), theta[at_sample])
    return Extremes(found[0], found[1], where[0], where[1])


def _bounds(theta: Float[Array, " n"], values: Float[Array, " n"], slopes: Float[Array, " n"]) -> Float[Array, " m"]:
    """Where the tangents at both ends of each interval meet; minus infinity without a turning point between."""
    step = theta[1:] - theta[:-1]
    rise, fall = slopes[:-1], -slopes[1:]
    turning = (rise > 0) & (fall > 0)
    total = jnp.where(turning, rise + fall, 1.0)
    meet = (fall * values[:-1] + rise * values[1:] + rise * fall * step) / total
    return jnp.where(turning, meet, -jnp.inf)


def root(square: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root whose derivative at zero is zero: the deviation of a constant record."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def deviation(record: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Standard deviation of each record."""
    centred = record - record.mean(axis=-1, keepdims=True)
    return root((centred * centred).mean(axis=-1))


def load_sharing_factor(forces: Float[Array, "... n contact"], pairs: int) -> Float[Array, "... n"]:
    """Share of the most loaded pair over the mean share, 1 (even) to ``pairs`` (one carries all), shape (n,).

    The mesh load factor ``K_gamma`` of ISO 6336-1 for planet wheels, at each sample; nan without load.

    Args:
        forces: compression of each contact, driving flanks first, shape (n, contact) [N].
        pairs: number of driving contacts.
    """
    carried = forces.reshape(*forces.shape[:-1], -1, pairs).sum(axis=-2)
    total = carried.sum(axis=-1)
    loaded = total > 0
    return jnp.where(loaded, pairs * carried.max(axis=-1) / jnp.where(loaded, total, 1.0), jnp.nan)
