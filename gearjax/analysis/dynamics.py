"""Dynamic transmission error: the motion of the output on its contacts (`gearjax.analysis.equation`).

Times are computed from the numbers of the sample and of the step, not by adding steps.
"""

import dataclasses
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis import chebyshev, modes
from gearjax.analysis.choice import (
    MODELLED,
    ChosenSteps,
    Fitted,
    Method,
    Modes,
    advice,
    allowed,
    are_uneven,
    known_limits,
    method_of,
    told,
)
from gearjax.analysis.equation import Equation, turning_rate
from gearjax.analysis.fast import march
from gearjax.analysis.fast.oscillator import Oscillator
from gearjax.analysis.fast.signals import Forcing
from gearjax.analysis.fast.windows import march_windows
from gearjax.analysis.follow import QuasiStatic, follow
from gearjax.analysis.growth import growth, growth_in_modes, watch
from gearjax.analysis.integrate import Even, integrated, recorded
from gearjax.analysis.meshing_impact import meshing_impact
from gearjax.analysis.modes import Steps, StructureEquation
from gearjax.analysis.motion import Motion
from gearjax.analysis.solvers import LONGEST_STEP, AdaptiveStep, FixedStep, Stepper
from gearjax.checks import SceneError, is_concrete
from gearjax.impact import MeshingImpact
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Scalar

FAULTS = {
    1: "the solution is not finite",
    2: "the step is too long for the fastest motion (natural frequency, damping, stiffness harmonics, load, bodies)",
    3: "the adaptive solver did not finish",
    4: "there is no equilibrium to start from",
    5: "the samples are not evenly spaced, as the fitted solver needs",
}


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
        torque: size of the load torque [N m]; a positive torque loads the driving flanks.
        start: initial state: ``"equilibrium"``, with the velocity at which the equilibrium moves with the gaps, or
            ``"zero"``, at rest at the ideal position. With a smooth contact law, the static position differs from the
            one at which the forces balance, by no more than the width of the law.
        settle: time after the first sample that the metrics leave out [s].
        stepper: `FixedStep`, `AdaptiveStep`, or `QuasiStatic` for a motion without integration. By default fixed steps
            that resolve the fastest motion: of the exponentially fitted scheme or of constant modes, long damped
            records in parallel windows of time (`chosen_steps` reports the choice and its reason); for uneven samples
            of Runge-Kutta. Where the scene is traced, by ``jax.jit``, ``jax.grad`` or ``jax.vmap``, the fastest motion
            is known if only errors and backlash are traced. Otherwise steps are those of ``FixedStep()``, and
            ``result`` is 2 if they are too long: then give those that `chosen_steps` reports for known numbers.

    Returns:
        The motion. If the scene is traced, faults are reported in its ``result``; otherwise they raise. If windows
        differ by more than 1e-9 m where they meet, the record is computed again in one go, with a warning.

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
    physics = scene.precomputed(*MODELLED)
    limits = known_limits(physics)
    method, ts = method_of(scene, ts, torque, stepper, limits), jnp.asarray(ts)
    motion = _simulate(physics, ts, torque, settle, start, method)
    if is_concrete(motion.result) and int(motion.result):
        fault = int(motion.result)
        raise SceneError(f"dynamic: {FAULTS[fault]}{advice(limits, method, fault)}{_of_impacts(physics, torque)}")
    if (
        limits is not None
        and is_concrete(motion.defect)
        and not float(motion.defect) <= allowed(ts.dtype) * float(limits.scale)
    ):
        warnings.warn(
            f"neighbouring time windows differ by {float(motion.defect):.2g} rad where they meet: computed again "
            "without windows",
            stacklevel=2,
        )
        assert isinstance(method, Fitted)
        motion = _simulate(physics, ts, torque, settle, start, method._replace(windows=None))
    return motion


@arguments.checked(
    stepper=arguments.an((FixedStep, AdaptiveStep, QuasiStatic), "must be FixedStep(), AdaptiveStep() or QuasiStatic()")
)
def chosen_steps(
    scene: Scene, ts: ArrayLike, torque: ArrayLike, *, stepper: Stepper | QuasiStatic | None = None
) -> ChosenSteps:
    """How `simulate` would compute a motion, and why; the motion itself is not computed.

    The choices are the fast march of one coordinate if it suits, otherwise steps of constant modes, or the given
    stepper.

    Args:
        scene, ts, torque, stepper: as for `simulate`.

    Raises:
        SceneError: the scene lacks a part, or the step does not suit it.

    Example:
        >>> import gearjax as gj, numpy as np
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> gj.chosen_steps(scene, np.linspace(0.0, 3.0, 3001), 100.0).scheme
        'fitted march in windows'
    """
    ts = _checked(scene, ts, "equilibrium")
    physics = scene.precomputed(*MODELLED)
    method = method_of(scene, ts, jnp.asarray(torque, ts.dtype), stepper, known_limits(physics))
    return told(scene, ts, stepper, method)


def _checked(scene: Scene, ts: ArrayLike, start: str) -> Array | np.ndarray:
    """Checked sample times; a numpy array if they are known, because inside a trace a JAX array would become traced."""
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
    """Mean growth rate of a small disturbance of the motion over a record [1/s]; negative if the disturbance dies out.

    It is the largest Lyapunov exponent, from the linearised steps of the exponentially fitted scheme, or of constant
    modes for bodies on supports (Benettin et al. 1980). If rate times duration is large, the motion is chaotic for
    practical purposes: its samples and their gradients mean nothing, and its statistics scatter.

    Args:
        scene, ts, torque, start: as for `simulate`, with evenly spaced ts.
        stepper: steps of that scheme; by default those of `suitable_step`.

    Raises:
        SceneError: the scene lacks a part, or the step does not suit it.
    """
    ts = _checked(scene, ts, start)
    physics, torque = scene.precomputed(*MODELLED), jnp.asarray(torque, ts.dtype)
    limits = known_limits(physics)
    method = method_of(scene, ts, torque, stepper, limits)
    if not isinstance(method, Fitted | Modes):
        raise SceneError(
            "the growth rate needs evenly spaced ts and steps of the fitted scheme: stepper=FixedStep(...)"
        )
    return _growth_rate(physics, jnp.asarray(ts), torque, start, method.spacing)


def _of_impacts(scene: Scene, torque: Scalar) -> str:
    """Words on impacts that were not found, where a motion failed; otherwise an empty text."""
    if not isinstance(scene.impact, MeshingImpact) or not is_concrete(torque) or not float(torque) > 0:
        return ""
    lost = int((meshing_impact(scene, torque).result != 0).sum())
    words = f"pairs that touch too far before their path of contact, or not until its middle: {lost}"
    return f": no impact is found under {float(torque):g} N*m ({words})" if lost else ""


@eqx.filter_jit
def _growth_rate(scene: Scene, ts: Array, torque: Array, start: str, spacing: march.Spacing | modes.Spacing) -> Scalar:
    if isinstance(spacing, modes.Spacing):
        equation = StructureEquation.of(scene, torque)
        steps, rate = _steps(equation, ts, spacing), equation.scale * equation.frequency
        place, speed = steps.initial(start)
        return growth_in_modes(steps, place * equation.scale, speed * rate, spacing)
    forcing, carry, _ = _begin(Equation.of(scene, torque), ts, start, spacing)
    return growth(forcing, ts[0], carry, spacing)


def _steps(equation: StructureEquation, ts: Array, spacing: modes.Spacing) -> Steps:
    """Constant-mode steps of a record."""
    return Steps.of(equation, ts[0], (ts[-1] - ts[0]) / ((ts.shape[0] - 1) * spacing.each))


def _begin(equation: Equation, ts: Array, start: str, spacing: march.Spacing) -> tuple[Forcing, tuple, Array]:
    """Forcing of the even steps of a record, the initial state, and whether an equilibrium exists to start from."""
    step = (ts[-1] - ts[0]) / ((spacing.samples - 1) * spacing.each)
    forcing = Forcing.of(Oscillator(equation, step), ts[0])
    state = None if start == "equilibrium" else equation.initial(ts[0], start)
    return forcing, *march.begin(forcing, ts[0], spacing.signals, state)


@eqx.filter_jit
def _simulate(scene: Scene, ts: Array, torque: Array, settle: Array, start: str, method: Method) -> Motion:
    of_output = scene.springs_apart and not isinstance(method, Modes)
    equation = (Equation if of_output else StructureEquation).of(scene, torque)
    if isinstance(method, Even | AdaptiveStep):
        motion = integrated(equation, ts, settle, start, method)
    elif isinstance(equation, StructureEquation):
        assert isinstance(method, Modes)
        motion = _in_modes(equation, ts, settle, start, method)
    elif isinstance(method, QuasiStatic):
        motion = _followed(equation, ts, settle, method)
    else:
        assert isinstance(method, Fitted)
        motion = _fitted(equation, ts, settle, start, method)
    if not equation.layout.all_could_carry:
        able = jax.vmap(equation.carriers)(ts)
        motion = dataclasses.replace(motion, carriers=able)
    lost = ~(jnp.isfinite(motion.te).all() & jnp.isfinite(motion.velocity).all())
    fault = jnp.where((motion.result == 0) & lost, 1, motion.result)
    return eqx.tree_at(lambda motion: motion.result, motion, fault)


def _followed(equation: Equation, ts: Array, settle: Array, method: QuasiStatic) -> Motion:
    """A motion that follows the quasi-static position; its extremes are those of the samples."""
    place, speed = follow(equation, ts, method)
    forces = jax.vmap(equation.forces)(ts, place)
    failed = jnp.where(jnp.isfinite(place[0]), 0, 4)
    return recorded(equation, ts, (place, speed), (place, place), forces, settle, failed)


def _in_modes(equation: StructureEquation, ts: Array, settle: Array, start: str, method: Modes) -> Motion:
    """A motion computed by steps of constant modes."""
    steps = _steps(equation, ts, method.spacing)
    state = steps.initial(start)
    there, state = jnp.isfinite(state).all(), jnp.nan_to_num(state)
    rate = equation.scale * equation.frequency
    record = modes.march(steps, state[0] * equation.scale, state[1] * rate, method.spacing)
    place, speed = record.states[:, 0], record.states[:, 1]
    forces = jax.vmap(equation.forces)(ts, place)
    uneven = are_uneven(ts, 1e-3)
    fast = steps.step * equation.fastest_rate(modes=True) > LONGEST_STEP
    failed = jnp.where(there, jnp.where(uneven, 5, jnp.where(fast, 2, 0)), 4)
    return recorded(equation, ts, (place, speed), (record.highest, record.lowest), forces, settle, failed)


def _fitted(equation: Equation, ts: Array, settle: Array, start: str, method: Fitted) -> Motion:
    """A motion computed by the exponentially fitted scheme."""
    forcing, carry, there = _begin(equation, ts, start, method.spacing)
    begun, step = ts[0], forcing.oscillator.step

    def resolves(block: march.Block, accuracy: float) -> Array:
        return step * turning_rate(equation.scene) * block.steps <= 1.01 * chebyshev.reach(block.nodes, accuracy)

    def by(spacing: march.Spacing) -> march.March:
        record = march.march(forcing, begun, carry, spacing)
        load = equation.scene.load
        growing = load is not None and load.alternates  # other causes of growing disturbances are not known
        return watch(record, forcing, begun, carry, spacing) if growing else record

    def in_one_go() -> march.March:
        quick = method.quick
        if quick is None:
            return by(method.spacing)
        return jax.lax.cond(resolves(*march.QUICK), lambda: by(quick), lambda: by(method.spacing))

    if method.windows is None:
        record = in_one_go()
    else:
        record = march_windows(forcing, begun, carry, method.spacing, method.windows)
        if method.fall_back:
            whole = record.defect <= allowed(ts.dtype)
            record = jax.lax.cond(whole, lambda: record, lambda: in_one_go()._replace(defect=record.defect))
    scale = equation.scale
    uneven = are_uneven(ts, 1e-3)
    block = method.spacing.of_whole_blocks().block if method.windows is None else method.windows.block
    resolved = resolves(block, chebyshev.accuracy(ts.dtype))
    fast = ~resolved | (step * equation.fastest_rate() > LONGEST_STEP)
    failed = jnp.where(there, jnp.where(uneven, 5, jnp.where(fast, 2, 0)), 4)
    return Motion(
        ts,
        record.positions * scale,
        record.speeds * (scale / step),
        record.forces,
        record.highest * scale,
        record.lowest * scale,
        settle,
        failed,
        record.defect * scale,
        equation.layout,
    )
