"""The interface between an error and a scene."""

import abc
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import numpy as np

from gearjax.checks import ParameterError, is_concrete
from gearjax.contact import BodyView, GearSize
from gearjax.typing import Array, Float
from gearjax.units import mm

SUSPICIOUS = 0.1 * mm  # a smaller deviation is far below half of any module


class AbstractError(eqx.Module):
    """An error of one body. ``kind`` is its name in a configuration."""

    kind: eqx.AbstractClassVar[str]
    body: eqx.AbstractVar[str]
    on_rim: ClassVar[bool] = False
    """Whether it is an error of single pins or teeth, which not every body has."""
    on_flank: ClassVar[bool] = False
    """Whether it is material along the profile or across the face of a tooth, which a design may ask for."""

    deviations: ClassVar[tuple[str, ...]] = ()
    """Names of the numbers that are deviations of the gear: lengths that are small against its teeth."""

    @abc.abstractmethod
    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        """Change of the gaps that the error makes, shape (contact,) [m]."""

    def check(self, size: Callable[[], GearSize | None]) -> None:
        """Refuse an error that its gear cannot have, such as a deviation of more than half a module.

        Args:
            size: function that returns the sizes of the gear, or ``None`` if the gear set does not give them. It is
                called only for errors that may be wrong.

        Raises:
            ParameterError: a value is wrong; the message names the key, the given value and what would be right.
        """
        for name in self.deviations:
            value = getattr(self, name)
            if not is_concrete(value):
                continue
            largest = float(np.max(np.abs(value), initial=0.0))
            gear = size() if largest > SUSPICIOUS else None
            if gear is None or not is_concrete(tuple(gear)) or largest <= 0.5 * float(gear.module):
                continue
            words = f"must be at most half a module, {0.5 * float(gear.module) / mm:.4g} mm: is its unit right?"
            raise ParameterError(name, f"{'up to ' if np.ndim(value) else ''}{largest / mm:.4g} mm", words)

    def proportional(self) -> "AbstractError":
        """The same error described by numbers that its gaps are proportional to; without such numbers, itself."""
        return self
