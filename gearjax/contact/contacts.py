"""Candidate contacts of a scene at one input angle, errors and compliance included.

A contact is a one-sided spring. The displacements ``q`` of the output from its ideal position [rad], and of the bodies
that have supports from theirs [m], close it by

    overlap = J q - gap(theta)                                               [m]

Driving flanks hold the output against a positive torque, so their ``J`` is negative (the overlap grows when the
output falls back); the ``J`` of a back flank is positive. Pins of a cycloidal disc touch one flank after the other as
the disc goes around: the sign of ``J`` tells which. Which contact is what, its `Layout` says.
"""

import equinox as eqx
import jax.numpy as jnp

from gearjax.contact.layout import Layout
from gearjax.contact.springs import LinearSprings, Springs
from gearjax.typing import Array, Float, Int, Scalar


class ContactSet(eqx.Module):
    """All candidate contacts of a scene at one input angle, errors included.

    Args:
        jacobian: shape (contact, coordinate); the output's column first [m/rad], then those of bodies that have
            supports [-].
        gap: shape (contact,) [m].
        springs: of the contacts; ``None`` for rigid teeth.
        layout: sides of the contacts, and pairs that they are flanks of.
        supports: stiffness of the coordinates after the first, shape (support, support) [N/m]; ``None`` where the
            output alone moves.
    """

    jacobian: Float[Array, "contact coordinate"]
    gap: Float[Array, " contact"]
    springs: Springs | None
    layout: Layout = eqx.field(static=True)
    supports: Float[Array, "support support"] | None = None

    @property
    def lever(self) -> Float[Array, " contact"]:
        """The single column of the Jacobian [m/rad]."""
        if self.jacobian.shape[1] != 1:
            raise ValueError(f"this solver is for one degree of freedom, the contacts have {self.jacobian.shape[1]}")
        return self.jacobian[:, 0]

    @property
    def linear(self) -> Float[Array, " contact"] | None:
        """Stiffness of linear springs, shape (contact,) [N/m]; ``None`` for rigid teeth."""
        if self.springs is None:
            return None
        if not isinstance(self.springs, LinearSprings):
            raise ValueError(f"this solver is for linear springs, the contacts have {type(self.springs).__name__}")
        return self.springs.stiffness

    def carriers(self, load: Scalar) -> Int[Array, ""]:
        """Number of pairs that could carry a generalised force [N m]; where levers tell the side, those on its side."""
        if not self.layout.sides_turn:
            return jnp.asarray(self.layout.teeth)
        return jnp.where(load > 0, self.lever > 0, self.lever < 0).sum()
