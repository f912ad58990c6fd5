"""What is known of the springs of the contacts at all times: means, a bound from above, and where dampers act.

Springs of pairs of teeth swing about a mean, and each pair has one damper, along its first flank. Slices of contact
lines come onto the path of contact and leave it, with a stiffness that goes by the angle: their mean is that of the
whole mesh over its period, and each has a damper of its own, in proportion to its stiffness.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.compliance import AbstractSliceCompliance
from gearjax.contact import Layout
from gearjax.contact.layout import Place
from gearjax.inertia import DampingRatio
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Scalar

ANGLES = 32  # of a mesh period, that slices are looked at
TOUCHING = 1e-9  # m, between ideal flanks that touch; corners of tips beyond the path of contact do not
HARMONICS = 16  # of the mesh, that steps resolve where slices come and go


class MeanSprings(eqx.Module):
    """Springs of the contacts of a scene.

    Args:
        mean: stiffness of each contact, shape (contact,) [N/m]; of slices where flanks touch, averaged over the period.
        peak: of slices the highest stiffness of the mesh over its mean [-], else that of a pair [N/m].
        pairs: of slices how many pairs touch on average, the total contact ratio [-].
        carries: 1 for slices on the flanks that hold the torque, 0 for others, shape (contact,).
        matrix: of slices, mean of ``J^T k J`` of those, shape (coordinate, coordinate) [N m/rad, N/m]; ``None`` of
            other springs.
        harmonics: of the mesh frequency, that steps resolve.
        layout: sides and pairs of the contacts.
    """

    mean: Float[Array, " contact"]
    peak: Scalar
    pairs: Scalar
    carries: Float[Array, " contact"]
    matrix: Float[Array, "coordinate coordinate"] | None
    harmonics: int = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)

    @classmethod
    def of(cls, scene: Scene, torque: Scalar) -> "MeanSprings":
        """Those of a scene whose springs are one by one (`require`), about a load torque [N m]."""
        layout = scene.layout
        if not isinstance(scene.compliance, AbstractSliceCompliance):
            compliance = scene.linear_compliance
            mean = layout.per_contact(layout.apiece(compliance.mean_stiffness(layout.teeth)))
            numbers = mean, compliance.peak_stiffness(), jnp.ones_like(mean[0]), jnp.ones_like(mean), None
            return cls(*numbers, compliance.harmonics, layout)
        period = 2 * math.pi / scene.system.orders["mesh"]
        angles = jnp.asarray(period / ANGLES * np.arange(ANGLES), scene.dtype)
        drives = jnp.asarray(np.asarray(layout.side) > 0)
        if layout.has_back:
            drives = drives == (torque >= 0)

        back = np.asarray(layout.side) < 0

        def at(theta: Scalar) -> tuple[Array, Array, Array]:
            pose = scene.pose(theta, "varying")
            # back flanks count from the least of their gaps, that of their own backlash
            room = jnp.where(jnp.asarray(np.asarray(layout.side) > 0), 0.0, pose.gap.min(where=back, initial=jnp.inf))
            contacts = scene.contacts(pose, "varying")
            assert contacts.linear is not None
            assert pose.slices is not None
            stiffness = jnp.where(drives & (pose.gap - room < TOUCHING), contacts.linear, 0.0)
            matrix = contacts.jacobian.T @ (stiffness[:, None] * contacts.jacobian)
            return stiffness, matrix, pose.slices.pair.total_contact_ratio

        stiffness, matrices, ratio = jax.vmap(at)(angles)
        whole = stiffness.sum(axis=1)
        carries = drives.astype(whole.dtype)
        numbers = stiffness.mean(axis=0), whole.max() / whole.mean(), ratio[0], carries, matrices.mean(axis=0)
        return cls(*numbers, HARMONICS, layout)

    @property
    def sliced(self) -> bool:
        """Whether they are slices of contact lines, whose stiffness comes and goes."""
        return self.matrix is not None

    @property
    def damped(self) -> Place:
        """The contacts that have dampers: the first flank of each pair, or all slices."""
        return slice(0, len(self.layout.side)) if self.sliced else self.layout.flanks[0]

    def at_contacts(self, of_dampers: Float[Array, " damper"]) -> Float[Array, " contact"]:
        """Numbers of the dampers at their contacts, zero at others."""
        return of_dampers if self.sliced else self.layout.on_first(of_dampers)

    def earliest(self, of_contacts: Float[Array, " contact"]) -> Float[Array, " damper"]:
        """The least number of the contacts that each damper acts with."""
        if self.sliced:
            return of_contacts
        first, *others = self.layout.flanks
        least = of_contacts[first]
        for flank in others:
            least = jnp.minimum(least, of_contacts[flank])
        return least

    def damping(self, damping: DampingRatio, mass: Array) -> Float[Array, "*pair"]:
        """Coefficients of the dampers of pairs [N s/m]; of slices over their stiffness, as if each of the pairs that
        touch had one, shape () [s].

        Args:
            damping: of each pair.
            mass: on the line of action [kg].
        """
        if not self.sliced:
            first = self.layout.flanks[0]
            return damping.coefficient(self.mean[first] * self.layout.across, mass)
        whole = self.mean.sum()
        return damping.coefficient(self.pairs * whole, mass) / whole

    def stiffest(self, jacobian: Float[Array, "contact coordinate"]) -> Float[Array, "coordinate coordinate"]:
        """Stiffness of the coordinates on all contacts at their peak [N m/rad, N/m]."""
        if self.matrix is not None:
            return self.peak * self.matrix
        first = jacobian[self.layout.flanks[0]]
        return self.peak * first.T @ first

    def dampers(
        self, jacobian: Float[Array, "contact coordinate"], coefficient: Float[Array, "*pair"]
    ) -> Float[Array, "coordinate coordinate"]:
        """Damping of the coordinates by all dampers [N m s/rad, N s/m]; arguments as of the equation of motion."""
        if self.matrix is not None:
            return coefficient * self.peak * self.matrix
        first = jacobian[self.layout.flanks[0]]
        return first.T @ (coefficient[:, None] * first)
