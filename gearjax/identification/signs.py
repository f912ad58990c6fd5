"""Signs of a recording that are against the conventions: of the torque, and of the transmission error."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gearjax.checks import GearjaxError
from gearjax.identification.fit import Fit
from gearjax.identification.measurement import Measurement

MUCH_BETTER = 0.5  # share of the sum of squares below which another sign is considered
CLEAR = 0.3  # share of the residual below which another sign is right, although not only noise is left


def check_signs(
    fit: Fit, records: Sequence[Measurement], noisy: float, refit: Callable[[list[Measurement]], Fit | None]
) -> None:
    """Refuse recordings that another sign explains much better: all of them are tried at once, and each alone.

    Args:
        fit: the fit of the recordings as they are.
        records: the recordings.
        noisy: standard deviation of a residual that may be noise alone [arcmin].
        refit: function that fits other recordings; it returns ``None`` for recordings that the scene cannot have.

    Raises:
        GearjaxError: says which sign is wrong, and how much better the other sign is.
    """
    found: list[tuple[float, str, str]] = []
    for what, right, other in other_signs(records):
        again = refit(other)
        if again is not None and again.cost < MUCH_BETTER * fit.cost:
            found.append((again.sigma, what, right))
    sigma, what, right = min(found, default=(np.inf, "", ""))
    if sigma < max(noisy, CLEAR * fit.sigma):
        raise GearjaxError(
            f"{what} seems to have the wrong sign: with the other sign the residual falls from {fit.sigma:.3g} to "
            f"{sigma:.3g} arcmin ({right}; give sign = -1 in the TOML file)"
        )


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
