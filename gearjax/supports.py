"""Supports of bodies: bearings that give way under the forces of the contacts."""

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
    """Support of one body. A direction that is not listed is rigid, and not computed.

    The axes are those of the body's gear set: x along the throw of a crank that carries the body and y across it,
    ahead; of wheels whose axes stand still as the gear set says. z is along the axis. Turns are about these axes, rz in
    the direction that the body turns in.

    Args:
        x, y, z: stiffness along an axis [N/m].
        rx, ry, rz: stiffness about an axis [N m/rad]; rz of a body that the input turns, held by its drive.
        x_damping, y_damping, z_damping: damping coefficient in that direction [N s/m]; undamped without.
        rx_damping, ry_damping, rz_damping: the same about an axis [N m s/rad].

    Raises:
        ParameterError: no direction is listed, or a stiffness is out of range.
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
            words = "or another direction must be given: the stiffness of the support there"
            raise ParameterError("x", MISSING, words)
        for way in DIRECTIONS:
            if getattr(self, way) is None and getattr(self, f"{way}_damping") is not None:
                raise ParameterError(
                    way, MISSING, f"must be given: {way}_damping is for a support that gives way in {way}"
                )

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions that are listed."""
        return tuple(way for way in DIRECTIONS if getattr(self, way) is not None)
