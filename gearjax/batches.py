"""Rows of arrays through a function, so many side by side."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def in_batches(function: Callable[[Any], Any], rows: Any, most: int) -> Any:
    """Results of a function for each row, in even batches, so that XLA compiles the function once.

    ``jax.lax.map`` with a batch size compiles it again for the rows that are left over. Here the last batch is filled
    with its last row.

    Args:
        function: function from one row to a tree of arrays.
        rows: tree of arrays whose first axis is the row.
        most: largest number of rows of a batch.
    """
    number = len(jax.tree.leaves(rows)[0])
    if number <= most:
        return jax.vmap(function)(rows)
    size = math.ceil(number / math.ceil(number / most))
    missing = -number % size
    filled = jax.tree.map(lambda part: jnp.concatenate([part, jnp.repeat(part[-1:], missing, axis=0)]), rows)
    return jax.tree.map(lambda part: part[:number], jax.lax.map(function, filled, batch_size=size))
