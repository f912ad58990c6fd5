"""Static description of the contacts: their sides, and the pairs of teeth to which their flanks belong."""

import dataclasses
import functools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float

Place = int | slice | np.ndarray
"""Index of one contact or of several; successive contacts have a slice, because it needs no gather operation."""


@dataclasses.dataclass(frozen=True)
class Layout:
    """Sides and pairs of the contacts, which are static in compiled programs.

    Args:
        side: side of each contact: 1 for a driving flank, which holds the output against a positive torque, -1 for a
            back flank, and 0 if the sign of its lever decides. Either all contacts or none have 0.
        pair: pair of teeth of each contact, counted from 0. The flanks of a pair share one stiffness, and one damper
            that acts along the flank that touches.
            All pairs have the same number of contacts.
        mesh: mesh of a train that each contact is in, counted from the input; without it, all are in one mesh.
        across: number of contacts of a pair that are beside each other across its face; each has its part of the pair's
            stiffness.

    Raises:
        ValueError: the sides and pairs contradict each other.
    """

    side: tuple[int, ...]
    pair: tuple[int, ...]
    mesh: tuple[int, ...] = ()
    across: int = 1

    def __post_init__(self):
        if len(self.side) != len(self.pair) or not self.side:
            raise ValueError(f"{len(self.side)} sides and {len(self.pair)} pairs: give one of each per contact")
        if self.mesh and len(self.mesh) != len(self.side):
            raise ValueError(f"{len(self.side)} sides and {len(self.mesh)} meshes: give one of each per contact")
        if not (set(self.side) == {0} or set(self.side) <= {1, -1}):
            raise ValueError(f"sides are 1 (driving) or -1 (back), or 0 for all, not {sorted(set(self.side))}")
        counts = np.bincount(self.pair)
        if counts.min() != counts.max():
            raise ValueError(f"pairs have {counts.min()} to {counts.max()} contacts: every pair needs the same number")
        if self.across < 1 or counts[0] % self.across:
            raise ValueError(f"across = {self.across}: must divide the {counts[0]} contacts of a pair")

    @classmethod
    @functools.cache  # analyses ask for the layout at each call
    def of_flanks(cls, number: int, back: bool) -> "Layout":
        """Layout of the driving flanks of a number of pairs and, if requested, their back flanks in the same order."""
        sides = (1, -1) if back else (1,)
        return cls(tuple(side for side in sides for _ in range(number)), tuple(range(number)) * len(sides))

    @classmethod
    def either(cls, number: int) -> "Layout":
        """Layout of contacts whose lever's sign decides which flank they touch; each contact is a pair of its own."""
        return cls((0,) * number, tuple(range(number)))

    @property
    def sides_turn(self) -> bool:
        """Whether the sign of its lever decides on which side a contact is."""
        return self.side[0] == 0

    @property
    def has_back(self) -> bool:
        """Whether there are contacts that hold the output against a negative torque."""
        return self.sides_turn or -1 in self.side

    @property
    def teeth(self) -> int:
        """Number of pairs of teeth."""
        return max(self.pair) + 1

    @functools.cached_property
    def pairs_by_side(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs with a driving flank, and pairs with a back flank; only for contacts whose sides are known."""
        side, pair = np.asarray(self.side), np.asarray(self.pair)
        return np.unique(pair[side > 0]), np.unique(pair[side < 0])

    @property
    def all_could_carry(self) -> bool:
        """Whether every pair can carry torques of each sign that any pair can carry."""
        if self.sides_turn:
            return False
        driving, back = self.pairs_by_side
        return len(driving) == self.teeth and len(back) in (0, self.teeth)

    def carriers(self, applied: Array) -> Array:
        """Number of pairs that could carry a generalised force [N m]; only for contacts whose sides are known."""
        driving, back = (len(pairs) for pairs in self.pairs_by_side)
        return jnp.asarray(driving) if back in (0, driving) else jnp.where(applied > 0, back, driving)

    @functools.cached_property
    def in_halves(self) -> bool:
        """Whether the first half of the contacts has driving flanks and the second half back flanks."""
        half = len(self.side) // 2
        return self.side == (1,) * half + (-1,) * half

    @functools.cached_property
    def flanks(self) -> tuple[Place, ...]:
        """The contacts in rows: the first contact of each pair, which is a driving flank, the second, and so on."""
        order = np.lexsort([-np.asarray(self.side), np.asarray(self.pair)]).reshape(self.teeth, -1)
        return tuple(_place(row) for row in order.T)

    @functools.cached_property
    def members(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the contacts of each pair."""
        of_pair: list[tuple[int, ...]] = [()] * self.teeth
        for contact, pair in enumerate(self.pair):
            of_pair[pair] += (contact,)
        return tuple(of_pair)

    def on(self, side: int) -> Place:
        """The contacts of one side, 1 or -1; only for contacts whose sides are known."""
        return _place(np.flatnonzero(np.asarray(self.side) == side))

    def joined(self, driving: Array, back: Array) -> Array:
        """Values of the driving flanks and of the back flanks, joined in the order of the contacts (first axis)."""
        together = jnp.concatenate([driving, back])
        order = np.argsort(np.argsort(-np.asarray(self.side), kind="stable"))
        return together if (order == np.arange(len(order))).all() else together[order]

    def apiece(self, of_pairs: Array) -> Array:
        """Stiffness of one contact from the stiffness of each pair, which contacts across the face share."""
        return of_pairs if self.across == 1 else of_pairs / self.across

    def per_contact(self, of_pairs: Array) -> Array:
        """Values of each pair repeated at each of its contacts, along the first axis."""
        repeats = len(self.pair) // self.teeth
        if self.pair == tuple(range(self.teeth)) * repeats:  # a copy compiles to less code than a gather
            return of_pairs if repeats == 1 else jnp.concatenate([of_pairs] * repeats)
        return of_pairs[np.asarray(self.pair)]

    def engaged(self, closed: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """How far the damper of a pair acts along each of its flanks, 0 to 1, from how far each flank is closed.

        A pair has one damper, which acts along the flank that touches; if several touch, along the first of them.
        """
        first, *others = self.flanks
        open_ = 1.0 - closed[first]
        for flank in others:
            closed = closed.at[flank].multiply(open_)
            open_ = open_ - closed[flank]
        return closed

    def on_first(self, of_pairs: Array) -> Array:
        """Values of each pair at its first contact, zero at its other contacts, along the only axis."""
        first = self.flanks[0]
        if isinstance(first, slice) and first == slice(0, self.teeth):  # padding is fast; a scatter would be a loop
            return jnp.pad(of_pairs, (0, len(self.side) - self.teeth))
        return jnp.zeros((len(self.side),), of_pairs.dtype).at[first].set(of_pairs)

    def per_pair(self, of_contacts: Array) -> Array:
        """Sums over the contacts of each pair, along the last axis."""
        first, *others = (of_contacts[..., row] for row in self.flanks)
        return sum(others, first)


def _place(indices: np.ndarray | Sequence[int]) -> Place:
    """Indices, as a slice if they are successive.

    They have 32 bits, because layouts are kept, and JAX does not take indices of 64 bits that it once saw in float64
    for a program in float32.
    """
    indices = np.asarray(indices, np.int32)
    begin = int(indices[0]) if len(indices) else 0
    if (indices == np.arange(begin, begin + len(indices))).all():
        return slice(begin, begin + len(indices))
    return indices
