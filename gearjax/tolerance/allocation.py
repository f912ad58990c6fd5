"""Tolerance allocation: the cheapest tolerances that reach a required yield.

Every tolerance is scaled by a factor: sizes of errors as a whole, other numbers about their means. The yield of a fixed
sample of gear sets is smoothed (a sigmoid in place of the step at the limit), so that it has a gradient; sequential
quadratic programming (scipy's SLSQP) finds the cheapest factors that reach it. The reported yield is counted on new
gear sets, without smoothing. If it is not proved to reach the requirement, the search is repeated with a higher
smoothed yield as its target.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError, nearest
from gearjax.progress import Left, Progress, silent
from gearjax.tolerance import statistics
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.monte_carlo import Work
from gearjax.tolerance.population import Tolerances, a_population
from gearjax.tolerance.rows import RowProgram
from gearjax.tolerance.sampling import points
from gearjax.tolerance.statistics import Estimate
from gearjax.typing import Array, Scalar

WIDTH = 0.1  # of the smoothed step, in standard deviations of the measure
CORRECTIONS = 6
SAME_COST = 1e-4  # of the cost as given: more accuracy is useless, as yields are known to a few parts in a thousand
SAME_YIELD = 1e-4  # by which the yield of a search may stay below its target
STUCK = 1e-3  # relative change of a factor
Cost = Sequence[tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class AllocatedTolerances:
    """The cheapest tolerances found.

    Args:
        measure: name of the measure whose limit counts.
        required: required share of good gear sets.
        paths: paths of the tolerances.
        factors: factors on the tolerances, shape (number,).
        cost: cost of the tolerances found.
        cost_before: cost of the tolerances as given.
        before, after: yield with the tolerances as given and as found, counted without smoothing on gear sets that the
            search has not used.
        met: whether the whole interval of the yield found is at or above the required yield.
    """

    measure: str
    required: float
    paths: tuple[str, ...]
    factors: np.ndarray
    cost: float
    cost_before: float
    before: Estimate
    after: Estimate
    met: bool


@arguments.checked(
    tolerances=a_population,
    measure=arguments.an(Measure, 'must be a Measure with a limit: Measure("no_load", "peak_to_peak", limit=...)'),
    required=arguments.a_share,
    tightest=arguments.one_positive,
    loosest=arguments.one_positive,
    n=arguments.whole(1),
    judged=arguments.whole(1),
)
def allocate(
    tolerances: Tolerances,
    measure: Measure,
    *,
    required: float,
    costs: Mapping[str, float | Cost],
    tightest: float = 0.1,
    loosest: float = 2.0,
    n: int = 2048,
    judged: int = 20_000,
    key: int = 0,
    progress: Progress = silent,
    **options: Any,
) -> AllocatedTolerances:
    """Find the cheapest tolerances whose yield is above a required yield, with 95 % confidence.

    Args:
        tolerances: the population with the tolerances as given.
        measure: a measure with a limit.
        required: required share of good gear sets.
        costs: cost of each tolerance, by path: a cost c of the tolerance as given, for the reciprocal law
            ``c / factor``; or pairs of a factor on the tolerance and its cost, with rising factors and falling costs,
            interpolated linearly. One pair (f, c) stands for the law ``c f / factor``.
        tightest, loosest: smallest and largest factor on a tolerance that is allowed.
        n: number of gear sets in the search.
        judged: number of new gear sets on which each yield is counted.
        key: seed of the samples.
        progress: called with a line of text now and then.
        options: ``theta``, ``extremes``, ``chunk`` and ``devices`` of `monte_carlo`.

    Raises:
        ParameterError: the measure has no limit, a path is not a tolerance, or a cost is not above 0.
    """
    from scipy import optimize

    if not measure.is_limited:
        raise ParameterError("measure", measure.name, "has no limit")
    for path in costs:
        if path not in tolerances.tolerated:
            raise ParameterError("costs", path, f"is no tolerance; {nearest(path, tolerances.tolerated)}")
    if not costs:
        raise ParameterError("costs", dict(costs), "names no tolerance")
    if tightest > loosest:
        raise ParameterError("tightest", tightest, f"must be at most loosest, {loosest:g}")
    tables = [_table(path, given) for path, given in costs.items()]
    paths = tuple(costs)
    places = np.array([tolerances.paths.index(path) for path in paths])
    judging = Work(tolerances, measure, number=judged, seed=key, **options)
    price = _price(tables)

    def judge(factors: np.ndarray, turn: int) -> Estimate:
        """Yield counted on gear sets that no earlier turn has used."""
        seed = key + 1 + turn
        drawn = tolerances.values(points(judging.sampler, seed, tolerances.paths, judged, 0, judged))
        moved = _scaled(drawn, tolerances.centres, places, factors)
        return statistics.share(measure.holds(judging.evaluate(moved)[0][:, 0]), judging.sizes)

    smooth = _smooth_yield(tolerances, measure, places, n, key, options)
    bounds = np.log([_range(rows, tightest, loosest) for rows in tables])
    ones = np.ones(len(paths))
    before, target, given = judge(ones, 0), required, price(ones)[0]
    start = np.clip(0 * ones, *bounds.T)
    scale = given or 1.0
    best: tuple = ((before.low >= required, -given), before, ones)
    if not best[0][0]:
        best = ((False, before.value), before, ones)

    def cheapest(target: float, start: np.ndarray) -> tuple[np.ndarray, bool]:
        """Cheapest factors whose smooth yield reaches a target, and whether it does."""
        solution = optimize.minimize(
            lambda logs: tuple(part / scale for part in price(np.exp(logs))),
            start,
            jac=True,
            bounds=bounds,
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda logs: smooth(np.exp(logs))[0] - target,
                "jac": lambda logs: smooth(np.exp(logs))[1] * np.exp(logs),
            },
            options={"maxiter": 60, "ftol": SAME_COST},
        )
        factors = np.exp(np.clip(solution.x, *bounds.T))
        return factors, smooth(factors)[0] >= target - SAME_YIELD

    left = Left(CORRECTIONS, "at most")
    for turn in range(1, CORRECTIONS + 1):
        factors, reaches = cheapest(target, start)
        for other in (np.log(best[2]), 0 * ones):  # at a bound the slope of a yield of few gear sets may lead nowhere
            if not reaches:
                again = cheapest(target, np.clip(other, *bounds.T))
                factors, reaches = again if again[1] else (factors, reaches)
        after = judge(factors, turn)
        cost = price(factors)[0]
        reached = f"cost {cost:.4g}, yield {after.value:.4f} [{after.low:.4f}, {after.high:.4f}]"
        progress(f"allocation {turn} of at most {CORRECTIONS}: {reached}{left.after()}")
        met = after.low >= required
        # a proved yield ranks before one that is not; then the lower cost counts, or the higher yield
        rank = (met, -cost if met else after.value)
        if rank > best[0]:
            best = (rank, after, factors)
        if met and after.low < required + 0.25 * (after.high - after.low):
            break  # the yield is proved with little to spare, so the cost can hardly fall further
        moved = np.abs(np.log(factors) - start).max()
        if moved < STUCK and not reaches:
            break  # the search cannot reach its target from here, and the next target would be higher
        target = float(np.clip(target + (required - after.low) * 1.05, 0.0, 1 - 1e-4))
        start = np.log(factors)
    (met, _), after, factors = best
    costs_found = price(factors)[0], given
    return AllocatedTolerances(measure.name, required, paths, factors, *costs_found, before, after, met)


def _table(path: str, given: Any) -> Cost:
    """Pairs of factor and cost, from pairs or from a single cost."""
    right = "must be a cost above 0, or pairs (factor, cost) with rising factors and falling costs"
    try:
        rows = tuple(
            (float(factor), float(cost)) for factor, cost in ([(1.0, given)] if np.ndim(given) == 0 else given)
        )
    except (TypeError, ValueError):
        rows = ()
    fits = bool(rows) and np.isfinite(rows).all() and min(rows[0]) > 0 and rows[-1][1] >= 0
    if not fits or any(a[0] >= b[0] or a[1] < b[1] for a, b in itertools.pairwise(rows)):
        raise ParameterError(f"costs.{path}", given, right)
    return rows


def _range(rows: Cost, tightest: float, loosest: float) -> tuple[float, float]:
    """Smallest and largest allowed factor, within the factors of a table if there is one."""
    if len(rows) == 1:
        return tightest, loosest
    return max(tightest, rows[0][0]), max(tightest, min(loosest, rows[-1][0]))


def _scaled(inputs: np.ndarray, centres: np.ndarray, places: np.ndarray, factors: np.ndarray) -> np.ndarray:
    moved = inputs.copy()
    moved[:, places] = centres[places] + factors * (inputs[:, places] - centres[places])
    return moved


def _price(costs: Sequence[Cost]) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """A function that returns the cost of factors, and its derivatives by their logarithms."""

    def price(factors: np.ndarray) -> tuple[float, np.ndarray]:
        total, slopes = 0.0, np.empty(len(factors))
        for index, (factor, rows) in enumerate(zip(factors, costs, strict=True)):
            if len(rows) == 1:
                cost = rows[0][0] * rows[0][1] / factor
                slope = -cost / factor
            else:
                known, prices = np.array(rows).T
                cost = float(np.interp(factor, known, prices))
                part = int(np.clip(np.searchsorted(known, factor), 1, len(known) - 1))
                slope = (prices[part] - prices[part - 1]) / (known[part] - known[part - 1])
            total += cost
            slopes[index] = slope * factor
        return total, slopes

    return price


def _smooth_yield(
    tolerances: Tolerances, measure: Measure, places: np.ndarray, number: int, key: int, options: dict[str, Any]
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """A function that returns the smoothed yield of factors, and its derivatives by the factors."""
    work = Work(tolerances, measure, number=number, seed=key, sampler="latin_hypercube", **options)
    inputs = work.inputs(0, number)
    dtype = tolerances.scene.dtype
    width = WIDTH * float(np.nanstd(work.evaluate(inputs)[0][:, 0])) + 1e-15
    rows, centres = inputs.astype(dtype), jnp.asarray(tolerances.centres, dtype)
    low, high = (jnp.asarray(bound, dtype) for bound in tolerances.bounds)

    def good(row: Array, factors: Array) -> Scalar:
        moved = row.at[places].set(centres[places] + factors * (row[places] - centres[places]))
        value = work.one(moved)[0][0]
        share = jnp.ones_like(value)
        if measure.limit is not None:
            share = share * jax.nn.sigmoid((measure.limit - value) / width)
        if measure.at_least is not None:
            share = share * jax.nn.sigmoid((value - measure.at_least) / width)
        allowed = (jnp.isfinite(moved) & (moved >= low) & (moved <= high)).all()
        return jnp.where(jnp.isfinite(value) & allowed, share, 0.0)

    each = RowProgram(jax.value_and_grad(good, argnums=1), work.devices, work.together, number)
    known: dict[bytes, tuple[float, np.ndarray]] = {}

    def evaluate(factors: np.ndarray) -> tuple[float, np.ndarray]:
        place = factors.tobytes()
        if place not in known:
            shares, slopes = each(rows, np.broadcast_to(factors, (number, len(factors))).astype(dtype))
            known[place] = float(shares.mean()), np.nan_to_num(slopes).mean(axis=0).astype(float)
        return known[place]

    return evaluate
