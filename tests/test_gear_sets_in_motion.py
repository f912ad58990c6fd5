"""The motion of every gear set by the steps that are chosen for it, against short Runge-Kutta steps of one equation.

Steps that are chosen work with what changes slowly between their nodes. Whether it does is the gear set's affair.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.studies.select import pick
from gearjax.units import arcmin
from tests.helical_pairs import GUO_1, TEETH, scene_of
from tests.test_matrix import KINDS, MOVES, TORQUE, Case, on_supports

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
    assert off(Case(gear_set, *KINDS).moved, 0.03, TORQUE) < APART


@pytest.mark.slow
@pytest.mark.parametrize("gear_set", MOVES)
def test_bodies_on_supports(gear_set):
    assert off(on_supports(Case(gear_set, "amplitude").scene), 0.005, TORQUE) < APART


@pytest.mark.slow
@pytest.mark.parametrize("gear_set", [name for name in MOVES if name != "two_kv"])  # which tests/test_gradients.py has
def test_gradients_in_reverse_are_differences(gear_set):
    """Of the standard deviation, by a phase, an amplitude, an element and a number of the system.

    Contacts are smoothed: dampers that engage at once put kinks into the curve that differences cross.
    """
    case = Case(gear_set, *KINDS)
    smooth = dataclasses.replace(case.scene, contact=gj.QuadraticContact(1e-6))
    place = pick(case.scene, case.where)
    sizes = jnp.asarray([number.step for number in case.numbers])
    start = jnp.asarray([number.ends[0] + 0.3 * number.step for number in case.numbers])
    ts = np.linspace(0.0, 0.05, 51)

    def std(change: jax.Array) -> jax.Array:
        return gj.simulate(place.set(smooth, start + sizes * change), ts, TORQUE).std / arcmin

    slope = jax.jit(jax.grad(std))(jnp.zeros(len(KINDS)))
    sides = jax.jit(jax.vmap(std))(jnp.concatenate([1e-4 * jnp.eye(len(KINDS)), -1e-4 * jnp.eye(len(KINDS))]))
    differences = (sides[: len(KINDS)] - sides[len(KINDS) :]) / 2e-4
    assert np.abs(differences).max() > 0
    np.testing.assert_allclose(slope, differences, rtol=1e-4, atol=2e-5 * np.abs(differences).max())


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
