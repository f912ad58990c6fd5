"""Remarks on motions whose teeth separate: told where half the steps change the curve, and only there."""

import dataclasses

import numpy as np
import pytest

import gearjax as gj
from gearjax.results import run_cases, separation_remark
from tests.conftest import CONFIG, ROOT


def remark(scene: gj.Scene, **changes) -> tuple[str | None, list[str]]:
    """What is said of the motion of a scene, and what is told meanwhile."""
    assert scene.run is not None
    run = dataclasses.replace(scene.run, analyses=("dynamic",), published=(), **changes)
    scene, told = dataclasses.replace(scene, run=run), []
    (case,) = run_cases(scene)
    return separation_remark(scene, case, told.append), told


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.UnclosedRecord", "ignore:neighbouring time windows")
def test_steps_that_are_too_coarse_for_impacts_are_told():
    """An oval pair that starts from rest and bounces; its steps are indeed off by per cents."""
    scene = gj.load(ROOT / "configs" / "elliptic" / "dong_2020.toml")
    scene = dataclasses.replace(scene, backlash=gj.InitialBacklash(200e-6))
    words, told = remark(scene, torques=(3.0,), start="zero", settle=0.0)
    assert words is not None
    assert "half the steps change the curve" in words
    assert len(told) == 1
    ts = scene.run.times
    step = gj.chosen_steps(scene, ts, 3.0).step
    steppers = gj.FixedStep(step), gj.FixedStep(step / 16, solver=gj.RungeKutta4())
    own, true = (np.asarray(gj.simulate(scene, ts, 3.0, start="zero", stepper=each).te) for each in steppers)
    assert np.abs(own - true).max() > 0.01 * np.ptp(true)


@pytest.mark.slow
def test_teeth_that_stay_together_are_not_tried_again():
    words, told = remark(gj.load(CONFIG), torques=(100.0,))
    assert words is None
    assert told == []
