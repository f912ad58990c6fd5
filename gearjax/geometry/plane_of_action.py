"""Where teeth on parallel axes touch: pairs of teeth on the plane of action, cut across the face into slices.

In a frame with gear 1 at the origin, its axis along z and gear 2 on the x axis, gear 1 turns from x to y. Its driving
flanks press along ``n = (sin alpha_wt cos beta_b, cos alpha_wt cos beta_b, -sin beta_b)``, its back flanks along the
mirror image ``(.., -.., +..)``: by ``side`` = 1 or -1. A pair of teeth p, counted in the order in which they come into
mesh, has its contact in the middle of the face at the length of roll of gear 1

    xi = xi_C + side (u - p) p_bt,     u = r_b1 theta / p_bt, of back flanks r_b1 (theta - psi_1) / p_bt

with the thickness psi_1 of its teeth at the working circle, and at a place z across the face at
``xi + side z tan beta_b``. Tooth p of gear 1 drives tooth p of gear 2, and its back flank faces tooth p + 1.

Beyond the path of contact the corner of a tip may still touch the other flank. With both flanks counted clockwise from
the line of centres, at a roll t [rad] they are at ``psi_i(t) = alpha_wt - t_i + t - atan t``, where ``t_i`` is where
they would touch; the distance is the angle between corner and flank at the corner's radius, times the base radius.
"""

from typing import NamedTuple

import jax.numpy as jnp

from gearjax.geometry.helical_pair import NARROWEST, InvolutePair
from gearjax.typing import Array, Float, Int, Scalar

CORNERS = 0.3  # base pitches beyond the path of contact to which corners are followed
SHALLOWEST = 1e-12  # of a squared roll


class SlicePoints(NamedTuple):
    """Slices of the pairs of teeth that may touch, of one side.

    Args:
        tooth: number of each pair in the order of meshing, shape (pair,).
        roll: lengths of roll of gear 1 and of gear 2 where slices touch, on their flanks, shape (pair, slice) [m].
        across: places of these from the middle of the face, shape (pair, slice) [m].
        share: of each slice that is on the path of contact, shape (pair, slice) [-].
        beyond: distance of each slice from the path of contact, shape (pair, slice) [m].
        gap: in a transverse section, between corner and flank of those beyond it, shape (pair, slice) [m].
    """

    tooth: Int[Array, " pair"]
    roll: tuple[Float[Array, "pair slice"], Float[Array, "pair slice"]]
    across: Float[Array, "pair slice"]
    share: Float[Array, "pair slice"]
    beyond: Float[Array, "pair slice"]
    gap: Float[Array, "pair slice"]


def _middles(pair: InvolutePair, slices: int) -> Float[Array, " slice"]:
    """Middles of even slices from the middle of the face on [m]."""
    middles = (jnp.arange(slices, dtype=pair.face_width.dtype) + 0.5) / slices
    return pair.face_width * (middles - 0.5)


def slice_points(pair: InvolutePair, angle: Scalar, side: int, pairs: int, slices: int, corners: bool) -> SlicePoints:
    """Slices of the pairs of teeth nearest to the middle of the path of contact.

    Args:
        pair: the gears.
        angle: by which gear 1 is turned from where pair 0 touches at the pitch point, in the middle of the face [rad].
        side: 1 for driving flanks, -1 for back flanks.
        pairs: how many of them; slot i has every ``pairs``-th one.
        slices: across the face.
        corners: whether slices beyond the path of contact are at the corner of a tip; else what touches of a slice is
            what is on the path, and its place is the middle of that.
    """
    path, pitch = pair.contact_path, pair.base_pitch
    gear = pair.gears[0]
    if side < 0:
        angle = angle - 2 * gear.half_angle(gear.base_radius / jnp.cos(pair.working_pressure_angle))
    turned = gear.base_radius * angle / pitch
    middle = turned + side * (path.pitch - 0.5 * (path.begin + path.end)) / pitch
    slots = jnp.arange(pairs, dtype=angle.dtype)
    tooth = slots + pairs * jnp.round((middle - slots) / pairs)
    place, half = _middles(pair, slices), 0.5 * pair.face_width / slices
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
        # the part of each slice that is on the path; those of spur gears all but at once
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
        length: of roll of gear 1 where the flanks would touch, went they on [m].
        beyond: of that from the path of contact [m].
    """
    path, (first, second) = pair.contact_path, pair.gears
    far = jnp.minimum(beyond, CORNERS * pair.base_pitch)
    distance, sign = pair.centre_distance, -1.0 if pair.internal else 1.0

    def corner(gear_tip: Scalar, base: Scalar, touching: Array) -> tuple[Array, Array]:
        tip = gear_tip / base
        turned = pair.working_pressure_angle - touching / base + tip - jnp.arctan(tip)
        radius = base * jnp.sqrt(1 + tip * tip)
        return radius * jnp.cos(turned), radius * jnp.sin(turned)

    def to_flank(base: Scalar, touching: Array, along: Array, across: Array) -> tuple[Array, Array]:
        """Distance of a point to a flank, and the angle of the flank's normal there, as alpha_wt is that at contact."""
        squared = (along * along + across * across) / base**2 - 1
        roll = jnp.sqrt(jnp.maximum(squared, SHALLOWEST))
        place = jnp.arctan2(across, along)
        flank = pair.working_pressure_angle - touching / base + roll - jnp.arctan(roll)
        return base * (flank - place), place + jnp.arctan(roll)

    # behind the end: the corner of gear 1 on the flank of gear 2
    at = path.end + far
    along, across = corner(path.end, first.base_radius, at)
    last, _ = to_flank(second.base_radius, pair.other_roll(at), distance - sign * along, -sign * across)
    # before the beginning: the corner of gear 2 on the flank of gear 1, whose normal has another lever on gear 2
    at = path.begin - far
    along, across = corner(pair.other_roll(path.begin), second.base_radius, pair.other_roll(at))
    start, leans = to_flank(first.base_radius, at, sign * (distance - along), -sign * across)
    start = start * second.base_radius / (distance * jnp.cos(leans) - sign * first.base_radius)
    gap = jnp.where(length > path.end, sign * last, jnp.where(length < path.begin, start, 0.0))
    return jnp.maximum(gap, 0.0)
