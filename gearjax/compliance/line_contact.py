"""Elastic line contact of pins on flanks: the force does not grow in proportion to the approach."""

import math
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from gearjax import units
from gearjax.contact import LineSprings, Places, Slices
from gearjax.geometry.line_contact import Radii
from gearjax.parameters import check_parameters, length, number
from gearjax.typing import Array, Float, Number, Scalar

DEEPEST = 1.0  # m, furthest point of a body that its approach counts to: to one endlessly far it would be endless


class AbstractLineContact(eqx.Module):
    """A pin on a flank of the same material: approach under a force F of two points, one in each body, each as deep as
    the radius of curvature there,

    ``2 F W / pi (ln(16 r |rho| / c^2) + constant)``, ``c = width sqrt(4 W F R)``, ``W = (1 - nu^2) / (E b)``.

    R is the relative radius of curvature of convex and concave flanks, ``r rho / (rho + r)`` with the flank's sign. On
    a convex flank the point lies at its centre of curvature. On a hollow flank, whose centre of curvature lies outside
    the body, it lies as deep in the body as that centre is away; a flat flank counts 1 m deep. The depth hardly
    matters: ten times as deep is 2.3 more in a bracket of 11 to 15.
    """

    kind: eqx.AbstractClassVar[str]
    width: eqx.AbstractClassVar[float]
    constant: eqx.AbstractClassVar[float]
    youngs_modulus: eqx.AbstractVar[Array]
    poissons_ratio: eqx.AbstractVar[Array]
    face_width: eqx.AbstractVar[Array]

    @property
    def plane_modulus(self) -> Scalar:
        """``E' = E / (1 - nu^2)`` [Pa]."""
        return self.youngs_modulus / (1 - self.poissons_ratio * self.poissons_ratio)

    @property
    def compliance(self) -> Scalar:
        """``W = (1 - nu^2) / (E b)`` [m/N]."""
        return (1 - self.poissons_ratio * self.poissons_ratio) / (self.youngs_modulus * self.face_width)

    def springs(self, radii: Radii) -> LineSprings:
        """The contacts as springs; ``r |rho| / R`` is the radius of the curve that the pin's centre follows."""
        straightness = 0.5 * jnp.log(radii.centre_curvature * radii.centre_curvature + 1 / DEEPEST**2)
        level = self.constant + math.log(4 / self.width**2) - jnp.log(self.compliance) - straightness
        return LineSprings(jnp.broadcast_to(2 / math.pi * self.compliance, level.shape), level)

    def pressure(self, radii: Radii, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Highest pressure in each contact by Hertz, ``sqrt(F / (2 pi W R)) / b``, shape (contact,) [Pa]."""
        square = forces / (2 * math.pi * self.compliance * radii.relative)
        return jnp.where(forces > 0, jnp.sqrt(jnp.where(forces > 0, square, 1.0)), 0.0) / self.face_width

    def flank_pressure(self, places: Places, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Highest pressure in each contact of tooth flanks, shape (contact,) [Pa].

        With the line load ``F' = F / b_i`` on the part ``b_i`` of the face that a contact stands for (`Places.strips`),
        the larger of that of Hertz, ``sqrt(F' E' kappa / (2 pi))``, ``E' = E / (1 - nu^2)``, with the relative
        curvature kappa (Johnson 1985, eq. 4.44), and of ``F' / s`` on its part ``s`` of the profile. Flanks of gears of
        few teeth difference are so alike that Hertz' contact would be wider than what they share: an even pressure
        is all that a strip of the profile tells, and its edge at a tip bears more.
        """
        each = forces.reshape(*places.radius[0].shape, len(places.face))
        along, across = places.strips(self.face_width)
        line = each / across[None, None, None]
        square = line * self.plane_modulus / (2 * math.pi) * places.curvature[..., None]
        pressed = square > 0
        hertz = jnp.where(pressed, jnp.sqrt(jnp.where(pressed, square, 1.0)), 0.0)
        carries = (each > 0) & (along > 0)[..., None]
        even = jnp.where(carries, line / jnp.where(carries, along[..., None], 1.0), 0.0)
        return jnp.maximum(hertz, even).ravel()

    def slice_pressure(self, slices: Slices, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Highest pressure in each slice of contact lines, shape (contact,) [Pa].

        That of Hertz under the force per length of the line, ``sqrt(F' E' kappa / (2 pi))`` as `flank_pressure`.
        """
        carries = (forces > 0) & (slices.lengths > 0)
        line = jnp.where(carries, forces, 1.0) / jnp.where(carries, slices.lengths, 1.0)
        square = line * self.plane_modulus / (2 * math.pi) * slices.curvature.ravel()
        return jnp.where(carries, jnp.sqrt(jnp.where(carries, square, 1.0)), 0.0)


class HertzLineContact(AbstractLineContact):
    """Elastic line contact by Hertz: ``2 F W / pi (ln(4 r / c) + ln(4 |rho| / c) - 1)`` with the half-width
    ``c^2 = 8 W F R / pi`` (Johnson 1985, eqs. 4.43 and 5.58).

    Roark's formula, ``2/3 + ln(2 D1 / b) + ln(2 D2 / b)`` with the full width b, is 2.5 % stiffer to softer than it.

    Args:
        youngs_modulus: E, of pins and disc [Pa].
        poissons_ratio: nu, of pins and disc [-].
        face_width: b, length of the contact lines [m].
    """

    kind: ClassVar[str] = "hertz_line_contact"
    width: ClassVar[float] = math.sqrt(2 / math.pi)
    constant: ClassVar[float] = -1.0
    youngs_modulus: Number = number(units.PRESSURE, at_least=1e3, at_most=1e13)
    poissons_ratio: Number = number(units.RATIO, at_least=0.0, at_most=0.5, example=0.3)
    face_width: Number = length(at_least=1e-6, at_most=10.0, example="11 mm")

    def __check_init__(self):
        check_parameters(self)

    @classmethod
    def of_teeth(cls, teeth: Any) -> "HertzLineContact":
        """That of the flanks of elastic teeth, which meet over the narrower one's width.

        Args:
            teeth: a compliance with ``youngs_modulus``, ``poissons_ratio``, ``external_width`` and ``internal_width``.
        """
        width = jnp.minimum(teeth.external_width, teeth.internal_width)
        return cls(teeth.youngs_modulus, teeth.poissons_ratio, width)


class HuLineContact(AbstractLineContact):
    """Line contact of Hu et al. (2020), eqs. 38-39: ``2 F W / pi (2/3 + ln(16 r |rho| / c^2))`` with
    ``c = 4.99e-3 sqrt(4 W F R)``.

    The width is not Hertz': contacts come out about twice as soft. It is here to reproduce the paper.

    Args:
        youngs_modulus: E, of pins and disc [Pa].
        poissons_ratio: nu, of pins and disc [-].
        face_width: b, length of the contact lines [m].
    """

    kind: ClassVar[str] = "hu_line_contact"
    width: ClassVar[float] = 4.99e-3
    constant: ClassVar[float] = 2 / 3
    youngs_modulus: Number = number(units.PRESSURE, at_least=1e3, at_most=1e13)
    poissons_ratio: Number = number(units.RATIO, at_least=0.0, at_most=0.5, example=0.3)
    face_width: Number = length(at_least=1e-6, at_most=10.0, example="11 mm")

    def __check_init__(self):
        check_parameters(self)


LINE_CONTACTS: tuple[type[AbstractLineContact], ...] = (HertzLineContact, HuLineContact)
