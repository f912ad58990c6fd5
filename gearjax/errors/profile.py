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
    """Material removed towards one end of the profile; a subclass defines this end."""

    on_rim: ClassVar[bool] = True
    on_flank: ClassVar[bool] = True
    body: str = name()
    amount: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["2 um"])
    length: Number = length(at_least=1e-9, at_most=1.0, example="0.5 mm")
    exponent: int = count(default=1, at_most=10)

    def __check_init__(self):
        check_parameters(self)

    @staticmethod
    @abc.abstractmethod
    def from_end(place: ProfilePlace) -> Float[Array, " contact"]:
        """Length of roll from that end of the profile to each contact, shape (contact,) [m]."""

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        share = running_out(self.from_end(place), self.length, self.exponent)
        return place.seen(spread("amount", self.amount, view) * share)


class TipRelief(AbstractRelief):
    """Tip relief: material removed towards the tip, ``amount (1 - s / length)^exponent`` (ISO 21771: C_a over L_Ca).

    Here s is the length of roll from the tip.

    Args:
        body: gear that carries the modification.
        amount: material removed at the tip: one value per tooth, shape (tooth,), or one for all [m].
        length: length of roll along the path of contact over which the relief runs out [m].
        exponent: exponent of the relief, 1 or more: 1 is a straight line, 2 a parabola.
    """

    kind: ClassVar[str] = "tip_relief"
    deviations: ClassVar[tuple[str, ...]] = ("amount",)

    @staticmethod
    def from_end(place: ProfilePlace) -> Float[Array, " contact"]:
        return place.to_tip


class RootRelief(AbstractRelief):
    """Root relief: material removed towards the root, ``amount (1 - s / length)^exponent`` (ISO 21771: C_f over L_Cf).

    Here s is the length of roll from the end of the path of contact at the root.

    Args:
        body: gear that carries the modification.
        amount: material removed at the end of the path of contact: one value per tooth, shape (tooth,), or one for all
            [m].
        length: length of roll along the path of contact over which the relief runs out [m].
        exponent: exponent of the relief, 1 or more: 1 is a straight line, 2 a parabola.
    """

    kind: ClassVar[str] = "root_relief"
    deviations: ClassVar[tuple[str, ...]] = ("amount",)

    @staticmethod
    def from_end(place: ProfilePlace) -> Float[Array, " contact"]:
        return place.length - place.to_tip


class ProfileSlope(AbstractError):
    """Profile slope deviation f_Ha over the part of the profile that may touch (ISO 1328-1).

    It is zero in the middle of that part; a positive value means more material at the tip and less at the root.

    Args:
        body: gear that carries the error.
        slope: profile slope deviation from one end of the profile to the other: one value per tooth, shape (tooth,), or
            one for all [m].
    """

    kind: ClassVar[str] = "profile_slope"
    deviations: ClassVar[tuple[str, ...]] = ("slope",)
    on_rim: ClassVar[bool] = True
    on_flank: ClassVar[bool] = True
    body: str = name()
    slope: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["2 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        return place.seen(spread("slope", self.slope, view) * (place.to_tip / place.length - 0.5))


class ProfileForm(AbstractError):
    """Profile form deviation: a wave along the part of the profile that may touch (ISO 1328-1).

    It is ``amplitude cos(2 pi waves s / length)`` at the length of roll s from the tip; a positive value means more
    material. The length is that of the part that may touch, and the amplitude is half of f_fa.

    Args:
        body: gear that carries the error.
        amplitude: amplitude of the wave: one value per tooth, shape (tooth,), or one for all [m].
        waves: number of waves along the profile.
    """

    kind: ClassVar[str] = "profile_form"
    deviations: ClassVar[tuple[str, ...]] = ("amplitude",)
    on_rim: ClassVar[bool] = True
    on_flank: ClassVar[bool] = True
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
    """Share of a relief at distances from its deepest point, ``(1 - distance / length)^exponent`` [-].

    The distances [m] may have any shape; the share is zero beyond the length.
    """
    return jnp.clip(1 - distance / length, 0.0, 1.0) ** exponent


def profile_of(body: str, view: BodyView) -> ProfilePlace:
    """Places of the contacts along the involute profile of a body.

    Raises:
        ParameterError: the body has no involute profile.
    """
    if view.flank is None:
        raise ParameterError("body", body, "has no involute profile to carry this error")
    return view.flank
