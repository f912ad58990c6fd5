"""Distributions from the tables of a configuration, and measured values from columns of CSV files."""

import csv
import dataclasses
import math
from pathlib import Path
from typing import Any

from gearjax import units
from gearjax.checks import MISSING, GearjaxError, ParameterError, nearest
from gearjax.config.quantities import read_quantity
from gearjax.config.tables import known_keys, read_parameter, read_whole
from gearjax.parameters import Parameter
from gearjax.tolerance import DISTRIBUTIONS, AbstractDistribution, Empirical
from gearjax.tolerance.distributions import renamed

_MOST_VALUES = 1_000_000


def read_distribution(key: str, given: dict[str, Any], parameter: Parameter, folder: Path) -> AbstractDistribution:
    """The distribution of one number.

    Args:
        key: where it stands, for messages.
        given: its table, with a ``kind``.
        parameter: declaration of the number.
        folder: that files named in it are relative to.

    Raises:
        GearjaxError: a value is wrong, or a file cannot be read.
    """
    kinds = {kind.kind: kind for kind in DISTRIBUTIONS}
    kind = given.get("kind", MISSING)
    if not isinstance(kind, str) or kind not in kinds:
        raise ParameterError(f"{key}.kind", kind, nearest(kind, kinds))
    table = {name: value for name, value in given.items() if name != "kind"}
    if kind == Empirical.kind and "file" in table:
        table = {"values": _column(key, table, parameter, folder)}
    table = renamed(kinds[kind], table)
    fields = {field.name: field for field in dataclasses.fields(kinds[kind]) if "parameter" in field.metadata}
    known_keys(key, table, fields, f' of kind "{kind}"')
    if kind == "uniform_phase" and not parameter.periodic:
        raise ParameterError(f"{key}.kind", kind, "is for angles of a whole turn")
    values = {}
    for name, field in fields.items():
        if name in table:
            values[name] = _value(f"{key}.{name}", table[name], field.metadata["parameter"], parameter)
        elif field.default is dataclasses.MISSING:
            raise ParameterError(f"{key}.{name}", MISSING, "must be given")
    try:
        return kinds[kind](**values)
    except ParameterError as fault:
        given_value = table.get(fault.key, fault.given)
        raise ParameterError(f"{key}.{fault.key}", given_value, fault.right) from fault


def _value(key: str, given: Any, declared: Parameter, leaf: Parameter) -> Any:
    if declared.kind == "name":
        if given not in declared.names:
            raise ParameterError(key, given, nearest(given, declared.names))
        return given
    if declared.kind == "count":
        assert declared.at_least is not None
        assert declared.at_most is not None
        return read_whole(key, given, int(declared.at_least), int(declared.at_most))
    own = dataclasses.replace(declared, dimension=declared.dimension or leaf.dimension)
    if declared.kind == "series":
        if not isinstance(given, list | tuple) or not given or len(given) > _MOST_VALUES:
            raise ParameterError(key, given, f"must be a list of 1 to {_MOST_VALUES} values")
        return tuple(
            v if isinstance(given, tuple) else read_parameter(f"{key}[{i}]", v, own) for i, v in enumerate(given)
        )
    return read_parameter(key, given, own)


def _column(key: str, table: dict[str, Any], parameter: Parameter, folder: Path) -> tuple[float, ...]:
    """Values of a column of a CSV file, in SI."""
    known_keys(key, table, ("file", "column", "unit"), ' of kind "empirical"')
    for name in ("file", "column"):
        if not isinstance(table.get(name), str):
            raise ParameterError(f"{key}.{name}", table.get(name, MISSING), "must be a name in quotes")
    path, column = folder / table["file"], table["column"]
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file)
            header = rows.fieldnames or []
            if column not in header:
                raise ParameterError(f"{key}.column", column, f"no column of {path}; {nearest(column, header)}")
            given = [row[column] for row in rows]
    except OSError as fault:
        raise GearjaxError(f"{key}.file: {path}: cannot be read ({fault.strerror or fault})") from fault
    except (UnicodeDecodeError, csv.Error) as fault:
        raise GearjaxError(f"{key}.file: {path}: not a CSV file in UTF-8") from fault
    if not given or len(given) > _MOST_VALUES:
        raise GearjaxError(f"{key}.file: {path}: has {len(given)} rows, must be 1 to {_MOST_VALUES}")
    assert parameter.dimension is not None
    unit = table.get("unit", parameter.dimension.unit)
    plain = parameter.dimension is units.RATIO
    size = 1.0 if plain else read_quantity(f"{key}.unit", f"1 {unit}", parameter.dimension)
    values = []
    for line, text in enumerate(given, start=2):
        try:
            value = float(text)
        except (TypeError, ValueError):
            value = math.nan
        if not math.isfinite(value):
            raise ParameterError(f"{key}.file", text, f"line {line} of {path}: must be a number")
        values.append(value * size)
    return tuple(values)
