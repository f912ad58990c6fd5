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
FIRST = np.arange(-STEPS, STEPS + 1, 4) / STEPS  # places around the best sample of a group, in spacings of samples
CLOSER = np.arange(-3, 4) / STEPS  # places around the best of these
PIECES = 8  # that are compared at once

Near = Callable[[Any, Int[Array, " group"], Float[Array, "place group"]], Float[Array, "place group"]]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def highest_between(near: Near, numbers: Any, values: Float[Array, " n"]) -> Scalar:
    """Highest value of a curve at its samples and between them, with the derivative at the place of that value.

    Args:
        near: function from numbers on which the curve depends, numbers of samples, and places near each of these
            samples, from -1 to 1 in spacings of samples, to the curve at these places.
        numbers: the numbers on which the curve depends, a tree of arrays.
        values: the curve at the samples, shape (n,).
    """
    return _searched(near, numbers, values)[0]


@highest_between.defjvp
def _highest_between_jvp(near: Near, primals: tuple, tangents: tuple) -> tuple[Scalar, Scalar]:
    value, sample, place = _searched(near, *primals)

    def there(numbers: Any) -> Scalar:
        return near(numbers, sample[None], place[None, None])[0, 0]

    return value, jax.jvp(there, primals[:1], tangents[:1])[1]


def _searched(near: Near, numbers: Any, values: Float[Array, " n"]) -> tuple[Scalar, Int[Array, ""], Scalar]:
    """The highest value, the number of the sample next to it, and its place near this sample."""
    samples = _best_of_groups(_stored(values))
    first, closer = (jnp.asarray(places, values.dtype)[:, None] for places in (FIRST, CLOSER))
    tried = _stored(near(numbers, samples, jnp.broadcast_to(first, (len(FIRST), len(samples)))))
    best = first[jax.lax.argmax(tried, 0, jnp.int32), 0]
    places = jnp.clip(best[None] + closer, -1.0, 1.0)
    found = near(numbers, samples, places)
    which = jax.lax.argmax(found.ravel(), 0, jnp.int32)
    return _top(found), samples[which % len(samples)], places.ravel()[which]


@jax.jit
def _best_of_groups(values: Float[Array, " n"]) -> Int[Array, " group"]:
    """Number of the highest sample of each of as many neighbouring groups as there are."""
    number = values.shape[0]
    size = -(-number // GROUPS)
    whole = number // size * size  # a group that is filled up would be computed anew, number by number
    starts = jnp.arange(0, whole, size, dtype=jnp.int32)
    samples = starts + _places_of_highest(values[:whole].reshape(-1, size))
    if whole == number:
        return samples
    return jnp.concatenate([samples, whole + _places_of_highest(values[None, whole:])])


def _places_of_highest(rows: Float[Array, "group size"]) -> Int[Array, " group"]:
    """Place of the highest number of each row; `jax.numpy.argmax` takes five times as long."""
    places = jnp.arange(rows.shape[1], dtype=rows.dtype)
    marked = jnp.where(rows == rows.max(axis=1, keepdims=True), places, 0.0)
    return marked.max(axis=1).astype(jnp.int32)


@jax.jit
def _stored(values: Float[Array, "..."]) -> Float[Array, "..."]:
    """The same numbers, computed once for all their uses."""
    return jax.lax.scan(lambda carried, _: (carried, carried), values, None, length=2)[1][0]


@jax.jit
def _top(values: Float[Array, "place group"]) -> Scalar:
    """The highest number, by pieces that are compared as a whole."""
    for _ in range(2):  # over the places, and then over the groups
        while (length := values.shape[0]) > 1:
            part = -(-length // PIECES)
            starts = (*range(0, length - part, part), length - part)
            values = functools.reduce(jnp.maximum, [values[start : start + part] for start in starts])
        values = values[0]
    return values
