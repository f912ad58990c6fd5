"""Foundation of teeth: an elastic layer on rigid ground, in plane strain, that forces at the roots of teeth shift and
turn."""

import math

import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Scalar

NODES = 160  # waves that the layer's answer is put together of
SHORTEST = 30.0  # turns of phase of the shortest wave over half of a root
SMALL = 0.1  # below which a quotient is taken by its series


def layer_compliance(
    apart: Float[Array, " distance"], thickness: Scalar, depth: Scalar, modulus: Scalar, poissons_ratio: Scalar
) -> Float[Array, "distance 3 3"]:
    """Shift along, turn and sinking of a root per force along the surface, moment and force into it at another root.

    Tractions are even, those of a moment a straight line (Weber and Banaschek 1953), and what they move is the mean
    with the same weights, so that the matrix is symmetric: of another root ``C(-x) = C(x)^T``. A wave of traction of
    the number k moves the surface of a bonded layer by ``2 / (E' k)`` times, with ``x = k h`` and ``c = 3 - 4 nu``,

    - along by traction along: ``(2 c sinh 2x + 4 x) / D``,
    - into by traction into: ``(2 c sinh 2x - 4 x) / D``,
    - each by the other, a quarter of a wave later: ``(2 c (c - 1) (cosh 2x - 1) - 8 x^2) / ((c + 1) D)``,

    with ``D = 2 c cosh 2x + 1 + c^2 + 4 x^2`` (after Johnson 1985, ch. 5.8). On a deep layer a turn per moment is Weber
    and Banaschek's ``18 / (pi E' s^2)``, a shift per moment their ``(1 - 2 nu) / ((1 - nu) E' s)``.

    Args:
        apart: how far ahead, in the sense of positive forces along the surface, the root is that they act on [m].
        thickness: s, of a root [m].
        depth: h, of the layer [m].
        modulus: ``E' = E / (1 - nu^2)`` [Pa].
        poissons_ratio: nu [-].

    Returns:
        Of the unit of width, ``[.., moved, moving]``, shape (distance, 3, 3) [m2/N], [m/N] and [1/N].
    """
    # evenly placed over waves longer than the layer is deep, in even ratios over shorter ones; weights are positive,
    # so that the matrix of many roots is positive semidefinite
    deep = 0.5 * thickness / depth
    top = jnp.arcsinh(SHORTEST / deep)
    level = top * jnp.asarray((np.arange(NODES)[None] + 0.5) / NODES, top.dtype)
    half = deep * jnp.sinh(level)  # phase over half of a root
    number, weight = 2 * half / thickness, 2 * deep * jnp.cosh(level) * top / (NODES * thickness)
    along, into, cross = _waves(number * depth, poissons_ratio)
    scale = weight * 2 / (math.pi * modulus * number)
    along, into, cross = (scale * part for part in (along, into, cross))
    safe = jnp.where(half < SMALL, 1.0, half)
    turning = 3 * (jnp.sin(safe) - safe * jnp.cos(safe)) / (safe * safe)
    turning = jnp.where(half < SMALL, half * (1 - 0.1 * half * half), turning) * 2 / thickness
    even = jnp.sin(half) / half
    phase = apart[:, None] * number
    level, later = jnp.cos(phase), jnp.sin(phase)
    by_turn = cross * even * turning
    entries = [
        [along * even * even * level, by_turn * level, cross * even * even * later],
        [by_turn * level, into * turning * turning * level, into * turning * even * later],
        [-cross * even * even * later, -into * turning * even * later, into * even * even * level],
    ]
    return jnp.stack([jnp.stack([part.sum(axis=-1) for part in row], axis=-1) for row in entries], axis=-2)


def _waves(x: Array, poissons_ratio: Scalar) -> tuple[Array, Array, Array]:
    """The three fractions of `layer_compliance`, by exponentials that do not overflow."""
    c = 3 - 4 * poissons_ratio
    decay = jnp.exp(-2 * x)
    below = c * (1 + decay * decay) + (1 + c * c + 4 * x * x) * decay
    grown, lost = -c * jnp.expm1(-4 * x), 4 * x * decay
    between = (c * (c - 1) * jnp.expm1(-2 * x) ** 2 - 8 * x * x * decay) / (c + 1)
    return (grown + lost) / below, (grown - lost) / below, between / below
