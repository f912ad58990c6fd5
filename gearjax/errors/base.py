"""What every error offers to a scene."""

import abc
from collections.abc import Callable
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

    def check(self, size: Callable[[], GearSize | None]) -> None:
        """Refuse what cannot be on its gear.

        Args:
            size: gives that of the gear, if the gear set tells it; worked out for errors that ask.

        Raises:
            ParameterError: naming the key, what was given and what would be right.
        """
        del size

    def proportional(self) -> "AbstractError":
        """The same error by numbers that its gaps are in proportion to, where there are such."""
        return self
