"""Signs of a recording that are against the conventions: of the torque, and of the transmission error."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gearjax.checks import GearjaxError
from gearjax.identification.fit import Fit
from gearjax.identification.measurement import Measurement
from gearjax.units import um

MUCH_BETTER = 0.5  # share of the sum of squares below which another sign is considered
CLEAR = 0.3  # share of the residual below which another sign is right, although not only noise is left
AS_GOOD, SMALLER = 1.2, 0.1  # another sign is right too if it explains about as much by errors that are so much smaller


def check_signs(
    fit: Fit,
    scales: np.ndarray,
    records: Sequence[Measurement],
    noisy: float,
    refit: Callable[[list[Measurement]], Fit | None],
) -> None:
    """Refuse recordings that another sign explains much better, or as well by far smaller errors.

    All recordings are tried at once, and each alone.

    Args:
        fit: the fit of the recordings as they are.
        scales: metres per unit of each number of the fit, zero for other numbers than errors, shape (unknown,).
        records: the recordings.
        noisy: standard deviation of a residual that may be noise alone [arcmin].
        refit: function that fits other recordings; it returns ``None`` for recordings that the scene cannot have.

    Raises:
        GearjaxError: says which sign is wrong, and how much better the other sign is.
    """
    found: list[tuple[float, str, str]] = []
    errors = _size_of_errors(fit, scales)
    for what, right, other in other_signs(records):
        again = refit(other)
        if again is None:
            continue
        if again.cost < MUCH_BETTER * fit.cost:
            words = f"the residual falls from {fit.sigma:.3g} to {again.sigma:.3g} arcmin"
        elif again.cost < AS_GOOD * fit.cost and (size := _size_of_errors(again, scales)) < SMALLER * errors:
            words = f"errors fall from {errors / um:.3g} to {size / um:.3g} um, and explain as much"
        else:
            continue
        found.append((again.sigma, f"{what} seems to have the wrong sign: with the other sign {words}", right))
    sigma, words, right = min(found, default=(np.inf, "", ""))
    if sigma < max(noisy, CLEAR * fit.sigma):
        zeroed = "; or the encoders were zeroed anew between recordings: give a larger offset_spread"
        again = zeroed if len(records) > 1 else ""
        if sigma > noisy:  # neither sign explains the recordings
            again += "; or the unit of a column is wrong"
        raise GearjaxError(f"{words} ({right}; give sign = -1 in the TOML file{again})")


def _size_of_errors(fit: Fit, scales: np.ndarray) -> float:
    return float(np.linalg.norm(scales * fit.values[: len(scales)]))


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
