"""Teeth of non-circular gears: line of action up to the tips, contact ratio, tip thickness and faults."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.geometry.internal_checks import THINNEST, Fault
from gearjax.geometry.noncircular import FURTHEST, STEPS, AbstractRatio, EllipseRatio, PitchCurves
from gearjax.typing import Array, Float, Scalar

MOST_LEAN = 65 * units.deg
"""Largest operating pressure angle; beyond it the gears may be self-locking (Dong et al. 2020, section 3)."""
PLACES = 1440  # places around a gear at which it is checked
NEAR = 0.1  # distance of tip thickness [modules] and contact ratio from their limits at which circular gears suffice
GEARS = ("driver", "driven gear")


def offset_points(
    curves: PitchCurves, gear: int, t: Float[Array, "..."], height: Float[Array, "..."] | float
) -> tuple[tuple[Array, Array], Array]:
    """Points of the curve at a height outside a gear's pitch curve, and the direction of its tangent [m, rad].

    The axes turn with the gear; x points towards the other gear at the angle zero. The direction of the tangent is
    counted from the y axis to the x axis.
    """
    at, turned = curves.at(t), curves.ratio.driven_angle(t)
    lean = at.lean + (t if gear == 0 else -turned)
    if gear == 0:
        x, y = at.radius * jnp.cos(t), -at.radius * jnp.sin(t)
        return (x + height * jnp.cos(lean), y - height * jnp.sin(lean)), lean
    x, y = -at.driven_radius * jnp.cos(turned), -at.driven_radius * jnp.sin(turned)
    return (x - height * jnp.cos(lean), y + height * jnp.sin(lean)), lean


def reach(
    curves: PitchCurves, gear: int, t: Float[Array, "..."], side: int, height: Scalar | float
) -> tuple[Array, Array]:
    """Distance along the line of action from the pitch point to the tips of a gear [m].

    The second result is the parameter of the pitch curve below that point of the tips [rad].

    Args:
        curves: the pitch curves.
        gear: 0 for the driver, 1 for the driven gear.
        t: angle of the driver, shape (...) [rad].
        side: 1 for drive flanks, -1 for back flanks.
        height: height of the teeth above the pitch curve [m].
    """
    (x0, y0), start = offset_points(curves, gear, t, 0.0)
    slant = curves.pressure_angle + side * start
    way = 1.0 if gear == 0 else -1.0
    nx, ny = way * jnp.sin(slant), way * side * jnp.cos(slant)
    at = curves.at(t)
    bend = at.curvatures[gear]
    about = _circular_reach(bend, curves.pressure_angle, height)
    guess = t - way * side * about * jnp.cos(curves.pressure_angle) / (at.speed * (1 + bend * height))

    def across(place: Array) -> Array:
        (x, y), _ = offset_points(curves, gear, place, height)
        return (x - x0) * ny - (y - y0) * nx

    def step(_: Any, place: Array) -> Array:
        value, slope = jax.jvp(across, (place,), (jnp.ones_like(place),))
        return place - jnp.clip(value / slope, -FURTHEST, FURTHEST)

    place = jax.lax.fori_loop(0, STEPS, step, guess)
    (x, y), _ = offset_points(curves, gear, place, height)
    return (x - x0) * nx + (y - y0) * ny, place


def _circular_reach(bend: Array, pressure_angle: Scalar, height: Scalar | float) -> Array:
    """Distance along the line of action from the pitch point to the tips of a circular gear of a given curvature [m].

    It is L of Dong et al. (2020), eq. 12, in a form without cancellation; the curvature is in [1/m].
    """
    sine, more = jnp.sin(pressure_angle), height * (2 + bend * height)
    return more / (sine + jnp.sqrt(sine * sine + bend * more))


def contact_ratio(
    curves: PitchCurves, t: Float[Array, "..."], side: int, module: Scalar, addendum: Scalar
) -> Float[Array, "..."]:
    """Contact ratio: arc length that passes while a flank is in contact, over the pitch [-].

    The contact is limited by the tips of the driven gear and by the tips of the driver.

    Args:
        curves: the pitch curves.
        t: angle of the driver at which the flank crosses the pitch curves [rad].
        side: 1 for drive flanks, -1 for back flanks.
        module: module of the rack [m].
        addendum: height of the teeth above the pitch curves, in modules.
    """
    slope = jnp.cos(curves.pressure_angle)

    def passed(gear: int) -> Array:
        """Arc length from the pitch point to the end of contact at the tips of a gear, backwards on the driven gear."""
        way = side if gear == 0 else -side

        def step(_: Any, state: tuple[Array, Array]) -> tuple[Array, Array]:
            end, _ = state
            along = reach(curves, gear, end, side, addendum * module)[0] / slope
            return end - (curves.between(t, end) - way * along) / curves.at(end).speed, along

        return jax.lax.fori_loop(0, 2 * STEPS, step, (t, jnp.zeros_like(t)))[1]

    return (passed(0) + passed(1)) / (math.pi * module)


def circular_contact_ratio(
    curves: PitchCurves, t: Float[Array, "..."], module: Scalar, addendum: Scalar
) -> Float[Array, "..."]:
    """Contact ratio of circular gears with the pitch curves' curvatures (Dong et al. 2020, eqs. 12 and 13) [-]."""
    bends = curves.at(t).curvatures
    along = sum(_circular_reach(bend, curves.pressure_angle, addendum * module) for bend in bends)
    return along / (math.pi * module * jnp.cos(curves.pressure_angle))


def tip_thickness(curves: PitchCurves, gear: int, module: float, addendum: float) -> np.ndarray:
    """Thickness of the tips around a gear along the tip curve, negative if flanks meet below it, shape (place,) [m].

    Numbers must be concrete (not traced).
    """
    t = jnp.linspace(0.0, 2 * math.pi, PLACES + 1)
    height, slope = addendum * module, float(jnp.cos(curves.pressure_angle))
    way = 1 if gear == 0 else -1
    arc, whole = np.asarray(curves.arc_length(t)), float(curves.perimeter)
    names, below = {}, {}
    for side in (1, -1):
        along, place = (np.asarray(part) for part in reach(curves, gear, t, side, height))
        # a flank is identified by the arc length at which it crosses the pitch curve
        names[side], below[side] = arc - way * side * along / slope, place
    # the back flank of the same tooth crosses half a pitch later on the driver and half a pitch earlier on the other
    other = names[1] + way * math.pi * module / 2
    turns = np.floor((other - names[-1][0]) / whole)
    far = np.interp(other - turns * whole, names[-1], below[-1]) + turns * 2 * math.pi
    near, far = jnp.asarray(below[1]), jnp.asarray(far)
    middle, half = 0.5 * (near + far), 0.5 * (far - near)
    at = curves.at(middle)
    return np.asarray(way * 2 * half * at.speed * (1 + at.curvatures[gear] * height))


def closing_centre_distance(ratio: AbstractRatio, teeth: int, module: Scalar) -> Scalar:
    """Distance of the axes at which the driver's pitch curve has the length ``pi m z`` [m]."""
    one = PitchCurves(ratio, jnp.ones_like(module), jnp.zeros_like(module))
    return math.pi * module * teeth / one.perimeter


def closing_eccentricity(
    ratio: EllipseRatio, centre_distance: float, teeth: int, module: float, pressure_angle: float
) -> float | None:
    """Eccentricity at which the driver's pitch curve has the length ``pi m z``.

    It is ``None`` if no eccentricity without self-locking gives this length.
    """
    from scipy.optimize import brentq

    def short_by(e: float) -> float:
        own = dataclasses.replace(ratio, eccentricity=jnp.asarray(e))
        return float(closing_centre_distance(own, teeth, jnp.asarray(module))) - centre_distance

    ends = 0.0, most_eccentricity(ratio, pressure_angle)
    if short_by(ends[0]) * short_by(ends[1]) > 0:
        return None
    root = brentq(short_by, *ends, xtol=1e-13)
    assert isinstance(root, float)  # brentq returns more only on request
    return root


def faults(curves: PitchCurves, module: float, addendum: float) -> Iterator[Fault]:
    """Faults of a pair of gears, the most basic one first: self-locking, undercut, pointed teeth, no continuous
    contact.

    Numbers must be concrete (not traced); the parameter names are those of the gear sets.
    """
    t, numbers = np.linspace(0.0, 2 * math.pi, PLACES + 1), (jnp.asarray(module), jnp.asarray(addendum))
    leans, bends, rounded_ratio = (np.asarray(part) for part in _looked_at(curves, *numbers))
    wrong = _locks(curves, t, leans) or _sharp(curves, t, bends, module, addendum)
    if wrong is None and bends.min() < 0:
        wrong = _cut_by_hollow(curves, t, module, addendum)
    if wrong is not None:
        yield wrong
        return
    # circular gears of the same curvature are a fast check; near the limit the non-circular gears are checked
    rounded = _circular_thickness(bends, float(curves.pressure_angle), module, addendum).min(axis=1)
    for gear, name in enumerate(GEARS):
        thinnest = rounded[gear] / module
        if bends[gear].min() <= 0 or thinnest < THINNEST + NEAR:
            thinnest = float(tip_thickness(curves, gear, module, addendum).min()) / module
        if not thinnest >= THINNEST:
            words = (
                f"tips of the {name} are {thinnest:.4g} modules thick, must be {THINNEST:g} or more: lower the addendum"
            )
            yield "addendum", f"{addendum:.6g}", words
            return
    if rounded_ratio.min() > 1 + NEAR:
        return
    for side in (1, -1):
        ratio = np.asarray(_contact(curves, jnp.asarray(t), side, *numbers))
        if not ratio.min() >= 1:
            place = float(t[int(ratio.argmin())]) / units.deg
            words = f"no continuous contact: contact ratio {ratio.min():.4g} at {place:.4g} deg, must be at least 1"
            yield "addendum", f"{addendum:.6g}", f"{words}: {_longer_contact(curves, t, module, addendum)}"
            return


HIGHER = 1.02, 1.05, 1.1, 1.2, 1.35, 1.5, 2.0, 3.0, 5.0


def _longer_contact(curves: PitchCurves, t: np.ndarray, module: float, addendum: float) -> str:
    """Advice on teeth that lose contact: a higher addendum if the teeth are not undercut by then, else more teeth."""
    bends = np.asarray(_looked_at(curves, jnp.asarray(module), jnp.asarray(addendum))[1])
    for higher in HIGHER:
        if _sharp(curves, t, bends, module, higher * addendum) is not None:
            break
        if _meets(curves, module, higher * addendum):
            return "raise the addendum"
    return "give more teeth"


def _meets(curves: PitchCurves, module: float, addendum: float) -> bool:
    """Whether circular gears of the same curvatures have continuous contact."""
    if addendum <= 0:
        return False
    return bool(np.asarray(_looked_at(curves, jnp.asarray(module), jnp.asarray(addendum))[2]).min() >= 1)


def _locks(curves: PitchCurves, t: np.ndarray, leans: np.ndarray) -> Fault | None:
    """Fault of gears whose pressure angle becomes so large that they may be self-locking."""
    alpha, worst = float(curves.pressure_angle), int(np.abs(leans).argmax())
    largest = alpha + abs(float(leans[worst]))
    if largest <= MOST_LEAN * (1 + 1e-6):
        return None
    place = t[worst] / units.deg
    words = f"self-locking: pressure angle {largest / units.deg:.6g} deg at {place:.4g} deg, must be at most"
    words = f"{words} {MOST_LEAN / units.deg:g} deg, a tangent inclined by {(MOST_LEAN - alpha) / units.deg:g} deg"
    ratio = curves.ratio
    if not isinstance(ratio, EllipseRatio):
        return "ratio", "(as given)", words
    limit = _floored(most_eccentricity(ratio, alpha), 4)
    return "eccentricity", f"{float(ratio.eccentricity):.6g}", f"{words}: eccentricity at most {limit}"


def most_eccentricity(ratio: EllipseRatio, pressure_angle: float) -> float:
    """Largest eccentricity at which the gears are not self-locking.

    It follows from ``tan psi = n e / sqrt(1 - e^2)`` at the largest lean of the tangent (Dong et al. 2020, eq. 27, for
    one lobe).
    """
    slope = math.tan(MOST_LEAN - pressure_angle)
    return slope / math.hypot(ratio.driver_lobes, slope)


def _sharp(curves: PitchCurves, t: np.ndarray, bends: np.ndarray, module: float, addendum: float) -> Fault | None:
    """Fault of pitch curves whose curvature is so large that teeth are undercut.

    Convex parts are undercut below the pitch curve. Concave parts are undercut above it, as in internal gears, whose
    flanks end at their own base circle there.
    """
    alpha, height = float(curves.pressure_angle), addendum * module
    shares = math.sin(alpha) ** 2, 1 - math.cos(alpha)
    for name, sharp in zip(GEARS, bends, strict=True):
        for share, bend, words in zip(shares, (sharp, -sharp), ("outwards", "inwards"), strict=True):
            worst = int(bend.argmax())
            if bend[worst] * height > share:
                radius = 1 / bend[worst]
                told = f"undercut: the pitch curve of the {name} is curved {words} with a radius of {_mm(radius)} at "
                told = f"{told}{t[worst] / units.deg:.4g} deg, must be at least {_mm(height / share)}: give more teeth"
                lower = math.floor(radius * share / module * 1e4) / 1e4
                if _meets(curves, module, lower):  # else lower teeth lose contact: only more teeth help
                    told = f"{told}, or an addendum of at most {lower:.4f}"
                return "addendum", f"{addendum:.6g}", told
    return None


def _cut_by_hollow(curves: PitchCurves, t: np.ndarray, module: float, addendum: float) -> Fault | None:
    """Fault of flanks that tips of the other gear reach past the evolute of their own pitch curve.

    Next to a hollow of their pitch curve tips are wider apart than those of a rack, and reach deeper. A flank folds
    where a tip is farther from the pitch point, along the line of action, than ``sin(alpha0)`` over the curvature.
    """
    past = np.asarray(_past(curves, jnp.asarray(t), jnp.asarray(addendum * module)))
    gear, _, worst = np.unravel_index(int(past.argmax()), past.shape)
    if past.max() <= 1:
        return None
    told = f"undercut: tips of the {GEARS[1 - gear]} reach {past.max():.5g} times as deep as flanks"
    words = f"{told} of the {GEARS[gear]} go, at {t[worst] / units.deg:.4g} deg: lower the addendum, or give more teeth"
    return "addendum", f"{addendum:.6g}", words


@eqx.filter_jit
def _past(curves: PitchCurves, t: Array, height: Array) -> Array:
    """How deep tips of the other gear reach, over the depth at which flanks fold, shape (gear, side, angle)."""
    bends, sine = curves.at(t).curvatures, jnp.sin(curves.pressure_angle)
    return jnp.stack(
        [
            jnp.stack([jnp.abs(reach(curves, 1 - gear, t, side, height)[0]) * bend / sine for side in (1, -1)])
            for gear, bend in enumerate(bends)
        ]
    )


def _floored(number: float, digits: int) -> str:
    """A number as text, rounded down, so that the text itself does not exceed the limit."""
    return f"{math.floor(number * 10**digits) / 10**digits:.{digits}f}"


@eqx.filter_jit
def _looked_at(curves: PitchCurves, module: Scalar, addendum: Scalar) -> tuple[Array, Array, Array]:
    """Lean of the tangent, curvatures of both pitch curves, and contact ratio from these, over a turn of the driver."""
    t = jnp.asarray(np.linspace(0.0, 2 * math.pi, PLACES + 1), jnp.result_type(curves.centre_distance))
    at = curves.at(t)
    return at.lean, jnp.stack(at.curvatures), circular_contact_ratio(curves, t, module, addendum)


_contact = eqx.filter_jit(contact_ratio)  # one program; without it, every single operation would be compiled separately


def _circular_thickness(bend: np.ndarray, pressure_angle: float, module: float, addendum: float) -> np.ndarray:
    """Tip thickness of circular gears with a curvature, ``2 r_a (pi m / (4 r) + inv alpha - inv alpha_a)`` [m]."""
    radius = 1 / np.maximum(bend, 1e-9)
    tip = radius + addendum * module
    at_tip = np.arccos(np.clip(radius * math.cos(pressure_angle) / tip, -1.0, 1.0))
    turned = (math.tan(pressure_angle) - pressure_angle) - (np.tan(at_tip) - at_tip)
    return 2 * tip * (math.pi * module / (4 * radius) + turned)


def _mm(length: Scalar | float) -> str:
    return f"{float(length) / units.mm:.6g} mm"
