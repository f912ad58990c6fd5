"""Files of measuring machines: flank deviations on a grid, and pitch deviations tooth by tooth."""

import dataclasses
import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gearjax import units
from gearjax.checks import GearjaxError, ParameterError, RepairedData, check_path, nearest
from gearjax.config.csv_files import Row, read_rows
from gearjax.config.quantities import unit_size
from gearjax.errors import MeasuredFlank, MeasuredPitch
from gearjax.errors.measured import FLANKS

MOST_MISSING = 0.1  # largest share of the points of a grid that may be missing and are filled in
FAR = 10.0  # times the usual distance from the neighbours: an outlier is farther away
FEWEST_TEETH = 8  # of a gear whose outlying teeth can be told from the others
STANDS_OUT = 0.2  # share of the spread of the grid: an outlier is also farther away than this
LONGEST, MOST_TEETH = 10.0, 100_000  # largest length [m], and largest number of a tooth, in a file
PLACES = 1e-9  # resolution with which points of a grid are distinguished [m]
_COLUMN = re.compile(r"(\w+)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?")


@dataclasses.dataclass(frozen=True)
class _Columns:
    """Places of the columns of a file by name, and for lengths the size of their unit."""

    place: dict[str, int]
    size: dict[str, float]

    def length(self, name: str, row: Row) -> float:
        """A length in a row [m]."""
        column = self.place[name]
        value = self.size[name] * row.number(column)
        if abs(value) > LONGEST:
            raise GearjaxError(f"{row.where}, column {column + 1}: is more than {LONGEST:g} m: is its unit right?")
        return value

    def tooth(self, row: Row) -> int:
        """Number of the tooth to which a row belongs."""
        number = row.number(self.place["tooth"])
        if not 0 <= number <= MOST_TEETH or number != round(number):
            raise GearjaxError(
                f"{row.where}, column {self.place['tooth'] + 1}: must be the number of a tooth, counted from 0"
            )
        return int(number)

    def flank(self, row: Row) -> str:
        """The flank that a row belongs to."""
        cell = row.cells[self.place["flank"]].strip()
        if cell not in FLANKS:
            words = f"must be {' or '.join(FLANKS)}"
            raise GearjaxError(f"{row.where}, column {self.place['flank'] + 1}: {words}")
        return cell


def read_flank(file: str | Path, flank: str = "both") -> dict[str, Any]:
    """Read the numbers of a `MeasuredFlank` from a CSV file with one point of a flank in each row.

    The first line names the columns, and gives the unit of lengths: ``roll [mm]`` from the base circle and ``deviation
    [um]``. Optional columns are ``across [mm]`` from the middle of the face, ``tooth``, counted from 0, and ``flank``,
    which is ``driving`` or ``back``. Rows may come in any order. Points without a number and points whose rows are
    missing are filled in from their neighbours, up to a tenth of a grid. Outliers are counted but not changed. Both
    cases cause a warning (`RepairedData`).

    Args:
        file: path of the file.
        flank: flank whose rows are read, if the file has a column ``flank``.

    Returns:
        ``roll``, ``across``, ``deviation``, ``teeth`` and ``flank``, the arguments of `MeasuredFlank`.

    Raises:
        GearjaxError: the file cannot be read, or something in it is wrong; the message is one line that says where.

    Example:
        >>> import gearjax as gj
        >>> numbers = gj.read_flank("configs/helical/pinion_flank.csv", "driving")
        >>> error = gj.MeasuredFlank("pinion", **numbers)
    """
    columns, rows = _open(file, ("roll", "deviation"), ("across", "tooth", "flank"), flank)
    key = f"file: {file}"
    found: dict[tuple[int, int, int], float] = {}
    known: tuple[dict[int, float], dict[int, float]] = {}, {}
    for row in rows:
        tooth = columns.tooth(row) if "tooth" in columns.place else 0
        at = [columns.length(name, row) if name in columns.place else 0.0 for name in ("roll", "across")]
        first, second = (round(value / PLACES) for value in at)
        for places, number, value in zip(known, (first, second), at, strict=True):
            places.setdefault(number, value)
        if (tooth, first, second) in found:
            raise GearjaxError(f"{row.where}: repeats a point of an earlier line")
        missing = row.cells[columns.place["deviation"]].strip().lower() in ("", "nan")
        found[tooth, first, second] = np.nan if missing else columns.length("deviation", row)
    teeth = sorted({tooth for tooth, _, _ in found})
    orders = [{number: place for place, number in enumerate(sorted(numbers))} for numbers in (teeth, *known)]
    grid = np.full([len(order) for order in orders], np.nan)
    for point, value in found.items():
        grid[tuple(order[number] for order, number in zip(orders, point, strict=True))] = value
    roll, across = (np.array([places[number] for number in sorted(places)]) for places in known)
    if len(roll) * len(across) == 1:
        raise GearjaxError(f"{key}: has one point of a flank: a form needs at least two")
    filled = _filled(key, grid, (roll, across))
    _warn_of_outliers(key, grid, (roll, across))
    numbers = {"roll": roll, "across": across, "deviation": filled.ravel(), "flank": flank}
    return numbers | {"teeth": np.array(teeth if "tooth" in columns.place else [], float)}


def read_pitch(file: str | Path, flank: str = "both") -> dict[str, Any]:
    """Read the numbers of a `MeasuredPitch` from a CSV file with one tooth in each row.

    The first line names the columns: ``tooth``, counted from 0; either ``cumulative [um]`` or, for the deviation of the
    pitch from each tooth to the next, ``single [um]``; and ``flank`` if the file holds both flanks. A tooth far from
    both of its neighbours is told as a warning (`RepairedData`), but not changed.

    Args:
        file: path of the file.
        flank: flank whose rows are read, if the file has a column ``flank``.

    Returns:
        ``deviation`` and ``flank``, the arguments of `MeasuredPitch`.

    Raises:
        GearjaxError: the file cannot be read, or something in it is wrong; the message is one line that says where.
    """
    columns, rows = _open(file, ("tooth",), ("cumulative", "single", "flank"), flank)
    told = [name for name in ("cumulative", "single") if name in columns.place]
    if len(told) != 1:
        raise GearjaxError(f"file: {file}: line 1 must name either cumulative [um] or single [um]")
    found: dict[int, float] = {}
    for row in rows:
        tooth = columns.tooth(row)
        if tooth in found:
            raise GearjaxError(f"{row.where}: repeats a tooth of an earlier line")
        found[tooth] = columns.length(told[0], row)
    lacking = next((tooth for tooth in range(len(found)) if tooth not in found), None)
    if lacking is not None:
        raise GearjaxError(f"file: {file}: tooth {lacking} is missing: give all teeth from 0 to {max(found)}")
    values = np.array([found[tooth] for tooth in range(len(found))])
    if told == ["single"]:
        if abs(values.sum()) > 1e-2 * np.abs(values).sum() + 1e-9:
            words = f"the single deviations add up to {values.sum() / units.um:.3g} um around the gear, not to 0"
            warnings.warn(f"file: {file}: {words}: their mean is subtracted", RepairedData, stacklevel=2)
        values = np.concatenate([np.zeros(1), np.cumsum(values - values.mean())[:-1]])
    _warn_of_far_teeth(f"file: {file}", values)
    return {"deviation": values, "flank": flank}


def _warn_of_far_teeth(key: str, values: np.ndarray) -> None:
    """Warn of teeth whose cumulative deviation is far from those of both neighbours, around the gear."""
    if values.size < FEWEST_TEETH:
        return
    away = np.abs(values - 0.5 * (np.roll(values, 1) + np.roll(values, -1)))
    spread = np.percentile(values, 95) - np.percentile(values, 5)
    far = away > max(FAR * float(np.median(away)), STANDS_OUT * float(spread))
    if far.any():
        tooth = int(np.argmax(away))
        words = f"tooth {tooth} is {away[tooth] / units.um:.3g} um beside its neighbours: it is taken as it is"
        warnings.warn(f"{key}: {words}", RepairedData, stacklevel=3)


READERS: Mapping[str, Callable[[str | Path, str], dict[str, Any]]] = {
    MeasuredFlank.kind: read_flank,
    MeasuredPitch.kind: read_pitch,
}


def _open(
    file: str | Path, required: tuple[str, ...], optional: tuple[str, ...], flank: str
) -> tuple[_Columns, list[Row]]:
    """The columns of a file, and the rows of one flank."""
    check_path("file", file)
    key = f"file: {file}"
    header, lines = read_rows("file", Path(file))
    if len(header) == 1 and re.search("[;\t]", header[0]):
        raise GearjaxError(f"{key}: line 1: columns must be separated by commas, decimals by points")
    place: dict[str, int] = {}
    size: dict[str, float] = {}
    for number, text in enumerate(header):
        match = _COLUMN.fullmatch(text)
        name = match[1].lower() if match else text
        if match is None or name not in (*required, *optional):
            words = f"column {number + 1} is not known; {nearest(name, (*required, *optional))}"
            raise GearjaxError(f"{key}: line 1: {words}")
        if name in place:
            raise GearjaxError(f"{key}: line 1: two columns are named {name}")
        place[name] = number
        if name not in ("tooth", "flank"):
            if not match[2]:
                raise GearjaxError(f"{key}: line 1: {name} needs its unit, such as {name} [um]")
            size[name] = _size(f"{key}: line 1: {text}", match[2])
    lacking = [name for name in required if name not in place]
    if lacking:
        raise GearjaxError(f"{key}: line 1 must name a column {lacking[0]}; it has {', '.join(place) or 'none'}")
    columns = _Columns(place, size)
    if flank not in ("both", *FLANKS):
        raise ParameterError("flank", flank, nearest(flank, ("both", *FLANKS)))
    if "flank" in place:
        if flank == "both":
            raise ParameterError("flank", flank, f'must be "driving" or "back": {key} has a column flank')
        lines = (row for row in lines if flank == columns.flank(row))
    rows = list(lines)
    if not rows:
        raise GearjaxError(f"{key}: has no rows of the {flank} flank")
    return columns, rows


def _size(where: str, unit: str) -> float:
    """Size of a unit of length [m]."""
    try:
        return unit_size("unit", unit, unit, units.LENGTH)
    except ParameterError as fault:
        raise GearjaxError(f"{where}: {fault.right}") from fault


def _filled(key: str, grid: np.ndarray, places: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """A grid without missing points.

    A missing point gets the value of the straight line through the next known points, along the profile and across the
    face; beyond the last known point the line is extended. If both directions give a value, their mean is taken.
    """
    missing = np.isnan(grid)
    if not missing.any():
        return grid
    if missing.mean() > MOST_MISSING:
        words = f"{missing.sum()} of {grid.size} points are missing, more than a tenth"
        raise GearjaxError(f"{key}: {words}: the points of each tooth must be on one grid of roll and across")
    ways = []
    for axis, own in zip((1, 2), places, strict=True):
        whole = grid.copy()
        lines = np.moveaxis(whole, axis, -1)
        for line in np.ndindex(lines.shape[:-1]):
            lines[line] = _on_lines(own, lines[line])
        ways.append(whole)
    known = ~np.isnan(ways)
    filled = np.where(missing, np.where(known, ways, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1), grid)
    if not known.any(axis=0).all():
        raise GearjaxError(f"{key}: a point, and all others of its row and its column of the grid, are missing")
    words = f"{missing.sum()} of {grid.size} points are missing: they are filled in on lines through the next points"
    warnings.warn(f"{key}: {words}", RepairedData, stacklevel=3)
    return filled


def _on_lines(places: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values with missing ones on straight lines through the next known ones; unchanged if fewer than two are known."""
    there = ~np.isnan(values)
    if there.sum() < 2:
        return values
    known, at = values[there], places[there]
    filled = np.where(there, values, np.interp(places, at, known))
    for beyond, (one, other) in ((places < at[0], (0, 1)), (places > at[-1], (-1, -2))):
        slope = (known[one] - known[other]) / (at[one] - at[other])
        filled = np.where(beyond, known[one] + slope * (places - at[one]), filled)
    return filled


def _warn_of_outliers(key: str, grid: np.ndarray, places: tuple[np.ndarray, np.ndarray]) -> None:
    """Warn of points that are off the lines through their neighbours, both along the profile and across the face."""
    each = zip((1, 2), places, strict=True)
    ways = [np.moveaxis(_off_line(own, np.moveaxis(grid, axis, -1)), -1, axis) for axis, own in each if own.size > 2]
    if not ways:
        return
    away = np.minimum.reduce(ways)
    usual, spread = np.nanmedian(away), np.nanpercentile(grid, 95) - np.nanpercentile(grid, 5)
    far = away > max(FAR * usual, STANDS_OUT * spread)
    if far.any():
        words = f"{far.sum()} of {grid.size} points are outliers, up to {away[far].max() / units.um:.3g} um from"
        warnings.warn(f"{key}: {words} their neighbours: they are taken as they are", RepairedData, stacklevel=3)


def _off_line(places: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Distance of each value along the last axis from the line through its neighbours on both sides.

    For the outermost values the line goes through the next two values. The distance is nan if a value is missing.
    """
    number = len(places)
    own = np.arange(number)
    first = np.concatenate([[1], own[:-2], [number - 2]])
    second = np.concatenate([[2], own[2:], [number - 3]])
    share = (places - places[first]) / (places[second] - places[first])
    return np.abs(lines - (1 - share) * lines[..., first] - share * lines[..., second])
