"""Disc profiles in files: as near to the profile as was asked for, closed, counter-clockwise, in millimetres."""

import ezdxf
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

import gearjax as gj
from gearjax.geometry.cycloid import profile
from gearjax.units import mm, um


def rv(pins=40, circle=76 * mm, pin=3 * mm, throw=1.5 * mm, isometric=-22 * um, shifting=-43.7 * um) -> gj.RVCycloidal:
    return gj.RVCycloidal(pins, circle, pin, throw, isometric, shifting, 100.0, discs=1)


SYSTEMS = {
    "hu_2020": rv(),
    "three pins": rv(pins=3, circle=30 * mm, pin=5 * mm, throw=4 * mm, isometric=0.0, shifting=0.0),
    "1000 pins": rv(pins=1000, circle=500 * mm, pin=0.8 * mm, throw=0.3 * mm, isometric=0.0, shifting=0.0),
    "strongly modified": rv(isometric=-0.9 * mm, shifting=-1.5 * mm, throw=1.75 * mm, pin=2.2 * mm),
}
CASES = [
    *(pytest.param(name, 0.1 * um, marks=[pytest.mark.slow] if name == "1000 pins" else []) for name in SYSTEMS),
    pytest.param("hu_2020", 1e-9, marks=pytest.mark.slow),
    pytest.param("three pins", 1e-9, marks=pytest.mark.slow),
]


def outline(system: gj.RVCycloidal, samples: int) -> np.ndarray:
    """The profile itself, closed, shape (n + 1, 2) [mm]."""
    phase = np.linspace(0.0, 2 * np.pi * system.profile.teeth, samples + 1)
    return np.asarray(profile(system.profile, jnp.asarray(phase))) / mm


def farthest(points: np.ndarray, curve: np.ndarray) -> float:
    """Largest distance of points from a closed curve, which is given so densely that it is straight between."""
    near = cKDTree(curve[:-1]).query(points)[1]
    found = np.full(len(points), np.inf)
    for begin, end in ((near - 1, near), (near, near + 1)):
        start, way = curve[:-1][begin], curve[:-1][end % (len(curve) - 1)] - curve[:-1][begin]
        share = np.clip(((points - start) * way).sum(axis=1) / (way * way).sum(axis=1), 0.0, 1.0)
        found = np.minimum(found, np.hypot(*(points - start - share[:, None] * way).T))
    return float(found.max())


def drawn(path, each: int) -> np.ndarray:
    """The curve of a drawing, ``each`` points on each of its arcs, shape (n, 2) [mm]."""
    (line,) = ezdxf.readfile(path).modelspace()
    x, y, bulge = np.array(list(line.get_points("xyb"))).T
    begin = x + 1j * y
    end = np.roll(begin, -1)
    share = np.arange(each) / each
    angle = 4 * np.arctan(bulge)[:, None]
    curved = np.abs(angle) > 1e-12
    turned = np.where(curved, np.expm1(1j * angle * share) / np.where(curved, np.expm1(1j * angle), 1.0), share)
    found = (begin[:, None] + (end - begin)[:, None] * turned).ravel()
    return np.stack([found.real, found.imag], axis=1)


def area(points: np.ndarray) -> float:
    x, y = points.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


@pytest.mark.parametrize(("name", "tolerance"), CASES)
def test_a_drawing_is_within_its_tolerance(tmp_path, name, tolerance):
    system = SYSTEMS[name]
    path = gj.export_profile(system, tmp_path / "new" / "disc.dxf", tolerance=tolerance)
    curve = drawn(path, 24)
    exact = outline(system, 40 * len(curve))
    assert farthest(curve, exact) < tolerance / mm
    assert area(curve) == pytest.approx(-area(exact), rel=1e-5)  # all around; the profile itself runs clockwise


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tolerance"), CASES)
def test_points_are_within_their_tolerance(tmp_path, name, tolerance):
    system = SYSTEMS[name]
    rows = gj.export_profile(system, tmp_path / "disc.csv", tolerance=tolerance).read_text(encoding="ascii").split()
    header, lines = " ".join(rows[:3]), rows[3:]
    assert header == "x [mm],y [mm]"
    assert lines[0] == lines[-1]
    points = np.array([[float(value) for value in line.split(",")] for line in lines])
    assert farthest(outline(system, 6 * len(points) + 1), points) < tolerance / mm  # chords, seen from the profile
    assert farthest(points, outline(system, 40 * len(points))) < 0.1 * tolerance / mm
    assert area(points[:-1]) > 0


def test_a_drawing_is_a_sound_file_in_millimetres(tmp_path):
    path = gj.export_profile(SYSTEMS["hu_2020"], tmp_path / "disc.DXF")
    document = ezdxf.readfile(path)
    assert (document.dxfversion, document.header["$INSUNITS"], document.header["$MEASUREMENT"]) == ("AC1015", 4, 1)
    audit = document.audit()
    assert not audit.has_errors
    assert not audit.has_fixes
    (line,) = document.modelspace()
    assert (line.dxftype(), line.closed, line.dxf.layer) == ("LWPOLYLINE", True, "profile")
    arcs = len(line)
    assert any(bulge < 0 for *_, bulge in line.get_points("xyb"))  # roots are hollow
    fine = gj.export_profile(SYSTEMS["hu_2020"], tmp_path / "fine.dxf", tolerance=1e-9)
    points = len(gj.export_profile(SYSTEMS["hu_2020"], tmp_path / "disc.csv").read_text().splitlines())
    assert arcs < len(ezdxf.readfile(fine).modelspace()[0]) / 2
    assert arcs < points / 2


def test_a_scene_is_exported_as_its_gear_set(tmp_path, rv_text):
    scene = gj.loads(rv_text)
    both = [gj.export_profile(of, tmp_path / f"{i}.csv").read_text() for i, of in enumerate((scene, scene.system))]
    assert both[0] == both[1]


def test_mistakes_are_one_line(tmp_path, scene):
    own = SYSTEMS["hu_2020"]
    with pytest.raises(
        gj.SceneError,
        match="two_kv has no disc with a profile and no gears with outlines; an rv_cycloidal or an elliptic_pair has",
    ):
        gj.export_profile(scene, tmp_path / "disc.dxf")
    with pytest.raises(gj.ParameterError, match=r'path = ".*disc.step": must end in \.csv or \.dxf'):
        gj.export_profile(own, "disc.step")
    for wrong in (0.0, -1e-7, np.nan, 1.0, 1e-12):
        with pytest.raises(
            gj.ParameterError, match=r"tolerance = .*: must be (at least 1e-10 m and at most 0\.0001 m|finite)"
        ):
            gj.export_profile(own, tmp_path / "disc.csv", tolerance=wrong)
    with pytest.raises(gj.ParameterError, match=r"needs more than 5000000 points: give a larger tolerance, or \.dxf"):
        gj.export_profile(SYSTEMS["1000 pins"], tmp_path / "disc.csv", tolerance=1e-10)
    (tmp_path / "taken").write_text("")
    with pytest.raises(gj.GearjaxError, match="cannot be written"):
        gj.export_profile(own, tmp_path / "taken" / "disc.csv")
    assert gj.export_profile(own, str(tmp_path / "coarse.csv"), tolerance=1e-4).exists()
