"""Load across the face against the formulas of ISO 6336-1, method C, for a misaligned spur pair."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.results import face_load_factors, run_cases
from gearjax.units import um
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, SPUR, TEETH, meshes_of, scene_of

PER_LENGTH, TORQUE = 14e9, 400.0


def misaligned(slope: float, slices: int = 50) -> gj.Scene:
    """A spur pair with constant stiffness per length, whose pinion has a helix slope [m]."""
    return scene_of(SPUR, {"slope": gj.HelixSlope("pinion", slope)}, gj.LineStiffness(PER_LENGTH), slices=slices)


@pytest.mark.slow
def test_a_slight_misalignment_has_the_factor_of_the_standard():
    """``1 + F c_gamma b / (2 F_t)`` with c_gamma of the mean number of pairs, the contact ratio."""
    scene, slope = misaligned(6 * um), 6 * um
    pair, theta = scene.system.pair, meshes_of(scene.system, 512)
    found = gj.face_load(scene, gj.transmission_error(scene, theta, torque=TORQUE))
    path = pair.contact_path
    ratio = (path.end - path.begin) / pair.base_pitch
    tangential = TORQUE / pair.gears[1].base_radius
    width = SPUR["face_width"]
    wanted = 1 + ratio * PER_LENGTH * slope * width / (2 * tangential) * (1 - 1 / 50)  # in the middle of a slice
    assert found.factor == pytest.approx(float(wanted), abs=2e-4)
    np.testing.assert_allclose(found.load.sum(axis=1) * width / 50, tangential, rtol=1e-9)
    np.testing.assert_allclose(np.diff(found.mean), np.diff(found.mean)[0], rtol=1e-6)  # a straight line
    assert (jnp.diff(found.across) > 0).all()
    assert found.across[0] == pytest.approx(-0.5 * width * (1 - 1 / 50))
    assert found.load.shape == (512, 50)


@pytest.mark.slow
def test_a_strong_misalignment_has_the_factor_of_the_standard():
    """``sqrt(2 F c b / F_t)`` where a part of the face carries, at the pitch point: one pair is in contact."""
    slope, torque = 30 * um, 100.0
    scene = misaligned(slope, 1000)
    found = gj.face_load(scene, gj.transmission_error(scene, np.zeros(1), torque=torque))
    tangential = torque / scene.system.pair.gears[1].base_radius
    wanted = jnp.sqrt(2 * slope * PER_LENGTH * SPUR["face_width"] / tangential)
    assert wanted > 2
    assert found.factor == pytest.approx(float(wanted), rel=2e-3)


@pytest.mark.slow
def test_slopes_at_the_same_end_add_and_opposite_ones_cancel():
    def factor(*slopes):
        errors = {body: gj.HelixSlope(body, slope) for body, slope in zip(("pinion", "wheel"), slopes, strict=False)}
        scene = scene_of(SPUR, errors, gj.LineStiffness(PER_LENGTH), slices=9)
        return float(
            gj.face_load(scene, gj.transmission_error(scene, meshes_of(scene.system, 16), torque=TORQUE)).factor
        )

    assert factor() == pytest.approx(1.0, abs=1e-12)
    assert factor(6 * um, -6 * um) == pytest.approx(1.0, abs=1e-9)
    assert factor(3 * um, 3 * um) == pytest.approx(factor(6 * um), rel=1e-9)


@pytest.mark.slow
def test_batches_and_gradients():
    """One pair by one, and differences; the factor of a helical pair over the crowning under jit and vmap."""

    pair = scene_of(GUO_1, {}, TEETH, slices=12)

    def factor(amount):
        scene = dataclasses.replace(pair, errors={"crowning": gj.Crowning("pinion", amount)})
        te = gj.transmission_error(scene, meshes_of(pair.system, 16), torque=830.0)
        return gj.face_load(scene, te).factor

    amounts = jnp.array([4.0, 8.0]) * um
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(factor)))(amounts)
    assert (values[1] > values[0]) & (values[0] > 1)
    step = 1e-10
    wanted = [(factor(a + step) - factor(a - step)) / (2 * step) for a in amounts]
    np.testing.assert_allclose(slopes, wanted, rtol=1e-5)


@pytest.mark.slow
def test_of_a_motion():
    """A slow motion has the loads of rest."""
    scene = misaligned(6 * um, 9)
    turning = dataclasses.replace(
        scene, inertia=gj.MomentOfInertia(0.01), load=gj.ConstantLoad(), damping=gj.DampingRatio(0.1)
    )
    ts = jnp.linspace(0.0, 2 * jnp.pi / scene.system.pinion_teeth / scene.system.input_speed, 65)
    moved = gj.face_load(turning, gj.simulate(turning, ts, TORQUE))
    still = gj.face_load(scene, gj.transmission_error(scene, ts * scene.system.input_speed, torque=TORQUE))
    assert moved.load.shape == still.load.shape
    assert moved.factor == pytest.approx(float(still.factor), abs=2e-3)


@pytest.mark.slow
def test_what_a_run_tells():
    """The factor of each case at rest over a mesh or more; a shorter record has none."""
    scene = dataclasses.replace(misaligned(6 * um, 9), run=gj.Run(0.06, 65, ("static",), (TORQUE,)))
    turn = 2 * np.pi / scene.system.pinion_teeth / float(scene.system.input_speed)
    assert turn < 0.06
    told = face_load_factors(scene, list(run_cases(scene)))
    assert list(told) == ["static, 400 N m"]
    assert told["static, 400 N m"] == pytest.approx(1.165, abs=0.01)
    short = dataclasses.replace(scene, run=gj.Run(0.9 * turn, 65, ("static",), (TORQUE,)))
    assert not face_load_factors(short, list(run_cases(short)))


@pytest.mark.slow
def test_refusals(scene):
    theta = np.linspace(0.0, 1.0, 5)
    with pytest.raises(gj.SceneError, match="needs slices across the face, which two_kv does not have"):
        gj.face_load(scene, gj.transmission_error(scene, theta, torque=10.0))
    pair = misaligned(1 * um, 3)
    with pytest.raises(gj.SceneError, match="the load across the face needs a torque"):
        gj.face_load(pair, gj.transmission_error(pair, theta))


@pytest.mark.slow
def test_the_result_of_another_scene_is_refused():
    scene, other = misaligned(6 * um, 5), misaligned(6 * um, 7)
    te = gj.transmission_error(scene, meshes_of(scene.system, 8), torque=TORQUE)
    steel = gj.HertzLineContact(206e9, 0.3, 20e-3)
    for function in (gj.face_load, lambda scene, te: gj.contact_pressure(scene, te, steel)):
        with pytest.raises(gj.SceneError, match=r"of another scene: it has \d+ contacts, this scene has \d+$"):
            function(other, te)


def test_tooth_numbers_of_numpy_are_tooth_numbers():
    given = {"normal_pressure_angle": np.radians(20.0), "helix_angle": 0.1, "input_speed": 10.0, "face_width": 0.02}
    one, other = (gj.HelicalPair(teeth(23), teeth(61), normal_module=2e-3, **given) for teeth in (int, np.int64))
    assert type(other.pinion_teeth) is int
    assert one.cycle == other.cycle
    train = gj.load(ROOT / "configs" / "helical" / "two_stage.toml").system
    assert dataclasses.replace(train, wheel_teeth=np.array(train.wheel_teeth)).wheel_teeth == train.wheel_teeth
