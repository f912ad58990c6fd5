"""What the contacts of bodies on supports see of their structure, and what they put into it: lines.

L has a row per contact where the levers of few contacts stand still (G then has one more column for the load torque),
else it is the identity and u holds generalised forces. Letters are those of `gearjax.analysis.modes.steps`.
"""

import equinox as eqx
import jax.numpy as jnp

from gearjax.analysis.modes.equation import Excitation, StructureEquation
from gearjax.typing import Array, Float, Scalar


class Lines(eqx.Module):
    """What the contacts see of the structure, and where their forces act.

    Args:
        equation: of motion.
        seen: L, shape (line, coordinate).
        acting: G, shape (coordinate, input): of the lines, then of what is known before.
        stiffness: mean springs that count with the structure, shape (line, line) [N/m].
        damping: the same of dampers [N s/m]; ``None`` without.
        apart: whether lines are contacts.
    """

    equation: StructureEquation
    seen: Float[Array, "line coordinate"]
    acting: Float[Array, "coordinate input"]
    stiffness: Float[Array, "line line"]
    damping: Float[Array, "line line"] | None
    apart: bool = eqx.field(static=True)

    @classmethod
    def of(cls, equation: StructureEquation, start: Scalar) -> "Lines":
        """Lines that suit a scene, with the springs that carry at the start."""
        now, first = equation.excitation(start), equation.layout.flanks[0]
        jacobian, coefficient = now.jacobian, equation.coefficient
        contacts, coordinates = jacobian.shape
        apart = not equation.levers_turn and contacts <= coordinates
        mean = equation.layout.per_contact(equation.scene.linear_compliance.mean_stiffness(equation.layout.teeth))
        if equation.layout.sides_turn:
            carries = equation.resting(jacobian, now.gap, now.stiffness, now.load)[1] > 0
        else:
            carries = equation.loaded(jacobian, now.load)
        held = jnp.where(carries, mean, 0.0)
        if not apart:
            unit, damping = jnp.eye(coordinates, dtype=jacobian.dtype), None
            if coefficient is not None:
                acts = jnp.where(carries[first], coefficient, 0.0) if equation.layout.sides_turn else coefficient
                damping = jacobian[first].T @ (acts[:, None] * jacobian[first])
            return cls(equation, unit, unit, jacobian.T @ (held[:, None] * jacobian), damping, apart)
        columns = [jacobian.T, jnp.zeros((coordinates, 1), jacobian.dtype).at[0].set(-1.0)]
        if equation.pushed:
            columns.append(equation.structure.push[:, None])
        damping = None
        if coefficient is not None:
            damping = jnp.diag(equation.layout.on_first(coefficient))
        return cls(equation, jacobian, jnp.concatenate(columns, axis=1), jnp.diag(held), damping, apart)

    @property
    def whole(self) -> tuple[Float[Array, "coordinate coordinate"], Float[Array, "coordinate coordinate"]]:
        """Stiffness and damping of the structure with what counts with it of the contacts [N/m, N s/m]."""
        parts, seen = self.equation.structure, self.seen
        stiffness = parts.stiffness + seen.T @ self.stiffness @ seen
        return stiffness, parts.damping if self.damping is None else parts.damping + seen.T @ self.damping @ seen

    @property
    def hears_speed(self) -> bool:
        """Whether inputs depend on velocities: where dampers come and go, or their levers turn."""
        damping = self.equation.scene.damping
        return damping is not None and (damping.acting == "contact" or not self.apart)

    def overlap(self, now: Excitation, seen: Array) -> Float[Array, " contact"]:
        """Overlap of the contacts [m]."""
        return (seen if self.apart else now.jacobian @ seen) - now.gap

    def approach(self, now: Excitation, seen: Array, speed: Array | None) -> Float[Array, " pair"] | None:
        """Rate of overlap along the dampers [m/s]; where they always act, without the part of the moving structure."""
        if self.equation.coefficient is None:
            return None
        assert now.gap_rate is not None
        if not self.apart:
            assert speed is not None
            return self.equation.approach(now, seen, speed)
        first = self.equation.layout.flanks[0]
        return -now.gap_rate[first] if speed is None else speed[first] - now.gap_rate[first]

    def known(self, now: Excitation) -> Float[Array, " known"]:
        """Inputs that do not depend on the motion, where lines are contacts: load torque and centrifugal forces."""
        if not self.apart:
            return jnp.zeros((0,), now.load.dtype)
        return jnp.stack([now.load, jnp.ones_like(now.load)]) if self.equation.pushed else now.load[None]

    def inputs(self, now: Excitation, seen: Array, speed: Array | None) -> Float[Array, " line"]:
        """The inputs u of the lines [N, N m].

        Args:
            now: what drives the motion.
            seen, speed: s and its rate, shape (line,); the rate only where `hears_speed`.
        """
        equation = self.equation
        overlap = self.overlap(now, seen)
        elastic, damping = equation.elastic(now, overlap), self.approach(now, seen, speed)
        damping = equation.resistance(overlap, damping)
        kept = times(self.stiffness, seen)
        if speed is not None and self.damping is not None:
            kept = kept + times(self.damping, speed)
        if not self.apart:
            return kept + equation.given(now) - equation.on_coordinates(now, elastic, damping)
        return kept - elastic if damping is None else kept - elastic - equation.layout.on_first(damping)

    def missed(self, now: Excitation, before: Array, seen: Array, speed: Array | None) -> Float[Array, " line"]:
        """What the parabola misses where contacts open or close within the step [N, N m].

        Args:
            now: what drives the motion at the end of the step.
            before: overlap at its beginning, shape (contact,) [m].
            seen, speed: at its end.
        """
        equation, overlap = self.equation, self.overlap(now, seen)
        crossed = (before > 0) != (overlap > 0)
        size = jnp.abs(overlap - before)
        share = jnp.where(crossed, jnp.abs(before) / jnp.where(crossed, size, 1.0), 1.0)
        kink = jnp.where(crossed, -now.stiffness * size * (1 / 12 - 0.5 * share * (1 - share)), 0.0)
        jump = None
        if equation.scene.damping is not None and equation.scene.damping.acting == "contact":
            turn = equation.engaged(before) - equation.engaged(overlap)
            when = jnp.stack([share[flank] for flank in equation.layout.flanks]).min(axis=0)
            approach = self.approach(now, seen, speed)
            assert approach is not None
            assert equation.coefficient is not None
            jump = equation.coefficient * turn * approach * (0.5 - when)
        if not self.apart:
            return equation.on_coordinates(now, kink, jump)
        return kink if jump is None else kink + equation.layout.on_first(jump)


def times(matrix: Float[Array, "... row column"], vector: Float[Array, " column"]) -> Float[Array, "... row"]:
    """A product that fuses with what is around it: within a loop, XLA would call a routine for each small one."""
    return (matrix * jnp.broadcast_to(vector, matrix.shape)).sum(axis=-1)
