"""The interface between a gear set and a scene."""

import abc
import math
from collections.abc import Callable, Mapping
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.choosing import Choosing
from gearjax.contact import GearSize, Layout, Moved, Movements, Places, Pose, Request
from gearjax.dependence import depends
from gearjax.geometry.cycloid import Cycloid
from gearjax.geometry.involute import InvoluteGear
from gearjax.sketch import Sketch
from gearjax.structure import Orbit
from gearjax.typing import Array, Bool, Float, Scalar

ANGLES_OF_PLACES = 33  # input angles over one mesh period
FARTHEST = 0.25  # of the size of the teeth, beyond which displacements are surely not small


@runtime_checkable
class DiscProfile(Protocol):
    """A gear set whose discs have a cycloidal profile that can be drawn."""

    @property
    def profile(self) -> Cycloid:
        """Profile of the discs, with the pins."""
        ...


@runtime_checkable
class GearOutlines(Protocol):
    """A gear set whose gears have outlines that can be drawn tooth by tooth."""

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the gears."""
        ...

    def teeth_of(self, body: str, points: int, backlash: float) -> list[np.ndarray]:
        """Smooth pieces of the outline of a gear, each of shape (tooth, point, 2) [m].

        The pieces are in the order in which they follow each other on a tooth, such as flank, tip, flank and root.

        Args:
            body: the gear.
            points: number of points of each piece.
            backlash: distance between its back flanks and the back flanks of the other gear [m].
        """
        ...


class MeshingIn(NamedTuple):
    """How pairs of teeth come into mesh at the beginning of a path of contact.

    Args:
        system: the gear set with contact that goes on at the corners of the tips.
        begin: input angle at which each slice of pair 0 is at the beginning of its path of contact, shape (slice,)
            [rad].
        early: input angle before that from which the gap of a slice is known [rad].
        late: input angle after that at which a slice is in the middle of its path of contact [rad].
        radius: travel along the line of action per input angle [m/rad].
        leverage: function from a distance before the path [m] to the lever on the wheel of the flank's normal, over the
            lever on the path [-].
    """

    system: "AbstractSystem"
    begin: Float[Array, " slice"]
    early: Scalar
    late: Scalar
    radius: Scalar
    leverage: Callable[[Scalar], Scalar]


class AbstractSystem(Choosing):
    """A gear set: its geometry and topology, nothing else.

    Each subclass is one file with its parameters as fields (`gearjax.parameters`) and the methods below. ``kind`` is
    its name in a configuration.
    """

    kind: eqx.AbstractClassVar[str]
    has_clearance: ClassVar[bool] = False
    """Whether interference of both flanks is evaluated without a section ``backlash``, because the gaps of the back
    flanks contain the backlash of its own geometry."""
    has_radii: ClassVar[bool] = False
    """Whether its contacts are line contacts and a pose gives their radii of curvature."""
    has_places: ClassVar[bool] = False
    """Whether a pose gives the places of the contacts on their teeth."""
    by_constant_modes: ClassVar[bool] = False
    """Whether its motion is integrated by constant modes if only the output moves. Constant modes suit many contacts
    whose levers change with the input angle."""
    has_slices: ClassVar[bool] = False
    """Whether its contacts are slices of contact lines and a pose describes these slices."""
    size_of_teeth: ClassVar[str] = ""
    """Name of the parameter that tells how large its teeth or pins are, such as ``module``; empty if there is none."""
    input_speed: eqx.AbstractVar[Array]
    """Angular speed of the input [rad/s]."""

    @property
    def largest_displacement(self) -> float | None:
        """Displacement beyond which displacements are surely not small, a quarter of the size of the teeth [m].

        ``None`` if this size is not known.
        """
        if not self.size_of_teeth:
            return None
        return FARTHEST * float(np.min(np.asarray(getattr(self, self.size_of_teeth))))

    @property
    def precomputes(self) -> bool:
        """Whether it has numbers that do not depend on the input angle and are worth working out only once
        (`precomputed`)."""
        return False

    def precomputed(self) -> "AbstractSystem":
        """The same gear set, with what its pose needs at every input angle worked out, such as sizes of its gears.

        It stays as it was when numbers of the copy are replaced one by one (`equinox.tree_at`).
        """
        return self

    @property
    @abc.abstractmethod
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that may carry errors."""

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        """Bodies that may have supports or be on shafts, with the directions in which each of them may move.

        The directions are ``x`` along the throw of its crank, ``y`` across the throw, ``z`` along the axis, and the
        rotations ``rx``, ``ry`` and ``rz`` about these; ``rz`` is positive in the sense in which the body turns.
        """
        return {}

    @property
    def meshes(self) -> tuple[tuple[str, str], ...]:
        """The two bodies of each mesh, the driving body first; the meshes run from the input to the output.

        Only gear sets whose bodies may be on shafts have entries. The first body turns with the input, the last body
        with the output.
        """
        return ()

    @property
    def rigid_shafts(self) -> Mapping[str, tuple[str, ...]]:
        """Shafts that are rigid unless a scene lists their bodies on shafts of its own: the bodies of each, by name."""
        return {}

    @property
    def orbits(self) -> Mapping[str, Orbit]:
        """Orbits of the bodies that a crank carries; the axes of all other bodies stand still."""
        return {}

    @property
    @abc.abstractmethod
    def orders(self) -> Mapping[str, float]:
        """Named frequencies in cycles per turn of the input; ``output`` and ``mesh`` are always among them.

        The ``mesh`` of a train is its fastest mesh. Every other frequency that the gaps contain is named too, so that
        time steps and samples resolve it.
        """

    @property
    def mesh_orders(self) -> tuple[float, ...]:
        """Order of each mesh with slices, in order from the input."""
        return (self.orders["mesh"],)

    @property
    def fastest_order(self) -> float:
        """Highest order of the curves, in cycles per turn of the input, without ``mesh``.

        A gear set whose gaps change from tooth to tooth names the tooth frequency a second time, beside ``mesh``.
        """
        return max((order for name, order in self.orders.items() if name != "mesh"), default=1.0)

    def output(self, theta: Scalar) -> Scalar:
        """Ideal output angle at an input angle [rad]; for non-circular gears it is not proportional to that angle."""
        return self.orders["output"] * theta

    @property
    def meshing_in(self) -> MeshingIn | None:
        """How pairs of teeth come into mesh; ``None`` if they do not at the beginning of a path of contact."""
        return None

    @property
    def turns_evenly(self) -> bool:
        """Whether the ideal output turns in proportion to the input; if not, the inertia of the output loads teeth."""
        if type(self).output is AbstractSystem.output:
            return True
        still = jnp.zeros_like(self.input_speed)
        return not depends(lambda theta: jax.jvp(self.output, (theta,), (jnp.ones_like(theta),))[1], still)[0]

    def output_acceleration(self, time: Scalar) -> Scalar:
        """Acceleration of the ideal output at a time [s] while the input turns at constant speed [rad/s2]."""

        def rate(time: Scalar) -> Scalar:
            return jax.jvp(lambda at: self.output(self.input_speed * at), (time,), (jnp.ones_like(time),))[1]

        return jax.jvp(rate, (time,), (jnp.ones_like(time),))[1]

    @property
    def told_of_forces(self) -> str | None:
        """A note for readers of the single contact forces, such as a limit of their accuracy; ``None`` without one."""
        return None

    def sketch(self) -> Sketch | None:
        """Sketch of the gear set with the directions of its phases; ``None`` if the gear set does not give it."""

    def gear_size(self, body: str) -> GearSize | None:
        """Sizes of a gear that its deviations are checked against; ``None`` if the gear set does not give them."""
        del body

    def contact_name(self, contact: int) -> str:
        """Name of a contact in messages."""
        return f"contact {contact + 1}"

    @property
    @abc.abstractmethod
    def cycle(self) -> float:
        """Input angle after which the errors of the bodies repeat [rad]."""

    @abc.abstractmethod
    def layout(self, request: Request) -> Layout:
        """Sides and pairs of the contacts.

        If the sign of a lever decides the side of a contact (`Layout.either`), gaps are counted from the ideal profile,
        and no back flanks are requested.
        """

    @abc.abstractmethod
    def pose(self, theta: Scalar, request: Request) -> Pose:
        """Contacts of ideal bodies at an input angle [rad], in the order of the layout, and what else is requested.

        Raises:
            ParameterError: a requested body is not one of the system's bodies.
        """

    def outermost(self, theta: Scalar, request: Request) -> Bool[Array, " contact"] | None:
        """Contacts at the ends of the range of teeth that the gear set models; ``None`` if it models all teeth.

        If one of these contacts carries load at an input angle [rad], teeth outside the range would carry load too.
        """
        del theta, request

    @property
    def exact(self) -> bool:
        """Whether gaps and levers are those of the displaced bodies (`displaced_gaps`) and not first-order ones."""
        return False

    def movements(self, body: str, theta: Scalar, request: Request) -> Movements:
        """How errors fixed on a body displace it, with one view per direction; only for systems that are `exact`.

        Raises:
            NotImplementedError: the system works to first order only.
        """
        raise NotImplementedError(f"{self.kind} has no exact geometry")

    def displaced_gaps(
        self, theta: Scalar, moved: Mapping[str, Moved], position: Scalar, request: Request
    ) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        """Gaps of displaced bodies and their derivative by the output position; only for systems that are `exact`.

        Args:
            theta: input angle [rad].
            moved: displacements of the bodies that carry errors, by name.
            position: position of the output beyond its ideal position [rad].
            request: states whether back flanks are requested.

        Returns:
            True distances, and their derivative by the position, shape (contact,) each [m, m/rad].

        Raises:
            NotImplementedError: the system works to first order only.
        """
        raise NotImplementedError(f"{self.kind} has no exact geometry")


@eqx.filter_jit
def pose_of(system: AbstractSystem, theta: Scalar, request: Request) -> Pose:
    """The same as `AbstractSystem.pose`, traced once: programs use a pose in many places, and each of them has its own
    derivatives and batches."""
    return system.pose(theta, request)


def flank_radii(system: AbstractSystem) -> tuple[tuple[InvoluteGear, InvoluteGear], tuple[Array, Array]]:
    """Both gears of a gear set that has places, and the radii of the contacts on each gear over one mesh period.

    The radii have the shape (angle, block, pair, point) [m].
    """
    period = 2 * math.pi / system.orders["mesh"]
    theta = jnp.linspace(0.0, period, ANGLES_OF_PLACES, dtype=system.input_speed.dtype)

    def places(angle: Scalar) -> Places:
        shown = pose_of(system, angle, Request(places=True)).places
        assert shown is not None  # only systems with ``has_places`` come here
        return shown

    return places(theta[0]).gears, jax.vmap(lambda angle: places(angle).radius)(theta)
