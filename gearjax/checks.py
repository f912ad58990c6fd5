"""Errors that a user's mistake raises: one line that says what is wrong, where, and what would be right."""

import contextlib
import difflib
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from jax.core import Tracer

_LONGEST_KEY = 100
_SHOWN = 40  # characters of a given value that an error repeats
_NAME = re.compile(r"[^\W\d_][\w-]*")
_MOST_NAMES = 210  # characters of names that an error lists


class GearjaxError(ValueError):
    """A mistake in what was asked for. Its message is one line, without what would break a terminal."""

    def __init__(self, message: str):
        super().__init__(_clean(message))


class ParameterError(GearjaxError):
    """A parameter has a value that it cannot have.

    Args:
        key: where, as a dotted path such as ``errors.planet_1.amplitude``.
        given: what was given.
        right: what would be right.
    """

    def __init__(self, key: str, given: object, right: str):
        self.key, self.given, self.right = key, given, right
        super().__init__(f"{key[:_LONGEST_KEY]} = {shown(given)}: {right}")


class MissingExtraError(GearjaxError):
    """What was asked for needs a package that comes with an extra of gearjax."""


class FewCandidates(UserWarning):
    """Candidates are too few: more teeth would carry, or forces on single nodes tell of finite elements."""


class RepairedData(UserWarning):
    """Measured data have gaps, which were filled in, or values that do not go with their neighbours."""


class SceneError(GearjaxError):
    """An analysis was asked for that the scene, as listed, does not allow."""


def shown(value: object) -> str:
    """A value as an error repeats it: one short line."""
    if isinstance(value, str):
        return _clean(f'"{value[:_SHOWN]}"') + (f"... ({len(value)} characters)" if len(value) > _SHOWN else "")
    if isinstance(value, (dict, list, tuple)) and len(value) > 8:
        return f"(a {type(value).__name__} of {len(value)})"
    if isinstance(value, (np.ndarray, np.floating, jax.Array)) and np.ndim(value) == 0:
        return f"{float(value):.12g}"
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, tables in tables
        return f"(a {type(value).__name__} too large to show)"
    return _clean(text[:_SHOWN]) + (f"... ({len(text)} characters)" if len(text) > _SHOWN else "")


def _clean(text: str) -> str:
    """The text without what would break a line or a terminal."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def check_name(key: str, name: object) -> None:
    """Refuse a name that paths such as ``errors.NAME.amplitude`` cannot lead to.

    Raises:
        ParameterError: naming the rule.
    """
    if not isinstance(name, str) or len(name) > _SHOWN or not _NAME.fullmatch(name):
        right = f"a name is of letters, digits, _ and -, begins with a letter and has at most {_SHOWN} of them"
        raise ParameterError(key, name, right)


def check_path(key: str, path: str | Path) -> None:
    """Refuse a path that no file system takes.

    Raises:
        ParameterError: naming the key.
    """
    if "\0" in str(path):
        raise ParameterError(key, str(path), "a file name has no character NUL")


def nearest(name: object, names: Iterable[str]) -> str:
    """``did you mean "x"? valid: a, b`` for a name that is not among ``names``;
    the entries of a series are told together."""
    names = list(names)
    close = difflib.get_close_matches(name[:100], names, n=1, cutoff=0.5) if isinstance(name, str) else []
    hint = f'did you mean "{close[0]}"? ' if close else ""
    told, entries = "", list(_told(names))
    for place, entry in enumerate(entries):
        if len(told) + len(entry) > _MOST_NAMES:
            return f"{hint}valid: {told} and {len(entries) - place} more"
        told += f", {entry}" if told else entry
    return f"{hint}valid: {told or '(none)'}"


def _told(names: Sequence[str]) -> Iterator[str]:
    """Names, those of a series such as ``a[0]``, ``a[1]``, ``a[2]`` as ``a[0..2]``."""
    for stem, group in itertools.groupby(names, lambda name: name[: name.rfind("[")] if name[-1:] == "]" else name):
        members = list(group)
        if len(members) > 2 and members == [f"{stem}[{index}]" for index in range(len(members))]:
            yield f"{stem}[0..{len(members) - 1}]"
        else:
            yield from members


@contextlib.contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Files written in the block are the user's ``--out``: what goes wrong there is a mistake of one line.

    Raises:
        GearjaxError: naming the path.
    """
    check_path("--out", path)
    try:
        yield
    except OSError as fault:
        raise GearjaxError(f"--out {place(path)}: cannot be written ({fault.strerror or fault})") from fault


def place(path: str | Path) -> str:
    """A path as an error repeats it: one short line."""
    text = _clean(str(path))
    return text if len(text) <= _LONGEST_KEY else f"{text[:_SHOWN]}... ({len(text)} characters)"


class Missing:
    """Stands for a value that was not given, or for several."""

    def __init__(self, number: int = 1):
        self.number = number

    def __repr__(self) -> str:
        return "(missing)" if self.number == 1 else f"({self.number} keys missing)"


MISSING = Missing()


def is_concrete(value: object) -> bool:
    """Whether the numbers of ``value`` are known now (not while tracing)."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))


def is_batched(value: object) -> bool:
    """Whether ``value`` is being traced for a batch by ``jax.vmap``, as far as its tracers tell: a hint of what is
    fast, since JAX has no public word for it and a ``jit`` in between hides it."""

    def batched(leaf: object) -> bool:
        inner = getattr(leaf, "primal", None)  # of what is differentiated
        return type(leaf).__name__ == "BatchTracer" or (inner is not None and batched(inner))

    return any(batched(leaf) for leaf in jax.tree.leaves(value))
