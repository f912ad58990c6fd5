"""Motion of bodies on supports: against adaptive solvers, energy, exponentials, one coordinate, differences."""

import dataclasses

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import gearjax as gj
from gearjax.analysis.choice import MODELLED, suitable_step
from gearjax.analysis.modes import ForcedTerm, Spacing, Steps, StructureEquation, march
from gearjax.analysis.modes.parabola import exponential, weights
from gearjax.checks import SceneError
from gearjax.units import mm, um

STIFF = 2e8
SMALL_RV = {"pins": 6, "pin_circle": 20 * mm, "pin_radius": 2 * mm, "eccentricity": 1.2 * mm, "discs": 1}
TS = np.linspace(0.0, 0.02, 11)


def on_supports(scene: gj.Scene, stiff: float = STIFF, mass: float = 0.8, damper: float | None = 300.0) -> gj.Scene:
    supports = {
        body: gj.Support(x=stiff, y=1.3 * stiff, x_damping=damper, y_damping=damper)
        for body in scene.system.coordinates
    }
    inertia = {body: gj.BodyInertia(mass) for body in supports}
    return dataclasses.replace(scene, supports=supports, body_inertia=inertia)


def planets(**changes) -> gj.Scene:
    own = gj.load("configs/two_kv/wang_2020.toml")
    return on_supports(
        dataclasses.replace(own, **{k: v for k, v in changes.items() if k in SLOTS}),
        **{k: v for k, v in changes.items() if k not in SLOTS},
    )


def disc(**changes) -> gj.Scene:
    own = gj.load("configs/rv_cycloidal/hu_2020.toml")
    small = dataclasses.replace(own.system, **SMALL_RV, input_speed=100.0)
    errors = {"disc": gj.Eccentricity("disc_1", 3 * um, 0.3)}
    given = {k: v for k, v in changes.items() if k in SLOTS}
    whole = dataclasses.replace(
        own, **({"system": small, "errors": errors, "inertia": gj.EquivalentMass(30.0)} | given)
    )
    return on_supports(whole, **{k: v for k, v in changes.items() if k not in SLOTS})


SLOTS = {field.name for field in dataclasses.fields(gj.Scene)}
SCENES = {"two_kv": planets, "rv_cycloidal": disc}
LOADS = {"two_kv": 100.0, "rv_cycloidal": 50.0}


def truth(scene: gj.Scene, torque: float, ts=TS, **more) -> gj.Motion:
    found = gj.simulate(scene, ts, torque, stepper=gj.AdaptiveStep(1e-11, 1e-11), **more)
    assert int(found.result) == 0
    return found


# a structure alone ---------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("stiff", [1.0, 1e10])
def test_a_parabola_of_inputs_is_exact(stiff, rng):
    """Rigid, overdamped, repeated and very stiff modes alike."""
    springs = np.diag([0.0, 2.0, 2.0, stiff])
    dampers = np.diag([0.0, 50.0, 0.1, 1.0])
    rate = np.sqrt(np.maximum(np.diag(springs), 1.0))  # velocities over it, as those of a scene
    matrix = np.block([[np.zeros((4, 4)), np.diag(rate)], [-springs / rate[:, None], -dampers]])
    inputs = np.concatenate([np.zeros((4, 2)), rng.normal(size=(4, 2))])
    step, start, bends = 0.3, rng.normal(size=8), rng.normal(size=(3, 2))
    found = weights(jnp.asarray(step * matrix), jnp.asarray(step * inputs))
    before, now, after = (bends.T @ np.array([1.0, t, t * t]) for t in (-step, 0.0, step))
    # the input's own powers of time are three more states
    wide = np.zeros((11, 11))
    wide[:8, :8], wide[:8, 8:] = matrix, inputs @ bends.T
    wide[9, 8], wide[10, 9] = 1.0, 2.0
    exact = (expm(step * wide) @ np.concatenate([start, [1.0, 0.0, 0.0]]))[:8]
    got = found.kept @ start + found.before @ before + found.now @ now + found.after @ after
    np.testing.assert_allclose(got, exact, rtol=1e-12, atol=1e-16 * max(1e4, step * np.sqrt(stiff) * 1e4))


@pytest.mark.slow
def test_as_a_solver_of_diffrax():
    """Third order where the input depends on the state, in one program that has a gradient."""
    springs = np.array([[3.0, -1.0], [-1.0, 2.0]])
    matrix = jnp.asarray(np.block([[np.zeros((2, 2)), np.eye(2)], [-springs, -0.1 * springs]]))
    inputs = jnp.asarray([[0.0], [0.0], [1.0], [0.5]])
    start = jnp.array([0.2, -0.1, 0.4, 0.3])

    def push(time, state, args):
        return jnp.stack([args * jnp.sin(1.3 * time) - 0.8 * state[0] ** 3])

    def end(number, size):
        step = 6.0 / number
        term = ForcedTerm(lambda t, y, args: push(step * t, y, args))
        solver = gj.ExponentialParabola(step * matrix, step * inputs)
        found = diffrax.diffeqsolve(term, solver, 0.0, float(number), 1.0, start, size, max_steps=number + 8).ys
        assert found is not None
        return found[-1]

    exact = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: matrix @ y + inputs @ push(t, y, args)),
        diffrax.Dopri8(),
        0.0,
        6.0,
        0.01,
        start,
        1.0,
        stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-12),
    ).ys
    assert exact is not None
    errors = [float(jnp.abs(end(number, 1.0) - exact[-1]).max()) for number in (40, 80, 160)]
    assert min(np.log2(np.array(errors[:-1]) / errors[1:])) > 2.8
    assert errors[-1] < 1e-5
    slope = jax.grad(lambda size: end(40, size)[0])(1.0)
    central = (end(40, 1.0 + 1e-5)[0] - end(40, 1.0 - 1e-5)[0]) / 2e-5
    assert float(slope) == pytest.approx(float(central), rel=1e-7)


# motions against the plain equation ----------------------------------------------------------------------------


ALWAYS = gj.DampingRatio(0.05, "always")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_kv", pytest.param("rv_cycloidal", marks=pytest.mark.slow)])
def test_third_order_from_the_equilibrium(name):
    """Levers that stand still, and those that turn while pins open and close."""
    scene, torque = SCENES[name](damping=ALWAYS), LOADS[name]
    exact, errors = truth(scene, torque), []
    few = {"two_kv": 60, "rv_cycloidal": 256}[name]
    for number in (few, 2 * few):
        found = gj.simulate(scene, TS, torque, stepper=gj.FixedStep(per_sample=number))
        errors.append(np.abs(np.asarray(found.q - exact.q)).max(axis=0))
        assert found.coordinates == scene.coordinates == exact.coordinates
    travel = np.ptp(np.asarray(exact.q), axis=0)
    assert (travel > 1e-9).all()
    assert (errors[1] < 3e-5 * travel).all()
    assert np.log2(errors[0][0] / errors[1][0]) > 2.6


# a torque to and fro for two_kv, which flies through its clearance; how many times as many steps gain what
FREE = {
    "dampers that come and go": ({"damping": gj.DampingRatio(0.05)}, 16, 40.0),
    "dampers that always act": ({"damping": ALWAYS}, 4, 40.0),
    "no dampers": ({"damping": None}, 4, 40.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", FREE)
@pytest.mark.parametrize("name", SCENES)
def test_contacts_that_open_and_close_and_hit_both_flanks(name, case):
    """Third order through impacts; where dampers jump, between first and second."""
    changes, more, gain = FREE[case]
    load = {"two_kv": {"load": gj.SinusoidalLoad(150.0)}, "rv_cycloidal": {}}[name]
    scene, few = SCENES[name](**changes, **load), {"two_kv": 80, "rv_cycloidal": 256}[name]
    exact = gj.simulate(scene, TS, 60.0, start="zero", stepper=gj.AdaptiveStep(1e-12, 1e-12))
    fine = gj.simulate(scene, np.linspace(0, 0.02, 801), 60.0, start="zero")
    closed = np.asarray(fine.forces) > 0
    assert (np.diff(closed.astype(int), axis=0) != 0).sum() > 10
    assert not closed.any(axis=1).all()
    if name == "two_kv":
        assert closed.any(axis=0).all()  # both flanks of both planet wheels
    errors = []
    for number in (few, more * few):
        found = gj.simulate(scene, TS, 60.0, start="zero", stepper=gj.FixedStep(per_sample=number))
        errors.append(float(np.abs(np.asarray(found.te - exact.te)).max()))
    assert errors[1] < 3e-3 * np.ptp(np.asarray(exact.te))
    assert errors[1] < errors[0] / gain


@pytest.mark.slow
def test_even_steps_of_runge_kutta_agree():
    scene = planets()
    found = gj.simulate(scene, TS, 100.0, stepper=gj.FixedStep(per_sample=256, solver=gj.RungeKutta4()))
    np.testing.assert_allclose(found.q, truth(scene, 100.0).q, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_energy_is_kept():
    """Nothing drives it and nothing damps it: kinetic and elastic energy, less the work of torque and orbit."""
    scene = planets(errors={}, damping=None, damper=None, compliance=gj.HarmonicStiffness(1e8, [], []))
    scene = dataclasses.replace(scene, system=dataclasses.replace(scene.system, te_radius="held_sun"))
    torque, equation = 20.0, StructureEquation.of(scene.physics(*MODELLED), jnp.asarray(20.0))
    parts, now = equation.structure, equation.excitation(jnp.asarray(0.0))

    motion = gj.simulate(scene, np.linspace(0.0, 0.01, 101), torque, start="zero", stepper=gj.FixedStep(per_sample=64))
    q, forces = np.asarray(motion.q), np.asarray(motion.forces)
    assert (forces > 0).any(axis=0).sum() >= 2
    assert (np.diff((forces > 0).astype(int), axis=0) != 0).any()
    step, still = jnp.asarray(1e-4 / 64), jnp.zeros_like(equation.scale)
    steps = jax.jit(lambda: Steps.of(equation, jnp.zeros(()), step))()
    spacing = Spacing.of(101, 64, None, still.dtype)
    states = jax.jit(lambda: march(steps, still, still, spacing).states)()
    place, velocity = np.asarray(states[:, 0]), np.asarray(states[:, 1])
    np.testing.assert_allclose(place, q, rtol=0, atol=1e-15)
    kinetic = 0.5 * np.einsum("ni,ij,nj->n", velocity, np.asarray(parts.mass), velocity)
    springs = 0.5 * np.einsum("ni,ij,nj->n", place, np.asarray(parts.stiffness), place)
    teeth = 0.5 * (forces**2 / np.asarray(now.springs.stiffness)).sum(axis=1)
    work = place @ np.asarray(equation.given(now))
    whole = kinetic + springs + teeth - work
    assert np.ptp(kinetic) > 1e-5
    assert np.ptp(whole) < 1e-6 * np.ptp(kinetic)


# limits and extremes -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_stiff_supports_tend_to_one_coordinate(name):
    """The difference falls in proportion to their compliance."""
    steps = gj.FixedStep(per_sample={"two_kv": 128, "rv_cycloidal": 1024}[name])
    soft = SCENES[name](damping=ALWAYS)
    alone = dataclasses.replace(soft, supports={}, body_inertia={})
    one = gj.simulate(alone, TS, LOADS[name], stepper=gj.AdaptiveStep(1e-11, 1e-11))
    differences = []
    for stiff in (1e11, 1e12, 1e15):
        many = gj.simulate(SCENES[name](damping=ALWAYS, stiff=stiff), TS, LOADS[name], stepper=steps)
        differences.append(float(jnp.abs(many.te - one.te).max()))
    assert differences[0] > 1e-9
    assert differences[0] == pytest.approx(10 * differences[1], rel=0.1)
    assert differences[2] < 3e-9  # what the steps miss


@pytest.mark.slow
@pytest.mark.parametrize(("stiff", "damper"), [(1e3, 0.0), (1e17, 0.0), (1e8, 1e9)])
def test_soft_hard_and_overdamped_supports(stiff, damper):
    motion = gj.simulate(planets(stiff=stiff, damper=damper), TS, 100.0, stepper=gj.FixedStep(per_sample=64))
    assert int(motion.result) == 0
    assert np.isfinite(np.asarray(motion.q)).all()
    push = float(motion.forces.max())
    assert 1e2 < push < 1e4
    if stiff > 1e10:
        assert float(jnp.abs(motion.moved).max()) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("torque", [0.0, -80.0])
def test_no_torque_and_back_flanks(torque):
    motion = gj.simulate(planets(), TS, torque, stepper=gj.FixedStep(per_sample=128))
    exact = truth(planets(), torque)
    np.testing.assert_allclose(motion.te, exact.te, rtol=0, atol=1e-3 * np.ptp(np.asarray(exact.te)) + 1e-12)


@pytest.mark.slow
def test_the_default_step_and_extremes_between_samples():
    scene = planets()
    usual = suitable_step(scene, 0.02)
    assert usual.windows is None
    coarse, fine = (gj.simulate(scene, np.linspace(0, 0.02, n), 100.0) for n in (3, 401))
    np.testing.assert_allclose(coarse.te, fine.te[::200], rtol=0, atol=1e-9)
    assert float(coarse.peak_to_peak) == pytest.approx(float(fine.peak_to_peak), rel=1e-4)
    uneven = np.sort(np.concatenate([TS[:6], [0.0111, 0.0174]]))
    moved = gj.simulate(scene, uneven, 100.0)
    np.testing.assert_allclose(moved.te[:6], gj.simulate(scene, TS[:6], 100.0).te, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_single_precision():
    exact = gj.simulate(planets(), TS, 100.0, stepper=gj.FixedStep(per_sample=64))
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), planets())
    found = gj.simulate(single, TS.astype(np.float32), 100.0, stepper=gj.FixedStep(per_sample=64))
    assert found.te.dtype == found.q.dtype == jnp.float32
    np.testing.assert_allclose(found.te, exact.te, rtol=0, atol=1e-3 * np.ptp(np.asarray(exact.te)))


# derivatives, batches, programs --------------------------------------------------------------------------------

NUMBERS = (
    "body_inertia.planet_1.mass",
    "supports.planet_1.x",
    "supports.planet_2.y_damping",
    "errors.planet_1.amplitude",
    "system.input_speed",
    "inertia.mass",
)


def leaf(scene, path):
    for step in path.split("."):
        scene = scene[step] if isinstance(scene, dict) else getattr(scene, step)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("damping", [ALWAYS, gj.DampingRatio(0.05)])
def test_gradients_under_vmap_and_jit(damping):
    """Reverse and forward, with respect to masses, supports, dampers, errors and speed, at two scenes at once."""
    scene, ts = planets(damping=damping), jnp.linspace(0.0, 0.004, 5)
    known = jnp.stack([leaf(scene, path) for path in NUMBERS])

    def size(factors):
        numbers = list(known * factors)
        changed = eqx.tree_at(lambda s: [leaf(s, path) for path in NUMBERS], scene, numbers)
        motion = gj.simulate(changed, ts, 100.0, stepper=gj.FixedStep(per_sample=64))
        return (motion.q[1:] ** 2 @ jnp.array([1.0, 1e4, 1e4, 1e4, 1e4])).sum() ** 0.5

    points = jnp.array([[1.0] * 6, [1.1, 0.9, 1.3, 0.8, 1.05, 0.97]])
    reverse = jax.jit(jax.vmap(jax.grad(size)))(points)
    forward = jax.jit(jax.vmap(jax.jacfwd(size)))(points)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-12 * float(jnp.abs(forward).max()))
    both = jax.jit(jax.vmap(size))
    for column in range(6):
        away = 1e-4 * jnp.zeros((1, 6)).at[0, column].set(1.0)
        central = (both(points + away) - both(points - away)) / 2e-4
        np.testing.assert_allclose(
            forward[:, column], central, rtol=2e-5, atol=1e-7 * float(jnp.abs(forward).max()), err_msg=NUMBERS[column]
        )


@pytest.mark.slow
def test_batches_equal_loops_and_compile_once():
    scene, steps = planets(), gj.FixedStep(per_sample=48)
    masses = jnp.array([0.3, 0.8, 2.0])

    def te(mass):
        body = gj.BodyInertia(mass)
        changed = dataclasses.replace(scene, body_inertia={"planet_1": body, "planet_2": body})
        return gj.simulate(changed, TS, 100.0, stepper=steps).te

    one = jax.jit(te)
    together = jax.jit(jax.vmap(te))(masses)
    for index, mass in enumerate(masses):
        np.testing.assert_allclose(together[index], one(mass), rtol=0, atol=1e-14)
    assert one._cache_size() == 1


@pytest.mark.slow
def test_a_direction_that_is_not_listed_is_not_computed():
    scene = planets()
    one = {"supports": {"planet_2": gj.Support(y=1e8)}, "body_inertia": {"planet_2": gj.BodyInertia(1.0)}}
    for changes, names in (
        ({}, ("output", "planet_1.x", "planet_1.y", "planet_2.x", "planet_2.y")),
        (one, ("output", "planet_2.y")),
    ):
        physics = dataclasses.replace(scene, **changes).physics(*MODELLED)
        equation = StructureEquation.of(physics, jnp.asarray(1.0))
        assert equation.structure.names == names
        assert equation.jacobian.shape == (4, len(names))
        assert equation.pushed == (not changes)  # across the throw nothing pushes


# refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_is_missing_or_does_not_suit_is_named():
    scene = planets()
    bare = dataclasses.replace(scene, body_inertia={"planet_1": gj.BodyInertia(1.0)})
    with pytest.raises(SceneError, match=r'"dynamic" needs \[inertia.planet_2\] with mass'):
        gj.simulate(bare, TS, 100.0)
    with pytest.raises(SceneError, match=r"QuasiStatic.*leave out .supports.planet_1"):
        gj.simulate(scene, TS, 100.0, stepper=gj.QuasiStatic())
    with pytest.raises(SceneError, match="windows need a scene in which only the output moves"):
        gj.simulate(scene, TS, 100.0, stepper=gj.FixedStep(windows=gj.Windows(4, 0.01)))
    with pytest.raises(SceneError, match=r"the step is too long.*it must be at most"):
        gj.simulate(scene, TS, 100.0, stepper=gj.FixedStep(per_sample=2))


def test_the_exponential_of_a_matrix(rng):
    for size in (1e-3, 1.0, 300.0):
        turning = rng.normal(size=(6, 6))
        matrix = size * (turning - turning.T) - 0.1 * np.eye(6)
        np.testing.assert_allclose(exponential(jnp.asarray(matrix)), expm(matrix), rtol=0, atol=1e-14 * max(1.0, size))


@pytest.mark.slow
def test_populations_of_motions_on_supports():
    """Many side by side, spread over the devices there are: as one by one. With JAX's own exponential of a matrix this
    never ended."""
    scene = dataclasses.replace(planets(), run=gj.Run(0.004, 5, ("dynamic",), (100.0,)))
    varied = {"inertia.planet_1.mass": gj.Uniform(0.5, 2.0), "supports.planet_2.x": gj.Uniform(1e8, 3e8)}
    population = gj.Tolerances(scene, varied)
    study = gj.monte_carlo(population, "dynamic.peak_to_peak@100Nm", n=3)
    values = np.asarray(study.values).ravel()
    assert not np.asarray(study.result).any()
    assert np.ptp(values) > 1e-10


@pytest.mark.slow
def test_excitation_between_nodes_is_that_at_each_step():
    """Where speeds are known a few nodes cover many steps; where they are not, each step is looked at."""
    scene, steps = planets(), gj.FixedStep(per_sample=64)
    known = gj.simulate(scene, TS, 100.0, stepper=steps)

    def te(speed):
        changed = dataclasses.replace(scene, system=dataclasses.replace(scene.system, input_speed=speed))
        return gj.simulate(changed, TS, 100.0, stepper=steps).q

    np.testing.assert_allclose(known.q, jax.jit(te)(scene.system.input_speed), rtol=0, atol=1e-13)
    assert Spacing.of(11, 64, 0.01, np.dtype(float)).nodes is not None
    assert Spacing.of(11, 64, 3.0, np.dtype(float)) == Spacing.of(11, 64, None, np.dtype(float))
