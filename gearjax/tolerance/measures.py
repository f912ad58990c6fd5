"""Measures of each gear set: metrics of analyses as numbers, with a result code that says what failed."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import Backlash, FixedStep, backlash, simulate, transmission_error
from gearjax.analysis.choice import suitable_step
from gearjax.analysis.dynamics import FAULTS
from gearjax.analysis.metrics import top
from gearjax.analysis.quasi_static import each_is_dear
from gearjax.checks import ParameterError, nearest
from gearjax.contact import HardContact
from gearjax.run import METRICS, NEEDS
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.studies.terms import SLOTS
from gearjax.tolerance.balances import Balances
from gearjax.tolerance.closer import closer, places_between
from gearjax.tolerance.curves import Curves
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.population import Tolerances
from gearjax.tolerance.pressed import Pressed
from gearjax.tolerance.quick import Part, QuickMeasures, parts, recorded
from gearjax.tolerance.record import Record, coded, lost, of_curve
from gearjax.typing import Array, ArrayLike, Float, Int, Scalar

EXTREMES = ("samples", "between")
CODES = {
    0: "good",
    1: "a number lies outside of what it may be",
    2: "a measure is not finite",
    3: "no flank can carry the torque",
    4: "its curve is not like those of the others: report it, and use other contacts or extremes",
    **{10 + code: f"dynamic: {words}" for code, words in FAULTS.items()},
}
"""Meaning of each result code."""
SAMPLES = 1581  # default number of input angles of one cycle
TOGETHER = {
    "quick": 32,
    "balances": 32,
    "pressed": 128,
    "other": 64,
    "dynamic": 64,
    "searched": 1,  # side by side, all gear sets wait for the one whose search takes longest, at each place
}  # gear sets side by side on one device


class Measures:
    """Several measures of a scene over the same input angles.

    Quasi-static records with hard contacts are computed by fast methods (`gearjax.tolerance.curves` and others), all
    other records by the analyses.

    Args:
        measures: the measures.
        tolerances: the population; numbers that do not vary are constants of the program.
        theta: input angles, shape (n,) [rad]; by default those of the scene's run section, or one cycle.
        extremes: ``"samples"`` for the extremes of the samples, ``"between"`` for those between samples too, ``None``
            for the default (`default_extremes`).

    Raises:
        ParameterError: two measures are the same.
        SceneError: the scene lacks a part that a measure needs.
    """

    def __init__(
        self,
        measures: Sequence[Measure],
        tolerances: Tolerances,
        theta: ArrayLike | None,
        extremes: str | None,
    ):
        scene = self.scene = tolerances.scene
        self.tolerances = tolerances
        self.places = 1  # steps of the curves from one sample to the next
        self.measures = tuple(measures)
        self.extremes = extremes_of(self.measures, scene, extremes)
        self.theta = angles(scene, theta)
        self._angles = str(self.theta.dtype), np.asarray(self.theta).tobytes()
        self.free = tolerances.free
        self.physics = self._physics(*_slots(self.measures))
        analyses = {measure.analysis for measure in self.measures}
        self.still = self.physics  # what curves without motion are computed from
        self.curves: Curves | Balances | None = None
        if isinstance(scene.contact, HardContact) and analyses - {"dynamic"}:
            self.curves = self._balances(analyses) if scene.layout.sides_turn else self._touches(analyses)
        errors_alone = all(path.split(".")[0] in ("errors", "backlash") for path in self.free.paths)
        known = "static" in analyses and self.extremes == "samples"  # springs are known at the samples alone
        self.pressed = Pressed.of(self.physics, self.theta, errors_alone) if known else None
        self.motion = _Motion.of(scene, self.theta) if "dynamic" in analyses else None

    def _physics(self, *slots: str) -> Scene:
        """The scene reduced to some of its parts, and to those whose numbers vary."""
        return self.scene.physics(*slots, *(path.split(".")[0] for path in self.free.paths))

    def _population(self, physics: Scene) -> Scene:
        """Example gear sets, every number with a leading axis."""
        examples = jnp.asarray(self.tolerances.examples, physics.dtype)
        return jax.vmap(lambda row: self.free.set(physics, row))(examples)

    def _touches(self, analyses: set[str]) -> Curves | None:
        """Curves of contacts that keep their sides, by the fast method; ``None`` if it does not apply.

        All studies of the population over the same input angles share them.
        """
        loaded = self._physics("backlash", "compliance")
        physics = loaded if loaded.springs_apart else self._physics("backlash")
        if self.physics.is_train or self.physics.system.exact or ("static" in analyses and physics is not loaded):
            return None

        def made() -> tuple[Scene, Curves]:
            stiffness = "mean" if physics is loaded else "rigid"
            curves = Curves.of(self._population(physics), self.theta, stiffness, not self._system_varies)
            return physics, curves

        physics, curves = self.tolerances.once(("curves", self._angles), made)
        if self.extremes == "between" and curves.series is None:
            return None
        self.still = physics
        return curves if self.extremes == "between" else dataclasses.replace(curves, series=None)

    def _balances(self, analyses: set[str]) -> Balances | None:
        """Curves of contacts that change sides, by the fast method; ``None`` if it does not apply."""
        population = self._population(self.physics)
        linear = "static" not in analyses or population.springs_apart
        if self._system_varies or not linear or population.system.exact:
            return None
        varied = [path.split(".")[1] for path in self.free.paths if path.startswith("errors.")]
        if self.extremes == "samples":
            return Balances.of(population, self.theta, varied)
        places = places_between(self.scene, self.theta)
        balances = None if places is None else Balances.of(population, closer(self.theta, places), varied)
        if balances is None or places is None or not balances.is_followed:
            return None
        self.places = places
        return balances

    @property
    def _system_varies(self) -> bool:
        return any(path.startswith("system.") for path in self.free.paths)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the measures."""
        return tuple(measure.name for measure in self.measures)

    @property
    def together(self) -> int:
        """Number of gear sets that are computed side by side."""
        if any(measure.analysis == "dynamic" for measure in self.measures):
            return TOGETHER["dynamic"]
        if isinstance(self.curves, Balances):
            return TOGETHER["balances"]
        if self.pressed is not None:
            return TOGETHER["pressed"]
        if self.extremes == "between" and default_extremes(self.measures, self.scene) == "samples":
            return TOGETHER["searched"]
        return TOGETHER["other" if self.curves is None else "quick"]

    @property
    def parts(self) -> list[Part]:
        """The measures in parts, each of which a program of its own computes."""
        curves = self.curves
        if not isinstance(curves, Curves) or self.motion is not None or self.pressed is not None:
            return [Part(self, None, (tuple(range(len(self.measures))),))]

        def one(metrics: tuple) -> QuickMeasures:
            key = "part", metrics, self.extremes, self._angles
            return self.tolerances.once(key, lambda: QuickMeasures(self.free, self.still, curves, metrics))

        return parts(self.measures, one, unloaded=self.extremes == "samples")

    def __call__(self, values: Float[Array, " free"]) -> tuple[Float[Array, " measure"], Int[Array, ""]]:
        """Measures of a gear set with the given numbers, nan if it failed, and its result code."""
        if isinstance(self.curves, Balances) and self.extremes == "between":
            measured, codes = self.rows(values[None])
            return measured[0], codes[0]
        scene = self.free.set(self.physics, values)
        curves = self.curves
        touches = curves.touches(self.free.set(self.still, values)) if isinstance(curves, Curves) else None

        def record(analysis: str, torque: float | None) -> Record:
            if isinstance(curves, Balances):
                return self._of_samples(curves.curve(scene, analysis, torque))
            if self.pressed is not None and torque is not None:
                return self._of_samples(self.pressed.curve(scene, torque))
            if touches is None:
                return _analysed(scene, self.theta, self.extremes, analysis, torque)
            metrics = [m.metric for m in self.measures if (m.analysis, m.torque) == (analysis, torque)]
            load = None if torque is None else jnp.asarray(torque, self.theta.dtype)
            return recorded(touches, analysis, load, metrics)

        return _told(self.measures, self.motion, scene, record)

    def curve_rows(self, values: Float[Array, "row free"], measure: Measure) -> Float[Array, "row n"]:
        """Quasi-static curves of a measure at the samples [rad], for gear sets with the given numbers."""
        key, curves = (measure.analysis, measure.torque), self.curves
        scenes = jax.vmap(lambda row: self.free.set(self.still, row))(values)
        if isinstance(curves, Balances):
            return curves.curves(scenes, [key])[0].T
        assert curves is not None
        return jax.vmap(lambda scene: curves.curve(scene, *key))(scenes)

    def rows(self, values: Float[Array, "row free"]) -> tuple[Float[Array, "row measure"], Int[Array, " row"]]:
        """Measures and result codes of several gear sets, computed with arrays laid out for speed."""
        if not isinstance(self.curves, Balances):
            return jax.vmap(self)(values)
        scenes = jax.vmap(lambda row: self.free.set(self.physics, row))(values)
        keys = list(dict.fromkeys((m.analysis, m.torque) for m in self.measures if m.analysis != "dynamic"))
        curves = self.curves.curves(scenes, keys)

        ends: list[tuple[Array, Array] | None] = [None] * len(keys)
        if self.extremes == "between":
            sought = {(m.analysis, m.torque) for m in self.measures if m.metric not in ("mean", "std")}
            ends = [
                self.curves.tops(scenes, key, curve) if key in sought else None
                for key, curve in zip(keys, curves, strict=True)
            ]

        def one(scene: Scene, curves: list[Array], ends: list) -> tuple[Array, Array]:
            known = dict(zip(keys, zip(curves, ends, strict=True), strict=True))
            return _told(self.measures, self.motion, scene, lambda *key: self._of_samples(*known[key]))

        return jax.vmap(one, in_axes=(0, -1, 0))(scenes, curves, ends)

    def _of_samples(self, values: Float[Array, " m"], ends: tuple[Scalar, Scalar] | None = None) -> Record:
        """Metrics of a curve from its samples; its extremes are ``ends`` if they are known."""
        samples = values[:: self.places]
        high, low = (
            (lambda: top(samples), lambda: -top(-samples)) if ends is None else (lambda: ends[0], lambda: ends[1])
        )
        return Record(of_curve(samples, high, low), jnp.where(jnp.isnan(values).any(), 3, 0))


class SceneMeasures:
    """Several measures of scenes that are drawn as a whole, over the same input angles, computed by the analyses.

    Args:
        measures: the measures.
        example: one of the scenes.
        theta, extremes: as for `Measures`.

    Raises:
        ParameterError: two measures are the same.
        SceneError: the example lacks a part that a measure needs.
    """

    def __init__(self, measures: Sequence[Measure], example: Scene, theta: ArrayLike | None, extremes: str | None):
        self.measures = tuple(measures)
        self.extremes = extremes_of(self.measures, example, extremes)
        self.theta = angles(example, theta)
        dynamic = any(measure.analysis == "dynamic" for measure in self.measures)
        self.motion = _Motion.of(example, self.theta) if dynamic else None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the measures."""
        return tuple(measure.name for measure in self.measures)

    def __call__(self, scene: Scene) -> tuple[Float[Array, " measure"], Int[Array, ""]]:
        """Measures of a scene, nan if it failed, and its result code."""
        physics = scene.physics(*_slots(self.measures))

        def record(analysis: str, torque: float | None) -> Record:
            return _analysed(physics, self.theta, self.extremes, analysis, torque)

        return _told(self.measures, self.motion, physics, record)


def default_extremes(measures: Sequence[Measure], scene: Scene) -> str:
    """Where extremes are searched by default: between samples too, unless each equilibrium takes long.

    Such are those of slices and of coupled contacts; `transmission_error` has the same default.
    """
    dear = each_is_dear(scene) and any(measure.analysis == "static" for measure in measures)
    return "samples" if dear else "between"


def extremes_of(measures: Sequence[Measure], scene: Scene, extremes: str | None = None) -> str:
    """Where extremes are searched, after a look at the measures.

    Raises:
        GearjaxError: a measure is listed twice, or needs what the scene does not have; ``extremes`` is no known word.
    """
    for index, measure in enumerate(measures):
        require(scene, measure.name, *NEEDS[measure.analysis])
        if measure.name in [other.name for other in measures[:index]]:
            raise ParameterError("measures", measure.name, "is listed twice")
    if extremes is not None and extremes not in EXTREMES:
        raise ParameterError("extremes", extremes, nearest(extremes, EXTREMES))
    return extremes or default_extremes(measures, scene)


def _slots(measures: Sequence[Measure]) -> set[str]:
    """Parts of a scene that measures depend on."""
    return {slot for measure in measures for slot in SLOTS[measure.analysis]}


def _told(
    measures: Sequence[Measure], motion: "_Motion | None", scene: Scene, record: Callable[..., Record]
) -> tuple[Array, Array]:
    """Measures and result code from the records of quasi-static analyses and of the dynamic analysis."""
    records: dict[tuple, Record] = {}
    for measure in measures:
        key = measure.analysis, measure.torque
        if key not in records:
            moving = motion if measure.analysis == "dynamic" else None
            records[key] = record(*key) if moving is None else moving.record(scene, measure.torque)
    own = [records[measure.analysis, measure.torque] for measure in measures]
    measured = [record.metrics[m.metric]() for record, m in zip(own, measures, strict=True)]
    return coded(measured, [record.code for record in own])


def angles(scene: Scene, theta: ArrayLike | None) -> Float[Array, " n"]:
    """Input angles of the records: the given ones, those of the run section, or one cycle, shape (n,) [rad]."""
    if theta is not None:
        return jnp.asarray(theta, scene.dtype)
    if scene.run is not None:
        return jnp.asarray(float(scene.system.input_speed) * scene.run.times, scene.dtype)
    return jnp.asarray(np.linspace(0.0, scene.system.cycle, SAMPLES), scene.dtype)


def _analysed(scene: Scene, theta: Float[Array, " n"], extremes: str, analysis: str, torque: float | None) -> Record:
    """Metrics of a quasi-static analysis."""
    if analysis == "backlash":
        result = backlash(scene, theta)
    else:
        result = transmission_error(scene, theta, torque, extremes=extremes)
    values = result.backlash if isinstance(result, Backlash) else result.te
    if extremes == "samples":
        metrics = of_curve(values, lambda: top(values), lambda: -top(-values))
    else:
        metrics = of_curve(values, lambda: result.extremes.maximum, lambda: result.extremes.minimum)
    return Record(metrics, jnp.where(lost(values, analysis), 3, 0))


def _metrics(motion: Any) -> dict[str, Callable[[], Scalar]]:
    return {name: functools.partial(getattr, motion, name) for name in METRICS}


class _Motion(NamedTuple):
    """Settings of the simulation of the dynamic TE, the same for all gear sets."""

    ts: np.ndarray
    stepper: FixedStep
    start: str
    settle: float

    @classmethod
    def of(cls, scene: Scene, theta: Float[Array, " n"]) -> "_Motion":
        ts = np.asarray(theta, dtype=float) / float(scene.system.input_speed)
        steps = suitable_step(scene, float(ts[-1] - ts[0])).steps(jnp.asarray(ts))
        run = scene.run
        start, settle = ("equilibrium", 0.0) if run is None else (run.start, run.settle)
        return cls(ts, FixedStep(per_sample=steps), start, settle)

    def record(self, scene: Scene, torque: float | None) -> Record:
        assert torque is not None  # the measure requires it
        motion = simulate(scene, self.ts, torque, start=self.start, settle=self.settle, stepper=self.stepper)
        edges = {"minimum": lambda: -top(-motion.bands[1]), "maximum": lambda: top(motion.bands[0])}
        return Record({**_metrics(motion), **edges}, jnp.where(motion.result > 0, 10 + motion.result, 0))
