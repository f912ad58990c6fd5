"""Interpolation of signals at evenly spaced times, so that no sine has to be computed for every time.

The polynomial through a few Chebyshev nodes covers a block of steps. The fastest rate of the signal decides how many
nodes are needed.
"""

import math
from typing import Any

import numpy as np

MOST_NODES = 24


def accuracy(dtype: Any) -> float:
    """Accuracy of the interpolation, relative to a sine of the fastest rate; in float32 it is below rounding."""
    return 1e-10 if np.finfo(dtype).bits > 32 else 1e-8


def reach(number: int, accuracy: float) -> float:
    """Largest phase of a block that a number of nodes resolves to the given accuracy [rad]."""
    return 4 * (0.5 * accuracy * math.factorial(number)) ** (1 / number)


def nodes(steps: int, number: int) -> np.ndarray:
    """Places of the Chebyshev nodes of a block, in steps from its start, shape (node,)."""
    return 0.5 * steps * (1 - np.cos(np.pi * (np.arange(number) + 0.5) / number))


def weights(steps: int, number: int, at: np.ndarray) -> np.ndarray:
    """Weights of the nodes of a block for values at places in steps, shape (place, node).

    Source: Berrut and Trefethen 2004, eq. 4.2.
    """
    barycentric = (-1.0) ** np.arange(number) * np.sin(np.pi * (np.arange(number) + 0.5) / number)
    away = at[:, None] - nodes(steps, number)[None, :]
    met = np.isclose(away, 0, atol=1e-12)
    shares = barycentric / np.where(met, 1.0, away)
    shares /= shares.sum(axis=1, keepdims=True)
    return np.where(np.any(met, axis=1, keepdims=True), met, shares)
