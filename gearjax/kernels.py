"""Numbers that a compiled program works out once, and not again for each use."""

import jax.numpy as jnp

from gearjax.typing import Array


def once(*parts: Array) -> tuple[Array, ...]:
    """The same arrays of one shape, as parts of one array.

    On a processor, XLA works out elementwise operations, sines too, again in every kernel that uses them, in a kernel
    over pairs of points for each pair. It seldom does so with a concatenation of arrays that are used at several
    places: with three functions of 50 points in products of all pairs, this takes a tenth of the time.
    """
    shape = parts[0].shape
    return tuple(jnp.concatenate([part.ravel() for part in parts]).reshape(len(parts), *shape))
