"""Conjugate gradients for contacts that one matrix couples, with many gaps and loads at once.

A lane is one problem of a batch; the last axis of all arrays is the lane. The method minimises ``f S f / 2 + gap f``
under ``J f = Q`` over the forces of the contacts that carry. When the residual of a set of contacts has become small,
the set changes: contacts with a tensile force are opened, the remaining forces are scaled to the load, and open
contacts that overlap are closed. Each step needs one product of the matrix with a column per lane. The column is the
search direction, or the forces themselves after contacts were opened and before a result counts as found. No matrix of
a single lane is factorised; a preconditioner may be given for all. A result either fulfils all conditions to rounding
or counts as not found.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from gearjax.typing import Array, Bool, Float, Int

# accuracy of closed contacts and overlap of open contacts, in units of the rounding of their opening; the smaller value
# of float32 leaves forces accurate to 2e-5 of the largest force, in a twentieth of the time
ROUNDING, ROUNDING_OF_SINGLE = 64.0, 8.0
FEWER = 1 / 4  # share of the lanes; when so few are unfinished, these are taken out and continue by themselves
EASED = 0.3  # share of the first residual of a set, below which the set may change


class Lanes(NamedTuple):
    """State of the iteration in all lanes.

    Args:
        forces, way: force of each contact and its search direction, shape (contact, lane).
        slope: gradient by the force of each contact: its opening plus its lever times the position [m].
        inside: whether each contact carries.
        fresh: whether the slope has to be calculated again from the forces, shape (lane,).
        place: position [rad].
        first: first residual of the current set of contacts [m].
        done: whether all conditions are fulfilled, with a slope that was calculated from the forces.
        step: number of products so far.
    """

    forces: Float[Array, "contact lane"]
    way: Float[Array, "contact lane"]
    slope: Float[Array, "contact lane"]
    inside: Bool[Array, "contact lane"]
    fresh: Bool[Array, " lane"]
    place: Float[Array, " lane"]
    first: Float[Array, " lane"]
    done: Bool[Array, " lane"]
    step: Int[Array, ""]


class Problems(NamedTuple):
    """What is given for each lane.

    Args:
        lever: lever of each contact, shape (contact, lane) [m/rad].
        gap: gaps at position zero [m].
        applied: generalised force, shape (1, lane) [N m].
        allowed: whether each contact may carry.
    """

    lever: Float[Array, "contact lane"]
    gap: Float[Array, "contact lane"]
    applied: Float[Array, "1 lane"]
    allowed: Bool[Array, "contact lane"]


class Begin(NamedTuple):
    """A start of the iteration.

    Args:
        forces: contact forces that hold the load, shape (contact, lane).
        inside: whether each contact carries.
        usable: whether a lane can start from them, shape (1, lane).
        slope: opening of each contact under these forces at position zero [m], if it is known. A lane that fulfils all
            conditions is then finished without a step.
    """

    forces: Float[Array, "contact lane"]
    inside: Bool[Array, "contact lane"]
    usable: Bool[Array, "1 lane"]
    slope: Float[Array, "contact lane"] | None = None


def _rounding(gap: Array) -> float:
    """Share of an opening that counts as rounding."""
    return float(jnp.finfo(gap.dtype).eps) * (ROUNDING if gap.dtype == jnp.float64 else ROUNDING_OF_SINGLE)


def _standing(slope: Array, lever: Array, gap: Array, inside: Array) -> tuple[Array, Array, Array, Array]:
    """Positions, overlaps, the largest overlap of the contacts that carry, and how much of it counts as rounding.

    Their shapes are (1, lane), (contact, lane), (1, lane) and (1, lane).
    """
    arms = jnp.where(inside, lever, 0.0)
    place = (arms * slope).sum(axis=0, keepdims=True) / (arms * arms).sum(axis=0, keepdims=True)
    beyond = lever * place - slope
    left = jnp.abs(jnp.where(inside, beyond, 0.0)).max(axis=0, keepdims=True)
    size = jnp.where(inside, jnp.abs(slope - gap) + jnp.abs(gap), 0.0).max(axis=0, keepdims=True)
    reach = _rounding(gap) * (size + jnp.abs(place) * jnp.abs(arms).max(axis=0, keepdims=True))
    return place, beyond, left, reach


def _without_load(way: Array, along: Array, lever: Array) -> Array:
    """A search direction, less so much of the direction ``along`` that it does not change the load."""
    return way - along * ((lever * way).sum(axis=0, keepdims=True) / (lever * along).sum(axis=0, keepdims=True))


def descended(
    influence: Float[Array, "contact contact"],
    lever: Float[Array, "contact lane"],
    gap: Float[Array, "contact lane"],
    applied: Float[Array, " lane"],
    allowed: Bool[Array, "contact lane"],
    most: int,
    one_sided: bool = True,
    begin: Begin | None = None,
    preconditioner: Float[Array, "contact contact"] | None = None,
    checked: bool = True,
) -> Lanes:
    """Forces and positions of many lanes after a limited number of steps.

    Most lanes need few steps and some need many: when few lanes are unfinished, these continue by themselves.

    Args:
        influence: approach of each contact per force on each contact [m/N].
        lever: lever of each contact [m/rad].
        gap: gaps at position zero [m].
        applied: generalised forces [N m].
        allowed: whether each contact may carry; the levers of these contacts have the sign of the load.
        most: greatest number of steps.
        one_sided: whether contacts can only press. If not, all allowed contacts carry forces of either sign, and their
            levers may have any sign.
        begin: start of the lanes for which it is usable; all conditions are looked at again. Other lanes start with all
            allowed contacts.
        preconditioner: matrix near the inverse of the influence of the contacts that carry, symmetric and positive
            definite: the nearer it is, the fewer steps are needed.
        checked: whether a result counts only with a slope calculated from its forces. If not, the caller looks at it.
    """
    lanes = Problems(lever, gap, applied[None], allowed)
    fewer = int(FEWER * len(applied))

    def steps(lanes: Problems, at: Lanes, left: int) -> Lanes:
        """Steps of some lanes until no more than the number ``left`` are unfinished."""
        return jax.lax.while_loop(
            lambda at: ((~at.done).sum() > left) & (at.step < most),
            lambda at: _step(influence, preconditioner, one_sided, checked, lanes, at),
            at,
        )

    at = steps(lanes, _first(lanes, one_sided, begin), fewer)

    def continued(at: Lanes) -> Lanes:
        """Steps of the unfinished lanes by themselves."""
        order = jnp.argsort(at.done[0])  # unfinished lanes first
        taken = partial(jax.tree.map, lambda part: part[:, order[:fewer]] if part.ndim else part)
        return _put_back(at, steps(taken(lanes), taken(at), 0), jnp.argsort(order))

    if fewer:
        at = jax.lax.cond(at.done.all() | (at.step >= most), lambda at: at, continued, at)
    return at._replace(fresh=at.fresh[0], place=at.place[0], first=at.first[0], done=at.done[0])


def _put_back(at: Lanes, rest: Lanes, place: Int[Array, " lane"]) -> Lanes:
    """State of all lanes, with that of some; ``place`` is the place of each lane among these, or beyond the last."""
    number = rest.done.shape[1]
    own, among = jnp.minimum(place, number - 1), place < number
    return jax.tree.map(lambda part, new: jnp.where(among, new[:, own], part) if new.ndim else new, at, rest)


def _first(lanes: Problems, one_sided: bool, begin: Begin | None) -> Lanes:
    """State before the first step; arguments as for `descended`."""
    lever, gap, applied, allowed = lanes
    arms = jnp.where(allowed, lever, 0.0)
    spread = (arms * arms).sum(axis=0, keepdims=True)
    forces = arms * (applied / jnp.where(spread > 0, spread, 1.0))
    inside = allowed & ((applied != 0) | (gap == 0)) if one_sided else allowed
    slope, place, idle = jnp.zeros_like(gap), jnp.zeros_like(applied), ~allowed.any(axis=0, keepdims=True)
    if begin is not None:
        forces, inside = (jnp.where(begin.usable, *both) for both in ((begin.forces, forces), (begin.inside, inside)))
    if begin is not None and begin.slope is not None:
        slope = begin.slope
        own, beyond, left, reach = _standing(slope, lever, gap, inside)
        wrong = _joins(beyond, reach, lanes, inside) | (inside & (forces < 0))
        found = begin.usable & (left <= reach) & ~wrong.any(axis=0, keepdims=True)
        place, idle = jnp.where(found, own, place), idle | found
    return Lanes(
        forces=forces,
        way=jnp.zeros_like(gap),
        slope=slope,
        inside=inside,
        fresh=jnp.ones(applied.shape, bool),
        place=place,
        first=jnp.zeros_like(applied),
        done=idle,
        step=jnp.zeros((), jnp.int32),
    )


def _joins(beyond: Array, reach: Array, lanes: Problems, inside: Array) -> Bool[Array, "contact lane"]:
    """Whether each open contact overlaps by more than rounding."""
    return ~inside & lanes.allowed & (beyond > reach + _rounding(lanes.gap) * jnp.abs(lanes.gap))


def _step(
    influence: Array, preconditioner: Array | None, one_sided: bool, checked: bool, lanes: Problems, at: Lanes
) -> Lanes:
    """One step of some lanes; arguments as for `descended`."""
    lever, gap, applied, _ = lanes
    product = influence @ jnp.where(at.fresh, at.forces, at.way)
    bend = (at.way * product).sum(axis=0, keepdims=True)
    bend = jnp.where(bend > 0, bend, 1.0)
    # a finished lane is not changed any more, because in float32 it would drift away
    share = jnp.where(at.fresh | at.done, 0.0, -(at.way * at.slope).sum(axis=0, keepdims=True) / bend)
    forces = at.forces + share * at.way
    slope = jnp.where(at.fresh, product + gap, at.slope + share * product)
    place, beyond, left, reach = _standing(slope, lever, gap, at.inside)
    settled, first, inside, cut = left <= reach, jnp.where(at.fresh, left, at.first), at.inside, at.done & False
    changed = cut
    if one_sided:
        eased = settled | (left <= EASED * first)
        pulls = inside & (forces < 0) & eased
        joins = _joins(beyond, reach, lanes, inside) & eased
        cut, changed = pulls.any(axis=0, keepdims=True), (pulls | joins).any(axis=0, keepdims=True)
        inside = (inside & ~pulls) | joins
        pressing = jnp.where(inside, jnp.maximum(forces, 0.0), 0.0)
        carried = (lever * pressing).sum(axis=0, keepdims=True)
        forces = jnp.where(cut, pressing * (applied / jnp.where(carried == 0, 1.0, carried)), forces)
        settled = settled & ~changed
    known = at.fresh if checked else jnp.ones_like(at.fresh)
    arms = jnp.where(inside, lever, 0.0)
    level = jnp.where(inside, beyond, 0.0)
    if preconditioner is None:
        level = _without_load(level, arms, arms)
        steepest = level
    else:
        steepest, spread = (jnp.where(inside, preconditioner @ part, 0.0) for part in (level, arms))
        steepest = _without_load(steepest, spread, arms)
    turn = jnp.where(at.fresh | changed, 0.0, -(steepest * product).sum(axis=0, keepdims=True) / bend)
    way = steepest + turn * jnp.where(inside, at.way, 0.0)
    return Lanes(
        forces=jnp.where(at.done, at.forces, forces),
        way=way,
        slope=slope,
        inside=jnp.where(at.done, at.inside, inside),
        fresh=~at.done & (cut | (settled & ~known)),
        place=jnp.where(at.done, at.place, place),
        first=jnp.where(changed, jnp.abs(level).max(axis=0, keepdims=True), first),
        done=at.done | (settled & known),
        step=at.step + 1,
    )
