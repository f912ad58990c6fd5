"""Involute RV reducer: external gears on cranks in a fixed internal gear, few teeth fewer (Yang, Tang, Liang 2019)."""

import functools
import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, is_concrete, nearest
from gearjax.contact import BodyView, Layout, Places, Pose, ProfilePlace, Request, Rim
from gearjax.geometry.first_stage import FirstStage
from gearjax.geometry.internal_checks import faults
from gearjax.geometry.internal_pair import FlankPoints, InternalPair, candidate_rolls
from gearjax.geometry.involute import InvoluteGear
from gearjax.parameters import angle, check_parameters, count, length, number
from gearjax.structure import Orbit
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Bool, Float, Int, Number, Scalar

APART = 0.05  # rad of roll between tips of flanks that face each other nowhere, beyond which they are not followed


class Candidates(NamedTuple):
    """Points on flanks that may touch, in blocks: of each external gear its driving flanks, then of each its back ones.

    Args:
        pair: the gears in each other.
        side: of the flanks, 1 or -1, shape (block, 1, 1).
        tooth: number of each pair, counted on from the one in the direction of the throw at its start, shape (block,
            pair).
        points: shape (block, pair, point).
        normals: sine and cosine of the angle from across the throw to the normal of the external gear's flank, and of
            the internal one's, shape (block, pair, point).
        share: change of the gap per displacement of the internal gear along the normal of its flank, shape (block,
            pair, point) [-].
        shared: length of the flanks that face each other, shape (block, pair) [m].
        apart: distance between the tips of those that face each other nowhere, else zero, shape (block, pair) [m].
    """

    pair: InternalPair
    side: Array
    tooth: Int[Array, "block pair"]
    points: FlankPoints
    normals: tuple[tuple[Array, Array], tuple[Array, Array]]
    share: Array
    shared: Array
    apart: Array


class InvoluteRV(AbstractSystem):
    """External involute gears that roll in a fixed internal gear, some teeth fewer, and turn the output.

    Hardly differently curved flanks nearly touch over many teeth, and under torque several pairs share the load. The
    candidates are those pairs about the line of action that may: contact i stays with every ``pairs``-th tooth and goes
    on to the next of these where it is furthest from touching. Each pair is one point, on the line of action or at the
    end of the flanks nearest to it, or a grid over flank and face. A contact force acts along the tangent of the base
    circle, so that the lever is ``r_b1`` while the crank is held (Yang et al. 2019, eq. 7); gaps are the base radius
    times the angle between flanks at equal radius. Driving flanks of ideal gears just touch; the backlash is that of
    the centre distance and the profile shifts, and the section ``backlash`` adds to it.

    With a first stage the input is its sun, which turns the cranks through planet wheels on the output, as those of an
    RV reducer. External gears sit evenly around the crank: gear i is where gear 1 is ``(i - 1) / gears`` of a turn of
    the crank later.

    Bodies: ``gear_1``, ...: run-out turns with the external gear, phase counted from the throw while the throw points
    at the ring's first space. ``ring``: the internal gear, fixed, counted from that space. ``throw``: of all cranks,
    phase 0 lengthens it. ``sun``, ``planet``: of the first stage, counted from its line of action; a run-out whose sine
    is positive turns the cranks ahead. Teeth are counted from 0, from the pair in that space, in the crank's sense,
    in which ``around`` is positive too.

    An external gear may have a support on its cranks: x along the throw, y across it, ahead.

    Args:
        external_teeth, internal_teeth: tooth numbers.
        module, pressure_angle: of the rack [m], [rad].
        external_shift, internal_shift: profile shifts, in modules; positive ones move teeth outwards [-].
        external_addendum, internal_addendum: in modules, from the shifted reference circle [-].
        centre_distance: throw of the cranks [m].
        input_speed: of the sun, or of the crank without a first stage [rad/s].
        external_dedendum, internal_dedendum: in modules [-].
        gears: number of external gears.
        pairs: candidates of each flank and gear; more than under the highest torque carry: `transmission_error` warns
            where the outermost ones do.
        profile_points, face_points: candidates of each pair along the profile and across the face.
        sun_teeth, planet_teeth, first_stage_module: of the first stage; all or none of them.
        first_stage_pressure_angle: [rad].

    Raises:
        ParameterError: a value is not physical, or the gears do not fit into each other.
    """

    kind: ClassVar[str] = "involute_rv"
    has_places: ClassVar[bool] = True
    has_clearance: ClassVar[bool] = True

    external_teeth: int = count(at_least=5, at_most=2000, example=236)
    internal_teeth: int = count(at_least=6, at_most=2001, example=240)
    module: Number = length(at_least=1e-6, at_most=1.0, example="0.58 mm")
    pressure_angle: Number = angle(above=0.0, below=math.pi / 4, example="20 deg")
    external_shift: Number = number(units.RATIO, at_least=-5.0, at_most=5.0, example=-0.4)
    internal_shift: Number = number(units.RATIO, at_least=-5.0, at_most=5.0, example=0.55028)
    external_addendum: Number = number(units.RATIO, at_least=0.01, at_most=3.0, example=0.6328)
    internal_addendum: Number = number(units.RATIO, at_least=0.01, at_most=3.0, example=1.0)
    centre_distance: Number = length(at_least=1e-6, at_most=10.0, example="1.5 mm")
    input_speed: Number = number(units.ANGULAR_SPEED, at_least=1e-9, at_most=1e6, example="885 rpm")
    external_dedendum: Number = number(units.RATIO, at_least=0.01, at_most=3.0, default=1.25)
    internal_dedendum: Number = number(units.RATIO, at_least=0.01, at_most=3.0, default=1.25)
    gears: int = count(default=1, at_most=4)
    pairs: int = count(default=15, at_most=200)
    profile_points: int = count(default=1, at_most=100)
    face_points: int = count(default=1, at_most=100)
    sun_teeth: int | None = count(default=None, example=22)
    planet_teeth: int | None = count(default=None, example=60)
    first_stage_module: Number | None = length(at_least=1e-6, at_most=1.0, default=None, example="1.25 mm")
    first_stage_pressure_angle: Number = angle(above=0.0, below=math.pi / 4, default=20 * units.deg)

    def __check_init__(self):
        check_parameters(self)
        _ = self._first_stage
        if self.external_teeth >= self.internal_teeth:
            words = f"must be below internal_teeth ({self.internal_teeth})"
            raise ParameterError("external_teeth", self.external_teeth, words)
        if self.pairs > self.external_teeth:
            raise ParameterError("pairs", self.pairs, f"must be at most external_teeth ({self.external_teeth})")
        if is_concrete(self.pair):
            for key, shown, words in faults(self.pair):
                raise ParameterError(key, shown, words)

    @property
    def pair(self) -> InternalPair:
        """The gears in each other."""
        shared = self.module, self.pressure_angle
        external = InvoluteGear(
            self.external_teeth, *shared, self.external_shift, self.external_addendum, self.external_dedendum
        )
        internal = InvoluteGear(
            self.internal_teeth, *shared, self.internal_shift, self.internal_addendum, self.internal_dedendum, True
        )
        return InternalPair(external, internal, self.centre_distance)

    @property
    def _first_stage(self) -> FirstStage | None:
        numbers = self.sun_teeth, self.planet_teeth, self.first_stage_module, self.first_stage_pressure_angle
        return FirstStage.of(*numbers)

    @property
    def ratio(self) -> Fraction:
        """Turns of the input per turn of the output: ``1 + (z_p / z_s) z_2 / (z_2 - z_1)`` with a first stage, else
        ``z_1 / (z_2 - z_1)``."""
        first, difference = self._first_stage, self.internal_teeth - self.external_teeth
        if first is None:
            return Fraction(self.external_teeth, difference)
        return first.ratio(Fraction(self.internal_teeth, difference))

    @property
    def bodies(self) -> tuple[str, ...]:
        first = () if self._first_stage is None else ("sun", "planet")
        return *(f"gear_{i + 1}" for i in range(self.gears)), "throw", "ring", *first

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return {f"gear_{i + 1}": ("x", "y") for i in range(self.gears)}

    @property
    def orbits(self) -> Mapping[str, Orbit]:
        # the output turns against the crank, which turns back with it
        return dict.fromkeys(self.coordinates, Orbit(self.orders["crank"], self.centre_distance, -self.with_output))

    @property
    def _exact_orders(self) -> Mapping[str, Fraction]:
        crank = Fraction(self.external_teeth, self.internal_teeth - self.external_teeth) / self.ratio
        orders = {
            "output": 1 / self.ratio,
            "crank": crank,
            "gear": crank * Fraction(self.internal_teeth, self.external_teeth),  # seen from the throw
            "tooth": crank * self.internal_teeth,  # next to "mesh": steps and samples resolve all orders but that one
            "mesh": crank * self.internal_teeth,
        }
        if self._first_stage is not None:
            orders |= {"sun": 1 - 1 / self.ratio, "planet": (crank + 1 / self.ratio)}  # seen from the output
        return orders

    @property
    def orders(self) -> Mapping[str, float]:
        return {name: float(order) for name, order in self._exact_orders.items()}

    def contact_name(self, contact: int) -> str:
        each = self.pairs * self.profile_points * self.face_points
        block, place = divmod(contact, each)
        pair = place // (self.profile_points * self.face_points)
        flank = "driving" if block < self.gears else "back"
        return f"the {flank} flank of pair {pair + 1} of {self.pairs} on gear_{block % self.gears + 1}"

    @property
    def cycle(self) -> float:
        return 2 * math.pi * math.lcm(*(order.denominator for order in self._exact_orders.values()))

    @property
    def with_output(self) -> Scalar:
        """Turn of the cranks per turn of the output while the input is held, ``1 + z_s / z_p`` with a first stage."""
        first = self._first_stage
        return jnp.asarray(0.0 if first is None else first.with_output, self.module.dtype)

    def layout(self, request: Request) -> Layout:
        return _layout(self.gears, self.pairs, self.profile_points, self.face_points, request.back)

    def candidates(self, theta: Scalar, back: bool) -> Candidates:
        """Points on flanks that may touch at an input angle [rad]."""
        pair, sides = self.pair, (1, -1) if back else (1,)
        side = jnp.asarray(np.repeat(sides, self.gears), theta.dtype)[:, None]
        crank = (self.orders["crank"] * theta + jnp.asarray(self._throws(len(sides)), theta.dtype))[:, None]
        middle = pair.space_of_roll(pair.middle)
        # the window's middle in spaces of the ring, and the pairs in it, each its own tooth of every ``pairs``
        spaces = (side * middle + crank) * (self.internal_teeth / (2 * math.pi))
        slots = jnp.arange(self.pairs, dtype=theta.dtype)[None]
        tooth = slots + self.pairs * jnp.round((spaces - slots) / self.pairs)
        roll = pair.roll_of_space(middle + side * (tooth - spaces) * (2 * math.pi / self.internal_teeth))
        begin, end = pair.ends(roll)
        apart = pair.base_radii[0] * jnp.maximum(begin - end, 0.0)
        followed = begin - end < APART
        roll, begin, end = (
            jnp.where(followed, part, other)
            for part, other in zip((roll, begin, end), (pair.middle, *pair.ends(pair.middle)), strict=True)
        )
        beyond = candidate_rolls(begin.ravel(), end.ravel(), self.profile_points).reshape(*roll.shape, -1)
        points = pair.points(jnp.broadcast_to(roll[..., None], beyond.shape), beyond)
        # along a flank, from one roll angle to another
        shared = 0.5 * pair.base_radii[0] * jnp.maximum((roll + end) ** 2 - (roll + begin) ** 2, 0.0)
        first, second = (turn.towards(pair.line_of_action) for turn in points.beyond)
        share = pair.share(points)
        return Candidates(pair, side[..., None], tooth.astype(int), points, (first, second), share, shared, apart)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        at = self.candidates(theta, request.back)
        pair = at.pair
        sine, cosine = at.normals[1]
        lever = pair.base_radii[0] + self.with_output * self.centre_distance * at.share * cosine
        columns = [-at.side * lever]
        for coordinate in request.coordinates:
            body, _, direction = coordinate.partition(".")
            along = sine if direction == "x" else at.side * cosine
            columns.append(self._own(body, at) * at.share * along)
        jacobian = jnp.stack([self._each(column) for column in columns], axis=1)
        gap = at.points.gap + jnp.where(at.side < 0, pair.backlash, 0.0)
        # tips that part: no jump where flanks begin to face each other, which would ring in what is interpolated
        gap = self._each(jnp.where(at.apart[..., None] > 0, jnp.maximum(gap, 0.0) + at.apart[..., None], gap))
        views = {body: self._view(body, theta, at) for body in request.bodies}
        mesh = jnp.broadcast_to(self.orders["mesh"] * theta, (at.tooth.size,)) if request.mesh else None
        return Pose(theta, jacobian, gap, views, mesh, places=self._places(at) if request.places else None)

    def outermost(self, theta: Scalar, request: Request) -> Bool[Array, " contact"] | None:
        """Points of the first and the last candidate pair of each flank; ``None`` of all pairs, and of a single one,
        which is a choice."""
        if self.pairs == 1 or self.pairs >= self.external_teeth:
            return None
        tooth = self.candidates(theta, request.back).tooth
        ends = (tooth == tooth.min(axis=1, keepdims=True)) | (tooth == tooth.max(axis=1, keepdims=True))
        return jnp.repeat(ends.ravel(), self.profile_points * self.face_points)

    def _each(self, of_points: Array) -> Array:
        """One value per contact, from one per point of the profile."""
        along = of_points.ravel()
        if self.face_points == 1:
            return along
        return jnp.broadcast_to(along[:, None], (along.size, self.face_points)).ravel()

    def _throws(self, sides: int) -> np.ndarray:
        """Angle of the throw of each block's gear from that of the first [rad]."""
        return np.tile(2 * np.pi * np.arange(self.gears) / self.gears, sides)

    def _own(self, body: str, at: Candidates) -> Float[Array, "block one one"]:
        """One in the blocks of an external gear, zero in those of the others."""
        blocks = np.arange(at.tooth.shape[0]) % self.gears == int(body.removeprefix("gear_")) - 1
        return jnp.asarray(blocks, at.side.dtype)[:, None, None]

    def _places(self, at: Candidates) -> Places:
        pair = at.pair
        radii = pair.external.radius_at(at.points.roll[0]), pair.internal.radius_at(at.points.roll[1])
        face = jnp.linspace(-0.5, 0.5, self.face_points) if self.face_points > 1 else jnp.zeros(1)
        tooth = at.side[..., 0] * at.tooth.astype(at.side.dtype)  # of back flanks as their mirror image
        return Places((pair.external, pair.internal), radii, tooth, at.shared, face.astype(tooth.dtype))

    def _view(self, body: str, theta: Scalar, at: Candidates) -> BodyView:
        """How a displacement fixed on a body is seen from the normals."""
        if body not in self.bodies:
            raise ParameterError("body", body, nearest(body, self.bodies))
        pair, still, share = at.pair, jnp.zeros_like(theta), at.share
        if body in ("sun", "planet"):
            first = self._first_stage
            assert first is not None
            ahead = -at.side * self.centre_distance * share * at.normals[1][1] / first.planet_radius
            return BodyView(self.orders[body] * theta, self._each(jnp.zeros_like(share)), self._each(ahead))
        if body == "throw":
            return self._seen(still, 0.0, at, 1, -at.side * share)
        crank = self.orders["crank"] * theta
        if body == "ring":
            of_teeth = self._teeth(pair.internal, at, at.points.roll[1], share)
            return self._seen(-crank, 1.0, at, 1, at.side * share, **of_teeth)
        # its flanks move beside its centre: it is the normals of these that count
        seen = jnp.broadcast_to(-self._own(body, at), share.shape)
        of_teeth = self._teeth(pair.external, at, at.points.roll[0], seen)
        turns = self.internal_teeth / self.external_teeth
        return self._seen(-turns * crank, turns, at, 0, at.side * seen, **of_teeth)

    def _seen(
        self, turn: Scalar, turns: float, at: Candidates, number: int, influence: Array, **of_teeth: Any
    ) -> BodyView:
        """A displacement at the angle p from the throw has the part sin(towards + p) along a driving normal, and
        sin(towards - p) along a back one: side * sin(side * towards + p).

        Args:
            turn: of the body, seen from the throw of the first gear [rad].
            turns: of the body back per turn from one gear's throw to another's.
            number: whose normals count, 0 for the external gear's, 1 for the internal one's.
        """
        sine, cosine = at.normals[number]
        towards = at.pair.operating_pressure_angle + at.points.beyond[number].angle
        sine, place = at.side * sine, at.side * towards
        if self.gears > 1:
            back = self._throws(at.tooth.shape[0] // self.gears)[:, None, None] * turns
            by = [jnp.asarray(part, place.dtype) for part in (np.sin(back), np.cos(back), back)]
            sine, cosine, place = sine * by[1] - cosine * by[0], cosine * by[1] + sine * by[0], place - by[2]
        sine, cosine, place, influence = (self._each(part) for part in (sine, cosine, place, influence))
        return BodyView(turn, place, influence, of_place=(sine, cosine), **of_teeth)

    def _teeth(self, gear: InvoluteGear, at: Candidates, roll: Array, seen: Array) -> dict[str, Any]:
        """How single teeth of a gear are seen: their radius stands at the pressure angle from the flank."""
        tooth = jnp.broadcast_to(jnp.mod(at.tooth, gear.teeth)[..., None], roll.shape)
        place, cosine = tooth.astype(roll.dtype) * (2 * math.pi / gear.teeth), 1 / jnp.sqrt(1 + roll * roll)
        outward, around = seen * roll * cosine, at.side * seen * cosine
        rim = Rim(self._each(place), self._each(outward), self._each(around), gear.teeth, self._each(tooth))
        number = int(gear.internal)
        to_tip = at.pair.base_radii[number] * jnp.abs(at.pair.tip_rolls[number] - roll)
        length = at.pair.contact_ratio * at.pair.base_pitch
        return {"rim": rim, "flank": ProfilePlace(self._each(to_tip), length)}


@functools.cache  # by analyses too, each time that they are called
def _layout(gears: int, pairs: int, profile_points: int, face_points: int, back: bool) -> Layout:
    """Every flank of a pair is a pair of its own: driving and back flanks of a gear touch on different teeth."""
    sides, points = (1, -1) if back else (1,), profile_points * face_points
    side = tuple(side for side in sides for _ in range(gears * pairs * points))
    pair = tuple(pair for pair in range(len(sides) * gears * pairs) for _ in range(points))
    return Layout(side, pair, across=face_points)
