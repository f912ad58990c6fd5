"""Progress of long computations, as lines of text."""

import time
from collections.abc import Callable

Progress = Callable[[str], None]
SURE = 0.1  # share of the parts after which the time for the rest is told


def silent(words: str) -> None:
    """Ignore a line of progress: the default if no progress is wanted."""
    del words


class Left:
    """How long a computation of known parts still takes, from the time that its parts took so far.

    Args:
        parts: number of parts, or their whole work in any unit.
    """

    def __init__(self, parts: float | int):
        self.parts, self.done = parts, 0.0
        self._began = time.perf_counter()

    def after(self, parts: float | int = 1) -> str:
        """Words such as ``, about 40 s left``, after further parts are done; none at first and near the end."""
        self.done += parts
        if self.done < SURE * self.parts:
            return ""
        rest = (time.perf_counter() - self._began) / self.done * (self.parts - self.done)
        return "" if rest < 1.0 else f", about {told_seconds(rest)} left"


def told_seconds(seconds: float | int) -> str:
    """A time as it is told: ``7 s``, ``40 s``, ``3 min``, ``2.5 h``."""
    if seconds < 10:
        return f"{seconds:.0f} s"
    if seconds < 100:
        return f"{10 * round(seconds / 10):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
