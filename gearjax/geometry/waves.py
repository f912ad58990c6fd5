"""A curve that repeats, as a mean and waves."""

import equinox as eqx
import jax.numpy as jnp

from gearjax.typing import Array, Float, Scalar


class Waves(eqx.Module):
    """A curve of an angle that repeats after 2 pi: ``mean + sum_n c_n cos(n psi) + s_n sin(n psi)``.

    Args:
        mean: its mean.
        cosine, sine: of each harmonic, shape (harmonic,).
    """

    mean: Scalar
    cosine: Float[Array, " harmonic"]
    sine: Float[Array, " harmonic"]

    @classmethod
    def of(cls, samples: Float[Array, " n"], harmonics: int) -> "Waves":
        """The waves of evenly spaced samples of one period, its end left out; of more than twice as many samples as
        harmonics."""
        lines = jnp.fft.rfft(samples)[: harmonics + 1] / samples.shape[0]
        return cls(lines[0].real, 2 * lines[1:].real, -2 * lines[1:].imag)

    def at(self, angle: Float[Array, " n"]) -> Float[Array, " n"]:
        """The curve at some angles [rad]."""
        turned = angle[:, None] * jnp.arange(1, self.cosine.shape[0] + 1, dtype=angle.dtype)[None]
        return self.mean + jnp.cos(turned) @ self.cosine + jnp.sin(turned) @ self.sine

    @property
    def reach(self) -> Scalar:
        """A bound on how far it is from its mean."""
        return jnp.hypot(self.cosine, self.sine).sum()
