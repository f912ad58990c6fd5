"""Mesh stiffness as a Fourier series of the mesh phase."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, is_concrete
from gearjax.compliance.base import AbstractCompliance
from gearjax.parameters import check_parameters, number, series
from gearjax.typing import Array, Float, Number, Scalar


class HarmonicStiffness(AbstractCompliance):
    """Stiffness of one pair, ``k = mean (1 + sum_n a_n cos(n psi + phase_n))`` (Wang et al. 2020, eq. 20).

    The contacts across the face of a pair, such as its slices, share the stiffness of the pair evenly.

    Args:
        mean: mean stiffness of one pair along the line of action [N/m].
        relative_amplitudes: amplitudes a_n of the harmonics of the mesh frequency, as shares of the mean, shape
            (harmonic,) [-]; empty for a constant stiffness.
        phases: phase of each harmonic, shape (harmonic,) [rad].

    Raises:
        ParameterError: the lists differ in length, or the stiffness becomes negative.
    """

    kind: ClassVar[str] = "harmonic_stiffness"
    mean: Number = number(units.STIFFNESS, at_least=1e-3, at_most=1e15)
    relative_amplitudes: Number = series(units.RATIO, at_least=-10.0, at_most=10.0)
    phases: Number = series(units.ANGLE, at_least=-1e6, at_most=1e6)

    def __check_init__(self):
        check_parameters(self)
        if self.phases.shape != self.relative_amplitudes.shape:
            raise ParameterError(
                "phases",
                f"{self.phases.size} phase(s)",
                f"needs one per relative amplitude, {self.relative_amplitudes.size}",
            )
        if is_concrete((self.relative_amplitudes, self.phases)) and self._lowest() <= 0:
            raise ParameterError(
                "relative_amplitudes",
                f"{[float(a) for a in self.relative_amplitudes.ravel()]}",
                f"the stiffness becomes negative (lowest {self._lowest():.3g} of the mean): must stay positive",
            )

    def _lowest(self) -> float:
        """Lowest stiffness divided by the mean, from an FFT with 64 samples per period of the highest harmonic."""
        amplitudes = np.asarray(self.relative_amplitudes, float).ravel()
        size = 64 * (amplitudes.size + 1)
        lines = np.zeros(size // 2 + 1, complex)
        lines[0] = size
        lines[1 : amplitudes.size + 1] = 0.5 * size * amplitudes * np.exp(1j * np.asarray(self.phases, float).ravel())
        return float(np.fft.irfft(lines, size).min())

    def _shape(self, psi: Float[Array, " n"]) -> Float[Array, " n"]:
        """Stiffness divided by the mean, at mesh phases [rad]."""
        harmonic = jnp.arange(1, self.phases.size + 1, dtype=self.phases.dtype)
        angle = psi[:, None] * harmonic[None, :] + self.phases[None, :]
        return 1.0 + (self.relative_amplitudes[None, :] * jnp.cos(angle)).sum(axis=-1)

    def mean_stiffness(self, pairs: int) -> Float[Array, " pair"]:
        return jnp.broadcast_to(self.mean, (pairs,))

    def stiffness(self, mesh_angle: Float[Array, " pair"]) -> Float[Array, " pair"]:
        if self.phases.size == 0:
            return self.mean_stiffness(mesh_angle.shape[0])
        return self.mean * self._shape(mesh_angle)

    @property
    def harmonics(self) -> int:
        return self.phases.size

    def peak_stiffness(self) -> Scalar:
        return self.mean * (1.0 + jnp.abs(self.relative_amplitudes).sum())
