"""Impact of teeth as they come into mesh: against plane geometry, energy, and exact series."""

import dataclasses
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.modes import StructureEquation
from gearjax.cli import main
from gearjax.compliance.wave_stiffness import WaveStiffness
from gearjax.geometry.waves import Waves
from gearjax.impact import Pulses
from gearjax.studies.select import numbers
from gearjax.systems.one_contact import OneContact
from gearjax.units import rpm, um
from tests.helical_pairs import GUO_1, SPUR, SPUR_RING, TEETH, scene_of

LINES, STIFFNESS, TORQUE = gj.LineStiffness(14e9), 5e8, 400.0
RELIEF = {"tip": gj.TipRelief("pinion", 20 * um, 8e-3), "root": gj.RootRelief("pinion", 15 * um, 8e-3)}


def loaded(given, errors=None, compliance=LINES, **changes):
    """A pair at rest, with the inertia that an impact needs."""
    scene = scene_of(given, errors, compliance, **changes)
    return dataclasses.replace(scene, inertia=gj.EquivalentMass(3.2568))


def cornered(scene):
    """The pair with contact at the corners of its tips."""
    return dataclasses.replace(scene, system=dataclasses.replace(scene.system, tip_contact="corner", pairs=None))


def plane_speed(scene, theta, lag):
    """Distance and speed along the normal at which the corner of the wheel's tip meets the flank of the pinion.

    By points in the plane (Guo and Fang 2018, eq. 10): ``v_s = (w_p x R) n - (w_g x rho) n``, with both gears turning
    evenly. Spur gears; the driving flanks pass through the pitch point at input angle 0.
    """
    pair = scene.system.pair
    inner = pair.internal
    base = [float(gear.base_radius) for gear in pair.gears]
    ratio, speed = pair.teeth[0] / pair.teeth[1], float(scene.system.input_speed)
    distance, alpha = float(pair.centre_distance), float(pair.working_pressure_angle)
    centre = np.array([-distance if inner else distance, 0.0])
    pitch = np.array([base[0] / math.cos(alpha), 0.0])

    def turned(vector, angle):
        return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]) @ vector

    def unwound(radius, number):
        """Angle of a flank point from the pitch point, about the axis of its gear."""

        def involute(at):
            slant = math.acos(base[number] / at)
            return math.tan(slant) - slant

        return involute(radius) - involute(base[number] / math.cos(alpha))

    way = 1.0 if inner else -1.0  # sense in which the wheel turns
    tip = 0.5 * float(pair.tip_diameters[1])
    corner = centre + turned(pitch - centre, -unwound(tip, 1)) * tip / np.linalg.norm(pitch - centre)
    moved = centre + turned(corner - centre, way * (theta * ratio + lag))
    radius = float(np.linalg.norm(moved))
    flank = turned(pitch, theta - unwound(radius, 0)) * radius / np.linalg.norm(pitch)
    along = turned(pitch, theta - unwound(radius * (1 + 1e-7), 0)) * radius * (1 + 1e-7) / np.linalg.norm(pitch) - flank
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    normal = normal * np.sign(normal @ [math.sin(alpha), math.cos(alpha)])

    def crossed(rate, arm):
        return rate * np.array([-arm[1], arm[0]])

    closing = crossed(speed, moved) - crossed(way * speed * ratio, moved - centre)
    lever = abs((moved - centre) @ [-normal[1], normal[0]])
    return float((moved - flank) @ normal), float(closing @ normal), lever / base[1]


@pytest.mark.slow
@pytest.mark.parametrize("given", [SPUR, SPUR_RING], ids=["external", "internal"])
def test_flanks_meet_at_the_speed_of_points_in_the_plane(given):
    scene = loaded(given, slices=2)
    found = gj.meshing_impact(scene, TORQUE)
    assert found.result.tolist() == [0]
    lag = float(gj.transmission_error(cornered(scene), found.theta, torque=TORQUE).te[0])
    apart, speed, lever = plane_speed(scene, float(found.theta[0]), lag)
    deflection = -lag * float(scene.system.pair.gears[1].base_radius)
    assert deflection > 5 * um
    assert abs(apart) < 2e-3 * deflection  # gaps are of first order in what the wheel turns
    assert 0.9 < lever < 0.99  # of the corner, over the base radius
    assert float(found.velocity[0]) == pytest.approx(speed, rel=2e-3)


@pytest.mark.slow
def test_speeds_at_the_deflections_of_the_study():
    """4.1, 6.3 and 7.5 mm/s at 2, 5 and 7 um, from points in the plane by a program apart; hence 164 to 301 N."""
    scene = loaded(GUO_1)
    system = cornered(scene).system
    lean = float(system.pair.gears[1].base_radius * jnp.cos(system.pair.base_helix_angle))
    for deflection, speed, force in ((2 * um, 4.1e-3, 164.0), (5 * um, 6.3e-3, 256.0), (7 * um, 7.5e-3, 301.0)):
        torque = 830.0
        for _ in range(8):
            found = gj.meshing_impact(scene, torque, stiffness=STIFFNESS)
            lag = gj.transmission_error(cornered(scene), found.theta, torque=torque).te[0]
            torque = float(torque * deflection / (-lag * lean))
        assert float(found.velocity[0]) == pytest.approx(speed, rel=0.02)  # two digits are given
        assert float(found.force[0]) == pytest.approx(force, rel=0.03)
    assert float(found.duration[0]) == pytest.approx(127e-6, rel=0.01)


@pytest.mark.slow
def test_energy_and_momentum():
    scene = loaded(GUO_1, RELIEF, TEETH, slices=10)
    found = gj.meshing_impact(scene, TORQUE)
    mass, speed = float(found.mass), float(found.velocity[0])
    assert mass == pytest.approx(3.2568, rel=1e-12)
    assert float(found.force[0]) ** 2 / (2 * float(found.stiffness[0])) == pytest.approx(0.5 * mass * speed**2)
    rate = scene.system.input_speed
    time = jnp.linspace(-0.5, 1.5, 40001) * found.duration[0]
    pulse = jax.vmap(found.pulses.at, (0, None))(found.theta[0] + rate * time, rate)
    impulse = float(pulse.sum() * (time[1] - time[0]))
    assert impulse == pytest.approx(mass * speed, rel=1e-6)
    assert float(found.impulse[0]) == pytest.approx(mass * speed, rel=1e-12)
    assert float(pulse.max()) == pytest.approx(float(found.force[0]), rel=1e-6)
    turned = jax.vmap(found.pulses.at, (0, None))(found.theta[0] + rate * time + 7 * found.pitch, rate)
    np.testing.assert_allclose(turned, pulse, atol=1e-6 * float(found.force[0]))


@pytest.mark.slow
def test_both_gears_are_the_mass_where_both_move():
    supports = {"pinion": gj.Support(rz=1e7)}
    own = {"supports": supports, "body_inertia": {"pinion": gj.BodyInertia(polar=0.0113)}}
    scene = dataclasses.replace(loaded(GUO_1), inertia=gj.MomentOfInertia(0.389), **own)
    base = [float(gear.base_radius * jnp.cos(scene.system.pair.base_helix_angle)) for gear in scene.system.pair.gears]
    wanted = 1 / (base[0] ** 2 / 0.0113 + base[1] ** 2 / 0.389)
    assert float(gj.meshing_impact(scene, TORQUE).mass) == pytest.approx(wanted, rel=1e-12)
    with pytest.raises(gj.SceneError, match=r"needs \[inertia.pinion\] with polar"):
        gj.meshing_impact(dataclasses.replace(scene, body_inertia={}), TORQUE)


@pytest.mark.slow
def test_each_pair_has_its_own_impact():
    """The impact of pair j is that of pair 0 of gears whose teeth are numbered from tooth j on."""
    pitch = np.random.default_rng(3).normal(0.0, 4 * um, 20)
    scene = loaded(SPUR | {"teeth": (20, 30), "centre_distance": None}, slices=2)

    def impacts(first, **given):
        errors = {"pitch": gj.Positions("pinion", np.zeros(1), np.roll(pitch, -first))}
        return gj.meshing_impact(dataclasses.replace(scene, errors=errors, **given), TORQUE)

    whole = impacts(0)
    assert len(whole.force) == 60  # of the hunting tooth
    assert np.ptp(np.asarray(whole.force)) > 0.1 * float(whole.force.mean())
    for pair in (1, 7):
        own = impacts(pair, impact=gj.MeshingImpact(pairs=1))
        assert len(own.force) == 1
        assert float(own.force[0]) == pytest.approx(float(whole.force[pair]), rel=1e-7)
        assert float(own.theta[0] + pair * own.pitch) == pytest.approx(float(whole.theta[pair]), abs=1e-9)
    rate = scene.system.input_speed
    middles = whole.theta + 0.5 * rate * whole.duration
    np.testing.assert_allclose(jax.vmap(whole.pulses.at, (0, None))(middles, rate), whole.force, rtol=1e-9)
    again = middles + 60 * whole.pitch
    np.testing.assert_allclose(jax.vmap(whole.pulses.at, (0, None))(again, rate), whole.force, rtol=1e-9)
    assert len(gj.meshing_impact(dataclasses.replace(scene, errors=RELIEF), TORQUE).force) == 1  # all are alike


def linear(pulses, speed, mass=3.0, stiffness=4e8, ratio=0.05):
    """One contact of constant stiffness under pulses: a linear oscillator."""
    system = OneContact(jnp.asarray(speed), jnp.asarray(0.13), (Waves.of(jnp.zeros(16), 2),), pulses.pitch, ())
    compliance = WaveStiffness(Waves.of(jnp.full(16, stiffness), 2))
    parts = {"inertia": gj.EquivalentMass(mass), "damping": gj.DampingRatio(ratio, "always")}
    return gj.Scene(system, compliance=compliance, load=gj.ConstantLoad(), impact=pulses, **parts)


@pytest.mark.slow
@pytest.mark.parametrize("duration", [3e-5, 1.3e-3])  # the second one is longer than a pitch
def test_motion_is_the_sum_of_the_series_of_the_pulses(duration):
    """``x_n = F_n / (k - m w_n^2 + i w_n c)`` with the coefficients F_n of a half sine, by numerical integration."""
    speed, pitch, torque, force = 60.0, 0.04, 200.0, 300.0
    pulses = Pulses(jnp.array([0.011]), jnp.array([force]), jnp.array([duration]), pitch)
    scene = linear(pulses, speed)
    period = pitch / speed
    found = gj.shooting(scene, torque, period, steps=4096)
    assert int(found.result) == 0
    mass, stiffness = 3.0, 4e8
    damping = 0.05 * math.sqrt(2 * stiffness * mass)
    order = 2 * np.pi / period * np.arange(400)
    within = (np.arange(200_000) + 0.5) / 200_000 * duration
    begun = 0.011 / speed
    waves = np.array(
        [(force * np.sin(np.pi * within / duration) * np.exp(-1j * w * (within + begun))).mean() for w in order]
    )
    waves = waves * duration / period
    waves[0] -= torque / 0.13
    answer = waves / (stiffness - mass * order**2 + 1j * order * damping)
    times = np.asarray(found.ts)
    wanted = answer[0].real + 2 * (answer[None, 1:] * np.exp(1j * times[:, None] * order[None, 1:])).real.sum(axis=1)
    moved = np.asarray(found.te) * 0.13
    assert np.abs(moved - wanted).max() < 2e-5 * np.ptp(wanted)
    ts = np.arange(40 * 64 + 1) * period / 64
    marched = np.asarray(gj.simulate(scene, ts, torque).te)[-65:-1] * 0.13
    assert np.abs(marched - moved[::64]).max() < 2e-3 * np.ptp(moved)  # the default steps
    balanced = gj.harmonic_balance(scene, torque, period, harmonics=200, samples=1024)
    assert np.abs(np.asarray(balanced.te)[::16] * 0.13 - moved[::64]).max() < 2e-3 * np.ptp(moved)


@pytest.mark.slow
def test_the_force_is_along_v_of_the_paper():
    """``V^T f_s`` of eqs. 21 and 25, on bodies on supports; both schemes of motion agree."""
    stiff = gj.Support(x=2e8, y=2e8, z=1e8, x_damping=883.0, y_damping=883.0, z_damping=624.0)
    own = {
        "supports": {"wheel": stiff},
        "body_inertia": {"wheel": gj.BodyInertia(mass=39.0)},
        "impact": gj.MeshingImpact(STIFFNESS),
        "load": gj.ConstantLoad(),
        "damping": gj.DampingRatio(0.07),
    }
    scene = dataclasses.replace(loaded(GUO_1, RELIEF, slices=10, input_speed=2104 * rpm), **own)
    found = gj.meshing_impact(scene, 830.0)
    equation = StructureEquation.of(scene.physics(*MODELLED), jnp.asarray(830.0))
    time = (found.theta[0] / scene.system.input_speed + 0.5 * found.duration[0])[()]
    pair = scene.system.pair
    alpha, beta = float(pair.working_pressure_angle), float(pair.base_helix_angle)
    normal = np.array([math.sin(alpha) * math.cos(beta), math.cos(alpha) * math.cos(beta), -math.sin(beta)])
    wanted = -np.array([float(pair.gears[1].base_radius) * math.cos(beta), *normal])
    np.testing.assert_allclose(equation.along, wanted, rtol=1e-9)
    assert float(equation.struck_at(time)) == pytest.approx(float(found.force[0]), rel=1e-9)
    ts = np.arange(6 * 64) * found.pitch / float(scene.system.input_speed) / 64
    modes = gj.simulate(scene, ts, 830.0)
    step = gj.chosen_steps(scene, ts, 830.0).step
    short = gj.simulate(scene, ts, 830.0, stepper=gj.FixedStep(step=step / 8, solver=gj.RungeKutta4()))
    without = gj.simulate(dataclasses.replace(scene, impact=None), ts, 830.0)
    change = np.abs(np.asarray(modes.q - without.q)).max(axis=0)
    assert (change > 0.01 * np.ptp(np.asarray(without.q), axis=0)).all()
    assert (np.abs(np.asarray(modes.q - short.q)).max(axis=0) < 0.01 * change).all()


@pytest.mark.slow
def test_gradients_are_differences_under_jit_and_vmap():
    scene = loaded(GUO_1, RELIEF, slices=6)

    def force(numbers):
        torque, tip, stiffness, module = numbers
        relief = {"tip": gj.TipRelief("pinion", tip * um, 8e-3), "root": RELIEF["root"]}
        pinion = dataclasses.replace(scene.system, normal_module=module * 1e-3, centre_distance=None)
        changed = dataclasses.replace(scene, errors=relief, system=pinion, impact=gj.MeshingImpact(pairs=1))
        return gj.meshing_impact(changed, torque, stiffness=stiffness * 1e8).force[0]

    start = jnp.array([[700.0, 18.0, 4.0, 6.0], [950.0, 5.0, 6.0, 6.02], [500.0, 1.0, 9.0, 5.9]])
    gradient = jax.jit(jax.vmap(jax.grad(force)))(start)
    steps = np.array([1e-2, 1e-3, 1e-4, 1e-4])
    both = np.concatenate([np.diag(steps), -np.diag(steps)])
    moved = jax.jit(jax.vmap(jax.vmap(force)))(start[:, None] + both[None])
    moved = np.asarray(moved)
    wanted = (moved[:, :4] - moved[:, 4:]) / (2 * steps)
    np.testing.assert_allclose(gradient, wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())
    forward = jax.jit(jax.vmap(jax.jacfwd(force)))(start)
    np.testing.assert_allclose(forward, gradient, rtol=1e-9)


@pytest.mark.slow
def test_one_contact_keeps_the_impact_of_the_whole():
    parts = {"load": gj.ConstantLoad(), "impact": gj.MeshingImpact(STIFFNESS)}
    scene = dataclasses.replace(loaded(GUO_1, RELIEF, TEETH, slices=10), **parts)
    reduced = gj.one_contact(scene, 830.0).scene.impact
    whole = gj.meshing_impact(scene, 830.0)
    assert isinstance(reduced, Pulses)
    np.testing.assert_allclose(reduced.force, whole.force, rtol=1e-12)
    np.testing.assert_allclose(reduced.theta, whole.theta, rtol=1e-12)


@pytest.mark.slow
def test_extremes():
    scene = loaded(SPUR, slices=2)
    light = gj.meshing_impact(scene, 1e-6)
    assert 0 < float(light.force[0]) < 1
    hardly = gj.meshing_impact(scene, 1e9)
    assert hardly.result.tolist() == [1]  # the pair touches before its gap is known
    assert np.isnan(float(hardly.force[0]))
    moving = {"load": gj.ConstantLoad(), "impact": gj.MeshingImpact(), "damping": gj.DampingRatio(0.05)}
    still = gj.simulate(dataclasses.replace(scene, **moving), np.linspace(0.0, 0.01, 65), 0.0)
    assert np.isfinite(np.asarray(still.te)).all()
    with pytest.raises(gj.SceneError, match=r"not finite: no impact is found under 1e\+09 N\*m \(pairs .*: 1\)"):
        gj.simulate(dataclasses.replace(scene, **moving), np.linspace(0.0, 0.01, 65), 1e9)


def test_what_has_no_impact_is_refused():
    with pytest.raises(gj.SceneError, match=r"needs \[inertia\]"):
        gj.meshing_impact(scene_of(SPUR, {}, LINES, slices=2), TORQUE)
    with pytest.raises(gj.SceneError, match="the teeth themselves strike each other"):
        dataclasses.replace(loaded(SPUR, slices=2, tip_contact="corner"), impact=gj.MeshingImpact())
    with pytest.raises(gj.ParameterError, match="torque = -3: must be above 0"):
        gj.meshing_impact(loaded(SPUR, slices=2), -3.0)
    with pytest.raises(gj.SceneError, match=r"\[impact\] is for a helical_pair, not for a two_kv"):
        dataclasses.replace(gj.load("configs/two_kv/wang_2020.toml"), impact=gj.MeshingImpact())
    pitch = {"pitch": gj.Positions("pinion", np.zeros(1), np.arange(499) * 1e-9)}
    many = SPUR | {"teeth": (499, 500), "centre_distance": None}
    with pytest.raises(gj.SceneError, match=r"249500 pairs of teeth differ, more than 20000: give impact\.pairs"):
        gj.meshing_impact(loaded(many, pitch, slices=1), TORQUE)


CONFIGURATION = """
[system]
kind = "helical_pair"
pinion_teeth = 20
wheel_teeth = 30
normal_module = "3 mm"
normal_pressure_angle = "20 deg"
helix_angle = "0 deg"
face_width = "25 mm"
input_speed = "1500 rpm"
slices = 2
[errors.wheel]
kind = "positions"
body = "wheel"
outward = ["0 um"]
around = [AROUND]
[compliance]
kind = "line_stiffness"
per_length = "14 N/mm/um"
[inertia]
mass = "0.7 kg"
[damping]
ratio = 0.1
[load]
kind = "constant"
[impact]
stiffness = "2e8 N/m"
[run]
duration = "10 ms"
samples = 401
analyses = ["dynamic"]
torques = ["200 N*m"]
"""


@pytest.mark.slow
def test_a_run_tells_and_draws_its_impacts(tmp_path, capsys):
    around = ", ".join(f'"{value:.1f} um"' for value in np.random.default_rng(1).normal(0.0, 3.0, 30))
    config = tmp_path / "struck.toml"
    config.write_text(CONFIGURATION.replace("AROUND", around), encoding="utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(["run", str(config), "--out", str(tmp_path / "out"), "--json"])
    assert not stopped.value.code
    told = json.loads(capsys.readouterr().out)["meshing_impact"]["dynamic, 200 N m"]
    found = gj.meshing_impact(gj.load(config), 200.0)
    assert told["pairs"] == 60
    assert told["force_N"] == pytest.approx(float(found.force.mean()))
    assert told["largest_force_N"] == pytest.approx(float(found.force.max()))
    assert told["duration_us"] == pytest.approx(0.5e6 * math.pi * math.sqrt(0.7 / 2e8))
    assert (tmp_path / "out" / "meshing_impact.png").stat().st_size > 10_000
    assert "impact.stiffness" in numbers(gj.load(config))


@pytest.mark.slow
def test_single_precision():
    """Speed and force to 2 parts in 1,000; teeth that differ by half a micrometre are told apart, others are alike."""
    pitch = {"pitch": gj.Positions("pinion", np.zeros(1), 0.5 * um * np.eye(19)[3])}
    scene = loaded(GUO_1, RELIEF, slices=6)
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    wide, narrow = (gj.meshing_impact(one, TORQUE, stiffness=STIFFNESS) for one in (scene, single))
    assert narrow.force.dtype == jnp.float32
    assert len(narrow.force) == 1
    assert float(narrow.velocity[0]) == pytest.approx(float(wide.velocity[0]), rel=2e-3)
    assert float(narrow.force[0]) == pytest.approx(float(wide.force[0]), rel=2e-3)
    differing = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), dataclasses.replace(scene, errors=pitch))
    assert gj.MeshingImpact().counted(differing).pairs == 893
