"""Metrics of a record, and extremes that fall between its samples.

A transmission error is the largest of several smooth curves: its lowest points are kinks, where the contacting
pair changes, and a sampled record misses them by slope times spacing (0.0022 arcmin at 1 ms for Wang et al. 2020).
`extremes` finds them: tangents at the samples bound the extreme of each interval, the interval with the best bound
is bisected on the slope, and the value is taken between the two tangents at the turning point. What is left is
second order in the spacing and only matters where an interval hides two turning points.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.typing import Array, Float, Scalar


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
    highest, at_highest = _highest(curve, physics, theta, values, 1.0)
    lowest, at_lowest = _highest(curve, physics, theta, values, -1.0)
    return Extremes(highest, -lowest, at_highest, at_lowest)


def _highest(curve, physics, theta, values, sign: float) -> tuple[Scalar, Scalar]:
    """Highest value of ``sign * curve`` and where it is."""
    values = sign * values
    best = jnp.argmax(values)
    if theta.shape[0] < 2:
        return values[best], theta[best]
    frozen, theta = jax.lax.stop_gradient((physics, theta))

    def slope_and_value(angle: Scalar) -> tuple[Scalar, Scalar]:
        value, slope = jax.jvp(lambda a: sign * curve(frozen, a), (angle,), (jnp.ones_like(angle),))
        return slope, value

    slopes, frozen_values = jax.vmap(slope_and_value)(theta)
    left, right = _bracket(theta, frozen_values, slopes)
    halvings = 30 if theta.dtype == jnp.float64 else 9

    def halve(_, ends):
        low, high = ends
        middle = 0.5 * (low + high)
        rising = slope_and_value(middle)[0] > 0
        return jnp.where(rising, middle, low), jnp.where(rising, high, middle)

    left, right = jax.lax.fori_loop(0, halvings, halve, (left, right))
    slope_left, slope_right = slope_and_value(left)[0], slope_and_value(right)[0]
    turning = (slope_left > 0) & (slope_right < 0)
    across = jnp.where(turning, slope_left - slope_right, 1.0)
    weight = jax.lax.stop_gradient(jnp.where(turning, -slope_right / across, 0.5))
    refined = weight * sign * curve(physics, left) + (1.0 - weight) * sign * curve(physics, right)
    better = turning & (refined > values[best])
    return jnp.where(better, refined, values[best]), jnp.where(better, 0.5 * (left + right), theta[best])


def _bracket(theta, values, slopes) -> tuple[Scalar, Scalar]:
    """The interval whose tangents meet highest, among those that rise at the left and fall at the right."""
    step = theta[1:] - theta[:-1]
    rise, fall = slopes[:-1], -slopes[1:]
    turning = (rise > 0) & (fall > 0)
    total = jnp.where(turning, rise + fall, 1.0)
    meet = (fall * values[:-1] + rise * values[1:] + rise * fall * step) / total
    interval = jnp.argmax(jnp.where(turning, meet, -jnp.inf))
    return theta[interval], theta[interval + 1]


def load_sharing_factor(forces: Float[Array, "n contact"], pairs: int) -> Float[Array, " n"]:
    """Share of the most loaded pair over the mean share, 1 (even) to ``pairs`` (one carries all), shape (n,).

    The mesh load factor ``K_gamma`` of ISO 6336-1 for planet wheels, at each sample; nan without load.

    Args:
        forces: compression of each contact, driving flanks first, shape (n, contact) [N].
        pairs: number of driving contacts.
    """
    carried = forces.reshape(forces.shape[0], -1, pairs).sum(axis=1)
    total = carried.sum(axis=1)
    loaded = total > 0
    return jnp.where(loaded, pairs * carried.max(axis=1) / jnp.where(loaded, total, 1.0), jnp.nan)
