"""Inertia and damping, for the dynamic transmission error."""

import equinox as eqx
import jax.numpy as jnp

from gearjax import units
from gearjax.checks import MISSING, ParameterError
from gearjax.parameters import check_parameters, name, number
from gearjax.typing import Array, Float, Number, Scalar


class EquivalentMass(eqx.Module):
    """Inertia of the output as a mass on the line of action (Wang et al. 2020, eq. 19).

    The levers of the contacts convert it to a moment of inertia. If the levers change with the input angle, those at
    input angle zero are used, so that the moment of inertia is constant.

    Args:
        mass: equivalent mass on the line of action [kg].
    """

    mass: Number = number(units.MASS, at_least=1e-9, at_most=1e9)

    def __check_init__(self):
        check_parameters(self)

    def moment(self, lever: Float[Array, " contact"]) -> Scalar:
        """Moment of inertia about the output's axis, ``mass * mean(lever^2)`` [kg m2]."""
        return self.mass * jnp.mean(lever * lever)

    def at_contacts(self, lever: Float[Array, " contact"]) -> Scalar:
        """Equivalent mass on the line of action [kg]."""
        return self.mass


class MomentOfInertia(eqx.Module):
    """Inertia of the output about its axis, including its load.

    Args:
        moment_of_inertia: moment of inertia of the output and its load about the output's axis [kg m2].
    """

    moment_of_inertia: Number = number(units.INERTIA, at_least=1e-12, at_most=1e9)

    def __check_init__(self):
        check_parameters(self)

    def moment(self, lever: Float[Array, " contact"]) -> Scalar:
        """Moment of inertia about the output's axis [kg m2]."""
        return self.moment_of_inertia

    def at_contacts(self, lever: Float[Array, " contact"]) -> Scalar:
        """Equivalent mass on the line of action, ``moment / mean(lever^2)`` [kg]."""
        return self.moment_of_inertia / jnp.mean(lever * lever)


class BodyInertia(eqx.Module):
    """Inertia of one body that moves on its own, for the dynamic transmission error.

    Args:
        mass: mass of a body that moves along x, y or z [kg].
        polar: moment of inertia about the axis of rotation [kg m2], for a body on a shaft that turns freely or twists,
            or for a body with a support in rz. Do not include it in the inertia of the output as well.
        transverse: moment of inertia about the axes x and y [kg m2], for a body with a support in rx or ry.

    Raises:
        ParameterError: none of them is given, or one is out of range.
    """

    mass: Number | None = number(units.MASS, at_least=1e-9, at_most=1e9, default=None)
    polar: Number | None = number(units.INERTIA, at_least=1e-15, at_most=1e9, default=None)
    transverse: Number | None = number(units.INERTIA, at_least=1e-15, at_most=1e9, default=None)

    def __check_init__(self):
        check_parameters(self)
        if self.mass is None and self.polar is None and self.transverse is None:
            raise ParameterError(
                "mass", MISSING, "mass, polar or transverse must be given, depending on the body's motion"
            )


OF_WAY = {"x": "mass", "y": "mass", "z": "mass", "rx": "transverse", "ry": "transverse", "rz": "polar"}
"""The kind of inertia that a motion in each direction needs."""


class DampingRatio(eqx.Module):
    """Viscous damping of each pair, ``c = ratio sqrt(2 k m)``.

    Each slice of a contact line has a damper in proportion to its stiffness, ``c = b k``, with
    ``b K = ratio sqrt(2 eps_gamma K m)``. K is the mean stiffness of the mesh and eps_gamma the total contact ratio, so
    that the mesh has, on average, the dampers of as many pairs as touch. The stiffness of a line contact grows slowly
    with its force. Its dampers are those of the stiffness under the mean force, which contacts have that share the
    torque evenly at input angle 0.

    Args:
        ratio: damping ratio [-] of a pair in ``c = ratio sqrt(2 k m)``, with the mean stiffness k of the pair and the
            equivalent mass m.
        acting: when the damper of a pair acts: ``"contact"``, while a flank of the pair is in contact, along that
            flank, or ``"always"``, also while the pair is separated, along its driving flank; in an involute RV reducer
            that is every candidate flank, so that damping grows with their number.
    """

    ratio: Number = number(units.RATIO, at_least=0.0, at_most=100.0)
    acting: str = name(default="contact", names=("contact", "always"))

    def __check_init__(self):
        check_parameters(self)

    def coefficient(self, stiffness: Float[Array, "*pair"], mass: Float[Array, "..."]) -> Float[Array, "*pair"]:
        """Damping coefficient of each pair [N s/m]."""
        return self.ratio * jnp.sqrt(2.0 * stiffness * mass)
