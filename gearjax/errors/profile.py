"""Errors and modifications along the profile of involute teeth."""

import abc
from typing import ClassVar

import jax.numpy as jnp

from gearjax import units
from gearjax.checks import ParameterError
from gearjax.contact import BodyView, ProfilePlace
from gearjax.errors.base import AbstractError
from gearjax.errors.rim import spread
from gearjax.parameters import check_parameters, count, length, name, series
from gearjax.typing import Array, Float, Number, Scalar


class AbstractRelief(AbstractError):
    """Material removed towards one end of the profile; a subclass says from where on lengths of roll count."""

    on_rim: ClassVar[bool] = True
    body: str = name()
    amount: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["2 um"])
    length: Number = length(at_least=1e-9, at_most=1.0, example="0.5 mm")
    exponent: int = count(default=1, at_most=10)

    def __check_init__(self):
        check_parameters(self)

    @staticmethod
    @abc.abstractmethod
    def from_end(place: ProfilePlace) -> Float[Array, " contact"]:
        """Length of roll from the end to each contact, shape (contact,) [m]."""

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        share = running_out(self.from_end(place), self.length, self.exponent)
        return place.seen(spread("amount", self.amount, view) * share)


class TipRelief(AbstractRelief):
    """Material removed towards the tip, ``amount (1 - s / length)^exponent`` with the length of roll s from the tip
    (ISO 21771: C_a over L_Ca; 1 is a straight line, 2 a parabola).

    Args:
        body: gear that carries it.
        amount: at the tip, shape (tooth,), or one value for all [m].
        length: of roll along the path of contact over which it runs out [m].
        exponent: 1 or more.
    """

    kind: ClassVar[str] = "tip_relief"

    @staticmethod
    def from_end(place: ProfilePlace) -> Float[Array, " contact"]:
        return place.to_tip


class RootRelief(AbstractRelief):
    """Material removed towards the root, ``amount (1 - s / length)^exponent`` with the length of roll s from where the
    path of contact ends there (ISO 21771: C_f over L_Cf; 1 is a straight line, 2 a parabola).

    Args:
        body: gear that carries it.
        amount: at the end of the path of contact, shape (tooth,), or one value for all [m].
        length: of roll along the path of contact over which it runs out [m].
        exponent: 1 or more.
    """

    kind: ClassVar[str] = "root_relief"

    @staticmethod
    def from_end(place: ProfilePlace) -> Float[Array, " contact"]:
        return place.length - place.to_tip


class ProfileSlope(AbstractError):
    """Slope deviation of the profile f_Ha over the part that may touch: positive where the tip has more material, the
    root less; nothing in the middle (ISO 1328-1).

    Args:
        body: gear that carries it.
        slope: from one end to the other, shape (tooth,), or one value for all [m].
    """

    kind: ClassVar[str] = "profile_slope"
    on_rim: ClassVar[bool] = True
    body: str = name()
    slope: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["2 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        return place.seen(spread("slope", self.slope, view) * (place.to_tip / place.length - 0.5))


class ProfileForm(AbstractError):
    """Form deviation of the profile, a wave along the part that may touch: ``amplitude cos(2 pi waves s / length)``
    with the length of roll s from the tip, material added where positive (ISO 1328-1: half of f_fa).

    Args:
        body: gear that carries it.
        amplitude: shape (tooth,), or one value for all [m].
        waves: along the profile.
    """

    kind: ClassVar[str] = "profile_form"
    on_rim: ClassVar[bool] = True
    body: str = name()
    amplitude: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["1 um"])
    waves: int = count(default=1, at_most=100)

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        wave = jnp.cos(2 * jnp.pi * self.waves * place.to_tip / place.length)
        return place.seen(-spread("amplitude", self.amplitude, view) * wave)


def running_out(distance: Array, length: Scalar, exponent: int) -> Array:
    """Share of a relief at distances from where it is full, any shape [m]: ``(1 - distance / length)^exponent``."""
    return jnp.clip(1 - distance / length, 0.0, 1.0) ** exponent


def profile_of(body: str, view: BodyView) -> ProfilePlace:
    """Where along its profile the contacts of a body are.

    Raises:
        ParameterError: it has no such profile.
    """
    if view.flank is None:
        raise ParameterError("body", body, "has no involute profile to carry this error")
    return view.flank
