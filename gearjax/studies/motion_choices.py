"""The ways to compute the motion of a scene that a trade-off compares."""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import AdaptiveStep, FixedStep, QuasiStatic, RungeKutta4
from gearjax.analysis.choice import STEP, step_limits, suitable_step
from gearjax.analysis.solvers import LONGEST_STEP, Stepper
from gearjax.checks import SceneError
from gearjax.compliance import HarmonicStiffness
from gearjax.contact import AbstractContact, QuadraticContact, SoftplusContact
from gearjax.run import Run
from gearjax.scene import Scene

STEPS = (0.8, 0.4, 0.2, 0.1, 0.05)  # rad of the fastest motion
WIDTHS = (1e-8, 1e-7, 1e-6)  # m
ADAPTIVE = (diffrax.Tsit5(), 1e-4, 3.0), (diffrax.Dopri5(), 1e-4, 3.0), (diffrax.Dopri8(), 1e-7, 30.0)  # with its work
TRUE_STEP = 0.0125  # rad of the fastest motion: Runge-Kutta steps of the reference
MOST_RUNGE_KUTTA = 2e8  # steps of a run, which take some minutes
RUNGE_KUTTA_WORK = 3.0  # a step takes some times as long as one of the usual scheme


@dataclasses.dataclass(frozen=True)
class Setting:
    """One way to compute a motion.

    Args:
        group: what is varied: ``solver``, ``contact``, ``samples``, ``harmonics``, ``fidelity`` or ``precision``.
        name: the setting in words.
        scene: the scene as this setting models it.
        stepper: stepper of `gearjax.simulate`.
        samples: number of samples of the record.
        work: expected time of a run, in those of the usual steps.
        gradient: expected time of a gradient, in runs; gradients that would take too long are left out.
        scheme: common name of settings whose gradients take about the same multiple of a run (they differ in step
            length, precision or adaptive solver); empty for the setting's own name.
    """

    group: str
    name: str
    scene: Scene
    stepper: Stepper | QuasiStatic
    samples: int
    work: float = 1.0
    gradient: float = 10.0
    scheme: str = ""

    @property
    def title(self) -> str:
        """Group and name."""
        return f"{self.group}: {self.name}"

    @property
    def of_gradient(self) -> str:
        """Name of the scheme whose gradient is measured for this setting."""
        return self.scheme or self.name

    @property
    def of_samples(self) -> bool:
        """Whether its extremes are those of its samples."""
        return isinstance(self.stepper, AdaptiveStep | QuasiStatic)


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

    def work(self, stepper: FixedStep) -> float:
        """Expected time of a run with even steps, in those of the usual steps."""
        return (RUNGE_KUTTA_WORK if isinstance(stepper.solver, RungeKutta4) else 1.0) * self.usual.step / stepper.step


def resolving(scene: Scene, run: Run) -> Resolving:
    """Steps that resolve the motion of a scene."""
    usual, limits = suitable_step(scene, run.duration), step_limits(scene)
    longest = usual.step / STEP * LONGEST_STEP
    whole = longest if limits.whole is None else LONGEST_STEP / float(limits.whole)
    return Resolving(longest, whole, usual)


def reference(scene: Scene, run: Run, resolved: Resolving) -> Setting:
    """What the settings are compared with: a scheme that has nothing in common with the usual one, in short steps."""
    stepper = resolved.runge_kutta(TRUE_STEP, run)
    return Setting("reference", "Runge-Kutta", scene, stepper, run.samples, resolved.work(stepper))


def settings(scene: Scene, run: Run, resolved: Resolving) -> list[Setting]:
    """The settings to measure."""
    alone, number, cut = FixedStep(resolved.usual.step), run.samples, resolved.usual.windows
    output_alone = scene.springs_apart

    def even(scheme: str, size: float, after: str = "", **options) -> Setting:
        name, stepper = f"{scheme}, {size:g} rad{after}", FixedStep(size * resolved.longest, **options)
        return Setting("solver", name, scene, stepper, number, resolved.work(stepper), scheme=scheme + after)

    trials = [even("fitted" if output_alone else "constant modes", size) for size in STEPS]
    if cut is not None:
        trials += [even("fitted", size, ", windows", windows=cut) for size in STEPS[:3]]
    slow, slowest = (10.0, 400.0) if output_alone else (math.inf, math.inf)  # many coordinates compile for minutes
    for size in STEPS[:3]:
        name, stepper = f"Runge-Kutta, {size:g} rad", resolved.runge_kutta(size, run)
        trials.append(Setting("solver", name, scene, stepper, number, resolved.work(stepper), slow, "Runge-Kutta"))
    for solver, tol, work in ADAPTIVE:
        name, stepper = f"{type(solver).__name__}, {tol:g}", AdaptiveStep(tol, tol, solver)
        trials.append(Setting("solver", name, scene, stepper, number, work, slowest, "adaptive"))
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
