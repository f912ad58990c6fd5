"""Springs of the contacts by type: one by one in proportion, one by one as line contacts, coupled by a matrix."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.typing import Array, Float

STEPS = 6  # of Newton's method, from a start within a few per cent
LAST = 1.5  # level less the logarithm of the force up to which the formula is gone by
SHALLOWEST = 1e-26  # m, below which an approach counts as none


class LinearSprings(eqx.Module):
    """Springs one by one, whose force is in proportion to the approach.

    Args:
        stiffness: shape (contact,) [N/m].
    """

    stiffness: Float[Array, " contact"]

    def force(self, penetration: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Force of an approach [N]."""
        return self.stiffness * penetration


class CoupledSprings(eqx.Module):
    """Springs where a force on one contact moves the others too: teeth of one body, slices of one face.

    Args:
        blocks: approach of each contact per force on each of its block, symmetric and positive definite, shape (block,
            own, own) [m/N]. Contacts of different blocks, such as pairs of teeth, do not move each other. A matrix of
            all is one block, and may be given as it is, shape (contact, contact).
    """

    blocks: Float[Array, "block own own"] = eqx.field(converter=lambda given: given if given.ndim > 2 else given[None])

    @property
    def influence(self) -> Float[Array, "*lane contact contact"]:
        """Approach of each contact per force on each, shape (contact, contact) [m/N]."""
        return block_diagonal(self.blocks)


def block_diagonal(blocks: Float[Array, "*lane block own own"]) -> Float[Array, "*lane contact contact"]:
    """The matrix of contacts in blocks that do not move each other, shape (block * own, block * own) [m/N]."""
    *many, number, own, _ = blocks.shape
    if number == 1:
        return blocks[..., 0, :, :]
    apart = jnp.eye(number, dtype=blocks.dtype)[:, None, :, None] * blocks[..., :, :, None, :]
    return apart.reshape(*many, number * own, number * own)


class LineSprings(eqx.Module):
    """Line contacts whose approach under a force is ``slope F (level - ln F)``: Hertz' contact of cylinders, and
    formulas like it.

    Args:
        slope: shape (contact,) [m/N].
        level: shape (contact,) [-], of forces in N.
    """

    slope: Float[Array, " contact"]
    level: Float[Array, " contact"]

    def approach(self, force: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Approach of the bodies under a force [m]."""
        safe = jnp.where(force > 0, force, 1.0)
        return jnp.where(force > 0, self.slope * safe * (self.level - jnp.log(safe)), 0.0)

    def force(self, penetration: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Force of an approach [N]; none where the bodies are apart.

        Newton's method in the logarithm of the force; its last two steps carry derivatives, the second ones
        too. Approaches beyond all elasticity, where the formula turns back, go on in a straight line.
        """
        end = jnp.exp(self.level - LAST)
        furthest = LAST * self.slope * end
        touching, beyond = penetration > SHALLOWEST, penetration > furthest
        inside = jnp.where(touching & ~beyond, penetration, jnp.where(beyond, furthest, SHALLOWEST))
        target = jnp.log(inside / self.slope)  # F (level - ln F)
        x = jax.lax.stop_gradient(target - jnp.log(self.level - target + jnp.log(self.level)))
        known = jax.lax.stop_gradient((target, self.level))
        for end_at, level in (*[known] * (STEPS - 1), *[(target, self.level)] * 2):
            x = x - (x + jnp.log(level - x) - end_at) / (1.0 - 1.0 / (level - x))
        straight = end + (penetration - furthest) / ((LAST - 1.0) * self.slope)
        return jnp.where(beyond, straight, jnp.where(touching, jnp.exp(x), 0.0))


Springs = LinearSprings | LineSprings | CoupledSprings
