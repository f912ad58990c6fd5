"""Fast computation of the dynamic TE: even steps of the exponentially fitted scheme, block by block.

The steps of a block are a scan whose state is only the position and its last change.
"""

import enum
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import chebyshev
from gearjax.analysis.equation import Gaps, Instant
from gearjax.analysis.fast.fitted import advance, change_before, velocity
from gearjax.analysis.fast.oscillator import Fast, Oscillator, Slow
from gearjax.analysis.fast.recurrence import recur
from gearjax.analysis.fast.signals import Basis, Forcing, Given, StepForcing, at_nodes, tabulated, written_out
from gearjax.analysis.metrics import top
from gearjax.typing import Array, Float, Scalar

BLOCKS = (192, 96, 48, 24, 12)  # numbers of steps per block; only a few, so that scenes of other speeds share a program
FEW_NODES = {4: 96, 6: 12}  # small numbers of nodes, each with the fewest steps per block that pay for them
MORE_NODES = 12  # nodes for fast or unknown speeds
UNKNOWN = 0.03  # rad, assumed rotation of the bodies per step if their speeds are traced
LANES = 48  # windows in parallel; with many more, each takes longer


class Block(NamedTuple):
    """Largest number of steps of a block, and number of nodes that cover its slow signals."""

    steps: int
    nodes: int


QUICK = Block(96, 6), 1e-12  # block for speeds that a run finds to be slow, and its accuracy, that of more nodes


class Signals(enum.Enum):
    """How a step gets its excitation.

    Either from a table of its block, or, for windows, by sums over the nodes of its block within the step. For a batch
    of scenes the nodes of such sums are computed block by block.
    """

    TABLE = 0
    SUMS = 1
    BATCH = 2


class Spacing(NamedTuple):
    """Division of a record into even steps.

    Args:
        samples: number of samples.
        each: number of steps between two samples.
        block: division of the steps into blocks.
        signals: how a step gets its excitation.
    """

    samples: int
    each: int
    block: Block
    signals: Signals

    @property
    def pieces(self) -> int:
        """Number of blocks between two samples; 1 if one block is enough."""
        numbers = range(1, self.each + 1)
        return next(n for n in numbers if self.each % n == 0 and self.each // n <= self.block.steps)

    @property
    def rows(self) -> int:
        """Number of samples per block, as many as its steps allow; 1 if there are several blocks between samples.

        The last block is filled about as well as the others.
        """
        most = max(1, self.block.steps // self.each) if self.pieces == 1 else 1
        return math.ceil(self.samples / math.ceil(self.samples / most))

    @property
    def blocks(self) -> int:
        """Number of blocks; the last block may extend beyond the last sample."""
        return math.ceil(self.samples * self.pieces / self.rows)

    @property
    def steps(self) -> int:
        """Number of steps of a block."""
        return self.rows * self.each // self.pieces

    def of_whole_blocks(self) -> "Spacing":
        """The same division with more samples, so that the last block is full."""
        block = self.block._replace(steps=self.steps)
        return self._replace(samples=self.blocks * self.rows // self.pieces, block=block)


def suitable_block(phase: float | None, dtype: Any, batched: bool) -> tuple[Block, Signals]:
    """Block and signals that suit a phase of the bodies per step [rad]; for ``None`` any phase up to `UNKNOWN`."""
    few = {} if phase is None else FEW_NODES
    for nodes, fewest in {**few, MORE_NODES: 1, chebyshev.MOST_NODES: 1}.items():
        longest = chebyshev.reach(nodes, chebyshev.accuracy(dtype)) / max(UNKNOWN if phase is None else phase, 1e-12)
        steps = next((steps for steps in BLOCKS if fewest <= steps <= longest), None)
        if steps is not None:
            break
    else:
        nodes, steps = chebyshev.MOST_NODES, BLOCKS[-1]  # the program reports if this is not enough
    if batched:
        return Block(steps, nodes), Signals.BATCH
    return Block(steps, nodes), Signals.TABLE


class March(NamedTuple):
    """The motion at its samples.

    Args:
        positions: scaled positions, shape (sample,).
        speeds: velocity of the scaled position times step, shape (sample,).
        forces: forces of the contacts, shape (sample, contact) [N].
        highest, lowest: extremes of the scaled position over the steps up to each sample, shape (sample,).
        defect: largest scaled difference of neighbouring windows where they meet; 0 without windows.
    """

    positions: Array
    speeds: Array
    forces: Array
    highest: Array
    lowest: Array
    defect: Scalar


def march(forcing: Forcing, start: Scalar, carry: tuple[Scalar, Scalar], spacing: Spacing, nodes: Any = None) -> March:
    """Compute all steps one after the other.

    Args:
        forcing: signals of the oscillator.
        start: time of the first sample [s].
        carry: scaled position and its last change at the first sample, as from `begin`.
        spacing: spacing of samples and steps.
        nodes: signals at the nodes as from `nodes_of`, if they are known already.
    """
    nodes = nodes_of(forcing, start, spacing) if nodes is None else nodes
    _, measured, _ = run_blocks(forcing, start, carry, spacing, nodes)
    return joined(measured, jnp.zeros((), start.dtype))


def joined(measured: tuple, defect: Scalar) -> March:
    """The samples of a record, from the results at each sample and up to the next sample."""
    x, speeds, forces, highest, lowest = measured
    high, low = (jnp.concatenate([x[:1], part[:-1]]) for part in (highest, lowest))
    return March(x, speeds, forces, high, low, defect)


def nodes_of(forcing: Forcing, start: Scalar, spacing: Spacing) -> Any:
    """The changing slow signals at the nodes of all blocks, or for a batch the instants at the nodes.

    The first axis of each array is the block.
    """
    if spacing.signals is not Signals.BATCH:
        return at_nodes(forcing, start, spacing.steps, spacing.block.nodes, spacing.blocks)
    within = chebyshev.nodes(spacing.steps, spacing.block.nodes)
    places = spacing.steps * np.arange(spacing.blocks)[:, None] + within[None, :]
    times = start + jnp.asarray(places, start.dtype) * forcing.oscillator.step
    return jax.vmap(jax.vmap(forcing.oscillator.equation.instant))(times)


def run_blocks(
    forcing: Forcing, start: Scalar, carry: tuple, spacing: Spacing, nodes: Any
) -> tuple[tuple, tuple, Float[Array, "block step"]]:
    """Compute the steps of all blocks, from position and last change at a time [s].

    Args:
        forcing, start, spacing: as for `march`.
        carry: position and last change.
        nodes: signals at the nodes as from `nodes_of`.

    Returns:
        Position and last change after the last block, which may extend beyond the last sample; the results of
        `measured` at each sample; and the positions at the begin of all steps.
    """
    pieces, steps, blocks = spacing.pieces, spacing.steps, spacing.blocks
    every = spacing.each // pieces
    basis = Basis.of(forcing, steps, spacing.block.nodes)
    origins = start + (steps * jnp.arange(blocks)).astype(start.dtype) * forcing.oscillator.step

    def block(carry: tuple, now: tuple) -> tuple[tuple, tuple]:
        columns, (cosine, sine), origin = now
        if spacing.signals is Signals.BATCH:  # inside the loop, so that constant parts are computed once
            columns = jax.vmap(forcing.columns)(columns)
        waves = forcing.harmonics._replace(cosine=cosine, sine=sine)
        given = Given(columns, waves, forcing.torques(origin, steps + 1))
        rows, step_forcing = (tabulated if spacing.signals is Signals.TABLE else written_out)(forcing, basis, given)
        ended, path = _steps(forcing.oscillator, step_forcing, carry, rows.own)
        return ended, (measured(forcing.oscillator, step_forcing, rows.every, path, every), path[1:-1])

    turned = jax.vmap(lambda time: forcing.turned(time)[1:])(origins)  # without the mean, which is constant
    ended, (parts, path) = jax.lax.scan(block, carry, (nodes, turned, origins))
    return ended, of_samples(parts, spacing), path


def of_samples(parts: tuple, spacing: Spacing) -> tuple:
    """The results of `measured` at each sample, from those of all blocks, whose first axis is the block."""
    x, speeds, forces, *extremes = jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), parts)
    kept = slice(0, spacing.samples * spacing.pieces, spacing.pieces)
    highest, lowest = (part.reshape(-1, spacing.pieces)[: spacing.samples] for part in extremes)
    return x[kept], speeds[kept], forces[kept], top(highest), -top(-lowest)


def begin(
    forcing: Forcing, time: Scalar, signals: Signals, state: Float[Array, "2"] | None = None
) -> tuple[tuple[Scalar, Scalar], Array]:
    """Initial position and change of a motion.

    Args:
        forcing: signals of the oscillator.
        time: time of the start [s].
        signals: how the following steps get their excitation.
        state: scaled position, and its velocity times step; by default those of the equilibrium as it moves with the
            gaps, or zero if there is no equilibrium.

    Returns:
        Scaled position and its last change, and whether there is an equilibrium; true if ``state`` is given.
    """
    oscillator, equation = forcing.oscillator, forcing.oscillator.equation
    times = jnp.stack([time, time + oscillator.step])
    instants = jax.vmap(lambda time: equation.instant(time, moving=True))(times)

    def slow_at(instant: Instant) -> tuple[Gaps, Slow]:
        return equation.gaps(instant), oscillator.slow(instant)

    def fast_at(time: Scalar) -> Fast:
        waves = forcing.turned(time)
        return Fast(waves.mean + waves.cosine.sum(axis=0), equation.load_less_impacts_at(time))

    # in a loop, parts that both times share are computed once, not again for each number that depends on them
    both = jax.lax.map(slow_at, instants) if signals is Signals.BATCH else jax.vmap(slow_at)(instants)
    every = *both, jax.vmap(fast_at)(times)
    (gaps, *now), (_, *later) = (jax.tree.map(lambda leaf, i=i: leaf[i], every) for i in range(2))
    there = jnp.asarray(True)
    if state is None:
        slow, fast = now
        stiffness = equation.layout.per_contact(fast.stiffness)
        state = equation.following(gaps, stiffness, slow.balanced(fast.torque)) * equation.per_step(oscillator.step)
        there, state = jnp.isfinite(state).all(), jnp.nan_to_num(state)
    first, second = (oscillator.state(slow, fast, state[0]) for slow, fast in (now, later))
    return (state[0], change_before(state[1], first, second.push - first.push)), there


def warm_start(forcing: Forcing, time: Scalar, spacing: Spacing, nodes: Any) -> tuple[Scalar, Scalar]:
    """Start of a warm-up: scaled position and change of the quasi-static solution, or zero if there is none.

    Args:
        forcing: signals of the oscillator.
        time: time at which the first block begins [s].
        spacing: spacing of samples and steps.
        nodes: signals at the nodes of the first block.
    """
    basis = Basis.of(forcing, spacing.steps, spacing.block.nodes)
    given = Given(nodes, forcing.turned(time), forcing.torques(time, spacing.steps + 1))
    rows, step_forcing = written_out(forcing, basis, given)
    now, later = jax.vmap(lambda row: forcing.oscillator.resting(*step_forcing(row)))(_rows(rows.every, slice(0, 2)))
    return jnp.nan_to_num(now), jnp.nan_to_num(later - now)


def _rows(table: Any, chosen: slice) -> Any:
    """Some rows of all columns."""
    return jax.tree.map(lambda column: column[chosen], table)


def _steps(oscillator: Oscillator, step_forcing: StepForcing, carry: tuple, rows: Any) -> tuple[tuple, Array]:
    """Compute the steps of a block.

    Args:
        oscillator: the oscillator.
        step_forcing: functions from a row to the excitation of a step.
        carry: position and last change.
        rows: rows of the steps.

    Returns:
        Position and last change after the steps, and the path: the position one step before the block, those at the
        begin of all its steps, and the one after them.
    """

    def step(position: Array, change: Array, numbers: Any) -> Array:
        slow, fast = step_forcing.put(numbers)
        return advance(change, oscillator.state(slow, fast, position))

    ended, path = recur(step, step_forcing.at, step_forcing.table, carry[0], carry[1], rows)
    return ended, jnp.concatenate([(carry[0] - carry[1])[None], path, ended[0][None]])


def measured(oscillator: Oscillator, step_forcing: StepForcing, rows: Any, path: Array, each: int) -> tuple:
    """Positions, speeds and forces at the samples, and highest and lowest position up to the next sample.

    Args:
        oscillator, step_forcing: as for `_steps`.
        rows: rows of the steps and of the first step of the next block.
        path: path of the steps.
        each: number of steps between samples.
    """
    now, following = path[1:-1:each], path[2::each]

    def sample(row: Any, after: Any, x: Array, dx: Array) -> tuple[Array, Array]:
        slow, fast = step_forcing(row)
        state = oscillator.state(slow, fast, x)
        later, sooner = step_forcing(after)
        rise = oscillator.state(later, sooner, x).push - state.push
        return velocity(dx, state, rise), oscillator.forces(slow, fast, x)

    def highest(path: Array) -> Array:
        return jnp.maximum(top(turning(path).reshape(-1, each)), path[1 + each :: each])

    both = _rows(rows, slice(0, -1, each)), _rows(rows, slice(1, None, each))
    speeds, forces = jax.vmap(sample)(*both, now, following - now)
    return now, speeds, forces, highest(path), -highest(-path)


def turning(path: Float[Array, " n"]) -> Float[Array, " m"]:
    """Highest value near each point except the first and the last: the vertex of a parabola at a local maximum."""
    before, now, after = (path[i : path.shape[0] - 2 + i] for i in range(3))
    bend = 2 * now - before - after
    peak = (now >= before) & (now >= after) & (bend > 0)
    rise = 0.125 * (after - before) ** 2 / jnp.where(peak, bend, 1.0)
    return jnp.where(peak, now + rise, now)
