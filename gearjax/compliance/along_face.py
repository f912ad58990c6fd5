"""Deflection along a tooth face beside a load: an elastic layer ``v - l^2 v'' = p`` with free ends."""

import math

import jax.numpy as jnp

from gearjax.geometry.plane_of_action import middles
from gearjax.typing import Array, Float, Scalar

SHORT, TERMS = 0.5, 16  # length over l up to which a series of so many terms holds to rounding


def factors_along(
    across: Float[Array, " slice"], share: Float[Array, " slice"], width: Scalar, reach: Scalar
) -> tuple[Float[Array, " slice"], Float[Array, " slice"], Float[Array, " slice"]]:
    """Mean deflection of the loaded part of each slice per force on that of each slice, by the factors of `Faces`.

    The products are factors [1/m] on the deflection of a unit of width under a uniform load. They are means over both
    parts of ``cosh(low / l) cosh(high / l) / (l sinh(w / l))``. Here ``low`` is the distance from the lower place to
    the lower end of the face, ``high`` the distance from the higher place to the higher end. Under a uniform load on
    all of the face all slices deflect by the same amount.

    Args:
        across: middles of the loaded parts, counted from the middle of the face [m].
        share: lengths of these parts, as shares of the slices [-].
        width: face width w [m].
        reach: length l [m].

    Returns:
        The factor of each slice with itself, and its factors with all slices above it and with all below it.
    """
    number = across.shape[0]
    step = width / number
    # parts as exponentials that do not overflow, unlike cosh and sinh: all their exponents are negative
    half, middle = 0.5 * share * step, middles(width, number)
    mean, rise = _decayed(2 * half / reach), half - 0.5 * step
    moved = jnp.clip(across - middle, rise, -rise)
    low, high = 0.5 * width + middle + moved, 0.5 * width - middle - moved
    lower = mean * jnp.exp((rise + moved) / reach) * (1 + jnp.exp(-2 * low / reach))
    higher = mean * jnp.exp((rise - moved) / reach) * (1 + jnp.exp(-2 * high / reach))
    ends = mean**2 * (jnp.exp(-2 * (high - half) / reach) + jnp.exp(-2 * (low - half) / reach))
    itself = ends + _within(2 * half / reach, width / reach)
    size = 1 / (2 * reach * -jnp.expm1(-2 * width / reach))
    return itself * size, lower * jnp.sqrt(size), higher * jnp.sqrt(size)


def _decayed(length: Array) -> Array:
    """Mean of ``exp(-z)`` over a length from 0 on [-]."""
    return -jnp.expm1(-length) / length


def _within(part: Array, whole: Scalar) -> Array:
    """Mean of ``cosh(W - |z - z'|)`` over z and z' of a part, times ``2 exp(-W)``, all lengths over l [-].

    It is ``(1 + exp(-2 W)) (A - B) + 2 exp(-2 W) B``, with ``A = 2 (cosh x - 1) / x^2`` and ``B = 2 (sinh x - x) /
    x^2``; for short parts by their series, which lose no digits.
    """
    short = part < SHORT
    x, y = jnp.where(short, part, SHORT), jnp.where(short, SHORT, part)
    powers = [1 / math.factorial(n + 2) for n in range(TERMS)]
    falling = sum((-1) ** n * power * x**n for n, power in enumerate(powers))
    rising = sum(power * x**n for n, power in enumerate(powers) if n % 2)
    decay = jnp.exp(-2 * whole)
    apart = 2 * jnp.where(short, falling, (jnp.expm1(-y) + y) / y**2)
    grown = (jnp.exp(y - 2 * whole) - jnp.exp(-y - 2 * whole) - 2 * y * decay) / y**2
    return (1 + decay) * apart + 2 * jnp.where(short, 2 * decay * rising, grown)
