"""Quasi-static curves of many gear sets with two-sided contacts, such as the pins of cycloidal discs.

Which contacts carry changes all the time, and their levers do: nothing is interpolated, each gear set is looked at in
all angles. Contacts are written out as one array each, over the input angles, which is what vectorises.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.contact.equilibrium import facing, hard_edges
from gearjax.contact.frame import Pose
from gearjax.contact.search import hard_balance
from gearjax.scene import Scene, Stiffness
from gearjax.typing import Array, Float


class Balances(eqx.Module):
    """What all gear sets of a population share.

    Args:
        poses: at all angles, these as the last axis.
        lever: of the contacts, shape (contact, n) [m/rad].
        stiffness: ``"rigid"``, or ``"mean"`` where torques are looked at.
    """

    poses: Pose
    lever: Float[Array, "contact n"]
    stiffness: Stiffness = eqx.field(static=True)

    @classmethod
    def of(cls, scene: Scene, theta: Float[Array, " n"], stiffness: Stiffness) -> "Balances":
        """From one gear set; no number of the system varies."""
        poses = _poses(scene, theta)
        return cls(poses, poses.drive.frame.jacobian[:, 0], stiffness)

    def touches(self, scene: Scene) -> "Balance":
        """The contacts of one gear set in all angles."""
        return Balance(*self._contacts(scene))

    def rows(self, scenes: Scene) -> "Balance":
        """The contacts of several gear sets, whose numbers have a leading axis."""
        # contacts before gear sets: what all of these share stays at hand while it is used
        gap, spring = jax.vmap(lambda scene: self._contacts(scene)[1:], out_axes=(1, 0))(scenes)
        return Balance(self.lever[:, None], gap, None if spring is None else spring[:, None])

    def _contacts(self, scene: Scene) -> tuple[Array, Array, Array | None]:
        def at(pose: Pose) -> tuple[Array, Array, Array | None]:
            contacts = scene.contacts(pose, self.stiffness)
            return contacts.lever, contacts.gap, None if contacts.linear is None else contacts.linear[0]

        return jax.vmap(at, in_axes=-1, out_axes=(-1, -1, None))(self.poses)


class Balance(eqx.Module):
    """The contacts of gear sets over input angles.

    Args:
        lever: shape (contact, n), or (contact, 1, n) for rows of gear sets [m/rad].
        gap: shape (contact, n), or (contact, row, n) [m].
        spring: stiffness of every contact, shape () or (row, 1) [N/m], or ``None``.
    """

    lever: Float[Array, "contact ..."]
    gap: Float[Array, "contact ..."]
    spring: Array | None

    def curve(self, analysis: str, torque: float | None) -> Float[Array, "..."]:
        """The curve of an analysis, shape (n,) or (row, n) [rad]."""
        if torque is not None:
            assert self.spring is not None  # the measure requires a compliance
            load = -jnp.asarray(torque, self.gap.dtype) / self.spring
            return hard_balance(list(self.lever), self.gap, load)
        lower = self._edge(1.0)
        return lower if analysis == "no_load" else -self._edge(-1.0) - lower

    def _edge(self, sign: float) -> Float[Array, "..."]:
        """Highest position at which a contact of one side touches, of the other side's the lowest, negated [rad]."""
        per_lever = 1 / jnp.abs(self.lever).mean(axis=0)
        touch = [facing(arm, gap, sign, per_lever) for arm, gap in zip(self.lever, self.gap, strict=True)]
        return hard_edges(touch, len(touch))[0]


@eqx.filter_jit
def _poses(scene: Scene, theta: Float[Array, " n"]) -> Pose:
    return jax.vmap(scene.pose, out_axes=-1)(theta)
