"""The motion of every gear set by the steps that are chosen for it, against short Runge-Kutta steps of one equation.

Steps that are chosen work with what changes slowly between their nodes. Whether it does is the gear set's affair.
"""

import dataclasses

import numpy as np
import pytest

import gearjax as gj
from tests.helical_pairs import GUO_1, TEETH, scene_of
from tests.test_matrix import KINDS, MOVES, TORQUE, Case

APART = 2e-3  # of the peak-to-peak


def off(scene: gj.Scene, duration: float, torque: float) -> float:
    """Largest deviation over the peak-to-peak."""
    ts = np.linspace(0.0, duration, 201)
    step = gj.chosen_steps(scene, ts, torque).step
    assert step is not None
    short = gj.FixedStep(step / 8, solver=gj.RungeKutta4())
    chosen, true = (np.asarray(gj.simulate(scene, ts, torque, stepper=stepper).te) for stepper in (None, short))
    return float(np.abs(chosen - true).max() / np.ptp(true))


@pytest.mark.slow
@pytest.mark.parametrize("gear_set", MOVES)
def test_the_output_alone(gear_set):
    assert off(Case(gear_set, *KINDS).moved, 0.05, TORQUE) < APART


@pytest.mark.slow
@pytest.mark.parametrize("gear_set", MOVES)
def test_bodies_on_supports(gear_set):
    scene = Case(gear_set, "amplitude").scene
    supports, inertia = (
        dict.fromkeys(scene.system.coordinates, part) for part in (gj.Support(x=2e8, y=3e8), gj.BodyInertia(0.5))
    )
    assert off(dataclasses.replace(scene, supports=supports, body_inertia=inertia), 0.01, TORQUE) < APART


@pytest.mark.slow
def test_a_helical_pair_as_one_contact():
    """And another program: an adaptive solver of diffrax."""
    relief = {"tip": gj.TipRelief("pinion", 20e-6, 8e-3), "crowning": gj.Crowning("pinion", 12e-6)}
    moving = {"load": gj.ConstantLoad(), "inertia": gj.MomentOfInertia(0.39), "damping": gj.DampingRatio(0.07)}
    whole = dataclasses.replace(scene_of(GUO_1, relief, TEETH, slices=8), **moving)
    scene = gj.one_contact(whole, 830.0).scene
    assert off(scene, 0.02, 830.0) < APART
    ts = np.linspace(0.0, 0.01, 101)
    steppers = (None, gj.AdaptiveStep())
    one, other = (np.asarray(gj.simulate(scene, ts, 830.0, stepper=stepper).te) for stepper in steppers)
    np.testing.assert_allclose(one, other, atol=APART * np.ptp(other))
