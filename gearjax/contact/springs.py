"""Types of springs of the contacts: independent linear springs, independent line contacts, and coupled springs."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.contact.faces import Faces
from gearjax.contact.slices import by_side
from gearjax.typing import Array, Float, Scalar

STEPS = 2  # steps of Newton's method before those that carry derivatives: rounding is all that is left of 2 %
NEAR = 2.6  # ``y - ln y`` at which two series of the Lambert function are equally good
LAST = 1.5  # smallest ``level - ln F`` at which the formula is used; at higher forces it is continued linearly
ELASTIC = 6.0  # ``level - ln F`` at which a contact is as wide as a quarter of its radius; steel yields before
SHALLOWEST = 1e-26  # m, smallest approach that makes a force
FEW_BLOCKS = 16  # up to which each is laid into the matrix by itself


class LinearSprings(eqx.Module):
    """Independent springs whose force is proportional to the approach.

    Args:
        stiffness: stiffness of each contact, shape (contact,) [N/m].
    """

    stiffness: Float[Array, " contact"]

    def force(self, penetration: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Force at an approach [N]."""
        return self.stiffness * penetration

    def secant(self, penetration: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Force per approach at an approach [N/m]."""
        del penetration
        return self.stiffness


class CoupledSprings(eqx.Module):
    """Coupled springs: a force on one contact moves the others too, such as teeth of one body or slices of one face.

    Args:
        blocks: approach of each contact per force on each contact of its block, symmetric and positive definite, shape
            (block, own, own) [m/N]. Contacts of different blocks, such as pairs of teeth, are not coupled. A matrix of
            all contacts is a single block and may be given with the shape (contact, contact). The blocks of slices of
            tooth faces may be given as these.
    """

    blocks: Float[Array, "block own own"] | Faces = eqx.field(
        converter=lambda given: given if isinstance(given, Faces) or given.ndim > 2 else given[None]
    )

    @property
    def influence(self) -> Float[Array, "*lane contact contact"]:
        """Influence matrix: approach of each contact per force on each contact, shape (contact, contact) [m/N]."""
        return block_diagonal(self.each_block)

    @property
    def each_block(self) -> Float[Array, "*lane block own own"]:
        """Matrix of each block [m/N]."""
        return self.blocks.blocks if isinstance(self.blocks, Faces) else self.blocks


def block_diagonal(blocks: Float[Array, "*lane block own own"]) -> Float[Array, "*lane contact contact"]:
    """Block-diagonal influence matrix from its blocks, shape (block * own, block * own) [m/N]."""
    *many, number, own, _ = blocks.shape
    if number == 1:
        return blocks[..., 0, :, :]
    if number <= FEW_BLOCKS:  # a product would work out each block again for all blocks beside it
        beside = [[*[(0, 0)] * (len(many) + 1), (i * own, (number - 1 - i) * own)] for i in range(number)]
        return jnp.concatenate([jnp.pad(blocks[..., i, :, :], beside[i]) for i in range(number)], axis=-2)
    unit = jnp.eye(number, dtype=blocks.dtype).reshape(*[1] * len(many), number, 1, number, 1)
    apart = unit * blocks[..., :, :, None, :]
    return apart.reshape(*many, number * own, number * own)


class LineSprings(eqx.Module):
    """Independent line contacts with the approach ``slope F (level - ln F)`` under a force F.

    Hertzian contact of cylinders and similar formulas have this form.

    Args:
        slope: slope of each contact, shape (contact,) [m/N].
        level: level of each contact for forces in N, shape (contact,) [-].
    """

    slope: Float[Array, " contact"]
    level: Float[Array, " contact"]

    def approach(self, force: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Approach of the bodies under a force [m]."""
        safe = jnp.where(force > 0, force, 1.0)
        return jnp.where(force > 0, self.slope * safe * (self.level - jnp.log(safe)), 0.0)

    def force(self, penetration: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Force at an approach [N]; zero if the bodies do not touch.

        Newton's method solves for the logarithm of the force, from series of the Lambert function W_-1 (Corless et al.
        1996, eqs. 4.19 and 4.22). Its last two steps carry first and second derivatives. At forces far beyond the
        elastic range the formula's approach would decrease; there the force is continued linearly.
        """
        end = jnp.exp(self.level - LAST)
        furthest = LAST * self.slope * end
        least = _shallowest(penetration.dtype)
        touching, beyond = penetration > least, penetration > furthest
        inside = jnp.where(touching & ~beyond, penetration, jnp.where(beyond, furthest, least))
        target = jnp.log(inside / self.slope)  # F (level - ln F)
        known = jax.lax.stop_gradient((target, self.level))
        x = known[1] - _lambert(known[1] - known[0])
        for end_at, level in (*[known] * STEPS, *[(target, self.level)] * 2):
            x = x - (x + jnp.log(level - x) - end_at) / (1.0 - 1.0 / (level - x))
        straight = end + (penetration - furthest) / ((LAST - 1.0) * self.slope)
        return jnp.where(beyond, straight, jnp.where(touching, jnp.exp(x), 0.0))

    def secant(self, penetration: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Force per approach at an approach [N/m]; zero if the bodies do not touch."""
        touching = penetration > _shallowest(penetration.dtype)
        return self.force(penetration) / jnp.where(touching, penetration, 1.0)

    @property
    def stiffest(self) -> Float[Array, " contact"]:
        """Change of force per change of approach at the end of the elastic range [N/m]."""
        return 1 / (self.slope * (ELASTIC - 1.0))

    def tangent(self, indentation: Scalar) -> Float[Array, " contact"]:
        """Change of force per change of approach, where ``slope F`` of all contacts is the same number [N/m].

        Args:
            indentation: ``slope F``, above zero [m].
        """
        left = self.level - jnp.log(indentation / self.slope)
        return 1 / (self.slope * (jnp.maximum(left, LAST) - 1.0))


def _shallowest(dtype: jnp.dtype) -> float:
    """Smallest approach that makes a force [m]; the second derivative of its logarithm is finite in single precision
    too."""
    return max(SHALLOWEST, 10 / math.sqrt(float(jnp.finfo(dtype).max)))


def _lambert(c: Array) -> Array:
    """Solution y > 1 of ``y - ln y = c``, ``-W_-1(-exp(-c))``, to 2 %."""
    near = c < NEAR
    p = jnp.sqrt(2 * (jnp.where(near, c, NEAR) - 1))  # series about y = 1
    far = jnp.where(near, NEAR, c)
    log = jnp.log(far)
    series = far + log + log / far + log * (2 - log) / (2 * far * far)
    return jnp.where(near, 1 + p * (1 + p * (1 / 3 + p * (1 / 36 - p / 270))), series)


Springs = LinearSprings | LineSprings | CoupledSprings


def join_springs(parts: Sequence[Springs], sides: int) -> Springs:
    """Springs of several meshes, which must be of one type, as the springs of all contacts in the order `by_side`."""
    return jax.tree.map(lambda *own: by_side(own, sides), *parts)
