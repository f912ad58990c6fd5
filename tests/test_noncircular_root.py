"""Roots of non-circular gears: outlines run together without overlap, fillets are those of a rolling rack."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

import gearjax as gj
from gearjax.geometry.involute import InvoluteGear
from gearjax.geometry.noncircular_outline import outline, placed
from gearjax.geometry.noncircular_root import Cutter, Root, cut_by_rack
from gearjax.geometry.root_fillet import RootFillet
from gearjax.units import um
from tests.conftest import ROOT
from tests.elliptic import ALPHA, MODULE, TEETH, Ellipses
from tests.test_elliptic_pair import pair
from tests.test_noncircular import closed

CROSSING = np.array([-3.0, 0.0, 17.3, 50.0]) * math.pi * MODULE
ROUNDING = 0.25 * MODULE / (1 - math.sin(ALPHA))  # flanks of the rack end one module above its pitch line
ACROSS = MODULE * math.tan(ALPHA) + ROUNDING * math.cos(ALPHA)  # from a flank of the rack to its centre of rounding
SHARE = np.linspace(0.0, 1.0, 25)


def lobed(driver: int, driven: int, e: float = 0.15, teeth: int = 60) -> gj.EllipticPair:
    return gj.EllipticPair(teeth, 2e-3, e, 20.0, driver_lobes=driver, driven_lobes=driven)


def table() -> gj.NoncircularPair:
    x = np.arange(20) * 2 * np.pi / 20
    values = 1 + 0.25 * np.cos(x) + 0.08 * np.sin(2 * x) + 0.03 * np.cos(3 * x - 1)
    return gj.NoncircularPair(50, 2.5e-3, jnp.asarray(values / values.mean()), 20.0)


PAIRS = {
    "dong": lambda: gj.load(ROOT / "configs" / "elliptic" / "dong_2020.toml").system,
    "two_lobes": lambda: gj.load(ROOT / "configs" / "elliptic" / "two_lobes.toml").system,
    "e_0.7": lambda: pair(eccentricity=0.7),
    "e_0.6": lambda: pair(teeth=61, module=2e-3, eccentricity=0.6),
    "2_to_3": lambda: lobed(2, 3),
    "2_to_1": lambda: lobed(2, 1),
    "table": table,
    "circular": lambda: pair(teeth=24, eccentricity=0.0),
    "fewest": lambda: pair(teeth=18, eccentricity=0.0),
    "28_deg": lambda: pair(eccentricity=0.4, pressure_angle=math.radians(28)),
    "concave_2_2": lambda: lobed(2, 2, 0.42, teeth=80),
    "concave_3_2": lambda: lobed(3, 2, 0.25, teeth=90),
}


class Outline:
    """A closed line of straight pieces, counter-clockwise."""

    def __init__(self, points: np.ndarray):
        apart = np.hypot(*(points - np.roll(points, -1, axis=0)).T)
        points = points[apart > 1e-8]  # pieces share their ends, up to some nm
        x, y = points.T
        if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() < 0:
            points = points[::-1]
        self.points, self.along = points, np.roll(points, -1, axis=0) - points
        self.tree = KDTree(points)

    def outside(self, points: np.ndarray) -> np.ndarray:
        """Distance of points from the line, negative inside; the pieces next to three near corners are looked at."""
        corners = self.tree.query(points, 3)[1]
        pieces = np.concatenate([corners, corners - 1], axis=1) % len(self.points)
        along, off = self.along[pieces], points[:, None] - self.points[pieces]
        square = (along**2).sum(axis=2)
        share = np.clip((off * along).sum(axis=2) / square, 0.0, 1.0)
        away = off - share[..., None] * along
        normals = np.stack([along[..., 1], -along[..., 0]], axis=-1) / np.sqrt(square)[..., None]
        far = np.hypot(away[..., 0], away[..., 1])
        # at a corner the sum of both pieces' normals tells the side
        nearest = far <= far.min(axis=1, keepdims=True) * (1 + 1e-9) + 1e-15
        normal = (normals * nearest[..., None]).sum(axis=1)
        first = far.argmin(axis=1)
        return np.sign((away[np.arange(len(points)), first] * normal).sum(axis=1)) * far.min(axis=1)


def overlap(system: gj.EllipticPair | gj.NoncircularPair, places: int, points: int = 150) -> tuple[float, float]:
    """Largest depth of one outline in the other one over a cycle, and their largest distance [m]."""
    gears = [Outline(outline(system.teeth_of(body, points, 0.0))) for body in system.bodies]
    distance, module = float(system.curves.centre_distance), float(system.module)
    deep, wide = 0.0, 0.0
    for t in np.linspace(0.0, system.cycle, places, endpoint=False) + 0.0371:
        turned = t, float(system.output(jnp.asarray(t)))
        pitch = np.array([float(system.curves.at(jnp.asarray(t)).radius), 0.0])
        least = np.inf
        for gear, mate in ((0, 1), (1, 0)):
            own = placed(gears[gear].points, gear, turned[gear], distance)
            own = own[np.hypot(*(own - pitch).T) < 4 * module]
            shifted = own - np.array([mate * distance, 0.0])
            least = min(least, gears[mate].outside(placed(shifted, 0, (-1, 1)[mate] * turned[mate], 0.0)).min())
        deep, wide = max(deep, -least), max(wide, least)
    return deep, wide


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
def test_outlines_run_together(name):
    """At many positions they touch, and overlap by no more than 0.1 um; the chords of these outlines are within 0.1 um.

    With straight lines below the flanks, e = 0.7 overlapped by 42 um, two_lobes by 17, and 18 circular teeth by 10.
    """
    deep, wide = overlap(PAIRS[name](), 150)
    assert deep < 0.1 * um
    assert wide < 0.1 * um


@pytest.mark.slow
def test_overlap_is_seen():
    """Corners of an outline, moved inwards or outwards by 1 um."""
    gear = Outline(outline(PAIRS["circular"]().teeth_of("driver", 60, 0.0)))
    outwards = np.stack([gear.along[:, 1], -gear.along[:, 0]], axis=1) / np.hypot(*gear.along.T)[:, None]
    moved = gear.points - 1 * um * outwards
    assert gear.outside(moved).min() == pytest.approx(-1 * um, rel=0.01)
    assert gear.outside(2 * gear.points - moved).min() > 0.5 * um


def by_rack(e: float, gear: int, way: int, backlash: float = 0.0) -> Root:
    space = 0.5 * (math.pi * MODULE + backlash / math.cos(ALPHA))
    return cut_by_rack(closed(e), gear, way, CROSSING, Cutter(MODULE, 0.25 * MODULE, space, MODULE), SHARE)


@pytest.mark.parametrize(("gear", "way"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_circular_gears_have_the_trochoid_of_a_rack(gear, way):
    """In axes of the tooth: half of its thickness, and distance from the axis of the gear (ISO 21771)."""
    root = by_rack(0.0, gear, way)
    module, alpha, shift, addendum, dedendum = map(jnp.asarray, (MODULE, ALPHA, 0.0, 1.0, 1.25))
    fillet = RootFillet(InvoluteGear(TEETH, module, alpha, shift, addendum, dedendum), jnp.asarray(ROUNDING))
    wanted = np.stack(fillet.at(jnp.asarray(ALPHA + (0.5 * math.pi - ALPHA) * SHARE)))
    for crossing, points in zip(CROSSING, root.points, strict=True):
        # direction of the middle of the tooth; points with higher arc lengths follow behind it
        middle = (crossing - way * 0.25 * math.pi * MODULE) / (0.5 * MODULE * TEETH)
        sign = 1 if gear == 0 else -1
        along = np.array([sign * math.cos(middle), -math.sin(middle)])
        ahead = np.array([sign * along[1], -sign * along[0]])
        np.testing.assert_allclose([way * points @ ahead, points @ along], wanted, atol=1e-13)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("backlash", [0.0, 60 * um])
def test_the_tip_of_a_rolling_rack_touches_fillets_and_does_not_cut_them(way, backlash):
    """A circle, the rounded tip of a rack that rolls along the ellipse, comes up to the points and not past them."""
    own, root = Ellipses(0.7), by_rack(0.7, 0, way, backlash)
    turn = np.linspace(-1.0, 7.5, 100_001)
    for crossing, points in zip(CROSSING, root.points, strict=True):
        near = np.interp(crossing, own.arc(turn), turn)
        t = near + np.linspace(-0.3, 0.3, 40_001)
        lean = own.psi(t) + t
        ahead = crossing + way * ACROSS - own.arc(t)
        x = own.r1(t) * np.cos(t) - ahead * np.sin(lean) - (MODULE * 1.25 - ROUNDING) * np.cos(lean)
        y = -own.r1(t) * np.sin(t) - ahead * np.cos(lean) + (MODULE * 1.25 - ROUNDING) * np.sin(lean)
        clear = [np.hypot(x - px, y - py).min() - ROUNDING for px, py in points]
        np.testing.assert_allclose(clear, 0.0, atol=1e-10)
        # it begins where the flank of the rack ends, whose flanks pass through the crossing
    begun = own.arc(root.start) - CROSSING
    np.testing.assert_allclose(begun, way * MODULE / (math.sin(ALPHA) * math.cos(ALPHA)), atol=1e-11)


@pytest.mark.parametrize(("degrees", "depth"), [(20, 1.25), (22, 1.25), (25, 1.2), (30, 1.12)])
def test_racks_with_thin_teeth_cut_less_deep(degrees, depth):
    """Two roundings have room on the tip, and the flanks still reach as deep as the teeth are high."""
    alpha, curves = math.radians(degrees), closed(0.3)
    curves = type(curves)(curves.ratio, curves.centre_distance, jnp.asarray(alpha))
    cutter = Cutter(MODULE, 0.25 * MODULE, 0.5 * math.pi * MODULE, MODULE)
    root = cut_by_rack(curves, 0, 1, np.zeros(1), cutter, SHARE)
    assert root.depth[0] / MODULE == pytest.approx(depth, abs=5e-3)
    end = float(curves.arc_length(jnp.asarray(root.end[0])))
    assert end < 0.25 * math.pi * MODULE  # the middle of the space


@pytest.mark.slow
@pytest.mark.parametrize("name", ["e_0.7", "28_deg", "concave_3_2", "fewest"])
@pytest.mark.parametrize("backlash", [0.0, 60 * um])
def test_outlines_are_closed_and_do_not_cross_themselves(name, backlash):
    system = PAIRS[name]()
    for body in system.bodies:
        pieces = system.teeth_of(body, 24, backlash)
        for one, other in zip(pieces, [*pieces[1:], np.roll(pieces[0], -1, axis=0)], strict=True):
            np.testing.assert_allclose(one[:, -1], other[:, 0], atol=1e-12)
        line = Outline(outline(pieces))
        begin, end = line.points, np.roll(line.points, -1, axis=0)
        longest = np.hypot(*line.along.T).max()
        one, other = KDTree(begin + 0.5 * line.along).query_pairs(longest, output_type="ndarray").T
        apart = (other - one) % len(begin)
        one, other = (part[(apart > 1) & (apart < len(begin) - 1)] for part in (one, other))

        def side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
            return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])

        ends = begin[one], end[one], begin[other], end[other]
        a = side(*ends[:3]) * side(ends[0], ends[1], ends[3])
        b = side(*ends[2:], ends[0]) * side(*ends[2:], ends[1])
        assert len(one) > len(begin)
        assert not ((a < 0) & (b < 0)).any()
        x, y = outline(pieces).T  # of the driver clockwise: arc lengths rise as it turns ahead
        turns = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
        assert turns * (-1 if body == "driver" else 1) > 0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tolerance"), [("e_0.7", 0.1 * um), ("2_to_3", 20 * um), ("concave_3_2", 1 * um)])
def test_drawn_roots_keep_their_tolerance(tmp_path, name, tolerance):
    """The points of a file are counter-clockwise, and fine points of the roots are as near to its lines as told."""
    system = PAIRS[name]()
    for body in system.bodies:
        path = gj.export_profile(system, tmp_path / "gear.csv", body=body, tolerance=tolerance)
        points = np.loadtxt(path, delimiter=",", skiprows=1)[:-1] * 1e-3
        x, y = points.T
        assert (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0
        for piece in system.teeth_of(body, 403, 0.0)[3:]:
            assert np.abs(Outline(points).outside(piece.reshape(-1, 2))).max() < tolerance
