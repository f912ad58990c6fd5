"""Accuracy and cost of each choice on a scene: errors of the dynamic metrics, run time, gradient time, compile time."""

import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Sequence

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import AdaptiveStep, FixedStep, Motion, QuasiStatic, RungeKutta4, simulate, transmission_error
from gearjax.analysis.choice import STEP, suitable_step
from gearjax.analysis.metrics import FewAngles
from gearjax.analysis.solvers import LONGEST_STEP, Stepper
from gearjax.checks import SceneError
from gearjax.compliance import HarmonicStiffness
from gearjax.contact import AbstractContact, QuadraticContact, SoftplusContact
from gearjax.progress import Progress, silent
from gearjax.run import METRICS, Run
from gearjax.scene import Scene
from gearjax.scene_checks import require_springs_apart
from gearjax.timing import Stopwatch
from gearjax.typing import Array
from gearjax.units import arcmin

STEPS = (0.8, 0.4, 0.2, 0.1, 0.05)  # rad of the fastest motion
WIDTHS = (1e-8, 1e-7, 1e-6)  # m
TRUE_STEP = 0.0125  # rad of the fastest motion: Runge-Kutta steps of the reference
LONGEST_GRADIENT = 20.0  # s: gradients that are expected to take longer are not measured
DIFFERENTIATED = ("solver", "fidelity", "precision")  # groups whose gradients are timed
REPEATS = 3
YARDSTICK = 0.05  # rad of the fastest motion: first Runge-Kutta steps of the reference of `accurate_step`
UNSURE = 0.2  # of the allowed error: largest uncertainty of the reference
MOST_HALVINGS = 4
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


@dataclasses.dataclass(frozen=True)
class Measured:
    """Accuracy and cost of a setting.

    Args:
        group, name: group and name of the setting.
        error: largest deviation of peak-to-peak, amplitude, mean and standard deviation under all torques [rad].
        metrics: metrics by torque and name [rad].
        seconds: time of one run, median [s].
        gradient_seconds: time of the gradient of the standard deviation by every number of the errors, in reverse mode
            [s]; ``None`` if it would take long, or the group is not differentiated.
        gradient_measured: whether the gradient's time was measured. Otherwise it is estimated from another setting of
            the same scheme, in runs, because a gradient compiles for 10 s and more; for the shortest runs the estimate
            is rough.
        compile_seconds: compile time of the first run [s].
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
class StaticChoice:
    """Accuracy and cost of a choice of geometry under static torque.

    Args:
        name: name of the choice.
        error: largest deviation of the metrics of the static TE under all torques from the most exact choice [rad].
        force_error: largest deviation of a single contact force, over the largest force [-].
        seconds: time of one torque, without compilation [s].
        compile_seconds: compile time [s].
    """

    name: str
    error: float
    force_error: float
    seconds: float
    compile_seconds: float


@dataclasses.dataclass(frozen=True)
class Tradeoff:
    """All settings of a scene, and the fastest one that is accurate enough.

    Args:
        truth: metrics of the reference by torque and name [rad].
        truth_seconds: run time of the reference [s].
        rows: the settings that were measured.
        error: allowed error [rad].
        statics: choices of geometry under static torque; empty if the system has none.
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


def tradeoff(scene: Scene, error: float, progress: Progress = silent) -> Tradeoff:
    """Measure every setting on the run section of a scene.

    Args:
        scene: a scene with a run section that lists ``dynamic``.
        error: allowed error of the metrics [rad].
        progress: called with a line of text now and then.

    Raises:
        SceneError: there is no dynamic analysis to measure.
    """
    run = _dynamic(scene)
    longest, usual = _resolving(scene, run)
    truth_step = FixedStep(TRUE_STEP * longest, solver=RungeKutta4())
    yardstick = Setting("truth", "Runge-Kutta", scene, truth_step, run.samples)
    progress(f"reference: Runge-Kutta, steps of {TRUE_STEP * longest:.2g} s")
    truth, seconds, _ = _run(yardstick, repeats=0)
    tried, rows = settings(scene, run, longest, usual), []
    for setting in tried:
        rows.append(_measure(setting, truth))
        progress(f"{setting.group}: {setting.name}: {rows[-1].seconds:.3g} s")
    rows = _with_gradients(tried, rows, progress)
    statics = static_choices(scene)
    for choice in statics:
        progress(f"static TE, {choice.name}: {choice.seconds:.3g} s")
    return Tradeoff(truth, seconds, rows, error, statics)


def _dynamic(scene: Scene) -> Run:
    if scene.run is None or "dynamic" not in scene.run.analyses:
        raise SceneError('[run] must list "dynamic" among its analyses: the accuracy is that of the dynamic TE')
    require_springs_apart(scene, "tradeoff")
    return scene.run


def _resolving(scene: Scene, run: Run) -> tuple[float, FixedStep]:
    """The longest step that resolves the fastest motion [s], and the usual steps of a run."""
    usual = suitable_step(scene, run.duration)
    return usual.step / STEP * LONGEST_STEP, usual


def accurate_step(scene: Scene, error: float, progress: Progress = silent) -> FixedStep:
    """The longest steps of the fitted scheme whose metrics are within an error of a reference.

    The reference is computed by Runge-Kutta, a different scheme, because step lengths of one scheme share errors that
    their comparison does not show. Its steps are halved until the metrics change little compared with the error. The
    step of the fitted scheme is predicted from the usual one, as the error falls with the square of the step, and
    then tried.

    Args:
        scene: a scene with a run section that lists ``dynamic``.
        error: allowed error of the metrics [rad].
        progress: called with a line of text now and then.

    Raises:
        SceneError: there is no dynamic analysis, or no step is short enough.
    """
    run = _dynamic(scene)
    longest, usual = _resolving(scene, run)

    def metrics(stepper: FixedStep) -> Metrics:
        return _run(Setting("solver", "", scene, stepper, run.samples), 0)[0]

    truth, unsure = _yardstick(metrics, longest, error, progress)
    sizes = (*STEPS, STEPS[-1] / 2, STEPS[-1] / 4)
    size, tried = STEP, {}
    while size not in tried:
        stepper = FixedStep(size * longest, windows=usual.windows)
        tried[size] = off = _apart(metrics(stepper), truth) + unsure
        progress(f"steps of {stepper.step:.2g} s: metrics within {off / arcmin:.2g} arcmin")
        good = [one for one, apart in tried.items() if apart <= error]
        foretold = size * math.sqrt(error / max(off, 1e-3 * error))
        if good and (longer := [one for one in sizes if max(good) < one <= foretold and one not in tried]):
            size = max(longer)
        elif good:
            size = max(good)
        else:
            shorter = [one for one in sizes if one < min(tried)]
            if not shorter:
                raise SceneError(
                    f"accuracy: no step down to {stepper.step:.2g} s is within {error / arcmin:.2g} arcmin"
                )
            size = max((one for one in shorter if one <= foretold), default=min(shorter))
    return FixedStep(size * longest, windows=usual.windows)


def _yardstick(
    metrics: Callable[[FixedStep], Metrics], longest: float, error: float, progress: Progress
) -> tuple[Metrics, float]:
    """Metrics by Runge-Kutta, and their uncertainty: a third of the change when the step was halved [rad]."""
    step = YARDSTICK * longest
    coarse = metrics(FixedStep(2 * step, solver=RungeKutta4()))
    for _ in range(MOST_HALVINGS):
        truth = metrics(FixedStep(step, solver=RungeKutta4()))
        unsure = _apart(coarse, truth) / 3
        progress(f"reference: Runge-Kutta, steps of {step:.2g} s: within {unsure / arcmin:.2g} arcmin")
        if unsure <= UNSURE * error:
            return truth, unsure
        coarse, step = truth, step / 2
    raise SceneError(
        f"accuracy: {error / arcmin:.2g} arcmin cannot be verified: the error of Runge-Kutta itself is larger"
    )


def _apart(one: Metrics, other: Metrics) -> float:
    """Largest difference of any metric under any torque [rad]."""
    return max(abs(one[torque][name] - other[torque][name]) for torque in one for name in METRICS)


def static_choices(scene: Scene) -> list[StaticChoice]:
    """Accuracy and cost of the choices of a system's geometry under static torque, compared with the most exact choice.

    Empty if the system has no choice, or the run section lists no static analysis.
    """
    run, choices = scene.run, scene.system.choices()
    if run is None or "static" not in run.analyses or not choices:
        return []
    theta = scene.system.input_speed * jnp.asarray(run.times)
    compared, metrics, forces, times = [], {}, {}, {}
    for name, system in choices.items():
        chosen = dataclasses.replace(scene, system=system)
        with Stopwatch() as watch, warnings.catch_warnings():
            warnings.simplefilter("ignore", FewAngles)  # all choices are compared at the same angles
            errors = [transmission_error(chosen, theta, torque) for torque in run.torques]
            metrics[name] = {
                torque: {metric: float(getattr(te, metric)) for metric in METRICS}
                for torque, te in zip(run.torques, errors, strict=True)
            }
        forces[name] = np.stack([np.asarray(te.forces) for te in errors])
        times[name] = watch.seconds / len(run.torques), watch.compile_seconds
    exact = list(choices)[-1]
    for name in choices:
        largest = float(forces[exact].max())
        off = float(np.abs(forces[name] - forces[exact]).max()) / largest if largest > 0 else 0.0
        compared.append(StaticChoice(name, _apart(metrics[name], metrics[exact]), off, *times[name]))
    return compared


def settings(scene: Scene, run: Run, longest: float, usual: FixedStep) -> list[Setting]:
    """The settings to measure, from the longest step that resolves the motion of the scene [s] and the usual steps."""
    alone, number, cut = FixedStep(usual.step), run.samples, usual.windows

    def even(scheme: str, size: float, after: str = "", **options) -> Setting:
        name, stepper = f"{scheme}, {size:g} rad{after}", FixedStep(size * longest, **options)
        return Setting("solver", name, scene, stepper, number, scheme=scheme + after)

    trials = [even("fitted", size) for size in STEPS]
    if cut is not None:
        trials += [even("fitted", size, ", windows", windows=cut) for size in STEPS[:3]]
    trials += [even("Runge-Kutta", size, solver=RungeKutta4()) for size in STEPS[:3]]
    trials += [
        Setting(
            "solver",
            f"{type(solver).__name__}, {tol:g}",
            scene,
            AdaptiveStep(tol, tol, solver),
            number,
            400.0,
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
    trials += [
        Setting("fidelity", name, scene, QuasiStatic(inertia), number)
        for name, inertia in (("quasi-static", False), ("quasi-static, inertia corrected", True))
    ]
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    return [*trials, Setting("precision", "float32", single, alone, number, scheme="fitted")]


def _measure(setting: Setting, truth: dict[float, dict[str, float]]) -> Measured:
    metrics, seconds, compile_seconds = _run(setting, REPEATS)
    error = max(abs(metrics[torque][name] - truth[torque][name]) for torque in truth for name in METRICS)
    return Measured(setting.group, setting.name, error, metrics, seconds, None, False, compile_seconds)


def _with_gradients(tried: list[Setting], rows: list[Measured], progress: Progress) -> list[Measured]:
    """The rows with the times of their gradients, measured for the slowest allowed run of each scheme."""
    schemes: dict[str, list[int]] = {}
    for place, (setting, row) in enumerate(zip(tried, rows, strict=True)):
        if setting.group in DIFFERENTIATED and setting.gradient * row.seconds <= LONGEST_GRADIENT:
            schemes.setdefault(setting.scheme or setting.name, []).append(place)
    rows = list(rows)
    for scheme, places in schemes.items():
        own = [place for place in places if tried[place].group != "precision"]  # float32 takes their multiple
        chosen = max(own or places, key=lambda place: rows[place].seconds)
        multiple = _gradient_seconds(tried[chosen]) / rows[chosen].seconds
        progress(f"gradient, {scheme}: {multiple:.3g} runs")
        for place in places:
            seconds = multiple * rows[place].seconds
            rows[place] = dataclasses.replace(rows[place], gradient_seconds=seconds, gradient_measured=place == chosen)
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


def _run(setting: Setting, repeats: int) -> tuple[dict[float, dict[str, float]], float, float]:
    """Metrics by torque, time of one run [s], and time of compilation [s]."""
    metrics, times, ts = {}, [], _times(setting)
    with Stopwatch() as watch:
        for torque in _torques(setting):
            motion = _once(setting, setting.scene, ts, torque)
            metrics[torque] = {name: float(getattr(motion, name)) for name in METRICS}
    torque = _torques(setting)[0]
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(_once(setting, setting.scene, ts, torque).te)
        times.append(time.perf_counter() - began)
    seconds = float(np.median(times)) if times else watch.seconds / len(metrics)
    return metrics, seconds, watch.compile_seconds


def _gradient_seconds(setting: Setting) -> float:
    torque, ts = _torques(setting)[0], _times(setting)

    @eqx.filter_jit
    def slope(errors, scene):
        return jax.grad(lambda errors: _once(setting, dataclasses.replace(scene, errors=errors), ts, torque).std)(
            errors
        )

    times = []
    for _ in range(1 + REPEATS):
        began = time.perf_counter()
        jax.block_until_ready(slope(setting.scene.errors, setting.scene))
        times.append(time.perf_counter() - began)
    return float(np.median(times[1:]))
