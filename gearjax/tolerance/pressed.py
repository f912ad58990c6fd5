"""Loaded curves of many gear sets with coupled springs that differ only in errors; they share poses and springs.

The pose of a system at an angle and the compliance of its teeth there do not depend on the errors. Both are computed
once for all gear sets, outside the program of the gear sets. At each angle, all gear sets are solved with the same
matrix.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.compliance import COUPLED
from gearjax.contact import CoupledSprings, Pose, equilibrium
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Scalar


class Pressed(eqx.Module):
    """Poses and springs that are common to all gear sets of a population.

    Args:
        poses: poses at the input angles.
        springs: springs at the input angles, every number with a leading axis of angles.
    """

    poses: Pose
    springs: CoupledSprings

    @classmethod
    def of(cls, scene: Scene, theta: Float[Array, " n"], fixed: bool) -> "Pressed | None":
        """From a population of which only the errors vary and only the output moves; ``None`` for any other.

        Args:
            scene: one of the gear sets.
            theta: input angles, shape (n,) [rad].
            fixed: whether only errors and backlash vary.
        """
        if not fixed or not isinstance(scene.compliance, COUPLED) or not scene.output_alone or scene.system.exact:
            return None
        return cls(*_shared(scene, theta))

    def curve(self, scene: Scene, torque: float) -> Float[Array, " n"]:
        """Static TE of one gear set under a torque [N m] at all angles [rad]; nan if there is no equilibrium."""
        anchored, applied = scene.anchored(), -jnp.asarray(torque, scene.dtype)

        def at(pose: Pose, springs: CoupledSprings) -> Scalar:
            contacts = dataclasses.replace(anchored.contacts(pose), springs=springs)
            return equilibrium(contacts, applied, anchored.contact).position

        return jax.vmap(at)(self.poses, self.springs)


@eqx.filter_jit
def _shared(scene: Scene, theta: Float[Array, " n"]) -> tuple[Pose, CoupledSprings]:
    def at(angle: Scalar) -> tuple[Pose, CoupledSprings]:
        pose = scene.pose(angle, "mean")
        springs = scene.contacts(pose, "mean").springs
        assert isinstance(springs, CoupledSprings)
        return dataclasses.replace(pose, places=None), springs

    return jax.lax.map(at, theta)
