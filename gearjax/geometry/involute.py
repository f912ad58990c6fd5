"""Involute gears: base circles, flanks of external and internal gears, centre distance."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.typing import Array, Scalar

INVOLUTE_STEPS = 6  # of Newton's method
ABOVE = 1e-9  # of the base radius, where a flank begins: at it slopes are endless


def involute(angle: Array) -> Array:
    """Involute function ``inv alpha = tan alpha - alpha`` of a pressure angle [rad] (ISO 21771)."""
    return jnp.tan(angle) - angle


def inverse_involute(value: Array) -> Array:
    """Pressure angle of an involute function, positive [rad]; to rounding, differentiable."""
    value = jnp.asarray(value)
    known = jax.lax.stop_gradient(value)
    # of small angles tan a - a is a^3 / 3, of large ones a nears a quarter turn: between them within 10 %
    small = jnp.cbrt(3 * known)
    angle = jnp.where(known < 1.8, small / (1 + 0.12 * small**2), 0.5 * jnp.pi - 1 / (known + 0.5 * jnp.pi))
    for _ in range(INVOLUTE_STEPS):
        angle = _involute_step(angle, known)
    return _involute_step(jax.lax.stop_gradient(angle), value)


def _involute_step(angle: Array, value: Array) -> Array:
    """One of Newton's method, whose slope is the square of the tangent."""
    tangent = jnp.tan(angle)
    return angle - (tangent - angle - value) / (tangent * tangent)


def base_radius(teeth: int | float, module: Scalar, pressure_angle: Scalar) -> Scalar:
    """Base circle radius ``r_b = z m cos(alpha) / 2`` (ISO 21771).

    Args:
        teeth: number of teeth.
        module: module [m].
        pressure_angle: pressure angle of the cutting rack [rad].

    Returns:
        The radius [m].
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
    """Flanks of a spur gear, external or internal (ISO 21771, with the tooth number and the shift of an internal gear
    counted as positive: a positive shift takes its teeth outwards).

    Args:
        teeth: number of teeth.
        module: [m].
        pressure_angle: of the cutting rack [rad].
        profile_shift: in modules [-].
        addendum, dedendum: heights of tip and root from the shifted reference circle, in modules [-].
        internal: whether the teeth point inwards.

    Attributes:
        base_radius: [m], worked out once, as most of what follows asks for it.
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
        """[m]."""
        return 0.5 * self.teeth * self.module

    @property
    def tip_radius(self) -> Scalar:
        """[m]."""
        height = self.profile_shift - self.addendum if self.internal else self.profile_shift + self.addendum
        return self.reference_radius + self.module * height

    @property
    def root_radius(self) -> Scalar:
        """[m]."""
        height = self.profile_shift + self.dedendum if self.internal else self.profile_shift - self.dedendum
        return self.reference_radius + self.module * height

    @property
    def base_half_angle(self) -> Scalar:
        """Half of the angle between the flanks of a tooth, of a space of an internal gear, where they meet the base
        circle [rad]."""
        half = (0.5 * jnp.pi + 2 * self.profile_shift * jnp.tan(self.pressure_angle)) / self.teeth
        return half + involute(self.pressure_angle)

    @property
    def tip_roll(self) -> Scalar:
        """Roll angle at the tip, the tangent of the pressure angle there [rad]."""
        return self.roll_at(self.tip_radius)

    def roll_at(self, radius: Array) -> Array:
        """Roll angle at a radius, ``tan alpha_R`` [rad], of radii of any shape [m]."""
        ratio = radius / self.base_radius
        return jnp.sqrt((ratio - 1) * (ratio + 1))

    def radius_at(self, roll: Array) -> Array:
        """Radius at a roll angle [m]."""
        return self.base_radius * jnp.sqrt(1 + roll**2)

    def pressure_angle_at(self, radius: Array) -> Array:
        """Angle between radius and flank, ``cos alpha_R = r_b / R`` [rad], of radii of any shape [m]."""
        return jnp.arccos(self.base_radius / radius)

    def half_angle(self, radius: Array) -> Array:
        """Half of the angle that the material of a tooth fills at a radius [rad], radii of any shape [m]."""
        filled = self.base_half_angle - involute(self.pressure_angle_at(radius))
        return jnp.pi / self.teeth - filled if self.internal else filled

    @property
    def first_radius(self) -> Scalar:
        """Radius where a flank begins, just above the base circle [m]."""
        return self.base_radius * (1 + ABOVE)

    def section(self, radius: Array) -> tuple[Array, Array, Array]:
        """Of a tooth at a point of its profile: distance from the gear's axis along the middle of the tooth, half of
        the thickness there [m], and angle of the normal from straight across [rad]; radii of any shape [m]."""
        half, slant = self.half_angle(radius), self.pressure_angle_at(radius)
        return radius * jnp.cos(half), radius * jnp.sin(half), slant + half if self.internal else slant - half

    def half_thickness(self, level: Array) -> Array:
        """Half of the thickness of a tooth at distances from the gear's axis along its middle, of any shape [m]; below
        the base circle flanks go on along the radius."""
        radius = level / jnp.cos(self.half_angle(jnp.maximum(level, self.first_radius)))
        return radius * jnp.sin(self.half_angle(jnp.maximum(radius, self.first_radius)))
