"""First contact, and the equilibrium of one-sided springs on one degree of freedom.

The equilibrium position q solves ``sum_i J_i k_i max(J_i q - gap_i, 0) = Q``. The left side never falls with q, so a
contact carries force exactly when the sum, taken where that contact begins to touch, has not yet reached Q: all
active contacts are found at once, of many by Newton's method between bounds, and the position is exact.
"""

import functools
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.contact.blocks import MOST_OWN
from gearjax.contact.contacts import ContactSet
from gearjax.contact.coupled import coupled_balance, coupled_train
from gearjax.contact.laws import AbstractContact, HardContact
from gearjax.contact.search import search
from gearjax.contact.springs import CoupledSprings, LinearSprings
from gearjax.contact.supported import moved_by, supported, with_supports
from gearjax.contact.train import closed_first, touching
from gearjax.typing import Array, Bool, Float, Int, Scalar

MOST_ONE_BY_ONE = 24  # contacts; of more, the program would grow
MOST_SMOOTH = 5  # contacts of a side, whose every subset the smooth closed form looks at; of more it is searched for
SHORTEST_LEVER = 0.03  # of the mean one, below which a contact is radial: it does not say where the output is
FAR = 1.0  # rad, where a contact that does not touch counts as touching


class Equilibrium(eqx.Module):
    """Where the output rests under a torque.

    Args:
        position: displacement of the output from its ideal position [rad], nan where there is none.
        forces: compression of each contact, shape (contact,) [N].
        result: 0 found; 1 no flank can carry the torque; 3 the search did not end.
        moved: displacements in the coordinates after the output's, shape (coordinate,) [m, rad]; ``None`` where the
            output alone moves.
    """

    position: Scalar
    forces: Float[Array, " contact"]
    result: Int[Array, ""]
    moved: Float[Array, " coordinate"] | None = None


def first_contact(contacts: ContactSet, law: AbstractContact) -> tuple[Scalar, Scalar | None]:
    """Edges of the play: output positions [rad] at which the first driving and the first back flank touch.

    Lower edge ``max_i(gap_i / J_i)`` over driving contacts (Wang et al. 2020, eq. 8), upper edge
    ``min_i(gap_i / J_i)`` over back contacts (eq. 9), ``None`` without back flanks. In a train motion is handed on from
    mesh to mesh (`touching`).
    """
    layout = contacts.layout
    if contacts.free > 1:
        ends = [touching(contacts, law, side)[0] for side in ((1, -1) if layout.has_back else (1,))]
        return ends[0], ends[1] if layout.has_back else None
    scale = _scale(contacts)
    if layout.sides_turn:
        sides = (facing(contacts.lever, contacts.gap, sign, 1 / scale) for sign in (1.0, -1.0))
        lower, upper = (law.maximum(side * scale) / scale for side in sides)
        return lower, -upper
    touch = contacts.gap / contacts.lever
    lower = law.maximum(touch[layout.on(1)] * scale) / scale
    if not layout.has_back:
        return lower, None
    return lower, -law.maximum(-touch[layout.on(-1)] * scale) / scale


def facing(lever: Array, gap: Array, sign: float | Array, per_lever: Array) -> Array:
    """Positions at which the contacts on one side touch, as their levers tell, those of the other side far away [rad].

    Args:
        lever, gap: of the contacts, arrays of any one shape [m/rad], [m].
        sign: 1 for the side that holds against a positive torque, -1 for the other, whose positions are negated.
        per_lever: one over the mean lever. A contact whose lever all but vanishes does not decide: the output can
            hardly clear an overlap there, which is interference and told as such (`least_overlap`).
    """
    faces = sign * lever * per_lever < -SHORTEST_LEVER
    size = jnp.where(faces, jnp.abs(lever), 1.0)
    return jnp.where(faces, jnp.clip(-gap / size, -FAR, FAR), -FAR)


def equilibrium(contacts: ContactSet, applied: Scalar, law: AbstractContact) -> Equilibrium:
    """Static equilibrium ``J^T f = Q`` (Wang et al. 2020, eqs. 10-18, with T / r_p in eq. 15).

    With the hard law the position is exact. With a smooth law the position is the smooth maximum of the
    equilibria of all subsets of contacts: it differs from the exact one by no more than the smoothing of the
    maximum, holds at zero torque too, and its forces still balance the torque exactly (a nearly open contact may
    show a slightly negative force). Of more than 5 contacts of a side, of contacts whose levers tell their side, and
    of springs that are not linear the balance is searched for; there a smooth law makes the forces smooth. So it is
    for contacts between bodies that have supports, in all their coordinates at once (`supported`), and for springs that
    a matrix couples (`coupled_balance`), by the hard law.

    Args:
        contacts: candidate contacts, with a stiffness.
        applied: generalised force Q on the output [N m]; a positive load torque is negative here.
        law: contact law.

    Returns:
        Position, forces and result code. At zero load the driving flanks touch.
    """
    springs = contacts.springs
    if springs is None:
        raise ValueError("rigid contacts have no equilibrium under torque: give them a stiffness")
    if isinstance(springs, CoupledSprings):
        return _coupled(contacts, springs, applied)
    alone = contacts.jacobian.shape[1] == 1
    if alone and not contacts.layout.sides_turn and isinstance(springs, LinearSprings):
        if isinstance(law, HardContact):
            return _hard(contacts, springs.stiffness, applied)
        if max(contacts.layout.side.count(side) for side in (1, -1)) <= MOST_SMOOTH:
            return _smooth(contacts, springs.stiffness, applied, law)
    edge, counted = _from_first_touch(contacts, applied)
    if alone:
        position, forces, carries = search(counted, applied, law)
        return Equilibrium(edge[0] + position, forces, jnp.where(carries, 0, 1))
    place, forces, result = supported(counted, applied, law)
    place = place.at[: contacts.free].add(edge)
    return Equilibrium(place[0], forces, result, place[1:])


def _from_first_touch(contacts: ContactSet, applied: Scalar) -> tuple[Float[Array, " free"], ContactSet]:
    """Where a load closes the first contact, of each mesh in a train [rad], and the contacts counted from there, so
    that the forces of a tiny torque are not lost in rounding."""
    if contacts.free > 1:
        place, apart = closed_first(contacts, applied)
        return place, eqx.tree_at(lambda c: c.gap, contacts, apart)
    lever = contacts.jacobian[:, 0]
    side = jnp.where(applied > 0, -1.0, 1.0).astype(contacts.gap.dtype)
    touch = facing(lever, contacts.gap, side, 1 / jnp.mean(jnp.abs(lever)))
    first = jnp.argmax(touch)
    edge = side * touch[first]
    apart = contacts.gap - lever * edge
    apart = jnp.where((jnp.arange(touch.shape[0]) == first) & (jnp.abs(edge) < FAR), 0.0, apart)
    return edge[None], eqx.tree_at(lambda c: c.gap, contacts, apart)


def _coupled(contacts: ContactSet, springs: CoupledSprings, applied: Scalar) -> Equilibrium:
    """Springs coupled by a matrix, which what the supports give way by adds to."""
    small = contacts.free == 1 and contacts.supports is None and springs.blocks.shape[-1] <= MOST_OWN
    influence = springs.blocks if small else with_supports(contacts, springs.influence)
    if contacts.free == 1:
        position, forces, code = coupled_balance(
            influence, contacts.jacobian[:, 0], contacts.gap, applied, contacts.layout.in_halves
        )
        place = position[None]
    else:
        place, forces, code = coupled_train(influence, contacts, applied)
    moved = [place[1:]] if contacts.supports is None else [place[1:], moved_by(contacts, forces)]
    moved = None if contacts.jacobian.shape[1] == 1 else jnp.concatenate(moved)
    return Equilibrium(place[0], forces, jnp.where(code == 2, 3, code), moved)


def _scale(contacts: ContactSet) -> Scalar:
    """Lever that turns positions into lengths on the line of action [m/rad]."""
    return jnp.mean(jnp.abs(contacts.lever))


def _hard(contacts: ContactSet, stiffness: Float[Array, " contact"], applied: Scalar) -> Equilibrium:
    lever = contacts.lever
    strength = lever * stiffness
    first = _first_loaded(contacts.gap / lever, lever < 0, applied)
    origin, touch = _counted_from(contacts, first)
    few = touch.shape[0] <= MOST_ONE_BY_ONE
    active = (_active_of_few if few else _active_of_many)(touch, lever, strength, applied) | first
    added = _added_one_by_one if few else jnp.sum
    weight = jnp.where(active, lever * strength, 0.0)
    carries = active.any()
    travel = (applied + added(weight * touch)) / jnp.where(carries, added(weight), 1.0)  # of the output from the origin
    forces = jnp.where(active, strength * (travel - touch), 0.0)
    return Equilibrium(jnp.where(carries, origin + travel, jnp.nan), forces, jnp.where(carries, 0, 1))


def _active_of_few(touch: Array, lever: Array, strength: Array, applied: Scalar) -> Bool[Array, " contact"]:
    """Which contacts carry: those where all of them together have not yet reached the load when they begin to touch.

    One contact after the other adds to what is carried at each place, which XLA makes one kernel of, also over many
    angles; the table of all by all, summed, was two to ten times slower.
    """
    carried = [strength[i] * jnp.maximum(lever[i] * (touch - touch[i]), 0.0) for i in range(touch.shape[0])]
    reaction = functools.reduce(jnp.add, carried)
    return jnp.where(lever < 0, reaction >= applied, reaction < applied)


def _active_of_many(touch: Array, lever: Array, strength: Array, applied: Scalar) -> Bool[Array, " contact"]:
    """The same for many contacts, by Newton's method between bounds.

    The reaction never falls from one touch position to the next, and is a straight line between two of them. Each turn
    follows the line at one of the bounds to the load, and looks at the touch positions on both sides of where that
    leads: they are the next bounds. It ends where no contact touches between the bounds, mostly after a few turns, at
    the latest after as many as there are contacts. Sorting the positions first took ten times as long. Memory grows
    with the contacts. Which contacts carry has no derivative.
    """
    touch, lever, strength, applied = jax.lax.stop_gradient((touch, lever, strength, applied))
    drives, weight, number = lever < 0, lever * strength, touch.shape[0]
    ends = jnp.full((), -jnp.inf, touch.dtype), jnp.full((), jnp.inf, touch.dtype)

    def reached(place: Scalar) -> Array:
        there = jnp.where(jnp.isfinite(place), place, 0.0)
        reaction = (strength * jnp.maximum(lever * (there - touch), 0.0)).sum()
        return jnp.where(jnp.isfinite(place), reaction >= applied, place > 0)

    def left(state: tuple[Array, Array, Array]) -> Array:
        low, high, turn = state
        return ((touch > low) & (touch < high)).any() & (turn < number)

    def nearer(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        low, high, turn = state  # below the first the load is not reached, from the second on it is
        pulled = applied > 0  # towards the back flanks: the line of more contacts is that before the second
        held = jnp.where(
            pulled, jnp.where(drives, touch >= high, touch < high), jnp.where(drives, touch > low, touch <= low)
        )
        own = jnp.where(held, weight, 0.0)
        whole = own.sum()
        root = (applied + (own * touch).sum()) / jnp.where(whole > 0, whole, 1.0)
        root = jnp.where(whole > 0, root, jnp.where(pulled, high, low))
        above = jnp.where((touch >= root) & (touch > low), touch, jnp.inf).min()
        below = jnp.where((touch < root) & (touch < high), touch, -jnp.inf).max()
        above, below = jnp.minimum(above, high), jnp.maximum(below, low)
        over, under = (above >= high) | reached(above), (below <= low) | ~reached(below)
        low, high = jnp.where(over, low, above), jnp.where(over, above, high)
        return jnp.where(under, jnp.maximum(low, below), low), jnp.where(under, high, below), turn + 1

    low, high, _ = jax.lax.while_loop(left, nearer, (*ends, jnp.zeros((), jnp.int32)))
    # They are told apart half way between two places, not at one: XLA may work positions out again for this comparison,
    # rounded otherwise than in the loop, and on flanks without modification many are equal to rounding.
    between = 0.5 * (low + high)
    return jnp.where(drives, touch > between, touch < between)


def _added_one_by_one(values: Float[Array, " contact"]) -> Scalar:
    """Sum of few values, which fuses with what they are made of, unlike a reduction."""
    return functools.reduce(jnp.add, [values[i] for i in range(values.shape[0])])


def _counted_from(contacts: ContactSet, first: Array) -> tuple[Scalar, Array]:
    """Position at which one contact touches, and positions of all counted from there, its own exactly zero.

    Positions of their own size would round away what hardly any torque moves, and a fused difference of two of them
    rounds one and not the other.
    """
    index = jnp.argmax(first)
    origin = (contacts.gap / contacts.lever)[index]
    apart = contacts.gap - contacts.lever * origin
    return origin, jnp.where(jnp.arange(first.shape[0]) == index, 0.0, apart) / contacts.lever


def _first_loaded(touch: Array, driving: Array, applied: Scalar) -> Array:
    """The contact that a load closes first: the first driving one, or under a positive load the first back one.

    It always carries: nothing on its side holds the output before it does, and the other side only pushes towards it.
    Said apart, because rounding may hide it at hardly any load.
    """
    on_side = jnp.where(applied > 0, ~driving, driving)
    place = jnp.where(on_side, jnp.where(applied > 0, -touch, touch), -jnp.inf)
    return on_side & (jnp.arange(touch.shape[0]) == jnp.argmax(place))


def hard_edges(touch: Sequence[Array], side: Sequence[int]) -> tuple[Array, Array | None]:
    """Edges of the play by the hard law, as `first_contact`, with one array for each contact.

    Args:
        touch: position at which each contact touches, arrays of any one shape [rad].
        side: of each contact, 1 for driving flanks and -1 for back flanks.
    """
    driving, back = ([at for at, on in zip(touch, side, strict=True) if on == which] for which in (1, -1))
    lower = functools.reduce(lambda one, other: jnp.where(one >= other, one, other), driving)
    if not back:
        return lower, None
    return lower, functools.reduce(lambda one, other: jnp.where(one <= other, one, other), back)


def hard_rest(touch: Sequence[Array], strength: Sequence[Array], side: Sequence[int], applied: Array) -> Array:
    """Position of the equilibrium by the hard law, as `equilibrium`, with one array for each contact.

    Args:
        touch: position at which each contact touches, arrays of any one shape [rad].
        strength: stiffness of each on the output [N m/rad].
        side: of each contact, 1 for driving flanks and -1 for back flanks.
        applied: generalised force on the output, one or of the shape of the others [N m].

    Returns:
        The position [rad], nan where no contact can carry the load.
    """
    signs = [-float(on) for on in side]
    origin = touch[0]  # positions count from it: they are small beside their distance from zero
    apart = [place - origin for place in touch]
    pull, total = jnp.zeros_like(origin), jnp.zeros_like(origin)
    for place, stiffness, sign in zip(apart, strength, signs, strict=True):
        reaction = functools.reduce(
            jnp.add,
            [
                s * k * jnp.maximum(s * (place - other), 0.0)
                for other, k, s in zip(apart, strength, signs, strict=True)
                if other is not place
            ],
            jnp.zeros_like(origin),
        )
        active = reaction >= applied if sign < 0 else reaction < applied
        pull = pull + jnp.where(active, stiffness * place, 0.0)
        total = total + jnp.where(active, stiffness, 0.0)
    carries = total > 0
    return jnp.where(carries, origin + (applied + pull) / jnp.where(carries, total, 1.0), jnp.nan)


def _subsets(size: int) -> np.ndarray:
    """All subsets of ``size`` contacts as rows of 0 and 1, the empty one first."""
    return np.array(list(itertools.product((0.0, 1.0), repeat=size)))


def _smooth(
    contacts: ContactSet, stiffness: Float[Array, " contact"], applied: Scalar, law: AbstractContact
) -> Equilibrium:
    """The sum of forces is ``min over S max over R`` of the linear springs S (driving) and R (back) held closed,
    so its root is the ``max over S min over R`` of their roots (reference form for two pairs:
    ``max(D1 - q, D2 - q, (D1 + D2 - q) / 2)``)."""
    layout, dtype = contacts.layout, contacts.gap.dtype
    drive, back = (_subsets(layout.side.count(side)) for side in (1, -1))
    held = np.zeros((len(drive), len(back), len(layout.side)))  # (drive subset, back subset, contact)
    held[:, :, layout.on(1)], held[:, :, layout.on(-1)] = drive[:, None, :], back[None, :, :]
    members = jnp.asarray(held, dtype=dtype)
    lever, scale = contacts.lever, _scale(contacts)
    touch = contacts.gap / lever
    origin = touch[0]
    weight = members * (lever * lever * stiffness)[None, None, :]
    total = weight.sum(axis=-1).at[0, 0].set(1.0)
    root = (applied + (weight * (touch - origin)[None, None, :]).sum(axis=-1)) / total
    # no spring at all: the sum of forces is zero everywhere, its root is beyond all others on the side of the load
    nowhere = jnp.where(applied > 0, 1e3, -1e3).astype(dtype)
    root = (root * scale).at[0, 0].set(nowhere)
    inner = -jax.vmap(law.maximum)(-root)
    inner_weights = jax.vmap(law.weights)(-root)
    outer_weights = law.weights(inner)
    chosen = outer_weights[:, None] * inner_weights
    position = origin + law.maximum(inner) / scale
    carries = chosen[0, 0] < 0.5
    each = (stiffness * lever)[None, None, :] * ((root / scale)[:, :, None] - (touch - origin)[None, None, :])
    forces = (chosen[:, :, None] * members * each).sum(axis=(0, 1))
    return Equilibrium(jnp.where(carries, position, jnp.nan), forces, jnp.where(carries, 0, 1))
