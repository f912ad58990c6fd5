"""Many gaps and loads under one matrix, solved among those contacts that are likely to carry.

The errors of a population move gaps by little, so that of many contacts the same few carry in all lanes: a lane is one
problem of a batch. One lane, the most heavily loaded one, is solved roughly among all contacts. With its forces, the
opening of every contact in every other lane is estimated; contacts that are closed by this estimate in some lane are
taken out, and all lanes are solved among them: with the inverse of the influence of the contacts that carry in that one
lane, exactly where the same contacts carry, and by preconditioned conjugate gradients elsewhere. The result is a start
for the same method among all contacts, which looks at every condition again: a wrong estimate takes time and changes no
result.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from gearjax.contact.conjugate import Begin, Lanes, descended
from gearjax.elimination import eliminated
from gearjax.typing import Array, Bool, Float, Int, Scalar

ROUGH = 20  # steps of conjugate gradients for one lane
SIZES = 1 / 4, 1 / 2  # shares of the contacts that are taken out; with more, nothing is gained
PRECONDITIONED = 64  # contacts up to which the steps are preconditioned
ALL_PRECONDITIONED = 128  # contacts up to which the steps among all contacts are preconditioned
MANY_LANES = 256  # lanes from which the inverse of the whole matrix takes less time than it saves
# how many times as stiff a contact may become when all others are held, in float64 and float32; beyond, contacts nearly
# depend on each other
DEPENDENT, DEPENDENT_SINGLE = 300.0, 10.0
WORTH_WHILE = 24  # lanes; with fewer, the rough solution and the look at the result take longer than they save


class Example(NamedTuple):
    """One lane, roughly solved.

    Args:
        forces: contact forces, shape (contact,) [N].
        opening: how far each contact is open [m].
        lever: lever of each contact [m/rad].
        gap: gaps at position zero [m].
        applied: generalised force [N m].
    """

    forces: Float[Array, " contact"]
    opening: Float[Array, " contact"]
    lever: Float[Array, " contact"]
    gap: Float[Array, " contact"]
    applied: Scalar

    @classmethod
    def of(cls, influence: Array, levers: Array, gaps: Array, applied: Array, allowed: Array) -> "Example":
        """The lane with the largest load; arguments as for `descended`, with the lanes first."""
        known = jnp.isfinite(applied) & jnp.isfinite(gaps).all(axis=1)
        heaviest = jnp.argmax(jnp.where(known, jnp.abs(applied), -1.0))
        lever, gap, load = levers[heaviest], gaps[heaviest], applied[heaviest]
        at = descended(influence, lever[:, None], gap[:, None], load[None], allowed[heaviest][:, None], ROUGH)
        forces = jnp.where(at.inside[:, 0], jnp.maximum(at.forces[:, 0], 0.0), 0.0)
        return cls(forces, at.slope[:, 0] - lever * at.place[0], lever, gap, load)

    def likely(self, gap: Array, applied: Array, allowed: Array) -> Bool[Array, " contact"]:
        """Contacts that are closed in some lane if the forces are those of the example; arguments as for `descended`.

        The output turns back by the mean change of the gaps, weighted by the forces (virtual work). The first contact
        to touch is always one of them; so is every contact if a lane is loaded in the other sense.
        """
        moved = gap - self.gap[:, None]
        back = (self.forces @ moved) / jnp.where(self.applied == 0, 1.0, self.applied)
        opening = self.opening[:, None] + moved - self.lever[:, None] * back[None]
        closed = (opening <= 0) | (gap <= 0)
        return (allowed & (closed | (applied * self.applied < 0)[None])).any(axis=1) | (self.forces > 0)

    def at(self, index: Array) -> Float[Array, " few"]:
        """Forces of the contacts of an index; zero beyond the last contact."""
        return self.forces.at[index].get(mode="fill", fill_value=0.0)

    def begin(
        self, index: Array, near: Array | None, lever: Array, gap: Array, applied: Array, allowed: Array
    ) -> Begin:
        """A start among the contacts of an index: those that carry in the example carry the load of each lane.

        Their forces are exact where ``near`` is the inverse of their influence; without it, they are the scaled forces
        of the example. A lane in which they hold no load cannot start from them.
        """
        inside = allowed & (self.at(index) > 0)[:, None]
        arms, gap = jnp.where(inside, lever, 0.0), jnp.where(inside, gap, 0.0)
        if near is None:
            per_turn, at_rest = jnp.where(inside, self.at(index)[:, None], 0.0), jnp.zeros_like(gap)
        else:
            per_turn, at_rest = (jnp.where(inside, near @ part, 0.0) for part in (arms, gap))
        steepness = (arms * per_turn).sum(axis=0, keepdims=True)
        turn = (applied[None] + (arms * at_rest).sum(axis=0, keepdims=True)) / jnp.where(steepness == 0, 1.0, steepness)
        usable = (steepness != 0) & (applied != 0)[None] & jnp.isfinite(turn)
        return Begin(turn * per_turn - at_rest, inside, usable)


def descended_among_few(
    example: Example,
    inverse: Array | None,
    influence: Array,
    lever: Array,
    gap: Array,
    applied: Array,
    allowed: Array,
    most: int,
) -> Lanes:
    """The same as `descended`, begun from the solution among contacts that are likely to carry.

    ``inverse`` is that of `inverse_of_all`.
    """

    def few(index: Array, inner: Array, lever: Array, gap: Array, allowed: Array) -> Begin:
        near = preconditioner_of(inner, example.at(index) > 0)
        begin = example.begin(index, near, lever, gap, applied, allowed)
        at = descended(inner, lever, gap, applied, allowed, most, begin=begin, preconditioner=near, checked=False)
        forces, inside = (laid_back(part, index, len(influence)) for part in (at.forces, at.inside))
        columns = influence.at[:, index].get(mode="fill", fill_value=0.0)
        return Begin(forces, inside, at.done[None], columns @ at.forces + all_gaps)

    def not_worth_while() -> Begin:
        return Begin(jnp.zeros_like(gap), jnp.zeros_like(allowed), jnp.zeros((1, len(applied)), bool), gap)

    all_gaps, likely = gap, example.likely(gap, applied, allowed)
    begin = among(likely, influence, (lever, gap, allowed), few, not_worth_while)
    return descended(influence, lever, gap, applied, allowed, most, begin=begin, preconditioner=inverse)


def linear_among_few(
    inverse: Array | None, influence: Array, lever: Array, gap: Array, applied: Array, closed: Array, most: int
) -> tuple[Float[Array, "contact lane"], Float[Array, " lane"], Bool[Array, " lane"]]:
    """Forces, positions, and whether they are found, of lanes whose closed contacts are known."""

    def few(index: Array, inner: Array, lever: Array, gap: Array, closed: Array) -> tuple[Array, Array, Array]:
        near = preconditioner_of(inner, closed.mean(axis=1) > 0.5)
        at = descended(inner, lever, gap, applied, closed, most, one_sided=False, preconditioner=near)
        return laid_back(at.forces, index, len(influence)), at.place, at.done

    def all_of_them() -> tuple[Array, Array, Array]:
        at = descended(influence, lever, gap, applied, closed, most, one_sided=False, preconditioner=inverse)
        return at.forces, at.place, at.done

    return among(closed.any(axis=1), influence, (lever, gap, closed), few, all_of_them)


def preconditioner_of(influence: Float[Array, "few few"], core: Bool[Array, " few"]) -> Float[Array, "few few"] | None:
    """Inverse of the influence of those contacts on each other that carry in most lanes, beside the diagonal of others.

    Lanes in which the same contacts carry then need two steps, and others some more for each contact that differs. Of
    many contacts the products would take longer than the steps that they save.
    """
    if len(core) > PRECONDITIONED:
        return None
    own = jnp.diag(jnp.diagonal(influence))
    near, unit = jnp.where(core[:, None] & core[None, :], influence, own), jnp.eye(len(core), dtype=own.dtype)
    return eliminated(near, unit, library_from=PRECONDITIONED + 1)


def inverse_of_all(
    influence: Float[Array, "contact contact"], lanes: int, chosen: Bool[Array, " contact"]
) -> Float[Array, "contact contact"] | None:
    """Inverse of the whole influence, near that of any set of contacts but at its ends: a third of the steps is saved.

    ``None`` where it would take longer than it saves. The unit matrix, which changes nothing, if few contacts are
    chosen, because these are solved by themselves, or if contacts nearly depend on each other: where only one of them
    carries, the inverse misleads.
    """
    number = len(influence)
    if number > ALL_PRECONDITIONED or lanes < MANY_LANES:
        return None
    unit = jnp.eye(number, dtype=influence.dtype)

    def accurate() -> Array:
        inverse = eliminated(influence, unit, library_from=ALL_PRECONDITIONED + 1)
        most = DEPENDENT if influence.dtype == jnp.float64 else DEPENDENT_SINGLE
        independent = (jnp.diagonal(inverse) * jnp.diagonal(influence)).max() < most
        return jnp.where(independent, inverse, unit)

    return jax.lax.cond(chosen.sum() > round(max(SIZES) * number), accurate, lambda: unit)


def among(
    chosen: Bool[Array, " contact"], influence: Array, lanes: tuple[Array, ...], few: Callable, otherwise: Callable
) -> Any:
    """Result of a function of the chosen contacts alone, or of another function if these are nearly all.

    Args:
        chosen: the contacts; others fill up the next of the `SIZES`.
        influence: matrix of all contacts.
        lanes: arrays of the shape (contact, lane), of which the last says which contacts may carry.
        few: function of the numbers of the chosen contacts, their matrix and their arrays.
        otherwise: function without arguments, with results of the same shapes.
    """
    number = len(influence)
    sizes = sorted({max(1, round(share * number)) for share in SIZES})

    def of_size(size: int) -> Callable:
        def gathered() -> Any:
            (index,) = jnp.nonzero(chosen, size=size, fill_value=number)
            at, there = jnp.minimum(index, number - 1), index < number
            *arrays, may = (part[at] for part in lanes)
            return few(index, influence[at[:, None], at[None, :]], *arrays, may & there[:, None])

        return gathered

    fits = sum(((chosen.sum() > size).astype(jnp.int32) for size in sizes), start=jnp.zeros((), jnp.int32))
    return jax.lax.switch(fits, [*(of_size(size) for size in sizes), otherwise])


def laid_back(part: Array, index: Int[Array, " few"], number: int) -> Array:
    """Rows of the chosen contacts among the rows of all, which are zero."""
    return jnp.zeros((number, *part.shape[1:]), part.dtype).at[index].set(part, mode="drop")
