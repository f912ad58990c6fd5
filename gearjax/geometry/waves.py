"""A periodic curve as a Fourier series."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.parameters import known_beside, with_known
from gearjax.typing import Array, Float, Scalar

FEW = 64  # harmonics up to which each one is evaluated
CELLS = 4  # cells of the table per harmonic, at least
POWERS = {4: 10, 8: 15}  # per bytes of a number; half a cell is pi/4 of the highest wave: pi/4^15 / 15! = 2e-14 of it


class Waves(eqx.Module):
    """A curve with the period 2 pi as a Fourier series, ``mean + sum_n c_n cos(n psi) + s_n sin(n psi)``.

    With many harmonics it is evaluated by Taylor series in the cells of a fine division of the period, which fast
    Fourier transforms give. They are exact to rounding, and cost the same at any number of harmonics.

    Args:
        mean: mean of the curve.
        cosine, sine: amplitudes c_n and s_n of each harmonic, shape (harmonic,).
    """

    mean: Scalar
    cosine: Float[Array, " harmonic"]
    sine: Float[Array, " harmonic"]
    table: Float[Array, "cell power"] | None = known_beside()

    @classmethod
    def of(cls, samples: Float[Array, " n"], harmonics: int) -> "Waves":
        """Fourier series of evenly spaced samples of one period without its end point.

        The number of samples must be more than twice the number of harmonics.
        """
        lines = jnp.fft.rfft(samples)[: harmonics + 1] / samples.shape[0]
        return cls(lines[0].real, 2 * lines[1:].real, -2 * lines[1:].imag)

    @property
    def many(self) -> bool:
        """Whether it has so many harmonics that a table of it pays."""
        return self.cosine.shape[0] > FEW

    def tabulated(self) -> "Waves":
        """The same curve, with its table worked out if it has many harmonics."""
        return with_known(self, table=self._table()) if self.many and self.table is None else self

    def at(self, angle: Float[Array, " n"]) -> Float[Array, " n"]:
        """Values of the curve at some angles [rad]."""
        if not self.many:
            turned = angle[:, None] * jnp.arange(1, self.cosine.shape[0] + 1, dtype=angle.dtype)[None]
            return self.mean + jnp.cos(turned) @ self.cosine + jnp.sin(turned) @ self.sine
        table = self._table() if self.table is None else self.table
        place = angle * (table.shape[0] / (2 * math.pi))
        cell = jax.lax.stop_gradient(jnp.round(place))
        rows, within = table[jnp.mod(cell.astype(int), table.shape[0])], 2 * (place - cell)
        value = rows[:, -1]
        for power in range(table.shape[1] - 2, -1, -1):
            value = value * within + rows[:, power]
        return value

    def _table(self) -> Float[Array, "cell power"]:
        """Taylor series about the middle of each cell, in the distance from it over half a cell."""
        number, dtype = self.cosine.shape[0], self.cosine.dtype
        cells = _evenly_divided(CELLS * number)
        power = np.arange(POWERS[dtype.itemsize])
        half = (np.arange(1, number + 1) * np.pi / cells)[None] ** power[:, None]
        size = jnp.asarray(half / np.array([math.factorial(each) for each in power])[:, None], dtype)
        quarter = power % 4  # powers of i turn a wave by quarters
        real = jnp.stack([self.cosine, self.sine, -self.cosine, -self.sine])[quarter] * size
        imaginary = jnp.stack([-self.sine, self.cosine, self.sine, -self.cosine])[quarter] * size
        mean = jnp.zeros((len(power), 1), dtype).at[0, 0].set(self.mean)
        lines = jnp.concatenate([jax.lax.complex(mean, 0 * mean), jax.lax.complex(real, imaginary) / 2], axis=1)
        return jnp.fft.irfft(lines * cells, cells, axis=1).T

    @property
    def reach(self) -> Scalar:
        """Upper bound of the distance of the curve from its mean."""
        return jnp.hypot(self.cosine, self.sine).sum()


def _evenly_divided(least: int) -> int:
    """Smallest number, not below the given one, that fast Fourier transforms divide well: 2^n or 3 2^n."""
    power = math.ceil(math.log2(least))
    return 3 * 2 ** (power - 2) if 3 * 2 ** (power - 2) >= least else 2**power
