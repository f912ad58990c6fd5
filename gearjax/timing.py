"""Wall time of a computation, with the compilation time separated."""

import threading
import time
from types import TracebackType

import jax

_running: "list[Stopwatch]" = []
_listening: list[bool] = []


def _compiled(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith("/jax/core/compile/"):
        now = time.perf_counter()
        for watch in _running:
            if watch.thread == threading.get_ident():
                watch.intervals.append((now - duration_secs, now))


class Stopwatch:
    """Wall time of a ``with`` block, and how much of it tracing and compiling took, in the thread of the block.

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
        self.thread = 0
        """The thread whose events count."""

    def __enter__(self) -> "Stopwatch":
        if not _listening:
            jax.monitoring.register_event_duration_secs_listener(_compiled)
            _listening.append(True)
        self.thread = threading.get_ident()
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
