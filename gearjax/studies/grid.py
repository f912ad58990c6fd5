"""Grid search: every combination of levels of some numbers of a scene."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError
from gearjax.contact import HardContact
from gearjax.scene import Scene
from gearjax.studies import separable
from gearjax.studies.objective import Objective
from gearjax.studies.select import Free, Where, pick
from gearjax.typing import ArrayLike

Progress = Callable[[str], None]
COARSE, MEDIUM = 16, 256  # times of the first and the second bound
CHUNK = 256
TRIED = 32  # combinations from which a number is tried for its effect
MOST_COMBINATIONS = 100_000_000


class GridSearch(eqx.Module):
    """The best combinations of a grid.

    Args:
        paths: the free numbers.
        best: their values at the minimum, shape (free,), SI.
        objective: the minimum.
        combinations: size of the grid.
        evaluated: combinations that were evaluated on all times; the others were excluded by a bound.
        runners_up: values of the best combinations, best first, shape (m, free).
        objectives: their objectives, shape (m,).
        seconds: wall time, compilation included.
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    best: np.ndarray
    objective: float
    combinations: int
    evaluated: int
    runners_up: np.ndarray
    objectives: np.ndarray
    seconds: float


def grid_search(
    loss: str | Callable[[Scene], Any] | Objective,
    scene: Scene,
    *,
    where: Where,
    step: float | Mapping[str, float],
    theta: ArrayLike | None = None,
    torque: float | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    keep: int = 10,
    progress: Progress | None = None,
) -> GridSearch:
    """The exact minimum of an objective over every combination of levels.

    Periodic numbers have levels from minus half a period, the other end left out; others from their lowest to their
    highest bound. The amplitude and the peak-to-peak of the hard no-load TE over numbers of errors are searched by
    their structure (`gearjax.studies.separable`), everything else by evaluating all combinations in chunks.

    Args:
        loss: what to minimise: a name such as ``"no_load_amplitude"`` (`Objective`), or a function of the scene.
        scene: the scene.
        where: paths of the free numbers.
        step: spacing of the levels in SI, one for all or by path.
        theta: input angles of a named loss [rad]; without, those of the scene's run section, or one cycle.
        torque: load torque of a static loss [N m].
        bounds: bounds by path, for numbers that are not periodic.
        keep: how many of the best combinations to return.
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
    objective = Objective.of(loss, scene, theta, torque)
    free = pick(scene, where, bounds)
    levels = tuple(_levels(path, free, i, step) for i, path in enumerate(free.paths))
    combinations = math.prod(len(axis) for axis in levels)
    if combinations > MOST_COMBINATIONS:
        raise ParameterError("step", step, f"gives {combinations:.3g} combinations, more than {MOST_COMBINATIONS:g}")
    progress = progress or _silent
    quick = objective.name in ("no_load_amplitude", "no_load_peak_to_peak") and objective.function is None
    quick = quick and isinstance(scene.contact, HardContact) and separable.is_separable(free)
    progress(f"grid of {combinations} combinations, {8e-6 * combinations:.3g} MB of objectives")
    found = _structured if quick else _exhaustive
    return found(objective, scene, free, levels, keep, progress)


def _silent(words: str) -> None:
    del words


def _levels(path: str, free: Free, index: int, step: float | Mapping[str, float]) -> np.ndarray:
    spacing = step[path] if isinstance(step, Mapping) and path in step else step
    if isinstance(spacing, Mapping) or not (math.isfinite(spacing) and spacing > 0):
        raise ParameterError(f"step of {path}", spacing, "must be a number above 0")
    period = free.periods[index]
    if period is not None:
        number = round(period / spacing)
        if number < 1 or abs(number * spacing - period) > 1e-9 * period:
            raise ParameterError(f"step of {path}", spacing, f"must divide the period {period:.6g}")
        return -period / 2 + spacing * np.arange(number)
    low, high = free.bounds[index]
    if not (math.isfinite(low) and math.isfinite(high) and high >= low):
        raise ParameterError(f"bounds of {path}", (low, high), "must be finite, lowest first")
    number = math.floor((high - low) / spacing + 1e-9) + 1
    if number > MOST_COMBINATIONS:
        raise ParameterError(f"step of {path}", spacing, f"gives {number:.3g} levels, more than {MOST_COMBINATIONS:g}")
    return low + spacing * np.arange(number)


def _structured(
    objective: Objective, scene: Scene, free: Free, levels: tuple[np.ndarray, ...], keep: int, progress: Progress
) -> GridSearch:
    """Bound, prune, evaluate the survivors exactly."""
    began = time.perf_counter()
    tables = separable.tables(scene, free, levels, objective.theta)
    _check_dependence(tables, free, levels)
    plan = separable.plan(tables)
    spread = objective.metric == "peak_to_peak"

    def score(low: Any, high: Any) -> np.ndarray:
        low, high = np.asarray(low), np.asarray(high)
        return high - low if spread else np.maximum(high, -low)

    def exact(flat: np.ndarray) -> np.ndarray:
        return score(*separable.range_at(tables, _levels_of(flat, plan, levels)))

    size = objective.theta.shape[0]
    bounds = []
    for number in (COARSE, MEDIUM):
        times = np.unique(np.linspace(0, size - 1, min(number, size)).round().astype(int))
        bounds.append(separable.lay_out(tables, plan, times))
    high = np.asarray(separable.highest(bounds[1])).ravel()
    lower = score(np.asarray(separable.lowest(bounds[0])).ravel(), high)
    progress(f"bounded {lower.size} combinations from {COARSE} and {MEDIUM} times")
    first = np.argpartition(lower, min(8 * keep, lower.size) - 1)[: 8 * keep]
    judge = _Judge(objective, scene, free, levels, plan)
    # the objective itself, extremes between samples included: no combination whose bound is above it can be kept
    reached = max(judge(flat)[0] for flat in first[np.argsort(exact(first))[:keep]])
    survivors = np.flatnonzero(lower <= reached * (1 + 1e-12))  # the walk rounds otherwise than the judge
    progress(f"{survivors.size} of them may be among the {keep} best: evaluated on all {size} times")
    values = exact(survivors)
    order = np.argsort(values, kind="stable")
    best = judge.best(survivors[order], values[order], keep)
    return GridSearch(
        paths=free.paths,
        best=best[0][1],
        objective=best[0][0],
        combinations=lower.size,
        evaluated=int(survivors.size),
        runners_up=np.array([numbers for _, numbers in best]),
        objectives=np.array([value for value, _ in best]),
        seconds=time.perf_counter() - began,
    )


def _check_dependence(tables: separable.Tables, free: Free, levels: tuple[np.ndarray, ...]) -> None:
    for path, axis, values in zip(free.paths, tables.axes, levels, strict=True):
        if len(values) > 1 and float(jnp.abs(axis - axis[:1]).max()) == 0:
            raise ParameterError("where", path, "the objective does not depend on it")


def _levels_of(flat: np.ndarray, plan: separable.Plan, levels: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Level of each axis from the flat number of a combination, in the order of the walk."""
    axes = [*plan.outer, *(axis for inner in plan.inner for axis in inner)]
    found = np.unravel_index(flat, tuple(len(levels[axis]) for axis in axes))
    by_axis = dict(zip(axes, found, strict=True))
    return tuple(by_axis[axis] for axis in range(len(levels)))


class _Judge:
    """The objective itself of single combinations."""

    def __init__(self, objective: Objective, scene: Scene, free: Free, levels: tuple[np.ndarray, ...], plan):
        self.levels, self.plan, self.dtype = levels, plan, objective.theta.dtype
        self.objective = jax.jit(lambda numbers: objective.hard(free.set(scene, numbers)))

    def __call__(self, flat: int | np.integer) -> tuple[float, np.ndarray]:
        chosen = _levels_of(np.asarray([flat]), self.plan, self.levels)
        numbers = np.array([axis[level[0]] for axis, level in zip(self.levels, chosen, strict=True)])
        return float(self.objective(jnp.asarray(numbers, self.dtype))), numbers

    def best(self, flat: np.ndarray, values: np.ndarray, keep: int) -> list[tuple[float, np.ndarray]]:
        """The best of combinations that are sorted by their samples, which bound them from below."""
        found: list[tuple[float, np.ndarray]] = []
        for number, value in zip(flat, values, strict=True):
            if len(found) == keep and value > found[-1][0]:
                break
            found = sorted([*found, self(number)], key=lambda item: item[0])[:keep]
        return found


def _check_each(evaluate, objective: Objective, free: Free, levels: tuple[np.ndarray, ...]) -> None:
    """Refuse a number that changes nothing: tried at three levels from each of some combinations."""
    rng = np.random.default_rng(0)
    for index, (path, axis) in enumerate(zip(free.paths, levels, strict=True)):
        rows = np.stack([rng.choice(levels[other], TRIED) for other in range(len(levels))], axis=1)
        rows = np.repeat(rows[:, None, :], 3, axis=1)
        rows[:, :, index] = axis[[0, len(axis) // 2, -1]][None, :]
        found = np.asarray(evaluate(jnp.asarray(rows.reshape(-1, len(levels)), objective.theta.dtype)))
        if len(axis) > 1 and (np.ptp(found.reshape(-1, 3), axis=1) == 0).all():
            raise ParameterError("where", path, "the objective does not depend on it")


def _exhaustive(
    objective: Objective, scene: Scene, free: Free, levels: tuple[np.ndarray, ...], keep: int, progress: Progress
) -> GridSearch:
    """Every combination, in chunks."""
    began = time.perf_counter()
    shape = tuple(len(axis) for axis in levels)
    total = math.prod(shape)

    @jax.jit
    def evaluate(numbers):
        return jax.lax.map(lambda row: objective.hard(free.set(scene, row)), numbers, batch_size=CHUNK)

    def numbers(flat: np.ndarray) -> np.ndarray:
        chosen = np.unravel_index(flat, shape)
        return np.stack([axis[level] for axis, level in zip(levels, chosen, strict=True)], axis=1)

    _check_each(evaluate, objective, free, levels)
    values = np.empty(total)
    chunk = min(total, 64 * CHUNK)
    for start in range(0, total, chunk):
        flat = np.minimum(np.arange(start, start + chunk), total - 1)  # the last chunk repeats its last combination
        found = np.asarray(evaluate(jnp.asarray(numbers(flat), objective.theta.dtype)))
        values[start : start + chunk] = found[: total - start]
        progress(f"{min(start + chunk, total)} of {total} combinations")
    if not np.isfinite(values).any():
        raise ParameterError("objective", objective.name, "is finite for no combination of the grid")
    values = np.where(np.isfinite(values), values, np.inf)
    best = np.argsort(values, kind="stable")[:keep]
    return GridSearch(
        paths=free.paths,
        best=numbers(best[:1])[0],
        objective=float(values[best[0]]),
        combinations=total,
        evaluated=total,
        runners_up=numbers(best),
        objectives=values[best],
        seconds=time.perf_counter() - began,
    )
