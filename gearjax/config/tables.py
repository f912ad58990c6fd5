"""Reading of keys and values from tables. A wrong key or value is refused with a message of one line."""

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
    """A key of a section that does not describe a part of the scene, such as the run section.

    Args:
        words: what values are allowed: unit, bounds, names.
        example: an example value, as TOML.
        default: the value that counts if the key is left out, as TOML; empty if there is none.
        required: whether the key must be given.
    """

    words: str
    example: str = ""
    default: str = ""
    required: bool = False


def known_keys(path: str, table: dict[str, Any], keys: Iterable[str], of: str = "") -> None:
    """Refuse a key that the section does not have.

    Raises:
        ParameterError: a key is unknown; the message names the nearest known key.
    """
    for key in table:
        if key not in keys:
            raise ParameterError(f"{path}.{key}", table[key], f"unknown key{of}; {nearest(key, keys)}")


def require_keys(path: str, table: Mapping[str, Any], keys: Mapping[str, Key]) -> None:
    """Refuse a section that lacks required keys; one message names all of them.

    Args:
        path: path of the section.
        table: the section.
        keys: the keys that the section may have.

    Raises:
        ParameterError: required keys are missing. The message names them; if there are several, it also names the
            defaults of the optional keys that are not given.
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


def in_words(parameter: Parameter, *, own_example: bool = False) -> str:
    """What a configuration may give for a parameter, in words: ``a length such as "10 um"``.

    Args:
        parameter: the parameter.
        own_example: whether the example is that of the parameter, not that of its dimension, which several share.
    """
    quoted = [f'"{name}"' for name in parameter.names]
    if parameter.kind == "count":
        return "a whole number"
    if parameter.kind == "counts":
        return "a list of whole numbers"
    if parameter.kind == "list":
        return "a list of names"
    if parameter.kind == "name":
        return " or ".join(quoted) or "a name in quotes"
    assert parameter.dimension is not None
    own = own_example and parameter.example is not None and parameter.kind != "series"
    shown = parameter.example if own else parameter.dimension.example
    example = f'"{shown}"' if parameter.dimension.unit else shown
    if parameter.kind == "series":
        return f"a list of {parameter.dimension.several} such as [{example}], [] for none"
    words = f"{parameter.dimension.described} such as {example}"
    if parameter.words:
        return f'{words}, or a name such as "crank"'
    return f"{', '.join(quoted)} or {words}" if quoted else words


def written(value: Any, parameter: Parameter) -> Any:
    """Convert a number in SI to the form of a configuration, in the unit that messages show."""
    dimension = parameter.dimension
    if dimension is None or isinstance(value, str):
        return value
    if np.ndim(value):
        return [written(each, parameter) for each in value]
    return f"{float(value) / dimension.per_shown:.15g} {dimension.shown}" if dimension.unit else float(value)


def as_toml(value: Any) -> str:
    """A value as TOML text, as it stands to the right of a ``=``."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(as_toml, value))}]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip()


def keys_of(part: Any) -> dict[str, Key]:
    """The keys of a part of the scene, from the declared fields of its class."""
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
    """Read a whole number.

    Raises:
        ParameterError: the value is not a whole number, or is out of range.
    """
    if isinstance(given, bool) or not isinstance(given, int) or not low <= given <= high:
        raise ParameterError(key, given, f"must be a whole number from {low} to {high}")
    return given


def read_parameter(key: str, given: Any, parameter: Parameter) -> float:
    """Read a number of a declared dimension in SI; the range of the number is not checked.

    Raises:
        ParameterError: the value is not a number, or does not have the dimension.
    """
    assert parameter.dimension is not None
    ratio = parameter.dimension is units.RATIO
    return read_ratio(key, given) if ratio else read_quantity(key, given, parameter.dimension)


def flattened(tables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one table with dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in tables.items():
        flat |= flattened(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
