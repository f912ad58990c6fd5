"""Loaded curves of many gear sets whose springs are coupled, where errors alone differ: poses and matrices are shared.

What a system shows at an angle, and how its teeth give way there, do not depend on the errors. Both are worked out once
for all gear sets, outside of their program; under each angle the gear sets are lanes that share its matrix.
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
    """What all gear sets of a population share.

    Args:
        poses: at the input angles.
        springs: there, every number with a leading axis of angles.
    """

    poses: Pose
    springs: CoupledSprings

    @classmethod
    def of(cls, scene: Scene, theta: Float[Array, " n"], fixed: bool) -> "Pressed | None":
        """Of a population whose errors alone vary and whose output alone moves; ``None`` of any other.

        Args:
            scene: one of the gear sets.
            theta: input angles, shape (n,) [rad].
            fixed: whether errors and backlash alone vary.
        """
        if not fixed or not isinstance(scene.compliance, COUPLED) or not scene.output_alone or scene.system.exact:
            return None
        return cls(*_shared(scene, theta))

    def curve(self, scene: Scene, torque: float) -> Float[Array, " n"]:
        """Static TE of one gear set under a torque [N m] at all angles, nan where there is none [rad]."""
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
