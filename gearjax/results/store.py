"""Samples of a study on disk: a zarr group that xarray opens, written chunk by chunk, checked whenever it is read.

A chunk has one file for each measure and one for the result codes. The files are not compressed, so that they can be
checked before they are decoded. After these files a mark is written: a hash of the study, of the index of the chunk and
of its files. A chunk that is missing, damaged, out of place or from another study does not match its mark and is
computed again; so is a chunk that a killed run could not mark. The zarr metadata follow from the study; if they are
damaged they are written again. The group holds the configuration; a configuration with other samples cannot continue
the study. Only one run at a time may use the folder.
"""

import contextlib
import hashlib
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import gearjax
from gearjax.checks import GearjaxError, place, writing
from gearjax.config.build import contents
from gearjax.config.tables import flattened
from gearjax.config.tolerance import sampled
from gearjax.files import settle, write_file
from gearjax.tolerance import Work
from gearjax.tolerance.monte_carlo import Evaluated
from gearjax.units import arcmin

NAME = "samples.zarr"
_FORMAT = 6  # is raised when samples of before would be other ones now, and are not continued
_NEW = f".{NAME}.new"
_MARKS, _CODES = "done", "result"
_ABOUT = "zarr.json"
_LOOKED_AT = 64  # most chunks that are read to identify the study if the metadata do not
_MARK_BYTES = 8


class Store:
    """Samples of one study in a folder.

    Args:
        folder: folder of the samples; it is created if it does not exist.
        definition: tables of the configuration.
        work: the study.
        config: text of the configuration.

    Attributes:
        done: which chunks are stored.
        damaged: indices of the chunks that were stored and are damaged or missing now.
        healed: whether damaged metadata were written again.

    Raises:
        GearjaxError: the folder cannot be written, or holds another study; the message names the first differences.
    """

    def __init__(self, folder: Path, definition: dict[str, Any], work: Work, config: str):
        self.path, self.work = folder / NAME, work
        wanted = {"format": _FORMAT, "gearjax": gearjax.__version__, "chunk": work.chunk}
        wanted |= flattened(sampled(definition)) | contents(definition)
        self._study = json.dumps(wanted, sort_keys=True)
        self._columns = {name: np.dtype("<f8") for name in work.names} | {_CODES: np.dtype("<i4")}
        about = self._metadata(config)
        with writing(folder):
            if self.path.is_symlink() or self.path.exists():
                self._check_study(wanted)
                self.healed = self._heal(about)
            else:
                self._create(about)
                self.healed = False
            marked = [self._marked(index) for index in range(len(work.chunks))]
            whole = [mark and self._read(index) is not None for index, mark in enumerate(marked)]
        self.done = np.array(whole, dtype=bool)
        self.damaged = np.flatnonzero(np.array(marked, dtype=bool) & ~self.done)

    @property
    def pending(self) -> list[tuple[int, int]]:
        """Chunks that are not stored yet."""
        return [chunk for chunk, done in zip(self.work.chunks, self.done, strict=True) if not done]

    @property
    def samples_done(self) -> int:
        """Number of stored samples."""
        return sum(end - begin for (begin, end), done in zip(self.work.chunks, self.done, strict=True) if done)

    @property
    def remarks(self) -> list[str]:
        """Remarks on damage to the stored samples."""
        lines = [f"{self.path}: its metadata were damaged and are written again"] if self.healed else []
        if len(self.damaged):
            chunks = self.work.chunks
            samples = sum(chunks[index][1] - chunks[index][0] for index in self.damaged)
            lines.append(
                f"{self.path}: {len(self.damaged)} of {len(chunks)} chunks are damaged or missing: "
                f"{samples} samples are computed again"
            )
        return lines

    def put(self, chunk: tuple[int, int], evaluated: Evaluated) -> None:
        """Write a chunk; a chunk that is stored already is not changed."""
        index = chunk[0] // self.work.chunk
        if self.done[index]:
            return
        values, codes = evaluated
        filled = np.full((self.work.chunk, len(self.work.names)), np.nan)
        filled[: len(values)] = values
        told = np.full(self.work.chunk, -1)
        told[: len(codes)] = codes
        columns = [*filled.T, told]
        contents = [column.astype(dtype).tobytes() for column, dtype in zip(columns, self._dtypes, strict=True)]
        for path, content in zip(self._files(index), contents, strict=True):
            write_file(path, content)
        write_file(self._mark_file(index), self._mark(index, contents))
        self.done[index] = True

    def load(self) -> Evaluated:
        """Measures and result codes of all samples.

        Raises:
            GearjaxError: a chunk was damaged after it was checked.
        """
        values = np.empty((self.work.number, len(self.work.names)))
        codes = np.empty(self.work.number, np.int32)
        for index, (begin, end) in enumerate(self.work.chunks):
            columns = self._read(index)
            if columns is None:
                words = f"samples {begin} to {end - 1} were damaged during this run: start it again"
                raise GearjaxError(f"{place(self.path)}: {words}")
            for column, stored in enumerate(columns[:-1]):
                values[begin:end, column] = stored[: end - begin]
            codes[begin:end] = columns[-1][: end - begin]
        return values, codes

    @property
    def _dtypes(self) -> list[np.dtype]:
        return list(self._columns.values())

    def _files(self, index: int) -> list[Path]:
        return [self.path / name / "c" / str(index) for name in self._columns]

    def _mark_file(self, index: int) -> Path:
        return self.path / _MARKS / "c" / str(index)

    def _mark(self, index: int, contents: list[bytes]) -> bytes:
        """Hash by which the files of this chunk of this study are recognised."""
        mark = hashlib.blake2b(f"{self._study}\0{index}\0".encode(), digest_size=_MARK_BYTES)
        for content in contents:
            mark.update(content)
        return mark.digest()

    def _marked(self, index: int) -> bool:
        """Whether the chunk has a mark, which means that it was stored once."""
        return self._mark_file(index).exists()

    def _read(self, index: int) -> list[np.ndarray] | None:
        """Measures and codes of a chunk, shape (chunk,) each; ``None`` if they are not what was written."""
        try:
            contents = [path.read_bytes() for path in self._files(index)]
            mark = self._mark_file(index).read_bytes()
        except OSError:  # a file is missing, or the disk cannot read it any more
            return None
        sizes = [self.work.chunk * dtype.itemsize for dtype in self._dtypes]
        if [len(content) for content in contents] != sizes or mark != self._mark(index, contents):
            return None
        return [np.frombuffer(content, dtype) for content, dtype in zip(contents, self._dtypes, strict=True)]

    def _metadata(self, config: str) -> dict[str, bytes]:
        """The zarr metadata of the study, by file name."""
        import zarr
        from zarr.storage import MemoryStore

        files: dict[str, Any] = {}
        attributes: dict[str, Any] = {"config": config, "definition": self._study}
        group = zarr.create_group(MemoryStore(store_dict=files), attributes=attributes)
        plain: dict[str, Any] = {"compressors": None, "filters": None}
        sample: dict[str, Any] = {
            "shape": (self.work.number,),
            "chunks": (self.work.chunk,),
            "dimension_names": ("sample",),
        }
        about: dict[str, Any] = {"units": "rad", "per_arcmin": arcmin}
        for name in self.work.names:
            group.create_array(name, dtype="<f8", fill_value=np.nan, attributes=about, **sample, **plain)
        about = {"long_name": "result code, 0 good, -1 not yet done"}
        group.create_array(_CODES, dtype="<i4", fill_value=-1, attributes=about, **sample, **plain)
        chunk: dict[str, Any] = {"shape": (len(self.work.chunks),), "chunks": (1,), "dimension_names": ("chunk",)}
        about = {"long_name": "hash of the study, of the chunk's index and of its files; 0 not yet done"}
        group.create_array(_MARKS, dtype="<u8", fill_value=0, attributes=about, **chunk, **plain)
        return {name: content.to_bytes() for name, content in files.items()}

    def _create(self, about: dict[str, bytes]) -> None:
        import shutil

        started = self.path.with_name(_NEW)
        shutil.rmtree(started, ignore_errors=True)  # left by a run that was killed here
        for name, content in about.items():
            write_file(started / name, content)
        for name in (*self._columns, _MARKS):
            (started / name / "c").mkdir()
            settle(started / name)
        settle(started)
        started.rename(self.path)
        settle(self.path.parent)

    def _check_study(self, wanted: dict[str, Any]) -> None:
        """Refuse a folder that holds another study."""
        stored = _definition(self.path)
        differing = [key for key in sorted({*stored, *wanted}) if stored.get(key) != wanted.get(key)]
        if not differing:
            return
        marked = (index for index in range(len(self.work.chunks)) if self._marked(index))
        looked_at = itertools.islice(marked, _LOOKED_AT)
        foreign = not stored and _object(self.path / _ABOUT) is not None  # readable metadata of something else
        if not foreign and any(self._read(index) is not None for index in looked_at):
            return  # the samples belong to this study: only their metadata are damaged
        if not stored:
            raise GearjaxError(f"--out {place(self.path.parent)}: {NAME} is not a study of gearjax: choose another")
        words = "; ".join(f"{key}: {_shown(stored, key)} there, {_shown(wanted, key)} now" for key in differing[:3])
        more = f" and {len(differing) - 3} more" if len(differing) > 3 else ""
        raise GearjaxError(
            f"{place(self.path.parent)} holds another study ({words}{more}): choose another --out, or remove {NAME}"
        )

    def _heal(self, about: dict[str, bytes]) -> bool:
        """Write damaged metadata again; return whether there were any."""
        damaged = False
        for name, content in about.items():
            there, right = _object(self.path / name), json.loads(content)
            if there == right:
                continue
            for one in (there, right) if name == _ABOUT else ():
                # the text of the configuration is from the last run; its limits may have changed since
                if one is not None and isinstance(one.get("attributes"), dict):
                    one["attributes"].pop("config", None)
            damaged |= there != right
            write_file(self.path / name, content)
        return damaged


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Lock a folder: another run that wants the folder is refused until this run ends or is killed.

    Raises:
        GearjaxError: another run has locked the folder.
    """
    import filelock

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(folder / ".lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout as fault:
            raise GearjaxError(
                f"--out {place(folder)}: another run is writing there: wait, or choose another folder"
            ) from fault
    try:
        yield
    finally:
        lock.release()


def _object(path: Path) -> dict[str, Any] | None:
    """The JSON object in a file; ``None`` if there is none."""
    try:
        parsed = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return parsed if isinstance(parsed, dict) else None


def _definition(path: Path) -> dict[str, Any]:
    """The definition of the study in the metadata of a group; empty if there is none."""
    attributes = (_object(path / _ABOUT) or {}).get("attributes")
    text = attributes.get("definition") if isinstance(attributes, dict) else None
    try:
        definition = json.loads(text) if isinstance(text, str) else {}
    except (ValueError, RecursionError):
        return {}
    return definition if isinstance(definition, dict) else {}


def _shown(table: dict[str, Any], key: str) -> str:
    return json.dumps(table[key])[:60] if key in table else "nothing"
