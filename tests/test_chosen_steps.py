"""What is chosen for a motion, and why."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from tests.conftest import ROOT
from tests.test_modes import planets
from tests.test_uneven import lobed

LONG, SHORT = np.linspace(0.0, 3.0, 3001), np.linspace(0.0, 0.02, 21)


@pytest.mark.parametrize(
    ("change", "ts", "stepper", "scheme", "reason"),
    [
        ({}, LONG, None, "fitted march in windows", "the record is long"),
        ({}, SHORT, None, "fitted march", "the record is short"),
        ({"damping": None}, LONG, None, "fitted march", "undamped"),
        ({"load": gj.SinusoidalLoad("mesh")}, LONG, None, "fitted march", "the load changes"),
        ({}, SHORT**2, None, "RungeKutta4", "not evenly spaced"),
        ({}, SHORT, gj.FixedStep(1e-5, solver=gj.RungeKutta4()), "RungeKutta4", "was given"),
        ({}, SHORT, gj.AdaptiveStep(), "AdaptiveStep", "was given"),
        ({}, SHORT, gj.QuasiStatic(), "QuasiStatic", "was given"),
    ],
)
def test_what_is_chosen_and_why(scene, change, ts, stepper, scheme, reason):
    found = gj.chosen_steps(dataclasses.replace(scene, **change), ts, 100.0, stepper=stepper)
    assert found.scheme == scheme
    assert reason in found.reason
    assert (found.windows > 1) == ("windows" in scheme)
    assert (found.step is None) == (scheme in ("AdaptiveStep", "QuasiStatic"))
    if found.step is not None:
        assert 0 < found.step <= np.diff(ts).max()


def damped_pins():
    """An RV reducer whose record is long beside what damps it, as `gearjax new rv_cycloidal` has it."""
    waves = gj.HarmonicStiffness(9.2e7, np.array([0.1]), np.array([np.pi / 2]))
    parts = {"compliance": waves, "inertia": gj.EquivalentMass(3.0), "damping": gj.DampingRatio(0.1)}
    return dataclasses.replace(gj.load(ROOT / "configs" / "rv_cycloidal" / "hu_2020.toml"), **parts)


def test_levers_that_turn_have_no_windows():
    """Their march took two minutes to compile."""
    found = gj.chosen_steps(damped_pins(), LONG, 100.0)
    assert (found.scheme, found.windows) == ("constant modes", 1)


@pytest.mark.slow
def test_levers_that_turn_move_as_by_short_steps_of_another_scheme():
    one, ts = damped_pins(), np.linspace(0.0, 0.02, 201)
    exact = gj.simulate(one, ts, 100.0, stepper=gj.FixedStep(5e-7, solver=gj.RungeKutta4()))
    chosen = gj.simulate(one, ts, 100.0)
    assert float(abs(chosen.te - exact.te).max()) < 1e-4 * float(exact.te.max() - exact.te.min())


@pytest.mark.slow
def test_more_coordinates():
    many = gj.chosen_steps(planets(), SHORT, 100.0)
    assert many.scheme == "constant modes"
    assert "planet_1.x" in many.reason


@pytest.mark.slow
def test_an_output_that_turns_unevenly_moves_in_windows_as_in_one_go():
    """The torque that accelerates it follows the angle as gaps do, and not the steps as a load that alternates."""
    chosen = gj.chosen_steps(lobed(), LONG, 10.0)
    assert chosen.scheme == "fitted march in windows"
    cut, whole = (gj.simulate(lobed(), LONG, 10.0, stepper=way) for way in (None, gj.FixedStep(chosen.step)))
    swing = float(jnp.ptp(whole.te))
    assert swing > 1e-6
    assert float(jnp.abs(cut.te - whole.te).max()) < 1e-6 * swing


def test_what_cannot_be_chosen_is_refused(scene):
    with pytest.raises(gj.SceneError, match=r"needs \[inertia\]"):
        gj.chosen_steps(dataclasses.replace(scene, inertia=None), SHORT, 100.0)
    with pytest.raises(gj.SceneError, match="QuasiStatic"):
        gj.chosen_steps(planets(), SHORT, 100.0, stepper=gj.QuasiStatic())
