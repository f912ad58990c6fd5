"""What every gear set offers to a scene."""

import abc
import math
from collections.abc import Mapping
from typing import ClassVar, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.contact import GearSize, Layout, Moved, Movements, Places, Pose, Request
from gearjax.dependence import depends
from gearjax.geometry.cycloid import Cycloid
from gearjax.geometry.involute import InvoluteGear
from gearjax.structure import Orbit
from gearjax.typing import Array, Bool, Float, Scalar

ANGLES_OF_PLACES = 33  # of a mesh period


@runtime_checkable
class DiscProfile(Protocol):
    """What a gear set offers besides where its discs have a cycloidal profile that can be drawn."""

    @property
    def profile(self) -> Cycloid:
        """Profile of the discs, and the pins."""
        ...


@runtime_checkable
class GearOutlines(Protocol):
    """What a gear set offers besides whose gears have outlines that can be drawn, tooth by tooth."""

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the gears."""
        ...

    def teeth_of(self, body: str, points: int, backlash: float) -> list[np.ndarray]:
        """Smooth pieces of the outline of a gear, one after the other of each tooth, each of shape (tooth, point, 2)
        [m], by so many points.

        Args:
            body: the gear.
            points: of each piece.
            backlash: between its back flanks and those of the other gear [m].
        """
        ...


class AbstractSystem(eqx.Module):
    """A gear set: geometry and topology, nothing else.

    A subclass is one file: parameters as fields (`gearjax.parameters`), and the methods below. ``kind`` is its
    name in a configuration.
    """

    kind: eqx.AbstractClassVar[str]
    has_clearance: ClassVar[bool] = False
    """Whether gaps of its back flanks tell the room that its own geometry leaves, before any initial backlash."""
    has_radii: ClassVar[bool] = False
    """Whether its contacts are line contacts whose radii of curvature it shows."""
    has_places: ClassVar[bool] = False
    """Whether it shows where on their teeth the contacts are."""
    by_constant_modes: ClassVar[bool] = False
    """Whether constant modes follow its motion best where the output alone moves: so it is with many contacts whose
    levers change with the input angle."""
    has_slices: ClassVar[bool] = False
    """Whether its contacts are slices of contact lines, which it shows."""
    input_speed: eqx.AbstractVar[Array]
    """Angular speed of the input [rad/s]."""

    @property
    @abc.abstractmethod
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that errors may be placed on."""

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        """Bodies that may have supports or be on shafts, with the directions of each: ``x`` along its crank's throw,
        ``y`` across, ``z`` along the axis, turns about them ``rx``, ``ry`` and ``rz``, ahead as the body turns."""
        return {}

    @property
    def meshes(self) -> tuple[tuple[str, str], ...]:
        """Bodies of each mesh, the driving one first, from the input's to the output's: of gear sets whose bodies may
        be on shafts. The first one turns with the input, the last one with the output."""
        return ()

    @property
    def orbits(self) -> Mapping[str, Orbit]:
        """How bodies go round that a crank carries; others have axes that stand still."""
        return {}

    @property
    @abc.abstractmethod
    def orders(self) -> Mapping[str, float]:
        """Named frequencies, in cycles per turn of the input; ``output`` and ``mesh`` are always there. The mesh of a
        train is its fastest one; what else gaps follow is named too, so that steps and samples resolve it."""

    @property
    def fastest_order(self) -> float:
        """Turns per turn of the input of what the curves follow fastest; the mesh counts where its teeth are errors."""
        return max((order for name, order in self.orders.items() if name != "mesh"), default=1.0)

    def output(self, theta: Scalar) -> Scalar:
        """Ideal output angle at an input angle [rad]; of gears that are not circular it does not go in proportion."""
        return self.orders["output"] * theta

    @property
    def turns_evenly(self) -> bool:
        """Whether the ideal output turns in proportion to the input: else its inertia loads the teeth."""
        if type(self).output is AbstractSystem.output:
            return True
        still = jnp.zeros_like(self.input_speed)
        return not depends(lambda theta: jax.jvp(self.output, (theta,), (jnp.ones_like(theta),))[1], still)[0]

    def output_acceleration(self, time: Scalar) -> Scalar:
        """Acceleration of the ideal output at a time [s], the input turning evenly [rad/s2]."""

        def rate(time: Scalar) -> Scalar:
            return jax.jvp(lambda at: self.output(self.input_speed * at), (time,), (jnp.ones_like(time),))[1]

        return jax.jvp(rate, (time,), (jnp.ones_like(time),))[1]

    def choices(self) -> Mapping[str, "AbstractSystem"]:
        """The same gear set by each choice of how exactly its geometry is followed, the most exact one last; empty
        where there is no choice."""
        return {}

    @property
    def told_of_forces(self) -> str | None:
        """What a reader of the single contact forces should know."""
        return None

    def gear_size(self, body: str) -> GearSize | None:
        """What deviations of a gear are measured by; ``None`` of bodies on which none were."""
        del body

    def contact_name(self, contact: int) -> str:
        """Name of a contact, for messages."""
        return f"contact {contact + 1}"

    @property
    @abc.abstractmethod
    def cycle(self) -> float:
        """Input angle after which the errors of the bodies repeat [rad]."""

    @abc.abstractmethod
    def layout(self, request: Request) -> Layout:
        """Sides and pairs of the contacts. Where the sign of a lever tells the side, gaps count from the ideal profile,
        and no back flanks are asked for."""

    @abc.abstractmethod
    def pose(self, theta: Scalar, request: Request) -> Pose:
        """Contacts of ideal bodies at an input angle [rad], in the order of the layout, and what else is asked for.

        Raises:
            ParameterError: a body is asked for that the system does not have.
        """

    def outermost(self, theta: Scalar, request: Request) -> Bool[Array, " contact"] | None:
        """Of a gear set that looks at some of its teeth only, those beside which others are left out: where they carry
        at an input angle [rad], the others would too. ``None`` where all are looked at."""
        del theta, request

    @property
    def exact(self) -> bool:
        """Whether gaps and levers are those of the displaced bodies (`displaced_gaps`), not to first order."""
        return False

    def movements(self, body: str, theta: Scalar, request: Request) -> Movements:
        """How errors fixed on a body displace it, each direction as a view of its own; of systems that are `exact`.

        Raises:
            NotImplementedError: the system works to first order only.
        """
        raise NotImplementedError(f"{self.kind} has no exact geometry")

    def displaced_gaps(
        self, theta: Scalar, moved: Mapping[str, Moved], position: Scalar, request: Request
    ) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        """Gaps at an input angle [rad] of displaced bodies, the output away from its ideal position [rad], and their
        change with that position; of systems that are `exact`.

        Args:
            theta: input angle [rad].
            moved: displacements by body, of those that carry errors.
            position: of the output, beyond its ideal one [rad].
            request: which tells whether back flanks are asked for.

        Returns:
            True distances, and their change, shape (contact,) each [m, m/rad].

        Raises:
            NotImplementedError: the system works to first order only.
        """
        raise NotImplementedError(f"{self.kind} has no exact geometry")


@eqx.filter_jit
def pose_of(system: AbstractSystem, theta: Scalar, request: Request) -> Pose:
    """The same as `AbstractSystem.pose`, written down once: programs look at a pose in many places, each with its own
    derivatives and batches."""
    return system.pose(theta, request)


def flank_radii(system: AbstractSystem) -> tuple[tuple[InvoluteGear, InvoluteGear], tuple[Array, Array]]:
    """Gears of a gear set that shows the places of its contacts, and the radii of these on each of them over a mesh
    period, shape (angle, block, pair, point) [m]."""
    period = 2 * math.pi / system.orders["mesh"]
    theta = jnp.linspace(0.0, period, ANGLES_OF_PLACES, dtype=system.input_speed.dtype)

    def places(angle: Scalar) -> Places:
        shown = pose_of(system, angle, Request(places=True)).places
        assert shown is not None  # the system has them
        return shown

    return places(theta[0]).gears, jax.vmap(lambda angle: places(angle).radius)(theta)
