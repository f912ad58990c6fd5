"""Ctrl-C: one line that says what was kept and how to go on, at once, whatever is being compiled or computed.

Python itself looks for a signal between two steps of its main thread alone, and one program of XLA may take half a
minute: a thread of its own is told by `signal.set_wakeup_fd`. It ends the process between two writes of files
(`gearjax.files`), so that none is half done.
"""

import atexit
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable

from gearjax.files import unbroken

CODE = 130  # of a process that SIGINT ended, as shells count
_PATIENCE = 5.0  # that a file may take to be written [s]
_ERASE_LINE = "\r\x1b[2K\x1b[?25h"  # of a progress bar, whose cursor was hidden
_kept: list[Callable[[], str]] = []
_listening: list[bool] = []


def nothing_kept() -> str:
    """What a command has to say that writes its results at its end."""
    return "nothing of this run was kept; the same command begins again"


def say_when_stopped(words: Callable[[], str]) -> None:
    """What Ctrl-C shall say from now on: what was kept, and how to go on."""
    _kept[:] = [words]


def message() -> str:
    """The line that Ctrl-C leaves."""
    return f"gearjax: stopped: {_kept[0]() if _kept else nothing_kept()}"


def listen() -> None:
    """Have Ctrl-C end this process, unless whoever started it had it ignore that."""
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
    """Nothing is left to stop at the end of the process: close what is open."""
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
    words = f"{_ERASE_LINE if sys.stderr.isatty() else ''}{message()}\n"
    os.write(sys.stderr.fileno(), words.encode(errors="backslashreplace"))
    os._exit(CODE)
