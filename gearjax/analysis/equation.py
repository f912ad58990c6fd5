"""The equation of motion of the output on its contacts, and its rates.

    M q'' + sum_i J_i (k_i(t) penetration(overlap_i) + c_i overlap_i') = -T(t) - M phi''

(consistent form of Wang et al. 2020, eq. 19; the printed equation has wrong signs). phi is the ideal output angle; if
the output turns evenly, its term vanishes. Position is scaled by `LENGTH_SCALE` on the line of action, time by the
highest natural frequency.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.meshing_impact import pulses_of
from gearjax.analysis.resting import carriers
from gearjax.contact import ContactSet, Layout, LinearSprings, Pose, Request, equilibrium
from gearjax.dependence import depends
from gearjax.impact import Pulses
from gearjax.scene import Scene
from gearjax.systems.base import pose_of
from gearjax.typing import Array, Float, Int, Scalar

LENGTH_SCALE = 1e-5  # m on the line of action


class Instant(NamedTuple):
    """Time, pose of the system and its rate if it is needed; errors change none of them."""

    time: Scalar
    pose: Pose
    rate: Pose | None


class Gaps(eqx.Module):
    """Levers and gaps of the contacts at one time, and their rates; a rate that is not needed is ``None``."""

    lever: Array
    gap: Array
    lever_rate: Array | None
    gap_rate: Array | None


class Excitation(eqx.Module):
    """Excitation of the motion at one time: everything in the equation except the state of the output."""

    gaps: Gaps
    stiffness: Array
    torque: Array


class Equation(eqx.Module):
    """The scaled equation of motion of one scene under one torque.

    Args:
        scene: the scene, `Scene.anchored`.
        torque: size of the load torque [N m].
        frequency: highest natural frequency, with all pairs in contact at their peak stiffness [rad/s]; scales time.
        scale: position per scaled position [rad].
        inertia: moment of inertia about the output's axis [kg m2]; constant, even if the levers change over time.
        mass: equivalent mass on the line of action, from which the damping is computed [kg].
        pulses: impacts of the teeth as they come into mesh; ``None`` without.
        lever: mean lever of the driving flanks, through which the impacts act [m/rad].
        levers_turn: whether the levers change over time.
        turns_evenly: whether the ideal output turns evenly.
        meshes_unevenly: whether the stiffness changes with a mesh phase that does not grow evenly.
        layout: sides and pairs of the contacts.
    """

    scene: Scene
    torque: Scalar
    frequency: Scalar
    scale: Scalar
    inertia: Scalar
    mass: Scalar
    pulses: Pulses | None
    lever: Scalar
    levers_turn: bool = eqx.field(static=True)
    turns_evenly: bool = eqx.field(static=True)
    meshes_unevenly: bool = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)

    @classmethod
    def of(cls, scene: Scene, torque: Scalar) -> "Equation":
        """The equation, scaled for the scene."""
        pulses = pulses_of(scene, torque)
        scene, start = scene.anchored(), jnp.zeros_like(scene.system.input_speed)
        assert scene.inertia is not None
        contacts = scene.contacts(start)
        arm = contacts.lever[contacts.layout.flanks[0]]
        stiffness = (arm * arm).sum() * scene.linear_compliance.peak_stiffness()
        inertia = scene.inertia.moment(arm)
        frequency = jnp.sqrt(stiffness / inertia)
        (turn,) = depends(lambda time: scene.contacts(scene.system.input_speed * time).lever, start)
        scale, mass = LENGTH_SCALE / jnp.mean(jnp.abs(contacts.lever)), scene.inertia.at_contacts(arm)
        numbers = frequency, scale, inertia, mass, pulses, jnp.mean(arm)
        evenly = scene.system.turns_evenly, _meshes_unevenly(scene)
        return cls(scene, torque, *numbers, turn, *evenly, contacts.layout)

    @property
    def load_varies(self) -> bool:
        """Whether the load, or an impact, changes over time."""
        assert self.scene.load is not None
        return self.pulses is not None or self.scene.load.alternates

    def load_at(self, time: Scalar) -> Scalar:
        """Load torque [N m]."""
        assert self.scene.load is not None
        turns = self.scene.system.input_speed * time / (2 * jnp.pi)
        return self.torque * self.scene.load.shape(turns, time, self.scene.system.orders)

    def accelerating_at(self, time: Scalar) -> Scalar | None:
        """Torque that accelerates the ideal output [N m]; ``None`` if it turns evenly."""
        return None if self.turns_evenly else self.inertia * self.scene.system.output_acceleration(time)

    def torque_at(self, time: Scalar) -> Scalar:
        """Load torque plus the torque that accelerates the ideal output [N m]."""
        accelerating = self.accelerating_at(time)
        return self.load_at(time) if accelerating is None else self.load_at(time) + accelerating

    def load_less_impacts_at(self, time: Scalar) -> Scalar:
        """The load, less what the impacts carry [N m]."""
        if self.pulses is None:
            return self.load_at(time)
        speed = self.scene.system.input_speed
        return self.load_at(time) + self.lever * self.pulses.at(speed * time, speed)

    def acting_at(self, time: Scalar) -> Scalar:
        """The torque that contacts and inertia balance in motion, less what the impacts carry [N m]."""
        load, accelerating = self.load_less_impacts_at(time), self.accelerating_at(time)
        return load if accelerating is None else load + accelerating

    def springs(self, time: Scalar) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        """Levers and stiffness of the contacts at a time [s]."""
        contacts = self._contacts(time)
        assert contacts.linear is not None
        return contacts.lever, contacts.linear

    def instant(self, time: Scalar, moving: bool = False) -> Instant:
        """Pose of the system at a time [s], with its rate if dampers need it or ``moving`` asks for it."""

        def pose(time: Scalar) -> Pose:
            return self.scene.pose(self.scene.system.input_speed * time)

        if self.scene.damping is None and not moving:
            return Instant(time, pose(time), None)
        return Instant(time, *jax.jvp(pose, (time,), (jnp.ones_like(time),)))

    def gaps(self, instant: Instant) -> Gaps:
        """Levers and gaps at an instant."""

        def both(pose: Pose) -> tuple[Array, Array]:
            contacts = self.scene.contacts(pose)
            return contacts.lever, contacts.gap

        if instant.rate is None:
            lever, gap = both(instant.pose)
            return Gaps(lever, gap, None, None)
        (lever, gap), (lever_rate, gap_rate) = jax.jvp(both, (instant.pose,), (instant.rate,))
        return Gaps(lever, gap, lever_rate if self.levers_turn else None, gap_rate)

    def excitation(self, time: Scalar) -> Excitation:
        """Contacts and load at a time [s]."""
        return Excitation(self.gaps(self.instant(time)), self.springs(time)[1], self.acting_at(time))

    def _contacts(self, time: Scalar) -> ContactSet:
        return self.scene.contacts(self.scene.system.input_speed * time, "varying")

    def forces(self, time: Scalar, position: Scalar) -> Float[Array, " contact"]:
        """Elastic force of each contact [N]."""
        now = self.excitation(time)
        return now.stiffness * self.scene.contact.penetration(now.gaps.lever * position - now.gaps.gap)

    def acceleration(self, now: Excitation, position: Scalar, velocity: Scalar) -> Scalar:
        """Acceleration of the output's deviation [rad/s2]."""
        scene, gaps = self.scene, now.gaps
        overlap = gaps.lever * position - gaps.gap
        net = -now.torque - (gaps.lever * now.stiffness * scene.contact.penetration(overlap)).sum()
        if scene.damping is not None and gaps.gap_rate is not None:
            stiffness = scene.linear_compliance.mean_stiffness(self.layout.teeth)
            coefficient = scene.damping.coefficient(stiffness, self.mass)
            speed = gaps.lever * velocity - gaps.gap_rate
            if gaps.lever_rate is not None:
                speed = speed + gaps.lever_rate * position
            drag = self.layout.per_contact(coefficient) * gaps.lever * speed
            if scene.damping.acting == "always":
                net = net - drag[self.layout.flanks[0]].sum()
            else:
                net = net - (self.layout.engaged(scene.contact.closed(overlap)) * drag).sum()
        return net / self.inertia

    def carriers(self, time: Scalar) -> Int[Array, ""]:
        """Number of pairs that could carry the torque at a time [s]."""
        return carriers(self.scene, self.scene.system.input_speed * time, self.torque_at(time))

    def rate(self, now: Excitation, state: Float[Array, "2"]) -> Float[Array, "2"]:
        """Change of the scaled state per scaled time."""
        acceleration = self.acceleration(now, state[0] * self.scale, state[1] * self.scale * self.frequency)
        return jnp.stack([state[1], acceleration / (self.scale * self.frequency**2)])

    def equilibrium(self, lever: Array, gap: Array, stiffness: Array, torque: Scalar) -> Scalar:
        """Position at which the contacts balance a load [rad]; arguments as for `following`."""
        contacts = ContactSet(lever[:, None], gap, LinearSprings(stiffness), self.layout)
        return equilibrium(contacts, -torque, self.scene.contact).position

    def resting(self, time: Scalar, stiffness: Float[Array, " contact"], torque: Scalar) -> Scalar:
        """Position of the static equilibrium at a time [s], with a given stiffness [N/m] and load [N m] [rad]."""
        now = self.scene.contacts(self.scene.system.input_speed * time)
        return self.equilibrium(now.lever, now.gap, stiffness, torque)

    def following(self, now: Gaps, stiffness: Float[Array, " contact"], torque: Scalar) -> Float[Array, "2"]:
        """Scaled position of the static equilibrium, and scaled velocity at which it moves with the gaps.

        Args:
            now: levers and gaps, with their rates.
            stiffness: stiffness of each contact [N/m].
            torque: load torque [N m].
        """
        assert now.gap_rate is not None
        turning = jnp.zeros_like(now.lever) if now.lever_rate is None else now.lever_rate
        position, velocity = jax.jvp(
            lambda lever, gap: self.equilibrium(lever, gap, stiffness, torque),
            (now.lever, now.gap),
            (turning, now.gap_rate),
        )
        return jnp.stack([position, velocity / self.frequency]) / self.scale

    def initial(self, time: Scalar, start: str) -> Float[Array, "2"]:
        """Scaled position and velocity to start from."""
        if start == "zero":
            return jnp.zeros((2,), time.dtype)
        now = self.gaps(self.instant(time, moving=True))
        return self.following(now, self.springs(time)[1], self.torque_at(time))

    def per_step(self, step: Scalar) -> Float[Array, "2"]:
        """Factors from scaled position and scaled velocity to scaled position and its change per step."""
        return jnp.stack([jnp.ones_like(step), self.frequency * step])

    def fastest_rate(self) -> Scalar:
        """Fastest rate of a scene, which a step has to resolve [rad/s].

        It is the largest of these: the highest natural frequency, the decay rate of all dampers together, and the rates
        of the highest harmonic of the stiffness, of the load, of the impacts and of the bodies.
        """
        scene = self.scene
        assert scene.load is not None
        system, orders = scene.system, scene.system.orders
        speed = jnp.abs(system.input_speed)
        rates = [
            self.frequency * (longest_arms(scene) if self.levers_turn else 1.0),
            scene.linear_compliance.harmonics * orders["mesh"] * speed,
            scene.load.rate(speed, orders),
            turning_rate(scene),
        ]
        if self.pulses is not None:
            rates.append(self.pulses.rate())
        if scene.damping is not None:
            stiffness = scene.linear_compliance.mean_stiffness(self.layout.teeth)
            rates.append(scene.damping.coefficient(stiffness, self.mass).sum() / self.mass)
        return jnp.stack([jnp.asarray(rate, scene.dtype) for rate in rates]).max()


def _meshes_unevenly(scene: Scene) -> bool:
    if scene.linear_compliance.harmonics == 0:
        return False

    def rate(angle: Scalar) -> Array:
        return jax.jvp(lambda angle: mesh_angles(scene, angle), (angle,), (jnp.ones_like(angle),))[1]

    return any(depends(rate, jnp.zeros_like(scene.system.input_speed)))


def mesh_angles(scene: Scene, angle: Scalar) -> Float[Array, " pair"]:
    """Mesh phase of each pair at an input angle [rad]."""
    mesh = pose_of(scene.system, angle, Request(scene.backlash is not None, mesh=True)).mesh_angle
    assert mesh is not None  # it was asked for
    return mesh


TURN = 64  # angles of a turn at which levers are looked at


def longest_arms(scene: Scene) -> Scalar:
    """Levers of the driving flanks where they are longest in a turn of the input, over those at its start."""

    def arms(angle: Scalar) -> Scalar:
        return jnp.linalg.norm(scene.contacts(angle).output_levers)

    size = jax.vmap(arms)(jnp.asarray(2 * np.pi * np.arange(TURN) / TURN, scene.dtype))
    return size.max() / size[0]


def turning_rate(scene: Scene) -> Scalar:
    """Angular frequency of the fastest body, which the gaps follow [rad/s]."""
    return jnp.asarray(scene.system.fastest_order, scene.dtype) * jnp.abs(scene.system.input_speed)


def slowest_decay(equation: Equation) -> Scalar:
    """Decay rate of a free motion while one pair is in contact [1/s]; 0 without damping."""
    scene = equation.scene
    if scene.damping is None or scene.inertia is None or scene.compliance is None:
        return jnp.zeros((), scene.dtype)
    mass = equation.mass
    stiffness = scene.linear_compliance.mean_stiffness(equation.layout.teeth)
    decay = 0.5 * scene.damping.coefficient(stiffness, mass).min() / mass
    overdamped = decay > jnp.sqrt(stiffness.min() / mass)
    return jnp.where(overdamped, stiffness.min() / mass / jnp.maximum(2 * decay, 1e-30), decay)
