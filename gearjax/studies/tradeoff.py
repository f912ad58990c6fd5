"""Accuracy and cost of each choice on a scene: errors of the dynamic metrics, run time, gradient time, compile time."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import Motion, simulate
from gearjax.progress import Left, Progress, silent, told_seconds
from gearjax.run import METRICS
from gearjax.scene import Scene
from gearjax.studies.motion_choices import Setting, dynamic_run, reference, resolving, settings
from gearjax.studies.static_choices import StaticChoice, static_choices
from gearjax.timing import Stopwatch
from gearjax.typing import Array

LONGEST_GRADIENT = 20.0  # s: gradients that are expected to take longer are not measured
DIFFERENTIATED = ("solver", "fidelity", "precision")  # groups whose gradients are timed
REPEATS, LONG_ENOUGH = 3, 2.0  # runs that are timed, and their time in all after which no further one is [s]
GRADIENT_WORK = 5  # compiling a gradient takes some times as long as compiling a run
Metrics = dict[float, dict[str, float]]
"""Metrics by torque and name [rad]."""


class FirstRun(NamedTuple):
    """The first run of a setting.

    Args:
        metrics: metrics by torque and name [rad].
        at_samples: the same, with the extremes of the samples instead of those of all steps [rad].
        seconds: time of one torque without compilation [s].
        compile_seconds: time of tracing and compiling [s], beside other settings if there are several workers.
    """

    metrics: Metrics
    at_samples: Metrics
    seconds: float
    compile_seconds: float


@dataclasses.dataclass(frozen=True)
class Measured:
    """Accuracy and cost of a setting.

    Args:
        group, name: group and name of the setting.
        error: largest deviation of peak-to-peak, amplitude, mean and standard deviation under all torques [rad]; if the
            setting has extremes of its samples only, from those of the reference's samples.
        metrics: metrics by torque and name [rad].
        seconds: time of one run, median [s].
        gradient_seconds: time of the gradient of the standard deviation by every number of the errors, in reverse mode
            [s]; ``None`` if it would take long, or the group is not differentiated.
        gradient_measured: whether the gradient's time was measured. Otherwise it is estimated from another setting of
            the same scheme, in runs, because a gradient compiles for 10 s and more; for the shortest runs the estimate
            is rough.
        compile_seconds: compile time of the first run, beside those of other settings if several are compiled at once
            [s].
    """

    group: str
    name: str
    error: float
    metrics: dict[float, dict[str, float]]
    seconds: float
    gradient_seconds: float | None
    gradient_measured: bool
    compile_seconds: float


@dataclasses.dataclass(frozen=True)
class Tradeoff:
    """All settings of a scene, and the fastest one that is accurate enough.

    Args:
        truth: metrics of the reference by torque and name [rad].
        truth_seconds: run time of the reference [s].
        rows: the settings that were measured; empty if the run section lists no motion.
        error: allowed error [rad].
        statics: choices of the parts of the scene under static torque; empty if there are none.
    """

    truth: dict[float, dict[str, float]]
    truth_seconds: float
    rows: list[Measured]
    error: float
    statics: list[StaticChoice] = dataclasses.field(default_factory=list)

    @property
    def best(self) -> Measured | None:
        """The fastest setting within the allowed error, ``None`` if there is none."""
        good = [row for row in self.rows if row.error <= self.error]
        return min(good, key=lambda row: row.seconds, default=None)


def tradeoff(scene: Scene, error: float, progress: Progress = silent, *, workers: int = 1) -> Tradeoff:
    """Measure every setting on the run section of a scene.

    Args:
        scene: a scene with a run section; settings of the motion are measured if it lists ``dynamic``, choices of the
            parts of the scene if it lists ``static``.
        error: allowed error of the metrics [rad].
        progress: called with a line of text now and then.
        workers: number of settings whose programs are compiled in parallel, in threads; runs are timed alone. A thread
            uses the settings of the whole process, but not settings of the calling thread alone.

    Raises:
        SceneError: there is nothing to measure, or Runge-Kutta steps of the reference would be too many.
    """
    if scene.run is not None and "dynamic" not in scene.run.analyses and (statics := static_choices(scene, progress)):
        return Tradeoff({}, 0.0, [], error, statics)
    run = dynamic_run(scene)
    resolved = resolving(scene, run)
    given = (reference(scene, run, resolved), *settings(scene, run, resolved))
    usual = first_run(Setting("solver", "usual", scene, resolved.usual, run.samples))
    expected = Expected(usual.compile_seconds, usual.seconds, len(run.torques), workers)
    left, number = Left(expected.whole(given)), len(given) - 1
    progress(f"{number} settings, and Runge-Kutta in short steps beside them: some {told_seconds(left.parts)}")
    with ThreadPoolExecutor(workers) as pool:
        truth, *first = _first_runs(given, pool, expected, left, progress)
        rows = []
        for setting, one in zip(given[1:], first, strict=True):
            rows.append(_measured(setting, one, truth))
            progress(f"timed: {setting.title}{left.after(expected.repeated(setting))}")
        rows = _with_gradients(list(given[1:]), rows, pool, left, expected, progress)
    return Tradeoff(truth.metrics, truth.seconds, rows, error, static_choices(scene, progress))


class Expected(NamedTuple):
    """Times that settings are expected to take, from the first run of the usual steps.

    Args:
        compile_seconds: time to trace and compile that run [s].
        seconds: time of that run under one torque [s].
        torques: number of torques.
        workers: number of settings whose first runs take place at once.
    """

    compile_seconds: float
    seconds: float
    torques: int
    workers: int

    def first(self, setting: Setting) -> float:
        """First runs, beside those of other settings [s]."""
        return (self.compile_seconds + self.torques * setting.work * self.seconds) / self.workers

    def repeated(self, setting: Setting) -> float:
        """Runs that are timed [s]."""
        return _repeated(setting.work * self.seconds)

    def gradient(self, setting: Setting) -> float:
        """Gradient of a scheme, compiled beside others and timed [s]."""
        timed = setting.gradient * setting.work * self.seconds
        return GRADIENT_WORK * self.compile_seconds / self.workers + _repeated(timed)

    def whole(self, given: Sequence[Setting]) -> float:
        """All of the trade-off, whose first setting is the reference [s]."""
        alone = sum(self.repeated(setting) for setting in given[1:])
        gradients: dict[str, float] = {}
        for setting in given:
            if _has_gradient(setting, setting.work * self.seconds):
                before = gradients.get(setting.of_gradient, 0.0)
                gradients[setting.of_gradient] = max(before, self.gradient(setting))
        return sum(map(self.first, given)) + alone + sum(gradients.values())


def _first_runs(
    given: Sequence[Setting], pool: ThreadPoolExecutor, expected: Expected, left: Left, progress: Progress
) -> list[FirstRun]:
    """First run of each setting; the reference, which takes long, is the first to begin."""
    running = {pool.submit(first_run, setting): setting for setting in given}
    runs = {}
    try:
        for done in as_completed(running):
            setting = running[done]
            first = runs[setting.title] = done.result()
            took = (first.compile_seconds + expected.torques * first.seconds) / expected.workers
            progress(f"ran: {setting.title}{left.after(expected.first(setting), took)}")
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)  # runs that have not begun are left out
        raise
    return [runs[setting.title] for setting in given]


def apart(one: Metrics, other: Metrics) -> float:
    """Largest difference of any metric under any torque [rad]; nan if one is not a number."""
    return float(np.max([abs(one[torque][name] - other[torque][name]) for torque in one for name in METRICS]))


def _measured(setting: Setting, first: FirstRun, truth: FirstRun) -> Measured:
    """What one setting takes and how far it is off, from its first run; the run is repeated alone for its time.

    A setting without extremes between samples is compared with the extremes of the reference's samples. Otherwise its
    error would mostly be that of too few samples.
    """
    torque, ts = _torques(setting)[0], _times(setting)
    seconds = _seconds(lambda: jax.block_until_ready(_once(setting, setting.scene, ts, torque).te))
    off = apart(first.metrics, truth.at_samples if setting.of_samples else truth.metrics)
    return Measured(setting.group, setting.name, off, first.metrics, seconds, None, False, first.compile_seconds)


def _with_gradients(
    tried: list[Setting],
    rows: list[Measured],
    pool: ThreadPoolExecutor,
    left: Left,
    expected: Expected,
    progress: Progress,
) -> list[Measured]:
    """The rows with the times of their gradients, measured for the slowest allowed run of each scheme."""
    schemes: dict[str, list[int]] = {}
    for place, (setting, row) in enumerate(zip(tried, rows, strict=True)):
        if _has_gradient(setting, row.seconds):
            schemes.setdefault(setting.of_gradient, []).append(place)
    chosen = {}
    for scheme, places in schemes.items():
        own = [place for place in places if tried[place].group != "precision"]  # float32 takes their multiple
        chosen[scheme] = max(own or places, key=lambda place: rows[place].seconds)
    rows = list(rows)
    compiled = pool.map(lambda place: _gradient(tried[place]), chosen.values())
    gradients = []
    for (scheme, place), gradient in zip(chosen.items(), compiled, strict=True):
        gradients.append(gradient)
        progress(f"compiled: gradient, {scheme}{left.after(expected.gradient(tried[place]))}")
    for (scheme, measured), gradient in zip(chosen.items(), gradients, strict=True):
        multiple = _seconds(gradient) / rows[measured].seconds
        progress(f"gradient, {scheme}: {multiple:.3g} runs")
        for place in schemes[scheme]:
            seconds = multiple * rows[place].seconds
            rows[place] = dataclasses.replace(
                rows[place], gradient_seconds=seconds, gradient_measured=place == measured
            )
    return rows


def _torques(setting: Setting) -> Sequence[float]:
    assert setting.scene.run is not None
    return setting.scene.run.torques


def _times(setting: Setting) -> Array:
    assert setting.scene.run is not None
    return jnp.asarray(np.linspace(0.0, setting.scene.run.duration, setting.samples), setting.scene.dtype)


def _once(setting: Setting, scene: Scene, ts: Array, torque: float) -> Motion:
    run = scene.run
    assert run is not None
    return simulate(scene, ts, torque, start=run.start, settle=run.settle, stepper=setting.stepper)


def first_run(setting: Setting) -> FirstRun:
    """The first run of a setting, which compiles its program."""
    motions, ts = {}, _times(setting)
    with Stopwatch() as watch:
        for torque in _torques(setting):
            motions[torque] = jax.block_until_ready(_once(setting, setting.scene, ts, torque))
    sampled = {torque: dataclasses.replace(one, highest=one.te, lowest=one.te) for torque, one in motions.items()}
    return FirstRun(_metrics(motions), _metrics(sampled), watch.seconds / len(motions), watch.compile_seconds)


def _metrics(motions: dict[float, Motion]) -> Metrics:
    return {torque: {name: float(getattr(one, name)) for name in METRICS} for torque, one in motions.items()}


def _gradient(setting: Setting) -> Callable[[], object]:
    """A function that computes the gradient of a setting, compiled by a first call."""
    torque, ts = _torques(setting)[0], _times(setting)

    @eqx.filter_jit
    def slope(errors, scene):
        return jax.grad(lambda errors: _once(setting, dataclasses.replace(scene, errors=errors), ts, torque).std)(
            errors
        )

    def gradient() -> object:
        return jax.block_until_ready(slope(setting.scene.errors, setting.scene))

    gradient()
    return gradient


def _seconds(computed: Callable[[], object]) -> float:
    """Median time of a computation, which is repeated unless it takes long [s]."""
    times: list[float] = []
    while len(times) < REPEATS and sum(times) < LONG_ENOUGH:
        began = time.perf_counter()
        computed()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def _repeated(seconds: float) -> float:
    """Time that `_seconds` takes for a computation [s]."""
    return min(REPEATS * seconds, max(seconds, LONG_ENOUGH))


def _has_gradient(setting: Setting, seconds: float) -> bool:
    """Whether the gradient of a setting may be measured, whose run takes a time [s]."""
    return setting.group in DIFFERENTIATED and setting.gradient * seconds <= LONGEST_GRADIENT
