"""Grid search: every combination of levels of some numbers of a scene."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import arguments, units
from gearjax.checks import MISSING, ParameterError
from gearjax.contact import HardContact
from gearjax.progress import Progress, silent
from gearjax.scene import Scene
from gearjax.studies import separable
from gearjax.studies.objective import Objective
from gearjax.studies.select import Bounds, Free, Where, pick, probed
from gearjax.studies.terms import Term
from gearjax.studies.values import Values, require_influence, values
from gearjax.timing import Stopwatch
from gearjax.typing import ArrayLike

CHUNK = 16384  # combinations between two lines of progress
JUDGED = 16  # combinations evaluated on all times at once
BOUND_SAMPLES = 16  # per turn of the fastest error
MOST_COMBINATIONS = 100_000_000
# slack of a bound for rounding: relative, a power of the dtype's spacing; absolute, that spacing of positions [rad]
ROUNDED, NO_MORE = 0.7, 0.01


class GridSearch(eqx.Module):
    """The best combinations of a grid.

    Args:
        paths: the free numbers.
        combinations: size of the grid.
        evaluated: combinations that were evaluated on all times; the others were excluded by a bound.
        runners_up: values of the best combinations, best first, shape (m, free), SI.
        objectives: objectives of the best combinations, shape (m,).
        seconds: wall time without compilation [s].
        compile_seconds: wall time of tracing and compiling [s].
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    combinations: int
    evaluated: int
    runners_up: np.ndarray
    objectives: np.ndarray
    seconds: float
    compile_seconds: float

    @property
    def best(self) -> np.ndarray:
        """Values of the free numbers at the minimum, shape (free,), SI."""
        return self.runners_up[0]

    @property
    def objective(self) -> float:
        """The minimum of the objective."""
        return float(self.objectives[0])


@arguments.checked(step=arguments.spacing, keep=arguments.whole(1))
def grid_search(
    loss: str | Callable[[Scene], Any] | Term | Sequence[Term] | Objective,
    scene: Scene,
    *,
    where: Where,
    step: float | Mapping[str, float],
    theta: ArrayLike | None = None,
    torque: float | None = None,
    bounds: Bounds | None = None,
    keep: int = 10,
    progress: Progress | None = None,
) -> GridSearch:
    r"""Find the exact minimum of an objective over every combination of levels.

    The levels of a periodic number go from minus half a period to plus half a period, without the latter; those of
    other numbers go from the lowest to the highest bound. For the amplitude and the peak-to-peak of the hard no-load
    TE over numbers of errors, most combinations are excluded by bounds (`gearjax.studies.separable`). Other amplitudes
    and peak-to-peaks are bounded from below on a part of their samples, and only combinations that may be among the
    best are evaluated. All other objectives are evaluated for every combination.

    Args:
        loss: what to minimise: a name such as ``"no_load_amplitude"``, `Term`\ s to be summed, or a function of the
            scene.
        scene: the scene.
        where: paths of the free numbers.
        step: spacing of the levels in SI, one for all or by path.
        theta: input angles of a named loss [rad]; by default those of the scene's run section, or one cycle.
        torque: load torque of a static loss [N m].
        bounds: lowest and highest value by path, SI, for numbers that are not periodic.
        keep: number of best combinations to return.
        progress: called with a line of text now and then; the first says how large the grid is.

    Raises:
        ParameterError: a path, a step or a bound is wrong, or the objective does not depend on a number.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> paths = ["errors.planet_1.phase", "errors.planet_2.phase"]
        >>> grid = gj.grid_search("no_load_amplitude", scene, where=paths, step=10 * gj.units.deg)
        >>> grid.combinations, round(grid.objective / gj.units.arcmin, 3)
        (1296, 0.621)
    """
    with Stopwatch() as watch:
        objective = Objective.of(loss, scene, theta, torque)
        free = pick(scene, where, bounds)
        levels = tuple(_levels(path, free, i, step) for i, path in enumerate(free.paths))
        combinations = math.prod(len(axis) for axis in levels)
        if combinations > MOST_COMBINATIONS:
            raise ParameterError(
                "step", step, f"gives {combinations:.3g} combinations, more than {MOST_COMBINATIONS:g}"
            )
        progress = progress or silent
        progress(f"grid of {combinations} combinations, {8e-6 * combinations:.3g} MB of objectives")
        search = _structured if _is_structured(objective, scene, free) else _exhaustive
        best, evaluated = search(objective, scene, free, levels, keep, progress)
    return GridSearch(
        paths=free.paths,
        combinations=combinations,
        evaluated=evaluated,
        runners_up=np.array([numbers for _, numbers in best]),
        objectives=np.array([value for value, _ in best]),
        seconds=watch.seconds,
        compile_seconds=watch.compile_seconds,
    )


def _is_structured(objective: Objective, scene: Scene, free: Free) -> bool:
    names = ("no_load_amplitude", "no_load_peak_to_peak")
    alone = objective.scatter is None and len(objective.terms) == 1 and objective.terms[0].name in names
    return alone and isinstance(scene.contact, HardContact) and separable.is_separable(scene, free)


def _levels(path: str, free: Free, index: int, step: float | Mapping[str, float]) -> np.ndarray:
    spacing = step[path] if isinstance(step, Mapping) and path in step else step
    if isinstance(spacing, Mapping) or not (math.isfinite(spacing) and spacing > 0):
        raise ParameterError(f"step of {path}", spacing, "must be a number above 0")
    period = free.periods[index]
    if period is not None:
        number = round(period / spacing)
        if number < 1 or abs(number * spacing - period) > 1e-9 * period:
            given, turn = spacing / units.deg, period / units.deg
            words = f"is {given:.6g} deg, must divide the period of {turn:g} deg"
            raise ParameterError(f"step of {path}", spacing, words)
        _check_levels(path, spacing, number)
        return -period / 2 + spacing * np.arange(number)
    low, high = free.bounds[index]
    if not free.searchable[index]:
        raise ParameterError(f"bounds of {path}", MISSING, "must be given: lowest and highest value")
    if not (math.isfinite(low) and math.isfinite(high) and high >= low):
        raise ParameterError(f"bounds of {path}", (low, high), "must be finite, lowest first")
    number = math.floor((high - low) / spacing + 1e-9) + 1
    _check_levels(path, spacing, number)
    return low + spacing * np.arange(number)


def _check_levels(path: str, spacing: float, number: int) -> None:
    if number > MOST_COMBINATIONS:
        raise ParameterError(f"step of {path}", spacing, f"gives {number:.3g} levels, more than {MOST_COMBINATIONS:g}")


Kept = tuple[list[tuple[float, np.ndarray]], int]  # the best (objective and numbers each), and how many were evaluated


def _structured(
    objective: Objective, scene: Scene, free: Free, levels: tuple[np.ndarray, ...], keep: int, progress: Progress
) -> Kept:
    """Exclude combinations by a bound; evaluate the rest on all times, and the best by the objective itself."""
    dtype = objective.theta.dtype
    axes = tuple(jnp.asarray(axis, dtype) for axis in levels)
    contributions = separable.contributions(scene, free, axes, objective.theta)
    _require_contributions(contributions, scene, free, axes, objective)
    plan = separable.plan(contributions)
    weight = float(objective.terms[0].weight)
    judge = values(objective, scene, free)

    def numbers(flat: np.ndarray) -> np.ndarray:
        chosen = separable.levels_of(flat, plan, contributions.shape)
        return np.stack([axis[level] for axis, level in zip(levels, chosen, strict=True)], axis=1)

    # the objective includes extremes between samples, so a combination whose bound is above it can be excluded
    spread = objective.terms[0].metric == "peak_to_peak"
    best = separable.certified(
        contributions, plan, spread=spread, keep=keep, reach=lambda flat: judge(numbers(flat)) / weight
    )
    progress(f"{best.evaluated} combinations may be among the {keep} best: evaluated on all times")
    kept: list[tuple[float, np.ndarray]] = []
    for begin in range(0, len(best.flat), JUDGED):
        if len(kept) == keep and weight * best.scores[begin] > kept[-1][0]:
            break  # the score of the samples bounds the objective from below: no later combination is better
        part = numbers(best.flat[begin : begin + JUDGED])
        kept = sorted([*kept, *zip(judge(part).tolist(), part, strict=True)], key=lambda item: item[0])[:keep]
    return kept, best.evaluated


def _require_contributions(
    contributions: separable.Contributions, scene: Scene, free: Free, axes: tuple, objective: Objective
) -> None:
    """Refuse a number that has no influence, also with nonzero numbers beside it."""
    for index, path in enumerate(free.paths):
        if len(axes[index]) > 1 and not np.ptp(np.asarray(contributions.axes[index]), axis=0).any():
            again = separable.contributions(probed(scene, free), free, axes, objective.theta)
            if not np.ptp(np.asarray(again.axes[index]), axis=0).any():
                raise ParameterError("where", path, f"the objective {objective.name} does not depend on it")


def _exhaustive(
    objective: Objective, scene: Scene, free: Free, levels: tuple[np.ndarray, ...], keep: int, progress: Progress
) -> Kept:
    """Search all combinations, in chunks.

    An objective made of largest values is bounded from below by a part of its samples. The bounds of all combinations
    are computed, and only combinations that may be among the best are evaluated.
    """
    shape = tuple(len(axis) for axis in levels)
    total = math.prod(shape)
    low, high = (np.array([end(axis) for axis in levels]) for end in (np.min, np.max))

    def numbers(flat: np.ndarray) -> np.ndarray:
        chosen = np.unravel_index(flat, shape)
        return np.stack([axis[level] for axis, level in zip(levels, chosen, strict=True)], axis=1)

    def each(evaluate: Values, words: str) -> np.ndarray:
        objectives = np.empty(total)
        for start in range(0, total, CHUNK):
            flat = np.arange(start, min(start + CHUNK, total))
            objectives[flat] = evaluate(numbers(flat))
            progress(f"{flat[-1] + 1} of {total} combinations {words}")
        return objectives

    evaluate = values(objective, scene, free)
    if objective.is_bounded:
        coarse = objective.coarse(scene, BOUND_SAMPLES).tabulated(scene, free)
        require_influence(coarse, scene, free, low, high)
        bounds = each(values(coarse, scene, free, "sampled"), "bounded")
        spacing = float(np.finfo(objective.theta.dtype).eps)
        slack = spacing**ROUNDED, spacing * NO_MORE
        return _best_of(bounds, lambda flat: evaluate(numbers(flat)), numbers, keep, slack, progress)
    require_influence(objective, scene, free, low, high, "hard")
    reached = each(evaluate, "evaluated")
    if not np.isfinite(reached).any():
        raise ParameterError("objective", objective.name, "is finite for no combination of the grid")
    reached = np.where(np.isfinite(reached), reached, np.inf)
    best = np.argsort(reached, kind="stable")[:keep]
    return list(zip(reached[best].tolist(), numbers(best), strict=True)), total


def _best_of(
    bounds: np.ndarray,
    judge: Values,
    numbers: Callable,
    keep: int,
    slack: tuple[float, float],
    progress: Progress,
) -> Kept:
    """The best combinations, found from lower bounds of all.

    ``judge`` computes the objective with the hard contact law. Combinations are evaluated from the lowest bound on,
    until no other can be better by more than ``slack``: rounding, relative and in rad.
    """
    order = np.argsort(np.where(np.isfinite(bounds), bounds, np.inf), kind="stable")
    kept: list[tuple[float, int]] = []
    evaluated = 0
    while evaluated < len(order):
        part = order[evaluated : evaluated + JUDGED]
        if len(kept) == keep and bounds[part[0]] > kept[-1][0] * (1 + slack[0]) + slack[1]:
            break
        objectives = judge(part)
        evaluated += len(part)
        finite = np.isfinite(objectives)
        kept = sorted([*kept, *zip(objectives[finite].tolist(), part[finite].tolist(), strict=True)])[:keep]
        progress(f"{evaluated} combinations evaluated on all times")
    if not kept:
        raise ParameterError("objective", "not finite", "is finite for no combination of the grid")
    points = numbers(np.array([index for _, index in kept]))
    return [(value, point) for (value, _), point in zip(kept, points, strict=True)], evaluated
