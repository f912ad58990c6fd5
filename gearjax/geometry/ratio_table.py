"""Checks of a table of ratios over one lobe: whether its curve closes, is closed twice, or has a corner."""

from collections.abc import Iterator

import numpy as np

SCALES = 1e-3  # relative error of the mean ratio that is scaled away
SAME = 1e-6  # relative difference of a first and a last value that are the same point
SMOOTHER = 0.5  # share to which the largest fourth difference falls if a repeated value is left out
STANDS_OUT = 0.8  # share of the largest second difference by which one may deviate from the mean of its two neighbours
BENT = 0.1  # in a short table: smallest change of slope that counts, in largest values per radian: rounding makes less
LONG, LONGER = 32, 64  # fewest values of a table whose straight, or smooth, part can be told from a corner
BENDS = 0.5  # in a long table: share of the second differences nearby that is not in line with its neighbours
APART = {LONG: 300.0, LONGER: 10.0}  # and how much larger that is than further away, on one side at least
TURNED = 0.01  # and smallest change of slope that counts, in largest values per radian
ROUNDED = 4.5  # and size over the last decimal of rounded values, which alone make up to 4
NEAR, FAR = 4, 8  # values between which "further away" is
FEWEST_DECIMALS, MOST_DECIMALS = 3, 10


def faults(values: np.ndarray, driver_lobes: int, driven_lobes: int) -> Iterator[str]:
    """What is wrong with the values at even steps over one lobe, shape (value,) [-], in words."""
    if _repeats_its_end(values):
        yield "its first and its last value are the same point of the lobe: leave the last value out"
        return
    right = driver_lobes / driven_lobes
    scale = right / float(values.mean())
    if abs(scale - 1) > SCALES:
        words = f"the driven gear's pitch curve stays open: the mean is {values.mean():.6g}, must be {right:.6g}"
        yield f"{words} (driver_lobes / driven_lobes): multiply by {scale:.6g}"
        return
    step = 2 * np.pi / (driver_lobes * len(values))
    place = _corner(values, step) if len(values) >= LONG else _rough_corner(values, step)
    if place is not None:
        degrees = 360 / driver_lobes * place / len(values)
        yield f"has a corner or a jump near {degrees:.4g} deg, or too few values: its slope must change gradually"


def _second(values: np.ndarray) -> np.ndarray:
    """Second differences around each value of the closed table."""
    return np.roll(values, 1) - 2 * values + np.roll(values, -1)


def _repeats_its_end(values: np.ndarray) -> bool:
    """Whether the last value is the first one again; a symmetric table may have equal values there, but is smooth."""
    if abs(values[0] - values[-1]) > SAME * values.max():
        return False
    with_it, without = (np.abs(_second(_second(each))).max() for each in (values, values[:-1]))
    return bool(without < SMOOTHER * with_it)


def _rough_corner(values: np.ndarray, step: float) -> int | None:
    """Place of a corner at one of a few values: its second difference stands out from those of its neighbours."""
    bends = _second(values)
    apart = np.abs(bends - 0.5 * (np.roll(bends, 1) + np.roll(bends, -1)))
    largest = np.abs(bends).max()
    if largest <= max(BENT * step * values.max(), ROUNDED * _last_decimal(values)):
        return None
    return int(apart.argmax()) if apart.max() > STANDS_OUT * largest else None


def _corner(values: np.ndarray, step: float) -> float | None:
    """Place of a corner of many values, at a value or between two, counted in values; ``None`` without.

    The change of slope at a value, or over two neighbouring values, is compared with those beside it. Where the curve
    is smooth they are nearly in line, and not less so than a few values further away.
    """
    bends = _second(values)
    least = max(TURNED * step * values.max(), ROUNDED * _last_decimal(values))
    clearest, place = 0.0, None
    apart = APART[LONGER if len(values) >= LONGER else LONG]
    for between, turned in ((0.0, bends), (0.5, bends + np.roll(bends, -1))):
        off = (1 + 2 * between) * np.abs(turned - 0.5 * (np.roll(turned, 1) + np.roll(turned, -1)))
        nearby = np.max([np.abs(np.roll(turned, shift)) for shift in range(-2, 3)], axis=0)
        before, after = (
            np.max([np.roll(off, sign * shift) for shift in range(NEAR, FAR + 1)], axis=0) for sign in (1, -1)
        )
        share = np.where(
            (off > apart * np.minimum(before, after)) & (off > least), off / np.maximum(nearby, least), 0.0
        )
        if share.max() > (1.2 * clearest if place is not None else BENDS):  # a corner at a value bends both its sides
            clearest, place = share.max(), int(share.argmax()) + between
    return place


def _last_decimal(values: np.ndarray) -> float:
    """Size of the last decimal of rounded values, of three and more; that of the most decimals for others."""
    for decimals in range(FEWEST_DECIMALS, MOST_DECIMALS):
        if np.abs(np.round(values, decimals) - values).max() < 10.0 ** -(decimals + 4):
            return 10.0**-decimals
    return 10.0**-MOST_DECIMALS
