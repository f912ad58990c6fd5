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
    """Helix slope deviation f_Hb across the face, zero in the middle of the face (ISO 1328-1).

    A positive value means more material at the high end of the face, counted along the axis about which the pinion
    turns.

    Args:
        body: gear that carries the error.
        slope: helix slope deviation from one end of the face to the other: one value per tooth, shape (tooth,), or one
            for all [m].
    """

    kind: ClassVar[str] = "helix_slope"
    deviations: ClassVar[tuple[str, ...]] = ("slope",)
    on_rim: ClassVar[bool] = True
    on_flank: ClassVar[bool] = True
    body: str = name()
    slope: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["2 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        return place.seen(-spread("slope", self.slope, view) * _across(self.body, view))


class Crowning(AbstractError):
    """Crowning: material removed towards both ends of the face, ``amount (2 z / b)^2`` (ISO 21771: C_b).

    Here z is the place across the face, counted from its middle, and b is the face width.

    Args:
        body: gear that carries the modification.
        amount: material removed at both ends of the face: one value per tooth, shape (tooth,), or one for all [m].
    """

    kind: ClassVar[str] = "crowning"
    deviations: ClassVar[tuple[str, ...]] = ("amount",)
    on_rim: ClassVar[bool] = True
    on_flank: ClassVar[bool] = True
    body: str = name()
    amount: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["5 um"])

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        return place.seen(spread("amount", self.amount, view) * (2 * _across(self.body, view)) ** 2)


class EndRelief(AbstractError):
    """End relief: material removed towards the ends of the face (ISO 21771: C_bI, C_bII).

    It is ``amount (1 - s / length)^exponent`` at the distance s from an end of the face.

    Args:
        body: gear that carries the modification.
        amount: material removed at the end of the face: one value per tooth, shape (tooth,), or one for all [m].
        length: length across the face over which the relief runs out [m].
        exponent: exponent of the relief, 1 or more.
        end: end of the face that is relieved: ``"both"``, or the ``"low"`` or the ``"high"`` end along the axis about
            which the pinion turns.
    """

    kind: ClassVar[str] = "end_relief"
    deviations: ClassVar[tuple[str, ...]] = ("amount",)
    on_rim: ClassVar[bool] = True
    on_flank: ClassVar[bool] = True
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
        assert width is not None  # `_across` has refused gears without a face width
        ends = {"low": (0.5 + across,), "high": (0.5 - across,), "both": (0.5 + across, 0.5 - across)}[self.end]
        shares = [running_out(from_end * width, self.length, self.exponent) for from_end in ends]
        return place.seen(spread("amount", self.amount, view) * sum(shares[1:], shares[0]))


def _across(body: str, view: BodyView) -> Float[Array, " contact"]:
    """Places of the contacts across the face, from its middle, in face widths [-].

    Raises:
        ParameterError: the body's contacts have no place across the face.
    """
    place = profile_of(body, view)
    if place.across is None or place.width is None:
        raise ParameterError("body", body, "has no contacts at single places across the face, which this error needs")
    return place.across / place.width
