"""The picture of the involute pair: what it shows is where the gears are."""

import dataclasses
import io
import re

import numpy as np
import pytest
from matplotlib.figure import Figure

import gearjax as gj
from gearjax.plot import noncircular_figure, pair_figure, save_figures, save_pair_figure
from gearjax.plot.axes import DPI, draw_curve, finish, new_figure, save_figure
from gearjax.plot.involute import _factor, _zones
from gearjax.results import run_cases
from gearjax.units import mm, um
from tests.involute import curves_of, system

TORQUE, THETA = 40.0, np.array([0.3, 0.31])


@pytest.fixture(scope="module")
def loaded() -> tuple[gj.Scene, np.ndarray, np.ndarray]:
    own = system(pairs=9, profile_points=2, face_points=2)
    compliance = gj.ElasticTeeth(206e9, 0.3, 6.5 * mm, 14 * mm)
    scene = gj.Scene(own, backlash=gj.InitialBacklash(10 * um), compliance=compliance)
    ahead, back = (gj.transmission_error(scene, THETA, way * TORQUE, extremes="samples").forces[0] for way in (1, -1))
    return scene, np.asarray(ahead), np.asarray(back)


@pytest.mark.slow
def test_teeth_stand_where_the_gears_are(loaded):
    scene, forces, _ = loaded
    zones, back = _zones(scene, scene.system, 0.3, forces)
    (zone,), curves = zones, curves_of(scene.system)
    assert not back
    assert (np.diff(zone.tooth) % 236 == 1).all()
    # candidates of both flanks are at the same place, within the gap
    assert np.abs(zone.place[0] - zone.place[1]).max() < 20 * um
    spaces = zone.tooth - 236 * (zone.tooth > 118)
    crank = scene.system.orders["crank"] * 0.3
    for row, space in enumerate(spaces):
        for place, normal in zip(zone.place[1, row], zone.normal[row], strict=True):
            expected = curves.ring_point(2 * np.pi * space / 240 - crank, abs(place))
            assert abs(place - expected) < 1e-9
            assert abs((place * np.conj(normal)).imag) == pytest.approx(curves.base[1], rel=1e-9)  # tangent to it
    assert zone.gap.min() == pytest.approx(0.0, abs=1e-12)
    assert zone.loads.sum() == pytest.approx(TORQUE / curves.base[0], rel=1e-9)


def texts(ax) -> str:
    return " ".join(text.get_text() for text in ax.texts)


@pytest.mark.slow
def test_the_figure_tells_loads_gaps_and_the_factor(loaded):
    scene, ahead, back = loaded
    for forces, words in ((ahead, "driving flanks carry"), (back, "back flanks carry, mirrored")):
        teeth, bars = pair_figure(scene, 0.3, forces).axes
        assert words in teeth.get_title()
        assert re.search(r"unloaded gaps enlarged [0-9.e+]+ times", teeth.get_title())
        assert (teeth.get_ylabel(), bars.get_ylabel()) == ("outwards [mm]", "load of the pair [N]")
        heights = np.array([bar.get_height() for bar in bars.patches])
        assert heights.sum() == pytest.approx(forces.sum(), rel=1e-9)
        assert (heights == 0).sum() >= 1  # pairs beside those that carry
        assert "gap 0.00 um" in texts(bars)
        assert f"{heights.max():.0f} N" in texts(bars)


@pytest.mark.slow
def test_several_gears_have_a_row_each_and_nothing_carries_in_one(loaded):
    scene = loaded[0]
    two = dataclasses.replace(scene, system=system(gears=2, pairs=7), backlash=None)
    forces = np.zeros(14)
    forces[9] = 50.0
    figure = pair_figure(two, 0.3, forces)
    assert [ax.get_title()[:6] for ax in figure.axes[::2]] == ["gear_1", "gear_2"]
    assert [ax.get_ylim() for ax in figure.axes[1::2]] == [(0.0, 62.5)] * 2


@pytest.mark.parametrize(("largest", "factor"), [(4e-6, 50.0), (6e-6, 30.0), (9e-6, 20.0), (1e-3, 1.0), (0.0, 1.0)])
def test_gaps_are_drawn_by_round_factors(largest, factor):
    assert _factor(largest, 0.58e-3) == pytest.approx(factor)


@pytest.mark.slow
def test_a_run_writes_it(loaded, tmp_path, monkeypatch):
    monkeypatch.setattr("gearjax.plot.run.spectrum_figure", lambda *_: None)  # of whole cycles, which takes seconds
    scene, forces, _ = loaded
    assert save_pair_figure(scene, 0.3, forces, tmp_path / "pair.png").read_bytes()[:4] == b"\x89PNG"
    run = gj.Run(THETA[1] / float(scene.system.input_speed), 2, ("static",), (TORQUE,))
    few = dataclasses.replace(scene, run=run)
    written = save_figures(few, list(run_cases(few)), tmp_path / "run")
    assert {"pair.png", "contact_forces.png"} < {path.name for path in written}
    assert "stage.png" not in {path.name for path in written}


def four_panels() -> Figure:
    figure, axes = new_figure(2, 2, width=7.0)
    for place, ax in enumerate(axes):
        draw_curve(ax, np.linspace(0.0, 1.0, 50), np.linspace(0.0, 1e-3, 50) ** (place + 1), f"case {place}")
        finish(ax, "a title\nof two lines")
    return figure


def test_a_figure_is_drawn_once_and_looks_as_matplotlib_lays_it_out(tmp_path, monkeypatch):
    plain = io.BytesIO()
    four_panels().savefig(plain, dpi=DPI)
    figure = four_panels()
    engine, dpi, drawn = figure.get_layout_engine(), figure.dpi, []
    draw = Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda self, renderer: drawn.append(draw(self, renderer)))
    assert save_figure(figure, tmp_path / "one.png").read_bytes() == plain.getvalue()
    assert len(drawn) == 1
    assert (figure.get_layout_engine(), figure.dpi) == (engine, dpi)
    assert save_figure(figure, tmp_path / "one.svg").read_text(encoding="utf-8").startswith("<?xml")


@pytest.mark.parametrize("figure", [lambda scene: pair_figure(scene, 0.0, np.ones(1)), noncircular_figure])
def test_figures_of_one_gear_set_refuse_others(figure, scene):
    with pytest.raises(gj.SceneError, match=r"this figure draws .*, the scene has a two_kv"):
        figure(scene)
