"""Where a motion is after a period: of an output that moves alone, and of bodies on supports, by their own steps.

Both maps take the scaled state at the start of a period, shape (2, coordinate), to that at its end. ``scale`` are the
coordinates [rad, m] and velocities [rad/s, m/s] per scaled ones; ``resting`` is the state at the static equilibrium,
moving as the gaps move it, nan where there is none; ``course`` tells the motion in between.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.analysis import modes
from gearjax.analysis.chebyshev import MOST_NODES
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.equation import Equation
from gearjax.analysis.fast import march
from gearjax.analysis.fast.oscillator import Oscillator
from gearjax.analysis.fast.signals import Forcing
from gearjax.analysis.modes import Steps, StructureEquation
from gearjax.analysis.modes.lines import Driving
from gearjax.analysis.modes.steps import AT_ONCE, divisor
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float, Scalar


class Problem(NamedTuple):
    """What a periodic motion depends on: a scene, the size of its load torque [N m], the period [s]."""

    scene: Scene
    torque: Scalar
    period: Scalar

    @classmethod
    def of(cls, scene: Scene, torque: ArrayLike, period: ArrayLike) -> "Problem":
        """The arguments of a user, checked."""
        require(scene, "dynamic", "compliance", "load", "inertia")
        physics, dtype = scene.physics(*MODELLED), scene.dtype
        return cls(physics, jnp.asarray(torque, dtype), jnp.asarray(period, dtype))


class Course(NamedTuple):
    """A motion over a period.

    Args:
        states: scaled coordinates and velocities at the ends of the steps, the start first, shape
            (step + 1, 2, coordinate).
        highest, lowest: extremes of the scaled output over the steps, shape (n,).
    """

    states: Array
    highest: Array
    lowest: Array


class OfOutput(eqx.Module):
    """By the exponentially fitted scheme; velocities are per step.

    Args:
        forcing: what drives the steps.
        nodes: what changes of it in the period.
        spacing: of the steps.
    """

    forcing: Forcing
    nodes: Any
    spacing: march.Spacing = eqx.field(static=True)

    @classmethod
    def of(cls, problem: Problem, steps: int) -> "OfOutput":
        """Of a period that is cut into some steps."""
        equation, start = Equation.of(problem.scene, problem.torque), jnp.zeros_like(problem.period)
        forcing = Forcing.of(Oscillator(equation, problem.period / steps), start)
        block = march.Block(max(steps // 8, 8), MOST_NODES)
        spacing = march.Spacing(steps + 1, 1, block, march.Signals.TABLE)
        return cls(forcing, march.nodes_of(forcing, start, spacing), spacing)

    @property
    def scale(self) -> Array:
        oscillator = self.forcing.oscillator
        step = oscillator.step
        return (oscillator.equation.scale * jnp.stack([jnp.ones_like(step), 1 / step]))[:, None]

    def resting(self) -> Array:
        oscillator = self.forcing.oscillator
        first = oscillator.equation.initial(jnp.zeros_like(oscillator.step), "equilibrium")
        return (first * oscillator.equation.per_step(oscillator.step))[:, None]

    def end(self, state: Array) -> Array:
        record = self._march(state)
        return jnp.stack([record.positions[-1], record.speeds[-1]])[:, None]

    def course(self, state: Array) -> Course:
        record = self._march(state)
        return Course(jnp.stack([record.positions, record.speeds], axis=1)[:, :, None], record.highest, record.lowest)

    def _march(self, state: Array) -> march.March:
        start = jnp.zeros_like(self.forcing.oscillator.step)
        carry, _ = march.begin(self.forcing, start, self.spacing.signals, state[:, 0])
        return march.march(self.forcing, start, carry, self.spacing, self.nodes)


class OfStructure(eqx.Module):
    """By steps of constant modes.

    Args:
        even: those of a period.
        table: what drives the motion at the end of each.
    """

    even: Steps
    table: Driving

    @classmethod
    def of(cls, problem: Problem, steps: int) -> "OfStructure":
        """Of a period that is cut into some steps."""
        equation = StructureEquation.of(problem.scene, problem.torque)
        even = Steps.of(equation, jnp.zeros_like(problem.period), problem.period / steps)
        ends = jnp.arange(1, steps + 1).astype(even.step.dtype) * even.step
        return cls(even, jax.vmap(even.lines.driving)(ends))

    @property
    def scale(self) -> Array:
        equation = self.even.lines.equation
        return jnp.outer(jnp.stack([jnp.ones_like(self.even.step), equation.frequency]), equation.scale)

    def resting(self) -> Array:
        return self.even.lines.equation.initial(jnp.zeros_like(self.even.step), "equilibrium")

    def end(self, state: Array) -> Array:
        steps = self._steps
        return self._march(state, modes.Spacing(2, steps, divisor(steps, AT_ONCE), None)).states[-1]

    def course(self, state: Array) -> Course:
        return self._march(state, modes.Spacing(self._steps + 1, 1, 1, None))

    @property
    def _steps(self) -> int:
        return jax.tree.leaves(self.table)[0].shape[0]

    def _march(self, state: Array, spacing: modes.Spacing) -> Course:
        place, speed = state * self.scale
        record = modes.march(self.even, place, speed, spacing, self.table)
        output = self.even.lines.equation.scale[0]
        return Course(record.states / self.scale[None], record.highest / output, record.lowest / output)


def return_map(problem: Problem, steps: int) -> OfOutput | OfStructure:
    """The map that suits a scene, worked out once: it is part of a program several times."""
    return (OfOutput if problem.scene.springs_apart else OfStructure).of(problem, steps)


def eigenvalues(matrix: Float[Array, "state state"]) -> Array:
    """Complex, shape (state,). Of two by two matrices in closed form, on any device."""
    if len(matrix) > 2:
        return jnp.linalg.eigvals(matrix)
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    square = half * half - determinant
    real, imaginary = (jnp.sqrt(jnp.maximum(sign * square, 0.0)) for sign in (1.0, -1.0))
    return jax.lax.complex(jnp.stack([half + real, half - real]), jnp.stack([imaginary, -imaginary]))
