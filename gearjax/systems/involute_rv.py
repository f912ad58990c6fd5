"""Involute RV reducer: external gears on cranks in a fixed internal gear, few teeth fewer (Yang, Tang, Liang 2019)."""

import dataclasses
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
from gearjax.sketch import Sketch, SketchedBody, on_cranks
from gearjax.structure import Orbit
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Bool, Float, Int, Number, Scalar

# roll angle [rad] between the tips of two flanks that do not face each other, beyond which the pair is not followed
APART = 0.05
MOST_POINTS = 100


class Candidates(NamedTuple):
    """Points on flanks that may touch.

    The points are in blocks: first the driving flanks of each external gear, then the back flanks of each.

    Args:
        pair: the external gear in the internal gear.
        side: side of the flanks, 1 (driving) or -1 (back), shape (block, 1, 1).
        tooth: number of each pair; pair 0 is in the first space of the ring, shape (block, pair).
        points: points of the flanks, shape (block, pair, point).
        normals: sine and cosine of the angle from the direction across the throw to the normal of the flank, first of
            the external gear and then of the internal gear, shape (block, pair, point).
        share: change of the gap per displacement of the internal gear along the normal of its flank, shape (block,
            pair, point) [-].
        shared: length of the flanks that face each other, shape (block, pair) [m].
        apart: distance between the tips of two flanks that do not face each other, else zero, shape (block, pair) [m].
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
    """External involute gears that roll in a fixed internal gear, with a few teeth fewer, and turn the output.

    The flanks of both gears have nearly the same curvature. They nearly touch over many teeth, and under torque several
    pairs share the load. The candidates are the pairs near the line of action. Candidate i always represents every
    ``pairs``-th tooth; it changes to the next of these teeth when it is furthest from touching. A pair has one contact
    point, on the line of action or at the end of the flanks nearest to that line, or a grid of points over flank and
    face. A contact force acts along the tangent of the base circle, so that the lever is ``r_b1`` while the crank is
    held (Yang et al. 2019, eq. 7). A gap is the base radius times the angle between the flanks at equal radius. The
    driving flanks of ideal gears just touch. The backlash follows from the centre distance and the profile shifts; the
    section ``backlash`` adds to it.

    With a first stage, the input is its sun, which turns the cranks through planet wheels on the output, as in an RV
    reducer. The external gears are spaced evenly around the crank: gear i is where gear 1 will be ``(i - 1) / gears``
    of a turn of the crank later.

    Bodies: ``gear_1``, ...: the run-out turns with the external gear; its phase is counted from the throw while the
    throw points at the first space of the ring. ``ring``: the internal gear, which is fixed; its phase is counted from
    that space. These phases count in the direction in which the crank turns, that of an external gear too, which turns
    against it. ``throw``: error of the throw of all cranks; phase 0 lengthens the throw. ``sun``, ``planet``: gears of
    the first stage; the phase is counted from the line of action of that stage, and a run-out whose sine is positive
    turns the cranks ahead. Teeth are counted from 0, beginning with the pair in the first space, in the direction in
    which the crank turns; ``around`` is positive in the same direction.

    An external gear may have a support on its cranks. Its x points along the throw. Its y points across the throw, in
    the direction in which the crank turns.

    Args:
        external_teeth: tooth number of the external gears.
        internal_teeth: tooth number of the internal gear, counted as positive.
        module: module of the rack [m].
        pressure_angle: pressure angle of the rack [rad].
        external_shift: profile shift of the external gears, in modules; a positive one moves the teeth outwards [-].
        internal_shift: profile shift of the internal gear, in modules; a positive one moves the teeth outwards [-].
        external_addendum: addendum of the external gears from the shifted reference circle, in modules [-].
        internal_addendum: addendum of the internal gear from the shifted reference circle, in modules [-].
        centre_distance: centre distance of external and internal gear, the throw of the cranks [m].
        input_speed: speed of the sun, or of the crank if there is no first stage [rad/s].
        external_dedendum: dedendum of the external gears from the shifted reference circle, in modules [-].
        internal_dedendum: dedendum of the internal gear from the shifted reference circle, in modules [-].
        gears: number of external gears.
        pairs: number of candidate pairs per flank and external gear. It must be larger than the number of pairs that
            carry the highest torque; `transmission_error` warns if the outermost candidates carry. With 1, each gear
            carries on a single pair, without a warning.
        profile_points: number of candidate contacts of each pair along the profile.
        face_points: number of candidate contacts of each pair across the face.
        sun_teeth: tooth number of the sun of the first stage; give all numbers of the first stage or none.
        planet_teeth: tooth number of the planet wheels of the first stage; give all numbers of that stage or none.
        first_stage_module: module of the first stage; give all numbers of that stage or none [m].
        first_stage_pressure_angle: pressure angle of the rack of the first stage [rad].

    Raises:
        ParameterError: a value is not physical, or the gears do not fit into each other.
    """

    kind: ClassVar[str] = "involute_rv"
    size_of_teeth: ClassVar[str] = "module"
    has_places: ClassVar[bool] = True
    by_constant_modes: ClassVar[bool] = True
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
    profile_points: int = count(default=1, at_most=MOST_POINTS)
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
        """The external gear in the internal gear."""
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
        """Turns of the input per turn of the output: ``1 + (z_p / z_s) z_2 / (z_2 - z_1)`` with a first stage,
        ``z_1 / (z_2 - z_1)`` without one."""
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
        # the output turns against the crank; with a first stage the crank turns along with the output
        return dict.fromkeys(self.coordinates, Orbit(self.orders["crank"], self.centre_distance, -self.with_output))

    @property
    def _exact_orders(self) -> Mapping[str, Fraction]:
        crank = Fraction(self.external_teeth, self.internal_teeth - self.external_teeth) / self.ratio
        orders = {
            "output": 1 / self.ratio,
            "crank": crank,
            "gear": crank * Fraction(self.internal_teeth, self.external_teeth),  # relative to the throw
            "tooth": crank * self.internal_teeth,  # as "mesh", because steps and samples resolve all orders but "mesh"
            "mesh": crank * self.internal_teeth,
        }
        if self._first_stage is not None:
            orders |= {"sun": 1 - 1 / self.ratio, "planet": (crank + 1 / self.ratio)}  # relative to the output
        return orders

    @property
    def orders(self) -> Mapping[str, float]:
        return {name: float(order) for name, order in self._exact_orders.items()}

    def choices(self) -> Mapping[str, AbstractSystem]:
        own = self.profile_points
        if own == 1:  # one point with a uniform pressure, or a stiffness of the whole pair
            return {}
        numbers = sorted({max(2, (own + 1) // 2), own, min(2 * own - 1, MOST_POINTS)})
        return {f"profile_points = {number}": dataclasses.replace(self, profile_points=number) for number in numbers}

    def contact_name(self, contact: int) -> str:
        each = self.pairs * self.profile_points * self.face_points
        block, place = divmod(contact, each)
        pair = place // (self.profile_points * self.face_points)
        flank = "driving" if block < self.gears else "back"
        return f"the {flank} flank of pair {pair + 1} of {self.pairs} on gear_{block % self.gears + 1}"

    def sketch(self) -> Sketch:
        throws = tuple(2 * math.pi * i / self.gears for i in range(self.gears))
        turns = 1 - self.internal_teeth / self.external_teeth  # of a gear, while the throw turns once
        gears = tuple(SketchedBody(f"gear_{i + 1}", zero=turns * throw) for i, throw in enumerate(throws))
        throw, ring = SketchedBody("throw"), SketchedBody("ring", radius=1.0)
        first = (SketchedBody(name, zero=None) for name in ("sun", "planet") if name in self.bodies)
        return on_cranks(gears, throws, (throw, ring, *first))

    @property
    def cycle(self) -> float:
        return 2 * math.pi * math.lcm(*(order.denominator for order in self._exact_orders.values()))

    @property
    def with_output(self) -> Scalar:
        """Turns of the cranks per turn of the output while the input is held: ``1 + z_s / z_p``, 0 without a first
        stage."""
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
        # middle of the range of candidates, counted in spaces of the ring, and the tooth that each candidate represents
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
        # length of an involute between two roll angles
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
        # beyond the tips the gap grows steadily: a jump would make an interpolation of the gaps ring
        gap = self._each(jnp.where(at.apart[..., None] > 0, jnp.maximum(gap, 0.0) + at.apart[..., None], gap))
        views = {body: self._view(body, theta, at) for body in request.bodies}
        mesh = jnp.broadcast_to(self.orders["mesh"] * theta, (at.tooth.size,)) if request.mesh else None
        return Pose(theta, jacobian, gap, views, mesh, places=self._places(at) if request.places else None)

    def outermost(self, theta: Scalar, request: Request) -> Bool[Array, " contact"] | None:
        """Points of the first and the last candidate pair of each flank; ``None`` if all pairs are modelled, or one.

        A single candidate pair is a deliberate choice of the user, which needs no warning.
        """
        if self.pairs == 1 or self.pairs >= self.external_teeth:
            return None
        tooth = self.candidates(theta, request.back).tooth
        ends = (tooth == tooth.min(axis=1, keepdims=True)) | (tooth == tooth.max(axis=1, keepdims=True))
        return jnp.repeat(ends.ravel(), self.profile_points * self.face_points)

    def _each(self, of_points: Array) -> Array:
        """One value per contact from one value per point of the profile."""
        along = of_points.ravel()
        if self.face_points == 1:
            return along
        return jnp.broadcast_to(along[:, None], (along.size, self.face_points)).ravel()

    def _throws(self, sides: int) -> np.ndarray:
        """Angle from the throw of the first gear to the throw of the gear of each block [rad]."""
        return np.tile(2 * np.pi * np.arange(self.gears) / self.gears, sides)

    def _own(self, body: str, at: Candidates) -> Float[Array, "block one one"]:
        """One in the blocks of an external gear, zero in the blocks of the other gears."""
        blocks = np.arange(at.tooth.shape[0]) % self.gears == int(body.removeprefix("gear_")) - 1
        return jnp.asarray(blocks, at.side.dtype)[:, None, None]

    def _places(self, at: Candidates) -> Places:
        pair = at.pair
        radii = pair.external.radius_at(at.points.roll[0]), pair.internal.radius_at(at.points.roll[1])
        face = jnp.linspace(-0.5, 0.5, self.face_points) if self.face_points > 1 else jnp.zeros(1)
        tooth = at.side[..., 0] * at.tooth.astype(at.side.dtype)  # back flanks are given as their mirror image
        return Places((pair.external, pair.internal), radii, tooth, at.shared, face.astype(tooth.dtype))

    def _view(self, body: str, theta: Scalar, at: Candidates) -> BodyView:
        """View of a displacement fixed on a body, from the normals of the flanks."""
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
        # the flanks of an external gear move with its centre, so that the normals of these flanks count
        own = jnp.broadcast_to(self._own(body, at), share.shape)
        seen = -own
        of_teeth = self._teeth(pair.external, at, at.points.roll[0], seen, own if self.gears > 1 else None)
        turns = self.internal_teeth / self.external_teeth
        return self._seen(-turns * crank, turns, at, 0, at.side * seen, **of_teeth)

    def _seen(
        self, turn: Scalar, turns: float, at: Candidates, number: int, influence: Array, **of_teeth: Any
    ) -> BodyView:
        """View of a displacement fixed on a body.

        A displacement at the angle p from the throw has the component sin(towards + p) along a driving normal and
        sin(towards - p) along a back normal: side * sin(side * towards + p).

        Args:
            turn: angle of the body relative to the throw of the first gear [rad].
            turns: turns of the body, backwards, per turn from the throw of one gear to the throw of another.
            number: gear whose normals count, 0 for the external and 1 for the internal gear.
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

    def _teeth(
        self, gear: InvoluteGear, at: Candidates, roll: Array, seen: Array, own: Array | None = None
    ) -> dict[str, Any]:
        """Views of single teeth of a gear; the radius of a tooth is at the pressure angle from its flank.

        Args:
            own: one at the contacts of this gear, zero at those of the other gears; ``None`` if it has all contacts.
        """
        touching = None if own is None else self._each(own)
        tooth = jnp.broadcast_to(jnp.mod(at.tooth, gear.teeth)[..., None], roll.shape)
        place, cosine = tooth.astype(roll.dtype) * (2 * math.pi / gear.teeth), 1 / jnp.sqrt(1 + roll * roll)
        outward, around = seen * roll * cosine, at.side * seen * cosine
        rim = Rim(self._each(place), self._each(outward), self._each(around), gear.teeth, self._each(tooth), touching)
        number = int(gear.internal)
        to_tip = at.pair.base_radii[number] * gear.from_tip(roll, at.pair.tip_rolls[number])
        length = at.pair.contact_ratio * at.pair.base_pitch
        return {"rim": rim, "flank": ProfilePlace(self._each(to_tip), length)}


@functools.cache  # analyses ask for the layout at each call
def _layout(gears: int, pairs: int, profile_points: int, face_points: int, back: bool) -> Layout:
    """Layout in which every flank is a pair of its own: driving and back flanks of a gear touch on different teeth."""
    sides, points = (1, -1) if back else (1,), profile_points * face_points
    side = tuple(side for side in sides for _ in range(gears * pairs * points))
    pair = tuple(pair for pair in range(len(sides) * gears * pairs) for _ in range(points))
    return Layout(side, pair, across=face_points)
