"""A scene: one gear set with the effects that are modelled."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError, SceneError, check_name, nearest, one_angle, with_article
from gearjax.clearance import Anchor, InitialBacklash, ZeroAtStart
from gearjax.compliance import (
    AbstractCompliance,
    AbstractCoupledCompliance,
    AbstractLineContact,
    AbstractSliceCompliance,
    AbstractToothCompliance,
    AnyCompliance,
)
from gearjax.contact import (
    AbstractContact,
    ContactSet,
    CoupledSprings,
    HardContact,
    Layout,
    LinearSprings,
    Pose,
    Request,
    Springs,
)
from gearjax.coordinates import Coordinates, check_offered
from gearjax.errors import AbstractError
from gearjax.evaluate import evaluated_or_traced
from gearjax.impact import MeshingImpact, Pulses
from gearjax.inertia import BodyInertia, DampingRatio, EquivalentMass, MomentOfInertia
from gearjax.load_torque import AbstractLoad
from gearjax.parameters import Named, strong, with_known
from gearjax.run import Run
from gearjax.shafts import Shaft
from gearjax.structure import Moving, Structure
from gearjax.supports import Support
from gearjax.systems import AbstractSystem
from gearjax.systems.base import pose_of
from gearjax.typing import Array, ArrayLike, Float, Scalar

_OPTIONAL = ("backlash", "compliance", "load", "inertia", "damping", "impact")
Stiffness = Literal["rigid", "mean", "varying"]


class Scene(eqx.Module):
    """A gear set with the effects that are modelled. An absent effect is ``None``, or is not in the mapping.

    Args:
        system: the gear set.
        errors: errors of the bodies, by the name that a configuration gives them; their effects on the gaps add up.
        reference: `ZeroAtStart`, or ``None`` to count errors absolutely.
        backlash: initial backlash; without it back flanks are not modelled.
        compliance: stiffness of the teeth; ``None`` for rigid teeth.
        load: load torque over time, relative to its size.
        contact: contact law.
        inertia: inertia of the output, for the dynamic transmission error.
        damping: damping of the pairs, for the dynamic transmission error.
        supports: elastic supports, by body; bodies without a support are held rigidly.
        shafts: shafts on which bodies of a train turn together, by name; those of the gear set itself are rigid if they
            are not listed.
        body_inertia: inertia of bodies that move on their own, by body, for the dynamic transmission error.
        impact: impact of the teeth as they come into mesh, a force in motion: `MeshingImpact`, or the `Pulses` of
            `gearjax.meshing_impact`.
        run: analyses that the configuration asked for; not part of the physics.

    Raises:
        ParameterError: a part is of another kind than its slot takes; an error has a name that cannot stand in a path,
            is on a body that the system does not have, or does not suit the body; or the load names a frequency that
            the system does not have.
        SceneError: parts of the scene do not suit each other.
    """

    system: AbstractSystem
    errors: Mapping[str, AbstractError] = eqx.field(default_factory=dict)
    reference: ZeroAtStart | Anchor | None = None
    backlash: InitialBacklash | None = None
    compliance: AnyCompliance | None = None
    load: AbstractLoad | None = None
    contact: AbstractContact = HardContact()
    inertia: EquivalentMass | MomentOfInertia | None = None
    damping: DampingRatio | None = None
    supports: Mapping[str, Support] = eqx.field(default_factory=dict)
    shafts: Mapping[str, Shaft] = eqx.field(default_factory=dict)
    body_inertia: Mapping[str, BodyInertia] = eqx.field(default_factory=dict)
    impact: MeshingImpact | Pulses | None = None
    run: Run | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        from gearjax.gear_set_checks import check_gear_set

        # that module imports this one
        from gearjax.scene_checks import check_body, check_coupled, check_impact, check_moving, check_slots

        if not isinstance(self.system, AbstractSystem):
            is_path = isinstance(self.system, str | Path)
            words = "is a path: give gj.load(path)" if is_path else "must be a gear set, such as gj.TwoKV(...)"
            raise ParameterError("system", str(self.system) if is_path else self.system, words)
        check_slots(self)
        rigid = {
            name: Shaft(bodies)
            for name, bodies in self.system.rigid_shafts.items()
            if name not in self.shafts and not any(set(bodies) & set(own.bodies) for own in self.shafts.values())
        }
        if rigid:
            object.__setattr__(self, "shafts", {**self.shafts, **rigid})
        check_offered(self.system.kind, self.system.coordinates, self.supports, self.shafts)
        for key, error in self.errors.items():
            check_name("errors", key)
            check_body(self.system, key, error)
        frequency = getattr(self.load, "frequency", None)
        if isinstance(frequency, Named) and frequency.name not in self.system.orders:
            raise ParameterError("load.frequency", frequency.name, nearest(frequency.name, self.system.orders))
        if self.layout.sides_turn:
            for slot in ("backlash", "reference"):
                if getattr(self, slot) is not None:
                    raise SceneError(
                        f"[{slot}] is not for {with_article(self.system.kind)}, whose contacts touch both flanks and "
                        "count from the ideal profile: its clearances come from its modification and errors"
                    )
        if self.system.exact and self.reference is not None:
            words = 'counts errors to first order: leave it out, or use clearance = "linear"'
            raise SceneError(f"[reference] {words}")
        if isinstance(self.compliance, AbstractLineContact) and not self.system.has_radii:
            raise SceneError(
                f'[compliance] kind = "{self.compliance.kind}" needs the radii of curvature of the flanks, which a '
                f'{self.system.kind} does not offer: use "harmonic_stiffness"'
            )

        check_moving(self)
        check_coupled(self)
        check_impact(self)
        check_gear_set(self)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates: output, free shafts, directions of the supports, twists of bodies on shafts."""
        return self.moving.coordinates.names

    @property
    def output_alone(self) -> bool:
        """Whether the output is the only coordinate."""
        return self.moving.coordinates.alone

    @property
    def is_train(self) -> bool:
        """Whether motion passes through several meshes in series, with shafts between them that turn freely."""
        return self.moving.coordinates.free > 1

    @property
    def moving(self) -> Moving:
        """The coordinates, and the supports and shafts that hold them."""
        return Moving.of(self.system.meshes, self.supports, self.shafts)

    def structure(self, contacts: ContactSet) -> Structure:
        """Mass, stiffness and damping of the coordinates; the scene must suit the dynamic TE (`require`).

        Args:
            contacts: contacts at input angle 0, whose levers tell the moment of inertia of an equivalent mass.
        """
        assert self.inertia is not None
        output = self.inertia.moment(contacts.output_levers)
        return Structure.of(output, self.moving, self.body_inertia, self.system.orbits, self.system.input_speed)

    @property
    def layout(self) -> Layout:
        """Sides and pairs of the contacts."""
        # called on the classes: equinox makes a module of every bound method, which takes longer than the call itself
        return type(self.system).layout(self.system, Scene._request(self, "rigid"))

    @property
    def has_back(self) -> bool:
        """Whether back flanks are modelled."""
        return self.layout.has_back

    @property
    def has_clearance(self) -> bool:
        """Whether the clearance between driving and back flanks is known.

        It is known if back flanks are modelled, or if the gear set knows the clearance of its own geometry. The latter
        does not help with an `Anchor`, which stores the errors of the driving flanks alone.
        """
        return self.has_back or (self.system.has_clearance and not isinstance(self.reference, Anchor))

    @property
    def both_flanks(self) -> "Scene":
        """The scene with back flanks, which must have a known clearance (`has_clearance`)."""
        if self.has_back:
            return self
        return dataclasses.replace(self, backlash=InitialBacklash(initial=jnp.zeros((), self.dtype)))

    @property
    def springs_apart(self) -> bool:
        """Whether the output alone moves, on linear springs of pairs of teeth that do not influence each other."""
        return isinstance(self.compliance, AbstractCompliance) and self.output_alone

    @property
    def linear_compliance(self) -> AbstractCompliance:
        """The compliance, known to consist of linear springs of pairs; the dynamics need them (`require`)."""
        assert isinstance(self.compliance, AbstractCompliance)
        return self.compliance

    @property
    def dtype(self) -> jnp.dtype:
        """Floating-point type of the numbers."""
        return jnp.result_type(self.system.input_speed)

    def physics(self, *slots: str) -> "Scene":
        """The scene reduced to the parts that an analysis depends on, so that scenes share its compiled program.

        These are the system, its errors, reference and contact law, and the named optional slots; supports stay with
        the compliance. Every number becomes an array of a definite dtype.
        """
        changed: dict = {slot: None for slot in (*_OPTIONAL, "run") if slot not in slots}
        if "impact" in slots and isinstance(self.impact, MeshingImpact):
            changed["impact"] = self.impact.counted(self)
        moving = "inertia" in slots and bool(self.body_inertia)
        if not moving:
            changed["body_inertia"] = {}
        if not moving and not {"compliance", "supports"} & set(slots):  # without forces nothing deflects
            changed["supports"] = {}
            changed["shafts"] = {name: shaft.rigid for name, shaft in self.shafts.items()}
        return self._with(**changed)

    def precomputed(self, *slots: str) -> "Scene":
        """The scene as `physics` gives it, with all that its contacts need at every input angle worked out beforehand.

        Programs of single scenes are smaller then, and compile sooner. For numbers that are replaced one by one, as in
        studies, `physics` is right.
        """
        scene = self.physics(*slots)
        springs = scene.compliance if getattr(scene.compliance, "precomputes", False) else None
        if not scene.system.precomputes and springs is None:
            return scene
        system, known = evaluated_or_traced(_precomputed, scene.system, springs)
        return with_known(scene, system=system, compliance=scene.compliance if springs is None else known)

    @property
    def springs_alone(self) -> "Scene":
        """The scene reduced to the parts that the springs depend on; scenes with other errors then share a program."""
        others = dict.fromkeys(("load", "inertia", "damping", "impact", "reference", "run"))
        return self._with(**others, errors={}, body_inertia={}, contact=HardContact())

    def _with(self, **changed: Any) -> "Scene":
        """The scene with some parts replaced, and with all numbers of a definite dtype.

        The parts were checked before. Checking them again would take time, 30 ms for many pins.
        """
        parts = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)} | changed
        alone = object.__new__(Scene)
        for name, part in parts.items():
            object.__setattr__(alone, name, part)
        return jax.tree.map(strong, alone)

    def anchored(self) -> "Scene":
        """The scene with the effect of its errors at input angle zero computed and stored (`Anchor`)."""
        if not self.errors or not isinstance(self.reference, ZeroAtStart):
            return self
        start = self.pose(jnp.zeros_like(self.system.input_speed))
        return dataclasses.replace(self, reference=Anchor(self._errors(start)))

    def _request(self, stiffness: Stiffness) -> Request:
        line = isinstance(self.compliance, AbstractLineContact)
        return Request(
            back=self.backlash is not None,
            bodies=tuple(dict.fromkeys(error.body for error in self.errors.values())),
            mesh=stiffness == "varying" and not line,
            radii=stiffness != "rigid" and line,
            places=stiffness != "rigid" and isinstance(self.compliance, AbstractToothCompliance),
            slices=stiffness != "rigid" and isinstance(self.compliance, AbstractSliceCompliance),
            moving=stiffness == "varying" and isinstance(self.compliance, AbstractSliceCompliance),
            coordinates=self._coordinates(stiffness).asked,
        )

    def _coordinates(self, stiffness: Stiffness) -> Coordinates:
        """The coordinates that move; without forces only those that no support or shaft holds."""
        coordinates = self.moving.coordinates
        return coordinates.rigid if stiffness == "rigid" else coordinates

    def pose(self, theta: ArrayLike, stiffness: Stiffness = "rigid") -> Pose:
        """Pose of the system at an input angle: everything that does not depend on the numbers of the errors.

        Args:
            theta: input angle [rad].
            stiffness: as for `contacts`.

        Raises:
            ParameterError: an argument is wrong.
        """
        _check_stiffness(stiffness)
        return pose_of(self.system, one_angle("theta", theta, self.dtype), self._request(stiffness))

    def contacts(
        self, theta: ArrayLike | Pose, stiffness: Stiffness = "rigid", position: ArrayLike | None = None
    ) -> ContactSet:
        """Candidate contacts at an input angle, including errors, reference and backlash.

        Args:
            theta: input angle [rad], or the pose at that angle.
            stiffness: ``"rigid"`` for contacts without springs, ``"mean"``, or ``"varying"`` with the mesh phase.
            position: position of the output at which exact geometry is linearised [rad]; by default the ideal one.

        Raises:
            ParameterError: an argument is wrong.
            SceneError: the scene has no compliance, which contacts with springs need.
        """
        _check_stiffness(stiffness)
        known = theta if isinstance(theta, Pose) else one_angle("theta", theta, self.dtype)
        if isinstance(known, Pose):
            known.require(self._request(stiffness).bodies, len(self.layout.side))
        place = None if position is None else one_angle("position", position, self.dtype)
        return _contacts_of(self, known, stiffness, place)

    def _contacts(self, theta: Scalar | Pose, stiffness: Stiffness, position: Scalar | None) -> ContactSet:
        pose, layout = theta if isinstance(theta, Pose) else self.pose(theta, stiffness), self.layout
        if self.system.exact:
            place = jnp.zeros_like(pose.theta) if position is None else position
            jacobian, gap = self._displaced(pose.theta, place)
        else:
            jacobian, gap = pose.jacobian, self._gaps(pose, layout)
        coordinates = self._coordinates(stiffness)
        jacobian = self._by_coordinates(jacobian, pose, coordinates)
        held = len(coordinates.names) - coordinates.free
        supports = self.moving.springs(jacobian.dtype)[-held:, -held:] if held else None
        meshes = layout.mesh or (0,) * len(layout.side)
        holds = tuple(coordinates.holds[mesh] for mesh in meshes) if coordinates.free > 1 else ()
        return ContactSet(jacobian, gap, self._springs(pose, layout, stiffness), layout, supports, holds)

    def _by_coordinates(
        self, motions: Float[Array, "contact motion"], pose: Pose, coordinates: Coordinates
    ) -> Float[Array, "contact coordinate"]:
        """Jacobian with respect to the coordinates, from that with respect to motions of the output and of bodies."""
        asked = len(coordinates.asked)
        if motions.shape[1] > 1 + asked:  # the pose also has columns of elastic motions
            names = dict(zip(self.moving.coordinates.asked, range(1, motions.shape[1]), strict=True))
            motions = motions[:, np.array([0, *(names[name] for name in coordinates.asked)])]
        elif motions.shape[1] < 1 + asked:  # the pose was made for rigid contacts
            request = Request(self.backlash is not None, coordinates=coordinates.asked)
            motions = pose_of(self.system, pose.theta, request).jacobian
        spread = coordinates.spread
        alike = spread.shape[0] == spread.shape[1] and (spread == np.eye(len(spread))).all()
        return motions if alike else motions @ jnp.asarray(spread, motions.dtype)

    def _displaced(self, theta: Scalar, position: Scalar) -> tuple[Float[Array, "contact 1"], Float[Array, " contact"]]:
        """Jacobian and gaps of the displaced bodies, linearised at a position of the output [rad]."""
        by_body: dict[str, list[AbstractError]] = {}
        for error in self.errors.values():
            by_body.setdefault(error.body, []).append(error)
        system, request = self.system, Request(self.backlash is not None)
        moved = {body: system.movements(body, theta, request).of(errors) for body, errors in by_body.items()}
        gap, rate = system.displaced_gaps(theta, moved, position, request)
        return -rate[:, None], self._with_backlash(gap - rate * position, self.layout)

    def _springs(self, pose: Pose, layout: Layout, stiffness: Stiffness) -> Springs | None:
        """Springs of the contacts; the flanks of a pair are equally stiff."""
        if stiffness == "rigid":
            return None
        if self.compliance is None:
            raise SceneError("the scene has no compliance: list a [compliance] to find forces under torque")
        back = self.backlash is not None
        if isinstance(self.compliance, AbstractLineContact):
            return self.compliance.springs(self._shown(pose, pose.radii, Request(back, radii=True)).radii)
        if isinstance(self.compliance, AbstractCoupledCompliance):
            return CoupledSprings(self.compliance.influence(layout))
        if isinstance(self.compliance, AbstractToothCompliance):
            places = self._shown(pose, pose.places, Request(back, places=True)).places
            return CoupledSprings(self.compliance.blocks(places))
        if isinstance(self.compliance, AbstractSliceCompliance):
            return self.compliance.of_meshes(self._shown(pose, pose.slices, Request(back, slices=True)).slices)
        if stiffness == "mean":
            return LinearSprings(layout.per_contact(layout.apiece(self.compliance.mean_stiffness(layout.teeth))))
        angle = self._shown(pose, pose.mesh_angle, Request(back, mesh=True)).mesh_angle
        return LinearSprings(layout.per_contact(layout.apiece(self.compliance.stiffness(angle))))

    def _shown(self, pose: Pose, part: Any, request: Request) -> Any:
        """The pose, or, if a part of it is missing, a new pose with that part."""
        return pose_of(self.system, pose.theta, request) if part is None else pose

    def _gaps(self, pose: Pose, layout: Layout) -> Float[Array, " contact"]:
        """Gaps with errors, reference and backlash, to first order in the errors."""
        gap = pose.gap
        if self.errors:
            gap = gap + self._errors(pose)
            if isinstance(self.reference, Anchor):
                gap = gap - self.reference.gap
            elif self.reference is not None:
                gap = gap - self._errors(self.pose(jnp.zeros_like(self.system.input_speed)))
        return self._with_backlash(gap, layout)

    def _with_backlash(self, gap: Float[Array, " contact"], layout: Layout) -> Float[Array, " contact"]:
        if self.backlash is None:
            return gap
        # the concatenation is an XLA kernel of its own, so that gaps are computed once and not up to four times
        return layout.joined(gap[layout.on(1)], gap[layout.on(-1)] + self.backlash.initial)

    def _errors(self, pose: Pose) -> Float[Array, " contact"]:
        gaps = [error.gap(pose.views[error.body]) for error in self.errors.values()]
        return jax.tree.reduce(jnp.add, gaps)


def _check_stiffness(stiffness: str) -> None:
    if not (isinstance(stiffness, str) and stiffness in get_args(Stiffness)):
        raise ParameterError("stiffness", stiffness, f"must be one of {', '.join(get_args(Stiffness))}")


def _precomputed(system: AbstractSystem, springs: Any) -> tuple[AbstractSystem, Any]:
    """A gear set and the compliance of its teeth, precomputed."""
    system = system.precomputed()
    if springs is None:
        return system, None
    if isinstance(springs, AbstractCompliance):
        return system, springs.precomputed()
    slices = isinstance(springs, AbstractSliceCompliance)
    pose = pose_of(system, jnp.zeros_like(system.input_speed), Request(slices=slices, places=not slices))
    return system, springs.precomputed(pose.slices if slices else pose.places)


@eqx.filter_jit
def _contacts_of(scene: Scene, theta: Scalar | Pose, stiffness: Stiffness, position: Scalar | None) -> ContactSet:
    """The same as `Scene._contacts`, traced once: programs use contacts in many places (see `pose_of`)."""
    return scene._contacts(theta, stiffness, position)
