"""Active-set method for coupled contacts: it finds the contacts that carry, with an exact solution in each step.

Each step solves the linear problem of one set of closed contacts. The signs of its forces and openings give the next
set (Hintermueller, Ito, Kunisch 2002). These steps are also Newton steps on a convex function. If the sets repeat in a
cycle, a line search on this function shortens the steps, so that the method ends. The result is exact to rounding.
"""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular

from gearjax.elimination import LIBRARY_FROM, eliminated
from gearjax.typing import Array, Bool, Float

MOST_STEPS = 1000  # never reached with a positive definite matrix: condition numbers of 1e6 took up to 200
PLAIN_STEPS = 8  # steps without a line search, which solve nearly all problems
HALVINGS = 40  # bisections of the length of a step
CLOSED = 64.0  # overlap of an open contact that counts as rounding, in units of the rounding of its opening
GATHERED_FROM = LIBRARY_FROM  # contacts; with fewer, a solution for all contacts takes no longer
PARTS = 4  # number of sizes of the matrix into which closed contacts are gathered
Carried = tuple[Float[Array, " free"], Float[Array, " contact"], Bool[Array, " contact"], Bool[Array, ""]]


def carrying(
    influence: Float[Array, "contact contact"],
    levers: Float[Array, "contact free"],
    gap: Float[Array, " contact"],
    applied: Float[Array, " free"],
    loaded: Bool[Array, " contact"],
    start: Bool[Array, " contact"],
) -> Carried:
    """Positions, forces, the set of contacts that carry, and whether this set was found.

    Args:
        influence: approach of each contact per force on each contact [m/N].
        levers: levers of the contacts on the free coordinates, which only contacts hold [m/rad].
        gap: gaps at position zero [m].
        applied: generalised forces on the free coordinates [N m].
        loaded: whether each contact can hold against the load.
        start: set of closed contacts to start from.
    """
    rounding = jnp.finfo(gap.dtype).eps * CLOSED
    few = levers.shape[0] < GATHERED_FROM
    own = _own(influence) if few else jnp.ones((), gap.dtype)

    root = jnp.sqrt(jnp.maximum(jnp.diagonal(influence), 0.0))

    def reached(position: Array, forces: Array, beyond: Array, closed: Array) -> Array:
        """Overlap of each open contact that counts as rounding [m]."""
        known = jnp.abs(gap) + jnp.abs(levers @ position)
        if few:
            return rounding * (jnp.abs(influence) @ jnp.abs(forces) + known)
        # for nearly all contacts, a bound of that product by the Cauchy-Schwarz inequality gives the same decision
        most = root * (root @ jnp.abs(forces))
        doubtful = ~closed & (beyond > rounding * known) & (beyond <= rounding * (most + known))
        own = jax.lax.cond(doubtful.any(), lambda: jnp.abs(influence) @ jnp.abs(forces), lambda: most)
        return rounding * (own + known)

    def tried(closed: Array) -> tuple[tuple, Array, Array]:
        """Position, forces and overlaps with a set of closed contacts, whether the set is right, and the next set."""
        position, forces = solved(influence, levers, gap, applied, closed)
        beyond = levers @ position - gap - influence @ forces
        reach = reached(position, forces, beyond, closed)
        right = jnp.where(closed, forces >= 0, beyond <= reach).all()
        # a contact that overlaps by no more than rounding is not closed: it would open and close again and again
        return (position, forces, beyond), right, held(jnp.where(closed, forces > 0, beyond > reach))

    def held(chosen: Array) -> Array:
        """A set in which each coordinate is held: if no contact holds it, the first contact of its side is added."""
        lacking = ~((chosen & loaded)[:, None] & (levers != 0)).any(axis=0)
        return chosen | (loaded & (gap == 0) & ((levers != 0) & lacking[None]).any(axis=1))

    def plain(state: tuple) -> tuple:
        """A step without a line search."""
        closed, *_, step = state
        (position, forces, beyond), right, chosen = tried(closed)
        return jnp.where(right, closed, chosen), (position, forces, beyond, closed), right, step + 1

    def damped(own: Array, state: tuple) -> tuple:
        """A step with a line search on the convex function."""
        closed, (position, forces, overlap), _, step = state
        (ended, pressed, beyond), right, chosen = tried(closed)
        target = jnp.where(closed, own * pressed, beyond)
        turn, push, close = ended - position, pressed - forces, target - overlap
        bend = influence @ push - own * push

        def slope(share: Array) -> Array:
            pressing = jnp.maximum(overlap + share * close, 0.0)
            return (pressing * close).sum() / own + ((forces + share * push) * bend).sum() - applied @ turn

        def halve(_, ends: tuple) -> tuple:
            low, high = ends
            middle = 0.5 * (low + high)
            falls = slope(middle) < 0
            return jnp.where(falls, middle, low), jnp.where(falls, high, middle)

        zero, one = jnp.zeros((), gap.dtype), jnp.ones((), gap.dtype)
        best = jax.lax.fori_loop(0, HALVINGS, halve, (zero, one))[1]
        share = jnp.where(slope(one) <= 0, one, best)
        at = position + share * turn, forces + share * push, overlap + share * close
        at = tuple(jnp.where(right, whole, part) for whole, part in zip((ended, pressed, target), at, strict=True))
        chosen = jnp.where(share == 1, chosen, held(at[2] > 0))
        return jnp.where(right, closed, chosen), at, right, step + 1

    def unfinished(state: tuple) -> Array:
        _, (position, *_), done, step = state
        return ~done & (step < MOST_STEPS) & jnp.isfinite(position).all()

    # There are two loops, because a single loop over many angles would search the length of every step, also of whole
    # steps. Plain steps start from a set only: a calculated start, from the same set at all angles, would be one matrix
    # with many right-hand sides, which a BLAS divides among threads that wait for each other (ten times the time of all
    # the rest).
    nothing = jnp.zeros_like(applied), jnp.zeros_like(gap), jnp.zeros_like(gap), start
    closed, (position, forces, beyond, last), done, step = jax.lax.while_loop(
        lambda state: unfinished(state) & (state[-1] < PLAIN_STEPS), plain, (start, nothing, jnp.asarray(False), 0)
    )
    if not few:  # this costs two thirds of the cube of the number of contacts, and hardly any problem needs it
        own = jax.lax.cond(done, lambda: own, lambda: _own(influence))
    begin = closed, (position, forces, jnp.where(last, own * forces, beyond)), done, step
    closed, (position, forces, _), done, _ = jax.lax.while_loop(unfinished, lambda state: damped(own, state), begin)
    return position, forces, closed, done & jnp.isfinite(own)


def _own(influence: Array) -> Array:
    """Number that can be subtracted from the diagonal so that the matrix stays positive definite; nan if it is not."""
    size = influence.shape[0]
    unit = jnp.eye(size, dtype=influence.dtype)
    if size < LIBRARY_FROM:
        return 0.5 / jnp.trace(eliminated(influence, unit))
    inverse = solve_triangular(jnp.linalg.cholesky(influence), unit, lower=True)
    return 0.5 / (inverse * inverse).sum()


def solved(influence: Array, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple[Array, Array]:
    """Positions and forces with a given set of closed contacts: ``S f + rest - J q = 0`` on this set, ``J^T f = Q``."""
    number = closed.shape[0]
    if number < GATHERED_FROM:
        return _solved(jnp.where(closed[:, None] & closed[None, :], influence, 0.0), levers, rest, applied, closed)
    sizes = [-(-number * part // PARTS) for part in range(1, PARTS + 1)]

    def gathered(size: int):
        def solve(_: None) -> tuple[Array, Array]:
            (index,) = jnp.nonzero(closed, size=size, fill_value=number)
            at = jnp.minimum(index, number - 1)
            there = index < number
            inner = jnp.where(there[:, None] & there[None, :], influence[at[:, None], at[None, :]], 0.0)
            position, forces = _solved(inner, levers[at], rest[at], applied, there)
            return position, jnp.zeros_like(rest).at[index].set(forces, mode="drop")

        return solve

    fits = sum((closed.sum() > size).astype(jnp.int32) for size in sizes[:-1])
    return jax.lax.switch(fits, [gathered(size) for size in sizes], None)


def _solved(inner: Array, levers: Array, rest: Array, applied: Array, closed: Array) -> tuple[Array, Array]:
    """The same as `solved`, with the matrix of the closed contacts; its other rows and columns are zero."""
    whole = inner + jnp.diag(jnp.where(closed, 0.0, 1.0).astype(inner.dtype))
    arms = jnp.where(closed[:, None], levers, 0.0)
    moved = eliminated(whole, jnp.concatenate([arms, jnp.where(closed, rest, 0.0)[:, None]], axis=1))
    per_turn, at_rest = moved[:, :-1], moved[:, -1]
    steepness, pull = arms.T @ per_turn, applied + arms.T @ at_rest
    holding = jnp.diagonal(steepness) > 0
    safe = steepness + jnp.diag(jnp.where(holding, 0.0, 1.0).astype(inner.dtype))
    position = eliminated(safe, pull[:, None])[:, 0]
    position = jnp.where(holding, position, 0.0)
    return position, jnp.where(closed, per_turn @ position - at_rest, 0.0)
