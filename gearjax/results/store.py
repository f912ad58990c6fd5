"""Samples of a study on disk: a zarr group, read and written through xarray, chunk by chunk.

A chunk counts once its flag is written, after its data: a killed run leaves at most one chunk to be worked out again.
The configuration is inside; one with other samples does not go on with them. One run at a time holds the folder.
"""

import contextlib
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gearjax.checks import GearjaxError, writing
from gearjax.config.tables import flattened
from gearjax.config.tolerance import sampled
from gearjax.tolerance import Work
from gearjax.tolerance.monte_carlo import Evaluated
from gearjax.units import arcmin

NAME = "samples.zarr"
_FORMAT = 1


class Store:
    """Samples of one study in a folder.

    Args:
        folder: where; made if it is not there.
        definition: the tables of the configuration.
        work: the study.
        config: text of the configuration.

    Raises:
        GearjaxError: the folder cannot be written, or holds another study; the first differences are named.
    """

    def __init__(self, folder: Path, definition: dict[str, Any], work: Work, config: str):
        self.path, self.work = folder / NAME, work
        wanted = {"format": _FORMAT, "chunk": work.chunk, **flattened(sampled(definition))}
        with writing(folder):
            if not self.path.exists():
                self._create(wanted, config)
            else:
                self._compare(wanted)
            with _opened(self.path) as known:
                self.done = np.asarray(known["done"].values, dtype=bool)

    @property
    def pending(self) -> list[tuple[int, int]]:
        """Chunks that are not there yet."""
        return [chunk for chunk, done in zip(self.work.chunks, self.done, strict=True) if not done]

    @property
    def samples_done(self) -> int:
        """How many samples are there."""
        return sum(end - begin for (begin, end), done in zip(self.work.chunks, self.done, strict=True) if done)

    def put(self, chunk: tuple[int, int], found: Evaluated) -> None:
        """Write a chunk; a chunk that is there already stays as it is."""
        index = chunk[0] // self.work.chunk
        if self.done[index]:
            return
        values, codes = found
        with writing(self.path.parent):
            self._write("sample", chunk, {**dict(zip(self.work.names, values.T, strict=True)), "result": codes})
            self._write("chunk", (index, index + 1), {"done": np.ones(1, np.int8)})
        self.done[index] = True

    def load(self) -> Evaluated:
        """Measures and result codes of all samples."""
        with _opened(self.path) as known:
            values = np.stack([np.asarray(known[name].values) for name in self.work.names], axis=1)
            return values, np.asarray(known["result"].values)

    def _create(self, wanted: dict[str, Any], config: str) -> None:
        import xarray as xr

        number, chunk = self.work.number, self.work.chunk
        about = {"units": "rad", "per_arcmin": arcmin}
        variables = {name: ("sample", np.full(number, np.nan), about) for name in self.work.names}
        codes = ("sample", np.full(number, -1, np.int32), {"long_name": "result code, 0 good, -1 not yet done"})
        flags = ("chunk", np.zeros(len(self.work.chunks), np.int8), {"long_name": "whether the chunk is written"})
        attributes = {"config": config, "definition": json.dumps(wanted, sort_keys=True)}
        data = xr.Dataset({**variables, "result": codes, "done": flags}, attrs=attributes)
        encoding: dict[str, Any] = {name: {"chunks": (min(chunk, number),)} for name in (*variables, "result")}
        encoding["done"] = {"chunks": (1,)}
        started = self.path.with_suffix(".new")
        _remove(started)
        data.to_zarr(started, mode="w", encoding=encoding, consolidated=False)
        started.rename(self.path)

    def _compare(self, wanted: dict[str, Any]) -> None:
        try:
            with _opened(self.path) as known:
                stored = json.loads(known.attrs["definition"])
        except (KeyError, ValueError, OSError) as fault:
            raise GearjaxError(f"--out {self.path.parent}: {NAME} is not a study of gearjax: choose another") from fault
        keys = sorted({*stored, *wanted})
        differing = [key for key in keys if stored.get(key) != wanted.get(key)]
        if differing:
            words = "; ".join(f"{key}: {_shown(stored, key)} there, {_shown(wanted, key)} now" for key in differing[:3])
            more = f" and {len(differing) - 3} more" if len(differing) > 3 else ""
            raise GearjaxError(
                f"{self.path.parent} holds another study ({words}{more}): choose another --out, or remove {NAME}"
            )

    def _write(self, dimension: str, region: tuple[int, int], variables: dict[str, np.ndarray]) -> None:
        import xarray as xr

        data = xr.Dataset({name: (dimension, values) for name, values in variables.items()})
        data.to_zarr(self.path, region={dimension: slice(*region)}, consolidated=False)


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a folder: another run that asks for it is refused, until this one ends or is killed.

    Raises:
        GearjaxError: another run holds it.
    """
    import filelock

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(folder / ".lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout as fault:
            raise GearjaxError(
                f"--out {folder}: another run is writing there: wait, or choose another folder"
            ) from fault
    try:
        yield
    finally:
        lock.release()


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import xarray as xr

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of zarr, that a format may change
        data = xr.open_zarr(path, consolidated=False, chunks=None, mask_and_scale=False)
    try:
        yield data
    finally:
        data.close()


def _remove(path: Path) -> None:
    import shutil

    shutil.rmtree(path, ignore_errors=True)


def _shown(table: dict[str, Any], key: str) -> str:
    return json.dumps(table[key])[:60] if key in table else "nothing"
