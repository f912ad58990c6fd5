"""Equilibrium of contacts whose springs are coupled by a matrix: teeth of one body, slices of one tooth face.

A force on one contact moves the others too. Forces ``f`` and the position ``q`` of the output, in a train of the shafts
too that turn freely, solve

    S f + gap - J q = y >= 0,   f >= 0,   f y = 0,   J^T f = Q

with the influence matrix ``S`` [m/N], symmetric and positive definite. What is searched for is the set of contacts that
carry: each step solves the linear problem of one set exactly, and the signs of its forces and openings tell the next
set (Hintermueller, Ito, Kunisch 2002). The same steps are Newton's on a convex function: where the sets go around in a
circle, each goes only so far as that function falls, so that they end. What is found is exact to rounding.

Derivatives are implicit and hold the set fixed: a contact that just touches gives one of its two one-sided values, that
of the open contact where its force is rounded to nothing, else that of the closed one.
"""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve, solve_triangular

from gearjax.contact.contacts import ContactSet
from gearjax.contact.train import closed_first
from gearjax.typing import Array, Bool, Float, Int, Scalar

MOST_STEPS = 100
PLAIN_STEPS = 8  # before the convex function is looked at: nearly all problems end within
HALVINGS = 40  # of the length of a step
CLOSED = 64.0  # roundings of the opening, within which an open contact may overlap
Solution = tuple[Scalar, Float[Array, " contact"], Int[Array, ""]]


def coupled_balance(
    influence: Float[Array, "contact contact"],
    lever: Float[Array, " contact"],
    gap: Float[Array, " contact"],
    load: Scalar,
) -> Solution:
    """Position of the output, forces of the contacts, and a result code.

    Args:
        influence: approach of each contact per force on each, symmetric, positive definite [m/N].
        lever: change of overlap per change of the position, of either sign [m/rad].
        gap: openings at position zero [m].
        load: generalised force on the output [N m]. At zero the contacts that hold against a positive torque touch.

    Returns:
        Position [rad], forces [N], and 0 for found, 1 where no contact can carry the load, 2 where the matrix is not
        positive definite or the search did not end; nan with 1 and 2. Differentiable in all arguments, to any order.
    """
    frozen_lever, frozen_gap, frozen_load = jax.lax.stop_gradient((lever, gap, load))
    edge, apart, able = _from_first_touch(frozen_lever, frozen_gap, frozen_load)
    loaded = _loaded(frozen_lever, frozen_load)
    place, forces, result = _balanced(influence, lever[:, None], gap, load[None], edge[None], apart, loaded, able)
    return place[0], forces, result


def coupled_train(
    influence: Float[Array, "contact contact"], contacts: ContactSet, load: Scalar
) -> tuple[Float[Array, " free"], Float[Array, " contact"], Int[Array, ""]]:
    """The same of a train: positions of the output and of shafts that turn freely [rad], forces, and a result code.

    Args:
        influence: as for `coupled_balance`.
        contacts: their Jacobian and gaps count, with supports in the influence.
        load: generalised force on the output [N m].
    """
    frozen, weight = jax.lax.stop_gradient((contacts, load))
    edge, apart = closed_first(frozen, weight)
    loaded = frozen.loaded(weight)
    able = jnp.stack([loaded[own].any() for _, own in frozen.stages]).all()
    levers, loads = contacts.jacobian[:, : contacts.free], jnp.zeros_like(edge).at[0].set(load)
    return _balanced(influence, levers, contacts.gap, loads, edge, apart, loaded, able)


def _balanced(
    influence: Array, levers: Array, gap: Array, load: Array, edge: Array, apart: Array, loaded: Array, able: Array
) -> tuple[Float[Array, " free"], Float[Array, " contact"], Int[Array, ""]]:
    """Positions, forces and result code.

    Args:
        influence, gap: as for `coupled_balance`.
        levers: of the coordinates that only contacts hold, shape (contact, free) [m/rad].
        load: on them, shape (free,) [N m].
        edge, apart: where the load closes the first contact of each, shape (free,), and the gaps counted from there.
        loaded: contacts that hold against the load.
        able: whether all of these coordinates are held.
    """
    frozen = jax.lax.stop_gradient((influence, levers, load))
    closed, ended = _carrying(frozen[0], frozen[1], apart, frozen[2], loaded)
    result = jnp.where(~able, 1, jnp.where(ended, 0, 2))
    position, forces = _solved(influence, levers, gap - levers @ edge, load, closed)
    good = result == 0
    return jnp.where(good, edge + position, jnp.nan), jnp.where(good, forces, jnp.nan), result


def _from_first_touch(
    lever: Float[Array, " contact"], gap: Float[Array, " contact"], load: Scalar
) -> tuple[Scalar, Float[Array, " contact"], Bool[Array, ""]]:
    """Where the load closes the first contact, the gaps counted from there, and whether there is one: positions of
    their own size would round away what a slight load moves."""
    loaded = _loaded(lever, load)
    able = loaded.any()
    places = jnp.where(loaded, gap / jnp.where(loaded, jnp.abs(lever), 1.0), jnp.inf)
    first = jnp.argmin(places)
    edge = jnp.where(able, gap[first] / jnp.where(able, lever[first], 1.0), 0.0)
    apart = gap - lever * edge
    return edge, jnp.where((jnp.arange(lever.shape[0]) == first) & able, 0.0, apart), able


def _loaded(lever: Float[Array, " contact"], load: Scalar) -> Bool[Array, " contact"]:
    return jnp.where(load > 0, lever > 0, lever < 0)


def _carrying(
    influence: Float[Array, "contact contact"],
    levers: Float[Array, "contact free"],
    gap: Float[Array, " contact"],
    load: Float[Array, " free"],
    loaded: Bool[Array, " contact"],
) -> tuple[Bool[Array, " contact"], Bool[Array, ""]]:
    """The set of contacts that carry, and whether it was found."""
    size = levers.shape[0]
    rounding = jnp.finfo(gap.dtype).eps * CLOSED
    inverse = solve_triangular(jnp.linalg.cholesky(influence), jnp.eye(size, dtype=gap.dtype), lower=True)
    # what is left of the matrix without this much of its diagonal is positive definite still
    own = 0.5 / (inverse * inverse).sum()

    def tried(closed: Array) -> tuple[tuple, Array, Array]:
        """Position, forces and overlaps with a set of closed contacts, whether it is right, and the next set."""
        position, forces = _solved(influence, levers, gap, load, closed)
        beyond = levers @ position - gap - influence @ forces
        reach = rounding * (jnp.abs(influence) @ jnp.abs(forces) + jnp.abs(gap) + jnp.abs(levers @ position))
        right = jnp.where(closed, forces >= 0, beyond <= reach).all()
        overlap = jnp.where(closed, own * forces, beyond)  # of the springs of the diagonal part
        # a contact that overlaps by rounding alone is left out: it would come and go
        return (position, forces, overlap), right, held(jnp.where(closed, forces > 0, beyond > reach))

    def held(chosen: Array) -> Array:
        """Something has to hold each coordinate: else the first contact of its side."""
        lacking = ~((chosen & loaded)[:, None] & (levers != 0)).any(axis=0)
        return chosen | (loaded & (gap == 0) & ((levers != 0) & lacking[None]).any(axis=1))

    def plain(state: tuple) -> tuple:
        closed, *_, step = state
        at, right, chosen = tried(closed)
        return jnp.where(right, closed, chosen), at, right, step + 1

    def damped(state: tuple) -> tuple:
        closed, (position, forces, overlap), _, step = state
        (ended, pressed, target), right, chosen = tried(closed)
        turn, push, close = ended - position, pressed - forces, target - overlap
        bend = influence @ push - own * push

        def slope(share: Array) -> Array:
            pressing = jnp.maximum(overlap + share * close, 0.0)
            return (pressing * close).sum() / own + ((forces + share * push) * bend).sum() - load @ turn

        def halve(_, ends: tuple) -> tuple:
            low, high = ends
            middle = 0.5 * (low + high)
            falls = slope(middle) < 0
            return jnp.where(falls, middle, low), jnp.where(falls, high, middle)

        zero, one = jnp.zeros((), gap.dtype), jnp.ones((), gap.dtype)
        best = jax.lax.fori_loop(0, HALVINGS, halve, (zero, one))[1]
        share = jnp.where(slope(one) <= 0, one, best)
        at = position + share * turn, forces + share * push, overlap + share * close
        chosen = jnp.where(share == 1, chosen, held(at[2] > 0))
        return jnp.where(right, closed, chosen), at, right, step + 1

    def unfinished(state: tuple) -> Array:
        *_, done, step = state
        return ~done & (step < MOST_STEPS)

    # Two loops: one would look for the shares of all steps, over many angles also of those that are whole. Plain steps
    # start from nothing but a set: a start that is worked out, of the same set at all angles, is one matrix with many
    # right-hand sides, which a BLAS shares among threads that wait for each other (ten times the time of all the rest)
    nothing = jnp.zeros_like(load), jnp.zeros_like(gap), jnp.zeros_like(gap)
    state = jax.lax.while_loop(
        lambda state: unfinished(state) & (state[-1] < PLAIN_STEPS), plain, (loaded, nothing, jnp.asarray(False), 0)
    )
    closed, _, done, _ = jax.lax.while_loop(unfinished, damped, state)
    return closed, done & jnp.isfinite(own)


def _solved(
    influence: Float[Array, "contact contact"],
    levers: Float[Array, "contact free"],
    gap: Float[Array, " contact"],
    load: Float[Array, " free"],
    closed: Bool[Array, " contact"],
) -> tuple[Float[Array, " free"], Float[Array, " contact"]]:
    """Positions and forces with a given set of closed contacts, differentiable in the others."""
    both = closed[:, None] & closed[None, :]
    matrix = jnp.where(both, influence, jnp.eye(closed.shape[0], dtype=influence.dtype))
    factor = cho_factor(jax.lax.stop_gradient(matrix), lower=True)

    def over(right: Array) -> Array:
        return jax.lax.custom_linear_solve(
            lambda x: matrix @ x, right, lambda _, b: cho_solve(factor, b), symmetric=True
        )

    arms = jnp.where(closed[:, None], levers, 0.0)
    per_turn = jnp.stack([over(arms[:, column]) for column in range(len(load))], axis=1)
    at_rest = over(jnp.where(closed, gap, 0.0))
    steepness, pull = arms.T @ per_turn, load + arms.T @ at_rest
    held = jnp.diagonal(steepness) > 0
    safe = steepness + jnp.diag(jnp.where(held, 0.0, 1.0))
    # one number is divided by: a factorisation of it would be a routine of its own
    position = pull / safe[0] if len(load) == 1 else jnp.linalg.solve(safe, pull)
    position = jnp.where(held, position, 0.0)
    return position, jnp.where(closed, per_turn @ position - at_rest, 0.0)
