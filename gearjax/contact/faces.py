"""Slices of tooth faces, coupled along the face by a deflection that decays from slice to slice.

Beside its diagonal, the influence matrix of a face is a product of two numbers and of a decay for each slice between:
``S_ij = low_i high_j decay^(j - i - 1)`` for ``i < j``. Its factorisation and its products therefore take a number of
operations proportional to the number of slices (Foreman-Mackey et al. 2017, "Fast and scalable Gaussian process
modeling with applications to astronomical time series"), and the matrix itself is not needed. The same holds for any
set of slices that are closed.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Bool, Float


class Faces(eqx.Module):
    """Influence of the slices of each tooth face on each other; different faces are not coupled.

    Args:
        own: approach of each slice per force on itself, shape (face, slice) [m/N].
        low, high: factors of a slice with all slices above it and with all below it, shape (face, slice) [sqrt(m/N)].
        fall: natural logarithm by which the influence falls from each slice to the next, shape (face,) [-].
    """

    own: Float[Array, "*lane face slice"]
    low: Float[Array, "*lane face slice"]
    high: Float[Array, "*lane face slice"]
    fall: Float[Array, "*lane face"]

    @property
    def blocks(self) -> Float[Array, "*lane face slice slice"]:
        """Matrix of each face [m/N]."""
        number = self.own.shape[-1]
        one, other = np.indices((number, number))
        powers = jnp.exp(-self.fall[..., None] * jnp.arange(number, dtype=self.fall.dtype).reshape(*self._ones, number))
        between = powers[..., np.maximum(abs(one - other) - 1, 0)]
        above = self.low[..., :, None] * self.high[..., None, :]
        below = self.high[..., :, None] * self.low[..., None, :]
        upper, diagonal = (part.reshape(*self._ones, number, number) for part in (one < other, one == other))
        return jnp.where(diagonal, self.own[..., None], between * jnp.where(upper, above, below))

    @property
    def _ones(self) -> list[int]:
        return [1] * self.fall.ndim

    def approach(self, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Approach of all slices under forces [m]."""
        number = self.own.shape[-1]
        low, high, pressing = (jnp.moveaxis(part, -1, 0) for part in (self.low, self.high, forces.reshape(-1, number)))
        beside = _of_others(jnp.exp(-self.fall), low, high, pressing)
        return (self.own * forces.reshape(-1, number) + jnp.moveaxis(beside, 0, -1)).ravel()


def _summed(decay: Float[Array, "*face"], given: Float[Array, "slice *face"]) -> Float[Array, "slice *face"]:
    """Sum over all slices before each, with a factor ``decay`` for each slice between both."""

    def pass_on(total: Array, own: Array) -> tuple[Array, Array]:
        return decay * total + own, total

    return jax.lax.scan(pass_on, jnp.zeros_like(given[0]), given)[1]


def _of_others(decay: Array, low: Array, high: Array, forces: Array) -> Float[Array, "slice *face"]:
    """Approach of each slice under the forces on all other slices of its face; slices come first [m]."""
    below, above = _summed(decay, low * forces), _summed(decay, (high * forces)[::-1])[::-1]
    return high * below + low * above


class Sweeps(NamedTuple):
    """Faces of many lanes, and the factorisation of any closed slices of them; slices come first, faces and lanes last.

    A lane is one problem of a batch. All functions take and return lists with one array of the shape (slice, face,
    lane), as those for blocks of few contacts have one array for each contact of a block.

    Args:
        own, low, high: as in `Faces`, shape (slice, face, lane or 1).
        decay: factor from each slice to the next, shape (face, lane or 1).
    """

    own: Float[Array, "slice face _"]
    low: Float[Array, "slice face _"]
    high: Float[Array, "slice face _"]
    decay: Float[Array, "face _"]
    # stiffness and steps of the first guess (`blocks`): with other values the search takes longer
    stiffer = 2.0
    guesses = 3

    @classmethod
    def of(cls, faces: Faces) -> "Sweeps":
        """From the faces of many lanes, or from those that all lanes have in common."""
        each = faces if faces.fall.ndim > 1 else jax.tree.map(lambda part: part[None], faces)
        own, low, high = (part.transpose(2, 1, 0) for part in (each.own, each.low, each.high))
        return cls(own, low, high, jnp.exp(-each.fall).T)

    def of_side(self, number: Array, half: int) -> "Sweeps":
        """The faces of one side."""

        def taken(part: Array) -> Array:
            return jax.lax.dynamic_slice_in_dim(part, number * half, half, axis=part.ndim - 2)

        return Sweeps(taken(self.own), taken(self.low), taken(self.high), taken(self.decay))

    @property
    def softness(self) -> list[Array]:
        """Approach of each slice under equal forces on its whole face [m/N]."""
        return [self.own + _of_others(self.decay, self.low, self.high, jnp.ones_like(self.own))]

    def tried(
        self,
        lever: list[Float[Array, "slice face lane"]],
        rest: list[Float[Array, "slice face lane"]],
        applied: Float[Array, "1 1 lane"],
        closed: list[Bool[Array, "slice face lane"]],
    ) -> tuple[Array, list[Array], list[Array], list[Array]]:
        """Position, forces, approach of all slices, and its size for rounding, with given sets of closed slices."""
        nothing = jnp.zeros_like(lever[0][0])
        decay = self.decay + nothing

        def downwards(at: tuple, row: tuple) -> tuple:
            """Factorisation L D L^T of one more slice, L^-1 times both right-hand sides, and their products."""
            spread, turned, pressed, steep, pull = at
            *numbers, inside = row
            low, high, arm, held = (jnp.where(inside, part, 0.0) for part in numbers[1:])
            fallen = high * spread
            pivot = jnp.where(inside, numbers[0], 1.0) - high * fallen
            inverse = 1.0 / jnp.where(pivot > 0, pivot, jnp.nan)
            weight = low - decay * fallen
            arm, held = arm - high * turned, held - high * pressed
            per_turn, at_rest = arm * inverse, held * inverse
            sums = steep + arm * per_turn, pull + arm * at_rest
            spread = decay * (decay * spread) + weight * weight * inverse
            at = spread, decay * turned + weight * per_turn, decay * pressed + weight * at_rest, *sums
            return at, (weight * inverse, per_turn, at_rest)

        rows = self.own, self.low, self.high, lever[0], rest[0], closed[0]
        (*_, steep, pull), (scaled, per_turn, at_rest) = jax.lax.scan(downwards, (nothing,) * 5, rows)
        steep, pull = (part.sum(axis=0, keepdims=True) for part in (steep, pull))
        place = jnp.where(steep == 0, 0.0, (applied[0] + pull) / jnp.where(steep == 0, 1.0, steep))

        def upwards(above: Array, row: tuple) -> tuple:
            """L^-T times the forces, and the sum over the slices above."""
            scaled, per_turn, at_rest, high = row
            force = per_turn * place - at_rest - scaled * above
            return decay * above + high * force, (force, above)

        rows = scaled, per_turn, at_rest, self.high
        _, (forces, above) = jax.lax.scan(upwards, nothing, rows, reverse=True)

        def again(below: Array, row: tuple) -> tuple:
            """Approach of each slice."""
            own, low, high, force, above = row
            return decay * below + low * force, own * force + high * below + low * above

        _, approach = jax.lax.scan(again, nothing, (self.own, self.low, self.high, forces, above))
        return place[None], [forces], [approach], [jnp.abs(approach)]
