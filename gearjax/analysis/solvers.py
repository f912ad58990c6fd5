"""Time steppers for the equation of motion.

`FixedStep` is the default: in a batch no scene waits for another, and its gradients are exact in both modes. It runs
the step of a solver under ``lax.scan``, because the adjoints of ``diffeqsolve`` cost hundreds of primal solutions on
these long records. `AdaptiveStep` is the adaptive loop of diffrax: the reference for accuracy, for single scenes.
"""

import itertools
import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.fast.fitted import ExponentialFit
from gearjax.analysis.fast.march import QUICK
from gearjax.checks import SceneError, is_concrete
from gearjax.typing import Array

LONGEST_STEP = 1.0  # rad of the fastest motion per step; Runge-Kutta is stable up to 2.8
MOST_BETWEEN = 10_000_000  # steps between two samples
LONG = QUICK[0].steps  # steps of a long block; if samples are further apart, blocks have at least half as many


class RungeKutta4(diffrax.AbstractSolver):
    """The classical Runge-Kutta method, written out; a step costs a fifth of that of a general tableau."""

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 4

    def init(self, terms, t0, t1, y0, args):
        return None

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del solver_state, made_jump
        span = terms.contr(t0, t1)
        middle = t0 + 0.5 * (t1 - t0)
        k1 = terms.vf(t0, y0, args)
        k2 = terms.vf(middle, y0 + 0.5 * span * k1, args)
        k3 = terms.vf(middle, y0 + 0.5 * span * k2, args)
        k4 = terms.vf(t1, y0 + span * k3, args)
        y1 = y0 + span * (k1 + 2 * (k2 + k3) + k4) / 6
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful


class Windows(NamedTuple):
    """Windows of time into which a record is cut, to be computed in parallel.

    Each window starts from the quasi-static solution and has a warm-up, in which the start is forgotten.

    Args:
        number: number of windows.
        warm_up: time before each window that is computed and discarded [s].
    """

    number: int
    warm_up: float


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= 1


def _check_solver(solver: object) -> None:
    if not isinstance(solver, diffrax.AbstractSolver):
        raise SceneError(f"solver = {solver!r:.40}: must be a solver, such as gj.RungeKutta4() or diffrax.Tsit5()")


class FixedStep(eqx.Module):
    """Even steps between samples.

    Args:
        step: longest step [s]. Each interval between samples is divided evenly, so that a step ends on each sample. A
            large number of steps is raised a little if it has no divisor for long blocks (168 instead of 167).
        per_sample: number of steps between samples, in place of ``step``; needed if the sample times are traced.
            Above 96, numbers with only small factors (128, not 127) are many times faster if speeds are traced.
        solver: `ExponentialFit` (second order, exact between changes of contact), or any solver of diffrax such as
            `RungeKutta4`.
        windows: windows into which the record is cut, for `ExponentialFit` only; ``None`` to compute it in one go.
    """

    step: float = eqx.field(static=True, default=4e-5)
    per_sample: int | None = eqx.field(static=True, default=None)
    solver: diffrax.AbstractSolver = ExponentialFit()
    windows: Windows | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        arguments.real("step", self.step, "must be a number of seconds, such as 1e-6")
        if not (math.isfinite(self.step) and self.step > 0):
            raise SceneError(f"step = {self.step:g} s: must be above 0")
        if self.per_sample is not None and not _is_whole(self.per_sample):
            raise SceneError(f"per_sample = {self.per_sample}: must be a whole number, at least 1")
        _check_solver(self.solver)
        if self.windows is None:
            return
        number, warm_up = self.windows
        if not _is_whole(number):
            raise SceneError(f"windows: number = {number}: must be a whole number, at least 1")
        if not 0 <= warm_up < math.inf:
            raise SceneError(f"windows: warm_up = {warm_up} s: must be a time, at least 0")

    def steps(self, ts: Array | np.ndarray) -> int:
        """Number of steps between two samples."""
        if self.per_sample is not None:
            return self.per_sample
        if not is_concrete(ts):
            raise SceneError("ts is traced: its spacing is unknown, give stepper=FixedStep(per_sample=...)")
        fewest = max(1, math.ceil(float(np.diff(np.asarray(ts)).max(initial=0.0)) / self.step - 1e-6))
        if fewest > MOST_BETWEEN:
            words = f"asks for {fewest:.2g} steps between samples, more than {MOST_BETWEEN:.0g}"
            raise SceneError(f"step = {self.step:g} s: {words}")
        return next(n for n in itertools.count(fewest) if n <= LONG or any(n % k == 0 for k in range(LONG // 2, LONG)))


class AdaptiveStep(eqx.Module):
    """Steps of adaptive length, for single scenes. Extremes of the motion are those of its samples.

    Args:
        rtol, atol: tolerances of the scaled variables (position in 10 um, velocity in 10 um per natural period / 2 pi).
        solver: a diffrax solver with an error estimate.
        max_steps: largest number of steps.
        adjoint: how diffrax differentiates: the default in reverse mode, ``diffrax.ForwardMode()`` in forward mode.
    """

    rtol: float = 1e-8
    atol: float = 1e-8
    solver: diffrax.AbstractSolver = diffrax.Dopri8()
    max_steps: int = eqx.field(static=True, default=10_000_000)
    adjoint: diffrax.AbstractAdjoint = diffrax.RecursiveCheckpointAdjoint()

    def __check_init__(self):
        for name, value in (("rtol", self.rtol), ("atol", self.atol)):
            arguments.real(name, value, "must be a tolerance, such as 1e-8")
            if is_concrete(value) and not 0 <= float(value) < math.inf:
                raise SceneError(f"{name} = {value}: must be a tolerance, such as 1e-8")
        if is_concrete((self.rtol, self.atol)) and not float(self.rtol) + float(self.atol) > 0:
            raise SceneError("rtol = atol = 0: one of them must be above 0, such as 1e-8")
        if not _is_whole(self.max_steps):
            raise SceneError(f"max_steps = {self.max_steps}: must be a whole number, at least 1")
        _check_solver(self.solver)


Stepper = FixedStep | AdaptiveStep


def highest_between(before: Array, after: Array, slope_before: Array, slope_after: Array, step: Array) -> Array:
    """Highest value on a step, from values and slopes at its ends; the vertex of a parabola if the curve turns down."""
    turning = (slope_before > 0) & (slope_after < 0)
    bend = jnp.where(turning, slope_before - slope_after, 1.0)
    vertex = before + 0.5 * step * slope_before * slope_before / bend
    return jnp.where(turning, jnp.maximum(vertex, jnp.maximum(before, after)), jnp.maximum(before, after))
