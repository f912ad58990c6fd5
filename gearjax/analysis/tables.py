"""Signals at evenly spaced times, without a sine for every time.

A block of steps is covered by the polynomial through a few Chebyshev nodes; how many it takes follows from the fastest
rate of the signal.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.extend.core import Literal

MOST_NODES = 24


def accuracy(dtype: Any) -> float:
    """Of the interpolation, relative to a sine of the fastest rate; in float32 below what that rounds."""
    return 1e-10 if np.finfo(dtype).bits > 32 else 1e-8


def reach(number: int, dtype: Any) -> float:
    """Largest phase per block that a number of nodes resolves [rad]."""
    return 4 * (0.5 * accuracy(dtype) * math.factorial(number)) ** (1 / number)


def interpolation(steps: int, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev nodes in steps, shape (node,), and the weights of the steps of a block and of the one after it, shape
    (steps + 1, node)."""
    angles = np.pi * (np.arange(number) + 0.5) / number
    places = 0.5 * steps * (1 - np.cos(angles))
    barycentric = (-1.0) ** np.arange(number) * np.sin(angles)
    away = np.arange(steps + 1)[:, None] - places[None, :]
    met = np.isclose(away, 0, atol=1e-12)
    weights = barycentric / np.where(met, 1.0, away)
    weights /= weights.sum(axis=1, keepdims=True)
    return places, np.where(np.any(met, axis=1, keepdims=True), met, weights)


def depends(function: Callable[[Any], Any], argument: Any) -> list[bool]:
    """Which results of a function, the leaves of a tree, depend on its argument, from its program."""
    program = jax.make_jaxpr(function)(argument).jaxpr
    touched = set(program.invars)
    for equation in program.eqns:
        if any(not isinstance(atom, Literal) and atom in touched for atom in equation.invars):
            touched |= set(equation.outvars)
    return [not isinstance(atom, Literal) and atom in touched for atom in program.outvars]
