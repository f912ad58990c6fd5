"""The involute first stage that drives the cranks of an RV reducer: a sun, and planet wheels on the output."""

from fractions import Fraction

from gearjax.checks import ParameterError
from gearjax.geometry.involute import base_radius
from gearjax.typing import Scalar

NAMES = ("sun_teeth", "planet_teeth", "first_stage_module")


class FirstStage:
    """First stage of a reducer; without it, the cranks would be the input.

    Args:
        sun_teeth, planet_teeth: tooth numbers of the sun and of the planet wheels.
        module: module [m].
        pressure_angle: pressure angle of the rack [rad].
    """

    def __init__(self, sun_teeth: int, planet_teeth: int, module: Scalar, pressure_angle: Scalar):
        self.sun_teeth, self.planet_teeth = sun_teeth, planet_teeth
        self.module, self.pressure_angle = module, pressure_angle

    @classmethod
    def of(
        cls, sun_teeth: int | None, planet_teeth: int | None, module: Scalar | None, pressure_angle: Scalar
    ) -> "FirstStage | None":
        """The first stage, or ``None`` if none of its numbers is given.

        Raises:
            ParameterError: some of the numbers are given and others are not.
        """
        given = dict(zip(NAMES, (sun_teeth, planet_teeth, module), strict=True))
        missing = [key for key, value in given.items() if value is None]
        if len(missing) == len(NAMES):
            return None
        if sun_teeth is None or planet_teeth is None or module is None:
            raise ParameterError(missing[0], None, f"a first stage needs {', '.join(NAMES)}: give all or none")
        return cls(sun_teeth, planet_teeth, module, pressure_angle)

    @property
    def planet_radius(self) -> Scalar:
        """Base radius of the planet wheels [m]."""
        return base_radius(self.planet_teeth, self.module, self.pressure_angle)

    @property
    def with_output(self) -> float:
        """Turns of the cranks per turn of the output while the sun is held, ``1 + z_1 / z_2``."""
        return 1 + self.sun_teeth / self.planet_teeth

    def ratio(self, crank: Fraction) -> Fraction:
        """Turns of the sun per turn of the output.

        Args:
            crank: turns of the cranks relative to the output, against its sense, per turn of the output.
        """
        return 1 + Fraction(self.planet_teeth, self.sun_teeth) * crank
