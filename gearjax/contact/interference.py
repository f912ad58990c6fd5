"""Interference: rigid bodies that overlap at every position of the output."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.contact.contacts import ContactSet
from gearjax.contact.laws import HardContact
from gearjax.contact.train import touching
from gearjax.typing import Array, Int, Scalar

MOST_STEPS = 60
FURTHEST = 1.0  # rad, largest position that is considered


class Overlap(eqx.Module):
    """The position of the output at which the largest overlap of all contacts is smallest.

    Args:
        overlap: largest overlap at that position; negative if all contacts can be open at once, minus infinity if one
            side has no contacts [m].
        contact: number of the contact with the shorter lever, of the two contacts that overlap most.
        position: position of the output [rad].
    """

    overlap: Scalar
    contact: Int[Array, ""]
    position: Scalar


def least_overlap(contacts: ContactSet) -> Overlap:
    """Smallest possible value of the largest overlap, ``min over q of max over i of (J_i q - gap_i)``.

    It is the smallest elastic approach with which all contacts have room. Unlike the positions at which contacts touch,
    it stays finite if a lever vanishes. The largest overlap is a convex, piecewise linear function of the position. Its
    minimum is the crossing of a falling and a rising line. The search starts with the steepest lines and replaces one
    of them by the highest line at their crossing, until none is higher. In a train the shaft behind each mesh turns
    freely, so that each mesh is evaluated on its own. The worst mesh is reported, together with the output position at
    which the driving flanks touch.
    """
    if contacts.free == 1:
        return _of_one_mesh(contacts)
    each = [(own, _of_one_mesh(contacts.alone(column, own))) for column, own in contacts.stages]
    overlaps = jnp.stack([least.overlap for _, least in each])
    deepest = jnp.stack([jnp.asarray(own)[least.contact] for own, least in each])
    worst = jnp.argmax(overlaps)
    return Overlap(overlaps[worst], deepest[worst], touching(contacts, HardContact(), 1)[0])


def _of_one_mesh(contacts: ContactSet) -> Overlap:
    """The same as `least_overlap` for contacts with a single coordinate."""
    frozen = jax.lax.stop_gradient(contacts)
    lever, gap = frozen.lever, frozen.gap

    def highest(position: Scalar) -> Int[Array, ""]:
        return jnp.argmax(lever * position - gap).astype(jnp.int32)

    def crossing(lever: Array, gap: Array, falling: Int[Array, ""], rising: Int[Array, ""]) -> Scalar:
        apart = lever[rising] - lever[falling]
        meet = (gap[rising] - gap[falling]) / jnp.where(apart > 0, apart, 1.0)
        return jnp.clip(jnp.where(apart > 0, meet, 0.0), -FURTHEST, FURTHEST)

    def advance(state: tuple) -> tuple:
        falling, rising, _, step = state
        new = highest(crossing(lever, gap, falling, rising))
        falls = lever[new] < 0
        done = new == jnp.where(falls, falling, rising)
        return jnp.where(falls, new, falling), jnp.where(falls, rising, new), done, step + 1

    start = jnp.argmin(lever).astype(jnp.int32), jnp.argmax(lever).astype(jnp.int32)
    both = (lever.min() < 0) & (lever.max() > 0)
    falling, rising, _, _ = jax.lax.while_loop(
        lambda state: ~state[2] & (state[3] < MOST_STEPS), advance, (*start, ~both, 0)
    )
    position = crossing(contacts.lever, contacts.gap, falling, rising)  # only the search has no derivatives
    # both contacts have the same overlap; the contact with the shorter lever is the harder one to open
    contact = jnp.where(jnp.abs(lever[rising]) < jnp.abs(lever[falling]), rising, falling)
    overlap = contacts.lever[contact] * position - contacts.gap[contact]
    return Overlap(jnp.where(both, overlap, -jnp.inf), contact, position)
