"""Equilibrium of contacts between bodies that give way at their supports: several coordinates at once.

The positions of the output and of shafts that turn freely, and the displacements of the bodies, together ``q``, solve

    K q + J^T f(J q - gap) = Q

with the stiffness ``K`` of supports and shafts, none for what only contacts hold. The left side is the slope of a
convex function, the energy of the supports and the springs: Newton's method on it, going no further than it falls, ends
at its only minimum. Memory grows with the number of contacts. Where springs are coupled by a matrix, what the supports
give way by is a part of it instead: ``S + J_s K_s^-1 J_s^T``.

The search does not take part in derivatives: more steps of Newton's method from its end carry them (`last_steps`).
"""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve

from gearjax.contact.contacts import ContactSet
from gearjax.contact.laws import AbstractContact
from gearjax.contact.search import ACCURACY, TYPICAL, last_steps, spring_forces
from gearjax.typing import Array, Float, Int, Scalar

MOST_STEPS = 100
HALVINGS = 50  # of the length of a step, at most
FINE = 1e-3  # of the length of a step, that it is found to
ENOUGH = 0.5  # of the slope along a step, that is left at its end where the whole step is taken
ROUNDING = 4.0  # spacings of the numbers that are added up
SLIGHTLY = 1e-9  # of all loaded contacts, that count in a step: without any the output would not be held


def with_supports(contacts: ContactSet, influence: Float[Array, "contact contact"]) -> Float[Array, "contact contact"]:
    """What forces on the contacts make them approach, supports included [m/N]."""
    if contacts.supports is None:
        return influence
    moving = contacts.jacobian[:, contacts.free :]
    return influence + moving @ cho_solve(cho_factor(contacts.supports, lower=True), moving.T)


def moved_by(contacts: ContactSet, forces: Float[Array, " contact"]) -> Float[Array, " support"]:
    """Displacements of the bodies under forces of the contacts [m]."""
    assert contacts.supports is not None
    return -cho_solve(cho_factor(contacts.supports, lower=True), contacts.jacobian[:, contacts.free :].T @ forces)


def supported(
    contacts: ContactSet, applied: Scalar, law: AbstractContact
) -> tuple[Float[Array, " coordinate"], Float[Array, " contact"], Int[Array, ""]]:
    """Displacements where the contacts and supports balance a load, the forces, and a result code.

    Args:
        contacts: with springs one by one; their gaps count from where the load closes the first contact of each mesh,
            and so do the positions of the output and of shafts that turn freely.
        applied: generalised force on the output [N m].
        law: contact law.

    Returns:
        Displacements in all coordinates, the output's first [rad, m]; forces [N]; 0 for found, 1 where no
        contact can carry the load, 3 where the search did not end; nan and zeros with 1 and 3.
    """
    frozen, weight = jax.lax.stop_gradient((contacts, applied))
    unloaded = weight == 0
    weight = jnp.where(unloaded, -1.0, weight)
    loaded = frozen.loaded(weight)
    able = jnp.stack([loaded[own].any() for _, own in frozen.stages]).all()
    typical = jnp.full_like(frozen.gap, TYPICAL)
    stiffness = jax.jvp(spring_forces(frozen, law), (typical,), (jnp.ones_like(typical),))[1]
    whole = _bending(frozen, jnp.where(loaded, stiffness, 0.0))
    scale = jnp.sqrt(jnp.where(able, jnp.diagonal(whole), 1.0))
    pull = jnp.zeros_like(scale).at[0].set(weight)
    closed = pull + frozen.jacobian.T @ jnp.where(loaded, stiffness * frozen.gap, 0.0)
    start = _solve(whole, closed, scale)
    place, ended = _search(frozen, weight, law, jnp.where(able, start, 0.0), whole, scale)
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
    """Displacements at the minimum, and whether they were found."""
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

        # a loop that is not begun where the whole step is taken; over many angles, a choice would look for all shares
        share = jax.lax.while_loop(rough, halve, (zero, one, 0))[1]
        small = jnp.abs(way * scale).max() <= accuracy * jnp.abs(place * scale).max()
        return place + share * way, small | _balanced(contacts, applied, law, place, excess), step + 1

    place, done, _ = jax.lax.while_loop(unfinished, advance, (start, ~jnp.isfinite(start).all(), 0))
    return place, done & jnp.isfinite(place).all()


def _balanced(contacts: ContactSet, applied: Scalar, law: AbstractContact, place: Array, excess: Array) -> Array:
    """Whether what is left is no more than rounding, which very stiff shafts beside soft bearings bring about."""
    forces = jnp.abs(spring_forces(contacts, law)(contacts.jacobian @ place - contacts.gap))
    size = (jnp.abs(contacts.jacobian).T @ forces).at[0].add(jnp.abs(applied))
    if contacts.supports is not None:
        size = size.at[contacts.free :].add(jnp.abs(contacts.supports) @ jnp.abs(place[contacts.free :]))
    return (jnp.abs(excess) <= ROUNDING * jnp.finfo(excess.dtype).eps * size).all()


def _excess(
    contacts: ContactSet, applied: Scalar, law: AbstractContact, place: Float[Array, " coordinate"]
) -> tuple[Float[Array, " coordinate"], Float[Array, " contact"]]:
    """What supports and contacts carry beyond the load, and the stiffness of each contact there."""
    overlap = contacts.jacobian @ place - contacts.gap
    forces, stiffness = jax.jvp(spring_forces(contacts, law), (overlap,), (jnp.ones_like(overlap),))
    carried = contacts.jacobian.T @ forces
    if contacts.supports is None:
        return carried.at[0].add(-applied), stiffness
    free = contacts.free
    held = carried[free:] + contacts.supports @ place[free:]
    return jnp.concatenate([carried[:1] - applied, carried[1:free], held]), stiffness


def _bending(contacts: ContactSet, stiffness: Float[Array, " contact"]) -> Float[Array, "coordinate coordinate"]:
    """Slope of `_excess` along the coordinates."""
    matrix = contacts.jacobian.T @ (stiffness[:, None] * contacts.jacobian)
    if contacts.supports is None:
        return matrix
    return matrix.at[contacts.free :, contacts.free :].add(contacts.supports)


def _solve(matrix: Array, right: Array, scale: Array) -> Array:
    """Solution of a positive definite system, whose coordinates are brought to one size first."""
    level = matrix / (scale[:, None] * scale[None, :])
    return cho_solve(cho_factor(level, lower=True), right / scale) / scale
