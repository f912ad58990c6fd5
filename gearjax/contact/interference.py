"""Interference: rigid bodies that overlap wherever the output is."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.contact.contacts import ContactSet
from gearjax.contact.laws import HardContact
from gearjax.contact.train import touching
from gearjax.typing import Array, Int, Scalar

MOST_STEPS = 60
FURTHEST = 1.0  # rad, of positions that are looked at


class Overlap(eqx.Module):
    """The position of the output at which the deepest overlap is least.

    Args:
        overlap: deepest overlap there; negative where all contacts can be clear at once, minus infinity where one side
            has no contacts [m].
        contact: of the two contacts that overlap most there, the one of the shorter lever.
        position: of the output [rad].
    """

    overlap: Scalar
    contact: Int[Array, ""]
    position: Scalar


def least_overlap(contacts: ContactSet) -> Overlap:
    """The least of all positions' deepest overlap, ``min over q of max over i of (J_i q - gap_i)``.

    It is the smallest elastic approach that the contacts need to make room for each other, and does not grow without
    bound where a lever vanishes, as the positions do at which such a contact touches. The deepest overlap is a convex
    function of the position, made of straight lines: the lowest crossing of a falling and a rising line is found by
    crossing the steepest ones, and then each time the line that lies highest there. In a train each mesh is looked at
    by itself, as the shaft behind it turns freely; the worst one is told, the output where its driving flanks touch.
    """
    if contacts.free == 1:
        return _of_one_mesh(contacts)
    each = [(own, _of_one_mesh(contacts.alone(column, own))) for column, own in contacts.stages]
    overlaps = jnp.stack([least.overlap for _, least in each])
    deepest = jnp.stack([jnp.asarray(own)[least.contact] for own, least in each])
    worst = jnp.argmax(overlaps)
    return Overlap(overlaps[worst], deepest[worst], touching(contacts, HardContact(), 1)[0])


def _of_one_mesh(contacts: ContactSet) -> Overlap:
    frozen = jax.lax.stop_gradient(contacts)
    lever, gap = frozen.lever, frozen.gap

    def highest(position: Scalar) -> Int[Array, ""]:
        return jnp.argmax(lever * position - gap).astype(jnp.int32)

    def crossing(falling: Int[Array, ""], rising: Int[Array, ""]) -> Scalar:
        apart = lever[rising] - lever[falling]
        meet = (gap[rising] - gap[falling]) / jnp.where(apart > 0, apart, 1.0)
        return jnp.clip(jnp.where(apart > 0, meet, 0.0), -FURTHEST, FURTHEST)

    def advance(state: tuple) -> tuple:
        falling, rising, _, step = state
        new = highest(crossing(falling, rising))
        falls = lever[new] < 0
        done = new == jnp.where(falls, falling, rising)
        return jnp.where(falls, new, falling), jnp.where(falls, rising, new), done, step + 1

    start = jnp.argmin(lever).astype(jnp.int32), jnp.argmax(lever).astype(jnp.int32)
    both = (lever.min() < 0) & (lever.max() > 0)
    falling, rising, _, _ = jax.lax.while_loop(
        lambda state: ~state[2] & (state[3] < MOST_STEPS), advance, (*start, ~both, 0)
    )
    position = crossing(falling, rising)
    # both overlap alike; the one that the output can clear least is named
    contact = jnp.where(jnp.abs(lever[rising]) < jnp.abs(lever[falling]), rising, falling)
    overlap = contacts.lever[contact] * position - contacts.gap[contact]
    return Overlap(jnp.where(both, overlap, -jnp.inf), contact, position)
