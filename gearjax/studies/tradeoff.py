"""What each choice costs and buys on a scene: errors of the dynamic metrics, run time, gradient time, compile time."""

import dataclasses
import time
from collections.abc import Callable, Sequence

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import AdaptiveStep, FixedStep, Motion, QuasiStatic, RungeKutta4, simulate
from gearjax.analysis.dynamics import LONGEST_STEP, STEP, Stepper, suitable_step
from gearjax.checks import SceneError
from gearjax.compliance import HarmonicStiffness
from gearjax.contact import AbstractContact, QuadraticContact, SoftplusContact
from gearjax.progress import Progress, silent
from gearjax.scene import METRICS, Run, Scene
from gearjax.timing import Stopwatch
from gearjax.typing import Array

STEPS = (0.8, 0.4, 0.2, 0.1, 0.05)  # rad of the fastest motion
WIDTHS = (1e-8, 1e-7, 1e-6)  # m
TRUE_STEP = 0.0125  # rad of the fastest motion, Runge-Kutta: the yardstick
LONGEST_GRADIENT = 20.0  # s that a gradient may be expected to take: others are not measured
DIFFERENTIATED = ("solver", "fidelity", "precision")  # groups whose gradients are timed
REPEATS = 3


@dataclasses.dataclass(frozen=True)
class Setting:
    """One way to compute a motion.

    Args:
        group: what is varied: ``solver``, ``contact``, ``samples``, ``harmonics``, ``fidelity`` or ``precision``.
        name: in words.
        scene: the scene as this setting models it.
        stepper: of `gearjax.simulate`.
        samples: of the record.
        gradient: how many runs its gradient may take, to leave out those that take too long.
    """

    group: str
    name: str
    scene: Scene
    stepper: Stepper | QuasiStatic
    samples: int
    gradient: float = 10.0


@dataclasses.dataclass(frozen=True)
class Measured:
    """What a setting costs and buys.

    Args:
        group, name: of the setting.
        error: largest deviation of peak-to-peak, amplitude, mean and standard deviation under all torques [rad].
        metrics: by torque and name [rad].
        seconds: of one run, median [s].
        gradient_seconds: of the gradient of the standard deviation with respect to every number of the errors, reverse
            mode [s]; ``None`` where it would take long, or is that of another setting.
        compile_seconds: of the first run [s].
    """

    group: str
    name: str
    error: float
    metrics: dict[float, dict[str, float]]
    seconds: float
    gradient_seconds: float | None
    compile_seconds: float


@dataclasses.dataclass(frozen=True)
class Tradeoff:
    """All settings of a scene and the cheapest one that is good enough.

    Args:
        truth: metrics of the yardstick by torque [rad].
        truth_seconds: what the yardstick took [s].
        rows: the settings.
        error: what was asked for [rad].
    """

    truth: dict[float, dict[str, float]]
    truth_seconds: float
    rows: list[Measured]
    error: float

    @property
    def best(self) -> Measured | None:
        """The fastest setting within the error, ``None`` if there is none."""
        good = [row for row in self.rows if row.error <= self.error]
        return min(good, key=lambda row: row.seconds, default=None)


def tradeoff(scene: Scene, error: float, progress: Progress = silent) -> Tradeoff:
    """Measure every setting on the run section of a scene.

    Args:
        scene: with a run section that lists ``dynamic``.
        error: allowed error of the metrics [rad].
        progress: called with a line of text now and then.

    Raises:
        SceneError: there is no dynamic analysis to measure.
    """
    run = _dynamic(scene)
    longest, usual = _resolving(scene, run)
    truth_step = FixedStep(TRUE_STEP * longest, solver=RungeKutta4())
    yardstick = Setting("truth", "Runge-Kutta", scene, truth_step, run.samples)
    progress(f"truth: Runge-Kutta, steps of {TRUE_STEP * longest:.2g} s")
    truth, seconds, _ = _run(yardstick, repeats=0)
    rows = []
    for setting in settings(scene, run, longest, usual):
        rows.append(_measure(setting, truth))
        progress(f"{setting.group}: {setting.name}: {rows[-1].seconds:.3g} s")
    return Tradeoff(truth, seconds, rows, error)


def _dynamic(scene: Scene) -> Run:
    if scene.run is None or "dynamic" not in scene.run.analyses:
        raise SceneError('[run] must list "dynamic" among its analyses: the accuracy is that of the dynamic TE')
    return scene.run


def _resolving(scene: Scene, run: Run) -> tuple[float, FixedStep]:
    """The longest step that follows the fastest motion [s], and the steps of a run."""
    usual = suitable_step(scene, run.duration)
    return usual.step / STEP * LONGEST_STEP, usual


def accurate_step(scene: Scene, error: float, progress: Progress = silent) -> FixedStep:
    """The longest steps of the fitted scheme whose metrics are within an error, against steps a quarter as long.

    Args:
        scene: with a run section that lists ``dynamic``.
        error: allowed error of the metrics [rad].
        progress: called with a line of text now and then.

    Raises:
        SceneError: there is no dynamic analysis, or no step is short enough.
    """
    run = _dynamic(scene)
    longest, usual = _resolving(scene, run)
    for size in (*STEPS, STEPS[-1] / 2, STEPS[-1] / 4):
        stepper = FixedStep(size * longest, windows=usual.windows)
        setting = Setting("solver", f"{size:g} rad", scene, stepper, run.samples)
        fine = dataclasses.replace(setting, stepper=dataclasses.replace(stepper, step=stepper.step / 4))
        metrics, finer = _run(setting, 0)[0], _run(fine, 0)[0]
        off = max(abs(metrics[t][name] - finer[t][name]) for t in metrics for name in METRICS)
        progress(f"steps of {stepper.step:.2g} s: metrics within {off:.2g} rad of steps a quarter as long")
        if off <= error:
            return stepper
    raise SceneError(f"accuracy: no step down to {STEPS[-1] / 4 * longest:.2g} s is within {error:.2g} rad")


def settings(scene: Scene, run: Run, longest: float, usual: FixedStep) -> list[Setting]:
    """The settings to measure, for the longest step of the scene [s] and its usual steps."""
    alone, number, cut = FixedStep(usual.step), run.samples, usual.windows
    found = [Setting("solver", f"fitted, {s:g} rad", scene, FixedStep(s * longest), number) for s in STEPS]
    found += [
        Setting("solver", f"fitted, {s:g} rad, windows", scene, FixedStep(s * longest, windows=cut), number)
        for s in (STEPS[:3] if cut is not None else ())
    ]
    found += [
        Setting("solver", f"Runge-Kutta, {s:g} rad", scene, FixedStep(s * longest, solver=RungeKutta4()), number)
        for s in STEPS[:3]
    ]
    found += [
        Setting("solver", f"{type(solver).__name__}, {tol:g}", scene, AdaptiveStep(tol, tol, solver), number, 400.0)
        for solver, tol in ((diffrax.Tsit5(), 1e-4), (diffrax.Dopri5(), 1e-4), (diffrax.Dopri8(), 1e-7))
    ]
    laws: list[tuple[str, Callable[[float], AbstractContact]]] = [
        ("quadratic", QuadraticContact),
        ("softplus", SoftplusContact),
    ]
    found += [
        Setting("contact", f"{name}, {1e6 * w:g} um", dataclasses.replace(scene, contact=law(w)), alone, number)
        for name, law in laws
        for w in WIDTHS
    ]
    mesh = 2 * np.pi / (float(scene.system.input_speed) * scene.system.orders["mesh"])
    for per_mesh in (2, 6, 20):
        fewer = int(run.duration / mesh * per_mesh) + 1
        if 2 <= fewer < number:
            found.append(Setting("samples", f"{per_mesh} per mesh period", scene, alone, fewer))
    if isinstance(scene.compliance, HarmonicStiffness):
        for kept in range(scene.compliance.harmonics):
            parts = scene.compliance.mean, scene.compliance.relative_amplitudes[:kept], scene.compliance.phases[:kept]
            fewer_waves = dataclasses.replace(scene, compliance=HarmonicStiffness(*parts))
            found.append(Setting("harmonics", f"{kept} kept", fewer_waves, alone, number))
    found += [
        Setting("fidelity", name, scene, QuasiStatic(inertia), number)
        for name, inertia in (("quasi-static", False), ("quasi-static, inertia corrected", True))
    ]
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)
    return [*found, Setting("precision", "float32", single, alone, number)]


def _measure(setting: Setting, truth: dict[float, dict[str, float]]) -> Measured:
    metrics, seconds, compile_seconds = _run(setting, REPEATS)
    error = max(abs(metrics[torque][name] - truth[torque][name]) for torque in truth for name in METRICS)
    timed = setting.group in DIFFERENTIATED and setting.gradient * seconds <= LONGEST_GRADIENT
    gradient = _gradient_seconds(setting) if timed else None
    return Measured(setting.group, setting.name, error, metrics, seconds, gradient, compile_seconds)


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
    """Metrics by torque, seconds of one run, and of compiling."""
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
