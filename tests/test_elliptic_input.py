"""What elliptic and other non-circular pairs may be: what is refused, and with which words; extremes; precision."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import ParameterError, SceneError
from gearjax.geometry import ratio_table
from gearjax.geometry.noncircular import EllipseRatio
from gearjax.units import arcmin, deg, um
from tests.conftest import ROOT
from tests.elliptic import MODULE, TEETH, E
from tests.test_elliptic_pair import MOVING, THETA, pair, scene

TABLE = [1.4, 1.28, 1.0, 0.72, 0.6, 0.72, 1.0, 1.28]


def by_table(ratio, **changes) -> gj.NoncircularPair:
    given = {"teeth": 48, "module": MODULE, "ratio": ratio, "input_speed": 20.0} | changes
    return gj.NoncircularPair(**given)


REFUSED = [
    ({"eccentricity": 0.70711}, 'eccentricity = "0.70711": self-locking: pressure angle 65.0003 deg at 45 deg'),
    ({"eccentricity": 0.8}, "must be at most 65 deg, a tangent inclined by 45 deg: eccentricity at most 0.7071"),
    ({"eccentricity": 0.77, "pressure_angle": 15 * deg, "teeth": 80}, "eccentricity at most 0.7660"),
    ({"eccentricity": 0.5, "driver_lobes": 2, "driven_lobes": 2, "teeth": 48}, "eccentricity at most 0.4472"),
    ({"eccentricity": 1.0}, "below 1"),
    ({"eccentricity": -0.1}, "at least 0"),
    (
        {"centre_distance": 0.15},
        "458.2401 mm long, its 47 teeth 442.96456 mm: it closes with centre_distance = 144.99972 mm",
    ),
    ({"centre_distance": 0.15}, "or module = 3.10345"),
    ({"centre_distance": 0.15}, "or eccentricity = 0.47862625"),
    (
        {"teeth": 3, "eccentricity": 0.0},
        "undercut: the pitch curve of the driver is curved outwards with a radius of 4.5 mm at 0 deg, must be",
    ),
    ({"teeth": 3, "eccentricity": 0.0}, "must be at least 25.6459 mm: give more teeth"),  # no addendum would help
    ({"teeth": 12, "eccentricity": 0.0}, "give more teeth, or an addendum of at most 0.7018"),
    ({"teeth": 3, "eccentricity": 0.0, "addendum": 0.17}, "must be at least 1: give more teeth"),
    (
        {"teeth": 90, "module": 2e-3, "eccentricity": 0.3, "driver_lobes": 3, "driven_lobes": 2},
        "times as deep as flanks of the driven gear go, at",
    ),
    (
        {"input_speed": -20.0},
        "rpm: gears that turn backwards turn forwards, seen from behind: give the size of the speed",
    ),
    (
        {"teeth": 47, "driver_lobes": 2},
        "would have 23.5 teeth, must be a whole number: give a multiple of 2",
    ),
    ({"addendum": 2.2, "teeth": 120}, "modules thick, must be 0.05 or more: lower the addendum"),
    ({"addendum": 0.35}, "no continuous contact: contact ratio"),
    ({"clearance": "fine"}, "exact"),
    ({"teeth": 47, "driver_lobes": 4, "driven_lobes": 2}, "give a multiple of 2"),
    ({"pressure_angle": 22.5 * deg, "eccentricity": 0.68}, "at most 0.6755"),
    (
        {"teeth": 144, "module": 1e-3, "eccentricity": 0.15, "driver_lobes": 6, "driven_lobes": 6},
        "undercut: the pitch curve of the driver is curved inwards with a radius of 14",
    ),
]


@pytest.mark.parametrize(("changes", "words"), REFUSED)
def test_gears_that_cannot_be(changes, words):
    with pytest.raises(ParameterError) as caught:
        pair(**changes)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("ratio", "changes", "words"),
    [
        (
            [1.5, 1.28, 1.0, 0.72, 0.6, 0.72, 1.0, 1.28],
            {},
            "stays open: the mean is 1.0125, must be 1 (driver_lobes / driven_lobes): multiply by 0.98765",
        ),
        (TABLE, {"driven_lobes": 2}, "the mean is 1, must be 0.5"),
        ([-0.1, *TABLE[1:]], {}, "above 0"),
        (TABLE[:5], {}, "must be a list of 8 values or more"),
        ([1.2, 1.2, 1.2, 1.2, 0.8, 0.8, 0.8, 0.8] * 3, {}, "has a corner or a jump near"),
        ((1 + 0.3 * (2 * np.abs(np.arange(36) / 18 - 1) - 1)).tolist(), {}, "has a corner or a jump near"),
        ((1 + 0.2 * (2 * np.abs((np.arange(36) + 0.5) / 18 - 1) - 1)).tolist(), {}, "or a jump near 175 deg"),
        (1 + 0.05 * (np.abs(np.sin(np.arange(72) * 2.5 * deg)) - 0.63652), {}, "a corner or a jump near 0 deg"),
        *[
            (1 + 0.3 * np.cos(np.linspace(0.0, 2 * np.pi, number)), {}, "the same point of the lobe: leave the last")
            for number in (13, 37, 361)
        ],
        ((1 + 0.9 * np.cos(np.arange(36) * 10 * deg)).tolist(), {}, 'ratio = "(as given)": self-locking'),
    ],
)
def test_ratios_that_cannot_be(ratio, changes, words):
    with pytest.raises(ParameterError) as caught:
        by_table(ratio, **changes)
    assert words in str(caught.value)


@pytest.mark.parametrize("number", [64, 100, 720])
def test_corners_anywhere_on_smooth_tables(number, rng):
    """The table turns by a tenth of its swing per radian or more at a random place, between its values too."""
    t = 2 * np.pi * np.arange(number) / number
    for _ in range(20):
        smooth = 1 + 0.1 * np.cos(t + rng.uniform(0, 6)) + 0.05 * np.cos(2 * t + rng.uniform(0, 6))
        place = rng.uniform(0, number)
        away = np.mod(np.arange(number) - place, number) * 2 * np.pi / number
        turned = smooth + 0.15 * rng.choice([-1, 1]) * (away * (2 * np.pi - away) / (2 * np.pi) - np.pi / 3)
        found = list(ratio_table.faults(turned / turned.mean(), 1, 1))
        assert len(found) == 1
        near = float(found[0].split(" deg")[0].split()[-1]) * number / 360
        assert abs(np.mod(near - place + number / 2, number) - number / 2) <= 1.5
        assert not list(ratio_table.faults(smooth / smooth.mean(), 1, 1))


@pytest.mark.parametrize("decimals", [3, 4, 6, 12])
@pytest.mark.parametrize("number", [8, 13, 20, 50, 200, 720])
def test_rounded_values_have_no_corners(number, decimals, rng):
    t = 2 * np.pi * (np.arange(number) + 0.5) / number  # its first and its last value are equal
    for _ in range(10):
        table = 1 + rng.uniform(0.05, 0.4) * np.cos(t)
        assert not list(ratio_table.faults(np.round(table, decimals), 1, 1))


def test_turning_backwards_is_turning_forwards_seen_from_behind():
    """Levers and gaps of the back flanks at the angle -t are those of driving flanks at t, as the message says."""
    t = jnp.asarray(np.linspace(0.1, 6.0, 9))
    ratio = 1 + 0.3 * np.cos(np.arange(36) * 10 * deg + 0.4)
    behind = np.roll(ratio[::-1], 1)
    errors = {body: gj.Eccentricity(body, 30 * um, phase) for body, phase in (("driver", 0.3), ("driven", -1.1))}
    mirrored = {body: dataclasses.replace(error, phase=-error.phase) for body, error in errors.items()}
    one = gj.Scene(by_table(ratio, teeth=47), errors, backlash=gj.InitialBacklash(60 * um))
    other = gj.Scene(by_table(behind, teeth=47), mirrored, backlash=gj.InitialBacklash(60 * um))
    for angle in t:
        back, drive = one.contacts(-angle), other.contacts(angle)
        assert float(back.lever[1]) == pytest.approx(-float(drive.lever[0]), rel=1e-12)
        assert float(back.gap[1]) - 60 * um == pytest.approx(float(drive.gap[0]), abs=1e-17)


@pytest.mark.parametrize("number", [36, 48, 64, 72])
@pytest.mark.parametrize("e", [0.2, 0.5, 0.7])
def test_smooth_tables_pass(e, number):
    ratio = EllipseRatio(jnp.asarray(e)).rates(jnp.asarray(np.arange(number) * 2 * np.pi / number))[0]
    by_table(ratio, teeth=47)


@pytest.mark.slow
def test_a_table_of_an_ellipse_is_the_ellipse():
    ratio = EllipseRatio(jnp.asarray(E)).rates(jnp.asarray(np.arange(96) * 2 * np.pi / 96))[0]
    own = scene(**MOVING)
    other = dataclasses.replace(own, system=by_table(ratio, teeth=TEETH))
    for torque in (None, 15.0):
        one, two = (gj.transmission_error(each, THETA, torque).te for each in (own, other))
        np.testing.assert_allclose(one, two, atol=1e-10)


def test_a_configuration_that_turns_backwards_is_told_the_same():
    text = (ROOT / "configs" / "elliptic" / "dong_2020.toml").read_text(encoding="utf-8")
    text = re.sub(r'input_speed = "[^"]*"', 'input_speed = "-600 rpm"', text)
    with pytest.raises(ParameterError, match=r'input_speed = "-600 rpm": must be at least .* seen from behind'):
        gj.loads(text)
    fast = text.replace('"-600 rpm"', '"1e9 rpm"')
    with pytest.raises(ParameterError) as caught:
        gj.loads(fast)
    assert "backwards" not in str(caught.value)


def test_slots_that_do_not_go_together():
    with pytest.raises(SceneError, match=r"\[reference\] counts errors to first order"):
        scene(system={"clearance": "exact"}, reference=gj.ZeroAtStart())
    with pytest.raises(SceneError, match='use clearance = "linear"'):
        scene(system={"clearance": "exact"}, supports={"driver": gj.Support(x=1e8)}, **MOVING)
    with pytest.raises(ParameterError, match="driver"):
        gj.Scene(pair(), {"one": gj.Eccentricity("drive", 1e-5, 0.0)})


def test_negative_torques_and_no_backlash():
    with pytest.raises(SceneError, match="loads the back flanks, which this scene lacks"):
        gj.transmission_error(scene(compliance=gj.HarmonicStiffness(1e8, [], [])), THETA, -1.0)


@pytest.mark.slow
@pytest.mark.parametrize("e", [0.0, 0.7071])
@pytest.mark.parametrize("clearance", ["linear", "exact"])
def test_extremes_of_eccentricity(e, clearance):
    gears = scene((3e-3, 3e-3), {"eccentricity": e, "clearance": clearance, "teeth": 300}, **MOVING)
    te = gj.transmission_error(gears, THETA, 15.0)
    assert np.isfinite(np.asarray(te.te)).all()
    assert float(jnp.abs(te.te).max()) > 1e-3


@pytest.mark.slow
def test_speed_at_which_inertia_alone_exceeds_the_load():
    """Twenty times the speed of separation: teeth hammer from flank to flank, numbers stay finite, all of the way."""
    gears = scene(system={"input_speed": 600.0}, **MOVING)
    motion = gj.simulate(gears, np.linspace(0.0, 0.05, 201), 10.0, stepper=gj.FixedStep(1e-6))
    assert int(motion.result) == 0
    forces = np.asarray(motion.forces)
    assert np.isfinite(np.asarray(motion.te)).all()
    assert (forces[:, 0] > 0).any()
    assert (forces[:, 1] > 0).any()
    assert np.ptp(np.asarray(motion.te)) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", ["elliptic/dong_2020.toml", "rv_cycloidal/hu_2020.toml"])
def test_exact_clearances_in_float32_do_not_lose_digits_with_every_turn(name):
    """After 100 turns of the output the TE of the elliptic pair was .2 arcmin off, that of the RV reducer .13."""
    scene = gj.load(ROOT / "configs" / name)
    scene = dataclasses.replace(scene, system=dataclasses.replace(scene.system, clearance="exact"))
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    angles = np.linspace(0.1, 6.0, 7)
    far = np.asarray(angles + 200 * np.pi / scene.system.orders["output"])
    known, near = (np.asarray(gj.transmission_error(each, angles).te, float) for each in (scene, single))
    later = np.asarray(gj.transmission_error(single, jnp.asarray(far, jnp.float32)).te, float)
    assert np.abs(near - known).max() < 0.01 * arcmin
    assert np.abs(later - known).max() < 0.01 * arcmin


@pytest.mark.slow
@pytest.mark.parametrize("clearance", ["linear", "exact"])
def test_float32(clearance):
    """Off by some 1e-6 of a radius that is read at the angle of the teeth: 0.01 arcmin, of 7."""
    gears = scene((50 * um, 50 * um), {"clearance": clearance})
    single = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), gears)
    one, other = (gj.transmission_error(each, THETA).te for each in (gears, single))
    assert other.dtype == jnp.float32
    assert float(jnp.abs(one - jnp.asarray(other, jnp.float64)).max()) < 4e-6
