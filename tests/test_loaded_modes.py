"""Natural modes of the contacts that carry: by the equilibrium, whatever candidates or flanks a scene lists."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from tests.test_matrix import ROOT


def involute(pairs: int, **parts) -> gj.Scene:
    """Two external gears with one stiffness for each pair of teeth."""
    scene = gj.load(ROOT / "configs/involute_rv/yang_2019.toml")
    system = dataclasses.replace(scene.system, gears=2, pairs=pairs, profile_points=1)
    given = {
        "compliance": gj.HarmonicStiffness(5e7, [], []),
        "inertia": gj.MomentOfInertia(0.02),
        "damping": gj.DampingRatio(0.05),
        "load": gj.ConstantLoad(),
    }
    return dataclasses.replace(scene, system=system, **(given | parts))


def closed(scene: gj.Scene, torque: float) -> np.ndarray:
    """Levers of the contacts that carry at input angle 0, by bisection of the sum of their torques."""
    contacts = scene.contacts(0.0, "mean")
    lever, gap, stiffness = (np.asarray(part) for part in (contacts.lever, contacts.gap, contacts.linear))
    low, high = -1e-2, 1e-2
    for _ in range(200):
        middle = 0.5 * (low + high)
        force = stiffness * np.maximum(lever * middle - gap, 0)
        low, high = (low, middle) if torque + (lever * force).sum() > 0 else (middle, high)
    return lever[lever * low - gap > 0]


@pytest.mark.slow
@pytest.mark.parametrize("torque", [20.0, 60.0, -20.0])
def test_the_number_of_candidates_does_not_matter(torque):
    found = [gj.natural_modes(involute(pairs), torque) for pairs in (9, 11, 15)]
    scene = involute(11)
    lever = closed(scene, torque)
    assert 1 < len(lever) < 18
    rate = np.sqrt((5e7 * lever**2).sum() / 0.02)
    all_levers = np.asarray(scene.contacts(0.0).lever)
    drag = 0.05 * np.sqrt(2 * 5e7 * 0.02 / (all_levers**2).mean())
    for modes in found:
        np.testing.assert_allclose(modes.frequencies, [rate / (2 * np.pi)], rtol=1e-9)
        np.testing.assert_allclose(modes.damping, [(drag * lever**2).sum() / (2 * rate * 0.02)], rtol=1e-3)


def test_back_flanks_are_not_damped_while_driving_ones_carry():
    bare = involute(7, backlash=None)
    np.testing.assert_allclose(
        gj.natural_modes(bare, 20.0).damping, gj.natural_modes(involute(7), 20.0).damping, rtol=1e-6
    )


def on_bearings(scene: gj.Scene) -> gj.Scene:
    """A 2K-V whose planet wheels have supports; its mirror image has the same modes."""
    held = {name: gj.Support(x=2e8, y=2e8) for name in ("planet_1", "planet_2")}
    mass = {name: gj.BodyInertia(0.8) for name in held}
    return dataclasses.replace(scene, errors={}, reference=None, supports=held, body_inertia=mass)


def test_dampers_act_along_the_flanks_that_carry(scene):
    """The damper of a back flank, along the driving flank before, damped modes up to five times too much."""
    modes = [gj.natural_modes(on_bearings(scene), torque) for torque in (100.0, -100.0)]
    np.testing.assert_allclose(modes[1].frequencies, modes[0].frequencies, rtol=1e-9)
    np.testing.assert_allclose(modes[1].damping, modes[0].damping, rtol=1e-9, atol=1e-12)
    held = dataclasses.replace(on_bearings(scene), contact=gj.SoftplusContact(1e-6))
    np.testing.assert_allclose(gj.natural_modes(held, 100.0).damping, modes[0].damping, rtol=1e-9, atol=1e-12)


def test_a_wheel_without_load_does_not_hold(scene):
    """With an eccentricity of .1 mm one planet wheel carries a small torque alone."""
    far = dataclasses.replace(scene.errors["planet_1"], amplitude=jnp.asarray(1e-4))
    apart = dataclasses.replace(scene, errors={"planet_1": far}, reference=None)
    small, large = (float(gj.natural_modes(apart, torque).frequencies[0]) for torque in (1.0, 1e5))
    assert large / small == pytest.approx(np.sqrt(2), rel=1e-9)
    touching = float(gj.natural_modes(apart, 0.0).frequencies[0])
    assert touching == pytest.approx(small, rel=1e-9)


def test_an_unstable_structure_is_refused_by_name(scene):
    heavy = {name: gj.BodyInertia(1e6 if name == "planet_1" else 0.8) for name in ("planet_1", "planet_2")}
    fast = dataclasses.replace(scene.system, input_speed=jnp.asarray(300.0))
    loose = dataclasses.replace(on_bearings(scene), body_inertia=heavy, system=fast)
    with pytest.raises(gj.SceneError, match=r"unstable in planet_1\.[xy]: centrifugal forces|no static equilibrium"):
        gj.natural_modes(loose, 100.0)
