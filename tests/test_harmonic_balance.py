"""Harmonic balance with many coefficients, without a matrix: against the matrix, short steps and differences."""

import dataclasses
import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.geometry.waves import Waves
from gearjax.units import arcmin
from tests.conftest import CONFIG

TORQUE = 300.0


@pytest.fixture
def scene():
    whole = gj.load(CONFIG)
    return dataclasses.replace(whole, backlash=None, load=gj.ConstantLoad(), run=None)


def period_of(scene, meshes):
    return meshes * 2 * np.pi / float(scene.system.orders["mesh"] * scene.system.input_speed)


@pytest.fixture
def no_matrix(monkeypatch):
    """Newton's method without a matrix, however few the unknowns are."""
    jax.clear_caches()
    monkeypatch.setattr(importlib.import_module("gearjax.analysis.harmonic_balance"), "MATRIX", 10)
    yield
    jax.clear_caches()


@pytest.mark.slow
def test_a_whole_cycle_is_that_of_short_steps(scene):
    """1,300 meshes, 10,399 harmonics: no matrix of this size would fit."""
    meshes = round(scene.system.cycle / (2 * np.pi) * scene.system.orders["mesh"])
    assert meshes == 1300
    period = period_of(scene, meshes)
    found = gj.harmonic_balance(scene, TORQUE, period, harmonics=8 * meshes - 1, samples=16 * meshes)
    assert int(found.result) == 0
    assert float(found.residual) < 1e-10
    ts = np.arange(meshes * 8) * period / meshes / 8
    off = []
    for steps in (64, 128):
        short = gj.simulate(scene, ts, TORQUE, stepper=gj.FixedStep(per_sample=steps))
        later = slice(meshes * 4, None)  # what the start made has died out
        off.append(np.abs(np.asarray(short.te)[later] - np.asarray(found.te)[::2][later]).max() / arcmin)
    assert off[1] < 3e-6
    assert off[1] < off[0] / 3  # the steps close in on it, by the square of their length


@pytest.mark.slow
def test_without_a_matrix_it_is_the_same(scene, request):
    period = period_of(scene, 12)
    scene = dataclasses.replace(scene, errors={})
    by_matrix = gj.harmonic_balance(scene, TORQUE, period, harmonics=60, samples=240)
    request.getfixturevalue("no_matrix")
    without = gj.harmonic_balance(scene, TORQUE, period, harmonics=60, samples=240)
    assert int(by_matrix.result) == int(without.result) == 0
    swing = float(by_matrix.peak_to_peak)
    np.testing.assert_allclose(without.te, by_matrix.te, rtol=0, atol=1e-9 * swing)
    np.testing.assert_allclose(
        without.start, by_matrix.start, rtol=0, atol=1e-7 * float(jnp.abs(by_matrix.start).max())
    )


@pytest.mark.slow
@pytest.mark.usefixtures("no_matrix")
def test_gradients_without_a_matrix_are_differences_under_jit_and_vmap(scene):
    period = period_of(scene, 3)

    def swing(numbers):
        stiffness = dataclasses.replace(scene.compliance, mean=scene.compliance.mean * numbers[1])
        damping = dataclasses.replace(scene.damping, ratio=scene.damping.ratio * numbers[2])
        moved = dataclasses.replace(scene, errors={}, compliance=stiffness, damping=damping)
        return 1e4 * gj.harmonic_balance(moved, TORQUE * numbers[0], period, harmonics=24, samples=96).std

    at = jnp.array([[1.0, 1.0, 1.0], [0.8, 1.1, 1.3]])
    reverse, forward = (jax.jit(jax.vmap(slope(swing)))(at) for slope in (jax.grad, jax.jacfwd))
    step = 1e-5
    moves = jnp.stack([side * step * unit for side in (1, -1) for unit in jnp.eye(3)])
    values = np.asarray(jax.jit(jax.vmap(jax.vmap(swing)))(at[:, None] + moves[None]))
    wanted = (values[:, :3] - values[:, 3:]) / (2 * step)
    np.testing.assert_allclose(reverse, wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())
    np.testing.assert_allclose(forward, reverse, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("number", [1, 64, 65, 100, 1000])
def test_waves_are_the_sum_of_their_harmonics(number):
    draws = np.random.default_rng(number)
    cosine, sine = draws.normal(size=(2, number)) / np.arange(1, number + 1)
    angle = draws.uniform(-9.0, 9.0, 50)
    turned = angle[:, None] * np.arange(1, number + 1)[None]
    wanted = 0.3 + np.cos(turned) @ cosine + np.sin(turned) @ sine
    waves = Waves(jnp.asarray(0.3), jnp.asarray(cosine), jnp.asarray(sine))
    slope = (np.arange(1, number + 1) * (np.cos(turned) * sine - np.sin(turned) * cosine)).sum(axis=1)
    for curve in (waves, waves.tabulated()):
        values, slopes = jax.jvp(curve.at, (jnp.asarray(angle),), (jnp.ones(50),))
        np.testing.assert_allclose(values, wanted, atol=1e-12)
        np.testing.assert_allclose(slopes, slope, atol=2e-13 * number)
    assert (waves.tabulated().table is None) == (number <= 64)
    by_amplitude = jax.jit(jax.jacrev(lambda cosine: Waves(waves.mean, cosine, waves.sine).at(jnp.asarray(angle[:3]))))
    np.testing.assert_allclose(by_amplitude(waves.cosine), np.cos(turned[:3]), atol=1e-12)
    single = jax.tree.map(lambda part: part.astype(jnp.float32), waves)
    narrow = single.at(jnp.asarray(angle / 9, jnp.float32))
    turned = np.float32(angle / 9)[:, None] * np.arange(1.0, number + 1)[None]
    exact = 0.3 + np.cos(turned) @ cosine + np.sin(turned) @ sine
    np.testing.assert_allclose(narrow, exact, atol=4e-7 * number)


@pytest.mark.slow
def test_a_reduction_with_many_harmonics_moves(scene):
    """The fitted march writes out harmonic by harmonic: for thousands of them it never compiled."""
    own = dataclasses.replace(scene, errors={"planet": scene.errors["planet_1"]}, reference=None)
    period = 2 * np.pi / scene.system.orders["planet"]
    few, many = (
        gj.one_contact(own, 100.0, period=period, samples=1024, harmonics=number).scene for number in (90, 130)
    )
    ts = np.linspace(0.0, 0.5, 201)
    chosen = gj.chosen_steps(many, ts, 100.0)
    assert (chosen.scheme, chosen.reason) == ("constant modes", "the stiffness has many waves")
    assert gj.chosen_steps(few, ts, 100.0).scheme.startswith("fitted march")
    first, second = (gj.simulate(reduced, ts, 100.0).te for reduced in (few, many))
    assert float(jnp.abs(first - second).max()) < 1e-3 * float(jnp.ptp(first))


@pytest.mark.slow
def test_single_precision(scene):
    """It ends when rounding is reached, not after all steps, and agrees to a part in 10,000 of the swing."""
    scene = dataclasses.replace(scene, errors={})
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    wide, narrow = (
        gj.harmonic_balance(one, TORQUE, period_of(scene, 1), harmonics=8, max_steps=12) for one in (scene, single)
    )
    assert narrow.te.dtype == jnp.float32
    assert int(narrow.result) == 0
    np.testing.assert_allclose(narrow.te, wide.te, rtol=0, atol=1e-4 * float(wide.peak_to_peak))
