"""Contacts coupled by one matrix, many gaps and loads at once: conjugate gradients, lanes last.

The forces that make ``f S f / 2 + gap f`` least under ``J f = Q`` are followed downhill within the contacts that carry.
Where little is left of what a set began with, contacts that pull are let go, what remains is brought to the load, and
open contacts that overlap join. Each step is one product of the matrix with a column per lane: of its direction, or of
its forces after contacts were let go and before an answer counts as found. Nothing is factorised, and what is found
fulfils the conditions to rounding, or is told as not found.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from gearjax.typing import Array, Bool, Float, Int

# roundings of the opening, within which contacts that carry are closed and others do not overlap: few of float32's
# leave forces right to 2e-5 of the largest, for a twentieth of the time
ROUNDING, ROUNDING_OF_SINGLE = 64.0, 8.0
EASED = 0.3  # of what a set began with, below which it may change


class Lanes(NamedTuple):
    """Where the lanes are.

    Args:
        forces, way: of each contact its force and its direction, shape (contact, lane).
        slope: of each contact its opening plus what the position takes from it [m].
        inside: contacts that carry.
        fresh: whether the slope is to be worked out anew, shape (lane,).
        place: position [rad].
        first: what a set of contacts began with [m].
        done: whether all conditions hold, by a slope worked out anew.
        step: products so far.
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


def descended(
    influence: Float[Array, "contact contact"],
    lever: Float[Array, "contact lane"],
    gap: Float[Array, "contact lane"],
    applied: Float[Array, " lane"],
    allowed: Bool[Array, "contact lane"],
    most: int,
    one_sided: bool = True,
) -> Lanes:
    """Forces and positions of many lanes after no more than so many steps.

    Args:
        influence: approach of each contact per force on each [m/N].
        lever: of each contact [m/rad].
        gap: openings at position zero [m].
        applied: generalised forces [N m].
        allowed: contacts that may carry, whose levers have the sign of the load.
        most: steps.
        one_sided: whether forces press only. Else all allowed contacts carry, either way, with levers of any sign.
    """
    rounding = jnp.finfo(gap.dtype).eps * (ROUNDING if gap.dtype == jnp.float64 else ROUNDING_OF_SINGLE)

    applied = applied[None]  # one row: numbers of lanes stand beside those of their contacts

    def advance(at: Lanes) -> Lanes:
        product = influence @ jnp.where(at.fresh, at.forces, at.way)
        bend = (at.way * product).sum(axis=0, keepdims=True)
        bend = jnp.where(bend > 0, bend, 1.0)
        # a lane that is found stays as it is: float32 would wander off
        share = jnp.where(at.fresh | at.done, 0.0, -(at.way * at.slope).sum(axis=0, keepdims=True) / bend)
        forces = at.forces + share * at.way
        slope = jnp.where(at.fresh, product + gap, at.slope + share * product)
        arms = jnp.where(at.inside, lever, 0.0)
        place = (arms * slope).sum(axis=0, keepdims=True) / (arms * arms).sum(axis=0, keepdims=True)
        beyond = lever * place - slope  # overlap
        left = jnp.abs(jnp.where(at.inside, beyond, 0.0)).max(axis=0, keepdims=True)
        size = jnp.where(at.inside, jnp.abs(slope - gap) + jnp.abs(gap), 0.0).max(axis=0, keepdims=True)
        reach = rounding * (size + jnp.abs(place) * jnp.abs(arms).max(axis=0, keepdims=True))
        settled, first, inside, cut = left <= reach, jnp.where(at.fresh, left, at.first), at.inside, at.done & False
        changed = cut
        if one_sided:
            eased = settled | (left <= EASED * first)
            pulls = inside & (forces < 0) & eased
            joins = ~inside & allowed & (beyond > reach + rounding * jnp.abs(gap)) & eased
            cut, changed = pulls.any(axis=0, keepdims=True), (pulls | joins).any(axis=0, keepdims=True)
            inside = (inside & ~pulls) | joins
            pressing = jnp.where(inside, jnp.maximum(forces, 0.0), 0.0)
            carried = (lever * pressing).sum(axis=0, keepdims=True)
            forces = jnp.where(cut, pressing * (applied / jnp.where(carried == 0, 1.0, carried)), forces)
            settled = settled & ~changed
        arms = jnp.where(inside, lever, 0.0)
        level = jnp.where(inside, beyond, 0.0)
        level = level - arms * ((arms * level).sum(axis=0, keepdims=True) / (arms * arms).sum(axis=0, keepdims=True))
        turn = jnp.where(at.fresh | changed, 0.0, -(level * product).sum(axis=0, keepdims=True) / bend)
        way = level + turn * jnp.where(inside, at.way, 0.0)
        return Lanes(
            forces=jnp.where(at.done, at.forces, forces),
            way=way,
            slope=slope,
            inside=jnp.where(at.done, at.inside, inside),
            fresh=~at.done & (cut | (settled & ~at.fresh)),
            place=jnp.where(at.done, at.place, place),
            first=jnp.where(changed, jnp.abs(level).max(axis=0, keepdims=True), first),
            done=at.done | (settled & at.fresh),
            step=at.step + 1,
        )

    arms = jnp.where(allowed, lever, 0.0)
    spread = (arms * arms).sum(axis=0, keepdims=True)
    start = arms * (applied / jnp.where(spread > 0, spread, 1.0))
    none, rest, no = jnp.zeros_like(gap), jnp.zeros_like(applied), jnp.zeros(applied.shape, bool)
    inside = allowed & ((applied != 0) | (gap == 0)) if one_sided else allowed
    begin = Lanes(
        start, none, none, inside, ~no, rest, rest, ~allowed.any(axis=0, keepdims=True), jnp.zeros((), jnp.int32)
    )
    at = jax.lax.while_loop(lambda at: ~at.done.all() & (at.step < most), advance, begin)
    return at._replace(fresh=at.fresh[0], place=at.place[0], first=at.first[0], done=at.done[0])
