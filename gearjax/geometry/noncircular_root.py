"""Roots of non-circular gears, from the ends of their flanks down, as a cutter leaves them. Numbers must be concrete.

A cutter whose pitch line rolls on the pitch curve touches the gear where its normal passes through the pitch point P.
Its flanks go down to the height h of the teeth, and cut the flanks of the gear. Beyond, its tips are rounded with the
radius rho, and their centre C cuts the fillet ``P + (1 + rho / |C - P|) (C - P)``, tangent to the flank at which it
begins (for circular gears the trochoid of ISO 21771, `gearjax.geometry.root_fillet`). The fillet ends where the centre
is below the pitch point, and there the bottom begins.

Where both pitch curves are convex, the cutter is a rack. All teeth of the other gear lie within the rack as the three
roll, so that they cannot touch the fillet. A rack cannot cut along a concave pitch curve, and teeth along a concave
curve are not within it. Such pairs are cut by the other gear itself, with rounded tips.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.geometry.noncircular import FURTHEST, STEPS, PitchCurves
from gearjax.geometry.noncircular_teeth import PLACES, offset_points, reach, tip_thickness
from gearjax.typing import Array

FLAT = 0.01  # flat part that is left of the tips of a cutter, in modules
FULL = 0.9  # share of half the thickness of a tip that its rounding takes up at most, of a gear as a cutter
KNOTS = 4096  # pieces of a lobe in which angles are interpolated over the arc length: exact to 1e-13 m or so


class Cutter(NamedTuple):
    """Numbers of the teeth of a cutter that do not change around a gear.

    Args:
        height: height of its flanks above its pitch line, which is the height of the gears' teeth [m].
        clearance: height of its rounded tips above the flanks, if there is room for them [m].
        space: width of its teeth on the pitch line, which is the width of the gear's spaces [m].
        module: module of the gears [m].
    """

    height: float
    clearance: float
    space: float
    module: float


class Root(NamedTuple):
    """Part of the root next to one flank of each tooth.

    Args:
        start: parameter of the pitch point from which the lower end of the flank is cut, shape (tooth,) [rad].
        points: fillet from the flank down, shape (tooth, point, 2) [m].
        end: parameter of the pitch point above the end of the fillet, shape (tooth,) [rad].
        depth: depth of that end below the pitch curve, shape (tooth,) [m].
    """

    start: np.ndarray
    points: np.ndarray
    end: np.ndarray
    depth: np.ndarray


def convex(curves: PitchCurves) -> bool:
    """Whether the pitch curves of both gears are convex all around."""
    return bool((np.asarray(_bends(curves, jnp.linspace(0.0, 2 * math.pi, PLACES + 1))) >= 0).all())


def cut_by_rack(
    curves: PitchCurves, gear: int, way: int, crossing: np.ndarray, cutter: Cutter, share: np.ndarray
) -> Root:
    """Root next to flanks, as a rack with rounded tips cuts it.

    The rounding of the tips begins where the rack's flanks are as high as the teeth of the gears. Its radius is
    ``rho = c / (1 - sin(alpha0))`` for the clearance c, or less if the rack's teeth are not wide enough for it. The
    angle gamma of the normal to the pitch line rises from alpha0 to 90 deg along the fillet. The rack touches the gear
    below the pitch point that lies ``d / tan(gamma)`` from its centre of rounding, which is d deep.

    Args:
        curves: the pitch curves.
        gear: 0 for the driver, 1 for the driven gear.
        way: 1 for flanks whose root follows in the sense of rising arc length, -1 for the others.
        crossing: arc lengths at which the flanks cross the pitch curve, shape (tooth,) [m].
        cutter: numbers of the rack.
        share: places on the fillet from 0 to 1, shape (point,).
    """
    alpha = float(curves.pressure_angle)
    sine, cosine, height = math.sin(alpha), math.cos(alpha), cutter.height
    wide = 0.5 * cutter.space - height * math.tan(alpha) - 0.5 * FLAT * cutter.module
    rounding = max(0.0, min(cutter.clearance / (1 - sine), wide / cosine))
    depth = height - rounding * sine
    centre = crossing + way * (height * math.tan(alpha) + rounding * cosine)
    rest = (0.5 * math.pi - alpha) * (1 - share[None])  # of gamma, up to 90 deg
    level = np.tan(rest)
    t = _angles(curves, centre[:, None] + way * depth * level)
    down = depth + rounding * np.cos(rest)
    points = points_below(curves, gear, t, -way * down * level, down)
    start = _angles(curves, crossing + way * height / (sine * cosine))
    return Root(start, points, t[:, -1], np.full(len(crossing), depth + rounding))


def cut_by_mate(
    curves: PitchCurves, gear: int, side: int, foot: tuple[np.ndarray, np.ndarray], cutter: Cutter, share: np.ndarray
) -> Root:
    """Root next to flanks, as the other gear would cut it if the corners of its tips were rounded.

    The rounding begins at the corner, where it is tangent to the flank of the other gear. Its radius is such that it
    rises above the tip by the clearance, or less if the tip is not thick enough for two of them.

    Args:
        curves: the pitch curves.
        gear: 0 for the driver, 1 for the driven gear.
        side: 1 for drive flanks, -1 for back flanks.
        foot: parameters of the pitch points from which the corner of the other gear's tips cuts the ends of the flanks,
            shape (tooth,) [rad], and these ends, shape (tooth, 2) [m].
        cutter: numbers of the other gear as a cutter.
        share: places on the fillet from 0 to 1, shape (point,).
    """
    start, corner = foot
    thick = tip_thickness(curves, 1 - gear, cutter.module, cutter.height / cutter.module).min()
    sizes = jnp.asarray([cutter.height, cutter.clearance, 0.5 * FULL * thick])
    places = jnp.asarray(start), jnp.asarray(corner)
    centre, rounding, end, depth = _rounded(curves, gear, side, *places, sizes)
    t = start[:, None] + (np.asarray(end) - start)[:, None] * share
    points = _swept(curves, gear, jnp.asarray(t), centre[:, None], rounding[:, None, None])
    return Root(start, np.asarray(points), np.asarray(end), np.asarray(depth))


@eqx.filter_jit
def _bends(curves: PitchCurves, t: Array) -> Array:
    return jnp.stack(curves.at(t).curvatures)


def _angles(curves: PitchCurves, arc: np.ndarray) -> np.ndarray:
    """Angles of the driver at which the pitch curves have given arc lengths [rad], by cubic pieces with true slopes."""
    from scipy.interpolate import CubicHermiteSpline  # this import takes 0.2 s, and only outlines need it

    lobe = 2 * math.pi / curves.ratio.driver_lobes
    t = np.linspace(0.0, lobe, KNOTS + 1)
    passed, speed = (np.asarray(part) for part in _passed(curves, jnp.asarray(t)))
    whole = np.floor(arc / passed[-1])
    return whole * lobe + CubicHermiteSpline(passed, t, 1 / speed)(arc - whole * passed[-1])


@eqx.filter_jit
def _passed(curves: PitchCurves, t: Array) -> tuple[Array, Array]:
    return curves.arc_length(t), curves.at(t).speed


def points_below(
    curves: PitchCurves, gear: int, t: np.ndarray, along: np.ndarray | float, depth: np.ndarray | float
) -> np.ndarray:
    """Points next to the pitch points at angles t [rad], in axes of the gear, shape (..., 2) [m].

    They lie at a depth inwards of the pitch curve, and along its tangent in the sense of rising arc length [m].
    """
    t, along, depth = np.broadcast_arrays(t, along, depth)
    return np.asarray(_below(curves, gear, jnp.asarray(t), jnp.asarray(along), jnp.asarray(depth)))


@eqx.filter_jit
def _below(curves: PitchCurves, gear: int, t: Array, along: Array, depth: Array) -> Array:
    (x, y), lean = offset_points(curves, gear, t, -depth)
    return jnp.stack([x - along * jnp.sin(lean), y - along * jnp.cos(lean)], axis=-1)


@eqx.filter_jit
def _rounded(
    curves: PitchCurves, gear: int, side: int, start: Array, corner: Array, sizes: Array
) -> tuple[Array, Array, Array, Array]:
    """Roundings of the other gear's tips, and where they stop cutting.

    The sizes are height and clearance of the cutter, and the room for a rounding on its tip [m]. The angle between the
    flank and the normal of the tip at the corner tells how far a rounding rises.

    Returns:
        Centre in axes of the other gear, shape (tooth, 2) [m], and radius [m]; parameter of the pitch point above the
        end of the fillet [rad], and depth of that end [m], shape (tooth,) each.
    """
    height, clearance, room = sizes
    mate, way = 1 - gear, 1.0 if gear == 0 else -1.0
    at_corner = _fixed(curves, gear, start, corner)
    normal = at_corner - _pitch_point(curves, start)
    normal = normal / jnp.linalg.norm(normal, axis=-1, keepdims=True)
    top = reach(curves, mate, start, side, height)[1]
    lean = offset_points(curves, mate, top, 0.0)[1] + _turned(curves, mate, start)
    sine = -way * (normal[..., 0] * jnp.cos(lean) - normal[..., 1] * jnp.sin(lean))
    rounding = jnp.minimum(clearance / (1 - sine), room / jnp.sqrt(1 - sine * sine))
    centre = _own(curves, mate, start, at_corner - rounding[:, None] * normal)

    def apart(t: Array) -> tuple[Array, Array]:
        """Distances of the centre from the pitch point along the tangent and inwards."""
        off, lean = _fixed(curves, mate, t, centre) - _pitch_point(curves, t), curves.at(t).lean
        sine, cosine = jnp.sin(lean), jnp.cos(lean)
        return -off[..., 0] * sine - off[..., 1] * cosine, way * (off[..., 1] * sine - off[..., 0] * cosine)

    def step(_: Any, t: Array) -> Array:
        value, slope = jax.jvp(lambda t: apart(t)[0], (t,), (jnp.ones_like(t),))
        return t - jnp.clip(value / slope, -FURTHEST, FURTHEST)

    end = jax.lax.fori_loop(0, 2 * STEPS, step, start)
    return centre, rounding, end, apart(end)[1] + rounding


@eqx.filter_jit
def _swept(curves: PitchCurves, gear: int, t: Array, centre: Array, rounding: Array) -> Array:
    """Points that a rounding of the other gear leaves as the driver stands at the angles t, in axes of the gear."""
    pitch = _pitch_point(curves, t)
    off = _fixed(curves, 1 - gear, t, centre) - pitch
    stretch = 1 + rounding / jnp.linalg.norm(off, axis=-1, keepdims=True)
    return _own(curves, gear, t, pitch + stretch * off)


def _turned(curves: PitchCurves, gear: int, t: Array) -> Array:
    """Difference of directions of tangents in fixed axes from those in axes of a gear, at an angle of the driver."""
    return -t if gear == 0 else curves.ratio.driven_angle(t)


def _pitch_point(curves: PitchCurves, t: Array) -> Array:
    radius = curves.at(t).radius
    return jnp.stack([radius, jnp.zeros_like(radius)], axis=-1)


def _turn(points: Array, angle: Array) -> Array:
    x, y, cosine, sine = points[..., 0], points[..., 1], jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([x * cosine - y * sine, x * sine + y * cosine], axis=-1)


def _fixed(curves: PitchCurves, gear: int, t: Array, points: Array) -> Array:
    """Points of a gear in fixed axes, at an angle of the driver; the driver's axis is the origin [m]."""
    if gear == 0:
        return _turn(points, t)
    return _turn(points, -curves.ratio.driven_angle(t)).at[..., 0].add(curves.centre_distance)


def _own(curves: PitchCurves, gear: int, t: Array, points: Array) -> Array:
    """Points in fixed axes, in axes of a gear at an angle of the driver [m]."""
    if gear == 0:
        return _turn(points, -t)
    return _turn(points.at[..., 0].add(-curves.centre_distance), curves.ratio.driven_angle(t))
