"""Trains on shafts, wheels on bearings, teeth that share a rim: against all sets of contacts tried one by one, linear
programmes, springs added by hand, scipy."""

import dataclasses
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import gearjax as gj
from gearjax import plot, registry, results
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.modes import StructureEquation
from gearjax.checks import SceneError
from gearjax.contact import ContactSet, Layout
from gearjax.units import um
from tests.test_batches import equations
from tests.trains import BODIES, Rim, SpurTrain, brute, in_motion, light, on_bearings, train

THETA = np.linspace(0.2, 5.7, 12)
TWISTING = gj.Shaft(["wheel_1", "pinion_2"], torsion=4e4)
SCENES = {
    "free": train,
    "twisting": lambda **changes: train(**({"shafts": {"middle": TWISTING}} | changes)),
    "bearings": on_bearings,
}


def contacts_of(scene: gj.Scene, theta: float, stiffness="mean") -> ContactSet:
    slots = ("backlash",) if stiffness == "rigid" else ("backlash", "compliance")
    return scene.physics(*slots).anchored().contacts(jnp.asarray(theta), stiffness)


def held(contacts: ContactSet) -> np.ndarray:
    """Stiffness of supports and shafts in all coordinates."""
    number = contacts.jacobian.shape[1]
    found = np.zeros((number, number))
    if contacts.supports is not None:
        found[contacts.free :, contacts.free :] = contacts.supports
    return found


# statics --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_one_set_of_contacts_that_fits(name):
    """Springs one by one: every set is tried, ``K q + J^T f = Q`` solved directly; 12 coordinates on bearings."""
    scene = SCENES[name]()
    for torque, at in itertools.product([40.0, -25.0, 1e-3], (0, 5, 11)):
        te = gj.transmission_error(scene, THETA, torque)
        assert not te.result.any()
        assert te.coordinates == scene.coordinates
        assert len(te.coordinates) == {"free": 2, "twisting": 3, "bearings": 12}[name]
        own = contacts_of(scene, THETA[at])
        influence = np.diag(1 / np.asarray(own.linear))
        place, forces = brute(np.asarray(own.jacobian), np.asarray(own.gap), influence, held(own), torque)
        np.testing.assert_allclose(te.q[at], place, rtol=1e-10, atol=1e-10 * abs(place).max())
        np.testing.assert_allclose(te.forces[at], forces, rtol=1e-9, atol=1e-9 * forces.max())


@pytest.mark.slow
@pytest.mark.parametrize("pairs", [1, 2])
@pytest.mark.parametrize("name", SCENES)
def test_teeth_that_share_a_rim(name, pairs):
    scene = SCENES[name](compliance=Rim(), system={"pairs": pairs})
    for torque, at in itertools.product([40.0, -25.0, 0.3], (2, 9)):
        te = gj.transmission_error(scene, THETA, torque)
        assert not te.result.any()
        own = contacts_of(scene, THETA[at])
        influence = np.asarray(own.springs.influence)
        place, forces = brute(np.asarray(own.jacobian), np.asarray(own.gap), influence, held(own), torque)
        np.testing.assert_allclose(te.q[at], place, rtol=1e-9, atol=1e-9 * abs(place).max())
        np.testing.assert_allclose(te.forces[at], forces, rtol=1e-8, atol=1e-8 * forces.max())


@pytest.mark.slow
@pytest.mark.parametrize("pairs", [1, 3])
def test_the_lightest_torque_is_a_linear_programme(pairs):
    """No-load TE and backlash: output positions that no contact forbids, whatever the shaft between does."""
    scene = train(system={"pairs": pairs})
    te, play = gj.transmission_error(scene, THETA), gj.backlash(scene, THETA)
    assert not play.result.any()
    for at in range(len(THETA)):
        own = contacts_of(scene, THETA[at], "rigid")
        assert own.jacobian.shape == (4 * pairs, 2)
        ends = [light(np.asarray(own.jacobian), np.asarray(own.gap), load) for load in (1, -1)]
        assert te.te[at] == pytest.approx(ends[0], abs=1e-12)
        assert play.lower[at] == pytest.approx(ends[0], abs=1e-12)
        assert play.upper[at] == pytest.approx(ends[1], abs=1e-12)


@pytest.mark.slow
def test_errors_of_two_stages_add():
    """No-load TE: that of the first stage, carried on by the ratio of the second, and that of the second."""
    both = gj.transmission_error(train(system={"waviness": 0.0}), THETA).te
    parts = []
    for name in ("run_out", "end"):
        scene = train(system={"waviness": 0.0})
        parts.append(gj.transmission_error(dataclasses.replace(scene, errors={name: scene.errors[name]}), THETA).te)
    np.testing.assert_allclose(both, parts[0] + parts[1], rtol=1e-12, atol=1e-18)
    own = SpurTrain()
    eccentric, order = 8 * um, own.ratios[0]
    arm = 0.5 * 31 * 2e-3 * np.cos(np.radians(20))
    wheel = eccentric * np.sin(order * THETA + 0.3 + 0.4) / arm  # turn of the shaft between
    np.testing.assert_allclose(parts[0], -wheel * 18 / 45, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("compliance", [None, Rim()])
def test_no_torque_and_hardly_any(name, compliance):
    scene = SCENES[name](**({} if compliance is None else {"compliance": compliance}))
    none, slight = (gj.transmission_error(scene, THETA, torque) for torque in (0.0, 1e-12))
    rigid = gj.transmission_error(scene, THETA)
    np.testing.assert_allclose(none.te, rigid.te, rtol=0, atol=1e-15)
    np.testing.assert_allclose(slight.te, rigid.te, rtol=0, atol=1e-14)
    arm = float(scene.system.base_radius("wheel_2"))
    np.testing.assert_allclose(slight.forces.max(axis=1), 1e-12 / arm, rtol=1e-9)


@pytest.mark.slow
def test_springs_of_shafts_and_bearings_add():
    """One set of pairs under torque: torsion, drive, bearings and bending add to the turn of the output by hand."""
    torque = 40.0
    rigid = train()
    own = rigid.system
    arms = {body: float(own.base_radius(body)) for body in BODIES}
    force = {2: torque / arms["wheel_2"]}
    moment = force[2] * arms["pinion_2"]  # on the shaft between
    force[1] = moment / arms["wheel_1"]
    drive = force[1] * arms["pinion_1"]
    ratios = own.ratios[1], own.ratios[1] / own.ratios[0]  # turns of the output per turn of the input, of the middle

    def added(**changes) -> np.ndarray:
        te = gj.transmission_error(train(**changes), THETA, torque)
        return np.asarray(te.te - gj.transmission_error(rigid, THETA, torque).te)

    twist = added(shafts={"middle": TWISTING})
    np.testing.assert_allclose(twist, -moment / 4e4 * ratios[1], rtol=1e-9)
    turned = added(supports={"pinion_1": gj.Support(rz=5e4)})
    np.testing.assert_allclose(turned, -drive / 5e4 * ratios[0], rtol=1e-9)
    sine, cosine = np.sin(np.radians(20)), np.cos(np.radians(20))
    seen = force[1] * (sine**2 / 1e8 + cosine**2 / 3e8) / arms["wheel_1"] * ratios[1]
    np.testing.assert_allclose(added(supports={"wheel_1": gj.Support(x=1e8, y=3e8)}), -seen, rtol=1e-9)
    # a shaft that does not bend lets both bearings share what either wheel is pushed by
    pushed, soft = {"wheel_1": gj.Support(x=1e8), "pinion_2": gj.Support(x=2e8)}, gj.Shaft(["wheel_1", "pinion_2"])
    stiff = gj.Shaft(["wheel_1", "pinion_2"], bending=1e17)
    ways = {1: -sine, 2: np.cos(np.radians(70)) * sine - np.sin(np.radians(70)) * cosine}  # of closing, per x
    shift = -(force[1] * ways[1] + force[2] * ways[2]) / 3e8
    closes = -(shift * ways[1] / arms["wheel_1"]) * ratios[1] - shift * ways[2] / arms["wheel_2"]
    np.testing.assert_allclose(added(supports=pushed, shafts={"middle": stiff}), -closes, rtol=1e-6)
    assert abs(added(supports=pushed, shafts={"middle": soft}) / -closes - 1).max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", ["twisting", "bearings"])
def test_what_gives_way_falls_in_proportion_to_its_compliance(name):
    rigid = gj.transmission_error(train(), THETA, 40.0).te

    def added(times: float) -> np.ndarray:
        scene = SCENES[name]()
        supports, shafts = jax.tree.map(lambda leaf: times * leaf, (scene.supports, scene.shafts))
        return np.asarray(
            gj.transmission_error(dataclasses.replace(scene, supports=supports, shafts=shafts), THETA, 40.0).te
        )

    one, other = added(1e4) - rigid, added(1e5) - rigid
    np.testing.assert_allclose(one, 10 * other, rtol=1e-3)
    assert abs(other).min() > 0


@pytest.mark.slow
def test_a_train_of_rigid_shafts_is_two_reducers_in_series():
    """Each stage by itself, one coordinate: turns and deflections add by the ratio."""
    scene = train(errors={})
    torque, own = 40.0, scene.system
    te = gj.transmission_error(scene, THETA, torque)
    for at in (0, 7):
        contacts = contacts_of(scene, THETA[at])
        first, second = (np.flatnonzero(np.array(contacts.holds) == c)[0] for c in (1, 0))
        arms = [float(own.base_radius(body)) for body in BODIES]
        forces = torque / arms[3] * arms[2] / arms[1], torque / arms[3]
        middle = -(forces[0] / 2e8 + contacts.gap[first]) / arms[1]
        output = -(forces[1] / 2e8 + contacts.gap[second]) / arms[3] + middle * arms[2] / arms[3]
        assert te.te[at] == pytest.approx(float(output), rel=1e-12)


def test_virtual_work():
    """What the input's torque gives when it turns is what the output takes: levers of both ends of each mesh."""
    scene = on_bearings()
    te = gj.transmission_error(scene, THETA, 40.0)
    own = scene.system
    arms = [float(own.base_radius(body)) for body in BODIES]
    forces = np.asarray(te.forces)
    np.testing.assert_allclose(forces[:, 2] - forces[:, 3], 40.0 / arms[3], rtol=1e-9)
    np.testing.assert_allclose((forces[:, 0] - forces[:, 1]) * arms[1], 40.0 / arms[3] * arms[2], rtol=1e-9)
    drive = -5e4 * np.asarray(te.q)[:, te.coordinates.index("pinion_1.rz")]
    np.testing.assert_allclose(drive, 40.0 * own.ratios[1], rtol=1e-9)


NUMBERS = {
    "torsion": lambda s: s.shafts["middle"].torsion,
    "bending": lambda s: s.shafts["middle"].bending,
    "drive": lambda s: s.supports["pinion_1"].rz,
    "bearing": lambda s: s.supports["wheel_2"].y,
    "run-out": lambda s: s.errors["run_out"].amplitude,
}


@pytest.mark.parametrize("compliance", [pytest.param("springs", marks=pytest.mark.slow), "rim"])
def test_gradients_of_statics(compliance):
    """Under jit and vmap, of numbers of every kind, torque included: central differences."""
    scene = on_bearings(**({"compliance": Rim()} if compliance == "rim" else {}))
    where = [*NUMBERS.values()]

    def mean(factors):
        moved = scene
        for get, factor in zip(where, factors[1:], strict=True):
            moved = eqx.tree_at(get, moved, get(moved) * factor)
        return 1e6 * gj.transmission_error(moved, THETA, 40.0 * factors[0]).mean

    several = jax.jit(jax.vmap(mean))
    at = jnp.linspace(0.9, 1.1, 1 + len(where))
    slopes = jax.jit(jax.vmap(jax.grad(mean)))(jnp.stack([at, at[::-1]]))
    step = 1e-5
    for row, start in zip(slopes, (at, at[::-1]), strict=True):
        moves = jnp.stack([start + side * step * unit for side in (1, -1) for unit in jnp.eye(len(at))])
        values = several(moves)
        central = (values[: len(at)] - values[len(at) :]) / (2 * step)
        np.testing.assert_allclose(row, central, rtol=1e-6, atol=1e-7 * float(jnp.abs(central).max()))


@pytest.mark.slow
@pytest.mark.parametrize("torque", [None, 40.0])
def test_extremes_of_the_samples_alone(torque):
    scene, theta = on_bearings(), np.linspace(0.0, 0.3, 61)
    every, few = (gj.transmission_error(scene, theta, torque, extremes=at) for at in ("between", "samples"))
    np.testing.assert_allclose(every.te, few.te, rtol=1e-14)
    assert float(few.extremes.maximum) == float(few.te.max())
    assert float(few.extremes.theta_minimum) == theta[int(jnp.argmin(few.te))]
    assert float(every.extremes.maximum) > float(few.extremes.maximum)
    with pytest.raises(gj.ParameterError, match="extremes"):
        gj.transmission_error(scene, theta, torque, extremes="everywhere")


@pytest.mark.parametrize("size", [1e3, 1e15])
def test_soft_and_hard(size):
    scene = on_bearings(size)
    te = gj.transmission_error(scene, THETA, 40.0)
    assert not te.result.any()
    arm = float(scene.system.base_radius("wheel_2"))
    np.testing.assert_allclose(te.forces[:, 2] - te.forces[:, 3], 40.0 / arm, rtol=1e-9)


@pytest.mark.slow
def test_single_precision():
    scene = jax.tree.map(lambda x: x.astype(jnp.float32), on_bearings())
    exact = gj.transmission_error(on_bearings(), THETA, 40.0)
    found = gj.transmission_error(scene, THETA.astype(np.float32), np.float32(40.0))
    assert found.te.dtype == jnp.float32
    assert abs(np.asarray(found.te) - np.asarray(exact.te)).max() < 1e-4 * float(jnp.abs(exact.te).max())


@pytest.mark.slow
def test_jammed_meshes_are_named():
    """Teeth that are too thick in the mesh of one wheel cannot be cleared, wherever the shafts are."""
    scene = train(errors={}, system={"waviness": -10 * um}, backlash=gj.InitialBacklash(0.0))
    found = gj.interference(scene, THETA)
    assert found.interferes.any()
    first = np.stack([np.asarray(contacts_of(scene, theta, "rigid").gap) for theta in THETA])
    deepest = np.maximum(-first[:, :2].sum(axis=1), -first[:, 2:].sum(axis=1)) / 2  # both flanks are alike
    np.testing.assert_allclose(found.overlap, deepest, rtol=1e-9, atol=1e-18)
    assert {int(c) // 2 for c in found.contact} == {0, 1}
    clear = gj.interference(train(), THETA)
    assert not clear.interferes.any()


# motion ---------------------------------------------------------------------------------------------------------

TS = np.linspace(0.0, 0.02, 11)


def lagrange(scene: gj.Scene, torque: float, time: float, q, v):
    """Accelerations by hand from the energies: every body its own, springs between bodies, contacts one by one."""
    own, inertia = scene.system, scene.body_inertia
    contacts = scene.physics("backlash", "compliance").anchored().contacts(jnp.asarray(60.0 * time), "varying")
    spread = scene.moving.coordinates.spread
    motions = dict(zip(("output", *scene.moving.coordinates.asked), spread, strict=True))
    unit = np.eye(len(q))
    turn = dict.fromkeys(BODIES, np.zeros(len(q))) | {"wheel_2": unit[0]}
    turn |= {name.removesuffix(".rz"): row for name, row in motions.items() if name.endswith(".rz")}
    mass = 4e-3 * np.outer(unit[0], unit[0])
    for body, part in inertia.items():
        for way in "xy":
            if f"{body}.{way}" in motions:
                mass += float(part.mass) * np.outer(motions[f"{body}.{way}"], motions[f"{body}.{way}"])
        if part.polar is not None:
            mass += float(part.polar) * np.outer(turn[body], turn[body])
    force = -torque * unit[0]
    springs = [
        (s, getattr(s, w), getattr(s, f"{w}_damping"), b, w) for b, s in scene.supports.items() for w in s.directions
    ]
    for _, stiffness, damping, body, way in springs:
        row = turn[body] if way == "rz" else motions[f"{body}.{way}"]
        force = force - row * (float(stiffness) * (row @ q) + (0.0 if damping is None else float(damping)) * (row @ v))
    shaft = scene.shafts["middle"]
    apart = turn["wheel_1"] - turn["pinion_2"]
    if shaft.torsion is not None:
        resistance = 0.0 if shaft.torsion_damping is None else float(shaft.torsion_damping)
        force = force - apart * (float(shaft.torsion) * (apart @ q) + resistance * (apart @ v))
    if shaft.bending is not None:
        for way in "xy":
            apart = motions[f"wheel_1.{way}"] - motions[f"pinion_2.{way}"]
            force = force - apart * float(shaft.bending) * (apart @ q)
    jacobian, gap = np.asarray(contacts.jacobian), np.asarray(contacts.gap)
    overlap = jacobian @ q - gap
    force = force - jacobian.T @ (np.asarray(contacts.linear) * np.maximum(overlap, 0.0))
    _, rate = jax.jvp(
        lambda t: scene.physics("backlash", "compliance").anchored().contacts(60.0 * t).gap, (time,), (1.0,)
    )
    first = np.array([0, 2])
    arms = jacobian[first, :2]
    at_pair = 1 / np.einsum("ij,jk,ik->i", arms, np.linalg.inv(mass[:2, :2]), arms)
    coefficient = float(scene.damping.ratio) * np.sqrt(2 * 2e8 * at_pair)
    touches = overlap.reshape(2, 2) > 0  # of each mesh, the driving flank and the back flank
    along, acts = first, np.ones(2)
    if scene.damping.acting == "contact":  # a damper acts along the flank that touches, the driving one if both do
        along, acts = first + ~touches[:, 0], touches.any(axis=1)
    approach = jacobian[along] @ v - np.asarray(rate)[along]
    force = force - jacobian[along].T @ (coefficient * acts * approach)
    assert own.pairs == 1
    return np.linalg.solve(mass, force)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "acting"), [("free", "contact"), ("twisting", "always"), ("bearings", "contact")])
def test_motion_is_that_of_the_energies(name, acting, rng):
    """Accelerations at random states by hand; a motion from rest that hits both flanks by scipy at 1e-10."""
    scene = in_motion(SCENES[name](backlash=gj.InitialBacklash(15 * um)), damping=gj.DampingRatio(0.05, acting))
    torque = 5.0
    equation = StructureEquation.of(scene.physics(*MODELLED), jnp.asarray(torque))
    scale = np.asarray(equation.scale)
    for _ in range(5):
        q, v = rng.normal(size=len(scale)) * scale, rng.normal(size=len(scale)) * scale * float(equation.frequency)
        time = float(rng.uniform(0, 0.1))
        found = equation.acceleration(equation.excitation(jnp.asarray(time)), jnp.asarray(q), jnp.asarray(v))
        np.testing.assert_allclose(found / scale, lagrange(scene, torque, time, q, v) / scale, rtol=1e-8, atol=1e-3)
    motion = gj.simulate(scene, TS, torque, start="zero", stepper=gj.FixedStep(per_sample=1024))
    assert motion.coordinates == scene.coordinates
    rate = float(equation.frequency)
    step = jax.jit(lambda t, y: equation.rate(equation.excitation(t), y.reshape(2, -1)).ravel())
    whole = solve_ivp(
        lambda tau, y: np.asarray(step(tau / rate, y)),
        (0.0, TS[-1] * rate),
        np.zeros(2 * len(scale)),
        method="DOP853",
        rtol=1e-10,
        atol=1e-10,
        t_eval=TS * rate,
        max_step=TS[-1] * rate / 2000,
    )
    wanted = whole.y.T[:, : len(scale)]
    forces = np.asarray(motion.forces)
    assert (forces.max(axis=1) == 0).any() or (forces.min(axis=0) == 0).any()
    bound = 2e-3 if acting == "contact" else 2e-5
    assert abs(np.asarray(motion.q) / scale - wanted).max() < bound * abs(wanted).max()


@pytest.mark.slow
def test_a_stiff_drive_and_shaft_tend_to_rigid_ones():
    """In motion: the difference falls in proportion to the compliance."""
    damping = gj.DampingRatio(0.05, "always")
    exact = gj.simulate(in_motion(train(), damping=damping), TS, 40.0, stepper=gj.FixedStep(per_sample=256)).te
    off = []
    for torsion in (1e8, 1e9):
        twisting = train(shafts={"middle": gj.Shaft(["wheel_1", "pinion_2"], torsion=torsion)})
        near = gj.simulate(in_motion(twisting, damping=damping), TS, 40.0, stepper=gj.FixedStep(per_sample=256)).te
        off.append(float(jnp.abs(near - exact).max()))
    assert off[0] / off[1] == pytest.approx(10.0, rel=0.2)


@pytest.mark.slow
def test_periodic_motion_of_a_train():
    """The period of both meshes: shooting ends where it began, harmonic balance and settled motion agree."""
    plain = train(errors={}, system={"teeth": (20, 30, 15, 45)}, compliance=gj.HarmonicStiffness(2e8, [0.2], [0.0]))
    scene = in_motion(plain, damping=gj.DampingRatio(0.08, "always"))
    period = 2 * np.pi / (60.0 * 10)  # two meshes of the first stage, one of the second
    found = gj.shooting(scene, 60.0, period, steps=1024)
    assert int(found.result) == 0
    assert bool(found.stable)
    balance = gj.harmonic_balance(scene, 60.0, period, harmonics=24, samples=512)
    assert int(balance.result) == 0
    np.testing.assert_allclose(balance.te, found.te[::2], rtol=0, atol=1e-4 * float(jnp.ptp(found.te)))
    ts = np.linspace(0.0, 60 * period, 60 * 64 + 1)
    settled = gj.simulate(scene, ts, 60.0, stepper=gj.FixedStep(per_sample=16)).te[-65:-1]
    np.testing.assert_allclose(settled, found.te[::16], rtol=0, atol=1e-5 * float(jnp.ptp(found.te)))


# only what is listed --------------------------------------------------------------------------------------------


def test_what_is_not_listed_is_not_computed():
    def number(scene: gj.Scene) -> int:
        physics = scene.physics("backlash", "compliance")
        return equations(jax.make_jaxpr(lambda theta: physics.contacts(theta, "mean").jacobian)(0.3).jaxpr)

    rigid, twisting, bearings = (number(scene()) for scene in SCENES.values())
    assert rigid < twisting < bearings
    supported = train(supports={"wheel_1": gj.Support(x=1e8)})
    assert rigid < number(supported) < bearings
    assert contacts_of(supported, 0.3).jacobian.shape[1] == 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"shafts": {}},
            r"wheel_1 must share a shaft with another body of the train: "
            r'list \[shafts.NAME\] with bodies = \["wheel_1"',
        ),
        ({"shafts": {"a": gj.Shaft(["wheel_1"])}}, r"pinion_2 must share a shaft with another body"),
        ({"shafts": {"a": gj.Shaft(["wheel_1"]), "b": gj.Shaft(["pinion_2"])}}, r"\[shafts.b\] turns freely: no mesh"),
        ({"shafts": {"a": gj.Shaft(["wheel_1", "pinion_3"])}}, "pinion_3"),
        ({"shafts": {"output": gj.Shaft(["wheel_1", "pinion_2"])}}, "give another name"),
        (
            {"shafts": {"a": gj.Shaft(["wheel_1", "pinion_2"]), "b": gj.Shaft(["pinion_1", "wheel_2"])}},
            "joins the input to the output",
        ),
        ({"shafts": {"a": gj.Shaft(["wheel_1", "pinion_2"]), "b": gj.Shaft(["wheel_1", "wheel_2"])}}, "is on .shafts"),
        ({"supports": {"wheel_1": gj.Support(rz=1e5)}}, "is only for pinion_1"),
        ({"supports": {"wheel_1": gj.Support(z=1e8)}}, "supports.wheel_1.z"),
        ({"body_inertia": {"wheel_2": gj.BodyInertia(1.0)}}, r"\[inertia.wheel_2\] is for a body that can move"),
        ({"body_inertia": {"wheel_1": gj.BodyInertia(polar=1e-3, transverse=1e-3)}}, "transverse is for a body"),
    ],
)
def test_what_cannot_be_is_refused(changes, words):
    with pytest.raises(gj.GearjaxError, match=words) as caught:
        train(**changes)
    assert "\n" not in str(caught.value)


def test_what_is_missing_is_named():
    scene = in_motion(on_bearings())
    inertia = dict(scene.body_inertia) | {"wheel_1": gj.BodyInertia(mass=1.0)}
    with pytest.raises(SceneError, match=r"needs \[inertia.wheel_1\] with polar"):
        gj.simulate(dataclasses.replace(scene, body_inertia=inertia), TS, 40.0)
    with pytest.raises(gj.ParameterError, match="must list at least two bodies: torsion acts between"):
        gj.Shaft(["wheel_1"], torsion=1e4)
    idle = {"middle": gj.Shaft(["wheel_1", "pinion_2"], bending=1e9)}
    for lone in ({}, {"wheel_1": gj.Support(x=1e8)}, {"wheel_1": gj.Support(x=1e8), "pinion_2": gj.Support(y=1e8)}):
        with pytest.raises(gj.ParameterError, match=r"shafts\.middle\.bending = .*: does nothing: it acts in x and y"):
            dataclasses.replace(gj.load("configs/helical/two_stage.toml"), supports=lone, shafts=idle)
    with pytest.raises(gj.ParameterError, match="names a body twice"):
        gj.Shaft(["wheel_1", "wheel_1"])
    with pytest.raises(gj.ParameterError, match="must be a list of names"):
        gj.Shaft([])
    with pytest.raises(gj.ParameterError, match="torsion_damping is for a shaft that twists"):
        gj.Shaft(["wheel_1", "pinion_2"], torsion_damping=1.0)
    with pytest.raises(SceneError, match=r"\[shafts.a\] is not for a two_kv"):
        dataclasses.replace(gj.load("configs/two_kv/wang_2020.toml"), shafts={"a": gj.Shaft(["planet_1"])})


@pytest.mark.slow
def test_one_pair_shares_with_nobody():
    """Forces of different meshes differ by their levers; load is shared within a mesh."""
    te = gj.transmission_error(train(), THETA, 40.0)
    np.testing.assert_allclose(te.load_sharing, 1.0, rtol=1e-12)
    two = gj.transmission_error(train(system={"pairs": 2}), THETA, 40.0)
    each = np.asarray(two.forces).reshape(-1, 2, 2, 2)[:, :, 0]  # angle, mesh, pair of its driving flanks
    expected = (each.max(axis=2) / each.mean(axis=2)).max(axis=1)
    np.testing.assert_allclose(two.load_sharing, expected, rtol=1e-12)


class Split(SpurTrain):
    """Two ways from the input to the output."""

    @property
    def meshes(self):
        return ("pinion_1", "wheel_1"), ("pinion_1", "pinion_2"), ("pinion_2", "wheel_2"), ("wheel_1", "wheel_2")


class Forgetful(SpurTrain):
    """Its layout does not tell the meshes."""

    def layout(self, request):
        whole = super().layout(request)
        return Layout(whole.side, whole.pair)


def test_gear_sets_of_ones_own_that_cannot_be():
    with pytest.raises(SceneError, match=r"the shaft of wheel_2 is driven by 2 independent shafts"):
        gj.Scene(Split(), shafts={"a": gj.Shaft(["wheel_1"]), "b": gj.Shaft(["pinion_2"])})
    with pytest.raises(
        SceneError,
        match=r"the layout of spur_train has meshes \[\]: Layout\(..., mesh=...\) must give the mesh of each contact",
    ):
        gj.Scene(Forgetful(), shafts={"middle": gj.Shaft(["wheel_1", "pinion_2"])})
    for bodies in ("wheel", None, ["wheel_1", 3]):
        with pytest.raises(gj.ParameterError, match="must be a list of names"):
            gj.Shaft(bodies)
    with pytest.raises(SceneError, match="in a train, shafts move too"):
        gj.simulate(in_motion(train()), TS, 40.0, stepper=gj.QuasiStatic())
    with pytest.raises(gj.ParameterError, match="wheel_1"):
        train(body_inertia={"wheel_11": gj.BodyInertia(1.0)})


@pytest.mark.slow
def test_undamped_motion_repeats_after_one_period():
    scene = in_motion(train(errors={}, system={"teeth": (20, 30, 15, 45)}), damping=None)
    found = gj.periodic_motion(scene, 40.0, 2 * np.pi / 600, steps=64)
    assert (int(found.result), found.periods) == (0, 1)
    with pytest.raises(SceneError, match="there is no equilibrium to start from"):
        gj.periodic_motion(dataclasses.replace(scene, backlash=None), -40.0, 2 * np.pi / 600, steps=64)


# the whole way --------------------------------------------------------------------------------------------------

TEXT = """
[system]
kind = "spur_train"
input_speed = "600 rpm"
[backlash]
initial = "60 um"
[compliance]
kind = "harmonic_stiffness"
mean = "2e8 N/m"
relative_amplitudes = [0.2]
phases = ["0 deg"]
[supports.pinion_1]
x = "2e8 N/m"
rz = "5e4 N*m/rad"
rz_damping = "0.5 N*m*s/rad"
[shafts.middle]
bodies = ["wheel_1", "pinion_2"]
torsion = "40 kN*m/rad"
[inertia]
moment_of_inertia = "0.004 kg*m^2"
[inertia.pinion_1]
mass = "0.5 kg"
polar = "1e-4 kg*m^2"
[inertia.wheel_1]
polar = "8e-4 kg*m^2"
[inertia.pinion_2]
polar = "9e-5 kg*m^2"
[load]
kind = "constant"
[damping]
ratio = 0.05
[run]
duration = "0.02 s"
samples = 41
analyses = ["no_load", "backlash", "static", "dynamic"]
torques = ["40 N*m"]
"""


@pytest.fixture
def registered(monkeypatch):
    """The train as a kind of the tests' own."""
    monkeypatch.setattr(registry, "_kinds", {group: dict(known) for group, known in registry._kinds.items()})
    gj.register(SpurTrain)


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_a_train_from_a_configuration_to_files_and_figures(tmp_path):
    scene = gj.loads(TEXT)
    assert scene.coordinates == ("output", "middle", "pinion_1.x", "pinion_1.rz", "pinion_2.twist")
    assert float(scene.shafts["middle"].torsion) == 4e4
    cases = list(results.run_cases(scene))
    results.save(scene, cases, TEXT, tmp_path)
    assert "support_displacements.png" in [path.name for path in plot.save_figures(scene, cases, tmp_path)]
    with xr.open_dataset(tmp_path / "results.nc", engine="scipy") as stored:
        moved = stored["static_40_Nm_moved"]
        units = [u.decode() if isinstance(u, bytes) else str(u) for u in moved["coordinate_unit"].values]
        assert units == ["rad", "m", "rad", "rad"]
        np.testing.assert_array_equal(moved.values, cases[2].result.moved)


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(
    ("given", "instead", "words"),
    [
        ('torsion = "40 kN*m/rad"', 'torsion = "4e4 N/m"', "shafts.middle.torsion"),
        ('torsion = "40 kN*m/rad"', 'stiffness = "4e4 N/m"', "shafts.middle.stiffness"),
        ('bodies = ["wheel_1", "pinion_2"]', 'bodies = "wheel_1"', "must be a list of names such as"),
        ('bodies = ["wheel_1", "pinion_2"]', 'bodies = ["wheel_1", "pinion"]', 'shafts.middle.bodies = "pinion"'),
        ('bodies = ["wheel_1", "pinion_2"]', "", "shafts.middle.bodies = (missing): must be given: a list of names"),
        ("[shafts.middle]", "[shafts]", "must be a section: [shafts.bodies]"),
        ('rz = "5e4 N*m/rad"', 'rz = "5e4 N/m"', "supports.pinion_1.rz"),
        ('polar = "8e-4 kg*m^2"', 'polar = "8e-4 kg"', "inertia.wheel_1.polar"),
    ],
)
def test_wrong_shafts_are_refused_in_a_line(given, instead, words):
    assert given in TEXT
    with pytest.raises(gj.GearjaxError) as caught:
        gj.loads(TEXT.replace(given, instead))
    assert words in str(caught.value), str(caught.value)
    assert "\n" not in str(caught.value)
