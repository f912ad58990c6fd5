"""Gears whose ideal output turns unevenly: a made-up pair of non-circular gears, in absolute coordinates by scipy."""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gearjax as gj
from gearjax.checks import SceneError
from gearjax.contact import Layout
from gearjax.parameters import angle, check_parameters, count, length, number
from gearjax.systems import AbstractSystem
from gearjax.typing import Number, Scalar
from gearjax.units import ANGULAR_SPEED, RATIO, deg, mm, um
from tests.test_batches import equations

SPEED = 60.0


class Lobed(AbstractSystem):
    """Two wheels with pitch curves: the output turns by ``theta + swing sin(theta)``, one tooth pair."""

    kind: ClassVar[str] = "lobed"
    teeth: int = count(default=12)
    centre_distance: Number = length(above=0.0, default=60 * mm)
    swing: Number = number(RATIO, at_least=0.0, below=1.0, default=0.3)
    pressure_angle: Number = angle(above=0.0, default=20 * deg)
    input_speed: Number = number(ANGULAR_SPEED, above=0.0, default=SPEED)

    def __check_init__(self):
        check_parameters(self)

    @property
    def bodies(self) -> tuple[str, ...]:
        return ("driver", "wheel")

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return {"wheel": ("y",)}

    @property
    def orders(self) -> Mapping[str, float]:
        return {"output": 1.0, "mesh": float(self.teeth)}

    @property
    def cycle(self) -> float:
        return 2 * math.pi

    def output(self, theta: Scalar) -> Scalar:
        return theta + self.swing * jnp.sin(theta)

    def layout(self, request: gj.Request) -> Layout:
        return Layout.of_flanks(1, request.back)

    def pose(self, theta: Scalar, request: gj.Request) -> gj.Pose:
        side = jnp.asarray(self.layout(request).side, theta.dtype)
        ratio = jax.jvp(self.output, (theta,), (jnp.ones_like(theta),))[1]
        lever = self.centre_distance / (1 + ratio) * jnp.cos(self.pressure_angle)  # of the wheel's pitch radius
        columns = [-side * lever, *(-side * jnp.cos(self.pressure_angle) for _ in request.coordinates)]
        views = {body: gj.BodyView(theta, side * 0.35, side if body == "wheel" else -side) for body in request.bodies}
        mesh = (self.teeth * theta)[None] if request.mesh else None
        return gj.Pose(theta, jnp.stack(columns, axis=1), jnp.zeros_like(side), views, mesh)


def lobed(**changes) -> gj.Scene:
    given = {
        "errors": {"wheel": gj.Eccentricity("wheel", 10 * um, 0.4)},
        "backlash": gj.InitialBacklash(40 * um),
        "compliance": gj.HarmonicStiffness(1e8, [0.1], [0.0]),
        "inertia": gj.MomentOfInertia(5e-3),
        "load": gj.ConstantLoad(),
        "damping": gj.DampingRatio(0.1, "always"),
    }
    return gj.Scene(Lobed(**changes.pop("system", {})), **(given | changes))


def absolute(scene: gj.Scene, torque: float, ts: np.ndarray) -> np.ndarray:
    """Deviation of the output's own angle y from the ideal one, ``I y'' = -T - sum J f``, everything by hand."""
    swing, distance = float(scene.system.swing), 60e-3
    inertia, backlash = float(scene.inertia.moment_of_inertia), float(scene.backlash.initial)
    cos = math.cos(math.radians(20))
    arm = distance / (2 + swing) * cos  # at the start, which the mass on the line of action counts with
    coefficient = float(scene.damping.ratio) * math.sqrt(2 * 1e8 * inertia / arm**2)

    def gaps(time: float) -> np.ndarray:
        run_out = 10e-6 * math.sin(SPEED * time + 0.35 + 0.4)
        back = -10e-6 * math.sin(SPEED * time - 0.35 + 0.4)
        return np.array([run_out, back + backlash])

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        theta = SPEED * time
        ratio, bend = 1 + swing * math.cos(theta), -swing * math.sin(theta)
        lever = distance / (1 + ratio) * cos
        turning = -distance / (1 + ratio) ** 2 * bend * SPEED * cos
        q = state[0] - (theta + swing * math.sin(theta))
        v = state[1] - ratio * SPEED
        stiffness = 1e8 * (1 + 0.1 * math.cos(12 * theta))
        forces = stiffness * np.maximum(np.array([-lever, lever]) * q - gaps(time), 0.0)
        h = 1e-6
        opening = (gaps(time + h)[0] - gaps(time - h)[0]) / (2 * h)
        drag = coefficient * (-lever * v - turning * q - opening)
        return np.array([state[1], (-torque + lever * (forces[0] - forces[1]) + lever * drag) / inertia])

    start = np.array([0.0, (1 + swing) * SPEED])
    found = solve_ivp(rate, (0, ts[-1]), start, "DOP853", ts, rtol=1e-12, atol=1e-15, max_step=2e-5)
    return found.y[0] - (SPEED * ts + swing * np.sin(SPEED * ts))


TS = np.linspace(0.0, 0.1, 51)
WAYS = {
    "fitted": (lambda scene: scene, gj.FixedStep(per_sample=400), 2e-5),
    "Runge-Kutta": (lambda scene: scene, gj.FixedStep(per_sample=400, solver=gj.RungeKutta4()), 2e-5),
    "adaptive": (lambda scene: scene, gj.AdaptiveStep(1e-10, 1e-10), 1e-7),
    "modes": (
        lambda scene: dataclasses.replace(
            scene, supports={"wheel": gj.Support(y=1e16)}, body_inertia={"wheel": gj.BodyInertia(1.0)}
        ),
        gj.FixedStep(per_sample=400),
        2e-5,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("swing", [0.3, 0.6])
def test_the_output_in_absolute_coordinates(swing):
    """The teeth lose contact and hit their back flanks where the output is slowed down."""
    scene = lobed(system={"swing": swing})
    torque = 3.0
    wanted = absolute(scene, torque, TS)
    size = np.ptp(wanted)
    back = 0
    for name, (changed, stepper, bound) in WAYS.items():
        motion = gj.simulate(changed(scene), TS, torque, start="zero", stepper=stepper)
        assert int(motion.result) == 0, name
        assert abs(np.asarray(motion.te) - wanted).max() < bound * size, name
        back = max(back, int((np.asarray(motion.forces)[:, 1] > 0).sum()))
    assert back > 0


@pytest.mark.slow
def test_stiff_teeth_carry_load_and_inertia():
    """The contact force tends to ``(T + I phi'') / lever``; without that term it would be off by its own size."""
    scene = lobed(compliance=gj.HarmonicStiffness(1e11, [], []), errors={}, damping=gj.DampingRatio(1.0, "always"))
    motion = gj.simulate(scene, TS, 10.0)
    theta = SPEED * TS
    bend = -0.3 * np.sin(theta) * SPEED**2
    lever = 60e-3 / (2 + 0.3 * np.cos(theta)) * np.cos(np.radians(20))
    expected = (10.0 + 5e-3 * bend) / lever
    np.testing.assert_allclose(motion.forces[:, 0], expected, rtol=2e-3)
    assert np.ptp(5e-3 * bend) > 5.0


@pytest.mark.slow
def test_the_input_gives_what_the_output_takes():
    """Work of the input over a period of settled motion: that of the load; what inertia takes it gives back."""
    damping = gj.DampingRatio(1e-6, "always")
    scene = lobed(compliance=gj.HarmonicStiffness(1e11, [], []), errors={}, damping=damping)
    ts = np.linspace(0.0, 2 * np.pi / SPEED, 4001)
    motion = gj.simulate(scene, ts, 10.0)
    theta = SPEED * ts
    ratio = 1 + 0.3 * np.cos(theta)
    lever = 60e-3 / (1 + ratio) * np.cos(np.radians(20))
    power = np.asarray(motion.forces)[:, 0] * lever * ratio * SPEED
    work = ((power[1:] + power[:-1]) / 2 * np.diff(ts)).sum()
    assert work == pytest.approx(10.0 * 2 * np.pi, rel=1e-3)
    kinetic = 0.5 * 5e-3 * (ratio * SPEED) ** 2
    assert np.ptp(kinetic) > 5.0


@pytest.mark.slow
def test_periodic_motion_and_gradients():
    scene = lobed()
    found = gj.shooting(scene, 10.0, 2 * np.pi / SPEED, steps=4096)
    assert int(found.result) == 0
    balance = gj.harmonic_balance(scene, 10.0, 2 * np.pi / SPEED, harmonics=40, samples=512)
    assert int(balance.result) == 0
    assert float(abs(balance.te - found.te[::8]).max()) < 1e-3 * float(jnp.ptp(found.te))

    @jax.jit
    @jax.vmap
    def std(swing):
        own = dataclasses.replace(scene, system=dataclasses.replace(scene.system, swing=swing))
        return 1e6 * gj.simulate(own, TS, 10.0, stepper=gj.FixedStep(per_sample=64)).te.std()

    slope = jax.grad(lambda x: std(x[None])[0])(jnp.asarray(0.3))
    values = std(jnp.array([0.3 + 1e-6, 0.3 - 1e-6]))
    assert float(slope) == pytest.approx(float((values[0] - values[1]) / 2e-6), rel=1e-5)


@pytest.mark.slow
def test_an_even_output_leaves_no_equation(scene):
    assert scene.system.turns_evenly
    assert not lobed().system.turns_evenly
    with_term = equations(jax.make_jaxpr(lambda t: Lobed().output_acceleration(t))(0.1).jaxpr)
    assert with_term > 0

    class Even(Lobed):
        def output(self, theta):
            return 0.4 * theta

    def program(system) -> int:
        own = dataclasses.replace(lobed(), system=system)
        return equations(jax.make_jaxpr(lambda s: gj.simulate(s, TS, 10.0, stepper=gj.FixedStep(1e-4)).te)(own).jaxpr)

    assert program(Even(swing=0.3)) < program(Lobed(swing=0.3))


def test_what_does_not_go_together_is_refused():
    class Carried(Lobed):
        @property
        def orbits(self):
            return {"wheel": None}

    scene = dataclasses.replace(lobed(), system=Carried())
    with pytest.raises(SceneError, match="turns unevenly is only possible without shafts and cranks"):
        gj.simulate(scene, TS, 10.0)
