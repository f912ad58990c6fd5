"""An external involute gear inside an internal one, close to touching on many teeth: gaps, normals, where flanks end.

Seen with the throw, from the internal gear's centre to the external one's, along x. The flanks ahead of the external
gear's teeth (counter-clockwise) touch along a line of action that is tangent to both base circles, its direction
``(sin alpha_w, cos alpha_w)``. A flank point of roll angle ``t`` lies at

    O + r_b (u(tau) + t n(tau)),   u = (cos tau, sin tau),   n = (-sin tau, cos tau)

with the normal ``n``; on the line of action ``tau = -alpha_w``. Every pair of teeth touches there in the ideal motion,
were its flanks long enough. Away from there, by ``delta`` in roll angle, flanks of different base circles part, by
micrometres over many teeth: offsets from the point on the line are worked with, whose differences keep their digits.
The other flanks are the mirror image about the throw.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.geometry.involute import InvoluteGear, inverse_involute, involute
from gearjax.typing import Array, Float, Scalar

STEPS = 2  # of Newton's method for equal radii; it begins within some micrometres
SMALLEST = 1e-12  # under roots of numbers that vanish where a flank begins


class Turn(NamedTuple):
    """An angle, and what differences of small ones need: each to its own rounding, arrays of one shape.

    Args:
        angle: [rad].
        sine: of it.
        less: one less its cosine.
        late: the angle less its sine [rad].
    """

    angle: Array
    sine: Array
    less: Array
    late: Array

    def towards(self, start: tuple[Scalar, Scalar]) -> tuple[Array, Array]:
        """Sine and cosine of this angle added to one whose sine and cosine are given."""
        sine, cosine = start
        return sine + (cosine * self.sine - sine * self.less), cosine - (cosine * self.less + sine * self.sine)


@jax.custom_jvp
def turned(angle: Array) -> Turn:
    """The numbers of an angle [rad], whose derivatives are among them."""
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
    """Points where flanks of pairs of teeth face each other, arrays of one shape.

    Args:
        gap: base radius of the external gear times the angle between the flanks, at equal radius about its centre [m].
        roll: roll angles on the external and on the internal gear [rad].
        beyond: how far the normals of both flanks are turned from the line of action, ``delta`` [rad].
    """

    gap: Array
    roll: tuple[Array, Array]
    beyond: tuple[Turn, Turn]


class InternalPair(eqx.Module):
    """An external gear in an internal one.

    Args:
        external, internal: the gears, of one module and one pressure angle.
        centre_distance: [m].

    Attributes:
        base_radii: of the external and of the internal gear [m]. Like the other attributes they are worked out once:
            what a gear set shows at an angle asks for them many times.
        base_pitch: distance of flanks along the line of action [m].
        base_difference: base radius of the internal gear less that of the external one [m].
        offset: by how much the flank of the internal gear is further from its tangent point on the line of action [m].
        operating_pressure_angle: ``cos alpha_w = (r_b2 - r_b1) / a`` [rad] (ISO 21771).
        tip_rolls: roll angles at the tips of the external and of the internal gear [rad].
        path: roll angles on the external gear where contact on the line of action begins, at the internal gear's tip,
            and ends, at its own [rad].
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
        """Operating pressure angle without backlash [rad] (ISO 21771),

        ``inv alpha_w = inv alpha + 2 tan alpha (x_2 - x_1) / (z_2 - z_1)``.
        """
        angle = self.external.pressure_angle
        return inverse_involute(involute(angle) + jnp.tan(angle) * 2 * self.shift_difference / self.teeth_difference)

    @property
    def tight_centre_distance(self) -> Scalar:
        """Centre distance without backlash [m]; a shorter one has backlash."""
        return self.base_difference / jnp.cos(self.tight_pressure_angle)

    @property
    def teeth_difference(self) -> int:
        """Teeth of the internal gear less those of the external one."""
        return self.internal.teeth - self.external.teeth

    @property
    def shift_difference(self) -> Scalar:
        """Profile shift of the internal gear less that of the external one [-]."""
        return self.internal.profile_shift - self.external.profile_shift

    @property
    def backlash(self) -> Scalar:
        """Travel along the line of action between the flanks [m]; negative where the teeth do not fit."""
        angle, half = self.external.pressure_angle, 0.5 * self.teeth_difference
        room = half * (involute(angle) - involute(self.operating_pressure_angle))
        return 2 * self.external.module * jnp.cos(angle) * (room + jnp.tan(angle) * self.shift_difference)

    @property
    def middle(self) -> Scalar:
        """Roll angle on the external gear in the middle of the path of contact [rad]."""
        return 0.5 * (self.path[0] + self.path[1])

    @property
    def contact_ratio(self) -> Scalar:
        """Length of the path of contact of the rigid pair over the base pitch [-]."""
        begin, end = self.path
        return self.base_radii[0] * (end - begin) / self.base_pitch

    @property
    def line_of_action(self) -> tuple[Scalar, Scalar]:
        """Sine and cosine of the operating pressure angle."""
        return self.offset / self.centre_distance, self.base_difference / self.centre_distance

    def roll_of_space(self, angle: Array) -> Array:
        """Roll angle on the external gear at which a tooth touches on the line of action [rad].

        Args:
            angle: of the middle of the internal gear's space that it is in, from the throw [rad].
        """
        internal = self.base_radii[1] * (angle + self.internal.base_half_angle + self.operating_pressure_angle)
        return (internal - self.offset) / self.base_radii[0]

    def space_of_roll(self, roll: Array) -> Array:
        """The reverse of `roll_of_space` [rad]."""
        internal = (self.base_radii[0] * roll + self.offset) / self.base_radii[1]
        return internal - self.internal.base_half_angle - self.operating_pressure_angle

    def ends(self, roll: Array) -> tuple[Array, Array]:
        """Where the flanks of pairs begin and end to face each other, at the internal gear's tip and at the external
        one's: roll angles of the external gear from the line of action [rad]. Those that begin beyond their end face
        each other nowhere.

        Args:
            roll: of each pair on the line of action (`roll_of_space`) [rad].
        """
        other, (own, theirs) = self._internal_roll(roll), self.base_radii
        along, across = (theirs * part for part in _offset(other, turned(self.tip_rolls[1] - other)))
        further = 2 * (along + roll * across) / own + (along**2 + across**2) / own**2  # of the squares of rolls
        # flanks begin at the base circle
        begin = jnp.sqrt(jnp.maximum(roll**2 + further, SMALLEST)) - roll
        return begin, self.tip_rolls[0] - roll

    def points(self, roll: Array, beyond: Array) -> FlankPoints:
        """Points on the flanks of pairs of teeth that face each other (`ends`).

        Args:
            roll: of each pair on the line of action [rad].
            beyond: by how much the roll angle at each point is larger [rad], of one shape with it.
        """
        ahead, other = turned(beyond), self._internal_roll(roll)
        gap, delta = facing(roll, other, ahead, *self.base_radii)
        return FlankPoints(gap, (roll + beyond, other + delta.angle), (ahead, delta))

    def share(self, points: FlankPoints) -> Array:
        """Change of the gap per displacement of the internal gear along the normal of its flank [-]: near one, as the
        gap counts about the centre of the external one."""
        delta, own = points.beyond[1], self.base_radii[0]
        return own / (own + self.base_difference * delta.less + self.offset * delta.sine)

    def _internal_roll(self, roll: Array) -> Array:
        return (self.base_radii[0] * roll + self.offset) / self.base_radii[1]


def _offset(roll: Array, beyond: Turn) -> tuple[Array, Array]:
    """Place on a flank from its point on the line of action, in base radii: along ``u`` and along ``n`` there."""
    whole = roll + beyond.angle
    return whole * beyond.sine - beyond.less, beyond.late - whole * beyond.less


@jax.custom_jvp
def facing(roll: Array, other: Array, beyond: Turn, own: Scalar, theirs: Scalar) -> tuple[Array, Turn]:
    """The gap at points of an external flank, and by how much the internal one's normal is turned at as large a radius.

    Newton's method for equal radii begins within the gap. A loop, whose results are worked out once for all that reads
    them; derivatives are those of the conditions that they fulfil.

    Args:
        roll, other: roll angles of the pair on the line of action, on the external and on the internal gear [rad].
        beyond: of the points, in roll angle from there.
        own, theirs: base radii of the external and of the internal gear [m].
    """
    along, across = (own * part for part in _offset(roll, beyond))  # from the point on the line of action
    square = 1 + (roll + beyond.angle) ** 2
    wanted = own**2 * (2 * roll * beyond.angle + beyond.angle**2)
    further = (2 * theirs * (along + other * across) + along**2 + across**2) / theirs**2

    def step(_: Array, state: tuple) -> tuple:
        delta: Array = state[0]
        at = turned(delta)
        ahead, aside = (theirs * part for part in _offset(other, at))
        # turn between two points of one radius, by the product of their arms
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
    """Of the points' places from the external gear's centre, along ``u`` and ``n`` of the line of action."""
    roll, other, beyond, own, theirs = primals
    roll_way, other_way, beyond_way, own_way, theirs_way = tangents
    gap, at = facing(*primals)
    (along, across), (ahead, aside) = _offset(roll, beyond), _offset(other, at)
    # the internal flank's point from that centre and from the external one's, which is within the gap of it
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
    """Where on their flanks pairs may touch, as roll angles from the line of action [rad].

    Args:
        begin, end: of each pair (`InternalPair.ends`) [rad].
        points: for one, where its gap is least: on the line of action, or at the nearest end. Else evenly from end to
            end, edges included.
    """
    if points == 1:
        return jnp.clip(0.0, begin, end)[:, None]
    share = jnp.linspace(0.0, 1.0, points, dtype=begin.dtype)
    return begin[:, None] + share[None] * (end - begin)[:, None]
