"""What every compliance offers to a scene."""

import abc
from typing import ClassVar

import equinox as eqx

from gearjax.compliance.line_contact import AbstractLineContact
from gearjax.contact import Layout, Places, Slices, Springs
from gearjax.geometry.involute import InvoluteGear
from gearjax.typing import Array, Float, Scalar


class AbstractCompliance(eqx.Module):
    """Stiffness of the pairs of a gear set. ``kind`` is its name in a configuration."""

    kind: eqx.AbstractClassVar[str]

    @abc.abstractmethod
    def mean_stiffness(self, pairs: int) -> Float[Array, " pair"]:
        """Stiffness of each pair averaged over a mesh period, shape (pair,) [N/m]: what the static TE uses."""

    @abc.abstractmethod
    def stiffness(self, mesh_angle: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """Stiffness of each pair at its mesh phase [rad], shape (pair,) [N/m]."""

    @property
    @abc.abstractmethod
    def harmonics(self) -> int:
        """Highest harmonic of the mesh frequency."""

    @abc.abstractmethod
    def peak_stiffness(self) -> Scalar:
        """A bound from above on the stiffness of a pair [N/m]."""


class AbstractCoupledCompliance(eqx.Module):
    """Compliance of contacts that move each other: teeth of one body. ``kind`` is its name in a configuration."""

    kind: eqx.AbstractClassVar[str]

    @abc.abstractmethod
    def influence(self, layout: Layout) -> Float[Array, "contact contact"]:
        """Approach of each contact per force on each, symmetric and positive definite, shape (contact, contact) [m/N].

        Args:
            layout: of the contacts.
        """


class AbstractToothCompliance(eqx.Module):
    """Compliance of contacts that move each other, by where on their teeth they are. ``kind`` is its name in a
    configuration."""

    kind: eqx.AbstractClassVar[str]
    prepares: ClassVar[bool] = False
    """Whether it has something to work out beforehand for a gear set (`made_for`)."""

    @abc.abstractmethod
    def influence(self, places: Places) -> Float[Array, "contact contact"]:
        """Approach of each contact per force on each, symmetric and positive definite, shape (contact, contact) [m/N].

        Args:
            places: of the contacts on their teeth.
        """

    def blocks(self, places: Places) -> Float[Array, "block own own"]:
        """The same in blocks of contacts, in their order, that do not move those of others, shape (block, own, own)
        [m/N]: small ones, of a few contacts each, are quick."""
        return self.influence(places)[None]

    def made_for(
        self, gears: tuple[InvoluteGear, InvoluteGear], radii: tuple[Array, Array]
    ) -> "AbstractToothCompliance":
        """The same with what it has to work out beforehand for a gear set, if there is something.

        Args:
            gears: whose teeth the contacts are on.
            radii: of the contacts on each over a mesh period, shape (angle, block, pair, point) [m].
        """
        return self

    def check(self, places: Places) -> None:
        """Refuse teeth that it was not made for.

        Args:
            places: of the contacts on them, numbers that are known.

        Raises:
            GearjaxError: naming what is wrong.
        """

    @property
    def line_contact(self) -> AbstractLineContact | None:
        """Material and face width of the contacts, for the pressure in them; ``None`` where it has none."""
        return None


class AbstractSliceCompliance(eqx.Module):
    """Compliance of contacts that are slices of contact lines. ``kind`` is its name in a configuration."""

    kind: eqx.AbstractClassVar[str]

    @property
    def couples(self) -> bool:
        """Whether its slices move each other."""
        return False

    @property
    def linear(self) -> bool:
        """Whether their forces are in proportion to their overlaps, one by one: so they are in motion."""
        return not self.couples

    @abc.abstractmethod
    def springs(self, slices: Slices) -> Springs:
        """Springs of the contacts, along the normals of the flanks.

        Args:
            slices: which of the contact lines they are.
        """

    def check(self, slices: Slices) -> None:
        """Refuse gears that it is not for.

        Args:
            slices: of the contacts, numbers that are known.

        Raises:
            GearjaxError: naming what is wrong.
        """

    @property
    def line_contact(self) -> AbstractLineContact | None:
        """Material and face width of the contacts, for the pressure in them; ``None`` where it has none."""
        return None


COUPLED = (AbstractCoupledCompliance, AbstractToothCompliance)
"""Those whose contacts move each other, as `isinstance` takes them."""


def couples(compliance: object) -> bool:
    """Whether contacts with this compliance move each other."""
    return isinstance(compliance, COUPLED) or (isinstance(compliance, AbstractSliceCompliance) and compliance.couples)
