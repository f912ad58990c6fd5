"""Elastic line contact of pins on flanks: the force does not grow in proportion to the approach."""

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from gearjax import units
from gearjax.contact import LineSprings
from gearjax.geometry.line_contact import Radii
from gearjax.parameters import check_parameters, length, number
from gearjax.typing import Array, Float, Number, Scalar

STRAIGHTEST = 1.0  # m, radius of curvature above which a flank counts as straight: its approach would be endless


class AbstractLineContact(eqx.Module):
    """A pin on a flank of the same material: approach under a force F,
    ``2 F W / pi (2/3 + ln(16 r |rho| / c^2))``, half-width ``c = half_width sqrt(4 W F R)``, ``W = (1 - nu^2) / (E b)``
    (Hu et al. 2020, eqs. 38-39).

    R is the relative radius of curvature of convex and concave flanks, ``r rho / (rho + r)`` with the flank's sign.
    """

    kind: eqx.AbstractClassVar[str]
    half_width: eqx.AbstractClassVar[float]
    youngs_modulus: eqx.AbstractVar[Array]
    poissons_ratio: eqx.AbstractVar[Array]
    face_width: eqx.AbstractVar[Array]

    @property
    def compliance(self) -> Scalar:
        """``W = (1 - nu^2) / (E b)`` [m/N]."""
        return (1 - self.poissons_ratio * self.poissons_ratio) / (self.youngs_modulus * self.face_width)

    def springs(self, radii: Radii) -> LineSprings:
        """The contacts as springs; ``r |rho| / R`` is the radius of the curve that the pin's centre follows."""
        straightness = 0.5 * jnp.log(radii.centre_curvature * radii.centre_curvature + 1 / STRAIGHTEST**2)
        level = 2 / 3 + math.log(4 / self.half_width**2) - jnp.log(self.compliance) - straightness
        return LineSprings(jnp.broadcast_to(2 / math.pi * self.compliance, level.shape), level)

    def pressure(self, radii: Radii, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Highest pressure in each contact by Hertz, ``sqrt(F / (2 pi W R)) / b``, shape (contact,) [Pa]."""
        square = forces / (2 * math.pi * self.compliance * radii.relative)
        return jnp.where(forces > 0, jnp.sqrt(jnp.where(forces > 0, square, 1.0)), 0.0) / self.face_width


class HertzLineContact(AbstractLineContact):
    """Line contact with Hertz' half-width, ``c^2 = 8 W F R / pi`` (Johnson 1985, eq. 4.43).

    Args:
        youngs_modulus: E, of pins and disc [Pa].
        poissons_ratio: nu, of pins and disc [-].
        face_width: b, length of the contact lines [m].
    """

    kind: ClassVar[str] = "hertz_line_contact"
    half_width: ClassVar[float] = math.sqrt(2 / math.pi)
    youngs_modulus: Number = number(units.PRESSURE, at_least=1e3, at_most=1e13)
    poissons_ratio: Number = number(units.RATIO, at_least=0.0, at_most=0.5, example=0.3)
    face_width: Number = length(at_least=1e-6, at_most=10.0, example="11 mm")

    def __check_init__(self):
        check_parameters(self)


class HuLineContact(AbstractLineContact):
    """Line contact with the half-width of Hu et al. (2020), eq. 39, ``c = 4.99e-3 sqrt(4 W F R)``.

    The constant is not Hertz': contacts come out about 1.75 times as soft. It is here to reproduce the paper.

    Args:
        youngs_modulus: E, of pins and disc [Pa].
        poissons_ratio: nu, of pins and disc [-].
        face_width: b, length of the contact lines [m].
    """

    kind: ClassVar[str] = "hu_line_contact"
    half_width: ClassVar[float] = 4.99e-3
    youngs_modulus: Number = number(units.PRESSURE, at_least=1e3, at_most=1e13)
    poissons_ratio: Number = number(units.RATIO, at_least=0.0, at_most=0.5, example=0.3)
    face_width: Number = length(at_least=1e-6, at_most=10.0, example="11 mm")

    def __check_init__(self):
        check_parameters(self)


LINE_CONTACTS: tuple[type[AbstractLineContact], ...] = (HertzLineContact, HuLineContact)
