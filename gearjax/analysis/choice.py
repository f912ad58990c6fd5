"""Choice of the steps for a motion, the only module that makes it.

The choice uses the numbers of the scene and the sample times as far as they are known, that is, not traced.
"""

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.equation import Equation, slowest_decay
from gearjax.analysis.fast import march
from gearjax.analysis.fast.fitted import ExponentialFit
from gearjax.analysis.fast.windows import Cut
from gearjax.analysis.follow import QuasiStatic
from gearjax.analysis.integrate import Even
from gearjax.analysis.modes import Spacing, StructureEquation
from gearjax.analysis.solvers import LONGEST_STEP, AdaptiveStep, FixedStep, RungeKutta4, Stepper, Windows
from gearjax.checks import SceneError, is_batched, is_concrete
from gearjax.compliance import AbstractCompliance, AbstractLineContact
from gearjax.evaluate import evaluated
from gearjax.run import NEEDS
from gearjax.scene import Scene
from gearjax.scene_checks import require, require_springs_apart
from gearjax.typing import Array

MODELLED = ("backlash", "compliance", "load", "inertia", "damping", "impact")
STEP = 0.4  # default step over the longest step
MOST_STEPS = 1_000_000_000
MANY_HARMONICS = 100  # of the stiffness, which the fitted march writes out one by one
WINDOW, FEWEST = (3000, 2000), 8  # steps per window for many and for few windows, and the fewest windows that pay
FORGOTTEN = 12.0  # duration of a warm-up, in time constants of the decay
APART = 1e-4, 1e4  # allowed difference of windows where they meet: scaled position (1e-9 m), or spacings of the dtype
ROUNDING = 8.0  # unevenness of samples that counts as rounding of their times, in units of it


class Modes(NamedTuple):
    """Even steps of constant modes: for bodies on supports, slices, or gear sets that ask for such steps."""

    spacing: Spacing


class Fitted(NamedTuple):
    """Even steps of the exponentially fitted scheme.

    Args:
        spacing: spacing of samples and steps.
        windows: windows into which the record is cut, or ``None``.
        fall_back: whether the program itself computes the record again in one go if the windows do not agree.
        quick: spacing for bodies that turn slowly, used if the speed becomes known only while the program runs.
    """

    spacing: march.Spacing
    windows: Cut | None
    fall_back: bool
    quick: march.Spacing | None = None


Method = Even | Fitted | Modes | AdaptiveStep | QuasiStatic


class Limits(NamedTuple):
    """Quantities that limit a step: rates of the scene [rad/s] and its position per scaled position [rad].

    Args:
        fastest: fastest rate that steps of the fitted scheme, or of constant modes, have to resolve.
        decay: decay rate of a motion while one pair is in contact; 0 if it is not known.
        scale: position per scaled position.
        whole: fastest rate for other solvers, which also have to resolve the supports; ``None`` if it is ``fastest``.
    """

    fastest: Array
    decay: Array
    scale: Array
    whole: Array | None = None


def known_limits(physics: Scene) -> Limits | None:
    """The limits of a scene, or ``None`` if its numbers are traced; works also inside the trace of something else."""
    if not is_concrete(physics):
        return None
    return evaluated(limits_of, physics)


def _limits_without_errors(physics: Scene) -> Limits | None:
    """The limits of a scene of which only errors and backlash are traced, on which they do not depend."""

    def parts(scene: Scene) -> tuple[Any, ...]:
        return scene.errors, scene.backlash, scene.reference

    def known(leaf: Any) -> Any:
        return leaf if is_concrete(leaf) else _zeros(leaf.shape, leaf.dtype)

    known_parts = jax.tree.map(known, parts(physics))
    return known_limits(eqx.tree_at(parts, physics, known_parts, is_leaf=lambda leaf: leaf is None))


@functools.cache  # always the same array, so that results of `evaluated` are found again
def _zeros(shape: tuple[int, ...], dtype: Any) -> Array:
    with jax.ensure_compile_time_eval():
        return jnp.zeros(shape, dtype)


def limits_of(physics: Scene) -> Limits:
    nothing = jnp.zeros((), physics.dtype)
    if not physics.springs_apart:  # the decay is not known, hence no windows
        equation = StructureEquation.of(physics, nothing)
        return Limits(equation.fastest_rate(modes=True), nothing, equation.scale[0], equation.fastest_rate())
    equation = Equation.of(physics, nothing)
    return Limits(equation.fastest_rate(), slowest_decay(equation), equation.scale)


def suitable_step(scene: Scene, duration: float) -> FixedStep:
    """Steps that resolve the fastest motion of the scene, with windows if it is damped and the record is long.

    Raises:
        SceneError: the record would need more than `MOST_STEPS` steps.
    """
    return _suitable_step(scene, duration, step_limits(scene))


def step_limits(scene: Scene) -> Limits:
    """The limits of a scene of known numbers.

    Raises:
        SceneError: the scene lacks what a motion needs.
    """
    require(scene, "dynamic", *NEEDS["dynamic"])
    return evaluated(limits_of, scene.precomputed(*MODELLED))


def memory_of(scene: Scene) -> float | None:
    """Time after which a motion has forgotten how it began [s]; ``None`` if that is not known."""
    decay = float(step_limits(scene).decay)
    return FORGOTTEN / decay if decay > 0 else None


def _suitable_step(scene: Scene, duration: float, limits: Limits) -> FixedStep:
    step = STEP * LONGEST_STEP / float(limits.fastest)
    if duration / step > MOST_STEPS:
        raise SceneError(
            f"run.duration = {duration:g} s needs {duration / step:.2g} steps of {step:.2g} s to follow its "
            f"fastest motion, more than {MOST_STEPS:g}: shorten it, lower compliance.mean or raise inertia.mass"
        )
    return FixedStep(step, windows=_suitable_windows(scene, duration, step, limits))


def _suitable_windows(scene: Scene, duration: float, step: float, limits: Limits) -> Windows | None:
    """Windows for a record, or ``None`` if they would not pay.

    They do not pay if the record is short, the damping weak, or the load changes. Nor do they if the levers of many
    contacts change with the angle, or if the stiffness has many harmonics: that march takes minutes to compile and is
    not faster than constant modes.
    """
    decay = float(limits.decay)
    if decay <= 0 or _load_changes(scene) or by_constant_modes(scene):
        return None
    warm_up = FORGOTTEN / decay
    long, short = (int(duration / max(steps * step, warm_up)) for steps in WINDOW)
    if short < FEWEST:
        return None
    few = min(math.ceil(short / FEWEST) * FEWEST, march.LANES)  # whole vectors, because a remainder takes longer
    return Windows(max(long // march.LANES * march.LANES, few), warm_up)


def method_of(
    scene: Scene, ts: Array | np.ndarray, torque: Array, stepper: Stepper | QuasiStatic | None, limits: Limits | None
) -> Method:
    """The method that a stepper means for a scene and its sample times; what is not traced becomes static."""
    limits = limits if is_concrete(ts) else None
    even = not is_concrete(ts) or not bool(are_uneven(np.asarray(ts), 1e-6))
    if stepper is None:
        known = limits
        if limits is None and is_concrete(ts):
            known = _limits_without_errors(scene)
        stepper = _suitable_step(scene, float(np.ptp(np.asarray(ts))), known) if known else FixedStep()
        if limits is None:  # windows are for motions whose defect can be looked at
            stepper = FixedStep(stepper.step)
        if not even:
            shorter = 1.0 if known is None or known.whole is None else float(known.fastest) / float(known.whole)
            stepper = FixedStep(stepper.step * shorter, solver=RungeKutta4())
    if isinstance(stepper, QuasiStatic):
        require_springs_apart(scene, "QuasiStatic")
    if isinstance(stepper, AdaptiveStep | QuasiStatic):
        return stepper
    steps = stepper.steps(ts)
    if not isinstance(stepper.solver, ExponentialFit):
        return Even(stepper.solver, steps)
    if not even:
        raise SceneError(
            "ts is not evenly spaced, but the exponentially fitted steps need even spacing: give "
            "stepper=FixedStep(step=..., solver=RungeKutta4())"
        )
    if not scene.springs_apart:
        if stepper.windows is not None:
            words = "windows need a scene in which only the output moves, on springs of pairs of teeth"
            raise SceneError(f"{words}: give FixedStep(...) without windows")
        return _modes(scene, ts, steps)
    alternates = scene.load is not None and scene.load.alternates  # the march then warns of meaningless gradients
    if by_constant_modes(scene) and stepper.windows is None and not alternates:
        return _modes(scene, ts, steps)
    samples = ts.shape[0]
    phase, spacing = None, float(np.asarray(ts)[1] - np.asarray(ts)[0]) if is_concrete(ts) else None
    if spacing is not None and is_concrete(scene.system.input_speed):
        phase = scene.system.fastest_order * abs(float(np.asarray(scene.system.input_speed))) * spacing / steps
    if stepper.windows is not None and spacing is None:
        raise SceneError("ts is traced: windows need its spacing, give stepper=FixedStep(per_sample=..., windows=None)")
    batched = is_batched((scene, ts, torque))
    block, signals = march.suitable_block(phase, ts.dtype, batched)
    windows = _windows(stepper.windows, samples, spacing, block) if stepper.windows and spacing else None
    seen = limits is not None and is_concrete((torque, jnp.zeros(())))  # then `simulate` checks the defect itself
    whole = march.Spacing(samples, steps, block, signals)
    alone = phase is None and not batched
    quick = whole._replace(block=march.QUICK[0], signals=march.Signals.TABLE) if alone else None
    return Fitted(whole, windows, fall_back=not seen, quick=quick)


def _modes(scene: Scene, ts: Array | np.ndarray, steps: int) -> Modes:
    return Modes(Spacing.of(ts.shape[0], steps, phase_of(scene, ts, steps), ts.dtype))


class ChosenSteps(NamedTuple):
    """How a motion is computed, and why.

    Args:
        scheme: ``"fitted march"``, ``"fitted march in windows"``, ``"constant modes"``, or the name of the given
            stepper or solver.
        reason: property of the scene, the samples or the stepper that decided.
        step: length of a step [s]; ``None`` if it is adaptive, or if the sample times are traced.
        windows: number of parallel windows; 1 if the record is computed in one go.
    """

    scheme: str
    reason: str
    step: float | None
    windows: int = 1


def told(scene: Scene, ts: Array | np.ndarray, stepper: Stepper | QuasiStatic | None, method: Method) -> ChosenSteps:
    """Description of a method in words; arguments as for `method_of`."""
    if isinstance(method, AdaptiveStep | QuasiStatic):
        return ChosenSteps(type(method).__name__, "the stepper was given", None)
    each = method.steps if isinstance(method, Even) else method.spacing.each
    step = float(np.diff(np.asarray(ts)).max()) / each if is_concrete(ts) else None
    if isinstance(method, Even):
        given = "the stepper was given" if stepper is not None else "the samples are not evenly spaced"
        return ChosenSteps(type(method.solver).__name__, given, step)
    if isinstance(method, Modes):
        if scene.output_alone:
            reason = "the contacts are slices of contact lines"
            if isinstance(scene.compliance, AbstractLineContact):
                reason = "the force of a line contact is not linear"
            elif scene.springs_apart:
                turning = scene.system.by_constant_modes
                reason = (
                    "the levers of many contacts change with the angle" if turning else "the stiffness has many waves"
                )
            return ChosenSteps("constant modes", reason, step)
        moving = ", ".join(scene.coordinates[1:4]) + (", ..." if len(scene.coordinates) > 4 else "")
        return ChosenSteps("constant modes", f"further coordinates move: {moving}", step)
    reason = "only the output moves, on independent springs"
    if method.windows is not None:
        forgets = f"{reason}; the record is long, and damping makes the motion forget its start"
        return ChosenSteps("fitted march in windows", forgets, step, method.windows.number)
    whole = (
        "undamped" if scene.damping is None else "the load changes" if _load_changes(scene) else "the record is short"
    )
    return ChosenSteps("fitted march", f"{reason}; without windows: {whole if stepper is None else 'as given'}", step)


def by_constant_modes(scene: Scene) -> bool:
    """Whether the fitted march does not suit a scene in which it would be possible."""
    return scene.system.by_constant_modes or scene.linear_compliance.harmonics > MANY_HARMONICS


def _load_changes(scene: Scene) -> bool:
    return scene.impact is not None or (scene.load is not None and scene.load.alternates)


def stiffness_order(scene: Scene) -> float:
    """Order of the highest harmonic of the stiffness; 0 if it is constant or depends on more than the mesh angle."""
    compliance = scene.compliance
    if not isinstance(compliance, AbstractCompliance):
        return 0.0
    return compliance.harmonics * scene.system.orders.get("mesh", 0.0)


def phase_of(scene: Scene, ts: Array | np.ndarray, steps: int) -> float | None:
    """Phase per step of the fastest excitation of a scene [rad]; ``None`` if it is not known.

    It is not known where the curvature of flanks acts, which passes through zero, or where slices enter the mesh.
    """
    assert scene.load is not None
    system = scene.system
    if not isinstance(scene.compliance, AbstractCompliance) or not is_concrete((ts, system.input_speed, scene.load)):
        return None
    with jax.ensure_compile_time_eval():
        turning = max(stiffness_order(scene), system.fastest_order) * abs(float(system.input_speed))
        fastest = max(turning, abs(float(scene.load.rate(system.input_speed, system.orders))))
    return fastest * float(np.ptp(np.asarray(ts))) / (ts.shape[0] - 1) / steps


def are_uneven(ts: Array | np.ndarray, share: float) -> Array | np.bool_:
    """Whether samples are further from even than a share of their spacing, beside the rounding of their times."""
    mean = (ts[-1] - ts[0]) / (ts.shape[0] - 1)
    rounding = ROUNDING * float(jnp.finfo(ts.dtype).eps) * abs(ts).max()
    return abs(ts[1:] - ts[:-1] - mean).max() > share * mean + rounding


def _windows(windows: Windows, samples: int, spacing: float, block: march.Block) -> Cut | None:
    """Windows with a warm-up in samples; ``None`` if fewer than two windows would be left."""
    number = max(1, min(windows.number, samples // 2))
    warm_up = max(1, math.ceil(windows.warm_up / spacing - 1e-9))
    return Cut(number, warm_up, block) if number > 1 else None


def allowed(dtype: Any) -> float:
    """Allowed difference of neighbouring windows where they meet, scaled."""
    return max(APART[0], APART[1] * float(jnp.finfo(dtype).eps))


def advice(limits: Limits | None, method: Method, fault: int) -> str:
    """Advice in words if a step is too long; otherwise an empty text."""
    if fault != 2 or limits is None:
        return ""
    whole = limits.whole if isinstance(method, Even) else None
    longest = LONGEST_STEP / float(limits.fastest if whole is None else whole)
    return f": it must be at most {longest:.3g} s, give stepper=FixedStep(step={0.25 * longest:.2g})"
