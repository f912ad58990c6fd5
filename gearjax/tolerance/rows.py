"""Programs for rows of numbers, one row for each gear set, spread over devices."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from gearjax.typing import Array, Int

Started = tuple[int, int, Any]
"""Number of rows, rows of each device, and the results on the devices."""


class RowProgram:
    """A function of one row of each of several arrays, for many rows at once, each device with its own part of them.

    The program has room for a fixed number of rows and is told how many blocks of rows there are, so that one compiled
    program serves studies of any size, and computes no more than they need.

    Args:
        one: function of one row of each array; if it has a method ``rows``, a function of several rows, that is used.
        devices: devices that share the rows evenly.
        together: number of rows that are computed side by side on one device.
        room: number of rows for which the program has room.
    """

    def __init__(self, one: Callable, devices: Sequence[Any], together: int, room: int):
        self.devices, self.together = tuple(devices), together
        self._blocks = -(-room // (together * len(self.devices)))  # of each device
        mesh = Mesh(np.array(self.devices), ("sample",))
        spec, whole = PartitionSpec("sample"), PartitionSpec()
        self._sharding = NamedSharding(mesh, spec)
        several = jax.jit(getattr(one, "rows", None) or jax.vmap(one))  # traced once for its shapes and its values

        def part(number: Int[Array, ""], rows: tuple[Array, ...]) -> Any:
            blocks = [row.reshape(-1, together, *row.shape[1:]) for row in rows]

            def block(i: Any) -> list[Array]:
                return [jax.lax.dynamic_index_in_dim(row, i, keepdims=False) for row in blocks]

            def step(i: Any, results: Any) -> Any:
                put = jax.lax.dynamic_update_index_in_dim
                return jax.tree.map(lambda all_, new: put(all_, new, i, 0), results, several(*block(i)))

            shapes = jax.eval_shape(several, *(jax.eval_shape(lambda row: row[0], row) for row in blocks))
            empty = jax.tree.map(lambda leaf: jnp.zeros((self._blocks, *leaf.shape), leaf.dtype), shapes)
            results = jax.lax.fori_loop(0, number, step, empty)
            return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), results)

        self._program = jax.jit(jax.shard_map(part, mesh=mesh, in_specs=(whole, spec), out_specs=spec, check_vma=False))

    @property
    def room(self) -> int:
        """Number of rows for which the program has room."""
        return self._blocks * self.together * len(self.devices)

    def begin(self, *arrays: np.ndarray) -> Started:
        """Start on as many rows as there is room for, at most; the devices work on while this returns."""
        number, devices = len(arrays[0]), len(self.devices)
        blocks = -(-number // (self.together * devices))
        share, place = blocks * self.together, np.arange(self.room // devices)
        of_device = np.arange(devices)[:, None] * share + np.where(place < share, place, 0)
        rows = np.minimum(of_device, number - 1).ravel()
        given = jax.device_put(tuple(array[rows] for array in arrays), self._sharding)
        return number, share, self._program(np.int32(blocks), given)

    def finish(self, started: Started) -> Any:
        """The results of the rows, as a tree of numpy arrays."""
        number, share, results = started

        def gathered(part: Array) -> np.ndarray:
            each = np.asarray(part).reshape(len(self.devices), -1, *part.shape[1:])[:, :share]
            return each.reshape(-1, *part.shape[1:])[:number].copy()

        return jax.tree.map(gathered, results)

    def __call__(self, *arrays: np.ndarray) -> Any:
        """The results of any number of rows, as a tree of numpy arrays."""
        starts = range(0, len(arrays[0]), self.room)
        parts = [self.finish(self.begin(*(array[i : i + self.room] for array in arrays))) for i in starts]
        return parts[0] if len(parts) == 1 else jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
