"""Outlines of non-circular gears, tooth by tooth, for drawings and CAD. Numbers must be concrete (not traced)."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.geometry.noncircular import PitchCurves
from gearjax.geometry.noncircular_root import Cutter, Root, convex, cut_by_mate, cut_by_rack, points_below
from gearjax.geometry.noncircular_teeth import offset_points, reach
from gearjax.typing import Array

ROOT = 0.25  # clearance of the roots below the tips of the other gear, in modules
LOOKED_AT = 256  # places per tooth between which the ends of flanks are interpolated


class Teeth(NamedTuple):
    """Teeth of a pair of non-circular gears.

    Args:
        curves: the pitch curves.
        number: tooth numbers of the driver and of the driven gear.
        module: module of the rack [m].
        addendum: height of the teeth above the pitch curves, in modules.
        backlash: distance between the back flanks along their normal; one half of it is taken from the teeth of each
            gear [m].
    """

    curves: PitchCurves
    number: tuple[int, int]
    module: float
    addendum: float
    backlash: float = 0.0

    @property
    def pitch(self) -> float:
        """Arc length from tooth to tooth [m]."""
        return float(self.curves.perimeter) / self.number[0]

    @property
    def thickness(self) -> float:
        """Arc length from the front to the back of a tooth [m]."""
        return 0.5 * self.pitch - 0.5 * self.backlash / math.cos(float(self.curves.pressure_angle))

    @property
    def height(self) -> float:
        """Height of the teeth above the pitch curves [m]."""
        return self.addendum * self.module


def outline(pieces: list[np.ndarray]) -> np.ndarray:
    """Outline of a gear once around, joined from the pieces of its teeth (`tooth_points`), shape (n, 2) [m]."""
    return np.concatenate([piece for tooth in zip(*pieces, strict=True) for piece in tooth])


def tooth_points(teeth: Teeth, gear: int, points: int) -> list[np.ndarray]:
    """Pieces of the outline of a gear: first flank, tip, second flank, fillet, bottom and fillet of each tooth.

    Each piece has the shape (tooth, point, 2) [m]. The teeth are in the order of rising arc length of the pitch curve.
    The axes turn with the gear; x points towards the other gear at input angle zero. The flanks are cut by a rack.
    Below them the roots are those of the same rack with rounded tips, or, if a pitch curve is concave, those that the
    other gear leaves (`gearjax.geometry.noncircular_root`). They are 0.25 modules deeper than the tips of the other
    gear reach, less if the cutter's teeth are too thin for it (with an addendum of 1 beyond 22 deg).

    Args:
        teeth: teeth of the pair.
        gear: 0 for the driver, 1 for the driven gear.
        points: number of points of each piece.
    """
    crossing = teeth.pitch * np.arange(teeth.number[gear])  # arc lengths at which drive flanks cross the pitch curve
    begins = {1: crossing, -1: crossing + (1 if gear == 0 else -1) * teeth.thickness}
    order = (1, -1) if gear == 0 else (-1, 1)
    share = np.linspace(0.0, 1.0, points)
    racked = convex(teeth.curves)
    flanks, tips, roots = [], [], []
    for side in order:
        end, above = _ends(teeth, gear, side, begins[side], tips=True)
        root = _root(teeth, gear, side, begins[side], share, racked)
        along = _between(root.start, end, share)
        flanks.append(flank(teeth.curves, gear, side, along, begins[side][:, None]))
        tips.append(above)
        roots.append(root)
    after, before = roots[1], roots[0]  # roots after the second flank of a tooth, and before its first flank
    around = 2 * math.pi * teeth.number[gear] / teeth.number[0]
    tip = points_below(teeth.curves, gear, _between(tips[0], tips[1], share), 0.0, -teeth.height)
    under = _between(after.end, np.append(before.end[1:], before.end[0] + around), share)
    bottom = points_below(teeth.curves, gear, under, 0.0, _between(after.depth, np.roll(before.depth, -1), share))
    fillet = np.roll(before.points, -1, axis=0)[:, ::-1]
    return [flanks[0], tip, flanks[1][:, ::-1], after.points, bottom, fillet]


def _root(teeth: Teeth, gear: int, side: int, crossing: np.ndarray, share: np.ndarray, racked: bool) -> Root:
    """Roots next to the flanks of one side, by a rack or by the other gear."""
    cutter = Cutter(teeth.height, ROOT * teeth.module, teeth.pitch - teeth.thickness, teeth.module)
    if racked:
        return cut_by_rack(teeth.curves, gear, side if gear == 1 else -side, crossing, cutter, share)
    start, _ = _ends(teeth, gear, side, crossing, tips=False)
    foot = start, flank(teeth.curves, gear, side, start, crossing)
    return cut_by_mate(teeth.curves, gear, side, foot, cutter, share)


def flank(curves: PitchCurves, gear: int, side: int, t: np.ndarray, crossing: np.ndarray) -> np.ndarray:
    """Points of flanks in axes of the gear, ``P(t) + (s(t) - s_k) cos(alpha0) u(t)``, shape (..., 2) [m].

    The points are cut from the pitch points at the angles t [rad] (Dong et al. 2020, eqs. 6 and 7); ``crossing`` is the
    arc length s_k at which the flank crosses the pitch curve [m].
    """
    return np.asarray(_flank(curves, gear, side, jnp.asarray(t), jnp.asarray(crossing)))


@eqx.filter_jit  # compiled as one program; without it, every single operation would be compiled separately
def _flank(curves: PitchCurves, gear: int, side: int, t: Array, crossing: Array) -> Array:
    (x, y), lean = offset_points(curves, gear, t, 0.0)
    slant = curves.pressure_angle + side * lean
    along = side * (curves.arc_length(t) - crossing) * jnp.cos(curves.pressure_angle)
    return jnp.stack([x + along * jnp.sin(slant), y + side * along * jnp.cos(slant)], axis=-1)


@eqx.filter_jit
def _crossings(curves: PitchCurves, gear: int, side: int, tips: bool, t: Array, height: Array) -> tuple[Array, Array]:
    """Arc lengths at which flanks cross the pitch curve, and parameters of the pitch curve next to the flanks' ends.

    The ends of these flanks are on the normals of the pitch points at the angles t.
    """
    way, slope = (1 if gear == 0 else -1), jnp.cos(curves.pressure_angle)
    along, below = reach(curves, gear if tips else 1 - gear, t, side, height)
    if not tips:
        along = -along
        below = t - way * side * along * slope / curves.at(t).speed
    return curves.arc_length(t) - way * side * along / slope, below


def _ends(teeth: Teeth, gear: int, side: int, crossing: np.ndarray, tips: bool) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the flanks that cross the pitch curve at given arc lengths, at their tips or where the other tips reach.

    Both results have the shape (tooth,) [rad]: parameters of the pitch points from which the ends are cut, and
    parameters of the pitch curve next to the ends. They are interpolated, and corrected twice along the slope.
    """
    curves = teeth.curves
    around = 2 * math.pi * teeth.number[gear] / teeth.number[0]
    beyond = around * (1 + 4 / teeth.number[gear])  # a little more than once around
    t, height = np.linspace(around - beyond, beyond, LOOKED_AT * teeth.number[gear]), jnp.asarray(teeth.height)
    arc, below = (np.asarray(part) for part in _crossings(curves, gear, side, tips, jnp.asarray(t), height))
    end, slope = np.interp(crossing, arc, t), np.interp(crossing, arc, np.gradient(arc, t))
    for _ in range(2):
        own, below = (np.asarray(part) for part in _crossings(curves, gear, side, tips, jnp.asarray(end), height))
        end = end - (own - crossing) / slope
    return end, below


def _between(first: np.ndarray, last: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Numbers between two of each tooth, at shares from 0 to 1, shape (tooth, point)."""
    return first[:, None] + (last - first)[:, None] * share


def placed(points: np.ndarray, gear: int, turned: float, centre_distance: float) -> np.ndarray:
    """Points of a gear after a turn by an angle [rad]; x points from the driver's to the driven gear's axis [m]."""
    angle = turned if gear == 0 else -turned
    cosine, sine = math.cos(angle), math.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([x * cosine - y * sine + gear * centre_distance, x * sine + y * cosine], axis=-1)
