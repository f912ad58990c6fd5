"""Gaps of many gear sets as sums of few products, for errors whose effects on the gaps add up.

Errors of the pins of a cycloidal reducer, its run-outs and pitch waves open gaps in proportion to their numbers
(amplitudes by components), and most of them affect only some contacts. Numbers that affect different contacts share one
table of influences, as columns of a sparse Jacobian share one difference (Curtis, Powell and Reid 1974). The gap of a
contact is then its nominal gap plus one product for each table. Contacts that share a number, such as those of both
discs at one pin, read it from one place: reading takes longer than multiplying.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Int

LOOKS = 5  # angles at which the influence of each number on each gap is tested
NEGLIGIBLE = 1e-9  # of the largest influence: a smaller one counts as zero
ACCURACY = 0.7  # of the sums, over the largest change of a gap, as a power of the dtype's spacing


class AffineGaps(eqx.Module):
    """Gaps of a population at input angles.

    Args:
        nominal: gaps if all numbers are zero, shape (n, contact) [m].
        influence: change of the gap per unit of a number, shape (n, table, contact).
        number: index of this number, shape (table, contact).
        shared: shape of the numbers of each table, arranged for contacts in equal rows, such as those of a disc:
            (row, column), or 1 in place of either if all rows, or all columns, have the same.
    """

    nominal: Float[Array, "n contact"]
    influence: Float[Array, "n table contact"]
    number: Int[Array, "table contact"]
    shared: tuple[tuple[int, int], ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls, gap: Callable[[Array, Any], Array], poses: Any, examples: Float[Array, "k number"]
    ) -> "AffineGaps | None":
        """The sums for a function of a gear set's numbers and a pose; ``None`` if the gaps are no such sums.

        Args:
            gap: function that returns the gaps of all contacts, shape (contact,) [m].
            poses: poses at the input angles, which are their leading axis.
            examples: numbers of gear sets for which the sums are compared with the gaps, at all angles.
        """
        size, dtype = examples.shape[1], examples.dtype
        everywhere = jax.jit(jax.vmap(jax.vmap(gap, in_axes=(None, 0)), in_axes=(0, None)))
        few = jax.tree.map(lambda leaf: leaf[_looks(leaf.shape[0])], poses)
        units = jnp.concatenate([jnp.zeros((1, size), dtype), jnp.eye(size, dtype=dtype)])
        opened = np.asarray(everywhere(units, few))
        opened = np.abs(opened[1:] - opened[0]).max(axis=1)  # (number, contact)
        groups = _groups(opened > NEGLIGIBLE * opened.max(initial=0.0))
        seeds = np.zeros((1 + len(groups), size))
        for row, members in enumerate(groups, start=1):
            seeds[row, members] = 1.0
        gaps = np.asarray(everywhere(jnp.concatenate([jnp.asarray(seeds, dtype), examples]), poses))
        nominal, shifted, actual = gaps[0], gaps[1 : len(seeds)], gaps[len(seeds) :]
        number = np.array([np.take(members, opened[members].argmax(axis=0)) for members in groups], dtype=int)
        number = number.reshape(len(groups), nominal.shape[1])
        influence = (shifted - nominal).swapaxes(0, 1)
        sums = nominal + np.einsum("ntc,tck->knc", influence, np.asarray(examples).T[number])
        allowed = float(np.finfo(dtype).eps) ** ACCURACY * np.abs(actual - nominal).max()
        if not (np.abs(sums - actual) <= allowed).all():
            return None
        return cls(jnp.asarray(nominal), jnp.asarray(influence), jnp.asarray(number), _shared(number))

    def terms(self, numbers: Float[Array, "number ..."]) -> Float[Array, "table contact ..."]:
        """The numbers of gear sets, arranged like the tables."""
        return numbers[self.number]

    def once(self, numbers: Float[Array, "number lane"]) -> list[Float[Array, "_ _ lane"]]:
        """The terms of each table, once for contacts that share them: of one row or column if all are alike."""
        rows = _rows(self.shared, self.nominal.shape[-1])
        arranged = [own.reshape(rows, -1) for own in self.number]
        return [numbers[own[:row, :column]] for own, (row, column) in zip(arranged, self.shared, strict=True)]

    def everywhere(self, numbers: Float[Array, " number"]) -> Float[Array, "contact n"]:
        """Gaps of one gear set at all angles [m]."""
        nominal = self.nominal.T
        return summed(nominal, jnp.moveaxis(self.influence, 0, -1), self.once(numbers[:, None]), nominal.shape[1])


def summed(
    nominal: Float[Array, "contact _"],
    influence: Float[Array, "table contact _"],
    terms: Sequence[Float[Array, "_ _ _"]],
    lanes: int,
) -> Float[Array, "contact _"]:
    """Gaps [m] for several angles or several gear sets as the last axis; data common to all have length one there.

    Args:
        nominal, influence: tables of `AffineGaps`.
        terms: terms of each table, as from `AffineGaps.once`; none, if no number changes a gap.
        lanes: length of the last axis.
    """
    contacts = nominal.shape[0]
    rows = _rows([term.shape[:2] for term in terms], contacts)
    gap = jnp.broadcast_to(nominal, (contacts, lanes)).reshape(rows, -1, lanes)
    for per_unit, amount in zip(influence, terms, strict=True):
        gap = gap + per_unit.reshape(rows, -1, per_unit.shape[-1]) * amount
    return gap.reshape(contacts, lanes)


def _looks(number: int) -> np.ndarray:
    """Indices of a few angles, unevenly spaced, so that no wave is zero at all of them."""
    shares = np.modf(np.arange(1, LOOKS + 1) * (np.sqrt(5) - 1) / 2)[0]
    return np.unique((shares * number).astype(int))


def _groups(opens: np.ndarray) -> list[list[int]]:
    """Groups of numbers of which no two change the same gap, by first fit; shape of ``opens``: (number, contact)."""
    groups: list[list[int]] = []
    taken: list[np.ndarray] = []
    for number in np.flatnonzero(opens.any(axis=1)):
        place = next((i for i, contacts in enumerate(taken) if not (contacts & opens[number]).any()), len(groups))
        if place == len(groups):
            groups.append([])
            taken.append(np.zeros(opens.shape[1], bool))
        groups[place].append(int(number))
        taken[place] |= opens[number]
    return groups


def _shared(number: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Shape of the numbers of each table for contacts in rows, with as many rows as leave the fewest numbers."""
    contacts = number.shape[1]

    def shapes(rows: int) -> tuple[tuple[int, int], ...]:
        return tuple(_distinct(own.reshape(rows, -1)) for own in number)

    divisions = [shapes(rows) for rows in range(1, contacts + 1) if contacts % rows == 0]
    return min(divisions, key=lambda each: sum(row * column for row, column in each))


def _rows(shapes: Sequence[tuple[int, ...]], contacts: int) -> int:
    """Number of rows of the contacts, from the shapes of terms."""
    columns = max((column for _, column in shapes), default=1)
    return contacts // columns if columns > 1 else max((row for row, _ in shapes), default=1)


def _distinct(table: np.ndarray) -> tuple[int, int]:
    """Number of rows and of columns of a table, or 1 if all are alike."""
    row = 1 if (table == table[:1]).all() else table.shape[0]
    return row, 1 if (table == table[:, :1]).all() else table.shape[1]
