"""Periodic motion of bodies on supports, and how disturbances of it grow: exact responses, scipy, one coordinate."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gearjax as gj
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.modes import StructureEquation
from gearjax.analysis.return_map import OfStructure, Problem, return_map
from gearjax.units import um
from tests.test_modes import LOADS, SCENES, on_supports, planets

SPEED, HEAVY = 300.0, 2000.0  # rad/s, and a torque that keeps every pair closed
ALWAYS = gj.DampingRatio(0.05, "always")
SHAKING = gj.HarmonicStiffness(2e8, [0.3], [0.0])
EVEN = gj.HarmonicStiffness(2e8, [0.0], [0.0])


def at_speed(scene: gj.Scene, speed: float) -> gj.Scene:
    return dataclasses.replace(scene, system=dataclasses.replace(scene.system, input_speed=speed))


def mesh_period(scene: gj.Scene) -> float:
    return 2 * np.pi / (scene.system.orders["mesh"] * float(scene.system.input_speed))


def linear(**changes) -> gj.Scene:
    """Planets on supports whose pairs never open."""
    given = {"errors": {}, "backlash": None, "compliance": EVEN, "damping": ALWAYS} | changes
    return at_speed(planets(**given), SPEED)


def structure_of(scene: gj.Scene, torque: float) -> StructureEquation:
    return StructureEquation.of(scene.physics(*MODELLED), jnp.asarray(torque))


def matrices(equation: StructureEquation) -> tuple[np.ndarray, ...]:
    """Mass, damping and stiffness with every pair closed, and what contacts and dampers do to the coordinates."""
    jacobian, parts = np.asarray(equation.jacobian), equation.structure
    assert equation.coefficient is not None
    springs = jacobian.T * float(EVEN.mean)
    dampers = jacobian.T * np.asarray(equation.coefficient)
    damping, stiffness = (np.asarray(part) for part in (parts.damping, parts.stiffness))
    return np.asarray(parts.mass), damping + dampers @ jacobian, stiffness + springs @ jacobian, springs, dampers


# responses that are known ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_linear_frequency_response():
    """Pairs that never open, driven by an eccentricity: every coordinate against one complex system of equations."""
    scene = linear(errors={"planet": gj.Eccentricity("planet_1", 5 * um, 0.3)})
    order = scene.system.orders["planet"]
    rate = order * SPEED
    period = 2 * np.pi / rate
    mass, damping, stiffness, springs, dampers = matrices(structure_of(scene, HEAVY))
    impedance = stiffness - rate**2 * mass + 1j * rate * damping
    errors = []
    for steps in (512, 2048):
        ts = np.arange(steps) * period / steps
        gaps = np.asarray(jax.vmap(lambda theta: scene.contacts(theta).gap)(jnp.asarray(SPEED * ts)))
        wave = np.fft.rfft(gaps, axis=0) / steps
        assert abs(wave[2:]).max() < 1e-9 * abs(wave[1]).max()
        turning = np.linalg.solve(impedance, (springs + 1j * rate * dampers) @ wave[1])
        expected = 2 * (turning[None, :] * np.exp(1j * rate * ts)[:, None]).real
        found = gj.shooting(scene, HEAVY, period, steps=steps)
        assert int(found.result) == 0
        assert bool(found.stable)
        assert found.coordinates == scene.coordinates
        moving = np.asarray(found.q) - np.asarray(found.q).mean(axis=0)
        errors.append((abs(moving - expected).max(axis=0) / abs(expected).max(axis=0)).max())
    assert errors[1] < 3e-7
    assert np.log2(errors[0] / errors[1]) / 2 > 2.7


@pytest.mark.slow
def test_multipliers_of_a_linear_structure():
    """They are exponentials of its eigenvalues, whose largest real part is how fast a disturbance grows."""
    scene = linear()
    period = mesh_period(scene)
    mass, damping, stiffness, *_ = matrices(structure_of(scene, HEAVY))
    inverse, size = np.linalg.inv(mass), len(mass)
    states = np.block([[np.zeros((size, size)), np.eye(size)], [-inverse @ stiffness, -inverse @ damping]])
    exact = np.linalg.eigvals(states)
    found = np.asarray(gj.shooting(scene, HEAVY, period, steps=128).multipliers)
    wanted = np.exp(exact * period)
    apart = abs(found[:, None] - wanted[None, :])
    assert apart.min(axis=1).max() < 1e-9
    assert apart.min(axis=0).max() < 1e-9
    ts = np.linspace(0.0, 800 * period, 1601)
    rate = gj.growth_rate(scene, ts, HEAVY)
    assert float(rate) == pytest.approx(exact.real.max(), rel=1e-2)


@pytest.mark.slow
def test_volumes_shrink_as_the_dampers_say():
    """Liouville: the product of the multipliers is exp(- tr(M^-1 C) T), whatever the stiffness does; third order."""
    scene = linear(compliance=SHAKING)
    period = mesh_period(scene)
    mass, damping, *_ = matrices(structure_of(scene, HEAVY))
    expected = -np.trace(np.linalg.solve(mass, damping)) * period
    errors = []
    for steps in (32, 64, 128):
        found = gj.shooting(scene, HEAVY, period, steps=steps)
        errors.append(abs(np.log(abs(np.asarray(found.multipliers))).sum() / expected - 1))
    assert errors[-1] < 1e-4
    assert np.log2(errors[0] / errors[-1]) / 2 > 2.7


# motions with impacts -------------------------------------------------------------------------------------------


def separating(name: str) -> tuple[gj.Scene, float, float]:
    """A scene, its torque and the period of its mesh, with pairs that open."""
    changes = {"errors": {}, "compliance": gj.HarmonicStiffness(2e8, [0.45], [0.0]), "damping": gj.DampingRatio(0.02)}
    if name == "rv_cycloidal":
        changes = {"errors": {}, "damping": gj.DampingRatio(0.05)}
    scene = SCENES[name](**changes)
    scene = at_speed(scene, {"two_kv": 500.0, "rv_cycloidal": 400.0}[name])
    return scene, LOADS[name], mesh_period(scene)


@pytest.mark.slow
@pytest.mark.parametrize("acting", ["always", "contact"])
def test_slope_of_the_return_map(acting):
    """Through contacts that open: products of matrices against forward mode, in float64 and float32."""
    scene, torque, period = separating("two_kv")
    scene = dataclasses.replace(scene, damping=gj.DampingRatio(0.02, acting))

    def both(scene: gj.Scene) -> tuple[OfStructure, list, list]:
        motion = return_map(Problem.of(scene, torque, period), 128)
        assert isinstance(motion, OfStructure)
        assert motion.even.lines.apart
        start = (1.5 * motion.resting() / motion.scale).ravel()

        def end(flat):
            return (motion.end(flat.reshape(2, -1)).ravel(),) * 2

        slope, ended = jax.jit(jax.jacfwd(end, has_aux=True))(start)
        return motion, jax.jit(lambda flat: motion.end_and_slope(flat))(start), (ended, slope)

    motion, found, expected = both(scene)
    places = motion.course(1.5 * motion.resting() / motion.scale).states[:, 0] * motion.scale[:1]
    equation = motion.even.lines.equation
    forces = jax.vmap(equation.forces)(motion.even.step * jnp.arange(129.0), places)
    assert ((forces > 0).any(axis=0) & (forces == 0).any(axis=0)).any(), "a pair opens"
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * float(abs(other).max()))
    _, single, _ = both(jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene))
    for one, other in zip(single, expected, strict=True):
        assert one.dtype == jnp.float32
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-3 * float(abs(other).max()))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_motion_returns(name):
    """From the start that was found, scipy comes back to it after a period; its slopes have the same multipliers."""
    scene, torque, period = separating(name)
    found = gj.shooting(scene, torque, period, steps=2048, settle=40)
    assert int(found.result) == 0
    equation = structure_of(scene, torque)
    forces = np.asarray(jax.vmap(equation.forces)(found.ts, found.q))
    carries = forces[:, forces.max(axis=0) > 0]
    assert (carries == 0).any(axis=0).any(), "pairs open and close"
    scale = np.asarray(equation.scale) * np.array([[1.0], [float(equation.frequency)]])
    begin = (np.asarray(found.start) / scale).ravel()
    rate = jax.jit(lambda time, state: equation.rate(equation.excitation(time), state.reshape(scale.shape)).ravel())

    def after(state):
        span = period * float(equation.frequency)
        whole = solve_ivp(
            lambda tau, y: np.asarray(rate(tau / equation.frequency, y)),
            (0.0, span),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
            max_step=span / 200,
        )
        return whole.y[:, -1]

    size = abs(np.asarray(found.q) / scale[0]).max()
    assert abs(after(begin) - begin).max() < 1e-5 * size
    step = 1e-5 * size
    slope = np.stack([(after(begin + step * e) - after(begin - step * e)) / (2 * step) for e in np.eye(len(begin))])
    wanted = np.linalg.eigvals(slope.T)
    got = np.asarray(found.multipliers)
    assert abs(got[:, None] - wanted[None, :]).min(axis=1).max() < 2e-3
    again = gj.shooting(scene, torque, period, steps=2048, guess=found.start)
    np.testing.assert_allclose(again.q, found.q, rtol=0, atol=1e-9 * size * scale[0].max())


@pytest.mark.slow
def test_a_sweep_ends_where_shooting_is():
    """On bodies that give way: the settled motion at each speed is a periodic one, of three periods at the first."""
    scene, torque, _ = separating("two_kv")
    speeds = np.array([490.0, 500.0, 510.0])
    sweep = gj.speed_sweep(scene, torque, speeds, periods=400, steps=256)
    assert sweep.ends.shape == (3, 2, len(scene.coordinates))
    for speed, end, periods in zip(speeds, sweep.ends, (3, 1, 1), strict=True):
        turned = at_speed(scene, speed)
        period = mesh_period(turned)
        found = gj.shooting(turned, torque, periods * period, steps=periods * 256, guess=end)
        assert int(found.result) == 0
        assert bool(found.stable)
        for row, wanted in zip(found.start, end, strict=True):
            np.testing.assert_allclose(row, wanted, rtol=0, atol=1e-6 * float(abs(wanted).max()))
        once = gj.shooting(turned, torque, period, steps=256, guess=end)
        assert (float(abs(once.start - end).max()) > 1e-3 * float(abs(end).max())) == (periods == 3)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "periods"), [(490.0, 3), (500.0, 1)])
def test_what_it_settles_to(speed, periods):
    """The motion that long integration ends at, of three periods at one speed, found without being told so."""
    scene, torque, _ = separating("two_kv")
    scene = at_speed(scene, speed)
    period = mesh_period(scene)
    found = gj.periodic_motion(scene, torque, period, steps=256)
    assert int(found.result) == 0
    assert bool(found.stable)
    assert found.periods == periods
    assert len(found.ts) == 256 * periods
    moved = found.start * (1 + 1e-4)  # a disturbance dies out: the motion is what integration ends at
    again = gj.shooting(scene, torque, periods * period, steps=periods * 256, guess=moved, settle=100, max_steps=1)
    np.testing.assert_allclose(again.q, found.q, rtol=0, atol=1e-7 * float(abs(found.q[:, 0]).max()))
    once = gj.shooting(scene, torque, period, steps=256, guess=found.start)
    assert (float(abs(once.te[0] - found.te[0])) > 1e-3 * float(jnp.ptp(found.te))) == (periods == 3)
    with pytest.raises(gj.SceneError, match="use shooting under jit"):
        jax.jit(lambda load: gj.periodic_motion(scene, load, period).te)(torque)


@pytest.mark.slow
def test_what_repeats_later_or_never():
    """The 2K-V under a torque that alternates at the mesh frequency: after two periods, after five, chaotic."""
    scene = gj.load("configs/two_kv/wang_2020.toml")
    scene = dataclasses.replace(scene, errors={}, load=gj.SinusoidalLoad("mesh"), run=None)
    period = mesh_period(scene)
    twice = gj.periodic_motion(scene, 100.0, period, steps=256)
    assert (int(twice.result), twice.periods) == (0, 2)
    often = gj.periodic_motion(scene, 30.0, period, steps=1024, longest=5)
    assert (int(often.result), often.periods) == (0, 5)
    never = gj.periodic_motion(scene, 10.0, period, steps=256, settle=60)
    assert (int(never.result), never.periods) == (2, 4)
    assert len(never.ts) == 1024
    assert float(gj.growth_rate(scene, np.linspace(0.0, 400 * period, 4001), 10.0)) > 0


@pytest.mark.slow
def test_it_tends_to_the_output_alone():
    """As supports stiffen, the difference falls in proportion to their compliance."""
    changes = {"errors": {}, "compliance": gj.HarmonicStiffness(2e8, [0.3], [0.0]), "damping": ALWAYS}
    own = at_speed(planets(**changes), SPEED)
    alone = dataclasses.replace(own, supports={}, body_inertia={})
    period = mesh_period(own)
    exact = gj.shooting(alone, 100.0, period, steps=512)
    differences = []
    for stiff in (1e11, 1e12):
        near = gj.shooting(on_supports(alone, stiff=stiff, mass=0.01), 100.0, period, steps=512)
        assert int(near.result) == 0
        differences.append(float(jnp.abs(near.te - exact.te).max()))
    assert differences[0] / differences[1] == pytest.approx(10.0, rel=0.15)
    assert differences[1] < 1e-2 * float(jnp.ptp(exact.te))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SCENES, "balance"])
def test_implicit_gradients(name):
    """Of the alternating part, with respect to torque, support and mass, under jit and vmap: differences."""
    scene, torque, period = separating("two_kv" if name == "balance" else name)
    body = next(iter(scene.supports))

    @jax.jit
    @jax.vmap
    def measure(numbers):
        support = dataclasses.replace(scene.supports[body], y=scene.supports[body].y * numbers[1])
        moved = dataclasses.replace(
            scene,
            supports={**scene.supports, body: support},
            body_inertia={**scene.body_inertia, body: gj.BodyInertia(0.8 * numbers[2])},
        )
        if name == "balance":
            return 1e6 * gj.harmonic_balance(moved, torque * numbers[0], period, harmonics=3, samples=64).std
        return 1e6 * gj.shooting(moved, torque * numbers[0], period, steps=256, settle=20).std

    at = jnp.array([1.0, 1.05, 0.97])
    reverse = jax.grad(lambda x: measure(x[None])[0])(at)
    step = 1e-6
    moves = jnp.stack([at + side * step * unit for side in (1, -1) for unit in jnp.eye(3)])
    values = measure(moves)
    central = (values[:3] - values[3:]) / (2 * step)
    if name == "two_kv":
        forward = jax.jacfwd(lambda x: measure(x[None])[0])(at)
        np.testing.assert_allclose(reverse, forward, rtol=1e-6, atol=1e-9 * float(jnp.abs(reverse).max()))
    np.testing.assert_allclose(reverse, central, rtol=2e-4, atol=1e-5 * float(jnp.abs(reverse).max()))


@pytest.mark.slow
def test_harmonic_balance_of_a_linear_structure():
    """Driven by an eccentricity and by stiffness: what shooting finds with many steps, in every coordinate."""
    errors = {"planet": gj.Eccentricity("planet_1", 5 * um, 0.3)}
    for scene, harmonics, allowed in ((linear(errors=errors), 1, 2e-7), (linear(compliance=SHAKING), 12, 1e-6)):
        order = "planet" if harmonics == 1 else "mesh"
        period = 2 * np.pi / (scene.system.orders[order] * SPEED)
        found = gj.harmonic_balance(scene, HEAVY, period, harmonics=harmonics, samples=64)
        steps = gj.shooting(scene, HEAVY, period, steps=2048 if harmonics == 1 else 1024)
        assert int(found.result) == 0
        assert found.coordinates == scene.coordinates
        near, true = np.asarray(found.q), np.asarray(steps.q)[:: len(steps.ts) // 64]
        size = abs(true - true.mean(axis=0)).max(axis=0)
        assert (abs(near - true).max(axis=0) / size).max() < allowed
        assert abs(np.asarray(found.start)[1] - np.asarray(steps.start)[1]).max() < 1e-5 * float(
            jnp.ptp(steps.velocity)
        )


@pytest.mark.slow
def test_harmonic_balance_through_impacts():
    """It closes in on shooting as harmonics are added, from a guess of all coordinates: forces without jumps."""
    scene, torque, period = separating("two_kv")
    scene = dataclasses.replace(scene, damping=gj.DampingRatio(0.02, "always"))
    exact = gj.shooting(scene, torque, period, steps=2048, settle=40)
    errors = []
    for harmonics in (8, 32):
        found = gj.harmonic_balance(scene, torque, period, harmonics=harmonics, samples=1024, guess=exact.q)
        assert int(found.result) == 0
        errors.append(float(jnp.abs(found.q - exact.q[::2])[:, 0].max() / jnp.ptp(exact.te)))
    assert errors[1] < 1e-4
    assert errors[1] < errors[0] / 20


def test_what_does_not_suit_is_named():
    scene = planets()
    with pytest.raises(
        gj.ParameterError, match=r"guess = \(9,\): is a shape: give output, planet_1.x, .*, shape \(n, 5\)"
    ):
        gj.harmonic_balance(scene, 100.0, 15.8, guess=np.zeros(9))
    with pytest.raises(
        gj.ParameterError, match=r"guess = \(2,\): is a shape: give output, planet_1.x, .*, shape \(2, 5\)"
    ):
        gj.shooting(scene, 100.0, 15.8, guess=np.zeros(2))
