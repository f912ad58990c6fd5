"""Geometry of non-circular gears: pitch curves, flanks, contact ratios, what closes them and what cannot be."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.special import ellipe

from gearjax.geometry import noncircular_teeth as teeth
from gearjax.geometry.noncircular import AbstractRatio, EllipseRatio, PitchCurves, TabulatedRatio
from gearjax.geometry.noncircular_outline import Teeth, flank, outline, placed, tooth_points
from gearjax.typing import Scalar
from tests.elliptic import ALPHA, MODULE, TEETH, E, Ellipses

ECCENTRICITIES = (0.0, 0.3287, 0.7071, 0.95)
T = np.linspace(-3.0, 9.0, 97)


def closed(e: float, **lobes: int) -> PitchCurves:
    ratio = EllipseRatio(jnp.asarray(e), **lobes)
    return PitchCurves(ratio, teeth.closing_centre_distance(ratio, TEETH, jnp.asarray(MODULE)), jnp.asarray(ALPHA))


@pytest.mark.parametrize("e", ECCENTRICITIES)
def test_curves_are_ellipses(e):
    curves, own = closed(e), Ellipses(e)
    at = eqx.filter_jit(curves.at)(jnp.asarray(T))
    np.testing.assert_allclose(curves.centre_distance, 2 * own.a, rtol=1e-13)
    np.testing.assert_allclose(at.radius, own.r1(T), rtol=1e-12)
    np.testing.assert_allclose(at.driven_radius, own.r2(T), rtol=1e-12)
    np.testing.assert_allclose(at.lean, own.psi(T), atol=1e-14)
    np.testing.assert_allclose(curves.ratio.driven_angle(jnp.asarray(T)), own.t2(T), atol=1e-13)
    # the arc length by another integral, and the perimeter by a complete one
    np.testing.assert_allclose(eqx.filter_jit(curves.arc_length)(jnp.asarray(T)), own.arc(T), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(curves.perimeter, 4 * own.a * ellipe(e * e), rtol=1e-13)
    # both gears' curvature is that of the ellipse (12)
    r = own.r1(T)
    radius = (r * (2 * own.a - r)) ** 1.5 / (own.a**2 * math.sqrt(1 - e * e))
    for bend in at.curvatures:
        np.testing.assert_allclose(1 / np.asarray(bend), radius, rtol=1e-10)


def test_curvature_radii_as_the_paper_has_them():
    """(12) of the ratio ``i12``, with ``(i')^2`` in place of ``(i'')^2``."""
    curves, e = closed(E), E
    i = (1 + e * e - 2 * e * np.cos(T)) / (1 - e * e)
    slope, bend = 2 * e * np.sin(T) / (1 - e * e), 2 * e * np.cos(T) / (1 - e * e)
    over = float(curves.centre_distance) * (1 + (slope / (1 + i)) ** 2) ** 1.5
    radii = over / (1 + i + bend), over * i / (1 + i - i * bend + slope**2)
    for radius, own in zip(radii, curves.at(jnp.asarray(T)).curvatures, strict=True):
        np.testing.assert_allclose(own, 1 / radius, rtol=1e-12)


def test_at_one_angle():
    curves, t = closed(E), jnp.asarray(math.radians(70.81))
    at = curves.at(t)
    assert float(curves.centre_distance) == pytest.approx(0.1449997173190, abs=1e-13)
    assert float(curves.ratio.driven_angle(t)) == pytest.approx(1.9057211625, abs=1e-10)
    assert math.degrees(at.lean) == pytest.approx(19.18988977, abs=1e-8)
    levers = [float(at.driven_radius * jnp.cos(curves.normal_angle(t, jnp.asarray(side)))) for side in (1.0, -1.0)]
    np.testing.assert_allclose(levers, [56.19141301e-3, 72.49256338e-3], atol=1e-11)
    contact = teeth.circular_contact_ratio(curves, t, jnp.asarray(MODULE), jnp.ones(()))
    assert float(contact) == pytest.approx(1.75868511, abs=1e-8)


@pytest.mark.parametrize(
    ("e", "distance", "least", "largest"),
    [
        (0.0, 0.15, 1.75467, 1.75467),
        (0.7, 0.15, 1.61633, 1.80768),
        (0.7071, 0.15, None, 1.80907),
        (0.2, 0.15, 1.74751, None),
        (0.3, 0.15, 1.73787, None),
        (0.5, 0.15, 1.70074, None),
        (0.3287, None, 1.727879, 1.758656),
    ],
)
def test_contact_ratio_of_circular_gears(e, distance, least, largest):
    curves = closed(e)
    if distance is not None:
        curves = PitchCurves(curves.ratio, jnp.asarray(distance), curves.pressure_angle)
    t = jnp.linspace(0.0, 2 * math.pi, 7201)
    contact = teeth.circular_contact_ratio(curves, t, jnp.asarray(MODULE), jnp.ones(()))
    for value, wanted in ((contact.min(), least), (contact.max(), largest)):
        if wanted is not None:
            assert float(value) == pytest.approx(wanted, abs=3.1e-5 if distance is None else 5.1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("e", "least", "largest", "tip"),
    [(E, 1.728146, 1.758456, 0.7659), (0.5, 1.702819, 1.779159, 0.7564), (0.7, 1.639344, 1.818758, 0.7304)],
)
def test_contact_ratio_by_the_tips(e, least, largest, tip):
    """The reference looked at the 47 teeth, whose driving flanks cross the pitch curve at whole pitches."""
    curves = closed(e)
    whole = jnp.linspace(0.0, 2 * math.pi, 4001)
    at_teeth = np.interp(math.pi * MODULE * (np.arange(TEETH) + 0.5), curves.arc_length(whole), whole)

    @jax.jit
    def contact(t):
        return teeth.contact_ratio(curves, t, 1, jnp.asarray(MODULE), jnp.ones(()))

    assert float(contact(whole).min()) == pytest.approx(least, abs=1e-6)
    assert float(contact(jnp.asarray(at_teeth)).max()) == pytest.approx(largest, abs=3e-5)
    for gear in (0, 1):
        assert teeth.tip_thickness(curves, gear, MODULE, 1.0).min() / MODULE == pytest.approx(tip, abs=1e-4)
    approximate = teeth.circular_contact_ratio(curves, whole, jnp.asarray(MODULE), jnp.ones(()))
    assert float(abs(approximate - contact(whole)).max()) < 4e-3


@pytest.mark.slow
def test_circular_gears_are_those_of_iso_21771():
    """Contact ratio and tip thickness of a pair without eccentricity, by the formulas of involute gears."""
    curves = closed(0.0)
    r, tip = MODULE * TEETH / 2, MODULE * (TEETH / 2 + 1)
    base = r * math.cos(ALPHA)
    contact = 2 * (math.sqrt(tip**2 - base**2) - r * math.sin(ALPHA)) / (math.pi * MODULE * math.cos(ALPHA))
    t = jnp.asarray([0.3])
    assert float(teeth.contact_ratio(curves, t, 1, jnp.asarray(MODULE), jnp.ones(()))[0]) == pytest.approx(
        contact, rel=1e-12
    )
    at_tip = math.acos(base / tip)
    turned = math.tan(ALPHA) - ALPHA - math.tan(at_tip) + at_tip
    thick = 2 * tip * (math.pi / (2 * TEETH) + turned)
    np.testing.assert_allclose(teeth.tip_thickness(curves, 0, MODULE, 1.0), thick, rtol=1e-9)


def test_what_closes_the_printed_gears():
    ratio = EllipseRatio(jnp.asarray(E))
    right = float(teeth.closing_centre_distance(ratio, TEETH, jnp.asarray(MODULE)))
    assert 0.5 * right == pytest.approx(72.4998586595e-3, abs=1e-13)
    assert 0.5 * right * (1 - E * E) == pytest.approx(64.6667064e-3, abs=1e-10)
    assert teeth.closing_eccentricity(ratio, 0.15, TEETH, MODULE, ALPHA) == pytest.approx(0.4786262506, abs=1e-10)
    assert MODULE * 0.15 / right == pytest.approx(3.1034543e-3, abs=1e-10)
    assert teeth.closing_eccentricity(ratio, 0.10, TEETH, MODULE, ALPHA) is None


@pytest.mark.parametrize(("e", "depth"), [(0.792901, 1.25), (0.845256, 1.0)])
def test_undercut_begins(e, depth):
    """Where the pitch curve's radius of curvature is the depth over the square of the sine (rack: ISO 21771)."""
    for off, undercut in ((-1e-5, False), (1e-5, True)):
        bend = closed(e + off).at(jnp.asarray(0.0)).curvatures[0]
        assert (1 / float(bend) < depth * MODULE / math.sin(ALPHA) ** 2) == undercut


def _rolled(own: Ellipses, t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pitch points of the driver at angle zero, with the tangent that the rack's pitch line lies on as it rolls."""
    lean = own.psi(t) + t
    return own.r1(t) * np.cos(t), -own.r1(t) * np.sin(t), np.sin(lean), np.cos(lean)


@pytest.mark.parametrize("e", [0.0, E, 0.7])
@pytest.mark.parametrize("side", [1, -1])
def test_a_rack_touches_flanks_and_does_not_cut_them(e, side):
    """A rack rolls along the pitch curve; its straight flank, which knows no envelope, comes up to flanks."""
    own, curves = Ellipses(e), closed(e)
    crossing = 5 * math.pi * MODULE
    inside = np.interp(crossing, own.arc(np.linspace(0, 2, 999)), np.linspace(0, 2, 999))
    t = inside + np.linspace(-0.06, 0.06, 7)
    points = flank(curves, 0, side, t, np.asarray(crossing))
    rolling = inside + np.linspace(-0.25, 0.25, 20001)
    x, y, tx, ty = _rolled(own, rolling)
    # outward of the pitch curve, and along it ahead; the rack's flank crosses its pitch line at the crossing
    along = (points[:, :1] - x) * tx + (points[:, 1:] - y) * ty
    out = (points[:, :1] - x) * ty - (points[:, 1:] - y) * tx
    ahead = own.arc(rolling) - crossing  # of where the rack's pitch line touches
    # the line's distance: flanks that drive lean away from the axis of the driver with alpha
    distance = side * (along - ahead) * math.cos(ALPHA) + out * math.sin(ALPHA)
    # material of the tooth is on one side: the rack comes to the point and never past it
    depth = distance.max(axis=1)
    np.testing.assert_allclose(depth, 0.0, atol=2e-11)
    touched = rolling[distance.argmax(axis=1)]
    np.testing.assert_allclose(touched, t, atol=2e-4)


@pytest.mark.parametrize("e", [E, 0.7])
def test_a_shaper_cuts_the_same_flanks(e):
    """A cutter of 24 involute teeth rolls around the driven gear: involutes of one base circle are parallel curves."""
    own, curves = Ellipses(e), closed(e)
    crossing, radius = 5 * math.pi * MODULE, 12 * MODULE
    base = radius * math.cos(ALPHA)
    inside = np.interp(crossing, own.arc(np.linspace(0, 2, 999)), np.linspace(0, 2, 999))
    t = inside + np.linspace(-0.05, 0.03, 7)
    points = flank(curves, 1, 1, t, np.asarray(crossing))
    rolling = inside + np.linspace(-0.2, 0.2, 20001)
    turned = own.t2(rolling)
    lean = own.psi(rolling) - turned
    inward, tangent = np.array([np.cos(lean), -np.sin(lean)]), np.array([np.sin(lean), np.cos(lean)])
    centre = own.r2(rolling) * np.array([-np.cos(turned), -np.sin(turned)]) - radius * inward
    off = points[:, :, None] - centre[None]
    along, across = (off * inward).sum(axis=1), (off * tangent).sum(axis=1)
    square = along**2 + across**2 - base**2
    unwound = np.sqrt(np.maximum(square, 0.0)) / base
    begins = np.arctan2(across, along) - np.arctan(unwound) + unwound
    distance = base * (begins - (own.arc(rolling) - crossing) / radius - math.tan(ALPHA) + ALPHA)
    distance = np.where(square > 0, distance, np.inf)  # inside the base circle there is no flank
    np.testing.assert_allclose(distance.min(axis=1), 0.0, atol=2e-11)
    np.testing.assert_allclose(rolling[distance.argmin(axis=1)], t, atol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("e", [E, 0.7])
def test_generated_teeth_run_together(e):
    """Outlines of both gears, laid into each other over a turn: they touch, and overlap by less than 0.1 um."""
    curves = closed(e)
    pair = Teeth(curves, (TEETH, TEETH), MODULE, 1.0)
    rows = [tooth_points(pair, gear, 1500) for gear in (0, 1)]
    for t in np.linspace(0.0, 2 * math.pi, 9)[:-1] + 0.1:
        turned = t, float(curves.ratio.driven_angle(jnp.asarray(t)))
        radius = float(curves.at(jnp.asarray(t)).radius)
        for first, second in ((0, 2), (2, 0)):  # flanks that drive, and back flanks
            own = placed(rows[0][first], 0, turned[0], float(curves.centre_distance)).reshape(-1, 2)
            own = own[np.hypot(own[:, 0] - radius, own[:, 1]) < 3 * MODULE]
            other = placed(rows[1][second], 1, turned[1], float(curves.centre_distance))
            apart = []
            for one in other:
                near = np.hypot(one[:, 0] - radius, one[:, 1]) < 3.5 * MODULE
                if near.sum() > 10:
                    apart.append(_beyond(own, one))
            least = np.nanmin(np.abs(np.concatenate(apart)))
            assert least < 1e-8
            # signed: of the flank next to each point, on which side of it the point lies
            sign = 1.0 if first == 0 else -1.0
            over = np.concatenate(apart) * sign
            near = over[np.abs(over) < 0.3 * MODULE]
            assert near.min() > -1e-7


def _beyond(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Signed distance of points from a line of many pieces, nan beyond its ends, ahead (y) positive."""
    order = np.argsort(line[:, 0])
    x, y = line[order].T
    inside = (points[:, 0] > x[0]) & (points[:, 0] < x[-1])
    height = np.interp(points[:, 0], x, y)
    slope = np.interp(points[:, 0], 0.5 * (x[1:] + x[:-1]), np.diff(y) / np.diff(x))
    return np.where(inside, (height - points[:, 1]) / np.hypot(1.0, slope), np.nan)


@pytest.mark.slow
def test_outlines_are_closed_and_as_long_as_told():
    curves = closed(E)
    pair = Teeth(curves, (TEETH, TEETH), MODULE, 1.0, backlash=1e-4)
    for gear in (0, 1):
        points = outline(tooth_points(pair, gear, 24))
        assert len(points) == TEETH * 6 * 24
        steps = np.hypot(*np.diff(np.concatenate([points, points[:1]]), axis=0).T)
        assert steps.max() < 0.6 * MODULE
    # half of the backlash is gone from each gear's teeth, measured along the pitch curve
    thick = [tooth_points(Teeth(curves, (TEETH, TEETH), MODULE, 1.0, b), 0, 9)[2] for b in (0.0, 1e-4)]
    moved = np.hypot(*(thick[0] - thick[1])[:, 4].T)
    np.testing.assert_allclose(moved, 0.5e-4, rtol=0.2)


class TestTables:
    @pytest.mark.slow
    def test_a_spline_through_values_is_scipys(self):
        rng = np.random.default_rng(3)
        for number in (8, 13):
            values = rng.random(number) + 0.6
            values /= values.mean()
            own = TabulatedRatio(jnp.asarray(values))
            places = np.arange(number + 1) * 2 * np.pi / number
            spline = make_interp_spline(places, np.append(values, values[0]), 5, bc_type="periodic")
            t = np.linspace(0.0, 2 * np.pi, 61)
            for order, rate in enumerate(eqx.filter_jit(own.rates)(jnp.asarray(t))):
                np.testing.assert_allclose(rate, spline(t, order), atol=1e-12)
            angle = spline.antiderivative()(t) - spline.antiderivative()(0.0)
            np.testing.assert_allclose(own.driven_angle(jnp.asarray(t)), angle, atol=1e-13)
            np.testing.assert_allclose(own.driven_angle(jnp.asarray(t - 6 * np.pi)), angle - 6 * np.pi, atol=1e-12)

    @pytest.mark.slow
    def test_convergence_to_an_ellipse(self):
        own, t = EllipseRatio(jnp.asarray(E)), jnp.linspace(0.0, 2 * np.pi, 501)
        off = []
        for number in (24, 48, 96):
            values = own.rates(jnp.asarray(np.arange(number) * (2 * np.pi / number)))[0]
            off.append(float(abs(TabulatedRatio(values).rates(t)[0] - own.rates(t)[0]).max()))
        orders = np.log2(np.array(off[:-1]) / np.array(off[1:]))
        assert (orders > 5.5).all()

    @pytest.mark.slow
    def test_rates_are_derivatives(self):
        for own in (
            EllipseRatio(jnp.asarray(0.4), 2, 3),
            TabulatedRatio(jnp.asarray([1.3, 1.2, 1.0, 0.8, 0.7, 0.8, 1.0, 1.2])),
        ):
            t = jnp.linspace(0.1, 5.0, 23)
            ratio, slope, bend = own.rates(t)
            ones = jnp.ones_like(t)
            np.testing.assert_allclose(jax.jvp(own.driven_angle, (t,), (ones,))[1], ratio, rtol=1e-11)
            np.testing.assert_allclose(jax.jvp(lambda t, own=own: own.rates(t)[0], (t,), (ones,))[1], slope, atol=1e-11)
            np.testing.assert_allclose(jax.jvp(lambda t, own=own: own.rates(t)[1], (t,), (ones,))[1], bend, atol=1e-10)


class Swinging(AbstractRatio):
    """A ratio function of one's own, by its angle alone: ``t + swing sin t``."""

    swing: Scalar
    driver_lobes: int = eqx.field(static=True, default=1)
    driven_lobes: int = eqx.field(static=True, default=1)

    def driven_angle(self, t):
        return t + self.swing * jnp.sin(t)


def test_a_ratio_function_of_ones_own():
    own = Swinging(swing=jnp.asarray(0.4))
    t = np.linspace(0.0, 2 * np.pi, 2001)
    ratio, slope, bend = own.rates(jnp.asarray(t))
    np.testing.assert_allclose(ratio, 1 + 0.4 * np.cos(t), rtol=1e-14)
    np.testing.assert_allclose(slope, -0.4 * np.sin(t), atol=1e-14)
    np.testing.assert_allclose(bend, -0.4 * np.cos(t), atol=1e-14)
    # both pitch curves turn by a whole turn once around: the integral of their curvature along them
    at = PitchCurves(own, jnp.asarray(0.1), jnp.asarray(ALPHA)).at(jnp.asarray(t))
    for bent in at.curvatures:
        assert float((bent * at.speed)[:-1].mean()) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("lobes", [(2, 2), (1, 2), (2, 3), (3, 1)])
def test_lobes_close(lobes):
    """The driven gear turns by whole lobes, its curve closes, and both curves are as long for each lobe."""
    ratio = EllipseRatio(jnp.asarray(0.2), *lobes)
    curves = PitchCurves(ratio, jnp.asarray(0.1), jnp.asarray(ALPHA))
    around = 2 * np.pi * lobes[1] / lobes[0]  # of the driver, until the driven gear is back
    assert float(ratio.driven_angle(jnp.asarray(around))) == pytest.approx(2 * np.pi, abs=1e-12)
    t = np.linspace(0.0, around, 20001)
    at = curves.at(jnp.asarray(t))
    turned = np.asarray(ratio.driven_angle(jnp.asarray(t)))
    x, y = np.asarray(at.driven_radius) * np.cos(turned), np.asarray(at.driven_radius) * np.sin(turned)
    long = np.hypot(np.diff(x), np.diff(y)).sum()
    assert long == pytest.approx(float(curves.arc_length(jnp.asarray(around))), rel=1e-7)
    r = np.asarray(at.radius)
    np.testing.assert_allclose(r, r[0] * (1 - 0.2) / (1 - 0.2 * np.cos(lobes[0] * t)), rtol=1e-12)
