"""Checks of a ratio function of one's own: whether it is one, and whether its pitch curves close."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.geometry.noncircular import AbstractRatio
from gearjax.typing import Array

PLACES = 64  # angles over one lobe at which a function is looked at, at even steps and at others
ROUNDED = 100.0  # spacings of the dtype that a difference by rounding has at most
SAME = 1e-6  # difference of ratios and of angles that rounding, or a short series, may cause [-], [rad]


def shape_fault(ratio: AbstractRatio) -> str | None:
    """What prevents a function from being evaluated, in words; ``None`` if nothing does."""
    angles = jax.ShapeDtypeStruct((2, 3), jnp.result_type(float))
    for function, number in ((ratio.driven_angle, 1), (ratio.rates, 3)):
        try:
            given = jax.tree.leaves(jax.eval_shape(function, angles))
        except (TypeError, ValueError, jax.errors.JAXTypeError) as fault:
            words = str(fault).partition("\n")[0][:120]
            return f"driven_angle must be made of functions of jax.numpy, for angles of any shape: {words}"
        right = [each.shape == angles.shape and jnp.issubdtype(each.dtype, jnp.floating) for each in given]
        if right != [True] * number:
            return "driven_angle must return real numbers, an array of the shape of its angles, and rates three of them"
    return None


def sampled(ratio: AbstractRatio) -> tuple[Array, ...]:
    """Numbers of a function that show its faults: angles at the ends of a lobe, and rates in it and a lobe later."""
    lobe = 2 * jnp.pi / ratio.driver_lobes
    places = lobe * np.modf(np.arange(PLACES) * (np.sqrt(5) - 1) / 2)[0]
    places = np.concatenate([places, lobe * np.arange(PLACES) / PLACES])
    ends = ratio.driven_angle(jnp.asarray([0.0, 1.0]) * lobe)
    slope = jax.jvp(ratio.driven_angle, (jnp.asarray(places),), (jnp.ones(len(places)),))[1]
    here, later = ratio.rates(jnp.asarray(places))[0], ratio.rates(jnp.asarray(places) + lobe)[0]
    return ends, slope, here, later, jnp.asarray(places)


def faults(ratio: AbstractRatio, lobes: tuple[int, int], numbers: tuple[Array, ...]) -> Iterator[str]:
    """What is wrong with a function, in words.

    Args:
        ratio: the function.
        lobes: lobes of driver and driven gear of the gear set.
        numbers: its numbers (`sampled`).
    """
    own = ratio.driver_lobes, ratio.driven_lobes
    same = max(SAME, ROUNDED * float(jnp.finfo(numbers[0].dtype).eps))
    if own != lobes:
        yield f"has {own[0]} and {own[1]} lobes, the gear set has {lobes[0]} and {lobes[1]}"
        return
    (begin, end), slope, here, later, places = (np.asarray(each) for each in numbers)
    if not np.isfinite(np.concatenate([slope, here, later, [begin, end]])).all():
        yield "is not finite everywhere"
        return
    if abs(begin) > same:
        yield f"driven_angle(0) is {begin:.6g} rad, must be 0: subtract it"
    lowest = int(here.argmin())
    if here[lowest] <= 0:
        yield f"the ratio is {here[lowest]:.4g} at {np.degrees(places[lowest]):.4g} deg, must be above 0 everywhere"
    right = 2 * np.pi / own[1]
    if abs(end - begin - right) > same:
        words = f"in one lobe of the driver the driven gear turns by {end - begin:.8g} rad, must be 2 pi / driven_lobes"
        yield f"the driven gear's pitch curve stays open: {words} = {right:.8g}"
    away = np.abs(later - here)
    if away.max() > same * np.abs(here).max():
        degrees = np.degrees(places[away.argmax()])
        yield f"the ratio at {degrees:.4g} deg differs from that one lobe later by {away.max():.3g}, must repeat"
    off = np.abs(slope - here)
    if off.max() > same * np.abs(here).max():
        yield f"rates gives another ratio than the slope of driven_angle, by {off.max():.3g}"
