"""Trains of helical and spur pairs on parallel shafts, such as a two-stage gearbox: helical meshes in series."""

import dataclasses
import functools
import math
from collections.abc import Mapping
from fractions import Fraction
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import MISSING, ParameterError, is_concrete, nearest
from gearjax.contact import BodyView, GearSize, Layout, Pose, ProfilePlace, Request
from gearjax.contact.helical_mesh import (
    MARGIN,
    MOST_SLICES,
    WAYS,
    HelicalMesh,
    MeshContacts,
    fault_of_gears,
    helical_layout,
    numbers_of_slices,
    pairs_of_teeth,
    with_tips,
)
from gearjax.contact.slices import by_side
from gearjax.geometry.helical_checks import faults
from gearjax.geometry.helical_pair import ISO_53, InvolutePair, rack_of
from gearjax.parameters import check_parameters, count, counts, known_beside, name, number, series, with_known
from gearjax.sketch import ANTICLOCKWISE, CLOCKWISE, Sketch, SketchedBody, beyond
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Number, Scalar

PER_MESH = (
    "normal_module",
    "normal_pressure_angle",
    "helix_angle",
    "face_width",
    "pinion_shift",
    "wheel_shift",
    "line_angle",
)
"""Parameters with one value per mesh, or one for all."""
MAY_FOLLOW = ("centre_distance", "pinion_tip_diameter", "wheel_tip_diameter")
"""Parameters that follow from the others if they are left out."""
MOST_MESHES = 20


class HelicalTrain(AbstractSystem):
    """External helical or spur pairs in series on parallel shafts, such as a gearbox of two stages.

    Mesh i has the bodies ``pinion_i`` and ``wheel_i``, counted from 1. ``pinion_1`` is on the input, the last wheel on
    the output, and each wheel shares a shaft with the pinion of the next mesh: a rigid shaft, unless the section
    ``shafts`` lists shafts that twist or bend. Every list has one value per mesh, in order from the input, or a single
    value for all meshes.

    Each mesh is that of a `HelicalPair`, with the same definitions of contacts, tips, errors and their phases: the
    phase of a run-out is counted in the sense in which its gear turns, from the line towards the pitch point of its
    mesh. At input angle 0, tooth 0 of every pinion touches at the pitch point, in the middle of the face.

    The axes of supports are the same for all bodies. The x axis is fixed in the housing; `line_angle` is counted from
    it. The z axis is the one about which ``pinion_1`` turns, y is across x and z; rx and ry are tilts about x and y,
    while rz of each body is positive in the sense in which that body turns.

    Args:
        pinion_teeth: tooth numbers of the pinions, one per mesh.
        wheel_teeth: tooth numbers of the wheels, one per mesh.
        normal_module: normal modules [m].
        normal_pressure_angle: normal pressure angles of the racks [rad].
        helix_angle: helix angles at the reference circles, positive for a right-hand pinion [rad].
        face_width: common face widths of both gears of each mesh [m].
        input_speed: speed of the first pinion [rad/s].
        pinion_shift: profile shifts of the pinions, in normal modules; a positive one moves the teeth outwards [-].
        wheel_shift: profile shifts of the wheels, in normal modules; a positive one moves the teeth outwards [-].
        line_angle: directions of the lines of centres, each from the axis of the pinion towards the axis of the wheel,
            counted from the x axis in the sense in which the first pinion turns [rad].
        centre_distance: centre distances [m]; an empty list for those without backlash.
        rack: basic rack of all gears, ``"ISO 53 A"`` to ``"ISO 53 D"``.
        pinion_tip_diameter: tip diameters of the pinions [m]; an empty list for those of rack and profile shifts.
        wheel_tip_diameter: tip diameters of the wheels [m]; an empty list for those of rack and profile shifts.
        slices: number of slices that each face is divided into.
        pairs: number of pairs of teeth that are modelled in each mesh; without it, as many as may touch at once.
        tip_contact: whether contact ends with the path of contact, ``"ends"``, or goes on at the corner of a tip,
            ``"corner"``.

    Raises:
        ParameterError: a list has the wrong length, a value is not physical, or gears do not fit into each other.
    """

    kind: ClassVar[str] = "helical_train"
    size_of_teeth: ClassVar[str] = "normal_module"
    has_slices: ClassVar[bool] = True

    pinion_teeth: tuple[int, ...] = counts(at_least=5, at_most=2000, example=[21, 19])
    wheel_teeth: tuple[int, ...] = counts(at_least=5, at_most=2000, example=[58, 61])
    normal_module: Number = series(units.LENGTH, at_least=1e-6, at_most=0.1, example=["2 mm", "3 mm"])
    normal_pressure_angle: Number = series(units.ANGLE, above=0.0, below=math.pi / 4, example=["20 deg"])
    helix_angle: Number = series(units.ANGLE, at_least=-math.pi / 3, at_most=math.pi / 3, example=["15 deg", "-12 deg"])
    face_width: Number = series(units.LENGTH, at_least=1e-9, at_most=10.0, example=["22 mm", "34 mm"])
    input_speed: Number = number(units.ANGULAR_SPEED, at_least=1e-9, at_most=1e6, example="3000 rpm")
    pinion_shift: Number = series(units.RATIO, at_least=-5.0, at_most=5.0, default=(0.0,))
    wheel_shift: Number = series(units.RATIO, at_least=-5.0, at_most=5.0, default=(0.0,))
    line_angle: Number = series(units.ANGLE, default=(0.0,), example=["0 deg", "70 deg"])
    centre_distance: Number = series(units.LENGTH, at_least=1e-6, at_most=100.0, default=())
    rack: str = name(default="ISO 53 A", names=tuple(ISO_53))
    pinion_tip_diameter: Number = series(units.LENGTH, at_least=1e-6, at_most=100.0, default=())
    wheel_tip_diameter: Number = series(units.LENGTH, at_least=1e-6, at_most=100.0, default=())
    slices: int = count(default=20, at_most=MOST_SLICES)
    pairs: int | None = count(default=None, at_most=100, example=4)
    tip_contact: str = name(default="ends", names=tuple(MARGIN))

    known_gears: tuple[InvolutePair, ...] | None = known_beside()

    def __check_init__(self):
        check_parameters(self)
        self._check_lengths()
        gears = self._gears
        if not is_concrete(gears):
            if self.pairs is None:
                raise ParameterError("pairs", MISSING, "must be given if the geometry is traced")
            return
        touching, looked_at = [], []
        with jax.ensure_compile_time_eval():
            for mesh, pair in enumerate(gears):
                for fault in faults(pair):
                    raise fault_of_gears(fault, self, f"mesh {mesh + 1}: ")
                at_once, modelled = pairs_of_teeth(pair, self.tip_contact)
                touching.append(at_once)
                looked_at.append(modelled)
        if self.pairs is None:
            object.__setattr__(self, "pairs", max(looked_at))
        elif self.pairs < max(touching):
            worst = touching.index(max(touching))
            words = f"must be at least {max(touching)}, as many as touch at once in mesh {worst + 1}"
            raise ParameterError("pairs", self.pairs, words)

    def _check_lengths(self) -> None:
        meshes = len(self.pinion_teeth)
        if meshes > MOST_MESHES:
            raise ParameterError("pinion_teeth", list(self.pinion_teeth), f"must be at most {MOST_MESHES} meshes")
        if len(self.wheel_teeth) != meshes:
            words = f"must have {meshes} numbers, one per mesh, as pinion_teeth has"
            raise ParameterError("wheel_teeth", list(self.wheel_teeth), words)
        for key in (*PER_MESH, *MAY_FOLLOW):
            number, follows = getattr(self, key).shape[-1], key in MAY_FOLLOW
            if number not in (1, meshes, *((0,) if follows else ())):
                words = f"must be {meshes}, one per mesh, or one for all" + (", or none" if follows else "")
                raise ParameterError(key, f"{number} values", words)

    @property
    def precomputes(self) -> bool:
        return True

    def precomputed(self) -> "HelicalTrain":
        return with_known(self, known_gears=self._gears)

    @property
    def _gears(self) -> tuple[InvolutePair, ...]:
        """The gears of each mesh."""
        if self.known_gears is not None:
            return self.known_gears
        rack = rack_of(self.rack)
        made = []
        for mesh, teeth in enumerate(zip(self.pinion_teeth, self.wheel_teeth, strict=True)):

            def own(key: str, mesh: int = mesh) -> Scalar | None:
                values = getattr(self, key)
                return values[mesh if len(values) > 1 else 0] if len(values) else None

            pair = jax.tree_util.Partial(
                InvolutePair,
                teeth,
                own("normal_module"),
                own("normal_pressure_angle"),
                own("helix_angle"),
                (own("pinion_shift"), own("wheel_shift")),
                own("face_width"),
                own("centre_distance"),
                rack=rack,
            )
            made.append(with_tips(pair, (own("pinion_tip_diameter"), own("wheel_tip_diameter"))))
        return tuple(made)

    @property
    def stages(self) -> tuple[HelicalMesh, ...]:
        """The meshes in order from the input, cut into slices."""
        corners, each = self.tip_contact == "corner", zip(self._gears, self._pairs, strict=True)
        return tuple(HelicalMesh(pair, number, self.slices, corners) for pair, number in each)

    @property
    def _pairs(self) -> tuple[int, ...]:
        """Number of pairs of teeth that are modelled in each mesh."""
        assert self.pairs is not None  # `__check_init__` sets it if it was not given
        return tuple(min(self.pairs, *teeth) for teeth in zip(self.pinion_teeth, self.wheel_teeth, strict=True))

    @property
    def bodies(self) -> tuple[str, ...]:
        return tuple(f"{gear}_{mesh + 1}" for mesh in range(len(self.pinion_teeth)) for gear in ("pinion", "wheel"))

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return dict.fromkeys(self.bodies, WAYS)

    @property
    def meshes(self) -> tuple[tuple[str, str], ...]:
        return tuple(zip(self.bodies[::2], self.bodies[1::2], strict=True))

    @property
    def rigid_shafts(self) -> Mapping[str, tuple[str, ...]]:
        between = zip(self.bodies[1:-1:2], self.bodies[2::2], strict=True)
        return {f"shaft_{number + 2}": bodies for number, bodies in enumerate(between)}

    @property
    def _turns(self) -> tuple[Fraction, ...]:
        """Turns of each pinion, and of the output, per turn of the input."""
        turns = [Fraction(1)]
        for pinion, wheel in zip(self.pinion_teeth, self.wheel_teeth, strict=True):
            turns.append(turns[-1] * Fraction(pinion, wheel))
        return tuple(turns)

    @property
    def mesh_orders(self) -> tuple[float, ...]:
        return tuple(float(turns * teeth) for turns, teeth in zip(self._turns, self.pinion_teeth, strict=False))

    @property
    def orders(self) -> Mapping[str, float]:
        orders, turns = self.mesh_orders, self._turns
        bodies = {f"pinion_{mesh + 1}": float(own) for mesh, own in enumerate(turns[:-1])}
        meshes = {f"mesh_{mesh + 1}": order for mesh, order in enumerate(orders)}
        return {"output": float(turns[-1]), "mesh": max(orders)} | bodies | meshes

    @property
    def cycle(self) -> float:
        return 2 * math.pi * math.lcm(*(turns.denominator for turns in self._turns))

    def sketch(self) -> Sketch:
        radii = [0.5 * z * module for z, module in zip(self._teeth, np.repeat(self._sizes, 2), strict=True)]
        axes = [(0.0, 0.0)]
        for mesh, direction in enumerate(self._lines):
            axes.append(beyond(axes[-1], direction, radii[2 * mesh] + radii[2 * mesh + 1]))
        size = max(max(abs(x), abs(y), 1e-9) for x, y in axes) + max(radii)
        bodies, points, turns = [], [], 1
        for mesh, direction in enumerate(self._lines):
            for gear in (0, 1):
                number = 2 * mesh + gear
                x, y = axes[mesh + gear]
                zero, sense = (direction + gear * math.pi), ANTICLOCKWISE if turns > 0 else CLOCKWISE
                place = x / size, y / size
                body = SketchedBody(self.bodies[number], place, radii[number] / size, zero, sense, turns=turns)
                bodies.append(body)
                turns = -turns if gear == 0 else turns
            pitch = beyond(axes[mesh], direction, radii[2 * mesh])
            points.append(((pitch[0] / size, pitch[1] / size), self.bodies[2 * mesh]))
        last = bodies[-1]
        return Sketch(tuple(bodies), tuple(points), (), (last.axis, last.radius, last.turns))

    @property
    def _teeth(self) -> tuple[int, ...]:
        return tuple(z for teeth in zip(self.pinion_teeth, self.wheel_teeth, strict=True) for z in teeth)

    @property
    def _sizes(self) -> np.ndarray:
        """Normal module of each mesh, for drawings."""
        return np.broadcast_to(np.asarray(self.normal_module), (len(self.pinion_teeth),))

    @property
    def _lines(self) -> list[float]:
        """Direction of each line of centres, for drawings."""
        return np.broadcast_to(np.asarray(self.line_angle), (len(self.pinion_teeth),)).tolist()

    def gear_size(self, body: str) -> GearSize:
        mesh, gear = divmod(self._number(body), 2)
        return self.stages[mesh].gear_size(gear)

    def choices(self) -> Mapping[str, AbstractSystem]:
        return {f"slices = {n}": dataclasses.replace(self, slices=n) for n in numbers_of_slices(self.slices)}

    def contact_name(self, contact: int) -> str:
        numbers = [stage.pairs * stage.slices for stage in self.stages]
        back, place = divmod(contact, sum(numbers))
        for mesh, stage in enumerate(self.stages):
            if place < numbers[mesh]:
                return f"{stage.contact_name(back * numbers[mesh] + place)}, mesh {mesh + 1}"
            place -= numbers[mesh]
        raise IndexError(f"contact {contact}")

    def layout(self, request: Request) -> Layout:
        return helical_layout(self._pairs, self.slices, request.back)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        meshes = [
            stage.contacts(theta * float(turns), request.back)
            for stage, turns in zip(self.stages, self._turns, strict=False)
        ]
        columns = [_spread(meshes, len(meshes) - 1, meshes[-1].lever)]
        for coordinate in request.coordinates:
            body, _, way = coordinate.partition(".")
            mesh, gear = divmod(self._number(body), 2)
            columns.append(_spread(meshes, mesh, self._column(meshes[mesh], mesh, gear, way)))
        views = {body: _view(meshes, *divmod(self._number(body), 2)) for body in request.bodies}
        phases = None
        if request.mesh:
            of_pairs = np.repeat(self.mesh_orders, [mesh.mesh.pairs for mesh in meshes])
            phases = jnp.asarray(np.tile(of_pairs, len(meshes[0].sides)), theta.dtype) * theta
        gaps = by_side([mesh.gap(request.moving) for mesh in meshes], len(meshes[0].sides))
        slices = tuple(mesh.slices for mesh in meshes) if request.slices else None
        return Pose(theta, jnp.stack(columns, axis=1), gaps, views, phases, slices=slices)

    def _column(self, contacts: MeshContacts, mesh: int, gear: int, way: str) -> Array:
        """Change of overlap per displacement along the axes of the housing, from those along the axes of the mesh.

        Successive pinions turn in opposite senses, and with them the y and z axes of their meshes.
        """
        sense = -1.0 if mesh % 2 else 1.0
        kind, axis = way[:-1], way[-1]
        if way == "rz":
            return contacts.column(gear, way)
        if axis == "z":
            return sense * contacts.column(gear, way)
        own = self.line_angle[mesh if len(self.line_angle) > 1 else 0]
        along, across = contacts.column(gear, f"{kind}x"), sense * contacts.column(gear, f"{kind}y")
        if axis == "x":
            return jnp.cos(own) * along - jnp.sin(own) * across
        return jnp.sin(own) * along + jnp.cos(own) * across

    def _number(self, body: str) -> int:
        if body not in self.bodies:
            raise ParameterError("body", body, nearest(body, self.bodies))
        return self.bodies.index(body)


def _spread(meshes: list[MeshContacts], mesh: int, part: Array) -> Array:
    """Numbers of the contacts of one mesh, zero at those of the others."""
    parts = [part if i == mesh else jnp.zeros((one.number,), part.dtype) for i, one in enumerate(meshes)]
    return by_side(parts, len(meshes[mesh].sides))


def _view(meshes: list[MeshContacts], mesh: int, gear: int) -> BodyView:
    """View of an error of one gear, which the contacts of the other meshes do not see."""
    contacts = meshes[mesh]
    own, spread = contacts.view(gear), functools.partial(_spread, meshes, mesh)
    flank = own.flank
    assert flank is not None
    assert flank.roll is not None
    normal = jnp.broadcast_to(jnp.cos(contacts.mesh.pair.base_helix_angle), (contacts.number,))
    place = ProfilePlace(
        length=flank.length,
        width=flank.width,
        normal=spread(normal),
        # contacts of other meshes stay on the flank, so that a measured one is not read beyond its ends
        roll=spread(flank.roll - flank.roll[0]) + flank.roll[0],
        **{key: spread(getattr(flank, key)) for key in ("to_tip", "across", "side", "ahead")},
    )
    turned = jax.tree.map(spread, eqx.tree_at(lambda view: view.flank, own, None))
    touching = spread(jnp.ones_like(own.influence))
    return eqx.tree_at(
        lambda view: (view.flank, view.rim.own), turned, (place, touching), is_leaf=lambda part: part is None
    )
