"""Monte Carlo studies: samples in chunks of one shape, side by side on all local devices."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError, nearest
from gearjax.memory import fitting, free_memory, size_words
from gearjax.progress import Left, Progress, Seldom, silent
from gearjax.scene import Scene
from gearjax.timing import Stopwatch, counting
from gearjax.tolerance import statistics
from gearjax.tolerance.measure import Measure, listed
from gearjax.tolerance.measures import CODES, Measures, SceneMeasures
from gearjax.tolerance.population import Tolerances
from gearjax.tolerance.quick import Part
from gearjax.tolerance.rows import RowProgram, Started
from gearjax.tolerance.sampling import SAMPLERS, points, replicate_sizes
from gearjax.tolerance.statistics import Estimate
from gearjax.typing import Array, ArrayLike

CHUNK = 16384
PIECES = 20  # of inputs whose progress is told
ACCELERATED = 1024  # samples side by side on an accelerator, at least
KEPT_STRATA = 6  # numbers that are kept for each sample of a Latin hypercube, for the orders of its strata
QUANTILES = (0.05, 0.5, 0.95)
Evaluated = tuple[np.ndarray, np.ndarray]
"""Measures, shape (n, measure), and result codes, shape (n,)."""


@dataclasses.dataclass(frozen=True)
class Study:
    """The results of a Monte Carlo study.

    Args:
        names: names of the measures.
        values: measures of each sample, nan if it failed, shape (n, measure).
        result: result code of each sample, 0 for good (`gearjax.tolerance.measures.CODES`), shape (n,).
        sizes: numbers of samples of the independent designs, adding to n.
        measures: the measures with their limits; empty if the measure was a function.
        seconds: wall time without compilation [s].
        compile_seconds: wall time of tracing and compiling [s].
    """

    names: tuple[str, ...]
    values: np.ndarray
    result: np.ndarray
    sizes: np.ndarray
    measures: tuple[Measure, ...] = ()
    seconds: float = 0.0
    compile_seconds: float = 0.0

    @property
    def samples(self) -> int:
        """Number of gear sets that were evaluated."""
        return len(self.result)

    @property
    def failed(self) -> np.ndarray:
        """Indices of the samples that failed."""
        return np.flatnonzero(self.result)

    @property
    def faults(self) -> dict[str, int]:
        """Number of failed samples, by the meaning of the result code."""
        codes, counts = np.unique(self.result[self.failed], return_counts=True)
        return {CODES.get(int(code), f"code {code}"): int(count) for code, count in zip(codes, counts, strict=True)}

    def column(self, name: str) -> np.ndarray:
        """Values of one measure, nan if a sample failed, shape (n,).

        Raises:
            ParameterError: there is no such measure.
        """
        if name not in self.names:
            raise ParameterError("measure", name, nearest(name, self.names))
        return self.values[:, self.names.index(name)]

    def good(self, name: str) -> np.ndarray:
        """Values of one measure of the samples that did not fail."""
        column = self.column(name)
        return column[np.isfinite(column)]

    def mean(self, name: str) -> float:
        """Mean of a measure."""
        good = self.good(name)
        return float(good.mean()) if good.size else math.nan

    def std(self, name: str) -> float:
        """Standard deviation of a measure."""
        good = self.good(name)
        return float(good.std(ddof=1)) if good.size > 1 else math.nan

    def quantile(self, name: str, level: float) -> Estimate:
        """Value below which a share of the gear sets lies, with its interval of 95 % confidence.

        Raises:
            ParameterError: the level is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ParameterError("level", level, "must be above 0 and below 1")
        good = self.good(name)
        whole = len(good) == self.samples
        return statistics.quantile(good, level, self.sizes if whole else np.array([len(good)]))

    def share_within(self, name: str, limit: float | None = None) -> Estimate:
        """Share of gear sets whose measure is within a limit, with its interval of 95 % confidence: the yield.

        Args:
            name: name of the measure.
            limit: highest good value; by default the limits of the measure itself. A sample that failed is not good.

        Raises:
            ParameterError: the measure has no limit.
        """
        column = self.column(name)
        if limit is not None and np.isnan(limit):
            raise ParameterError("limit", limit, "must be a number")
        if limit is not None:
            return statistics.share(column <= limit, self.sizes)
        measure = next((m for m in self.measures if m.name == name and m.is_limited), None)
        if measure is None:
            raise ParameterError("limit", limit, f"{name} has no limit of its own: give one")
        return statistics.share(measure.holds(column), self.sizes)

    def worst(self, name: str) -> int:
        """Index of the worst sample (by `Measure.excess`); -1 if all failed."""
        column = self.column(name)
        if not np.isfinite(column).any():
            return -1
        measure = next((m for m in self.measures if m.name == name), None)
        return int(np.nanargmax(column if measure is None else measure.excess(column)))


class Work:
    """A study as independent chunks: the results of a chunk depend only on the study and the indices of its samples.

    Args:
        sample, measure, number, seed, sampler, theta, extremes, chunk, devices: as for `monte_carlo`.
        workers: number of programs that are compiled in parallel, in threads. A thread uses the settings of the whole
            process, but not settings of the calling thread alone.
    """

    def __init__(
        self,
        sample: Any,
        measure: Any,
        *,
        number: int,
        seed: Any = 0,
        sampler: str = "monte_carlo",
        theta: ArrayLike | None = None,
        extremes: str | None = None,
        chunk: int = CHUNK,
        devices: Sequence[Any] | None = None,
        workers: int = 1,
    ):
        self.number, self.sampler, self.workers = _whole("n", number), sampler, workers
        if sampler not in SAMPLERS:
            raise ParameterError("sampler", sampler, nearest(sampler, SAMPLERS))
        seed = int(seed) if isinstance(seed, int | np.integer) else seed
        self.seed = seed if isinstance(seed, int) else int.from_bytes(np.asarray(jax.random.key_data(seed)).tobytes())
        self.measures: tuple[Measure, ...] = ()
        self.sample, self.together = sample, 16
        if isinstance(sample, Tolerances):
            self.one, self.together = self._of_tolerances(sample, measure, theta, extremes)
            self.sizes = replicate_sizes(sampler, self.number)
        else:
            self.one = self._of_functions(sample, measure, seed, theta, extremes)
            self.sizes = np.array([self.number])
        self.devices = tuple(jax.local_devices() if devices is None else devices)
        if not self.devices:
            raise ParameterError("devices", devices, "is empty: give some of jax.local_devices(), or None for all")
        if self.devices[0].platform != "cpu":
            self.together = max(self.together, ACCELERATED)
        self.chunk = min(_whole("chunk", chunk), self.number)  # the same on every machine
        self._room = min(chunk, max(CHUNK, self.number))  # more than a small study needs, so that it shares programs
        whole = Part(self.one, None, (tuple(range(len(self.names))),))
        self.parts = self.one.parts if isinstance(self.one, Measures) else [whole]
        self._programs = [self._program(part) for part in self.parts]

    def _of_tolerances(self, tolerances: Tolerances, measure: Any, theta: ArrayLike | None, extremes: str | None):
        if callable(measure) and not isinstance(measure, Measure):
            self.names = _names(measure, tolerances.scene)
            free, scene = tolerances.free, tolerances.scene

            def one(values: Array) -> tuple[Array, Array]:
                return _coded(measure(free.set(scene, values)))

            return one, 16
        given = tuple(listed(measure))
        places = None if theta is None else (np.asarray(theta).dtype, np.asarray(theta).tobytes())
        measures = tolerances.once(
            ("measures", given, places, extremes), lambda: Measures(given, tolerances, theta, extremes)
        )
        self.measures, self.names = measures.measures, measures.names
        return measures, measures.together

    def _of_functions(self, sample: Any, measure: Any, seed: Any, theta: ArrayLike | None, extremes: str | None):
        if self.sampler != "monte_carlo":
            raise ParameterError(
                "sampler", self.sampler, "needs Tolerances: a function of a random key draws the samples itself"
            )
        if not callable(sample):
            raise ParameterError(
                "sample", sample, "must be Tolerances(gj.load(path), {...}), or a function of a random key"
            )
        key = jax.random.key(seed) if isinstance(seed, int) else seed
        if isinstance(measure, Measure) or not callable(measure):
            given, draw = listed(measure), cast(Callable[[Array], Any], sample)
            example = draw(jax.random.fold_in(key, 0))
            if not isinstance(example, Scene):
                words = f"is for a scene, but sample returns a {type(example).__name__}: give a function of it"
                raise ParameterError("measure", given[0].name, words)
            measures = SceneMeasures(given, example, theta, extremes)
            self.measures, self.names = measures.measures, measures.names
            return lambda index: measures(draw(jax.random.fold_in(key, index[0])))
        self.names = _names(lambda key: measure(sample(key)), key, named=measure)

        def one(index: Array) -> tuple[Array, Array]:
            return _coded(measure(sample(jax.random.fold_in(key, index[0]))))

        return one

    def _program(self, part: Part) -> RowProgram:
        def made() -> RowProgram:
            return RowProgram(part.one, self.devices, self.together, self._room)

        if not isinstance(self.one, Measures):
            return made()
        return self.sample.once(("program", part.one, self.devices, self.together, self._room), made)

    @property
    def chunks(self) -> list[tuple[int, int]]:
        """First index of each chunk, and the one after its last."""
        return [(begin, min(begin + self.chunk, self.number)) for begin in range(0, self.number, self.chunk)]

    def inputs(self, begin: int, end: int) -> np.ndarray:
        """Inputs of the samples from one index to another, shape (n, ...): their numbers, or their indices."""
        if not isinstance(self.sample, Tolerances):
            return np.arange(begin, end, dtype=np.uint32)[:, None]
        paths = self.sample.paths
        return self.sample.values(points(self.sampler, self.seed, paths, self.number, begin, end))

    def evaluate(self, inputs: np.ndarray, progress: Progress = silent, words: str = "") -> Evaluated:
        """Measures and result codes of given inputs, any number of rows.

        ``progress`` is called with the words, and with how many rows are done, every few seconds.
        """
        size, parts = self._room, []
        if progress is not silent:
            size = min(size, max(-(-len(inputs) // PIECES), self.together * len(self.devices)))
        told, left = Seldom(progress), Left(len(inputs))
        for begin in range(0, len(inputs), size):
            parts.append(self._finish(self._begin(inputs[begin : begin + size])))
            done = min(begin + size, len(inputs))
            told(f"{words}: {done} of {len(inputs)} gear sets{left.after(done - begin)}")
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def each(self, chunks: Sequence[tuple[int, int]]) -> Iterator[tuple[tuple[int, int], Evaluated]]:
        """Chunks with their results, in order; the host draws the next samples while the devices work."""
        waiting = None
        for chunk in chunks:
            begun = self._begin(self.inputs(*chunk))
            if waiting is not None:
                yield waiting[0], self._finish(waiting[1])
            waiting = chunk, begun
        if waiting is not None:
            yield waiting[0], self._finish(waiting[1])

    def _begin(self, inputs: np.ndarray) -> tuple[list[list[Started]], np.ndarray]:
        dtype = self.sample.scene.dtype if isinstance(self.sample, Tolerances) else inputs.dtype
        rows = inputs.astype(dtype)

        def begun(place: int) -> list[Started]:
            return [self._programs[place].begin(*given) for given, _ in self.parts[place].given(rows)]

        return self.over_parts(begun), inputs

    def over_parts(self, function: Callable[[int], Any]) -> list[Any]:
        """The results of a function of the place of each part."""
        places = range(len(self.parts))
        if self.workers == 1 or len(places) == 1:
            return [function(place) for place in places]
        with ThreadPoolExecutor(self.workers, initializer=counting()) as pool:
            return list(pool.map(function, places))

    def _finish(self, begun: tuple[list[list[Started]], np.ndarray]) -> Evaluated:
        started, inputs = begun
        values, codes = np.empty((len(inputs), len(self.names))), np.zeros(len(inputs), np.int32)
        for program, part, waiting in zip(self._programs, self.parts, started, strict=True):
            for columns, one in zip(part.columns, waiting, strict=True):
                values[:, columns], code = program.finish(one)
                codes = np.maximum(codes, code)
        if isinstance(self.sample, Tolerances):
            outside = ~self.sample.allowed(inputs)
            values[outside], codes[outside] = np.nan, 1
        return values, codes

    def study(self, values: np.ndarray, result: np.ndarray, watch: Stopwatch | None = None) -> Study:
        """The study from the results of all samples."""
        seconds = (0.0, 0.0) if watch is None else (watch.seconds, watch.compile_seconds)
        return Study(self.names, values, result, self.sizes, self.measures, *seconds)


@arguments.checked(n=arguments.whole(1), chunk=arguments.whole(1), key=arguments.a_key)
def monte_carlo(
    sample: Any,
    measure: Any,
    *,
    n: int = 10_000,
    key: Any = 0,
    sampler: str = "monte_carlo",
    theta: ArrayLike | None = None,
    extremes: str | None = None,
    chunk: int = CHUNK,
    devices: Sequence[Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Find the distribution of measures over a population of gear sets.

    Each sample depends only on the key and its own index, not on the chunks or the devices.

    Args:
        sample: `Tolerances`, or a function from a random key to a scene or anything else.
        measure: a name such as ``"no_load.peak_to_peak"``, a `Measure`, or several; or a function of the sample that
            returns a number or a dict of numbers. With a function as ``sample``, named measures need scenes; each is
            analysed by itself, without the fast methods for `Tolerances`.
        n: number of samples.
        key: seed, or random key.
        sampler: ``"monte_carlo"``, ``"latin_hypercube"`` or ``"sobol"``; the last two only with `Tolerances`.
        theta: input angles, shape (m,) [rad]; by default those of the scene's run section, or one cycle.
        extremes: extremes of quasi-static measures: ``"between"`` for those between samples too, ``"samples"`` for
            those of the samples only, which is faster. The default is ``"between"``, but ``"samples"`` for static
            measures of slices and coupled contacts, as for `transmission_error`.
        chunk: number of samples that are computed at once.
        devices: devices that share the work; by default all local devices.
        progress: called with the number of samples that are done, and the number of all samples.

    Returns:
        The study; samples that failed have a result code and nan.

    Raises:
        ParameterError: a name or a number is wrong, or there is too little memory for so many samples.
        SceneError: the scene lacks a part that a measure needs.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> tolerances = gj.Tolerances(scene, {"errors.planet_1.amplitude": gj.Rayleigh(6e-6)})
        >>> study = gj.monte_carlo(tolerances, "no_load.peak_to_peak", n=1000)
        >>> estimate = study.share_within("no_load.peak_to_peak", 2.5 * gj.units.arcmin)
        >>> bool(0 < estimate.low < estimate.value < estimate.high < 1)
        True
    """
    with Stopwatch() as watch:
        work = Work(
            sample,
            measure,
            number=n,
            seed=key,
            sampler=sampler,
            theta=theta,
            extremes=extremes,
            chunk=chunk,
            devices=devices,
        )
        _require_memory(work)
        values, result = np.full((work.number, len(work.names)), np.nan), np.zeros(work.number, np.int32)
        for (begin, end), (measured, codes) in work.each(work.chunks):
            values[begin:end], result[begin:end] = measured, codes
            if progress is not None:
                progress(end, work.number)
    return work.study(values, result, watch)


def _require_memory(work: Work) -> None:
    """Refuse more samples than the memory can store results of."""
    kept = 8.0 * (len(work.names) + (KEPT_STRATA if work.sampler == "latin_hypercube" else 0)) + 4.0
    free = free_memory()
    if free is not None and work.number * kept > free:
        words = f"needs about {size_words(work.number * kept)} of memory, {size_words(free)} are free"
        raise ParameterError("n", work.number, f"{words}; {fitting(free / kept)}")


def _whole(name: str, given: Any) -> int:
    if isinstance(given, bool) or not isinstance(given, int | np.integer) or not 1 <= given < 2**32:
        raise ParameterError(name, given, "must be a whole number from 1 to 4294967295")
    return int(given)


def _names(function: Callable[[Any], Any], of: Any, named: Any = None) -> tuple[str, ...]:
    """Names of the numbers that a function returns: the keys of a dict, or the function's own name."""

    def looked_at(of: Any) -> Any:  # within the trace, which refuses what it does not know in words of its own
        returned = function(of)
        if not (isinstance(returned, dict) and returned):
            return arguments.a_result("measure", returned, ", or a dict of numbers by their names")
        return {name: arguments.a_result("measure", part, f", {name!r} too") for name, part in returned.items()}

    shape = jax.eval_shape(looked_at, of)
    return tuple(sorted(shape)) if isinstance(shape, dict) else (getattr(named or function, "__name__", "measure"),)


def _coded(measured: Any) -> tuple[Array, Array]:
    """Numbers in the order of their names, and the result code of a sample."""
    parts = [measured[name] for name in sorted(measured)] if isinstance(measured, dict) else [measured]
    values = jnp.stack([jnp.asarray(part) for part in parts])
    return values, jnp.where(jnp.isfinite(values).all(), 0, 2)
