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

STEPS = 3  # of Newton's method for equal radii; it begins within some micrometres
SMALLEST = 1e-12  # under roots of numbers that vanish where a flank begins


class FlankPoints(NamedTuple):
    """Points where flanks of pairs of teeth face each other, arrays of one shape.

    Args:
        gap: base radius of the external gear times the angle between the flanks, at equal radius about its centre [m].
        roll: roll angles on the external and on the internal gear [rad].
        beyond: how far the normals of both flanks are turned from the line of action, ``delta`` [rad].
    """

    gap: Array
    roll: tuple[Array, Array]
    beyond: tuple[Array, Array]


class InternalPair(eqx.Module):
    """An external gear in an internal one.

    Args:
        external, internal: the gears, of one module and one pressure angle.
        centre_distance: [m].
    """

    external: InvoluteGear
    internal: InvoluteGear
    centre_distance: Scalar

    @property
    def base_difference(self) -> Scalar:
        """Base radius of the internal gear less that of the external one [m]."""
        return 0.5 * (self.internal.teeth - self.external.teeth) * self.base_pitch / jnp.pi

    @property
    def base_pitch(self) -> Scalar:
        """Distance of flanks along the line of action [m]."""
        return jnp.pi * self.external.module * jnp.cos(self.external.pressure_angle)

    @property
    def operating_pressure_angle(self) -> Scalar:
        """``cos alpha_w = (r_b2 - r_b1) / a`` [rad] (ISO 21771)."""
        return jnp.arccos(self.base_difference / self.centre_distance)

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
    def path(self) -> tuple[Scalar, Scalar]:
        """Roll angles on the external gear where contact on the line of action begins, at the internal gear's tip, and
        ends, at its own [rad]."""
        begin = (self.internal.base_radius * self.internal.tip_roll - self._offset) / self.external.base_radius
        return begin, self.external.tip_roll

    @property
    def middle(self) -> Scalar:
        """Roll angle on the external gear in the middle of the path of contact [rad]."""
        return 0.5 * (self.path[0] + self.path[1])

    @property
    def contact_ratio(self) -> Scalar:
        """Length of the path of contact of the rigid pair over the base pitch [-]."""
        begin, end = self.path
        return self.external.base_radius * (end - begin) / self.base_pitch

    @property
    def _offset(self) -> Scalar:
        """By how much the flank of the internal gear is further from its tangent point on the line of action [m]."""
        return self.centre_distance * jnp.sin(self.operating_pressure_angle)

    def roll_of_space(self, angle: Array) -> Array:
        """Roll angle on the external gear at which a tooth touches on the line of action [rad].

        Args:
            angle: of the middle of the internal gear's space that it is in, from the throw [rad].
        """
        internal = self.internal.base_radius * (angle + self.internal.base_half_angle + self.operating_pressure_angle)
        return (internal - self._offset) / self.external.base_radius

    def space_of_roll(self, roll: Array) -> Array:
        """The reverse of `roll_of_space` [rad]."""
        internal = (self.external.base_radius * roll + self._offset) / self.internal.base_radius
        return internal - self.internal.base_half_angle - self.operating_pressure_angle

    def ends(self, roll: Array) -> tuple[Array, Array]:
        """Where the flanks of pairs begin and end to face each other, at the internal gear's tip and at the external
        one's: roll angles of the external gear from the line of action [rad]. Those that begin beyond their end face
        each other nowhere.

        Args:
            roll: of each pair on the line of action (`roll_of_space`) [rad].
        """
        along, across = self._moved(self.internal, self._internal_roll(roll), self._internal_tip(roll))
        own = self.external.base_radius
        further = 2 * (along + roll * across) / own + (along**2 + across**2) / own**2  # of the squares of rolls
        # flanks begin at the base circle
        begin = jnp.sqrt(jnp.maximum(roll**2 + further, SMALLEST)) - roll
        return begin, self.external.tip_roll - roll

    def points(self, roll: Array, beyond: Array) -> FlankPoints:
        """Points on the flanks of pairs of teeth that face each other (`ends`).

        Args:
            roll: of each pair on the line of action [rad].
            beyond: by how much the roll angle at each point is larger [rad], of one shape with it.
        """
        other, own = self._internal_roll(roll), self.external.base_radius
        moved = self._moved(self.external, roll, beyond)
        delta = self._equal_radius(roll, other, beyond, moved)
        along, across = self._moved(self.internal, other, delta)
        # turn between two points of one radius, by the product of their arms
        cross = own * ((across - moved[1]) - roll * (along - moved[0])) + moved[0] * across - moved[1] * along
        square = own**2 * (1 + (roll + beyond) ** 2)
        return FlankPoints(own * jnp.arcsin(cross / square), (roll + beyond, other + delta), (beyond, delta))

    def share(self, points: FlankPoints) -> Array:
        """Change of the gap per displacement of the internal gear along the normal of its flank [-]: near one, as the
        gap counts about the centre of the external one."""
        towards = self.operating_pressure_angle + points.beyond[1]
        arm = self.internal.base_radius - self.centre_distance * jnp.cos(towards)
        return self.external.base_radius / arm

    def _internal_roll(self, roll: Array) -> Array:
        return (self.external.base_radius * roll + self._offset) / self.internal.base_radius

    def _internal_tip(self, roll: Array) -> Array:
        """Roll angle of the internal gear's tip, from the line of action."""
        return self.internal.tip_roll - self._internal_roll(roll)

    def _equal_radius(self, roll: Array, other: Array, beyond: Array, moved: tuple[Array, Array]) -> Array:
        """Roll angle of the internal flank from the line of action, as far from the external gear's centre [rad]."""
        own, theirs = self.external.base_radius, self.internal.base_radius
        wanted = own**2 * (2 * roll * beyond + beyond**2)

        def step(delta: Array, roll: Array, other: Array, wanted: Array, own: Array, theirs: Array) -> Array:
            along, across = _offset(other, delta)
            along, across = theirs * along, theirs * across
            missed = 2 * own * (along + roll * across) + along**2 + across**2 - wanted
            slope = (own + along) * jnp.cos(delta) - (own * roll + across) * jnp.sin(delta)
            return delta - missed / (2 * theirs * (other + delta) * slope)

        # the external flank's own point is within the gap of it
        further = (2 * theirs * (moved[0] + other * moved[1]) + moved[0] ** 2 + moved[1] ** 2) / theirs**2
        numbers = roll, other, wanted, own, theirs
        known = jax.lax.stop_gradient(numbers)
        delta = jax.lax.stop_gradient(jnp.sqrt(jnp.maximum(other**2 + further, SMALLEST)) - other)
        for _ in range(STEPS):
            delta = step(delta, *known)
        return step(jax.lax.stop_gradient(delta), *numbers)

    @staticmethod
    def _moved(gear: InvoluteGear, roll: Array, beyond: Array) -> tuple[Array, Array]:
        """Place on a flank from its point on the line of action: along ``u`` and along ``n`` there [m]."""
        along, across = _offset(roll, beyond)
        return gear.base_radius * along, gear.base_radius * across


def _offset(roll: Array, beyond: Array) -> tuple[Array, Array]:
    """The same in base radii, without the loss of digits of small angles."""
    half, sine = jnp.sin(0.5 * beyond), jnp.sin(beyond)
    less = 2 * half**2  # 1 - cos
    return (roll + beyond) * sine - less, _late(beyond, sine) - (roll + beyond) * less


def _late(angle: Array, sine: Array) -> Array:
    """``angle - sin angle``."""
    square = angle * angle
    series = angle * square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72 * (1 - square / 110))))
    return jnp.where(jnp.abs(angle) < 0.5, series, angle - sine)


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
