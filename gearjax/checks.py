"""Errors for mistakes of the user: each message is one line that says what is wrong, where, and what would be right."""

import contextlib
import difflib
import itertools
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

CALLED_THROUGH = (
    "gearjax",
    "equinox",
    "jax",
    "jaxlib",
    "beartype",
    "jaxtyping",
    "dataclasses",
    "functools",
)
_LONGEST_KEY = 100
_SHOWN = 40  # characters of a given value that an error repeats
_NAME = re.compile(r"[^\W\d_][\w-]*")
_MOST_NAMES = 210  # characters of names that an error lists


class GearjaxError(ValueError):
    """A mistake of the user. Its message is one line of printable characters, so that it cannot disturb a terminal."""

    def __init__(self, message: str):
        super().__init__(_clean(message))


class ParameterError(GearjaxError):
    """A parameter has a value that is not allowed.

    Args:
        key: place of the parameter, as a dotted path such as ``errors.planet_1.amplitude``.
        given: value that was given.
        right: description of a right value.
    """

    def __init__(self, key: str, given: object, right: str):
        self.key, self.given, self.right = key, given, right
        super().__init__(f"{key[:_LONGEST_KEY]} = {shown(given)}: {right}")


class MissingExtraError(GearjaxError):
    """The request needs a package that is installed only with an optional extra of gearjax."""


class FewCandidates(UserWarning):
    """There are too few candidate contacts.

    Further teeth would carry load, or there are fewer candidates than finite elements along the profile, so that forces
    act on single nodes.
    """


class RepairedData(UserWarning):
    """Measured data have gaps, which were filled in, or values that do not fit their neighbours."""


class SceneError(GearjaxError):
    """The scene, as it is listed, does not allow the analysis."""


def shown(value: object) -> str:
    """The value as an error message repeats it: one short line."""
    if isinstance(value, str):
        return _clean(f'"{value[:_SHOWN]}"') + (f"... ({len(value)} characters)" if len(value) > _SHOWN else "")
    if isinstance(value, (dict, list, tuple)) and len(value) > 8:
        return f"(a {type(value).__name__} of {len(value)})"
    if isinstance(value, (np.ndarray, np.floating, jax.Array)) and np.ndim(value) == 0:
        with contextlib.suppress(TypeError, ValueError):  # a complex number, a key of random numbers, a word
            return f"{float(value):.12g}"
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, tables in tables
        return f"(a {type(value).__name__} too large to show)"
    return _clean(text[:_SHOWN]) + (f"... ({len(text)} characters)" if len(text) > _SHOWN else "")


def _clean(text: str) -> str:
    """The text with a space in place of each character that is not printable, such as a line break."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def check_name(key: str, name: object) -> None:
    """Refuse a name that cannot stand in a path such as ``errors.NAME.amplitude``.

    Raises:
        ParameterError: the name breaks the rule, which the message states.
    """
    if not isinstance(name, str) or len(name) > _SHOWN or not _NAME.fullmatch(name):
        right = f"a name begins with a letter and has at most {_SHOWN} characters: letters, digits, _ and -"
        raise ParameterError(key, name, right)


def check_path(key: str, path: str | Path) -> None:
    """Refuse a path that no file system accepts.

    Raises:
        ParameterError: the path has a character NUL; the message names the key.
    """
    if "\0" in str(path):
        raise ParameterError(key, str(path), "a file name has no character NUL")


def nearest(name: object, names: Iterable[str]) -> str:
    """The hint ``did you mean "x"? valid: a, b`` for a name that is not among ``names``.

    The entries of a series are abbreviated, such as ``a[0..2]``.
    """
    names = list(names)
    close = difflib.get_close_matches(name[:100], names, n=1, cutoff=0.5) if isinstance(name, str) else []
    hint = f'did you mean "{close[0]}"? ' if close else ""
    if isinstance(name, int | float) and abs(name) < 1e9 and str(name) in names:  # longer ones may have no text
        hint = f'did you mean "{name}", in quotes? '
    told, entries = "", list(_told(names))
    for place, entry in enumerate(entries):
        if len(told) + len(entry) > _MOST_NAMES:
            return f"{hint}valid: {told} and {len(entries) - place} more"
        told += f", {entry}" if told else entry
    return f"{hint}valid: {told or '(none)'}"


def _told(names: Sequence[str]) -> Iterator[str]:
    """The names, with a series such as ``a[0]``, ``a[1]``, ``a[2]`` abbreviated to ``a[0..2]``."""
    for stem, group in itertools.groupby(names, lambda name: name[: name.rfind("[")] if name[-1:] == "]" else name):
        members = list(group)
        if len(members) > 2 and members == [f"{stem}[{index}]" for index in range(len(members))]:
            yield f"{stem}[0..{len(members) - 1}]"
        else:
            yield from members


@contextlib.contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """A context in which the user's ``--out`` is written: a failure of the file system becomes a one-line error.

    Raises:
        GearjaxError: a file cannot be written; the message names the path.
    """
    check_path("--out", path)
    try:
        yield
    except OSError as fault:
        raise GearjaxError(f"--out {place(path)}: cannot be written ({fault.strerror or fault})") from fault


def place(path: str | Path) -> str:
    """The path as an error message repeats it: one short line."""
    text = _clean(str(path))
    return text if len(text) <= _LONGEST_KEY else f"{text[:_SHOWN]}... ({len(text)} characters)"


class Missing:
    """Placeholder in an error message for one or several values that were not given."""

    def __init__(self, number: int = 1):
        self.number = number

    def __repr__(self) -> str:
        return "(missing)" if self.number == 1 else f"({self.number} keys missing)"


MISSING = Missing()


def with_article(name: str) -> str:
    """A name after its article: ``an elliptic_pair``, ``a two_kv``, ``an rv_cycloidal``."""
    return f"{'an' if name[0] in 'aeio' or name.startswith('rv') else 'a'} {name}"


def is_concrete(value: object) -> bool:
    """Whether the numbers of ``value`` are known now, that is, whether none of them is traced."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))


def warn_the_caller(words: str, category: type[Warning]) -> None:
    """Warn at the line of the caller: the first one outside gearjax and the packages through which it calls itself."""
    frame, level = sys._getframe(1), 2
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in CALLED_THROUGH:
        frame, level = frame.f_back, level + 1
    warnings.warn(words, category, stacklevel=level)


def one_angle(name: str, value: Any, dtype: Any) -> jax.Array:
    """A value as one finite angle, an array of the given dtype; a traced one passes.

    Raises:
        ParameterError: the value is something else.
    """
    right = "must be one finite angle in rad"
    if not is_concrete(value):
        array = jnp.asarray(value)
        if array.ndim or jnp.iscomplexobj(array) or array.dtype == bool:
            raise ParameterError(name, f"shape {array.shape}, {array.dtype}", right)
        return array.astype(dtype)
    try:
        given = np.asarray(value)
    except (ValueError, TypeError) as fault:  # rows of different lengths
        raise ParameterError(name, value, right) from fault
    real = given.dtype.kind in "iuf" or jnp.issubdtype(given.dtype, jnp.floating)
    if not real or given.ndim or not np.isfinite(given):
        raise ParameterError(name, value, right)
    return value if isinstance(value, jax.Array) and value.dtype == dtype else jnp.asarray(given, dtype)


def is_batched(value: object) -> bool:
    """Whether ``value`` is being traced for a batch by ``jax.vmap``, as far as its tracers show.

    JAX has no public function for this, and a ``jit`` in between hides the batch. The answer may therefore only choose
    the faster of two equivalent programs.
    """

    def batched(leaf: object) -> bool:
        inner = getattr(leaf, "primal", None)  # a tracer of a derivative wraps its primal value
        return type(leaf).__name__ == "BatchTracer" or (inner is not None and batched(inner))

    return any(batched(leaf) for leaf in jax.tree.leaves(value))
