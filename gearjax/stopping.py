"""Ctrl-C ends a command at once, during compilation too, with one line on what was kept and how to go on.

Python handles a signal only between two steps of its main thread, and one program of XLA may take half a minute.
Therefore a separate thread receives the signal through `signal.set_wakeup_fd`. This thread ends the process between two
writes of files (`gearjax.files`), so that no file is half written. The module needs the standard library only: the
command listens before it imports JAX, which takes a second.
"""

import atexit
import contextlib
import os
import shutil
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

CODE = 130  # exit code of a process ended by SIGINT, as in shells
_PATIENCE = 5.0  # longest wait until a file is written [s]
_ERASE_LINE = "\r\x1b[2K\x1b[?25h"  # erases a progress bar and shows its hidden cursor again

unbroken = threading.RLock()
"""Lock that is held while a file is written; taking it before ending the process avoids a partial file."""

_kept: list[Callable[[], str]] = []
_listening: list[bool] = []
_unfinished: list[list[Path]] = []


def nothing_kept() -> str:
    """The message of a command that writes its results only at its end."""
    return "nothing of this run was saved; run the same command again"


@contextlib.contextmanager
def unfinished(folder: Path) -> Iterator[None]:
    """A new folder for the time of the block: it is removed at its end, and by Ctrl-C, with what was made above it.

    Folders above it stay if something else is in them.
    """
    made = [folder, *(level for level in folder.parents if not level.exists())]
    with unbroken:
        folder.mkdir(parents=True)
        _unfinished.append(made)
    try:
        yield
    finally:
        _remove(made)
        _unfinished.remove(made)


def _remove(made: list[Path]) -> None:
    """Remove a folder, and the folders above it that are empty then."""
    shutil.rmtree(made[0], ignore_errors=True)
    with contextlib.suppress(OSError):
        for level in made[1:]:
            level.rmdir()


def say_when_stopped(words: Callable[[], str]) -> None:
    """Set the message of Ctrl-C from now on: what was kept, and how to go on."""
    _kept[:] = [words]


def message() -> str:
    """The line that Ctrl-C prints."""
    return f"gearjax: stopped: {_kept[0]() if _kept else nothing_kept()}"


def listen() -> None:
    """Let Ctrl-C end this process, unless the caller of the process made it ignore Ctrl-C."""
    if _listening or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    told, telling = socket.socketpair()
    telling.setblocking(False)
    signal.set_wakeup_fd(telling.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, lambda *_: None)
    watching = threading.Thread(target=_watch, args=(told,), name="Ctrl-C", daemon=True)
    watching.start()
    atexit.register(_deaf, telling, watching)
    _listening.append(True)


def _deaf(telling: socket.socket, watching: threading.Thread) -> None:
    """Stop listening at the end of the process, and close the socket and the thread."""
    signal.set_wakeup_fd(-1)
    telling.close()
    watching.join(_PATIENCE)


def _watch(told: socket.socket) -> None:
    with told:
        heard = told.recv(64)
        while heard and signal.SIGINT not in heard:
            heard = told.recv(64)
    if not heard:
        return
    unbroken.acquire(timeout=_PATIENCE)
    for made in _unfinished:
        _remove(made)
    words = f"{_ERASE_LINE if sys.stderr.isatty() else ''}{message()}\n"
    os.write(sys.stderr.fileno(), words.encode(errors="backslashreplace"))
    os._exit(CODE)
