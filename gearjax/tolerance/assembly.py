"""Assembly matched to the parts: phases chosen for each gear set from its own measured errors, next to random ones."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.metrics import deviation
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.progress import Progress, silent
from gearjax.studies.descent import default_optimiser, descend
from gearjax.studies.select import numbers, pick
from gearjax.timing import Stopwatch
from gearjax.tolerance import statistics
from gearjax.tolerance.measures import Measure, Measures
from gearjax.tolerance.monte_carlo import Work, over_rows
from gearjax.tolerance.population import Tolerances, a_population
from gearjax.tolerance.sampling import points
from gearjax.tolerance.statistics import Estimate
from gearjax.typing import Array, Scalar

STEPS = 60
TEMPERATURES = 0.1, 0.0015  # shares of the measure at the start
PER_TURN = 12  # samples of the fastest error that the descent looks at
BLOCK = 1024  # gear sets whose phases are searched before progress is told
TOGETHER = 4  # side by side on one device


@dataclasses.dataclass(frozen=True)
class MatchedAssembly:
    """Gear sets as assembled at random, and with phases chosen for each.

    Args:
        measure: what was made small, or brought within its limits (`Measure.excess`).
        where: the phases that were chosen.
        random: the measure as assembled at random, shape (units,).
        matched: with the chosen phases, shape (units,).
        phases: the chosen phases, shape (units, where) [rad].
        seconds, compile_seconds: wall time, compilation apart [s].
    """

    measure: Measure
    where: tuple[str, ...]
    random: np.ndarray
    matched: np.ndarray
    phases: np.ndarray
    seconds: float
    compile_seconds: float

    def quantiles(self, level: float) -> tuple[Estimate, Estimate]:
        """A quantile at random and matched, each with its interval, of the units that did not fail."""
        random, matched = (part[np.isfinite(part)] for part in (self.random, self.matched))
        return (
            statistics.quantile(random, level, np.array([len(random)])),
            statistics.quantile(matched, level, np.array([len(matched)])),
        )

    @property
    def failed(self) -> int:
        """Units that failed at random or matched."""
        return int((~np.isfinite(self.random + self.matched)).sum())

    def shares(self) -> tuple[Estimate, Estimate]:
        """Yield at random and matched, each with its interval."""
        sizes = np.array([len(self.random)])
        random, matched = (statistics.share(self.measure.holds(v), sizes) for v in (self.random, self.matched))
        return random, matched


@arguments.checked(tolerances=a_population, units=arguments.whole(1), starts=arguments.whole(1))
def matched_assembly(
    tolerances: Tolerances,
    measure: str | Measure,
    *,
    where: tuple[str, ...],
    units: int = 1000,
    starts: int = 8,
    key: int = 0,
    progress: Progress = silent,
    **options: Any,
) -> MatchedAssembly:
    """What choosing the phases of each gear set from its own errors buys.

    For each gear set of the population the phases are searched from several starts at once, its own random ones among
    them: smoothed descent over a part of the input angles, then the hard measure over all decides.

    Args:
        tolerances: the population; phases in ``where`` that it does not list are random too.
        measure: of a quasi-static analysis with hard contacts.
        where: paths of the phases.
        units: how many gear sets.
        starts: of each search.
        key: seed.
        progress: told how far it is.
        options: ``theta``, ``extremes``, ``chunk`` and ``devices`` of `monte_carlo`.

    Raises:
        ParameterError: ``where`` names something else than phases.
        SceneError: the measure does not allow a quick search.
    """
    from gearjax.tolerance.distributions import UniformPhase

    known = numbers(tolerances.scene)
    phases = [path for path in known if known[path].periodic]
    if not where:
        raise ParameterError("where", where, f"must be phases; {nearest('', phases)}")
    for path in where:
        if path not in phases or where.count(path) > 1:
            raise ParameterError("where", path, f"must be phases, each once; {nearest(path, phases)}")
    added = {path: UniformPhase() for path in where if path not in tolerances.distributions}
    population = Tolerances(tolerances.scene, {**tolerances.distributions, **added}, tolerances.correlations)
    with Stopwatch() as watch:
        work = Work(population, measure, number=units, seed=key, **options)
        chosen = work.measures[0]
        search = _Search(population, chosen, where, work)
        inputs = work.inputs(0, units)
        random = work.evaluate(inputs)[0][:, 0]
        names = [f"start of {path}" for path in where]
        drawn = points("monte_carlo", key, names, units * starts, 0, units * starts)
        begun = (2 * np.pi * (drawn - 0.5)).reshape(units, starts, len(where))
        begun[:, 0] = inputs[:, search.places]
        ends = np.empty_like(begun)
        for first in range(0, units, BLOCK):
            rows = np.minimum(np.arange(first, first + BLOCK), units - 1)
            ends[first : first + BLOCK] = search.run(inputs[rows], begun[rows])[: units - first]
            progress(f"matched assembly: {min(first + BLOCK, units)} of {units} units searched")
        rows = np.repeat(inputs[:, None], starts, axis=1)
        rows[:, :, search.places] = ends
        found = work.evaluate(rows.reshape(-1, rows.shape[2]))[0][:, 0].reshape(units, starts)
        found = np.concatenate([found, random[:, None]], axis=1)  # nobody assembles worse than at random on purpose
        ends = np.concatenate([ends, inputs[:, None, search.places]], axis=1)
    ranked = np.where(np.isfinite(found), chosen.excess(found), np.inf)
    best = np.argmin(ranked, axis=1)
    line = np.arange(units)
    phases = np.mod(ends[line, best] + np.pi, 2 * np.pi) - np.pi
    return MatchedAssembly(chosen, where, random, found[line, best], phases, watch.seconds, watch.compile_seconds)


class _Search:
    """The descent of many gear sets at once."""

    def __init__(self, population: Tolerances, measure: Measure, where: tuple[str, ...], work: Work):
        scene, theta = population.scene, work.one.theta
        self.measure, self.where = measure, where
        self.places = np.array([population.paths.index(path) for path in where])
        turns = max((order for name, order in scene.system.orders.items() if name != "mesh"), default=1.0)
        span = float(theta[-1] - theta[0])
        number = min(len(theta), max(64, round(turns * span / (2 * np.pi) * PER_TURN)))
        coarse = jnp.asarray(np.linspace(float(theta[0]), float(theta[-1]), number), scene.dtype)
        self.measures = Measures([measure], population, coarse, "samples")
        if self.measures.curves is None:
            raise SceneError(f"matched assembly: {measure.name} needs a quasi-static analysis with hard contacts")
        self.free = pick(scene, population.paths)
        optimiser = default_optimiser(STEPS)

        def unit(values: Array, starts: Array) -> Array:
            def loss(phases: Array, temperature: Scalar) -> Scalar:
                return self._smooth(values.at[self.places].set(phases), temperature)

            def one(start: Array) -> Array:
                scale = jnp.maximum(jnp.abs(self.measures(values.at[self.places].set(start))[0][0]), 1e-12)
                hot, cold = (share * scale for share in TEMPERATURES)
                return descend(loss, start, optimiser, STEPS, (hot, cold))[0]

            return jax.vmap(one)(starts)

        self._program = over_rows(unit, work.devices, TOGETHER)

    def run(self, inputs: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Ends of the descents, shape (unit, start, where)."""
        return self._program(*(part.astype(self.measures.theta.dtype) for part in (inputs, starts)))

    def _smooth(self, values: Array, temperature: Scalar) -> Scalar:
        """What the measure has too much of (`Measure.excess`), with smooth largest values."""
        curve = self.measures.curve(values, self.measure)

        def largest(curve: Array) -> Scalar:
            return temperature * jax.nn.logsumexp(curve / temperature)

        found = {
            "mean": lambda: curve.mean(),
            "std": lambda: deviation(curve),
            "peak_to_peak": lambda: largest(curve) + largest(-curve),
            "amplitude": lambda: largest(jnp.concatenate([curve, -curve])),
            "maximum": lambda: largest(curve),
            "minimum": lambda: -largest(-curve),
        }[self.measure.metric]()
        return self.measure.excess(found)
