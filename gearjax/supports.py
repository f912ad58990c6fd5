"""Supports of bodies: bearings that give way under the forces of the contacts."""

import equinox as eqx

from gearjax import units
from gearjax.checks import MISSING, ParameterError
from gearjax.parameters import check_parameters, number
from gearjax.typing import Number

DIRECTIONS = ("x", "y")


class Support(eqx.Module):
    """Support of one body. A direction that is not listed is rigid, and not computed.

    Args:
        x: stiffness along the throw of the body's crank [N/m].
        y: stiffness across it, ahead [N/m].
        x_damping, y_damping: damping coefficient in that direction [N s/m]; undamped without.

    Raises:
        ParameterError: no direction is listed, or a stiffness is out of range.
    """

    x: Number | None = number(units.STIFFNESS, at_least=1.0, at_most=1e18, default=None, example="2e8 N/m")
    y: Number | None = number(units.STIFFNESS, at_least=1.0, at_most=1e18, default=None, example="2e8 N/m")

    x_damping: Number | None = number(units.DAMPING, at_least=0.0, at_most=1e12, default=None)
    y_damping: Number | None = number(units.DAMPING, at_least=0.0, at_most=1e12, default=None)

    def __check_init__(self):
        check_parameters(self)
        if not self.directions:
            raise ParameterError("x", MISSING, "or y must be given: the stiffness of the support in that direction")
        for way in DIRECTIONS:
            if getattr(self, way) is None and getattr(self, f"{way}_damping") is not None:
                raise ParameterError(
                    way, MISSING, f"must be given: {way}_damping is for a support that gives way in {way}"
                )

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions that are listed."""
        return tuple(way for way in DIRECTIONS if getattr(self, way) is not None)
