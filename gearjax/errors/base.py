"""What every error offers to a scene."""

import abc
from typing import ClassVar

import equinox as eqx

from gearjax.contact import BodyView, GearSize
from gearjax.typing import Array, Float


class AbstractError(eqx.Module):
    """An error of one body. ``kind`` is its name in a configuration."""

    kind: eqx.AbstractClassVar[str]
    body: eqx.AbstractVar[str]
    on_rim: ClassVar[bool] = False
    """Whether it is of single pins or teeth, which not every body has."""

    @abc.abstractmethod
    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        """Change of the gaps, shape (contact,) [m]."""

    def check(self, gear: GearSize | None) -> None:
        """Refuse what cannot be on a gear of that size, if the gear set tells it.

        Raises:
            ParameterError: naming the key, what was given and what would be right.
        """
        del gear

    def proportional(self) -> "AbstractError":
        """The same error by numbers that its gaps are in proportion to, where there are such."""
        return self
