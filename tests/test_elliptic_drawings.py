"""Outlines of non-circular gears for CAD, and how the gears run as a film."""

import ezdxf
import numpy as np
import pytest
from PIL import Image

import gearjax as gj
from gearjax.checks import ParameterError, SceneError
from gearjax.geometry.noncircular_outline import outline
from gearjax.plot import noncircular_figure, save_noncircular_animation
from gearjax.units import um
from tests.conftest import ROOT
from tests.test_elliptic_pair import MOVING, pair, scene


def apart(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distance of points from a closed line of straight pieces."""
    begin, end = line, np.roll(line, -1, axis=0)
    along = end - begin
    square = (along**2).sum(axis=1)
    least = []
    for point in points:
        share = np.clip(((point - begin) * along).sum(axis=1) / square, 0.0, 1.0)
        least.append(np.hypot(*(begin + share[:, None] * along - point).T).min())
    return np.array(least)


@pytest.mark.slow
@pytest.mark.parametrize("body", ["driver", "driven"])
@pytest.mark.parametrize("tolerance", [0.1 * um, 5 * um])
def test_outlines_keep_their_tolerance(tmp_path, body, tolerance):
    gears = scene(**MOVING)
    true = outline(gears.system.teeth_of(body, 801, 60 * um))[::47] / 1e-3
    csv = gj.export_profile(gears, tmp_path / "gear.csv", body=body, tolerance=tolerance)
    points = np.loadtxt(csv, delimiter=",", skiprows=1)
    assert (points[0] == points[-1]).all()
    assert tolerance / 20 < apart(true, points[:-1]).max() * 1e-3 < tolerance
    drawing = ezdxf.readfile(gj.export_profile(gears, tmp_path / "gear.dxf", body=body, tolerance=tolerance))
    assert not drawing.audit().errors
    (line,) = drawing.modelspace()
    drawn = np.array(line.get_points("xyb"))
    np.testing.assert_allclose(drawn[:, :2], points[:-1], atol=1e-9)
    assert (drawn[:, 2] == 0).all()
    assert drawing.units == ezdxf.units.MM
    x, y = drawn[:, :2].T
    assert (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0  # counter-clockwise


@pytest.mark.slow
def test_backlash_and_names(tmp_path):
    alone = gj.export_profile(pair(), tmp_path / "one.csv", tolerance=5 * um).read_text()
    assert alone == gj.export_profile(scene(), tmp_path / "two.csv", body="driver", tolerance=5 * um).read_text()
    assert alone != gj.export_profile(scene(**MOVING), tmp_path / "three.csv", tolerance=5 * um).read_text()
    with pytest.raises(ParameterError, match="driven"):
        gj.export_profile(pair(), tmp_path / "one.csv", body="drive")


@pytest.mark.slow
def test_figure_and_film(tmp_path):
    gears = gj.load(ROOT / "configs" / "elliptic" / "two_lobes.toml")
    whole, near = noncircular_figure(gears, 0.7).axes[:2]
    assert whole.get_xlabel() == "x [mm]"
    assert len(near.lines) == 4  # both gears, both lines of action
    path = save_noncircular_animation(gears, tmp_path / "new" / "gears.gif", frames=3)
    with Image.open(path) as film:
        assert film.n_frames == 3
    for wrong, words in (({"path": "gears.avi"}, "must end in .gif or .mp4"), ({"frames": 1}, "at least 2")):
        with pytest.raises(ParameterError, match=words):
            save_noncircular_animation(gears, **({"path": tmp_path / "a.gif"} | wrong))
    with pytest.raises(SceneError, match="non-circular gears"):
        save_noncircular_animation(gj.load(ROOT / "configs" / "two_kv" / "wang_2020.toml"), tmp_path / "a.gif")
