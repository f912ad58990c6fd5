"""A record cut into windows of time that run in parallel.

A damped motion forgets its start. Each window is therefore warmed up from the quasi-static solution; the difference of
neighbouring windows where they meet is measured. The derivative needs no warm-up: with the path known, the partial
derivatives of all steps are computed at once, and the linear recurrence that remains (see `recurrence`) goes from block
to block exactly, because it is linear in the state with which a block begins.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.analysis.fast.fitted import advance
from gearjax.analysis.fast.march import (
    LANES,
    Block,
    March,
    Signals,
    Spacing,
    joined,
    measured,
    nodes_of,
    of_samples,
    run_blocks,
    warm_start,
)
from gearjax.analysis.fast.signals import Basis, Forcing, Given, written_out
from gearjax.dependence import changes, moved
from gearjax.typing import Array, Float, Scalar

CACHED = 8192  # steps whose numbers fit into a core's cache


class Cut(NamedTuple):
    """Division of a record into windows.

    Args:
        number: number of windows in parallel.
        warm_up: number of samples before each window that are computed and discarded.
        block: division of the steps of a window into blocks.
    """

    number: int
    warm_up: int
    block: Block


class _Division(NamedTuple):
    """Windows of whole blocks, so that each ends where the next begins, and its warm-up shares nodes with others.

    Args:
        groups, lanes: number of groups of windows, and of windows in each, which run in parallel.
        own, warm: spacing of a window and of its warm-up.
        whole: spacing of the record and of the warm-up of its first window.
    """

    groups: int
    lanes: int
    own: Spacing
    warm: Spacing
    whole: Spacing

    @classmethod
    def of(cls, spacing: Spacing, windows: Cut) -> "_Division":
        """The division of a record."""
        groups = math.ceil(windows.number / LANES)
        lanes = math.ceil(windows.number / groups)
        samples = math.ceil(spacing.samples / (groups * lanes))
        own = spacing._replace(samples=samples, block=windows.block, signals=Signals.SUMS).of_whole_blocks()
        warm = own._replace(samples=own.rows * math.ceil(windows.warm_up / own.rows))
        return cls(groups, lanes, own, warm, own._replace(samples=warm.samples + groups * lanes * own.samples))

    @property
    def record(self) -> Spacing:
        """Spacing of the record that all windows together cover, to the end of the last block."""
        return self.own._replace(samples=self.groups * self.lanes * self.own.samples)


def march_windows(
    forcing: Forcing,
    start: Scalar,
    carry: tuple[Scalar, Scalar],
    spacing: Spacing,
    windows: Cut,
) -> March:
    """Compute all windows in parallel, one window per lane of a vector; many windows in groups of at most `LANES`.

    Args:
        forcing, start, carry, spacing: as for `march`.
        windows: division of the record into windows.
    """
    division = _Division.of(spacing, windows)
    nodes = nodes_of(forcing, start - division.warm.samples * forcing.oscillator.step * spacing.each, division.whole)

    @eqx.filter_custom_jvp
    def record(forcing: Forcing, nodes: Array, start: Scalar, carry: tuple) -> tuple:
        return _record(forcing, nodes, start, carry, division)

    @record.def_jvp
    def _(primals: tuple, tangents: tuple) -> tuple:
        return _derivative(record(*primals), primals, tangents, division)

    parts, defect, _, _ = record(forcing, nodes, start, carry)
    return joined(tuple(part[: spacing.samples] for part in parts), defect)


def _record(forcing: Forcing, nodes: Array, start: Scalar, carry: tuple, division: _Division) -> tuple:
    """Results at the samples, defect, positions at all steps, shape (block, step), and state after the last step."""
    own, warm, number = division.own, division.warm, division.groups * division.lanes
    spaced = forcing.oscillator.step * own.each

    def window(number: Array) -> tuple:
        begun = start + (number * own.samples).astype(start.dtype) * spaced
        early = begun - warm.samples * spaced
        here = jax.lax.dynamic_slice_in_dim(nodes, number * own.blocks, warm.blocks + own.blocks)
        warmed, *_ = run_blocks(forcing, early, warm_start(forcing, early, warm, here[0]), warm, here[: warm.blocks])
        own_start = tuple(jnp.where(number == 0, one, other) for one, other in zip(carry, warmed, strict=True))
        return own_start, *run_blocks(forcing, begun, own_start, own, here[warm.blocks :])

    numbers = jnp.arange(number).reshape(division.groups, division.lanes)
    begun, ended, parts, path = jax.tree.map(
        lambda part: part.reshape(number, *part.shape[2:]), jax.lax.map(jax.vmap(window), numbers)
    )
    apart, faster = (jnp.abs(end[:-1] - own[1:]).max() for end, own in zip(ended, begun, strict=True))
    defect = jnp.maximum(apart, faster / (forcing.oscillator.step * forcing.oscillator.equation.frequency))
    parts = tuple(part.reshape(-1, *part.shape[2:]) for part in parts)
    return parts, defect, path.reshape(-1, own.steps), tuple(part[-1] for part in ended)


def _derivative(outcome: tuple, primals: tuple, tangents: tuple, division: _Division) -> tuple[tuple, tuple]:
    """The rule of `_record`: its results and their tangents; tangents are ``None`` where nothing moves."""
    parts, defect, path, ended = outcome
    forcing, nodes, start, carry = primals
    forcing_moves, nodes_moves, start_moves, carry_moves = tangents
    spacing = division.record
    own = slice(division.warm.blocks, None)  # the nodes but for the warm-up of the first window
    columns, columns_moves = nodes[own], None if nodes_moves is None else nodes_moves[own]
    first, second = (jnp.zeros_like(x) if way is None else way for x, way in zip(carry, carry_moves, strict=True))
    before = carry[0] - carry[1], first - second

    def slopes(now: tuple) -> tuple[Array, Array, Array]:
        of_group, moves = now[:-1], now[-1]
        return _slopes((forcing, start), (forcing_moves, start_moves), of_group, moves, spacing)

    places = (spacing.steps * jnp.arange(spacing.blocks)).astype(start.dtype)
    given = columns, places, path, _steps_before(path, before[0]), columns_moves
    groups = _groups(spacing)
    each = spacing.blocks // groups
    grouped = jax.tree.map(lambda part: part.reshape(groups, each, *part.shape[1:]), given)
    # in a loop, so that the slopes are computed along the steps, and not while they are transposed
    a, b, driven = (part.reshape(path.shape) for part in jax.lax.map(slopes, grouped))
    path_dot, ended_dot = _linear(a, b, driven, (first, second))

    def sampled(given: tuple) -> tuple:
        forcing, start, columns, path, first, last = given
        basis = Basis.of(forcing, spacing.steps, spacing.block.nodes)
        ends = jnp.concatenate([first[None], path[:-1, -1]]), jnp.concatenate([path[1:, 0], last[None]])
        paths = jnp.concatenate([ends[0][:, None], path, ends[1][:, None]], axis=1)

        def block(columns: Array, place: Array, path: Array) -> tuple:
            given = _given(forcing, columns, start + place * forcing.oscillator.step, spacing)
            rows, step_forcing = written_out(forcing, basis, given)
            return measured(forcing.oscillator, step_forcing, rows.every, path, spacing.each // spacing.pieces)

        return of_samples(jax.vmap(block)(columns, places, paths), spacing)

    _, parts_dot = changes(
        sampled,
        (forcing, start, columns, path, before[0], ended[0]),
        (forcing_moves, start_moves, columns_moves, path_dot, before[1], ended_dot[0]),
    )
    return (parts, defect, path, ended), (parts_dot, jnp.zeros_like(defect), path_dot, ended_dot)


def _groups(spacing: Spacing) -> int:
    """Number of groups of blocks whose arrays fit into a cache; a divisor of the number of blocks."""
    fewest = math.ceil(spacing.blocks * spacing.steps / CACHED)
    return next(n for n in range(max(fewest, 2), spacing.blocks + 1) if spacing.blocks % n == 0)


def _steps_before(path: Float[Array, "block step"], before: Scalar) -> Float[Array, "block step"]:
    """Change over the step before each position; ``before`` is the position one step before the first."""
    sooner = jnp.concatenate([before[None], path[:-1, -1]])
    return jnp.concatenate([(path[:, 0] - sooner)[:, None], path[:, 1:] - path[:, :-1]], axis=1)


def _given(forcing: Forcing, columns: Array, time: Scalar, spacing: Spacing) -> Given:
    return Given(columns, forcing.turned(time), forcing.torques(time, spacing.steps + 1))


def _slopes(
    given: tuple[Forcing, Scalar], given_moves: tuple, of_group: tuple, columns_moves: Any, spacing: Spacing
) -> tuple[Float[Array, "block step"], Float[Array, "block step"], Float[Array, "block step"]]:
    """Partial derivatives of the change of each step by position and last change, and its tangent by all else.

    Args:
        given: forcing and time of the first step [s].
        given_moves: tangents of these.
        of_group: nodes of some blocks, numbers of steps before them, positions, and changes over the steps before.
        columns_moves: tangent of the nodes.
        spacing: spacing of the record.
    """
    nodes, places, path, change = of_group

    def excitation(forcing: Forcing, start: Scalar, columns: Array, place: Array) -> tuple[Any, Any]:
        basis = Basis.of(forcing, spacing.steps, spacing.block.nodes)
        now = _given(forcing, columns, start + place * forcing.oscillator.step, spacing)
        rows, step_forcing = written_out(forcing, basis, now)
        return rows.own, step_forcing

    def table(now: tuple) -> Any:
        (forcing, start), columns = now

        def block(columns: Array, place: Array) -> Any:
            rows, step_forcing = excitation(forcing, start, columns, place)
            return step_forcing.table(rows)

        return jax.vmap(block)(columns, places)

    def next_change(position: Array, last: Array, numbers: Any, given: tuple) -> Array:
        forcing, start = given
        _, step_forcing = excitation(forcing, start, nodes[0], places[0])  # any block: all have the same form
        return advance(last, forcing.oscillator.state(*step_forcing.put(numbers), position))

    def each(function: Any) -> Any:
        return jax.vmap(jax.vmap(function))

    numbers, moving = moved(table, (given, nodes), (given_moves, columns_moves))
    one = jnp.ones((), path.dtype)
    by_position = each(lambda x, c, row: jax.jvp(lambda x: next_change(x, c, row, given), (x,), (one,))[1])
    by_change = each(lambda x, c, row: jax.jvp(lambda c: next_change(x, c, row, given), (c,), (one,))[1])

    def all_next(now: tuple) -> Array:
        numbers, given = now
        return each(lambda x, c, row: next_change(x, c, row, given))(path, change, numbers)

    _, driven = changes(all_next, (numbers, given), (moving, given_moves))
    return by_position(path, change, numbers), by_change(path, change, numbers), driven


def _linear(
    by_position: Float[Array, "block step"],
    by_change: Float[Array, "block step"],
    driven: Float[Array, "block step"],
    begins: tuple[Scalar, Scalar],
) -> tuple[Float[Array, "block step"], tuple[Scalar, Scalar]]:
    """Tangents of the positions at all steps, and of position and change after the last step.

    The blocks run in parallel, first from zero, and from two unit states that nothing drives: the end of a block is
    linear in its begin. With the begins known from block to block, they run again.
    """
    a, b, push = by_position.T, by_change.T, driven.T

    def step(carry: tuple, now: tuple) -> tuple[tuple, Array]:
        dx, dc = carry
        a, b, push = now
        dc = a * dx + b * dc + push
        return (dx + dc, dc), dx

    def ends(x: Array, c: Array, push: Array) -> tuple[Array, Array]:
        return jax.lax.scan(lambda carry, now: (step(carry, now)[0], None), (x, c), (a, b, push))[0]

    zero, one = jnp.zeros_like(a[0]), jnp.ones_like(a[0])
    kept_x, kept_c = jax.vmap(lambda x, c: ends(x, c, jnp.zeros_like(a)))(
        jnp.stack([one, zero]), jnp.stack([zero, one])
    )
    last_x, last_c = ends(zero, zero, push)

    def block(state: tuple, now: tuple) -> tuple[tuple, tuple]:
        x, c = state
        kept_x, kept_c, last_x, last_c = now
        return (kept_x[0] * x + kept_x[1] * c + last_x, kept_c[0] * x + kept_c[1] * c + last_c), state

    ended, starts = jax.lax.scan(block, begins, (kept_x.T, kept_c.T, last_x, last_c))
    _, path = jax.lax.scan(step, starts, (a, b, push))
    return path.T, ended
