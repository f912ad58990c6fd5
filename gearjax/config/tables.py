"""Keys and values of tables, refused with one line where they are wrong."""

from collections.abc import Iterable
from typing import Any

from gearjax import units
from gearjax.checks import ParameterError, nearest
from gearjax.config.quantities import read_plain, read_quantity
from gearjax.parameters import Parameter


def known_keys(path: str, table: dict[str, Any], keys: Iterable[str], of: str = "") -> None:
    """Refuse a key that a section does not know.

    Raises:
        ParameterError: naming the nearest key.
    """
    for key in table:
        if key not in keys:
            raise ParameterError(f"{path}.{key}", table[key], f"unknown key{of}; {nearest(key, keys)}")


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
    plain = parameter.dimension is units.RATIO
    return read_plain(key, given) if plain else read_quantity(key, given, parameter.dimension)


def flattened(tables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Tables in tables as one table of dotted keys."""
    found: dict[str, Any] = {}
    for key, value in tables.items():
        found |= flattened(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found
