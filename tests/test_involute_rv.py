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
from gearjax.systems import flank_radii
from gearjax.units import deg, mm, um
from tests.conftest import ROOT
from tests.internal_gears import Curves

FIRST = {"sun_teeth": 22, "planet_teeth": 60, "first_stage_module": 1.25 * mm}


def system(**changes) -> gj.InvoluteRV:
    """That of Yang, Tang and Liang (2019), Table 1."""
    numbers = {
        "external_teeth": 236,
        "internal_teeth": 240,
        "module": 0.58 * mm,
        "pressure_angle": 20 * deg,
        "external_shift": -0.4,
        "internal_shift": 0.55028,
        "external_addendum": 0.6328,
        "internal_addendum": 1.0,
        "centre_distance": 1.5 * mm,
        "input_speed": 92.7,
    }
    return gj.InvoluteRV(**(numbers | changes))


class Place(NamedTuple):
    """A flank point: number of its contact, gear, tooth from the first one on, radius about the gear's axis, side."""

    contact: int
    gear: int
    tooth: int
    radius: float
    back: bool


_drawn: dict[int, tuple[gj.InvoluteRV, Curves]] = {}


def curves_of(own: gj.InvoluteRV) -> Curves:
    """The gears of a system as curves, worked out once: their numbers are arrays, which take longer than the gaps."""
    if id(own) not in _drawn:
        _drawn[id(own)] = own, Curves(own.pair)
    return _drawn[id(own)][1]


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


@pytest.mark.parametrize("changes", SETS, ids=["crank", "sun", "two gears", "sun, three gears"])
def test_ideal_gaps_are_those_of_the_curves_at_any_angle(changes, rng):
    """The ideal motion itself: the output turns as it should, the cranks too, driving flanks touch."""
    own = system(**changes)
    for theta in rng.uniform(0, own.cycle, 3):
        pose, places = contacts_at(own, theta, True)
        assert len(places) > 10
        for place in places:  # to rounding of angles over many turns
            assert float(pose.gap[place.contact]) == pytest.approx(true_gap(own, theta, place), abs=1e-11)


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


STEEL = {"youngs_modulus": 2.06e11, "poissons_ratio": 0.3, "external_width": 6.5 * mm, "internal_width": 14 * mm}


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


def test_without_load_ideal_gears_have_no_error():
    own = system(gears=2)
    found = gj.transmission_error(gj.Scene(own), jnp.linspace(0.0, own.cycle, 301))
    assert float(jnp.abs(found.te).max()) < 1e-15


def test_backlash_is_that_of_the_centre_distance_and_what_is_listed():
    own = system(centre_distance=1.497 * mm)
    scene = gj.Scene(own, backlash=gj.InitialBacklash(initial=10 * um))
    play = gj.backlash(scene, jnp.linspace(0.0, 0.3, 401))
    known = (float(own.pair.backlash) + 10 * um) / float(own.pair.external.base_radius)
    np.testing.assert_allclose(play.backlash, known, rtol=1e-9)


def test_teeth_that_are_pressed_together_interfere():
    """The published numbers overlap by 0.4 um when both flanks are looked at; without room for it that is told."""
    scene = gj.Scene(system(), backlash=gj.InitialBacklash(initial=0.0))
    overlap = gj.interference(scene, jnp.linspace(0.0, 0.02, 11))
    assert bool(overlap.interferes.all())
    assert float(overlap.overlap.max() / um) == pytest.approx(0.3957 / 2, abs=1e-3)  # shared by both flanks


def angle_of(own: gj.InvoluteRV, share: float) -> float:
    """Input angle at which a pair stands at a share of its path of contact [rad]."""
    begin, end = own.pair.path
    space = float(own.pair.space_of_roll(begin + share * (end - begin)))
    return (-space % (2 * np.pi / own.internal_teeth)) / own.orders["crank"]


def per_pair(own: gj.InvoluteRV, theta: float, forces) -> np.ndarray:
    """Loads of the pairs by falling tooth number, those of the paper rising."""
    tooth = np.asarray(own.candidates(jnp.asarray(theta), False).tooth[0])
    return np.asarray(forces).reshape(own.pairs, -1).sum(axis=1)[np.argsort(-tooth)]


def test_one_stiffness_for_each_pair_is_the_closed_form(rng):
    """At random angles and torques, by trying every number of pairs that carry."""
    own = system(pairs=13)
    scene = gj.Scene(own, compliance=gj.HarmonicStiffness(mean=2e8, relative_amplitudes=[], phases=[]))
    radius = float(own.pair.external.base_radius)
    for theta, torque in zip(rng.uniform(0, own.cycle, 4), (1e-3, 5.0, 100.0, 400.0), strict=True):
        found = gj.transmission_error(scene, jnp.asarray([theta]), torque=torque)
        gaps = np.sort(np.asarray(own.pose(jnp.asarray(theta), Request()).gap))
        approach = next(
            at
            for carry in range(1, len(gaps) + 1)
            if (at := (torque / radius / 2e8 + gaps[:carry].sum()) / carry) <= (*gaps, np.inf)[carry]
        )
        assert -float(found.te[0]) * radius == pytest.approx(approach, rel=1e-12)


def test_published_loads_by_one_stiffness():
    """The reference's best fit of one stiffness for all pairs: 2.0e5 N/mm at the share 0.25 of the path, two digits."""
    own = system(pairs=9)
    scene = gj.Scene(own, compliance=gj.HarmonicStiffness(mean=2.0e8, relative_amplitudes=[], phases=[]))
    theta = angle_of(own, 0.25)
    found = gj.transmission_error(scene, jnp.asarray([theta]), torque=100.0)
    loads = per_pair(own, theta, found.forces[0])
    np.testing.assert_allclose(loads[loads > 0], [40.3, 275.5, 374.5, 377.6, 337.0, 149.9], atol=1.0)
    assert loads.sum() == pytest.approx(1554.9, abs=0.02)


def test_elastic_teeth_give_what_finite_elements_give():
    """Loads of `InfluenceMatrix` with the rim of 0.8 mm and of 2 mm, an even load across the face (slow test below)."""
    known = {
        0.8: [62.2, 245.8, 376.8, 404.8, 313.3, 152.0, 0.0],
        2.0: [89.9, 248.5, 354.9, 377.3, 304.6, 167.8, 11.8],
    }
    own = system(pairs=9, profile_points=5)
    theta = angle_of(own, 0.3417)
    for (rim, loads), part in zip(known.items(), (0.02, 0.04), strict=True):
        scene = gj.Scene(own, compliance=gj.ElasticTeeth(**STEEL, rim=rim * mm))
        found = gj.transmission_error(scene, jnp.asarray([theta]), torque=100.0)
        mine = per_pair(own, theta, found.forces[0])
        first = int(np.flatnonzero(mine)[0])
        np.testing.assert_allclose(mine[first : first + 7], loads, atol=part * max(loads))


def test_elastic_teeth_are_symmetric_definite_and_pass_reciprocity(rng):
    """The matrix of a scene at random angles; a wider ring and a thicker rim only change it as they should."""
    own = system(pairs=5, profile_points=4, face_points=5)
    for theta in rng.uniform(0, 1, 2):
        parts = {}
        for name, changes in {"plain": {}, "rim": {"rim": 1 * mm}, "narrow": {"internal_width": 6.5 * mm}}.items():
            scene = gj.Scene(own, compliance=gj.ElasticTeeth(**(STEEL | changes)))
            influence = np.asarray(scene.contacts(jnp.asarray(theta), "mean").springs.influence)
            np.testing.assert_allclose(influence, influence.T, rtol=1e-12)
            assert np.linalg.eigvalsh(influence)[0] > 0
            parts[name] = influence.sum()
        assert parts["rim"] < parts["plain"] < parts["narrow"]


def test_an_even_load_across_the_face_is_what_many_slices_carry():
    """Forces of one pair over equally wide gears: the same compliance, with one place across the face and with many."""
    wide = STEEL | {"internal_width": 6.5 * mm}
    totals = []
    for slices in (1, 21, 41):
        own = system(pairs=1, profile_points=3, face_points=slices)
        scene = gj.Scene(own, compliance=gj.ElasticTeeth(**wide))
        influence = np.asarray(scene.contacts(jnp.asarray(0.3), "mean").springs.influence)
        share = np.full(slices, 1.0)
        share[[0, -1]] = 0.5 if slices > 1 else 1.0
        share = np.tile(share / share.sum(), 3)
        totals.append(share @ influence @ share)
    even, coarse, fine = totals
    assert fine == pytest.approx(even, rel=3e-3)
    assert abs(fine - even) < 0.3 * abs(coarse - even)  # the second order of straight lines


def test_gradients_of_the_loaded_error_are_those_of_differences():
    """With respect to centre distance, shift, a tooth's place and modulus, under jit and vmap over angles."""
    own = system(pairs=9, profile_points=3)
    theta = jnp.sort(jnp.asarray([angle_of(own, share) for share in (0.7, 0.45, 0.2)]))

    def error(numbers):
        distance, shift, tooth, modulus = numbers
        changed = system(pairs=9, profile_points=3, centre_distance=distance, external_shift=shift)
        places = jnp.zeros(236).at[16].set(tooth)
        errors = {"pitch": gj.Positions(body="gear_1", outward=jnp.zeros(0), around=places)}
        scene = gj.Scene(changed, errors, compliance=gj.ElasticTeeth(**(STEEL | {"youngs_modulus": modulus})))
        return gj.transmission_error(scene, theta, torque=100.0).te

    at = jnp.asarray([1.4995 * mm, -0.4, 0.5 * um, 2.06e11])
    slopes = jax.jit(jax.jacrev(error))(at)
    value = jax.jit(error)
    for column, step in enumerate([1e-9, 1e-7, 1e-9, 1e6]):
        way = np.zeros(4)
        way[column] = step
        difference = (8 * (value(at + way) - value(at - way)) - (value(at + 2 * way) - value(at - 2 * way))) / (
            12 * step
        )
        scale = np.abs(difference).max()
        np.testing.assert_allclose(slopes[:, column], difference, rtol=1e-6, atol=1e-6 * scale)


def test_loads_balance_at_extremes():
    """Torques from none to that of the paper, one candidate, and the torque turned around."""
    own = system(pairs=9)
    elastic = gj.ElasticTeeth(**STEEL)
    theta, radius = jnp.asarray([0.01]), float(own.pair.external.base_radius)
    for torque in (0.0, 1e-9, 1.0, 100.0):
        found = gj.transmission_error(gj.Scene(own, compliance=elastic), theta, torque=torque)
        assert float(found.forces.sum()) * radius == pytest.approx(torque, rel=1e-9, abs=1e-15)
        assert int(found.result[0]) == 0
    one = gj.transmission_error(gj.Scene(system(pairs=1), compliance=elastic), theta, torque=100.0)
    assert float(one.forces.sum()) * radius == pytest.approx(100.0, rel=1e-12)
    roomy = gj.Scene(own, backlash=gj.InitialBacklash(initial=20 * um), compliance=elastic)
    both = [gj.transmission_error(roomy, theta, torque=torque) for torque in (100.0, -100.0)]
    lost = float(both[1].te[0] - both[0].te[0])
    assert lost > float(gj.backlash(roomy, theta).backlash[0]) > 0
    with pytest.raises(gj.GearjaxError, match="list a \\[backlash\\]"):
        gj.transmission_error(gj.Scene(own, compliance=elastic), theta, torque=-1.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"external_teeth": 240}, "external_teeth = 240: must be below internal_teeth"),
        ({"centre_distance": 1.0 * mm}, "must be above the difference of the base radii"),
        ({"pairs": 201}, "pairs = 201"),
        ({"sun_teeth": 22}, "a first stage needs"),
        ({"external_addendum": 3.0}, "pointed teeth"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(changes, words):
    with pytest.raises(gj.GearjaxError) as caught:
        system(**changes)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_gear_sets_have_no_places_for_elastic_teeth():
    with pytest.raises(gj.GearjaxError, match="needs the places of contacts on their teeth"):
        gj.Scene(gj.load(ROOT / "configs/two_kv/wang_2020.toml").system, compliance=gj.ElasticTeeth(**STEEL))


def test_a_single_candidate_is_too_few_for_finite_elements():
    matrix = gj.InfluenceMatrix(**STEEL, rim=0.8 * mm)
    with pytest.raises(gj.GearjaxError, match="at least 3 candidates along the profile"):
        matrix.made_for(*flank_radii(system()))
    with pytest.raises(gj.GearjaxError, match="has no tables"):
        gj.Scene(system(profile_points=3), compliance=matrix)


@pytest.mark.slow
def test_published_loads_by_finite_elements():
    """Table 5 of the paper within 1 N rms, the phase and the rim fitted; six pairs of teeth, none on the others."""
    published = [58.6, 244.2, 379.7, 407.8, 315.1, 149.5]
    own = system(pairs=9, profile_points=9, face_points=14)
    theta = angle_of(own, 0.3417)
    for rim, bound in ((0.8, 1.5), (0.77, 1.0)):
        matrix = gj.InfluenceMatrix(**STEEL, rim=rim * mm).made_for(*flank_radii(own))
        found = gj.transmission_error(gj.Scene(own, compliance=matrix), jnp.asarray([theta]), torque=100.0)
        loads = per_pair(own, theta, found.forces[0])
        assert (loads > 0).sum() == 6
        assert loads.sum() == pytest.approx(1554.9, abs=0.02)
        assert np.sqrt(np.mean((loads[loads > 0] - published) ** 2)) < bound
        even = system(pairs=9, profile_points=9)
        loads = per_pair(
            even, theta, gj.transmission_error(gj.Scene(even, compliance=matrix), jnp.asarray([theta]), 100.0).forces[0]
        )
        if rim == 0.8:  # what elastic teeth are compared with above
            np.testing.assert_allclose(loads[loads > 0], [62.2, 245.8, 376.8, 404.8, 313.3, 152.0], atol=0.1)
