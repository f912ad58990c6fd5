"""Inertia and damping, for the dynamic transmission error."""

import equinox as eqx
import jax.numpy as jnp

from gearjax import units
from gearjax.checks import MISSING, ParameterError
from gearjax.parameters import check_parameters, name, number
from gearjax.typing import Array, Float, Number, Scalar


class EquivalentMass(eqx.Module):
    """Inertia of the output as a mass on the line of action (Wang et al. 2020, eq. 19).

    Where levers turn with the input, those at input angle zero make it a moment of inertia, which is constant.

    Args:
        mass: equivalent mass [kg].
    """

    mass: Number = number(units.MASS, at_least=1e-9, at_most=1e9)

    def __check_init__(self):
        check_parameters(self)

    def moment(self, lever: Float[Array, " contact"]) -> Scalar:
        """Moment of inertia on the output's axis, ``mass * mean(lever^2)`` [kg m2]."""
        return self.mass * jnp.mean(lever * lever)

    def at_contacts(self, lever: Float[Array, " contact"]) -> Scalar:
        """As a mass on the line of action [kg]."""
        return self.mass


class MomentOfInertia(eqx.Module):
    """Inertia of the output about its axis, its load included.

    Args:
        moment_of_inertia: [kg m2].
    """

    moment_of_inertia: Number = number(units.INERTIA, at_least=1e-12, at_most=1e9)

    def __check_init__(self):
        check_parameters(self)

    def moment(self, lever: Float[Array, " contact"]) -> Scalar:
        """Moment of inertia on the output's axis [kg m2]."""
        return self.moment_of_inertia

    def at_contacts(self, lever: Float[Array, " contact"]) -> Scalar:
        """As a mass on the line of action, ``moment / mean(lever^2)`` [kg]."""
        return self.moment_of_inertia / jnp.mean(lever * lever)


class BodyInertia(eqx.Module):
    """Inertia of one body that moves on its own, for the dynamic transmission error.

    Args:
        mass: of a body that moves along x, y or z [kg].
        polar: about the axis that it turns about, of a body on a shaft that turns freely or twists, or with a support
            in rz [kg m2]. The inertia of the output itself does not count this body again.
        transverse: about the axes across, of a body with a support in rx or ry [kg m2].

    Raises:
        ParameterError: none is given, or one is out of range.
    """

    mass: Number | None = number(units.MASS, at_least=1e-9, at_most=1e9, default=None)
    polar: Number | None = number(units.INERTIA, at_least=1e-15, at_most=1e9, default=None)
    transverse: Number | None = number(units.INERTIA, at_least=1e-15, at_most=1e9, default=None)

    def __check_init__(self):
        check_parameters(self)
        if self.mass is None and self.polar is None and self.transverse is None:
            raise ParameterError("mass", MISSING, "polar or transverse must be given: what the body's motion needs")


OF_WAY = {"x": "mass", "y": "mass", "z": "mass", "rx": "transverse", "ry": "transverse", "rz": "polar"}
"""The inertia that a motion in each direction needs."""


class DampingRatio(eqx.Module):
    """Viscous damping of each pair, ``c = ratio sqrt(2 k m)``.

    Slices of contact lines have dampers in proportion to their stiffness, ``c = b k``: altogether, on average, as many
    times that of a pair as pairs touch, ``b K = ratio sqrt(2 eps_gamma K m)`` with the mean stiffness K of the mesh.

    Args:
        ratio: damping ratio [-]; k is the mean stiffness of the pair, m the equivalent mass.
        acting: ``"contact"`` while one of its flanks is in contact, or ``"always"``, through the clearance too.
    """

    ratio: Number = number(units.RATIO, at_least=0.0, at_most=100.0)
    acting: str = name(default="contact", names=("contact", "always"))

    def __check_init__(self):
        check_parameters(self)

    def coefficient(self, stiffness: Float[Array, "*pair"], mass: Float[Array, "..."]) -> Float[Array, "*pair"]:
        """Damping coefficient of each pair [N s/m]."""
        return self.ratio * jnp.sqrt(2.0 * stiffness * mass)
