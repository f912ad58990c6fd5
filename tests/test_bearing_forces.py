"""Forces on supports: those of statics by hand, action and reaction, and Newton's law in motion."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import rpm, um
from tests.helical_pairs import GUO_1, TEETH, meshes_of, scene_of

TORQUE = 830.0
HELD = {body: gj.Support(x=6e8, y=4e8, z=3e8) for body in ("pinion", "wheel")}


def held(**changed: object) -> gj.Scene:
    """The pair of Guo and Fang on bearings."""
    scene = scene_of(GUO_1, {"run_out": gj.Eccentricity("wheel", 20 * um, 0.4)}, TEETH, slices=12)
    return dataclasses.replace(scene, supports=HELD, **changed)


@pytest.mark.slow
def test_forces_of_a_helical_pair_are_those_of_statics():
    """Radial ``T / r_b`` along the line of action, axial ``T tan(beta_b) / r_b``, on both wheels against each other."""
    scene = held()
    pair = scene.system.pair
    found = gj.bearing_forces(scene, gj.transmission_error(scene, meshes_of(scene.system, 16), torque=TORQUE))
    assert found.names == tuple(f"{body}.{way}" for body in ("pinion", "wheel") for way in "xyz")
    tangential = TORQUE / pair.gears[1].base_radius
    for body in ("pinion", "wheel"):
        np.testing.assert_allclose(found.radial(body), tangential, rtol=1e-9)
        np.testing.assert_allclose(
            np.abs(found.of(f"{body}.z")), tangential * jnp.tan(pair.base_helix_angle), rtol=1e-9
        )
    np.testing.assert_allclose(found.forces[:, :3], -found.forces[:, 3:], rtol=1e-9)


def moving() -> gj.Scene:
    """The same pair in motion; contacts have no dampers, whose forces are not among those of contacts."""
    parts = {
        "inertia": gj.MomentOfInertia(0.0587),
        "load": gj.ConstantLoad(),
        "body_inertia": {"wheel": gj.BodyInertia(mass=12.0)},
    }
    scene = held(**parts)
    turning = dataclasses.replace(scene.system, input_speed=4200 * rpm)
    supports = {"wheel": gj.Support(x=6e8, y=4e8, x_damping=4e3, y_damping=9e3)}
    return dataclasses.replace(scene, system=turning, supports=supports)


@pytest.mark.slow
def test_what_the_bearing_does_not_carry_accelerates_the_wheel():
    """``m du2/dt2`` is the sum of contact forces, along the line of action, less the bearing's; its damper counts."""
    scene = moving()
    ts = jnp.linspace(0.0, 0.004, 4001)
    motion = gj.simulate(scene, ts, TORQUE)
    found = gj.bearing_forces(scene, motion)
    between = np.gradient(np.asarray(motion.q), np.asarray(ts), axis=0)
    np.testing.assert_allclose(between[5:-5], motion.rates[5:-5], atol=2e-3 * jnp.abs(motion.rates).max())
    rest = gj.transmission_error(scene, ts[:1] * scene.system.input_speed, torque=TORQUE)
    still, total = gj.bearing_forces(scene, rest), motion.forces.sum(axis=1)
    for way in "xy":
        along = still.of(f"wheel.{way}")[0] / rest.forces.sum()  # of the contact force
        pushed = along * total - found.of(f"wheel.{way}")
        rate = motion.rates[:, motion.coordinates.index(f"wheel.{way}")]
        wanted = 12.0 * np.gradient(np.asarray(rate), np.asarray(ts))
        inner = slice(20, -20)
        size = np.abs(wanted[inner]).max()
        assert size > 0.03 * rest.forces.sum()  # far from rest
        np.testing.assert_allclose(pushed[inner], wanted[inner], atol=0.01 * size)


@pytest.mark.slow
def test_gradients_of_statics():
    """A wheel on its two bearings is statically determinate: only the torque counts, not the stiffness."""
    scene = held()
    theta = meshes_of(scene.system, 8)

    def force(stiffness, torque):
        own = dataclasses.replace(scene, supports={"wheel": gj.Support(x=stiffness, y=4e8)})
        return gj.bearing_forces(own, gj.transmission_error(own, theta, torque=torque)).radial("wheel").mean()

    at = jnp.array([3e8, 9e8])
    by_stiffness, by_torque = jax.jit(jax.vmap(jax.grad(force, argnums=(0, 1)), in_axes=(0, None)))(at, TORQUE)
    np.testing.assert_allclose(by_torque, 1 / scene.system.pair.gears[1].base_radius, rtol=1e-9)
    assert jnp.abs(by_stiffness * at).max() < 1e-9 * TORQUE


@pytest.mark.slow
def test_gradients_of_a_motion_are_differences():
    scene = moving()
    ts = jnp.linspace(0.0, 0.004, 81)

    def swing(stiffness, damping):
        own = dataclasses.replace(scene, supports={"wheel": gj.Support(x=stiffness, y=4e8, x_damping=damping)})
        return gj.bearing_forces(own, gj.simulate(own, ts, TORQUE)).of("wheel.x").std()

    slopes = jax.jit(jax.vmap(jax.grad(swing, argnums=(0, 1)), in_axes=(0, None)))(jnp.array([6e8]), 4e3)
    values = jax.jit(jax.vmap(swing))(
        *jnp.array([[6e8 + 1e4, 4e3], [6e8 - 1e4, 4e3], [6e8, 4e3 + 1], [6e8, 4e3 - 1]]).T
    )
    np.testing.assert_allclose(slopes[0], (values[0] - values[1]) / 2e4, rtol=1e-5)
    np.testing.assert_allclose(slopes[1], (values[2] - values[3]) / 2, rtol=1e-5)


@pytest.mark.slow
def test_refusals(scene):
    theta = np.linspace(0.0, 1.0, 5)
    with pytest.raises(gj.SceneError, match=r"bearing forces need supports: list \[supports.BODY\]"):
        gj.bearing_forces(scene, gj.transmission_error(scene, theta, torque=10.0))
    own = held()
    with pytest.raises(gj.SceneError, match="bearing forces need a torque"):
        gj.bearing_forces(own, gj.transmission_error(own, theta))
    loaded = gj.transmission_error(own, theta, torque=10.0)
    with pytest.raises(gj.SceneError, match=r"the result is of another scene: it moves in output, pinion\.x"):
        gj.bearing_forces(dataclasses.replace(own, supports={"wheel": gj.Support(x=1e8)}), loaded)
    with pytest.raises(gj.SceneError, match=r'no support "wheel\.rx"; there are pinion\.x'):
        gj.bearing_forces(own, loaded).of("wheel.rx")
    axial = dataclasses.replace(own, supports={"wheel": gj.Support(z=1e8)})
    with pytest.raises(gj.SceneError, match=r'"wheel" has no support in x or y; there are wheel\.z'):
        gj.bearing_forces(axial, gj.transmission_error(axial, theta, torque=10.0)).radial("wheel")
