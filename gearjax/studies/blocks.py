"""Batches of any length in blocks of one shape, so that any number of points compiles once."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np


def in_blocks(evaluate: Callable[..., Any], size: int, *arrays: np.ndarray, done: Callable[[int], None] | None = None):
    """Results of a batched function, as numpy arrays, with the first axis of its arguments cut into blocks.

    Args:
        evaluate: function from arrays of ``size`` rows to a tree of arrays of ``size`` rows.
        size: number of rows of a block; the last block is padded with its last row.
        arrays: arrays of n rows each, n at least 1.
        done: called after each block with the number of rows that are finished.
    """
    number = len(arrays[0])
    results = []
    for begin in range(0, number, size):
        rows = np.minimum(np.arange(begin, begin + size), number - 1)
        results.append(jax.tree.map(np.asarray, evaluate(*(array[rows] for array in arrays))))
        if done is not None:
            done(min(begin + size, number))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:number], *results)
