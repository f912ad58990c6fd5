"""Files of results: written whole or not at all, through to the disk, in folders that were tried beforehand."""

import contextlib
import os
import tempfile
import threading
from pathlib import Path

from gearjax.checks import GearjaxError, place, writing

unbroken = threading.RLock()
"""Held while a file is written: who takes it before ending the process leaves none half done."""


def write_file(path: Path, content: str | bytes) -> Path:
    """Write a file, and its folder where that is missing: whoever reads it, and a loss of power, finds what was there
    before or all that is new.

    Args:
        path: the file.
        content: what is in it; text is written in UTF-8.

    Raises:
        GearjaxError: it cannot be written.

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


def settle(folder: Path) -> None:
    """Have the disk know the names in a folder, as fsync does for what is in a file; Windows knows them already."""
    if os.name == "nt":
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def writable(folder: Path) -> Path:
    """The folder, once a file could be made there, and the folders above it; nothing of that is left behind.

    Args:
        folder: where results shall go, made already or not.

    Raises:
        GearjaxError: no file can be made there.

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
    except ValueError as fault:  # of names that no system can have, such as one with a NUL
        if isinstance(fault, GearjaxError):
            raise
        raise GearjaxError(f"--out {place(folder)}: cannot be written ({fault})") from fault
    finally:
        for level in reversed(made):
            with contextlib.suppress(OSError):  # another run may have begun to write there
                level.rmdir()
    return folder
