"""The involute RV reducer where little or everything touches, and where what it is given does not fit."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import deg, mm, um
from tests.involute import STEEL, angle_of, system

ELASTIC = gj.ElasticTeeth(**STEEL)


@pytest.mark.slow
def test_a_vanishing_torque_leaves_the_first_contact():
    """Errors included: the loaded error is that without load, and no tooth carries."""
    own = system(pairs=9, profile_points=3)
    errors = {"ring": gj.Eccentricity(body="ring", amplitude=3 * um, phase=1.0)}
    scene = gj.Scene(own, errors, compliance=ELASTIC)
    theta = jnp.linspace(0.0, 0.02, 4)
    at_rest = gj.transmission_error(scene, theta)
    loaded = gj.transmission_error(scene, theta, torque=0.0)
    np.testing.assert_allclose(loaded.te, at_rest.te, rtol=1e-12)
    assert not np.asarray(loaded.forces).any()
    assert not np.asarray(loaded.crowded).any()


@pytest.mark.slow
def test_all_candidates_carry_where_more_would_and_that_is_told():
    """By a torque that closes everything: forces balance, and the outermost pair is named."""
    own = system(pairs=9)
    with pytest.warns(gj.FewCandidates, match=r"(?s)pair \d of 9 on gear_1.*more system.pairs"):
        found = gj.transmission_error(gj.Scene(own, compliance=ELASTIC), jnp.asarray([0.01]), torque=1e5)
    assert (np.asarray(found.forces) > 0).all()
    assert float(found.forces.sum()) * float(own.pair.external.base_radius) == pytest.approx(1e5, rel=1e-9)


@pytest.mark.slow
def test_too_few_candidates_are_told_and_enough_are_not():
    """Six pairs carry: of five the outermost do, of nine they do not, and a single one is a choice."""
    theta = jnp.asarray([angle_of(system(), 0.34)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for pairs in (1, 9):
            gj.transmission_error(gj.Scene(system(pairs=pairs), compliance=ELASTIC), theta, torque=100.0)
    with pytest.warns(gj.FewCandidates, match=r"carry load at 100 % of the angles \(the driving flank of pair") as told:
        gj.transmission_error(gj.Scene(system(pairs=5), compliance=ELASTIC), theta, torque=100.0)
    assert "\n" not in str(told[0].message)


@pytest.mark.slow
def test_one_pair_carries_all_where_the_others_are_far_away():
    """A tooth that stands ahead by 40 um: its pair carries everything, and load sharing is the number that could."""
    own = system(pairs=9)
    theta = jnp.asarray([angle_of(own, 0.5)])
    pose_teeth = np.asarray(own.candidates(theta[0], False).tooth[0])
    tooth = int(np.sort(pose_teeth)[4]) % own.external_teeth
    found = []
    for ahead in (40 * um, -40 * um):
        around = jnp.zeros(own.external_teeth).at[tooth].set(ahead)
        errors = {"teeth": gj.Positions(body="gear_1", outward=jnp.zeros(0), around=around)}
        found.append(gj.transmission_error(gj.Scene(own, errors, compliance=ELASTIC), theta, torque=100.0))
    engaged = sorted(int(each.engaged[0]) for each in found)
    assert engaged[0] == 1
    assert engaged[1] > 3
    one = min(found, key=lambda each: int(each.engaged[0]))
    assert float(one.load_sharing[0]) == pytest.approx(own.pairs, rel=1e-12)


@pytest.mark.slow
def test_points_on_the_edges_of_the_tips_carry():
    """At both ends of the path of contact the outer points of the profile are on the tip circles, and are found."""
    own = system(pairs=13, profile_points=5)
    for share in (0.0, 1.0):
        theta = angle_of(own, share)
        found = own.candidates(jnp.asarray(theta), False)
        radii = [np.asarray(gear.radius_at(r)) for gear, r in zip(
            (own.pair.external, own.pair.internal), found.points.roll, strict=True)]  # fmt: skip
        loaded = gj.transmission_error(gj.Scene(own, compliance=ELASTIC), jnp.asarray([theta]), torque=100.0)
        forces = np.asarray(loaded.forces).reshape(own.pairs, -1)
        for radius, gear in zip(radii, (own.pair.external, own.pair.internal), strict=True):
            on_tip = np.abs(radius[0] - float(gear.tip_radius)) < 1e-9
            assert on_tip.any(axis=1).sum() >= 6
            assert forces[on_tip].max() > 1.0
        assert np.isfinite(forces).all()


@pytest.mark.slow
def test_a_torque_turned_around_is_carried_by_the_back_flanks_alone():
    own = system(pairs=9)
    scene = gj.Scene(own, backlash=gj.InitialBacklash(initial=20 * um), compliance=ELASTIC)
    theta = jnp.asarray([angle_of(own, 0.3)])
    ahead, back = (gj.transmission_error(scene, theta, torque=torque) for torque in (100.0, -100.0))
    for found, carry, rest in ((ahead, slice(0, 9), slice(9, 18)), (back, slice(9, 18), slice(0, 9))):
        assert float(found.forces[0, carry].sum() * own.pair.external.base_radius) == pytest.approx(100.0, rel=1e-9)
        assert not np.asarray(found.forces[0, rest]).any()
    assert int(ahead.result[0]) == int(back.result[0]) == 0


@pytest.mark.slow
def test_negative_gaps_are_flagged_with_how_much():
    """A throw that is 5 um too long closes the gaps by some 7 um: rigid flanks share the overlap, elastic ones are both
    pressed."""
    own = system(pairs=13, centre_distance=1.505 * mm)
    missing = -float(own.pair.backlash)
    assert missing > 7 * um
    scene = gj.Scene(own, backlash=gj.InitialBacklash(initial=0.0), compliance=ELASTIC)
    theta = jnp.asarray([0.0, 0.005])
    overlap = gj.interference(scene, theta)
    assert bool(overlap.interferes.all())
    np.testing.assert_allclose(overlap.overlap, missing / 2, rtol=1e-2)
    assert "rigid bodies overlap at 100 % of the angles" in str(overlap.told(scene))
    pressed = gj.transmission_error(scene, theta, torque=1.0)  # elastic teeth give way: both flanks carry
    assert (np.asarray(pressed.forces[:, :13]).sum(axis=1) > 10.0).all()
    assert (np.asarray(pressed.forces[:, 13:]).sum(axis=1) > 10.0).all()
    net = (pressed.forces[:, :13].sum(axis=1) - pressed.forces[:, 13:].sum(axis=1)) * own.pair.external.base_radius
    np.testing.assert_allclose(net, 1.0, rtol=1e-6)


@pytest.mark.slow
def test_one_tooth_of_difference():
    """Most teeth of all share the load; the ratio is the number of teeth, and the forces balance."""
    own = system(
        external_teeth=100, internal_teeth=101, module=1 * mm, pressure_angle=30 * deg, external_shift=0.0,
        internal_shift=0.3, external_addendum=0.35, internal_addendum=0.35, centre_distance=0.6736 * mm, pairs=31,
    )  # fmt: skip
    assert own.ratio == 100
    theta = jnp.linspace(0.0, 0.05, 3)
    found = gj.transmission_error(gj.Scene(own, compliance=ELASTIC), theta, torque=20.0)
    moment = np.asarray(found.forces.sum(axis=1)) * float(own.pair.external.base_radius)
    np.testing.assert_allclose(moment, 20.0, rtol=1e-9)
    assert int(found.engaged.min()) >= 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"external_teeth": 241}, "external_teeth = 241: must be below internal_teeth"),
        ({"external_shift": 3.0}, "tips of the external gear reach 72.047 mm, beyond the ring's roots"),
        ({"internal_shift": -2.0}, ""),
    ],
    ids=["teeth", "shifted outwards", "ring shifted inwards"],
)
def test_an_external_gear_larger_than_its_ring_is_refused(changes, words):
    with pytest.raises(gj.GearjaxError) as caught:
        system(**changes)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
