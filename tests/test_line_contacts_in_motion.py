"""Motion with line contacts of pins and of slices: against a program apart, energy, the static limit, differences."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import lambertw

import gearjax as gj
from gearjax.units import mm, um
from tests.helical_pairs import GUO_1, STEEL, scene_of

STIFF, SPEED, RATIO = gj.HertzLineContact(206e9, 0.3, 11 * mm), 100.0, 0.06
ERRORS = {
    "pins": gj.Positions("pin_ring", [0.5 * um, -0.3 * um, 0.2 * um] * 4, []),
    "disc": gj.Eccentricity("disc_1", 2 * um, 0.4),
}
RELIEFS = {"tip": gj.TipRelief("pinion", 20 * um, 8 * mm), "crowning": gj.Crowning("pinion", 12 * um)}


def pins(damping=RATIO, acting="contact", law=STIFF, errors=ERRORS, inertia=0.5, **changes):
    """A pin stage of two discs with twelve pins, and what its motion needs."""
    own = {"pins": 12, "pin_circle": 40 * mm, "pin_radius": 3 * mm, "eccentricity": 1.5 * mm, "discs": 2}
    profile = {"isometric_modification": -20 * um, "shifting_modification": -35 * um, "input_speed": SPEED}
    parts = {"load": gj.ConstantLoad(), "inertia": gj.MomentOfInertia(inertia)}
    if damping:
        parts["damping"] = gj.DampingRatio(damping, acting=acting)
    return gj.Scene(gj.RVCycloidal(**(own | profile | changes)), errors, compliance=law, **parts)


def slices(damping=RATIO, errors=RELIEFS, inertia=0.0587, law=None, **changes):
    """A helical pair on Hertzian slices, and what its motion needs."""
    law = gj.ToothSlices(**STEEL, contact="hertz") if law is None else law
    scene = scene_of(GUO_1, errors, law, None, **({"input_speed": 220.0, "slices": 6} | changes))
    parts = {"load": gj.ConstantLoad(), "inertia": gj.MomentOfInertia(inertia)}
    return dataclasses.replace(scene, **parts, **({"damping": gj.DampingRatio(damping)} if damping else {}))


def forces_of(slope, level, overlap):
    """Forces of line contacts, ``slope F (level - ln F)``, by the Lambert function of scipy."""
    closed = overlap > 0
    x = np.where(closed, overlap / slope * np.exp(-level), 0.1)
    return np.where(closed, np.exp(level + lambertw(-x, -1).real), 0.0)


def stiffness_of(slope, level, force):
    """Change of force per approach, by a difference of the formula."""
    step = 1e-6 * force
    apart = [slope * f * (level - np.log(f)) for f in (force + step, force - step)]
    return 2 * step / (apart[0] - apart[1])


def as_apart(scene, ts, torque, coefficient, start):
    """Positions by scipy, with the contacts that statics have; ``coefficient`` gives dampers from slopes and levels."""
    speed, inertia = float(scene.system.input_speed), float(scene.inertia.moment_of_inertia)

    @jax.jit
    def contacts(theta):
        def both(theta):
            found = scene.contacts(theta, "varying")
            return (found.jacobian[:, 0], found.gap), (found.springs.slope, found.springs.level)

        now, rates, springs = jax.jvp(both, (theta,), (jnp.asarray(speed),), has_aux=True)
        return *now, *rates, *springs

    def rate(time, state):
        lever, gap, lever_rate, gap_rate, slope, level = map(np.asarray, contacts(jnp.asarray(speed * time)))
        overlap = lever * state[0] - gap
        approach = lever * state[1] + lever_rate * state[0] - gap_rate
        force = forces_of(slope, level, overlap) + coefficient(slope, level) * (overlap > 0) * approach
        return state[1], (-torque - lever @ force) / inertia

    return solve_ivp(rate, (ts[0], ts[-1]), start, "DOP853", ts, rtol=1e-9, atol=1e-14, max_step=2e-5).y[0]


@pytest.mark.slow
@pytest.mark.parametrize("torque", [400.0, 15.0])
def test_pins_move_as_by_a_program_apart(torque):
    """Dampers are those of the mean stiffness under the force that pins have if all of a flank share the torque."""
    scene, ts = pins(), np.linspace(0.0, 4e-3, 81)
    motion = gj.simulate(scene, ts, torque)
    first = scene.contacts(jnp.zeros(()), "varying")
    lever, slope, level = np.asarray(first.lever), np.asarray(first.springs.slope), np.asarray(first.springs.level)
    mean = np.full_like(lever, torque / -lever[lever < 0].sum())
    mass = 0.5 / np.mean(lever**2)
    own = 2 * RATIO * np.sqrt(0.5 * mass * stiffness_of(slope, level, mean).mean())
    place = as_apart(scene, ts, torque, lambda *_: own, (float(motion.te[0]), float(motion.velocity[0])))
    np.testing.assert_allclose(motion.te, place, rtol=0, atol=1e-4 * np.ptp(place))
    short = gj.FixedStep(per_sample=32)
    np.testing.assert_allclose(
        gj.simulate(scene, ts, torque, stepper=short).te, place, rtol=0, atol=3e-7 * np.ptp(place)
    )


@pytest.mark.slow
def test_slices_move_as_by_a_program_apart():
    """Slices have dampers in proportion to their stiffness under the mean force per length. They are altogether as many
    as pairs touch on average, for the mean mass and stiffness of the mesh."""
    scene, torque = slices(), 600.0
    ts = np.linspace(0.0, 2 * 2 * math.pi / (19 * 220.0), 129)
    motion = gj.simulate(scene, ts, torque)
    first = scene.contacts(jnp.zeros(()), "varying")
    lever, slope = np.asarray(first.lever), np.asarray(first.springs.slope)
    pressed = torque / (np.abs(lever) / slope).sum()  # slope F of all slices

    def stiffness(slope, level):
        return stiffness_of(slope, level, pressed / slope)

    period, ideal = 2 * math.pi / 19, dataclasses.replace(scene, errors={})
    at = jax.jit(jax.vmap(lambda theta: ideal.contacts(theta, "varying")))(period * np.arange(128) / 128)
    touches = np.asarray(at.gap) < 1e-9
    mean = (touches * stiffness(np.asarray(at.springs.slope), np.asarray(at.springs.level))).sum(axis=1).mean()
    pairs, mass = float(scene.system.pair.total_contact_ratio), 0.0587 / np.mean(lever**2)
    delay = RATIO * math.sqrt(2 * pairs * mass / mean)
    start = float(motion.te[0]), float(motion.velocity[0])
    place = as_apart(scene, ts, torque, lambda slope, level: delay * stiffness(slope, level), start)
    np.testing.assert_allclose(motion.te, place, rtol=0, atol=2e-3 * np.ptp(place))
    short = gj.FixedStep(per_sample=64)
    np.testing.assert_allclose(
        gj.simulate(scene, ts, torque, stepper=short).te, place, rtol=0, atol=5e-5 * np.ptp(place)
    )


@pytest.mark.slow
@pytest.mark.parametrize("scene", [pins(damping=None, input_speed=1e-6), slices(damping=None, input_speed=1e-6)])
def test_a_motion_without_dampers_keeps_its_energy(scene):
    """Gears that hardly turn, released from the ideal position."""
    torque, ts = 300.0, np.linspace(0.0, 3e-3, 301)
    motion = gj.simulate(scene, ts, torque, start="zero", stepper=gj.FixedStep(per_sample=16))
    springs = scene.contacts(jnp.zeros(()), "varying").springs
    force = np.asarray(motion.forces)
    safe = np.where(force > 0, force, 1.0)
    slope, level = np.asarray(springs.slope), np.asarray(springs.level)
    stored = (0.5 * slope * force**2 * (level - np.log(safe) - 0.5)).sum(axis=1)
    moving = 0.5 * float(scene.inertia.moment_of_inertia) * np.asarray(motion.velocity) ** 2
    energy = moving + stored + torque * np.asarray(motion.te)
    assert stored.max() > 0.02
    np.testing.assert_allclose(energy, 0.0, rtol=0, atol=1e-6 * stored.max())


@pytest.mark.slow
@pytest.mark.parametrize("make", [pins, slices])
def test_a_slow_motion_follows_the_statics(make):
    """The difference falls with the speed, because dampers cause it."""
    apart = []
    for speed in (0.5, 0.05):
        scene = make(input_speed=speed)
        mesh = 12 if make is pins else 19
        ts = np.linspace(0.0, 0.3 * 2 * math.pi / mesh / speed, 13)
        motion = gj.simulate(scene, ts, 250.0)
        still = gj.transmission_error(scene, speed * ts, 250.0)
        apart.append(float(jnp.abs(motion.te - still.te).max()) / np.ptp(still.te))
        np.testing.assert_allclose(motion.forces, still.forces, rtol=0, atol=speed * 5e-3 * float(still.forces.max()))
    assert apart[0] < 5e-3
    assert apart[1] < 0.15 * apart[0]


@pytest.mark.slow
def test_steps_converge_to_third_order():
    scene, ts = pins(acting="always"), np.linspace(0.0, 4e-3, 81)
    te = [gj.simulate(scene, ts, 400.0, stepper=gj.FixedStep(per_sample=each)).te for each in (2, 4, 8, 64)]
    errors = [float(jnp.abs(one - te[-1]).max()) for one in te[:-1]]
    assert all(one / other > 5 for one, other in itertools.pairwise(errors)), errors


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pins", "slices"])
def test_gradients_are_differences(kind):
    """Under vmap and jit, by the torque, Young's modulus, an error, and the speed."""
    ts = jnp.linspace(0.0, 1.5e-3, 31)

    def power(numbers, torque):
        load, stiff, error, speed = 1 + numbers
        if kind == "pins":
            errors = ERRORS | {"disc": gj.Eccentricity("disc_1", 2 * um * error, 0.4)}
            scene = pins(law=gj.HertzLineContact(206e9 * stiff, 0.3, 11 * mm), errors=errors, input_speed=SPEED * speed)
        else:
            errors = RELIEFS | {"tip": gj.TipRelief("pinion", 20 * um * error, 8 * mm)}
            law = gj.ToothSlices(**STEEL | {"youngs_modulus": 206e9 * stiff}, contact="hertz")
            scene = slices(errors=errors, law=law, input_speed=220.0 * speed, pairs=3)
        motion = gj.simulate(scene, ts, torque * load, stepper=gj.FixedStep(per_sample=2))
        return 1e9 * jnp.mean(motion.te**2) + 1e-6 * jnp.mean(motion.forces**2)

    both = jax.jit(jax.vmap(jax.value_and_grad(power), (None, 0)))
    torques, step = jnp.asarray([200.0, 400.0]), 1e-5
    slopes = both(jnp.zeros(4), torques)[1]
    for place, way in enumerate(step * np.eye(4)):
        difference = (both(way, torques)[0] - both(-way, torques)[0]) / (2 * step)
        np.testing.assert_allclose(slopes[:, place], difference, rtol=1e-5)


@pytest.mark.slow
def test_periodic_motions_are_those_of_a_long_simulation():
    scene, period = pins(damping=0.2, errors={}), 2 * math.pi / 12 / SPEED
    settled = gj.simulate(scene, np.linspace(0.0, 40 * period, 40 * 64 + 1), 400.0).te[-65:-1]
    shot = gj.shooting(scene, 400.0, period, steps=256)
    balanced = gj.harmonic_balance(scene, 400.0, period, harmonics=24)
    assert int(shot.result) == int(balanced.result) == 0
    np.testing.assert_allclose(shot.te[::4], settled, rtol=0, atol=2e-3 * np.ptp(settled))
    np.testing.assert_allclose(balanced.te[::6], settled, rtol=0, atol=5e-3 * np.ptp(settled))


@pytest.mark.slow
def test_pins_of_a_body_on_supports_move_as_by_other_steps():
    """The crank's bearings give way. Motion tends to that of rigid bearings as they become stiffer."""
    ts = np.linspace(0.0, 2e-3, 41)
    rigid = gj.simulate(pins(), ts, 400.0).te
    apart = []
    for stiff in (1e9, 1e10):
        held = dataclasses.replace(
            pins(), supports={"disc_1": gj.Support(x=stiff, y=stiff)}, body_inertia={"disc_1": gj.BodyInertia(0.8)}
        )
        motion = gj.simulate(held, ts, 400.0)
        other = gj.simulate(held, ts, 400.0, stepper=gj.FixedStep(per_sample=64, solver=gj.RungeKutta4()))
        np.testing.assert_allclose(motion.te, other.te, rtol=0, atol=2e-3 * np.ptp(other.te))
        apart.append(float(jnp.abs(motion.te - rigid).max()))
    assert 5 < apart[0] / apart[1] < 20


@pytest.mark.slow
def test_steps_of_uneven_samples_are_the_same_where_errors_are_traced():
    """Steps of Runge-Kutta resolve stiff supports too, and records that are too long are refused."""
    scene = pins(damping=None, law=gj.HarmonicStiffness(1.6e8, [], []))
    held = dataclasses.replace(
        scene, supports={"disc_1": gj.Support(x=1e11, y=1e11)}, body_inertia={"disc_1": gj.BodyInertia(0.8)}
    )

    def motion(amplitude, ts):
        errors = ERRORS | {"disc": gj.Eccentricity("disc_1", amplitude, 0.4)}
        return gj.simulate(dataclasses.replace(held, errors=errors), ts, 300.0)

    uneven = np.linspace(0.0, 1.0, 31) ** 1.1 * 1e-3
    known, traced = motion(2 * um, uneven), jax.jit(lambda amplitude: motion(amplitude, uneven))(2 * um)
    assert int(traced.result) == 0
    np.testing.assert_allclose(traced.te, known.te, rtol=0, atol=1e-12 * np.ptp(known.te))
    with pytest.raises(gj.SceneError, match=r"needs .* steps"):
        jax.jit(lambda amplitude: motion(amplitude, np.linspace(0.0, 1e6, 11)).te)(2 * um)
