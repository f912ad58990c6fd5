"""Checks whether an external gear and an internal gear fit into each other."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.evaluate import evaluated
from gearjax.geometry.internal_pair import InternalPair, candidate_rolls
from gearjax.geometry.involute import InvoluteGear
from gearjax.typing import Scalar

THINNEST = 0.05  # smallest thickness of a tip, in modules
ROUNDING = 1e-9  # m, overlaps up to this length count as rounding errors
ROUNDED = 0.25  # depth of the tip rounding of the rack of ISO 53, in modules
PLACES = 41  # places along each flank at which overlaps are searched for
WIDE = 2001  # angles at which the radial assembly is checked
Fault = tuple[str, str, str]
"""Name of the parameter, its value as text, and what would be right."""


def faults(pair: InternalPair, rounding: float = ROUNDED) -> Iterator[Fault]:
    """Faults of the pair, the most basic one first: each fault makes the later ones meaningless.

    The faults are pointed tips, tips that reach the roots of the other gear, contact below the involute, and tips that
    cut each other away from the contact.

    Args:
        pair: the gears.
        rounding: part of the external gear's dedendum that the tip rounding of the rack takes, in modules.
    """
    external, internal = pair.external, pair.internal
    yield from tooth_faults("external", external)
    yield from tooth_faults("internal", internal)
    distance, least = float(pair.centre_distance), float(pair.base_difference)
    if distance <= least:
        words = f"must be above the difference of the base radii, {least / units.mm:.6g} mm"
        yield "centre_distance", _mm(distance), words
        return
    reach = float(external.tip_radius) + distance
    if reach > float(internal.root_radius):
        words = f"tips of the external gear reach {_mm(reach)}, beyond the ring's roots at {_mm(internal.root_radius)}"
        yield "external_addendum", f"{float(external.addendum):.6g}", words
    inner = float(internal.tip_radius) - distance
    if inner < float(external.root_radius):
        words = f"tips of the ring come to {_mm(inner)}, inside the roots of the external gear at "
        yield "internal_addendum", f"{float(internal.addendum):.6g}", words + _mm(external.root_radius)
    yield from _path(pair, rounding)


def tooth_faults(name: str, gear: InvoluteGear) -> Iterator[Fault]:
    """Faults of the tips of one gear, reported as faults of ``{name}_addendum``."""
    base, tip, root = (float(part) for part in (gear.base_radius, gear.tip_radius, gear.root_radius))
    if min(tip, root) <= 0 or (gear.internal and tip < base):
        words = f"the tip circle, {_mm(tip)}, is inside the base circle, {_mm(base)}: no involute flank is left there"
        yield f"{name}_addendum", f"{float(gear.addendum):.6g}", words
        return
    if not gear.internal and tip <= base:
        words = f"the tip circle is below the base circle, whose diameter is {_mm(2 * base)}"
        yield f"{name}_addendum", f"{float(gear.addendum):.6g}", words
        return
    thick = 2 * tip * float(gear.half_angle(jnp.asarray(tip)))
    if thick < THINNEST * float(gear.module):
        words = f"pointed teeth: the tip is {_mm(thick)} thick, needs {_mm(THINNEST * float(gear.module))}"
        yield f"{name}_addendum", f"{float(gear.addendum):.6g}", words


def _path(pair: InternalPair, rounding: float) -> Iterator[Fault]:
    """Faults of the contact: no path of contact, contact below the involute, or tips that cut each other beyond it."""
    begin, end = (float(part) for part in pair.path)
    if begin >= end:
        words = "the tips leave no path of contact: raise an addendum, or approach the backlash-free centre distance, "
        yield "centre_distance", _mm(pair.centre_distance), words + _mm(pair.tight_centre_distance)
        return
    form = form_roll(pair.external, rounding)
    if begin < form - ROUNDING:
        words = f"trochoid interference: the ring's tip touches at a roll angle of {begin:.5g} rad, below the involute "
        yield "internal_addendum", f"{float(pair.internal.addendum):.6g}", words + f"that begins at {form:.5g} rad"
    overlap = tip_overlap(pair)
    if overlap > ROUNDING:
        words = f"tips cut into each other by {overlap / units.um:.4g} um away from the contact: lower an addendum"
        yield "external_addendum", f"{float(pair.external.addendum):.6g}", words


def form_roll(gear: InvoluteGear, rounding: float = ROUNDED) -> float:
    """Roll angle at which the involute of an external gear begins that is cut by a rack (ISO 21771) [rad].

    It is ``tan alpha - 4 (h - x) / (z sin 2 alpha)``, but not below zero. Here h is the dedendum minus the depth of the
    rack's tip rounding, in modules.
    """
    depth = float(gear.dedendum) - rounding - float(gear.profile_shift)
    angle = float(gear.pressure_angle)
    return max(0.0, np.tan(angle) - 4 * depth / (gear.teeth * np.sin(2 * angle)))


def tip_overlap(pair: InternalPair) -> float:
    """Largest overlap of flanks among all pairs of teeth that face each other [m]; zero if ideal gears just touch.

    With few teeth difference the tips can meet far from the path of contact (ISO 21771: interference of tips).
    """
    return -min(0.0, float(evaluated(_least_gap, pair)))


def _least_gap(pair: InternalPair) -> Scalar:
    """Smallest gap between the flanks of all pairs of teeth, zero at most [m]."""
    teeth = np.arange(-(pair.external.teeth // 2), pair.external.teeth // 2 + 1) * (2 * np.pi / pair.internal.teeth)
    roll = pair.roll_of_space(pair.space_of_roll(pair.middle) + jnp.asarray(teeth, pair.middle.dtype))
    begin, end = pair.ends(roll)
    facing = begin < end
    roll = jnp.where(facing, roll, pair.middle)
    begin, end = (jnp.where(facing, one, 0.0) for one in (begin, end))
    beyond = candidate_rolls(begin, end, PLACES)
    points = pair.points(jnp.broadcast_to(roll[:, None], beyond.shape), beyond)
    return jnp.where(facing[:, None], points.gap, 0.0).min()


def radial_assembly(pair: InternalPair) -> float:
    """Smallest room beside a tip if the external gear is inserted radially, with a tooth in front [m].

    The value is negative if tips collide; the external gear must then be inserted axially. A tip edge of the external
    gear at the angle b_1 passes the edge of its space at the angle b_2 if it is nearer to the middle line,
    ``r_a1 sin b_1 < r_a2 sin b_2``, for all teeth up to the widest place.
    """
    external, internal = pair.external, pair.internal
    tips = [float(gear.tip_radius) for gear in (external, internal)]
    tooth = float(external.half_angle(external.tip_radius))
    space = np.pi / internal.teeth - float(internal.half_angle(internal.tip_radius))
    own = np.linspace(tooth, 0.5 * np.pi, WIDE)
    theirs = space + (own - tooth) * (external.teeth / internal.teeth)
    return float((tips[1] * np.sin(theirs) - tips[0] * np.sin(own)).min())


def _mm(length: Scalar | float) -> str:
    return f"{float(length) / units.mm:.6g} mm"
