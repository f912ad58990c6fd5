"""Least squares from many starts at once, by Levenberg-Marquardt steps; a problem computes its sums for all starts."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gearjax.identification.model import Normal

STEPS = 40
SETTLED = 1e-3  # variances of a row: a start ends at a step that gains less, a thirtieth of a standard error
RATTLING = 0.1  # variances of a row: after some failed steps a start ends if a step promises less (curves have kinks)
MOST_FAILED = 3
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-12, 1e10
UNSEEN = 1e-16  # a number stays if doubling it, or moving it by a unit, changes a smaller share of the sum of squares
SHORTEST = 1e-2  # share of a positive number that a step leaves at least
Sums = Callable[[np.ndarray], Normal]


class Known(NamedTuple):
    """Priors of the numbers: means, and precisions multiplied by the variance of a row, shape (number,) each.

    The precision is zero without a prior.
    """

    mean: np.ndarray
    precision: np.ndarray

    def added(self, sums: Normal, values: np.ndarray) -> Normal:
        """The sums with the priors added."""
        away = self.mean - values
        return Normal(
            sums.cost + (self.precision * away**2).sum(axis=1),
            sums.matrix + np.diag(self.precision),
            sums.slope + self.precision * away,
        )


def descend(
    sums: Sums, starts: np.ndarray, known: Known, allowed: np.ndarray, rows: float, steps: int = STEPS
) -> tuple[np.ndarray, Normal]:
    """Minimise the least-squares cost from all starts.

    Args:
        sums: function of points, shape (start, number), that returns their least-squares sums.
        starts: points to start from, shape (start, number).
        known: the priors.
        allowed: lowest and highest value of each number, shape (2, number).
        rows: number of rows in the sums.
        steps: largest number of steps.

    Returns:
        The ends, shape (start, number), and the sums there, with the priors.
    """
    values = starts.copy()
    found = known.added(sums(values), values)
    cost = np.where(np.isfinite(found.cost), found.cost, np.inf)
    matrix, slope = np.nan_to_num(found.matrix), np.nan_to_num(found.slope)
    damping = np.full(len(values), FIRST_DAMPING)
    done, failed = np.zeros(len(values), bool), np.zeros(len(values), int)
    for _ in range(steps):
        own = np.flatnonzero(~done)
        if not own.size:
            break
        seen = np.einsum("spp->sp", matrix[own]) * np.maximum(values[own] ** 2, 1.0) > UNSEEN * cost[own, None]
        step = _steps(matrix[own], slope[own], damping[own], seen)
        trial = values[own] + step
        floor = np.maximum(values[own] * SHORTEST, 1e-6)
        trial = np.where((allowed[0] >= 0) & (trial < floor), floor, trial)
        trial = np.clip(trial, *allowed)
        new = known.added(sums(trial), trial)
        promised = np.einsum("sp,sp->s", slope[own], step)
        variance = np.where(np.isfinite(cost[own]), cost[own], 0.0) / rows
        better = new.cost < cost[own]
        failed[own] = np.where(better, 0, failed[own] + 1)
        settled = better & (cost[own] - new.cost < SETTLED * variance)
        rattles = (failed[own] >= MOST_FAILED) & (promised < RATTLING * variance)
        done[own] = settled | (promised < SETTLED * variance) | rattles | (damping[own] > MOST_DAMPING)
        damping[own] *= np.where(better, 0.1, 10.0)
        damping = np.maximum(damping, LEAST_DAMPING)
        now = own[better]
        values[now], cost[now] = trial[better], new.cost[better]
        matrix[now], slope[now] = new.matrix[better], new.slope[better]
    return values, Normal(cost, matrix, slope)


def _steps(matrix: np.ndarray, slope: np.ndarray, damping: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Steps of all starts, each with its own damping; numbers that are not seen stay."""
    diagonal = np.einsum("spp->sp", matrix)
    scale = np.sqrt(np.where(seen, diagonal, 1.0))
    scaled = matrix / scale[:, :, None] / scale[:, None, :]
    eye = np.eye(matrix.shape[1])
    held = scaled + (damping[:, None] + 1e-13)[:, :, None] * eye + np.where(seen, 0.0, 1.0)[:, :, None] * eye
    return np.linalg.solve(held, (slope / scale)[..., None])[..., 0] / scale
