"""Return maps (Poincare maps) over one period: by the fitted scheme for an output alone, otherwise by constant modes.

Both maps take the scaled state at the start of a period, shape (2, coordinate), to the state at its end. ``scale`` are
the coordinates [rad, m] and velocities [rad/s, m/s] per scaled one. ``resting`` is the state of the static equilibrium,
with the velocity at which it moves with the gaps, or nan if there is none. ``course`` is the motion over the period.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import modes
from gearjax.analysis.chebyshev import MOST_NODES
from gearjax.analysis.choice import MODELLED, by_constant_modes
from gearjax.analysis.equation import Equation
from gearjax.analysis.fast import march
from gearjax.analysis.fast.oscillator import Oscillator
from gearjax.analysis.fast.signals import Forcing
from gearjax.analysis.modes import Steps, StructureEquation
from gearjax.analysis.modes.lines import Driving
from gearjax.analysis.modes.recurrence import Begun, returned
from gearjax.analysis.modes.steps import AT_ONCE, divisor
from gearjax.analysis.period import check_repeats
from gearjax.analysis.solvers import LONGEST_STEP
from gearjax.checks import SceneError, is_concrete
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float, Scalar

MOST_TURN = 2.0  # rad of the fastest motion in a step of the fitted scheme: error 2e-3 of the swing in closed contact


class Problem(NamedTuple):
    """Data of a periodic motion: a scene, the size of its load torque [N m], the period [s]."""

    scene: Scene
    torque: Scalar
    period: Scalar

    @classmethod
    def of(cls, scene: Scene, torque: ArrayLike, period: ArrayLike) -> "Problem":
        """The problem, from checked arguments of a user."""
        require(scene, "dynamic", "compliance", "load", "inertia")
        physics, dtype = scene.precomputed(*MODELLED), scene.dtype
        if is_concrete((scene.system.input_speed, period)):
            check_repeats(scene, float(scene.system.input_speed) * float(np.asarray(period)))
        return cls(physics, jnp.asarray(torque, dtype), jnp.asarray(period, dtype))


class Course(NamedTuple):
    """A motion over a period.

    Args:
        states: scaled coordinates and velocities at the start and at the end of each step, shape
            (step + 1, 2, coordinate).
        highest, lowest: extremes of the scaled output over the steps, shape (n,).
    """

    states: Array
    highest: Array
    lowest: Array


class OfOutput(eqx.Module):
    """Return map of an output that moves alone, by the exponentially fitted scheme; velocities are per step.

    Args:
        forcing: signals that drive the steps.
        nodes: values of the slow signals at the nodes of the period.
        spacing: spacing of the steps.
    """

    forcing: Forcing
    nodes: Any
    spacing: march.Spacing = eqx.field(static=True)

    @classmethod
    def of(cls, problem: Problem, steps: int) -> "OfOutput":
        """The map over a period with a number of steps."""
        equation, start = Equation.of(problem.scene, problem.torque), jnp.zeros_like(problem.period)
        forcing = Forcing.of(Oscillator(equation, problem.period / steps), start)
        block = march.Block(max(steps // 8, 8), MOST_NODES)
        spacing = march.Spacing(steps + 1, 1, block, march.Signals.TABLE)
        return cls(forcing, march.nodes_of(forcing, start, spacing), spacing)

    @property
    def resolved(self) -> Array:
        """Whether the steps are short enough; with longer ones the scheme loses accuracy, and then stability."""
        oscillator = self.forcing.oscillator
        return oscillator.step * oscillator.equation.fastest_rate() <= MOST_TURN

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

    def end_and_slope(self, flat: Array) -> tuple[Array, Array]:
        """State at the end of the period and its slope, from the state at its start; states of shape (number,)."""
        return _with_slope(self, flat)

    def course(self, state: Array) -> Course:
        record = self._march(state)
        return Course(jnp.stack([record.positions, record.speeds], axis=1)[:, :, None], record.highest, record.lowest)

    def _march(self, state: Array) -> march.March:
        start = jnp.zeros_like(self.forcing.oscillator.step)
        carry, _ = march.begin(self.forcing, start, self.spacing.signals, state[:, 0])
        return march.march(self.forcing, start, carry, self.spacing, self.nodes)


class OfStructure(eqx.Module):
    """Return map by steps of constant modes: of bodies on supports, and of scenes that such steps suit better.

    Args:
        even: steps of a period.
        table: excitation at the end of each step.
    """

    even: Steps
    table: Driving

    @classmethod
    def of(cls, problem: Problem, steps: int) -> "OfStructure":
        """The map over a period with a number of steps."""
        equation = StructureEquation.of(problem.scene, problem.torque)
        even = Steps.of(equation, jnp.zeros_like(problem.period), problem.period / steps)
        ends = jnp.arange(1, steps + 1).astype(even.step.dtype) * even.step
        return cls(even, jax.vmap(even.lines.driving)(ends))

    @property
    def resolved(self) -> Array:
        """True: steps of any length are stable."""
        return jnp.asarray(True)

    @property
    def scale(self) -> Array:
        equation = self.even.lines.equation
        return jnp.outer(jnp.stack([jnp.ones_like(self.even.step), equation.frequency]), equation.scale)

    def resting(self) -> Array:
        return self.even.initial("equilibrium")

    def end(self, state: Array) -> Array:
        steps = self._steps
        return self._march(state, modes.Spacing(2, steps, divisor(steps, AT_ONCE), None)).states[-1]

    def end_and_slope(self, flat: Array) -> tuple[Array, Array]:
        """As for an output that moves alone."""
        even, scale = self.even, self.scale
        if not even.lines.apart:
            return _with_slope(self, flat)

        def start(flat: Array) -> Begun:
            place, speed = flat.reshape(scale.shape) * scale
            return even.start(place, speed)

        end, slope = returned(even.lines, even.products, start, flat, self.table)
        # coordinates and velocities are linear in the state of the steps
        columns = jnp.concatenate([end[:, None], slope], axis=1)
        columns = (jax.vmap(even.coordinates, 1, 2)(columns) / scale[:, :, None]).reshape(len(flat), -1)
        return columns[:, 0], columns[:, 1:]

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


def _with_slope(motion: OfOutput | OfStructure, flat: Array) -> tuple[Array, Array]:
    """Flat state at the end of a period and its slope, by forward mode."""

    def end(flat: Array) -> tuple[Array, Array]:
        ended = motion.end(flat.reshape(2, -1)).ravel()
        return ended, ended

    slope, ended = jax.jacfwd(end, has_aux=True)(flat)
    return ended, slope


def return_map(problem: Problem, steps: int) -> OfOutput | OfStructure:
    """The map that suits a scene; its tables are computed once, although a program uses the map several times."""
    return (OfOutput if _by_fitted_scheme(problem.scene) else OfStructure).of(problem, steps)


def _by_fitted_scheme(scene: Scene) -> bool:
    return scene.springs_apart and not by_constant_modes(scene)


def turned(problem: Problem) -> Scalar:
    """Angle by which the fastest motion turns in a period [rad]; zero where steps of any length are stable."""
    if not _by_fitted_scheme(problem.scene):
        return jnp.zeros_like(problem.period)
    return problem.period * Equation.of(problem.scene, problem.torque).fastest_rate()


def check_steps(steps: int, turn: float, where: str = "") -> None:
    """Refuse too few steps per period.

    Args:
        steps: number of steps per period.
        turn: angle by which the fastest motion turns in a period, as from `turned` [rad].
        where: words on the motion, such as its input speed.

    Raises:
        SceneError: the fastest motion would turn by more than `MOST_TURN` in a step.
    """
    if turn > steps * MOST_TURN:
        enough = 8 * math.ceil(turn / LONGEST_STEP / 8)
        words = f"too few per period{where}: the fastest motion turns by {turn / steps:.3g} rad in a step"
        raise SceneError(f"steps = {steps}: {words}, more than {MOST_TURN:g}: give steps={enough}")


def eigenvalues(matrix: Float[Array, "state state"]) -> Array:
    """Complex eigenvalues, shape (state,); those of a 2 x 2 matrix in closed form, which works on any device."""
    if len(matrix) > 2:
        return jnp.linalg.eigvals(matrix)
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    square = half * half - determinant
    real, imaginary = (jnp.sqrt(jnp.maximum(sign * square, 0.0)) for sign in (1.0, -1.0))
    return jax.lax.complex(jnp.stack([half + real, half - real]), jnp.stack([imaginary, -imaginary]))
