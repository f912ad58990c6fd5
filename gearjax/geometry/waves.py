"""A periodic curve as a Fourier series."""

import equinox as eqx
import jax.numpy as jnp

from gearjax.typing import Array, Float, Scalar


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
        turned = angle[:, None] * jnp.arange(1, self.cosine.shape[0] + 1, dtype=angle.dtype)[None]
        return self.mean + jnp.cos(turned) @ self.cosine + jnp.sin(turned) @ self.sine

    @property
    def reach(self) -> Scalar:
        """Upper bound of the distance of the curve from its mean."""
        return jnp.hypot(self.cosine, self.sine).sum()
