"""Properties of the contact springs that hold at all times: means, an upper bound, and the places of the dampers.

The stiffness of a pair of teeth varies about a mean, and each pair has one damper, along the flank that touches. The
stiffness of a line contact grows with its force; its mean is the stiffness under the mean force. Slices of contact
lines enter and leave the path of contact, and their stiffness depends on the angle. Their mean is that of the whole
mesh over its mesh period, and each slice has its own damper, in proportion to its stiffness.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.compliance import AbstractLineContact, AbstractSliceCompliance
from gearjax.contact import Layout, LinearSprings, LineSprings
from gearjax.contact.layout import Place
from gearjax.inertia import DampingRatio
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Scalar

ANGLES = 128  # angles per mesh period at which slices are evaluated: mean stiffness of a spur pair to 0.04 %
TOUCHING = 1e-9  # m, largest gap of ideal flanks that touch; tip corners beyond the path have larger gaps
LIGHTEST = 1.0  # N, smallest mean force of line contacts; without a force they have no stiffness
HEAVIEST = 20.0  # force on slices for which steps are short enough, over the mean force
HARMONICS = 16  # harmonics of the mesh that steps resolve for slices


class MeanSprings(eqx.Module):
    """Mean springs of the contacts of a scene.

    Args:
        mean: mean stiffness of each contact, shape (contact,) [N/m]; for pins the mean over all pins of the stiffness
            under the mean force; for slices averaged over the mesh period, with zero while the flanks do not touch and
            for flanks that do not carry the torque.
        peak: for slices the highest stiffness of each mesh over its mean, shape (mesh,) [-], otherwise the peak
            stiffness of a pair [N/m].
        pairs: for slices the total contact ratio of each mesh, the mean number of pairs in contact, shape (mesh,) [-].
        carries: 1 for slices on the flanks that carry the torque, 0 for others, shape (contact,).
        matrices: for slices, mean of ``J^T k J`` over those flanks of each mesh, shape (mesh, coordinate, coordinate)
            [N m/rad, N/m]; ``None`` for other springs.
        harmonics: number of harmonics of the mesh frequency that steps resolve.
        layout: sides and pairs of the contacts.
        all_damped: whether each contact may have a damper: slices, and flanks of pairs whose dampers act in contact.
        indentation: for line contacts ``slope F`` of the mean force [m], as in `LineSprings`; ``None`` for linear
            springs.
    """

    mean: Float[Array, " contact"]
    peak: Float[Array, "*mesh"]
    pairs: Float[Array, "*mesh"]
    carries: Float[Array, " contact"]
    matrices: Float[Array, "mesh coordinate coordinate"] | None
    harmonics: int = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)
    all_damped: bool = eqx.field(static=True)
    indentation: Scalar | None = None

    @classmethod
    def of(cls, scene: Scene, torque: Scalar) -> "MeanSprings":
        """Mean springs of a scene with independent springs (`require`), under a load torque [N m]."""
        if isinstance(scene.compliance, AbstractSliceCompliance):
            return cls._of_slices(scene, torque)
        layout = scene.layout
        if isinstance(scene.compliance, AbstractLineContact):
            springs, indentation = _indented(scene, torque)
            each = springs.tangent(indentation)
            # the same for all: pins change places, and a pin must not keep the damper of its first place
            mean, peak, harmonics = jnp.full_like(each, jnp.mean(each)), springs.stiffest.max(), 0
        else:
            compliance, indentation = scene.linear_compliance, None
            mean = layout.per_contact(layout.apiece(compliance.mean_stiffness(layout.teeth)))
            peak, harmonics = compliance.peak_stiffness(), compliance.harmonics
        numbers = mean, peak, jnp.ones_like(mean[0]), jnp.ones_like(mean), None
        acting = scene.damping is None or scene.damping.acting == "contact"
        return cls(*numbers, harmonics, layout, acting, indentation)

    @classmethod
    def _of_slices(cls, scene: Scene, torque: Scalar) -> "MeanSprings":
        assert isinstance(scene.compliance, AbstractSliceCompliance)
        layout = scene.layout
        period = 2 * math.pi / np.array(scene.system.mesh_orders)
        angles = jnp.asarray(period[:, None] / ANGLES * np.arange(ANGLES), scene.dtype)
        own = jnp.asarray(_mesh(layout) == np.arange(len(period))[:, None], scene.dtype)
        drives = jnp.asarray(np.asarray(layout.side) > 0)
        if layout.has_back:
            drives = drives == (torque >= 0)
        back = np.asarray(layout.side) < 0
        indentation, firmer = None, 1.0
        if not scene.compliance.linear:
            springs, indentation = _indented(scene, torque)
            firmer = (springs.tangent(HEAVIEST * indentation) / springs.tangent(indentation)).max()

        def at(theta: Scalar, own: Float[Array, " contact"]) -> tuple[Array, Array, Array]:
            pose = scene.pose(theta, "varying")
            # the smallest gap of back flanks is the backlash of the mesh itself: these flanks touch there
            least = jnp.where(jnp.asarray(back) & (own > 0), pose.gap, jnp.inf).min()
            room = jnp.where(jnp.asarray(back), least, 0.0)
            contacts = scene.contacts(pose, "varying")
            assert isinstance(contacts.springs, LinearSprings | LineSprings)
            assert pose.slices is not None
            stiffness = _linear(contacts.springs, indentation)
            stiffness = own * jnp.where(drives & (pose.gap - room < TOUCHING), stiffness, 0.0)
            matrix = contacts.jacobian.T @ (stiffness[:, None] * contacts.jacobian)
            return stiffness, matrix, jnp.stack([mesh.pair.total_contact_ratio for mesh in pose.slices])

        stiffness, matrices, ratios = jax.vmap(jax.vmap(at, (0, None)))(angles, own)
        whole = stiffness.sum(axis=2)
        carries = drives.astype(whole.dtype)
        peak = firmer * whole.max(axis=1) / whole.mean(axis=1)
        numbers = stiffness.mean(axis=1).sum(axis=0), peak, ratios[0, 0], carries, matrices.mean(axis=1)
        return cls(*numbers, HARMONICS, layout, True, indentation)

    def linear(self, springs: LinearSprings | LineSprings) -> Float[Array, " contact"]:
        """Stiffness of springs of this scene, of line contacts under the mean force [N/m]."""
        return _linear(springs, self.indentation)

    @property
    def sliced(self) -> bool:
        """Whether the contacts are slices of contact lines, which enter and leave the path of contact."""
        return self.matrices is not None

    def per_mesh(self, of_meshes: Float[Array, " mesh"]) -> Float[Array, "..."]:
        """Numbers of the meshes at their contacts, shape (contact,); the number itself if there is one mesh."""
        return of_meshes if len(of_meshes) == 1 else of_meshes[_mesh(self.layout)]

    @property
    def damped(self) -> Place:
        """The contacts that may have dampers: all, or the first flank of each pair if dampers always act."""
        return slice(0, len(self.layout.side)) if self.all_damped else self.layout.flanks[0]

    def at_contacts(self, of_dampers: Float[Array, " damper"]) -> Float[Array, " contact"]:
        """Numbers of the dampers at their contacts, zero at the other contacts."""
        return of_dampers if self.all_damped else self.layout.on_first(of_dampers)

    def earliest(self, of_contacts: Float[Array, " contact"]) -> Float[Array, " damper"]:
        """For each damper, the smallest number of the contacts that it belongs to."""
        if self.sliced:
            return of_contacts
        first, *others = self.layout.flanks
        least = of_contacts[first]
        for flank in others:
            least = jnp.minimum(least, of_contacts[flank])
        return self.layout.per_contact(least) if self.all_damped else least

    def damping(self, damping: DampingRatio, mass: Array) -> Float[Array, "*pair"]:
        """Damping coefficients of the pairs [N s/m]; for slices the coefficient over stiffness of each mesh [s].

        For slices a whole mesh has, on average, as many dampers of a pair as pairs touch.

        Args:
            damping: damping of each pair.
            mass: equivalent mass on the line of action, one for all or of each pair [kg].
        """
        if not self.sliced:
            first = self.layout.flanks[0]
            return damping.coefficient(self.mean[first] * self.layout.across, mass)
        meshes, of_pair = np.arange(len(self.pairs)), _mesh(self.layout)[self.layout.flanks[0]]
        whole = jnp.stack([self.mean.sum(where=_mesh(self.layout) == mesh) for mesh in meshes])
        if mass.ndim:  # all pairs of a mesh have the same
            mass = mass[np.array([np.argmax(of_pair == mesh) for mesh in meshes])]
        return damping.coefficient(self.pairs * whole, mass) / whole

    def stiffest(self, jacobian: Float[Array, "contact coordinate"]) -> Float[Array, "coordinate coordinate"]:
        """Stiffness matrix of the coordinates from all contacts at peak stiffness [N m/rad, N/m]."""
        if self.matrices is not None:
            return jnp.tensordot(self.peak, self.matrices, 1)
        first = jacobian[self.layout.flanks[0]]
        return self.peak * first.T @ first

    def dampers(
        self, jacobian: Float[Array, "contact coordinate"], coefficient: Float[Array, "*pair"]
    ) -> Float[Array, "coordinate coordinate"]:
        """Damping matrix of the coordinates from all dampers [N m s/rad, N s/m].

        Arguments are those of the equation of motion.
        """
        if self.matrices is not None:
            return jnp.tensordot(coefficient * self.peak, self.matrices, 1)
        first = jacobian[self.layout.flanks[0]]
        return first.T @ (coefficient[:, None] * first)


def _indented(scene: Scene, torque: Scalar) -> tuple[LineSprings, Scalar]:
    """Line contacts at input angle 0, and ``slope F`` of their mean force [m].

    The mean force is that of contacts which hold the output evenly together: each pin has the same force, and slices
    have the same force per length. The stiffness grows slowly with the force, by some 6 % if the force doubles.
    """
    contacts = scene.contacts(jnp.zeros_like(scene.system.input_speed), "varying")
    springs, arms = contacts.springs, jnp.abs(contacts.jacobian[:, 0])
    assert isinstance(springs, LineSprings)
    held = (arms / springs.slope).sum(where=contacts.loaded(-torque))
    return springs, jnp.maximum(jnp.abs(torque) / held, LIGHTEST * springs.slope.min())


def _linear(springs: LinearSprings | LineSprings, indentation: Scalar | None) -> Float[Array, " contact"]:
    if isinstance(springs, LinearSprings):
        return springs.stiffness
    assert indentation is not None
    return springs.tangent(indentation)


def _mesh(layout: Layout) -> np.ndarray:
    """Number of the mesh of each contact."""
    return np.array(layout.mesh or (0,) * len(layout.side))
