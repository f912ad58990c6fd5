"""The involute RV reducer against its gears as curves, laws of mechanics, other solvers, and limits."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import gearjax as gj
from gearjax.contact import Request
from gearjax.geometry import base_radius
from gearjax.units import deg, mm, um
from tests.internal_gears import Curves
from tests.involute import FIRST, STEEL, angle_of, curves_of, system


class Place(NamedTuple):
    """A flank point: number of its contact, gear, tooth from the first one on, radius about the gear's axis, side."""

    contact: int
    gear: int
    tooth: int
    radius: float
    back: bool


def true_gap(
    own: gj.InvoluteRV,
    theta: float,
    place: Place,
    cranks: float = 0.0,
    output: float = 0.0,
    throw: complex = 0.0,
    shift: complex = 0.0,
    ring: complex = 0.0,
) -> float:
    """Base radius times the angle from a tooth's flank to its space's, at a radius about the external gear's axis.

    Displacements from the ideal motion: cranks ahead and the output ahead, against them [rad]; the external gear's
    centre, its flanks on it, and the ring, in axes of the ideal throw [m].
    """
    curves = curves_of(own)
    z1, z2 = own.external_teeth, own.internal_teeth
    crank = own.orders["crank"] * theta + 2 * np.pi * place.gear / own.gears
    # tooth 0 is in the space 0 while the throw points there, driving flanks touching
    tooth = curves.tooth_that_touches(0.0) + 2 * np.pi * place.tooth / z1 - crank * z2 / z1 - output
    space = 2 * np.pi * place.tooth / z2 - crank
    centre = (curves.centre + throw) * np.exp(1j * cranks)
    if place.back:  # in a mirror along the throw
        tooth, space, centre, shift, ring = -tooth, -space, np.conj(centre), np.conj(shift), np.conj(ring)

    def angle_at(point, near):
        """Angle about the centre where a curve crosses the radius."""
        where = brentq(lambda at: abs(point(at) - centre) - place.radius, near - 0.1 * mm, near + 0.1 * mm, xtol=1e-16)
        return np.angle(point(where) - centre)

    def external(radius):
        return centre + shift + radius * np.exp(1j * (tooth + curves.turn(0, radius)))

    def internal(radius):
        return ring + curves.ring_point(space, radius)

    apart = angle_at(internal, abs(external(place.radius))) - angle_at(external, place.radius)
    return curves.base[0] * apart


def contacts_at(own: gj.InvoluteRV, theta: float, back: bool, bodies: tuple[str, ...] = (), coordinates=()):
    """Pose, and the places of the contacts whose flanks face each other."""
    pose = own.pose(jnp.asarray(theta), Request(back, bodies, coordinates=coordinates))
    found = own.candidates(jnp.asarray(theta), back)
    radii = np.asarray(own.pair.external.radius_at(found.points.roll[0]))
    tooth = np.broadcast_to(np.asarray(found.tooth)[..., None], radii.shape)
    block = np.broadcast_to(np.arange(len(tooth))[:, None, None], radii.shape)
    each = zip((block % own.gears).ravel(), tooth.ravel(), radii.ravel(), (block >= own.gears).ravel(), strict=True)
    facing = np.broadcast_to(np.asarray(found.apart == 0)[..., None], radii.shape).ravel()
    return pose, [Place(index, *one) for index, one in enumerate(each) if facing[index]]


def halved(own, theta, place, **way) -> float:
    """Half of the difference of the gaps with a displacement and with its opposite."""
    back = {key: -value for key, value in way.items()}
    return (true_gap(own, theta, place, **way) - true_gap(own, theta, place, **back)) / 2


SETS = [{}, FIRST, {"gears": 2, "profile_points": 3}, FIRST | {"gears": 3, "pairs": 9}]


@pytest.mark.slow
@pytest.mark.parametrize("changes", SETS, ids=["crank", "sun", "two gears", "sun, three gears"])
def test_ideal_gaps_are_those_of_the_curves_at_any_angle(changes, rng):
    """The ideal motion itself: the output turns as it should, the cranks too, driving flanks touch."""
    own = system(**changes)
    for theta in rng.uniform(0, own.cycle, 3):
        pose, places = contacts_at(own, theta, True)
        assert len(places) > 10
        for place in places:  # to rounding of angles over many turns
            assert float(pose.gap[place.contact]) == pytest.approx(true_gap(own, theta, place), abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("changes", SETS, ids=["crank", "sun", "two gears", "sun, three gears"])
def test_a_lever_is_the_change_of_the_true_distance_per_output_angle_at_a_held_input(changes, rng):
    own, step = system(**changes), 1e-5
    theta, with_output = float(rng.uniform(0, own.cycle)), float(own.with_output)
    pose, places = contacts_at(own, theta, True)
    for place in places[::3]:
        # the cranks turn with the output, against their own sense
        near, far = (
            halved(own, theta, place, output=size, cranks=-with_output * size) / size for size in (step, 2 * step)
        )
        lever = -(4 * near - far) / 3
        assert float(pose.jacobian[place.contact, 0]) == pytest.approx(lever, rel=1e-7)
        assert (lever > 0) == place.back


@pytest.mark.slow
@pytest.mark.parametrize("body", ["gear_1", "gear_2", "ring", "throw"])
def test_a_run_out_is_seen_as_its_curves_are_displaced(body, rng):
    own = system(gears=2)
    theta, phase, size = float(rng.uniform(0, own.cycle)), float(rng.uniform(0, 6)), 1e-7
    pose, places = contacts_at(own, theta, True, (body,))
    seen = gj.Eccentricity(body=body, amplitude=size, phase=phase).gap(pose.views[body])
    for place in places[::2]:
        crank, along = own.orders["crank"] * theta + np.pi * place.gear, size * np.exp(1j * phase)
        ways = {
            "throw": {"throw": along},
            "ring": {"ring": along * np.exp(-1j * crank)},
            f"gear_{place.gear + 1}": {"shift": along * np.exp(-1j * crank * own.internal_teeth / own.external_teeth)},
        }
        known = halved(own, theta, place, **ways[body]) if body in ways else 0.0
        assert float(seen[place.contact]) == pytest.approx(known, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize("body", ["sun", "planet"])
def test_a_run_out_of_the_first_stage_turns_the_cranks(body):
    own, theta, size = system(**FIRST), 1.234, 1e-6
    pose, places = contacts_at(own, theta, True, (body,))
    phase = (0.5 * np.pi - own.orders[body] * theta) % (2 * np.pi)  # its sine is one
    seen = gj.Eccentricity(body=body, amplitude=size, phase=phase).gap(pose.views[body])
    ahead = size / float(base_radius(60, jnp.asarray(1.25 * mm), jnp.asarray(20 * deg)))
    for place in places[::4]:
        assert float(seen[place.contact]) == pytest.approx(halved(own, theta, place, cranks=ahead), rel=1e-4)


@pytest.mark.parametrize(("direction", "way"), [("x", 1.0), ("y", 1.0j)])
def test_a_support_lets_the_gear_go_along_and_across_the_throw(direction, way):
    own = system(gears=2)
    pose, places = contacts_at(own, 0.7, True, coordinates=(f"gear_2.{direction}",))
    for place in places[::3]:
        known = -halved(own, 0.7, place, throw=1e-7 * way) / 1e-7 * (place.gear == 1)
        assert float(pose.jacobian[place.contact, 1]) == pytest.approx(known, rel=1e-4, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("body", ["gear_1", "ring"])
@pytest.mark.parametrize("way", ["outward", "around"])
def test_places_of_single_teeth_are_those_of_their_curves(body, way, rng):
    """A tooth is displaced along its radius or around; it keeps its error as it goes around."""
    own, size = system(), 1e-7
    teeth = own.external_teeth if body == "gear_1" else own.internal_teeth
    off = rng.uniform(-1, 1, teeth) * size
    nothing = jnp.zeros(0)
    error = gj.Positions(body=body, **({"outward": nothing, "around": nothing} | {way: jnp.asarray(off)}))
    curves = Curves(own.pair)
    for theta in rng.uniform(0, 3 * own.cycle, 2):
        pose, places = contacts_at(own, theta, True, (body,))
        seen, crank = error.gap(pose.views[body]), own.orders["crank"] * theta
        on_ring = own.candidates(jnp.asarray(theta), True).points.roll[1].ravel()
        for place in places[::3]:
            side = -1 if place.back else 1
            if body == "gear_1":  # polar angle of the flank point, from the throw
                middle = curves.tooth_that_touches(0.0) + 2 * np.pi * place.tooth / own.external_teeth
                middle = middle - crank * own.internal_teeth / own.external_teeth
                polar = middle + side * curves.turn(0, place.radius)
            else:
                radius = float(own.pair.internal.radius_at(on_ring[place.contact]))
                polar = 2 * np.pi * place.tooth / own.internal_teeth - crank + side * curves.turn(1, radius)
            vector = off[place.tooth % teeth] * np.exp(1j * polar) * (1 if way == "outward" else 1j)
            known = halved(own, theta, place, **{"shift" if body == "gear_1" else "ring": vector})
            assert float(seen[place.contact]) == pytest.approx(known, rel=2e-4, abs=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("first", [False, True], ids=["crank", "sun"])
def test_the_forces_take_the_torque_from_the_input(first):
    """One pair on the line of action: its force, with the arm of the crank, holds the input's share of the torque."""
    own = system(pairs=1, **(FIRST if first else {}))
    scene = gj.Scene(own, compliance=gj.HarmonicStiffness(mean=2e8, relative_amplitudes=[], phases=[]))
    begin, end = (float(part) for part in own.pair.path)
    space = float(own.pair.space_of_roll(jnp.asarray(0.5 * (begin + end))))
    theta = (-space + 2 * np.pi / own.internal_teeth) / own.orders["crank"]
    found = gj.transmission_error(scene, jnp.asarray([theta]), torque=100.0)
    force, working = float(found.forces[0, 0]), float(own.pair.operating_pressure_angle)
    # the ring pushes the external gear against the normal (sin, cos), its centre on the throw
    across = -force * np.cos(working)
    against_crank = -across * float(own.centre_distance)  # holds the crank back, which drives it: positive
    ahead = force * float(own.pair.external.base_radius)  # on the external gear, in the output's sense negative
    crank = against_crank
    if first:  # planet wheels sit on the output: the cranks' torque passes through them to it and to the sun
        sun = crank / (own.planet_teeth / own.sun_teeth)
        assert sun * float(own.ratio) == pytest.approx(100.0, rel=1e-9)
        assert ahead + crank * float(own.with_output) == pytest.approx(100.0, rel=1e-9)
    else:
        assert crank * float(own.ratio) == pytest.approx(100.0, rel=1e-9)
        assert ahead == pytest.approx(100.0, rel=1e-12)


@pytest.mark.slow
def test_nothing_jumps_when_candidates_go_on_to_the_next_tooth():
    """Position and loads over a mesh period, closely: steps are as small as the samples are close."""
    own = system(pairs=11)
    scene = gj.Scene(own, compliance=gj.ElasticTeeth(**STEEL))
    theta = jnp.linspace(0.0, 2 * 2 * np.pi / 240, 801)
    found = gj.transmission_error(scene, theta, torque=100.0, extremes="samples")
    steps = np.abs(np.diff(found.te))
    assert steps.max() < 12 * np.median(steps)
    loads = np.abs(np.diff(found.forces, axis=0)).max(axis=1)
    assert loads.max() < 0.02 * float(found.forces.max())
    # what repeats with the mesh does
    np.testing.assert_allclose(found.te[:401], found.te[400:], rtol=1e-9)


@pytest.mark.slow
def test_gaps_have_no_jumps_where_teeth_begin_to_face_each_other():
    """Few teeth, and candidates around half of the gear: what touches nowhere only goes further apart."""
    few = {"external_teeth": 40, "internal_teeth": 46, "pairs": 24, "external_shift": 0.0, "internal_shift": 0.2}
    own = system(**few, centre_distance=1.78 * mm, external_addendum=0.7, internal_addendum=0.7)
    theta = jnp.linspace(0.0, 0.4, 2001)
    gap = np.asarray(jax.vmap(lambda at: own.pose(at, Request(True)).gap)(theta))
    assert np.isfinite(gap).all()
    jumps = np.abs(np.diff(gap, axis=0)) > 30 * um
    assert jumps.any()  # contacts go on to another tooth, far away
    assert np.minimum(gap[:-1], gap[1:])[jumps].min() > 0.3 * mm


@pytest.mark.slow
@pytest.mark.parametrize("body", ["gear_1", "ring"])
def test_profiles_are_modified_where_they_say(body):
    """Along the path of contact: the length of roll from a tip is that of the curves."""
    own = system(profile_points=7)
    pose, places = contacts_at(own, 0.4, True, (body,))
    curves, amount, over = Curves(own.pair), jnp.asarray([3e-6]), 0.5 * mm
    relief = gj.TipRelief(body=body, amount=amount, length=over, exponent=2).gap(pose.views[body])
    slope = gj.ProfileSlope(body=body, slope=amount).gap(pose.views[body])
    form = gj.ProfileForm(body=body, amplitude=amount, waves=2).gap(pose.views[body])
    number = 0 if body == "gear_1" else 1
    tip = float((own.pair.external, own.pair.internal)[number].tip_radius)
    radii = (own.pair.external, own.pair.internal)[number].radius_at(
        own.candidates(jnp.asarray(0.4), True).points.roll[number].ravel()
    )
    whole = float(own.pair.contact_ratio * own.pair.base_pitch)
    for place in places:
        rolled = [np.sqrt(radius**2 - curves.base[number] ** 2) for radius in (tip, float(radii[place.contact]))]
        far = abs(rolled[0] - rolled[1])
        assert float(relief[place.contact]) == pytest.approx(3e-6 * max(0, 1 - far / over) ** 2, rel=1e-9, abs=1e-15)
        assert float(slope[place.contact]) == pytest.approx(3e-6 * (far / whole - 0.5), rel=1e-9, abs=1e-15)
        wave = -3e-6 * np.cos(4 * np.pi * far / whole)
        assert float(form[place.contact]) == pytest.approx(wave, rel=1e-7, abs=1e-14)


def test_a_body_without_a_profile_takes_no_relief():
    with pytest.raises(gj.GearjaxError, match="has no involute profile"):
        gj.Scene(system(), {"relief": gj.TipRelief(body="throw", amount=jnp.asarray([1e-6]), length=1 * mm)})


@pytest.mark.slow
def test_relief_takes_the_load_off_the_tips():
    own = system(pairs=9, profile_points=9)
    theta = jnp.asarray([angle_of(own, 0.5)])
    at_tips = []
    for amount in (0.0, 0.3 * um, 3.0 * um):
        relief = {"relief": gj.TipRelief(body="gear_1", amount=jnp.asarray([amount]), length=0.1 * mm)}
        scene = gj.Scene(own, relief, compliance=gj.ElasticTeeth(**STEEL, rim=0.8 * mm))
        forces = gj.transmission_error(scene, theta, torque=100.0).forces
        at_tips.append(float(forces.reshape(own.pairs, 9)[:, -1].sum()))
    assert at_tips[0] > at_tips[1] > at_tips[2] == 0


@pytest.mark.slow
def test_without_load_ideal_gears_have_no_error():
    own = system(gears=2)
    found = gj.transmission_error(gj.Scene(own), jnp.linspace(0.0, own.cycle, 301))
    assert float(jnp.abs(found.te).max()) < 1e-15


@pytest.mark.slow
def test_backlash_is_that_of_the_centre_distance_and_what_is_listed():
    own = system(centre_distance=1.497 * mm)
    scene = gj.Scene(own, backlash=gj.InitialBacklash(initial=10 * um))
    play = gj.backlash(scene, jnp.linspace(0.0, 0.3, 401))
    known = (float(own.pair.backlash) + 10 * um) / float(own.pair.external.base_radius)
    np.testing.assert_allclose(play.backlash, known, rtol=1e-9)


@pytest.mark.slow
def test_teeth_that_are_pressed_together_interfere():
    """The published numbers overlap by 0.4 um when both flanks are looked at; without room for it that is told."""
    scene = gj.Scene(system(), backlash=gj.InitialBacklash(initial=0.0))
    overlap = gj.interference(scene, jnp.linspace(0.0, 0.02, 11))
    assert bool(overlap.interferes.all())
    assert float(overlap.overlap.max() / um) == pytest.approx(0.3957 / 2, abs=1e-3)  # shared by both flanks
