"""Progress of long computations, as lines of text."""

from collections.abc import Callable

Progress = Callable[[str], None]


def silent(words: str) -> None:
    """Ignore a line of progress: the default if no progress is wanted."""
    del words
