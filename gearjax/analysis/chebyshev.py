"""Signals at evenly spaced times, without a sine for every time.

A block of steps is covered by the polynomial through a few Chebyshev nodes; how many it takes follows from the fastest
rate of the signal.
"""

import math
from typing import Any

import numpy as np

MOST_NODES = 24


def accuracy(dtype: Any) -> float:
    """Of the interpolation, relative to a sine of the fastest rate; in float32 below what that rounds."""
    return 1e-10 if np.finfo(dtype).bits > 32 else 1e-8


def reach(number: int, accuracy: float) -> float:
    """Largest phase per block that a number of nodes resolves to an accuracy [rad]."""
    return 4 * (0.5 * accuracy * math.factorial(number)) ** (1 / number)


def nodes(steps: int, number: int) -> np.ndarray:
    """Chebyshev nodes of a block in steps, shape (node,)."""
    return 0.5 * steps * (1 - np.cos(np.pi * (np.arange(number) + 0.5) / number))


def weights(steps: int, number: int, at: np.ndarray) -> np.ndarray:
    """Weights of the nodes of a block at places in steps, shape (place, node) (Berrut and Trefethen 2004, eq. 4.2)."""
    barycentric = (-1.0) ** np.arange(number) * np.sin(np.pi * (np.arange(number) + 0.5) / number)
    away = at[:, None] - nodes(steps, number)[None, :]
    met = np.isclose(away, 0, atol=1e-12)
    shares = barycentric / np.where(met, 1.0, away)
    shares /= shares.sum(axis=1, keepdims=True)
    return np.where(np.any(met, axis=1, keepdims=True), met, shares)
