"""The internal pair 236/240 of Yang, Tang and Liang (2019): gears, candidate points, elastic influence of the teeth."""

from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.geometry.internal_pair import InternalPair
from gearjax.geometry.involute import InvoluteGear
from gearjax.influence import InfluenceTable, influence_on_grid, tooth_influence
from gearjax.typing import Array, Float
from gearjax.units import deg, mm

TORQUE = 100.0  # N m on one external gear
MODULE, PRESSURE_ANGLE, CENTRE_DISTANCE = 0.58 * mm, 20 * deg, 1.5 * mm  # Table 1, like the next two lines
EXTERNAL, INTERNAL = (-0.4, 0.6328), (0.55028, 1.0)  # profile shift and addendum [modules]
EXTERNAL_WIDTH, INTERNAL_WIDTH, TOOL_RADIUS = 6.5 * mm, 14 * mm, 0.116 * mm
DEDENDUM = 1.25  # modules; not printed
YOUNGS_MODULUS, POISSONS_RATIO = 2.06e11, 0.3  # steel; not printed
MEETING = (0.5 * mm, 7 * mm)  # part of the internal gear's face; places in Table 8 are 0.5 mm larger than in Table 7
LAYERS = 13  # layers of elements across the external gear, section IV
POINTS = {13: 11, 14: 11, 15: 11, 16: 11, 17: 10, 18: 10, 19: 9, 20: 9, 21: 9}  # points along the profile, Table 3
FIRST = 17  # the tooth that touches without load
PHASE = 0.3417  # its place on the path of contact; fitted to Table 5
RIM = 0.72 * mm  # depth under the root circle at which the elements are fixed; fitted to Table 5
REACH = (0.675 * mm, 0.67 * mm)  # depth of the nodes of both gears from their tips, a little more than may touch

Tables = tuple[InfluenceTable, InfluenceTable]


class Candidates(NamedTuple):
    """Points where teeth may touch.

    They are in order of increasing polar angle of the teeth, then along the profile, then across the face. All arrays
    have the shape (point,) except the last two.

    Args:
        tooth: number of the pair in the paper, 13 to 21.
        radius: radius of each point on the external gear [m].
        mate: radius of the opposite point on the internal gear [m].
        face: place across the external gear [m].
        gap: initial clearance, base radius times the angle between the flanks [m].
        grid: radii on both gears, the same number of them along each profile, shape (2, tooth, profile) [m].
        there: which points of that grid, over all layers, exist, shape (tooth * profile * layer,).
    """

    tooth: np.ndarray
    radius: np.ndarray
    mate: np.ndarray
    face: np.ndarray
    gap: np.ndarray
    grid: np.ndarray
    there: np.ndarray


@cache
def pair() -> InternalPair:
    """Both gears of Table 1; the first column of the table is the internal gear."""
    common = jnp.asarray(MODULE), jnp.asarray(PRESSURE_ANGLE)
    (shift, height), (other_shift, other_height) = (tuple(map(jnp.asarray, own)) for own in (EXTERNAL, INTERNAL))
    dedendum = jnp.asarray(DEDENDUM)
    external = InvoluteGear(236, *common, shift, height, dedendum)
    internal = InvoluteGear(240, *common, other_shift, other_height, dedendum, internal=True)
    return InternalPair(external, internal, jnp.asarray(CENTRE_DISTANCE))


def total_load() -> float:
    """Sum of the loads of all teeth, eq. (5) ``T / r_b1`` [N]."""
    return TORQUE / float(pair().base_radii[0])


def tables(rim: float = RIM) -> Tables:
    """Influence tables of the teeth of the external gear and of the internal gear, by finite elements.

    Args:
        rim: depth under the root circle at which the elements are fixed [m].

    Raises:
        GearjaxError: scikit-fem is missing.
    """
    external, internal = pair().external, pair().internal
    tip, inner = float(external.tip_radius), float(internal.tip_radius)
    return (
        _table(external, EXTERNAL_WIDTH, (tip - REACH[0], tip), (0.0, EXTERNAL_WIDTH), rim),
        _table(internal, INTERNAL_WIDTH, (inner, inner + REACH[1]), MEETING, rim),
    )


def _table(
    gear: InvoluteGear, width: float, touching: tuple[float, float], meeting: tuple[float, float], rim: float
) -> InfluenceTable:
    return tooth_influence(
        gear,
        face_width=width,
        youngs_modulus=YOUNGS_MODULUS,
        poissons_ratio=POISSONS_RATIO,
        rim=rim,
        touching=touching,
        meeting=meeting,
        fillet=TOOL_RADIUS,
        profile_elements=10,
        layers=LAYERS,
    )


def rolls(phase: float = PHASE) -> tuple[np.ndarray, np.ndarray]:
    """Number of each pair in the paper, and roll angle of the pair on the line of action [rad], shape (pair,) both.

    The numbers fall with rising polar angle.

    Args:
        phase: place of pair 17 on its path of contact, from the internal tip circle (0) to the external one (1) [-].
    """
    tooth = np.array(sorted(POINTS, reverse=True))
    begin, end = (float(edge) for edge in pair().path)
    return tooth, begin + phase * (end - begin) + (FIRST - tooth) * 2 * np.pi / pair().external.teeth


def candidates(phase: float = PHASE) -> Candidates:
    """The points of section IV, at equal distances along a profile from the internal tip circle to the external one.

    The radii in Table 7 have the same spacing.

    Args:
        phase: as for `rolls`.
    """
    both, most = pair(), max(POINTS.values())
    tooth, roll = rolls(phase)
    begin = np.asarray(both.external.radius_at(jnp.asarray(roll) + both.ends(jnp.asarray(roll))[0]))
    tip = float(both.external.tip_radius)
    # a tooth with fewer points than others gets extra ones before its first point, which are left out below
    missing = np.array([most - POINTS[number] for number in tooth])
    share = np.maximum(np.arange(most) - missing[:, None], 0) / (most - 1 - missing)[:, None]
    radius = begin[:, None] + share * (tip - begin)[:, None]
    own = both.external.roll_at(jnp.asarray(radius))
    points = eqx.filter_jit(both.points)(jnp.asarray(roll)[:, None], own - roll[:, None])
    mate = np.asarray(both.internal.radius_at(points.roll[1]))
    layers = LAYERS + 1
    there = np.repeat((np.arange(most) >= missing[:, None]).ravel(), layers)
    face = np.tile(np.linspace(0.0, EXTERNAL_WIDTH, layers), radius.size)
    each = [np.broadcast_to(tooth[:, None], radius.shape), radius, mate, np.asarray(points.gap)]
    number, outer, inner, gap = (np.repeat(np.ravel(part), layers)[there] for part in each)
    return Candidates(number, outer, inner, face[there], gap, np.stack([radius, mate]), there)


def influence(both: Tables, points: Candidates) -> np.ndarray:
    """Approach of each point per force on each point, both gears together, section IV, shape (point, point) [m/N].

    Args:
        both: influence tables of the external and of the internal gear.
        points: points that may touch.
    """
    whole = np.asarray(_on_grid(both, jnp.asarray(points.grid)))
    return whole[np.ix_(points.there, points.there)]


@eqx.filter_jit
def _on_grid(both: Tables, radii: Float[Array, "2 tooth profile"]) -> Float[Array, "point point"]:
    external, internal = both
    return influence_on_grid(external, radii[0]) + influence_on_grid(internal.mirrored, radii[1])
