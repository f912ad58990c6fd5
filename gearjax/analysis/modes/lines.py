"""Lines: the displacements through which contacts act on a structure of bodies on supports.

A line is a row of L: ``s = L q`` is its displacement, u its input force, and G takes the inputs to the coordinates. If
the levers are constant and the contacts not more than the coordinates, each contact is a line, and G has further
columns for the load torque, for centrifugal forces and for impacts. Otherwise L is the identity, and u are generalised
forces. A sight is the vector on which the inputs depend: s, and rates of s if needed. Letters are those of
`gearjax.analysis.modes.steps`.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from gearjax.analysis.modes.equation import Excitation, StructureEquation
from gearjax.contact import LinearSprings, LineSprings
from gearjax.typing import Array, Bool, Float, Scalar


class Driving(NamedTuple):
    """Excitation at the end of a step. Contacts are the last axis, so that sums over coordinates add vectors.

    Args:
        lever: J, shape (coordinate, contact) [m/rad, -]; ``None`` if lines are contacts.
        gap: gaps, shape (contact,) [m].
        lever_rate: rate of J for contacts with dampers, shape (coordinate, damper) [m/rad s, 1/s]; ``None`` if
            ``lever`` is ``None``, or without dampers.
        gap_rate: rate of the gaps of contacts with dampers, shape (damper,) [m/s]; ``None`` without dampers.
        springs: springs of the contacts.
        torque: load torque [N m].
        struck: force of the impacts [N]; ``None`` without.
    """

    lever: Array | None
    gap: Array
    lever_rate: Array | None
    gap_rate: Array | None
    springs: LinearSprings | LineSprings
    torque: Array
    struck: Array | None


class Lines(eqx.Module):
    """The lines of a scene, and the mean springs and dampers along them.

    Args:
        equation: equation of motion.
        seen: L, shape (line, coordinate).
        acting: G, shape (coordinate, input): columns of the lines, then those of the known inputs.
        stiffness: mean springs that are counted with the structure, shape (line, line) [N/m].
        damping: dampers that are counted with the structure, shape (line, line) [N s/m]; ``None`` without.
        apart: whether lines are contacts.
    """

    equation: StructureEquation
    seen: Float[Array, "line coordinate"]
    acting: Float[Array, "coordinate input"]
    stiffness: Float[Array, "line line"]
    damping: Float[Array, "line line"] | None
    apart: bool = eqx.field(static=True)

    @classmethod
    def of(cls, equation: StructureEquation, now: Excitation) -> "Lines":
        """Lines that suit a scene, with mean springs of contacts on the side that the torque loads.

        If the levers of contacts decide their sides, only those are counted that carry at the start.

        Args:
            equation: equation of motion.
            now: excitation at the start.
        """
        layout, springs = equation.layout, equation.springs
        jacobian, coefficient = now.jacobian, equation.coefficient
        contacts, coordinates = jacobian.shape
        apart = not equation.levers_turn and contacts <= coordinates and not springs.sliced
        unit, damping = jnp.eye(coordinates, dtype=jacobian.dtype), None
        if springs.matrices is not None:
            held = springs.matrices.sum(axis=0)
            damping = None if coefficient is None else jnp.tensordot(coefficient, springs.matrices, 1)
            return cls(equation, unit, unit, held, damping, apart)
        if layout.sides_turn:
            carries = equation.resting(jacobian, now.gap, now.springs, now.torque)[1] > 0
        else:
            carries = equation.loaded(jacobian, now.torque)
        held, first = jnp.where(carries, springs.mean, 0.0), layout.flanks[0]
        if not apart:
            if coefficient is not None:
                acts = jnp.where(carries[first], coefficient, 0.0) if layout.sides_turn else coefficient
                damping = jacobian[first].T @ (acts[:, None] * jacobian[first])
            return cls(equation, unit, unit, jacobian.T @ (held[:, None] * jacobian), damping, apart)
        columns = [jacobian.T, jnp.zeros((coordinates, 1), jacobian.dtype).at[0].set(-1.0)]
        if equation.pushed:
            columns.append(equation.structure.push[:, None])
        if equation.along is not None:
            columns.append(-equation.along[:, None])
        if coefficient is not None:
            damping = jnp.diag(layout.on_first(coefficient))
        return cls(equation, jacobian, jnp.concatenate(columns, axis=1), jnp.diag(held), damping, apart)

    @property
    def whole(self) -> tuple[Float[Array, "coordinate coordinate"], Float[Array, "coordinate coordinate"]]:
        """Stiffness and damping of the structure, including mean springs and dampers of the contacts [N/m, N s/m]."""
        parts, seen = self.equation.structure, self.seen
        stiffness = parts.stiffness + seen.T @ self.stiffness @ seen
        return stiffness, parts.damping if self.damping is None else parts.damping + seen.T @ self.damping @ seen

    @property
    def hears_speed(self) -> bool:
        """Whether inputs depend on velocities: if dampers act only in contact, or if lines are not contacts."""
        damping = self.equation.scene.damping
        return damping is not None and (damping.acting == "contact" or not self.apart)

    def sights(self, place: Float[Array, "coordinate *any"], speed: Float[Array, "coordinate *any"]) -> Array:
        """The sight: s, and with `hears_speed` its rate. If lines are contacts, only rates at dampers are included.

        Args:
            place, speed: coordinates and velocities, or both per number of a state.
        """
        if not self.hears_speed:
            return self.seen @ place
        heard = self.seen[self.equation.springs.damped] if self.apart else self.seen
        return jnp.concatenate([self.seen @ place, heard @ speed])

    def sight(self, seen: Float[Array, " line"], rate: Float[Array, " line"]) -> Array:
        """The sight, from s and its rate at all lines."""
        if not self.hears_speed:
            return seen
        return jnp.concatenate([seen, rate[self.equation.springs.damped] if self.apart else rate])

    def driving(self, time: Scalar) -> Driving:
        """Excitation of the steps at a time [s], without the parts that are constant."""
        return self.driven(self.equation.excitation(time))

    def driven(self, now: Excitation) -> Driving:
        """The same, from the excitation of the scene."""
        first = self.equation.springs.damped
        heard = None if now.gap_rate is None else now.gap_rate[first]
        if self.apart:
            return Driving(None, now.gap, None, heard, now.springs, now.torque, now.struck)
        rate = None if now.jacobian_rate is None else now.jacobian_rate[first].T
        return Driving(now.jacobian.T, now.gap, rate, heard, now.springs, now.torque, now.struck)

    def overlap(self, now: Driving, sight: Array) -> Float[Array, " contact"]:
        """Overlap of the contacts [m]."""
        seen = sight[: len(self.seen)]
        return (seen if now.lever is None else total(now.lever, seen)) - now.gap

    def approach(self, now: Driving, sight: Array) -> Float[Array, " damper"] | None:
        """Rate of overlap at the dampers [m/s].

        Without `hears_speed` only the part of the gaps, because the structure contains the other part.
        """
        if now.gap_rate is None:
            return None
        if not self.hears_speed:
            return -now.gap_rate
        seen, heard = sight[: len(self.seen)], sight[len(self.seen) :]
        if now.lever is None:
            return heard - now.gap_rate
        assert now.lever_rate is not None
        return total(now.lever[:, self.equation.springs.damped], heard) + total(now.lever_rate, seen) - now.gap_rate

    def known(self, now: Driving) -> Float[Array, " known"]:
        """Inputs that do not depend on the motion, if lines are contacts: load torque, centrifugal forces, impacts."""
        if not self.apart:
            return jnp.zeros((0,), now.torque.dtype)
        pushed = (jnp.ones_like(now.torque),) if self.equation.pushed else ()
        return jnp.stack([now.torque, *pushed, *(() if now.struck is None else (now.struck,))])

    def inputs(
        self, now: Driving, sight: Array, carries: Bool[Array, " contact"] | None = None
    ) -> Float[Array, " line"]:
        """The inputs u of the lines [N, N m].

        Args:
            now: excitation at this time.
            sight: a vector as from `sights`.
            carries: contacts that carry, whatever their overlap is, by linear springs; ``None`` for those that touch.
        """
        equation, seen = self.equation, sight[: len(self.seen)]
        overlap = self.overlap(now, sight)
        if carries is None:
            force = now.springs.force(equation.scene.contact.penetration(overlap))
        else:
            force = jnp.where(carries, equation.springs.linear(now.springs) * overlap, 0.0)
            overlap = jnp.where(carries, jnp.inf, -jnp.inf).astype(overlap.dtype)
        damping = equation.resistance(now.springs, overlap, self.approach(now, sight))
        if damping is not None:
            force = force + equation.springs.at_contacts(damping)
        kept = self._of_mean(self.stiffness, seen)
        if self.hears_speed and self.damping is not None:
            heard = sight[len(self.seen) :]
            kept = kept + self._of_mean(self.damping, equation.springs.at_contacts(heard) if self.apart else heard)
        if now.lever is None:
            return kept - force
        first = jnp.zeros_like(seen).at[0].set(1.0)
        if now.struck is not None and equation.along is not None:
            kept = kept - now.struck * equation.along
        return kept + equation.structure.push - now.torque * first - now.lever @ force

    def _of_mean(self, mean: Array, seen: Array) -> Array:
        """Forces of mean springs or dampers; if lines are contacts, their matrix is diagonal."""
        return jnp.diagonal(mean) * seen if self.apart else total(mean, seen)

    def missed(self, now: Driving, before: Array, sight: Array) -> Float[Array, " line"]:
        """Correction of the inputs for contacts that open or close within the step [N, N m].

        The parabola through the inputs misses the kink or jump of such a contact.

        Args:
            now: excitation at the end of the step.
            before: overlap at the start of the step, shape (contact,) [m].
            sight: sight at the end of the step.
        """
        equation, overlap = self.equation, self.overlap(now, sight)
        crossed = (before > 0) != (overlap > 0)
        size = jnp.abs(overlap - before)
        share = jnp.where(crossed, jnp.abs(before) / jnp.where(crossed, size, 1.0), 1.0)
        # the mean stiffness would take a third less time with line contacts, but lose the third order
        stiffness = now.springs.secant(jnp.maximum(before, overlap))
        kink = jnp.where(crossed, -stiffness * size * (1 / 12 - 0.5 * share * (1 - share)), 0.0)
        if equation.scene.damping is not None and equation.scene.damping.acting == "contact":
            turn = equation.engaged(before) - equation.engaged(overlap)
            approach = self.approach(now, sight)
            assert approach is not None
            push = equation.drag(now.springs) * turn * approach * (0.5 - equation.springs.earliest(share))
            kink = kink + equation.springs.at_contacts(push)
        return kink if now.lever is None else now.lever @ kink


def total(columns: Float[Array, "column ..."], numbers: Float[Array, "column ..."]) -> Float[Array, "..."]:
    """A matrix product written out as a sum of vectors, so that XLA fuses it with the operations around it."""
    product = columns[0] * numbers[0]
    for column in range(1, len(columns)):
        product = product + columns[column] * numbers[column]
    return product
