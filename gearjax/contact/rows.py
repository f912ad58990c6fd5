"""Matrices of small blocks of contacts in many lanes, whose factorisation is written out over the contacts of a block.

A lane is one problem of a batch. There is one array of shape (block, lane) for each contact of a block, so that the
last axes vectorise.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from gearjax.typing import Array, Float

Each = list[Array]
Matrix = list[Each]


class Rows(NamedTuple):
    """Matrices of small blocks, as one array of shape (block, lane or 1) for each of their numbers [m/N].

    Args:
        rows: rows of all blocks.
    """

    rows: Matrix
    # stiffness and steps of the first guess: with other values the search takes longer
    stiffer = 1.4
    guesses = 5

    @classmethod
    def of(cls, blocks: Array) -> "Rows":
        """From blocks of each lane, shape (lane, block, own, own), or common ones, shape (block, own, own)."""
        behind = jnp.moveaxis(blocks, (-2, -1), (0, 1))
        behind = jnp.moveaxis(behind, 2, -1) if blocks.ndim == 4 else behind[..., None]
        return cls([list(row) for row in behind])

    def of_side(self, number: Array, half: int) -> "Rows":
        """The blocks of one side."""
        return Rows([[jax.lax.dynamic_slice_in_dim(each, number * half, half) for each in row] for row in self.rows])

    @property
    def softness(self) -> Each:
        """Approach of each contact under equal forces on its whole block, at most [m/N]."""
        return [added([jnp.abs(entry) for entry in row]) for row in self.rows]

    def tried(
        self, lever: Each, rest: Each, applied: Float[Array, "1 lane"], closed: Each
    ) -> tuple[Array, Each, Each, Each]:
        """Position, forces, approach of all contacts, and its size for rounding, with given sets of closed contacts.

        Args:
            lever, rest, closed: one array of shape (block, lane) for each contact of a block.
            applied: generalised force.
        """
        place, forces = _within(self.rows, lever, rest, applied, closed)
        parts = [[entry * force for entry, force in zip(row, forces, strict=True)] for row in self.rows]
        size = [added([jnp.abs(part) for part in own]) for own in parts]
        return place, forces, [added(own) for own in parts], size


def _within(blocks: Matrix, lever: Each, rest: Each, applied: Array, closed: Each) -> tuple[Array, Each]:
    """Position and forces with given sets of closed contacts.

    Args:
        blocks: rows of the blocks' matrices, as arrays of shape (block, lane or 1) [m/N].
        lever, rest, closed: one array of shape (block, lane) for each contact of a block.
        applied: generalised force, shape (1, lane).
    """
    # factorisation L D L^T of the closed contacts; rows and columns of the other contacts are those of the unit matrix
    own = range(len(lever))
    arms = [jnp.where(closed[i], lever[i], 0.0) for i in own]
    held = [jnp.where(closed[i], rest[i], 0.0) for i in own]
    low: Matrix = []
    inverse: Each = []
    for i in own:
        row: Each = []
        scaled: Each = []
        diagonal = jnp.where(closed[i], blocks[i][i], 1.0)
        for j in range(i):
            entry = jnp.where(closed[i] & closed[j], blocks[i][j], 0.0)
            for k in range(j):
                entry = entry - scaled[k] * low[j][k]
            scaled.append(entry)
            row.append(entry * inverse[j])
            diagonal = diagonal - entry * row[j]
            arms[i] = arms[i] - row[j] * arms[j]
            held[i] = held[i] - row[j] * held[j]
        low.append(row)
        inverse.append(1.0 / jnp.where(diagonal > 0, diagonal, jnp.nan))
    steep = total([arms[i] * arms[i] * inverse[i] for i in own])
    pull = applied + total([arms[i] * held[i] * inverse[i] for i in own])
    place = jnp.where(steep == 0, 0.0, pull / jnp.where(steep == 0, 1.0, steep))
    forces = [(arms[i] * place - held[i]) * inverse[i] for i in own]
    for i in reversed(own):
        for j in range(i):
            forces[j] = forces[j] - low[i][j] * forces[i]
    return place, [jnp.where(closed[i], forces[i], 0.0) for i in own]


def added(parts: Each) -> Array:
    """Sum over the contacts of a block."""
    return functools.reduce(jnp.add, parts)


def total(parts: Each) -> Array:
    """Sum over all contacts of a lane, shape (1, lane), with further axes of length 1 as the parts have them."""
    whole = added(parts)
    return whole.sum(axis=tuple(range(whole.ndim - 1)), keepdims=True)
