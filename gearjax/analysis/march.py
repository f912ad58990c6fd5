"""The fast path of the dynamic TE: even steps of the exponentially fitted scheme, in one go or in windows of time.

What drives the motion is tabulated block by block; the scan over the steps of a block holds nothing but the position
and its last change. A damped motion forgets its start, so that a long record can be cut into windows that run side by
side, each warmed up from the quasi-static solution; how far they are apart where they meet is measured.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from gearjax.analysis.fitted import State, advance, change_before, velocity
from gearjax.analysis.oscillator import Fast, Harmonics, Oscillator, Slow, mesh_phases, mesh_rate
from gearjax.analysis.recurrence import recur
from gearjax.analysis.tables import depends, interpolation
from gearjax.typing import Array, ArrayLike, Float, Scalar

LONGEST_BLOCK, SHORTEST_BLOCK = 384, 8  # steps of a block of the march in one go
LANES = 16  # windows side by side; more take longer for each


class Block(NamedTuple):
    """The most steps of a block, and how many nodes cover its slow signals."""

    steps: int
    nodes: int


class Spacing(NamedTuple):
    """Even steps: number of samples, steps between two samples, and how they are tabulated."""

    samples: int
    each: int
    block: Block


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


class Drive(eqx.Module):
    """The signals that drive an oscillator.

    Args:
        oscillator: what is driven.
        harmonics: of its stiffness.
        changing: which leaves of its slow signals change over time.
    """

    oscillator: Oscillator
    harmonics: Harmonics
    changing: tuple[bool, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, oscillator: Oscillator, time: Scalar) -> "Drive":
        """The signals of an oscillator; the time [s] is that of any sample."""
        return cls(oscillator, Harmonics.of(oscillator.equation), tuple(depends(oscillator.slow, time)))

    def nodes(self, start: Scalar, places: ArrayLike) -> Float[Array, "node column"]:
        """What changes of the slow signals, at places counted in steps from a time [s]."""

        def moving(place: Scalar) -> Float[Array, " column"]:
            parts = self._changing(self.oscillator.slow(start + place * self.oscillator.step))
            return jnp.concatenate([jnp.zeros((0,), start.dtype), *(part.ravel() for part in parts)])

        return jax.vmap(moving)(jnp.asarray(places, start.dtype))

    def _changing(self, slow: Slow) -> list[Array]:
        return [leaf for leaf, new in zip(jax.tree.leaves(slow), self.changing, strict=True) if new]

    def slow(self, time: Scalar) -> Callable[[Array], Slow]:
        """From what changes, shape (column,), to the slow signals; the others are those of a time [s]."""
        held = self.oscillator.slow(time)
        leaves, tree = jax.tree.flatten(held)
        unravel = ravel_pytree(self._changing(held))[1]

        def unpack(columns: Array) -> Slow:
            moving = iter(unravel(columns))
            both = zip(leaves, self.changing, strict=True)
            return jax.tree.unflatten(tree, [next(moving) if new else leaf for leaf, new in both])

        return unpack

    def turned(self, time: Scalar) -> Harmonics:
        """Stiffness harmonics counted from a time [s]."""
        return self.harmonics.turned(mesh_phases(self.oscillator.equation, time))

    def loads(self, time: Scalar, steps: int) -> Array:
        """Load of every step of a block [N m]; one number where it does not alternate."""
        load = self.oscillator.equation.scene.load
        assert load is not None
        if not load.alternates:
            return self.oscillator.equation.load(time)
        return jax.vmap(lambda step: self.oscillator.equation.load(time + step * self.oscillator.step))(
            jnp.arange(steps).astype(time.dtype)
        )


class Basis(NamedTuple):
    """What the tables of all blocks of a length share.

    Args:
        places: of the nodes of a block, in steps, shape (node,).
        weights: of the nodes at each step, shape (step, node).
        cosine, sine: of the mesh harmonics at each step from the start of a block, shape (step, harmonic).
    """

    places: np.ndarray
    weights: Array
    cosine: Array
    sine: Array

    @classmethod
    def of(cls, drive: Drive, steps: int, nodes: int, beyond: int = 0) -> "Basis":
        """The basis of blocks of some steps, their tables going so many steps beyond."""
        places, weights = interpolation(steps, nodes, beyond)
        rate = mesh_rate(drive.oscillator.equation) * drive.oscillator.step
        order = jnp.arange(1, drive.harmonics.cosine.shape[0] + 1).astype(rate.dtype)
        angle = jnp.arange(steps + beyond).astype(rate.dtype)[:, None] * (rate * order)[None, :]
        cosine, sine = (jnp.cos(angle), jnp.sin(angle)) if angle.size else (angle, angle)
        return cls(places, jnp.asarray(weights, rate.dtype), cosine, sine)


def _spread(weights: Float[Array, "step node"], values: Float[Array, "node column"]) -> Float[Array, "step column"]:
    """A small matrix product, written out: in a loop it takes a quarter of a library call's time."""
    total = jnp.zeros((weights.shape[0], values.shape[1]), weights.dtype)
    for node in range(values.shape[0]):
        total = total + weights[:, node, None] * values[node][None, :]
    return total


def march(drive: Drive, start: Scalar, first: Float[Array, "2"], spacing: Spacing) -> March:
    """All steps one after the other.

    Args:
        drive: of the oscillator.
        start: time of the first sample [s].
        first: scaled position, and velocity times step, there.
        spacing: of samples and steps.
    """
    longest = spacing.block.steps
    pieces = next(n for n in range(1, spacing.each + 1) if spacing.each % n == 0 and spacing.each // n <= longest)
    every = spacing.each // pieces  # steps of a piece of an interval between samples
    steps = every * (max(1, longest // every) if pieces == 1 else 1)
    blocks = math.ceil(spacing.samples * spacing.each / steps)
    basis, unpack = Basis.of(drive, steps, spacing.block.nodes, beyond=1), drive.slow(start)
    places = (steps * np.arange(blocks)[:, None] + basis.places[None, :]).ravel()
    nodes = drive.nodes(start, places).reshape(blocks, spacing.block.nodes, -1)
    origins = start + (steps * jnp.arange(blocks)).astype(start.dtype) * drive.oscillator.step

    def block(carry, given):
        columns, waves, origin = given
        stiffness = waves.mean[None, :] + _spread(basis.cosine, waves.cosine) + _spread(basis.sine, waves.sine)
        load = drive.loads(origin, steps + 1)
        rows = _spread(basis.weights, columns), stiffness, (load,) if load.ndim else ()

        def drives(row: Any) -> tuple[Slow, Fast]:
            return unpack(row[0]), Fast(row[1], row[2][0] if row[2] else load)

        ended, path = _steps(drive.oscillator, drives, carry, rows)
        return ended, _measured(drive.oscillator, drives, rows, path, every)

    carry = begin(drive, start, first)
    _, found = jax.lax.scan(block, carry, (nodes, jax.vmap(drive.turned)(origins), origins))
    x, speeds, forces, *extremes = jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), found)
    kept = slice(0, spacing.samples * pieces, pieces)
    highest, lowest = (part.reshape(-1, pieces)[: spacing.samples] for part in extremes)
    bounds = _up_to(x[kept], top(highest), -top(-lowest))
    return March(x[kept], speeds[kept], forces[kept], bounds[0], bounds[1], jnp.zeros((), start.dtype))


def begin(drive: Drive, time: Scalar, state: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Scaled position and its last change, from position and velocity times step at a time [s]."""
    oscillator = drive.oscillator

    def at(time: Scalar) -> State:
        stiffness, load = drive.turned(time), oscillator.equation.load(time)
        fast = Fast(stiffness.mean + stiffness.cosine.sum(axis=0), load)
        return oscillator.state(oscillator.slow(time), fast, state[0])

    both = jax.vmap(at)(jnp.stack([time, time + oscillator.step]))
    now, later = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in range(2))
    return state[0], change_before(state[1], now, later.push - now.push)


def _rows(table: Any, chosen: slice) -> Any:
    """Some rows of all columns."""
    return jax.tree.map(lambda column: column[chosen], table)


def _steps(oscillator: Oscillator, drives: Callable, carry: tuple, rows: Any) -> tuple[tuple, Array]:
    """The steps of a table but its last row, of one motion or of lanes side by side.

    Args:
        oscillator: whose steps they are.
        drives: from a row to what drives a step.
        carry: position and last change.
        rows: the table.

    Returns:
        Position and last change after them, and the path: a position before, those of all rows.
    """

    def step(position: Array, change: Array, row: Any) -> Array:
        slow, fast = drives(row)
        return advance(change, oscillator.state(slow, fast, position))

    ended, path = recur(step if carry[0].ndim == 0 else jax.vmap(step), carry[0], carry[1], _rows(rows, slice(0, -1)))
    return ended, jnp.concatenate([(carry[0] - carry[1])[None], path, ended[0][None]])


def _measured(oscillator: Oscillator, drives: Callable, rows: Any, path: Array, each: int) -> tuple:
    """Positions, speeds and forces at the samples, and highest and lowest position up to the next sample.

    Args:
        oscillator, drives, rows: as for `_steps`.
        path: its path.
        each: steps between samples.
    """
    now, following = path[1:-1:each], path[2::each]

    def sample(row: Any, after: Any, x: Array, dx: Array) -> tuple[Array, Array]:
        slow, fast = drives(row)
        state = oscillator.state(slow, fast, x)
        later, sooner = drives(after)
        rise = oscillator.state(later, sooner, x).push - state.push
        return velocity(dx, state, rise), oscillator.forces(slow, fast, x)

    def highest(path: Array) -> Array:
        between = turning(path).reshape(-1, each, *path.shape[1:])
        return jnp.maximum(top(between), path[1 + each :: each])

    both = _rows(rows, slice(0, -1, each)), _rows(rows, slice(1, None, each))
    over_lanes = sample if path.ndim == 1 else jax.vmap(sample)
    speeds, forces = jax.vmap(over_lanes)(*both, now, following - now)
    return now, speeds, forces, highest(path), -highest(-path)


def _up_to(positions: Array, highest: Array, lowest: Array) -> tuple[Array, Array]:
    """Extremes up to each sample from those up to the next one."""
    first = positions[:1]
    return jnp.concatenate([first, highest[:-1]]), jnp.concatenate([first, lowest[:-1]])


@jax.custom_jvp
def top(values: Float[Array, "n m ..."]) -> Float[Array, "n ..."]:
    """Highest value along the second axis, with the derivative of the one that is highest: the built-in derivative
    compares values with their maximum, which fused code may round differently."""
    return values.max(axis=1)


@top.defjvp
def _top_jvp(primals: tuple, tangents: tuple) -> tuple:
    (values,), (slopes,) = primals, tangents
    where = jnp.argmax(values, axis=1, keepdims=True)
    return top(values), jnp.take_along_axis(slopes, where, axis=1)[:, 0]


def turning(path: Float[Array, "n ..."]) -> Float[Array, "m ..."]:
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
        warm_up: steps before each window that are thrown away, a multiple of the steps between samples.
        nodes: of a window, for the slow signals.
    """

    number: int
    warm_up: int
    nodes: int

    def steps(self, spacing: Spacing) -> int:
        """Steps of one window, warm-up included."""
        return self.warm_up + spacing.each * math.ceil(spacing.samples / self.number)


def march_windows(
    drive: Drive,
    start: Scalar,
    first: Float[Array, "2"],
    rest: Callable[[Scalar], Float[Array, "2"]],
    spacing: Spacing,
    windows: Windows,
) -> March:
    """All windows at once, each lane of a vector one window; many windows in groups of `LANES`.

    Args:
        drive, start, first, spacing: as for `march`.
        rest: scaled position, and velocity times step, of the quasi-static solution at a time [s].
        windows: how the record is cut.
    """
    groups = math.ceil(windows.number / LANES)
    lanes = math.ceil(windows.number / groups)
    samples = math.ceil(spacing.samples / (groups * lanes))
    warm, steps = windows.warm_up, windows.warm_up + samples * spacing.each + 1
    basis, unpack = Basis.of(drive, steps, windows.nodes), drive.slow(start)
    load = drive.oscillator.equation.load(start)

    def drives(row: Any) -> tuple[Slow, Fast]:
        return unpack(jnp.stack(row[0])), Fast(jnp.stack(row[1]), row[2][0] if row[2] else load)

    def group(window: Array) -> tuple:
        offsets = ((window + jnp.arange(lanes)) * (samples * spacing.each) - warm).astype(start.dtype)
        origins = start + offsets * drive.oscillator.step
        rows = _lanes(drive, basis, start, offsets)
        begins = window + jnp.arange(lanes) == 0
        # the last of these is the real start, for the first window
        states = jnp.concatenate([jax.vmap(rest)(origins), first[None]])
        starts = jax.vmap(lambda time, state: begin(drive, time, state))(jnp.append(origins, start), states)
        carry, real = (tuple(part[chosen] for part in starts) for chosen in (slice(0, -1), -1))
        carry, _ = _steps(drive.oscillator, drives, carry, _rows(rows, slice(0, warm + 1)))
        carry = tuple(jnp.where(begins, own, lane) for own, lane in zip(real, carry, strict=True))
        rows = _rows(rows, slice(warm, None))
        ended, path = _steps(drive.oscillator, drives, carry, rows)
        return _measured(drive.oscillator, drives, rows, path, spacing.each), carry, ended

    if groups == 1:
        found, begun, ended = jax.tree.map(lambda part: part[None], group(jnp.asarray(0)))
    else:
        found, begun, ended = jax.lax.map(group, lanes * jnp.arange(groups))
    x, speeds, forces, *extremes = (
        jnp.swapaxes(part, 1, 2).reshape(groups * lanes * samples, *part.shape[3:])[: spacing.samples] for part in found
    )
    apart, faster = (jnp.abs(end.ravel()[:-1] - own.ravel()[1:]) for end, own in zip(ended, begun, strict=True))
    defect = jnp.maximum(apart.max(), faster.max() / (drive.oscillator.step * drive.oscillator.equation.frequency))
    return March(x, speeds, forces, *_up_to(x, *extremes), defect)


def _lanes(drive: Drive, basis: Basis, start: Scalar, offsets: Float[Array, " lane"]) -> tuple:
    """One array for each signal, steps by lanes, so that a step reads whole vectors.

    Args:
        drive: of the oscillator.
        basis: of a lane.
        start: time of the first sample [s].
        offsets: of the first step of each lane, in steps from there.
    """
    origins = start + offsets * drive.oscillator.step
    nodes = drive.nodes(start, (offsets[:, None] + jnp.asarray(basis.places, start.dtype)[None, :]).ravel())
    nodes = nodes.reshape(offsets.shape[0], -1, nodes.shape[-1])
    slow = tuple(basis.weights @ nodes[:, :, column].T for column in range(nodes.shape[-1]))
    waves = jax.vmap(drive.turned, out_axes=-1)(origins)
    stiffness = tuple(
        waves.mean[pair][None, :] + basis.cosine @ waves.cosine[:, pair] + basis.sine @ waves.sine[:, pair]
        for pair in range(waves.mean.shape[0])
    )
    load = jax.vmap(lambda origin: drive.loads(origin, basis.weights.shape[0]), out_axes=-1)(origins)
    return slow, stiffness, (load,) if load.ndim == 2 else ()
