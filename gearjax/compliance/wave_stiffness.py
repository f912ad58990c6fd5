"""Mesh stiffness as cosines and sines, with derivatives also at vanishing amplitudes."""

from typing import ClassVar

import jax.numpy as jnp

from gearjax.compliance.base import AbstractCompliance
from gearjax.geometry.waves import Waves
from gearjax.parameters import with_known
from gearjax.typing import Array, Float, Scalar


class WaveStiffness(AbstractCompliance):
    """Stiffness of a pair over its mesh phase, as a sum of cosines and sines.

    A `HarmonicStiffness` is given by amplitudes and phases instead; the phase of a wave with zero amplitude has no
    derivative.

    Args:
        waves: stiffness as a Fourier series of the mesh phase [N/m].
    """

    kind: ClassVar[str] = "wave_stiffness"
    waves: Waves

    def mean_stiffness(self, pairs: int) -> Float[Array, " pair"]:
        return jnp.broadcast_to(self.waves.mean, (pairs,))

    def stiffness(self, mesh_angle: Float[Array, " pair"]) -> Float[Array, " pair"]:
        return self.waves.at(mesh_angle)

    @property
    def precomputes(self) -> bool:
        return self.waves.many

    def precomputed(self) -> "WaveStiffness":
        return with_known(self, waves=self.waves.tabulated())

    @property
    def harmonics(self) -> int:
        return self.waves.cosine.shape[0]

    def peak_stiffness(self) -> Scalar:
        return self.waves.mean + self.waves.reach
