"""Signs of a recording that are against the conventions: of the torque, and of the transmission error."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from gearjax.checks import GearjaxError
from gearjax.identification.measurement import Measurement
from gearjax.units import um

MUCH_BETTER = 0.5  # share of the sum of squares below which another sign is considered
CLEAR = 0.3  # share of the residual below which another sign is right, although not only noise is left
JAMMED = 20 * um  # overlap of flanks that is no error of an estimate of zero backlash
AS_GOOD, SMALLER = 1.2, 0.1  # another sign is right too if it explains about as much by errors that are so much smaller


class Explanation(NamedTuple):
    """How recordings are explained, by the smallest errors that do so.

    Args:
        cost: weighted sum of squares of the rows [arcmin^2].
        sigma: standard deviation of a row [arcmin].
        errors: size of the errors [m].
        overlap: by how much flanks would have to overlap, minus the initial backlash; zero if it is positive [m].
    """

    cost: float
    sigma: float
    errors: float
    overlap: float


def check_signs(
    own: Explanation,
    records: Sequence[Measurement],
    noisy: float,
    refit: Callable[[list[Measurement]], Explanation | None],
) -> None:
    """Refuse recordings that another sign explains much better, or as well by far smaller errors or without overlap.

    All recordings are tried at once, and each alone.

    Args:
        own: explanation of the recordings as they are.
        records: the recordings.
        noisy: standard deviation of a residual that may be noise alone [arcmin].
        refit: function that explains other recordings; it returns ``None`` for recordings that the scene cannot have.

    Raises:
        GearjaxError: says which sign is wrong, and how much better the other sign is.
    """
    found: list[tuple[float, str, str]] = []
    for what, right, other in other_signs(records):
        again = refit(other)
        if again is None:
            continue
        if again.cost < MUCH_BETTER * own.cost:
            words = f"the residual falls from {own.sigma:.3g} to {again.sigma:.3g} arcmin"
        elif again.cost > AS_GOOD * own.cost:
            continue
        elif again.errors < SMALLER * own.errors:
            words = f"errors fall from {own.errors / um:.3g} to {again.errors / um:.3g} um, and explain as much"
        elif own.overlap > JAMMED and again.overlap == 0:
            words = f"flanks need not overlap by {own.overlap / um:.3g} um, and errors explain as much"
        else:
            continue
        found.append((again.sigma, f"{what} seems to have the wrong sign: with the other sign {words}", right))
    sigma, words, right = min(found, default=(np.inf, "", ""))
    if sigma < max(noisy, CLEAR * own.sigma):
        zeroed = "; or the encoders were zeroed anew between recordings: give a larger offset_spread"
        again = zeroed if len(records) > 1 else ""
        if sigma > noisy:  # neither sign explains the recordings
            again += "; or the unit of a column is wrong"
        raise GearjaxError(f"{words} ({right}; give sign = -1 in the TOML file{again})")


def other_signs(records: Sequence[Measurement]) -> Iterator[tuple[str, str, list[Measurement]]]:
    """What may have the wrong sign, what is right, and the recordings with the other sign."""
    right = "a positive torque resists the output"
    turned = [dataclasses.replace(record, torque=-record.loads) for record in records]
    yield "the torque", right, turned
    if len(records) > 1:
        for i, (record, other) in enumerate(zip(records, turned, strict=True)):
            if record.is_loaded:
                yield f"the torque of {record.name}", right, [*records[:i], other, *records[i + 1 :]]
    if all(record.te is not None for record in records):
        mirrored = [dataclasses.replace(record, te=-record.te) for record in records]
        yield "te", "it is the angle of the output minus the ideal one", mirrored
        reversed_way = [dataclasses.replace(record, theta=-record.theta) for record in records]
        yield "the input angle", "it is that of the scene's input", reversed_way
