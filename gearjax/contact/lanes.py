"""Batching rules of `jax.vmap` for many problems with one common matrix.

A lane is one problem of a batch.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from gearjax.typing import Array, Bool


def side_by_side(one: Callable, many: Callable, one_factor: tuple[int, ...] = ()) -> Callable:
    """A function whose lanes under `jax.vmap` are solved together if they share the matrix.

    Args:
        one: function of a matrix and further arrays.
        many: the same function for further arrays with an axis of lanes in front.
        one_factor: numbers of the arguments that a factorisation in ``one`` depends on. If none of them differs between
            lanes, the factorisation is calculated once.

    Returns:
        The function. Nested lanes become one axis. If the matrices differ, they are treated one after the other, each
        with all lanes that share it.
    """
    alone, together = jax.custom_batching.custom_vmap(one), jax.custom_batching.custom_vmap(many)

    def each(function: Callable, given: list, batched: list) -> tuple:
        """Apply a function to one matrix after the other, with the arguments that belong to it."""

        def at(own: list) -> tuple:
            taken = iter(own)
            return function(
                *(next(taken) if with_axis else part for part, with_axis in zip(given, batched, strict=True))
            )

        return jax.lax.map(at, [part for part, with_axis in zip(given, batched, strict=True) if with_axis])

    def over(size: int, batched: list, *given: Array) -> tuple:
        if one_factor and not any(batched[place] for place in one_factor):
            out = jax.vmap(one, [0 if own else None for own in batched])(*given)
        elif batched[0]:
            out = each(alone, list(given), batched)
        else:
            out = together(given[0], *_broadcast(size, batched[1:], given[1:]))
        return out, jax.tree.map(lambda _: True, out)

    def merged(size: int, batched: list, *given: Array) -> tuple:
        if batched[0]:
            out = each(together, list(given), batched)
        else:
            lanes = _broadcast(size, batched[1:], given[1:])
            flat = together(given[0], *(part.reshape(-1, *part.shape[2:]) for part in lanes))
            out = jax.tree.map(lambda part: part.reshape(size, -1, *part.shape[1:]), flat)
        return out, jax.tree.map(lambda _: True, out)

    alone.def_vmap(over)
    together.def_vmap(merged)
    return alone


def _broadcast(size: int, batched: list, given: tuple) -> list:
    """The arguments with an axis of lanes each."""
    return [
        part if own else jnp.broadcast_to(part, (size, *part.shape)) for part, own in zip(given, batched, strict=True)
    ]


def in_parts(function: Callable, most: int, *given: Array) -> tuple:
    """Apply a function to many lanes, at most ``most`` lanes at a time, so that their numbers stay in the cache."""
    lanes = given[0].shape[0]
    if lanes <= most:
        return function(*given)
    parts = -(-lanes // most)
    each = -(-lanes // parts)
    index = jnp.minimum(jnp.arange(parts * each), lanes - 1).reshape(parts, each)  # copies of the last lane fill up
    out = jax.lax.map(lambda own: function(*(part[own] for part in given)), index)
    return jax.tree.map(lambda part: part.reshape(parts * each, *part.shape[2:])[:lanes], out)


def finished(out: tuple, done: Bool[Array, " lane"], exact: Callable) -> tuple:
    """Results of all lanes; unfinished lanes get theirs from the function ``exact``, one after the other."""

    def one(state: tuple) -> tuple:
        out, done = state
        lane = jnp.argmin(done)
        values = exact(lane)
        out = tuple(part.at[lane].set(value) for part, value in zip(out, values, strict=True))
        return out, done.at[lane].set(True)

    return jax.lax.while_loop(lambda state: ~state[1].all(), one, (out, done))[0]
