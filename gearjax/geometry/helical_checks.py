"""Checks whether two gears on parallel axes fit into each other: what is wrong, and which value would be right."""

import math
from collections.abc import Iterator

import jax.numpy as jnp

from gearjax import units
from gearjax.geometry import internal_checks
from gearjax.geometry.helical_pair import InvolutePair
from gearjax.geometry.internal_checks import ROUNDING, Fault, form_roll, tooth_faults
from gearjax.typing import Scalar

JAMMED = 0.02  # overlap, in normal modules, that may come from rounded profile shifts and centre distances


def misfits(pair: InvolutePair) -> Iterator[Fault]:
    """Faults that make a pair impossible, the most basic one first.

    They are tips inside base circles or pointed teeth, teeth that jam, tips that reach the roots, and no continuous
    contact.

    Args:
        pair: the gears, with concrete (not traced) numbers.

    Returns:
        Faults; their parameters are those of `InvolutePair`.
    """
    for name, gear in zip(("gear 1", "gear 2"), pair.gears, strict=True):
        for key, _, words in tooth_faults(name, gear):
            yield _tip(pair, key.startswith("gear 2"), words)
    distance, base = float(pair.centre_distance), float(pair.base_distance)
    if distance <= base:
        words = "difference" if pair.internal else "sum"
        yield "centre_distance", _mm(distance), f"must be above the {words} of the base radii, {_mm(base)}"
        return
    jam, module = -float(pair.backlash), float(pair.normal_module)
    if jam > JAMMED * module:
        words = f"the teeth overlap by {_mm(jam)}: with these profile shifts they just fit at "
        yield "centre_distance", _mm(distance), words + _mm(pair.tight_centre_distance)
    yield from _roots(pair)
    ratio, along = float(pair.total_contact_ratio), float(pair.transverse_contact_ratio)
    if ratio < 1 or along <= 0:
        told = f"the total contact ratio is {ratio:.4g}, must be at least 1" if along > 0 else "the tips do not meet"
        yield "centre_distance", _mm(distance), f"no continuous contact, {told}: {longer_contact(pair)}"


def longer_contact(pair: InvolutePair) -> str:
    """Advice on how to lengthen the path of contact."""
    if float(pair.tight_pressure_angle) <= 0:  # these teeth have backlash at every centre distance
        return "increase a tip diameter or the profile shifts"
    if math.isclose(float(pair.tight_centre_distance), float(pair.centre_distance), rel_tol=1e-6):
        return "increase a tip diameter or the addendum"
    return f"increase a tip diameter, or move the centre distance towards {_mm(pair.tight_centre_distance)}"


def faults(pair: InvolutePair) -> Iterator[Fault]:
    """All faults of a pair, `misfits` first.

    The other faults are undercut, tips that touch below the involute and, for an internal pair, tips that cut each
    other away from the contact (`internal_checks`). The numbers must be concrete (not traced).

    Returns:
        Faults; their parameters are those of `InvolutePair`.
    """
    wrong = list(misfits(pair))
    yield from wrong
    yield from _undercut(pair)
    if wrong:
        return  # further faults would only be consequences of these
    if pair.internal:
        for key, _, words in internal_checks.faults(pair.internal_pair, _rounding(pair, 0)):
            yield _tip(pair, key.startswith("internal"), words)
        return
    yield from _below_involute(pair)


def _roots(pair: InvolutePair) -> Iterator[Fault]:
    """Faults of tips that reach the roots of the other gear."""
    distance = float(pair.centre_distance)
    tips, roots = ([0.5 * float(size) for size in sizes] for sizes in (pair.tip_diameters, pair.root_diameters))
    # of an internal gear both circles lie around the other gear
    rooms = [roots[1] - distance - tips[0], tips[1] - distance - roots[0]]
    if not pair.internal:
        rooms = [distance - tips[0] - roots[1], distance - tips[1] - roots[0]]
    for i, room in enumerate(rooms):
        if room < -ROUNDING:
            ring = pair.internal and i == 1
            bound, right = ("at least", tips[i] - room) if ring else ("at most", tips[i] + room)
            words = f"tips of gear {i + 1} cut into the roots of gear {2 - i} by {_mm(-room)}: must be {bound} "
            yield _tip(pair, i == 1, words + _mm(2 * right))


def _undercut(pair: InvolutePair) -> Iterator[Fault]:
    """Faults of external gears whose involute is undercut by the rack."""
    gears = pair.gears[:1] if pair.internal else pair.gears
    for i, gear in enumerate(gears):
        scale = float(pair.normal_module / pair.transverse_module)
        depth = float(gear.dedendum) - _rounding(pair, i)
        least = (depth - 0.5 * gear.teeth * float(jnp.sin(gear.pressure_angle)) ** 2) / scale
        shift = float(pair.profile_shifts[i])
        if shift < least - 1e-9:
            words = f"undercut: with {gear.teeth} teeth and this rack it must be at least {least:.4f}"
            yield f"profile_shifts[{i}]", f"{shift:.6g}", words


def _below_involute(pair: InvolutePair) -> Iterator[Fault]:
    """Faults of tips that touch the other gear below the beginning of its involute."""
    tangent = float(pair.tangent_length)
    for i, gear in enumerate(pair.gears):
        other = pair.gears[1 - i]
        form = form_roll(gear, _rounding(pair, i)) * float(gear.base_radius)
        reach = float(other.base_radius * other.tip_roll)
        if tangent - reach < form - ROUNDING:
            right = 2 * (float(other.base_radius) ** 2 + max(tangent - form, 0.0) ** 2) ** 0.5
            words = f"touch gear {i + 1} at a roll length of {_mm(tangent - reach)}, below its involute that begins at "
            limit = f"{_mm(form)} (tip interference): must be at most {_mm(right)}"
            yield _tip(pair, i == 0, f"tips of gear {2 - i} {words}{limit}")


def _rounding(pair: InvolutePair, i: int) -> float:
    """Depth of the tip rounding of a gear's rack, ``rho (1 - sin alpha_n)``, in transverse modules."""
    rounded = pair.racks[i].fillet_radius * (1 - jnp.sin(pair.normal_pressure_angle))
    return float(rounded * pair.normal_module / pair.transverse_module)


def _tip(pair: InvolutePair, second: bool, words: str) -> Fault:
    """A fault of the tips of a gear; their diameter was given or follows from the rack."""
    return f"tip_diameters[{int(second)}]", _mm(pair.tip_diameters[int(second)]), words


def _mm(length: Scalar | float) -> str:
    return f"{float(length) / units.mm:.6g} mm"
