"""Motion of elliptic pairs against an own right-hand side, the speed of separation, energy, gradients."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gearjax as gj
from gearjax.checks import SceneError
from gearjax.units import rpm, um
from tests.conftest import ROOT
from tests.elliptic import ALPHA, MODULE, TEETH
from tests.test_elliptic_pair import DRIVEN, DRIVER, MOVING, OWN, scene

INERTIA, STIFFNESS, BACKLASH = 0.01, 3e8, 60 * um


def levers(t: float) -> np.ndarray:
    """Change of overlap of both flanks with the output."""
    lean = OWN.psi(t)
    return np.array([-1.0, 1.0]) * OWN.r2(t) * np.cos(ALPHA + np.array([1.0, -1.0]) * lean)


def gaps(t: float) -> np.ndarray:
    side, turned = np.array([1.0, -1.0]), OWN.t2(t)
    slant = ALPHA + side * OWN.psi(t)
    run_outs = 30 * um * np.sin(t + DRIVER + side * slant) + 20 * um * np.sin(turned + DRIVEN - side * slant)
    return -side * run_outs + np.array([0.0, BACKLASH])


def absolute(speed: float, torque: float, ts: np.ndarray, turns: float = 0.0, acting: str = "always") -> np.ndarray:
    """Deviation of the driven gear's own angle, ``I y'' = -T - sum J f``, everything by hand; the torque constant, or a
    sine of so many turns per turn of the driver."""
    start = levers(0.0)
    damping = 0.05 * math.sqrt(2 * STIFFNESS * INERTIA / (start @ start / 2))
    long = OWN.arc(2 * math.pi)
    h = 1e-6

    def rate(time: float, state: np.ndarray) -> list[float]:
        t = speed * time
        lever, gap = levers(t), gaps(t)
        turning = (levers(t + h) - levers(t - h)) / (2 * h) * speed
        opening = (gaps(t + h) - gaps(t - h)) / (2 * h) * speed
        q, v = state[0] - OWN.t2(t), state[1] - OWN.ratio(t) * speed
        stiffness = STIFFNESS * (1 + 0.15 * math.cos(2 * math.pi * TEETH * OWN.arc(t) / long + 0.2))
        overlap = lever * q - gap
        force = lever @ (stiffness * np.maximum(overlap, 0.0))
        back = acting == "contact" and overlap[1] > 0 >= overlap[0]
        at = 1 if back else 0  # the damper acts along the flank that touches, or always along the driving flank
        drag = damping * lever[at] * (lever[at] * v + turning[at] * q - opening[at])
        if acting == "contact" and overlap.max() <= 0:
            drag = 0.0
        load = torque * (math.sin(turns * t) if turns else 1.0)
        return [state[1], (-load - force - drag) / INERTIA]

    state = [0.0, OWN.ratio(0.0) * speed]
    found = solve_ivp(rate, (0, ts[-1]), state, "DOP853", ts, rtol=1e-11, atol=1e-13, max_step=6e-5)
    return found.y[0] - OWN.t2(speed * ts)


TS = np.linspace(0.0, 0.08, 161)


def moving(speed: float, **slots) -> gj.Scene:
    return scene(system={"input_speed": speed}, **(MOVING | slots))


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "lifts"), [(150 * rpm, False), (450 * rpm, True)])
def test_the_driven_gear_in_absolute_coordinates(speed, lifts):
    """From a start that is no equilibrium; at the higher speed teeth lift off and hit their back flanks."""
    torque = 40.0 if not lifts else 10.0
    wanted = absolute(speed, torque, TS)
    steppers = {
        "fitted": gj.FixedStep(per_sample=400),
        "Runge-Kutta": gj.FixedStep(per_sample=200, solver=gj.RungeKutta4()),
    }
    for name, stepper in steppers.items():
        motion = gj.simulate(moving(speed), TS, torque, start="zero", stepper=stepper)
        assert int(motion.result) == 0
        assert np.abs(np.asarray(motion.te) - wanted).max() < 1e-4 * np.ptp(wanted), name
        settled = np.asarray(motion.forces)[40:]
        assert (settled[:, 0] <= 0).any() == lifts
        assert (settled[:, 1] > 0).any() == lifts


@pytest.mark.slow
@pytest.mark.parametrize("torque", [-120.0, 120.0, -25.0])
def test_dampers_act_along_the_flank_that_touches(torque):
    """Levers of the two flanks differ by a half here; against the back flanks both touch in turn until it settles."""
    speed, damping = 150 * rpm, gj.DampingRatio(0.05, "contact")
    wanted = absolute(speed, torque, TS, acting="contact")
    gears = moving(speed, damping=damping)
    steppers = {
        "fitted": gj.FixedStep(per_sample=6400),
        "Runge-Kutta": gj.FixedStep(per_sample=3200, solver=gj.RungeKutta4()),
    }
    for name, stepper in steppers.items():
        motion = gj.simulate(gears, TS, torque, start="zero", stepper=stepper)
        off = np.abs(np.asarray(motion.te) - wanted)
        assert off.max() < 2e-4 * np.ptp(wanted), name  # dampers that come and go with impacts: first order
        assert off[120:].max() < 1e-8 * np.ptp(wanted[120:]), name
        forces = np.asarray(motion.forces)
        assert (forces[80:, 1] > 0).all() == (torque < 0)
        assert (forces[:80] > 0).any(axis=0).all() == (torque < 0)


@pytest.mark.slow
@pytest.mark.parametrize("errors", [True, False])
def test_stiffness_follows_the_arc_length_within_long_blocks_of_steps(errors):
    """Teeth mesh by arc length, not evenly over time: fitted steps tend to Runge-Kutta steps with their square."""
    gears = dataclasses.replace(gj.load(ROOT / "configs" / "elliptic" / "dong_2020.toml"), run=None)
    system = dataclasses.replace(gears.system, eccentricity=0.2)
    gears = dataclasses.replace(gears, system=system, errors=gears.errors if errors else {})
    ts = np.linspace(0.0, 2 * np.pi / float(system.input_speed), 2001)
    exact = gj.simulate(gears, ts, 10.0, stepper=gj.FixedStep(per_sample=32, solver=gj.RungeKutta4())).te
    off = [
        float(jnp.abs(gj.simulate(gears, ts, 10.0, stepper=gj.FixedStep(per_sample=each)).te - exact).max())
        for each in (4, 16)
    ]
    assert off[0] < (2e-6 if errors else 6e-5) * float(jnp.ptp(exact))
    assert off[1] < off[0] / 12


@pytest.mark.slow
@pytest.mark.parametrize("supported", [False, True])
def test_default_steps_resolve_the_longest_levers_of_a_turn(supported):
    """At the start of a turn the levers are the shortest ones; the fastest rate grows with the levers."""
    gears = dataclasses.replace(gj.load(ROOT / "configs" / "elliptic" / "dong_2020.toml"), run=None)
    if supported:
        held = {"supports": {"driven": gj.Support(x=1e9)}, "body_inertia": {"driven": gj.BodyInertia(1.0)}}
        gears = dataclasses.replace(gears, **held)
    steps, levers = [], []
    for eccentricity in (0.0, 0.3, 0.6):
        own = dataclasses.replace(gears, system=dataclasses.replace(gears.system, eccentricity=eccentricity))
        steps.append(gj.chosen_steps(own, np.linspace(0.0, 0.5, 6), 10.0).step)
        turn = jnp.linspace(0.0, 2 * np.pi, 361)
        levers.append(jnp.abs(jax.vmap(lambda angle, own=own: own.contacts(angle).jacobian[:, 0])(turn)).max())
    ratios = np.array(steps) * np.array(levers) / (steps[0] * levers[0])
    assert (ratios < 1.02).all()
    assert (ratios > (0.7 if supported else 0.98)).all()  # beside x, along which the gear also moves, it is a bound


@pytest.mark.slow
def test_an_alternating_torque():
    """Three times in a turn it presses on either flank: teeth go from one to the other across the backlash."""
    speed, torque = 60.0, 30.0
    wanted = absolute(speed, torque, TS, turns=3.0)
    gears = moving(speed, load=gj.SinusoidalLoad(3.0 * speed / (2 * math.pi)))
    # through so many impacts the fitted scheme is of first order
    for stepper in (gj.FixedStep(per_sample=1600), gj.FixedStep(per_sample=400, solver=gj.RungeKutta4())):
        motion = gj.simulate(gears, TS, torque, start="zero", stepper=stepper)
        assert np.abs(np.asarray(motion.te) - wanted).max() < 1e-4 * np.ptp(wanted)
    assert (np.asarray(motion.forces)[40:] > 0).any(axis=0).all()


@pytest.mark.slow
@pytest.mark.parametrize("torque", [10.0, -25.0])
def test_speed_of_separation(torque):
    """Stiff teeth carry the load and the inertia of the ideal motion; just above that speed they let go."""
    speed = float(gj.separation_speed(moving(20.0), torque))
    if torque > 0:
        assert speed / rpm == pytest.approx(296.3537, abs=1e-4)
    t = np.linspace(0.0, 2 * math.pi, 400_001)
    lifts = -OWN.bend(t).min() if torque > 0 else OWN.bend(t).max()
    assert speed == pytest.approx(math.sqrt(abs(torque) / (INERTIA * lifts)), rel=1e-9)
    stiff = {"compliance": gj.HarmonicStiffness(1e10, [], []), "damping": gj.DampingRatio(0.3, "always")}
    ts = np.linspace(0.0, 2 * math.pi / speed, 401)
    least = []
    for share in (0.95, 1.12):
        gears = dataclasses.replace(moving(share * speed, **stiff), errors={})
        motion = gj.simulate(gears, ts / share, torque, stepper=gj.FixedStep(per_sample=200))
        least.append(float(np.asarray(motion.forces)[20:, 0 if torque > 0 else 1].min()))
    assert least[0] > 0
    assert least[1] == 0


def test_separation_is_for_uneven_outputs():
    with pytest.raises(SceneError, match="an output that turns unevenly; that of a two_kv does not"):
        gj.separation_speed(gj.load("configs/two_kv/wang_2020.toml"), 10.0)
    with pytest.raises(gj.ParameterError, match="must not be zero"):
        gj.separation_speed(moving(20.0), 0.0)
    with pytest.raises(SceneError, match="inertia"):
        gj.separation_speed(scene(), 10.0)


@pytest.mark.slow
def test_energy_over_a_turn():
    """Without a damper the input gives what the load takes and what is kept: the work by the force and the rate of its
    own distance at a held output."""
    speed, torque = 40.0, 60.0
    undamped = {"damping": None, "compliance": gj.HarmonicStiffness(STIFFNESS, [], [])}
    ts = np.linspace(0.0, 2 * math.pi / speed, 6284 * 4 + 1)
    motion = gj.simulate(moving(speed, **undamped), ts, torque, stepper=gj.FixedStep(per_sample=16))
    t, q, v = speed * ts, np.asarray(motion.te), np.asarray(motion.velocity)
    force = np.asarray(motion.forces)
    assert (force[:, 0] > 0).all()
    h = 1e-5
    around = [np.array([levers(x)[0] for x in t + d]) for d in (0.0, h, -h)]
    opening = (np.array([gaps(x)[0] for x in t + h]) - np.array([gaps(x)[0] for x in t - h])) / (2 * h)
    ratio = OWN.ratio(t)
    # the overlap changes with the input at a held output: q falls by the ratio, the lever turns, the gap opens
    closing = -around[0] * ratio + (around[1] - around[2]) / (2 * h) * q - opening
    given = force[:, 0] * closing * speed
    output = ratio * speed + v
    kept = 0.5 * INERTIA * output**2 + 0.5 * force[:, 0] ** 2 / STIFFNESS
    work = _integral(given, ts)
    taken = torque * (OWN.t2(t[-1]) + q[-1] - q[0]) + kept[-1] - kept[0]
    assert work == pytest.approx(taken, rel=1e-8)
    assert np.ptp(kept) > 0.05 * work


def _integral(values: np.ndarray, ts: np.ndarray) -> float:
    """By Simpson's rule."""
    step = ts[1] - ts[0]
    return float(step / 3 * (values[0] + values[-1] + 4 * values[1:-1:2].sum() + 2 * values[2:-1:2].sum()))


NUMBERS = {  # value, step of differences
    "system.eccentricity": (0.3287, 2e-4),
    "system.module": (MODULE, 3e-6),
    "system.centre_distance_error": (10 * um, 3e-6),
    "errors.driver.amplitude": (30 * um, 3e-6),
    "errors.driven.phase": (DRIVEN, 1e-3),
}


@pytest.mark.parametrize("clearance", ["linear", pytest.param("exact", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["no_load", "static", "ratio"])
def test_gradients(kind, clearance):
    """Under jit and vmap, by all numbers at once, against central differences."""
    gears = scene(system={"centre_distance_error": 10 * um, "clearance": clearance}, **MOVING)
    theta = jnp.linspace(0.0, 6.0, 41)
    weights = jnp.cos(3 * theta) + 0.3
    names = list(NUMBERS)

    def placed(values):
        parts = dict(zip(names, values, strict=True))
        system = {name.partition(".")[2]: parts.pop(name) for name in names if name.startswith("system")}
        driver = dataclasses.replace(gears.errors["driver"], amplitude=parts["errors.driver.amplitude"])
        driven = dataclasses.replace(gears.errors["driven"], phase=parts["errors.driven.phase"])
        own = dataclasses.replace(gears.system, **system)
        return dataclasses.replace(gears, system=own, errors={"driver": driver, "driven": driven})

    @jax.jit
    @jax.vmap
    @jax.value_and_grad
    def measure(values):
        own = placed(values)
        if kind == "ratio":
            return 1e3 * (gj.ratio_error(own, theta).error * weights).sum()
        torque = 15.0 if kind == "static" else None
        return 1e3 * (gj.transmission_error(own, theta, torque, extremes="samples").te * weights).sum()

    values = jnp.asarray([value for value, _ in NUMBERS.values()])
    steps = jnp.asarray([step for _, step in NUMBERS.values()])
    ends = values[None, None] + jnp.array([-2.0, -1.0, 1.0, 2.0])[:, None, None] * jnp.diag(steps)[None]
    found, (slopes, *_) = measure(jnp.concatenate([values[None], ends.reshape(-1, len(names))]))
    differences = found[1:].reshape(4, -1).T
    for number, (name, (_, step)) in enumerate(NUMBERS.items()):
        far, near, ahead, further = differences[number]
        wanted = (far - 8 * near + 8 * ahead - further) / (12 * step)
        assert float(slopes[number]) == pytest.approx(float(wanted), rel=1e-7), name


def test_gradient_by_the_centre_distance():
    """At a given one gears need not close while it is traced."""
    gears = scene()

    @jax.jit
    @jax.vmap
    def measure(distance):
        own = dataclasses.replace(gears, system=dataclasses.replace(gears.system, centre_distance=distance))
        return 1e3 * gj.transmission_error(own, jnp.linspace(0.0, 3.0, 21), extremes="samples").te.std()

    slope = jax.grad(lambda distance: measure(distance[None])[0])(jnp.asarray(0.145))
    far, near, ahead, further = measure(0.145 + 1e-4 * jnp.asarray([-2.0, -1.0, 1.0, 2.0]))
    assert float(slope) == pytest.approx(float((far - 8 * near + 8 * ahead - further) / 1.2e-3), rel=1e-7)


@pytest.mark.slow
def test_gradients_of_motion():
    gears = moving(60.0)
    ts = np.linspace(0.0, 0.02, 41)

    @jax.jit
    @jax.vmap
    @jax.value_and_grad
    def measure(e):
        system = dataclasses.replace(gears.system, eccentricity=e)
        motion = gj.simulate(dataclasses.replace(gears, system=system), ts, 40.0, stepper=gj.FixedStep(per_sample=40))
        return 1e5 * motion.te.std()

    step = 1e-6
    values, slopes = measure(jnp.asarray([0.3287 - step, 0.3287 + step, 0.3287]))
    assert float(slopes[2]) == pytest.approx(float((values[1] - values[0]) / (2 * step)), rel=1e-6)


@pytest.mark.slow
def test_speeds_known_too_late_are_no_fault():
    """Blocks for speeds that are traced suit slow bodies; the motion of fast ones is still right, and told so."""
    known = gj.load(ROOT / "configs/elliptic/dong_2020.toml")
    times, stepper = np.linspace(0.0, 0.005, 31), gj.FixedStep(per_sample=17, windows=None)
    known = dataclasses.replace(
        known, system=dataclasses.replace(known.system, input_speed=known.system.input_speed * 20)
    )
    motion = gj.simulate(known, times, 10.0, stepper=stepper)
    traced = eqx.filter_jit(lambda scene: gj.simulate(scene, times, 10.0, stepper=stepper))(known)
    assert int(motion.result) == int(traced.result) == 0
    np.testing.assert_allclose(traced.te, motion.te, rtol=0, atol=1e-11 * np.ptp(motion.te))
