"""Supports of bodies: elastic bearings that deflect under the contact forces."""

from typing import Any

import equinox as eqx

from gearjax import units
from gearjax.checks import MISSING, ParameterError
from gearjax.parameters import check_parameters, number
from gearjax.typing import Number

SHIFTS, TURNS = ("x", "y", "z"), ("rx", "ry", "rz")
DIRECTIONS = SHIFTS + TURNS


def _stiffness() -> Any:
    return number(units.STIFFNESS, at_least=1.0, at_most=1e18, default=None, example="2e8 N/m")


def _damping() -> Any:
    return number(units.DAMPING, at_least=0.0, at_most=1e12, default=None)


def _turning() -> Any:
    return number(units.TORSION, at_least=1e-3, at_most=1e18, default=None, example="1e7 N*m/rad")


def _turning_damping() -> Any:
    return number(units.TORSION_DAMPING, at_least=0.0, at_most=1e12, default=None)


class Support(eqx.Module):
    """Support of one body. A direction that is not listed is rigid, and its motion is not computed.

    The gear set defines the axes. If a crank carries the body, x points along the throw and y perpendicular to it, in
    the crank's sense of rotation; for wheels on fixed axes see the gear set. z is parallel to the axis of rotation. rx,
    ry and rz are rotations about these axes, rz positive in the direction in which the body turns.

    Args:
        x, y, z: stiffness along this axis [N/m].
        rx, ry: stiffness against rotation about this axis [N m/rad].
        rz: stiffness against rotation about this axis [N m/rad], only for the body that the input turns: the
            stiffness of its drive.
        x_damping, y_damping, z_damping: damping coefficient along this axis [N s/m]; without it there is no damping.
        rx_damping, ry_damping, rz_damping: damping coefficient of rotation about this axis [N m s/rad]; without it
            there is no damping.

    Raises:
        ParameterError: no direction is listed, a number is out of range, or a damping has no stiffness.
    """

    x: Number | None = _stiffness()
    y: Number | None = _stiffness()
    z: Number | None = _stiffness()
    rx: Number | None = _turning()
    ry: Number | None = _turning()
    rz: Number | None = _turning()
    x_damping: Number | None = _damping()
    y_damping: Number | None = _damping()
    z_damping: Number | None = _damping()
    rx_damping: Number | None = _turning_damping()
    ry_damping: Number | None = _turning_damping()
    rz_damping: Number | None = _turning_damping()

    def __check_init__(self):
        check_parameters(self)
        if not self.directions:
            words = "the stiffness of the support must be given for x or another direction"
            raise ParameterError("x", MISSING, words)
        for way in DIRECTIONS:
            if getattr(self, way) is None and getattr(self, f"{way}_damping") is not None:
                raise ParameterError(
                    way, MISSING, f"must be given: {way}_damping is for a support that gives way in {way}"
                )

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions for which a stiffness is listed."""
        return tuple(way for way in DIRECTIONS if getattr(self, way) is not None)
