"""Equilibrium of contacts between bodies on elastic supports, in several coordinates at once.

The coordinates ``q`` are the positions of the output and of shafts that turn freely, and the displacements of the
bodies. They solve

    K q + J^T f(J q - gap) = Q

with the stiffness ``K`` of supports and shafts, which is zero for free coordinates. The left side is the gradient of a
convex function, the energy of the supports and springs. Newton's method with a line search on this energy ends at its
only minimum. Memory grows with the number of contacts. If springs are coupled by a matrix, the compliance of the
supports is added to this matrix instead: ``S + J_s K_s^-1 J_s^T``.

The search itself is not differentiated: further Newton steps at its end carry the derivatives (`last_steps`).
"""

import jax
import jax.numpy as jnp

from gearjax.contact.contacts import ContactSet
from gearjax.contact.laws import AbstractContact
from gearjax.contact.search import ACCURACY, TYPICAL, last_steps, spring_forces
from gearjax.elimination import solved_definite
from gearjax.typing import Array, Float, Int, Scalar

MOST_STEPS = 100
HALVINGS = 50  # most bisections of the length of a step
FINE = 1e-3  # relative accuracy of the length of a step
ENOUGH = 0.5  # share of the slope along a step that may be left at its end if the whole step is taken
ROUNDING = 4.0  # rounding of a sum, in units in the last place of its terms
SLIGHTLY = 1e-9  # share of the stiffness of all loaded contacts in each step, so that the output is always held


def with_supports(contacts: ContactSet, influence: Float[Array, "contact contact"]) -> Float[Array, "contact contact"]:
    """Influence matrix of the contacts including their supports [m/N]."""
    if contacts.supports is None:
        return influence
    moving = contacts.jacobian[:, contacts.free :]
    return influence + moving @ solved_definite(contacts.supports, moving.T)


def moved_by(contacts: ContactSet, forces: Float[Array, " contact"]) -> Float[Array, " support"]:
    """Displacements of the bodies on their supports under forces of the contacts [m]."""
    assert contacts.supports is not None
    return -solved_definite(contacts.supports, contacts.jacobian[:, contacts.free :].T @ forces)


def supported(
    contacts: ContactSet, applied: Scalar, law: AbstractContact
) -> tuple[Float[Array, " coordinate"], Float[Array, " contact"], Int[Array, ""]]:
    """Displacements at which contacts and supports balance a load, the contact forces, and a result code.

    Args:
        contacts: contacts with independent springs. Their gaps, and the positions of the output and of shafts that turn
            freely, are counted from where the load closes the first contact of each mesh.
        applied: generalised force on the output [N m].
        law: contact law.

    Returns:
        Displacements in all coordinates, that of the output first [rad, m]; forces [N]; result code: 0 if found, 1 if
        no contact can carry the load, 3 if the search did not end. With 1 and 3 the displacements are nan and the
        forces zero.
    """
    frozen, weight, still = jax.lax.stop_gradient((contacts, applied, law))
    unloaded = weight == 0
    weight = jnp.where(unloaded, -1.0, weight)
    loaded = frozen.loaded(weight)
    able = jnp.stack([loaded[own].any() for _, own in frozen.stages]).all()
    typical = jnp.full_like(frozen.gap, TYPICAL)
    stiffness = jax.jvp(spring_forces(frozen, still), (typical,), (jnp.ones_like(typical),))[1]
    whole = _bending(frozen, jnp.where(loaded, stiffness, 0.0))
    scale = jnp.sqrt(jnp.where(able, jnp.diagonal(whole), 1.0))
    pull = jnp.zeros_like(scale).at[0].set(weight)
    closed = pull + frozen.jacobian.T @ jnp.where(loaded, stiffness * frozen.gap, 0.0)
    start = _solve(whole, closed, scale)
    place, ended = _search(frozen, weight, still, jnp.where(able, start, 0.0), whole, scale)
    for _ in range(last_steps(contacts, law)):
        excess, stiffness = _excess(contacts, applied, law, place)
        step = _solve(_bending(contacts, stiffness) + SLIGHTLY**2 * whole, excess, scale)
        place = jnp.where(unloaded, 0.0, place - step)
    forces = spring_forces(contacts, law)(contacts.jacobian @ place - contacts.gap)
    good = able & (ended | unloaded)
    result = jnp.where(able, jnp.where(good, 0, 3), 1)
    return jnp.where(good, place, jnp.nan), jnp.where(good & ~unloaded, forces, 0.0), result


def _search(
    contacts: ContactSet, applied: Scalar, law: AbstractContact, start: Array, whole: Array, scale: Array
) -> tuple[Array, Array]:
    """Displacements at the minimum of the energy, and whether the search found them."""
    accuracy = float(jnp.finfo(start.dtype).eps) ** ACCURACY

    def unfinished(state: tuple) -> Array:
        _, done, step = state
        return ~done & (step < MOST_STEPS)

    def advance(state: tuple) -> tuple:
        place, _, step = state
        excess, stiffness = _excess(contacts, applied, law, place)
        way = -_solve(_bending(contacts, stiffness) + SLIGHTLY * whole, excess, scale)

        def slope(share: Scalar) -> Scalar:
            return way @ _excess(contacts, applied, law, place + share * way)[0]

        def halve(state: tuple) -> tuple:
            low, high, halved = state
            middle = 0.5 * (low + high)
            falls = slope(middle) < 0
            return jnp.where(falls, middle, low), jnp.where(falls, high, middle), halved + 1

        zero, one = jnp.zeros_like(applied), jnp.ones_like(applied)
        far = slope(one) > ENOUGH * jnp.abs(way @ excess)

        def rough(state: tuple) -> Array:
            low, high, halved = state
            return far & (high - low > FINE * high) & (halved < HALVINGS)

        # this loop does not start if the whole step is taken; a conditional over many angles would search in all cases
        share = jax.lax.while_loop(rough, halve, (zero, one, 0))[1]
        small = jnp.abs(way * scale).max() <= accuracy * jnp.abs(place * scale).max()
        return place + share * way, small | _balanced(contacts, applied, law, place, excess), step + 1

    place, done, _ = jax.lax.while_loop(unfinished, advance, (start, ~jnp.isfinite(start).all(), 0))
    return place, done & jnp.isfinite(place).all()


def _balanced(contacts: ContactSet, applied: Scalar, law: AbstractContact, place: Array, excess: Array) -> Array:
    """Whether the excess is within rounding, which is large if very stiff shafts are on soft bearings."""
    forces = jnp.abs(spring_forces(contacts, law)(contacts.jacobian @ place - contacts.gap))
    size = (jnp.abs(contacts.jacobian).T @ forces).at[0].add(jnp.abs(applied))
    if contacts.supports is not None:
        size = size.at[contacts.free :].add(jnp.abs(contacts.supports) @ jnp.abs(place[contacts.free :]))
    return (jnp.abs(excess) <= ROUNDING * jnp.finfo(excess.dtype).eps * size).all()


def _excess(
    contacts: ContactSet, applied: Scalar, law: AbstractContact, place: Float[Array, " coordinate"]
) -> tuple[Float[Array, " coordinate"], Float[Array, " contact"]]:
    """Generalised force of supports and contacts minus the load, and the stiffness of each contact."""
    overlap = contacts.jacobian @ place - contacts.gap
    forces, stiffness = jax.jvp(spring_forces(contacts, law), (overlap,), (jnp.ones_like(overlap),))
    carried = contacts.jacobian.T @ forces
    if contacts.supports is None:
        return carried.at[0].add(-applied), stiffness
    free = contacts.free
    held = carried[free:] + contacts.supports @ place[free:]
    return jnp.concatenate([carried[:1] - applied, carried[1:free], held]), stiffness


def _bending(contacts: ContactSet, stiffness: Float[Array, " contact"]) -> Float[Array, "coordinate coordinate"]:
    """Jacobian of `_excess` by the coordinates."""
    matrix = contacts.jacobian.T @ (stiffness[:, None] * contacts.jacobian)
    if contacts.supports is None:
        return matrix
    return matrix.at[contacts.free :, contacts.free :].add(contacts.supports)


def _solve(matrix: Array, right: Array, scale: Array) -> Array:
    """Solution of a positive definite system, after its coordinates are scaled to similar sizes."""
    level = matrix / (scale[:, None] * scale[None, :])
    return solved_definite(level, right / scale) / scale
