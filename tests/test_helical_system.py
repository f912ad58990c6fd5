"""The helical pair as a gear set, against curves in a plane, virtual work and symmetry."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import deg, mm, um
from tests.flat_gears import FlatPair
from tests.helical_pairs import (
    GUO_1,
    PAIRS,
    SPUR,
    STEEL,
    TEETH,
    meshes_of,
    scene_of,
    system_of,
)

# exact geometry: curves in a plane


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spur", "spur ring"])
@pytest.mark.parametrize("body", ["pinion", "wheel"])
def test_run_out_is_that_of_displaced_curves(name, body, rng):
    """The axis of one gear goes round: in the pinion's sense from the wheel on, and in the wheel's from the pinion."""
    system, size, phase = system_of(PAIRS[name], slices=1, tip_contact="corner"), 10 * um, rng.uniform(-3, 3)
    scene = gj.Scene(system, {"run_out": gj.Eccentricity(body, size, phase)})
    flat = FlatPair.of(system.pair)
    turns = np.linspace(0.0, 2 * math.pi, 7) + 0.01
    ratio = system.pinion_teeth / system.wheel_teeth
    exact = []
    for turn in turns:
        at = phase + (turn if body == "pinion" else turn * ratio)
        if body == "pinion":
            moved = {"moved": (size * math.cos(at), size * math.sin(at))}
        else:
            sign = 1 if system.wheel_kind == "internal" else -1
            moved = {"wheel_moved": (sign * size * math.cos(at), size * math.sin(at))}
        exact.append(flat.wheel_turn(turn, **moved))
    found = gj.transmission_error(scene, turns).te
    largest = np.abs(exact).max()
    assert largest > 5e-5 * (0.5 if name == "spur ring" else 1.0)
    np.testing.assert_allclose(found, exact, atol=2e-3 * largest)


@pytest.mark.parametrize("name", ["spur", "spur ring"])
@pytest.mark.parametrize("way", ["x", "y"])
@pytest.mark.parametrize("body", ["pinion", "wheel"])
def test_displacements_are_those_of_curves(name, way, body):
    """Levers of bearings: by how much less the wheel turns when a gear is displaced."""
    system, step, turn = system_of(PAIRS[name], slices=1), 1 * um, 0.013
    request = gj.Request(coordinates=(f"{body}.{way}",))
    pose = system.pose(jnp.asarray(turn), request)
    touching = int(jnp.argmin(pose.gap))
    lever, own = pose.jacobian[touching]
    flat = FlatPair.of(system.pair)
    moved = (step, 0.0) if way == "x" else (0.0, step)
    ends = [
        flat.wheel_turn(turn, **{"moved" if body == "pinion" else "wheel_moved": tuple(sign * part for part in moved)})
        for sign in (1, -1)
    ]
    assert -own / lever == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spur", "spur ring"])
def test_profiles_and_pitch_are_those_of_curves(name, rng):
    """Reliefs along the roll and places of single teeth, by their numbers, of the pinion."""
    system = system_of(PAIRS[name], slices=1, tip_contact="corner")
    pair, teeth = system.pair, system.pinion_teeth
    around = rng.uniform(-4, 4, teeth) * um
    reach, amount = 0.5 * float(pair.base_pitch), 0.05 * um  # small: flanks that lean touch elsewhere
    errors = {
        "tip": gj.TipRelief("pinion", [amount], reach),
        "root": gj.RootRelief("pinion", [0.7 * amount], reach, 2),
        "pitch": gj.Positions("pinion", [], around),
    }
    path, base, flat = pair.contact_path, float(pair.gears[0].base_radius), FlatPair.of(pair)

    def removed(_, roll):
        tip = np.clip(1 - (float(path.end) - roll * base) / reach, 0, 1)
        root = np.clip(1 - (roll * base - float(path.begin)) / reach, 0, 1)
        return amount * tip + 0.7 * amount * root**2

    def displaced(tooth, roll):
        # along the circumference at a radius is less along the base circle
        return -around[tooth % teeth] / np.sqrt(1 + roll**2)

    turns = np.sort(rng.uniform(0, 2 * math.pi, 12))
    only = gj.Scene(system, {key: errors[key] for key in ("tip", "root")})
    found = gj.transmission_error(only, turns).te
    exact = [flat.wheel_turn(turn, removed=removed) for turn in turns]
    np.testing.assert_allclose(found, exact, atol=2e-3 * np.abs(exact).max())
    pitch = gj.Scene(system, {"pitch": errors["pitch"]})
    found = gj.transmission_error(pitch, turns).te
    exact = [flat.wheel_turn(turn, removed=displaced) for turn in turns]
    np.testing.assert_allclose(found, exact, atol=2e-3 * np.abs(exact).max())


@pytest.mark.parametrize("name", ["spur", "spur ring"])
@pytest.mark.parametrize("end", ["begin", "end"])
def test_corners_stand_where_curves_say(name, end):
    """Beyond the path of contact: the turn of the wheel at which the corner of a tip touches, of one pair alone."""
    system = system_of(PAIRS[name], slices=1, tip_contact="corner")
    pair, side = system.pair, 1 if end == "end" else -1
    path, base = pair.contact_path, float(pair.gears[0].base_radius)
    beyond = 0.1 * float(pair.base_pitch)
    length = float(getattr(path, end)) + side * beyond
    turn = (length - float(path.pitch)) / base
    flat = FlatPair.of(pair)
    # the other pairs are out of the way when their flanks are taken back
    alone = flat.wheel_turn(turn, later=lambda tooth: 0.0 if tooth == 0 else 1e-3)
    pose, tooth = system.pose(jnp.asarray(turn), gj.Request()), system.points(jnp.asarray(turn), 1).tooth
    own = int(np.flatnonzero(np.asarray(tooth) == 0)[0])
    found = float(pose.gap[own] / pose.jacobian[own, 0])
    assert found < -1e-6
    assert found == pytest.approx(alone, rel=0.02)


# over the plane of action


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
def test_shares_of_slices_make_up_the_contact_lines(name, rng):
    """Partial slices lose nothing: their length is the closed form's at any angle, of both flanks."""
    system = system_of(PAIRS[name], slices=7)
    angles = jnp.asarray(rng.uniform(-9, 9, 40))
    slices = jax.vmap(lambda angle: system.pose(angle, gj.Request(back=True, slices=True)).slices[0])(angles)
    found = np.asarray(jax.vmap(lambda one: one.lengths)(slices)).reshape(40, 2, -1).sum(axis=-1)
    expected = system.pair.contact_line_length(angles)
    if system.pair.overlap_ratio > 0.1:  # the sum of spur gears jumps: what is a slice in it is a jump's width
        np.testing.assert_allclose(found[:, 0], expected, rtol=1e-9)
    else:
        assert np.mean(np.abs(found[:, 0] / expected - 1) < 1e-9) > 0.95
    # back flanks, by symmetry: the wheel turned back, and by the thickness of the teeth
    first = system.pair.gears[0]
    thickness = 2 * float(first.half_angle(first.base_radius / jnp.cos(system.pair.working_pressure_angle)))
    mirrored = np.asarray(system.pair.contact_line_length(thickness - angles))
    assert np.mean(np.abs(found[:, 1] / mirrored - 1) < 1e-9) > 0.95


@pytest.mark.slow
def test_back_flanks_carry_as_driving_ones_do():
    """The pair turned back under the torque turned round is the mirror image of itself, another hand of helix too."""
    play = {"backlash": gj.InitialBacklash(0.0), "compliance": TEETH, "slices": 10}
    ahead, back = scene_of(GUO_1, **play), scene_of(GUO_1 | {"helix_angle": -GUO_1["helix_angle"]}, **play)
    first = ahead.system.pair.gears[0]
    thickness = 2 * float(first.half_angle(first.base_radius / jnp.cos(ahead.system.pair.working_pressure_angle)))
    turns = meshes_of(ahead.system, 9)
    found = gj.transmission_error(ahead, turns, torque=-500.0)
    other = gj.transmission_error(back, (thickness - turns)[::-1], torque=500.0)
    lever = float(ahead.system.pair.gears[1].base_radius)
    apart = np.asarray(found.te) + np.asarray(other.te)[::-1]
    np.testing.assert_allclose(apart, float(ahead.system.pair.backlash) / lever, atol=1e-9 * abs(found.te).max())


def test_wrenches_are_those_of_the_published_vector():
    """At the tangent point and in the middle of the face the columns are V of Guo and Fang, eq. 25, per turn."""
    system = system_of(GUO_1, slices=1)
    ways = ("x", "y", "z", "rx", "ry", "rz")
    asked = [f"{body}.{way}" for body in system.bodies for way in ways[: 6 - (body == "wheel")]]
    request, pair = gj.Request(coordinates=tuple(asked)), system.pair
    alpha, beta = float(pair.working_pressure_angle), float(pair.base_helix_angle)
    sine, cosine, lean, flat = math.sin(alpha), math.cos(alpha), math.sin(beta), math.cos(beta)
    for turn in (0.0, 0.2, -0.4):
        pose, at = system.pose(jnp.asarray(turn), request), system.points(jnp.asarray(turn), 1)
        bases = [float(gear.base_radius) for gear in pair.gears]
        rolls, places = np.asarray(at.roll).reshape(2, -1).T, np.asarray(at.across).ravel()
        for found, roll, place in zip(np.asarray(pose.jacobian), rolls, places, strict=True):
            # V has the moments at the tangent points, in the middle of the face: from there a contact is its roll away
            # along the line of action, and its place along the face
            turned = [(sine * base - cosine * own) * lean for base, own in zip(bases, roll, strict=True)]
            tipped = [(cosine * base + sine * own) * lean for base, own in zip(bases, roll, strict=True)]
            first = [turned[0] - place * cosine * flat, tipped[0] + place * sine * flat, bases[0] * flat]
            second = [turned[1] + place * cosine * flat, tipped[1] - place * sine * flat]
            pushed = [sine * flat, cosine * flat, -lean]
            expected = [-bases[1] * flat, *pushed, *first, *(-one for one in pushed), *second]
            np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.slow
def test_axial_bearings_are_turns_along_the_helix():
    """A right-hand pinion that moves along its axis by dz is turned by -dz tan beta_b / r_b: the same flanks."""
    for sign in (1, -1):
        system = system_of(GUO_1 | {"helix_angle": sign * GUO_1["helix_angle"]}, slices=3)
        pose = system.pose(jnp.asarray(0.1), gj.Request(coordinates=("pinion.z", "pinion.rz")))
        _, along, turned = np.asarray(pose.jacobian).T
        lean = math.tan(float(system.pair.base_helix_angle)) / float(system.pair.gears[0].base_radius)
        np.testing.assert_allclose(along, -lean * turned, rtol=1e-12)


@pytest.mark.slow
def test_a_tilted_gear_is_a_slope_across_the_face():
    """Turned about the line of action, a spur gear's slices come nearer in proportion to their place."""
    system = system_of(SPUR, slices=5)
    pose = system.pose(jnp.asarray(0.0), gj.Request(coordinates=("pinion.rx", "pinion.ry")))
    alpha = float(system.pair.working_pressure_angle)
    places = np.tile(np.asarray(system.points(jnp.asarray(0.0), 1).across[0]), system.pairs)
    # about the normal in the plane nothing moves along it; across it by the place
    across = pose.jacobian[:, 1:] @ np.array([-math.cos(alpha), math.sin(alpha)])
    np.testing.assert_allclose(across, places, atol=1e-12)
    np.testing.assert_allclose(pose.jacobian[:, 1:] @ np.array([math.sin(alpha), math.cos(alpha)]), 0, atol=1e-12)


# errors over the face


@pytest.mark.slow
def test_errors_across_the_face_are_what_they_say():
    system = system_of(GUO_1, slices=8)
    normal = math.cos(float(system.pair.base_helix_angle))
    view = system.pose(jnp.asarray(0.07), gj.Request(bodies=("wheel",))).views["wheel"]
    across, width = np.asarray(view.flank.across), 75 * mm
    high, low = (np.clip(1 - (width / 2 + sign * across) / (20 * mm), 0, 1) for sign in (-1, 1))
    expected = [
        (gj.HelixSlope("wheel", 3 * um), -3 * um * across / width),
        (gj.Crowning("wheel", 4 * um), 4 * um * (2 * across / width) ** 2),
        (gj.EndRelief("wheel", 5 * um, 20 * mm, 2, "high"), 5 * um * high**2),
        (gj.EndRelief("wheel", 5 * um, 20 * mm), 5 * um * (high + low)),
    ]
    for error, gap in expected:
        np.testing.assert_allclose(error.gap(view), gap * normal, atol=1e-15)


@pytest.mark.parametrize("error", [gj.HelixSlope("gear_1", 3 * um), gj.Crowning("gear_1", 3 * um)])
def test_gears_without_slices_refuse_errors_across_the_face(error):
    scene = gj.load("configs/involute_rv/yang_2019.toml")
    with pytest.raises(gj.ParameterError, match="which this error needs"):
        gj.Scene(scene.system, {"face": error})


@pytest.mark.slow
def test_a_tilt_of_the_load_along_the_face_follows_the_helix_slope():
    """Spur gears of a stiffness per length: forces rise across the face by ``k' slope / b``."""
    law = gj.LineStiffness(10e9)
    scene = scene_of(SPUR, {"slope": gj.HelixSlope("pinion", 2 * um)}, law, slices=10)
    found = np.asarray(gj.transmission_error(scene, np.zeros(1), torque=500.0).forces[0]).reshape(-1, 10)
    carrying = found[found.sum(axis=1) > 0]
    steps = np.diff(carrying, axis=1)
    np.testing.assert_allclose(steps, 10e9 * 2.5 * mm * 2 * um / 10, rtol=1e-9)


# on bearings, and as one contact


@pytest.mark.slow
def test_bearings_take_the_components_of_the_force_along_the_normal():
    """Both gears on five springs each: forces of Guo and Fang's V times F_n, and moments about both gears' middles that
    are alike where the load is in the middle of the face."""
    bearing = gj.Support(x=2e8, y=2e8, z=1e8, rx=1e7, ry=1e7)
    scene = dataclasses.replace(
        scene_of(GUO_1, compliance=TEETH, slices=6), supports={"pinion": bearing, "wheel": bearing}
    )
    te = gj.transmission_error(scene, meshes_of(scene.system, 3), torque=830.0)
    rigid = gj.transmission_error(dataclasses.replace(scene, supports={}), meshes_of(scene.system, 3), torque=830.0)
    pair = scene.system.pair
    alpha, beta = float(pair.working_pressure_angle), float(pair.base_helix_angle)
    force = 830.0 / float(pair.gears[1].base_radius) / math.cos(beta)
    pushed = np.array([math.sin(alpha) * math.cos(beta), math.cos(alpha) * math.cos(beta), -math.sin(beta)]) * force
    moved = dict(zip(te.coordinates, np.asarray(te.q).T, strict=True))
    for way, part, stiffness in zip("xyz", pushed, (2e8, 2e8, 1e8), strict=True):
        np.testing.assert_allclose(moved[f"pinion.{way}"], -part / stiffness, rtol=1e-9)  # pushed back by the wheel
        np.testing.assert_allclose(moved[f"wheel.{way}"], part / stiffness, rtol=1e-9)
    # virtual work: what the output gives way by is what all springs take
    work = 2 * ((pushed**2) / (2e8, 2e8, 1e8)).sum() + sum(
        1e7 * moved[f"{body}.{way}"] ** 2 for body in ("pinion", "wheel") for way in ("rx", "ry")
    )
    softer = (np.asarray(rigid.te) - np.asarray(te.te)) * 830.0
    np.testing.assert_allclose(softer, work, rtol=0.02)  # teeth are loaded a little otherwise along the face


@pytest.mark.slow
def test_slices_move_as_one_contact_and_are_refused_with_a_stiffness_per_pair():
    moving = {"load": gj.ConstantLoad(), "inertia": gj.MomentOfInertia(0.39), "damping": gj.DampingRatio(0.07)}
    per_pair = gj.HarmonicStiffness(8e8, jnp.zeros(0), jnp.zeros(0))
    for slices in (6, 1):
        scene = dataclasses.replace(scene_of(GUO_1, compliance=per_pair, slices=slices), **moving)
        with pytest.raises(gj.SceneError, match="one_contact"):
            gj.simulate(scene, np.linspace(0.0, 0.1, 11), torque=830.0)
    scene = dataclasses.replace(scene_of(GUO_1, compliance=TEETH, slices=6), **moving)
    one = gj.one_contact(scene, 830.0)
    assert one.error(830.0) < 2e-3 * gj.units.arcmin


@pytest.mark.slow
def test_slices_share_the_stiffness_of_their_pair():
    """Of spur teeth all slices touch at once: however many there are, a pair is as stiff as it is said to be."""
    angles = meshes_of(system_of(SPUR, slices=1), 24) + 0.003
    per_pair = gj.HarmonicStiffness(3e8, jnp.zeros(0), jnp.zeros(0))
    one, few, many = (
        np.asarray(gj.transmission_error(scene_of(SPUR, compliance=per_pair, slices=slices), angles, 200.0).te)
        for slices in (1, 4, 40)
    )
    np.testing.assert_allclose(few, one, rtol=1e-12)
    np.testing.assert_allclose(many, one, rtol=1e-12)
    base = float(system_of(SPUR).pair.gears[1].base_radius)
    pairs = 200.0 / base / (3e8 * -one * base)
    np.testing.assert_allclose(pairs, np.round(pairs), rtol=1e-9)
    assert set(np.round(pairs)) == {1.0, 2.0}


# gradients


NUMBERS = {
    "errors.tip.amount": 20 * um,
    "errors.crowning.amount": 12 * um,
    "system.helix_angle": 9.9 * deg,
    "compliance.youngs_modulus": 206e9,
}


@pytest.mark.slow
@pytest.mark.parametrize("coupled", [None, 1.5])
def test_gradients_are_those_of_differences(coupled):
    """Of the mean and the swing of the loaded error, under jit and vmap over torques."""
    errors = {"tip": gj.TipRelief("pinion", 20 * um, 8 * mm), "crowning": gj.Crowning("pinion", 12 * um)}
    given = {key: value for key, value in GUO_1.items() if key != "centre_distance"}
    scene = scene_of(given, errors, dataclasses.replace(TEETH, coupling_length=coupled), slices=6)
    angles = jnp.asarray(meshes_of(scene.system, 5) + 0.003)

    def found(values, torque):
        tip, crowning = (dataclasses.replace(errors[key], amount=values[f"errors.{key}.amount"]) for key in errors)
        system = dataclasses.replace(scene.system, helix_angle=values["system.helix_angle"])
        compliance = dataclasses.replace(scene.compliance, youngs_modulus=values["compliance.youngs_modulus"])
        own = gj.Scene(system, {"tip": tip, "crowning": crowning}, compliance=compliance)
        te = gj.transmission_error(own, angles, torque).te
        return jnp.stack([te.mean(), jnp.sum(te * jnp.cos(19 * angles))])

    values = {
        key: jnp.asarray([value]) if key.startswith("errors") else jnp.asarray(value) for key, value in NUMBERS.items()
    }
    torques = jnp.asarray([300.0, 830.0])
    slopes = jax.jit(jax.vmap(jax.jacrev(found), in_axes=(None, 0)))(values, torques)
    batch = jax.jit(jax.vmap(found, in_axes=(None, 0)))
    for key, value in NUMBERS.items():
        step = 1e-5 * value
        ends = [batch(values | {key: values[key] + sign * step}, torques) for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        found_here = slopes[key].reshape(expected.shape)
        np.testing.assert_allclose(found_here, expected, rtol=2e-6, atol=1e-9 * abs(expected).max())


# extremes


@pytest.mark.parametrize("given", PAIRS.values(), ids=PAIRS)
@pytest.mark.parametrize("corner", ["ends", "corner"])
@pytest.mark.parametrize("torque", [1e-3, 1.0, 1e4])
def test_all_torques_find_an_equilibrium(given, corner, torque):
    scene = scene_of(given, compliance=TEETH, slices=5, tip_contact=corner)
    te = gj.transmission_error(scene, meshes_of(scene.system, 7), torque=torque)
    assert not np.asarray(te.result).any()
    lever = float(scene.system.pair.gears[1].base_radius * jnp.cos(scene.system.pair.base_helix_angle))
    np.testing.assert_allclose(np.asarray(te.forces).sum(axis=1) * lever, torque, rtol=1e-9)


@pytest.mark.slow
def test_teeth_from_5_to_500_and_a_ratio_of_one():
    few = {"normal_module": 2 * mm, "normal_pressure_angle": 20 * deg, "helix_angle": 25 * deg, "face_width": 30 * mm}
    for teeth, shifts in (((8, 500), (0.5, 0.0)), ((30, 30), (0.0, 0.0)), ((500, 500), (0.0, 0.0)), ((60, 20), (0, 0))):
        scene = scene_of(
            {"teeth": teeth, "profile_shifts": shifts, **few}, compliance=gj.ToothSlices(**STEEL), slices=4
        )
        te = gj.transmission_error(scene, meshes_of(scene.system, 5), torque=50.0)
        assert not np.asarray(te.result).any()
        assert (np.asarray(te.te) < 0).all()


@pytest.mark.slow
def test_single_precision_follows():
    scene = scene_of(GUO_1, {"crowning": gj.Crowning("pinion", 12 * um)}, TEETH, slices=10)
    turns = meshes_of(scene.system, 9)
    exact = gj.transmission_error(scene, turns, torque=830.0).te
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    found = gj.transmission_error(single, jnp.asarray(turns, jnp.float32), torque=830.0).te
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, exact, atol=1e-3 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pinion_shift": -0.9}, "pinion_shift.*undercut"),
        ({"wheel_kind": "ring"}, "wheel_kind"),
        ({"face_width": 75.0}, "face_width.*at most 10 m"),
        ({"centre_distance": 260 * mm}, "centre_distance"),
        ({"pinion_tip_diameter": 150 * mm}, r"pinion_tip_diameter[^(]*$"),
        ({"wheel_shift": 2.5, "wheel_tip_diameter": None}, r"wheel_tip_diameter.*\(the diameter follows from"),
        ({"slices": 0}, "slices"),
        ({"pairs": 2}, "pairs.*at least 3"),
    ],
)
def test_gears_that_cannot_be_are_refused(changes, words):
    with pytest.raises(gj.ParameterError, match=words):
        system_of(GUO_1, **changes)


def test_a_wider_copy_of_a_gear_set_is_refused_where_more_pairs_touch():
    narrow = system_of(GUO_1)
    with pytest.raises(gj.ParameterError, match=r"pairs.*at least 4"):
        dataclasses.replace(narrow, face_width=200 * mm)
    assert dataclasses.replace(narrow, face_width=200 * mm, pairs=None).pairs == 4


def test_parts_that_do_not_go_together_are_refused():
    with pytest.raises(gj.SceneError, match=r"line_stiffness.*slices.*two_kv"):
        dataclasses.replace(gj.load("configs/two_kv/wang_2020.toml"), compliance=gj.LineStiffness(14e9))
    with pytest.raises(gj.SceneError, match=r"elastic_teeth.*helical_pair"):
        scene_of(GUO_1, compliance=gj.ElasticTeeth(206e9, 0.3, 75 * mm, 75 * mm))
    with pytest.raises(gj.ParameterError, match=r"contact.*coupling_length"):
        gj.ToothSlices(**STEEL, coupling_length=1.5, contact="hertz")
    with pytest.raises(gj.ParameterError, match="pinion_bore"):
        scene_of(GUO_1, compliance=gj.ToothSlices(**STEEL, pinion_bore=100 * mm))
