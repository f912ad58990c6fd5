"""Equilibrium of many contacts or of non-linear springs, by Newton's method between bounds.

The sum of the contact forces on the output never decreases with its position. A root is therefore between any two
positions whose sums are on both sides of the load. The search itself is not differentiated; derivatives are implicit.
They come from further Newton steps at the end of the search (`last_steps`), or from a derivative rule of their own
(`hard_balance`).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from gearjax.contact.contacts import ContactSet
from gearjax.contact.laws import AbstractContact, HardContact
from gearjax.contact.springs import CoupledSprings, LinearSprings
from gearjax.typing import Array, Bool, Float, Scalar

MOST_STEPS = 200
FLATTEST = 1e-9  # stiffness, as a share of the whole loaded side's, below which a slope is useless for a step
LONGEST = 1.0  # rad, longest step
ACCURACY = 0.7  # a step is the last but one if, relative to position and travel, it is below eps to this power
SLIGHT = 1e-7  # rad, travel below which a given start may, by rounding, be on the wrong side and is not used
TYPICAL = 1e-6  # m, penetration at which the stiffness of non-linear springs is taken
CHAINS = 4  # sums over contacts that are formed side by side; more gain nothing


def spring_forces(contacts: ContactSet, law: AbstractContact) -> Callable[[Array], Array]:
    """Forces of the contacts as a function of their overlap, shape (contact,) both."""
    springs = contacts.springs
    assert springs is not None
    assert not isinstance(springs, CoupledSprings)  # the force of a coupled spring depends on the other forces
    return lambda overlap: springs.force(law.penetration(overlap))


def last_steps(contacts: ContactSet, law: AbstractContact) -> int:
    """Number of Newton steps after a search that carry its first and second derivatives.

    A velocity is a first derivative, and its gradient a second one. One step is enough if the forces are piecewise
    linear.
    """
    return 1 if isinstance(contacts.springs, LinearSprings) and isinstance(law, HardContact) else 2


def newton(
    move: Callable[[Array], Array], start: Float[Array, "..."], travel: Float[Array, "..."]
) -> tuple[Array, Bool[Array, "..."]]:
    """Roots of sums that never decrease with the position, and whether each root was found.

    Args:
        move: function that returns the Newton step at a position, which is to be subtracted [rad]; the step has the
            sign of the sum. It returns a single array: XLA would calculate the common terms of several results again.
        start: start positions, of any shape [rad].
        travel: typical change of the position, which the accuracy refers to [rad].
    """
    accuracy = float(jnp.finfo(start.dtype).eps) ** ACCURACY

    def unfinished(state: tuple) -> Array:
        _, _, _, done, step = state
        return (~done).any() & (step < MOST_STEPS)

    def advance(state: tuple) -> tuple:
        position, low, high, done, step = state
        back = jax.lax.optimization_barrier(move(position))
        low, high = jnp.where(back < 0, position, low), jnp.where(back > 0, position, high)
        small = jnp.abs(back) <= accuracy * (jnp.abs(position) + travel)
        new = position - jnp.clip(back, -LONGEST, LONGEST)
        new = jnp.where(
            (new > low) & (new < high), new, 0.5 * (low + high)
        )  # the bounds are finite here, because a step cannot pass an infinite bound
        done = done | small | ~(low < high)
        return jnp.where(done, position, new), low, high, done, step + 1

    endless = jnp.full_like(start, jnp.inf)
    hopeless = ~jnp.isfinite(start)
    position, _, _, done, _ = jax.lax.while_loop(unfinished, advance, (start, -endless, endless, hopeless, 0))
    return position, done & jnp.isfinite(position) & ~hopeless


def _ratio(excess: Array, slope: Array, steepness: Array) -> Array:
    """Newton step, or a very long step if the slope is too small; from far away, contacts open one after the other."""
    return excess / jnp.where(slope > FLATTEST * steepness, slope, jnp.finfo(slope.dtype).tiny)


def search(contacts: ContactSet, applied: Scalar, law: AbstractContact) -> tuple[Scalar, Array, Array]:
    """Position in which the contacts carry the load, their forces, and whether the position was found.

    Args:
        contacts: candidate contacts with a stiffness. Their gaps and the position [rad] are counted from the position
            at which the load closes the first contact.
        applied: generalised force on the output [N m].
        law: contact law.
    """

    def sums(contacts: ContactSet, law: AbstractContact, applied: Scalar, position: Scalar) -> tuple[Scalar, Scalar]:
        lever, force = contacts.lever, spring_forces(contacts, law)
        overlap = lever * position - contacts.gap
        pressed, stiffness = jax.jvp(force, (overlap,), (jnp.ones_like(overlap),))
        return (lever * pressed).sum() - applied, (lever * lever * stiffness).sum()

    frozen, still, weight = jax.lax.stop_gradient((contacts, law, applied))
    side = jnp.where(weight > 0, frozen.lever > 0, frozen.lever < 0)
    overlap = jnp.full_like(frozen.gap, TYPICAL)
    stiffness = jax.jvp(spring_forces(frozen, still), (overlap,), (jnp.ones_like(overlap),))[1]
    steepness = jnp.where(side, frozen.lever * frozen.lever * stiffness, 0.0).sum()
    safe = jnp.where(steepness > 0, steepness, 1.0)
    begin = jnp.where(steepness > 0, weight / safe, jnp.nan)
    position, ended = newton(lambda at: _ratio(*sums(frozen, still, weight, at), safe), begin, jnp.abs(begin))
    position = jnp.where(ended, position, 0.0)
    for _ in range(last_steps(contacts, law)):
        excess, slope = sums(contacts, law, applied, position)
        # without a closed contact there is no load, and the first contact just touches at zero
        position = jnp.where(slope > 0, position - excess / jnp.where(slope > 0, slope, 1.0), 0.0)
    forces = spring_forces(contacts, law)(contacts.lever * position - contacts.gap)
    return jnp.where(ended, position, jnp.nan), jnp.where(ended, forces, 0.0), ended


def closed_side(
    lever: Float[Array, "contact _"], gap: Float[Array, "contact lane"], applied: Float[Array, " lane"]
) -> Float[Array, " lane"]:
    """Equilibrium positions if all contacts with a lever of the loaded side were closed [rad]; zero without any.

    The arguments are those of `hard_balance`.
    """
    loaded = jnp.where(jnp.where(applied[None] > 0, lever > 0, lever < 0), lever, 0.0)
    steepness = (loaded * loaded).sum(axis=0)
    return jnp.where(
        steepness > 0, (applied + (loaded * gap).sum(axis=0)) / jnp.where(steepness > 0, steepness, 1.0), 0.0
    )


@jax.custom_jvp
def hard_balance(
    lever: Float[Array, "contact _"],
    gap: Float[Array, "contact lane"],
    applied: Float[Array, " lane"],
    start: Float[Array, " lane"],
) -> Float[Array, " lane"]:
    """Equilibrium positions of contacts with equal linear springs and levers of either sign, by the hard contact law.

    A lane is one problem of a batch: one gear set or one input angle.

    Args:
        lever: lever of each contact, shape (contact, lane), or (contact, 1) if it is the same in all lanes [m/rad].
        gap: gap of each contact [m].
        applied: generalised force on the output divided by the stiffness of a contact, which is the same for all
            contacts [m^2/rad]; at zero, the side that holds against a positive torque touches.
        start: start positions [rad].

    Returns:
        The positions [rad], nan if no contact can carry the load.
    """
    # zero load would be balanced anywhere in the play; the smallest negative load closes the first contact
    applied = jnp.where(applied == 0, -jnp.finfo(applied.dtype).tiny, applied)
    squared = lever * lever
    sides = [jnp.where(side, squared, 0.0).sum(axis=0) for side in (lever > 0, lever < 0)]
    steepness = jnp.where(applied > 0, *sides)
    safe = jnp.where(steepness > 0, steepness, 1.0)

    def move(position: Array) -> Array:
        # without the barrier, XLA would calculate constant terms of each contact before the loop, one by one
        excess, slope = _sums(*jax.lax.optimization_barrier((lever, gap, applied, position)))
        return _ratio(excess, slope, safe)

    travel = jnp.abs(applied) / safe
    slight = travel < SLIGHT
    begin = jax.lax.cond(
        slight.any(), lambda: jnp.where(slight, closed_side(lever, gap, applied), start), lambda: jnp.asarray(start)
    )
    position, ended = newton(move, jnp.where(steepness > 0, begin, jnp.nan), travel)
    return jnp.where(ended, position, jnp.nan)


@hard_balance.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    position = hard_balance(*primals)

    def excess(lever: Array, gap: Array, applied: Array) -> Array:
        return (lever * jnp.maximum(lever * position[None] - gap, 0.0)).sum(axis=0) - applied

    lever, gap, _, _ = primals
    slope = jnp.where(lever * position[None] > gap, lever * lever, 0.0).sum(axis=0)
    change = jax.jvp(excess, primals[:3], tangents[:3])[1]
    return position, -change / jnp.where(slope > 0, slope, 1.0)


def _sums(lever: Array, gap: Array, applied: Array, position: Array) -> tuple[Array, Array]:
    """Sum of the contact forces on the output minus the load, and its slope, both divided by the contact stiffness.

    Each contact is an array of its own in the program, because this form vectorises. Contacts are added in several
    chains, since each addition waits for the one before it in its chain.
    """
    moments = [jnp.zeros_like(position)] * CHAINS
    slopes = [jnp.zeros_like(position)] * CHAINS
    for contact, (arm, at) in enumerate(zip(lever, gap, strict=True)):
        chain, overlap = contact % CHAINS, arm * position - at
        closed = jnp.where(overlap > 0, arm, 0.0)
        moments[chain] = moments[chain] + closed * overlap
        slopes[chain] = slopes[chain] + closed * closed
    return sum(moments[1:], moments[0]) - applied, sum(slopes[1:], slopes[0])
