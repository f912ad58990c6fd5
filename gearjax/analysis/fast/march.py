"""The fast path of the dynamic TE: even steps of the exponentially fitted scheme, in one go or in windows of time.

The steps of a block are a scan that holds nothing but the position and its last change. A damped motion forgets its
start, so that a long record can be cut into windows that run side by side, each warmed up from the quasi-static
solution; how far they are apart where they meet is measured.
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

BLOCKS = (192, 96, 48, 24, 12)  # steps of a block: few, so that scenes of other speeds share a program
SUMMED = {4: 96, 6: 12}  # nodes that each step sums over, and the fewest steps of a block that they pay for
MORE_NODES = 12  # of fast or unknown speeds
UNKNOWN = 0.03  # rad per step of the bodies, where their speeds are traced
LANES = 48  # windows side by side; many more take longer for each


class Block(NamedTuple):
    """The most steps of a block, and how many nodes cover its slow signals."""

    steps: int
    nodes: int


QUICK = Block(96, 6), 1e-12  # of speeds that a run sees to be slow; as exact as more nodes


class Signals(enum.Enum):
    """How a step comes by what drives it: from a table, by sums over the nodes of its block within the step, or by such
    sums whose nodes are worked out block by block, for a batch of scenes."""

    TABLE = 0
    SUMS = 1
    BATCH = 2


class Spacing(NamedTuple):
    """Even steps.

    Args:
        samples: number of samples.
        each: steps between two samples.
        block: how the steps are cut.
        signals: how a step comes by what drives it.
    """

    samples: int
    each: int
    block: Block
    signals: Signals

    @property
    def pieces(self) -> int:
        """Blocks between two samples, where one is not enough."""
        numbers = range(1, self.each + 1)
        return next(n for n in numbers if self.each % n == 0 and self.each // n <= self.block.steps)

    @property
    def rows(self) -> int:
        """Samples of a block, or pieces: as many in each as its steps allow, the last block not much emptier."""
        most = max(1, self.block.steps // self.each) if self.pieces == 1 else 1
        return math.ceil(self.samples / math.ceil(self.samples / most))

    @property
    def blocks(self) -> int:
        """Number of blocks, the last of which may reach beyond the last sample."""
        return math.ceil(self.samples * self.pieces / self.rows)

    @property
    def steps(self) -> int:
        """Steps of a block."""
        return self.rows * self.each // self.pieces

    def of_whole_blocks(self) -> "Spacing":
        """The same with more samples, until the last block is full."""
        block = self.block._replace(steps=self.steps)
        return self._replace(samples=self.blocks * self.rows // self.pieces, block=block)


def suitable_block(phase: float | None, dtype: Any, batched: bool) -> tuple[Block, Signals]:
    """How steps are cut and driven, for a phase of the bodies per step [rad], or any up to `UNKNOWN`."""
    few = {} if phase is None else SUMMED
    for nodes, fewest in {**few, MORE_NODES: 1, chebyshev.MOST_NODES: 1}.items():
        longest = chebyshev.reach(nodes, chebyshev.accuracy(dtype)) / max(UNKNOWN if phase is None else phase, 1e-12)
        steps = next((steps for steps in BLOCKS if fewest <= steps <= longest), None)
        if steps is not None:
            break
    else:
        nodes, steps = chebyshev.MOST_NODES, BLOCKS[-1]  # the program says that this is not enough
    if batched:
        return Block(steps, nodes), Signals.BATCH
    return Block(steps, nodes), Signals.SUMS if nodes in SUMMED else Signals.TABLE


class March(NamedTuple):
    """The motion at its samples.

    Args:
        positions: scaled, shape (sample,).
        speeds: velocity times step, shape (sample,).
        forces: shape (sample, contact) [N].
        highest, lowest: extremes of the scaled position over the steps up to each sample, shape (sample,).
        defect: how far neighbouring windows are apart where they meet, scaled; 0 without windows.
    """

    positions: Array
    speeds: Array
    forces: Array
    highest: Array
    lowest: Array
    defect: Scalar


def march(forcing: Forcing, start: Scalar, carry: tuple[Scalar, Scalar], spacing: Spacing, nodes: Any = None) -> March:
    """All steps one after the other.

    Args:
        forcing: of the oscillator.
        start: time of the first sample [s].
        carry: scaled position and its last change there, as by `begin`.
        spacing: of samples and steps.
        nodes: as by `nodes_of`, where they are known.
    """
    nodes = nodes_of(forcing, start, spacing) if nodes is None else nodes
    _, measured = run_blocks(forcing, start, carry, spacing, nodes)
    return _joined(measured, jnp.zeros((), start.dtype))


def _joined(measured: tuple, defect: Scalar) -> March:
    """The samples of a record from what was found at each and up to the next one."""
    x, speeds, forces, highest, lowest = measured
    high, low = (jnp.concatenate([x[:1], part[:-1]]) for part in (highest, lowest))
    return March(x, speeds, forces, high, low, defect)


def nodes_of(forcing: Forcing, start: Scalar, spacing: Spacing) -> Any:
    """What changes of the slow signals at the nodes of blocks, or for a batch the instants there; first axis of each
    array the blocks."""
    if spacing.signals is not Signals.BATCH:
        return at_nodes(forcing, start, spacing.steps, spacing.block.nodes, spacing.blocks)
    within = chebyshev.nodes(spacing.steps, spacing.block.nodes)
    places = spacing.steps * np.arange(spacing.blocks)[:, None] + within[None, :]
    times = start + jnp.asarray(places, start.dtype) * forcing.oscillator.step
    return jax.vmap(jax.vmap(forcing.oscillator.equation.instant))(times)


def run_blocks(forcing: Forcing, start: Scalar, carry: tuple, spacing: Spacing, nodes: Any) -> tuple[tuple, tuple]:
    """The steps of as many samples, from position and last change at a time [s].

    Args:
        forcing, start, spacing: as for `march`.
        carry: position and last change.
        nodes: as by `nodes_of`.

    Returns:
        Position and last change after the last block, which may reach beyond the last sample, and what `_measured`
        found at each sample.
    """
    pieces, steps, blocks = spacing.pieces, spacing.steps, spacing.blocks
    every = spacing.each // pieces
    basis = Basis.of(forcing, steps, spacing.block.nodes)
    origins = start + (steps * jnp.arange(blocks)).astype(start.dtype) * forcing.oscillator.step

    def block(carry: tuple, now: tuple) -> tuple[tuple, tuple]:
        columns, (cosine, sine), origin = now
        if spacing.signals is Signals.BATCH:  # in the loop, so that what is the same for all times is worked out once
            columns = jax.vmap(forcing.columns)(columns)
        waves = forcing.harmonics._replace(cosine=cosine, sine=sine)
        given = Given(columns, waves, forcing.torques(origin, steps + 1))
        rows, step_forcing = (tabulated if spacing.signals is Signals.TABLE else written_out)(forcing, basis, given)
        ended, path = _steps(forcing.oscillator, step_forcing, carry, rows.own)
        return ended, _measured(forcing.oscillator, step_forcing, rows.every, path, every)

    turned = jax.vmap(lambda time: forcing.turned(time)[1:])(origins)  # but the mean, which stays
    ended, measured = jax.lax.scan(block, carry, (nodes, turned, origins))
    x, speeds, forces, *extremes = jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), measured)
    kept = slice(0, spacing.samples * pieces, pieces)
    highest, lowest = (part.reshape(-1, pieces)[: spacing.samples] for part in extremes)
    return ended, (x[kept], speeds[kept], forces[kept], top(highest), -top(-lowest))


def begin(
    forcing: Forcing, time: Scalar, signals: Signals, state: Float[Array, "2"] | None = None
) -> tuple[tuple[Scalar, Scalar], Array]:
    """Where a motion begins.

    Args:
        forcing: of the oscillator.
        time: [s].
        signals: how the steps that follow come by what drives them.
        state: scaled position, and velocity times step; without, those of the equilibrium, moving as the gaps move it,
            or zero where there is none.

    Returns:
        Scaled position and its last change, and whether there is such an equilibrium.
    """
    oscillator, equation = forcing.oscillator, forcing.oscillator.equation
    times = jnp.stack([time, time + oscillator.step])
    instants = jax.vmap(lambda time: equation.instant(time, moving=True))(times)

    def slow_at(instant: Instant) -> tuple[Gaps, Slow]:
        return equation.gaps(instant), oscillator.slow(instant)

    def fast_at(time: Scalar) -> Fast:
        waves = forcing.turned(time)
        return Fast(waves.mean + waves.cosine.sum(axis=0), equation.torque_at(time))

    # in a loop, what both times share is worked out once, not again for every number that it is part of
    both = jax.lax.map(slow_at, instants) if signals is Signals.BATCH else jax.vmap(slow_at)(instants)
    every = *both, jax.vmap(fast_at)(times)
    (gaps, *now), (_, *later) = (jax.tree.map(lambda leaf, i=i: leaf[i], every) for i in range(2))
    there = jnp.asarray(True)
    if state is None:
        _, fast = now
        stiffness = equation.layout.per_contact(fast.stiffness)
        state = equation.following(gaps, stiffness, fast.torque) * equation.per_step(oscillator.step)
        there, state = jnp.isfinite(state).all(), jnp.nan_to_num(state)
    first, second = (oscillator.state(slow, fast, state[0]) for slow, fast in (now, later))
    return (state[0], change_before(state[1], first, second.push - first.push)), there


def warm_start(forcing: Forcing, time: Scalar, spacing: Spacing, nodes: Any) -> tuple[Scalar, Scalar]:
    """Where a warm-up begins: scaled position and change of the quasi-static solution, zero where there is none.

    Args:
        forcing: of the oscillator.
        time: at which the first block begins [s].
        spacing: of samples and steps.
        nodes: of the first block.
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
    """The steps of a block.

    Args:
        oscillator: whose steps they are.
        step_forcing: from a row to what drives a step.
        carry: position and last change.
        rows: of the steps.

    Returns:
        Position and last change after them, and the path: a position before, those of all steps, that after them.
    """

    def step(position: Array, change: Array, numbers: Any) -> Array:
        slow, fast = step_forcing.put(numbers)
        return advance(change, oscillator.state(slow, fast, position))

    ended, path = recur(step, step_forcing.at, step_forcing.table, carry[0], carry[1], rows)
    return ended, jnp.concatenate([(carry[0] - carry[1])[None], path, ended[0][None]])


def _measured(oscillator: Oscillator, step_forcing: StepForcing, rows: Any, path: Array, each: int) -> tuple:
    """Positions, speeds and forces at the samples, and highest and lowest position up to the next sample.

    Args:
        oscillator, step_forcing: as for `_steps`.
        rows: of the steps and the first one of the next block.
        path: of the steps.
        each: steps between samples.
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
    """Highest value near each point but the first and last: the vertex of the parabola where the path turns down."""
    before, now, after = (path[i : path.shape[0] - 2 + i] for i in range(3))
    bend = 2 * now - before - after
    peak = (now >= before) & (now >= after) & (bend > 0)
    rise = 0.125 * (after - before) ** 2 / jnp.where(peak, bend, 1.0)
    return jnp.where(peak, now + rise, now)


class Windows(NamedTuple):
    """How a record is cut.

    Args:
        number: of windows, side by side.
        warm_up: samples before each window that are thrown away.
        block: how the steps of a window are cut.
    """

    number: int
    warm_up: int
    block: Block


def march_windows(
    forcing: Forcing,
    start: Scalar,
    carry: tuple[Scalar, Scalar],
    spacing: Spacing,
    windows: Windows,
) -> March:
    """All windows at once, each lane of a vector one window; many windows in groups of `LANES`.

    Args:
        forcing, start, carry, spacing: as for `march`.
        windows: how the record is cut.
    """
    groups = math.ceil(windows.number / LANES)
    lanes = math.ceil(windows.number / groups)
    samples = math.ceil(spacing.samples / (groups * lanes))
    # whole blocks, so that each window ends where the next one begins, and shares nodes with the one before
    own = spacing._replace(samples=samples, block=windows.block, signals=Signals.SUMS).of_whole_blocks()
    warm = own._replace(samples=own.rows * math.ceil(windows.warm_up / own.rows))
    whole = own._replace(samples=warm.samples + groups * lanes * own.samples)
    spaced = forcing.oscillator.step * spacing.each
    nodes = nodes_of(forcing, start - warm.samples * spaced, whole)

    def window(number: Array) -> tuple:
        begun = start + (number * own.samples).astype(start.dtype) * spaced
        early = begun - warm.samples * spaced
        here = jax.lax.dynamic_slice_in_dim(nodes, number * own.blocks, warm.blocks + own.blocks)
        warmed, _ = run_blocks(forcing, early, warm_start(forcing, early, warm, here[0]), warm, here[: warm.blocks])
        own_start = tuple(jnp.where(number == 0, one, other) for one, other in zip(carry, warmed, strict=True))
        return own_start, *run_blocks(forcing, begun, own_start, own, here[warm.blocks :])

    numbers = jnp.arange(groups * lanes).reshape(groups, lanes)
    begun, ended, measured = jax.tree.map(
        lambda part: part.reshape(groups * lanes, *part.shape[2:]), jax.lax.map(jax.vmap(window), numbers)
    )
    apart, faster = (jnp.abs(end[:-1] - own[1:]).max() for end, own in zip(ended, begun, strict=True))
    defect = jnp.maximum(apart, faster / (forcing.oscillator.step * forcing.oscillator.equation.frequency))
    measured = (part.reshape(-1, *part.shape[2:])[: spacing.samples] for part in measured)
    return _joined(tuple(measured), defect)
