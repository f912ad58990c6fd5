"""Fillet at the root of an external gear that a rack with a rounded tip has cut (ISO 21771; Ma et al. 2014)."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.geometry.involute import InvoluteGear
from gearjax.typing import Array, Scalar


class RootFillet(eqx.Module):
    """Fillet between the root circle and the involute, the envelope of the rounded tip of a rack.

    A point of it is given by the angle gamma of its normal to the pitch line of the rack. It begins on the root circle
    at 90 deg, and ends at the pressure angle of the rack, where the involute begins if there is no undercut.

    Args:
        gear: the gear in the transverse section.
        rounding: radius of the tip of the rack [m]. In the transverse section of a helical gear it is an ellipse, which
            a circle of this radius stands for.

    Attributes:
        depth: depth of the centre of the rounding below the pitch line of the rack, which rolls on the reference circle
            [m].
        place: distance of this centre from the middle of the space of the rack along the pitch line [m].
    """

    gear: InvoluteGear
    rounding: Scalar
    depth: Scalar
    place: Scalar

    def __init__(self, gear: InvoluteGear, rounding: Scalar):
        self.gear, self.rounding = gear, rounding
        self.depth = gear.reference_radius - gear.root_radius - rounding
        flank = (gear.module * gear.dedendum - rounding) * jnp.tan(gear.pressure_angle)
        self.place = 0.25 * jnp.pi * gear.module + flank + rounding / jnp.cos(gear.pressure_angle)

    @property
    def most_rounding(self) -> Scalar:
        """Radius at which the roundings at both flanks of the rack's tip meet [m]."""
        gear = self.gear
        half = 0.25 * jnp.pi * gear.module - gear.module * gear.dedendum * jnp.tan(gear.pressure_angle)
        return half * jnp.cos(gear.pressure_angle) / (1 - jnp.sin(gear.pressure_angle))

    @property
    def root_angle(self) -> Scalar:
        """Half of the angle of the tooth where the fillet meets the root circle [rad]."""
        return self.place / self.gear.reference_radius

    def at(self, gamma: Array) -> tuple[Array, Array]:
        """Half of the thickness of the tooth, and distance of this section from the axis of the gear [m]."""
        radius, reach = self.gear.reference_radius, self.depth / jnp.sin(gamma) + self.rounding
        turned = (self.depth / jnp.tan(gamma) + self.place) / radius
        half = radius * jnp.sin(turned) - reach * jnp.cos(gamma - turned)
        return half, radius * jnp.cos(turned) - reach * jnp.sin(gamma - turned)

    def sections(self, nodes: Array) -> tuple[Array, Array, Array]:
        """Sections at some shares of the way from the root circle to the involute.

        Returns:
            Half of the thickness [m], distance from the axis of the gear [m], and the derivative of the latter by the
            share [m].
        """
        begin, end = 0.5 * jnp.pi, self.gear.pressure_angle

        def at(share: Array) -> tuple[Array, Array]:
            return self.at(begin + share * (end - begin))

        (half, level), (_, rise) = jax.jvp(at, (nodes,), (jnp.ones_like(nodes),))
        return half, level, rise
