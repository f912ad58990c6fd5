"""First contact and static equilibrium of one-sided springs with one degree of freedom.

The equilibrium position q solves ``sum_i J_i k_i max(J_i q - gap_i, 0) = Q``. The left side never decreases with q. A
contact therefore carries force exactly if the sum, at the position where this contact begins to touch, has not yet
reached Q. All active contacts are found at once, if they are many by Newton's method between bounds, and the position
is exact.
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
from gearjax.contact.faces import Faces
from gearjax.contact.laws import AbstractContact, HardContact
from gearjax.contact.search import search
from gearjax.contact.springs import CoupledSprings, LinearSprings
from gearjax.contact.supported import moved_by, supported, with_supports
from gearjax.contact.train import closed_first, touching
from gearjax.typing import Array, Bool, Float, Int, Scalar

MOST_ONE_BY_ONE = 24  # contacts that are written out one by one; with more, the program would become too large
MOST_SMOOTH = 5  # contacts of a side up to which the smooth closed form evaluates all subsets; beyond, it is searched
SHORTEST_LEVER = 0.03  # share of the mean lever below which a contact is radial and cannot position the output
FAR = 1.0  # rad, distance at which a contact that cannot touch is assumed to touch


class Equilibrium(eqx.Module):
    """Static equilibrium of the output under a torque.

    Args:
        position: displacement of the output from its ideal position [rad], nan if there is no equilibrium.
        forces: compression of each contact, shape (contact,) [N].
        result: result code: 0 if found, 1 if no flank can carry the torque, 3 if the search did not end.
        moved: displacements in the coordinates after that of the output, shape (coordinate,) [m, rad]; ``None`` if only
            the output moves.
    """

    position: Scalar
    forces: Float[Array, " contact"]
    result: Int[Array, ""]
    moved: Float[Array, " coordinate"] | None = None


def first_contact(contacts: ContactSet, law: AbstractContact) -> tuple[Scalar, Scalar | None]:
    """Edges of the play: output positions at which the first driving flank and the first back flank touch [rad].

    The lower edge is ``max_i(gap_i / J_i)`` over driving contacts (Wang et al. 2020, eq. 8). The upper edge is
    ``min_i(gap_i / J_i)`` over back contacts (eq. 9), or ``None`` without back flanks. In a train the edges are found
    mesh by mesh (`touching`).
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
    """Positions at which the contacts of one side touch, with the side decided by their levers [rad].

    Contacts of the other side get a position far away.

    Args:
        lever, gap: lever and gap of each contact, arrays of any common shape [m/rad], [m].
        sign: 1 for the side that holds against a positive torque, -1 for the other side, whose positions are negated.
        per_lever: one over the mean lever. Contacts with nearly vanishing levers are excluded: a turn of the output can
            hardly open an overlap of such a contact, which is reported as interference (`least_overlap`).
    """
    faces = sign * lever * per_lever < -SHORTEST_LEVER
    size = jnp.where(faces, jnp.abs(lever), 1.0)
    return jnp.where(faces, jnp.clip(-gap / size, -FAR, FAR), -FAR)


def equilibrium(contacts: ContactSet, applied: Scalar, law: AbstractContact) -> Equilibrium:
    """Static equilibrium ``J^T f = Q`` (Wang et al. 2020, eqs. 10-18, with T / r_p in eq. 15).

    With the hard contact law the position is exact. With a smooth law the position is the smooth maximum of the
    equilibria of all subsets of contacts. It differs from the exact position by no more than the smoothing of the
    maximum, also at zero torque, and its forces still balance the torque exactly (a nearly open contact may have a
    slightly negative force).

    In three cases the equilibrium is found by a search, in which a smooth law makes the forces smooth: a smooth law
    with more than 5 contacts on a side, contacts whose levers decide their side, and non-linear springs. Contacts
    between bodies on supports are also solved by a search, in all coordinates at once (`supported`). For springs that a
    matrix couples the search always uses the hard contact law (`coupled_balance`).

    Args:
        contacts: candidate contacts with a stiffness.
        applied: generalised force Q on the output [N m]; it is minus the load torque.
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
    """Position at which a load closes the first contact, of each mesh in a train [rad], and the contacts with gaps
    counted from there, so that the forces of a tiny torque are not lost in rounding."""
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
    """Equilibrium of springs that a matrix couples; the compliance of the supports is added to this matrix."""
    if contacts.free == 1:
        apart = _influence_alone(springs) if contacts.supports is None else None
        influence = with_supports(contacts, springs.influence) if apart is None else apart
        position, forces, code = coupled_balance(
            influence, contacts.jacobian[:, 0], contacts.gap, applied, contacts.layout.in_halves
        )
        place = position[None]
    else:
        place, forces, code = coupled_train(with_supports(contacts, springs.influence), contacts, applied)
    moved = [place[1:]] if contacts.supports is None else [place[1:], moved_by(contacts, forces)]
    moved = None if contacts.jacobian.shape[1] == 1 else jnp.concatenate(moved)
    return Equilibrium(place[0], forces, jnp.where(code == 2, 3, code), moved)


def _influence_alone(springs: CoupledSprings) -> Float[Array, "block own own"] | Faces | None:
    """Influence of blocks that have only the position in common; ``None`` for blocks that are no better alone."""
    faces = springs.blocks
    if isinstance(faces, Faces) and faces.own.shape[-1] > MOST_OWN:
        return faces
    blocks = springs.each_block
    return blocks if blocks.shape[-1] <= MOST_OWN else None


def _scale(contacts: ContactSet) -> Scalar:
    """Mean lever, which turns positions into lengths on the line of action [m/rad]."""
    return jnp.mean(jnp.abs(contacts.lever))


def _hard(contacts: ContactSet, stiffness: Float[Array, " contact"], applied: Scalar) -> Equilibrium:
    """Equilibrium of linear springs by the hard contact law."""
    lever = contacts.lever
    strength = lever * stiffness
    first = _first_loaded(contacts.gap / lever, lever < 0, applied)
    origin, touch = _counted_from(contacts, first)
    few = touch.shape[0] <= MOST_ONE_BY_ONE
    active = (_active_of_few if few else _active_of_many)(touch, lever, strength, applied) | first
    added = _added_one_by_one if few else jnp.sum
    weight = jnp.where(active, lever * strength, 0.0)
    carries = active.any()
    travel = (applied + added(weight * touch)) / jnp.where(carries, added(weight), 1.0)  # from the origin
    forces = jnp.where(active, strength * (travel - touch), 0.0)
    return Equilibrium(jnp.where(carries, origin + travel, jnp.nan), forces, jnp.where(carries, 0, 1))


def _active_of_few(touch: Array, lever: Array, strength: Array, applied: Scalar) -> Bool[Array, " contact"]:
    """Whether each contact carries: the sum of all forces has not reached the load where this contact begins to touch.

    The forces at each position are added one contact after the other, which XLA compiles to one kernel, also over many
    angles. The sum over a table of all contacts by all contacts was two to ten times slower.
    """
    carried = [strength[i] * jnp.maximum(lever[i] * (touch - touch[i]), 0.0) for i in range(touch.shape[0])]
    reaction = functools.reduce(jnp.add, carried)
    return jnp.where(lever < 0, reaction >= applied, reaction < applied)


def _active_of_many(touch: Array, lever: Array, strength: Array, applied: Scalar) -> Bool[Array, " contact"]:
    """Whether each of many contacts carries, by Newton's method between bounds.

    A touch position is the position at which a contact begins to touch. The sum of forces never decreases with the
    position and is linear between two touch positions. Each iteration follows the line at one of the bounds to the
    load; the touch positions on both sides of that point are the next bounds. The iteration ends when no contact begins
    to touch between the bounds, usually after a few iterations, at the latest after as many as there are contacts.
    Sorting the touch positions first took ten times as long. Memory grows with the number of contacts. The result has
    no derivative.
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
        low, high, turn = state  # the load is not reached at the lower bound, and is reached at the upper bound
        pulled = applied > 0  # towards the back flanks: then the line just below the upper bound has more contacts
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
    # The comparison is with the middle between the bounds and not with a bound: XLA may calculate the touch positions
    # again for it, with another rounding than in the loop, and flanks without modification have many equal positions.
    between = 0.5 * (low + high)
    return jnp.where(drives, touch > between, touch < between)


def _added_one_by_one(values: Float[Array, " contact"]) -> Scalar:
    """Sum of a few values; unlike a reduction, it fuses with the calculation of the values."""
    return functools.reduce(jnp.add, [values[i] for i in range(values.shape[0])])


def _counted_from(contacts: ContactSet, first: Array) -> tuple[Scalar, Array]:
    """Position at which one contact touches, and the touch positions of all contacts counted from there.

    The position of the first contact itself is exactly zero. Without this origin, the travel under a tiny torque would
    be lost in rounding, and a fused difference of two positions would round only one of them.
    """
    index = jnp.argmax(first)
    origin = (contacts.gap / contacts.lever)[index]
    apart = contacts.gap - contacts.lever * origin
    return origin, jnp.where(jnp.arange(first.shape[0]) == index, 0.0, apart) / contacts.lever


def _first_loaded(touch: Array, driving: Array, applied: Scalar) -> Array:
    """The contact that a load closes first: the first driving contact, or under a positive load the first back contact.

    It always carries: no other contact on its side touches before it, and contacts of the other side only push towards
    it. It is determined separately, because at a very small load rounding may hide it.
    """
    on_side = jnp.where(applied > 0, ~driving, driving)
    place = jnp.where(on_side, jnp.where(applied > 0, -touch, touch), -jnp.inf)
    return on_side & (jnp.arange(touch.shape[0]) == jnp.argmax(place))


def hard_edges(touch: Sequence[Array], side: Sequence[int]) -> tuple[Array, Array | None]:
    """Edges of the play by the hard contact law as in `first_contact`, with one array for each contact.

    Args:
        touch: position at which each contact touches, arrays of any common shape [rad].
        side: side of each contact, 1 for driving flanks and -1 for back flanks.
    """
    driving, back = ([at for at, on in zip(touch, side, strict=True) if on == which] for which in (1, -1))
    lower = functools.reduce(lambda one, other: jnp.where(one >= other, one, other), driving)
    if not back:
        return lower, None
    return lower, functools.reduce(lambda one, other: jnp.where(one <= other, one, other), back)


def hard_rest(touch: Sequence[Array], strength: Sequence[Array], side: Sequence[int], applied: Array) -> Array:
    """Equilibrium position by the hard contact law as in `equilibrium`, with one array for each contact.

    Args:
        touch: position at which each contact touches, arrays of any common shape [rad].
        strength: torsional stiffness of each contact on the output [N m/rad].
        side: side of each contact, 1 for driving flanks and -1 for back flanks.
        applied: generalised force on the output, a scalar or of the common shape [N m].

    Returns:
        The position [rad], nan if no contact can carry the load.
    """
    signs = [-float(on) for on in side]
    origin = touch[0]  # positions are counted from here: their differences are small against their distance from zero
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
    """All subsets of ``size`` contacts as rows of 0 and 1, the empty subset first."""
    return np.array(list(itertools.product((0.0, 1.0), repeat=size)))


def _smooth(
    contacts: ContactSet, stiffness: Float[Array, " contact"], applied: Scalar, law: AbstractContact
) -> Equilibrium:
    """Equilibrium of linear springs by a smooth contact law, in closed form.

    The sum of forces is ``min over S max over R`` of the sums of closed linear springs in the subsets S (driving) and
    R (back). Its root is therefore ``max over S min over R`` of the roots of these sums (for two pairs in the
    reference: ``max(D1 - q, D2 - q, (D1 + D2 - q) / 2)``).
    """
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
    # without any spring the sum of forces is zero everywhere; its root is set beyond all others on the loaded side
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
