"""A made-up train for the tests: two spur meshes on three shafts, every wheel on bearings that may give way."""

import dataclasses
import itertools
import math
from collections.abc import Mapping
from fractions import Fraction
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.optimize import linprog

import gearjax as gj
from gearjax.contact import Layout
from gearjax.parameters import angle, check_parameters, count, length, number
from gearjax.systems import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar
from gearjax.units import ANGULAR_SPEED, deg, mm, um

BODIES = ("pinion_1", "wheel_1", "pinion_2", "wheel_2")


class SpurTrain(AbstractSystem):
    """Two pairs of spur wheels in series, the second line of centres turned by an angle against the first."""

    kind: ClassVar[str] = "spur_train"
    teeth: tuple[int, ...] = eqx.field(static=True, default=(20, 31, 18, 45))
    pairs: int = count(default=1)
    module: Number = length(above=0.0, default=2 * mm)
    pressure_angle: Number = angle(above=0.0, default=20 * deg)
    turned: Number = angle(default=70 * deg)
    waviness: Number = length(default=3 * um)
    input_speed: Number = number(ANGULAR_SPEED, above=0.0, default=60.0)

    def __check_init__(self):
        check_parameters(self)

    @property
    def bodies(self) -> tuple[str, ...]:
        return BODIES

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return dict.fromkeys(BODIES, ("x", "y", "rz"))

    @property
    def meshes(self) -> tuple[tuple[str, str], ...]:
        return BODIES[:2], BODIES[2:]

    @property
    def ratios(self) -> tuple[float, float]:
        """Turns of each driven wheel per turn of the input."""
        first = self.teeth[0] / self.teeth[1]
        return first, first * self.teeth[2] / self.teeth[3]

    @property
    def orders(self) -> Mapping[str, float]:
        first, second = float(self.teeth[0]), self.teeth[2] * self.ratios[0]  # of the teeth, with which gaps change
        own = {"intermediate": self.ratios[0], "first_teeth": first, "second_teeth": second}
        return {"output": self.ratios[1], "mesh": first, **own}

    @property
    def cycle(self) -> float:
        first, second = (Fraction(driver, driven) for driver, driven in (self.teeth[:2], self.teeth[2:]))
        return 2 * math.pi * math.lcm(first.denominator, (first * second).denominator)

    def layout(self, request: gj.Request) -> Layout:
        one = Layout.of_flanks(self.pairs, request.back)
        pair = one.pair + tuple(p + self.pairs for p in one.pair)
        return Layout(one.side * 2, pair, (0,) * len(one.side) + (1,) * len(one.side))

    def base_radius(self, body: str) -> Scalar:
        return 0.5 * self.teeth[BODIES.index(body)] * self.module * jnp.cos(self.pressure_angle)

    def pose(self, theta: Scalar, request: gj.Request) -> gj.Pose:
        layout = self.layout(request)
        side, mesh = np.array(layout.side), np.array(layout.mesh)
        columns = [self._column("wheel_2", "rz", side, mesh)]
        columns += [self._column(*name.split("."), side, mesh) for name in request.coordinates]
        phase = jnp.asarray(np.where(mesh == 0, self.teeth[0], self.teeth[2] * self.ratios[0]), theta.dtype) * theta
        gap = self.waviness * (1 + jnp.cos(phase + jnp.asarray(0.7 * mesh + np.array(layout.pair), theta.dtype)))
        first = jnp.arange(2 * self.pairs) // self.pairs
        angles = theta * jnp.where(first == 0, float(self.teeth[0]), self.teeth[2] * self.ratios[0]).astype(theta.dtype)
        views = {body: self._view(body, theta, side, mesh) for body in request.bodies}
        return gj.Pose(theta, jnp.stack(columns, axis=1), gap, views, angles if request.mesh else None)

    def _view(self, body: str, theta: Scalar, side: np.ndarray, mesh: np.ndarray) -> gj.BodyView:
        place = BODIES.index(body)
        turn = theta * (1.0, self.ratios[0], self.ratios[0], self.ratios[1])[place]
        own = (mesh == place // 2) * (1.0 if place % 2 else -1.0)
        return gj.BodyView(turn, jnp.asarray(side * 0.3 + mesh, theta.dtype), jnp.asarray(own, theta.dtype))

    def _column(self, body: str, way: str, side: np.ndarray, mesh: np.ndarray) -> Float[Array, " contact"]:
        """Change of overlap per motion of a body: it is the driving one, which closes, or the driven one."""
        place = BODIES.index(body)
        dtype = self.module.dtype
        sign = jnp.asarray((mesh == place // 2) * (-1.0 if place % 2 else 1.0), dtype)
        side = jnp.asarray(side, dtype)
        if way == "rz":
            return sign * side * self.base_radius(body)
        along, across = jnp.sin(self.pressure_angle), side * jnp.cos(self.pressure_angle)
        turned = jnp.where(mesh == 0, 0.0, self.turned)
        cos, sin = jnp.cos(turned), jnp.sin(turned)
        return sign * (cos * along - sin * across if way == "x" else sin * along + cos * across)


class Rim(gj.AbstractCoupledCompliance):
    """Teeth that share a rim: a force on one flank moves the flanks of the same side and mesh too."""

    kind: ClassVar[str] = "shared_rim"
    own: Number = number(gj.units.ANGLE, default=5e-9)
    shared: Number = number(gj.units.ANGLE, default=2e-9)

    def influence(self, layout: Layout) -> Float[Array, "contact contact"]:
        where = list(zip(layout.side, layout.mesh, strict=True))
        alike = np.array([[one == other for other in where] for one in where], dtype=float)
        return self.own * np.eye(len(where)) + self.shared * (alike - np.eye(len(where)))


def train(**changes) -> gj.Scene:
    """The train on an intermediate shaft, with teeth that give way and backlash."""
    own = SpurTrain(**changes.pop("system", {}))
    given = {
        "errors": {"run_out": gj.Eccentricity("wheel_1", 8 * um, 0.4), "end": gj.Eccentricity("wheel_2", 5 * um, 1.0)},
        "backlash": gj.InitialBacklash(60 * um),
        "compliance": gj.HarmonicStiffness(2e8, [0.2], [0.0]),
        "shafts": {"middle": gj.Shaft(["wheel_1", "pinion_2"])},
    }
    return gj.Scene(own, **(given | changes))


def on_bearings(stiffness: float = 2e8, **changes) -> gj.Scene:
    """All wheels free in x and y, the input on a drive that gives way, the middle shaft twisting and bending."""
    supports = {body: gj.Support(x=stiffness, y=1.3 * stiffness, x_damping=400.0, y_damping=500.0) for body in BODIES}
    supports["pinion_1"] = gj.Support(
        x=stiffness, y=1.3 * stiffness, rz=5e4, x_damping=400.0, y_damping=500.0, rz_damping=0.5
    )
    shaft = gj.Shaft(["wheel_1", "pinion_2"], torsion=4e4, torsion_damping=0.4, bending=0.2 * stiffness)
    return train(**({"supports": supports, "shafts": {"middle": shaft}} | changes))


INERTIA = {
    "pinion_1": gj.BodyInertia(0.5, 1e-4),
    "wheel_1": gj.BodyInertia(1.2, 8e-4),
    "pinion_2": gj.BodyInertia(0.4, 9e-5),
    "wheel_2": gj.BodyInertia(2.0),
}


def in_motion(scene: gj.Scene, **changes) -> gj.Scene:
    """The same with inertia, load and damping."""
    bodies = scene.moving.coordinates.bodies
    inertia = {body: INERTIA[body] for body in bodies}
    for body in bodies:
        if not scene.supports:
            inertia[body] = gj.BodyInertia(polar=INERTIA[body].polar)
    given = {"inertia": gj.MomentOfInertia(4e-3), "load": gj.ConstantLoad(), "damping": gj.DampingRatio(0.05)}
    return dataclasses.replace(scene, body_inertia=inertia, **(given | changes))


def brute(jacobian, gap, influence, stiffness, torque):
    """Coordinates and forces of the one set of closed contacts that fits, of all sets: K q + J^T f = Q."""
    number, coordinates = jacobian.shape
    load = np.zeros(coordinates)
    load[0] = -torque
    for closed in itertools.product((False, True), repeat=number):
        own = np.flatnonzero(closed)
        inner = influence[np.ix_(own, own)]
        whole = np.block([[stiffness, jacobian[own].T], [jacobian[own], -inner]])
        try:
            found = np.linalg.solve(whole, np.concatenate([load, gap[own]]))
        except np.linalg.LinAlgError:
            continue
        place, forces = found[:coordinates], np.zeros(number)
        forces[own] = found[coordinates:]
        beyond = jacobian @ place - gap - influence @ forces
        scale = abs(gap).max()
        if (forces[own] > 0).all() and (np.delete(beyond, own) <= 1e-12 * scale).all():
            return place, forces
    raise ValueError("no set of contacts fits")


def light(jacobian, gap, load: int):
    """Position of the output under the lightest of torques: a linear programme."""
    cost = np.zeros(jacobian.shape[1])
    cost[0] = load
    found = linprog(cost, A_ub=jacobian / 1e-2, b_ub=gap / 1e-2 / 1.0, bounds=(None, None), method="highs-ds")
    assert found.status == 0
    return found.x[0]
