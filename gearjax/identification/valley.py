"""Flat valleys of a least-squares problem: points between ends that fit equally well."""

from typing import NamedTuple

import numpy as np

from gearjax.identification.model import Normal
from gearjax.identification.search import Known, Sums, descend

BESIDE = 0.25, 0.75  # places on the way from the best end to another that are tried if its middle fits as well
SLIDE = 0.25  # share of the cost that still counts as equally good, which a pull towards zero may add
STEPS = 8
FLAT = 25.0  # variances of a row by which points that fit equally well may exceed the best end, which follows the noise


class Valley(NamedTuple):
    """What lies between the best end of a search and the others.

    Args:
        points: points inside the valley, shape (k, number).
        matrix: their ``J^T W J``, with the priors, shape (k, number, number).
        joined: for each end, whether all points on the way to it from the best one fit equally well.
    """

    points: np.ndarray
    matrix: np.ndarray
    joined: np.ndarray


def between(
    sums: Sums,
    ends: np.ndarray,
    best: Normal,
    known: Known,
    errors: np.ndarray,
    allowed: np.ndarray,
    variance: float,
) -> Valley:
    """Look for points between ends that fit equally well.

    A search that stops at the rim of a flat valley sees a slope on one side, so that its sums seem to determine what
    the inside of the valley hides. The ways from the best end to the others lead through the inside. So does the way to
    the end that a weak pull of the errors towards zero reaches, if all other searches stopped at the same rim.

    Args:
        sums: function that returns the sums of points, without the priors.
        ends: equally good ends, the best one first, shape (end, number).
        best: sums of the best end with the priors.
        known: the priors.
        errors: whether each number is an error, whose nominal value is zero, shape (number,).
        allowed: lowest and highest value of each number, shape (2, number).
        variance: variance of a row of weight one [arcmin^2].
    """
    most = FLAT * variance
    first = ends[0]
    pull = SLIDE * most / max(float((first[errors] ** 2).sum()), 1e-300)
    precision = known.precision + np.where(errors, pull, 0.0)
    mean = known.mean * known.precision / np.where(precision > 0, precision, 1.0)
    held = Known(np.where(errors, mean, known.mean), precision)
    slid, _ = descend(sums, first[None], held, allowed, max(float(best.cost[0]) / variance, 1.0), STEPS)
    others = np.concatenate([ends[1:], slid])
    middles = first + 0.5 * (others - first)
    there = known.added(sums(middles), middles)
    flat = there.cost < best.cost[0] + most  # also without nan
    if flat.any():
        ways = np.concatenate([first + share * (others[flat] - first) for share in BESIDE])
        cost = known.added(sums(ways), ways).cost.reshape(len(BESIDE), -1)
        flat[flat] = np.all(cost < best.cost[0] + most, axis=0)
    return Valley(middles[flat], there.matrix[flat], np.concatenate([[True], flat[:-1]]))
