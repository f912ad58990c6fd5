"""Recordings of a gear set at speed: the dynamic TE at the speed of each recording, as a function of the unknowns.

The integration begins before the first row, so that the transient of its start has decayed. Its steps are even, and
recordings of about the same length have the same number of steps. Between samples, the TE is the cubic through
positions and velocities. Derivatives are propagated forward with the integration, one tangent for each unknown.

The search starts at the solutions of a static fit. Contacts and their dampers act gradually over a width of overlap: if
a damper engages at once, its force jumps, and the derivatives of the steps miss that the time of the jump changes. The
search uses a large width first; the final width is far below what a recording resolves.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.choice import FORGOTTEN, MODELLED, STEP, known_limits
from gearjax.analysis.dynamics import simulate
from gearjax.analysis.fast.march import UNKNOWN
from gearjax.analysis.motion import Motion
from gearjax.analysis.solvers import LONGEST_STEP, FixedStep
from gearjax.checks import SceneError
from gearjax.contact import QuadraticContact
from gearjax.identification.measurement import Measurement
from gearjax.identification.model import MOVING, Model
from gearjax.identification.rows import Rows
from gearjax.identification.running import at_speed_of, speed_of, under_torque
from gearjax.identification.tables import AbstractCurves
from gearjax.identification.unknowns import Unknown, Unknowns, scene_with
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Int

PER_SAMPLE = 2  # steps between samples: the cubic follows the fastest motion within 0.1 % of its amplitude
MOST_STEPS = 1 << 21  # of a recording
FINER, FINE = 4, 1 << 15  # short recordings get up to so many times more steps, up to so many, for kinks of contacts
WIDE, NARROW = 1e-6, 5e-8  # overlaps over which contacts become active [m]
RUN_IN = 0.1  # of a recording: time integrated before it if nothing damps the transient of the start
FAR = 10.0  # times stiffer or softer than the scene: a static fit that ends beyond does not determine the stiffness


class Course(NamedTuple):
    """Times of the samples of a recording's motion; the time of a row is ``theta / speed``.

    Args:
        speed: input speed, negative if the input turns backward [rad/s].
        begin: time of the first sample [s].
        spacing: time between samples [s].
        samples: number of samples.
        torque: mean load torque of the recording [N m].
    """

    speed: float
    begin: float
    spacing: float
    samples: int
    torque: float

    @classmethod
    def of(cls, scene: Scene, record: Measurement) -> "Course":
        """The course whose steps resolve the fastest motion of a scene at the speed of a recording.

        Raises:
            SceneError: there would be too many steps.
        """
        speed, torque = speed_of(record), float(np.mean(record.loads))
        limits = known_limits(at_speed_of(under_torque(scene), abs(speed)).physics(*MODELLED))
        assert limits is not None
        ends = record.theta / speed
        duration = float(np.ptp(ends))
        bodies = UNKNOWN / (scene.system.fastest_order * abs(speed))  # with such steps, all speeds share a program
        step = min(STEP * LONGEST_STEP / float(limits.fastest), bodies)
        decay = float(limits.decay)
        run_in = FORGOTTEN / decay if decay > 0 else RUN_IN * duration
        steps = (duration + run_in) / step
        steps = max(steps, min(FINER * steps, FINE))
        if steps > MOST_STEPS:
            words = f" and {run_in:.3g} s before it, until its start is forgotten ([damping])" if decay > 0 else ""
            raise SceneError(
                f"{record.name}: its {duration:.3g} s{words} need {steps:.2g} steps of motion, more than "
                f'{MOST_STEPS:.2g}: give a part of it, or analysis = "static" for errors of slow bodies'
            )
        coarse = 1 << max(3, int(np.log2(steps / PER_SAMPLE)) - 2)  # few numbers of steps, so few programs
        samples = 1 + coarse * math.ceil(steps / PER_SAMPLE / coarse)
        begin = float(ends.min()) - run_in
        return cls(speed, begin, (duration + run_in) / (samples - 1), samples, torque)


def moving_error(scene: Scene, record: Measurement, theta: np.ndarray | None = None) -> tuple[np.ndarray, list[str]]:
    """Dynamic TE of a scene at the rows of a recording, shape (n,) [rad], and remarks for the reader.

    Args:
        scene: the scene.
        record: the recording.
        theta: other input angles than those of the recording, shape (n,) [rad].

    Raises:
        SceneError: no motion is found, for example if there is no equilibrium to start from.
    """
    scene = under_torque(scene)
    at = record if theta is None else dataclasses.replace(record, theta=theta, output=None, te=np.zeros(theta.shape))
    course = Course.of(scene, at)
    place, share = _places(course, at.theta)
    ts = course.begin + course.spacing * np.arange(course.samples)
    motion = simulate(at_speed_of(scene, course.speed), ts, course.torque, stepper=FixedStep(per_sample=PER_SAMPLE))
    numbers = (jnp.asarray(part) for part in (course.spacing, place, share))
    begun = int(np.searchsorted(ts, float((at.theta / course.speed).min())))
    apart = float(np.mean(~np.any(np.asarray(motion.forces)[begun:] > 0, axis=1)))
    words = f"{record.name}: its teeth lose contact in {100 * apart:.2g} % of the time: from another start the motion"
    return np.asarray(_between(motion, *numbers)), [f"{words} may differ"] if apart else []


def _places(course: Course, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each row, the sample before it, and the row's place between this sample and the next, from 0 to 1."""
    along = (theta / course.speed - course.begin) / course.spacing
    place = np.clip(along.astype(int), 0, course.samples - 2)
    return place, along - place


def _between(motion: Motion, spacing: Array, place: Array, share: Array) -> Array:
    """TE between samples, by the cubic through positions and velocities."""
    before, after = motion.te[place], motion.te[place + 1]
    leaves, arrives = spacing * motion.velocity[place], spacing * motion.velocity[place + 1]
    rise, left = after - before, 1 - share
    return before + share * rise + share * left * (left * (leaves - rise) - share * (arrives - rise))


class Group(eqx.Module):
    """Recordings whose motions have the same number of samples, padded to the same number of rows.

    ``where`` is the place of each row among all rows; padding has a place beyond their end, and is dropped.
    """

    speed: Float[Array, " record"]
    begin: Float[Array, " record"]
    spacing: Float[Array, " record"]
    torque: Float[Array, " record"]
    turn: Float[Array, "record unknown unknown"]
    place: Int[Array, "record row"]
    share: Float[Array, "record row"]
    where: Int[Array, "record row"]
    samples: int = eqx.field(static=True)


class Moving(AbstractCurves):
    """Rows of recordings in motion; recordings without torque are computed at rest.

    Args:
        scene: the scene with all parts that act in motion.
        still: the same rows at rest; ``None`` if all recordings are in motion.
        groups: the recordings in motion.
        each: the unknowns.
        rows: number of rows.
    """

    scene: Scene
    still: AbstractCurves | None
    groups: tuple[Group, ...]
    each: tuple[Unknown, ...] = eqx.field(static=True)
    rows: int = eqx.field(static=True)

    def positions(self, values: Float[Array, "s unknown"]) -> tuple[Float[Array, "s n"], Float[Array, "s n unknown"]]:
        """Positions of the output and their derivatives [rad]."""
        if self.still is None:
            q = jnp.zeros((values.shape[0], self.rows), values.dtype)
            rate = jnp.zeros((*q.shape, values.shape[1]), values.dtype)
        else:
            q, rate = self.still.positions(values)
        for group in self.groups:
            te, slope = jax.lax.map(lambda one, own=group: self._of_group(own, one), values)
            q = q.at[:, group.where].set(te, mode="drop")
            rate = rate.at[:, group.where].set(slope, mode="drop")
        return q, rate

    def _of_group(self, group: Group, values: Array) -> tuple[Array, Array]:
        """Positions and derivatives of all recordings of a group, shape (record, row) and (record, row, unknown)."""

        def one(own: Group) -> tuple[Array, Array]:
            def at(values: Array) -> Array:
                scene = at_speed_of(scene_with(self.each, own.turn @ values, self.scene), own.speed)
                ts = own.begin + own.spacing * jnp.arange(group.samples, dtype=own.begin.dtype)
                motion = simulate(scene, ts, own.torque, stepper=FixedStep(per_sample=PER_SAMPLE))
                te = _between(motion, own.spacing, own.place, own.share)
                return jnp.where(motion.result == 0, te, jnp.nan)

            along = jax.vmap(lambda way: jax.jvp(at, (values,), (way,)), out_axes=(None, 1))
            return along(jnp.eye(values.shape[0], dtype=values.dtype))

        return jax.lax.map(one, group)


@dataclasses.dataclass(frozen=True)
class MovingModel(Model):
    """A model of recordings in motion.

    Args:
        courses: the course of each recording, ``None`` for one without torque.
        moving: the scene with all parts that act in motion.
    """

    courses: tuple[Course | None, ...] = ()
    moving: Scene | None = None

    @classmethod
    def of_static(
        cls, model: Model, unknowns: Unknowns, records: Sequence[Measurement], solution: Scene, width: float = NARROW
    ) -> "MovingModel":
        """The model of recordings in motion, from their model at rest.

        Args:
            model: the model of the recordings at rest.
            unknowns: the unknowns, of the scene with all parts that act in motion.
            records: the recordings.
            solution: an approximate solution; the steps are chosen for it.
            width: overlap over which contacts and their dampers become active, if the springs are uncoupled [m].
        """
        courses = tuple(Course.of(solution, record) if record.is_loaded else None for record in records)
        scene = under_torque(unknowns.scene)
        if scene.springs_apart:
            scene = dataclasses.replace(scene, contact=QuadraticContact(width))
        scene = scene.physics(*MODELLED)
        parts = {field.name: getattr(model, field.name) for field in dataclasses.fields(model)}
        return cls(**parts | {"courses": courses, "moving": scene})

    def beside(self, records: Sequence[Measurement]) -> Model:
        """A model of other recordings, at rest."""
        parts = {field.name: getattr(self, field.name) for field in dataclasses.fields(Model)}
        return Model(**parts).beside(records)

    def at(self, rows: Rows) -> AbstractCurves:
        """The model at rows."""
        still = super().at(rows) if any(course is None for course in self.courses) else None
        assert self.moving is not None
        groups: dict[int, list[int]] = {}
        for i, course in enumerate(self.courses):
            if course is not None:
                groups.setdefault(course.samples, []).append(i)
        made = tuple(self._group(rows, samples, own) for samples, own in groups.items())
        return Moving(self.moving, still, made, self.unknowns.each, rows.theta.size)

    def _group(self, rows: Rows, samples: int, own: list[int]) -> Group:
        """The recordings ``own``, whose motions have the same number of samples."""
        courses = [course for i in own if (course := self.courses[i]) is not None]
        members = [np.flatnonzero(rows.record == i) for i in own]
        size = max(each.size for each in members)
        where = np.full((len(own), size), rows.theta.size)
        place, share = np.zeros((len(own), size), int), np.zeros((len(own), size))
        for i, (course, index) in enumerate(zip(courses, members, strict=True)):
            where[i, : index.size] = index
            place[i, : index.size], share[i, : index.size] = _places(course, rows.theta[index])
        speed, begin, spacing, torque = (
            jnp.asarray([getattr(each, key) for each in courses]) for key in ("speed", "begin", "spacing", "torque")
        )
        turns, places, shares = jnp.asarray(self.turns[own]), jnp.asarray(place), jnp.asarray(share)
        return Group(speed, begin, spacing, torque, turns, places, shares, jnp.asarray(where), samples)


def start_of_motion(unknowns: Unknowns, values: np.ndarray) -> np.ndarray:
    """Values from which motion can start: the scene's own in place of those that a static fit does not determine.

    The static TE does not depend on unknowns that only act in motion, and may hardly depend on a stiffness.
    """
    start = unknowns.start[None]
    far = unknowns.reciprocals[None] & ~((values * FAR > start) & (values < FAR * start))
    unseen = np.array([each.path.partition(".")[0] in MOVING for each in unknowns.each])[None]
    return np.where(far | unseen, start, values)
