"""Compensation: a design's numbers chosen to minimise the loaded transmission error over given sets of errors.

Forward-mode gradients for sequential quadratic programming (scipy's SLSQP), side by side over the sets; the result is
judged by the hard law, between the samples too, and tightened until it holds there.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.metrics import extremes, top
from gearjax.analysis.quasi_static import angles_of, play, rest
from gearjax.analysis.torsion import pressures
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.compliance import AbstractLineContact
from gearjax.errors import AbstractError
from gearjax.scene import Scene, require
from gearjax.studies.select import Bounds, Free, Where, pick
from gearjax.typing import Array, ArrayLike, Float, Scalar

OBJECTIVES = ("mean_lag", "peak_to_peak")
ROUNDS = 4  # of tightening
MOST_STEPS = 100
FEASIBLE = 1e-4  # of the scaled constraints
Errors = Mapping[str, AbstractError]
Requirement = Callable[[Scene], Scalar]


class Judged(eqx.Module):
    """A design under each set of errors, by the hard law.

    Args:
        mean_lag: mean of the loaded transmission error, positive where the output lags, shape (set,) [rad].
        peak_to_peak: of the loaded transmission error at the samples, shape (set,) [rad].
        minimum_backlash: smallest backlash over the angles, between samples too, shape (set,) [rad].
        maximum_backlash: largest backlash, shape (set,) [rad].
        largest_force: shape (set,) [N].
        largest_pressure: by Hertz, shape (set,) [Pa]; ``None`` where the material is not known.
    """

    mean_lag: Float[Array, " set"]
    peak_to_peak: Float[Array, " set"]
    minimum_backlash: Float[Array, " set"]
    maximum_backlash: Float[Array, " set"]
    largest_force: Float[Array, " set"]
    largest_pressure: Float[Array, " set"] | None


@dataclasses.dataclass(frozen=True)
class Compensation:
    """A compensated design next to the one it started from.

    Args:
        scene: the compensated scene.
        values: its numbers by path, SI.
        before, after: both designs judged.
        holds: whether every requirement holds, judged hard under every set of errors.
        complaints: what does not hold, one line each.
        interferes: whether the start has negative backlash under some set of errors.
    """

    scene: Scene
    values: dict[str, float]
    before: Judged
    after: Judged
    holds: bool
    complaints: tuple[str, ...]
    interferes: bool

    @property
    def lag_reduction(self) -> float:
        """Share of the mean lag over all sets that is gone [-]."""
        return 1 - float(self.after.mean_lag.mean() / self.before.mean_lag.mean())


def compensate(
    scene: Scene,
    theta: ArrayLike,
    torque: ArrayLike,
    where: Where,
    *,
    bounds: Bounds,
    objective: str = "mean_lag",
    error_sets: Sequence[Errors] | None = None,
    minimum_backlash: float = 0.0,
    maximum_backlash: float | None = None,
    maximum_pressure: float | None = None,
    law: AbstractLineContact | None = None,
    require_positive: Sequence[Requirement] = (),
    starts: int = 1,
) -> Compensation:
    """Choose numbers of a design, such as modifications, to minimise its loaded transmission error.

    The mean over all sets of errors is minimised. A design with less than the minimum backlash under any of them is
    never accepted: what looks like a small error may be interference (Hu et al. 2020).

    Args:
        scene: the design to start from, with a compliance and back flanks.
        theta: input angles, increasing, shape (n,) [rad].
        torque: load torque [N m].
        where: the numbers to choose.
        bounds: lowest and highest value of each, by path, SI.
        objective: ``"mean_lag"``, or ``"peak_to_peak"``, which needs a maximum backlash: without, ever more backlash
            pays.
        error_sets: errors in place of the scene's, as it has them; without, the scene's own.
        minimum_backlash: at every angle, under every set [rad].
        maximum_backlash: mean over the angles, under every set [rad].
        maximum_pressure: by Hertz [Pa].
        law: material and face width for the pressure, where the compliance does not have them.
        require_positive: functions of the scene that must not be negative, such as
            ``lambda scene: scene.system.tip_clearance - 10e-6``.
        starts: designs to descend from: the given one, and others spread between the bounds.

    Raises:
        ParameterError: a value is wrong.
        SceneError: the scene lacks what it needs.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> names = ["system.isometric_modification", "system.shifting_modification"]
        >>> found = gj.compensate(
        ...     scene, jnp.linspace(0.0, 6.2, 40), 784.0, names, bounds=dict.fromkeys(names, (-60e-6, 20e-6)),
        ...     minimum_backlash=0.1 * gj.units.arcmin, require_positive=[lambda s: s.system.tip_clearance - 10e-6],
        ... )
        >>> found.holds, found.lag_reduction > 0.1
        (True, True)
    """
    if objective not in OBJECTIVES:
        raise ParameterError("objective", objective, nearest(objective, OBJECTIVES))
    if objective == "peak_to_peak" and maximum_backlash is None:
        raise ParameterError("maximum_backlash", None, "peak_to_peak needs one: without, ever more backlash pays")
    require(scene, "compensation", "backlash", "compliance")
    free = pick(scene, where, bounds)
    free.require_bounds()
    physics = scene.physics("backlash", "compliance")
    sets = _stacked(scene, error_sets)
    limits = _Limits(minimum_backlash, maximum_backlash, maximum_pressure, tuple(require_positive))
    theta, torque = angles_of(scene, theta), jnp.asarray(torque, scene.dtype)
    task = _Task(physics, sets, free, theta, torque, law, maximum_pressure is not None)
    start = np.asarray(free.get(scene), float)
    begins, margin = [start, *_others(free, starts - 1)], 0.0
    values = start
    for _ in range(ROUNDS):
        ends = [_descend(task, begin, objective, limits, margin) for begin in begins]
        values = min(ends, key=lambda end: end[1])[0]
        short = limits.minimum_backlash - float(task.judged(jnp.asarray(values)).minimum_backlash.min())
        if short <= 0:
            break
        margin += 1.05 * short
    before, after = (task.judged(jnp.asarray(x, scene.dtype)) for x in (start, values))
    found = free.set(scene, jnp.asarray(values, scene.dtype))
    complaints = limits.complaints(found, after)
    named = dict(zip(free.paths, (float(v) for v in values), strict=True))
    interferes = bool((before.minimum_backlash < 0).any())
    return Compensation(found, named, before, after, not complaints, complaints, interferes)


@dataclasses.dataclass(frozen=True)
class _Limits:
    minimum_backlash: float
    maximum_backlash: float | None
    maximum_pressure: float | None
    positive: tuple[Requirement, ...]

    def complaints(self, scene: Scene, judged: Judged) -> tuple[str, ...]:
        """What does not hold."""
        found = []
        sets = len(judged.mean_lag)
        short = judged.minimum_backlash < self.minimum_backlash
        if bool(short.any()):
            low = float(judged.minimum_backlash.min())
            found.append(
                f"backlash below {self.minimum_backlash:g} rad under {int(short.sum())} of {sets} sets: {low:g}"
            )
        if self.maximum_backlash is not None and bool(
            (judged.maximum_backlash > self.maximum_backlash * (1 + 1e-6)).any()
        ):
            found.append(f"mean backlash above {self.maximum_backlash:g} rad: {float(judged.maximum_backlash.max()):g}")
        if self.maximum_pressure is not None and judged.largest_pressure is not None:
            high = float(judged.largest_pressure.max())
            if high > self.maximum_pressure * (1 + 1e-6):
                found.append(f"pressure above {self.maximum_pressure:g} Pa: {high:g}")
        for index, requirement in enumerate(self.positive):
            value = float(requirement(scene))
            if value < -1e-12:
                found.append(f"require_positive[{index}]: {value:g}")
        return tuple(found)


class _Task(eqx.Module):
    """A design under its sets of errors."""

    physics: Scene
    sets: Any
    free: Free
    theta: Array
    torque: Array
    law: AbstractLineContact | None
    pressed: bool = eqx.field(static=True)

    def _scene(self, values: Array, errors: Any) -> Scene:
        return dataclasses.replace(self.free.set(self.physics, values), errors=errors)

    def curves(self, values: Array) -> tuple[Array, Array, Array | None]:
        """Loaded TE and backlash, shape (set, n) [rad], and the largest pressure, shape (set,) [Pa]."""

        def one(errors: Any) -> tuple[Array, Array, Array | None]:
            scene = self._scene(values, errors).anchored()
            rests = jax.vmap(lambda angle: rest(scene.contacts(angle, "mean"), scene, self.torque))(self.theta)
            backlash = jax.vmap(lambda angle: play(scene, angle))(self.theta)
            pressure = None
            if self.pressed:
                pressure = top(pressures(scene, self.law, self.theta, rests.forces).ravel())
            return rests.position, backlash, pressure

        return jax.vmap(one)(self.sets)

    @eqx.filter_jit
    def numbers(self, values: Array, objective: str) -> tuple[Array, Array, Array, Array | None]:
        """Objective, smallest and mean backlash and largest pressure of each set."""
        te, backlash, pressure = self.curves(values)
        lag = -te.mean() if objective == "mean_lag" else (top(te) + top(-te)).mean()
        return lag, -top(-backlash), backlash.mean(axis=1), pressure

    @eqx.filter_jit
    def slopes(self, values: Array, objective: str) -> tuple[Array, Array, Array, Array | None]:
        """Derivatives of `numbers`."""
        return jax.jacfwd(lambda values: self.numbers(values, objective))(values)

    @eqx.filter_jit
    def judged(self, values: Array) -> Judged:
        """Everything that is told of a design."""

        def one(errors: Any) -> tuple:
            scene = self._scene(values, errors).anchored()
            rests = jax.vmap(lambda angle: rest(scene.contacts(angle, "mean"), scene, self.torque))(self.theta)
            backlash = jax.vmap(lambda angle: play(scene, angle))(self.theta)
            found = extremes(play, scene, self.theta, backlash)
            pressure = None
            if self.pressed:
                pressure = pressures(scene, self.law, self.theta, rests.forces).max()
            te = rests.position
            return -te.mean(), te.max() - te.min(), found.minimum, backlash.mean(), rests.forces.max(), pressure

        return Judged(*jax.lax.map(one, self.sets))


def _others(free: Free, number: int) -> list[np.ndarray]:
    """Designs spread between the bounds."""
    from scipy.stats import qmc

    low, high = np.array(free.bounds).T
    return [low + (high - low) * point for point in qmc.Halton(len(low), scramble=False).random(number + 1)[1:]]


def _descend(
    task: _Task, start: np.ndarray, objective: str, limits: _Limits, margin: float
) -> tuple[np.ndarray, tuple[float, float]]:
    """Values by sequential quadratic programming, the backlash larger by a margin than required [rad]; and how far
    they are from what is required, then how good."""
    from scipy import optimize

    low, high = np.array(task.free.bounds).T
    scale = 0.1 * (high - low)

    @functools.lru_cache(maxsize=4)
    def at(key: bytes) -> tuple:
        values = jnp.asarray(np.frombuffer(key) * scale, task.physics.dtype)
        return task.numbers(values, objective), task.slopes(values, objective)

    def number(x: np.ndarray, index: int) -> np.ndarray:
        return np.asarray(at(x.tobytes())[0][index], float)

    def slope(x: np.ndarray, index: int) -> np.ndarray:
        return np.asarray(at(x.tobytes())[1][index], float) * scale

    unit = max(abs(float(number(start / scale, 0))), 1e-12)
    least = limits.minimum_backlash + margin
    constraints = [
        {"type": "ineq", "fun": lambda x: (number(x, 1) - least) / unit, "jac": lambda x: slope(x, 1) / unit}
    ]
    if limits.maximum_backlash is not None:
        most = limits.maximum_backlash
        constraints.append(
            {"type": "ineq", "fun": lambda x: (most - number(x, 2)) / unit, "jac": lambda x: -slope(x, 2) / unit}
        )
    if limits.maximum_pressure is not None:
        highest = limits.maximum_pressure
        constraints.append(
            {"type": "ineq", "fun": lambda x: 1 - number(x, 3) / highest, "jac": lambda x: -slope(x, 3) / highest}
        )
    for requirement in limits.positive:
        with_values = _function_of(task, requirement)
        gradient = jax.grad(with_values)
        size = max(float(np.linalg.norm(np.asarray(gradient(jnp.asarray(start))) * scale)), 1e-300)
        constraints.append(
            {
                "type": "ineq",
                "fun": lambda x, f=with_values, s=size: float(f(jnp.asarray(x * scale))) / s,
                "jac": lambda x, g=gradient, s=size: np.asarray(g(jnp.asarray(x * scale)), float) * scale / s,
            }
        )
    found = optimize.minimize(
        lambda x: float(number(x, 0)) / unit,
        np.clip(start, low, high) / scale,
        jac=lambda x: slope(x, 0) / unit,
        bounds=list(zip(low / scale, high / scale, strict=True)),
        constraints=constraints,
        method="SLSQP",
        options={"maxiter": MOST_STEPS, "ftol": 1e-7},
    )
    missed = max(0.0, *(-float(np.min(part["fun"](found.x))) for part in constraints))
    return np.clip(found.x * scale, low, high), (missed if missed > FEASIBLE else 0.0, float(number(found.x, 0)))


def _function_of(task: _Task, requirement: Requirement) -> Callable[[Array], Scalar]:
    return lambda values: jnp.asarray(requirement(task.free.set(task.physics, values)))


def _stacked(scene: Scene, error_sets: Sequence[Errors] | None) -> Any:
    """Sets of errors with a leading axis.

    Raises:
        SceneError: none given, or of different kinds.
    """
    sets = [dict(scene.physics().errors)] if error_sets is None else [dict(errors) for errors in error_sets]
    if not sets:
        raise SceneError("error_sets is empty: give at least one, or None for the scene's own errors")
    for index, errors in enumerate(sets):
        if jax.tree.structure(errors) != jax.tree.structure(sets[0]):
            raise SceneError(f"error_sets[{index}]: lists other errors than error_sets[0]")
        dataclasses.replace(scene, errors=errors)  # checks bodies
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, scene.dtype) for leaf in leaves]), *sets)
