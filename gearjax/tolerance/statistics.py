"""Estimates from samples, with intervals of 95 % confidence.

The interval of a share is Wilson's (1927). Latin hypercube and Sobol samples are not independent: the spread between
their independent designs gives the standard error of a share, and from this an effective number of samples. The
interval of a quantile ends at the quantiles of the ends of the interval of its share (Woodruff 1952).
"""

import math
from typing import NamedTuple

import numpy as np

CONFIDENCE = 0.95


class Estimate(NamedTuple):
    """A value with its interval of 95 % confidence, whose ends are infinite if there are too few samples."""

    value: float
    low: float
    high: float


def share(good: np.ndarray, sizes: np.ndarray) -> Estimate:
    """Share of the population that is good.

    Args:
        good: whether each sample is good, shape (n,).
        sizes: numbers of samples of the independent designs, adding to n (one design: independent samples).
    """
    value = float(np.mean(good))
    number, multiple = _effective(good, sizes, value)
    return Estimate(value, *wilson(value, number, multiple))


def wilson(value: float, number: float, multiple: float) -> tuple[float, float]:
    """Wilson's interval of a share.

    Args:
        value: the share found.
        number: number of samples, or the effective number.
        multiple: half of the interval's width, in standard deviations.
    """
    square = multiple * multiple / number
    middle = (value + 0.5 * square) / (1 + square)
    half = multiple / (1 + square) * math.sqrt(value * (1 - value) / number + 0.25 * square / number)
    return max(0.0, middle - half), min(1.0, middle + half)


def _effective(good: np.ndarray, sizes: np.ndarray, value: float) -> tuple[float, float]:
    """Effective number of samples, and half of the interval's width in standard deviations."""
    from scipy import special

    if len(sizes) < 2:
        return float(len(good)), float(special.ndtri(0.5 + CONFIDENCE / 2))
    means = np.add.reduceat(good.astype(float), np.concatenate([[0], np.cumsum(sizes)[:-1]])) / sizes
    square = float(((means - value) ** 2 * sizes).sum() / (sizes.sum() * (len(sizes) - 1)))
    number = len(good) if square == 0 else value * (1 - value) / square
    return float(max(number, 1.0)), float(special.stdtrit(len(sizes) - 1, 0.5 + CONFIDENCE / 2))


def quantile(values: np.ndarray, level: float, sizes: np.ndarray) -> Estimate:
    """Value below which a share of the population lies; nan if there are no values.

    Args:
        values: finite samples in the order of their designs, shape (n,).
        level: the share, between 0 and 1.
        sizes: as for `share`.
    """
    if not len(values):
        return Estimate(math.nan, math.nan, math.nan)
    ordered = np.sort(values)
    value = _interpolated(ordered, level)
    below = values <= value
    number, multiple = _effective(below, sizes, float(np.mean(below)))
    low, high = wilson(level, number, multiple)
    return Estimate(value, _end(ordered, low, -math.inf), _end(ordered, high, math.inf))


def _end(ordered: np.ndarray, level: float, beyond: float) -> float:
    """End of an interval; infinite if it is beyond the samples."""
    place = _place(len(ordered), level)
    return _interpolated(ordered, level) if 0 <= place <= len(ordered) - 1 else beyond


def _place(number: int, level: float) -> float:
    """Place of a quantile among ordered samples, counted from 0."""
    return level * (number + 1 / 3) + 1 / 3 - 1


def _interpolated(ordered: np.ndarray, level: float) -> float:
    """Quantile of ordered samples, linear between them (Hyndman and Fan 1996, type 8: unbiased for its median)."""
    number = len(ordered)
    place = _place(number, level)
    below = int(np.clip(math.floor(place), 0, number - 1))
    above = min(below + 1, number - 1)
    part = float(np.clip(place - below, 0.0, 1.0))
    return float(ordered[below] * (1 - part) + ordered[above] * part)
