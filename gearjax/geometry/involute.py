"""Involute gears: base circles, flanks of external and internal gears, centre distance."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.typing import Array, Scalar

INVOLUTE_STEPS = 6  # steps of Newton's method
ABOVE = 1e-9  # height of the beginning of a flank, in base radii: at the base circle itself slopes are infinite
ROUNDED = 8  # the same, at least, in units of rounding


def involute(angle: Array) -> Array:
    """Involute function ``inv alpha = tan alpha - alpha`` of a pressure angle [rad] (ISO 21771)."""
    return jnp.tan(angle) - angle


def inverse_involute(value: Array) -> Array:
    """Pressure angle of an involute function [rad], of the same sign; exact to rounding and differentiable."""
    value = jnp.asarray(value)
    known = jax.lax.stop_gradient(value)
    # tan a - a is a^3 / 3 for small a, and a tends to a quarter turn for large values: this start is within 10 %
    small = jnp.cbrt(3 * known)
    angle = jnp.where(known < 1.8, small / (1 + 0.12 * small**2), 0.5 * jnp.pi - 1 / (known + 0.5 * jnp.pi))
    for _ in range(INVOLUTE_STEPS):
        angle = _involute_step(angle, known)
    return _involute_step(jax.lax.stop_gradient(angle), value)


def _involute_step(angle: Array, value: Array) -> Array:
    """One step of Newton's method; the derivative of the involute function is the squared tangent."""
    tangent = jnp.tan(angle)
    return angle - (tangent - angle - value) / (tangent * tangent)


def base_radius(teeth: int | float, module: Scalar, pressure_angle: Scalar) -> Scalar:
    """Base circle radius ``r_b = z m cos(alpha) / 2`` (ISO 21771).

    Args:
        teeth: number of teeth.
        module: module [m].
        pressure_angle: pressure angle of the cutting rack [rad].

    Returns:
        The base radius [m].
    """
    return 0.5 * teeth * module * jnp.cos(pressure_angle)


def internal_centre_distance(
    teeth_difference: int, module: Scalar, cutting_angle: Scalar, working_angle: Scalar
) -> Scalar:
    """Working centre distance of an internal pair, ``a cos(alpha_w) = m (z_2 - z_1) cos(alpha) / 2`` (ISO 21771).

    Args:
        teeth_difference: ring teeth minus planet teeth.
        module: module [m].
        cutting_angle: pressure angle of the cutting rack [rad].
        working_angle: working pressure angle [rad].

    Returns:
        The centre distance [m].
    """
    return 0.5 * teeth_difference * module * jnp.cos(cutting_angle) / jnp.cos(working_angle)


class InvoluteGear(eqx.Module):
    """Flanks of a spur gear, external or internal (ISO 21771).

    Unlike in ISO 21771, the tooth number of an internal gear is positive, and a positive profile shift moves its teeth
    outwards.

    Args:
        teeth: number of teeth.
        module: module [m].
        pressure_angle: pressure angle of the cutting rack [rad].
        profile_shift: profile shift, in modules [-].
        addendum, dedendum: heights of tip and root from the shifted reference circle, in modules [-].
        internal: whether the teeth point inwards.

    Attributes:
        base_radius: base radius [m], calculated only once because most methods use it.
    """

    teeth: int = eqx.field(static=True)
    module: Scalar
    pressure_angle: Scalar
    profile_shift: Scalar
    addendum: Scalar
    dedendum: Scalar
    internal: bool = eqx.field(static=True)
    base_radius: Scalar

    def __init__(
        self,
        teeth: int,
        module: Scalar,
        pressure_angle: Scalar,
        profile_shift: Scalar,
        addendum: Scalar,
        dedendum: Scalar,
        internal: bool = False,
    ):
        self.teeth, self.module, self.pressure_angle, self.internal = teeth, module, pressure_angle, internal
        self.profile_shift, self.addendum, self.dedendum = profile_shift, addendum, dedendum
        self.base_radius = base_radius(teeth, module, pressure_angle)

    @property
    def reference_radius(self) -> Scalar:
        """Radius of the reference circle [m]."""
        return 0.5 * self.teeth * self.module

    @property
    def tip_radius(self) -> Scalar:
        """Radius of the tip circle [m]."""
        height = self.profile_shift - self.addendum if self.internal else self.profile_shift + self.addendum
        return self.reference_radius + self.module * height

    @property
    def root_radius(self) -> Scalar:
        """Radius of the root circle [m]."""
        height = self.profile_shift + self.dedendum if self.internal else self.profile_shift - self.dedendum
        return self.reference_radius + self.module * height

    @property
    def base_half_angle(self) -> Scalar:
        """Half of the angle of a tooth (external gear) or of a space (internal gear) at the base circle [rad]."""
        half = (0.5 * jnp.pi + 2 * self.profile_shift * jnp.tan(self.pressure_angle)) / self.teeth
        return half + involute(self.pressure_angle)

    @property
    def tip_roll(self) -> Scalar:
        """Roll angle at the tip, the tangent of the pressure angle there [rad]."""
        return self.roll_at(self.tip_radius)

    def roll_at(self, radius: Array) -> Array:
        """Roll angle at a radius, ``tan alpha_R`` [rad]; radii of any shape [m]."""
        ratio = radius / self.base_radius
        return jnp.sqrt((ratio - 1) * (ratio + 1))

    def from_tip(self, place: Array, tip: Scalar) -> Array:
        """How far places of any shape lie from the tip towards the root, in any measure that grows with the radius.

        Such a measure is the roll angle. The sign is known: gradients of an absolute value could be wrong at the tip,
        where the difference is zero but for rounding.
        """
        return place - tip if self.internal else tip - place

    def radius_at(self, roll: Array) -> Array:
        """Radius at a roll angle [m]."""
        return self.base_radius * jnp.sqrt(1 + roll**2)

    def pressure_angle_at(self, radius: Array) -> Array:
        """Pressure angle at a radius, between radius and flank, ``cos alpha_R = r_b / R`` [rad]; any shape [m]."""
        return jnp.arccos(self.base_radius / radius)

    def half_angle(self, radius: Array) -> Array:
        """Half of the angle that the material of a tooth fills at a radius [rad]; radii of any shape [m]."""
        filled = self.base_half_angle - involute(self.pressure_angle_at(radius))
        return jnp.pi / self.teeth - filled if self.internal else filled

    @property
    def first_radius(self) -> Scalar:
        """Radius at which a flank begins, just above the base circle [m]."""
        rounding = float(jnp.finfo(jnp.result_type(self.base_radius)).eps)
        return self.base_radius * (1 + max(ABOVE, ROUNDED * rounding))

    def section(self, radius: Array) -> tuple[Array, Array, Array]:
        """Section of a tooth at points of its profile, given by radii of any shape [m].

        Returns:
            Distance from the gear's axis along the middle of the tooth [m], half of the tooth thickness at that
            distance [m], and inclination of the flank's normal against the direction across the tooth [rad].
        """
        half, slant = self.half_angle(radius), self.pressure_angle_at(radius)
        return radius * jnp.cos(half), radius * jnp.sin(half), slant + half if self.internal else slant - half

    def half_thickness(self, level: Array) -> Array:
        """Half of the tooth thickness at distances from the gear's axis along the middle of the tooth, any shape [m].

        Below the base circle the flanks are radial.
        """
        radius = level / jnp.cos(self.half_angle(jnp.maximum(level, self.first_radius)))
        return radius * jnp.sin(self.half_angle(jnp.maximum(radius, self.first_radius)))
