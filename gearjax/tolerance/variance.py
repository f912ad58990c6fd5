"""Influence of each tolerance: its share of the variance of a measure, by three methods, and the gain by tightening it.

- linear: mean of the squared derivatives times the variance of the number, over the variance of the measure; exact for
  a linear measure, and for normal numbers an upper bound of the total index (Sobol and Kucherenko 2009);
- Sobol first and total indices from Saltelli's design (SALib): the share that a number explains alone, and together
  with all others;
- one at a time, as is usual in papers: the range of the measure while one number runs through its middle 95 % and the
  others stay at their medians, squared and scaled to shares.
"""

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from gearjax import arguments
from gearjax.checks import GearjaxError
from gearjax.progress import Left, Progress, silent
from gearjax.tolerance.monte_carlo import Work
from gearjax.tolerance.population import Tolerances, a_population
from gearjax.tolerance.rows import RowProgram
from gearjax.tolerance.statistics import Estimate, share
from gearjax.typing import Array

DERIVATIVES = 1024  # samples over which the linear shares are averaged, at most
LEVELS = np.linspace(0.025, 0.975, 39)
OFF = 0.1  # largest difference of a linear share and the total index
MISSED = 0.2  # largest difference of the sum of linear shares and 1
TIGHTER = 0.5
TIGHTENED_SAMPLES = 10_000  # of which the yield with one tolerance tightened is told


@dataclasses.dataclass(frozen=True)
class Sensitivities:
    """Shares of the variance of one measure, one entry for each number.

    Args:
        name: name of the measure.
        paths: paths of the toleranced numbers.
        linear: share by derivatives, shape (number,).
        first, total: Sobol indices, shape (number,).
        first_error, total_error: half widths of the 95 % intervals of the Sobol indices, shape (number,).
        one_at_a_time: share by ranges, shape (number,).
        samples: number of gear sets evaluated for the Sobol indices.
        failed: number of these gear sets that failed; they count as average ones.
        correlated: whether the population has correlations, which are ignored here.
    """

    name: str
    paths: tuple[str, ...]
    linear: np.ndarray
    first: np.ndarray
    first_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    one_at_a_time: np.ndarray
    samples: int
    failed: int
    correlated: bool

    @property
    def linear_fails(self) -> str:
        """Why the linear shares mislead; empty if they do not."""
        whole = float(self.linear.sum())
        if whole == 0 and not self.total.any():
            return ""  # the measure does not vary
        apart = np.abs(self.linear - self.total) - self.total_error
        worst = int(np.argmax(apart))
        if apart[worst] > OFF:
            return (
                f"linear shares are misleading: {self.paths[worst]} has {self.linear[worst]:.2f}, its total index is "
                f"{self.total[worst]:.2f}"
            )
        if abs(whole - 1) > MISSED + float(self.total_error.max()):
            return f"linear shares add to {whole:.2f}, not 1: the measure is not linear in the errors"
        return ""


@arguments.checked(tolerances=a_population, n=arguments.whole(1))
def sensitivities(
    tolerances: Tolerances, measure: Any, *, n: int = 1024, key: int = 0, progress: Progress = silent, **options: Any
) -> list[Sensitivities]:
    """Find the share of each toleranced number in the variance of each measure.

    Correlations of the population are ignored: the numbers are drawn independently.

    Args:
        tolerances: the population.
        measure: as for `monte_carlo`.
        n: number of base samples of Saltelli's design, which has n (numbers + 2) samples; a power of two is best.
        key: seed of the samples.
        progress: called with a line of text now and then.
        options: ``theta``, ``extremes``, ``chunk`` and ``devices`` of `monte_carlo`.

    Raises:
        GearjaxError: too many gear sets failed.
    """
    correlated = bool(tolerances.correlations)
    independent = Tolerances(tolerances.scene, tolerances.distributions) if correlated else tolerances
    work = Work(independent, measure, number=max(n, 2), seed=key, **options)
    progress("sensitivities: by derivatives")
    slopes = _linear(work, min(n, DERIVATIVES))
    progress("sensitivities: one at a time")
    ranges = _one_at_a_time(work, progress)
    progress("sensitivities: Sobol indices")
    measured, problem = _saltelli(work, n, key, progress)
    from SALib.analyze import sobol

    results = []
    for index, name in enumerate(work.names):
        column, good = measured[:, index], np.isfinite(measured[:, index])
        if good.mean() < 0.5:
            raise GearjaxError(f"sensitivity of {name}: {(~good).sum()} of {good.size} gear sets failed")
        column = np.where(good, column, column[good].mean())  # a failed gear set counts as an average one
        varies = np.ptp(column) > 0
        # SALib takes a seed of 0 for no seed, and the resampling for the errors would then be random
        indices = sobol.analyze(problem, column, calc_second_order=False, seed=key + 1) if varies else None
        none = np.zeros(len(independent.paths))
        first, first_error, total, total_error = (none if indices is None else indices[part] for part in _PARTS)
        squares = ranges[:, index] ** 2
        variance = max(float(column.var()), 1e-300)
        results.append(
            Sensitivities(
                name,
                independent.paths,
                linear=slopes[index] * independent.deviations**2 / variance,
                first=first,
                first_error=first_error,
                total=total,
                total_error=total_error,
                one_at_a_time=squares / max(squares.sum(), 1e-300),
                samples=good.size,
                failed=int((~good).sum()),
                correlated=correlated,
            )
        )
    return results


_PARTS = ("S1", "S1_conf", "ST", "ST_conf")


def _saltelli(work: Work, number: int, seed: int, progress: Progress) -> tuple[np.ndarray, dict]:
    """Measures of Saltelli's design, shape (number (free + 2), measure), and the design."""
    from SALib.sample import sobol  # its import takes a second

    paths = work.sample.paths
    problem = {"num_vars": len(paths), "names": list(paths), "bounds": [[0.0, 1.0]] * len(paths)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # scipy warns that only powers of two are balanced
        cube = sobol.sample(problem, number, calc_second_order=False, seed=seed)
    cube = np.clip(cube, 2.0**-33, 1 - 2.0**-33)
    return work.evaluate(work.sample.values(cube), progress, "sensitivities: Sobol indices")[0], problem


def _linear(work: Work, number: int) -> np.ndarray:
    """Means of the squared derivatives, shape (measure, free)."""
    rows = work.inputs(0, min(number, work.number)).astype(work.sample.scene.dtype)
    measured = np.empty((len(rows), len(work.names)))
    slopes = np.empty((*measured.shape, rows.shape[1]))

    def fill(place: int) -> None:
        part = work.parts[place]
        program = RowProgram(_with_slopes(part.one), work.devices, work.together, len(rows))
        for given, columns in part.given(rows):
            slopes[:, columns], measured[:, columns] = program(*given)

    work.over_parts(fill)
    good = np.isfinite(measured).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
    return (slopes[good] ** 2).mean(axis=0)


def _with_slopes(one: Callable) -> Callable:
    """A function that returns the derivatives of measures by the numbers of a gear set, and the measures."""

    def twice(*given: Array) -> tuple[Array, Array]:
        measured = one(*given)[0]
        return measured, measured

    return jax.jacrev(twice, has_aux=True)


def _one_at_a_time(work: Work, progress: Progress) -> np.ndarray:
    """Range of each measure while one number varies alone, shape (free, measure)."""
    spreads = list(work.sample.distributions.values())
    medians = np.array([float(spread.quantile(np.array(0.5))) for spread in spreads])
    rows = np.repeat(medians[None], len(spreads) * len(LEVELS), axis=0).reshape(len(spreads), len(LEVELS), -1)
    for index, spread in enumerate(spreads):
        rows[index, :, index] = spread.quantile(LEVELS)
    measured = work.evaluate(rows.reshape(-1, len(spreads)), progress, "sensitivities: one at a time")[0]
    measured = measured.reshape(len(spreads), len(LEVELS), -1)
    return np.nan_to_num(np.nanmax(measured, axis=1) - np.nanmin(measured, axis=1))


def tightened(
    work: Work, number: int, factor: float = TIGHTER, progress: Progress = silent
) -> dict[str, dict[str, tuple[Estimate, Estimate]]]:
    """Yield of the same gear sets as they are, and with one tolerance tightened.

    Args:
        work: the study; yields are of its measures with limits.
        number: number of gear sets, the first ones of the study; of several designs, whole ones.
        factor: factor on the tolerance.
        progress: called with a line of text after each tolerance, and every few seconds.

    Returns:
        By measure and path: the yield, and the yield with that tolerance scaled (`Tolerances.centres`).
    """
    sizes = work.sizes
    if number < work.number:
        whole = sizes[np.cumsum(sizes) <= number]
        sizes = whole if len(whole) else np.array([number])
    number = int(sizes.sum())
    inputs, paths, centres = work.inputs(0, number), work.sample.paths, work.sample.centres
    limited = [measure for measure in work.measures if measure.is_limited]
    before, _ = work.evaluate(inputs, progress, "tolerances as they are")
    yields: dict[str, dict[str, tuple[Estimate, Estimate]]] = {measure.name: {} for measure in limited}
    left = Left(len(work.sample.tolerated))
    for path in work.sample.tolerated if limited else ():
        place = paths.index(path)
        moved = inputs.copy()
        moved[:, place] = centres[place] + factor * (inputs[:, place] - centres[place])
        after, _ = work.evaluate(moved, progress, f"halved: {path}")
        for measure in limited:
            column = work.names.index(measure.name)
            pair = (share(measure.holds(part[:, column]), sizes) for part in (before, after))
            yields[measure.name][path] = (next(pair), next(pair))
        progress(f"halved: {path}{left.after()}")
    return yields
