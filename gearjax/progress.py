"""Progress of long computations, as lines of text."""

import time
from collections.abc import Callable

Progress = Callable[[str], None]
EVERY = 5.0  # seconds between two lines of a search
SURE = 0.1  # share of the parts after which the time for the rest is told


def silent(words: str) -> None:
    """Ignore a line of progress: the default if no progress is wanted."""
    del words


class Left:
    """How long a computation of known parts still takes, from the time that its parts took so far.

    Args:
        parts: number of parts, or their whole work in any unit.
        sure: ``about``, or ``at most`` if fewer parts may do.
    """

    def __init__(self, parts: float | int, sure: str = "about"):
        self.parts, self.done, self._sure = parts, 0.0, sure
        self._took, self._last = 0.0, time.perf_counter()

    def after(self, parts: float | int = 1, took: float | None = None) -> str:
        """Words such as ``, about 40 s left``, after further parts are done; none at first and near the end.

        Args:
            parts: what is done now.
            took: the time that it took [s]; by default the time since the last call. Parts that are done at once have
                each a time of their own, as those that are not done yet are no reason to expect more.
        """
        now = time.perf_counter()
        self._took += now - self._last if took is None else took
        self._last, self.done = now, self.done + parts
        if self.done < SURE * self.parts:
            return ""
        rest = self._took / self.done * (self.parts - self.done)
        return "" if rest < 1.0 else f", {self._sure} {told_seconds(rest)} left"


class Seldom:
    """Lines of progress at most every `EVERY` seconds: others are left out.

    Args:
        progress: called with the lines that are not left out.
    """

    def __init__(self, progress: Progress):
        self._progress, self._said = progress, time.monotonic()

    def __call__(self, words: str) -> None:
        """Pass a line on, or leave it out."""
        if time.monotonic() - self._said > EVERY:
            self._said = time.monotonic()
            self._progress(words)


class Searching:
    """Lines of a search whose evaluations take long; how many it needs is known from experience only.

    Args:
        progress: called with a line now and then.
        words: what was evaluated, such as ``motions integrated``.
        usual: number of evaluations that such a search usually takes.
    """

    def __init__(self, progress: Progress, words: str, usual: int):
        self._progress, self._words, self._usual = progress, words, usual
        self._left: Left | None = None

    def __call__(self, evaluations: int) -> None:
        """Count further evaluations; the first ones also compile, so that their time says nothing on the rest."""
        if self._left is None:
            self._left, self._first, self._said = Left(max(self._usual - evaluations, 1)), evaluations, time.monotonic()
            return
        rest = self._left.after(evaluations)
        if time.monotonic() - self._said > EVERY:
            self._said = time.monotonic()
            self._progress(f"{self._first + self._left.done:.0f} {self._words}{rest}")


def told_seconds(seconds: float | int) -> str:
    """A time as it is told: ``7 s``, ``40 s``, ``3 min``, ``2.5 h``."""
    if seconds < 10:
        return f"{seconds:.0f} s"
    if seconds < 100:
        return f"{10 * round(seconds / 10):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
