"""Cycloidal gears: disc profile, contact with the pins, clearance, curvature and undercut.

The disc has ``pins - 1`` teeth and touches a ring of pins. Angles ``u`` are counted from a pin to the throw of the
crank. The common normal of a contact runs through the pitch point, whose distance from the centre of the pin circle is
``K`` times the radius of that circle. ``K = throw pins / pin_circle`` is the short-width coefficient, and
``S = 1 + K^2 - 2 K cos u``.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Scalar

STEPS = 8  # steps of Newton's method for the foot of a normal


class Cycloid(NamedTuple):
    """A cycloidal disc and its pins; all lengths are in m.

    Args:
        pins: number of pins; the disc has one tooth fewer.
        pin_circle: radius of the circle of pin centres.
        pin_radius: radius of a pin.
        throw: throw (eccentricity) of the crank.
        isometric: isometric (equidistant) modification of the profile; positive removes material.
        shifting: shifting modification, a change of the radius of the pin circle that the profile is generated from.
    """

    pins: int
    pin_circle: Scalar
    pin_radius: Scalar
    throw: Scalar
    isometric: Scalar
    shifting: Scalar

    @property
    def teeth(self) -> int:
        """Number of teeth of the disc."""
        return self.pins - 1

    @property
    def rolling_radius(self) -> Scalar:
        """Radius of the rolling circle of the disc, the largest lever of a contact, ``r_c = a z_c`` [m]."""
        return self.throw * self.teeth

    @property
    def short_width(self) -> Scalar:
        """Short-width coefficient of the mechanism, ``K = a z_p / r_p`` [-]."""
        return self.throw * self.pins / self.pin_circle

    @property
    def modified_short_width(self) -> Scalar:
        """Short-width coefficient of the profile, ``K1 = a z_p / (r_p + shifting)`` (Hu et al. 2020, eq. 3)."""
        return self.throw * self.pins / (self.pin_circle + self.shifting)


class Touch(NamedTuple):
    """Contact of a pin with the disc at each angle ``u``.

    Args:
        lever: lever over the rolling radius, ``L = sin u / sqrt(S)`` (Hu et al. 2020, eq. 36); negative ahead of the
            throw, on the flanks that carry a load that resists the output.
        outward: change of gap per outward displacement of the pin, ``(1 - K cos u) / sqrt(S)``.
        along_throw: change of gap per displacement of the disc along the throw, ``(K - cos u) / sqrt(S)``; for a
            displacement across the throw it is L.
        root: ``sqrt(S)``.
    """

    lever: Array
    outward: Array
    along_throw: Array
    root: Array


def touch(short_width: Scalar, u: Float[Array, "..."]) -> Touch:
    """Contacts of the pins at the angles ``u`` [rad]."""
    cosine, sine = jnp.cos(u), jnp.sin(u)
    root = jnp.sqrt(1 + short_width * short_width - 2 * short_width * cosine)
    return Touch(sine / root, (1 - short_width * cosine) / root, (short_width - cosine) / root, root)


def profile(disc: Cycloid, phase: Float[Array | np.ndarray, " n"]) -> Float[Array | np.ndarray, "n 2"]:
    """Modified profile of a disc (Hu et al. 2020, eqs. 1-2, signs restored), shape (n, 2) [m].

    Args:
        disc: the disc.
        phase: meshing phase, ``2 pi`` per tooth, shape (n,) [rad]; ``2 pi teeth`` is once around. If it is a numpy
            array and the disc has plain numbers, numpy calculates the profile.
    """
    xp = phase.__array_namespace__()
    ratio = disc.pins / disc.teeth
    circle, offset = disc.pin_circle + disc.shifting, disc.pin_radius + disc.isometric
    short = disc.throw * disc.pins / circle
    share = offset / xp.sqrt(1 + short * short - 2 * short * xp.cos(phase))
    far = circle - share
    near = disc.throw / circle * (circle - disc.pins * share)
    x = far * xp.cos((1 - ratio) * phase) - near * xp.cos(ratio * phase)
    y = far * xp.sin((1 - ratio) * phase) + near * xp.sin(ratio * phase)
    return xp.stack([x, y], axis=-1)


def clearance(disc: Cycloid, u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Initial clearance at each pin due to the modification, while the disc touches at ``cos u = K1`` [m].

    It is ``C = isometric (1 - L) - shifting (1 - K1 cos u - s sin u) / sqrt(S)`` (Hu et al. 2020, eq. 32, with a
    misprint in its second term corrected).
    """
    short = disc.modified_short_width
    at, side = touch(short, u), jnp.sqrt(1 - short * short)
    return disc.isometric * (1 - at.lever) - disc.shifting * (at.outward - side * at.lever)


def gap(disc: Cycloid, u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Gap of the modified profile at the ideal position, to first order [m].

    It is ``isometric - shifting (1 - K cos u) / sqrt(S)``. Eq. 32 of Hu et al. (2020) is the same gap after the disc is
    turned until it touches.
    """
    return disc.isometric - disc.shifting * touch(disc.short_width, u).outward


def exact_gap(disc: Cycloid, u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Exact gap of the modified profile at the ideal position: distance of the pin from the foot of its normal [m].

    The profile is equidistant to the trochoid of pin centres. The gap is therefore the distance of the pin's centre
    from the trochoid of the modified pin circle, plus the isometric modification.
    """
    return pin_distance(disc, trochoid(disc._replace(shifting=jnp.zeros_like(disc.shifting)), u), u) + disc.isometric


def trochoid(disc: Cycloid, phase: Float[Array, "..."]) -> tuple[Array, Array]:
    """Centre of the pin that is an angle ``phase`` behind the throw, as x and y in axes of the disc [m]."""
    return _trochoid(disc, phase)[0]


def _trochoid(disc: Cycloid, phase: Array) -> tuple[tuple[Array, Array], ...]:
    """Point of the `trochoid` and its first and second derivative by the phase, as x and y of each [m]."""
    slow, fast = 1 / disc.teeth, disc.pins / disc.teeth
    circle, throw = disc.pin_circle + disc.shifting, disc.throw
    far = circle * jnp.cos(slow * phase), circle * jnp.sin(slow * phase)
    near = throw * jnp.cos(fast * phase), throw * jnp.sin(fast * phase)
    return (
        (far[0] - near[0], far[1] - near[1]),
        (fast * near[1] - slow * far[1], slow * far[0] - fast * near[0]),
        (fast * fast * near[0] - slow * slow * far[0], fast * fast * near[1] - slow * slow * far[1]),
    )


def pin_distance(disc: Cycloid, pin: tuple[Array, Array], guess: Float[Array, "..."]) -> Float[Array, "..."]:
    """Distance of a pin's centre from the trochoid that the profile is generated from, positive outside [m].

    Newton's method finds the foot of the normal. The search itself is not differentiated: one more step carries the
    derivative of the foot along the curve. First derivatives do not need this step, because the distance is stationary
    at the foot, but second derivatives do.

    Args:
        disc: the disc.
        pin: x and y of the centre in axes of the disc [m].
        guess: phase of the trochoid near the pin [rad].
    """

    def beyond_foot(disc: Cycloid, pin: tuple[Array, Array], phase: Array) -> tuple[Array, Array]:
        """Distance of the pin from the normal, times the curve's speed, and the derivative of this by the phase."""
        (x, y), (dx, dy), (ddx, ddy) = _trochoid(disc, phase)
        away = pin[0] - x, pin[1] - y
        return away[0] * dx + away[1] * dy, away[0] * ddx + away[1] * ddy - dx * dx - dy * dy

    frozen, held = jax.lax.stop_gradient((disc, pin))
    frozen = frozen._replace(pins=disc.pins)

    def step(phase: Array, _: None) -> tuple[Array, None]:
        value, slope = beyond_foot(frozen, held, phase)
        return phase - jnp.clip(value / slope, -0.2, 0.2), None

    foot = jax.lax.scan(step, jax.lax.stop_gradient(guess), None, length=STEPS)[0]
    value, slope = beyond_foot(disc, pin, foot)
    foot = foot - value / jax.lax.stop_gradient(slope)
    (x, y), (dx, dy), _ = _trochoid(disc, foot)
    return ((pin[0] - x) * dy - (pin[1] - y) * dx) / jnp.sqrt(dx * dx + dy * dy)


def curvature(disc: Cycloid, u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Curvature of the disc's flank at the contact with a pin, positive on convex flanks [1/m].

    It is ``-1 / rho`` of Hu et al. (2020), eq. 40, for the modified profile.
    """
    short, offset = disc.modified_short_width, disc.pin_radius + disc.isometric
    inner = 1 + disc.pins * short * short - short * (disc.pins + 1) * jnp.cos(u)
    return inner / ((disc.pin_circle + disc.shifting) * touch(short, u).root ** 3 - offset * inner)


def largest_offset(pins: int, pin_circle: float, short_width: float) -> float:
    """Smallest radius of curvature of the convex part of the trochoid [m]; a larger pin would undercut the disc."""
    cosine = np.cos(np.linspace(0.0, math.pi, 20_001))
    inner = 1 + pins * short_width**2 - short_width * (pins + 1) * cosine
    radii = pin_circle * (1 + short_width**2 - 2 * short_width * cosine) ** 1.5 / np.where(inner > 0, inner, np.inf)
    return float(radii[inner > 0].min())
