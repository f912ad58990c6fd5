"""An external involute gear in an internal one as curves of the plane, written out apart from the package."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from gearjax.geometry import InvoluteGear
from gearjax.geometry.internal_pair import InternalPair
from gearjax.units import deg, mm


def pair_of(
    teeth=(236, 240), module=0.58 * mm, angle=20 * deg, shifts=(-0.4, 0.55028), heights=(0.6328, 1.0), distance=1.5 * mm
) -> InternalPair:
    number = jnp.asarray
    shared = number(module), number(angle)
    made = [
        InvoluteGear(z, *shared, number(x), number(height), number(1.25), internal)
        for z, x, height, internal in zip(teeth, shifts, heights, (False, True), strict=True)
    ]
    return InternalPair(*made, number(distance))


def inv(angle):
    return np.tan(angle) - angle


@dataclasses.dataclass
class Curves:
    """Both gears as curves of the plane, the ring's centre at zero, the throw along the real axis [m]."""

    pair: InternalPair

    def __post_init__(self):
        external, internal = self.pair.external, self.pair.internal
        self.alpha = float(external.pressure_angle)
        self.base = [0.5 * float(gear.module) * gear.teeth * np.cos(self.alpha) for gear in (external, internal)]
        self.half = [
            (np.pi / 2 + 2 * float(gear.profile_shift) * np.tan(self.alpha)) / gear.teeth + inv(self.alpha)
            for gear in (external, internal)
        ]
        self.centre = float(self.pair.centre_distance)

    def turn(self, gear: int, radius: float) -> float:
        """Angle of a flank from the middle of its tooth, of the ring of its space [rad]."""
        return self.half[gear] - inv(np.arccos(self.base[gear] / radius))

    def external_angle(self, middle: float, radius: float) -> float:
        """Of the flank ahead, about the external gear's centre."""
        return middle + self.turn(0, radius)

    def ring_point(self, middle: float, radius: float) -> complex:
        return radius * np.exp(1j * (middle + self.turn(1, radius)))

    def gap(self, tooth: float, space: float, radius: float, centre: complex | None = None) -> float:
        """Base radius times the angle from the tooth's flank to the space's, at a radius about the external centre."""
        centre = self.centre if centre is None else centre

        def missed(of_ring: float) -> float:
            return abs(self.ring_point(space, of_ring) - centre) - radius

        near = abs(radius * np.exp(1j * self.external_angle(tooth, radius)) + centre)
        ring = brentq(missed, near - 0.2 * mm, near + 0.2 * mm, xtol=1e-16)
        return self.base[0] * np.angle(
            (self.ring_point(space, ring) - centre) * np.exp(-1j * self.external_angle(tooth, radius))
        )

    def tooth_that_touches(self, space: float, centre: complex | None = None) -> float:
        """Middle of the tooth whose flank and the space's have a common normal, tangent to both base circles."""
        working = np.arccos((self.base[1] - self.base[0]) / self.centre)
        ring = self.base[1] * (space + self.half[1] + working)
        return (ring - self.centre * np.sin(working)) / self.base[0] - self.half[0] - working


def random_pair(rng) -> InternalPair:
    teeth = int(rng.integers(40, 200))
    more = int(rng.integers(3, 9))
    module = rng.uniform(0.3, 3.0) * mm
    shifts = rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.8)
    tight = pair_of((teeth, teeth + more), module, 20 * deg, shifts, (0.6, 0.7)).tight_centre_distance
    return pair_of((teeth, teeth + more), module, 20 * deg, shifts, (0.6, 0.7), float(tight))
