"""Kinematics of planetary trains, in exact fractions of a turn."""

from fractions import Fraction
from typing import NamedTuple


class FewTeethDifference(NamedTuple):
    """A two-stage few-teeth-difference train whose ring is fixed and whose carrier is the output.

    The first stage, an external pair on the carrier, turns the crank. The second stage rolls the planet in the ring.
    All speeds are turns per turn of the output, counted in the sense of the output.
    """

    sun_teeth: int
    first_stage_planet_teeth: int
    planet_teeth: int
    ring_teeth: int

    @property
    def crank_to_output(self) -> Fraction:
        """Turns of the crank relative to the output (absolute value), ``z_r / (z_r - z_p)``."""
        return Fraction(self.ring_teeth, self.ring_teeth - self.planet_teeth)

    @property
    def crank_to_frame(self) -> Fraction:
        """Turns of the crank relative to the frame (absolute value), ``z_p / (z_r - z_p)``."""
        return Fraction(self.planet_teeth, self.ring_teeth - self.planet_teeth)

    @property
    def ratio(self) -> Fraction:
        """Turns of the input per turn of the output, ``1 + (z_2 / z_1) z_r / (z_r - z_p)``."""
        return 1 + Fraction(self.first_stage_planet_teeth, self.sun_teeth) * self.crank_to_output

    @property
    def mesh(self) -> Fraction:
        """Tooth engagements of the second stage per turn of the output."""
        return self.planet_teeth * self.crank_to_output

    @property
    def cycle(self) -> int:
        """Turns of the output after which the eccentricities repeat."""
        return self.crank_to_output.denominator
