"""Outlines of non-circular gears, tooth by tooth, for drawings and CAD. Numbers must be concrete (not traced)."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.geometry.noncircular import PitchCurves
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


class _Ends(NamedTuple):
    """Ends of the flanks of one side, in rising order of the arc length at which the flanks cross the pitch curve.

    Args:
        crossing: arc length at which the flank crosses the pitch curve, shape (place,) [m].
        parameter: parameter of the pitch point from which the end is cut, shape (place,) [rad].
        below: parameter of the pitch curve below the end, shape (place,) [rad].
    """

    crossing: np.ndarray
    parameter: np.ndarray
    below: np.ndarray

    def at(self, crossing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both parameters of the end of flanks that cross the pitch curve at given arc lengths, by interpolation."""
        return np.interp(crossing, self.crossing, self.parameter), np.interp(crossing, self.crossing, self.below)


def outline(pieces: list[np.ndarray]) -> np.ndarray:
    """Outline of a gear once around, joined from the pieces of its teeth (`tooth_points`), shape (n, 2) [m]."""
    return np.concatenate([piece for tooth in zip(*pieces, strict=True) for piece in tooth])


def tooth_points(teeth: Teeth, gear: int, points: int) -> list[np.ndarray]:
    """Pieces of the outline of a gear: first flank, tip, second flank and following root of each tooth.

    Each piece has the shape (tooth, point, 2) [m]. The teeth are in the order of rising arc length of the pitch curve.
    The axes turn with the gear; x points towards the other gear at input angle zero. The flanks are cut by a rack, as
    far down as the tips of the other gear reach. From there to the roots, which are 0.25 modules deeper, they are drawn
    straight: the fillet is not modelled.

    Args:
        teeth: teeth of the pair.
        gear: 0 for the driver, 1 for the driven gear.
        points: number of points of each piece.
    """
    way = 1 if gear == 0 else -1
    height = teeth.addendum * teeth.module
    crossing = teeth.pitch * np.arange(teeth.number[gear])  # arc lengths at which drive flanks cross the pitch curve
    slope = math.cos(float(teeth.curves.pressure_angle))
    thick = 0.5 * teeth.pitch - 0.5 * teeth.backlash / slope
    begins = {1: crossing, -1: crossing + way * thick}
    order = (1, -1) if gear == 0 else (-1, 1)
    share = np.linspace(0.0, 1.0, points)
    flanks, tips, roots = [], [], []
    for side in order:
        tip, foot = (_ends(teeth, gear, side, height, tips=end) for end in (True, False))
        (end, above), (start, below) = tip.at(begins[side]), foot.at(begins[side])
        along = start[:, None] + (end - start)[:, None] * share
        flanks.append(flank(teeth.curves, gear, side, along, begins[side][:, None]))
        tips.append(above)
        roots.append(below)
    around = 2 * math.pi * teeth.number[gear] / teeth.number[0]
    next_root = np.append(roots[0][1:], roots[0][0] + around)
    over = _curve(teeth.curves, gear, tips, share, height)
    under = _curve(teeth.curves, gear, (roots[1], next_root), share, -(height + ROOT * teeth.module))
    return [flanks[0], over, flanks[1][:, ::-1], under]


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


@eqx.filter_jit
def _offset(curves: PitchCurves, gear: int, t: Array, height: Array) -> Array:
    return jnp.stack(offset_points(curves, gear, t, height)[0], axis=-1)


def _ends(teeth: Teeth, gear: int, side: int, height: float, tips: bool) -> _Ends:
    """Ends of flanks at their own tips, or where the tips of the other gear reach; a little more than once around."""
    curves = teeth.curves
    around = 2 * math.pi * teeth.number[gear] / teeth.number[0]
    beyond = around * (1 + 4 / teeth.number[gear])
    t = jnp.linspace(around - beyond, beyond, LOOKED_AT * teeth.number[gear])
    arc, below = _crossings(curves, gear, side, tips, t, jnp.asarray(height))
    return _Ends(np.asarray(arc), np.asarray(t), np.asarray(below))


def _curve(curves: PitchCurves, gear: int, ends: tuple | list, share: np.ndarray, height: float) -> np.ndarray:
    """Points of a curve at a height from the pitch curve, between two parameters, shape (tooth, point, 2) [m]."""
    first, last = ends
    t = first[:, None] + (last - first)[:, None] * share
    return np.asarray(_offset(curves, gear, jnp.asarray(t), jnp.asarray(height)))


def placed(points: np.ndarray, gear: int, turned: float, centre_distance: float) -> np.ndarray:
    """Points of a gear after a turn by an angle [rad]; x points from the driver's to the driven gear's axis [m]."""
    angle = turned if gear == 0 else -turned
    cosine, sine = math.cos(angle), math.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([x * cosine - y * sine + gear * centre_distance, x * sine + y * cosine], axis=-1)
