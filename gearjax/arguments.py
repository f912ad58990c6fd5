"""Checks of the arguments of public functions: a wrong one is refused by a one-line error before anything is computed.

`checked` chooses the check of an argument by the argument's name, so that ``scene``, ``theta`` and ``torque`` mean the
same everywhere. Traced values pass, because they cannot be read.
"""

import functools
import inspect
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError, SceneError, is_concrete
from gearjax.scene import Scene

P = ParamSpec("P")
R = TypeVar("R")
Checker = Callable[[str, Any], None]

LARGEST_TORQUE = 1e12  # N m, as in a configuration
LARGEST_ANGLE = 1e12  # rad: beyond it, float64 no longer resolves the parts of a tooth
DEGREES = 4 * math.pi  # rad: angles over a longer span, in steps of whole numbers, are taken for degrees


def checked(**special: Checker) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator that checks the arguments of a function by their names.

    An argument that is left at its default is not checked.

    Args:
        special: checkers by name, for arguments that mean something else here than in `KNOWN`.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        parameters = inspect.signature(function).parameters
        checkers = {name: check for name, check in (KNOWN | special).items() if name in parameters}

        @functools.wraps(function)
        def checking(*args: P.args, **kwargs: P.kwargs) -> R:
            given = dict(zip(parameters, args, strict=False)) | kwargs
            for name, check in checkers.items():
                if name in given and given[name] is not parameters[name].default:
                    check(name, given[name])
            return function(*args, **kwargs)

        return checking

    return decorate


def a_scene(name: str, value: Any) -> None:
    """Refuse a value that is not a scene."""
    if not isinstance(value, Scene):
        is_path = isinstance(value, str | Path)
        words = "is a path: give gj.load(path)" if is_path else "must be a Scene, such as gj.load(path)"
        raise ParameterError(name, str(value) if is_path else value, words)


def real(name: str, value: Any, words: str = "must be a real number, or an array of them") -> np.ndarray | None:
    """The value as an array of real numbers; ``None`` while it is traced.

    Raises:
        ParameterError: the value is something else.
    """
    if not is_concrete(value):
        if any(jnp.iscomplexobj(leaf) for leaf in jax.tree.leaves(value)):
            raise ParameterError(name, "complex numbers", words)
        return None
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as fault:  # rows of different lengths
        raise ParameterError(name, value, words) from fault
    if array.dtype.kind not in "iuf" and not jnp.issubdtype(array.dtype, jnp.floating):
        raise ParameterError(name, value, words)
    return array


def finite(name: str, value: Any) -> np.ndarray | None:
    """The value as an array of finite real numbers, of any shape; ``None`` while it is traced."""
    array = real(name, value)
    if array is not None and not np.isfinite(array).all():
        place = np.argwhere(~np.isfinite(array))[0]
        where = name + "".join(f"[{index}]" for index in place)
        raise ParameterError(where, array[tuple(place)], "must be finite")
    return array


def numbers(name: str, value: Any) -> None:
    """Refuse anything but finite numbers, of any shape."""
    finite(name, value)


def one_number(name: str, value: Any) -> None:
    """Refuse anything but one finite number."""
    array = finite(name, value)
    if array is not None and array.ndim:
        raise ParameterError(name, array.shape, "is a shape: must be one number")


def positive(name: str, value: Any) -> None:
    """Refuse anything but finite numbers above zero."""
    array = finite(name, value)
    if array is not None and not (array > 0).all():
        raise ParameterError(name, array.min() if array.size else value, "must be above 0")


def one_positive(name: str, value: Any) -> None:
    """Refuse anything but one finite number above zero."""
    one_number(name, value)
    positive(name, value)


def torques(name: str, value: Any) -> None:
    """Refuse anything but torques [N m], of any shape."""
    array = finite(name, value)
    largest = float(np.abs(array).max(initial=0.0)) if array is not None else 0.0  # the limit is beyond float16
    if largest > LARGEST_TORQUE:
        raise ParameterError(name, largest, f"must be at most {LARGEST_TORQUE:g} N*m")


def torque(name: str, value: Any) -> None:
    """Refuse anything but one torque [N m]."""
    one_number(name, value)
    torques(name, value)


def positive_torque(name: str, value: Any) -> None:
    """Refuse anything but one torque above zero [N m]."""
    torque(name, value)
    positive(name, value)


def angles(name: str, value: Any) -> None:
    """Refuse anything but increasing angles, shape (n,) [rad]; warn if they look like degrees."""
    _increasing(name, value, 1, "give input angles of shape (n,)")
    if not is_concrete(value):
        return
    array = np.asarray(value, dtype=float)
    if np.abs(array).max() > LARGEST_ANGLE:
        raise ParameterError(name, np.abs(array).max(), f"must be at most {LARGEST_ANGLE:g} rad")
    steps = np.diff(array)
    long = steps.size and steps.min() > 0.5 and array[-1] - array[0] > DEGREES
    if long and np.allclose(steps, np.round(steps), rtol=0, atol=1e-6):
        warnings.warn(
            f"{name} runs from {array[0]:g} to {array[-1]:g} in whole steps, but it is in radians: give degrees "
            f"as {name} * gj.units.deg",
            stacklevel=3,
        )


def times(name: str, value: Any) -> None:
    """Refuse anything but at least two increasing times, shape (n,) [s]."""
    _increasing(name, value, 2, "give at least two sample times")


def _increasing(name: str, value: Any, least: int, words: str) -> None:
    array = finite(name, value)
    shape = np.shape(value) if array is None else array.shape
    if len(shape) != 1 or shape[0] < least:
        raise SceneError(f"{name} has shape {shape}: {words}")
    if array is not None and not (np.diff(array.astype(float)) > 0).all():
        raise SceneError(f"{name} must increase")


def whole(least: int) -> Checker:
    """A checker of whole numbers that are at least ``least``."""

    def check(name: str, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise ParameterError(name, value, f"must be a whole number, at least {least}")
        if value < least:
            raise ParameterError(name, value, f"must be at least {least}")

    return check


def a_key(name: str, value: Any) -> None:
    """Refuse anything but a seed, or a random key of JAX."""
    if isinstance(value, jax.Array):
        return
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise ParameterError(name, value, "must be a whole number, at least 0, or a key such as jax.random.key(0)")


def a_share(name: str, value: Any) -> None:
    """Refuse anything but one number above 0 and below 1."""
    one_number(name, value)
    number = real(name, value)
    if number is not None and not 0 < float(number) < 1:
        raise ParameterError(name, value, "must be above 0 and below 1")


def deviations(name: str, value: Any) -> None:
    """Refuse anything but at least one finite number."""
    array = finite(name, value)
    if array is not None and not array.size:
        raise ParameterError(name, value, "must be at least one deviation")


def turn(name: str, value: Any) -> None:
    """Refuse anything but the angle of one turn [rad]."""
    one_positive(name, value)
    number = real(name, value)
    if number is not None and not 1e-9 <= float(number) <= 1e9:
        raise ParameterError(name, value, "must be at least 1e-9 rad and at most 1e9 rad")


def starts(name: str, value: Any) -> None:
    """Refuse anything but a number of starts, or the starting points.

    Points that are not finite pass; the search drops and counts them.
    """
    if np.ndim(value) == 0:
        whole(1)(name, value)
    else:
        real(name, value)


def paths(name: str, value: Any) -> None:
    """Refuse anything but paths of numbers of a scene, or a function that picks such numbers."""
    several = isinstance(value, Sequence) and all(isinstance(path, str) for path in value)
    if not (callable(value) or several):
        raise ParameterError(name, value, 'must be paths such as ["errors.planet_1.phase"], or a function of the scene')


def pairs(name: str, value: Any) -> None:
    """Refuse anything but a pair of bounds for each path: lowest and highest value."""
    if not isinstance(value, Mapping):
        raise ParameterError(name, value, 'must be pairs by path: {"errors.planet_1.amplitude": (0.0, 20e-6)}')
    for path, pair in value.items():
        bounds = real(f"{name} of {path}", pair, "must be a pair of numbers, lowest first")
        if bounds is not None and (bounds.shape != (2,) or not bounds[0] <= bounds[1]):
            raise ParameterError(f"{name} of {path}", pair, "must be a pair of numbers, lowest first")


def spacing(name: str, value: Any) -> None:
    """Refuse anything but one spacing for all numbers, or one for each path."""
    for path, step in value.items() if isinstance(value, Mapping) else [("", value)]:
        one_number(f"{name} of {path}" if path else name, step)


def a_result(name: str, value: Any, words: str = "") -> Any:
    """The result of a user's function, an array or the shape of one, if it is one real number."""
    kind = getattr(value, "dtype", np.result_type(value) if isinstance(value, int | float) else None)
    returned = ""
    if kind is None:
        returned = "None" if value is None else type(value).__name__
    elif jnp.issubdtype(kind, jnp.complexfloating):
        returned = "complex number"
    elif shape := getattr(value, "shape", ()):
        returned = f"array of shape {shape}"
    if returned:
        raise ParameterError(name, returned, f"is what the function returns, must be one real number{words}")
    return value


def a_loss(name: str, value: Any) -> None:
    """Refuse anything but the name of an objective, terms, or a function of the scene."""
    terms = value if isinstance(value, Sequence) else [value]  # their classes are of a higher layer
    known = all(hasattr(term, "analysis") or hasattr(term, "pieces") for term in terms)
    if not (isinstance(value, str) or callable(value) or known):
        raise ParameterError(name, value, 'must be a name ("no_load_amplitude"), terms, or a function of the scene')


def an(kind: type | tuple[type, ...], words: str) -> Checker:
    """A checker of instances of a type."""

    def check(name: str, value: Any) -> None:
        if not isinstance(value, kind):
            raise ParameterError(name, value, words)

    return check


KNOWN: dict[str, Checker] = {
    "scene": a_scene,
    "theta": angles,
    "ts": times,
    "torque": torque,
    "torques": torques,
    "rated_torque": torque,
    "settle": one_number,
    "period": one_positive,
    "speeds": positive,
    "guess": numbers,
    "steps": whole(0),
    "max_steps": whole(1),
    "where": paths,
    "bounds": pairs,
    "loss": a_loss,
    "at": numbers,
    "deviations": deviations,
    "key": whole(0),
}
"""The checker of each argument name, the same in all functions."""
