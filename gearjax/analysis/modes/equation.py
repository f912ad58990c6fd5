"""The equation of motion of bodies on supports, in all their coordinates, and its rates.

    M q'' + C q' + K q + J^T f = Q(t) - M r phi'',     f_i = F_i(penetration(overlap_i), t),  overlap = J(t) q - gap(t)

where F is the force of a linear spring or of a line contact. One damper per pair acts along the flank that touches,
``c overlap'``, or one damper per slice of a contact line, in proportion to the stiffness of the slice. Coordinates are
scaled by `LENGTH_SCALE` on the line of action, time by the highest natural frequency. `gearjax.analysis.equation` is
the special case of one coordinate and of linear springs of pairs of teeth.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve

from gearjax.analysis.equation import LENGTH_SCALE, longest_arms, turning_rate
from gearjax.analysis.meshing_impact import pulses_of
from gearjax.analysis.modes.springs import MeanSprings
from gearjax.analysis.resting import carriers
from gearjax.contact import ContactSet, Layout, LinearSprings, LineSprings, equilibrium
from gearjax.dependence import depends
from gearjax.impact import Pulses
from gearjax.scene import Scene
from gearjax.structure import Structure
from gearjax.typing import Array, Bool, Float, Int, Scalar

OFF = 0.01  # m, gap that is added to slices off the path of contact, so that they touch nothing


class Excitation(NamedTuple):
    """Excitation of the motion at one time: everything in the equation except the coordinates and their rates.

    Args:
        jacobian: Jacobian of the contacts, shape (contact, coordinate) [m/rad, -].
        gap: gaps, shape (contact,) [m].
        jacobian_rate, gap_rate: rates of Jacobian and gaps; ``None`` without dampers.
        springs: springs of the contacts, which do not influence each other.
        torque: load torque [N m].
        struck: force of the impacts [N]; ``None`` without.
    """

    jacobian: Array
    gap: Array
    jacobian_rate: Array | None
    gap_rate: Array | None
    springs: LinearSprings | LineSprings
    torque: Array
    struck: Array | None


class Instant(NamedTuple):
    """What a scene shows at one time, and its rate."""

    now: Excitation
    rate: Excitation


class StructureEquation(eqx.Module):
    """The scaled equation of motion of a scene with supports under one torque.

    Args:
        scene: the scene, `Scene.anchored`.
        torque: size of the load torque [N m].
        structure: masses, supports and shafts.
        jacobian: Jacobian of the contacts at the start, shape (contact, coordinate) [m/rad, -].
        free: number of coordinates that only contacts hold; they come first.
        holds: for each contact the coordinate that it holds, as in a `ContactSet`.
        springs: mean springs of the contacts.
        coefficient: damping coefficient of each pair [N s/m]; for slices one coefficient over stiffness, shape () [s];
            ``None`` without dampers.
        scale: coordinates per scaled coordinate, shape (coordinate,) [rad, m].
        frequency: highest natural frequency with all contacts closed [rad/s]; scales time.
        contact_rate: fastest rate by springs or dampers of the contacts, with supports and shafts left out [rad/s].
        levers_turn: whether the Jacobian changes over time.
        turns_evenly: whether the ideal output turns evenly.
        layout: sides and pairs of the contacts.
        pulses: impacts of the teeth as they come into mesh; ``None`` without.
        along: V, generalised forces per force of the impacts, along the mean direction of the springs, shape
            (coordinate,) [m, -]; ``None`` without impacts.
    """

    scene: Scene
    torque: Scalar
    structure: Structure
    jacobian: Float[Array, "contact coordinate"]
    springs: MeanSprings
    coefficient: Float[Array, "*pair"] | None
    scale: Float[Array, " coordinate"]
    frequency: Scalar
    contact_rate: Scalar
    levers_turn: bool = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)
    turns_evenly: bool = eqx.field(static=True)
    free: int = eqx.field(static=True)
    holds: tuple[int, ...] = eqx.field(static=True)
    pulses: Pulses | None = None
    along: Float[Array, " coordinate"] | None = None

    @classmethod
    def of(cls, scene: Scene, torque: Scalar) -> "StructureEquation":
        """The equation, scaled for the scene."""
        pulses = pulses_of(scene, torque)
        scene, start = scene.anchored(), jnp.zeros_like(scene.system.input_speed)
        assert scene.inertia is not None
        layout, springs = scene.layout, MeanSprings.of(scene, torque)
        contacts = scene.contacts(start, "varying")
        structure, jacobian = scene.structure(contacts), contacts.jacobian
        (turn,) = depends(lambda time: scene.contacts(scene.system.input_speed * time, "varying").jacobian, start)
        coefficient = None
        if scene.damping is not None:
            free = contacts.free  # held coordinates left out, so that stiff supports tend to none
            mass = _at_pairs(jacobian[layout.flanks[0], :free], structure.mass[:free, :free])
            if contacts.free == 1:
                mass = scene.inertia.at_contacts(contacts.output_levers)
            coefficient = springs.damping(scene.damping, mass)
        reach = jnp.abs(jacobian).max(axis=0)
        arms = jnp.where(np.array(scene.moving.coordinates.turns) & (reach > 0), reach, 1.0)
        arms = arms.at[0].set(jnp.mean(jnp.abs(contacts.output_levers)))
        scale = LENGTH_SCALE / arms
        teeth = springs.stiffest(jacobian)
        own = jnp.diagonal(structure.stiffness)  # centrifugal forces of a fast crank may make it negative
        held = structure.stiffness + jnp.diag(jnp.abs(own) - own)
        whole = _fastest(structure.mass, teeth + held)
        contact = _fastest(structure.mass, teeth)
        if coefficient is not None:
            drag = _fastest(structure.mass, springs.dampers(jacobian, coefficient)) ** 2
            contact = jnp.maximum(contact, drag)
        rates = whole, contact, turn
        along = None
        if pulses is not None:
            weights = springs.mean * springs.carries
            along = weights @ jacobian / weights.sum()
        return cls(
            *(scene, torque, structure, jacobian, springs, coefficient, scale, *rates, layout),
            *(scene.system.turns_evenly, contacts.free, contacts.holds, pulses, along),
        )

    @property
    def pushed(self) -> bool:
        """Whether a centrifugal force of a body on a crank acts along a coordinate."""
        orbits, supports = self.scene.system.orbits, self.scene.supports
        return any("x" in support.directions for body, support in supports.items() if body in orbits)

    def torque_at(self, time: Scalar) -> Scalar:
        """Load torque plus the torque that accelerates the ideal output [N m]."""
        assert self.scene.load is not None
        turns = self.scene.system.input_speed * time / (2 * jnp.pi)
        torque = self.torque * self.scene.load.shape(turns, time, self.scene.system.orders)
        if self.turns_evenly:
            return torque
        return torque + self.structure.mass[0, 0] * self.scene.system.output_acceleration(time)

    def struck_at(self, time: Scalar) -> Scalar | None:
        """Force of the impacts at a time [s] [N]; ``None`` without."""
        speed = self.scene.system.input_speed
        return None if self.pulses is None else self.pulses.at(speed * time, speed)

    def excitation(self, time: Scalar) -> Excitation:
        """Contacts and load at a time [s], with the rates that dampers need."""
        loads = self.torque_at(time), self.struck_at(time)
        if self.coefficient is None:
            (jacobian, gap), springs = self._contacts(time)
            return Excitation(jacobian, gap, None, None, springs, *loads)
        along: Any = jax.jvp(self._contacts, (time,), (jnp.ones_like(time),), has_aux=True)
        (jacobian, gap), (jacobian_rate, gap_rate), springs = along
        return Excitation(jacobian, gap, jacobian_rate, gap_rate, springs, *loads)

    def instant(self, time: Scalar) -> Instant:
        """The excitation at a time [s], and how fast it changes."""
        return Instant(*jax.jvp(self.excitation, (time,), (jnp.ones_like(time),)))

    def _contacts(self, time: Scalar) -> tuple[tuple[Array, Array], LinearSprings | LineSprings]:
        """Jacobian and gaps, and the springs, of the contacts."""
        contacts = self.scene.contacts(self.scene.system.input_speed * time, "varying")
        assert isinstance(contacts.springs, LinearSprings | LineSprings)
        return (contacts.jacobian, contacts.gap), contacts.springs

    def pull(self, now: Excitation, place: Array, speed: Array) -> tuple[Array, Array | None]:
        """Elastic forces, shape (contact,), and damper forces, shape (damper,), of the contacts [N].

        Args:
            now: excitation at this time.
            place, speed: coordinates and velocities, shape (coordinate,).
        """
        overlap = now.jacobian @ place - now.gap
        return self.elastic(now, overlap), self.resistance(now.springs, overlap, self.approach(now, place, speed))

    def elastic(self, now: Excitation, overlap: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Elastic force of each contact from its overlap [N]."""
        return now.springs.force(self.scene.contact.penetration(overlap))

    def approach(self, now: Excitation, place: Array, speed: Array) -> Float[Array, " damper"] | None:
        """Rate of overlap of the contacts with dampers [m/s]; ``None`` without dampers."""
        if self.coefficient is None:
            return None
        assert now.jacobian_rate is not None
        assert now.gap_rate is not None
        first = self.springs.damped
        return now.jacobian[first] @ speed + now.jacobian_rate[first] @ place - now.gap_rate[first]

    def resistance(
        self, springs: LinearSprings | LineSprings, overlap: Array, approach: Array | None
    ) -> Float[Array, " damper"] | None:
        """Forces of the dampers [N]; ``None`` without dampers."""
        if approach is None or self.coefficient is None:
            return None
        return self.drag(springs) * self.engaged(overlap) * approach

    def drag(self, springs: LinearSprings | LineSprings) -> Float[Array, " damper"]:
        """Coefficients of the dampers [N s/m]."""
        assert self.coefficient is not None
        if self.springs.sliced:
            return self.springs.per_mesh(self.coefficient) * self.springs.linear(springs)
        return self.layout.per_contact(self.coefficient) if self.springs.all_damped else self.coefficient

    def engaged(self, overlap: Float[Array, " contact"]) -> Float[Array, " damper"]:
        """How far each damper acts, 0 to 1: while its slice or flank is in contact (`Layout.engaged`), or always."""
        assert self.scene.damping is not None
        closed = self.scene.contact.closed(overlap)
        if self.springs.sliced:
            return closed if self.scene.damping.acting == "contact" else self.springs.carries
        if self.scene.damping.acting == "always":
            return jnp.ones((self.layout.teeth,), overlap.dtype)
        return self.layout.engaged(closed)

    def on_coordinates(self, now: Excitation, elastic: Array, damping: Array | None) -> Float[Array, " coordinate"]:
        """Generalised forces of the contacts on the coordinates, ``J^T f`` [N m, N]."""
        pull = now.jacobian.T @ elastic
        if damping is None:
            return pull
        return pull + now.jacobian[self.springs.damped].T @ damping

    def given(self, now: Excitation) -> Float[Array, " coordinate"]:
        """Generalised forces that do not depend on the coordinates: load torque, impacts, centrifugal ones [N m, N]."""
        given = self.structure.push.at[0].add(-now.torque)
        return given if now.struck is None or self.along is None else given - now.struck * self.along

    def acceleration(self, now: Excitation, place: Array, speed: Array) -> Float[Array, " coordinate"]:
        """Acceleration of the coordinates [rad/s2, m/s2]."""
        parts = self.structure
        force = self.given(now) - self.on_coordinates(now, *self.pull(now, place, speed))
        return jnp.linalg.solve(parts.mass, force - parts.stiffness @ place - parts.damping @ speed)

    def rate(self, now: Excitation, state: Float[Array, "2 coordinate"]) -> Float[Array, "2 coordinate"]:
        """Change of the scaled state per scaled time."""
        acceleration = self.acceleration(now, state[0] * self.scale, state[1] * self.scale * self.frequency)
        return jnp.stack([state[1], acceleration / (self.scale * self.frequency**2)])

    def forces(self, time: Scalar, place: Float[Array, " coordinate"]) -> Float[Array, " contact"]:
        """Elastic force of each contact [N]."""
        (jacobian, gap), springs = self._contacts(time)
        return springs.force(self.scene.contact.penetration(jacobian @ place - gap))

    def loaded(self, jacobian: Array, torque: Scalar) -> Bool[Array, " contact"]:
        """Whether each contact can carry a load torque [N m]."""
        supports = None if self.free == jacobian.shape[1] else self.structure.stiffness[self.free :, self.free :]
        none = jnp.zeros(jacobian.shape[0], jacobian.dtype)
        return ContactSet(jacobian, none, None, self.layout, supports, self.holds).loaded(-torque)

    def carriers(self, time: Scalar) -> Int[Array, ""]:
        """Number of pairs that could carry the torque at a time [s]."""
        return carriers(self.scene, self.scene.system.input_speed * time, self.torque_at(time))

    def resting(
        self, jacobian: Array, gap: Array, springs: LinearSprings | LineSprings, torque: Scalar
    ) -> tuple[Float[Array, " coordinate"], Float[Array, " contact"]]:
        """Static equilibrium [rad, m] with centrifugal forces, and the contact forces [N].

        The position is nan if there is no equilibrium.
        """
        free, supports = self.free, None
        pushed = self.structure.push
        if free < len(pushed):
            supports = self.structure.stiffness[free:, free:]
            # at zero torque the first contact just touches, and the rounding of this decides whether its damper acts
            pushed = pushed.at[free:].set(cho_solve(cho_factor(supports, lower=True), pushed[free:]))
        gap = gap - jacobian @ pushed
        if self.springs.sliced:  # off the path of contact a slice touches nothing
            gap = gap + jnp.where(self.springs.linear(springs) > 0, 0.0, OFF)
        contacts = ContactSet(jacobian, gap, springs, self.layout, supports, self.holds)
        rest = equilibrium(contacts, -torque, self.scene.contact)
        moved = jnp.zeros(0, gap.dtype) if rest.moved is None else rest.moved
        place = jnp.concatenate([rest.position[None], moved]) + pushed
        return jnp.where(rest.result == 0, place, jnp.nan), rest.forces

    def initial(self, time: Scalar, start: str) -> Float[Array, "2 coordinate"]:
        """Scaled positions and velocities at the start."""
        return self.starting(self.instant(time), start)

    def starting(self, begin: Instant, start: str) -> Float[Array, "2 coordinate"]:
        """Scaled positions and velocities at the start of a motion, from what the scene shows there."""
        now, rate = begin
        if start == "zero":
            return jnp.zeros((2, len(self.scale)), now.gap.dtype)
        place, speed = jax.jvp(
            lambda jacobian, gap: self.resting(jacobian, gap, now.springs, now.torque)[0],
            (now.jacobian, now.gap),
            (rate.jacobian, rate.gap),
        )
        return jnp.stack([place / self.scale, speed / (self.scale * self.frequency)])

    def fastest_rate(self, modes: bool = False) -> Scalar:
        """Fastest rate that a step has to resolve [rad/s].

        Args:
            modes: whether the steps are of constant modes, which are exact for supports of any stiffness.
        """
        scene, orders = self.scene, self.scene.system.orders
        assert scene.load is not None
        speed = jnp.abs(scene.system.input_speed)
        arms = longest_arms(scene) if self.levers_turn else 1.0
        rates = [
            arms * (self.contact_rate if modes else jnp.maximum(self.contact_rate, self.frequency)),
            self.springs.harmonics * orders["mesh"] * speed,
            scene.load.rate(speed, orders),
            turning_rate(scene),
        ]
        if self.pulses is not None:
            rates.append(self.pulses.rate())
        return jnp.stack([jnp.asarray(rate, scene.dtype) for rate in rates]).max()


def _at_pairs(first: Float[Array, "pair coordinate"], mass: Array) -> Float[Array, " pair"]:
    """Effective mass on the line of action of each pair while the other pairs are open [kg]."""
    return 1 / (first.T * jnp.linalg.solve(mass, first.T)).sum(axis=0)


def _fastest(mass: Array, stiffness: Array) -> Scalar:
    """Highest natural frequency of masses on springs [rad/s]."""
    frozen = jax.lax.stop_gradient((mass, stiffness))
    level = 1 / jnp.sqrt(jnp.diagonal(frozen[0]))
    masses, springs = (level[:, None] * part * level[None, :] for part in frozen)
    factor = jnp.linalg.cholesky(masses)
    half = jax.scipy.linalg.solve_triangular(factor, springs, lower=True)
    turned = jax.scipy.linalg.solve_triangular(factor, half.T, lower=True)
    return jnp.sqrt(jnp.maximum(jnp.linalg.eigvalsh(turned)[-1], 0.0))
