"""The interface between a compliance and a scene."""

import abc
from typing import ClassVar

import equinox as eqx

from gearjax.choosing import Choosing
from gearjax.compliance.line_contact import AbstractLineContact
from gearjax.contact import Layout, Places, Slices, Springs, join_springs
from gearjax.geometry.involute import InvoluteGear
from gearjax.typing import Array, Float, Scalar


class AbstractCompliance(Choosing):
    """Stiffness of the pairs of a gear set. ``kind`` is its name in a configuration."""

    kind: eqx.AbstractClassVar[str]

    @abc.abstractmethod
    def mean_stiffness(self, pairs: int) -> Float[Array, " pair"]:
        """Stiffness of each pair averaged over a mesh period, shape (pair,) [N/m]; the static TE uses this mean."""

    @abc.abstractmethod
    def stiffness(self, mesh_angle: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """Stiffness of each pair at its mesh phase [rad], shape (pair,) [N/m]."""

    @property
    @abc.abstractmethod
    def harmonics(self) -> int:
        """Number of the highest harmonic of the mesh frequency in the stiffness."""

    @abc.abstractmethod
    def peak_stiffness(self) -> Scalar:
        """Upper bound of the stiffness of a pair [N/m]."""

    @property
    def precomputes(self) -> bool:
        """Whether it has numbers that do not depend on the input angle and are worth working out only once
        (`precomputed`)."""
        return False

    def precomputed(self) -> "AbstractCompliance":
        """The same compliance, with what its stiffness needs at every mesh phase worked out."""
        return self


class AbstractCoupledCompliance(Choosing):
    """Compliance of coupled contacts, such as the teeth of one body. ``kind`` is its name in a configuration.

    Contacts are coupled if a force on one of them moves the others too.
    """

    kind: eqx.AbstractClassVar[str]

    @abc.abstractmethod
    def influence(self, layout: Layout) -> Float[Array, "contact contact"]:
        """Influence matrix: approach of each contact per force on each, symmetric and positive definite [m/N].

        Its shape is (contact, contact).

        Args:
            layout: sides and pairs of the contacts.
        """


class AbstractToothCompliance(Choosing):
    """Compliance of coupled contacts that depends on their places on the teeth. ``kind`` is its name in a
    configuration."""

    kind: eqx.AbstractClassVar[str]
    prepares: ClassVar[bool] = False
    """Whether it has to be prepared for a gear set before use (`made_for`)."""

    @abc.abstractmethod
    def influence(self, places: Places) -> Float[Array, "contact contact"]:
        """Influence matrix: approach of each contact per force on each, symmetric and positive definite [m/N].

        Its shape is (contact, contact).

        Args:
            places: places of the contacts on their teeth.
        """

    def blocks(self, places: Places) -> Float[Array, "block own own"]:
        """The influence matrix as diagonal blocks, shape (block, own, own) [m/N].

        The blocks are in the order of the contacts; contacts of different blocks are not coupled. Small blocks of a few
        contacts each are fast to solve.
        """
        return self.influence(places)[None]

    def made_for(
        self, gears: tuple[InvoluteGear, InvoluteGear], radii: tuple[Array, Array]
    ) -> "AbstractToothCompliance":
        """The compliance prepared for a gear set; the same compliance if it needs no preparation.

        Args:
            gears: both gears of the gear set.
            radii: radii of the contacts on each gear over a mesh period, shape (angle, block, pair, point) [m].
        """
        return self

    @property
    def precomputes(self) -> bool:
        """Whether it has numbers that do not depend on the input angle and are worth working out only once
        (`precomputed`)."""
        return False

    def precomputed(self, places: Places) -> "AbstractToothCompliance":
        """The same compliance, with what its influence needs at every input angle of a gear set worked out.

        Args:
            places: places of the contacts on their teeth, at any input angle.
        """
        return self

    def check(self, places: Places) -> None:
        """Refuse teeth that the compliance was not made for.

        Args:
            places: places of the contacts on the teeth, as concrete (not traced) numbers.

        Raises:
            GearjaxError: the compliance does not suit the teeth; the message names the reason.
        """

    @property
    def line_contact(self) -> AbstractLineContact | None:
        """Material and face width of the contacts, for their contact pressure; ``None`` if these are not known."""
        return None


class AbstractSliceCompliance(Choosing):
    """Compliance of contacts that are slices of contact lines. ``kind`` is its name in a configuration."""

    kind: eqx.AbstractClassVar[str]

    @property
    def couples(self) -> bool:
        """Whether the slices are coupled."""
        return False

    @property
    def precomputes(self) -> bool:
        """Whether it has numbers that do not depend on the input angle and are worth working out only once
        (`precomputed`)."""
        return False

    def precomputed(self, slices: tuple[Slices, ...]) -> "AbstractSliceCompliance":
        """The same compliance, with what its springs need at every input angle of a gear set worked out.

        Args:
            slices: slices of the contacts of each mesh, at any input angle.
        """
        return self

    @property
    def linear(self) -> bool:
        """Whether the force of each slice is proportional to its own overlap."""
        return not self.couples

    @abc.abstractmethod
    def springs(self, slices: Slices) -> Springs:
        """Springs of the contacts along the normals of the flanks.

        Args:
            slices: the slices of contact lines that the contacts represent.
        """

    def of_meshes(self, slices: tuple[Slices, ...]) -> Springs:
        """Springs of the contacts of all meshes, in the order of the contacts."""
        return join_springs([self.springs(mesh) for mesh in slices], slices[0].share.shape[0])

    def check(self, slices: Slices) -> None:
        """Refuse gears that the compliance does not suit.

        Args:
            slices: slices of the contacts, as concrete (not traced) numbers.

        Raises:
            GearjaxError: the compliance does not suit the gears; the message names the reason.
        """

    @property
    def line_contact(self) -> AbstractLineContact | None:
        """Material and face width of the contacts, for their contact pressure; ``None`` if these are not known."""
        return None


COUPLED = (AbstractCoupledCompliance, AbstractToothCompliance)
"""Compliances whose contacts are coupled, as a tuple for `isinstance`."""


def couples(compliance: object) -> bool:
    """Whether contacts with this compliance are coupled: a force on one of them moves the others too."""
    return isinstance(compliance, COUPLED) or (isinstance(compliance, AbstractSliceCompliance) and compliance.couples)
