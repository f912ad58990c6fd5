"""A scene: one gear set and the effects that are modelled, nothing else."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError, SceneError, check_name, nearest
from gearjax.clearance import Anchor, InitialBacklash, ZeroAtStart
from gearjax.compliance import AbstractCompliance, AbstractLineContact
from gearjax.contact import AbstractContact, ContactFrame, ContactSet, Flank, HardContact, LineSprings
from gearjax.contact.frame import Pose, Side, join
from gearjax.errors import AbstractError
from gearjax.inertia import DampingRatio, EquivalentMass, MomentOfInertia
from gearjax.load import AbstractLoad
from gearjax.parameters import Named, is_numeric, strong
from gearjax.systems import AbstractSystem, LineContacts
from gearjax.typing import Array, Float, Scalar

_OPTIONAL = ("backlash", "compliance", "load", "inertia", "damping")
NEEDS = {
    "no_load": (),
    "backlash": ("backlash",),
    "static": ("compliance",),
    "dynamic": ("compliance", "load", "inertia"),
}
ANALYSES = tuple(NEEDS)
"""Analyses of a scene, and the optional slots that each needs."""
METRICS = ("peak_to_peak", "amplitude", "mean", "std")
"""What is told of every record."""
Stiffness = Literal["rigid", "mean", "varying"]


@dataclasses.dataclass(frozen=True)
class Published:
    """Published or measured values to show next to computed ones.

    Args:
        analysis, torque: the case they belong to; torque in N m, 0 without load.
        metrics: pairs of a metric's name and its value [rad].
        note: what a reader of the comparison should know.
    """

    analysis: str
    torque: float
    metrics: tuple[tuple[str, float], ...]
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Run:
    """What a configuration asks to be computed. Times in seconds, torques in N m.

    Args:
        duration: length of the record [s].
        samples: number of samples of the record, both ends included.
        analyses: of ``no_load``, ``backlash``, ``static``, ``dynamic``.
        torques: sizes of the load torque [N m].
        start: of the dynamic TE, ``"equilibrium"`` or ``"zero"``.
        settle: time that the metrics of the dynamic TE leave out [s].
        published: values to show next to the computed ones.

    Raises:
        ParameterError: a value that cannot be.
    """

    duration: float
    samples: int
    analyses: tuple[str, ...]
    torques: tuple[float, ...] = ()
    start: str = "equilibrium"
    settle: float = 0.0
    published: tuple[Published, ...] = ()

    def __post_init__(self):
        for key, given, least in (("duration", self.duration, 1e-9), ("settle", self.settle, 0.0)):
            if not is_numeric(given) or not least <= float(given) < np.inf:
                raise ParameterError(f"run.{key}", given, f"must be finite and at least {least:g} s")
        if self.settle >= self.duration:
            raise ParameterError("run.settle", self.settle, "must be below run.duration")
        if isinstance(self.samples, bool) or not isinstance(self.samples, int | np.integer) or self.samples < 2:
            raise ParameterError("run.samples", self.samples, "must be a whole number, at least 2")
        for analysis in self.analyses:
            if analysis not in ANALYSES:
                raise ParameterError("run.analyses", analysis, nearest(analysis, ANALYSES))
        if not is_numeric(self.torques) or not np.isfinite(self.torques).all():
            raise ParameterError("run.torques", self.torques, "must be finite numbers [N m]")

    @property
    def times(self) -> np.ndarray:
        """Sample times, shape (samples,) [s]."""
        return np.linspace(0.0, self.duration, self.samples)


class Scene(eqx.Module):
    """A gear set with the effects that are modelled. An absent effect is ``None``, or not in the dict.

    Args:
        system: the gear set.
        errors: errors of its bodies, summed into the gaps; the key is the name in a configuration.
        reference: `ZeroAtStart`, or ``None`` to count errors absolutely.
        backlash: initial backlash; without it there are no back flanks.
        compliance: stiffness of the teeth; ``None`` is rigid.
        load: how the load torque runs in time.
        contact: contact law.
        inertia, damping: for the dynamic transmission error.
        run: what the configuration asked for; not part of the physics.

    Raises:
        ParameterError: an error has a name that no path leads to, is placed on a body that the system does not have,
            or does not suit it, or the load names a frequency that the system does not have.
        SceneError: parts that do not go together.
    """

    system: AbstractSystem
    errors: Mapping[str, AbstractError] = eqx.field(default_factory=dict)
    reference: ZeroAtStart | Anchor | None = None
    backlash: InitialBacklash | None = None
    compliance: AbstractCompliance | AbstractLineContact | None = None
    load: AbstractLoad | None = None
    contact: AbstractContact = HardContact()
    inertia: EquivalentMass | MomentOfInertia | None = None
    damping: DampingRatio | None = None
    run: Run | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if not isinstance(self.system, AbstractSystem):
            is_path = isinstance(self.system, str | Path)
            words = "is a path: give gj.load(path)" if is_path else "must be a gear set, such as gj.TwoKV(...)"
            raise ParameterError("system", str(self.system) if is_path else self.system, words)
        for key, error in self.errors.items():
            check_name("errors", key)
            if error.body not in self.system.bodies:
                raise ParameterError(f"errors.{key}.body", error.body, nearest(error.body, self.system.bodies))
            if error.on_rim:
                _check_rim(self.system, key, error)
        frequency = getattr(self.load, "frequency", None)
        if isinstance(frequency, Named) and frequency.name not in self.system.orders:
            raise ParameterError("load.frequency", frequency.name, nearest(frequency.name, self.system.orders))
        if self.system.two_sided:
            for slot in ("backlash", "reference"):
                if getattr(self, slot) is not None:
                    raise SceneError(
                        f"[{slot}] is not for a {self.system.kind}, whose contacts touch both flanks and count from "
                        "the ideal profile: its clearances come from its modification and errors"
                    )
        if isinstance(self.compliance, AbstractLineContact) and not isinstance(self.system, LineContacts):
            raise SceneError(
                f'[compliance] kind = "{self.compliance.kind}" needs the radii of curvature of the flanks, which a '
                f'{self.system.kind} does not offer: use "harmonic_stiffness"'
            )

    @property
    def has_back(self) -> bool:
        """Whether back flanks are modelled."""
        return self.system.two_sided or self.backlash is not None

    @property
    def linear_compliance(self) -> AbstractCompliance:
        """Its compliance as linear springs, which the dynamics need (`require`)."""
        assert isinstance(self.compliance, AbstractCompliance)
        return self.compliance

    @property
    def dtype(self) -> jnp.dtype:
        """Precision that its numbers are given in."""
        return jnp.result_type(self.system.input_speed)

    def physics(self, *slots: str) -> "Scene":
        """What the program of an analysis depends on, and nothing else.

        That is the system, its errors, reference and contact law, and the named optional slots; every number is an
        array of a definite dtype.
        """
        unused = {slot: None for slot in (*_OPTIONAL, "run") if slot not in slots}
        return jax.tree.map(strong, dataclasses.replace(self, **unused))

    def anchored(self) -> "Scene":
        """The same scene with the values of its errors at the start worked out."""
        if not self.errors or not isinstance(self.reference, ZeroAtStart):
            return self
        start = self.pose(jnp.zeros_like(self.system.input_speed))
        back = None if start.back is None else self._errors(start.back)
        return dataclasses.replace(self, reference=Anchor(self._errors(start.drive), back))

    def pose(self, theta: Scalar) -> Pose:
        """What the system shows at an input angle [rad]: all that does not depend on the errors' own numbers."""
        back = None if self.backlash is None else self._side(theta, Flank.BACK)
        return Pose(theta, self._side(theta, Flank.DRIVE), back)

    def contacts(
        self, theta: Scalar | Pose, stiffness: Stiffness = "rigid", position: Scalar | None = None
    ) -> ContactSet:
        """Candidate contacts at an input angle [rad], errors, reference and backlash included.

        Args:
            theta: input angle [rad], or the pose there.
            stiffness: ``"rigid"`` for none, ``"mean"``, or ``"varying"`` with the mesh phase.
            position: of the output, where a scene of exact geometry is looked at; its ideal position without [rad].
        """
        pose = theta if isinstance(theta, Pose) else self.pose(theta)
        if self.system.exact:
            drive = self._displaced(pose.theta, jnp.zeros_like(pose.theta) if position is None else position)
        else:
            drive = self._flank(pose.drive, Flank.DRIVE)
        back = None if pose.back is None else self._flank(pose.back, Flank.BACK)
        if back is not None and self.backlash is not None:
            back = ContactFrame(back.jacobian, back.gap + self.backlash.initial)
        springs = None if stiffness == "rigid" else self._stiffness(pose.theta, drive.gap.shape[0], stiffness)
        return join(drive, back, springs, self.system.two_sided)

    def _displaced(self, theta: Scalar, position: Scalar) -> ContactFrame:
        """Contacts of the displaced bodies, in a straight line about a position of the output [rad]."""
        by_body: dict[str, list[AbstractError]] = {}
        for error in self.errors.values():
            by_body.setdefault(error.body, []).append(error)
        moved = {body: self.system.movements(body, theta).of(errors) for body, errors in by_body.items()}
        gap, rate = jax.jvp(
            lambda at: self.system.displaced_gaps(theta, moved, at), (position,), (jnp.ones_like(position),)
        )
        return ContactFrame(-rate[:, None], gap - rate * position)

    def _stiffness(self, theta: Scalar, pairs: int, stiffness: Stiffness) -> Float[Array, " pair"] | LineSprings:
        if self.compliance is None:
            raise SceneError("the scene has no compliance: list a [compliance] to find forces under torque")
        if isinstance(self.compliance, AbstractLineContact):
            assert isinstance(self.system, LineContacts)
            return self.compliance.springs(self.system.radii(theta))
        if stiffness == "mean":
            return self.compliance.mean_stiffness(pairs)
        return self.compliance.stiffness(self.system.mesh_angle(theta))

    def _side(self, theta: Scalar, flank: Flank) -> Side:
        bodies = dict.fromkeys(error.body for error in self.errors.values())
        return Side(self.system.frame(theta, flank), {body: self.system.view(body, theta, flank) for body in bodies})

    def _flank(self, side: Side, flank: Flank) -> ContactFrame:
        if not self.errors:
            return side.frame
        gap = side.frame.gap + self._errors(side)
        if isinstance(self.reference, Anchor):
            start = self.reference.drive if flank is Flank.DRIVE else self.reference.back
            assert start is not None  # back flanks come with a backlash, and so does their start
            gap = gap - start
        elif self.reference is not None:
            gap = gap - self._errors(self._side(jnp.zeros_like(self.system.input_speed), flank))
        return ContactFrame(side.frame.jacobian, gap)

    def _errors(self, side: Side) -> Float[Array, " contact"]:
        gaps = [error.gap(side.views[error.body]) for error in self.errors.values()]
        return jax.tree.reduce(jnp.add, gaps)


def _check_rim(system: AbstractSystem, key: str, error: AbstractError) -> None:
    """Refuse an error of pins or teeth that its body does not have."""

    def gap(error: AbstractError) -> Array:
        return error.gap(system.view(error.body, jnp.zeros_like(system.input_speed), Flank.DRIVE))

    try:
        jax.eval_shape(gap, error)
    except ParameterError as fault:
        raise ParameterError(f"errors.{key}.{fault.key}", fault.given, fault.right) from fault


def require(scene: Scene, what: str, *slots: str) -> None:
    """Refuse an analysis whose slots the scene does not list, by name.

    Raises:
        SceneError: naming the analysis and the sections to add.
    """
    missing = [slot for slot in slots if getattr(scene, slot) is None]
    if scene.system.two_sided and "backlash" in missing:
        missing.remove("backlash")  # its contacts touch both flanks
    if missing:
        listed = " and ".join(f"[{slot}]" for slot in missing)
        raise SceneError(f'"{what}" needs {listed}, which this scene does not list')
    if "inertia" in slots and isinstance(scene.compliance, AbstractLineContact):
        raise SceneError(
            f'"{what}" needs springs in proportion, such as [compliance] kind = "harmonic_stiffness": the force of '
            f"{scene.compliance.kind} is not"
        )
