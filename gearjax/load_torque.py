"""Load torque on the output as a function of time."""

import abc
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from gearjax import units
from gearjax.parameters import Named, check_parameters, number
from gearjax.typing import Array, Float, Number, Scalar


class AbstractLoad(eqx.Module):
    """Load torque over time, relative to its size. The size is the ``torque`` argument of an analysis."""

    kind: eqx.AbstractClassVar[str]
    alternates: eqx.AbstractClassVar[bool]
    """Whether the torque changes its sign."""

    @abc.abstractmethod
    def shape(
        self, turns: Float[Array, "..."], time: Float[Array, "..."], orders: Mapping[str, float]
    ) -> Float[Array, "..."]:
        """Torque divided by its size, after a number of turns of the input and at a time [s].

        ``orders`` are the named orders of the system, in cycles per turn of the input.
        """

    @abc.abstractmethod
    def rate(self, input_speed: Scalar, orders: Mapping[str, float]) -> Scalar:
        """Highest angular frequency of the torque [rad/s]; 0 for a constant torque."""


class ConstantLoad(AbstractLoad):
    """Constant torque."""

    kind: ClassVar[str] = "constant"
    alternates: ClassVar[bool] = False

    def shape(
        self, turns: Float[Array, "..."], time: Float[Array, "..."], orders: Mapping[str, float]
    ) -> Float[Array, "..."]:
        return jnp.ones_like(time)

    def rate(self, input_speed: Scalar, orders: Mapping[str, float]) -> Scalar:
        return jnp.zeros_like(input_speed)


class SinusoidalLoad(AbstractLoad):
    """Alternating torque ``T sin(2 pi f t)`` (Wang et al. 2020, figs. 7, 11 and 12).

    Args:
        frequency: frequency f of the torque [Hz], or the name of an order of the system, such as ``"crank"`` or
            ``"mesh"``.
    """

    kind: ClassVar[str] = "sinusoidal"
    alternates: ClassVar[bool] = True
    frequency: Named | Number = number(units.FREQUENCY, at_least=1e-9, at_most=1e9, words=True)

    def __check_init__(self):
        check_parameters(self)

    def shape(
        self, turns: Float[Array, "..."], time: Float[Array, "..."], orders: Mapping[str, float]
    ) -> Float[Array, "..."]:
        if isinstance(self.frequency, Named):
            return jnp.sin(2 * jnp.pi * orders[self.frequency.name] * turns)
        return jnp.sin(2 * jnp.pi * self.frequency * time)

    def rate(self, input_speed: Scalar, orders: Mapping[str, float]) -> Scalar:
        if isinstance(self.frequency, Named):
            return orders[self.frequency.name] * input_speed
        return 2 * jnp.pi * self.frequency


LOADS: tuple[type[AbstractLoad], ...] = (ConstantLoad, SinusoidalLoad)
