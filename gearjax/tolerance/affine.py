"""Gaps of many gear sets as sums of few products, where errors add up without disturbing each other.

Errors of the pins of a cycloidal reducer, its run-outs and pitch waves open gaps in proportion to their numbers
(amplitudes by components), and most of them only some contacts' gaps. Numbers that touch different contacts share one
table of influences, as columns of a sparse Jacobian share one difference (Curtis, Powell and Reid 1974): the gap of a
contact is its nominal one plus one product for each table.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Int

LOOKS = 5  # angles at which it is found out which number opens which gap
NEGLIGIBLE = 1e-9  # influence, over the largest one, that counts as none
ACCURACY = 0.7  # power of the dtype's spacing: of the sums, over the largest change of a gap


class AffineGaps(eqx.Module):
    """Gaps of a population at input angles.

    Args:
        nominal: gaps where all numbers are zero, shape (n, contact) [m].
        influence: what one unit of a number opens, shape (n, table, contact).
        number: which number that is, shape (table, contact).
    """

    nominal: Float[Array, "n contact"]
    influence: Float[Array, "n table contact"]
    number: Int[Array, "table contact"]

    @classmethod
    def of(
        cls, gap: Callable[[Array, Any], Array], poses: Any, examples: Float[Array, "k number"]
    ) -> "AffineGaps | None":
        """Of a function of a gear set's numbers and a pose; ``None`` where the gaps are not such sums.

        Args:
            gap: gaps of all contacts, shape (contact,) [m].
            poses: at the input angles, which are their leading axis.
            examples: numbers of gear sets that the sums are compared with, at all angles.
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
        return cls(*(jnp.asarray(part) for part in (nominal, influence, number)))

    def terms(self, numbers: Float[Array, "number ..."]) -> Float[Array, "table contact ..."]:
        """The numbers of gear sets, laid out as the tables are."""
        return numbers[self.number]

    def everywhere(self, terms: Float[Array, "table contact"]) -> Float[Array, "contact n"]:
        """Gaps of one gear set at all angles [m]."""
        return summed(self.nominal.T, jnp.moveaxis(self.influence, 0, -1), terms[..., None])


def summed(
    nominal: Float[Array, "contact _"],
    influence: Float[Array, "table contact _"],
    terms: Float[Array, "table contact _"],
) -> Float[Array, "contact _"]:
    """Gaps [m], for several angles or several gear sets as the last axis; what they share has one entry there."""
    gap = jnp.broadcast_to(nominal, (nominal.shape[0], max(nominal.shape[-1], terms.shape[-1])))
    for per_unit, amount in zip(influence, terms, strict=True):
        gap = gap + per_unit * amount
    return gap


def _looks(number: int) -> np.ndarray:
    """A few of the angles, far from evenly spaced, so that no wave is zero in all."""
    shares = np.modf(np.arange(1, LOOKS + 1) * (np.sqrt(5) - 1) / 2)[0]
    return np.unique((shares * number).astype(int))


def _groups(opens: np.ndarray) -> list[list[int]]:
    """Numbers that open no gap together, first fit; shape of ``opens``: (number, contact)."""
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
