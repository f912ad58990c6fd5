"""Elastic line contact of pins on flanks, whose force is not proportional to the approach."""

import math
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from gearjax import units
from gearjax.choosing import Choosing
from gearjax.contact import LineSprings, Places, Slices
from gearjax.contact.slices import by_side
from gearjax.geometry.line_contact import Radii
from gearjax.parameters import check_parameters, length, number
from gearjax.typing import Array, Float, Number, Scalar

DEEPEST = 1.0  # m, greatest depth of a reference point: the approach of an infinitely deep point would be infinite


class AbstractLineContact(Choosing):
    """Line contact of a pin on a flank of the same material.

    The approach under a force F is that of two reference points, one in each body. Each point is as deep in its body as
    the radius of curvature of the surface:

    ``2 F W / pi (ln(16 r |rho| / c^2) + constant)``, ``c = width sqrt(4 W F R)``, ``W = (1 - nu^2) / (E b)``.

    R is the relative radius of curvature of convex and concave flanks, ``r rho / (rho + r)`` with the flank's sign. On
    a convex flank the reference point is the centre of curvature. The centre of curvature of a concave flank lies
    outside the body; the reference point then has the same distance from the surface, but inside the body. For a flat
    flank the depth is 1 m. The depth has little influence: ten times the depth adds 2.3 to a bracket of 11 to 15.
    """

    kind: eqx.AbstractClassVar[str]
    width: eqx.AbstractClassVar[float]
    constant: eqx.AbstractClassVar[float]
    youngs_modulus: eqx.AbstractVar[Array]
    poissons_ratio: eqx.AbstractVar[Array]
    face_width: eqx.AbstractVar[Array]

    @property
    def plane_modulus(self) -> Scalar:
        """Plane-strain modulus ``E' = E / (1 - nu^2)`` [Pa]."""
        return self.youngs_modulus / (1 - self.poissons_ratio * self.poissons_ratio)

    @property
    def compliance(self) -> Scalar:
        """Compliance ``W = (1 - nu^2) / (E b)`` of the contact's width [m/N]."""
        return (1 - self.poissons_ratio * self.poissons_ratio) / (self.youngs_modulus * self.face_width)

    def springs(self, radii: Radii) -> LineSprings:
        """Springs of the contacts; ``r |rho| / R`` is the radius of the curve that the pin's centre follows."""
        straightness = 0.5 * jnp.log(radii.centre_curvature * radii.centre_curvature + 1 / DEEPEST**2)
        level = self.constant + math.log(4 / self.width**2) - jnp.log(self.compliance) - straightness
        return LineSprings(jnp.broadcast_to(2 / math.pi * self.compliance, level.shape), level)

    def pressure(self, radii: Radii, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Highest Hertzian pressure in each contact, ``sqrt(F / (2 pi W R)) / b``, shape (contact,) [Pa]."""
        square = forces / (2 * math.pi * self.compliance * radii.relative)
        return jnp.where(forces > 0, jnp.sqrt(jnp.where(forces > 0, square, 1.0)), 0.0) / self.face_width

    def flank_pressure(self, places: Places, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Highest pressure in each contact of tooth flanks, shape (contact,) [Pa].

        A contact represents the part ``b_i`` of the face and the part ``s`` of the profile (`Places.strips`). With its
        line load ``F' = F / b_i`` the pressure is the larger of two values: the Hertzian pressure
        ``sqrt(F' E' kappa / (2 pi))``, ``E' = E / (1 - nu^2)``, with the relative curvature kappa (Johnson 1985,
        eq. 4.44), and the mean pressure ``F' / s`` on the strip. The flanks of gears with few teeth difference are so
        similar that a Hertzian contact would be wider than the length that both flanks share. The mean pressure is then
        all that can be calculated; the true pressure at the edge of a tip is higher.
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

    def slice_pressure(self, slices: tuple[Slices, ...], forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Highest pressure in each slice of the contact lines of all meshes, shape (contact,) [Pa].

        It is the Hertzian pressure ``sqrt(F' E' kappa / (2 pi))`` under the force F' per length of the contact line, as
        in `flank_pressure`.
        """
        sides = slices[0].share.shape[0]
        lengths = by_side([mesh.lengths for mesh in slices], sides)
        curvature = by_side([mesh.curvature.ravel() for mesh in slices], sides)
        carries = (forces > 0) & (lengths > 0)
        line = jnp.where(carries, forces, 1.0) / jnp.where(carries, lengths, 1.0)
        square = line * self.plane_modulus / (2 * math.pi) * curvature
        return jnp.where(carries, jnp.sqrt(jnp.where(carries, square, 1.0)), 0.0)


class HertzLineContact(AbstractLineContact):
    """Elastic line contact by Hertz: ``2 F W / pi (ln(4 r / c) + ln(4 |rho| / c) - 1)``.

    The half-width c of the contact follows from ``c^2 = 8 W F R / pi`` (Johnson 1985, eqs. 4.43 and 5.58). Roark's
    formula, ``2/3 + ln(2 D1 / b) + ln(2 D2 / b)`` with the full width b, is up to 2.5 % stiffer or softer.

    Args:
        youngs_modulus: Young's modulus E of pins and disc [Pa].
        poissons_ratio: Poisson's ratio nu of pins and disc [-].
        face_width: length b of the contact lines [m].
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
        """Line contact of the flanks of elastic teeth, over the width of the narrower gear.

        Args:
            teeth: a compliance with ``youngs_modulus``, ``poissons_ratio``, ``external_width`` and ``internal_width``.
        """
        width = jnp.minimum(teeth.external_width, teeth.internal_width)
        return cls(teeth.youngs_modulus, teeth.poissons_ratio, width)


class HuLineContact(AbstractLineContact):
    """Line contact of Hu et al. (2020), eqs. 38-39: ``2 F W / pi (2/3 + ln(16 r |rho| / c^2))`` with
    ``c = 4.99e-3 sqrt(4 W F R)``.

    The half-width c differs from Hertz: contacts are about twice as soft. The formula serves to reproduce the paper.

    Args:
        youngs_modulus: Young's modulus E of pins and disc [Pa].
        poissons_ratio: Poisson's ratio nu of pins and disc [-].
        face_width: length b of the contact lines [m].
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
