"""Measured flanks and pitches: against formulas and closed forms, and as files tell them."""

import dataclasses
import inspect
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import ParameterError, SceneError
from gearjax.units import arcmin, mm, um
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, RING, SPUR, TEETH, meshes_of, scene_of

MEASURED = ROOT / "configs" / "helical" / "guo_2018_measured.toml"


def on_grid(system, number, deviation, rows=9, columns=7):
    """A measured flank from a function of the share of the way from the tip, and of the face from its middle."""
    pair = system.pair
    path, gear = pair.contact_path, pair.gears[number]
    tip = float(gear.base_radius * gear.tip_roll)
    inward = -1.0 if gear.internal else 1.0
    length = float(path.end - path.begin)
    s = np.linspace(1.0, 0.0, rows) if inward > 0 else np.linspace(0.0, 1.0, rows)
    z = np.linspace(-0.5, 0.5, columns)
    values = deviation(s[:, None], z[None, :]) * np.ones((rows, columns))
    return gj.MeasuredFlank(
        ("pinion", "wheel")[number], tip - inward * s * length, values.ravel(), z * float(system.face_width)
    )


@pytest.mark.slow
@pytest.mark.parametrize("given", [GUO_1, RING, SPUR], ids=["external", "internal", "spur"])
@pytest.mark.parametrize("number", [0, 1])
def test_a_grid_of_a_formula_is_the_formula(given, number):
    """Slopes and crowning are polynomials, which a spline goes through: no-load and loaded TE to rounding."""
    scene = scene_of(given, {}, TEETH, slices=8)
    body = scene.system.bodies[number]
    grid = on_grid(scene.system, number, lambda s, z: 5 * um * (0.5 - s) + 4 * um * z - 6 * um * (2 * z) ** 2)
    formulas = {
        "profile": gj.ProfileSlope(body, 5 * um),
        "helix": gj.HelixSlope(body, 4 * um),
        "crowning": gj.Crowning(body, 6 * um),
    }
    theta = meshes_of(scene.system, 5)
    for torque in (0.0, 300.0):
        both = [
            gj.transmission_error(dataclasses.replace(scene, errors=errors), theta, torque=torque).te
            for errors in ({"grid": grid}, formulas)
        ]
        np.testing.assert_allclose(*both, atol=1e-10 * arcmin)


@pytest.mark.slow
def test_teeth_have_their_own_flanks_and_others_the_mean():
    """A flank that is higher all over is a flank ahead: single teeth by their no-load TE, tooth by tooth."""
    scene = scene_of(GUO_1 | {"helix_angle": 0.0, "centre_distance": None}, {}, TEETH, slices=2)
    heights = np.array([3.0, 9.0]) * um
    values = np.repeat(heights, 4)
    flank = gj.MeasuredFlank("pinion", [1 * mm, 34 * mm], values, [-30 * mm, 30 * mm], teeth=[2, 5])
    each = np.full(19, heights.mean())
    each[[2, 5]] = heights
    own = gj.MeasuredFlank("pinion", [20 * mm], each)
    assert flank.grids == 2
    assert own.grids == 19
    theta = meshes_of(scene.system, 19, of=19.0) + 0.003
    found, expected = (
        gj.transmission_error(dataclasses.replace(scene, errors={"flank": one}), theta).te for one in (flank, own)
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)
    # of two pairs that may touch the higher one does: a tooth is ahead by its height over the wheel's base radius
    pair = scene.system.pair
    ahead = np.asarray(found) * float(pair.gears[1].base_radius) / um
    assert ahead.max() == pytest.approx(9.0, rel=1e-9)
    assert ahead.min() == pytest.approx(3.0, rel=1e-9)  # tooth 2, where it is alone


@pytest.mark.slow
def test_flanks_are_told_apart():
    scene = scene_of(GUO_1, {}, TEETH, gj.InitialBacklash(60 * um), slices=4)
    theta = meshes_of(scene.system, 5)
    plain = [gj.transmission_error(scene, theta, torque=torque).te for torque in (200.0, -200.0)]
    for place, flank in enumerate(("driving", "back")):
        high = gj.MeasuredFlank("pinion", [10 * mm], [8 * um], flank=flank)
        one = dataclasses.replace(scene, errors={"high": high})
        found = [gj.transmission_error(one, theta, torque=torque).te for torque in (200.0, -200.0)]
        np.testing.assert_allclose(found[1 - place], plain[1 - place], atol=1e-15)
        # pressed by the other gear either way: to the wheel it is ahead on driving flanks, behind on back flanks
        moved = (1, -1)[place] * 8 * um / float(scene.system.pair.gears[1].base_radius)
        np.testing.assert_allclose(found[place] - plain[place], moved, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("given", [GUO_1, RING], ids=["external", "internal"])
def test_a_common_pitch_deviation_is_a_turn(given):
    """A gear whose flanks are all ahead has turned by that over its reference radius."""
    scene = scene_of(given, {}, TEETH, slices=4)
    theta = meshes_of(scene.system, 3)
    plain = gj.transmission_error(scene, theta, torque=100.0).te
    radii = [float(diameter) / 2 for diameter in scene.system.pair.reference_diameters]
    ratio = scene.system.orders["output"]
    for body, turned in (("pinion", 3 * um / radii[0] * ratio), ("wheel", -3 * um / radii[1])):
        ahead = dataclasses.replace(scene, errors={"pitch": gj.MeasuredPitch(body, 3 * um)})
        np.testing.assert_allclose(gj.transmission_error(ahead, theta, torque=100.0).te - plain, turned, rtol=1e-9)


@pytest.mark.slow
def test_pitches_of_single_teeth_are_those_of_teeth_that_are_displaced():
    """Against displacements of single teeth along the circumference, at the reference circle where both agree."""
    scene = scene_of(GUO_1 | {"helix_angle": 0.0, "centre_distance": None}, {}, None, slices=2)
    deviation = np.random.default_rng(3).normal(0, 3 * um, 19)
    errors = {"pitch": gj.MeasuredPitch("pinion", deviation)}, {"teeth": gj.Positions("pinion", [], deviation)}
    theta = meshes_of(scene.system, 19, of=19.0)  # a tooth of each touches at the pitch point
    found, expected = (gj.transmission_error(dataclasses.replace(scene, errors=one), theta).te for one in errors)
    np.testing.assert_allclose(found, expected, rtol=0.03)


# --- Accuracy grades


GEARS = [  # teeth, whether internal, profile shift
    pytest.param(12, False, 0.5, id="pinion of 12"),
    pytest.param(60, False, 0.0, id="pinion of 60"),
    pytest.param(60, True, 0.5, id="ring of 60"),
]


@pytest.mark.parametrize(("teeth", "internal", "shift"), GEARS)
def test_run_out_of_an_eccentric_gear_is_twice_the_eccentricity(teeth, internal, shift):
    """A ball in the spaces of a gear that is displaced by e goes up and down by e, whatever its tooth number.

    A displaced flank crosses the reference circle ahead of its place by its own displacement along the circle and by
    that along the radius times tan alpha.
    """
    e, alpha = 20 * um, math.radians(20)
    if internal:
        system = gj.HelicalPair(
            24, teeth, 3e-3, alpha, 0.0, 30e-3, 100.0, 0.3, shift, addendum=0.8, wheel_kind="internal"
        )
    else:
        system = gj.HelicalPair(teeth, 40, 3e-3, alpha, 0.0, 30e-3, 100.0, shift, 0.0, addendum=0.8)
    body, sense, sign = ("wheel", -1, -1) if internal else ("pinion", 1, 1)
    half = (0.5 * math.pi + 2 * shift * math.tan(alpha)) / teeth  # of a tooth, of a space if internal
    half = math.pi / teeth - half if internal else half
    errors = {}
    for flank, lead in (("driving", sense), ("back", -sense)):
        place = -2 * math.pi * np.arange(teeth) / teeth + lead * half
        ahead = -e * np.sin(place) + lead * sign * math.tan(alpha) * e * np.cos(place)
        errors[flank] = gj.MeasuredPitch(body, ahead, flank=flank)
    found = gj.accuracy_grades(gj.Scene(system, errors), body)
    least = math.cos(math.pi / teeth)  # no tooth is just where the run-out is largest
    assert 2 * e * least * 0.999 < found["F_r"].value < 2 * e * 1.001
    assert least * 0.999 < found["F_p"].value * math.cos(alpha) / (2 * e) < 1.001


@pytest.mark.slow
def test_deviations_and_grades():
    """A straight slope with a wave: slope, form and total as defined; grades by the formulas of ISO 1328-1."""
    system = scene_of(GUO_1, slices=2).system

    def wave(s, z):
        return 9 * um * (0.5 - s) + 2 * um * np.sin(8 * math.pi * s) - 7 * um * z

    scene = scene_of(GUO_1, {"flank": on_grid(system, 0, wave, 401, 41)}, slices=2)
    found = gj.accuracy_grades(scene, "pinion")
    even = np.linspace(-0.5, 0.5, 20001)
    trace = 9 * um * even + 2 * um * np.sin(8 * math.pi * (0.5 - even))
    slope, _ = np.polyfit(even, trace, 1)
    assert found["f_H_alpha"].value == pytest.approx(slope, rel=2e-3)
    assert found["f_f_alpha"].value == pytest.approx(np.ptp(trace - slope * even), rel=2e-3)
    assert found["F_alpha"].value == pytest.approx(np.ptp(trace), rel=2e-3)
    assert found["f_H_beta"].value == pytest.approx(-7 * um, rel=1e-9)
    assert found["f_f_beta"].value == pytest.approx(0.0, abs=1e-12)
    assert found["F_beta"].value == pytest.approx(7 * um, rel=1e-9)
    assert found["f_f_beta"].grade == 1
    # limits at grade 5, m = 6, d = 115.7, b = 75 mm: 6.5, 8.5 and 7.5 um
    for name, at_5 in (("f_H_alpha", 6.5), ("f_f_alpha", 8.5), ("f_H_beta", 7.5)):
        assert gj.flank_tolerance(name, 5, 6 * mm, 115.727 * mm, 75 * mm) == pytest.approx(at_5 * um)
    assert found["f_H_beta"].grade == 5
    assert gj.flank_tolerance("F_alpha", 5, 6 * mm, 115.727 * mm, 75 * mm) == pytest.approx(11 * um)
    ratios = [gj.flank_tolerance("F_beta", grade, 6 * mm, 0.3, 75 * mm) for grade in (6, 8, 10)]
    np.testing.assert_allclose(np.diff(np.log2(ratios)), 1.0, atol=0.05)  # rounded to whole um
    rough = scene_of(GUO_1, {"flank": on_grid(system, 0, lambda s, z: 900 * um * s + 0 * z)}, slices=2)
    assert gj.accuracy_grades(rough, "pinion")["F_alpha"].grade is None


@pytest.mark.slow
def test_slopes_are_positive_towards_the_tip_of_internal_gears_too():
    for given in (GUO_1, RING):
        system = scene_of(given, slices=2).system
        for number, body in enumerate(("pinion", "wheel")):
            tip = on_grid(system, number, lambda s, z: 5 * um * (0.5 - s) + 0 * z)
            found = gj.accuracy_grades(scene_of(given, {"tip": tip}, slices=2), body)
            assert found["f_H_alpha"].value == pytest.approx(5 * um, rel=1e-6)


@pytest.mark.slow
def test_grades_of_what_was_not_measured_are_refused(scene):
    with pytest.raises(SceneError, match="lists no measured_flank or measured_pitch of the driving flanks"):
        gj.accuracy_grades(scene, "planet_1")
    point = scene_of(GUO_1, {"one": gj.MeasuredFlank("pinion", [10 * mm], [0.0])}, slices=2)
    with pytest.raises(SceneError, match="single points of pinion"):
        gj.accuracy_grades(point, "pinion")
    measured = gj.load(MEASURED)
    with pytest.raises(SceneError, match="of the back flanks of wheel"):
        gj.accuracy_grades(measured, "wheel", "back")
    with pytest.raises(ParameterError, match="pinion"):
        gj.accuracy_grades(measured, "pinio")
    with pytest.raises(ParameterError, match="driving"):
        gj.accuracy_grades(measured, "pinion", "left")
    with pytest.raises(ParameterError, match="f_H_alpha"):
        gj.flank_tolerance("f_H", 5, 6 * mm, 0.1, 75 * mm)
    with pytest.raises(ParameterError, match="4 to 1200 mm"):
        gj.flank_tolerance("F_beta", 5, 6 * mm, 0.1, 3 * mm)


# --- What does not fit


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"roll": [2 * mm, 1 * mm]}, "roll .*must increase"),
        ({"roll": []}, "roll .*one or more"),
        ({"deviation": [0.0, 0.0, 0.0]}, "deviation = .3 values.*2 x 1 = 2"),
        ({"deviation": []}, "deviation"),
        ({"teeth": [1, 2]}, "teeth .*must be 1"),
        ({"teeth": [3, 3], "deviation": [0.0] * 4}, "each tooth once"),
        ({"flank": "left"}, "driving"),
        ({"ends": "natural"}, "not_a_knot"),
    ],
)
def test_measured_flanks_that_make_no_grid_are_refused(changes, words):
    given = {"roll": [1 * mm, 2 * mm], "deviation": [0.0, 1 * um]} | changes
    with pytest.raises(ParameterError, match=words):
        gj.MeasuredFlank("pinion", **given)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (gj.MeasuredFlank("pinion", [10 * mm], [12 * mm]), r"errors.m.deviation .*12 mm.*half a module, 3 mm"),
        (gj.MeasuredPitch("wheel", 4 * mm), r"errors.m.deviation .*half a module"),
        (gj.TipRelief("pinion", [20 * mm], 1 * mm), r"errors.m.amount = .up to 20 mm.: .*half a module"),
        (gj.Eccentricity("wheel", 20 * mm, 0.0), r"errors.m.amplitude = .20 mm.: .*half a module, 3 mm"),
        (gj.CumulativePitch("wheel", 15 * mm, 0.0), r"errors.m.amplitude = .*half a module"),
        (gj.MeasuredFlank("pinion", [10 * mm], [0.0], teeth=[19]), "errors.m.teeth = .*19.*0 to 18"),
        (gj.MeasuredFlank("pinion", [10 * mm], [0.0], teeth=[1.5]), "errors.m.teeth = .*1.5"),
        (
            gj.MeasuredFlank("pinion", [10 * mm], [0.0, 0.0]),
            "2 teeth.*must be 1 or 19 teeth; for other numbers of teeth",
        ),
        (gj.MeasuredPitch("wheel", [0.0, 0.0]), "must be 47"),
        (gj.MeasuredFlank("pinion", [5.0, 9.0], [0.0, 0.0]), "errors.m.roll .*4.744 to 33.65 mm: is their unit right"),
        (gj.MeasuredFlank("wheel", [50 * mm], [0.0] * 2, [0.0, 75 * mm]), r"errors.m.across .*up to 37.5 mm"),
    ],
)
def test_measurements_of_another_gear_are_refused(error, words):
    with pytest.raises(ParameterError, match=words):
        scene_of(GUO_1, {"m": error}, slices=2)


@pytest.mark.slow
def test_gear_sets_may_be_traced():
    """What cannot be known while something is traced is not looked at."""
    flank = gj.MeasuredFlank("pinion", [10 * mm, 30 * mm], [0.0, 5 * um])
    scene = scene_of(GUO_1 | {"centre_distance": None}, {"m": flank}, TEETH, slices=2, pairs=3)
    theta = meshes_of(scene.system, 3)

    def mean(module):
        own = dataclasses.replace(scene, system=dataclasses.replace(scene.system, normal_module=module))
        return gj.transmission_error(own, theta, torque=100.0, extremes="samples").te.mean()

    value, at = jax.jit(mean), jnp.asarray(6e-3)
    difference = (value(at + 1e-8) - value(at - 1e-8)) / 2e-8
    assert float(jax.jit(jax.grad(mean))(at)) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.slow
def test_other_gear_sets_refuse_them_in_one_line(scene):
    yang = gj.load(ROOT / "configs" / "involute_rv" / "yang_2019.toml")
    with pytest.raises(ParameterError, match=r"errors.m.kind .*places of the contacts on its flanks"):
        dataclasses.replace(yang, errors={"m": gj.MeasuredFlank("gear_1", [1 * mm], [0.0])})
    with pytest.raises(ParameterError, match=r"errors.m.kind .*reference circle"):
        dataclasses.replace(yang, errors={"m": gj.MeasuredPitch("gear_1", 0.0)})
    with pytest.raises(ParameterError, match=r"errors.m.kind .*involute profile"):
        dataclasses.replace(scene, errors={"m": gj.MeasuredFlank("planet_1", [1 * mm], [0.0])})


@pytest.mark.slow
def test_vibration_of_the_measured_pair_has_gradients():
    """From a point of the measured grid, tip relief, crowning, torque and speed to the first mesh harmonic at 2,104
    rpm: by way of the loaded analysis and one contact, against differences."""
    measured = gj.load(MEASURED)
    flank = measured.errors["pinion_flank"]
    flank = gj.MeasuredFlank("pinion", flank.roll, flank.grid[0].ravel(), flank.across)
    turning = dataclasses.replace(measured.system, input_speed=2104 * gj.units.rpm, slices=10, pairs=3)
    parts = {"inertia": gj.MomentOfInertia(0.0587), "damping": gj.DampingRatio(0.07)}
    scene = dataclasses.replace(measured, system=turning, **parts)

    def harmonic(numbers):
        point, tip, crowning, load, speed = numbers
        errors = {
            "flank": dataclasses.replace(flank, deviation=flank.deviation.at[13 * 17 + 6].add(point * um)),
            "tip": gj.TipRelief("wheel", (5 + tip) * um, 4 * mm),
            "crowning": gj.Crowning("wheel", (4 + crowning) * um),
        }
        rate = 2104 * gj.units.rpm * (1 + speed)
        whole = dataclasses.replace(scene, errors=errors, system=dataclasses.replace(turning, input_speed=rate))
        torque = 830.0 * (1 + load)
        one = gj.one_contact(whole, torque, samples=64, harmonics=16)
        motion = gj.shooting(one.scene, torque, 2 * math.pi / (19 * rate))
        return 2 / motion.te.shape[0] * jnp.abs(jnp.fft.rfft(motion.te)[1]) / arcmin

    at = jnp.zeros(5)
    slopes, value = jax.jit(jax.grad(harmonic))(at), jax.jit(harmonic)
    assert float(value(at)) > 1e-3
    for place, step in enumerate((1e-3, 1e-3, 1e-3, 1e-4, 2e-5)):
        way = np.zeros(5)
        way[place] = step
        difference = (value(at + way) - value(at - way)) / (2 * step)
        assert float(slopes[place]) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.parametrize("design", [gj.TipRelief("pinion", 12e-6, 2e-3), {"tip": 1}, ["tip"]])
def test_what_is_no_list_of_modifications_is_refused(design):
    flank, size = (
        gj.MeasuredFlank("pinion", np.linspace(0.01, 0.03, 5), np.zeros(5)),
        scene_of(GUO_1, slices=2).system.gear_size("pinion"),
    )
    with pytest.raises(gj.ParameterError, match=r"^design = .*must be a list of modifications"):
        inspect.unwrap(gj.MeasuredFlank.without)(flank, design, size)
    with pytest.raises(gj.ParameterError, match=r"^gear = .*must be sizes of a gear: system.gear_size\(.pinion.\)"):
        inspect.unwrap(gj.MeasuredFlank.without)(flank, [], "pinion")
