"""Objectives of a study: metrics of analyses as one number of a scene, hard for results and smooth for descent.

In the smooth objective, a largest value over time becomes ``T log(sum(exp(values / T)))``, which is above the largest
sample by at most ``T log(n)``; the temperature T is in radians of transmission error. The contacts become
`QuadraticContact` of the width ``T r / 1.5`` with the mean lever r. The exact optimum lies on kinks; to find it, an
objective also offers its `pieces`: local extremes, the largest of which make up the objective.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis import FixedStep, Motion, backlash, simulate, transmission_error
from gearjax.analysis.choice import suitable_step
from gearjax.analysis.extremes import highest
from gearjax.analysis.metrics import top, warn_of_few_angles
from gearjax.analysis.quasi_static import Backlash, TransmissionError, each_is_dear
from gearjax.analysis.resting import carriers, rest
from gearjax.analysis.spectrum import order_amplitude, order_phasor
from gearjax.checks import ParameterError
from gearjax.compliance import couples
from gearjax.contact import Pose, QuadraticContact
from gearjax.run import NEEDS
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.studies.scatter import Scatter
from gearjax.studies.select import Free
from gearjax.studies.terms import ANGLE, SHARE, SHARES, SLOTS, Term
from gearjax.studies.turning_points import slope_and_value, tangent_bounds, turning_points
from gearjax.typing import Array, ArrayLike, Float, Scalar
from gearjax.units import Dimension

SAMPLES = 8001  # default number of samples of one cycle
EXTREMES = 32  # highest points, and as many lowest ones, in `pieces`; a polished curve has many equal extremes
PER_CYCLE = 8  # angles of a search per cycle of an order
SPLITS = 5  # of the intervals that contain the extremes
DIRECTIONS = 16  # on which the phasor of an order is projected
WIDTH = 1 / 1.5  # smoothing of the contacts per smoothing over time


class Pieces(NamedTuple):
    """Values whose maximum, times a weight, is a part of an objective; a smooth part has one value."""

    values: Float[Array, " m"]
    weight: Scalar


class Table(eqx.Module):
    """Poses of the samples and their derivatives by the input angle, the same for all assemblies."""

    pose: Pose
    rate: Pose


@eqx.filter_jit
def _tabulate(physics: Scene, theta: Float[Array, " n"]) -> Table:
    return Table(*jax.vmap(lambda angle: jax.jvp(physics.pose, (angle,), (jnp.ones_like(angle),)))(theta))


def _soft_largest(temperature: float | Scalar, values: Float[Array, " m"]) -> Scalar:
    return temperature * jax.nn.logsumexp(values / temperature)


class Objective(eqx.Module):
    """A weighted sum of metrics over a window of input angles, or a function of the scene.

    Args:
        name: name of the only term, of the function, or ``weighted_sum``.
        theta: input angles, shape (n,) [rad].
        terms: terms of the sum; empty with a function.
        function: ``function(scene) -> number``.
        stepper, start, settle: time steps, start and settling time of dynamic terms.
        table: poses of the samples, if they were computed before.
        scatter: gear sets over which the mean is taken; without it, the scene alone counts.
    """

    name: str = eqx.field(static=True)
    theta: Float[Array, " n"]
    terms: tuple[Term, ...] = ()
    function: Callable[[Scene], Scalar] | None = eqx.field(static=True, default=None)
    stepper: FixedStep | None = None
    start: str = eqx.field(static=True, default="equilibrium")
    settle: float = eqx.field(static=True, default=0.0)
    table: Table | None = None
    scatter: Scatter | None = None

    @classmethod
    def of(
        cls,
        loss: "str | Callable[[Scene], Scalar] | Term | Sequence[Term] | Objective",
        scene: Scene,
        theta: ArrayLike | None = None,
        torque: float | None = None,
        scatter: Scatter | None = None,
    ) -> "Objective":
        """An objective from a name, terms, or a function, over the given angles, the scene's run, or one cycle.

        With ``scatter`` it is the mean over gear sets as they are made, `gearjax.Tolerances.scatter`.

        Raises:
            ParameterError: a name is unknown, or something that it needs is missing.
            SceneError: the scene lacks a part that the objective needs.
        """
        if isinstance(loss, Objective):
            return loss if scatter is None else dataclasses.replace(loss, scatter=scatter)
        if theta is None and scene.run is not None:
            theta = scene.system.input_speed * jnp.asarray(scene.run.times)
        elif theta is None:
            theta = jnp.linspace(0.0, scene.system.cycle, SAMPLES)
        angles = jnp.asarray(theta, scene.dtype)
        if isinstance(loss, str):
            loss = Term(loss, torque)
        if isinstance(loss, Term):
            loss = (loss,)
        if callable(loss):
            return cls(getattr(loss, "__name__", "function"), angles, function=loss, scatter=scatter)
        terms = jax.tree.map(lambda leaf: leaf.astype(scene.dtype), tuple(loss))
        if not terms:
            raise ParameterError("objective", (), "needs at least one term")
        if any(term.metric in ("amplitude", "peak_to_peak") and term.analysis != "dynamic" for term in terms):
            warn_of_few_angles(angles, scene.system.fastest_order)
        for term in terms:
            require(scene, term.name, *NEEDS[term.analysis])
            if term.metric == "order":
                term.require_resolved(scene, angles)
        objective = cls(terms[0].name if len(terms) == 1 else "weighted_sum", angles, terms, scatter=scatter)
        if objective.is_dynamic:
            ts = np.asarray(angles) / float(scene.system.input_speed)
            steps = suitable_step(scene, float(ts[-1] - ts[0])).steps(jnp.asarray(ts))
            run = scene.run
            words = {} if run is None else {"start": run.start, "settle": run.settle}
            objective = dataclasses.replace(objective, stepper=FixedStep(per_sample=steps), **words)
        return objective

    def physics(self, scene: Scene, free: Free) -> Scene:
        """The parts of the scene that the objective depends on, and those with free numbers."""
        slots = {slot for term in self.terms for slot in SLOTS[term.analysis]}
        if self.function is not None:
            slots = set(SLOTS["dynamic"])
        return scene.physics(*slots, *(path.split(".")[0] for path in (*free.paths, *self._drawn)))

    def at(self, theta: Float[Array, " n"]) -> "Objective":
        """The same objective over other angles; with dynamic terms it keeps its own angles."""
        return self if self.is_dynamic else dataclasses.replace(self, theta=theta, table=None)

    def tabulated(self, scene: Scene, free: Free) -> "Objective":
        """The same objective with a table of its samples, if no number of the system is free."""
        if self.function is not None or any(path.startswith("system.") for path in (*free.paths, *self._drawn)):
            return self
        return dataclasses.replace(self, table=_tabulate(self.physics(scene, free), self.theta))

    def coarse(self, scene: Scene, per_turn: int) -> "Objective":
        """The same objective over a part of its angles: ``per_turn`` of them per turn of the fastest error.

        An order has at least `PER_CYCLE` of them per cycle, evenly: fewer would show another order in its place.
        """
        if self.function is not None or self.theta.shape[0] < 2:
            return self
        fastest = max((order for name, order in scene.system.orders.items() if name != "mesh"), default=1.0)
        asked = max((term.per_turn(scene) for term in self.terms if term.metric == "order"), default=0.0)
        last, turns = self.theta.shape[0] - 1, float(self.theta[-1] - self.theta[0]) / (2 * np.pi)
        number = max(4 * per_turn, round(turns * max(fastest * per_turn, asked * PER_CYCLE)))
        if asked:
            strides = range(max(1, last // number), 0, -1)
            return self.at(self.theta[:: next(stride for stride in strides if last % stride == 0)])
        chosen = np.unique(np.linspace(0, last, min(last + 1, number)).round().astype(int))
        return self.at(self.theta[chosen])

    def result(self, scene: Scene, term: Term) -> TransmissionError | Backlash | Motion:
        """The result of the analysis that a term evaluates."""
        if term.analysis == "backlash":
            return backlash(scene, self.theta)
        if term.analysis != "dynamic":
            return transmission_error(scene, self.theta, term.torque)
        assert self.stepper is not None
        assert term.torque is not None
        ts = self.theta / jax.lax.stop_gradient(scene.system.input_speed)
        return simulate(scene, ts, term.torque, start=self.start, settle=self.settle, stepper=self.stepper)

    def _shares(self, scene: Scene, term: Term) -> Float[Array, " m"]:
        """Load of each pair at each angle over the mean load of pairs that could carry, shape (n * pair,) [-]."""
        assert term.torque is not None
        torque = term.torque

        def at(angle: Scalar | Pose) -> Float[Array, " pair"]:
            carried = scene.layout.per_pair(rest(scene, angle, torque).forces)
            return carried * (carriers(scene, angle, torque).astype(carried.dtype) / carried.sum())

        return jax.vmap(at)(self.theta if self.table is None else self.table.pose).ravel()

    @property
    def _drawn(self) -> tuple[str, ...]:
        """Paths of the numbers that differ from one drawn gear set to another."""
        return () if self.scatter is None else self.scatter.free.paths

    def _mean(self, of: "Callable[[Objective, Scene], Scalar]", scene: Scene) -> Scalar:
        """A number of the scene, or its mean over the drawn gear sets."""
        if self.scatter is None:
            return of(self, scene)
        alone = dataclasses.replace(self, scatter=None)
        return self.scatter.mean(lambda scene: of(alone, scene), scene)

    def hard(self, scene: Scene) -> Scalar:
        """The objective by the scene's own contact law, with extremes where the analyses search them by default."""
        if self.scatter is not None:
            return self._mean(Objective.hard, scene)
        if self.function is not None:
            return self._own(scene)
        return self._sum(lambda term: self._metric(scene, term))

    def _own(self, scene: Scene) -> Scalar:
        """The user's own function of the scene."""
        assert self.function is not None
        return arguments.a_result("loss", self.function(scene))

    def _sum(self, metric: Callable[[Term], Scalar]) -> Scalar:
        """The weighted sum of a metric of all terms."""
        return jnp.concatenate([term.weight * values for term, values in self._each(metric)]).sum()

    def _each(self, measure: Callable[[Term], Any]) -> list[tuple[Term, Any]]:
        """Terms with their measures; terms that differ only in torque are one batch, so that they compile once."""
        batches: dict[tuple, list[Term]] = {}
        for term in self.terms:
            batches.setdefault((term.name, term.order), []).append(term)
        measured = []
        for terms in batches.values():
            batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *terms)
            if len(terms) == 1:
                measured.append((batch, jax.tree.map(lambda part: part[None], measure(terms[0]))))
                continue
            measured.append((batch, jax.vmap(measure)(batch)))
        return measured

    def _metric(self, scene: Scene, term: Term) -> Scalar:
        """The metric of a term by the contact law of the scene, without its weight."""
        if term.name in SHARES:
            return top(self._shares(scene.anchored(), term))
        result = self.result(scene, term)
        if term.metric != "order":
            return getattr(result, term.metric)
        record = result.backlash if isinstance(result, Backlash) else result.te
        settled = self.settle if term.analysis == "dynamic" else 0.0
        first = self.theta[0] + settled * jax.lax.stop_gradient(scene.system.input_speed)
        return order_amplitude(record, self.theta, term.per_turn(scene), first=first)

    def smooth(self, scene: Scene, temperature: float | Scalar) -> Scalar:
        """The objective with smooth contacts, and smooth largest values over the samples.

        Args:
            scene: the scene.
            temperature: smoothing of the largest values, in the unit of the objective: rad, or a share of load for load
                sharing. A share of load gives no width of contacts, which then stay hard.
        """
        if self.scatter is not None:
            return self._mean(lambda alone, scene: alone.smooth(scene, temperature), scene)
        smoothed = functools.partial(_soft_largest, temperature)
        hard_alone = couples(scene.compliance)
        if hard_alone or any(term.name in SHARES for term in self.terms):
            return self._of_samples(scene, smoothed)
        lever = jnp.abs(scene.contacts(self.theta[0]).output_levers).mean()
        width = jnp.maximum(WIDTH * temperature * jax.lax.stop_gradient(lever), 1e-15)
        soft = dataclasses.replace(scene, contact=QuadraticContact(width))
        return self._of_samples(soft, smoothed)

    def sampled(self, scene: Scene) -> Scalar:
        """The objective of the samples, without the extremes between them, which takes less time."""
        return self._mean(lambda alone, scene: alone._of_samples(scene, jnp.max), scene)  # never differentiated

    def _of_samples(self, scene: Scene, largest: Callable[[Float[Array, " n"]], Scalar]) -> Scalar:
        if self.function is not None:
            return self._own(scene)
        anchored = scene.anchored()

        def metric(term: Term) -> Scalar:
            if term.name in SHARES:
                return largest(self._shares(anchored, term))
            if term.metric not in ("amplitude", "peak_to_peak"):
                return self._metric(scene, term)
            if term.analysis == "dynamic":
                motion = self.result(scene, term)
                assert isinstance(motion, Motion)
                high, low = motion.bands
            else:
                curve, physics = term.curve(anchored)
                points = self.theta if self.table is None else self.table.pose
                high = low = jax.vmap(curve, in_axes=(None, 0))(physics, points)
            if term.metric == "amplitude":
                return largest(jnp.concatenate([high, -low]))
            return largest(high) + largest(-low)

        return self._sum(metric)

    def refined(self, scene: Scene) -> Scalar:
        """The objective from its `pieces`: close to `hard`, and faster if the samples have a table."""

        def alone(objective: Objective, scene: Scene) -> Scalar:
            return jnp.stack([piece.weight * piece.values.max() for piece in objective.pieces(scene)]).sum()

        return self._mean(alone, scene)

    def pieces(self, scene: Scene) -> list[Pieces]:
        """The parts of the objective by the scene's own contact law: it is the sum of their weighted largest values.

        The values are local extremes of curves. The input angle of each extreme is held fixed in derivatives, so that
        each value has a derivative of its own. The mean over drawn gear sets has no kinks to speak of: it is one part.
        """
        if self.scatter is not None:
            return [Pieces(jnp.atleast_1d(self.refined(scene)), jnp.ones((), self.theta.dtype))]
        if self.function is not None:
            return [Pieces(jnp.atleast_1d(self._own(scene)), jnp.ones((), self.theta.dtype))]
        anchored = scene.anchored()

        def measure(term: Term) -> tuple[Float[Array, " m"], ...]:
            if term.name in SHARES:
                shares = self._shares(anchored, term)
                highest = jax.lax.top_k(jax.lax.stop_gradient(shares), min(EXTREMES, shares.shape[0]))[1]
                return (shares[highest],)
            if term.metric == "order" and term.analysis != "dynamic":
                return (self._directions(term, anchored),)
            if term.analysis == "dynamic" or term.metric not in ("amplitude", "peak_to_peak"):
                return (jnp.atleast_1d(self._metric(scene, term)),)
            high, low = self._extremes(term, anchored)
            return (jnp.concatenate([high, low]),) if term.metric == "amplitude" else (high, low)

        return [
            Pieces(values[index], batch.weight[index])
            for batch, sides in self._each(measure)
            for index in range(batch.weight.shape[0])
            for values in sides
        ]

    @property
    def dimension(self) -> Dimension:
        """Dimension of the objective, with the unit in which it is shown; none for load sharing alone."""
        return SHARE if self.terms and all(term.dimension is SHARE for term in self.terms) else ANGLE

    @property
    def is_dynamic(self) -> bool:
        """Whether one of the terms is dynamic."""
        return any(term.analysis == "dynamic" for term in self.terms)

    @property
    def is_bounded(self) -> bool:
        """Whether a part of the samples bounds the objective from below, as it is made of largest values over time."""
        bounded = ("amplitude", "peak_to_peak")
        return bool(self.terms) and all(t.metric in bounded and t.analysis != "dynamic" for t in self.terms)

    def between_alone(self, scene: Scene) -> bool:
        """Whether `pieces` have extremes between samples, and `hard`, as the analyses by default, has not."""
        sought = (t.analysis == "static" and t.metric in ("amplitude", "peak_to_peak") for t in self.terms)
        return each_is_dear(scene) and any(sought)

    @property
    def is_bent(self) -> bool:
        """Whether a part of the objective is smooth: its curvature then has to be added to its linearised pieces."""
        return self.scatter is None and any(t.metric == "std" and t.analysis != "dynamic" for t in self.terms)

    def smooth_part(self, scene: Scene) -> Scalar:
        """The weighted sum of the smooth terms."""
        smooth = tuple(term for term in self.terms if term.metric == "std" and term.analysis != "dynamic")
        return dataclasses.replace(self, terms=smooth)._sum(lambda term: self._metric(scene, term))

    def _directions(self, term: Term, scene: Scene) -> Float[Array, " m"]:
        """Projections of the phasor of an order on directions, its own first: the largest is the amplitude."""
        curve, physics = term.curve(scene)
        points = self.theta if self.table is None else self.table.pose
        record = jax.vmap(curve, in_axes=(None, 0))(physics, points)
        parts = order_phasor(record, self.theta, term.per_turn(scene))
        own = jax.lax.stop_gradient(jnp.arctan2(parts[1], parts[0]))
        angles = own + jnp.arange(DIRECTIONS).astype(own.dtype) * (2 * np.pi / DIRECTIONS)
        return jnp.cos(angles) * parts[0] + jnp.sin(angles) * parts[1]

    def _extremes(self, term: Term, scene: Scene) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """The highest points of a curve and of its negative: turning points, the highest sample, ends of the window."""
        curve, physics = term.curve(scene)
        frozen, theta = jax.lax.stop_gradient((physics, self.theta))
        at = slope_and_value(curve, frozen)
        if self.table is None:
            slopes, samples = jax.vmap(at)(theta)
        else:
            table = jax.lax.stop_gradient(self.table)
            along = jax.vmap(lambda pose, rate: jax.jvp(lambda pose: curve(frozen, pose), (pose,), (rate,)))
            samples, slopes = along(table.pose, table.rate)
        each = jax.vmap(curve, in_axes=(None, 0))
        if theta.shape[0] < 3:
            edges = each(physics, theta[jnp.array([0, -1])])
            return edges, -edges
        signs = jnp.array([1.0, -1.0], theta.dtype)
        intervals = jnp.stack([highest(side, EXTREMES) for side in tangent_bounds(theta, samples, slopes)])
        turns = jnp.broadcast_to(signs[:, None], intervals.shape)
        points = jax.lax.stop_gradient(turning_points(at, turns, (theta, slopes, samples), intervals, splits=SPLITS))
        # with few samples, the slopes may show no turning point, or miss the highest one
        besides = jnp.stack([theta[0], theta[-1], theta[jnp.argmax(samples)], theta[jnp.argmin(samples)]])
        found = each(physics, jnp.concatenate([besides, points.ends.reshape(-1)]))
        edges, above, below, sides = found[:2], found[2:3], found[3:4], found[4:].reshape(points.ends.shape)
        # an interval without turning point repeats an end of the window
        values = jnp.where(points.heights > -jnp.inf, points.values(sides), (signs * edges[0])[:, None])
        high = jnp.concatenate([values[0], edges, above])
        low = jnp.concatenate([values[1], -edges, -below])
        return high, low
