"""A periodic curve as a Fourier series."""

import math

import equinox as eqx
import jax.numpy as jnp

from gearjax.typing import Array, Float, Scalar

FEW = 64  # harmonics up to which each one is evaluated


class Waves(eqx.Module):
    """A curve with the period 2 pi as a Fourier series, ``mean + sum_n c_n cos(n psi) + s_n sin(n psi)``.

    Args:
        mean: mean of the curve.
        cosine, sine: amplitudes c_n and s_n of each harmonic, shape (harmonic,).
    """

    mean: Scalar
    cosine: Float[Array, " harmonic"]
    sine: Float[Array, " harmonic"]

    @classmethod
    def of(cls, samples: Float[Array, " n"], harmonics: int) -> "Waves":
        """Fourier series of evenly spaced samples of one period without its end point.

        The number of samples must be more than twice the number of harmonics.
        """
        lines = jnp.fft.rfft(samples)[: harmonics + 1] / samples.shape[0]
        return cls(lines[0].real, 2 * lines[1:].real, -2 * lines[1:].imag)

    def at(self, angle: Float[Array, " n"]) -> Float[Array, " n"]:
        """Values of the curve at some angles [rad]."""
        number = self.cosine.shape[0]
        if number <= FEW:
            turned = angle[:, None] * jnp.arange(1, number + 1, dtype=angle.dtype)[None]
            return self.mean + jnp.cos(turned) @ self.cosine + jnp.sin(turned) @ self.sine
        # exp(i (a + b m) psi) is a product of two waves: of n harmonics there are two times the root of n
        each = math.isqrt(number - 1) + 1
        whole = jnp.zeros(each * each, angle.dtype)
        cosine, sine = (whole.at[:number].set(part).reshape(each, each) for part in (self.cosine, self.sine))
        order = jnp.arange(each, dtype=angle.dtype)
        fine, coarse = angle[:, None] * (order + 1)[None], angle[:, None] * (each * order)[None]
        c, s = jnp.cos(fine), jnp.sin(fine)
        along, across = c @ cosine.T + s @ sine.T, c @ sine.T - s @ cosine.T
        return self.mean + (jnp.cos(coarse) * along + jnp.sin(coarse) * across).sum(axis=1)

    @property
    def reach(self) -> Scalar:
        """Upper bound of the distance of the curve from its mean."""
        return jnp.hypot(self.cosine, self.sine).sum()
