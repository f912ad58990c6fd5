"""Equilibrium of contacts whose springs are coupled by a matrix: teeth of one body, slices of one tooth face.

A force on one contact moves the others too. The forces ``f`` and the position ``q`` of the output (in a train also the
positions of shafts that turn freely) solve a linear complementarity problem:

    S f + gap - J q = y >= 0,   f >= 0,   f y = 0,   J^T f = Q

with the influence matrix ``S`` [m/N], symmetric and positive definite. The search finds the active set, that is the set
of contacts that carry, exactly (`active_set`); from `MANY` contacts on it starts from a guess by conjugate gradients. A
batch of many gaps and loads with one common matrix (`jax.vmap` over the other arguments) is solved together by products
with this matrix, without a factorisation (`conjugate`), first among the contacts that are likely to carry (`likely`).
Lanes, that is problems of the batch, that are not finished then are finished by the exact steps one by one.

Derivatives are implicit and keep the active set fixed. A contact that just touches has two one-sided derivatives: the
result is that of the open contact if its force is rounded to zero, else that of the closed contact.
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
from gearjax.contact.faces import Faces
from gearjax.contact.lanes import finished, in_parts, side_by_side
from gearjax.contact.likely import WORTH_WHILE, Example, descended_among_few, inverse_of_all, linear_among_few
from gearjax.contact.train import closed_first
from gearjax.typing import Array, Bool, Float, Int, Scalar

MANY = 48  # contacts; with fewer, the exact steps of many lanes side by side are as fast
GUESS = 20  # steps of conjugate gradients before the exact steps, for a single problem
ENOUGH = 120  # steps of conjugate gradients for many lanes: twice as many as a matrix with the condition 15 needs
LANES = 128  # lanes at a time, so that their numbers stay in the cache
Solution = tuple[Scalar, Float[Array, " contact"], Int[Array, ""]]


def coupled_balance(
    influence: Float[Array, "contact contact"] | Float[Array, "block own own"] | Faces,
    lever: Float[Array, " contact"],
    gap: Float[Array, " contact"],
    applied: Scalar,
    sided: bool = False,
) -> Solution:
    """Equilibrium of coupled contacts: position of the output, contact forces, and a result code.

    Args:
        influence: approach of each contact per force on each contact, symmetric and positive definite, shape (contact,
            contact); or small diagonal blocks of it, shape (block, own, own) [m/N]; or slices of tooth faces.
        lever: change of overlap per change of the position, of either sign [m/rad].
        gap: gaps at position zero [m].
        applied: generalised force on the output [N m]. At zero, the contacts that hold against a positive torque touch.
        sided: whether the first half of small blocks has driving flanks and the second half as many back flanks.

    Returns:
        Position [rad]; forces [N]; result code: 0 if found, 1 if no contact can carry the load, 2 if the matrix is not
        positive definite or the search did not end. With 1 and 2 position and forces are nan. Differentiable in all
        arguments, to any order. From `MANY` contacts on, only the rows and columns of contacts that carry are checked.
    """
    influence = jax.tree.map(jnp.asarray, influence)
    lever, gap, applied = (jnp.asarray(part) for part in (lever, gap, applied))
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
    """Equilibrium of a train of coupled contacts.

    The results are the positions of the output and of shafts that turn freely [rad], the forces [N] and a result code.

    Args:
        influence: as for `coupled_balance`, including the compliance of supports.
        contacts: contacts whose Jacobian and gaps are used.
        applied: generalised force on the output [N m].
    """
    frozen, weight = jax.lax.stop_gradient((contacts, applied))
    edge, apart = closed_first(frozen, weight)
    loaded = frozen.loaded(weight)
    able = jnp.stack([loaded[own].any() for _, own in frozen.stages]).all()
    levers, loads = contacts.jacobian[:, : contacts.free], jnp.zeros_like(edge).at[0].set(applied)
    return _balanced(influence, levers, contacts.gap, loads, edge, apart, loaded, able)


def _balanced(
    influence: Array | Faces,
    levers: Array,
    gap: Array,
    applied: Array,
    edge: Array,
    apart: Array,
    loaded: Array,
    able: Array,
    sided: bool = False,
) -> tuple[Float[Array, " free"], Float[Array, " contact"], Int[Array, ""]]:
    """Positions, forces and result code of coupled contacts with any number of free coordinates.

    Args:
        influence, gap: as for `coupled_balance`.
        levers: levers on the free coordinates, which only contacts hold, shape (contact, free) [m/rad].
        applied: generalised forces on the free coordinates, shape (free,) [N m].
        edge, apart: positions at which the load closes the first contact of each free coordinate, shape (free,), and
            the gaps counted from these positions.
        loaded: whether each contact can hold against the load.
        able: whether contacts hold all free coordinates.
        sided: as for `coupled_balance`.
    """
    # no contact of the loaded side is closed before the first one, but if several touch together rounding may show it
    apart = jnp.where(loaded, jnp.maximum(apart, 0.0), apart)
    place, forces, _, good = _answer(sided, influence, levers, gap, applied, (edge, apart, loaded, able))
    good = jax.lax.stop_gradient(good) > 0
    result = jnp.where(~able, 1, jnp.where(good, 0, 2))
    return jnp.where(good, place, jnp.nan), jnp.where(good, forces, jnp.nan), result


def _primal(sided: bool, influence: Array | Faces, levers: Array, gap: Array, applied: Array, counted: tuple) -> tuple:
    """Positions, forces, and, as floating-point numbers, which contacts carry and whether the search succeeded."""
    del gap  # the search uses the gaps counted from the first touch; `gap` is an argument for its derivative
    edge, apart, loaded, able = counted
    few: Callable = _exact if _is_whole(influence) else partial(search_of_blocks, sided)
    search = _search if _is_whole(influence) and len(apart) >= MANY else few
    position, forces, closed, done = search(influence, levers, apart, applied, loaded)
    good = done & able
    numbers = (jnp.where(good, part, 0.0) for part in (edge + position, forces, closed.astype(forces.dtype)))
    return *numbers, good.astype(forces.dtype)


_answer = jax.custom_jvp(_primal, nondiff_argnums=(0,))


@partial(_answer.defjvp, symbolic_zeros=True)
def _answer_jvp(sided: bool, primals: tuple, tangents: tuple) -> tuple:
    """Derivatives from the linear problem of the active contacts, ``S df - J dq``, ``-J^T df``, which is symmetric."""
    influence, levers, _, applied, _ = primals
    place, forces, closed, good = _answer(sided, *primals)
    carry = jax.lax.stop_gradient(closed) > 0

    def moved(way: Array | SymbolicZero, product: Callable[[Array], Array]) -> Array | float:
        return 0.0 if isinstance(way, SymbolicZero) else product(way)

    pushed = moved(tangents[2], lambda way: way) + _changed(influence, tangents[0], forces)
    pushed = pushed - moved(tangents[1], lambda way: way @ place)
    pulled = moved(tangents[3], lambda way: way) - moved(tangents[1], lambda way: way.T @ forces)
    number = len(forces)
    # a single vector: of two vectors, one may not depend on the differentiated argument and then has no transpose
    right = jnp.concatenate([jnp.where(carry, -pushed, jnp.zeros_like(forces)), jnp.zeros_like(applied) - pulled])

    def matrix(unknown: Array) -> Array:
        inner, turn = jnp.where(carry, unknown[:number], 0.0), unknown[number:]
        pressed = jnp.where(carry, _approach(influence, inner) - levers @ turn, unknown[:number])
        return jnp.concatenate([pressed, -(levers.T @ inner)])

    def solve(_: Callable, right: Array) -> Array:
        rest, few = jnp.where(carry, right[:number], 0.0), solved if _is_whole(influence) else solved_of_blocks
        linear = _linear if _is_whole(influence) and number >= MANY else few
        turn, push = linear(influence, levers, -rest, -right[number:], carry)
        return jnp.concatenate([jnp.where(carry, push, right[:number]), turn])

    change = jax.lax.custom_linear_solve(matrix, right, solve, symmetric=True)
    push, turn = change[:number], change[number:]
    held = jax.lax.stop_gradient(good) > 0
    still = jnp.zeros_like(closed), jnp.zeros_like(good)
    return (place, forces, closed, good), (jnp.where(held, turn, 0.0), jnp.where(held, push, 0.0), *still)


def _is_whole(influence: Array | Faces) -> bool:
    """Whether this is a matrix of all contacts, not one of its parts."""
    return not isinstance(influence, Faces) and influence.ndim == 2


def _approach(influence: Array | Faces, forces: Array) -> Array:
    """Approach of the contacts under forces [m], from an influence matrix, its diagonal blocks or faces."""
    if isinstance(influence, Faces):
        return influence.approach(forces)
    if influence.ndim == 2:
        return influence @ forces
    own = forces.reshape(influence.shape[0], -1)
    return (influence * own[:, None, :]).sum(axis=-1).ravel()


def _changed(influence: Array | Faces, way: Array | Faces | SymbolicZero, forces: Array) -> Array | float:
    """Change of the approach under constant forces, if the influence changes [m]."""
    ways, numbers = (jax.tree.leaves(part, is_leaf=_is_zero) for part in (way, influence))
    if all(map(_is_zero, ways)):
        return 0.0
    whole = [jnp.zeros_like(known) if _is_zero(own) else own for own, known in zip(ways, numbers, strict=True)]
    changes = jax.tree.unflatten(jax.tree.structure(influence), whole)
    return jax.jvp(lambda influence: _approach(influence, forces), (influence,), (changes,))[1]


def _is_zero(way: object) -> bool:
    return isinstance(way, SymbolicZero)


def _exact(influence: Array, levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
    """Solve one problem with few contacts by exact steps, which start from all contacts that can hold the load."""
    return carrying(influence, levers, apart, applied, loaded, loaded)


def _single(influence: Array, levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
    """Solve one problem with many contacts by exact steps, which start from a guess by conjugate gradients."""
    if len(applied) > 1:
        return _exact(influence, levers, apart, applied, loaded)
    at = descended(influence, levers, apart[:, None], applied, loaded[:, None], GUESS)
    guess = at.inside[:, 0] & (at.forces[:, 0] > 0)
    return carrying(influence, levers, apart, applied, loaded, jnp.where(guess.any(), guess, loaded))


def _many(influence: Array, levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
    """Solve many problems with one matrix by conjugate gradients, and unfinished problems by exact steps."""
    if applied.shape[1] > 1:
        return jax.lax.map(lambda each: _exact(influence, *each), (levers, apart, applied, loaded))
    descend = partial(descended, influence)
    if len(applied) >= WORTH_WHILE:
        example = Example.of(influence, levers[:, :, 0], apart, applied[:, 0], loaded)
        chosen = example.likely(apart[:LANES].T, applied[:LANES, 0], loaded[:LANES].T)
        inverse = inverse_of_all(influence, len(applied), chosen)
        descend = partial(descended_among_few, example, inverse, influence)

    def part(levers: Array, apart: Array, applied: Array, loaded: Array) -> tuple:
        lever, gap = levers[:, :, 0].T, apart.T
        at = descend(lever, gap, applied[:, 0], loaded.T, ENOUGH)
        turned = lever * at.place[None]
        reach = jnp.finfo(gap.dtype).eps * CLOSED * (jnp.abs(at.slope - gap) + jnp.abs(gap) + jnp.abs(turned))
        clear = (loaded.T | (turned - at.slope <= reach)).all(axis=0)  # whether the other side stays open
        closed = (at.inside & ((at.forces > 0) | (applied[:, 0] == 0)[None])).T

        def exact(lane: Array) -> tuple:
            start = jnp.where(closed[lane].any(), closed[lane], loaded[lane])
            return carrying(influence, levers[lane], apart[lane], applied[lane], loaded[lane], start)

        done = at.done & clear
        return finished((at.place[:, None], at.forces.T, closed, done), done | ~loaded.any(axis=1), exact)

    return in_parts(part, LANES, levers, apart, applied, loaded)


def _many_linear(influence: Array, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
    """Positions and forces of many lanes with one matrix and given sets of closed contacts."""
    if applied.shape[1] > 1:
        return jax.lax.map(lambda each: solved(influence, *each), (levers, rest, applied, closed))

    inverse = inverse_of_all(influence, len(applied), closed[:LANES].any(axis=0))

    def part(levers: Array, rest: Array, applied: Array, closed: Array) -> tuple:
        lanes = levers[:, :, 0].T, rest.T, applied[:, 0], closed.T
        forces, place, done = linear_among_few(inverse, influence, *lanes, ENOUGH)

        def exact(lane: Array) -> tuple:
            return solved(influence, levers[lane], rest[lane], applied[lane], closed[lane])

        return finished((place[:, None], forces.T), done, exact)

    return in_parts(part, LANES, levers, rest, applied, closed)


_search = side_by_side(_single, _many)
_linear = side_by_side(solved, _many_linear, one_factor=(0, 1, 4))


def _from_first_touch(
    lever: Float[Array, " contact"], gap: Float[Array, " contact"], applied: Scalar
) -> tuple[Scalar, Float[Array, " contact"], Bool[Array, ""]]:
    """Position at which the load closes the first contact, the gaps counted from there, and whether there is one.

    Counted from zero, the travel under a small load would be lost in rounding.
    """
    loaded = _loaded(lever, applied)
    able = loaded.any()
    places = jnp.where(loaded, gap / jnp.where(loaded, jnp.abs(lever), 1.0), jnp.inf)
    first = jnp.argmin(places)
    edge = jnp.where(able, gap[first] / jnp.where(able, lever[first], 1.0), 0.0)
    apart = gap - lever * edge
    return edge, jnp.where((jnp.arange(lever.shape[0]) == first) & able, 0.0, apart), able


def _loaded(lever: Float[Array, " contact"], applied: Scalar) -> Bool[Array, " contact"]:
    """Whether each contact can hold against the load."""
    return jnp.where(applied > 0, lever > 0, lever < 0)
