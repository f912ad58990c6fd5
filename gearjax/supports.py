"""Supports of bodies: bearings that give way under the forces of the contacts."""

import equinox as eqx

from gearjax import units
from gearjax.checks import MISSING, ParameterError
from gearjax.parameters import check_parameters, declared, number
from gearjax.typing import Number


class Support(eqx.Module):
    """Support of one body. A direction that is not listed is rigid, and not computed.

    Args:
        x: stiffness along the throw of the body's crank [N/m].
        y: stiffness across it [N/m].

    Raises:
        ParameterError: no direction is listed, or a stiffness is out of range.
    """

    x: Number | None = number(units.STIFFNESS, at_least=1.0, at_most=1e18, default=None, example="2e8 N/m")
    y: Number | None = number(units.STIFFNESS, at_least=1.0, at_most=1e18, default=None, example="2e8 N/m")

    def __check_init__(self):
        check_parameters(self)
        if not self.directions:
            raise ParameterError("x", MISSING, "or y must be given: the stiffness of the support in that direction")

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions that are listed."""
        return tuple(name for name in declared(self) if getattr(self, name) is not None)
