"""An external involute gear inside an internal gear, nearly touching on many teeth: gaps, normals and ends of flanks.

The axes are those of the throw: x points from the centre of the internal gear to the centre of the external gear. The
flanks ahead of the external gear's teeth (counter-clockwise) touch along a line of action that is tangent to both base
circles and has the direction ``(sin alpha_w, cos alpha_w)``. A flank point with the roll angle ``t`` is at

    O + r_b (u(tau) + t n(tau)),   u = (cos tau, sin tau),   n = (-sin tau, cos tau)

and its normal is ``n``; on the line of action ``tau = -alpha_w``. In the ideal motion every pair of teeth would touch
on the line of action if its flanks were long enough. At a roll angle that differs by ``delta`` from this point, flanks
of different base circles separate, over many teeth by micrometres only. The calculation therefore uses offsets from the
point on the line of action, because small differences of offsets are not lost in rounding. The other flanks are the
mirror image about the throw.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.geometry.involute import InvoluteGear, inverse_involute, involute
from gearjax.typing import Array, Float, Scalar

STEPS = 2  # steps of Newton's method for equal radii, which starts within some micrometres
SMALLEST = 1e-12  # lower bound of squares that vanish at the beginning of a flank: the root has no derivative at zero


class Turn(NamedTuple):
    """An angle with functions of it that keep their relative accuracy for small angles; arrays of one shape.

    Args:
        angle: the angle [rad].
        sine: its sine.
        less: one minus its cosine.
        late: the angle minus its sine [rad].
    """

    angle: Array
    sine: Array
    less: Array
    late: Array

    def towards(self, start: tuple[Scalar, Scalar]) -> tuple[Array, Array]:
        """Sine and cosine of the sum of this angle and another one, whose sine and cosine are given."""
        sine, cosine = start
        return sine + (cosine * self.sine - sine * self.less), cosine - (cosine * self.less + sine * self.sine)


@jax.custom_jvp
def turned(angle: Array) -> Turn:
    """The `Turn` of an angle [rad]; its derivatives are calculated from its own numbers."""
    half = 0.5 * angle
    sine, cosine = jnp.sin(half), jnp.cos(half)
    whole, square = 2 * sine * cosine, angle * angle
    series = angle * square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72 * (1 - square / 110))))
    return Turn(angle, whole, 2 * sine * sine, jnp.where(jnp.abs(angle) < 0.5, series, angle - whole))


@turned.defjvp
def _turned_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Turn, Turn]:
    at, way = turned(*primals), tangents[0]
    return at, Turn(way, way - at.less * way, at.sine * way, at.less * way)


class FlankPoints(NamedTuple):
    """Points at which the flanks of pairs of teeth face each other; arrays of one shape.

    Args:
        gap: base radius of the external gear times the angle between the flanks, at equal radius about its centre [m].
        roll: roll angles on the external and on the internal gear [rad].
        beyond: angles ``delta`` of the normals of both flanks from the line of action [rad].
    """

    gap: Array
    roll: tuple[Array, Array]
    beyond: tuple[Turn, Turn]


class InternalPair(eqx.Module):
    """An external gear in an internal gear.

    Args:
        external, internal: the gears, with the same module and pressure angle.
        centre_distance: centre distance [m].

    Attributes:
        base_radii: base radii of the external and of the internal gear [m]. Like the other attributes they are
            calculated only once, because the pose of a gear set uses them many times.
        base_pitch: distance of successive flanks along the line of action [m].
        base_difference: base radius of the internal gear minus base radius of the external gear [m].
        offset: length of roll of the internal gear minus length of roll of the external gear, at a point of the line of
            action [m].
        operating_pressure_angle: operating pressure angle, ``cos alpha_w = (r_b2 - r_b1) / a`` [rad] (ISO 21771).
        tip_rolls: roll angles at the tips of the external and of the internal gear [rad].
        path: roll angles on the external gear at the beginning of the path of contact, at the tip of the internal gear,
            and at its end, at the tip of the external gear [rad].
    """

    external: InvoluteGear
    internal: InvoluteGear
    centre_distance: Scalar
    base_radii: tuple[Scalar, Scalar]
    base_pitch: Scalar
    base_difference: Scalar
    offset: Scalar
    operating_pressure_angle: Scalar
    tip_rolls: tuple[Scalar, Scalar]
    path: tuple[Scalar, Scalar]

    def __init__(self, external: InvoluteGear, internal: InvoluteGear, centre_distance: Scalar):
        self.external, self.internal, self.centre_distance = external, internal, centre_distance
        own, theirs = self.base_radii = external.base_radius, internal.base_radius
        self.base_pitch = jnp.pi * external.module * jnp.cos(external.pressure_angle)
        self.base_difference = 0.5 * (internal.teeth - external.teeth) * self.base_pitch / jnp.pi
        self.offset = jnp.sqrt((centre_distance - self.base_difference) * (centre_distance + self.base_difference))
        self.operating_pressure_angle = jnp.arccos(self.base_difference / centre_distance)
        self.tip_rolls = external.tip_roll, internal.tip_roll
        self.path = (theirs * self.tip_rolls[1] - self.offset) / own, self.tip_rolls[0]

    @property
    def tight_pressure_angle(self) -> Scalar:
        """Operating pressure angle without backlash [rad] (ISO 21771).

        It follows from ``inv alpha_w = inv alpha + 2 tan alpha (x_2 - x_1) / (z_2 - z_1)``.
        """
        angle = self.external.pressure_angle
        return inverse_involute(involute(angle) + jnp.tan(angle) * 2 * self.shift_difference / self.teeth_difference)

    @property
    def tight_centre_distance(self) -> Scalar:
        """Centre distance without backlash [m]; a pair with a shorter centre distance has backlash."""
        return self.base_difference / jnp.cos(self.tight_pressure_angle)

    @property
    def teeth_difference(self) -> int:
        """Tooth number of the internal gear minus tooth number of the external gear."""
        return self.internal.teeth - self.external.teeth

    @property
    def shift_difference(self) -> Scalar:
        """Profile shift of the internal gear minus profile shift of the external gear, in modules [-]."""
        return self.internal.profile_shift - self.external.profile_shift

    @property
    def backlash(self) -> Scalar:
        """Travel along the line of action between the flanks [m]; negative if the teeth overlap."""
        angle, half = self.external.pressure_angle, 0.5 * self.teeth_difference
        room = half * (involute(angle) - involute(self.operating_pressure_angle))
        return 2 * self.external.module * jnp.cos(angle) * (room + jnp.tan(angle) * self.shift_difference)

    @property
    def middle(self) -> Scalar:
        """Roll angle on the external gear in the middle of the path of contact [rad]."""
        return 0.5 * (self.path[0] + self.path[1])

    @property
    def contact_ratio(self) -> Scalar:
        """Contact ratio: length of the path of contact of the rigid pair over the base pitch [-]."""
        begin, end = self.path
        return self.base_radii[0] * (end - begin) / self.base_pitch

    @property
    def line_of_action(self) -> tuple[Scalar, Scalar]:
        """Direction of the line of action: sine and cosine of the operating pressure angle."""
        return self.offset / self.centre_distance, self.base_difference / self.centre_distance

    def roll_of_space(self, angle: Array) -> Array:
        """Roll angle on the external gear at which a tooth touches on the line of action [rad].

        Args:
            angle: angle from the throw to the middle of the internal gear's space that contains the tooth [rad].
        """
        internal = self.base_radii[1] * (angle + self.internal.base_half_angle + self.operating_pressure_angle)
        return (internal - self.offset) / self.base_radii[0]

    def space_of_roll(self, roll: Array) -> Array:
        """Inverse of `roll_of_space`: angle of the space from the roll angle [rad]."""
        internal = (self.base_radii[0] * roll + self.offset) / self.base_radii[1]
        return internal - self.internal.base_half_angle - self.operating_pressure_angle

    def ends(self, roll: Array) -> tuple[Array, Array]:
        """Beginning and end of the part of the flanks of each pair that face each other [rad].

        They are roll angles of the external gear, counted from the line of action: the beginning is at the tip of the
        internal gear, the end at the tip of the external gear. If the beginning is beyond the end, the flanks do not
        face each other anywhere.

        Args:
            roll: roll angle of each pair on the line of action (`roll_of_space`) [rad].
        """
        other, (own, theirs) = self._internal_roll(roll), self.base_radii
        along, across = (theirs * part for part in _offset(other, turned(self.tip_rolls[1] - other)))
        further = 2 * (along + roll * across) / own + (along**2 + across**2) / own**2  # difference of squared rolls
        # flanks begin at the base circle, where the square is zero
        begin = jnp.sqrt(jnp.maximum(roll**2 + further, SMALLEST)) - roll
        return begin, self.tip_rolls[0] - roll

    def points(self, roll: Array, beyond: Array) -> FlankPoints:
        """Points on the flanks of pairs of teeth that face each other (`ends`).

        Args:
            roll: roll angle of each pair on the line of action [rad].
            beyond: roll angle at each point minus the roll angle on the line of action, of the same shape [rad].
        """
        ahead, other = turned(beyond), self._internal_roll(roll)
        gap, delta = facing(roll, other, ahead, *self.base_radii)
        return FlankPoints(gap, (roll + beyond, other + delta.angle), (ahead, delta))

    def share(self, points: FlankPoints) -> Array:
        """Change of the gap per displacement of the internal gear along the normal of its flank [-].

        It is not exactly one, because the gap is measured by an angle about the centre of the external gear.
        """
        delta, own = points.beyond[1], self.base_radii[0]
        return own / (own + self.base_difference * delta.less + self.offset * delta.sine)

    def _internal_roll(self, roll: Array) -> Array:
        return (self.base_radii[0] * roll + self.offset) / self.base_radii[1]


def _offset(roll: Array, beyond: Turn) -> tuple[Array, Array]:
    """Offset of a flank point from the flank's point on the line of action, along ``u`` and ``n`` there, in base
    radii."""
    whole = roll + beyond.angle
    return whole * beyond.sine - beyond.less, beyond.late - whole * beyond.less


@jax.custom_jvp
def facing(roll: Array, other: Array, beyond: Turn, own: Scalar, theirs: Scalar) -> tuple[Array, Turn]:
    """Gap at points of an external flank, and the turn of the internal flank's normal at the same radius.

    Newton's method finds the point of the internal flank with the same radius; its start differs by no more than the
    gap. It is written as a loop, so that XLA calculates its results once and not again for each use. Derivatives are
    those of the equations that the results fulfil.

    Args:
        roll, other: roll angles of the pair on the line of action, on the external and on the internal gear [rad].
        beyond: roll angles of the points, counted from the line of action.
        own, theirs: base radii of the external and of the internal gear [m].
    """
    along, across = (own * part for part in _offset(roll, beyond))  # offset from the point on the line of action
    square = 1 + (roll + beyond.angle) ** 2
    wanted = own**2 * (2 * roll * beyond.angle + beyond.angle**2)
    further = (2 * theirs * (along + other * across) + along**2 + across**2) / theirs**2

    def step(_: Array, state: tuple) -> tuple:
        delta: Array = state[0]
        at = turned(delta)
        ahead, aside = (theirs * part for part in _offset(other, at))
        # the angle between two points of equal radius follows from the cross product of their position vectors
        cross = own * ((aside - across) - roll * (ahead - along)) + along * aside - across * ahead
        missed = 2 * own * (ahead + roll * aside) + ahead**2 + aside**2 - wanted
        slope = (own + ahead) * (1 - at.less) - (own * roll + aside) * at.sine
        better = delta - missed / (2 * theirs * (other + delta) * slope)
        return better, own * jnp.arcsin(cross / (own**2 * square)), at

    delta = jnp.sqrt(jnp.maximum(other**2 + further, SMALLEST)) - other
    begin = delta, jnp.zeros_like(delta), Turn(*(jnp.zeros_like(delta) for _ in Turn._fields))
    _, gap, at = jax.lax.fori_loop(0, STEPS + 1, step, begin)
    return gap, at


@facing.defjvp
def _facing_jvp(primals: tuple, tangents: tuple) -> tuple[tuple[Array, Turn], tuple[Array, Turn]]:
    """Derivatives of `facing`, from the places of both points relative to the centre of the external gear.

    The places are components along ``u`` and ``n`` of the line of action.
    """
    roll, other, beyond, own, theirs = primals
    roll_way, other_way, beyond_way, own_way, theirs_way = tangents
    gap, at = facing(*primals)
    (along, across), (ahead, aside) = _offset(roll, beyond), _offset(other, at)
    # place of the internal flank's point from that centre, and its small distance from the external flank's point
    here, side = own + theirs * ahead, own * roll + theirs * aside
    apart, beside = theirs * ahead - own * along, theirs * aside - own * across
    whole = roll + beyond.angle
    moved = own_way * along + own * (beyond.sine * roll_way + whole * (1 - beyond.less) * beyond_way.angle)
    raised = own_way * across - own * (beyond.less * roll_way + whole * beyond.sine * beyond_way.angle)
    parted = theirs_way * ahead + theirs * at.sine * other_way - moved
    rises = theirs_way * aside - theirs * at.less * other_way - raised
    moved, raised = moved + own_way, raised + own_way * roll + own * roll_way
    cosine, arm = 1 - at.less, theirs * (other + at.angle)
    missed = here * parted + side * rises + apart * moved + beside * raised
    way = -missed / (arm * (here * cosine - side * at.sine))
    parted, rises = parted + arm * cosine * way, rises - arm * at.sine * way
    turn = (apart * raised - beside * moved + here * rises - side * parted) / (own**2 * (1 + whole**2))
    return (gap, at), (gap / own * own_way + own * turn, Turn(way, cosine * way, at.sine * way, at.less * way))


def candidate_rolls(
    begin: Float[Array, " pair"], end: Float[Array, " pair"], points: int
) -> Float[Array, "pair point"]:
    """Points of the flanks at which pairs may touch, as roll angles from the line of action [rad].

    Args:
        begin, end: beginning and end of the facing flanks of each pair (`InternalPair.ends`) [rad].
        points: number of points of each pair. A single point is where the gap is smallest: on the line of action, or at
            the end nearest to it. Several points are spaced evenly from end to end, ends included.
    """
    if points == 1:
        return jnp.clip(0.0, begin, end)[:, None]
    share = jnp.linspace(0.0, 1.0, points, dtype=begin.dtype)
    return begin[:, None] + share[None] * (end - begin)[:, None]
