"""The interface between an error and a scene."""

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
    """Whether it is an error of single pins or teeth, which not every body has."""
    on_flank: ClassVar[bool] = False
    """Whether it is material along the profile or across the face of a tooth, which a design may ask for."""

    @abc.abstractmethod
    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        """Change of the gaps that the error makes, shape (contact,) [m]."""

    def check(self, size: Callable[[], GearSize | None]) -> None:
        """Refuse an error that its gear cannot have.

        Args:
            size: function that returns the sizes of the gear, or ``None`` if the gear set does not give them. It is
                called only by errors that need them.

        Raises:
            ParameterError: a value is wrong; the message names the key, the given value and what would be right.
        """
        del size

    def proportional(self) -> "AbstractError":
        """The same error described by numbers that its gaps are proportional to; without such numbers, itself."""
        return self
