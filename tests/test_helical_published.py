"""Guo and Fang (2018): what `gearjax reproduce helical` prints."""

import json
import math

import matplotlib.pyplot as plt
import numpy as np
import pytest

import gearjax as gj
from gearjax.cli import main
from gearjax.reproduce import helical
from gearjax.units import um
from tests.validation import assert_shown


@pytest.fixture(scope="module")
def rows():
    return {row.item: row for row in helical.rows()}


@pytest.mark.slow
def test_frequencies_and_run_outs_are_reproduced(rows):
    """All that rests on printed numbers; what does not says which are missing."""
    missed = {item for item, row in rows.items() if row.published and row.status != "reproduced"}
    assert missed == {
        f"{table}, {speed} rpm, simulation {simulation}, {name}"
        for table, speed in (("Table 4", "50.8"), ("Table 6", "2104"))
        for simulation, names in ((1, ("f_g", "f_p", "f_m")), (2, ("f_m",)), (3, ("f_g", "f_p", "f_m")))
        for name in names
    }
    assert all(rows[item].why for item in missed)
    assert len(rows) == 48


@pytest.mark.slow
def test_run_outs_are_seen_in_full_and_make_no_sidebands(rows):
    """Along the base tangent a run-out is its own amplitude, whatever the load does."""
    for name, amplitude in (("f_g", 20.0), ("f_p", 15.0)):
        assert rows[f"Table 4, 50.8 rpm, simulation 2, {name}"].computed == pytest.approx(amplitude, rel=1e-9)
    assert all(row.computed < 1e-9 for item, row in rows.items() if "static, height" in item)


@pytest.mark.slow
def test_the_sidebands_of_the_paper_are_those_of_its_series(rows):
    """Half the alternating stiffness over its mean, times the run-outs."""
    gears = helical.scene()
    alone = gj.Scene(gears.system, compliance=gears.compliance)
    stiffness = np.asarray(gj.mesh_stiffness(alone, 2 * math.pi / 19 / 64 * np.arange(64), helical.TORQUE).secant)
    share = np.abs(np.fft.rfft(stiffness)[1]) / stiffness.sum()
    for name, amplitude in (("- f_p", 15.0), ("- f_g", 20.0), ("+ f_g", 20.0), ("+ f_p", 15.0)):
        height = rows[f"Table 5, series of the paper, height of f_m {name}"].computed
        assert height == pytest.approx(share * amplitude, rel=5e-3)


@pytest.mark.slow
def test_the_sidebands_are_drawn(rows, tmp_path):
    """One group of bars for each sideband, those of the series beside those that are there."""
    (written,) = helical.save_sidebands_figure(list(rows.values()), tmp_path)
    assert written.name == "helical_sidebands.png"
    assert plt.imread(written).std() > 0.05


@pytest.mark.slow
def test_the_mesh_order_is_that_of_one_mesh_without_run_outs(rows):
    """Another record and no run-outs: 32 angles of one mesh."""
    gears = helical.scene()
    alone = gj.Scene(gears.system, compliance=gears.compliance)
    theta = 2 * math.pi / 19 / 32 * np.arange(32)
    te = np.asarray(gj.transmission_error(alone, theta, helical.TORQUE).te)
    height = np.abs(np.fft.rfft(te)[1]) / 16 * 0.134264 / um
    assert rows["Table 4, 50.8 rpm, simulation 2, f_m"].computed == pytest.approx(height, rel=0.02)


def test_the_validation_page_shows_them(rows):
    assert_shown("helical", list(rows.values()))


def test_the_command_prints_them(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["reproduce", "helical", "--json"])
    assert ended.value.code == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["paper"] == helical.PAPER
    assert {row["status"] for row in printed["rows"]} == {"reproduced", "not reproduced", "not published"}
