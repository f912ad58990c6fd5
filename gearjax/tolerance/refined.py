"""The highest value of a curve between its samples, for curves that are quick to compute anywhere near a sample.

The samples are divided into groups. Around the best sample of each group the curve is computed at a few places, and
then close to the best of these. On CPUs most of the time goes into what surrounds this, unless it suits XLA: arrays
that are cheap to compute are computed anew for each use unless a loop stores them (barriers do not prevent it), and
the highest of some ten numbers is found one by one unless it is folded by pieces that vectorise.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Int, Scalar

GROUPS = 32  # groups of samples, at most
STEPS = 24  # places from one sample to the next
FIRST = np.arange(-STEPS, STEPS + 1, 8) / STEPS  # places around the best sample of a group, in spacings of samples
CLOSER = np.arange(-5, 6) / STEPS  # places around the best of these
PIECES = 12  # that are compared at once

Near = Callable[[Any, Int[Array, " group"], Float[Array, "place group"]], Float[Array, "place group"]]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def highest_between(near: Near, numbers: Any, values: Float[Array, " n"], sign: Scalar) -> Scalar:
    """Highest value of a curve times a sign, at its samples and between them, and the derivative at its place.

    Args:
        near: function from numbers on which the curve depends, numbers of samples from the second to the last but one,
            and places near each of these samples, from -1 to 1 in spacings of samples, to the curve at these places.
        numbers: the numbers on which the curve depends, a tree of arrays.
        values: the curve at the samples, shape (n,) with n at least 3, in the order of `in_search_order`.
        sign: 1, or -1 for the lowest value, with the other sign.
    """
    return _searched(near, numbers, values, sign)[0]


@highest_between.defjvp
def _highest_between_jvp(near: Near, primals: tuple, tangents: tuple) -> tuple[Scalar, Scalar]:
    value, sample, place = _searched(near, *primals)

    def there(numbers: Any) -> Scalar:
        return primals[2] * near(numbers, sample[None], place[None, None])[0, 0]

    return value, jax.jvp(there, primals[:1], tangents[:1])[1]


def _searched(
    near: Near, numbers: Any, values: Float[Array, " n"], sign: Scalar
) -> tuple[Scalar, Int[Array, ""], Scalar]:
    """The highest value, the number of the sample next to it, and its place near this sample."""
    # The first and the last sample are places near their neighbours; nothing beyond them belongs to the curve.
    samples = stored(jnp.clip(_best_of_groups(values, sign), 1, values.shape[0] - 2))
    first, closer = (jnp.asarray(places, values.dtype)[:, None] for places in (FIRST, CLOSER))
    tried = stored(sign * near(numbers, samples, jnp.broadcast_to(first, (len(FIRST), len(samples)))))
    best = first[jax.lax.argmax(tried, 0, jnp.int32), 0]
    places = jnp.clip(best[None] + closer, -1.0, 1.0)
    found = sign * near(numbers, samples, places)
    which = jax.lax.argmax(found.ravel(), 0, jnp.int32)
    return _top(found), samples[which % len(samples)], places.ravel()[which]


def in_search_order(number: int) -> np.ndarray:
    """Numbers of the samples of a curve in the order in which the search wants them, shape (number,).

    First come the first samples of all groups of neighbours, then all second ones and so on: groups are compared as a
    whole then.
    """
    starts, size = _groups(number)
    rows = starts + np.arange(size)[:, None]
    return rows[rows < np.append(starts[1:], number)]


def _groups(number: int) -> tuple[np.ndarray, int]:
    """First sample of each group of neighbours, and the size of the first group; others may be smaller by one."""
    count = min(GROUPS, number)
    size = -(-number // count)
    whole = number - (size - 1) * count
    return np.arange(count) * (size - 1) + np.minimum(np.arange(count), whole), size


@jax.jit
def _best_of_groups(values: Float[Array, " n"], sign: Scalar) -> Int[Array, " group"]:
    """Number of the highest sample, times the sign, of each group of values in search order."""
    starts, size = _groups(values.shape[0])
    count = len(starts)
    if size == 1:
        return jnp.asarray(starts, jnp.int32)
    # The values stay flat: the last row is shorter, and to make a table of the others would copy them in a batch.
    whole = (size - 1) * count
    places = jnp.asarray(np.repeat(np.arange(size - 1), count), values.dtype)
    pieces = [(sign * values[piece], places[piece]) for piece in _pieces(size - 1, count)]
    best, place = functools.reduce(_higher, pieces)
    while (length := len(best) // count) > 1:
        best, place = functools.reduce(_higher, [(best[piece], place[piece]) for piece in _pieces(length, count)])
    # a group that has no sample in the last row repeats its first one there
    rest = sign * jnp.concatenate([values[whole:], values[len(values) - whole : count]])
    _, place = _higher((best, place), (rest, jnp.full_like(rest, size - 1)))
    return jnp.asarray(starts, jnp.int32) + place.astype(jnp.int32)


def _pieces(rows: int, width: int) -> list[slice]:
    """Pieces of as many rows, equally long; the last two may overlap."""
    part = -(-rows // PIECES)
    return [slice(start * width, (start + part) * width) for start in _starts(rows, part)]


def _higher(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[Array, Array]:
    """The higher values of two arrays, and their places."""
    higher = other[0] > one[0]
    return jnp.where(higher, other[0], one[0]), jnp.where(higher, other[1], one[1])


def _starts(length: int, part: int) -> tuple[int, ...]:
    """Where parts of an array begin; the last two may overlap."""
    return *range(0, length - part, part), length - part


@jax.jit
def stored(values: Array) -> Array:
    """The same numbers, computed once for all their uses."""
    flat = values.ravel()
    first = flat[0]
    kept: Array = jax.lax.fori_loop(0, 2, lambda _, carried: carried.at[0].set(first), flat)
    return kept.reshape(values.shape)


@jax.jit
def _top(values: Float[Array, "place group"]) -> Scalar:
    """The highest number, by pieces that are compared as a whole."""
    for _ in range(2):  # over the places, and then over the groups
        while (length := values.shape[0]) > 1:
            part = -(-length // PIECES)
            values = functools.reduce(jnp.maximum, [values[start : start + part] for start in _starts(length, part)])
        values = values[0]
    return values
