"""Candidate contacts of a scene at one input angle, including errors and compliance.

A contact is a one-sided spring. The coordinates ``q`` are displacements from the ideal motion: first the position of
the output [rad], then the positions of shafts that turn freely [rad], then the coordinates that supports and shafts
hold [m, rad]. They close a contact by

    overlap = J q - gap(theta)                                               [m]

Driving flanks hold the output against a positive torque. Their ``J`` is negative, because the overlap grows when the
output falls back; the ``J`` of a back flank is positive. A pin of a cycloidal disc touches one flank after the other as
the disc goes around; the sign of its ``J`` states which. The `Layout` states the side of each contact.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.contact.layout import Layout
from gearjax.contact.springs import LinearSprings, Springs
from gearjax.typing import Array, Bool, Float, Int, Scalar


class ContactSet(eqx.Module):
    """All candidate contacts of a scene at one input angle, including errors.

    Args:
        jacobian: change of overlap per coordinate, shape (contact, coordinate): first the column of the output [m/rad],
            then the columns of shafts that turn freely [m/rad], then those of the held coordinates [-, m/rad].
        gap: gap of each contact, shape (contact,) [m].
        springs: springs of the contacts; ``None`` for rigid teeth.
        layout: side of each contact, and pair to which it belongs.
        supports: stiffness of the last coordinates, which supports and shafts hold, shape (support, support) [N/m,
            N m/rad]; ``None`` if contacts alone hold all coordinates.
        holds: coordinate of the driven body of each contact, which the contact holds, shape (contact,). Without shafts
            that turn freely, all contacts hold the output.
    """

    jacobian: Float[Array, "contact coordinate"]
    gap: Float[Array, " contact"]
    springs: Springs | None
    layout: Layout = eqx.field(static=True)
    supports: Float[Array, "support support"] | None = None
    holds: tuple[int, ...] = eqx.field(static=True, default=())

    @property
    def free(self) -> int:
        """Number of free coordinates, which only contacts hold; they are the first coordinates.

        Raises:
            ValueError: there are several free coordinates, but ``holds`` does not assign the contacts to them.
        """
        free = self.jacobian.shape[1] - (0 if self.supports is None else self.supports.shape[0])
        if free > 1 and not self.holds:
            raise ValueError(f"these contacts are for one degree of freedom, their Jacobian has {free}")
        return free

    @property
    def stages(self) -> list[tuple[int, np.ndarray]]:
        """Free coordinates in the order in which motion is transmitted, the output last, each with its contacts."""
        if self.free == 1:
            return [(0, np.arange(len(self.layout.side)))]
        return [(column, np.flatnonzero(np.asarray(self.holds) == column)) for column in (*range(1, self.free), 0)]

    def loaded(self, applied: Scalar) -> Bool[Array, " contact"]:
        """Whether each contact can hold the output against a generalised force on it [N m].

        At zero force, these are the contacts that hold against a positive torque.
        """
        if self.free == 1:
            lever = self.jacobian[:, 0]
            return jnp.where(applied > 0, lever > 0, lever < 0)
        side = np.asarray(self.layout.side)
        return jnp.where(applied > 0, side < 0, side > 0)

    @property
    def lever(self) -> Float[Array, " contact"]:
        """Lever of each contact: the only column of the Jacobian [m/rad].

        Raises:
            ValueError: the Jacobian has several columns.
        """
        if self.jacobian.shape[1] != 1:
            raise ValueError(f"this solver is for one degree of freedom, the contacts have {self.jacobian.shape[1]}")
        return self.jacobian[:, 0]

    @property
    def output_levers(self) -> Float[Array, " pair"]:
        """Levers on the output of the first flank of each pair that holds it [m/rad]."""
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
        """Stiffness of linear springs, shape (contact,) [N/m]; ``None`` for rigid teeth.

        Raises:
            ValueError: the springs are not linear.
        """
        if self.springs is None:
            return None
        if not isinstance(self.springs, LinearSprings):
            raise ValueError(f"this solver is for linear springs, the contacts have {type(self.springs).__name__}")
        return self.springs.stiffness

    def alone(self, column: int, own: np.ndarray) -> "ContactSet":
        """Some of the contacts with one coordinate only, as rigid contacts that are a pair each."""
        sides = tuple(self.layout.side[i] for i in own)
        layout = Layout(sides, tuple(range(len(own))))
        return ContactSet(self.jacobian[own, column][:, None], self.gap[own], None, layout)

    def carriers(self, applied: Scalar) -> Int[Array, ""]:
        """Number of pairs that could carry a generalised force [N m]: pairs with a flank on the loaded side."""
        if not self.layout.sides_turn:
            return self.layout.carriers(applied)
        return jnp.where(applied > 0, self.lever > 0, self.lever < 0).sum()
