"""Motion of slices of contact lines: against a program apart, the static limit, other schemes, and differences."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gearjax as gj
from gearjax.checks import SceneError
from gearjax.units import arcmin, mm, rpm, um
from tests.helical_pairs import GUO_1, GUO_2, RING, SPUR, STEEL, TEETH, scene_of

INERTIA, RATIO, TORQUE = 0.0587, 0.07, 830.0
LINES = gj.LineStiffness(1.2e10)
RELIEFS = {
    "tip": gj.TipRelief("pinion", 20 * um, 8 * mm),
    "root": gj.RootRelief("pinion", 15 * um, 8 * mm),
    "crowning": gj.Crowning("pinion", 12 * um),
}


def turning(given, speed, errors=None, compliance=LINES, inertia=INERTIA, **changes):
    """A pair at a speed of its pinion, with what its motion needs."""
    parts = {name: changes.pop(name) for name in ("supports", "body_inertia", "contact", "damping") if name in changes}
    backlash = changes.pop("backlash", None)
    scene = scene_of(given, errors, compliance, backlash, input_speed=speed, **changes)
    own = {"load": gj.ConstantLoad(), "inertia": gj.MomentOfInertia(inertia), "damping": gj.DampingRatio(RATIO)}
    return dataclasses.replace(scene, **(own | parts))


def meshes(scene, number, each=64):
    """Times of some meshes, and the length of one [s]."""
    period = 2 * math.pi / (scene.system.pinion_teeth * float(scene.system.input_speed))
    return np.linspace(0.0, number * period, number * each + 1), period


def short_steps(scene, ts, torque=TORQUE):
    """Runge-Kutta steps, eight times as short as the usual ones."""
    return gj.FixedStep(step=gj.chosen_steps(scene, ts, torque).step / 8, solver=gj.RungeKutta4())


@pytest.mark.slow
@pytest.mark.parametrize("errors", [{}, RELIEFS], ids=["ideal", "relieved"])
def test_motion_is_that_of_a_program_apart(errors):
    """By scipy: contacts as statics have them, each with a damper in proportion to its stiffness, which altogether are
    as many as pairs touch: of closed forms of the mean length of the contact lines and of the contact ratio."""
    scene = turning(GUO_1, 2104 * rpm, errors, slices=10)
    pair, speed = scene.system.pair, float(scene.system.input_speed)
    lean = math.cos(float(pair.base_helix_angle))
    line = float(pair.face_width) * float(pair.transverse_contact_ratio) / lean
    mean = 1.2e10 * line
    mass = INERTIA / (float(pair.gears[1].base_radius) * lean) ** 2
    delay = RATIO * math.sqrt(2 * float(pair.total_contact_ratio) * mass / mean)

    @jax.jit
    def force(time, place, rate):
        def at(time):
            now = scene.contacts(speed * time, "mean")
            return now.lever, now.gap, now.linear

        (lever, gap, stiffness), (_, moves, _) = jax.jvp(at, (time,), (1.0,))
        overlap, closing = lever * place - gap, lever * rate - moves
        return jnp.where(overlap > 0, lever * stiffness * (overlap + delay * closing), 0.0).sum()

    def field(time, state):
        return [state[1], (-TORQUE - float(force(time, *state))) / INERTIA]

    ts, period = meshes(scene, 3, 32)
    motion = gj.simulate(scene, ts, TORQUE)
    start = [float(motion.te[0]), float(motion.velocity[0])]
    apart = solve_ivp(field, (0.0, ts[-1]), start, t_eval=ts, rtol=1e-9, atol=1e-13, max_step=period / 64)
    assert np.ptp(apart.y[0]) > 0.03 * arcmin
    np.testing.assert_allclose(motion.te, apart.y[0], atol=2e-3 * np.ptp(apart.y[0]))
    fine = gj.simulate(scene, ts, TORQUE, stepper=gj.FixedStep(step=gj.chosen_steps(scene, ts, TORQUE).step / 8))
    np.testing.assert_allclose(fine.te, apart.y[0], atol=2e-4 * np.ptp(apart.y[0]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "changes"),
    [(GUO_1, {}), (GUO_2, {}), (RING, {}), (SPUR, {"tip_contact": "corner"})],
    ids=["helical", "overlapping", "ring", "spur, corners"],
)
def test_a_slow_motion_is_the_static_error(given, changes):
    errors = {} if changes else {"crowning": gj.Crowning("pinion", 6 * um)}
    scene = turning(given, 0.5 * rpm, errors, inertia=0.01, slices=6, **changes)
    ts, _ = meshes(scene, 2, 16)
    motion = gj.simulate(scene, ts, 100.0)
    static = gj.transmission_error(scene, float(scene.system.input_speed) * ts, torque=100.0)
    np.testing.assert_allclose(motion.te, static.te, atol=2e-3 * float(jnp.ptp(static.te)))
    assert motion.moved is None
    assert motion.coordinates == ("output",)
    assert gj.chosen_steps(scene, ts, 100.0).scheme == "constant modes"


@pytest.mark.slow
def test_clearance_that_nothing_crosses_changes_nothing():
    """One damper for each slice of the flanks that carry, whether they always act or not."""
    for acting in ("contact", "always"):
        damping = gj.DampingRatio(RATIO, acting)
        bare, loose = (
            turning(GUO_1, 2104 * rpm, RELIEFS, slices=4, damping=damping, backlash=room)
            for room in (None, gj.InitialBacklash(200 * um))
        )
        ts, _ = meshes(bare, 4, 16)
        one, other = (np.asarray(gj.simulate(scene, ts, TORQUE).te) for scene in (bare, loose))
        np.testing.assert_allclose(one, other, atol=1e-9 * np.ptp(one))


HELD = {
    "supports": {
        "pinion": gj.Support(x=2e8, y=2e8, rx=1e7, ry=1e7, x_damping=401.0, y_damping=401.0),
        "wheel": gj.Support(y=2e8, y_damping=883.0),
    },
    "body_inertia": {"pinion": gj.BodyInertia(mass=6.0, transverse=0.02), "wheel": gj.BodyInertia(mass=30.0)},
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speed", "torque", "changes"),
    [
        (2104, TORQUE, {"errors": RELIEFS, "compliance": TEETH}),
        (2104, TORQUE, {"errors": RELIEFS | {"run_out": gj.Eccentricity("pinion", 15 * um, 0.0)}}),
        (2104, 50.0, {"backlash": gj.InitialBacklash(20 * um)}),
        (2104, -TORQUE, {"backlash": gj.InitialBacklash(20 * um), "errors": RELIEFS}),
        (2104, TORQUE, {"tip_contact": "corner", "compliance": gj.Iso6336Teeth()}),
        (2104, TORQUE, {"errors": RELIEFS, "contact": gj.SoftplusContact(1 * um)}),
        (2104, TORQUE, {"errors": RELIEFS, "damping": gj.DampingRatio(RATIO, "always")}),
        (2104, TORQUE, {"errors": RELIEFS, "damping": None}),
        (2104, TORQUE, {"errors": RELIEFS} | HELD),
        (20000, 10000.0, {"errors": RELIEFS}),
        (20, 1.0, {"errors": RELIEFS}),
    ],
    ids=["teeth", "run-out", "loose", "reversed", "corners", "soft", "always", "undamped", "held", "fast", "slow"],
)
def test_usual_steps_are_short_enough(speed, torque, changes):
    """Against Runge-Kutta steps that are much shorter."""
    scene = turning(GUO_1, speed * rpm, slices=8, **changes)
    ts, period = meshes(scene, 3, 32)
    usual = gj.simulate(scene, ts, torque, settle=period)
    short = gj.simulate(scene, ts, torque, settle=period, stepper=short_steps(scene, ts, torque))
    spread = float(jnp.ptp(short.te))
    np.testing.assert_allclose(usual.te, short.te, atol=5e-3 * spread)
    assert float(usual.peak_to_peak) == pytest.approx(float(short.peak_to_peak), rel=5e-3)


@pytest.mark.slow
def test_stiff_supports_tend_to_none():
    """The difference falls in proportion to their compliance."""
    ts, _ = meshes(turning(GUO_1, 500 * rpm), 2, 16)
    alone = gj.simulate(turning(GUO_1, 500 * rpm, RELIEFS, slices=6), ts, TORQUE).te
    apart = []
    for size in (1e11, 1e12):
        held = {
            "supports": {"pinion": gj.Support(y=size, y_damping=1e5)},
            "body_inertia": {"pinion": gj.BodyInertia(mass=1.0)},
        }
        moved = gj.simulate(turning(GUO_1, 500 * rpm, RELIEFS, slices=6, **held), ts, TORQUE).te
        apart.append(float(jnp.abs(moved - alone).max()))
    assert apart[0] / apart[1] == pytest.approx(10, rel=0.1)


@pytest.fixture(scope="module")
def periodic():
    scene = turning(GUO_1, 2104 * rpm, RELIEFS, slices=6)
    return scene, meshes(scene, 1)[1]


@pytest.mark.slow
def test_periodic_motions_agree(periodic):
    """Shooting, harmonic balance and settled steps."""
    scene, period = periodic
    shot = gj.shooting(scene, TORQUE, period, steps=1024)
    balanced = gj.harmonic_balance(scene, TORQUE, period, harmonics=64)
    assert int(shot.result) == int(balanced.result) == 0
    assert bool(shot.stable)
    size = float(shot.peak_to_peak)
    assert float(balanced.peak_to_peak) == pytest.approx(size, rel=5e-4)
    np.testing.assert_allclose(balanced.te, shot.te, atol=1e-3 * size)
    ts = np.arange(33) * period
    assert float(gj.simulate(scene, ts, TORQUE).te[-1]) == pytest.approx(float(shot.te[0]), abs=2e-3 * size)
    sweep = gj.speed_sweep(scene, TORQUE, np.array([float(scene.system.input_speed)]), periods=40, steps=512)
    assert float(sweep.peak_to_peak[0]) == pytest.approx(size, rel=1e-3)
    assert float(gj.growth_rate(scene, np.linspace(0.0, 16 * period, 257), TORQUE)) < 0


@pytest.mark.slow
def test_vibration_has_gradients_under_jit_and_vmap(periodic):
    """First mesh harmonic by tip relief, crowning, helix angle, torque and speed, for two loads at once."""
    scene = periodic[0]

    def harmonic(numbers, torque):
        tip, crowning, helix, load, speed = numbers
        errors = RELIEFS | {
            "tip": gj.TipRelief("pinion", (20 + tip) * um, 8 * mm),
            "crowning": gj.Crowning("pinion", (12 + crowning) * um),
        }
        rate = 2104 * rpm * (1 + speed)
        angle = scene.system.helix_angle * (1 + helix)
        system = dataclasses.replace(scene.system, input_speed=rate, helix_angle=angle)
        whole = dataclasses.replace(scene, errors=errors, system=system)
        motion = gj.shooting(whole, torque * (1 + load), 2 * math.pi / (19 * rate), steps=256)
        return 2 / motion.te.shape[0] * jnp.abs(jnp.fft.rfft(motion.te)[1]) / arcmin

    at, torques = jnp.zeros(5), jnp.asarray([400.0, TORQUE])
    both = jax.jit(jax.vmap(jax.value_and_grad(harmonic), (None, 0)))  # one program of values and slopes
    slopes = both(at, torques)[1]
    for place, step in enumerate((1e-3, 1e-3, 1e-6, 1e-5, 2e-6)):
        way = np.zeros(5)
        way[place] = step
        difference = (both(at + way, torques)[0] - both(at - way, torques)[0]) / (2 * step)
        np.testing.assert_allclose(slopes[:, place], difference, rtol=1e-5)


@pytest.mark.slow
def test_steps_are_the_same_where_errors_are_traced():
    """By default; of a pair so quick that the steps for unknown scenes are too long."""
    scene = turning(GUO_1, 9000 * rpm, RELIEFS, slices=4)
    ts = np.linspace(0.0, 2e-3, 41)

    def motion(amount, law=LINES):
        errors = RELIEFS | {"tip": gj.TipRelief("pinion", amount, 8 * mm)}
        return gj.simulate(dataclasses.replace(scene, errors=errors, compliance=law), ts, TORQUE)

    known = motion(20 * um)
    for traced in (jax.jit(motion)(20 * um), jax.tree.map(lambda x: x[0], jax.vmap(motion)(jnp.asarray([20 * um])))):
        assert int(traced.result) == 0
        np.testing.assert_allclose(traced.te, known.te, rtol=0, atol=1e-12 * np.ptp(known.te))
    of_stiffness = jax.jit(lambda stiffness: motion(20 * um, gj.LineStiffness(stiffness)))(1.2e10)
    assert int(of_stiffness.result) == 2  # the fastest motion is not known: the result says so


@pytest.mark.slow
def test_what_does_not_move_as_slices_is_refused_in_one_line():
    for compliance in (
        gj.HarmonicStiffness(1e9, [], []),
        gj.ToothSlices(**STEEL, coupling_length=1.5),
    ):
        scene = turning(GUO_1, 100 * rpm, compliance=compliance, slices=4)
        with pytest.raises(SceneError, match=r"independent springs|compliance\] of slices") as caught:
            gj.simulate(scene, np.linspace(0.0, 0.01, 11), TORQUE)
        assert "gj.one_contact" in str(caught.value)
    scene = turning(GUO_1, 100 * rpm, slices=4)
    for stepper, words in (
        (gj.QuasiStatic(), "springs of pairs of teeth"),
        (gj.FixedStep(windows=gj.Windows(8, 0.001)), "windows need a scene"),
    ):
        with pytest.raises(SceneError, match=words):
            gj.simulate(scene, np.linspace(0.0, 0.01, 11), TORQUE, stepper=stepper)
