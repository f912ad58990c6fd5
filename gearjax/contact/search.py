"""Equilibrium of many contacts, or of springs that are not linear: Newton's method between bounds.

The sum of the contacts' forces on the output never falls with its position, so that a root is between any two
positions with sums on both sides of the load. The search does not take part in derivatives: from its end one more step
of Newton's method does, which is the implicit derivative, and exact where the springs are linear.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from gearjax.contact.frame import ContactSet
from gearjax.contact.laws import AbstractContact
from gearjax.contact.line import LineSprings
from gearjax.typing import Array, Scalar

MOST_STEPS = 200
FLATTEST = 1e-9  # slope of the forces over that of the whole loaded side, below which it tells nothing
LONGEST = 1.0  # rad, of a step
SPACINGS = 8.0  # of the dtype, that the balance of forces may be off, relative to the largest force


def spring_forces(contacts: ContactSet, law: AbstractContact) -> Callable[[Array], Array]:
    """Forces of the contacts as a function of their overlap, shape (contact,) both."""
    springs = contacts.stiffness
    if isinstance(springs, LineSprings):
        return lambda overlap: springs.force(law.penetration(overlap))
    assert springs is not None
    return lambda overlap: springs * law.penetration(overlap)


def search(contacts: ContactSet, load: Scalar, law: AbstractContact, start: Scalar) -> tuple[Scalar, Array, Array]:
    """Position where the contacts carry the load, their forces, and whether it was found.

    Args:
        contacts: candidate contacts, with a stiffness.
        load: generalised force on the output [N m].
        law: contact law.
        start: position to start from, such as the edge of the play on the side of the load [rad].
    """
    frozen, weight, begin = jax.lax.stop_gradient((contacts, load, start))

    def sums(contacts: ContactSet, load: Scalar, position: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """What is out of balance, its slope, and the size of the forces."""
        lever, force = contacts.lever, spring_forces(contacts, law)
        overlap = lever * position - contacts.gap
        pressed, stiffness = jax.jvp(force, (overlap,), (jnp.ones_like(overlap),))
        moment = lever * pressed
        size = jnp.maximum(jnp.abs(moment).sum(), jnp.abs(load))
        return moment.sum() - load, (lever * lever * stiffness).sum(), size

    # where no contact is closed yet, a step as if the springs of the loaded side were
    side = jnp.where(weight > 0, frozen.lever > 0, frozen.lever < 0)
    overlap = jnp.full_like(frozen.gap, 1e-6)
    stiff = jax.jvp(spring_forces(frozen, law), (overlap,), (jnp.ones_like(overlap),))[1]
    first = jnp.where(side, frozen.lever * frozen.lever * stiff, 0.0).sum()
    accuracy = SPACINGS * jnp.finfo(begin.dtype).eps

    def unfinished(state: tuple) -> Array:
        _, _, _, done, step = state
        return ~done & (step < MOST_STEPS)

    def advance(state: tuple) -> tuple:
        position, low, high, _, step = state
        excess, slope, size = sums(frozen, weight, position)
        low, high = jnp.where(excess < 0, position, low), jnp.where(excess > 0, position, high)
        step_size = excess / jnp.where(slope > FLATTEST * first, slope, first)
        new = position - jnp.clip(step_size, -LONGEST, LONGEST)
        inside = (new > low) & (new < high)
        new = jnp.where(inside, new, 0.5 * (low + high))  # bounds are finite where a step leaves them
        done = (jnp.abs(excess) <= accuracy * size) | (new == position) | ~(low < high)
        return jnp.where(done, position, new), low, high, done, step + 1

    endless = jnp.full_like(begin, jnp.inf)
    state = begin, -endless, endless, ~jnp.isfinite(begin) | ~(first > 0), 0
    position, _, _, done, _ = jax.lax.while_loop(unfinished, advance, state)
    found = done & jnp.isfinite(position)
    position = jax.lax.stop_gradient(jnp.where(found, position, 0.0))
    excess, slope, _ = sums(contacts, load, position)
    slope = jax.lax.stop_gradient(slope)
    # without a closed contact nothing is carried, and the start is the position
    position = jnp.where(slope > 0, position - excess / jnp.where(slope > 0, slope, 1.0), start)
    forces = spring_forces(contacts, law)(contacts.lever * position - contacts.gap)
    return jnp.where(found, position, jnp.nan), jnp.where(found, forces, 0.0), found
