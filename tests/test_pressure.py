"""Loads of pairs, load sharing, and pressure in the contacts of involute flanks, against hand formulas."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact import Places, even_parts
from gearjax.units import mm, um
from tests.involute import curves_of, system

TORQUE, THETA = 40.0, np.linspace(0.2, 1.1, 6)
WIDTH = 6.5 * mm
ELASTIC = gj.ElasticTeeth(206e9, 0.3, WIDTH, 14 * mm, rim=0.8 * mm)
STEEL = gj.HertzLineContact(206e9, 0.3, WIDTH)
PLANE = 206e9 / (1 - 0.3**2)


@pytest.fixture(scope="module")
def loaded() -> tuple[gj.Scene, gj.TransmissionError, gj.TransmissionError]:
    """Both flanks of seven pairs with three points each, and what carries a torque ahead and back."""
    own = system(pairs=7, profile_points=3)
    scene = gj.Scene(own, backlash=gj.InitialBacklash(10 * um), compliance=ELASTIC)
    ahead, back = (gj.transmission_error(scene, THETA, way * TORQUE, extremes="samples") for way in (1, -1))
    return scene, ahead, back


@pytest.mark.slow
def test_loads_of_pairs_balance_the_torque(loaded):
    """Of an involute pair every contact has the lever of the base circle (Yang et al. 2019, eq. 7)."""
    scene, ahead, back = loaded
    base = 236 * 0.58 * mm * math.cos(math.radians(20)) / 2
    for te, carry, idle in ((ahead, slice(0, 7), slice(7, 14)), (back, slice(7, 14), slice(0, 7))):
        assert te.pair_forces.shape == (len(THETA), 14)
        np.testing.assert_allclose(te.pair_forces[:, carry].sum(axis=1), TORQUE / base, rtol=1e-12)
        np.testing.assert_array_equal(te.pair_forces[:, idle], 0.0)
        for pair in (0, 6, 9):  # contacts of a pair stand side by side
            expected = sum(te.forces[:, 3 * pair + point] for point in range(3))
            np.testing.assert_allclose(te.pair_forces[:, pair], expected, rtol=1e-12)
            assert f"pair {pair % 7 + 1} of 7" in scene.system.contact_name(3 * pair + 1)
        carrying = [len({i // 3 for i in np.flatnonzero(np.asarray(row))}) for row in te.forces > 0]
        np.testing.assert_array_equal(te.engaged_pairs, carrying)
        assert (np.asarray(te.engaged_pairs) < np.asarray(te.engaged)).all()


@pytest.mark.slow
def test_load_sharing_counts_the_pairs_of_the_loaded_side(loaded):
    for te in loaded[1:]:
        np.testing.assert_array_equal(te.carriers, 7)
        loads = te.pair_forces
        np.testing.assert_allclose(te.load_sharing, 7 * loads.max(axis=1) / loads.sum(axis=1), rtol=1e-12)
    with pytest.raises(gj.SceneError, match="loads of pairs need a torque"):
        _ = gj.transmission_error(loaded[0], THETA, extremes="samples").pair_forces


def test_both_flanks_of_a_pair_are_one_pair(scene):
    te = gj.transmission_error(scene, THETA, -100.0)
    assert te.forces.shape[1] == 4
    np.testing.assert_array_equal(te.carriers, 2)
    np.testing.assert_allclose(te.pair_forces, te.forces[:, :2] + te.forces[:, 2:])


@pytest.mark.slow
def test_motion_counts_the_pairs_of_the_loaded_side():
    one = gj.Scene(
        system(pairs=7, input_speed=6.0),
        backlash=gj.InitialBacklash(10 * um),
        compliance=gj.HarmonicStiffness(2e8, [], []),
        load=gj.ConstantLoad(),
        inertia=gj.MomentOfInertia(0.5),
        damping=gj.DampingRatio(0.05),
    )
    motion = gj.simulate(one, np.linspace(0.0, 0.01, 11), TORQUE)
    np.testing.assert_array_equal(motion.carriers, 7)
    assert float(motion.load_sharing.max()) <= 7.0


@pytest.mark.slow
def test_pressure_is_hertz_or_even_whichever_is_larger(loaded):
    """Radii from the gears as curves: their tangent points, and the length of flank from its base circle."""
    scene, te, _ = loaded
    found = np.asarray(gj.contact_pressure(scene, te)).reshape(len(THETA), 14, 3)
    np.testing.assert_allclose(gj.contact_pressure(scene, te, STEEL).reshape(found.shape), found, rtol=1e-12)
    forces, base = np.asarray(te.forces).reshape(found.shape), curves_of(scene.system).base
    kinds = set()
    for index, theta in enumerate(THETA):
        at = scene.system.candidates(jnp.asarray(theta), True)
        for pair in np.flatnonzero(forces[index].sum(axis=1) > 0):
            rolls = [np.asarray(roll)[0, pair] for roll in at.points.roll]
            radii = [b * roll for b, roll in zip(base, rolls, strict=True)]  # of curvature
            relative = radii[0] * radii[1] / (radii[1] - radii[0])
            flank = base[0] * (rolls[0][-1] ** 2 - rolls[0][0] ** 2) / 2
            line = forces[index, pair] / WIDTH
            half = np.sqrt(8 * line * relative / (math.pi * PLANE))  # of the width, Johnson 1985, eq. 4.43
            hertz = np.where(line > 0, 2 * line / (math.pi * np.maximum(half, 1e-300)), 0.0)
            even = line / (flank * np.array([0.25, 0.5, 0.25]))
            np.testing.assert_allclose(found[index, pair], np.maximum(hertz, even), rtol=1e-9)
            kinds |= set((hertz > even)[line > 0].tolist())
    np.testing.assert_array_equal(found[forces == 0], 0.0)
    assert kinds == {False, True}  # where little is carried, Hertz' contact is narrower than the strip
    assert 1e7 < found.max() < 3e8


@pytest.mark.slow
def test_curved_flanks_have_hertz_pressure():
    """The same law where the flanks are curved: a strip that is wider than Hertz' contact."""
    pair = system().pair
    radius = tuple(jnp.full((1, 1, 1), float(gear.tip_radius)) for gear in (pair.external, pair.external))
    shared, face = jnp.full((1, 1), 5 * mm), jnp.linspace(-0.5, 0.5, 3)
    places = Places((pair.external, pair.external), radius, jnp.zeros((1, 1)), shared, face)
    forces = jnp.array([20.0, 0.0, 20.0])
    rolled = math.sqrt(float(pair.external.tip_radius) ** 2 - float(pair.external.base_radius) ** 2)
    expected = math.sqrt(20.0 / (WIDTH / 4) * PLANE / (2 * math.pi) * 2 / rolled)
    np.testing.assert_allclose(STEEL.flank_pressure(places, forces), [expected, 0.0, expected], rtol=1e-12)
    assert expected > 2 * 20.0 / (WIDTH / 4) / (5 * mm)


def test_parts_add_up_to_the_whole():
    for number in (1, 2, 5):
        parts = even_parts(number, jnp.dtype(float))
        assert parts.shape == (number,)
        assert float(parts.sum()) == pytest.approx(1.0, rel=1e-12)


def test_pressure_has_derivatives(loaded):
    scene, te, _ = loaded
    forces, step = te.forces, 1e-4

    def highest(factor):
        return gj.contact_pressure(scene, dataclasses.replace(te, forces=factor * forces)).max()

    slope, difference = jax.grad(highest)(1.0), (highest(1 + step) - highest(1 - step)) / (2 * step)
    assert float(slope) == pytest.approx(float(difference), rel=1e-6)


def test_pressure_without_material_is_refused(loaded):
    scene = dataclasses.replace(loaded[0], compliance=gj.HarmonicStiffness(2e8, [], []))
    with pytest.raises(gj.SceneError, match="and their material: give law=HertzLineContact") as caught:
        gj.contact_pressure(scene, loaded[1])
    assert "\n" not in str(caught.value)
