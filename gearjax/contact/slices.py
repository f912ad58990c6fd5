"""Slices of contact lines: where on the plane of action of a pair on parallel axes its contacts are."""

import equinox as eqx
import jax.numpy as jnp

from gearjax.geometry.helical_pair import InvolutePair
from gearjax.typing import Array, Float


class Slices(eqx.Module):
    """Contacts that are slices of contact lines: in blocks by side, in each of them pair by pair, across the face.

    Args:
        pair: the gears.
        roll: lengths of roll of gear 1 and of gear 2 at the contacts, shape (block, pair, slice) [m].
        across: their places from the middle of the face, shape (block, pair, slice) [m].
        share: of each slice that touches where the flanks do, shape (block, pair, slice) [-].
    """

    pair: InvolutePair
    roll: tuple[Float[Array, "block pair slice"], Float[Array, "block pair slice"]]
    across: Float[Array, "block pair slice"]
    share: Float[Array, "block pair slice"]

    @property
    def lengths(self) -> Float[Array, " contact"]:
        """Lengths of contact line that the contacts stand for, of a whole slice ``b / (n cos beta_b)`` [m]."""
        whole = self.pair.face_width / self.share.shape[-1] / jnp.cos(self.pair.base_helix_angle)
        return (whole * self.share).ravel()

    @property
    def curvature(self) -> Float[Array, "block pair slice"]:
        """Relative curvature of the flanks across the contact lines, ``cos beta_b (1 / rho_1 + 1 / rho_2)``, of an
        internal gear the difference (ISO 21771) [1/m]."""
        first, second = self.roll
        other = -1 / second if self.pair.internal else 1 / second
        return jnp.cos(self.pair.base_helix_angle) * (1 / first + other)
