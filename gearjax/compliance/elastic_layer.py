"""Foundation of teeth: an elastic layer on rigid ground in plane strain, loaded at the roots of the teeth."""

import math

import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Scalar

NODES = 160  # number of waves in the Fourier integral of the layer
SHORTEST = 30.0  # phase [rad] of the shortest wave over half of a root
SMALL = 0.1  # phase below which a quotient is calculated from its series


def layer_compliance(
    apart: Float[Array, " distance"], thickness: Scalar, depth: Scalar, modulus: Scalar, poissons_ratio: Scalar
) -> Float[Array, "distance 3 3"]:
    """Displacements of the root of one tooth per load at the root of another tooth.

    The displacements are the shift along the surface, the rotation and the displacement into the surface; the loads are
    the force along the surface, the moment and the force into the surface. The tractions of the forces are uniform,
    those of the moment linear over the root (Weber and Banaschek 1953). The displacement of a root is the mean with the
    same weights, so that the matrix is symmetric: ``C(-x) = C(x)^T`` for two roots. A wave of traction with the wave
    number k moves the surface of a bonded layer by ``2 / (E' k)`` times the following, with ``x = k h`` and
    ``c = 3 - 4 nu``:

    - along the surface by traction along it: ``(2 c sinh 2x + 4 x) / D``,
    - into the surface by traction into it: ``(2 c sinh 2x - 4 x) / D``,
    - each by the other traction, a quarter of a wave later: ``(2 c (c - 1) (cosh 2x - 1) - 8 x^2) / ((c + 1) D)``,

    with ``D = 2 c cosh 2x + 1 + c^2 + 4 x^2`` (after Johnson 1985, ch. 5.8). On a deep layer the rotation per moment is
    ``18 / (pi E' s^2)`` and the shift per moment ``(1 - 2 nu) / ((1 - nu) E' s)``, both as in Weber and Banaschek.

    Args:
        apart: distance of the loaded root from the moved root, in the direction of positive forces along the surface
            [m].
        thickness: thickness s of a tooth at its root [m].
        depth: depth h of the layer [m].
        modulus: ``E' = E / (1 - nu^2)`` [Pa].
        poissons_ratio: Poisson's ratio nu [-].

    Returns:
        Compliance for a unit of width, ``[.., moved, moving]``, shape (distance, 3, 3) [m2/N], [m/N] and [1/N].
    """
    # wave numbers are spaced evenly for waves longer than the depth of the layer and geometrically for shorter waves;
    # all weights are positive, so that the matrix of many roots is positive semidefinite
    deep = 0.5 * thickness / depth
    top = jnp.arcsinh(SHORTEST / deep)
    level = top * jnp.asarray((np.arange(NODES)[None] + 0.5) / NODES, top.dtype)
    half = deep * jnp.sinh(level)  # phase of each wave over half of a root
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
    """The three fractions of `layer_compliance`, written with exponentials that do not overflow."""
    c = 3 - 4 * poissons_ratio
    decay = jnp.exp(-2 * x)
    below = c * (1 + decay * decay) + (1 + c * c + 4 * x * x) * decay
    grown, lost = -c * jnp.expm1(-4 * x), 4 * x * decay
    between = (c * (c - 1) * jnp.expm1(-2 * x) ** 2 - 8 * x * x * decay) / (c + 1)
    return (grown + lost) / below, (grown - lost) / below, between / below
