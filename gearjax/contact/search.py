"""Equilibrium of many contacts, or of springs that are not linear: Newton's method between bounds.

The sum of the contacts' forces on the output never falls with its position, so that a root is between any two
positions with sums on both sides of the load. The search does not take part in derivatives, which are implicit: by
more steps of Newton's method from its end (`last_steps`), or by a rule of its own (`hard_balance`).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from gearjax.contact.contacts import ContactSet
from gearjax.contact.laws import AbstractContact, HardContact
from gearjax.contact.springs import CoupledSprings, LinearSprings
from gearjax.typing import Array, Bool, Float, Scalar

MOST_STEPS = 200
FLATTEST = 1e-9  # slope of the forces over that of the whole loaded side, below which it tells nothing
LONGEST = 1.0  # rad, of a step
ACCURACY = 0.7  # power of the dtype's spacing, relative to the position and typical travel: the last step but one
SLIGHT = 1e-7  # rad, travel of loads that rounding hides where the wrong side begins to touch: it is not started from
TYPICAL = 1e-6  # m, penetration at which springs that are not linear are called as stiff as they are there


def spring_forces(contacts: ContactSet, law: AbstractContact) -> Callable[[Array], Array]:
    """Forces of the contacts as a function of their overlap, shape (contact,) both."""
    springs = contacts.springs
    assert springs is not None
    assert not isinstance(springs, CoupledSprings)  # the force of each hangs on the others
    return lambda overlap: springs.force(law.penetration(overlap))


def last_steps(contacts: ContactSet, law: AbstractContact) -> int:
    """How many steps of Newton's method from the end of a search carry first and second derivatives: a velocity is a
    first one, whose gradient is a second one. One is enough where forces are straight lines between changes of contact.
    """
    return 1 if isinstance(contacts.springs, LinearSprings) and isinstance(law, HardContact) else 2


def newton(
    move: Callable[[Array], Array], start: Float[Array, "..."], travel: Float[Array, "..."]
) -> tuple[Array, Bool[Array, "..."]]:
    """Roots of sums that never fall, and where they were found.

    Args:
        move: Newton's step at a position, to be taken off it [rad]; it has the sign of the sum. One array of one
            program: whatever else is worked out from the same terms would be worked out by itself.
        start: positions to start from, of any shape [rad].
        travel: typical change of the position, that accuracy counts with [rad].
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
        )  # a step leaves only bounds that are finite
        done = done | small | ~(low < high)
        return jnp.where(done, position, new), low, high, done, step + 1

    endless = jnp.full_like(start, jnp.inf)
    hopeless = ~jnp.isfinite(start)
    position, _, _, done, _ = jax.lax.while_loop(unfinished, advance, (start, -endless, endless, hopeless, 0))
    return position, done & jnp.isfinite(position) & ~hopeless


def _ratio(excess: Array, slope: Array, steepness: Array) -> Array:
    """Newton's step, the longest one where the slope tells nothing: from there, contacts open one after the other."""
    return excess / jnp.where(slope > FLATTEST * steepness, slope, jnp.finfo(slope.dtype).tiny)


def search(contacts: ContactSet, applied: Scalar, law: AbstractContact) -> tuple[Scalar, Array, Array]:
    """Position where the contacts carry the load, their forces, and whether it was found.

    Args:
        contacts: candidate contacts, with a stiffness; their gaps count from where the load closes the first contact,
            and so does the position [rad].
        applied: generalised force on the output [N m].
        law: contact law.
    """

    def sums(contacts: ContactSet, applied: Scalar, position: Scalar) -> tuple[Scalar, Scalar]:
        lever, force = contacts.lever, spring_forces(contacts, law)
        overlap = lever * position - contacts.gap
        pressed, stiffness = jax.jvp(force, (overlap,), (jnp.ones_like(overlap),))
        return (lever * pressed).sum() - applied, (lever * lever * stiffness).sum()

    frozen, weight = jax.lax.stop_gradient((contacts, applied))
    side = jnp.where(weight > 0, frozen.lever > 0, frozen.lever < 0)
    overlap = jnp.full_like(frozen.gap, TYPICAL)
    stiffness = jax.jvp(spring_forces(frozen, law), (overlap,), (jnp.ones_like(overlap),))[1]
    steepness = jnp.where(side, frozen.lever * frozen.lever * stiffness, 0.0).sum()
    safe = jnp.where(steepness > 0, steepness, 1.0)
    begin = jnp.where(steepness > 0, weight / safe, jnp.nan)
    position, ended = newton(lambda position: _ratio(*sums(frozen, weight, position), safe), begin, jnp.abs(begin))
    position = jnp.where(ended, position, 0.0)
    for _ in range(last_steps(contacts, law)):
        excess, slope = sums(contacts, applied, position)
        # without a closed contact nothing is carried, and the first contact just touches
        position = jnp.where(slope > 0, position - excess / jnp.where(slope > 0, slope, 1.0), 0.0)
    forces = spring_forces(contacts, law)(contacts.lever * position - contacts.gap)
    return jnp.where(ended, position, jnp.nan), jnp.where(ended, forces, 0.0), ended


def closed_side(
    lever: Float[Array, "contact _"], gap: Float[Array, "contact lane"], applied: Float[Array, " lane"]
) -> Float[Array, " lane"]:
    """Positions of the equilibrium as if all two-sided contacts of the loaded side were closed [rad]; zero without any.

    Arguments as of `hard_balance`.
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
    """Positions of the equilibrium of two-sided linear springs by the hard law, of several gear sets, or angles.

    Args:
        lever: of each contact, shape (contact, lane), or (contact, 1) for all [m/rad].
        gap: of each contact [m].
        applied: generalised force on the output over the stiffness of a contact, the same for all [m^2/rad]; at zero
            the side that holds against a positive torque touches.
        start: positions to start from [rad].

    Returns:
        The positions [rad], nan where no contact can carry the load.
    """
    applied = jnp.where(applied == 0, -jnp.finfo(applied.dtype).tiny, applied)  # in play, nothing is not yet carried
    squared = lever * lever
    sides = [jnp.where(side, squared, 0.0).sum(axis=0) for side in (lever > 0, lever < 0)]
    steepness = jnp.where(applied > 0, *sides)
    safe = jnp.where(steepness > 0, steepness, 1.0)

    def move(position: Array) -> Array:
        # all that a contact has to do with read anew: what does not change would be worked out before, one by one
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
    """What the contacts carry beyond the load, and its slope, both over the stiffness of a contact.

    Contacts are written out as one array each, which is what vectorises.
    """
    moment = slope = jnp.zeros_like(position)
    for arm, at in zip(lever, gap, strict=True):
        overlap = arm * position - at
        moment = moment + jnp.where(overlap > 0, arm * overlap, 0.0)
        slope = slope + jnp.where(overlap > 0, arm * arm, 0.0)
    return moment - applied, slope
