"""Active-set method for contacts that are coupled within small blocks only, such as one pair of teeth, in many lanes.

A lane is one problem of a batch; all lanes are solved at once. The steps are those of `active_set`: each solves the
linear problem of one set of closed contacts, and the signs of the result give the next set. The blocks have only the
position in common. Each block therefore has a factorisation of its own, which is written out over its few contacts; the
last axes of its arrays are blocks and lanes, so that it vectorises. Lanes whose sets repeat in a cycle count as not
found.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from gearjax.contact.active_set import CLOSED, carrying
from gearjax.contact.lanes import finished, in_parts
from gearjax.contact.springs import block_diagonal
from gearjax.typing import Array, Bool, Float, Int

MOST_OWN = 8  # contacts of a block; with more, the program would become too large
MOST_STEPS = 24  # steps of all lanes together: hardly any problem needs more than 10
GUESSES, STIFFER = 5, 1.4  # steps and stiffness of the first guess: with other values the search took more steps
LANES = 128  # lanes at a time, so that their numbers stay in the cache
Each = list[Array]
Matrix = list[Each]


class _Sets(NamedTuple):
    """Sets of closed contacts, with the positions and forces that belong to them.

    There is one array of shape (block, lane) for each contact of a block. A single array of all contacts would be
    assembled again in every step, which took four times as long as the step.

    Args:
        closed: whether each contact is closed.
        place: position, shape (1, lane) [rad].
        forces: forces of the contacts [N].
        right: whether all conditions are fulfilled, shape (1, lane).
        step: number of sets that were tried.
    """

    closed: list[Bool[Array, "block lane"]]
    place: Float[Array, "1 lane"]
    forces: list[Float[Array, "block lane"]]
    right: Bool[Array, "1 lane"]
    step: Int[Array, ""]


def search_of_blocks(sided: bool, blocks: Array, levers: Array, gap: Array, applied: Array, loaded: Array) -> tuple:
    """Position, forces, the set of contacts that carry, and whether it was found, as from `active_set.carrying`.

    Args:
        sided: whether the first half of the contacts has driving flanks and the second half as many back flanks. If no
            block has both, the search treats only the side that the load presses, and checks that the other one is
            open.
        blocks: approach of each contact per force on each contact of its block, shape (block, own, own) [m/N].
        levers: lever of each contact, shape (contact, 1) [m/rad].
        gap: gaps at position zero, shape (contact,) [m].
        applied: generalised force, shape (1,) [N m].
        loaded: whether each contact can hold against the load, shape (contact,).
    """
    apart = sided and blocks.shape[0] % 2 == 0  # with an odd number of blocks, one block has flanks of both sides
    return (_search_of_sides if apart else _search)(blocks, levers, gap, applied, loaded)


def solved_of_blocks(blocks: Array, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
    """Position, shape (1,), and forces with a given set of closed contacts, as from `active_set.solved`."""
    return _linear(blocks, levers, rest, applied, closed)


def _within(blocks: Matrix, lever: Each, rest: Each, applied: Array, closed: Each) -> tuple[Array, Each]:
    """Position and forces with given sets of closed contacts.

    Args:
        blocks: rows of the blocks' matrices, as arrays of shape (block, lane or 1) [m/N].
        lever, rest, closed: one array of shape (block, lane) for each contact of a block.
        applied: generalised force, shape (1, lane).
    """
    # factorisation L D L^T of the closed contacts; rows and columns of the other contacts are those of the unit matrix
    own = range(len(lever))
    arms = [jnp.where(closed[i], lever[i], 0.0) for i in own]
    held = [jnp.where(closed[i], rest[i], 0.0) for i in own]
    low: Matrix = []
    inverse: Each = []
    for i in own:
        row: Each = []
        scaled: Each = []
        diagonal = jnp.where(closed[i], blocks[i][i], 1.0)
        for j in range(i):
            entry = jnp.where(closed[i] & closed[j], blocks[i][j], 0.0)
            for k in range(j):
                entry = entry - scaled[k] * low[j][k]
            scaled.append(entry)
            row.append(entry * inverse[j])
            diagonal = diagonal - entry * row[j]
            arms[i] = arms[i] - row[j] * arms[j]
            held[i] = held[i] - row[j] * held[j]
        low.append(row)
        inverse.append(1.0 / diagonal)
    steep = _added([arms[i] * arms[i] * inverse[i] for i in own]).sum(axis=0, keepdims=True)
    pull = applied + _added([arms[i] * held[i] * inverse[i] for i in own]).sum(axis=0, keepdims=True)
    place = jnp.where(steep > 0, pull / jnp.where(steep > 0, steep, 1.0), 0.0)
    forces = [(arms[i] * place - held[i]) * inverse[i] for i in own]
    for i in reversed(own):
        for j in range(i):
            forces[j] = forces[j] - low[i][j] * forces[i]
    return place, [jnp.where(closed[i], forces[i], 0.0) for i in own]


def _steps(blocks: Matrix, lever: Each, gap: Each, applied: Array, loaded: Each) -> _Sets:
    """Search for the sets of closed contacts from a guess; arguments as for `_within`."""
    own, rounding = range(len(lever)), jnp.finfo(applied.dtype).eps * CLOSED

    def advance(at: _Sets) -> _Sets:
        place, forces = _within(blocks, lever, gap, applied, at.closed)
        wrong, chosen, holds = [], [], []
        for i in own:
            parts = [blocks[i][j] * forces[j] for j in own]
            turned = lever[i] * place
            reach = rounding * (_added([jnp.abs(part) for part in parts]) + jnp.abs(gap[i]) + jnp.abs(turned))
            overlaps = turned - gap[i] - _added(parts) > reach
            wrong.append(jnp.where(at.closed[i], forces[i] < 0, overlaps))
            chosen.append(jnp.where(at.closed[i], forces[i] > 0, overlaps))
            holds.append(chosen[i] & loaded[i])
        right = ~_any(wrong)
        # if no contact holds the output, the first contact of the loaded side is closed
        lacking = ~_any(holds)
        new = [jnp.where(right, at.closed[i], chosen[i] | (loaded[i] & (gap[i] == 0) & lacking)) for i in own]
        return _Sets(new, place, forces, right, at.step + 1)

    nothing, none = jnp.zeros_like(applied), [jnp.zeros_like(part) for part in gap]
    begin = _Sets(_guessed(blocks, lever, gap, applied, loaded), nothing, none, ~_any(loaded), jnp.zeros((), jnp.int32))
    return jax.lax.while_loop(lambda at: ~at.right.all() & (at.step < MOST_STEPS), advance, begin)


def _guessed(blocks: Matrix, lever: Each, gap: Each, applied: Array, loaded: Each) -> Each:
    """First guess of the sets of closed contacts, as if all contacts were independent springs.

    Each spring is somewhat stiffer than the contact is under equal forces on its whole block. From this guess the
    search needs half as many steps as from the set of all loaded contacts.
    """
    stiff = [STIFFER / _added([jnp.abs(entry) for entry in row]) for row in blocks]
    weight = [k * arm for k, arm in zip(stiff, lever, strict=True)]
    closed = loaded
    for _ in range(GUESSES):  # each pass is a step of Newton's method
        inside = [jnp.where(own, w, 0.0) for own, w in zip(closed, weight, strict=True)]
        steep = _added([w * arm for w, arm in zip(inside, lever, strict=True)]).sum(axis=0, keepdims=True)
        pull = applied + _added([w * rest for w, rest in zip(inside, gap, strict=True)]).sum(axis=0, keepdims=True)
        place = jnp.where(steep > 0, pull / jnp.where(steep > 0, steep, 1.0), 0.0)
        beyond = [arm * place > rest for arm, rest in zip(lever, gap, strict=True)]
        closed = [own & over for own, over in zip(loaded, beyond, strict=True)]
    some = _any(closed)
    return [jnp.where(some, own, all_of) for own, all_of in zip(closed, loaded, strict=True)]


def _of_sides(blocks: Matrix, lever: Each, gap: Each, applied: Array, loaded: Each) -> _Sets:
    """Search for the sets of closed contacts if the first half of the blocks has driving and the second back flanks.

    In each lane only the blocks of the loaded side are searched; the other blocks are only checked to stay open. A side
    that no lane needs is skipped.
    """
    half, rounding = lever[0].shape[0] // 2, jnp.finfo(applied.dtype).eps * CLOSED

    def side(number: Array) -> tuple:
        def part(given: Each, of: Array) -> Each:
            return [jax.lax.dynamic_slice_in_dim(each, of * half, half) for each in given]

        near, away = ([part(given, of) for given in (lever, gap, loaded)] for of in (number, 1 - number))
        ours = _any(near[2])

        def looked_at() -> tuple:
            at = _steps([part(row, number) for row in blocks], near[0], near[1], applied, near[2])
            beside = []
            for arm, room, holds in zip(*away, strict=True):
                turned = arm * at.place
                beside.append(holds | (turned - room > rounding * (jnp.abs(room) + jnp.abs(turned))))
            closed = [ours & each for each in at.closed]
            forces = [jnp.where(ours, each, 0.0) for each in at.forces]
            return closed, jnp.where(ours, at.place, 0.0), forces, at.right & ~_any(beside), at.step

        def left_out() -> tuple:
            nothing = [jnp.zeros_like(each) for each in near[1]]
            return near[2], jnp.zeros_like(applied), nothing, ~ours, jnp.zeros((), jnp.int32)

        *solution, right, step = jax.lax.cond(ours.any(), looked_at, left_out)
        return *solution, right | ~ours, step

    closed, place, forces, right, step = jax.lax.map(side, jnp.arange(2))
    whole = [[each.reshape(2 * half, -1) for each in given] for given in (closed, forces)]
    return _Sets(whole[0], place.sum(axis=0), whole[1], right.all(axis=0), step.max())


def _added(parts: Each) -> Array:
    """Sum over the contacts of a block."""
    return functools.reduce(jnp.add, parts)


def _any(parts: Each) -> Array:
    """Whether the condition is true for any contact of a lane, shape (1, lane)."""
    return functools.reduce(jnp.logical_or, parts).any(axis=0, keepdims=True)


def _laid_out(blocks: Array, *given: Array) -> tuple[Matrix, list[Each]]:
    """Arguments as one array for each contact of a block, with the last axes block and lane.

    Args:
        blocks: blocks of each lane, shape (lane, block, own, own), or common blocks, shape (block, own, own).
        given: arrays of shape (lane, contact).
    """
    number, own = blocks.shape[-3], blocks.shape[-1]
    behind = jnp.moveaxis(blocks, (-2, -1), (0, 1))
    behind = jnp.moveaxis(behind, 2, -1) if blocks.ndim == 4 else behind[..., None]
    each = [part.reshape(-1, number, own).transpose(2, 1, 0) for part in given]
    return [list(row) for row in behind], [list(part) for part in each]


def _in_order(parts: Each) -> Array:
    """An array of shape (lane, contact) from one array for each contact of a block."""
    each = jnp.stack(parts)
    return each.transpose(2, 1, 0).reshape(each.shape[2], -1)


def _searched(steps: Callable, blocks: Array, levers: Array, gap: Array, applied: Array, loaded: Array) -> tuple:
    """Search in many lanes, which have blocks of their own, shape (lane, block, own, own), or common blocks."""

    def part(levers: Array, gap: Array, applied: Array, loaded: Array, *apart: Array) -> tuple:
        own = apart[0] if apart else blocks
        matrix, (lever, rest, holds) = _laid_out(own, levers[..., 0], gap, loaded)
        at = steps(matrix, lever, rest, applied.T, holds)

        def exact(lane: Array) -> tuple:
            whole = block_diagonal(own[lane] if apart else own)
            return carrying(whole, levers[lane], gap[lane], applied[lane], loaded[lane], loaded[lane])

        done = (at.right & jnp.isfinite(at.place))[0]
        solutions = at.place.T, _in_order(at.forces), _in_order(at.closed), done
        return finished(solutions, done | ~loaded.any(axis=1), exact)

    return in_parts(part, LANES, levers, gap, applied, loaded, *([blocks] if blocks.ndim == 4 else []))


def _solved(blocks: Array, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
    """Linear problem with given sets of closed contacts in many lanes, with blocks as for `_searched`."""

    def part(levers: Array, rest: Array, applied: Array, closed: Array, *apart: Array) -> tuple:
        matrix, (lever, held, inside) = _laid_out(apart[0] if apart else blocks, levers[..., 0], rest, closed)
        place, forces = _within(matrix, lever, held, applied.T, inside)
        return place.T, _in_order(forces)

    return in_parts(part, LANES, levers, rest, applied, closed, *([blocks] if blocks.ndim == 4 else []))


def _lanes_of(many: Callable) -> Callable:
    """A function of one problem whose lanes under `jax.vmap` are solved side by side.

    Lanes that share their blocks use a single copy of them; other lanes have blocks of their own.

    Args:
        many: function of blocks, either of each lane or common ones, and of arrays with an axis of lanes in front.
    """

    @jax.custom_batching.custom_vmap
    def one(blocks: Array, *given: Array) -> tuple:
        solutions = many(blocks, *(part[None] for part in given))
        return jax.tree.map(lambda part: part[0], solutions)

    @jax.custom_batching.custom_vmap
    def shared(blocks: Array, *given: Array) -> tuple:
        return many(blocks, *given)

    @jax.custom_batching.custom_vmap
    def apart(blocks: Array, *given: Array) -> tuple:
        return many(blocks, *given)

    def spread(size: int, batched: list, given: tuple) -> list:
        each = zip(given, batched, strict=True)
        return [part if own else jnp.broadcast_to(part, (size, *part.shape)) for part, own in each]

    def flat(function: Callable, size: int, *given: Array) -> tuple:
        solutions = function(*(part.reshape(-1, *part.shape[2:]) for part in given))
        return jax.tree.map(lambda part: part.reshape(size, -1, *part.shape[1:]), solutions)

    @one.def_vmap
    def _(size: int, batched: list, *given: Array) -> tuple:
        lanes = spread(size, batched[1:], given[1:])
        solutions = (apart if batched[0] else shared)(given[0], *lanes)
        return solutions, jax.tree.map(lambda _: True, solutions)

    @shared.def_vmap
    def _(size: int, batched: list, *given: Array) -> tuple:
        lanes = spread(size, batched[1:], given[1:])
        if batched[0]:  # one matrix after the other, each with all its lanes
            solutions = jax.lax.map(lambda own: shared(*own), (given[0], *lanes))
        else:
            solutions = flat(lambda *flat_lanes: shared(given[0], *flat_lanes), size, *lanes)
        return solutions, jax.tree.map(lambda _: True, solutions)

    @apart.def_vmap
    def _(size: int, batched: list, *given: Array) -> tuple:
        lanes = spread(size, batched[1:], given[1:])
        if batched[0]:
            solutions = flat(apart, size, given[0], *lanes)
        else:  # the lanes that share a matrix are brought together
            across = [jnp.swapaxes(part, 0, 1) for part in lanes]
            solutions = jax.lax.map(lambda own: shared(*own), (given[0], *across))
            solutions = jax.tree.map(lambda part: jnp.swapaxes(part, 0, 1), solutions)
        return solutions, jax.tree.map(lambda _: True, solutions)

    return one


_search = _lanes_of(functools.partial(_searched, _steps))
_search_of_sides = _lanes_of(functools.partial(_searched, _of_sides))
_linear = _lanes_of(_solved)
