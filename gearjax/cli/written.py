"""Which files of a folder belong to which command, so that results of different runs are not taken for one."""

import contextlib
import json
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from gearjax.checks import writing
from gearjax.files import settle, write_file
from gearjax.stopping import unbroken, unfinished

NAME = "written.json"
LEFT_BEHIND = 600.0  # s: a command writes its results in seconds, so that older ones are of a process that was killed


class Results:
    """Results of a command on their way into their folder.

    Args:
        folder: folder for the time of writing.
        files: files that were written there.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.files: list[Path] = []

    def add(self, files: list[Path]) -> None:
        """Note files that were written."""
        self.files += files


@contextlib.contextmanager
def replacing(folder: Path, command: str, say: Callable[[str], None]) -> Iterator[Results]:
    """Results that a command writes in the block; they come into their folder all together at its end.

    A command that is stopped while it writes leaves the results of an earlier run as they were. Of two commands that
    write at once, each has a folder of its own for that time, and the results of the last one stay.

    Args:
        folder: folder of the results.
        command: name of the command.
        say: called with lines on what was written.

    Raises:
        GearjaxError: the folder cannot be written.
    """
    part = folder / f".{command}.{secrets.token_hex(4)}.part"
    with contextlib.ExitStack() as stack:
        with writing(folder):
            _remove_left_behind(folder, command)
            stack.enter_context(unfinished(part))
        results = Results(part)
        yield results
        with writing(folder), unbroken:
            lines = Folder(folder).keep(command, [_moved(file, part, folder) for file in results.files])
            settle(folder)
    for line in lines:
        say(line)


def _remove_left_behind(folder: Path, command: str) -> None:
    """Remove what processes that were killed left unfinished."""
    for part in folder.glob(f".{command}.*part"):
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > LEFT_BEHIND:
                shutil.rmtree(part, ignore_errors=True)


def _moved(file: Path, part: Path, folder: Path) -> Path:
    """A file, moved from one folder to the same place in another one."""
    place = folder / file.relative_to(part)
    place.parent.mkdir(parents=True, exist_ok=True)
    return file.replace(place)


class Folder:
    """A folder of results, and the files that each command wrote into it at last.

    Args:
        path: the folder.
    """

    def __init__(self, path: Path):
        self.path = path
        self.commands: dict[str, list[str]] = {}
        try:
            known = json.loads((path / NAME).read_text(encoding="utf-8"))
            self.commands = {str(name): [str(file) for file in files] for name, files in known.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return  # none yet, or no longer readable: then no file is known

    @property
    def last(self) -> str | None:
        """The command that wrote last."""
        return next(reversed(self.commands), None)

    def of(self, file: str) -> str | None:
        """The command that a file belongs to; ``None`` if it is not known."""
        return next((name for name, files in self.commands.items() if file in files), None)

    def keep(self, command: str, files: list[Path]) -> list[str]:
        """Note what a command wrote, and remove what only an earlier run of the same command wrote.

        The result is what to say about it, as lines.
        """
        own = [path.relative_to(self.path).as_posix() for path in files]
        earlier = self.commands.pop(command, [])
        others = {name: [file for file in kept if file not in own] for name, kept in self.commands.items()}
        stale = [file for file in earlier if file not in own and not any(file in kept for kept in others.values())]
        removed = [file for file in stale if self._removed(file)]
        self.commands = others | {command: own}
        write_file(self.path / NAME, json.dumps(self.commands, indent=1) + "\n")
        lines = [f"written to {self.path}: {', '.join(path.name for path in files)}"]
        return lines + [f"removed, of the gearjax {command} before: {', '.join(removed)}"] * bool(removed)

    def _removed(self, file: str) -> bool:
        """Remove a file; false if it is not there, or not within the folder."""
        path = self.path / file
        if ".." in path.parts or not path.is_file():
            return False
        path.unlink()
        return True
