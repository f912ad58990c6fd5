"""Fit of the unknowns: many starts on means over steps of the angle; the best are refined on all rows.

Outlying rows get less weight.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from gearjax.checks import GearjaxError
from gearjax.identification.measurement import Measurement, binned
from gearjax.identification.model import Model, Normal, Problem
from gearjax.identification.rows import Rows, Trend, Wave, further
from gearjax.identification.search import Known, Sums, descend
from gearjax.identification.valley import between
from gearjax.identification.weights import noise_of, of_outliers, of_recordings, spread_of
from gearjax.scene import Scene

BINS = 256  # steps per turn of the output; means over them bias fast waves, so they serve the starts only
PER_TURN = 12  # steps per cycle of the highest order, at least
MOST_BINS = 2000  # of one recording
ROUGH_STEPS = 20
NEAR = 0.5  # of the least cost on the means: excess up to which a start is refined
POLISHED, FLATTEST = 4, 2  # starts refined: the best, and those of the good ones whose sums have the lowest rank
ROUNDS = 4  # of reweighting
NEAR_ZERO = 0.05  # spread of every second start, over that of the others
LARGEST = 1e4  # units of the search: spread of the starts, at most
LEAST = 1e-6  # of the span of the TE: least standard deviation of a row
SAME_OFFSET = 1e-11  # relative information below which offsets of all and of single recordings are not told apart
SAME = 12.0  # squared standard errors within which two ends count as one, apart from hidden directions
CLEARLY = 1.1  # ratio of the errors of two solutions above which one has clearly smaller ones
AS_GOOD = 12.0  # variances of a row by which the sum of squares of an equally good end may exceed the least one


@dataclasses.dataclass(frozen=True)
class Fit:
    """The result of a fit.

    Args:
        values: numbers in units of the search, shape (number,).
        cost: weighted sum of squares of the rows [arcmin^2].
        sigma: standard deviation of a row [arcmin].
        weight: weight of each row, shape (n,).
        share: share of its weight that is left to each row, below one for outliers, shape (n,).
        matrix: ``J^T W J`` of all rows, without the priors, shape (number, number).
        others: other solutions that fit equally well, shape (k, number).
        within: other ends in the same flat valley, between which and ``values`` all points fit equally well, shape
            (k, number).
        problem: the problem of all rows.
        known: the priors, their precisions multiplied by the variance of a row.
    """

    values: np.ndarray
    cost: float
    sigma: float
    weight: np.ndarray
    share: np.ndarray
    matrix: np.ndarray
    others: np.ndarray
    within: np.ndarray
    problem: Problem
    known: Known

    @functools.cached_property
    def residual(self) -> np.ndarray:
        """Measured minus computed, shape (n,) [arcmin]."""
        return self.problem.rows.te - self.problem.curve(self.values)[0]


def coarse(
    records: Sequence[Measurement], scene: Scene, rows: Rows, free: Sequence[Wave | Trend], share: np.ndarray
) -> Rows:
    """Means of the rows over even steps of the angle; the rows themselves if there are hardly more rows than steps.

    Rows with a share of zero are left out.
    """
    turns = scene.system.orders
    per_input_turn = max(BINS * turns.get("output", 1.0), PER_TURN * scene.system.fastest_order)
    parts = []
    for i in range(len(records)):
        own = (share > 0) & (rows.record == i)
        theta = rows.theta[own]
        width = max(2 * np.pi / per_input_turn, np.ptp(theta) / MOST_BINS)
        if np.ptp(theta) / width > 0.7 * theta.size:
            parts.append((theta, rows.torque[own], rows.back[own].astype(float), rows.te[own], np.ones(theta.size)))
        else:
            angle, values, number = binned(theta, (rows.torque[own], rows.back[own].astype(float), rows.te[own]), width)
            parts.append((angle, *values, number))
    record = np.concatenate([np.full(part[0].size, i) for i, part in enumerate(parts)])
    theta, torque, back, te, number = (np.concatenate(column) for column in zip(*parts, strict=True))
    basis = further(theta, record, len(records), free, rows.basis.shape[1] > 1 + 2 * len(free))
    return Rows(theta, torque, back > 0.5, te, number, basis, record)


def fitted(
    model: Model,
    rows: Rows,
    rough: Problem | None,
    precision: tuple[np.ndarray, np.ndarray],
    starts: np.ndarray,
    share: np.ndarray,
    *,
    robust: bool,
    counted: Callable[[int], None],
) -> Fit:
    """The best end of several starts.

    Args:
        model: the model of the recordings.
        rows: all rows.
        rough: the problem of their means; ``None`` if all starts are to be refined.
        precision: means and precisions of the priors, in units of the search, shape (number,) each.
        starts: numbers that the search starts from, shape (start, number).
        share: share of its weight that each row has at first, shape (n,).
        robust: whether outlying rows get less weight.
        counted: called with the number of points at which the sums of all rows were computed.
    """

    def sums_with(weight: np.ndarray) -> Sums:
        def sums(points: np.ndarray) -> Normal:
            found = problem.normal(points, weight)
            counted(len(points))
            return found

        return sums

    unknowns = model.unknowns
    beside = np.zeros(starts.shape[1] - len(unknowns.each), bool)
    free = np.full((2, len(beside)), [[-np.inf], [np.inf]])
    allowed = np.concatenate([unknowns.allowed, free], axis=1)
    errors = np.concatenate([[each.path.startswith("errors.") for each in unknowns.each], beside])
    sigma = noise_of(rows)
    known = Known(precision[0], precision[1] * sigma**2)
    problem = Problem(model, rows)
    if rough is not None and len(starts) > 1:
        starts = _best_on_means(rough, starts, known, allowed, sigma)
    weight = rows.weight * share
    ends, sums = starts, None
    for turn in range(ROUNDS):
        ends, sums = descend(sums_with(weight), ends, known, allowed, weight.sum())
        best = int(np.argmin(sums.cost))
        residual = rows.te - problem.curve(ends[best])[0]
        of_records = rows.weight * of_recordings(residual, rows)
        even = np.sqrt(of_records) * residual
        sigma = max(spread_of(even) if robust else float(np.std(even)), 1e-9)
        known = Known(precision[0], precision[1] * sigma**2)
        share = of_outliers(even, sigma) if robust else share
        moved = np.abs(of_records * share - weight).max()
        if turn and moved < 1e-3:
            break
        weight = of_records * share
    assert sums is not None
    sigma = float(np.sqrt((weight * residual**2).sum() / max(weight.sum() - ends.shape[1], 1.0)))
    sigma = max(sigma, LEAST * float(np.ptp(rows.te)))
    known = Known(precision[0], precision[1] * sigma**2)
    ends, sums = descend(sums_with(weight), ends, known, allowed, weight.sum())
    if not np.isfinite(sums.cost).any():
        raise GearjaxError(
            "the model is not finite at any start: give the scene numbers nearer to the measured gear set"
        )
    order = np.argsort(sums.cost)
    order = order[sums.cost[order] - sums.cost[order[0]] < AS_GOOD * sigma**2]
    ends, sums = ends[order], Normal(*(part[order] for part in sums))
    values, others, within = _flattest(sums_with(weight), ends, sums, known, errors, allowed, sigma)
    there = problem.normal(values[None], weight)
    return Fit(values, float(there.cost[0]), sigma, weight, share, there.matrix[0], others, within, problem, known)


def _best_on_means(rough: Problem, starts: np.ndarray, known: Known, allowed: np.ndarray, sigma: float) -> np.ndarray:
    """The best of the starts' ends on the means, and those of the good ones whose sums have the lowest rank."""
    bins = rough.rows
    ends, sums = descend(lambda v: rough.normal(v, bins.weight), starts, known, allowed, bins.weight.sum(), ROUGH_STEPS)
    order = np.argsort(sums.cost)
    good = order[sums.cost[order] <= (1 + NEAR) * sums.cost[order[0]] + 100 * sigma**2]
    apart = good[_apart(ends[good], sums.matrix[good], sigma)]
    ranks = [rank_of(matrix - np.diag(known.precision)) for matrix in sums.matrix[apart]]
    flattest = apart[np.argsort(ranks, kind="stable")[:FLATTEST]]
    return ends[list(dict.fromkeys([*apart[:POLISHED], *flattest]))]


def _flattest(
    sums: Sums,
    ends: np.ndarray,
    at_ends: Normal,
    known: Known,
    errors: np.ndarray,
    allowed: np.ndarray,
    sigma: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of equally good points the one that is taken, the ends that are other solutions, and those in its flat valley.

    The sums of the one that is taken have the lowest rank: a search may stop at the rim of a flat valley, where the
    recordings seem to determine more than they do. Where that leaves a choice, its errors are the smallest.
    """
    valley = between(sums, ends, at_ends, known, errors, allowed, sigma**2)
    points, matrix = np.concatenate([ends, valley.points]), np.concatenate([at_ends.matrix, valley.matrix])
    ranks = [rank_of(part - np.diag(known.precision)) for part in matrix]
    sizes = np.where(ranks == np.min(ranks), np.linalg.norm(points[:, errors], axis=1), np.inf)
    best = int(np.argmax(sizes <= CLEARLY * sizes.min()))  # ends are in the order of their costs
    joined = np.concatenate([valley.joined, np.ones(len(valley.points), bool)])
    apart = [int(i) for i in np.flatnonzero(~joined) if i != best]
    first = [best, *apart] if joined[best] else [best, 0, *apart]
    distinct = [first[i] for i in _apart(points[first], matrix[first], sigma)[1:]]
    same = [i for i in np.flatnonzero(valley.joined) if i != best] if joined[best] else []
    return points[best], points[distinct], points[same]


def _apart(ends: np.ndarray, matrix: np.ndarray, sigma: float) -> list[int]:
    """Indices of the distinct ends: of ends that count as one, the first."""
    chosen: list[int] = []
    for i in range(len(ends)):
        if all(not _is_same(ends[i], ends[j], matrix[i], matrix[j], sigma) for j in chosen):
            chosen.append(i)
    return chosen


def _is_same(one: np.ndarray, other: np.ndarray, first: np.ndarray, second: np.ndarray, sigma: float) -> bool:
    """Whether two ends differ by no more than a few standard errors, apart from directions hidden at both ends."""
    way = one - other
    return bool(max(way @ first @ way, way @ second @ way) < SAME * sigma**2)


def rank_of(matrix: np.ndarray) -> int:
    """Number of directions that the sums of squares determine beyond rounding."""
    values = np.linalg.eigvalsh(scaled(matrix)[0])
    return int((values > 1e-9 * max(values[-1], 1e-300)).sum())


def without_further(matrix: np.ndarray, size: int) -> np.ndarray:
    """Matrix of the first numbers with the further ones (offsets and free orders) eliminated: the Schur complement.

    The offset of all recordings and those of single ones differ only by the priors; with wide ones, by rounding alone.
    """
    own, cross = matrix[:size, :size], matrix[:size, size:]
    beside, scale = scaled(matrix[size:, size:])
    cross = cross / scale
    left = own - cross @ np.linalg.pinv(beside, rcond=SAME_OFFSET, hermitian=True) @ cross.T
    return 0.5 * (left + left.T)


def scaled(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A matrix of sums scaled to ones on its diagonal, and the scale of each number."""
    diagonal = np.diag(matrix)
    scale = np.sqrt(np.where(diagonal > 1e-20 * max(diagonal.max(), 1e-300), diagonal, 1.0))
    whole = matrix / scale[:, None] / scale[None, :]
    return np.where(np.isfinite(whole), whole, 0.0), scale


def starts_of(model: Model, rough: Problem, number: int, seed: int) -> np.ndarray:
    """Starts: the scene itself, some with errors near zero, the others with errors as large as the TE allows."""
    each, start, rows = model.unknowns.each, model.unknowns.start, rough.rows
    further_numbers = rows.basis.shape[1]
    draws = np.random.default_rng(seed).standard_normal((number, len(each)))
    if number == 1:
        return np.concatenate([start, np.zeros(further_numbers)])[None]
    _, rate = rough.curve(np.concatenate([start, np.zeros(further_numbers)]))
    moves = np.sqrt((rate[:, : len(each)] ** 2).mean(axis=0))  # root mean square of the curve per unit of each unknown
    sizes = np.where(moves > 0, 0.5 * float(np.ptp(rows.te)) / np.where(moves > 0, moves, 1.0), 10.0)
    small = np.where(np.arange(number) % 2 == 1, NEAR_ZERO, 1.0)
    points = np.zeros((number, len(each) + further_numbers))
    for i, unknown in enumerate(each):
        if unknown.path.startswith("errors."):
            points[:, i] = small * min(sizes[i], LARGEST) * draws[:, i]
        elif unknown.kind == "reciprocal":
            points[:, i] = np.exp(0.4 * draws[:, i])
        else:
            points[:, i] = start[i] * (1 + 0.2 * draws[:, i])
    points[0, : len(each)] = start
    return points
