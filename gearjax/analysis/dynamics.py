"""Dynamic transmission error: the motion of the output on its contacts (`gearjax.analysis.equation`).

Times come from the sample and step number.
"""

import dataclasses
import math
import warnings
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis import march, tables
from gearjax.analysis.equation import Equation, fastest_rate, slowest_decay, turning_rate
from gearjax.analysis.fitted import ExponentialFit
from gearjax.analysis.follow import QuasiStatic, follow
from gearjax.analysis.growth import growth, watch
from gearjax.analysis.integrate import adaptive_steps, even_steps
from gearjax.analysis.motion import Motion
from gearjax.analysis.oscillator import Oscillator
from gearjax.analysis.signals import Drive
from gearjax.analysis.solvers import AdaptiveStep, FixedStep, RungeKutta4, Stepper, Windows
from gearjax.checks import SceneError, is_batched, is_concrete
from gearjax.scene import Scene, require
from gearjax.typing import Array, ArrayLike, Scalar

MODELLED = ("backlash", "compliance", "load", "inertia", "damping")
LONGEST_STEP = 1.0  # rad of the fastest motion; Runge-Kutta is stable to 2.8
STEP = 0.4  # of the longest one, by default
MOST_STEPS = 1_000_000_000
FAULTS = {
    1: "the solution is not finite",
    2: "the step is too long for the fastest motion (natural frequency, damping, stiffness harmonics, load, bodies)",
    3: "the adaptive solver did not finish",
    4: "there is no equilibrium to start from",
    5: "the samples are not evenly spaced, as the fitted solver needs",
}
WINDOW, FEWEST = (3000, 2000), 8  # steps after the warm-up of many windows and of few, and windows that pay
FORGOTTEN = 12.0  # time constants of the decay that a warm-up lasts
APART = 1e-4, 1e4  # that windows may be apart where they meet: scaled position (1e-9 m), or spacings of the dtype


class Even(NamedTuple):
    """Even steps of a solver of diffrax."""

    solver: diffrax.AbstractSolver
    steps: int


class Fitted(NamedTuple):
    """Even steps of the exponentially fitted scheme.

    Args:
        spacing: of samples and steps.
        windows: how the record is cut, or ``None``.
        fall_back: whether windows that do not agree are replaced, within the program, by the march in one go.
        quick: for bodies that turn slowly, which one go finds out while it runs where no speed is known before.
    """

    spacing: march.Spacing
    windows: march.Windows | None
    fall_back: bool
    quick: march.Spacing | None = None


Method = Even | Fitted | AdaptiveStep | QuasiStatic


@arguments.checked(
    stepper=arguments.an((FixedStep, AdaptiveStep, QuasiStatic), "must be FixedStep(), AdaptiveStep() or QuasiStatic()")
)
def simulate(
    scene: Scene,
    ts: ArrayLike,
    torque: ArrayLike,
    *,
    start: str = "equilibrium",
    settle: ArrayLike = 0.0,
    stepper: Stepper | QuasiStatic | None = None,
) -> Motion:
    """Dynamic transmission error under the scene's load.

    Args:
        scene: the scene, with compliance, load and inertia.
        ts: sample times, increasing, shape (n,) [s].
        torque: size of the load torque [N m]; positive loads the driving flanks.
        start: ``"equilibrium"``, moving as the gaps move it, or ``"zero"``, at rest at the ideal position. The
            smooth static form of a smooth law is within its width of the rest position of its forces, not on it.
        settle: time after the first sample that metrics leave out [s].
        stepper: `FixedStep`, `AdaptiveStep`, or `QuasiStatic` for no integration at all. Without, fixed steps of the
            exponentially fitted scheme that resolve the fastest motion, a long damped record in windows side by side
            (`suitable_step`); where the samples are not even, of Runge-Kutta.

    Returns:
        The motion. While tracing, faults are in its ``result``; otherwise they raise. Windows that are further apart
        than 1e-9 m where they meet are replaced by the march in one go, with a warning.

    Raises:
        SceneError: the scene lacks a part, or the step does not suit it.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> motion = gj.simulate(scene, jnp.linspace(0.0, 0.1, 101), torque=100.0)
        >>> motion.te.shape, int(motion.result)
        ((101,), 0)
    """
    ts = _checked(scene, ts, start)
    if is_concrete((ts, settle)) and not 0 <= float(np.asarray(settle)) < float(ts[-1] - ts[0]):
        raise SceneError(f"settle = {float(np.asarray(settle)):g} s: must be at least 0 and less than the record")
    torque, settle = jnp.asarray(torque, ts.dtype), jnp.asarray(settle, ts.dtype)
    physics = scene.physics(*MODELLED)
    limits = _known_limits(physics)
    method, ts = _method(scene, ts, torque, stepper, limits), jnp.asarray(ts)
    motion = _simulate(physics, ts, torque, settle, start, method)
    if is_concrete(motion.result) and int(motion.result):
        raise SceneError(f"dynamic: {FAULTS[int(motion.result)]}{_advice(limits, int(motion.result))}")
    if (
        limits is not None
        and is_concrete(motion.defect)
        and not float(motion.defect) <= _allowed(ts.dtype) * float(limits.scale)
    ):
        warnings.warn(
            f"windows of time are {float(motion.defect):.2g} rad apart where they meet: computed in one go instead",
            stacklevel=2,
        )
        assert isinstance(method, Fitted)
        motion = _simulate(physics, ts, torque, settle, start, method._replace(windows=None))
    return motion


def _checked(scene: Scene, ts: ArrayLike, start: str) -> Array | np.ndarray:
    """Sample times, of numpy where they are known: inside a trace an array of JAX would not stay known."""
    require(scene, "dynamic", "compliance", "load", "inertia")
    if start not in ("equilibrium", "zero"):
        raise SceneError(f'start = "{start}": valid: equilibrium, zero')
    times = np.asarray(ts, scene.dtype) if is_concrete(ts) else jnp.asarray(ts, scene.dtype)
    if times.ndim != 1 or times.shape[0] < 2:
        raise SceneError(f"ts has shape {times.shape}: give at least two sample times")
    if isinstance(times, np.ndarray) and not bool((np.diff(times) > 0).all()):
        raise SceneError("ts must increase")
    return times


@arguments.checked(stepper=arguments.an(FixedStep, "must be FixedStep(...)"))
def growth_rate(
    scene: Scene, ts: ArrayLike, torque: ArrayLike, *, start: str = "equilibrium", stepper: FixedStep | None = None
) -> Scalar:
    """Mean rate at which a small disturbance of the motion grows over a record [1/s]; negative where it dies out.

    The largest Lyapunov exponent, from the linearised steps of the exponentially fitted scheme (Benettin et al. 1980).
    Where rate times duration is large the motion is chaotic for all purposes: its samples and their gradients mean
    nothing, and its statistics scatter.

    Args:
        scene, ts, torque, start: as for `simulate`, ts evenly spaced.
        stepper: steps of the fitted scheme; those of `suitable_step` without.

    Raises:
        SceneError: the scene lacks a part, or the step does not suit it.
    """
    ts = _checked(scene, ts, start)
    physics, torque = scene.physics(*MODELLED), jnp.asarray(torque, ts.dtype)
    limits = _known_limits(physics)
    method = _method(scene, ts, torque, stepper, limits)
    if not isinstance(method, Fitted):
        raise SceneError(
            "the growth rate needs evenly spaced ts and steps of the fitted scheme: stepper=FixedStep(...)"
        )
    return _growth_rate(physics, jnp.asarray(ts), torque, start, method.spacing)


@eqx.filter_jit
def _growth_rate(scene: Scene, ts: Array, torque: Array, start: str, spacing: march.Spacing) -> Scalar:
    drive, carry, _ = _begin(Equation.of(scene, torque), ts, start, spacing)
    return growth(drive, ts[0], carry, spacing)


def _begin(equation: Equation, ts: Array, start: str, spacing: march.Spacing) -> tuple[Drive, tuple, Array]:
    """What drives the even steps of a record, where they begin, and whether there is an equilibrium to begin from."""
    step = (ts[-1] - ts[0]) / ((spacing.samples - 1) * spacing.each)
    drive = Drive.of(Oscillator(equation, step), ts[0])
    state = None if start == "equilibrium" else equation.initial(ts[0], start)
    return drive, *march.begin(drive, ts[0], spacing.signals, state)


class Limits(NamedTuple):
    """What a step depends on: rates of the scene [rad/s] and its position per scaled position [rad]."""

    fastest: Array
    decay: Array
    scale: Array


def _known_limits(physics: Scene) -> Limits | None:
    """The limits of a scene whose numbers are known, also inside the trace of something else."""
    if not is_concrete(physics):
        return None
    with jax.ensure_compile_time_eval():
        return _limits(physics)


@eqx.filter_jit
def _limits(physics: Scene) -> Limits:
    equation = Equation.of(physics, jnp.zeros((), physics.dtype))
    return Limits(fastest_rate(equation), slowest_decay(equation), equation.scale)


def suitable_step(scene: Scene, duration: float) -> FixedStep:
    """Steps that resolve the fastest motion of the scene, and windows where it is damped and the record is long.

    Raises:
        SceneError: the record would need more than `MOST_STEPS` steps.
    """
    return _suitable_step(scene, duration, _limits(scene.physics(*MODELLED)))


def _suitable_step(scene: Scene, duration: float, limits: Limits) -> FixedStep:
    step = STEP * LONGEST_STEP / float(limits.fastest)
    if duration / step > MOST_STEPS:
        raise SceneError(
            f"run.duration = {duration:g} s needs {duration / step:.2g} steps of {step:.2g} s to follow its "
            f"fastest motion, more than {MOST_STEPS:g}: shorten it, lower compliance.mean or raise inertia.mass"
        )
    return FixedStep(step, windows=_suitable_windows(scene, duration, step, limits))


def _suitable_windows(scene: Scene, duration: float, step: float, limits: Limits) -> Windows | None:
    """Windows for a record, or ``None`` where they would not pay: it is short, or what damps it forgets too slowly."""
    decay = float(limits.decay)
    if decay <= 0 or (scene.load is not None and scene.load.alternates):
        return None
    warm_up = FORGOTTEN / decay
    long, short = (int(duration / max(steps * step, warm_up)) for steps in WINDOW)
    if short < FEWEST:
        return None
    few = min(math.ceil(short / FEWEST) * FEWEST, march.LANES)  # whole vectors: what is left over takes longer
    return Windows(max(long // march.LANES * march.LANES, few), warm_up)


def _method(
    scene: Scene, ts: Array | np.ndarray, torque: Array, stepper: Stepper | QuasiStatic | None, limits: Limits | None
) -> Method:
    """What a stepper means for a scene and its sample times; whatever is known now is made static."""
    limits = limits if is_concrete(ts) else None
    even = not is_concrete(ts) or _are_even(np.asarray(ts))
    if stepper is None:
        stepper = _suitable_step(scene, float(np.ptp(np.asarray(ts))), limits) if limits else FixedStep()
        stepper = stepper if even else FixedStep(stepper.step, solver=RungeKutta4())
    if isinstance(stepper, (AdaptiveStep, QuasiStatic)):
        return stepper
    steps = stepper.steps(ts)
    if not isinstance(stepper.solver, ExponentialFit):
        return Even(stepper.solver, steps)
    if not even:
        raise SceneError(
            "ts is not evenly spaced, as the exponentially fitted steps need: give "
            "stepper=FixedStep(step=..., solver=RungeKutta4())"
        )
    samples = ts.shape[0]
    phase, spacing = None, float(np.asarray(ts)[1] - np.asarray(ts)[0]) if is_concrete(ts) else None
    if spacing is not None and is_concrete(scene.system.input_speed):
        phase = scene.system.fastest_order * float(np.asarray(scene.system.input_speed)) * spacing / steps
    if stepper.windows is not None and spacing is None:
        raise SceneError("ts is traced: windows need its spacing, give stepper=FixedStep(per_sample=..., windows=None)")
    batched = is_batched((scene, ts, torque))
    block, signals = march.suitable_block(phase, ts.dtype, batched)
    windows = _windows(stepper.windows, samples, spacing, block) if stepper.windows and spacing else None
    seen = limits is not None and is_concrete((torque, jnp.zeros(())))  # the defect, outside of any trace
    whole = march.Spacing(samples, steps, block, signals)
    alone = phase is None and not batched
    quick = whole._replace(block=march.QUICK[0], signals=march.Signals.SUMS) if alone else None
    return Fitted(whole, windows, fall_back=not seen, quick=quick)


def _are_even(ts: np.ndarray) -> bool:
    spacing = np.diff(ts)
    allowed = 1e-6 * spacing.mean() + 8 * np.finfo(ts.dtype).eps * np.abs(ts).max()
    return bool(np.abs(spacing - spacing.mean()).max() <= allowed)


def _windows(windows: Windows, samples: int, spacing: float, block: march.Block) -> march.Windows | None:
    """Windows in samples; ``None`` where fewer than two would be left."""
    number = max(1, min(windows.number, samples // 2))
    warm_up = max(1, math.ceil(windows.warm_up / spacing - 1e-9))
    return march.Windows(number, warm_up, block) if number > 1 else None


def _allowed(dtype: Any) -> float:
    """How far windows may be apart, scaled."""
    return max(APART[0], APART[1] * float(jnp.finfo(dtype).eps))


def _advice(limits: Limits | None, fault: int) -> str:
    if fault != 2 or limits is None:
        return ""
    longest = LONGEST_STEP / float(limits.fastest)
    return f": it must be at most {longest:.3g} s, give stepper=FixedStep(step={0.25 * longest:.2g})"


@eqx.filter_jit
def _simulate(scene: Scene, ts: Array, torque: Array, settle: Array, start: str, method: Method) -> Motion:
    equation = Equation.of(scene, torque)
    if isinstance(method, Fitted):
        motion = _fitted(equation, ts, settle, start, method)
    else:
        motion = _integrated(equation, ts, settle, start, method)
    if equation.layout.sides_turn:
        able = jax.vmap(equation.carriers)(ts)
        motion = dataclasses.replace(motion, carriers=able)
    lost = ~(jnp.isfinite(motion.te).all() & jnp.isfinite(motion.velocity).all())
    fault = jnp.where((motion.result == 0) & lost, 1, motion.result)
    return eqx.tree_at(lambda motion: motion.result, motion, fault)


def _integrated(
    equation: Equation, ts: Array, settle: Array, start: str, method: Even | AdaptiveStep | QuasiStatic
) -> Motion:
    """By a solver of diffrax, or by following the quasi-static position; extremes of the latter are those of the
    samples."""
    state = equation.initial(ts[0], start)
    there, state = jnp.isfinite(state).all(), jnp.nan_to_num(state)
    if isinstance(method, QuasiStatic):
        place, speed = follow(equation, ts, method)
        states = jnp.stack([place / equation.scale, speed / (equation.scale * equation.frequency)], axis=1)
        highest = lowest = states[:, 0]
        failed = jnp.zeros((), int)
    elif isinstance(method, AdaptiveStep):
        states, highest, lowest, failed = adaptive_steps(equation, ts, state, method)
    else:
        states, highest, lowest = even_steps(equation, ts, state, method.solver, method.steps)
        too_long = (ts[1:] - ts[:-1]).max() / method.steps * fastest_rate(equation) > LONGEST_STEP
        failed = jnp.where(too_long, 2, 0)
    scale = equation.scale
    te = states[:, 0] * scale
    forces = jax.vmap(equation.forces)(ts, te)
    velocity = states[:, 1] * (scale * equation.frequency)
    failed = jnp.where(there, failed, 4)
    whole = jnp.zeros_like(scale)
    return Motion(ts, te, velocity, forces, highest * scale, lowest * scale, settle, failed, whole, equation.layout)


def _fitted(equation: Equation, ts: Array, settle: Array, start: str, method: Fitted) -> Motion:
    """By the exponentially fitted scheme."""
    drive, carry, there = _begin(equation, ts, start, method.spacing)
    begun, step = ts[0], drive.oscillator.step
    spacing = step * method.spacing.each

    def resolves(block: march.Block, accuracy: float) -> Array:
        return step * turning_rate(equation.scene) * block.steps <= 1.01 * tables.reach(block.nodes, accuracy)

    def by(spacing: march.Spacing) -> march.March:
        found = march.march(drive, begun, carry, spacing)
        load = equation.scene.load
        growing = load is not None and load.alternates  # what else makes disturbances grow is not known
        return watch(found, drive, begun, carry, spacing) if growing else found

    def in_one_go() -> march.March:
        quick = method.quick
        if quick is None:
            return by(method.spacing)
        return jax.lax.cond(resolves(*march.QUICK), lambda: by(quick), lambda: by(method.spacing))

    if method.windows is None:
        found = in_one_go()
    else:
        found = march.march_windows(drive, begun, carry, method.spacing, method.windows)
        if method.fall_back:
            whole = found.defect <= _allowed(ts.dtype)
            found = jax.lax.cond(whole, lambda: found, lambda: in_one_go()._replace(defect=found.defect))
    scale = equation.scale
    uneven = jnp.abs((ts[1:] - ts[:-1]) - spacing).max() > 1e-3 * spacing
    block = method.spacing.block if method.windows is None else method.windows.block
    resolved = resolves(block, tables.accuracy(ts.dtype))
    fast = ~resolved | (step * fastest_rate(equation) > LONGEST_STEP)
    failed = jnp.where(there, jnp.where(uneven, 5, jnp.where(fast, 2, 0)), 4)
    return Motion(
        ts,
        found.positions * scale,
        found.speeds * (scale / step),
        found.forces,
        found.highest * scale,
        found.lowest * scale,
        settle,
        failed,
        found.defect * scale,
        equation.layout,
    )
