"""Longer checks; CI runs them with ``-m slow``."""

import dataclasses
import runpy
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact import HardContact, equilibrium
from gearjax.reproduce import two_kv
from gearjax.units import arcmin, mm
from tests.conftest import ROOT
from tests.test_equilibrium import brute_force, contact_set

pytestmark = pytest.mark.slow


def test_the_figures_of_the_paper_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["two_kv_figures.py", str(tmp_path)])
    runpy.run_path(str(ROOT / "experiments" / "two_kv_figures.py"), run_name="__main__")
    names = sorted(path.stem for path in tmp_path.iterdir())
    assert names == [f"figure_{number:02d}" for number in (4, 5, 6, 7, 11, 12, 13)]


def test_many_equilibria_against_brute_force(rng):
    """Three pairs with back flanks: play, jams, both signs of the torque, five decades of stiffness."""
    solve = jax.jit(
        lambda drive, back, springs, load: equilibrium(contact_set(drive, back, springs), load, HardContact())
    )
    for _ in range(1000):
        drive, back = rng.uniform(-30e-6, 30e-6, 3), rng.uniform(-60e-6, 90e-6, 3)
        springs = 10 ** rng.uniform(5, 10, 6)
        torque = rng.choice([-1, 1]) * 10 ** rng.uniform(-2, 4)
        found = solve(drive, back, springs, jnp.asarray(-torque))
        expected = brute_force(contact_set(drive, back, springs), -torque)
        assert float(found.position) == pytest.approx(expected, rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_random_assemblies_against_the_adaptive_yardstick(scene, seed):
    """Random phases, masses, stiffness harmonics and torques: fixed steps of 40 us within 1e-3 arcmin."""
    rng = np.random.default_rng(seed)
    errors = {
        key: dataclasses.replace(error, phase=jnp.asarray(rng.uniform(-np.pi, np.pi)))
        for key, error in scene.errors.items()
    }
    compliance = gj.HarmonicStiffness(10 ** rng.uniform(7.6, 8.1), rng.uniform(-0.1, 0.1, 3), rng.uniform(0, 6, 3))
    changed = dataclasses.replace(
        scene, errors=errors, compliance=compliance, inertia=gj.EquivalentMass(rng.uniform(2.0, 20.0))
    )
    ts = jnp.linspace(0.0, 0.5, 501)
    torque = 10 ** rng.uniform(0.5, 2.7)
    fixed = gj.simulate(changed, ts, torque, settle=0.05)
    adaptive = gj.simulate(changed, ts, torque, settle=0.05, stepper=gj.AdaptiveStep(1e-10, 1e-10))
    assert float(abs(fixed.te - adaptive.te).max()) / arcmin < 1e-3


def test_jump_at_torque_reversal_is_the_backlash():
    """Fig. 7a: away from the reversals the output rests on an edge of the backlash, less the static deflection."""
    alternating = dataclasses.replace(
        two_kv.scene(stiffness=two_kv.DYNAMIC_STIFFNESS),
        load=gj.SinusoidalLoad("crank"),
        backlash=gj.InitialBacklash(0.2 * mm),
    )
    ts = jnp.linspace(0.0, 3.0, 6001)
    motion = gj.simulate(alternating, ts, 30.0, start="zero", stepper=gj.FixedStep(1e-5))
    theta = alternating.system.input_speed * ts
    shape = np.sin(np.asarray(alternating.system.orders["crank"] * theta))
    static = gj.transmission_error(alternating, theta, 30.0 * jnp.asarray(shape))
    quiet = (np.abs(shape) > 0.7) & (np.asarray(ts) > 0.1)
    late = quiet & np.roll(quiet, 100)  # 50 ms after the torque has grown
    assert late.sum() > 1500
    assert np.abs(np.asarray(motion.te - static.te))[late].max() / arcmin < 0.15


def test_the_mesh_frequency_motion_is_chaotic():
    """A start 1e-12 m away ends somewhere else: why gradients of such a motion are not promised."""
    alternating = dataclasses.replace(
        two_kv.scene(stiffness=two_kv.DYNAMIC_STIFFNESS),
        load=gj.SinusoidalLoad("mesh"),
        backlash=gj.InitialBacklash(0.2 * mm),
    )
    near = dataclasses.replace(alternating, backlash=gj.InitialBacklash(0.2 * mm + 1e-12))
    ts = jnp.linspace(0.0, 1.0, 2001)
    one, other = (gj.simulate(s, ts, 30.0, start="zero", stepper=gj.FixedStep(1e-5)) for s in (alternating, near))
    assert float(abs(one.te - other.te)[:100].max()) / arcmin < 1e-2
    assert float(abs(one.te - other.te)[1000:].max()) / arcmin > 1.0
