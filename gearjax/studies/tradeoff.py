"""Accuracy and cost of each choice on a scene: errors of the dynamic metrics, run time, gradient time, compile time."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import AdaptiveStep, FixedStep, Motion, QuasiStatic, RungeKutta4, simulate
from gearjax.analysis.choice import STEP, step_limits, suitable_step
from gearjax.analysis.solvers import LONGEST_STEP, Stepper
from gearjax.checks import SceneError
from gearjax.compliance import HarmonicStiffness
from gearjax.contact import AbstractContact, QuadraticContact, SoftplusContact
from gearjax.progress import Left, Progress, silent, told_seconds
from gearjax.run import METRICS, Run
from gearjax.scene import Scene
from gearjax.studies.static_choices import StaticChoice, static_choices
from gearjax.timing import Stopwatch
from gearjax.typing import Array

STEPS = (0.8, 0.4, 0.2, 0.1, 0.05)  # rad of the fastest motion
WIDTHS = (1e-8, 1e-7, 1e-6)  # m
TRUE_STEP = 0.0125  # rad of the fastest motion: Runge-Kutta steps of the reference
MOST_RUNGE_KUTTA = 2e8  # steps of a run, which take some minutes
LONGEST_GRADIENT = 20.0  # s: gradients that are expected to take longer are not measured
DIFFERENTIATED = ("solver", "fidelity", "precision")  # groups whose gradients are timed
REPEATS = 3
TRUTH_WORK, GRADIENT_WORK = 4, 5  # the reference, and compiling a gradient, take some times as long as compiling a run
Metrics = dict[float, dict[str, float]]
"""Metrics by torque and name [rad]."""


@dataclasses.dataclass(frozen=True)
class Setting:
    """One way to compute a motion.

    Args:
        group: what is varied: ``solver``, ``contact``, ``samples``, ``harmonics``, ``fidelity`` or ``precision``.
        name: the setting in words.
        scene: the scene as this setting models it.
        stepper: stepper of `gearjax.simulate`.
        samples: number of samples of the record.
        gradient: expected time of a gradient, in runs; gradients that would take too long are left out.
        scheme: common name of settings whose gradients take about the same multiple of a run (they differ in step
            length, precision or adaptive solver); empty for the setting's own name.
    """

    group: str
    name: str
    scene: Scene
    stepper: Stepper | QuasiStatic
    samples: int
    gradient: float = 10.0
    scheme: str = ""

    @property
    def of_samples(self) -> bool:
        """Whether its extremes are those of its samples."""
        return isinstance(self.stepper, AdaptiveStep | QuasiStatic)


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
    truth_step = resolved.runge_kutta(TRUE_STEP, run)
    yardstick = Setting("truth", "Runge-Kutta", scene, truth_step, run.samples)
    tried = settings(scene, run, resolved)
    usual = resolved.usual
    began = time.perf_counter()
    first_run(Setting("solver", "usual", scene, usual, run.samples))
    once, work = time.perf_counter() - began, len(tried) + TRUTH_WORK + GRADIENT_WORK * len(_schemes(tried))
    told = told_seconds(once * work / workers)
    progress(f"{len(tried)} settings, and Runge-Kutta in steps of {truth_step.step:.2g} s beside them: some {told}")
    left, runs = Left(work), []
    with ThreadPoolExecutor(workers) as pool:
        for setting, first in zip((yardstick, *tried), pool.map(first_run, (yardstick, *tried)), strict=True):
            runs.append(first)
            rest = left.after(TRUTH_WORK if setting is yardstick else 1)
            progress(f"compiled: {setting.group}: {setting.name}{rest}")
        truth = runs[0]
        rows = [_measured(*each, truth) for each in zip(tried, runs[1:], strict=True)]
        rows = _with_gradients(tried, rows, pool, left, progress)
    return Tradeoff(truth.metrics, truth.seconds, rows, error, static_choices(scene, progress))


def dynamic_run(scene: Scene) -> Run:
    """The run section of a scene.

    Raises:
        SceneError: there is none that lists ``dynamic``.
    """
    if scene.run is None or "dynamic" not in scene.run.analyses:
        raise SceneError('[run] must list "dynamic" among its analyses: the accuracy is that of the dynamic TE')
    return scene.run


class Resolving(NamedTuple):
    """Steps that resolve the motion of a scene.

    Args:
        longest: longest step of the usual scheme that resolves the fastest motion [s].
        whole: the same for other solvers, which have to resolve the supports too [s].
        usual: the usual steps of a run.
    """

    longest: float
    whole: float
    usual: FixedStep

    def runge_kutta(self, size: float, run: Run) -> FixedStep:
        """Runge-Kutta steps of a size [rad of the fastest motion].

        Raises:
            SceneError: the run would need too many.
        """
        step = size * self.whole
        if run.duration / step > MOST_RUNGE_KUTTA:
            words = f"the reference needs {run.duration / step:.2g} Runge-Kutta steps of {step:.2g} s"
            raise SceneError(
                f"{words}, more than {MOST_RUNGE_KUTTA:g}: shorten run.duration, or leave out stiff supports"
            )
        return FixedStep(step, solver=RungeKutta4())


def resolving(scene: Scene, run: Run) -> Resolving:
    """Steps that resolve the motion of a scene."""
    usual, limits = suitable_step(scene, run.duration), step_limits(scene)
    longest = usual.step / STEP * LONGEST_STEP
    whole = longest if limits.whole is None else LONGEST_STEP / float(limits.whole)
    return Resolving(longest, whole, usual)


def apart(one: Metrics, other: Metrics) -> float:
    """Largest difference of any metric under any torque [rad]; nan if one is not a number."""
    return float(np.max([abs(one[torque][name] - other[torque][name]) for torque in one for name in METRICS]))


def settings(scene: Scene, run: Run, resolved: Resolving) -> list[Setting]:
    """The settings to measure."""
    alone, number, cut = FixedStep(resolved.usual.step), run.samples, resolved.usual.windows
    output_alone = scene.springs_apart

    def even(scheme: str, size: float, after: str = "", **options) -> Setting:
        name, stepper = f"{scheme}, {size:g} rad{after}", FixedStep(size * resolved.longest, **options)
        return Setting("solver", name, scene, stepper, number, scheme=scheme + after)

    trials = [even("fitted" if output_alone else "constant modes", size) for size in STEPS]
    if cut is not None:
        trials += [even("fitted", size, ", windows", windows=cut) for size in STEPS[:3]]
    slow = 10.0 if output_alone else math.inf  # gradients of many coordinates compile for minutes
    for size in STEPS[:3]:
        stepper = resolved.runge_kutta(size, run)
        trials.append(Setting("solver", f"Runge-Kutta, {size:g} rad", scene, stepper, number, slow, "Runge-Kutta"))
    trials += [
        Setting(
            "solver",
            f"{type(solver).__name__}, {tol:g}",
            scene,
            AdaptiveStep(tol, tol, solver),
            number,
            400.0 if output_alone else math.inf,
            "adaptive",
        )
        for solver, tol in ((diffrax.Tsit5(), 1e-4), (diffrax.Dopri5(), 1e-4), (diffrax.Dopri8(), 1e-7))
    ]
    laws: list[tuple[str, Callable[[float], AbstractContact]]] = [
        ("quadratic", QuadraticContact),
        ("softplus", SoftplusContact),
    ]
    trials += [
        Setting("contact", f"{name}, {1e6 * w:g} um", dataclasses.replace(scene, contact=law(w)), alone, number)
        for name, law in laws
        for w in WIDTHS
    ]
    mesh = 2 * np.pi / (float(scene.system.input_speed) * scene.system.orders["mesh"])
    for per_mesh in (2, 6, 20):
        fewer = int(run.duration / mesh * per_mesh) + 1
        if 2 <= fewer < number:
            trials.append(Setting("samples", f"{per_mesh} per mesh period", scene, alone, fewer))
    if isinstance(scene.compliance, HarmonicStiffness):
        for kept in range(scene.compliance.harmonics):
            parts = scene.compliance.mean, scene.compliance.relative_amplitudes[:kept], scene.compliance.phases[:kept]
            fewer_waves = dataclasses.replace(scene, compliance=HarmonicStiffness(*parts))
            trials.append(Setting("harmonics", f"{kept} kept", fewer_waves, alone, number))
    if output_alone:
        trials += [
            Setting("fidelity", name, scene, QuasiStatic(inertia), number)
            for name, inertia in (("quasi-static", False), ("quasi-static, inertia corrected", True))
        ]
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    return [*trials, Setting("precision", "float32", single, alone, number, scheme=trials[0].scheme)]


def _measured(setting: Setting, first: FirstRun, truth: FirstRun) -> Measured:
    """What one setting takes and how far it is off, from its first run; the run is repeated alone for its time.

    A setting without extremes between samples is compared with the extremes of the reference's samples. Otherwise its
    error would mostly be that of too few samples.
    """
    torque, ts = _torques(setting)[0], _times(setting)
    seconds = _seconds(lambda: jax.block_until_ready(_once(setting, setting.scene, ts, torque).te))
    off = apart(first.metrics, truth.at_samples if setting.of_samples else truth.metrics)
    return Measured(setting.group, setting.name, off, first.metrics, seconds, None, False, first.compile_seconds)


def _schemes(tried: list[Setting]) -> list[str]:
    """Names of the schemes of which gradients are measured."""
    return list(dict.fromkeys(setting.scheme or setting.name for setting in tried if setting.group in DIFFERENTIATED))


def _with_gradients(
    tried: list[Setting], rows: list[Measured], pool: ThreadPoolExecutor, left: Left, progress: Progress
) -> list[Measured]:
    """The rows with the times of their gradients, measured for the slowest allowed run of each scheme."""
    schemes: dict[str, list[int]] = {}
    for place, (setting, row) in enumerate(zip(tried, rows, strict=True)):
        if setting.group in DIFFERENTIATED and setting.gradient * row.seconds <= LONGEST_GRADIENT:
            schemes.setdefault(setting.scheme or setting.name, []).append(place)
    chosen = {}
    for scheme, places in schemes.items():
        own = [place for place in places if tried[place].group != "precision"]  # float32 takes their multiple
        chosen[scheme] = max(own or places, key=lambda place: rows[place].seconds)
    rows = list(rows)
    compiled = pool.map(lambda place: _gradient(tried[place]), chosen.values())
    gradients = []
    for scheme, gradient in zip(chosen, compiled, strict=True):
        gradients.append(gradient)
        progress(f"compiled: gradient, {scheme}{left.after(GRADIENT_WORK)}")
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
    """Median time of a computation [s]."""
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        computed()
        times.append(time.perf_counter() - began)
    return float(np.median(times))
