"""Compensation: choice of a design's numbers that minimise the loaded transmission error over given sets of errors.

The method is sequential linear programming with a trust region, which suits requirements on the smallest of many
values. Gradients are computed in forward mode, for all sets of errors at once. The result is evaluated with the hard
contact law, also between the samples, and requirements are tightened until they are met there too.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.extremes import extremes
from gearjax.analysis.metrics import top
from gearjax.analysis.quasi_static import angles_of, play
from gearjax.analysis.resting import clash, rest
from gearjax.analysis.torsion import pressures
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.compliance import AbstractLineContact
from gearjax.contact import Equilibrium
from gearjax.errors import AbstractError
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.studies.compensation import Compensation, Judged, Limits, Requirement
from gearjax.studies.select import Bounds, Free, Where, pick
from gearjax.typing import Array, ArrayLike, Scalar

OBJECTIVES = ("mean_lag", "peak_to_peak")
ROUNDS = 4  # of tightening
SHORT_LEVER = 0.1  # of the mean lever, below which a contact counts as radial
CLEAR = 1e-2  # m, gap of contacts that are not radial
MOST_STEPS = 100
LONGEST_STEP, SHORTEST_STEP = 0.1, 1e-6  # of the span between the bounds
LEAST_GAIN = 1e-7  # of the objective: a step must promise more
PENALTY = 30.0  # of one radian by which a requirement is missed, in radians of the objective
FEASIBLE = 1e-4  # of the objective: amount by which a requirement may be missed at the samples
Errors = Mapping[str, AbstractError]


@arguments.checked(
    starts=arguments.whole(1),
    minimum_backlash=arguments.one_number,
    maximum_backlash=arguments.one_number,
    maximum_pressure=arguments.one_positive,
    law=arguments.an(AbstractLineContact, "must be a line contact, such as HertzLineContact(206e9, 0.3, 11e-3)"),
)
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

    The mean over all sets of errors is minimised. Designs with less than the minimum backlash under any set, or
    whose tips and roots touch, come after all others, because a small error may only be due to interference (Hu et al.
    2020); if no other was found, the result has ``holds`` false.

    Args:
        scene: the design to start from, with a compliance and back flanks.
        theta: input angles, increasing, shape (n,) [rad].
        torque: load torque [N m].
        where: the numbers to choose. Numbers of errors, such as tip relief, are then the same in all sets of errors.
        bounds: lowest and highest value of each number, by path, SI.
        objective: ``"mean_lag"``, or ``"peak_to_peak"``, which needs a maximum backlash: without it, the objective
            falls with ever more backlash.
        error_sets: sets of errors in place of the scene's errors, in the same form; by default the scene's own.
        minimum_backlash: smallest backlash at every angle, under every set [rad].
        maximum_backlash: largest mean backlash over the angles, under every set [rad].
        maximum_pressure: largest pressure by Hertz [Pa].
        law: material and face width for the pressure, if the compliance does not have them.
        require_positive: functions of the scene that must not be negative, such as
            ``lambda scene: scene.system.tip_clearance - 10e-6``.
        starts: number of designs to descend from: the given one, and others spread between the bounds.

    Raises:
        ParameterError: a value is wrong, or a number has no influence.
        SceneError: the scene lacks a part that is needed.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> names = ["system.isometric_modification", "system.shifting_modification"]
        >>> compensation = gj.compensate(
        ...     scene, jnp.linspace(0.0, 6.2, 40), 784.0, names, bounds=dict.fromkeys(names, (-60e-6, 20e-6)),
        ...     minimum_backlash=0.1 * gj.units.arcmin, require_positive=[lambda s: s.system.tip_clearance - 10e-6],
        ... )
        >>> compensation.holds, compensation.lag_reduction > 0.1
        (True, True)
    """
    if objective not in OBJECTIVES:
        raise ParameterError("objective", objective, nearest(objective, OBJECTIVES))
    if objective == "peak_to_peak" and maximum_backlash is None:
        raise ParameterError(
            "maximum_backlash", None, "must be given for peak_to_peak: without it, more backlash is always better"
        )
    require(scene, "compensation", "backlash", "compliance")
    free = pick(scene, where, bounds)
    free.require_bounds()
    physics = scene.physics("backlash", "compliance")
    sets, number = _stacked(scene, error_sets), 1 if error_sets is None else len(error_sets)
    for errors in error_sets or ():
        pick(dataclasses.replace(scene, errors=dict(errors)), where)  # raises if the set lacks a chosen number
    limits = Limits(minimum_backlash, maximum_backlash, maximum_pressure, tuple(require_positive))
    theta, torque = angles_of(scene, theta), jnp.asarray(torque, scene.dtype)
    task = _Task(physics, sets, free, theta, torque, law, maximum_pressure is not None, number)
    start = np.asarray(free.get(scene), float)
    before = task.judged(jnp.asarray(start, scene.dtype))
    begins = _with_ends(task, [start, *_others(free, starts - 1)], objective, limits)
    values, after, margin = start, before, 0.0
    for _ in range(ROUNDS):
        ends = [_descend(task, begin, objective, limits, margin) for begin in begins]
        values = min(ends, key=lambda end: end[1])[0]
        after = task.judged(jnp.asarray(values, scene.dtype))
        short = minimum_backlash - float(after.minimum_backlash.min())
        if short <= 0:
            break
        margin, begins = margin + 1.05 * short, [values]
    design = free.set(scene, jnp.asarray(values, scene.dtype))
    complaints = limits.complaints(design, after)
    named = dict(zip(free.paths, (float(v) for v in values), strict=True))
    interferes = before.clash(scene) is not None
    return Compensation(design, named, before, after, not complaints, complaints, interferes)


class _Task(eqx.Module):
    """A design under its sets of errors."""

    physics: Scene
    sets: Any
    free: Free
    theta: Array
    torque: Array
    law: AbstractLineContact | None
    pressed: bool = eqx.field(static=True)
    number: int = eqx.field(static=True)

    def _under(self, values: Array, errors: Any) -> tuple[Scene, Equilibrium, Array, Array | None]:
        """The scene under one set of errors, its equilibria and backlash at every angle, and the pressures there."""
        scene = self.free.set(dataclasses.replace(self.physics, errors=errors), values).anchored()
        rests = jax.vmap(lambda angle: rest(scene, angle, self.torque))(self.theta)
        backlash = jax.vmap(lambda angle: play(scene, angle))(self.theta)
        pressure = pressures(scene, self.law, self.theta, rests.forces) if self.pressed else None
        return scene, rests, backlash, pressure

    def curves(self, values: Array) -> tuple[Array, Array, Array, Array | None]:
        """Curves and extremes of a design that the search needs.

        They are the loaded TE and the backlash, shape (set, n) [rad], the radial clearance as an angle at the mean
        lever [rad] and the largest pressure [Pa], shape (set,).
        """

        def one(errors: Any) -> tuple[Array, Array, Array, Array | None]:
            scene, rests, backlash, pressure = self._under(values, errors)
            highest = None if pressure is None else top(pressure.ravel())
            return rests.position, backlash, self._radial(scene)[1], highest

        return jax.vmap(one, axis_size=self.number)(self.sets)

    def _lag(self, te: Array) -> Scalar:
        """Mean of the loaded TE in the direction in which the torque turns the output [rad]."""
        return jnp.where(self.torque < 0, 1.0, -1.0) * te.mean()

    def _radial(self, scene: Scene) -> tuple[Array, Array]:
        """Smallest gap of radial contacts, whose lever is short [m], and the same divided by the mean lever [rad]."""

        def at(angle: Scalar) -> tuple[Array, Array]:
            contacts = scene.contacts(angle)
            size = jnp.abs(contacts.own_levers)
            return jnp.where(size < SHORT_LEVER * size.mean(), contacts.gap, CLEAR), size.mean()

        gaps, levers = jax.vmap(at)(self.theta)
        least = -top(-gaps.ravel())
        return least, least / jax.lax.stop_gradient(levers.mean())

    @eqx.filter_jit
    def at(
        self, values: Array, margin: Scalar, objective: str, limits: Limits
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Derivatives of the objective and of the slacks, and their values."""

        def both(values: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
            te, backlash, radial, pressure = self.curves(values)
            goal = self._lag(te) if objective == "mean_lag" else (top(te) + top(-te)).mean()
            goal_and_slack = goal, limits.slack(self.free.set(self.physics, values), backlash, radial, pressure, margin)
            return goal_and_slack, goal_and_slack

        return jax.jacfwd(both, has_aux=True)(values)

    @eqx.filter_jit
    def judged(self, values: Array) -> Judged:
        """The evaluation of a design with the hard contact law."""

        def one(errors: Any) -> tuple:
            scene, rests, backlash, pressure = self._under(values, errors)
            te, extreme = rests.position, extremes(play, scene, self.theta, backlash)
            highest = None if pressure is None else pressure.max()
            sizes = extreme.minimum, backlash.mean(), rests.forces.max(), highest, self._radial(scene)[0]
            overlap = jax.vmap(lambda angle: clash(scene, angle))(self.theta)
            worst = jnp.argmax(overlap.overlap)
            sizes = *sizes, overlap.overlap[worst], overlap.contact[worst], self.theta[worst]
            return self._lag(te), te.max() - te.min(), *sizes

        each = jax.lax.map(lambda at: one(at[0]), (self.sets, jnp.arange(self.number)))
        return Judged(*each)


def _with_ends(task: _Task, begins: list[np.ndarray], objective: str, limits: Limits) -> list[np.ndarray]:
    """The starts, and further ones with a number at each of its bounds if it has no influence near the starts.

    Without these, the search would never change that number.

    Raises:
        ParameterError: a number changes neither the objective nor a requirement at its bounds either.
    """

    def at(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The objective and the slacks, and the sum of the derivatives' sizes for each number."""
        values, margin = (jnp.asarray(part, task.physics.dtype) for part in (place, 0.0))
        slopes, sizes = task.at(values, margin, objective, limits)
        slope, size = (np.concatenate([np.asarray(part[0])[None], np.asarray(part[1])]) for part in (slopes, sizes))
        return size, np.abs(slope).sum(axis=0)

    sizes, moves = zip(*map(at, begins), strict=True)
    low, high = task.free.box
    for column in np.flatnonzero(sum(moves) == 0):
        ends = [np.where(np.arange(len(low)) == column, end, begins[0]) for end in (low, high)]
        if all(np.array_equal(at(end)[0], sizes[0]) for end in ends):
            words = f"{objective} does not depend on it, nor does any requirement"
            raise ParameterError("where", task.free.paths[column], words)
        begins = [*begins, *ends]
    return begins


def _others(free: Free, number: int) -> list[np.ndarray]:
    """Designs spread between the bounds."""
    from scipy.stats import qmc

    low, high = free.box
    return [low + (high - low) * point for point in qmc.Halton(len(low), scramble=False).random(number + 1)[1:]]


def _descend(
    task: _Task, start: np.ndarray, objective: str, limits: Limits, margin: float
) -> tuple[np.ndarray, tuple[float, float]]:
    """The best values near a start, and a pair to compare them by: by how much a requirement is missed, the objective.

    Each step solves the linear programme within a trust region (Fletcher and Sainz de la Maza 1989).
    """
    from scipy import optimize

    low, high = task.free.box
    scale = high - low

    def at(place: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        values, kept = (jnp.asarray(part, task.physics.dtype) for part in (place, margin))
        linearised = task.at(values, kept, objective, limits)
        (slope, slopes), (goal, slack) = jax.tree.map(lambda part: np.asarray(part, float), linearised)
        return float(goal), slope * scale, slack, slopes * scale

    def merit(goal: float, slack: np.ndarray) -> float:
        return goal + PENALTY * max(0.0, -float(slack.min()))

    place, reach = np.clip(start, low, high), LONGEST_STEP
    goal, slope, slack, slopes = at(place)
    for _ in range(MOST_STEPS):
        unit = max(abs(goal), 1e-12)
        programme = optimize.linprog(  # of steps as shares of the bounds' spans, and the miss of the worst requirement
            np.append(slope, PENALTY * unit) / unit,
            A_ub=np.column_stack([-slopes, -np.full(len(slack), unit)]) / unit,
            b_ub=slack / unit,
            bounds=[
                *zip(np.maximum(-reach, (low - place) / scale), np.minimum(reach, (high - place) / scale), strict=True),
                (0, None),
            ],
        )
        if programme.x is None:
            break
        promised = merit(goal, slack) - (goal + unit * float(programme.fun))
        if promised <= LEAST_GAIN * unit or reach < SHORTEST_STEP:
            break
        new = np.clip(place + programme.x[:-1] * scale, low, high)
        trial = at(new)
        gained = (merit(goal, slack) - merit(trial[0], trial[2])) / promised
        reach *= 2.0 if gained > 0.75 else 1.0 if gained > 0.25 else 0.3
        if gained > 0:
            place, (goal, slope, slack, slopes) = new, trial
    missed = max(0.0, -float(slack.min()))
    return place, (missed if missed > FEASIBLE * max(abs(goal), 1e-12) else 0.0, goal)


def _stacked(scene: Scene, error_sets: Sequence[Errors] | None) -> Any:
    """Sets of errors with a leading axis.

    Raises:
        SceneError: no set is given, or the sets list different errors.
    """
    sets = [dict(scene.physics().errors)] if error_sets is None else [dict(errors) for errors in error_sets]
    if not sets:
        raise SceneError("error_sets is empty: give at least one, or None for the scene's own errors")
    for index, errors in enumerate(sets):
        if jax.tree.structure(errors) != jax.tree.structure(sets[0]):
            raise SceneError(f"error_sets[{index}]: lists other errors than error_sets[0]")
        dataclasses.replace(scene, errors=errors)  # checks bodies
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, scene.dtype) for leaf in leaves]), *sets)
