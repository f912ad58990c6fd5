"""Waterfalls: against shooting one by one, and the closed form of a linear motion."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.period import what_differs
from gearjax.plot import waterfall_figure
from gearjax.reproduce import helical
from gearjax.units import rpm, um
from tests.conftest import CONFIG
from tests.helical_pairs import GUO_1, TEETH, scene_of

SPEEDS = np.array([500.0, 2104.0, 4100.0]) * rpm


@pytest.fixture(scope="module")
def linear():
    """A 2K-V reducer on constant springs that never part, shaken by one run-out."""
    scene = gj.load(CONFIG)
    own = {"planet_1": dataclasses.replace(scene.errors["planet_1"], amplitude=jnp.asarray(1 * um))}
    stiff = gj.HarmonicStiffness(9e7, jnp.zeros(0), jnp.zeros(0))
    return dataclasses.replace(scene, errors=own, compliance=stiff, load=gj.ConstantLoad(), backlash=None)


@pytest.mark.slow
def test_a_linear_motion_by_its_closed_form(linear):
    """The static TE times (K + i w C) / (K - w^2 I + i w C), and the torque that accelerates the output."""
    order = "planet_1" if "planet_1" in linear.system.orders else "planet"
    turns, torque = linear.system.orders[order], 300.0
    contacts = linear.contacts(jnp.zeros(()), "mean")
    lever, stiffness = contacts.lever, contacts.linear
    inertia = linear.inertia.moment(lever)
    springs = float((lever**2 * stiffness).sum())
    drag = float((lever**2 * linear.damping.coefficient(stiffness, linear.inertia.at_contacts(lever))).sum())
    natural = math.sqrt(springs / float(inertia))
    speeds = np.array([0.3, 0.9, 1.0, 2.0]) * natural / turns
    found = gj.waterfall(linear, torque, speeds, harmonics=2, steps=256, order=order)
    theta = 2 * np.pi / turns * np.arange(64) / 64
    static = gj.transmission_error(linear, theta, torque=torque, extremes="samples").te
    still = float(jnp.abs(jnp.fft.rfft(static)[1])) / 32
    rate = turns * speeds
    answer = (springs + 1j * rate * drag) / (springs - rate**2 * float(inertia) + 1j * rate * drag)
    np.testing.assert_allclose(found.amplitudes[:, 0], np.abs(answer) * still, rtol=2e-3)
    np.testing.assert_allclose(found.amplitudes[:, 1], 0.0, atol=1e-6 * still)
    accelerated = float(inertia) * rate**2 * np.asarray(found.amplitudes[:, 0])
    np.testing.assert_allclose(found.dynamic_factor, 1 + accelerated / torque, rtol=1e-4)
    np.testing.assert_allclose(found.orders, [turns, 2 * turns])
    assert found.stable.all()


@pytest.fixture(scope="module")
def pair():
    parts = {"load": gj.ConstantLoad(), "inertia": gj.MomentOfInertia(0.0587), "damping": gj.DampingRatio(0.07)}
    return dataclasses.replace(scene_of(GUO_1, {}, TEETH, slices=4), **parts)


STEPS = 64


@pytest.fixture(scope="module")
def found(pair):
    return gj.waterfall(pair, 830.0, SPEEDS, harmonics=4, steps=STEPS)


@pytest.mark.slow
def test_speeds_side_by_side_are_those_one_by_one(pair, found):
    """Of slices in motion; and the gradient of an amplitude, by the program of all speeds."""
    for place, speed in enumerate(SPEEDS):
        turning = dataclasses.replace(pair, system=dataclasses.replace(pair.system, input_speed=speed))
        motion = gj.shooting(turning, 830.0, 2 * math.pi / (19 * speed), steps=STEPS)
        assert float(found.peak_to_peak[place]) == pytest.approx(float(motion.peak_to_peak), rel=1e-9)
        lines = np.abs(np.fft.rfft(motion.te))[1:5] / (STEPS / 2)
        np.testing.assert_allclose(found.amplitudes[place], lines, rtol=1e-8)
    assert (np.asarray(found.result) == 0).all()
    assert np.argmax(found.dynamic_factor) == 2

    def highest(mass):
        heavier = dataclasses.replace(pair, inertia=gj.MomentOfInertia(mass))
        return gj.waterfall(heavier, 830.0, SPEEDS, harmonics=4, steps=STEPS).amplitudes[1, 0]

    at, step = jnp.asarray(0.0587), 1e-7
    difference = (highest(at + step) - highest(at - step)) / (2 * step)
    assert float(jax.grad(highest)(at)) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.slow
def test_a_torque_reversed_is_the_mirror_image(pair):
    """Of flanks without modification and even contact lines, whose stiffness runs the same way back."""
    even = gj.LineStiffness(1.2e10)
    loose = dataclasses.replace(pair, compliance=even, backlash=gj.InitialBacklash(50 * um))
    ahead, back = (gj.waterfall(loose, torque, SPEEDS, harmonics=2, steps=256) for torque in (830.0, -830.0))
    np.testing.assert_allclose(back.dynamic_factor, ahead.dynamic_factor, rtol=5e-4)
    np.testing.assert_allclose(back.peak_to_peak, ahead.peak_to_peak, rtol=1e-3)
    assert (np.asarray(ahead.dynamic_factor) > 1).all()


@pytest.mark.slow
def test_its_figure(pair, found, tmp_path):
    figure = waterfall_figure(found, gj.natural_modes(pair, 830.0))
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels[:3] == ["TE, peak-to-peak [arcmin]", "dynamic factor [-]", "frequency [Hz]"]
    figure.savefig(tmp_path / "waterfall.png")


REPEATED = {
    "waterfall": lambda scene, torque: gj.waterfall(scene, torque, np.array([20.0]), harmonics=2, steps=32),
    "speed_sweep": lambda scene, torque: gj.speed_sweep(scene, torque, np.array([20.0]), periods=2, steps=32),
    "shooting": lambda scene, torque: gj.shooting(scene, torque, mesh_of(scene), steps=32),
    "harmonic_balance": lambda scene, torque: gj.harmonic_balance(scene, torque, mesh_of(scene), harmonics=2),
}


def mesh_of(scene) -> float:
    return 2 * np.pi / (float(scene.system.orders["mesh"]) * float(scene.system.input_speed))


def test_the_rounding_of_angles_is_no_difference():
    """In float32 the stiffness of a helical pair differs by 0.03 % after 47 turns: the angle's rounding."""
    scene = dataclasses.replace(helical.scene(), load=gj.ConstantLoad())
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    for each, least in ((scene, 1e-4), (single, 1e-3)):
        assert what_differs(each, scene.system.cycle) is None
        assert "gaps differ by" in str(what_differs(each, scene.system.cycle + least))


@pytest.mark.parametrize("name", REPEATED)
def test_a_period_after_which_errors_do_not_repeat_is_refused(name, linear):
    """The run-out of a planet repeats after 79 turns of the input, not after a mesh."""
    words = r"does not repeat .* gaps differ by 0\.06\d+ um; errors repeat after"
    with pytest.raises(gj.SceneError, match=words) as told:
        REPEATED[name](linear, 300.0)
    assert "\n" not in str(told.value)
    assert len(str(told.value)) < 300
    with pytest.raises(gj.SceneError, match=words):  # the numbers of the scene are known in a trace of the torque, too
        jax.eval_shape(lambda torque: REPEATED[name](linear, torque), jnp.asarray(300.0))


SLOW = {  # motions at a hundredth of a scene's speed, with their usual number of steps or another one
    "shooting": lambda scene, **steps: gj.shooting(slowed(scene), 300.0, 100 * mesh_of(scene), **steps),
    "periodic_motion": lambda scene, **steps: gj.periodic_motion(slowed(scene), 300.0, 100 * mesh_of(scene), **steps),
    "speed_sweep": lambda scene, **steps: gj.speed_sweep(scene, 300.0, slow_and_fast(scene), periods=3, **steps),
    "waterfall": lambda scene, **steps: gj.waterfall(scene, 300.0, slow_and_fast(scene), **steps),
}


def slowed(scene):
    return dataclasses.replace(
        scene, system=dataclasses.replace(scene.system, input_speed=scene.system.input_speed / 100)
    )


def slow_and_fast(scene) -> np.ndarray:
    return float(scene.system.input_speed) * np.array([1.0, 0.01])


@pytest.fixture(scope="module")
def swinging(linear):
    """On springs that change with the mesh."""
    return dataclasses.replace(linear, errors={}, reference=None, compliance=gj.HarmonicStiffness(9e7, [0.1], [0.0]))


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_steps_that_are_too_long_are_refused(name, swinging):
    """With the number of steps that the message tells, a slow motion follows the springs."""
    with pytest.raises(gj.SceneError, match=r"too few per period.*turns by \d\S* rad in a step, more than 2") as told:
        SLOW[name](swinging, steps=512)
    assert ("at speeds[1] = " in str(told.value)) == (name in ("speed_sweep", "waterfall"))
    enough = int(str(told.value).rpartition("give steps=")[2])
    theta = 2 * np.pi / swinging.system.orders["mesh"] * np.arange(401) / 400

    def turning(angle):
        contacts = swinging.contacts(angle, "varying")
        return (contacts.lever**2 * contacts.linear).sum()

    still = np.ptp(300.0 / np.asarray(jax.vmap(turning)(theta)))
    found = SLOW[name](swinging, steps=enough)
    np.testing.assert_allclose(np.ravel(found.peak_to_peak)[-1], still, rtol=1e-3)
    assert not np.any(found.result)


@pytest.mark.slow
def test_steps_that_are_too_long_are_told_of_traced_numbers(swinging):
    result = jax.jit(lambda torque: gj.speed_sweep(swinging, torque, slow_and_fast(swinging), periods=2).result)(300.0)
    assert result.tolist() == [0, 3]
    period = 100 * mesh_of(swinging)
    assert int(jax.jit(lambda period: gj.shooting(slowed(swinging), 300.0, period).result)(period)) == 3


@pytest.mark.slow
@pytest.mark.parametrize("function", [gj.waterfall, gj.speed_sweep])
def test_a_known_scene_inside_a_trace(function, linear):
    """The torque is traced, the period is checked: the same as without a trace."""
    calm = dataclasses.replace(linear, errors={})

    def spread(torque):
        return function(calm, torque, np.array([20.0]), steps=160, **given).peak_to_peak

    given = {"harmonics": 2} if function is gj.waterfall else {"periods": 2}
    np.testing.assert_allclose(jax.jit(spread)(300.0), spread(300.0), rtol=1e-9, atol=1e-15)


def test_a_load_that_does_not_repeat_is_refused(linear):
    calm = dataclasses.replace(linear, errors={}, load=gj.SinusoidalLoad(3.3))
    with pytest.raises(gj.SceneError, match="its load differs"):
        REPEATED["shooting"](calm, 300.0)
    waves = gj.HarmonicStiffness(9e7, [0.1], [0.0])
    with pytest.raises(gj.SceneError, match="its stiffness differs"):
        gj.shooting(dataclasses.replace(linear, errors={}, compliance=waves), 300.0, 0.7 * mesh_of(linear), steps=32)


@pytest.mark.slow
def test_a_load_in_hertz_repeats_at_some_speeds_only(linear):
    """It repeats with the mesh at the speeds of which it is a mesh harmonic, whatever the speed of the scene is."""
    calm, mesh = dataclasses.replace(linear, errors={}), float(linear.system.orders["mesh"])
    own = 40.0  # rad/s, not that of the scene
    shaken = dataclasses.replace(calm, load=gj.SinusoidalLoad(2 * own * mesh / (2 * np.pi)))
    for function, given in ((gj.waterfall, {"harmonics": 2}), (gj.speed_sweep, {"periods": 2})):
        assert np.isfinite(function(shaken, 300.0, np.array([own, 2 * own]), steps=128, **given).peak_to_peak).all()
        with pytest.raises(gj.SceneError, match="its load differs at 60 rad/s"):
            function(shaken, 300.0, np.array([own, 60.0]), steps=128, **given)


def test_levers_of_non_circular_gears_repeat_with_the_turn():
    """Without errors gaps, stiffness and load repeat with the mesh; levers and the speed of the output do not."""
    scene = gj.load(CONFIG.parents[1] / "elliptic" / "dong_2020.toml")
    stiff = gj.HarmonicStiffness(3e8, [], [])
    scene = dataclasses.replace(scene, errors={}, backlash=None, compliance=stiff, load=gj.ConstantLoad())
    assert what_differs(scene, 2 * np.pi) is None
    assert what_differs(scene, 2 * np.pi / scene.system.orders["mesh"]) == "its levers differ"
    with pytest.raises(gj.SceneError, match="its levers differ"):
        gj.shooting(scene, 100.0, mesh_of(scene), steps=32)


def test_discs_that_change_places_are_not_the_same_disc():
    """Two discs half a pin apart: their gaps swap after half a pin, but one of them alone is on a bearing."""
    scene = gj.load(CONFIG.parents[1] / "rv_cycloidal" / "hu_2020.toml")
    scene = dataclasses.replace(scene, system=dataclasses.replace(scene.system, pins=39, discs=2), errors={})
    half = np.pi / scene.system.orders["mesh"]
    held = dataclasses.replace(scene, supports={"disc_1": gj.Support(y=5e7)})
    assert what_differs(scene, half) is None
    assert what_differs(held, half) == "its levers differ"
    assert what_differs(held, 2 * half) is None


@pytest.mark.slow
def test_the_dynamic_factor_of_a_load_that_alternates(linear):
    """Both flanks always touch: T (k + i w c) / (k - w^2 J + i w c) is the torque of the contacts."""
    load, none = gj.SinusoidalLoad("mesh"), gj.InitialBacklash(0.0)
    scene = dataclasses.replace(linear, errors={}, load=load, backlash=none)
    lever, pairs = float(np.abs(scene.contacts(jnp.zeros(()), "mean").lever[0])), 2
    mass, stiffness = float(scene.inertia.at_contacts(jnp.full(2, lever))), 9e7
    springs, inertia = pairs * stiffness * lever**2, mass * lever**2
    drag = pairs * float(scene.damping.coefficient(jnp.asarray(stiffness), jnp.asarray(mass))) * lever**2
    ratios = np.array([0.3, 0.7, 1.5, 2.0])
    rate = ratios * math.sqrt(springs / inertia)
    found = gj.waterfall(scene, 113.0, rate / scene.system.orders["mesh"], steps=256)
    answer = np.abs((springs + 1j * rate * drag) / (springs - rate**2 * inertia + 1j * rate * drag))
    np.testing.assert_allclose(found.dynamic_factor, answer, rtol=2e-3)
