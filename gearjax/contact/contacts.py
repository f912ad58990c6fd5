"""Candidate contacts of a scene at one input angle, errors and compliance included.

A contact is a one-sided spring. The displacements ``q`` from the ideal motion, of the output first [rad], then of
shafts that turn freely [rad], then of what supports and shafts hold [m, rad], close it by

    overlap = J q - gap(theta)                                               [m]

Driving flanks hold the output against a positive torque, so their ``J`` is negative (the overlap grows when the
output falls back); the ``J`` of a back flank is positive. Pins of a cycloidal disc touch one flank after the other as
the disc goes around: the sign of ``J`` tells which. Which contact is what, its `Layout` says.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.contact.layout import Layout
from gearjax.contact.springs import LinearSprings, Springs
from gearjax.typing import Array, Bool, Float, Int, Scalar


class ContactSet(eqx.Module):
    """All candidate contacts of a scene at one input angle, errors included.

    Args:
        jacobian: shape (contact, coordinate); the output's column first [m/rad], then those of shafts that turn freely,
            then those of what supports and shafts hold [-, m/rad].
        gap: shape (contact,) [m].
        springs: of the contacts; ``None`` for rigid teeth.
        layout: sides of the contacts, and pairs that they are flanks of.
        supports: stiffness of the last coordinates, which supports and shafts hold, shape (support, support) [N/m,
            N m/rad]; ``None`` where contacts hold all.
        holds: of each contact the coordinate that its driven body turns with, which it holds, shape (contact,); all the
            output where shafts do not turn freely.
    """

    jacobian: Float[Array, "contact coordinate"]
    gap: Float[Array, " contact"]
    springs: Springs | None
    layout: Layout = eqx.field(static=True)
    supports: Float[Array, "support support"] | None = None
    holds: tuple[int, ...] = eqx.field(static=True, default=())

    @property
    def free(self) -> int:
        """How many coordinates, the first ones, nothing but contacts holds.

        Raises:
            ValueError: there are several, and it is not said which contact holds which.
        """
        free = self.jacobian.shape[1] - (0 if self.supports is None else self.supports.shape[0])
        if free > 1 and not self.holds:
            raise ValueError(f"these contacts are for one degree of freedom, their Jacobian has {free}")
        return free

    @property
    def stages(self) -> list[tuple[int, np.ndarray]]:
        """Coordinates that only contacts hold, in the order that motion is handed on, the output last; each with the
        contacts that hold it."""
        if self.free == 1:
            return [(0, np.arange(len(self.layout.side)))]
        return [(column, np.flatnonzero(np.asarray(self.holds) == column)) for column in (*range(1, self.free), 0)]

    def loaded(self, applied: Scalar) -> Bool[Array, " contact"]:
        """Contacts that hold against a generalised force on the output [N m]; against a positive torque at zero."""
        if self.free == 1:
            lever = self.jacobian[:, 0]
            return jnp.where(applied > 0, lever > 0, lever < 0)
        side = np.asarray(self.layout.side)
        return jnp.where(applied > 0, side < 0, side > 0)

    @property
    def lever(self) -> Float[Array, " contact"]:
        """The single column of the Jacobian [m/rad]."""
        if self.jacobian.shape[1] != 1:
            raise ValueError(f"this solver is for one degree of freedom, the contacts have {self.jacobian.shape[1]}")
        return self.jacobian[:, 0]

    @property
    def output_levers(self) -> Float[Array, " pair"]:
        """Levers of the output of the first flanks of the pairs that hold it [m/rad]."""
        first = np.arange(len(self.layout.side))[self.layout.flanks[0]]
        return self.jacobian[first[np.isin(first, self.stages[-1][1])], 0]

    @property
    def own_levers(self) -> Float[Array, " contact"]:
        """Lever of each contact on the coordinate that it holds [m/rad]."""
        if self.free == 1:
            return self.jacobian[:, 0]
        return self.jacobian[np.arange(len(self.holds)), np.array(self.holds)]

    @property
    def linear(self) -> Float[Array, " contact"] | None:
        """Stiffness of linear springs, shape (contact,) [N/m]; ``None`` for rigid teeth."""
        if self.springs is None:
            return None
        if not isinstance(self.springs, LinearSprings):
            raise ValueError(f"this solver is for linear springs, the contacts have {type(self.springs).__name__}")
        return self.springs.stiffness

    def alone(self, column: int, own: np.ndarray) -> "ContactSet":
        """Some of the contacts as if one coordinate alone moved, rigid and each a pair of its own."""
        sides = tuple(self.layout.side[i] for i in own)
        layout = Layout(sides, tuple(range(len(own))))
        return ContactSet(self.jacobian[own, column][:, None], self.gap[own], None, layout)

    def carriers(self, applied: Scalar) -> Int[Array, ""]:
        """Number of pairs that could carry a generalised force [N m]: those with a flank on its side."""
        if not self.layout.sides_turn:
            driving, back = (len(pairs) for pairs in self.layout.pairs_by_side)
            alike = back in (0, driving)
            return jnp.asarray(driving) if alike else jnp.where(applied > 0, back, driving)
        return jnp.where(applied > 0, self.lever > 0, self.lever < 0).sum()
