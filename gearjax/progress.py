"""Lines of text that tell how far long work has come."""

from collections.abc import Callable

Progress = Callable[[str], None]


def silent(words: str) -> None:
    """Progress that nobody asked for."""
    del words
