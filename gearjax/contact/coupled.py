"""Equilibrium of contacts whose springs are coupled by a matrix: teeth of one body, slices of one tooth face.

A force on one contact moves the others too. Forces ``f`` and the position ``q`` of the output, in a train of the shafts
too that turn freely, solve

    S f + gap - J q = y >= 0,   f >= 0,   f y = 0,   J^T f = Q

with the influence matrix ``S`` [m/N], symmetric and positive definite. What is searched for is the set of contacts
that carry, exactly (`active_set`); from `MANY` contacts on, conjugate gradients guess it. Many gaps and loads under one
matrix (`jax.vmap` with the matrix held) share its products with it, lanes last, without a factorisation (`conjugate`):
what they leave the exact steps finish, lane by lane.

Derivatives are implicit and hold the set fixed: a contact that just touches gives one of its two one-sided values, that
of the open contact where its force is rounded to nothing, else that of the closed one.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from gearjax.contact.active_set import CLOSED, carrying, solved
from gearjax.contact.blocks import search_of_blocks, solved_of_blocks
from gearjax.contact.conjugate import descended
from gearjax.contact.contacts import ContactSet
from gearjax.contact.lanes import finished, in_parts, side_by_side
from gearjax.contact.train import closed_first
from gearjax.typing import Array, Bool, Float, Int, Scalar

MANY = 48  # contacts; of fewer the exact steps of many lanes, side by side, are as quick
GUESS = 20  # steps of conjugate gradients before the exact ones, of a single problem
ENOUGH = 120  # steps of many lanes: twice what a matrix of condition 15 takes
LANES = 128  # side by side: their numbers stay in the cache
Solution = tuple[Scalar, Float[Array, " contact"], Int[Array, ""]]


def coupled_balance(
    influence: Float[Array, "contact contact"] | Float[Array, "block own own"],
    lever: Float[Array, " contact"],
    gap: Float[Array, " contact"],
    applied: Scalar,
    sided: bool = False,
) -> Solution:
    """Position of the output, forces of the contacts, and a result code.

    Args:
        influence: approach of each contact per force on each, symmetric, positive definite, shape (contact, contact);
            or small blocks of it, of contacts that do not move those of others, shape (block, own, own) [m/N].
        lever: change of overlap per change of the position, of either sign [m/rad].
        gap: openings at position zero [m].
        applied: generalised force on the output [N m]. At zero the contacts that hold against a positive torque touch.
        sided: whether the first half of small blocks is of driving flanks, and the second of as many back flanks.

    Returns:
        Position [rad], forces [N], and 0 for found, 1 where no contact can carry the load, 2 where the matrix is not
        positive definite or the search did not end; nan with 1 and 2. Differentiable in all arguments, to any order.
        From `MANY` contacts on the matrix is looked at only as far as contacts carry.
    """
    influence, lever, gap, applied = (jnp.asarray(part) for part in (influence, lever, gap, applied))
    frozen_lever, frozen_gap, frozen_applied = jax.lax.stop_gradient((lever, gap, applied))
    edge, apart, able = _from_first_touch(frozen_lever, frozen_gap, frozen_applied)
    loaded = _loaded(frozen_lever, frozen_applied)
    place, forces, result = _balanced(
        influence, lever[:, None], gap, applied[None], edge[None], apart, loaded, able, sided
    )
    return place[0], forces, result


def coupled_train(
    influence: Float[Array, "contact contact"], contacts: ContactSet, applied: Scalar
) -> tuple[Float[Array, " free"], Float[Array, " contact"], Int[Array, ""]]:
    """The same of a train: positions of the output and of shafts that turn freely [rad], forces, and a result code.

    Args:
        influence: as for `coupled_balance`.
        contacts: their Jacobian and gaps count, with supports in the influence.
        applied: generalised force on the output [N m].
    """
    frozen, weight = jax.lax.stop_gradient((contacts, applied))
    edge, apart = closed_first(frozen, weight)
    loaded = frozen.loaded(weight)
    able = jnp.stack([loaded[own].any() for _, own in frozen.stages]).all()
    levers, loads = contacts.jacobian[:, : contacts.free], jnp.zeros_like(edge).at[0].set(applied)
    return _balanced(influence, levers, contacts.gap, loads, edge, apart, loaded, able)


def _balanced(
    influence: Array,
    levers: Array,
    gap: Array,
    applied: Array,
    edge: Array,
    apart: Array,
    loaded: Array,
    able: Array,
    sided: bool = False,
) -> tuple[Float[Array, " free"], Float[Array, " contact"], Int[Array, ""]]:
    """Positions, forces and result code.

    Args:
        influence, gap: as for `coupled_balance`.
        levers: of the coordinates that only contacts hold, shape (contact, free) [m/rad].
        applied: on them, shape (free,) [N m].
        edge, apart: where the load closes the first contact of each, shape (free,), and the gaps counted from there.
        loaded: contacts that hold against the load.
        able: whether all of these coordinates are held.
        sided: as for `coupled_balance`.
    """
    # rounding hides which of those that touch together is the first: none on the loaded side is closed before it
    apart = jnp.where(loaded, jnp.maximum(apart, 0.0), apart)
    place, forces, _, good = _answer(sided, influence, levers, gap, applied, (edge, apart, loaded, able))
    good = jax.lax.stop_gradient(good) > 0
    result = jnp.where(~able, 1, jnp.where(good, 0, 2))
    return jnp.where(good, place, jnp.nan), jnp.where(good, forces, jnp.nan), result


def _primal(sided: bool, influence: Array, levers: Array, gap: Array, applied: Array, counted: tuple) -> tuple:
    """Positions, forces, and as numbers which contacts carry and whether they were found."""
    del gap  # counted from where contacts touch
    edge, apart, loaded, able = counted
    few = _exact if influence.ndim == 2 else partial(search_of_blocks, sided)
    search = _search if influence.ndim == 2 and len(apart) >= MANY else few
    position, forces, closed, done = search(influence, levers, apart, applied, loaded)
    good = done & able
    numbers = (jnp.where(good, part, 0.0) for part in (edge + position, forces, closed.astype(forces.dtype)))
    return *numbers, good.astype(forces.dtype)


_answer = jax.custom_jvp(_primal, nondiff_argnums=(0,))


@partial(_answer.defjvp, symbolic_zeros=True)
def _answer_jvp(sided: bool, primals: tuple, tangents: tuple) -> tuple:
    """The linear problem of the contacts that carry, whose matrix is symmetric: ``S df - J dq``, ``-J^T df``."""
    influence, levers, _, applied, _ = primals
    place, forces, closed, good = _answer(sided, *primals)
    carry = jax.lax.stop_gradient(closed) > 0

    def moved(way: Array | SymbolicZero, product: Callable[[Array], Array]) -> Array | float:
        return 0.0 if isinstance(way, SymbolicZero) else product(way)

    pushed = moved(tangents[2], lambda way: way) + moved(tangents[0], lambda way: _approach(way, forces))
    pushed = pushed - moved(tangents[1], lambda way: way @ place)
    pulled = moved(tangents[3], lambda way: way) - moved(tangents[1], lambda way: way.T @ forces)
    number = len(forces)
    # one vector: of two, one may not depend on what is differentiated, which has no transpose
    right = jnp.concatenate([jnp.where(carry, -pushed, jnp.zeros_like(forces)), jnp.zeros_like(applied) - pulled])

    def matrix(unknown: Array) -> Array:
        inner, turn = jnp.where(carry, unknown[:number], 0.0), unknown[number:]
        pressed = jnp.where(carry, _approach(influence, inner) - levers @ turn, unknown[:number])
        return jnp.concatenate([pressed, -(levers.T @ inner)])

    def solve(_: Callable, right: Array) -> Array:
        rest, few = jnp.where(carry, right[:number], 0.0), solved if influence.ndim == 2 else solved_of_blocks
        linear = _linear if influence.ndim == 2 and number >= MANY else few
        turn, push = linear(influence, levers, -rest, -right[number:], carry)
        return jnp.concatenate([jnp.where(carry, push, right[:number]), turn])

    change = jax.lax.custom_linear_solve(matrix, right, solve, symmetric=True)
    push, turn = change[:number], change[number:]
    held = jax.lax.stop_gradient(good) > 0
    still = jnp.zeros_like(closed), jnp.zeros_like(good)
    return (place, forces, closed, good), (jnp.where(held, turn, 0.0), jnp.where(held, push, 0.0), *still)


def _approach(influence: Array, forces: Array) -> Array:
    """What forces make the contacts approach, by a matrix or by blocks of it [m]."""
    if influence.ndim == 2:
        return influence @ forces
    own = forces.reshape(influence.shape[0], -1)
    return (influence * own[:, None, :]).sum(axis=-1).ravel()


def _exact(influence: Array, levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
    """One problem of few contacts: exact steps from all that hold against the load."""
    return carrying(influence, levers, apart, applied, loaded, loaded)


def _single(influence: Array, levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
    """One problem of many contacts: exact steps from a guess."""
    if len(applied) > 1:
        return _exact(influence, levers, apart, applied, loaded)
    at = descended(influence, levers, apart[:, None], applied, loaded[:, None], GUESS)
    guess = at.inside[:, 0] & (at.forces[:, 0] > 0)
    return carrying(influence, levers, apart, applied, loaded, jnp.where(guess.any(), guess, loaded))


def _many(influence: Array, levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
    """Many problems under one matrix: conjugate gradients, exact steps where these leave something."""
    if applied.shape[1] > 1:
        return jax.lax.map(lambda each: _exact(influence, *each), (levers, apart, applied, loaded))

    def part(levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
        lever, gap = levers[:, :, 0].T, apart.T
        at = descended(influence, lever, gap, applied[:, 0], loaded.T, ENOUGH)
        turned = lever * at.place[None]
        reach = jnp.finfo(gap.dtype).eps * CLOSED * (jnp.abs(at.slope - gap) + jnp.abs(gap) + jnp.abs(turned))
        clear = (loaded.T | (turned - at.slope <= reach)).all(axis=0)  # of the other side
        closed = (at.inside & ((at.forces > 0) | (applied[:, 0] == 0)[None])).T

        def exact(lane: Array) -> tuple:
            start = jnp.where(closed[lane].any(), closed[lane], loaded[lane])
            return carrying(influence, levers[lane], apart[lane], applied[lane], loaded[lane], start)

        done = at.done & clear
        return finished((at.place[:, None], at.forces.T, closed, done), done | ~loaded.any(axis=1), exact)

    return in_parts(part, LANES, levers, apart, applied, loaded)


def _many_linear(influence: Array, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
    """Positions and forces with given sets of closed contacts, of many lanes under one matrix."""
    if applied.shape[1] > 1:
        return jax.lax.map(lambda each: solved(influence, *each), (levers, rest, applied, closed))

    def part(levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
        at = descended(influence, levers[:, :, 0].T, rest.T, applied[:, 0], closed.T, ENOUGH, one_sided=False)

        def exact(lane: Array) -> tuple:
            return solved(influence, levers[lane], rest[lane], applied[lane], closed[lane])

        return finished((at.place[:, None], at.forces.T), at.done, exact)

    return in_parts(part, LANES, levers, rest, applied, closed)


_search = side_by_side(_single, _many)
_linear = side_by_side(solved, _many_linear, one_factor=(0, 1, 4))


def _from_first_touch(
    lever: Float[Array, " contact"], gap: Float[Array, " contact"], applied: Scalar
) -> tuple[Scalar, Float[Array, " contact"], Bool[Array, ""]]:
    """Where the load closes the first contact, the gaps counted from there, and whether there is one: positions of
    their own size would round away what a slight load moves."""
    loaded = _loaded(lever, applied)
    able = loaded.any()
    places = jnp.where(loaded, gap / jnp.where(loaded, jnp.abs(lever), 1.0), jnp.inf)
    first = jnp.argmin(places)
    edge = jnp.where(able, gap[first] / jnp.where(able, lever[first], 1.0), 0.0)
    apart = gap - lever * edge
    return edge, jnp.where((jnp.arange(lever.shape[0]) == first) & able, 0.0, apart), able


def _loaded(lever: Float[Array, " contact"], applied: Scalar) -> Bool[Array, " contact"]:
    return jnp.where(applied > 0, lever > 0, lever < 0)
