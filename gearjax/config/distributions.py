"""Reading of distributions from the tables of a configuration, and of measured values from columns of CSV files."""

import dataclasses
from pathlib import Path
from typing import Any

from gearjax.checks import MISSING, ParameterError, check_path, nearest
from gearjax.config.csv_files import MOST_ROWS, read_rows
from gearjax.config.quantities import unit_size
from gearjax.config.tables import Key, as_toml, in_words, known_keys, read_parameter, read_whole, require_keys
from gearjax.parameters import Parameter
from gearjax.tolerance import DISTRIBUTIONS, AbstractDistribution, Empirical
from gearjax.tolerance.distributions import renamed

COLUMN_KEYS = {
    "file": Key("the name of a CSV file in quotes", '"measured.csv"', required=True),
    "column": Key("the name of a column in quotes", '"run_out"', required=True),
    "unit": Key('a unit in quotes, such as "um"; if left out, the SI unit', '"um"'),
}


def read_distribution(key: str, given: dict[str, Any], parameter: Parameter, folder: Path) -> AbstractDistribution:
    """Read the distribution of one number.

    Args:
        key: path of the table in the configuration, for messages.
        given: table of the distribution, with a ``kind``.
        parameter: declaration of the number.
        folder: folder to which file names in the table are relative.

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
        raise ParameterError(f"{key}.kind", kind, "is only for angles with a period of one turn")
    values = {}
    require_keys(key, table, distribution_keys(kinds[kind], parameter))
    for name in table:
        values[name] = _value(f"{key}.{name}", table[name], fields[name].metadata["parameter"], parameter)
    try:
        return kinds[kind](**values)
    except ParameterError as fault:
        given_value = table.get(fault.key, fault.given)
        raise ParameterError(f"{key}.{fault.key}", given_value, fault.right) from fault


def distribution_keys(kind: type[AbstractDistribution], parameter: Parameter) -> dict[str, Key]:
    """The keys of a kind of distribution, for a number with the given declaration."""
    keys = {}
    for field in dataclasses.fields(kind):
        if "parameter" in field.metadata:
            declared = field.metadata["parameter"]
            own = dataclasses.replace(declared, dimension=declared.dimension or parameter.dimension)
            required = field.default is dataclasses.MISSING
            keys[field.name] = Key(
                in_words(own, own_example=True), default="" if required else as_toml(field.default), required=required
            )
    return keys


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
        if not isinstance(given, list | tuple) or not given or len(given) > MOST_ROWS:
            raise ParameterError(key, given, f"must be a list of 1 to {MOST_ROWS} values")
        return tuple(
            v if isinstance(given, tuple) else read_parameter(f"{key}[{i}]", v, own) for i, v in enumerate(given)
        )
    return read_parameter(key, given, own)


def _column(key: str, table: dict[str, Any], parameter: Parameter, folder: Path) -> tuple[float, ...]:
    """Read the values of a column of a CSV file, in SI."""
    known_keys(key, table, COLUMN_KEYS, ' of kind "empirical"')
    require_keys(key, table, COLUMN_KEYS)
    for name in table:
        if not isinstance(table[name], str):
            raise ParameterError(f"{key}.{name}", table[name], f"must be {COLUMN_KEYS[name].words}")
    dimension = parameter.dimension
    assert dimension is not None
    size = 1.0
    if "unit" in table and (table["unit"].strip() or dimension.unit):
        size = unit_size(f"{key}.unit", table["unit"], table["unit"], dimension)
    check_path(f"{key}.file", table["file"])
    path = folder / table["file"]
    return tuple(size * value for value in _numbers(f"{key}.file", path, f"{key}.column", table["column"]))


def _numbers(key: str, path: Path, column_key: str, column: str) -> list[float]:
    """Read the numbers in one column of a CSV file."""
    header, rows = read_rows(key, path)
    if header.count(column) != 1:
        how_many = "two columns or more" if column in header else f"none of the {len(header)} columns"
        raise ParameterError(column_key, column, f"{how_many} in line 1 of {path} have this name, must be one")
    place = header.index(column)
    return [row.number(place) for row in rows]
