"""Errors that a user's mistake raises: one line that says what is wrong, where, and what would be right."""

import difflib
from collections.abc import Iterable

import jax
import numpy as np
from jax.core import Tracer

_SHOWN = 40  # characters of a given value that an error repeats


class GearjaxError(ValueError):
    """A mistake in what was asked for. Its message is one line."""


class ParameterError(GearjaxError):
    """A parameter has a value that it cannot have.

    Args:
        key: where, as a dotted path such as ``errors.planet_1.amplitude``.
        given: what was given.
        right: what would be right.
    """

    def __init__(self, key: str, given: object, right: str):
        self.key, self.given, self.right = key, given, right
        super().__init__(f"{key} = {shown(given)}: {right}")

    def under(self, path: str) -> "ParameterError":
        """The same error one level further out in the configuration."""
        return ParameterError(f"{path}.{self.key}", self.given, self.right)


class SceneError(GearjaxError):
    """An analysis was asked for that the scene, as listed, does not allow."""


def shown(value: object) -> str:
    """A value as an error repeats it: one short line."""
    if isinstance(value, str):
        text = '"' + value[: 2 * _SHOWN].replace("\n", " ").replace("\r", " ") + '"'
        long = len(value) > _SHOWN
    elif isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 64:
        return f"(an integer of {value.bit_length()} bits)"
    elif isinstance(value, (dict, list, tuple)) and len(value) > 8:
        return f"(a {type(value).__name__} of {len(value)})"
    elif isinstance(value, (float, np.ndarray, jax.Array)) and np.ndim(value) == 0:
        text, long = f"{float(value):.12g}", False
    else:
        text = str(value).replace("\n", " ")
        long = len(text) > _SHOWN
    return text[:_SHOWN] + f"... ({len(str(value))} characters)" if long else text


def nearest(name: str, names: Iterable[str]) -> str:
    """``did you mean "x"? valid: a, b`` for a name that is not among ``names``."""
    names = list(names)
    close = difflib.get_close_matches(str(name)[:100], names, n=1, cutoff=0.5)
    hint = f'did you mean "{close[0]}"? ' if close else ""
    return f"{hint}valid: {', '.join(names) if names else '(none)'}"


def is_concrete(value: object) -> bool:
    """Whether the numbers of ``value`` are known now (not while tracing)."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))
