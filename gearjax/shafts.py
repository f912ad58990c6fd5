"""Shafts: bodies of a train that turn together, rigidly or through a spring."""

import equinox as eqx

from gearjax import units
from gearjax.checks import MISSING, ParameterError
from gearjax.parameters import check_parameters, name_list, number
from gearjax.typing import Number


class Shaft(eqx.Module):
    """A shaft that bodies sit on, in the order of the list.

    Without ``torsion`` they turn as one. Without ``bending`` they move sideways apart from each other, each on the
    support of its own.

    Args:
        bodies: that turn together.
        torsion: stiffness between each body and the next [N m/rad].
        torsion_damping: damping coefficient there [N m s/rad]; undamped without.
        bending: stiffness between each body and the next against moving sideways, in x and in y, of bodies whose
            supports list that direction [N/m].

    Raises:
        ParameterError: no body, one twice, or a number is out of range.
    """

    bodies: tuple[str, ...] = name_list(example=["wheel_1", "pinion_2"])
    torsion: Number | None = number(units.TORSION, at_least=1e-3, at_most=1e18, default=None, example="2e5 N*m/rad")
    torsion_damping: Number | None = number(units.TORSION_DAMPING, at_least=0.0, at_most=1e12, default=None)
    bending: Number | None = number(units.STIFFNESS, at_least=1.0, at_most=1e18, default=None, example="1e8 N/m")

    def __check_init__(self):
        if self.bodies is None:
            raise ParameterError("bodies", MISSING, "must be a list of names in quotes")
        check_parameters(self)
        if len(set(self.bodies)) < len(self.bodies):
            raise ParameterError("bodies", list(self.bodies), "names a body twice")
        if self.torsion is None and self.torsion_damping is not None:
            raise ParameterError("torsion", MISSING, "must be given: torsion_damping is of a shaft that twists")
        for key in ("torsion", "bending"):
            if getattr(self, key) is not None and len(self.bodies) < 2:
                raise ParameterError("bodies", list(self.bodies), f"is one body: {key} is between a body and the next")

    @property
    def rigid(self) -> "Shaft":
        """The same bodies on a shaft that does not give way."""
        return Shaft(self.bodies)
