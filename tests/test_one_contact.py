"""A gear set as one contact: exact where one contact is all there is, and how far off where it is not."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import ParameterError, SceneError
from gearjax.units import arcmin, um
from tests.conftest import CONFIG, ROOT

TORQUE = 300.0
WHOLE = {"samples": 600, "harmonics": 150}  # the run-outs of the 2K-V have few orders per cycle


@pytest.fixture(scope="module")
def wang() -> gj.Scene:
    """The example, whose pairs are springs of one stiffness each that never part under 300 N m."""
    scene = gj.load(CONFIG)
    assert scene.damping is not None
    stiff = gj.HarmonicStiffness(9e7, jnp.zeros(0), jnp.zeros(0))
    return dataclasses.replace(scene, compliance=stiff, load=gj.ConstantLoad(), backlash=None)


@pytest.fixture(scope="module")
def yang() -> gj.Scene:
    scene = gj.load(ROOT / "configs" / "involute_rv" / "yang_2019.toml")
    own = dataclasses.replace(scene.system, pairs=9, profile_points=3)
    return dataclasses.replace(scene, system=own, errors={})


@pytest.mark.slow
def test_springs_that_all_carry_are_one_at_any_torque(wang):
    reduced = gj.one_contact(wang, TORQUE, period=wang.system.cycle, **WHOLE)
    assert float(reduced.error(TORQUE)) < 1e-12 * arcmin
    assert float(reduced.error(1.3 * TORQUE)) < 1e-12 * arcmin
    assert float(reduced.error(100.0)) > 0.1 * arcmin  # a pair parts there: the reduction is told to be off


@pytest.mark.slow
def test_the_motion_of_springs_that_all_carry_is_that_of_one(wang):
    reduced = gj.one_contact(wang, TORQUE, period=wang.system.cycle, **WHOLE)
    ts = jnp.linspace(0.0, 0.02, 41)
    exact = {"start": "zero", "stepper": gj.AdaptiveStep(1e-10, 1e-10)}
    whole, one = (gj.simulate(scene, ts, TORQUE, **exact).te for scene in (wang, reduced.scene))
    assert float(jnp.ptp(whole)) > 0.1 * arcmin
    np.testing.assert_allclose(one, whole, atol=1e-8 * arcmin)


@pytest.mark.slow
def test_the_loaded_involute_pair_as_one_contact(yang):
    """Stiffness as by differences of the loaded TE, the position held, and told how far off at other torques."""
    reduced = gj.one_contact(yang, 100.0, samples=32, harmonics=15)
    assert reduced.scene.system.kind == "one_contact"
    travel = float(jnp.ptp(reduced.static(100.0)))
    assert float(reduced.error(100.0)) < 0.1 * travel  # what 15 harmonics leave out
    te = [gj.transmission_error(yang, reduced.theta, torque=load).te for load in (99.9, 100.1)]
    rate = 0.2 / (te[0] - te[1])
    one = reduced.scene
    phase = one.system.orders["mesh"] * reduced.theta
    np.testing.assert_allclose(one.compliance.stiffness(phase) * one.system.lever**2, rate, rtol=0.02)
    lag = -float(reduced.static(100.0).mean())
    for share, bound in ((0.8, 0.03), (1.2, 0.03), (0.5, 0.15)):  # of the lag
        assert 1e-3 * lag < float(reduced.error(share * 100.0)) < bound * lag


@pytest.mark.slow
def test_a_slow_motion_of_one_contact_is_the_loaded_error(yang):
    """Coupled springs are refused in motion; their one contact moves, and at a crawl it is where they rest."""
    slow = dataclasses.replace(yang.system, input_speed=0.02)
    whole = dataclasses.replace(yang, system=slow, load=gj.ConstantLoad(), damping=gj.DampingRatio(0.1))
    whole = dataclasses.replace(whole, inertia=gj.MomentOfInertia(1e-3))
    reduced = gj.one_contact(whole, 100.0, samples=32, harmonics=6)
    ts = reduced.theta / 0.02
    with pytest.raises(SceneError):
        gj.simulate(whole, ts, 100.0)
    moved = gj.simulate(reduced.scene, ts, 100.0).te
    one = reduced.static(100.0)
    np.testing.assert_allclose(moved, one, atol=1e-3 * float(jnp.ptp(one)))
    rest = gj.transmission_error(whole, reduced.theta, torque=100.0).te
    np.testing.assert_allclose(moved, rest, atol=1.01 * float(reduced.error(100.0)))
    assert float(reduced.error(100.0)) < 0.2 * float(jnp.ptp(rest))


@pytest.mark.slow
def test_the_back_flank_holds_the_torque_reversed(yang):
    reduced = gj.one_contact(yang, 100.0, samples=32, harmonics=15)
    back = gj.transmission_error(reduced.scene, reduced.theta, torque=-100.0).te
    whole = gj.transmission_error(yang, reduced.theta, torque=-100.0).te
    assert float(whole.mean()) > 0
    np.testing.assert_allclose(back, whole, atol=0.01 * float(whole.mean()))


@pytest.mark.slow
def test_gradients_are_those_of_differences(yang):
    """Of stiffness and gap, with respect to relief, modulus and torque, under jit."""
    at = jnp.asarray([1.0 * um, 2.06e11, 100.0])

    def made(numbers):
        relief, modulus, torque = numbers
        whole = dataclasses.replace(
            yang,
            errors={"relief": gj.TipRelief(body="gear_1", amount=relief[None], length=0.2e-3)},
            compliance=dataclasses.replace(yang.compliance, youngs_modulus=modulus),
        )
        one = gj.one_contact(whole, torque, samples=8, harmonics=3).scene
        return jnp.stack(
            [one.compliance.waves.mean, one.system.gaps[0].mean * 1e12, one.system.gaps[0].cosine[0] * 1e12]
        )

    value = jax.jit(made)
    slopes = jax.jit(jax.jacrev(made))(at)
    for column, step in enumerate([1e-10, 1e6, 1e-3]):
        way = np.zeros(3)
        way[column] = step
        difference = (value(at + way) - value(at - way)) / (2 * step)
        np.testing.assert_allclose(slopes[:, column], difference, rtol=1e-5)


def test_an_error_that_looks_periodic_at_one_angle_is_refused():
    """The run-out of the pinion has the same value at both ends of one mesh, and changes in between."""
    scene = gj.load(ROOT / "configs" / "helical" / "guo_2018.toml")
    scene = dataclasses.replace(scene, errors={"runout": gj.Eccentricity("pinion", 30e-6, np.radians(60.2476))})
    with pytest.raises(SceneError, match=r"repeat after scene\.system\.cycle"):
        gj.one_contact(scene, 830.0)


def test_what_has_no_one_contact_is_refused_in_one_line(yang, wang):
    with pytest.raises(SceneError, match="compliance"):
        gj.one_contact(dataclasses.replace(yang, compliance=None), 100.0)
    with pytest.raises(ParameterError, match="positive"):
        gj.one_contact(yang, -5.0)
    with pytest.raises(ParameterError, match="more than twice"):
        gj.one_contact(yang, 100.0, samples=8, harmonics=4)
    with pytest.raises(ParameterError, match="period"):
        gj.one_contact(yang, 100.0, period=0.0)
    with pytest.raises(SceneError, match=r"repeat after scene\.system\.cycle"):
        gj.one_contact(wang, TORQUE)
