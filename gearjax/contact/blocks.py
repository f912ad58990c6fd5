"""Active-set method for contacts that are coupled within blocks only, such as one pair of teeth, in many lanes.

A lane is one problem of a batch; all lanes are solved at once. The steps are those of `active_set`: each solves the
linear problem of one set of closed contacts, and the signs of the result give the next set. The blocks have only the
position in common. Each block therefore has a factorisation of its own: that of a small block is written out over its
contacts (`Rows`), that of slices of a tooth face goes along the face (`faces`). The last axes of all arrays are blocks
and lanes, so that they vectorise. Lanes whose sets repeat in a cycle count as not found.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from gearjax.contact.active_set import CLOSED, carrying
from gearjax.contact.faces import Faces, Sweeps
from gearjax.contact.lanes import finished, in_parts
from gearjax.contact.rows import Each, Rows, total
from gearjax.contact.springs import CoupledSprings
from gearjax.typing import Array, Bool, Float, Int

MOST_OWN = 8  # contacts of a block; with more, the program would become too large
MOST_STEPS = 24  # steps of all lanes together: hardly any problem needs more than 10
WORTH_SHARING = 32  # lanes that share their faces; with fewer, sweeps along the face take longer than copies of them
LANES = 128  # lanes at a time, so that their numbers stay in the cache


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


def search_of_blocks(
    sided: bool, blocks: Array | Faces, levers: Array, gap: Array, applied: Array, loaded: Array
) -> tuple:
    """Position, forces, the set of contacts that carry, and whether it was found, as from `active_set.carrying`.

    Args:
        sided: whether the first half of the contacts has driving flanks and the second half as many back flanks. If no
            block has both, the search treats only the side that the load presses, and checks that the other one is
            open.
        blocks: approach of each contact per force on each contact of its block, shape (block, own, own) [m/N]; or
            faces.
        levers: lever of each contact, shape (contact, 1) [m/rad].
        gap: gaps at position zero, shape (contact,) [m].
        applied: generalised force, shape (1,) [N m].
        loaded: whether each contact can hold against the load, shape (contact,).
    """
    number = len(blocks.own) if isinstance(blocks, Faces) else len(blocks)
    apart = sided and number % 2 == 0  # with an odd number of blocks, one block has flanks of both sides
    return (_search_of_sides if apart else _search)(blocks, levers, gap, applied, loaded)


def solved_of_blocks(blocks: Array | Faces, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
    """Position, shape (1,), and forces with a given set of closed contacts, as from `active_set.solved`."""
    return _linear(blocks, levers, rest, applied, closed)


def _steps(matrix: Rows | Sweeps, lever: Each, gap: Each, applied: Array, loaded: Each) -> _Sets:
    """Search for the sets of closed contacts from a guess; arguments as for `Rows.tried`."""
    own, rounding = range(len(lever)), jnp.finfo(applied.dtype).eps * CLOSED

    def advance(at: _Sets) -> _Sets:
        place, forces, approach, size = matrix.tried(lever, gap, applied, at.closed)
        wrong, chosen, holds = [], [], []
        for i in own:
            turned = lever[i] * place
            reach = rounding * (size[i] + jnp.abs(gap[i]) + jnp.abs(turned))
            overlaps = turned - gap[i] - approach[i] > reach
            wrong.append(jnp.where(at.closed[i], forces[i] < 0, overlaps))
            chosen.append(jnp.where(at.closed[i], forces[i] > 0, overlaps))
            holds.append(chosen[i] & loaded[i])
        right = ~_any(wrong)
        # if no contact holds the output, the first contact of the loaded side is closed
        lacking = ~_any(holds)
        new = [jnp.where(right, at.closed[i], chosen[i] | (loaded[i] & (gap[i] == 0) & lacking)) for i in own]
        return _Sets(new, place, forces, right, at.step + 1)

    nothing, none = jnp.zeros_like(applied), [jnp.zeros_like(part) for part in gap]
    begin = _Sets(_guessed(matrix, lever, gap, applied, loaded), nothing, none, ~_any(loaded), jnp.zeros((), jnp.int32))
    return jax.lax.while_loop(lambda at: ~at.right.all() & (at.step < MOST_STEPS), advance, begin)


def _guessed(matrix: Rows | Sweeps, lever: Each, gap: Each, applied: Array, loaded: Each) -> Each:
    """First guess of the sets of closed contacts, as if all contacts were independent springs.

    Each spring is somewhat stiffer than the contact is under equal forces on its whole block. From this guess the
    search needs half as many steps as from the set of all loaded contacts.
    """
    stiff = [matrix.stiffer / soft for soft in matrix.softness]
    weight = [k * arm for k, arm in zip(stiff, lever, strict=True)]
    closed = loaded
    for _ in range(matrix.guesses):  # each pass is a step of Newton's method
        inside = [jnp.where(own, w, 0.0) for own, w in zip(closed, weight, strict=True)]
        steep = total([w * arm for w, arm in zip(inside, lever, strict=True)])
        pull = applied + total([w * rest for w, rest in zip(inside, gap, strict=True)])
        place = jnp.where(steep > 0, pull / jnp.where(steep > 0, steep, 1.0), 0.0)
        beyond = [arm * place > rest for arm, rest in zip(lever, gap, strict=True)]
        closed = [own & over for own, over in zip(loaded, beyond, strict=True)]
    some = _any(closed)
    return [jnp.where(some, own, all_of) for own, all_of in zip(closed, loaded, strict=True)]


def _of_sides(matrix: Rows | Sweeps, lever: Each, gap: Each, applied: Array, loaded: Each) -> _Sets:
    """Search for the sets of closed contacts if the first half of the blocks has driving and the second back flanks.

    In each lane only the blocks of the loaded side are searched; the other blocks are only checked to stay open. A side
    that no lane needs is skipped.
    """
    half, rounding = lever[0].shape[-2] // 2, jnp.finfo(applied.dtype).eps * CLOSED

    def side(number: Array) -> tuple:
        def part(given: Each, of: Array) -> Each:
            return [jax.lax.dynamic_slice_in_dim(each, of * half, half, axis=each.ndim - 2) for each in given]

        near, away = ([part(given, of) for given in (lever, gap, loaded)] for of in (number, 1 - number))
        ours = _any(near[2])

        def looked_at() -> tuple:
            at = _steps(matrix.of_side(number, half), near[0], near[1], applied, near[2])
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
    whole = [[_both_sides(each) for each in given] for given in (closed, forces)]
    return _Sets(whole[0], place.sum(axis=0), whole[1], right.all(axis=0), step.max())


def _both_sides(part: Array) -> Array:
    """Blocks of both sides one after the other, from an array with an axis of sides in front."""
    apart = jnp.moveaxis(part, 0, -3)
    return apart.reshape(*apart.shape[:-3], -1, apart.shape[-1])


def _any(parts: Each) -> Array:
    """Whether the condition is true for any contact of a lane, with the shape of `total`."""
    whole = functools.reduce(jnp.logical_or, parts)
    return whole.any(axis=tuple(range(whole.ndim - 1)), keepdims=True)


def _laid_out(blocks: Array | Faces, applied: Array, *given: Array) -> tuple[Rows | Sweeps, Array, list[Each]]:
    """Arguments with the last axes block and lane: one array for each contact of a small block, or one of all slices.

    Args:
        blocks: blocks of each lane, shape (lane, block, own, own), or common blocks, shape (block, own, own); or faces.
        applied: generalised force, shape (lane, 1).
        given: arrays of shape (lane, contact).
    """
    own = blocks.own.shape[-1] if isinstance(blocks, Faces) else blocks.shape[-1]
    number = given[0].shape[1] // own
    each = [part.reshape(-1, number, own).transpose(2, 1, 0) for part in given]
    if isinstance(blocks, Faces):
        return Sweeps.of(blocks), applied.T[None], [[part] for part in each]
    return Rows.of(blocks), applied.T, [list(part) for part in each]


def _in_order(parts: Each) -> Array:
    """An array of shape (lane, contact) from one array for each contact of a block, or from one of all slices."""
    each = parts[0] if parts[0].ndim == 3 else jnp.stack(parts)
    return each.transpose(2, 1, 0).reshape(each.shape[2], -1)


def _each_has(blocks: Array | Faces) -> bool:
    """Whether each lane has blocks of its own."""
    return blocks.own.ndim == 3 if isinstance(blocks, Faces) else blocks.ndim == 4


def _with_lanes(part: Callable, blocks: Array | Faces, *given: Array) -> tuple:
    """Apply a function of blocks and lanes to some lanes at a time."""
    apart, structure = jax.tree.flatten(blocks) if _each_has(blocks) else ([], None)
    count = len(given)

    def own(*some: Array) -> tuple:
        return part(jax.tree.unflatten(structure, some[count:]) if structure else blocks, *some[:count])

    return in_parts(own, LANES, *given, *apart)


def _searched(
    steps: Callable, blocks: Array | Faces, levers: Array, gap: Array, applied: Array, loaded: Array
) -> tuple:
    """Search in many lanes, which have blocks of their own or common ones; `_laid_out` tells the shapes."""

    def part(own: Array | Faces, levers: Array, gap: Array, applied: Array, loaded: Array) -> tuple:
        matrix, load, (lever, rest, holds) = _laid_out(own, applied, levers[..., 0], gap, loaded)
        at = steps(matrix, lever, rest, load, holds)

        def exact(lane: Array) -> tuple:
            whole = CoupledSprings(jax.tree.map(lambda each: each[lane], own) if _each_has(own) else own).influence
            return carrying(whole, levers[lane], gap[lane], applied[lane], loaded[lane], loaded[lane])

        done = (at.right & jnp.isfinite(at.place)).ravel()
        solutions = at.place.reshape(-1, 1), _in_order(at.forces), _in_order(at.closed), done
        return finished(solutions, done | ~loaded.any(axis=1), exact)

    return _with_lanes(part, blocks, levers, gap, applied, loaded)


def _solved(blocks: Array | Faces, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
    """Linear problem with given sets of closed contacts in many lanes, with blocks as for `_searched`."""

    def part(own: Array | Faces, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
        matrix, load, (lever, held, inside) = _laid_out(own, applied, levers[..., 0], rest, closed)
        place, forces, *_ = matrix.tried(lever, held, load, inside)
        return place.reshape(-1, 1), _in_order(forces)

    return _with_lanes(part, blocks, levers, rest, applied, closed)


def _lanes_of(many: Callable) -> Callable:
    """A function of one problem whose lanes under `jax.vmap` are solved side by side.

    Lanes that share their blocks use a single copy of them; other lanes have blocks of their own.

    Args:
        many: function of blocks, either of each lane or common ones, and of arrays with an axis of lanes in front.
    """

    @jax.custom_batching.custom_vmap
    def one(blocks: Array | Faces, *given: Array) -> tuple:
        solutions = many(blocks, *(part[None] for part in given))
        return jax.tree.map(lambda part: part[0], solutions)

    @jax.custom_batching.custom_vmap
    def shared(blocks: Array | Faces, *given: Array) -> tuple:
        return many(blocks, *given)

    @jax.custom_batching.custom_vmap
    def apart(blocks: Array | Faces, *given: Array) -> tuple:
        return many(blocks, *given)

    def spread(size: int, batched: Sequence, given: Sequence) -> list:
        each = zip(given, batched, strict=True)
        return [part if own else jnp.broadcast_to(part, (size, *part.shape)) for part, own in each]

    def own_blocks(size: int, batched: bool | Faces, blocks: Array | Faces) -> Array | Faces | None:
        """Blocks with an axis of lanes, or ``None`` if all lanes have the same ones."""
        flags, (numbers, structure) = jax.tree.leaves(batched), jax.tree.flatten(blocks)
        return jax.tree.unflatten(structure, spread(size, flags, numbers)) if any(flags) else None

    def flat(function: Callable, size: int, *given: Array | Faces) -> tuple:
        solutions = function(*jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), given))
        return jax.tree.map(lambda part: part.reshape(size, -1, *part.shape[1:]), solutions)

    @one.def_vmap
    def _(size: int, batched: list, *given: Any) -> tuple:
        lanes, own = spread(size, batched[1:], given[1:]), own_blocks(size, batched[0], given[0])
        solutions = shared(given[0], *lanes) if own is None else apart(own, *lanes)
        return solutions, jax.tree.map(lambda _: True, solutions)

    @shared.def_vmap
    def _(size: int, batched: list, *given: Any) -> tuple:
        lanes, own = spread(size, batched[1:], given[1:]), own_blocks(size, batched[0], given[0])
        if own is not None:  # one matrix after the other, each with all its lanes
            solutions = jax.lax.map(lambda each: shared(*each), (own, *lanes))
        else:
            solutions = flat(lambda *flat_lanes: shared(given[0], *flat_lanes), size, *lanes)
        return solutions, jax.tree.map(lambda _: True, solutions)

    @apart.def_vmap
    def _(size: int, batched: list, *given: Any) -> tuple:
        lanes, own = spread(size, batched[1:], given[1:]), own_blocks(size, batched[0], given[0])
        if own is not None:
            solutions = flat(apart, size, own, *lanes)
        elif isinstance(given[0], Faces) and size < WORTH_SHARING:
            copies = jax.tree.map(lambda part: jnp.broadcast_to(part, (size, *part.shape)), given[0])
            solutions = flat(apart, size, copies, *lanes)
        else:  # the lanes that share a matrix are brought together
            across = [jnp.swapaxes(part, 0, 1) for part in lanes]
            solutions = jax.lax.map(lambda own: shared(*own), (given[0], *across))
            solutions = jax.tree.map(lambda part: jnp.swapaxes(part, 0, 1), solutions)
        return solutions, jax.tree.map(lambda _: True, solutions)

    return one


_search = _lanes_of(functools.partial(_searched, _steps))
_search_of_sides = _lanes_of(functools.partial(_searched, _of_sides))
_linear = _lanes_of(_solved)
