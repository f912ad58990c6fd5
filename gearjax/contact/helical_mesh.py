"""Contacts of one mesh of gears on parallel axes: its levers, gaps and views of errors, in the axes of that mesh.

The x axis of a mesh points from the axis of its pinion towards the axis of its wheel (in an internal pair, away from
it). Its y axis points across x, in the direction in which the teeth of the pinion move at the mesh, and its z axis
along the axis about which the pinion turns.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError, is_concrete
from gearjax.contact.layout import Layout
from gearjax.contact.pose import BodyView, GearSize, ProfilePlace, Rim
from gearjax.contact.slices import Slices
from gearjax.geometry.helical_pair import InvolutePair
from gearjax.geometry.internal_checks import Fault
from gearjax.geometry.involute import involute
from gearjax.geometry.plane_of_action import SlicePoints, slice_points
from gearjax.typing import Array, Float, Scalar

ROUNDING = 1e-6  # rounding of the total contact ratio
MOST_SLICES = 1000
MARGIN = {"ends": 0.2, "corner": 0.7}
"""What happens at the ends of the path of contact, and the number of pairs beyond the total contact ratio that other
designs and loads may need."""
WAYS = ("x", "y", "z", "rx", "ry", "rz")
"""Directions in which the gears may move, as coordinates of supports name them."""


class HelicalMesh(eqx.Module):
    """A pinion that drives a wheel, and how their contact lines are cut into slices.

    Args:
        pair: the gears.
        pairs: number of pairs of teeth that are modelled.
        slices: number of slices that the face is divided into.
        corners: whether contact goes on at the corner of a tip beyond the path of contact.
    """

    pair: InvolutePair
    pairs: int = eqx.field(static=True)
    slices: int = eqx.field(static=True)
    corners: bool = eqx.field(static=True)

    @property
    def ratio(self) -> float:
        """Turns of the wheel per turn of the pinion, in the sense of each."""
        return self.pair.teeth[0] / self.pair.teeth[1]

    def gear_size(self, number: int) -> GearSize:
        """Sizes of the pinion (0) or the wheel (1) that deviations are checked against."""
        pair = self.pair
        ends = pair.contact_path.begin, pair.contact_path.end
        rolls = ends if number == 0 else tuple(pair.other_roll(end) for end in ends)
        roll = jnp.minimum(*rolls), jnp.maximum(*rolls)
        gear, diameter, angle = pair.gears[number], pair.reference_diameters[number], pair.transverse_pressure_angle
        own = gear.base_half_angle - involute(gear.pressure_angle)
        space = own if gear.internal else math.pi / gear.teeth - own
        return GearSize(gear.teeth, pair.normal_module, diameter, pair.face_width, angle, space, roll, gear.internal)

    def contact_name(self, contact: int) -> str:
        """Name of a contact in messages."""
        block, place = divmod(contact, self.pairs * self.slices)
        pair, part = divmod(place, self.slices)
        side = ("driving", "back")[block]
        return f"slice {part + 1} of {self.slices} of the {side} flanks, pair {pair + 1} of {self.pairs}"

    def points(self, theta: Scalar, side: int) -> SlicePoints:
        """Slices of the pairs of teeth that may touch on one side, 1 or -1, at an angle of the pinion [rad]."""
        return slice_points(self.pair, theta, side, self.pairs, self.slices, self.corners)

    def contacts(self, theta: Scalar, back: bool) -> "MeshContacts":
        """The contacts at an angle of the pinion [rad], with the back flanks if asked for."""
        sides = (1, -1) if back else (1,)
        at = jax.tree.map(lambda *parts: jnp.stack(parts), *(self.points(theta, side) for side in sides))
        return MeshContacts(self, theta, at, sides)


class MeshContacts(eqx.Module):
    """Contacts of a mesh at one angle of its pinion, in the order side, pair, slice.

    Args:
        mesh: the gears.
        theta: angle of the pinion [rad].
        at: the slices, each array with the sides first.
        sides: the sides, 1 for driving and -1 for back flanks.
    """

    mesh: HelicalMesh
    theta: Scalar
    at: SlicePoints
    sides: tuple[int, ...] = eqx.field(static=True)

    @property
    def number(self) -> int:
        """Number of contacts."""
        return len(self.sides) * self.mesh.pairs * self.mesh.slices

    @property
    def slices(self) -> Slices:
        """Places of the contacts on the plane of action."""
        return Slices(self.mesh.pair, self.at.roll, self.at.across, self.at.share)

    @property
    def _side(self) -> Array:
        return jnp.asarray(self.sides, self.theta.dtype)[:, None, None]

    def _all(self, part: Array) -> Array:
        """A number of the contacts as an array of the shape (contact,)."""
        return jnp.broadcast_to(part, self.at.across.shape).ravel()

    def gap(self, moving: bool) -> Float[Array, " contact"]:
        """Gaps of ideal flanks along their normal [m]; ``moving`` leaves out distances from the path of contact."""
        pair = self.mesh.pair
        gap = jnp.cos(pair.base_helix_angle) * (self.at.gap + jnp.where(self._side < 0, pair.backlash, 0.0))
        if not moving or self.mesh.corners:
            gap = gap + self.at.beyond  # slices off the path of contact stay open
        return gap.ravel()

    @property
    def lever(self) -> Float[Array, " contact"]:
        """Change of overlap per turn of the wheel ahead of its ideal position [m/rad]."""
        pair = self.mesh.pair
        return self._all(-self._side * jnp.cos(pair.base_helix_angle) * pair.gears[1].base_radius)

    def column(self, number: int, way: str) -> Float[Array, " contact"]:
        """Change of overlap per displacement of the pinion (0) or the wheel (1) along one of `WAYS` [m/m, m/rad].

        The pinion closes a contact by moving along its normal.
        """
        pair, side, at = self.mesh.pair, self._side, self.at
        alpha, beta = pair.working_pressure_angle, pair.base_helix_angle
        flat, lean = jnp.cos(beta), jnp.sin(beta)
        normal = jnp.sin(alpha) * flat, side * jnp.cos(alpha) * flat, -side * lean
        sign = -1.0 if number else 1.0
        if way in ("x", "y", "z"):
            return self._all(sign * normal[("x", "y", "z").index(way)])
        base = pair.gears[0].base_radius
        along = at.roll[0]
        arm = base * jnp.cos(alpha) + along * jnp.sin(alpha), side * (along * jnp.cos(alpha) - base * jnp.sin(alpha))
        if number:
            arm = arm[0] + (pair.centre_distance if pair.internal else -pair.centre_distance), arm[1]
        arm = *arm, at.across
        first, second = {"rx": (1, 2), "ry": (2, 0), "rz": (0, 1)}[way]
        turned = arm[first] * normal[second] - arm[second] * normal[first]
        # an external wheel turns the other way
        ahead = -1.0 if way == "rz" and number and not pair.internal else 1.0
        return self._all(sign * ahead * turned)

    def view(self, number: int) -> BodyView:
        """View of a displacement fixed on the pinion (0) or the wheel (1), from the normals of the flanks."""
        pair, side, at = self.mesh.pair, self._side, self.at
        gear, roll = pair.gears[number], at.roll[number]
        # a displacement e at the phase p has the component e sin(turn + p +- alpha) along the line of action
        outer = number == 1 and not pair.internal
        turn = self.theta * (self.mesh.ratio if number else 1.0)
        place = (-side if outer else side) * pair.working_pressure_angle
        normal = jnp.cos(pair.base_helix_angle)
        away = normal if number else -normal  # change of the gap per displacement along the normal
        # a back flank of the pinion faces the next tooth of the wheel
        tooth = at.tooth + np.array([int(one < 0) for one in self.sides])[:, None] if number else at.tooth
        tooth = self._all(jnp.mod(tooth, gear.teeth)[..., None])
        slant = jnp.arctan(roll / gear.base_radius)
        outward = self._all(normal * jnp.sin(slant) * (1.0 if number and pair.internal else -1.0))
        around, seen = self._all(away * side * jnp.cos(slant)), self._all(away * side)
        eta = tooth.astype(roll.dtype) * (2 * math.pi / gear.teeth)
        path = pair.contact_path
        flank = ProfilePlace(
            to_tip=gear.from_tip(roll, gear.base_radius * gear.tip_roll).ravel(),
            length=path.end - path.begin,
            across=at.across.ravel(),
            width=pair.face_width,
            normal=normal,
            roll=roll.ravel(),
            side=self._all(side),
            # a turn moves a flank by r_b along the base tangent, and by r along the reference circle
            ahead=seen * (2 * gear.base_radius / pair.reference_diameters[number]),
        )
        rim = Rim(eta, outward, around, gear.teeth, tooth)
        return BodyView(turn, self._all(place), seen, rim, flank=flank)


def with_tips(made: Callable[..., InvolutePair], tips: tuple[Scalar | None, Scalar | None]) -> InvolutePair:
    """A pair with the tip diameters that are given [m]; the others follow from its rack and profile shifts.

    Numbers that are known now go through one program: compiled one by one, its operations take a second.
    """
    return (_with_tips_compiled if is_concrete((made, tips)) else _with_tips)(made, tips)


def _with_tips(made: Callable[..., InvolutePair], tips: tuple[Scalar | None, Scalar | None]) -> InvolutePair:
    plain = made()
    if tips == (None, None):
        return plain
    each = zip(tips, plain.tip_diameters, strict=True)
    return made(tip_diameters=[own if given is None else given for given, own in each])


_with_tips_compiled = eqx.filter_jit(_with_tips)


def key_of_gears(key: str) -> str:
    """Name of a parameter of a gear set, from its name in `InvolutePair`."""
    base, _, place = key.partition("[")
    own = {"tip_diameters": "tip_diameter", "profile_shifts": "shift"}.get(base)
    return key if own is None else f"{('pinion', 'wheel')[int(place[0])]}_{own}"


FOLLOWS = {
    "tip_diameter": "the diameter follows from rack, normal module, teeth, profile shift and helix angle",
    "centre_distance": "the distance follows from normal module, teeth, profile shifts and helix angle",
}


def fault_of_gears(fault: Fault, gears: Any, mesh: str = "") -> ParameterError:
    """The error of a fault of two gears; it tells where a number comes from that nobody gave.

    Args:
        fault: the fault, whose parameter is one of `InvolutePair`.
        gears: the gear set.
        mesh: words that name the mesh, if there are several.
    """
    key, shown, words = key_of_gears(fault[0]), *fault[1:]
    given = getattr(gears, key.partition("[")[0], None)
    if given is None or np.size(given) == 0:
        origin = next((origin for name, origin in FOLLOWS.items() if key.endswith(name)), "")
        words = f"{words} ({origin})" if origin else words
    return ParameterError(key, shown, mesh + words)


def pairs_of_teeth(pair: InvolutePair, tip_contact: str) -> tuple[int, int]:
    """Number of pairs of teeth that touch at once, and number of pairs to model, with a margin for other designs.

    Args:
        pair: the gears, with concrete (not traced) numbers.
        tip_contact: what happens at the ends of the path of contact, a key of `MARGIN`.
    """
    ratio, most = float(pair.total_contact_ratio), min(pair.teeth)
    touching, looked_at = (math.floor(ratio + margin) + 1 for margin in (-ROUNDING, MARGIN[tip_contact]))
    return min(touching, most), min(looked_at, most)


@functools.cache  # analyses ask for the layout at each call
def numbers_of_slices(own: int) -> list[int]:
    """Fewer slices than a face has, its own number, and twice as many."""
    return sorted({max(1, own // 4), max(1, own // 2), own, min(2 * own, MOST_SLICES)})


def helical_layout(pairs: tuple[int, ...], slices: int, back: bool) -> Layout:
    """Layout of meshes, each with its own number of pairs, in the order side, mesh, pair, slice (`slices.by_side`).

    Every flank is a pair of its own, because driving and back flanks touch on different teeth.
    """
    sides = (1, -1) if back else (1,)
    blocks = [(side, mesh) for side in sides for mesh, number in enumerate(pairs) for _ in range(number)]
    side, mesh = (tuple(block[i] for block in blocks for _ in range(slices)) for i in (0, 1))
    pair = tuple(pair for pair in range(len(blocks)) for _ in range(slices))
    return Layout(side, pair, mesh, slices) if len(pairs) > 1 else Layout(side, pair, across=slices)
