"""Studies of the RV reducer: motion, populations, compensation, and the paper's own numbers."""

import dataclasses
import json
import re
import runpy

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.cli import main
from gearjax.reproduce import PAPERS
from gearjax.units import arcmin, um
from tests.conftest import ROOT
from tests.rv import HERTZ, TORQUE, angles, scene
from tests.validation import assert_shown

MODIFICATIONS = [f"system.{name}_modification" for name in ("isometric", "shifting", "thickness")]
BOUNDS = dict.fromkeys(MODIFICATIONS, (-90e-6, 60e-6))


def start(**changes):
    return scene(with_errors=True, thickness_modification=0.0, **changes)


def clear_tips(scene):
    return scene.system.tip_clearance - 10 * um


@pytest.mark.slow
@pytest.mark.runs_long
def test_compensation_finds_what_the_study_found():
    theta = jnp.asarray(angles(39, 80))
    found = gj.compensate(
        start(),
        theta,
        TORQUE,
        MODIFICATIONS,
        bounds=BOUNDS,
        minimum_backlash=0.1 * arcmin,
        require_positive=[clear_tips],
    )
    assert found.holds
    assert found.lag_reduction == pytest.approx(0.155, abs=0.01)
    values = np.array([found.values[path] for path in MODIFICATIONS]) / um
    np.testing.assert_allclose(values, [0.9, -9.1, -4.2], atol=0.3)
    assert float(found.after.minimum_backlash[0]) == pytest.approx(0.1 * arcmin, rel=1e-3)


@pytest.mark.slow
@pytest.mark.runs_long
def test_compensation_of_the_swing_has_to_be_bounded_and_finds_the_valley_of_the_study():
    theta = jnp.asarray(angles(39, 80))
    with pytest.raises(gj.ParameterError, match="maximum_backlash"):
        gj.compensate(scene(), theta, TORQUE, MODIFICATIONS[:2], bounds={}, objective="peak_to_peak")
    found = gj.compensate(
        scene(with_errors=True),
        theta,
        -TORQUE,  # the study loads the pins behind the throw, as a torque that helps the output does
        MODIFICATIONS[:2],
        bounds={k: BOUNDS[k] for k in MODIFICATIONS[:2]},
        objective="peak_to_peak",
        minimum_backlash=0.1 * arcmin,
        maximum_backlash=0.6 * arcmin,
        starts=5,
    )
    assert found.holds
    assert float(found.after.peak_to_peak[0]) / arcmin == pytest.approx(0.0227, abs=4e-4)


@pytest.mark.slow
@pytest.mark.runs_long
def test_robust_compensation_holds_under_every_set_of_errors(rng):
    drawn = runpy.run_path(str(ROOT / "experiments" / "rv_compensation.py"))["drawn"]
    sets = [drawn(rng, 0.5) for _ in range(24)]
    found = gj.compensate(
        start(),
        jnp.asarray(angles(1, 80)),
        TORQUE,
        MODIFICATIONS,
        bounds=BOUNDS,
        error_sets=sets,
        minimum_backlash=0.1 * arcmin,
        require_positive=[clear_tips],
    )
    assert found.holds
    assert not found.interferes
    assert found.lag_reduction > 0.14
    assert bool((found.after.minimum_backlash >= 0.1 * arcmin).all())
    play = gj.backlash(dataclasses.replace(found.scene, errors=sets[7]), jnp.asarray(angles(1, 80)))
    assert float(play.extremes.minimum) == pytest.approx(float(found.after.minimum_backlash[7]), rel=1e-9)


@pytest.mark.slow
def test_what_cannot_hold_is_said_and_interference_is_flagged():
    narrow = dict.fromkeys(MODIFICATIONS[:2], (-23e-6, -21e-6)) | {MODIFICATIONS[1]: (-27e-6, -26e-6)}
    found = gj.compensate(
        scene("modified"),
        jnp.asarray(angles(1, 80)),
        TORQUE,
        MODIFICATIONS[:2],
        bounds=narrow,
        minimum_backlash=0.1 * arcmin,
        maximum_pressure=1e8,
        law=HERTZ,
    )
    assert found.interferes
    assert not found.holds
    assert len(found.complaints) == 3
    assert "backlash below" in found.complaints[0]
    assert "pressure above 1e+08 Pa" in found.complaints[1]
    assert re.fullmatch(
        r"interference under 1 of 1 sets: rigid bodies overlap by up to [\d.]+ um "
        r"\(pin \d+ on disc_[12], input angle [\d.]+ deg\)",
        found.complaints[2],
    )


@pytest.mark.slow
def test_a_turn_of_the_crank_in_motion():
    one = gj.load("configs/rv_cycloidal/hu_2020.toml")
    motion = gj.simulate(one, one.run.times, TORQUE)
    exact = gj.simulate(one, one.run.times, TORQUE, stepper=gj.AdaptiveStep(rtol=1e-9, atol=1e-12))
    assert float(jnp.abs(motion.te - exact.te).max()) * 58.5e-3 < 1e-8
    static = gj.transmission_error(one, one.run.times * one.system.input_speed, TORQUE)
    assert float(motion.mean) == pytest.approx(float(static.mean), rel=1e-3)


@pytest.mark.slow
def test_reproduce_prints_valid_json(capsys, monkeypatch):
    paper, kept = PAPERS["rv_cycloidal"], []
    monkeypatch.setitem(PAPERS, "rv_cycloidal", paper._replace(rows=lambda say: kept.extend(paper.rows(say)) or kept))
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "rv_cycloidal", "--json"])
    printed = json.loads(capsys.readouterr().out)
    rows = {row["item"]: row for row in printed["rows"]}
    assert sum(row["status"] == "reproduced" for row in rows.values()) >= 15
    assert sum(row["status"] in ("reproduced", "inferred") for row in rows.values()) >= 40
    assert rows["Table 2, sensitivity index of pin_position"]["status"] == "reproduced"
    final = next(row for item, row in rows.items() if item.startswith("Table 7, final force ("))
    assert final["status"] == "inferred"
    assert final["computed"] == pytest.approx(1435.9, rel=1e-3)
    initial = next(row for item, row in rows.items() if item.startswith("Table 4, final force ("))
    assert initial["status"] == "not reproduced"
    assert initial["computed"] / 1910.3 - 1 == pytest.approx(-0.036, abs=1e-3)
    assert rows["text, elastic share of the TE"]["computed"] == pytest.approx(16.07, abs=0.005)
    assert rows["Fig. 9, TE of the initial prototype"]["computed"] is None
    assert all(row["status"] == "inferred" for item, row in rows.items() if ", pin " in item)
    assert_shown("rv_cycloidal", kept)
