"""Errors and modifications across the face of involute teeth (ISO 21771, ISO 1328-1)."""

from typing import ClassVar

from gearjax import units
from gearjax.checks import ParameterError
from gearjax.contact import BodyView
from gearjax.errors.base import AbstractError
from gearjax.errors.profile import profile_of, running_out
from gearjax.errors.rim import spread
from gearjax.parameters import check_parameters, count, length, name, series
from gearjax.typing import Array, Float, Number

SIDES = ("both", "low", "high")


class HelixSlope(AbstractError):
    """Slope deviation of the helix f_Hb across the face: positive where the tooth has more material at its high end,
    along the axis about which the pinion turns; nothing in the middle (ISO 1328-1).

    Args:
        body: gear that carries it.
        slope: from one end of the face to the other, shape (tooth,), or one value for all [m].
    """

    kind: ClassVar[str] = "helix_slope"
    on_rim: ClassVar[bool] = True
    body: str = name()
    slope: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["2 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        return place.seen(-spread("slope", self.slope, view) * _across(self.body, view))


class Crowning(AbstractError):
    """Material removed towards both ends of the face, ``amount (2 z / b)^2`` with the place z from its middle (ISO
    21771: C_b).

    Args:
        body: gear that carries it.
        amount: at the ends, shape (tooth,), or one value for all [m].
    """

    kind: ClassVar[str] = "crowning"
    on_rim: ClassVar[bool] = True
    body: str = name()
    amount: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["5 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        return place.seen(spread("amount", self.amount, view) * (2 * _across(self.body, view)) ** 2)


class EndRelief(AbstractError):
    """Material removed towards the ends of the face, ``amount (1 - s / length)^exponent`` with the distance s from an
    end (ISO 21771: C_bI, C_bII).

    Args:
        body: gear that carries it.
        amount: at the end, shape (tooth,), or one value for all [m].
        length: across the face over which it runs out [m].
        exponent: 1 or more.
        end: ``"both"``, or the ``"low"`` or the ``"high"`` one along the axis about which the pinion turns.
    """

    kind: ClassVar[str] = "end_relief"
    on_rim: ClassVar[bool] = True
    body: str = name()
    amount: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["5 um"])
    length: Number = length(at_least=1e-9, at_most=10.0, example="5 mm")
    exponent: int = count(default=1, at_most=10)
    end: str = name(default="both", names=SIDES)

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        across, width = _across(self.body, view), place.width
        assert width is not None  # the gears tell of their face
        ends = {"low": (0.5 + across,), "high": (0.5 - across,), "both": (0.5 + across, 0.5 - across)}[self.end]
        shares = [running_out(from_end * width, self.length, self.exponent) for from_end in ends]
        return place.seen(spread("amount", self.amount, view) * sum(shares[1:], shares[0]))


def _across(body: str, view: BodyView) -> Float[Array, " contact"]:
    """Places across the face from its middle, parts of its width.

    Raises:
        ParameterError: the body's contacts have no place across the face.
    """
    place = profile_of(body, view)
    if place.across is None or place.width is None:
        raise ParameterError("body", body, "has contacts over all of its face, which cannot show this error")
    return place.across / place.width
