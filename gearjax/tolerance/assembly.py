"""Matched assembly: phases chosen for each gear set from its own measured errors, compared with random phases."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.metrics import deviation
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.contact import HardContact
from gearjax.progress import Left, Progress, silent
from gearjax.scene_checks import require_output_alone
from gearjax.studies.descent import default_optimiser, descend
from gearjax.studies.select import numbers
from gearjax.timing import Stopwatch
from gearjax.tolerance import statistics
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.measures import Measures
from gearjax.tolerance.monte_carlo import Work
from gearjax.tolerance.population import Tolerances, a_population
from gearjax.tolerance.rows import RowProgram
from gearjax.tolerance.sampling import points
from gearjax.tolerance.statistics import Estimate
from gearjax.typing import Array, Float, Scalar

STEPS = 60
PER_TURN = 12  # samples of the descent per turn of the fastest error
FEWEST, MOST = 64, 512  # samples of the descent
FEW = 101  # samples of a first descent, if more than MOST would be needed; a prime, as it shares no factor with teeth
SMALLEST = 1e-12  # rad: least measure to which a temperature is relative
BLOCK = 1024  # gear sets whose phases are searched before progress is reported
TOGETHER = 32  # rows side by side on one device


class _Way(NamedTuple):
    """Settings of a descent.

    Args:
        rate: learning rate of the first steps [rad].
        temperatures: first and last temperature, as shares of the measure at the start.
        words: text for the progress.
    """

    rate: float
    temperatures: tuple[float, float]
    words: str = ""


FIRST = _Way(0.4, (0.1, 0.0015))
SECOND = _Way(0.1, (0.02, 0.0015), ", over all angles")


@dataclasses.dataclass(frozen=True)
class MatchedAssembly:
    """Gear sets assembled at random, and with phases chosen for each gear set.

    Args:
        measure: measure that was minimised, or brought within its limits (`Measure.excess`).
        where: paths of the phases that were chosen.
        random: the measure of gear sets assembled at random, shape (units,).
        matched: the measure with the chosen phases, shape (units,).
        phases: the chosen phases, shape (units, where) [rad].
        seconds, compile_seconds: wall time without compilation, and that of compilation [s].
    """

    measure: Measure
    where: tuple[str, ...]
    random: np.ndarray
    matched: np.ndarray
    phases: np.ndarray
    seconds: float
    compile_seconds: float

    def quantiles(self, level: float) -> tuple[Estimate, Estimate]:
        """A quantile of random and of matched assembly, each with its interval, of the units that did not fail."""
        random, matched = (part[np.isfinite(part)] for part in (self.random, self.matched))
        return (
            statistics.quantile(random, level, np.array([len(random)])),
            statistics.quantile(matched, level, np.array([len(matched)])),
        )

    @property
    def failed(self) -> int:
        """Number of units that failed in random or in matched assembly."""
        return int((~np.isfinite(self.random + self.matched)).sum())

    def shares(self) -> tuple[Estimate, Estimate]:
        """Yield of random and of matched assembly, each with its interval."""
        sizes = np.array([len(self.random)])
        random, matched = (statistics.share(self.measure.holds(v), sizes) for v in (self.random, self.matched))
        return random, matched


@arguments.checked(tolerances=a_population, units=arguments.whole(1), starts=arguments.whole(1))
def matched_assembly(
    tolerances: Tolerances,
    measure: str | Measure,
    *,
    where: str | Sequence[str],
    units: int = 1000,
    starts: int = 8,
    key: int = 0,
    progress: Progress = silent,
    **options: Any,
) -> MatchedAssembly:
    """Choose the phases of each gear set from its own errors, and compare the result with random phases.

    For each gear set of the population, phases are searched from several starts at once; the first start is its own
    random phases. The smoothed measure is descended over a part of the input angles; then the phases with the best hard
    measure over all angles are chosen.

    Args:
        tolerances: the population; phases in ``where`` that it does not list are random too.
        measure: a measure of a quasi-static analysis with hard contacts.
        where: path or paths of the phases.
        units: number of gear sets.
        starts: number of starts of each search.
        key: seed of the samples.
        progress: called with a line of text now and then.
        options: ``theta``, ``extremes``, ``chunk`` and ``devices`` of `monte_carlo`.

    Raises:
        ParameterError: ``where`` contains something other than phases.
        SceneError: the measure does not allow a fast search.
    """
    from gearjax.tolerance.distributions import UniformPhase

    known = numbers(tolerances.scene)
    phases = [path for path in known if known[path].periodic]
    where = (where,) if isinstance(where, str) else (*where,)
    if not where:
        raise ParameterError("where", where, f"must be phases; {nearest('', phases)}")
    for path in where:
        if path not in phases or where.count(path) > 1:
            raise ParameterError("where", path, f"must be phases, each once; {nearest(path, phases)}")
    added = {path: UniformPhase() for path in where if path not in tolerances.distributions}
    population = tolerances
    if added:
        population = Tolerances(tolerances.scene, {**tolerances.distributions, **added}, tolerances.correlations)
    with Stopwatch() as watch:
        work = Work(population, measure, number=units, seed=key, **options)
        chosen = work.measures[0]
        searches = _searches(population, chosen, where, work)
        inputs = work.inputs(0, units)
        places = np.array([population.paths.index(path) for path in where])
        names = [f"start of {path}" for path in where]
        drawn = points("monte_carlo", key, names, units * starts, 0, units * starts)
        begun = (2 * np.pi * (drawn - 0.5)).reshape(units, starts, len(where))
        begun[:, 0] = inputs[:, places]

        def judged(phases: np.ndarray) -> np.ndarray:
            rows = np.repeat(inputs[:, None], phases.shape[1], axis=1)
            rows[:, :, places] = phases
            return work.evaluate(rows.reshape(-1, rows.shape[2]))[0][:, 0].reshape(phases.shape[:2])

        tried = inputs[:, None, places]  # the random phases are kept if no search finds better ones
        values = random = judged(tried)
        for search in searches:
            ended = search.of_all(inputs, begun, progress)
            tried, values = np.concatenate([tried, ended], axis=1), np.concatenate([values, judged(ended)], axis=1)
            best = np.argmin(np.where(np.isfinite(values), chosen.excess(values), np.inf), axis=1)
            begun = tried[np.arange(units), best][:, None]
    phases = np.mod(begun[:, 0] + np.pi, 2 * np.pi) - np.pi
    matched = values[np.arange(units), best]
    return MatchedAssembly(chosen, where, random[:, 0], matched, phases, watch.seconds, watch.compile_seconds)


def _searches(population: Tolerances, measure: Measure, where: tuple[str, ...], work: Work) -> "list[_Search]":
    """One search if few angles determine the measure; otherwise one over few angles, and one over all from its best."""
    theta = work.one.theta
    turns = population.scene.system.fastest_order * float(theta[-1] - theta[0]) / (2 * np.pi)
    number = max(FEWEST, round(turns * PER_TURN))
    if number <= MOST:
        return [_Search(population, measure, where, work, min(len(theta), number), FIRST)]
    few, every = min(len(theta), FEW), len(theta)
    return [
        _Search(population, measure, where, work, few, FIRST),
        _Search(population, measure, where, work, every, SECOND),
    ]


def _lacking(measure: Measure, population: Tolerances) -> str:
    """What a population lacks that has no quick curves of a measure."""
    scene = population.scene
    if measure.analysis == "dynamic":
        return "a measure without motion"
    if not isinstance(scene.contact, HardContact):
        return "hard contacts"
    if scene.system.exact:
        return 'clearance = "linear"'
    if measure.analysis == "static" and not scene.springs_apart:
        return "linear springs of pairs of teeth; a measure without load does not"
    return "numbers of errors alone as those that vary"


class _Search:
    """The descent of many gear sets from many starts at once: each row is one start of one gear set."""

    def __init__(
        self, population: Tolerances, measure: Measure, where: tuple[str, ...], work: Work, number: int, way: "_Way"
    ):
        self.measure, self.way = measure, way
        self.places = np.array([population.paths.index(path) for path in where])
        theta = np.linspace(float(work.one.theta[0]), float(work.one.theta[-1]), number)
        self.measures = Measures([measure], population, jnp.asarray(theta, population.scene.dtype), "samples")
        if self.measures.curves is None:
            require_output_alone(population.scene, "matched assembly")
            raise SceneError(f"matched assembly by {measure.name} needs {_lacking(measure, population)}")
        self.devices = work.devices

    def of_all(self, inputs: np.ndarray, starts: np.ndarray, progress: Progress) -> np.ndarray:
        """Ends of the descents of gear sets, shape (unit, free), from starts; both of shape (unit, start, where)."""
        units, number, size = starts.shape
        ends, program = np.empty_like(starts), RowProgram(self, self.devices, TOGETHER, min(units, BLOCK) * number)
        left = Left(units)
        for first in range(0, units, BLOCK):
            part = slice(first, first + BLOCK)
            rows = np.repeat(inputs[part], number, axis=0), starts[part].reshape(-1, size)
            reached = program(*(row.astype(self.measures.theta.dtype) for row in rows))
            ends[part] = reached.reshape(-1, number, size)
            rest = left.after(len(reached) // number)
            progress(f"matched assembly: {left.done:.0f} of {units} units searched{self.way.words}{rest}")
        return ends

    def __call__(self, values: Float[Array, " free"], start: Float[Array, " where"]) -> Float[Array, " where"]:
        """End of the descent of one row."""
        return self.rows(values[None], start[None])[0]

    def rows(self, values: Float[Array, "row free"], starts: Float[Array, "row where"]) -> Float[Array, "row where"]:
        """Ends of the descents of several rows at once.

        Rows are independent, so the gradient of the sum of their losses contains the gradient of each.
        """

        def moved(phases: Array) -> Array:
            return values.at[:, self.places].set(phases.reshape(starts.shape))

        def loss(phases: Array, temperature: Array) -> Scalar:
            curves = self.measures.curve_rows(moved(phases), self.measure)
            return jax.vmap(self._smooth)(curves, temperature).sum()

        scale = jnp.maximum(jnp.abs(self.measures.rows(moved(starts))[0][:, 0]), SMALLEST)
        hot, cold = (share * scale for share in self.way.temperatures)
        optimiser = default_optimiser(STEPS, self.way.rate)
        return descend(loss, starts.ravel(), optimiser, STEPS, (hot, cold))[0].reshape(starts.shape)

    def _smooth(self, curve: Float[Array, " n"], temperature: Scalar) -> Scalar:
        """The excess of the measure (`Measure.excess`), with smooth largest values."""

        def largest(curve: Array) -> Scalar:
            return temperature * jax.nn.logsumexp(curve / temperature)

        value = {
            "mean": lambda: curve.mean(),
            "std": lambda: deviation(curve),
            "peak_to_peak": lambda: largest(curve) + largest(-curve),
            "amplitude": lambda: largest(jnp.concatenate([curve, -curve])),
            "maximum": lambda: largest(curve),
            "minimum": lambda: -largest(-curve),
        }[self.measure.metric]()
        return self.measure.excess(value)
