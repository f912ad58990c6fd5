"""The best of several points, by an objective that is known over a part of the input angles at first."""

from collections.abc import Callable

import numpy as np

JUDGED = 16  # points that are evaluated on all angles at once
ALIKE = 1e-6  # share of the objective by which points are not told apart: many starts end at the same place


def judge(objectives: np.ndarray, ends: np.ndarray, exactly: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Put objectives over all angles in place of those over a part, from the best end on, until the best is exact.

    A part of the angles may show less than all of them. An end with an objective over a part must therefore not be
    compared with one over all.

    Args:
        objectives: objectives over a part of the angles, inf for a dropped start, shape (starts,); they are changed.
        ends: end points, shape (starts, free).
        exactly: function from points to objectives over all angles.

    Returns:
        Whether each objective is one over all angles, shape (starts,).
    """
    judged = np.zeros(len(objectives), bool)
    while True:
        best = objectives[judged].min(initial=np.inf)
        order = np.argsort(np.where(judged, np.inf, objectives), kind="stable")[:JUDGED]
        least = best - ALIKE * abs(best) if np.isfinite(best) else best
        first = order[~judged[order] & (objectives[order] < least)]
        if not len(first):
            above = np.maximum(objectives, np.nextafter(best, np.inf))  # so that the least one is judged
            objectives[:] = np.where(judged, objectives, above)
            return judged
        objectives[first], judged[first] = exactly(ends[first]), True
        objectives[first] = np.where(np.isfinite(objectives[first]), objectives[first], np.inf)
