"""The scan over the steps of a motion, with a derivative that costs little more than the scan.

A derivative of the loop by the rules would carry every tangent through every operation of every step. But a step is a
smooth function of position, last change and what drives it, so its partial derivatives can be worked out for all steps
at once, after the scan; what is left in sequence is the linear recurrence

    dc_n+1 = (dc/dx)_n dx_n + (dc/dc)_n dc_n + b_n,     dx_n+1 = dx_n + dc_n+1

whose transpose is another one, backwards. Both modes follow from this one rule.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from gearjax.typing import Array

ALIASED = 2048  # bytes; beginnings of vectors a multiple of it apart fight for the same places of a cache
Step = Callable[[Array, Array, Any], Array]


def recur(step: Step, position: Array, change: Array, rows: Any) -> tuple[tuple[Array, Array], Array]:
    """Positions before each step, and position and change after the last.

    Args:
        step: from position, last change and a row to the next change, numbers.
        position, change: at the start.
        rows: a tree of arrays, their first axis the steps.
    """
    first = jax.tree.map(lambda column: column[0], rows)
    converted, constants = jax.closure_convert(step, position, change, first)
    return _recur(converted, position, change, rows, tuple(constants))


def _loop(step: Callable, position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
    def one(carry, row):
        position, change = carry
        change = step(position, change, row, *constants)
        return (_moved(position, change), change), position  # an output that takes no work is not worked out twice

    return jax.lax.scan(one, (position, change), rows)


def _moved(position: Array, change: Array) -> Array:
    moved = position + change
    if moved.ndim == 0:
        return moved
    # the bounds matter to no motion: XLA's CPU compiler makes a bare sum of two vectors take twice as long (jax 0.10)
    most = np.finfo(moved.dtype).max
    return jax.lax.clamp(-most, moved, most)


def _scan(step: Callable, position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
    @jax.custom_batching.custom_vmap
    def run(position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
        return _loop(step, position, change, rows, constants)

    @run.def_vmap
    def side_by_side(size: int, batched: Any, position: Array, change: Array, rows: Any, constants: tuple) -> tuple:
        """Lanes last, so that every number of a step is one vector."""
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
    """Lanes that keep vectors of a size [bytes] from beginning at the same places of a processor's cache, which holds
    few of such."""
    return 8 if size % ALIASED == 0 else 0


_recur = jax.custom_jvp(_scan, nondiff_argnums=(0,))


@partial(_recur.defjvp, symbolic_zeros=True)
def _recur_jvp(step: Callable, primals: tuple, tangents: tuple) -> tuple:
    position, change, rows, constants = primals
    (last, ended), path = _recur(step, position, change, rows, constants)
    after = jnp.concatenate([path[1:], last[None]])
    changes = jnp.concatenate([change[None], after[:-1] - path[:-1]])

    def by_position(x: Array, c: Array, row: Any) -> Array:
        return jax.jvp(lambda x: step(x, c, row, *constants), (x,), (jnp.ones_like(x),))[1]

    def by_change(x: Array, c: Array, row: Any) -> Array:
        return jax.jvp(lambda c: step(x, c, row, *constants), (c,), (jnp.ones_like(c),))[1]

    def linear(carry, given):
        dx, dc = carry
        a, b, push = given
        dc = a * dx + b * dc + push
        return (dx + dc, dc), dx

    slopes = (jax.vmap(slope)(path, changes, rows) for slope in (by_position, by_change))
    driven = _driven(step, path, changes, (rows, constants), tangents[2:])
    start = (
        jnp.zeros_like(value) if isinstance(way, SymbolicZero) else way
        for value, way in zip(primals[:2], tangents[:2], strict=True)
    )
    (last_dot, ended_dot), path_dot = jax.lax.scan(linear, tuple(start), (*slopes, driven))
    return ((last, ended), path), ((last_dot, ended_dot), path_dot)


def _driven(step: Callable, path: Array, changes: Array, given: tuple, ways: tuple) -> Array:
    """What each step's change moves by along a way of rows and constants; those that stay as they are cost nothing."""
    values, tree = jax.tree.flatten(given)
    moved = {i: way for i, way in enumerate(jax.tree.leaves(ways)) if not isinstance(way, SymbolicZero)}
    if not moved:
        return jnp.zeros_like(path)
    stepped = len(jax.tree.leaves(given[0]))
    axes = [0 if i < stepped else None for i in range(len(values))]

    def one(x: Array, c: Array, values: list, ways: dict) -> Array:
        def at(parts: dict) -> Array:
            row, constants = jax.tree.unflatten(tree, [parts.get(i, value) for i, value in enumerate(values)])
            return step(x, c, row, *constants)

        return jax.jvp(at, ({i: values[i] for i in moved},), (ways,))[1]

    return jax.vmap(one, (0, 0, axes, {i: axes[i] for i in moved}))(path, changes, values, moved)
