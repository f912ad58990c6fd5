"""What a step of constant modes makes of the state and of the inputs, as three small products.

Letters are those of `gearjax.analysis.modes.steps`.
"""

from typing import NamedTuple

import jax.numpy as jnp

from gearjax.analysis.modes.lines import Lines
from gearjax.analysis.modes.parabola import Scaled, Weights
from gearjax.typing import Array


class Products(NamedTuple):
    """What a step makes of the state with the inputs of the lines now and a step before.

    Args:
        free: without the inputs at its end: sights at the inputs that the last two lead to, sights, and the state,
            shape (2 sight + state, state + 2 line).
        after: of the inputs at its end: sights and the state, shape (sight + state, line).
        kink: of what a parabola misses, shape (sight + state, line).
        sight: sights of a state, shape (sight, state).
        known: of known inputs at its end, now, and a step before, rows as of ``free``, each of shape (row, known).
        given: what known inputs make where they stand still, shape (2 sight + state,); ``None`` where they change.
    """

    free: Array
    after: Array
    kink: Array
    sight: Array
    known: tuple[Array, Array, Array]
    given: Array | None

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of sights, of lines, and of a state."""
        return len(self.sight), self.after.shape[1], self.sight.shape[1]

    @classmethod
    def of(cls, lines: Lines, scaled: Scaled, part: Weights, known: Array | None) -> "Products":
        """Those of a step; known inputs where they stand still."""
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
