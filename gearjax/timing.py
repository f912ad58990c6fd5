"""Wall time of a computation, with the compilation time separated."""

import threading
import time
from collections.abc import Callable
from types import TracebackType

import jax

_running: "list[Stopwatch]" = []
_listening: list[bool] = []


def _compiled(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith("/jax/core/compile/"):
        now = time.perf_counter()
        for watch in _running:
            if threading.get_ident() in watch.threads:
                watch.intervals.append((now - duration_secs, now))


class Stopwatch:
    """Wall time of a ``with`` block, and how much of it tracing and compiling took, in the thread of the block.

    Threads that the block starts count too if they call what `counting` returned.

    Example:
        >>> from gearjax.timing import Stopwatch
        >>> with Stopwatch() as watch:
        ...     total = sum(range(1000))
        >>> watch.seconds >= 0 and watch.compile_seconds == 0
        True
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        """Wall time without tracing and compiling [s]."""
        self.compile_seconds = 0.0
        """Time of tracing and compiling [s]."""
        self.intervals: list[tuple[float, float]] = []
        """Start and end of each event of tracing or compiling [s]."""
        self.threads: set[int] = set()
        """The threads whose events count."""

    def __enter__(self) -> "Stopwatch":
        if not _listening:
            jax.monitoring.register_event_duration_secs_listener(_compiled)
            _listening.append(True)
        self.threads = {threading.get_ident()}
        _running.append(self)
        self._began = time.perf_counter()
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        total = time.perf_counter() - self._began
        _running.remove(self)
        reached = self._began
        for start, end in sorted(self.intervals):  # events are nested, so that only their union counts
            self.compile_seconds += max(0.0, end - max(start, reached))
            reached = max(reached, end)
        self.seconds = max(0.0, total - self.compile_seconds)


def counting() -> Callable[[], None]:
    """A function that another thread calls, so that what it compiles counts for the watches of the calling thread."""
    watches = [watch for watch in _running if threading.get_ident() in watch.threads]

    def counted() -> None:
        for watch in watches:
            watch.threads.add(threading.get_ident())

    return counted
