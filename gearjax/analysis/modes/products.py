"""The matrices of a step of constant modes: three small products with the state and the inputs.

Letters are those of `gearjax.analysis.modes.steps`, lines and sights those of `gearjax.analysis.modes.lines`.
"""

from typing import NamedTuple

import jax.numpy as jnp

from gearjax.analysis.modes.lines import Lines
from gearjax.analysis.modes.parabola import Scaled, Weights
from gearjax.typing import Array


class Products(NamedTuple):
    """Matrices of a step. "Now" is the start of the step.

    Args:
        free: effect of the state and of the inputs of the lines now and a step before. Its rows are sights with the
            inputs at the end extrapolated from these two, then sights and state without the inputs at the end, shape
            (2 sight + state, state + 2 line).
        after: effect of the inputs at the end on sights and state, shape (sight + state, line).
        kink: effect of the correction for kinks on sights and state, shape (sight + state, line).
        sight: sights of a state, shape (sight, state).
        known: effect of the known inputs at the end, now, and a step before, rows as in ``free``, each of shape
            (row, known).
        given: effect of known inputs that are constant, shape (2 sight + state,); ``None`` if they change.
    """

    free: Array
    after: Array
    kink: Array
    sight: Array
    known: tuple[Array, Array, Array]
    given: Array | None

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Lengths of a sight, of the inputs of the lines, and of a state."""
        return len(self.sight), self.after.shape[1], self.sight.shape[1]

    @classmethod
    def of(cls, lines: Lines, scaled: Scaled, part: Weights, known: Array | None) -> "Products":
        """The matrices of a step; ``known`` are the known inputs if they are constant."""
        number, sight = lines.seen.shape[0], lines.sights(scaled.place, scaled.speed)

        def rows(expected: Array, corrected: Array) -> Array:
            return jnp.concatenate([sight @ expected, sight @ corrected, corrected])

        kept, after, now, before = part
        own = rows(now + 2 * after, now)[:, :number], rows(before - after, before)[:, :number]
        free = jnp.concatenate([rows(kept, kept), *own], axis=1)
        last, kink = (jnp.concatenate([sight @ one, one])[:, :number] for one in (after, part.kink))
        of_known = rows(after, after)[:, number:], rows(now, now)[:, number:], rows(before, before)[:, number:]
        given = None if known is None else (of_known[0] + of_known[1] + of_known[2]) @ known
        return cls(free, last, kink, sight, of_known, given)
