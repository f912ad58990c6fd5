"""Slices of contact lines: places of the contacts of a pair on parallel axes on its plane of action."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp

from gearjax.geometry.helical_pair import InvolutePair
from gearjax.typing import Array, Float


def by_side(parts: Sequence[Array], sides: int) -> Array:
    """Numbers of the contacts or pairs of several meshes, each in the order of its sides, as one array, sides first.

    In this order the number of a contact does not depend on whether back flanks are modelled.

    Args:
        parts: numbers of each mesh, the contacts or pairs along the first axis.
        sides: number of sides, 1 or 2.
    """
    if len(parts) == 1:
        return parts[0]
    apart = [part.reshape(sides, -1, *part.shape[1:]) for part in parts]
    return jnp.concatenate(apart, axis=1).reshape(-1, *parts[0].shape[1:])


class Slices(eqx.Module):
    """Contacts that are slices of contact lines, in the order side (block), pair, place across the face.

    Args:
        pair: the gears.
        roll: lengths of roll of gear 1 and of gear 2 at the contacts, shape (block, pair, slice) [m].
        across: places of the contacts from the middle of the face, shape (block, pair, slice) [m].
        share: share of each slice that is on the path of contact, shape (block, pair, slice) [-].
    """

    pair: InvolutePair
    roll: tuple[Float[Array, "block pair slice"], Float[Array, "block pair slice"]]
    across: Float[Array, "block pair slice"]
    share: Float[Array, "block pair slice"]

    @property
    def lengths(self) -> Float[Array, " contact"]:
        """Length of contact line of each contact, ``b / (n cos beta_b)`` for a whole slice [m]."""
        whole = self.pair.face_width / self.share.shape[-1] / jnp.cos(self.pair.base_helix_angle)
        return (whole * self.share).ravel()

    @property
    def curvature(self) -> Float[Array, "block pair slice"]:
        """Relative curvature of the flanks at right angles to the contact lines (ISO 21771) [1/m].

        It is ``cos beta_b (1 / rho_1 + 1 / rho_2)``, with the difference for an internal gear.
        """
        first, second = self.roll
        other = -1 / second if self.pair.internal else 1 / second
        return jnp.cos(self.pair.base_helix_angle) * (1 / first + other)
