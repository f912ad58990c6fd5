"""Columns of recordings: the column and the unit of each quantity, from the first line and a TOML file beside."""

import dataclasses
import difflib
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from gearjax import units
from gearjax.checks import GearjaxError, ParameterError, nearest, shown
from gearjax.config.quantities import read_quantity, unit_size
from gearjax.config.tables import known_keys

DIMENSIONS = {
    "time": units.TIME,
    "input angle": units.ANGLE,
    "output angle": units.ANGLE,
    "te": units.ANGLE,
    "torque": units.TORQUE,
}
ALSO = {"transmission error": "te", "t": "time", "input": "input angle", "output": "output angle", "load": "torque"}
BESIDE = ("columns", "torque", "turned", "input_counts", "output_counts", "name")
ALIKE = 0.81  # likeness of two names of which one may be the other misspelt: torqe and torque have 0.91
OF_COLUMN = ("column", "unit", "sign")
_COLUMN = re.compile(r"([^\[(]+?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?")


@dataclasses.dataclass(frozen=True)
class Column:
    """Column of a quantity in a file, and the size of its unit in SI, with the sign of the column."""

    place: int
    size: float


def beside_of(path: Path) -> dict[str, Any]:
    """Read the TOML file beside a recording; empty if there is none."""
    toml = path.with_suffix(".toml")
    if not toml.is_file():
        return {}
    try:
        table = tomllib.loads(toml.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as fault:
        raise GearjaxError(f"{toml}: cannot be read ({fault})") from fault
    if "system" in table:
        words = f"is a configuration, but beside {path.name} this name is for what its columns mean: rename one of them"
        raise GearjaxError(f"{toml}: {words}")
    known_keys(str(toml), table, BESIDE)
    for name in ("input_counts", "output_counts"):
        given = table.get(name, 1)
        if isinstance(given, bool) or not isinstance(given, int) or not 1 <= given <= 2**62:
            raise ParameterError(f"{toml}: {name}", given, "must be a whole number of counts per turn")
    if not isinstance(table.get("name", ""), str):
        raise ParameterError(f"{toml}: name", table["name"], "must be a name in quotes")
    for key in ("columns", "turned"):
        if not isinstance(table.get(key, {}), dict):
            raise ParameterError(f"{toml}: {key}", table[key], "must be a table")
    turned = {
        name: read_quantity(f"{toml}: turned.{name}", given, units.ANGLE)
        for name, given in table.get("turned", {}).items()
    }
    return table | {"turned": turned, "file": str(toml)}


def columns_of(key: str, header: list[str], beside: dict[str, Any]) -> dict[str, Column]:
    """Find the column of each quantity."""
    if len(header) == 1 and re.search("[;\t]", header[0]):
        raise GearjaxError(f"{key}: line 1: columns must be separated by commas, decimals by points")
    if header and header[0].startswith("#"):
        raise GearjaxError(f"{key}: line 1 must name the columns; it is a comment")
    plain = [_plain(text) for text in header]
    found: dict[str, Column] = {}
    for name, told in beside.get("columns", {}).items():
        where = f"{beside['file']}: columns.{name}"
        if name not in DIMENSIONS:
            raise ParameterError(where, told, nearest(name, DIMENSIONS))
        told = {"column": told} if isinstance(told, str) else told
        if not isinstance(told, dict):
            raise ParameterError(where, told, 'must be the name of a column, or {column = "...", unit = "..."}')
        known_keys(where, told, OF_COLUMN)
        names = [text.strip() for text in header]
        text = told.get("column", name)
        place = names.index(text) if text in names else plain.index(text) if text in plain else None
        if place is None:
            raise ParameterError(f"{where}.column", text, nearest(text, [*names, *plain]))
        sign = told.get("sign", 1)
        if sign not in (1, -1):
            raise ParameterError(f"{where}.sign", sign, "must be 1 or -1")
        unit = told.get("unit", _unit(header[place]))
        if unit is not None and not isinstance(unit, str):
            raise ParameterError(f"{where}.unit", unit, "must be a unit in quotes")
        found[name] = Column(place, sign * _size(where, name, unit, beside))
    for place, text in enumerate(header):
        name = ALSO.get(plain[place], plain[place])
        if name not in DIMENSIONS or any(column.place == place for column in found.values()):
            continue
        if name in found:
            if name in beside.get("columns", {}):
                continue
            raise GearjaxError(f"{key}: line 1: two columns are named {name}")
        found[name] = Column(place, _size(f"{key}: line 1: {name}", name, _unit(text), beside))
    _require(key, found, header)
    _misspelt(key, found, plain)
    return found


def _require(key: str, found: dict[str, Column], header: list[str]) -> None:
    """Refuse a table without the columns that are needed."""
    has = f"it has {', '.join(name.strip() or '(no name)' for name in header)[:200] or 'none'}"
    if "input angle" not in found:
        words = " (time cannot replace it: the speed is never constant)" if "time" in found else ""
        raise GearjaxError(f"{key}: line 1 must name a column input angle{words}; {has}")
    if "output angle" not in found and "te" not in found:
        raise GearjaxError(f"{key}: line 1 must name a column output angle, or te; {has}")


def _misspelt(key: str, found: dict[str, Column], plain: list[str]) -> None:
    """Refuse a column that would be ignored although it seems to be one that may be left out: its name is misspelt."""
    lacking = [name for name in DIMENSIONS if name not in found]
    taken = {column.place for column in found.values()}
    for place, name in enumerate(plain):
        close = [] if place in taken else difflib.get_close_matches(name[:100], lacking, n=1, cutoff=ALIKE)
        if close:
            words = f'the column {shown(name)} would be ignored; did you mean "{close[0]}"? If not, name it otherwise'
            raise GearjaxError(f"{key}: line 1: {words}")


def _plain(text: str) -> str:
    """Name of a column without its unit, in lower-case letters."""
    match = _COLUMN.fullmatch(text.strip())
    name = match[1] if match else text
    return re.sub(r"[\s_]+", " ", name).strip().lower()


def _unit(text: str) -> str | None:
    match = _COLUMN.fullmatch(text.strip())
    return match[2] if match else None


def _size(where: str, name: str, unit: str | None, beside: dict[str, Any]) -> float:
    """Size of a unit in SI; a count is a turn divided by the counts per turn of the encoder."""
    dimension = DIMENSIONS[name]
    if not unit:
        example = dimension.example.rpartition(" ")[2]
        raise GearjaxError(f"{where} needs its unit, such as {name} [{example}]")
    if unit in ("counts", "count") and name.endswith("angle"):
        counts = beside.get(f"{name.partition(' ')[0]}_counts")
        if counts is None:
            counts_key = f"{name.partition(' ')[0]}_counts"
            words = f"is in counts: give {counts_key} (counts per turn) in a TOML file of the same name"
            raise GearjaxError(f"{where} {words}")
        return 2 * np.pi / counts
    try:
        return unit_size("unit", unit, re.sub(r"(?<=\w)\s*[\s·⋅]\s*(?=\w)", "*", unit), dimension)
    except ParameterError as fault:
        raise GearjaxError(f"{where}: {fault}") from fault
