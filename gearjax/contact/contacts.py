"""Candidate contacts of a scene at one input angle, errors and compliance included.

A contact is a one-sided spring. The displacement ``q`` of the output from its ideal position [rad] closes it by

    overlap = J q - gap(theta)                                               [m]

Driving flanks hold the output against a positive torque, so their ``J`` is negative (the overlap grows when the
output falls back); the ``J`` of a back flank is positive. Pins of a cycloidal disc touch one flank after the other as
the disc goes around: the sign of ``J`` tells which. Which contact is what, its `Layout` says.
"""

import equinox as eqx
import jax.numpy as jnp

from gearjax.contact.layout import Layout
from gearjax.contact.line import LineSprings
from gearjax.typing import Array, Float, Int, Scalar


class ContactSet(eqx.Module):
    """All candidate contacts of a scene at one input angle, errors included.

    Args:
        jacobian: shape (contact, dof) [m/rad].
        gap: shape (contact,) [m].
        stiffness: shape (contact,) [N/m], or the law of elastic line contacts; ``None`` for rigid teeth.
        layout: sides of the contacts, and pairs that they are flanks of.
    """

    jacobian: Float[Array, "contact dof"]
    gap: Float[Array, " contact"]
    stiffness: Float[Array, " contact"] | LineSprings | None
    layout: Layout = eqx.field(static=True)

    @property
    def lever(self) -> Float[Array, " contact"]:
        """The single column of the Jacobian [m/rad]."""
        if self.jacobian.shape[1] != 1:
            raise ValueError(f"this solver is for one degree of freedom, the contacts have {self.jacobian.shape[1]}")
        return self.jacobian[:, 0]

    @property
    def linear(self) -> Float[Array, " contact"] | None:
        """Stiffness of linear springs, shape (contact,) [N/m]; ``None`` for rigid teeth."""
        if isinstance(self.stiffness, LineSprings):
            raise ValueError("this solver is for linear springs, the contacts are line contacts")
        return self.stiffness

    def carriers(self, load: Scalar) -> Int[Array, ""]:
        """Number of pairs that could carry a generalised force [N m]; where levers tell the side, those on its side."""
        if not self.layout.sides_turn:
            return jnp.asarray(self.layout.teeth)
        return jnp.where(load > 0, self.lever > 0, self.lever < 0).sum()
