"""Geometry of two gears on parallel axes: published pairs; involutes and contact lines written out apart from it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.checks import ParameterError
from gearjax.geometry import BasicRack, InvoluteGear
from gearjax.geometry.helical_checks import faults, misfits
from gearjax.geometry.helical_pair import ISO_53, rack_of, racks_of
from gearjax.geometry.internal_pair import InternalPair
from gearjax.units import deg, mm
from tests.helical_pairs import GUO_1, GUO_2, INTERNAL, SPUR, pair_of

TABLES = {  # of both pairs of Guo and Fang (2018), as worked out apart from gearjax
    "guo_1": (
        GUO_1,
        {
            "transverse_pressure_angle": 20.2785 * deg,
            "base_helix_angle": 9.3078 * deg,
            "base_diameters": (2 * 54.2771 * mm, 2 * 134.2644 * mm),
            "tip_diameters": (2 * 63.8635 * mm, 2 * 149.1361 * mm),
            "root_diameters": (2 * 50.3635 * mm, 2 * 135.6361 * mm),
            "base_pitch": 17.9491 * mm,
            "transverse_contact_ratio": 1.6107,
            "overlap_ratio": 0.6848,
            "total_contact_ratio": 2.2955,
            "tight_centre_distance": 200.9997 * mm,
        },
        28.9105 * mm,
    ),
    "guo_2": (
        GUO_2,
        {
            "transverse_pressure_angle": 21.8802 * deg,
            "base_helix_angle": 23.3990 * deg,
            "base_diameters": (2 * 25.5974 * mm, 2 * 51.1948 * mm),
            "tip_diameters": (2 * 30.0844 * mm, 2 * 57.6689 * mm),
            "root_diameters": (2 * 24.4594 * mm, 2 * 52.0439 * mm),
            "base_pitch": 8.0417 * mm,
            "transverse_contact_ratio": 1.4319,
            "overlap_ratio": 2.1524,
            "total_contact_ratio": 3.5843,
        },
        11.5150 * mm,
    ),
}
LONG_WHEEL = ("ISO 53 A", BasicRack(1.2, 1.25))
PAIRS = {"guo_1": GUO_1, "guo_2": GUO_2, "spur": SPUR, "internal": INTERNAL}


@pytest.mark.parametrize("name", TABLES)
def test_published_pairs(name):
    given, table, path = TABLES[name]
    pair = pair_of(**{**given, "centre_distance": None})
    for key, wanted in table.items():
        np.testing.assert_allclose(getattr(pair, key), wanted, rtol=1e-4, err_msg=key)
    np.testing.assert_allclose(pair.contact_path.end - pair.contact_path.begin, path, rtol=1e-4)


def line_lengths(pair, angles, slices=4001):
    """Length of the contact lines [m], by counting the pairs of teeth in contact in thin slices of the face."""
    width, slope = float(pair.face_width), np.tan(float(pair.base_helix_angle))
    middles = width * ((np.arange(slices) + 0.5) / slices - 0.5)
    path, pitch = pair.contact_path, float(pair.base_pitch)
    reached = float(pair.gears[0].base_radius) * np.asarray(angles)[:, None, None] + float(path.pitch)
    places = reached + middles[:, None] * slope + pitch * np.arange(-20, 21)
    touching = (places >= float(path.begin)) & (places <= float(path.end))
    return touching.sum((1, 2)) * width / slices / np.cos(float(pair.base_helix_angle))


@pytest.mark.parametrize("name", PAIRS)
def test_contact_line_length_counts_the_pairs_of_each_slice(name):
    pair = pair_of(**PAIRS[name])
    angles = np.linspace(0.0, 2.2 * np.pi / pair.teeth[0], 37) + 0.0123
    wanted = line_lengths(pair, angles)
    lengths = pair.contact_line_length(jnp.asarray(angles))
    np.testing.assert_allclose(lengths, wanted, rtol=0, atol=4e-4 * wanted.mean())


@pytest.mark.parametrize("name", ["guo_1", "guo_2"])
def test_harmonics_of_the_contact_line_length(name):
    """``2 sinc(n eps_alpha) sinc(n eps_beta)`` of the mean, which is ``b eps_alpha / cos beta_b``."""
    pair = pair_of(**PAIRS[name])
    count = 4096
    angles = 2 * np.pi / pair.teeth[0] * np.arange(count) / count
    waves = np.fft.rfft(pair.contact_line_length(jnp.asarray(angles))) / count
    mean = float(pair.face_width * pair.transverse_contact_ratio / jnp.cos(pair.base_helix_angle))
    orders = np.arange(1, 9)
    wanted = 2 * np.sinc(orders * float(pair.transverse_contact_ratio)) * np.sinc(orders * float(pair.overlap_ratio))
    np.testing.assert_allclose(waves[0].real, mean, rtol=1e-5)
    np.testing.assert_allclose(2 * np.abs(waves[1:9]) / mean, np.abs(wanted), atol=1e-6)


def involute_at(base, roll, turn):
    """Points of the involute of a base circle that turns, as complex numbers."""
    return base * (1 - 1j * roll) * np.exp(1j * (roll + turn))


@pytest.mark.parametrize("name", PAIRS)
def test_path_of_contact_is_where_both_involutes_are(name):
    """A flank of gear 1, turned until it meets the line of action, touches the tip circles there: at the end its own,
    at the beginning that of gear 2. The pitch point lies on the line of centres, at the ratio of the teeth."""
    pair = pair_of(**PAIRS[name])
    base, distance = float(pair.gears[0].base_radius), float(pair.centre_distance)
    working = float(pair.working_pressure_angle)

    def place(length):
        # the line of action touches base circle 1 at exp(i working) and runs backwards from there
        roll = length / base
        return involute_at(base, roll, working - roll)

    begin, pitch, end = (place(float(length)) for length in pair.contact_path)
    first, second = (0.5 * float(tip) for tip in pair.tip_diameters)
    # external gears have their centres on both sides of the pitch point, an internal pair on one
    centre = -distance if pair.internal else distance
    np.testing.assert_allclose(abs(end), first, rtol=1e-12)
    np.testing.assert_allclose(abs(begin - centre), second, rtol=1e-12)
    np.testing.assert_allclose(pitch.imag, 0.0, atol=1e-15)
    np.testing.assert_allclose(abs(pitch - centre) / abs(pitch), pair.teeth[1] / pair.teeth[0], rtol=1e-12)


@pytest.mark.parametrize("name", PAIRS)
def test_base_pitch_and_contact_ratio_of_the_flanks_themselves(name):
    """Two flanks of gear 1, a tooth apart, cross the line of action a base pitch apart; the contact ratio is the mean
    number of flanks on the path."""
    pair = pair_of(**PAIRS[name])
    base, path = float(pair.gears[0].base_radius), pair.contact_path
    working, step = float(pair.working_pressure_angle), 2 * np.pi / pair.teeth[0]
    turn = 0.3
    rolls = [working - turn - k * step for k in range(2)]
    points = [involute_at(base, roll, turn + k * step) for k, roll in enumerate(rolls)]
    np.testing.assert_allclose(abs(points[1] - points[0]), float(pair.base_pitch), rtol=1e-12)
    turns = working - np.linspace(0, step, 20000, endpoint=False)[:, None] - step * np.arange(-pair.teeth[0], 20)
    lengths = base * (working - turns)
    inside = (lengths >= float(path.begin)) & (lengths <= float(path.end))
    np.testing.assert_allclose(inside.sum(1).mean(), float(pair.transverse_contact_ratio), atol=1e-4)


def test_spur_is_the_limit_of_a_small_helix():
    spur = pair_of(**SPUR)
    nearly = pair_of(**{**SPUR, "helix_angle": 1e-5})
    for key in ("transverse_contact_ratio", "tight_centre_distance", "base_pitch", "root_diameters"):
        np.testing.assert_allclose(getattr(nearly, key), getattr(spur, key), rtol=1e-8, atol=1e-12, err_msg=key)
    angles = jnp.linspace(0, 0.5, 13)
    np.testing.assert_allclose(nearly.contact_line_length(angles), spur.contact_line_length(angles), rtol=1e-8)
    pairs = np.asarray(spur.contact_line_length(angles)) / float(spur.face_width)
    np.testing.assert_allclose(pairs, pairs.round(), atol=1e-8)  # whole teeth carry or do not


def test_spur_lengths_are_whole_in_single_precision():
    leaves = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), pair_of(**SPUR))
    pairs = leaves.contact_line_length(jnp.linspace(0.01, 0.4, 17, dtype=jnp.float32)) / leaves.face_width
    np.testing.assert_allclose(pairs, np.asarray(pairs).round(), atol=1e-5)


def test_hand_of_the_helix_changes_nothing():
    left, right = (pair_of(**{**GUO_2, "helix_angle": sign * GUO_2["helix_angle"]}) for sign in (-1, 1))
    assert float(left.overlap_ratio) == float(right.overlap_ratio)
    angle = jnp.asarray(0.1)
    np.testing.assert_allclose(left.contact_line_length(angle), right.contact_line_length(angle), rtol=1e-12)


def test_internal_pair_is_the_one_of_nearly_touching_flanks():
    pair = pair_of(**INTERNAL)
    scale = jnp.cos(pair.helix_angle)
    shared = pair.transverse_module, pair.transverse_pressure_angle
    shifts = [scale * shift for shift in pair.profile_shifts]
    external = InvoluteGear(pair.teeth[0], *shared, shifts[0], scale * 1.0, scale * 1.25)
    internal = InvoluteGear(pair.teeth[1], *shared, shifts[1], scale * 1.0, scale * 1.25, True)
    other = InternalPair(external, internal, pair.centre_distance)
    for key, wanted in {
        "transverse_contact_ratio": other.contact_ratio,
        "working_pressure_angle": other.operating_pressure_angle,
        "tight_centre_distance": other.tight_centre_distance,
        "backlash": other.backlash,
        "tangent_length": other.offset,
        "base_pitch": other.base_pitch,
    }.items():
        np.testing.assert_allclose(getattr(pair, key), wanted, rtol=1e-9, atol=1e-15, err_msg=key)
    np.testing.assert_allclose(pair.internal_pair.path, other.path, rtol=1e-12)


@pytest.mark.parametrize("given", [SPUR, GUO_2, INTERNAL])
def test_backlash_is_what_thinner_teeth_leave(given):
    """None at the tight centre distance; near it, twice the change of distance times the sine of the working angle."""
    tight = pair_of(**{**given, "centre_distance": None})
    np.testing.assert_allclose(tight.backlash, 0.0, atol=1e-15)
    apart = 1e-6 * mm * (-1 if tight.internal else 1)
    moved = pair_of(**{**given, "centre_distance": tight.centre_distance + apart})
    wanted = 2 * abs(apart) * float(jnp.sin(tight.working_pressure_angle))
    np.testing.assert_allclose(moved.backlash, wanted, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["guo_2", "internal"])
def test_gradients_are_those_of_differences(name):
    """Under vmap and jit, of every number."""
    given = PAIRS[name]
    keys = ("normal_module", "normal_pressure_angle", "helix_angle", "profile_shifts", "face_width", "centre_distance")
    names = ("transverse_contact_ratio", "overlap_ratio", "backlash", "working_pressure_angle", "root_diameters")

    def figures(values):
        shifts, rest = values[:2], dict(zip([key for key in keys if key != "profile_shifts"], values[2:], strict=True))
        pair = pair_of(**{**given, **rest, "profile_shifts": shifts})
        parts = [jnp.atleast_1d(jnp.asarray(getattr(pair, key))) for key in names]
        return jnp.concatenate([*parts, pair.contact_line_length(jnp.asarray([0.013, 0.047]))])

    start = jnp.asarray([*given["profile_shifts"], *(given[key] for key in keys if key != "profile_shifts")])
    sizes = jnp.maximum(jnp.abs(start), 0.1 * jnp.asarray([1.0, 1.0, *start[2:]]))
    many = jnp.stack([start, start + 1e-6 * sizes])
    slopes = jax.jit(jax.vmap(jax.jacfwd(figures)))(many)
    for at, slope in zip(many, slopes, strict=True):
        steps = np.asarray(1e-5 * sizes)
        ways = jnp.diag(jnp.asarray(steps))
        wanted = jax.vmap(lambda way, at=at: (figures(at + way) - figures(at - way)) / 2)(ways).T
        scale = np.abs(np.asarray(wanted)).max(1, keepdims=True)
        np.testing.assert_allclose(np.asarray(slope) * steps / scale, np.asarray(wanted) / scale, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ISO_53)
def test_racks_by_name(name):
    rack = rack_of(name)
    assert (float(rack.addendum), float(rack.dedendum), float(rack.fillet_radius)) == ISO_53[name]


def test_each_gear_may_have_its_own_rack():
    own = BasicRack(1.1, 1.4, 0.2)
    pair = pair_of(**{**GUO_1, "rack": ("ISO 53 D", own)})
    depths = [0.5 * float(a - b) / 6e-3 for a, b in zip(pair.tip_diameters, pair.root_diameters, strict=True)]
    np.testing.assert_allclose(depths, [2.4, 2.5], rtol=1e-12)


@pytest.mark.parametrize("rack", ["ISO 53 E", 3, ["ISO 53 A"] * 3, ["ISO 53 A", "A"], None])
def test_racks_that_are_none(rack):
    with pytest.raises(ParameterError, match="rack") as caught:
        racks_of(rack)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", PAIRS)
def test_good_pairs_have_no_faults(name):
    assert list(faults(pair_of(**PAIRS[name]))) == []


WRONG = {  # given, what differs, the parameter named, what it says
    "jam": (GUO_1, {"centre_distance": 200.0 * mm}, "centre_distance", "overlap by"),
    "inside the base circles": (GUO_1, {"centre_distance": 188.0 * mm}, "centre_distance", "base radii"),
    "apart": (GUO_1, {"centre_distance": 212.0 * mm}, "centre_distance", "no continuous contact"),
    "pointed": (SPUR, {"profile_shifts": (1.6, 0.0), "centre_distance": None}, "tip_diameters[0]", "pointed"),
    "tips in roots": (SPUR, {"tip_diameters": (69.0 * mm, 105.6 * mm)}, "tip_diameters[0]", "cut into the roots"),
    "undercut": (SPUR, {"teeth": (12, 40), "centre_distance": None}, "profile_shifts[0]", "undercut: with 12 teeth"),
    "interference": (
        SPUR,
        {
            "teeth": (18, 200),
            "profile_shifts": (0, 0),
            "centre_distance": None,
            "rack": ("ISO 53 A", BasicRack(1.2, 1.25)),
        },
        "tip_diameters[1]",
        "tip interference",
    ),
    "ring's tips": (INTERNAL, {"tip_diameters": (48.5 * mm, 132.0 * mm)}, "tip_diameters[1]", "must be at least 133.3"),
    "ring apart": (INTERNAL, {"centre_distance": 40.0 * mm}, "centre_distance", "base radii"),
}


@pytest.mark.parametrize("name", WRONG)
def test_faults_name_what_is_wrong(name):
    given, other, key, words = WRONG[name]
    told = list(faults(pair_of(**{**given, **other})))
    assert key in [fault[0] for fault in told], told
    assert any(words in fault[2] for fault in told if fault[0] == key), told
    assert not any("nan" in part or "\n" in part for fault in told for part in fault)


def test_undercut_begins_where_the_rack_says():
    """``z = 2 (h - x) / sin^2 alpha`` with the straight part h of the dedendum: one module of the ISO 53 racks."""
    least = 1 - 12 * np.sin(20 * deg) ** 2 / 2
    for shift, wrong in ((least + 0.005, False), (least - 0.005, True)):
        pair = pair_of(**{**SPUR, "teeth": (12, 40), "profile_shifts": (shift, 0.0), "centre_distance": None})
        assert any("undercut" in fault[2] for fault in faults(pair)) is wrong


def test_what_does_not_fit_is_told_before_what_the_rack_cuts_away():
    pair = pair_of(**{**SPUR, "teeth": (12, 40), "centre_distance": 40 * mm})
    assert [fault[0] for fault in misfits(pair)] == ["centre_distance"]


def test_tips_may_reach_as_far_as_is_told():
    """The largest tip circle that the message names is good, and one of 20 um more is not."""
    given, other, _, _ = WRONG["interference"]
    given = {**given, **other}
    words = next(fault[2] for fault in faults(pair_of(**given)) if "interference" in fault[2])
    most = float(words.split("at most ")[1].split()[0])
    own = float(pair_of(**given).tip_diameters[0])
    for tip, wrong in ((most - 0.001, False), (most + 0.02, True)):
        told = list(faults(pair_of(**{**given, "tip_diameters": (own, tip * mm)})))
        assert any("interference" in fault[2] for fault in told) is wrong, told
