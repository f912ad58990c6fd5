"""Trains of helical pairs: against their pairs one by one, exact motions of rigid bodies, statics, an integration."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gearjax as gj
from gearjax.analysis.modes.equation import StructureEquation
from gearjax.checks import ParameterError
from gearjax.contact.helical_mesh import WAYS
from gearjax.units import deg, mm, um

STEEL = gj.ToothSlices(206e9, 0.3)
TEETH = (20, 18), (50, 54)
GIVEN = {
    "normal_module": [2 * mm, 3 * mm],
    "normal_pressure_angle": [20 * deg],
    "helix_angle": [-15 * deg, 10 * deg],
    "face_width": [22 * mm, 34 * mm],
    "pinion_shift": [0.3, 0.2],
    "line_angle": [25 * deg, 95 * deg],
    "centre_distance": [74 * mm, 111 * mm],
}
ERRORS = {
    "run_out_1": gj.Eccentricity("pinion_1", 6 * um, 0.3),
    "run_out_2": gj.Eccentricity("wheel_1", 10 * um, 1.9),
    "run_out_4": gj.Eccentricity("wheel_2", 14 * um, -0.4),
    "tip_1": gj.TipRelief("pinion_1", [12 * um], 3 * mm),
    "crowning_2": gj.Crowning("pinion_2", [5 * um]),
    "pitch_2": gj.MeasuredPitch("pinion_2", np.linspace(-4, 3, 18) * um),
    "pitch_1": gj.MeasuredPitch("wheel_1", 3 * um * np.sin(np.arange(50.0))),
    "slope_4": gj.HelixSlope("wheel_2", [4 * um]),
}
THETA = np.linspace(0.2, 4.0, 41)
BACKLASH = gj.InitialBacklash(15 * um)
TORQUE = 350.0


def train(**changes) -> gj.HelicalTrain:
    """A train of two stages, with backlash by its centre distances."""
    return gj.HelicalTrain(*TEETH, **(GIVEN | {"input_speed": 120.0, "slices": 5} | changes))


def scene_of(**changes) -> gj.Scene:
    given = {"errors": ERRORS, "compliance": STEEL, "backlash": BACKLASH}
    return gj.Scene(changes.pop("system", train()), **(given | changes))


def stage_of(mesh: int, **changes) -> gj.Scene:
    """One mesh of the train as a pair of its own."""
    own = {key: (values * 2)[mesh] for key, values in GIVEN.items() if key != "line_angle"}
    teeth = (numbers[mesh] for numbers in TEETH)
    system = gj.HelicalPair(*teeth, input_speed=120.0, slices=5, **own)
    bodies = {f"{body}_{mesh + 1}": body for body in ("pinion", "wheel")}
    errors = {name: dataclasses.replace(e, body=bodies[e.body]) for name, e in ERRORS.items() if e.body in bodies}
    return gj.Scene(system, errors, **({"compliance": STEEL, "backlash": BACKLASH} | changes))


# statics ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("torque", [None, 1.0, TORQUE, -TORQUE])
def test_a_train_is_its_pairs_in_series(torque):
    """On a rigid shaft: the error of the second pair, and that of the first divided by the second ratio."""
    first, second = (teeth[0] / teeth[1] for teeth in zip(*TEETH, strict=True))
    scene = scene_of()
    assert scene.shafts["shaft_2"].bodies == ("wheel_1", "pinion_2")
    both = gj.transmission_error(scene, THETA, torque)
    one = gj.transmission_error(stage_of(0), THETA, None if torque is None else torque * second)
    two = gj.transmission_error(stage_of(1), THETA * first, torque)
    np.testing.assert_allclose(both.te, two.te + second * one.te, rtol=0, atol=1e-13 * np.abs(both.te).max())
    if torque is None:
        clear = gj.backlash(scene, THETA).backlash
        apart = gj.backlash(stage_of(1), THETA * first).backlash + second * gj.backlash(stage_of(0), THETA).backlash
        np.testing.assert_allclose(clear, apart, rtol=1e-12)
    else:
        forces = np.concatenate([np.asarray(te.forces).reshape(len(THETA), 2, -1) for te in (one, two)], axis=2)
        forces = forces.reshape(len(THETA), -1)
        np.testing.assert_allclose(both.forces, forces, rtol=0, atol=1e-11 * forces.max())


@pytest.mark.slow
@pytest.mark.parametrize(
    "compliance",
    [
        gj.ToothSlices(206e9, 0.3, contact="hertz"),
        gj.ToothSlices(206e9, 0.3, coupling_length=1.5),
        gj.Iso6336Teeth(),
        gj.HarmonicStiffness(2e8, [0.1], [0.0]),
    ],
    ids=["hertz", "coupled", "iso_6336", "harmonic"],
)
def test_springs_of_every_type_join(compliance):
    first, second = (teeth[0] / teeth[1] for teeth in zip(*TEETH, strict=True))
    both = gj.transmission_error(scene_of(compliance=compliance), THETA[:7], TORQUE).te
    one = gj.transmission_error(stage_of(0, compliance=compliance), THETA[:7], TORQUE * second).te
    two = gj.transmission_error(stage_of(1, compliance=compliance), THETA[:7] * first, TORQUE).te
    np.testing.assert_allclose(both, two + second * one, rtol=0, atol=1e-10 * np.abs(both).max())


@pytest.mark.slow
def test_a_train_of_one_mesh_is_a_pair():
    own = {key: values[:1] for key, values in GIVEN.items() if key != "line_angle"}
    system = gj.HelicalTrain((20,), (50,), **own, input_speed=120.0, slices=5)
    errors = {name: error for name, error in ERRORS.items() if error.body.endswith("_1")}
    alone, pair = scene_of(system=system, errors=errors), stage_of(0)
    assert alone.output_alone
    for torque in (None, TORQUE):
        mine, other = (gj.transmission_error(scene, THETA, torque).te for scene in (alone, pair))
        np.testing.assert_allclose(mine, other, rtol=0, atol=1e-14 * np.abs(other).max())
    given = {"inertia": gj.MomentOfInertia(0.05), "load": gj.ConstantLoad(), "damping": gj.DampingRatio(0.05)}
    ts = np.linspace(0.0, 0.01, 51)
    mine, other = (gj.simulate(dataclasses.replace(scene, **given), ts, 60.0).te for scene in (alone, pair))
    np.testing.assert_allclose(mine, other, rtol=0, atol=1e-9 * np.abs(other).max())


@pytest.mark.slow
def test_a_shaft_that_twists():
    """The twist under the torque of the shaft, seen at the output."""
    second = TEETH[0][1] / TEETH[1][1]
    twisting = scene_of(shafts={"middle": gj.Shaft(["wheel_1", "pinion_2"], torsion=4e4)})
    rigid, soft = (gj.transmission_error(scene, THETA, TORQUE).te for scene in (scene_of(), twisting))
    np.testing.assert_allclose(rigid - soft, TORQUE * second**2 / 4e4, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("meshes", [1, 2, 3])
def test_rigid_motions_of_the_whole_train_change_no_gap(meshes):
    """Both gears of a mesh moved or tilted together, about any axis: exact geometry that needs no reference."""
    lists = {key: [*values, *values][:meshes] for key, values in GIVEN.items()}
    lists["normal_pressure_angle"] = [20 * deg]
    teeth = (20, 18, 20)[:meshes], (50, 54, 50)[:meshes]
    system = gj.HelicalTrain(*teeth, **lists, input_speed=120.0, slices=3)
    coordinates = tuple(f"{body}.{way}" for body in system.bodies for way in WAYS)
    pose = system.pose(jnp.asarray(0.7), gj.Request(back=True, coordinates=coordinates))
    columns = dict(zip(coordinates, np.asarray(pose.jacobian)[:, 1:].T, strict=True))
    axes = [np.zeros(2)]
    for distance, direction in zip(lists["centre_distance"], lists["line_angle"], strict=True):
        axes.append(axes[-1] + distance * np.array([math.cos(direction), math.sin(direction)]))
    places = {body: axes[(number + 1) // 2] for number, body in enumerate(system.bodies)}
    senses = {body: (-1) ** ((number + 1) // 2) for number, body in enumerate(system.bodies)}
    own = {way: sum(columns[f"{body}.{way}"] for body in system.bodies) for way in ("x", "y", "z")}
    for way, sums in own.items():
        assert np.abs(sums).max() < 1e-14, way
    scale = 0.1
    about_x = sum(columns[f"{body}.rx"] + places[body][1] * columns[f"{body}.z"] for body in system.bodies)
    about_y = sum(columns[f"{body}.ry"] - places[body][0] * columns[f"{body}.z"] for body in system.bodies)
    about_z = sum(
        senses[body] * columns[f"{body}.rz"]
        - places[body][1] * columns[f"{body}.x"]
        + places[body][0] * columns[f"{body}.y"]
        for body in system.bodies
    )
    for sums in (about_x, about_y, about_z):
        assert np.abs(sums).max() < 1e-14 * scale * 10
    assert min(np.abs(column).max() for column in columns.values()) > 1e-4  # none is zero throughout


@pytest.mark.slow
def test_bearings_of_the_middle_shaft_carry_what_statics_says():
    """Spur gears without errors: tangential and radial forces of both meshes, by the pressure angle."""
    system = train(helix_angle=[0.0], pinion_shift=[0.0], centre_distance=[], slices=1, tip_contact="corner")
    supports = {body: gj.Support(x=1e12, y=1e12) for body in system.bodies}
    scene = scene_of(system=system, errors={}, backlash=None, supports=supports)
    te = gj.transmission_error(scene, THETA, TORQUE)
    told = gj.bearing_forces(scene, te)
    second = TEETH[0][1] / TEETH[1][1]
    for number, (body, torque) in enumerate({"wheel_1": TORQUE * second, "pinion_2": TORQUE * second}.items()):
        radius = 0.5 * (50 * 2 * mm if number == 0 else 18 * 3 * mm)
        around = torque / radius
        out = around * math.tan(20 * deg)
        line = GIVEN["line_angle"][number]
        towards = np.array([math.cos(line), math.sin(line)])  # from the pinion to the wheel
        ahead = np.array([-math.sin(line), math.cos(line)]) * (1 if number == 0 else -1)  # of the pinion's teeth
        on_gear = (around * ahead + out * towards) * (1 if number == 0 else -1)
        for way, part in zip("xy", on_gear, strict=True):
            mean = float(np.asarray(told.of(f"{body}.{way}")).mean())
            assert mean == pytest.approx(part, rel=2e-3), (body, way)


@pytest.mark.slow
def test_axial_forces_of_the_middle_shaft_oppose_each_other_if_its_gears_have_the_same_hand():
    def net(hands):
        system = train(helix_angle=hands, face_width=[22 * mm], slices=5)
        supports = {body: gj.Support(z=1e12) for body in ("wheel_1", "pinion_2")}
        scene = scene_of(system=system, errors={}, backlash=None, supports=supports)
        told = gj.bearing_forces(scene, gj.transmission_error(scene, THETA[:3], TORQUE))
        return tuple(float(np.asarray(told.of(f"{body}.z")).mean()) for body in ("wheel_1", "pinion_2"))

    second = TEETH[0][1] / TEETH[1][1]
    wheel, pinion = net([-15 * deg, 10 * deg])  # a left-hand pinion, so a right-hand wheel; a right-hand pinion
    assert wheel * pinion < 0
    radii = 0.5 * 50 * 2 * mm / math.cos(15 * deg), 0.5 * 18 * 3 * mm / math.cos(10 * deg)
    for force, radius, helix in zip((wheel, pinion), radii, (15, 10), strict=True):
        assert abs(force) == pytest.approx(TORQUE * second / radius * math.tan(helix * deg), rel=1e-6)
    other_wheel, other_pinion = net([15 * deg, 10 * deg])
    assert other_wheel == pytest.approx(-wheel, rel=1e-6)
    assert other_pinion == pytest.approx(pinion, rel=1e-6)


@pytest.mark.slow
def test_a_turned_housing_changes_nothing():
    """With isotropic bearings; displacements turn with the lines of centres."""
    supports = {body: gj.Support(x=2e8, y=2e8, rx=1e6, ry=1e6) for body in train().bodies}
    results = []
    for turn in (0.0, 1.1):
        system = train(line_angle=[angle + turn for angle in GIVEN["line_angle"]])
        results.append(gj.transmission_error(scene_of(system=system, supports=supports), THETA, TORQUE))
    np.testing.assert_allclose(results[0].te, results[1].te, rtol=0, atol=1e-11 * np.abs(results[0].te).max())
    assert results[0].moved is not None
    names = results[0].coordinates[1:]
    first, second = (dict(zip(names, np.asarray(result.moved).T, strict=True)) for result in results)
    for body in train().bodies:
        for ways in (("x", "y"), ("rx", "ry")):
            before = first[f"{body}.{ways[0]}"] + 1j * first[f"{body}.{ways[1]}"]
            after = second[f"{body}.{ways[0]}"] + 1j * second[f"{body}.{ways[1]}"]
            np.testing.assert_allclose(after, before * np.exp(1.1j), rtol=0, atol=1e-10 * np.abs(before).max())


@pytest.mark.slow
def test_the_direction_of_the_lines_matters_if_a_shaft_is_on_soft_bearings():
    """The forces of both meshes add up on the middle shaft: the fault that a train without angles would have."""
    supports = {"wheel_1": gj.Support(x=5e7, y=5e7), "pinion_2": gj.Support(x=5e7, y=5e7)}
    shafts = {"middle": gj.Shaft(["wheel_1", "pinion_2"], bending=1e9)}
    lags = []
    for second in (25 * deg, 115 * deg, 205 * deg):
        system = train(line_angle=[25 * deg, second])
        scene = scene_of(system=system, errors={}, supports=supports, shafts=shafts)
        lags.append(-float(gj.transmission_error(scene, THETA[:5], TORQUE).te.mean()))
    assert max(lags) > 1.05 * min(lags)


# motion ----------------------------------------------------------------------------------------------------------

POLAR = {"wheel_1": 1.6e-3, "pinion_2": 1.2e-4}
OUTPUT = 0.05


def moving(**changes) -> gj.Scene:
    inertia = {body: gj.BodyInertia(polar=polar) for body, polar in POLAR.items()}
    given = {"inertia": gj.MomentOfInertia(OUTPUT), "load": gj.ConstantLoad(), "body_inertia": inertia}
    return scene_of(**({"damping": None} | given | changes))


@pytest.mark.slow
def test_motion_by_an_integration_of_its_own():
    """Two angles on the springs of both pairs, whose levers, gaps and stiffness come from the pairs alone."""
    first = TEETH[0][0] / TEETH[1][0]
    pairs = tuple(dataclasses.replace(stage_of(mesh), contact=gj.HardContact()) for mesh in (0, 1))

    @jax.jit
    def torques(time, middle, output):
        """Torques on the middle shaft and on the output, of all slices."""
        angle = 120.0 * time
        one = pairs[0].contacts(angle, "varying")
        two = pairs[1].contacts(angle * first, "varying")
        lever_1, lever_2 = one.jacobian[:, 0], two.jacobian[:, 0]
        force_1 = one.springs.stiffness * jnp.maximum(lever_1 * middle - one.gap, 0.0)
        # a middle shaft ahead closes the driving flanks of the second mesh as its pinion, by the ratio of the pair
        overlap = lever_2 * (output - middle * TEETH[0][1] / TEETH[1][1]) - two.gap
        force_2 = two.springs.stiffness * jnp.maximum(overlap, 0.0)
        on_output = -lever_2 @ force_2
        return -lever_1 @ force_1 - on_output * TEETH[0][1] / TEETH[1][1], on_output

    def rates(time, state):
        on_middle, on_output = (float(part) for part in torques(time, state[0], state[1]))
        return [state[2], state[3], on_middle / sum(POLAR.values()), (on_output - TORQUE) / OUTPUT]

    scene = moving()
    ts = np.linspace(0.0, 0.004, 21)
    motion = gj.simulate(scene, ts, TORQUE, stepper=gj.FixedStep(per_sample=400))
    start = [float(motion.moved[0, 0]), float(motion.te[0])]
    speeds = [float(motion.moved_velocity[0, 0]), float(motion.velocity[0])]
    exact = solve_ivp(rates, (0.0, ts[-1]), [*start, *speeds], "DOP853", ts, rtol=1e-9, atol=1e-13)
    swing = np.ptp(exact.y[1])
    np.testing.assert_allclose(motion.te, exact.y[1], rtol=0, atol=2e-3 * swing)
    np.testing.assert_allclose(motion.moved[:, 0], exact.y[0], rtol=0, atol=2e-3 * np.ptp(exact.y[0]))


@pytest.mark.slow
def test_each_mesh_is_damped_by_its_own_stiffness_and_mass():
    """``b K = ratio sqrt(2 eps_gamma K m)``, with m of the bodies beside the mesh while the other mesh is open."""
    scene = moving(damping=gj.DampingRatio(0.07), errors={})
    equation = StructureEquation.of(scene, jnp.asarray(TORQUE))
    middle = sum(POLAR.values())
    for mesh, stage in enumerate(scene.system.stages):
        pair = stage.pair
        angles = np.linspace(0.0, 2 * np.pi / pair.teeth[0], 32, endpoint=False)
        whole = []
        for angle in angles:
            at = stage.contacts(jnp.asarray(angle), back=False)
            whole.append(float(STEEL.springs(at.slices).stiffness.sum()))
        stiffness = np.mean(whole)
        lever = [float(gear.base_radius * jnp.cos(pair.base_helix_angle)) for gear in pair.gears]
        easy = lever[1] ** 2 / middle if mesh == 0 else lever[0] ** 2 / middle + lever[1] ** 2 / OUTPUT
        wanted = 0.07 * math.sqrt(2 * float(pair.total_contact_ratio) * stiffness / easy) / stiffness
        assert float(equation.coefficient[mesh]) == pytest.approx(wanted, rel=2e-3)


# numbers ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_gradients_are_differences_under_jit_and_vmap():
    scene = scene_of(supports={"wheel_1": gj.Support(x=2e8, y=3e8)})
    sizes = {"normal_module": 1e-9, "face_width": 1e-9, "helix_angle": 1e-6, "line_angle": 1e-6}

    def swing(steps):
        own = {key: getattr(scene.system, key) + step for key, step in zip(sizes, steps, strict=True)}
        system = dataclasses.replace(scene.system, **own)
        te = gj.transmission_error(dataclasses.replace(scene, system=system), THETA[::8], TORQUE).te
        return (te**2).mean() * 1e8

    slopes = jax.jit(jax.vmap(jax.grad(swing)))(jnp.zeros((1, 4, 2)))[0]
    step = np.array(list(sizes.values()))[:, None, None, None] * np.eye(8).reshape(4, 2, 4, 2)
    ends = jax.jit(jax.vmap(swing))(jnp.asarray(np.concatenate([step, -step]).reshape(16, 4, 2)))
    apart = (ends[:8] - ends[8:]).reshape(4, 2) / (2 * np.array(list(sizes.values()))[:, None])
    np.testing.assert_allclose(slopes, apart, rtol=2e-5, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"face_width": [22 * mm, 30 * mm, 1 * mm]}, r"face_width.*3 values.*must be 2, one per mesh, or one for all"),
        ({"face_width": []}, r"face_width.*0 values.*must be 2, one per mesh, or one for all"),
        (
            {"centre_distance": [74 * mm, 100 * mm]},
            r"centre_distance = .*mesh 2: must be above the sum of the base radii",
        ),
        ({"pinion_shift": [0.3, -0.9]}, r"pinion_shift = .*mesh 2: undercut: with 18 teeth"),
        ({"pairs": 1}, r"pairs.*must be at least \d, as many as touch at once in mesh"),
        ({"normal_module": [2 * mm, -3 * mm]}, r"normal_module.*must be at least"),
    ],
)
def test_wrong_input_is_refused_in_one_line(changes, words):
    with pytest.raises(ParameterError, match=words) as refused:
        train(**changes)
    assert "\n" not in str(refused.value)


def test_lists_of_other_lengths_are_refused():
    with pytest.raises(ParameterError, match=r"wheel_teeth.*must have 2 numbers, one per mesh, as pinion_teeth has"):
        gj.HelicalTrain((20, 18), (50,), **GIVEN, input_speed=1.0)
    with pytest.raises(ParameterError, match=r"pinion_teeth.*list of whole numbers"):
        gj.HelicalTrain((), (), **GIVEN, input_speed=1.0)
    with pytest.raises(ParameterError, match=r"pinion_teeth\[1\].*whole number"):
        gj.HelicalTrain((20, 18.5), (50, 54), **GIVEN, input_speed=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("back", [True, False])
def test_contacts_are_named_by_their_mesh(back):
    system = train()
    layout = system.layout(gj.Request(back=back))
    for contact, (side, mesh) in enumerate(zip(layout.side, layout.mesh, strict=True)):
        flank = "driving" if side > 0 else "back"
        assert system.contact_name(contact).endswith(f"mesh {mesh + 1}")
        assert f"of the {flank} flanks" in system.contact_name(contact)
    assert len({system.contact_name(contact) for contact in range(len(layout.side))}) == len(layout.side)


@pytest.mark.slow
def test_back_flanks_of_meshes_of_different_backlash_have_their_own_stiffness():
    """The other torque presses the back flanks of both meshes, the one of which has more room than the other."""
    system = train(centre_distance=[74.1 * mm, 111.0 * mm])
    room = [float(stage.pair.backlash) for stage in system.stages]
    assert abs(room[0] - room[1]) > 20 * um
    scene = moving(system=system, damping=gj.DampingRatio(0.07), errors={})
    ahead, behind = (StructureEquation.of(scene, jnp.asarray(torque)) for torque in (TORQUE, -TORQUE))
    np.testing.assert_allclose(behind.coefficient, ahead.coefficient, rtol=2e-3)
    np.testing.assert_allclose(behind.frequency, ahead.frequency, rtol=2e-3)


@pytest.mark.slow
def test_orders_and_cycle():
    system = train()
    assert system.orders["output"] == pytest.approx(20 / 50 * 18 / 54)
    assert system.orders["mesh"] == pytest.approx(20)
    assert system.orders["mesh_2"] == pytest.approx(18 * 20 / 50)
    assert system.cycle == pytest.approx(15 * 2 * np.pi)
    scene = scene_of()
    te = [gj.transmission_error(scene, THETA + turn, TORQUE).te for turn in (0.0, system.cycle)]
    np.testing.assert_allclose(te[0], te[1], rtol=0, atol=1e-9 * np.abs(te[0]).max())
