"""Pairs of gears as curves in a plane, by numpy alone: flanks as points, turned until they touch."""

import dataclasses
import math

import numpy as np

POINTS = 40_001


def involute_angle(base, radius):
    angle = np.arccos(base / radius)
    return np.tan(angle) - angle


@dataclasses.dataclass
class FlatPair:
    """A pair with its pinion at the origin and its wheel on the x axis; the pinion turns from x to y.

    Args:
        bases, tips: radii [m].
        teeth: of both gears.
        distance: of the axes [m].
        internal: whether the wheel is an internal gear, around the pinion.
        thickness: angle of the pinion's teeth at the base circle [rad].
        clearance: angle by which the wheel may be turned between both flanks [rad].
    """

    bases: tuple[float, float]
    tips: tuple[float, float]
    teeth: tuple[int, int]
    distance: float
    internal: bool

    @classmethod
    def of(cls, pair):
        bases = tuple(0.5 * float(size) for size in pair.base_diameters)
        tips = tuple(0.5 * float(size) for size in pair.tip_diameters)
        return cls(bases, tips, pair.teeth, float(pair.centre_distance), pair.internal)

    @property
    def angle(self):
        sign = -1 if self.internal else 1
        return math.acos((self.bases[1] + sign * self.bases[0]) / self.distance)

    def wheel_turn(self, turn, moved=(0.0, 0.0), wheel_moved=(0.0, 0.0), removed=None, later=None):
        """By how much the wheel turns ahead of where it would, while the pinion's driving flanks push it [rad].

        Teeth are ideal: at no turn tooth 0 touches at the pitch point.

        Args:
            turn: of the pinion [rad].
            moved, wheel_moved: displacements of the axes [m].
            removed: material along the base tangent, by number of the tooth and roll of the pinion [m].
            later: of each tooth by how much it stands behind, along the base circle of the pinion [m].
        """
        alpha, ratio = self.angle, self.teeth[0] / self.teeth[1]
        sense = 1 if self.internal else -1  # of the wheel's turn
        centre = np.array([-self.distance if self.internal else self.distance, 0.0]) + wheel_moved
        first = round(turn * self.teeth[0] / (2 * math.pi))
        turns = []
        for tooth in range(first - 3, first + 4):
            begin = 0.0 if self.internal else 1e-3
            roll = np.linspace(begin, math.sqrt((self.tips[0] / self.bases[0]) ** 2 - 1), POINTS)
            radius = self.bases[0] * np.sqrt(1 + roll**2)
            gone = 0.0 if removed is None else removed(tooth, roll) / self.bases[0]
            behind = gone + (0.0 if later is None else later(tooth) / self.bases[0])
            # tooth 0 touches at the pitch point: there the flank stands on the line of centres
            place = (math.tan(alpha) - alpha) - (roll - np.arctan(roll)) - 2 * math.pi * tooth / self.teeth[0]
            place = place + turn - behind
            points = np.stack([radius * np.cos(place), radius * np.sin(place)], axis=1) + moved - centre
            far = np.hypot(*points.T)
            if self.internal:
                there = (far > self.tips[1]) & (far > self.bases[1])
                line = 0.0
            else:
                there = (far < self.tips[1]) & (far > self.bases[1])
                line = math.pi
            far, points = far[there], points[there]
            if not len(far):
                continue
            # angle ahead, in the wheel's sense, from the line of centres
            ahead = sense * (np.arctan2(points[:, 1], points[:, 0]) - line)
            ahead = np.mod(ahead + math.pi, 2 * math.pi) - math.pi
            pitch = math.tan(alpha) - alpha
            rise = involute_angle(self.bases[1], far) - pitch
            # the flank of the wheel's tooth that is pushed stands there when the wheel has not turned
            own = (-rise if self.internal else rise) - 2 * math.pi * tooth / self.teeth[1]
            turns.append((ahead - own).max())
        return max(turns) - turn * ratio
