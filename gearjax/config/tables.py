"""Keys and values of tables, refused with one line where they are wrong."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import tomli_w

from gearjax import units
from gearjax.checks import MISSING, Missing, ParameterError, nearest
from gearjax.config.quantities import read_quantity, read_ratio
from gearjax.parameters import Parameter


@dataclasses.dataclass(frozen=True)
class Key:
    """A key of a section that is not a part of the scene.

    Args:
        words: what may stand there: unit, bounds, names.
        example: a value, as TOML.
        default: the value without it, as TOML; empty for none.
        required: whether it must be given.
    """

    words: str
    example: str = ""
    default: str = ""
    required: bool = False


def known_keys(path: str, table: dict[str, Any], keys: Iterable[str], of: str = "") -> None:
    """Refuse a key that a section does not know.

    Raises:
        ParameterError: naming the nearest key.
    """
    for key in table:
        if key not in keys:
            raise ParameterError(f"{path}.{key}", table[key], f"unknown key{of}; {nearest(key, keys)}")


def require_keys(path: str, table: Mapping[str, Any], keys: Mapping[str, Key]) -> None:
    """Refuse a section that lacks keys which must be given; all of them are told at once.

    Args:
        path: of the section.
        table: the section.
        keys: what it may hold.

    Raises:
        ParameterError: naming the keys that are missing, and what those that may be left out are without.
    """
    lacking = [name for name, key in keys.items() if key.required and name not in table]
    if not lacking:
        return
    if len(lacking) == 1:
        raise ParameterError(f"{path}.{lacking[0]}", MISSING, f"must be given: {keys[lacking[0]].words}")
    groups: dict[str, list[str]] = {}
    for name in lacking:
        groups.setdefault(keys[name].words, []).append(name)
    told = "; ".join(f"{', '.join(names)}: {words}" for words, names in groups.items())
    defaults = [f"{name} = {key.default}" for name, key in keys.items() if key.default and name not in table]
    without = f"; may be left out: {', '.join(defaults)}" if defaults else ""
    raise ParameterError(path, Missing(len(lacking)), f"must have {told}{without}")


def in_words(parameter: Parameter) -> str:
    """What may stand for a parameter in a configuration: ``a length such as "10 um"``."""
    quoted = [f'"{name}"' for name in parameter.names]
    if parameter.kind == "count":
        return "a whole number"
    if parameter.kind == "list":
        return "a list of names"
    if parameter.kind == "name":
        return " or ".join(quoted) or "a name in quotes"
    assert parameter.dimension is not None
    example = f'"{parameter.dimension.example}"' if parameter.dimension.unit else parameter.dimension.example
    if parameter.kind == "series":
        return f"a list of {parameter.dimension.several} such as [{example}], [] for none"
    words = f"{parameter.dimension.described} such as {example}"
    if parameter.words:
        return f'{words}, or a name such as "crank"'
    return f"{', '.join(quoted)} or {words}" if quoted else words


def written(value: Any, parameter: Parameter) -> Any:
    """A number in SI as a configuration holds it, in the unit that messages show."""
    dimension = parameter.dimension
    if dimension is None or isinstance(value, str):
        return value
    if np.ndim(value):
        return [written(each, parameter) for each in value]
    return f"{float(value) / dimension.per_shown:.15g} {dimension.shown}" if dimension.unit else float(value)


def as_toml(value: Any) -> str:
    """A value as it stands to the right of a ``=``."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(as_toml, value))}]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip()


def keys_of(part: Any) -> dict[str, Key]:
    """The keys of a part of the scene (its class), from its declared fields."""
    keys = {}
    for field in dataclasses.fields(part):
        parameter = field.metadata.get("parameter")
        if parameter is None:
            continue
        required = field.default is dataclasses.MISSING
        default = "" if required or field.default is None else as_toml(written(field.default, parameter))
        keys[field.name] = Key(in_words(parameter), default=default, required=required)
    return keys


def read_whole(key: str, given: Any, low: int, high: int) -> int:
    """A whole number.

    Raises:
        ParameterError: it is none, or out of range.
    """
    if isinstance(given, bool) or not isinstance(given, int) or not low <= given <= high:
        raise ParameterError(key, given, f"must be a whole number from {low} to {high}")
    return given


def read_parameter(key: str, given: Any, parameter: Parameter) -> float:
    """A number of a declared dimension in SI; its range is not looked at.

    Raises:
        ParameterError: no number, or not of the dimension.
    """
    assert parameter.dimension is not None
    ratio = parameter.dimension is units.RATIO
    return read_ratio(key, given) if ratio else read_quantity(key, given, parameter.dimension)


def flattened(tables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Tables in tables as one table of dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in tables.items():
        flat |= flattened(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
