"""Scan over the steps of a motion, with a derivative that costs little more than the scan.

Automatic differentiation of the loop would carry every tangent through every operation of every step. But a step is a
smooth function of position, last change and excitation. Its partial derivatives can therefore be computed for all steps
at once after the scan. The remaining recurrence is linear,

    dc_n+1 = (dc/dx)_n dx_n + (dc/dc)_n dc_n + b_n,     dx_n+1 = dx_n + dc_n+1

and its transpose is another linear recurrence, backwards. Forward and reverse mode follow from this one rule. The
excitation is computed from rows and constants: within each step in the scan, but for the derivative as a table, by a
few matrix products.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from gearjax.dependence import depends
from gearjax.typing import Array

ALIASED = 2048  # bytes; vectors that begin a multiple of it apart compete for the same lines of a cache
Step = Callable[[Array, Array, Any], Array]


def recur(
    step: Step, at: Callable[[Any], Any], table: Callable[[Any], Any], position: Array, change: Array, rows: Any
) -> tuple[tuple[Array, Array], Array]:
    """Position and change after the last step, and positions before each step.

    Args:
        step: function from position, last change and excitation of a step to the next change, all numbers.
        at: function from a row to the excitation of its step, a tree of numbers.
        table: the same function for all rows, with a tree of arrays.
        position, change: position and last change at the start.
        rows: a tree of arrays; the first axis is the step.
    """
    first = jax.tree.map(lambda column: column[0], rows)
    whole, constants = jax.closure_convert(lambda x, c, row: step(x, c, at(row)), position, change, first)
    tabulate, of_table = jax.closure_convert(table, rows)
    bare, of_step = jax.closure_convert(step, position, change, at(first))
    given = rows, tuple(constants), tuple(of_table), tuple(of_step)
    return _recur((whole, tabulate, bare), position, change, *given)


def _loop(step: Callable, position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
    def one(carry, row):
        position, change = carry
        change = step(position, change, row, *constants)
        return (_moved(position, change), change), position  # the new position as output would be computed twice

    return jax.lax.scan(one, (position, change), rows)


def _moved(position: Array, change: Array) -> Array:
    moved = position + change
    if moved.ndim == 0:
        return moved
    # no motion reaches the bounds; without the clamp XLA on CPUs makes the sum of two vectors twice as slow (jax 0.10)
    most = np.finfo(moved.dtype).max
    return jax.lax.clamp(-most, moved, most)


def _scan(step: Callable, position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
    @jax.custom_batching.custom_vmap
    def run(position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
        return _loop(step, position, change, rows, constants)

    @run.def_vmap
    def side_by_side(size: int, batched: Any, position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
        """The batch axis becomes the last one, so that every number of a step is one vector."""
        if not any(jax.tree.leaves(batched)):  # JAX asks for this where only the tangents are a batch, as in a Hessian
            return _loop(step, position, change, rows, constants), ((False, False), False)
        extra = _extra(size * position.dtype.itemsize)

        def laid(value: Array, batched: bool) -> Array:
            if not batched:
                return value
            last = jnp.moveaxis(value, 0, -1)
            return jnp.pad(last, [(0, 0)] * (last.ndim - 1) + [(0, extra)], mode="edge") if extra else last

        def lane(batched: Any) -> Any:
            return jax.tree.map(lambda one: -1 if one else None, batched)

        position, change = (
            laid(value, True) if one else jnp.broadcast_to(value, (size + extra, *value.shape))
            for value, one in zip((position, change), batched[:2], strict=True)
        )
        rows, constants = (
            jax.tree.map(laid, value, one) for value, one in zip((rows, constants), batched[2:], strict=True)
        )
        over = jax.vmap(step, (0, 0, lane(batched[2]), *lane(batched[3])))
        ended, path = _loop(over, position, change, rows, constants)
        ended, path = jax.tree.map(lambda lanes: lanes[..., :size], (ended, path))
        return (ended, path.T), ((True, True), True)

    return run(position, change, rows, constants)


def _extra(size: int) -> int:
    """Additional lanes, so that vectors of a size [bytes] do not begin at the same lines of a cache.

    A cache holds only few vectors that begin at the same lines.
    """
    return 8 if size % ALIASED == 0 else 0


def _primal(steps: tuple, position: Array, change: Array, rows: Any, constants: tuple, *of_parts: tuple) -> tuple:
    del of_parts  # used by the derivative only
    return _scan(steps[0], position, change, rows, constants)


_recur = jax.custom_jvp(_primal, nondiff_argnums=(0,))


@partial(_recur.defjvp, symbolic_zeros=True)
def _recur_jvp(steps: tuple, primals: tuple, tangents: tuple) -> tuple:
    _, change, rows, _, of_table, of_step = primals
    _, tabulate, step = steps
    (last, ended), path = _recur(steps, *primals)
    after = jnp.concatenate([path[1:], last[None]])
    changes = jnp.concatenate([change[None], after[:-1] - path[:-1]])

    def by_position(x: Array, c: Array, row: Any) -> Array:
        return jax.jvp(lambda x: step(x, c, row, *of_step), (x,), (jnp.ones_like(x),))[1]

    def by_change(x: Array, c: Array, row: Any) -> Array:
        return jax.jvp(lambda c: step(x, c, row, *of_step), (c,), (jnp.ones_like(c),))[1]

    def linear(carry, given):
        dx, dc = carry
        a, b, push = given
        dc = a * dx + b * dc + push
        return (dx + dc, dc), dx

    numbers, moving = _along(lambda rows, given: tabulate(rows, *given), (rows, of_table), (tangents[2], tangents[4]))
    slopes = (jax.vmap(slope)(path, changes, numbers) for slope in (by_position, by_change))
    driven = _driven(step, path, changes, (numbers, of_step), [*moving, *_ways(tangents[5])])
    start = (
        jnp.zeros_like(value) if isinstance(way, SymbolicZero) else way
        for value, way in zip(primals[:2], tangents[:2], strict=True)
    )
    (last_dot, ended_dot), path_dot = jax.lax.scan(linear, tuple(start), (*slopes, driven))
    return ((last, ended), path), ((last_dot, ended_dot), path_dot)


def _ways(tangents: Any) -> list[Array | None]:
    """Tangent of each leaf; ``None`` if the leaf is constant."""
    return [None if isinstance(way, SymbolicZero) else way for way in jax.tree.leaves(tangents)]


def _along(function: Callable, given: tuple, tangents: tuple) -> tuple[Any, list[Array | None]]:
    """Values of a function of trees, and the tangent of each leaf of the values; ``None`` if the leaf is constant."""
    values, tree = jax.tree.flatten(given)
    moved = {i: way for i, way in enumerate(_ways(tangents)) if way is not None}
    start = {i: values[i] for i in moved}

    def at(parts: dict) -> Any:
        return function(*jax.tree.unflatten(tree, [parts.get(i, value) for i, value in enumerate(values)]))

    outcome, along = jax.jvp(at, (start,), (moved,))
    return outcome, [
        way if moves else None for way, moves in zip(jax.tree.leaves(along), depends(at, start), strict=True)
    ]


def _driven(step: Callable, path: Array, changes: Array, given: tuple, ways: list[Array | None]) -> Array:
    """Tangent of the change of each step by its numbers and constants; constant leaves cost nothing.

    Args:
        step: function of position, last change, numbers and constants.
        path, changes: positions and changes of all steps.
        given: numbers of all steps, and constants.
        ways: tangents of the leaves of ``given``; ``None`` for constant leaves.
    """
    values, tree = jax.tree.flatten(given)
    moved = {i: way for i, way in enumerate(ways) if way is not None}
    if not moved:
        return jnp.zeros_like(path)
    stepped = len(jax.tree.leaves(given[0]))
    axes = [0 if i < stepped else None for i in range(len(values))]

    def one(x: Array, c: Array, values: list, ways: dict) -> Array:
        def at(parts: dict) -> Array:
            numbers, constants = jax.tree.unflatten(tree, [parts.get(i, value) for i, value in enumerate(values)])
            return step(x, c, numbers, *constants)

        return jax.jvp(at, ({i: values[i] for i in moved},), (ways,))[1]

    return jax.vmap(one, (0, 0, axes, {i: axes[i] for i in moved}))(path, changes, values, moved)
