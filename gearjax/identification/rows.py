"""Rows of recordings, one after the other, and the further numbers (offsets, free orders) that add to their curves."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gearjax.identification.measurement import Measurement
from gearjax.scene import Scene
from gearjax.units import arcmin


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


def rows_of(records: Sequence[Measurement], scene: Scene, orders: Sequence[float] = (), offsets: bool = True) -> Rows:
    """Rows of recordings, one after the other, with the basis of their further numbers.

    These are the common offset of the encoders, its change in each recording (with ``offsets``), and free orders.
    """
    number = np.concatenate([np.full(record.theta.size, i) for i, record in enumerate(records)])
    theta = np.concatenate([record.theta for record in records])
    basis = further(theta, number, len(records), orders, offsets)
    return Rows(
        theta,
        np.concatenate([record.loads for record in records]),
        np.concatenate([record.back for record in records]),
        np.concatenate([record.error(scene) for record in records]) / arcmin,
        np.ones(theta.shape),
        basis,
        number,
    )


def further(theta: np.ndarray, record: np.ndarray, records: int, orders: Sequence[float], offsets: bool) -> np.ndarray:
    """Columns of the further numbers: the common offset, its change in each recording, free orders."""
    columns = [np.ones(theta.shape)]
    if offsets and records > 1:
        columns += [(record == i).astype(float) for i in range(records)]
    for order in orders:
        columns += [np.cos(order * theta), np.sin(order * theta)]
    return np.stack(columns, axis=1)


def names_of_further(records: Sequence[Measurement], orders: Mapping[float, str], offsets: bool) -> list[str]:
    """Names of the further numbers."""
    names = ["offset"]
    if offsets and len(records) > 1:
        names += [f"offset of {record.name}" for record in records]
    return names + [f"{name}.{part}" for name in orders.values() for part in ("cos", "sin")]
