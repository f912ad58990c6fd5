"""Rows of recordings, one after the other, and further numbers (offsets, waves, drifts) that add to their curves."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gearjax.identification.measurement import Measurement
from gearjax.scene import Scene
from gearjax.units import arcmin


class Wave(NamedTuple):
    """A free wave of all recordings: two further numbers, of its cosine and sine.

    Args:
        order: cycles per turn of the input.
        name: name of the wave.
    """

    order: float
    name: str
    parts = "cos", "sin"

    def columns(self, theta: np.ndarray, record: np.ndarray) -> list[np.ndarray]:
        """Change of the rows per unit of each number."""
        del record
        return [np.cos(self.order * theta), np.sin(self.order * theta)]


class Trend(NamedTuple):
    """A drift of the encoders' offset within a recording: two further numbers, of a line and a parabola.

    Args:
        record: number of the recording.
        name: name of the drift.
    """

    record: int
    name: str
    parts = "line", "parabola"

    def columns(self, theta: np.ndarray, record: np.ndarray) -> list[np.ndarray]:
        """Change of the rows per unit of each number: Legendre's polynomials over the angles of the recording."""
        own = record == self.record
        low, high = theta[own].min(), theta[own].max()
        place = (2 * theta - low - high) / max(high - low, 1e-300)
        return [np.where(own, place, 0.0), np.where(own, 1.5 * place**2 - 0.5, 0.0)]


class Rows(NamedTuple):
    """Rows of recordings, one after the other.

    Args:
        theta: input angle [rad].
        torque: load torque [N m].
        back: whether the back flanks carry, for rows without torque.
        te: transmission error [arcmin].
        weight: weight of the row.
        basis: change of the curve per unit of each further number, such as the encoders' offset, shape (n, further)
            [arcmin].
        record: number of the recording.
    """

    theta: np.ndarray
    torque: np.ndarray
    back: np.ndarray
    te: np.ndarray
    weight: np.ndarray
    basis: np.ndarray
    record: np.ndarray

    def padded(self) -> "Rows":
        """The same rows followed by rows of zero weight, so that few sizes are compiled."""
        size = self.theta.size
        step = max(16, 1 << max(0, size.bit_length() - 4))
        more = -size % step
        longer = Rows._make(np.concatenate([part, np.repeat(part[-1:], more, axis=0)]) for part in self)
        return longer._replace(weight=np.concatenate([self.weight, np.zeros(more)]))


def rows_of(
    records: Sequence[Measurement], scene: Scene, free: Sequence[Wave | Trend] = (), offsets: bool = True
) -> Rows:
    """Rows of recordings, one after the other, with the basis of their further numbers.

    These are the common offset of the encoders, its change in each recording (with ``offsets``), free waves and drifts.
    """
    number = np.concatenate([np.full(record.theta.size, i) for i, record in enumerate(records)])
    theta = np.concatenate([record.theta for record in records])
    basis = further(theta, number, len(records), free, offsets)
    return Rows(
        theta,
        np.concatenate([record.loads for record in records]),
        np.concatenate([record.back for record in records]),
        np.concatenate([record.error(scene) for record in records]) / arcmin,
        np.ones(theta.shape),
        basis,
        number,
    )


def further(
    theta: np.ndarray, record: np.ndarray, records: int, free: Sequence[Wave | Trend], offsets: bool
) -> np.ndarray:
    """Columns of the further numbers: the common offset, its change in each recording, free waves and drifts."""
    columns = [np.ones(theta.shape)]
    if offsets and records > 1:
        columns += [(record == i).astype(float) for i in range(records)]
    for each in free:
        columns += each.columns(theta, record)
    return np.stack(columns, axis=1)


def names_of_further(records: Sequence[Measurement], free: Sequence[Wave | Trend], offsets: bool) -> list[str]:
    """Names of the further numbers."""
    names = ["offset"]
    if offsets and len(records) > 1:
        names += [f"offset of {record.name}" for record in records]
    return names + [f"{each.name}.{part}" for each in free for part in each.parts]
