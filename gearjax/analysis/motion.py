"""Result of a simulation, with its metrics."""

import equinox as eqx
import jax.numpy as jnp

from gearjax.analysis.metrics import load_sharing, root
from gearjax.contact import Layout
from gearjax.typing import Array, Float, Int, Scalar


class Motion(eqx.Module):
    """Dynamic transmission error over time.

    Args:
        ts: sample times, shape (n,) [s].
        te: transmission error, positive when the output leads, shape (n,) [rad].
        velocity: rate of the transmission error, shape (n,) [rad/s].
        forces: elastic force of each contact in the order of the layout, shape (n, contact) [N].
        highest, lowest: extremes of te over the steps from the previous sample to each sample, shape (n,) [rad].
        settle: time at the start of the record that the metrics leave out [s].
        result: 0 good, otherwise a key of `gearjax.analysis.dynamics.FAULTS`.
        defect: largest difference of neighbouring windows of time where they meet [rad]; 0 without windows.
        layout: sides and pairs of the contacts.
        carriers: number of pairs that could carry the torque at each time, shape (n,); ``None`` if all could.
        moved: displacements in the other coordinates, shape (n, coordinate) [m, rad]; ``None`` if there are none.
        coordinates: names of the coordinates: the output, then the others.
        moved_velocity: rates of the displacements in the other coordinates, shape (n, coordinate) [m/s, rad/s].
    """

    ts: Float[Array, " n"]
    te: Float[Array, " n"]
    velocity: Float[Array, " n"]
    forces: Float[Array, "n contact"]
    highest: Float[Array, " n"]
    lowest: Float[Array, " n"]
    settle: Scalar
    result: Int[Array, ""]
    defect: Scalar
    layout: Layout = eqx.field(static=True)
    carriers: Int[Array, " n"] | None = None
    moved: Float[Array, "n coordinate"] | None = None
    coordinates: tuple[str, ...] = eqx.field(static=True, default=("output",))
    moved_velocity: Float[Array, "n coordinate"] | None = None

    @property
    def q(self) -> Float[Array, "... n coordinate"]:
        """Displacement from the ideal motion in each coordinate, the output's first [rad, m]."""
        te = self.te[..., None]
        return te if self.moved is None else jnp.concatenate([te, self.moved], axis=-1)

    @property
    def rates(self) -> Float[Array, "... n coordinate"]:
        """Rate of the displacement in each coordinate, the output's first [rad/s, m/s]."""
        rate = self.velocity[..., None]
        return rate if self.moved_velocity is None else jnp.concatenate([rate, self.moved_velocity], axis=-1)

    @property
    def settled(self) -> Array:
        """Whether the metrics include each sample, shape (n,)."""
        return self.ts >= self.ts[..., :1] + self.settle[..., None]

    @property
    def _maximum(self) -> Float[Array, "..."]:
        values = jnp.where(self._after, self.highest, self.te)
        return _pick(values, jnp.argmax(jnp.where(self.settled, values, -jnp.inf), axis=-1))

    @property
    def _minimum(self) -> Float[Array, "..."]:
        values = jnp.where(self._after, self.lowest, self.te)
        return _pick(values, jnp.argmin(jnp.where(self.settled, values, jnp.inf), axis=-1))

    @property
    def _after(self) -> Array:
        """Whether the interval up to each sample lies completely after settling; first entry: the first sample."""
        settled = self.settled
        return jnp.concatenate([settled[..., :1], settled[..., :-1]], axis=-1)

    @property
    def bands(self) -> tuple[Float[Array, "... n"], Float[Array, "... n"]]:
        """Highest and lowest value up to each sample, shape (n,) each [rad].

        Samples that the metrics leave out are replaced by the last sample.
        """
        settled, last = self.settled, self.te[..., -1:]
        high = jnp.where(self._after, self.highest, self.te)
        low = jnp.where(self._after, self.lowest, self.te)
        return jnp.where(settled, high, last), jnp.where(settled, low, last)

    @property
    def peak_to_peak(self) -> Float[Array, "..."]:
        """Highest minus lowest over all steps after settling [rad]."""
        return self._maximum - self._minimum

    @property
    def amplitude(self) -> Float[Array, "..."]:
        """Largest absolute value over all steps after settling [rad]."""
        return jnp.maximum(self._maximum, -self._minimum)

    @property
    def mean(self) -> Float[Array, "..."]:
        """Mean of the samples after settling [rad]."""
        return _mean(self.te, self.settled)

    @property
    def std(self) -> Float[Array, "..."]:
        """Standard deviation of the samples after settling [rad]."""
        return root(_mean((self.te - self.mean[..., None]) ** 2, self.settled))

    @property
    def load_sharing(self) -> Float[Array, "... n"]:
        """Load of the most loaded pair over the mean load of the pairs that could carry, shape (n,) [-]."""
        carriers = self.layout.teeth if self.carriers is None else self.carriers
        return load_sharing(self.layout, self.forces, carriers)


def _pick(values: Float[Array, "... n"], index: Int[Array, "..."]) -> Float[Array, "..."]:
    """One sample of each record."""
    return jnp.take_along_axis(values, index[..., None], axis=-1)[..., 0]


def _mean(values: Float[Array, "... n"], counted: Array) -> Float[Array, "..."]:
    """Mean of the samples that ``counted`` marks."""
    return jnp.where(counted, values, 0.0).sum(axis=-1) / counted.sum(axis=-1).astype(values.dtype)
