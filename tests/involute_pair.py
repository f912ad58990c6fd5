"""The internal pair 236/240 of Yang, Tang, Liang (2019), written out apart from the systems of the package.

``python -m tests.involute_pair`` prints the loads of Table 5 and what they owe to the two numbers that the paper does
not print: the phase of the mesh and the depth of the fixed rim.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq

import gearjax as gj
from gearjax.geometry.involute import InvoluteGear
from gearjax.units import mm

PUBLISHED = np.array([58.6, 244.2, 379.7, 407.8, 315.1, 149.5])  # Table 5, teeth 14 to 19 [N]
POINTS = {13: 11, 14: 11, 15: 11, 16: 11, 17: 10, 18: 10, 19: 9, 20: 9, 21: 9}  # Table 3, along the profile
FIRST = 17  # the tooth that touches first
PHASE, RIM = 0.3417, 0.72 * mm  # fitted
TORQUE, CENTRE_DISTANCE = 100.0, 1.5 * mm
TOOL_RADIUS = 0.116 * mm  # Table 1, taken as the fillet


def gears() -> tuple[InvoluteGear, InvoluteGear]:
    """External and internal gear of Table 1; roots by a dedendum of 1.25, which it does not give."""
    given = (-0.4, 0.6328, 1.25), (0.55028, 1.0, 1.25)
    parts = [[jnp.asarray(value) for value in (0.58 * mm, np.deg2rad(20), *own)] for own in given]
    return InvoluteGear(236, *parts[0]), InvoluteGear(240, *parts[1], internal=True)


def tables(rim: float = RIM, **chosen) -> tuple[gj.InfluenceTable, gj.InfluenceTable]:
    """Tables of both gears; the wider internal one carries one of two external gears, 0.5 mm from its end (Table 8)."""
    external, internal = gears()
    common = {"youngs_modulus": 2.06e11, "poissons_ratio": 0.3, "rim": rim, "fillet": TOOL_RADIUS, "layers": 13}
    common |= {"profile_elements": 10} | chosen
    tip, inner = float(external.tip_radius), float(internal.tip_radius)
    return (
        gj.tooth_influence(external, face_width=6.5 * mm, touching=(tip - 0.675 * mm, tip), **common),
        gj.tooth_influence(
            internal, face_width=14 * mm, meeting=(0.5 * mm, 7 * mm), touching=(inner, inner + 0.67 * mm), **common
        ),
    )


def posed(phase: float) -> tuple[float, float]:
    """Polar angles of the axes of tooth 17 of the external gear and of its mate, which touch on the line of action at a
    share ``phase`` of their path of contact, from the internal tip circle to the external one."""
    external, internal = gears()
    base, other = float(external.base_radius), float(internal.base_radius)
    angle = -np.arccos((other - base) / CENTRE_DISTANCE)
    across, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    centre = np.array([CENTRE_DISTANCE, 0.0])
    first = np.sqrt(float(internal.tip_radius) ** 2 - other**2) - centre @ along
    last = np.sqrt(float(external.tip_radius) ** 2 - base**2)
    point = base * across + (first + phase * (last - first)) * along
    mate = point + centre
    return (
        np.arctan2(point[1], point[0]) - float(external.half_angle(jnp.asarray(np.hypot(*point)))),
        np.arctan2(mate[1], mate[0]) + float(internal.half_angle(jnp.asarray(np.hypot(*mate)))),
    )


def opposite(tooth: int, radius: np.ndarray, phase: float) -> tuple[np.ndarray, np.ndarray]:
    """Gap of a pair at radii about the external centre, base radius times the angle between the flanks there, and the
    radii of the points opposite about the internal centre."""
    external, internal = gears()
    first, second = posed(phase)
    ahead = FIRST - tooth  # numbers go against polar angles
    angle = first + 2 * np.pi / external.teeth * ahead + np.asarray(external.half_angle(jnp.asarray(radius)))

    def seen(radii: np.ndarray) -> np.ndarray:
        """Points of the internal flank, from the external centre."""
        at = second + 2 * np.pi / internal.teeth * ahead - np.asarray(internal.half_angle(jnp.asarray(radii)))
        return np.stack([radii * np.cos(at) - CENTRE_DISTANCE, radii * np.sin(at)])

    mate = radius + CENTRE_DISTANCE * np.cos(angle)
    for _ in range(8):
        step = 1e-6 * mm
        slope = (np.hypot(*seen(mate + step)) - np.hypot(*seen(mate - step))) / (2 * step)
        mate = mate - (np.hypot(*seen(mate)) - radius) / slope
    place = seen(mate)
    return float(external.base_radius) * (np.arctan2(place[1], place[0]) - angle), mate


def own_points(tooth: int, phase: float) -> np.ndarray:
    """Radii of a tooth's points, at equal distances from the internal tip circle to the external one: those that
    Table 7 names, such as 68.19 and 68.26 of tooth 15, 68.51 of tooth 18, 68.22 of tooth 19 [mm]."""
    external, internal = gears()
    tip, inner = float(external.tip_radius), float(internal.tip_radius)
    start = brentq(lambda radius: opposite(tooth, np.array([radius]), phase)[1][0] - inner, tip - 1 * mm, tip)
    return np.linspace(float(np.asarray(start)), tip, POINTS[tooth])


def pressed(influence: np.ndarray, gap: np.ndarray, force: float) -> tuple[np.ndarray, float]:
    """Forces and approach of points that carry a force together (Conry and Seireg 1971), by active sets."""
    active = np.ones(len(gap), dtype=bool)
    while True:
        inside = np.flatnonzero(active)
        right = np.stack([np.ones(len(inside)), gap[inside]], axis=1)
        per_approach, at_rest = cho_solve(cho_factor(influence[np.ix_(inside, inside)]), right).T
        approach = (force + at_rest.sum()) / per_approach.sum()
        forces = np.zeros(len(gap))
        forces[inside] = approach * per_approach - at_rest
        opening = influence @ forces + gap - approach
        chosen = np.where(active, forces > 0, opening < -1e-15)
        if (chosen == active).all():
            return forces, float(approach)
        active = chosen


def loads(both: tuple[gj.InfluenceTable, gj.InfluenceTable], phase: float = PHASE) -> tuple[np.ndarray, float]:
    """Loads of teeth 13 to 21 [N] and the approach [m]."""
    teeth = sorted(POINTS, reverse=True)  # in the order of increasing polar angles
    most = max(POINTS.values())
    own = [own_points(tooth, phase) for tooth in teeth]
    radius = np.stack([np.append(np.full(most - len(points), points[0]), points) for points in own])
    pairs = [opposite(tooth, radii, phase) for tooth, radii in zip(teeth, radius, strict=True)]
    gap, mate = (np.stack(arrays) for arrays in zip(*pairs, strict=True))
    external, internal = both
    influence = gj.influence_on_grid(external, jnp.asarray(radius))
    influence = np.asarray(influence + gj.influence_on_grid(internal.mirrored, jnp.asarray(mate)))
    layers = len(external.face)
    there = np.repeat(np.concatenate([np.arange(most) >= most - len(points) for points in own]), layers)
    base = float(gears()[0].base_radius)
    forces, approach = pressed(influence[np.ix_(there, there)], np.repeat(gap.ravel(), layers)[there], TORQUE / base)
    number = np.repeat(teeth, most * layers)[there]
    return np.array([forces[number == tooth].sum() for tooth in sorted(POINTS)]), approach


def deviation(found: np.ndarray) -> float:
    """Root mean square from Table 5, teeth 14 to 19 [N]."""
    return float(np.sqrt(np.mean((found[1:7] - PUBLISHED) ** 2)))


def told(both: tuple[gj.InfluenceTable, gj.InfluenceTable], phase: float) -> str:
    """One line of a table."""
    found, approach = loads(both, phase)
    six = " ".join(f"{load:6.1f}" for load in found[1:7])
    return f"phase {phase:.4f}  {six} N  rms {deviation(found):5.2f} N  approach {approach * 1e6:.3f} um"


def main() -> None:
    """Loads, and what the two fitted numbers do."""
    jax.config.update("jax_enable_x64", True)
    for rim in (0.6, 0.7, 0.72, 0.75, 0.8, 1.0):
        start = time.process_time()
        both = tables(rim * mm)
        spent = time.process_time() - start
        phases = (0.30, 0.32, PHASE, 0.36, 0.38) if rim * mm == RIM else (PHASE,)
        for phase in phases:
            print(f"rim {rim:.2f} mm ({spent:.0f} CPU s)  {told(both, phase)}", flush=True)


if __name__ == "__main__":
    main()
