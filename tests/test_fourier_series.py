"""The Fourier series shortcut of Guo and Fang (2018): where it is right, and the sidebands that it makes up."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import um

TORQUE = 113.0


def pair(*amplitudes: float, damping: float = 0.1) -> gj.Scene:
    """A 2K-V without errors: its stiffness alternates by some shares of the mean, so that all teeth stay in contact."""
    scene = gj.load("configs/two_kv/wang_2020.toml")
    teeth = gj.HarmonicStiffness(1e8, list(amplitudes) or [0.0], [0.0] * max(len(amplitudes), 1))
    parts = {"errors": {}, "reference": None, "inertia": gj.EquivalentMass(3.0), "compliance": teeth}
    return dataclasses.replace(scene, **parts, damping=gj.DampingRatio(damping))


def period_of(scene: gj.Scene) -> float:
    return 2 * math.pi / (float(scene.system.input_speed) * scene.system.orders["mesh"])


def test_with_constant_stiffness_it_is_harmonic_balance():
    run_out = gj.Eccentricity("planet_1", 2 * um, 0.3)
    scene = dataclasses.replace(pair(), errors={"planet_1": run_out})
    period = scene.system.cycle / float(scene.system.input_speed)
    one = gj.fourier_series(scene, TORQUE, period, harmonics=40)
    other = gj.harmonic_balance(scene, TORQUE, period, harmonics=40)
    assert int(one.result) == 0
    np.testing.assert_allclose(one.te, other.te, rtol=0, atol=1e-9 * float(jnp.abs(other.te).max()))
    np.testing.assert_allclose(one.velocity, other.velocity, rtol=0, atol=1e-9 * float(jnp.abs(other.velocity).max()))


def test_its_error_is_of_second_order_in_the_alternating_stiffness():
    """Half the alternating part: a quarter of the error, and of the residual that tells it."""
    off, rest = [], []
    for share in (0.04, 0.02, 0.01):
        scene = pair(share)
        one = gj.fourier_series(scene, TORQUE, period_of(scene), harmonics=8)
        other = gj.harmonic_balance(scene, TORQUE, period_of(scene), harmonics=8)
        off.append(float(jnp.abs(one.te - other.te).max()))
        rest.append(float(one.residual))
        assert int(one.result) == int(float(one.residual) > 1e-6)
    np.testing.assert_allclose([off[0] / off[1], off[1] / off[2]], 4.0, rtol=0.1)
    np.testing.assert_allclose([rest[0] / rest[1], rest[1] / rest[2]], 4.0, rtol=0.1)


def test_gradients_are_those_of_differences_under_jit_and_vmap():
    scene = pair(0.08)

    def swing(share, torque):
        teeth = dataclasses.replace(scene.compliance, relative_amplitudes=share[None])
        found = gj.fourier_series(dataclasses.replace(scene, compliance=teeth), torque, period_of(scene), harmonics=4)
        return found.te.std()

    shares, torques, step = jnp.array([0.05, 0.08]), jnp.array([90.0, 120.0]), 1e-5
    by_share, by_torque = jax.jit(jax.vmap(jax.grad(swing, (0, 1))))(shares, torques)
    for i in range(2):
        ahead, behind = (swing(shares[i] + d, torques[i]) for d in (step, -step))
        assert by_share[i] == pytest.approx(float(ahead - behind) / (2 * step), rel=1e-6)
        ahead, behind = (swing(shares[i], torques[i] + d) for d in (1e3 * step, -1e3 * step))
        assert by_torque[i] == pytest.approx(float(ahead - behind) / (2e3 * step), rel=1e-6)


@pytest.fixture(scope="module")
def guo():
    """Table 1 with run-outs and a stiffness in proportion to the length of the contact lines."""
    scene = gj.load("configs/helical/guo_2018.toml")
    errors = {name: scene.errors[name] for name in ("pinion", "wheel")}
    parts = {"reference": None, "run": None, "inertia": gj.MomentOfInertia(0.66), "damping": gj.DampingRatio(0.07)}
    return dataclasses.replace(scene, errors=errors, compliance=gj.LineStiffness(1e10), **parts)


@pytest.mark.slow
def test_the_sidebands_of_the_paper_are_made_up(guo):
    """1.083 and 1.444 um by an independent program (linear length, 50.8 rpm); with the pair's own deflection none."""
    meshes = 893
    period = guo.system.cycle / float(guo.system.input_speed)
    options = {"harmonics": 4 * meshes, "samples": 16 * meshes}
    places = [meshes - 47, meshes - 19, meshes + 19, meshes + 47]
    radius = float(guo.system.pair.gears[1].base_radius)
    heights = []
    for static in (dataclasses.replace(guo, errors={}), None):
        te = np.asarray(gj.fourier_series(guo, 830.0, period, static=static, **options).te)
        heights.append(np.abs(np.fft.rfft(te))[places] * 2 / te.size * radius / um)
    np.testing.assert_allclose(heights[0], [1.083, 1.444, 1.444, 1.083], rtol=2e-3)
    assert heights[1].max() < 1e-3


@pytest.mark.slow
def test_a_loaded_error_beside_a_varying_stiffness_counts_twice(guo):
    """What the paper does: the mesh order doubles."""
    alone = dataclasses.replace(guo, errors={})
    reduced = gj.one_contact(alone, 830.0, harmonics=16)
    own = reduced.scene.system
    loaded = reduced.static(830.0)  # the static TE under load, as a gap beside the same stiffness
    waves = type(own.gaps[0]).of(-own.lever * loaded, 16)
    twice = dataclasses.replace(reduced.scene, system=dataclasses.replace(own, gaps=(waves,)))
    slow = (
        dataclasses.replace(twice.system, input_speed=jnp.asarray(0.1)),
        dataclasses.replace(own, input_speed=jnp.asarray(0.1)),
    )
    swings = [
        float(gj.harmonic_balance(dataclasses.replace(reduced.scene, system=system), 830.0, own.period / 0.1).std)
        for system in slow
    ]
    assert swings[0] / swings[1] == pytest.approx(2.0, rel=0.02)


def test_other_contacts_are_refused():
    scene = pair(0.08)
    with pytest.raises(gj.SceneError, match="static must have the contacts"):
        gj.fourier_series(scene, TORQUE, period_of(scene), static=dataclasses.replace(scene, backlash=None))
    with pytest.raises(gj.SceneError, match="no static equilibrium under this torque"):
        gj.fourier_series(dataclasses.replace(scene, backlash=None), -TORQUE, period_of(scene))
    with pytest.raises(gj.SceneError, match="needs at least 2 harmonics"):
        gj.fourier_series(scene, TORQUE, period_of(scene), harmonics=8, samples=9)
