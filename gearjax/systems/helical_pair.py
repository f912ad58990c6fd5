"""Helical and spur pairs on parallel axes, external and internal: contact lines cut into slices (ISO 21771)."""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp

from gearjax import units
from gearjax.checks import MISSING, ParameterError, is_concrete, nearest
from gearjax.contact import GearSize, Layout, Pose, Request
from gearjax.contact.helical_mesh import (
    MARGIN,
    MOST_SLICES,
    WAYS,
    HelicalMesh,
    fault_of_gears,
    helical_layout,
    numbers_of_slices,
    pairs_of_teeth,
    with_tips,
)
from gearjax.geometry.helical_checks import faults
from gearjax.geometry.helical_pair import ISO_53, BasicRack, InvolutePair, rack_of
from gearjax.geometry.plane_of_action import CORNERS, SlicePoints, entering_corner, middles
from gearjax.parameters import angle, check_parameters, count, known_beside, length, name, number, with_known
from gearjax.sketch import ANTICLOCKWISE, CLOCKWISE, Sketch, SketchedBody
from gearjax.systems.base import AbstractSystem, MeshingIn
from gearjax.typing import Number, Scalar

PINION, WHEEL = "pinion", "wheel"


class HelicalPair(AbstractSystem):
    """Two involute gears on parallel axes, helical or spur; the wheel may be an internal gear.

    The pinion is on the input and the wheel on the output, even if the pinion has more teeth. Contacts are slices of
    the contact lines of all pairs of teeth that may touch, on the plane of action. Overlap and force of a contact are
    along the normal of the flanks, so that the lever on the wheel is ``r_b2 cos beta_b``. Errors of profile and helix
    are given in transverse sections, along the base tangent, as they are measured (ISO 1328-1). The driving flanks of
    ideal gears just touch. The backlash follows from the centre distance and the profile shifts; the section
    ``backlash`` adds to it.

    The key ``tip_contact`` states what happens at the ends of the path of contact. With ``"ends"``, contact ends there,
    as in Guo and Fang (2018): only the part of a slice that is on the path counts, at the middle of that part. With
    ``"corner"``, contact goes on at the corner of the tip, with the gap between the corner and the other flank; loaded
    teeth then come into contact early.

    In motion, slices need springs whose stiffness is proportional to their share on the path, such as `LineStiffness`
    or `ToothSlices` with constant contact. With spur teeth and ``"ends"`` this stiffness jumps at the ends of the path,
    and the usual time steps then have an error of up to 5 % of the swing. With ``"corner"`` there is no jump.
    `gearjax.one_contact` reduces a gear set with any compliance to one contact.

    Bodies: ``pinion`` and ``wheel``. The run-out turns with its gear. Its phase is counted in the sense in which the
    gear turns, from the line from its axis towards the pitch point. Teeth are counted from 0 in the order in which they
    come into mesh; tooth 0 touches at the pitch point, in the middle of the face, at input angle 0.

    Either gear may have a support. Its x points from the axis of the pinion towards the axis of the wheel (in an
    internal pair, away from it). Its y points across x, in the direction in which the teeth of the pinion move at the
    mesh. Its z points along the axis about which the pinion turns; rx and ry are tilts about x and y. A force that is
    off the middle of the face tilts the gears.

    Args:
        pinion_teeth: tooth number of the pinion.
        wheel_teeth: tooth number of the wheel; the tooth number of an internal gear is positive too.
        normal_module: normal module of the rack [m].
        normal_pressure_angle: normal pressure angle of the rack [rad].
        helix_angle: helix angle at the reference circles, positive for a right-hand pinion [rad].
        face_width: common face width of both gears [m].
        input_speed: speed of the pinion [rad/s].
        pinion_shift: profile shift of the pinion, in normal modules; a positive one moves the teeth outwards [-].
        wheel_shift: profile shift of the wheel, in normal modules; a positive one moves the teeth outwards [-].
        centre_distance: centre distance [m]; without it, the centre distance without backlash.
        rack: basic rack of both gears, ``"ISO 53 A"`` to ``"ISO 53 D"``.
        addendum: addendum of the basic rack, in normal modules, in place of the addendum of ``rack`` [-].
        dedendum: dedendum of the basic rack, in normal modules, in place of the dedendum of ``rack`` [-].
        fillet_radius: fillet radius of the basic rack, in normal modules, in place of the radius of ``rack`` [-].
        pinion_tip_diameter: tip diameter of the pinion [m]; without it, it follows from rack and profile shift.
        wheel_tip_diameter: tip diameter of the wheel [m]; without it, it follows from rack and profile shift.
        wheel_kind: kind of the wheel, ``"external"`` or ``"internal"``.
        slices: number of slices that the face is divided into.
        pairs: number of pairs of teeth that are modelled; without it, as many as may touch at once.
        tip_contact: whether contact ends with the path of contact, ``"ends"``, or goes on at the corner of a tip,
            ``"corner"``.

    Raises:
        ParameterError: a value is not physical, or the gears do not fit into each other.
    """

    kind: ClassVar[str] = "helical_pair"
    size_of_teeth: ClassVar[str] = "normal_module"
    has_slices: ClassVar[bool] = True

    pinion_teeth: int = count(at_least=5, at_most=2000, example=19)
    wheel_teeth: int = count(at_least=5, at_most=2000, example=47)
    normal_module: Number = length(at_least=1e-6, at_most=0.1, example="6 mm")
    normal_pressure_angle: Number = angle(above=0.0, below=math.pi / 4, example="20 deg")
    helix_angle: Number = angle(at_least=-math.pi / 3, at_most=math.pi / 3, example="9.911 deg")
    face_width: Number = length(at_least=1e-9, at_most=10.0, example="75 mm")
    input_speed: Number = number(units.ANGULAR_SPEED, at_least=1e-9, at_most=1e6, example="1500 rpm")
    pinion_shift: Number = number(units.RATIO, at_least=-5.0, at_most=5.0, default=0.0)
    wheel_shift: Number = number(units.RATIO, at_least=-5.0, at_most=5.0, default=0.0)
    centre_distance: Number | None = length(at_least=1e-6, at_most=100.0, default=None, example="201 mm")
    rack: str = name(default="ISO 53 A", names=tuple(ISO_53))
    addendum: Number | None = number(units.RATIO, at_least=0.01, at_most=3.0, default=None, example=1.0)
    dedendum: Number | None = number(units.RATIO, at_least=0.01, at_most=3.0, default=None, example=1.25)
    fillet_radius: Number | None = number(units.RATIO, at_least=0.0, at_most=1.0, default=None, example=0.38)
    pinion_tip_diameter: Number | None = length(at_least=1e-6, at_most=100.0, default=None, example="127.7 mm")
    wheel_tip_diameter: Number | None = length(at_least=1e-6, at_most=100.0, default=None, example="298.3 mm")
    wheel_kind: str = name(default="external", names=("external", "internal"))
    slices: int = count(default=40, at_most=MOST_SLICES)
    pairs: int | None = count(default=None, at_most=100, example=4)
    tip_contact: str = name(default="ends", names=tuple(MARGIN))

    known_pair: InvolutePair | None = known_beside()

    def __check_init__(self):
        check_parameters(self)
        if self.wheel_kind == "internal" and self.pinion_teeth >= self.wheel_teeth:
            words = f"must be below wheel_teeth ({self.wheel_teeth}), those of the internal gear"
            raise ParameterError("pinion_teeth", self.pinion_teeth, words)
        pair = self.pair
        if not is_concrete(pair):
            if self.pairs is None:
                raise ParameterError("pairs", MISSING, "must be given if the geometry is traced")
            return
        with jax.ensure_compile_time_eval():
            for fault in faults(pair):
                raise fault_of_gears(fault, self)
            touching, looked_at = pairs_of_teeth(pair, self.tip_contact)
            ratio = float(pair.total_contact_ratio)
        if self.pairs is None:
            object.__setattr__(self, "pairs", looked_at)
        elif self.pairs < touching:  # possible in a copy with a wider face, which keeps the old number
            words = f"must be at least {touching}, as many as touch at once (total contact ratio {ratio:.4g})"
            raise ParameterError("pairs", self.pairs, words)

    @property
    def precomputes(self) -> bool:
        return True

    def precomputed(self) -> "HelicalPair":
        return with_known(self, known_pair=self.pair)

    @property
    def pair(self) -> InvolutePair:
        """Both gears in mesh."""
        if self.known_pair is not None:
            return self.known_pair
        named, dtype = rack_of(self.rack), jnp.result_type(self.normal_module)
        own = {key: getattr(self, key) for key in ("addendum", "dedendum", "fillet_radius")}
        given = {key: getattr(named, key) if value is None else value for key, value in own.items()}
        rack = BasicRack(**{key: value.astype(dtype) for key, value in given.items()})
        pair = jax.tree_util.Partial(
            InvolutePair,
            (self.pinion_teeth, self.wheel_teeth),
            self.normal_module,
            self.normal_pressure_angle,
            self.helix_angle,
            (self.pinion_shift, self.wheel_shift),
            self.face_width,
            self.centre_distance,
            rack=rack,
            internal=self.wheel_kind == "internal",
        )
        return with_tips(pair, (self.pinion_tip_diameter, self.wheel_tip_diameter))

    @property
    def bodies(self) -> tuple[str, ...]:
        return PINION, WHEEL

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return dict.fromkeys(self.bodies, WAYS)

    @property
    def meshes(self) -> tuple[tuple[str, str], ...]:
        return ((PINION, WHEEL),)

    @property
    def orders(self) -> Mapping[str, float]:
        teeth = float(self.pinion_teeth)
        return {"output": teeth / self.wheel_teeth, "pinion": 1.0, "tooth": teeth, "mesh": teeth}

    def sketch(self) -> Sketch:
        internal = self.wheel_kind == "internal"
        distance = self.wheel_teeth - self.pinion_teeth if internal else self.wheel_teeth + self.pinion_teeth
        size = max(self.wheel_teeth, self.pinion_teeth)
        radii = self.pinion_teeth / size, self.wheel_teeth / size
        axis, turns = (-distance / size, 0.0) if internal else (distance / size, 0.0), 1 if internal else -1
        pinion = SketchedBody(PINION, radius=radii[0], turns=ANTICLOCKWISE)
        zero, sense = (0.0, ANTICLOCKWISE) if internal else (math.pi, CLOCKWISE)
        wheel = SketchedBody(WHEEL, axis, radii[1], zero, sense, turns=turns)
        return Sketch((pinion, wheel), (((radii[0], 0.0), PINION),), (), (axis, radii[1], turns))

    @property
    def cycle(self) -> float:
        return 2 * math.pi * self.wheel_teeth / math.gcd(self.pinion_teeth, self.wheel_teeth)

    def gear_size(self, body: str) -> GearSize:
        return self.stages[0].gear_size(self.bodies.index(body))

    def choices(self) -> Mapping[str, AbstractSystem]:
        return {f"slices = {n}": dataclasses.replace(self, slices=n) for n in numbers_of_slices(self.slices)}

    def contact_name(self, contact: int) -> str:
        return self.stages[0].contact_name(contact)

    @property
    def _pairs(self) -> int:
        assert self.pairs is not None  # `__check_init__` sets it if it was not given
        return self.pairs

    @property
    def stages(self) -> tuple[HelicalMesh, ...]:
        """The only mesh, cut into slices."""
        return (HelicalMesh(self.pair, self._pairs, self.slices, self.tip_contact == "corner"),)

    @property
    def meshing_in(self) -> MeshingIn:
        pair, system = self.pair, self
        path, radius = pair.contact_path, pair.gears[0].base_radius
        if self.tip_contact != "corner":
            more = min(1 + self._pairs, self.pinion_teeth, self.wheel_teeth)  # corners reach further than the path
            system = dataclasses.replace(self, tip_contact="corner", pairs=more)
        begin = path.begin - path.pitch - middles(pair.face_width, self.slices) * jnp.tan(pair.base_helix_angle)
        early, late = CORNERS * pair.base_pitch, 0.5 * (path.end - path.begin)

        def leverage(ahead: Scalar) -> Scalar:
            return entering_corner(pair, jnp.maximum(ahead, 0.0))[1]

        return MeshingIn(system, begin / radius, early / radius, late / radius, radius, leverage)

    def layout(self, request: Request) -> Layout:
        return helical_layout((self._pairs,), self.slices, request.back)

    def points(self, theta: Scalar, side: int) -> SlicePoints:
        """Slices of the pairs of teeth that may touch on one side, 1 or -1, at an input angle [rad]."""
        return self.stages[0].points(theta, side)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        contacts = self.stages[0].contacts(theta, request.back)
        columns = [contacts.lever]
        for coordinate in request.coordinates:
            body, _, way = coordinate.partition(".")
            columns.append(contacts.column(self._number(body), way))
        views = {body: contacts.view(self._number(body)) for body in request.bodies}
        teeth = len(contacts.sides) * self._pairs
        mesh = jnp.broadcast_to(self.orders["mesh"] * theta, (teeth,)) if request.mesh else None
        slices = (contacts.slices,) if request.slices else None
        return Pose(theta, jnp.stack(columns, axis=1), contacts.gap(request.moving), views, mesh, slices=slices)

    def _number(self, body: str) -> int:
        if body not in self.bodies:
            raise ParameterError("body", body, nearest(body, self.bodies))
        return self.bodies.index(body)
