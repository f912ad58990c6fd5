"""Contact of teeth on parallel axes: pairs of teeth on the plane of action, cut across the face into slices.

The frame has gear 1 at the origin with its axis along z, and gear 2 on the x axis; gear 1 turns from x to y. Its
driving flanks (``side`` = 1) press along ``n = (sin alpha_wt cos beta_b, cos alpha_wt cos beta_b, -sin beta_b)``, its
back flanks (``side`` = -1) along the mirror image ``(.., -.., +..)``. Pairs of teeth p are counted in the order in
which they come into mesh. In the middle of the face the contact of a pair is at the length of roll of gear 1

    xi = xi_C + side (u - p) p_bt,     u = r_b1 theta / p_bt, for back flanks r_b1 (theta - psi_1) / p_bt

Here psi_1 is the angular thickness of the teeth of gear 1 at the working circle. At a place z across the face the
contact is at ``xi + side z tan beta_b``. Tooth p of gear 1 drives tooth p of gear 2; its back flank faces tooth p + 1.

Beyond the path of contact the corner of a tip may still touch the other flank. With angles counted clockwise from the
line of centres, the flank point with the roll angle t [rad] is at ``psi_i(t) = alpha_wt - t_i + t - atan t``; ``t_i``
is the roll angle at which the flanks would touch. The distance is the angle between corner and flank at the radius of
the corner, times the base radius.
"""

from typing import NamedTuple

import jax.numpy as jnp

from gearjax.geometry.helical_pair import NARROWEST, InvolutePair
from gearjax.typing import Array, Float, Int, Scalar

CORNERS = 0.3  # base pitches beyond the path of contact to which corners are followed
SHALLOWEST = 1e-12  # lower bound of a squared roll angle, whose root has no derivative at zero


class SlicePoints(NamedTuple):
    """Slices of the pairs of teeth that may touch on one side.

    Args:
        tooth: number of each pair in the order of meshing, shape (pair,).
        roll: lengths of roll of gear 1 and of gear 2 at the contact of each slice, shape (pair, slice) [m].
        across: place of this contact from the middle of the face, shape (pair, slice) [m].
        share: share of each slice that is on the path of contact, shape (pair, slice) [-].
        beyond: distance of each slice from the path of contact, shape (pair, slice) [m].
        gap: gap between corner and flank in a transverse section, for slices beyond the path of contact, shape (pair,
            slice) [m].
    """

    tooth: Int[Array, " pair"]
    roll: tuple[Float[Array, "pair slice"], Float[Array, "pair slice"]]
    across: Float[Array, "pair slice"]
    share: Float[Array, "pair slice"]
    beyond: Float[Array, "pair slice"]
    gap: Float[Array, "pair slice"]


def middles(face_width: Scalar, slices: int) -> Float[Array, " slice"]:
    """Middles of slices of equal width, counted from the middle of the face [m]."""
    return face_width * ((jnp.arange(slices, dtype=face_width.dtype) + 0.5) / slices - 0.5)


def slice_points(pair: InvolutePair, angle: Scalar, side: int, pairs: int, slices: int, corners: bool) -> SlicePoints:
    """Slices of the pairs of teeth nearest to the middle of the path of contact.

    Args:
        pair: the gears.
        angle: angle of gear 1 from the position in which pair 0 touches at the pitch point, in the middle of the face
            [rad].
        side: 1 for driving flanks, -1 for back flanks.
        pairs: number of pairs; entry i always has one of every ``pairs``-th pair.
        slices: number of slices across the face.
        corners: whether slices beyond the path of contact touch at the corner of a tip. If not, only the part of a
            slice that is on the path touches, and the place of the slice is the middle of that part.
    """
    path, pitch = pair.contact_path, pair.base_pitch
    gear = pair.gears[0]
    if side < 0:
        angle = angle - 2 * gear.half_angle(gear.base_radius / jnp.cos(pair.working_pressure_angle))
    turned = gear.base_radius * angle / pitch
    middle = turned + side * (path.pitch - 0.5 * (path.begin + path.end)) / pitch
    slots = jnp.arange(pairs, dtype=angle.dtype)
    tooth = slots + pairs * jnp.round((middle - slots) / pairs)
    place, half = middles(pair.face_width, slices), 0.5 * pair.face_width / slices
    lean = jnp.tan(pair.base_helix_angle)
    length = path.pitch + side * ((turned - tooth)[:, None] * pitch + place[None, :] * lean)
    before, after = path.begin - length, length - path.end
    beyond = jnp.maximum(jnp.maximum(before, after), 0.0)
    if corners:
        on, share = jnp.clip(length, path.begin, path.end), jnp.ones_like(length)
        across = jnp.broadcast_to(place[None, :], length.shape)
        gap = _corner_gap(pair, length, beyond)
        beyond = jnp.maximum(beyond - CORNERS * pitch, 0.0)
    else:
        # the part of each slice that is on the path; slices of spur gears enter and leave the path almost at once
        reach = jnp.maximum(half * jnp.abs(lean), NARROWEST * pitch)
        low, high = (jnp.clip(end - length, -reach, reach) for end in (path.begin, path.end))
        share, shift = 0.5 * (high - low) / reach, 0.5 * (high + low)
        beyond = jnp.maximum(beyond - reach, 0.0)
        on, gap = jnp.clip(length + shift, path.begin, path.end), jnp.zeros_like(length)
        across = place[None, :] + side * jnp.sign(lean) * half * shift / reach
    return SlicePoints(tooth.astype(int), (on, pair.other_roll(on)), across, share, beyond, gap)


def _corner_gap(pair: InvolutePair, length: Array, beyond: Array) -> Array:
    """Turn of gear 2 until the corner of a tip touches the other flank, times its base radius [m].

    Args:
        pair: the gears.
        length: length of roll of gear 1 at which the flanks would touch if they did not end [m].
        beyond: distance of this point from the path of contact [m].
    """
    path, (first, second) = pair.contact_path, pair.gears
    far = jnp.minimum(beyond, CORNERS * pair.base_pitch)
    distance, sign = pair.centre_distance, -1.0 if pair.internal else 1.0
    # beyond the end of the path: the corner of gear 1 touches the flank of gear 2
    at = path.end + far
    along, across = _corner(pair, path.end, first.base_radius, at)
    last, _ = _to_flank(pair, second.base_radius, pair.other_roll(at), distance - sign * along, -sign * across)
    # before the beginning: the corner of gear 2 touches the flank of gear 1, whose normal has another lever on gear 2
    start, leverage = entering_corner(pair, far)
    gap = jnp.where(length > path.end, sign * last, jnp.where(length < path.begin, start / leverage, 0.0))
    return jnp.maximum(gap, 0.0)


def entering_corner(pair: InvolutePair, far: Array) -> tuple[Array, Array]:
    """The corner of the tip of gear 2 before the beginning of the path of contact.

    Args:
        pair: the gears.
        far: distance of the point at which the flanks would touch from the beginning of the path [m].

    Returns:
        Distance of the corner from the flank of gear 1, along its normal [m], and the lever of this normal on gear 2,
        over the base radius [-].
    """
    (first, second), distance = pair.gears, pair.centre_distance
    sign, at = -1.0 if pair.internal else 1.0, pair.contact_path.begin - far
    along, across = _corner(pair, pair.other_roll(pair.contact_path.begin), second.base_radius, pair.other_roll(at))
    apart, leans = _to_flank(pair, first.base_radius, at, sign * (distance - along), -sign * across)
    return apart, (distance * jnp.cos(leans) - sign * first.base_radius) / second.base_radius


def _corner(pair: InvolutePair, gear_tip: Scalar, base: Scalar, touching: Array) -> tuple[Array, Array]:
    """Place of the corner of a tip, along the line of centres and across it [m]."""
    tip = gear_tip / base
    turned = pair.working_pressure_angle - touching / base + tip - jnp.arctan(tip)
    radius = base * jnp.sqrt(1 + tip * tip)
    return radius * jnp.cos(turned), radius * jnp.sin(turned)


def _to_flank(pair: InvolutePair, base: Scalar, touching: Array, along: Array, across: Array) -> tuple[Array, Array]:
    """Distance from a point to a flank [m], and angle of the flank's normal, which is alpha_wt at contact [rad]."""
    squared = (along * along + across * across) / base**2 - 1
    roll = jnp.sqrt(jnp.maximum(squared, SHALLOWEST))
    place = jnp.arctan2(across, along)
    flank = pair.working_pressure_angle - touching / base + roll - jnp.arctan(roll)
    return base * (flank - place), place + jnp.arctan(roll)
