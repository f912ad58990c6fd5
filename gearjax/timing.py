"""Wall time of a piece of work, compilation apart."""

import time
from types import TracebackType

import jax

_intervals: list[tuple[float, float]] = []
_listening: list[bool] = []


def _compiled(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith("/jax/core/compile/"):
        now = time.perf_counter()
        _intervals.append((now - duration_secs, now))


class Stopwatch:
    """Wall time of a ``with`` block, and how much of it tracing and compiling took.

    Example:
        >>> from gearjax.timing import Stopwatch
        >>> with Stopwatch() as watch:
        ...     total = sum(range(1000))
        >>> watch.seconds >= 0 and watch.compile_seconds == 0
        True
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        """Without compilation [s]."""
        self.compile_seconds = 0.0
        """Tracing and compiling [s]."""

    def __enter__(self) -> "Stopwatch":
        if not _listening:
            jax.monitoring.register_event_duration_secs_listener(_compiled)
            _listening.append(True)
        self._first = len(_intervals)
        self._began = time.perf_counter()
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        total = time.perf_counter() - self._began
        reached = self._began
        for start, end in sorted(_intervals[self._first :]):  # events are nested: count their union
            self.compile_seconds += max(0.0, end - max(start, reached))
            reached = max(reached, end)
        self.seconds = max(0.0, total - self.compile_seconds)
