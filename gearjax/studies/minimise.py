"""Multi-start minimisation: descent of a smoothed objective, then polish (refinement) of the hard objective.

The best ends are finally evaluated with the hard contact law on all angles.
"""

import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.checks import GearjaxError, ParameterError
from gearjax.compliance import couples
from gearjax.progress import Left, Progress, silent
from gearjax.scene import Scene
from gearjax.studies import valleys
from gearjax.studies.blocks import in_blocks
from gearjax.studies.descent import Optimiser, check_optimiser, default_optimiser, descend
from gearjax.studies.judging import JUDGED, judge
from gearjax.studies.minimax import Polished, polish
from gearjax.studies.objective import Objective
from gearjax.studies.select import Bounds, Free, Where, pick
from gearjax.studies.terms import Term
from gearjax.studies.values import require_influence, values
from gearjax.timing import Stopwatch
from gearjax.typing import Array, ArrayLike, Float, Scalar

CODES = {
    0: "converged",
    1: "the steps ran out while the objective still fell",
    2: "not finite: dropped",
    3: "nothing better than its start was found",
}
UNIMPROVED = "no start was improved upon: narrow the bounds, or give more starts or steps"
SETTLED = 1e-3  # share of the objective: a start has converged if one more step promises less
DESCENT_SAMPLES, POLISH_SAMPLES = 10, 16  # per turn of the fastest error
MOST_NUMBERS = 2**22  # samples times starts that are computed at once
MOST_STARTS = 256  # at once
MANY_MATRICES = 1024  # angles of coupled contacts from which on the starts are computed one by one
MOST_MOTIONS = 16  # starts at once of an objective with dynamic terms
BLOCK = 64  # points evaluated at once: a fixed size, so that one program serves any number of points
FINISHED = 4  # judged ends that are polished on all angles, if a part of them shows something else
SMALLEST = 1e-12  # rad of TE: least objective to which a temperature is relative


class Minimisation(eqx.Module):
    """The result of a multi-start minimisation, with the end point of every start.

    Args:
        paths: the free numbers.
        starts: starting points, shape (starts, free), SI.
        ends: end points, shape (starts, free), SI.
        objectives: objectives of the end points, inf for a dropped start, shape (starts,); over all angles for the best
            ones, over 16 samples per turn with the extremes between them for the others, but not below the best.
        judged: whether the objective of each end point is that over all angles, shape (starts,). The best one is, and
            each one that 16 samples per turn show to be better than it.
        valley: number of the valley of each end point, 0 for the valley of the best, -1 if dropped, shape (starts,).
        result: 0 converged, 1 still falling, 2 dropped because not finite, 3 no better than its start, which is then
            its end (`CODES`), shape (starts,).
        history: the objective at the start, then after each evaluation: smoothed in the descent, hard in the polish,
            shape (starts, 1 + steps).
        evaluations: number of evaluations of the objective with its gradient, of all starts together.
        seconds: wall time without compilation [s].
        compile_seconds: wall time of tracing and compiling [s].
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    starts: np.ndarray
    ends: np.ndarray
    objectives: np.ndarray
    judged: np.ndarray
    valley: np.ndarray
    result: np.ndarray
    history: np.ndarray
    evaluations: int
    seconds: float
    compile_seconds: float

    @property
    def best(self) -> np.ndarray:
        """Values of the free numbers at the best end point, shape (free,), SI."""
        return self.ends[np.argmin(self.objectives)]

    @property
    def objective(self) -> float:
        """The objective at the best end point, by the scene's own contact law, over all angles.

        Its extremes are where the analyses search them by default: between samples too, but not for slices and coupled
        contacts under torque.
        """
        return float(self.objectives.min())

    @property
    def failed(self) -> int:
        """Number of starts that were dropped."""
        return int((self.result == 2).sum())

    @property
    def improved(self) -> bool:
        """Whether any end point is better than its start."""
        return bool((self.result < 2).any())

    def within(self, share: float = 0.01) -> int:
        """Number of starts that ended within a share of the best objective."""
        return int((self.objectives <= self.objective + share * abs(self.objective)).sum())


@arguments.checked(
    starts=arguments.starts,
    polish_steps=arguments.whole(0),
    temperatures=arguments.numbers,
    key=arguments.a_key,
)
def minimise(
    loss: str | Callable[[Scene], Any] | Term | Sequence[Term] | Objective,
    scene: Scene,
    *,
    where: Where,
    starts: int | ArrayLike | Sequence[Sequence[float]] = 300,
    theta: ArrayLike | None = None,
    torque: float | None = None,
    bounds: Bounds | None = None,
    optimiser: Any = None,
    steps: int = 30,
    polish_steps: int = 12,
    temperatures: tuple[float, float] = (0.1, 0.0015),
    key: Array | int | None = None,
    progress: Progress | None = None,
) -> Minimisation:
    r"""Minimise an objective over numbers of a scene, from many starts at once.

    Each start descends the smoothed objective (`gearjax.studies.objective`) while its temperature falls. The end is
    polished on the objective with the hard contact law (`gearjax.studies.minimax`), whose optima lie on kinks. Angles
    are periodic; other numbers stay within their bounds, by a logistic transform in the descent and exactly in the
    polish. The descent uses 10 samples per turn of the fastest error, the polish 16 with the extremes between them, and
    both more where an order asks for it; the best ends are then judged on all samples.

    Args:
        loss: what to minimise: a name such as ``"no_load_amplitude"``, `Term`\ s to be summed, or a function of the
            scene that returns a number (in the descent, the scene that it gets has a smooth contact law).
        scene: the scene; its own numbers are the first start.
        where: paths of the free numbers, or a function that returns them.
        starts: number of starts, all but the first random; or the starting points, shape (starts, free), SI.
        theta: input angles [rad]; by default those of the scene's run section, or one cycle.
        torque: load torque of a static or dynamic loss given by name [N m].
        bounds: lowest and highest value by path, SI; needed for numbers that are not angles, unless their declared
            bounds are close to each other (a factor of 100, or a span of 2 for a ratio or angle).
        optimiser: optimiser of the descent, from optax (``optax.adam(0.1)``) or optimistix
            (``optimistix.BFGS(1e-4, 1e-6)``).
        steps: number of steps of the descent.
        polish_steps: number of steps of the polish, 0 for none.
        temperatures: first and last temperature of the descent, as shares of the objective at the start.
        key: seed of the starts, or a random key; by default the seed 0.
        progress: called with a line of text now and then.

    Returns:
        All end points. Starts that are not finite are dropped and counted, without an error. A warning is given if no
        end is better than its start.

    Raises:
        ParameterError: a path or a bound is wrong, or the objective does not depend on a number.
        GearjaxError: no start has a finite objective.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> minimum = gj.minimise("no_load_amplitude", scene, where=["errors.planet_1.phase"], starts=4)
        >>> minimum.ends.shape, minimum.failed
        ((4, 1), 0)
    """
    with Stopwatch() as watch:
        objective = Objective.of(loss, scene, theta, torque)
        free = pick(scene, where, bounds)
        free.require_bounds()
        optimiser = default_optimiser(steps) if optimiser is None else optimiser
        check_optimiser(optimiser)
        _check(steps, polish_steps, temperatures)
        points = _starting_points(free, scene, starts, key)
        coarse = objective.coarse(scene, POLISH_SAMPLES).tabulated(scene, free)
        sampled = values(coarse, scene, free, "sampled", BLOCK)
        require_influence(coarse, scene, free, *free.box)
        begun = sampled(points)
        physics, descent = objective.physics(scene, free), objective.coarse(scene, DESCENT_SAMPLES)
        numbers = (steps, polish_steps), jnp.array(temperatures)
        search = _Search(descent.tabulated(scene, free), coarse, free, *numbers)
        descents = _in_chunks(search, physics, points, begun, optimiser, progress or silent)
        result = np.asarray(descents.result)
        if (result == 2).all():
            raise GearjaxError(f"minimise {objective.name}: no start has a finite objective ({len(points)} dropped)")
        ends = np.where(result[:, None] == 2, np.nan, free.wrapped(np.asarray(descents.ends)))
        objectives = np.where(result == 2, np.inf, descents.value if polish_steps else sampled(ends))
        back = (begun < objectives) & (result != 2)  # an end that is worse than its start is replaced by it
        ends[back], objectives[back] = points[back], begun[back]
        result = np.where(back, 3, result)
        if not (result < 2).any():
            warnings.warn(f"minimise {objective.name}: {UNIMPROVED}", stacklevel=3)
        seen, exactly = objectives.copy(), values(objective, scene, free, block=JUDGED)
        judged, best = judge(objectives, ends, exactly), np.argmin(objectives)
        apart = abs(seen[best] - objectives[best]) > SETTLED * abs(objectives[best])
        evaluations = int(np.asarray(descents.evaluations).sum())
        if polish_steps and apart and not objective.between_alone(scene):
            last = search.over(objective.tabulated(scene, free))
            finish = functools.partial(_in_chunks, last, physics, optimiser=optimiser, progress=silent)
            evaluations += _finish(finish, free, ends, objectives, result, judged, exactly)
        labels = valleys.label(free, ends, objectives, sampled)
    return Minimisation(
        paths=free.paths,
        starts=points,
        ends=ends,
        objectives=objectives,
        judged=judged,
        valley=labels,
        result=result,
        history=np.concatenate([begun[:, None], np.asarray(descents.history)], axis=1),
        evaluations=evaluations,
        seconds=watch.seconds,
        compile_seconds=watch.compile_seconds,
    )


def _finish(
    finish: Callable[[np.ndarray, np.ndarray], "_Descents"],
    free: Free,
    ends: np.ndarray,
    objectives: np.ndarray,
    result: np.ndarray,
    judged: np.ndarray,
    exactly: Callable[[np.ndarray], np.ndarray],
) -> int:
    """Polish the best ends on all angles, and put what is better in their place: the number of evaluations.

    Args:
        finish: the polish, of ends with their objectives.
        free: the free numbers.
        ends, objectives, result: those of all starts; they are changed.
        judged: whether the objective of each end is that over all angles.
        exactly: function from points to objectives over all angles.
    """
    first = np.argsort(np.where(judged, objectives, np.inf), kind="stable")[: min(FINISHED, judged.sum())]
    finished = finish(ends[first], objectives[first])
    there = free.wrapped(np.asarray(finished.ends))
    reached = exactly(there)
    better = reached < objectives[first]
    first = first[better]
    ends[first], objectives[first], result[first] = there[better], reached[better], np.asarray(finished.result)[better]
    return int(np.asarray(finished.evaluations).sum())


def _check(steps: int, polish_steps: int, temperatures: tuple[float, float]) -> None:
    for name, number in (("steps", steps), ("polish_steps", polish_steps)):
        if number < 0:
            raise ParameterError(name, number, "must be at least 0")
    if np.shape(temperatures) != (2,) or not min(temperatures) > 0:
        raise ParameterError("temperatures", temperatures, "must be above 0, two numbers: the first and the last")


def _starting_points(free: Free, scene: Scene, starts: Any, key: Array | int | None) -> np.ndarray:
    if not isinstance(starts, int):
        given = np.asarray(starts, dtype=float)
        if given.ndim != 2 or given.shape[0] < 1 or given.shape[1] != len(free.paths):
            raise ParameterError("starts", given.shape, f"must have shape (starts, {len(free.paths)})")
        return np.where(np.isfinite(given), free.wrapped(given), given)
    if starts < 1:
        raise ParameterError("starts", starts, "must be at least 1")
    key = key if isinstance(key, jax.Array) else jax.random.key(key or 0)
    share = np.asarray(jax.random.uniform(key, (starts, len(free.paths))), dtype=float)
    low, high = free.box
    points = low + share * (high - low)
    points[0] = free.wrapped(np.asarray(free.get(scene), dtype=float))
    return points


class _Descents(NamedTuple):
    """End of one start, or of many starts."""

    ends: Any
    value: Any
    result: Any
    history: Any
    evaluations: Any


class _Search(eqx.Module):
    """Descent and polish of one start."""

    descent: Objective
    polishing: Objective
    free: Free
    steps: tuple[int, int] = eqx.field(static=True)
    temperatures: Float[Array, "2"]

    def __call__(self, physics: Scene, start: Float[Array, " free"], begun: Scalar, optimiser: Optimiser) -> _Descents:
        """Descend and polish from a start and the objective there."""
        dtype = start.dtype
        size = jnp.maximum(jnp.abs(begun), SMALLEST)
        numbers, losses, evaluations = start, jnp.zeros((0,), dtype), jnp.asarray(0)
        if self.steps[0]:
            first, last = self.temperatures.astype(dtype)
            numbers, losses, evaluations = descend(
                lambda numbers, share: self._loss(physics, numbers, share, size),
                self.free.unconstrained(start),
                optimiser,
                self.steps[0],
                (first, last),
            )
            numbers = self.free.constrained(numbers)
        ended = self._polish(physics, numbers)
        finite = jnp.isfinite(numbers).all() & jnp.isfinite(ended.numbers).all() & jnp.isfinite(begun)
        finite &= jnp.isfinite(ended.value) if self.steps[1] else True
        result = jnp.where(finite, jnp.where(ended.promise > SETTLED, 1, 0), 2)
        history = jnp.concatenate([losses * size, ended.history])
        return _Descents(ended.numbers, ended.value, result, history, evaluations + self.steps[1])

    def over(self, whole: Objective) -> "_Search":
        """The polish alone, on another objective."""
        return _Search(whole, whole, self.free, (0, self.steps[1]), self.temperatures)

    def _loss(self, physics: Scene, numbers: Float[Array, " free"], share: Scalar, size: Scalar) -> Scalar:
        """The smoothed objective divided by the objective at the start, of which the temperature is a share."""
        moved = self.free.set(physics, self.free.constrained(numbers))
        return self.descent.smooth(moved, share * size) / size

    def _polish(self, physics: Scene, numbers: Float[Array, " free"]) -> Polished:
        free, dtype = self.free, numbers.dtype
        if not self.steps[1]:  # without polish it is not known whether the start has converged
            return Polished(numbers, jnp.zeros((), dtype), jnp.zeros((), dtype), jnp.zeros((0,), dtype))
        origins, scales = jnp.asarray(free.origins, dtype), jnp.asarray(free.scales, dtype)
        low, high = ((bound - free.origins) / free.scales for bound in np.array(free.bounds).T)

        def at(place: Float[Array, " free"]) -> Scene:
            return free.set(physics, origins + scales * place)

        def bend(place: Float[Array, " free"]) -> Float[Array, "free free"]:
            bends, ways = jnp.linalg.eigh(jax.hessian(lambda place: self.polishing.smooth_part(at(place)))(place))
            return (ways * jnp.maximum(bends, 0.0)[None, :]) @ ways.T

        ended = polish(
            lambda place: self.polishing.pieces(at(place)),
            (numbers - origins) / scales,
            np.where(free.periodic, -np.inf, low),
            np.where(free.periodic, np.inf, high),
            self.steps[1],
            bend if self.polishing.is_bent else None,
        )
        return ended._replace(numbers=origins + scales * ended.numbers)


@eqx.filter_jit
def _run(search: _Search, physics: Scene, starts: Array, begun: Array, optimiser: Optimiser) -> _Descents:
    return jax.vmap(lambda start, value: search(physics, start, value, optimiser))(starts, begun)


def _in_chunks(
    search: _Search, physics: Scene, points: np.ndarray, begun: np.ndarray, optimiser: Optimiser, progress: Progress
) -> _Descents:
    """Run all starts, in chunks that fit into memory."""
    dtype = search.descent.theta.dtype
    most = max(1, min(MOST_STARTS, MOST_NUMBERS // search.polishing.theta.shape[0]))
    if couples(physics.compliance) and search.polishing.theta.shape[0] > MANY_MATRICES:
        most = 1  # of each angle there is a matrix
    if search.descent.is_dynamic:
        most = min(most, MOST_MOTIONS)
    if search.descent.scatter is not None:
        most = max(1, most // len(search.descent.scatter.values))
    chunks = -(-len(points) // most)
    size = -(-len(points) // chunks)
    progress(f"{len(points)} starts, {size} at once")

    def run(points: np.ndarray, begun: np.ndarray) -> _Descents:
        return _run(search, physics, jnp.asarray(points, dtype), jnp.asarray(begun, dtype), optimiser)

    left = Left(len(points))

    def done(number: int) -> None:
        rest = left.after(number - left.done)
        progress(f"{number} of {len(points)} starts descended and polished{rest}")

    return in_blocks(run, size, points, begun, done=done)
