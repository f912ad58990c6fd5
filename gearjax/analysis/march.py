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
    """

    oscillator: Oscillator
    harmonics: Harmonics

    @classmethod
    def of(cls, oscillator: Oscillator) -> "Drive":
        """The signals of an oscillator."""
        return cls(oscillator, Harmonics.of(oscillator.equation))

    def nodes(self, start: Scalar, places: ArrayLike) -> Float[Array, "node column"]:
        """What changes of the slow signals, at places counted in steps from a time [s]."""
        return jax.vmap(lambda place: self._split(start + place * self.oscillator.step))(
            jnp.asarray(places, start.dtype)
        )

    def _changes(self, time: Scalar) -> list[bool]:
        return depends(self.oscillator.slow, time)

    def _split(self, time: Scalar) -> Float[Array, " column"]:
        leaves = jax.tree.leaves(self.oscillator.slow(time))
        moving = [leaf.ravel() for leaf, new in zip(leaves, self._changes(time), strict=True) if new]
        return jnp.concatenate([jnp.zeros((0,), time.dtype), *moving])

    def slow(self, time: Scalar) -> Callable[[Array], Slow]:
        """From what changes, shape (column,), to the slow signals; the others are those of a time [s]."""
        leaves, tree = jax.tree.flatten(self.oscillator.slow(time))
        changes = self._changes(time)
        unravel = ravel_pytree([leaf for leaf, new in zip(leaves, changes, strict=True) if new])[1]

        def unpack(columns: Array) -> Slow:
            moving = iter(unravel(columns))
            return jax.tree.unflatten(
                tree, [next(moving) if new else leaf for leaf, new in zip(leaves, changes, strict=True)]
            )

        return unpack

    def waves(self, steps: int) -> tuple[Float[Array, "step harmonic"], Float[Array, "step harmonic"]]:
        """Cosines and sines of the mesh harmonics over the steps of a block, from its start."""
        rate = mesh_rate(self.oscillator.equation) * self.oscillator.step
        if self.harmonics.cosine.shape[0] == 0:
            return jnp.zeros((steps, 0), rate.dtype), jnp.zeros((steps, 0), rate.dtype)
        angle = jnp.arange(steps).astype(rate.dtype) * rate
        order = jnp.arange(1, self.harmonics.cosine.shape[0] + 1).astype(rate.dtype)
        return jnp.cos(angle[:, None] * order[None, :]), jnp.sin(angle[:, None] * order[None, :])

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

    def state(self, slow: Slow, stiffness: Array, load: Array, position: Array) -> State:
        """The oscillator at a position."""
        return self.oscillator.state(slow, Fast(stiffness, load), position)


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
    rows = max(1, longest // every) if pieces == 1 else 1
    steps, blocks = rows * every, math.ceil(spacing.samples * pieces / rows)
    step, dtype = drive.oscillator.step, start.dtype
    places, weights = interpolation(steps, spacing.block.nodes, beyond=1)
    unpack, weights = drive.slow(start), jnp.asarray(weights, dtype)
    cosine, sine = drive.waves(steps + 1)
    origins = start + (steps * jnp.arange(blocks)).astype(dtype) * step
    nodes = drive.nodes(start, (steps * np.arange(blocks)[:, None] + places[None, :]).ravel())
    nodes = nodes.reshape(blocks, spacing.block.nodes, nodes.shape[-1])

    def block(carry, given):
        columns, waves, origin = given
        stiffness = waves.mean[None, :] + _spread(cosine, waves.cosine) + _spread(sine, waves.sine)
        load = drive.loads(origin, steps + 1)
        table = (_spread(weights, columns), stiffness, load if load.ndim else jnp.zeros((steps + 1, 0), dtype))

        def at(row, position):
            return drive.state(unpack(row[0]), row[1], row[2] if load.ndim else load, position)

        def step(position, change, row):
            return advance(change, at(row, position))

        before = carry[0] - carry[1]
        carry, path = recur(step, carry[0], carry[1], _rows(table, slice(0, -1)))
        path = jnp.concatenate([before[None], path, carry[0][None]])
        now = path[1:-1:every]

        def measured(row, following, x, dx):
            state = at(row, x)
            forces = drive.oscillator.forces(unpack(row[0]), Fast(row[1], load), x)
            return velocity(dx, state, at(following, x).push - state.push), forces

        rows = _rows(table, slice(0, -1, every)), _rows(table, slice(1, None, every))
        speeds, forces = jax.vmap(measured)(*rows, now, path[2::every] - now)
        high, low = (turning(sign, path).reshape(-1, every).max(axis=1) for sign in (1.0, -1.0))
        ends = path[1 + every :: every]
        return carry, (now, speeds, forces, jnp.maximum(high, ends), -jnp.maximum(low, -ends))

    waves = jax.vmap(drive.turned)(origins)
    columns = (nodes, waves, origins)
    carry = begin(drive, start, first)
    _, found = jax.lax.scan(block, carry, columns)
    x, speeds, forces, highest, lowest = jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), found)
    highest, lowest = (
        (part.reshape(-1, pieces)[: spacing.samples].max(axis=1) for part in (highest, -lowest))
        if pieces > 1
        else (highest, -lowest)
    )
    kept = slice(0, spacing.samples * pieces, pieces)
    highest, lowest = (
        jnp.concatenate([end[None], part[: spacing.samples - 1]]) for end, part in ((x[0], highest), (-x[0], lowest))
    )
    return March(x[kept], speeds[kept], forces[kept], highest, -lowest, jnp.zeros((), dtype))


def begin(drive: Drive, time: Scalar, state: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Scaled position and its last change, from position and velocity times step at a time [s]."""

    def at(time: Scalar) -> State:
        stiffness, load = drive.turned(time), drive.oscillator.equation.load(time)
        return drive.state(drive.oscillator.slow(time), stiffness.mean + stiffness.cosine.sum(axis=0), load, state[0])

    now = at(time)
    rise = at(time + drive.oscillator.step).push - now.push
    return state[0], change_before(state[1], now, rise)


def _rows(table: Any, chosen: slice) -> Any:
    """Some rows of all columns."""
    return jax.tree.map(lambda column: column[chosen], table)


def turning(sign: float, path: Float[Array, "n ..."]) -> Float[Array, "m ..."]:
    """Highest value near each point but the first and last: the vertex of the parabola where the path turns down."""
    before, now, after = (sign * path[i : path.shape[0] - 2 + i] for i in range(3))
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
    places, weights = interpolation(steps, windows.nodes)
    table = _Tables(drive, start, steps, jnp.asarray(places, start.dtype), jnp.asarray(weights, start.dtype))
    real, unpack, load = begin(drive, start, first), drive.slow(start), drive.oscillator.equation.load(start)

    def drives(row: Any) -> tuple[Slow, Fast]:
        return unpack(jnp.stack(row[0])), Fast(jnp.stack(row[1]), row[2][0] if row[2] else load)

    def step(position: Scalar, change: Scalar, row: Any) -> Scalar:
        slow, fast = drives(row)
        return advance(change, drive.oscillator.state(slow, fast, position))

    def group(window: Array) -> tuple:
        offsets = ((window + jnp.arange(lanes)) * (samples * spacing.each) - warm).astype(start.dtype)
        origins = start + offsets * drive.oscillator.step
        rows = table.rows(origins, offsets)
        begins = window + jnp.arange(lanes) == 0

        carry = jax.vmap(lambda origin: begin(drive, origin, rest(origin)))(origins)
        carry, _ = recur(jax.vmap(step), carry[0], carry[1], _rows(rows, slice(0, warm)))
        carry = tuple(jnp.where(begins, own, lane) for own, lane in zip(real, carry, strict=True))
        rows = _rows(rows, slice(warm, None))
        ended, path = recur(jax.vmap(step), carry[0], carry[1], _rows(rows, slice(0, -1)))
        path = jnp.concatenate([(carry[0] - carry[1])[None], path, ended[0][None]])
        return _measured(drive.oscillator, drives, rows, path, spacing.each), carry, ended

    if groups == 1:
        found, begun, ended = jax.tree.map(lambda part: part[None], group(jnp.asarray(0)))
    else:
        found, begun, ended = jax.lax.map(group, lanes * jnp.arange(groups))
    x, speeds, forces, high, low = (
        jnp.swapaxes(part, 1, 2).reshape(groups * lanes * samples, *part.shape[3:])[: spacing.samples] for part in found
    )
    apart, faster = (jnp.abs(end.ravel()[:-1] - own.ravel()[1:]) for end, own in zip(ended, begun, strict=True))
    defect = jnp.maximum(apart.max(), faster.max() / (drive.oscillator.step * drive.oscillator.equation.frequency))
    highest, lowest = (jnp.concatenate([end[None], part[:-1]]) for end, part in ((x[0], high), (-x[0], low)))
    return March(x, speeds, forces, highest, -lowest, defect)


def _measured(oscillator: Oscillator, drives: Callable, rows: Any, path: Array, each: int) -> tuple:
    """Positions, speeds and forces at the samples of all lanes, and extremes up to the next sample."""
    now, following = path[1:-1:each], path[2::each]

    def sample(row, after, x, dx):
        slow, fast = drives(row)
        state = oscillator.state(slow, fast, x)
        later, sooner = drives(after)
        rise = oscillator.state(later, sooner, x).push - state.push
        return velocity(dx, state, rise), oscillator.forces(slow, fast, x)

    both = _rows(rows, slice(0, -1, each)), _rows(rows, slice(1, None, each))
    speeds, forces = jax.vmap(jax.vmap(sample))(*both, now, following - now)
    ends = path[1 + each :: each]
    high, low = (turning(sign, path).reshape(-1, each, path.shape[1]).max(axis=1) for sign in (1.0, -1.0))
    return now, speeds, forces, jnp.maximum(high, ends), jnp.maximum(low, -ends)


class _Tables(NamedTuple):
    """What drives all steps of a group of windows."""

    drive: Drive
    start: Scalar
    steps: int
    places: Array
    weights: Array

    def rows(self, origins: Float[Array, " lane"], offsets: Float[Array, " lane"]) -> tuple:
        """One array for each signal, steps by lanes, so that a step reads whole vectors.

        Args:
            origins: time of the first step of each lane [s].
            offsets: the same in steps from the start of the record.
        """
        drive = self.drive
        nodes = drive.nodes(self.start, (offsets[:, None] + self.places[None, :]).ravel())
        nodes = nodes.reshape(origins.shape[0], -1, nodes.shape[-1])
        slow = tuple(self.weights @ nodes[:, :, column].T for column in range(nodes.shape[-1]))
        cosine, sine = drive.waves(self.steps)
        waves = jax.vmap(drive.turned, out_axes=-1)(origins)
        stiffness = tuple(
            waves.mean[pair][None, :] + cosine @ waves.cosine[:, pair] + sine @ waves.sine[:, pair]
            for pair in range(waves.mean.shape[0])
        )
        load = jax.vmap(lambda origin: drive.loads(origin, self.steps), out_axes=-1)(origins)
        return slow, stiffness, (load,) if load.ndim == 2 else ()
