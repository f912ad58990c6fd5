"""Writing of result files: each is written completely or not at all, and flushed to the disk; numbers for JSON.

A folder for results can be tried before the work begins.
"""

import contextlib
import math
import os
import tempfile
from pathlib import Path
from typing import Any

from gearjax.checks import GearjaxError, place, writing
from gearjax.stopping import unbroken


def write_file(path: Path, content: str | bytes) -> Path:
    """Write a file, and make its folder if that is missing.

    The file is replaced in one operation: a reader, also after a loss of power, finds the whole old or the whole new
    content.

    Args:
        path: the file.
        content: content of the file; text is written in UTF-8.

    Raises:
        GearjaxError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> from gearjax.files import write_file
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_file(Path(folder) / "new" / "words.txt", "pins").read_text()
        'pins'
    """
    started = path.with_name(f".{path.name}.part")
    with writing(path), unbroken:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with started.open("wb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
            started.replace(path)
            settle(path.parent)
        except BaseException:
            with contextlib.suppress(OSError):
                started.unlink(missing_ok=True)
            raise
    return path


def finite(entry: Any) -> Any:
    """Tables, lists and numbers with ``None`` in place of numbers that are not finite, which JSON does not know."""
    if isinstance(entry, dict):
        return {key: finite(value) for key, value in entry.items()}
    if isinstance(entry, list):
        return [finite(value) for value in entry]
    return None if isinstance(entry, float) and not math.isfinite(entry) else entry


def settle(folder: Path) -> None:
    """Flush the names in a folder to the disk, as fsync does with the content of a file; Windows does not need it."""
    if os.name == "nt":
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def writable(folder: Path) -> Path:
    """The folder, after a trial that a file can be made in it.

    Missing folders and the trial file are removed after the trial.

    Args:
        folder: folder for results, which need not exist yet.

    Raises:
        GearjaxError: no file can be made in the folder.

    Example:
        >>> from gearjax.files import writable
        >>> writable(Path("README.md") / "out")
        Traceback (most recent call last):
            ...
        gearjax.checks.GearjaxError: --out README.md/out: cannot be written (Not a directory)
    """
    made: list[Path] = []
    try:
        with writing(folder):
            for level in reversed([level for level in (folder, *folder.parents) if not level.exists()]):
                level.mkdir(exist_ok=True)
                made.append(level)
            with tempfile.NamedTemporaryFile(dir=folder, prefix=".gearjax-") as tried:
                tried.write(b"\0")
    except ValueError as fault:  # raised for names that no system allows, such as one with a NUL
        if isinstance(fault, GearjaxError):
            raise
        raise GearjaxError(f"--out {place(folder)}: cannot be written ({fault})") from fault
    finally:
        for level in reversed(made):
            with contextlib.suppress(OSError):  # another run may have begun to write there
                level.rmdir()
    return folder
