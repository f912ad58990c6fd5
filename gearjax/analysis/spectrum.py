"""Order spectrum: amplitude over cycles per turn."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.metrics import root
from gearjax.checks import SceneError, is_concrete
from gearjax.typing import Array, ArrayLike, Float, Scalar


class Spectrum(eqx.Module):
    """Amplitude spectrum over orders.

    Args:
        order: cycles per turn, shape (m,) [-].
        amplitude: amplitude of the sine at each order, in the unit of the record, shape (m,).
    """

    order: Float[Array, " m"]
    amplitude: Float[Array, " m"]


@arguments.checked(values=arguments.numbers, theta=arguments.numbers, turn=arguments.turn)
def order_spectrum(
    values: ArrayLike, theta: ArrayLike, *, turn: ArrayLike = 2 * math.pi, window: str = "hann"
) -> Spectrum:
    """Order spectrum of a record sampled evenly over the angle, by FFT.

    On whole cycles use ``window="none"``: each order is exact. On any other span ``window="hann"`` reduces leakage. A
    line is then two spacings wide, and its peak may be up to 15 % too low.

    Args:
        values: record, shape (n,).
        theta: input angles, evenly spaced, shape (n,) [rad]. With ``window="none"`` the last sample is one spacing
            before the end of the whole span.
        turn: input angle of the turn to which the orders refer [rad]: ``2 pi`` for a turn of the input,
            ``2 pi / orders["output"]`` for a turn of the output.
        window: ``"none"`` or ``"hann"``.

    Raises:
        SceneError: the window is unknown, the record is too short, or the angles are uneven.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> theta = 2 * jnp.pi * jnp.arange(256.0) / 256
        >>> spectrum = gj.order_spectrum(0.3 * jnp.sin(5 * theta), theta, window="none")
        >>> round(float(spectrum.amplitude[5]), 6)
        0.3
    """
    if window not in ("none", "hann"):
        raise SceneError(f'window = "{window}": valid: none, hann')
    values, theta = jnp.asarray(values), jnp.asarray(theta)
    size = values.shape[0] if values.ndim == 1 else 0
    if size < 4 or theta.shape != values.shape:
        raise SceneError(
            f"a spectrum needs at least 4 samples and as many angles, got shapes {values.shape} and {theta.shape}"
        )
    if is_concrete(theta):
        steps = np.diff(np.asarray(theta, dtype=float))
        if not np.allclose(steps, steps.mean(), rtol=1e-3, atol=0):
            raise SceneError("theta is unevenly spaced: an order spectrum needs even angles")
    return _spectrum(values, theta, jnp.asarray(turn, values.dtype), window)


@eqx.filter_jit
def _spectrum(values: Array, theta: Array, turn: Scalar, window: str) -> Spectrum:
    size = values.shape[0]
    weights = jnp.ones(size, values.dtype)
    if window == "hann":
        weights = 0.5 * (1 - jnp.cos(2 * jnp.pi * jnp.arange(size, dtype=values.dtype) / size))
    centred = values - (weights * values).sum() / weights.sum()
    amplitude = 2 * jnp.abs(jnp.fft.rfft(weights * centred)) / weights.sum()
    if size % 2 == 0:
        amplitude = amplitude.at[-1].divide(2.0)  # the line at half the sampling rate has no mirror line
    spacing = (theta[-1] - theta[0]) / (size - 1)
    order = jnp.arange(amplitude.shape[0], dtype=values.dtype) * (turn / (size * spacing))
    return Spectrum(order, amplitude)


def order_amplitude(
    values: Float[Array, " n"], theta: Float[Array, " n"], order: float, *, first: ArrayLike | None = None
) -> Scalar:
    """Amplitude of one order, which need not be a line of the spectrum; differentiable, with gradient 0 at 0.

    Arguments as for `order_phasor`.
    """
    cosine, sine = order_phasor(values, theta, order, first=first)
    return root(cosine**2 + sine**2)


def order_phasor(
    values: Float[Array, " n"], theta: Float[Array, " n"], order: float, *, first: ArrayLike | None = None
) -> tuple[Scalar, Scalar]:
    """Amplitudes of the cosine and of the sine of one order.

    If the span is a whole number of cycles of the order, all samples have equal weights, so that other whole orders
    have no effect. Any other span is weighted by a Hann window.

    Args:
        values: record, shape (n,).
        theta: input angles, increasing, including both ends of the span, shape (n,) [rad].
        order: cycles per turn of the input.
        first: input angle at which the span begins [rad]; by default the first of theta.
    """
    first = theta[0] if first is None else jnp.asarray(first, theta.dtype)
    span = theta[-1] - first
    turns = order * span / (2 * math.pi)
    whole = (jnp.abs(turns - jnp.round(turns)) < 1e-6 * jnp.maximum(turns, 1.0)) & (turns > 0.5)
    hann = jnp.sin(math.pi * (theta - first) / span) ** 2
    width = jnp.asarray(jnp.gradient(theta))
    width = width.at[jnp.array([0, -1])].multiply(0.5)  # trapezoidal rule: half a spacing at both ends
    weights = width * jnp.where(whole, 1.0, hann) * jnp.where(theta >= first, 1.0, 0.0)
    weights = weights / weights.sum()
    centred = values - (weights * values).sum()
    cosine, sine = ((2 * weights * centred * wave(order * theta)).sum() for wave in (jnp.cos, jnp.sin))
    return cosine, sine
