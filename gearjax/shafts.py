"""Shafts: bodies of a train that turn together, rigidly or through a spring."""

import equinox as eqx

from gearjax import units
from gearjax.checks import MISSING, ParameterError
from gearjax.parameters import check_parameters, name_list, number
from gearjax.typing import Number


class Shaft(eqx.Module):
    """A shaft with its bodies, in the order in which they sit on it.

    Without ``torsion`` the bodies turn together rigidly. Without ``bending`` the shaft does not couple their lateral
    displacements: each body moves on its own support.

    Args:
        bodies: names of the bodies on the shaft.
        torsion: torsional stiffness of the shaft between each body and the next [N m/rad].
        torsion_damping: torsional damping coefficient of the shaft between each body and the next [N m s/rad]; without
            it the torsion is undamped.
        bending: stiffness of the shaft between each body and the next against their relative displacement in x and in
            y [N/m]; it acts in directions that the supports of both bodies list.

    Raises:
        ParameterError: no body is listed, one is listed twice, or a number is out of range.
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
            raise ParameterError("torsion", MISSING, "must be given: torsion_damping is for a shaft that twists")
        for key in ("torsion", "bending"):
            if getattr(self, key) is not None and len(self.bodies) < 2:
                raise ParameterError(
                    "bodies",
                    list(self.bodies),
                    f"must list at least two bodies: {key} acts between a body and the next",
                )

    @property
    def rigid(self) -> "Shaft":
        """The same bodies on a rigid shaft."""
        return Shaft(self.bodies)
