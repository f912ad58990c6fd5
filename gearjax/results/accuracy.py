"""Accuracy grades of the measured gears of a scene."""

import dataclasses

from gearjax.errors import AbstractMeasured
from gearjax.errors.measured import FLANKS
from gearjax.scene import Scene
from gearjax.tolerance.accuracy import GradedDeviation, accuracy_grades
from gearjax.units import um


@dataclasses.dataclass(frozen=True)
class GradedGear:
    """A gear whose driving or back flanks were measured.

    Args:
        body: the gear.
        flank: ``"driving"`` or ``"back"``.
        deviations: deviations with their grades, by name.
    """

    body: str
    flank: str
    deviations: dict[str, GradedDeviation]

    def as_json(self) -> dict:
        """The deviations in um with their grades; a grade is ``null`` beyond the coarsest one."""
        graded = {name: {"um": one.value / um, "grade": one.grade} for name, one in self.deviations.items()}
        return {"body": self.body, "flank": self.flank, "deviations": graded}


def graded_gears(scene: Scene) -> list[GradedGear]:
    """Deviations and grades of all measured gears, one entry for the driving and one for the back flanks.

    Raises:
        ParameterError: a size is outside the range of ISO 1328-1.
    """
    measured = [error for error in scene.errors.values() if isinstance(error, AbstractMeasured)]
    told = [
        (body, flank)
        for body in scene.system.bodies
        for flank in FLANKS
        if any(error.body == body and error.tells_of(flank) for error in measured)
    ]
    return [GradedGear(body, flank, accuracy_grades(scene, body, flank)) for body, flank in told]
