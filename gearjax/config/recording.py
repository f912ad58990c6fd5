"""Recordings of test benches: CSV files with named columns and units, each with a small TOML file beside it."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gearjax import units
from gearjax.checks import GearjaxError, ParameterError, RepairedData, check_path
from gearjax.config.csv_files import read_rows
from gearjax.config.quantities import read_quantity
from gearjax.config.recording_columns import Column, beside_of, columns_of
from gearjax.identification.measurement import SHORTEST, Measurement, means_of

CHUNK = 500_000  # rows read at once
MOST_KEPT = 1_000_000  # rows; a longer recording is averaged while it is read
MOST_MISSING = 0.3  # largest share of the rows that may lack a value and be left out
GAP = 5.0  # times the usual time between rows: a gap, in which angles may have made whole turns
FARTHEST = 1 / 3  # turns: largest median step from row to row of an angle that wraps around
ALONE = 0.3  # largest share of the rows whose zeros may stand for missing values
SHUFFLED = 0.1  # share of steps far back, above which rows without times are sorted by their input angle


def read_measurement(file: str | Path, *, torque: float | None = None) -> Measurement:
    """Read a recording of a test bench.

    The file is a CSV file. Its first line holds names and units, such as
    ``time [s],input angle [deg],output angle [deg],torque [N m]``. The file needs ``input angle`` and either
    ``output angle`` or ``te``; ``time`` and ``torque`` are optional, and other columns are ignored. Names and units may
    also stand in a TOML file of the same name beside the CSV file::

        torque = "40 N*m"                       # of the whole run; a positive torque resists the output
        input_counts = 262144                   # counts per turn of the encoders
        turned = {"errors.planet_1" = "30 deg"} # bodies turned in their seats before this run
        [columns]
        "input angle" = {column = "phi_1", unit = "deg", sign = -1}

    The unit ``counts`` needs the counts per turn. Rows are sorted by time. Repeated rows and rows with a missing value
    are left out and counted. Angles that wrap around once a turn are unwrapped. A recording of more than a million rows
    is averaged while it is read: its rows must be in the order of time, and repeated rows are not looked for.

    Args:
        file: path of the CSV file.
        torque: torque of the whole run, used if neither file states a torque [N m].

    Returns:
        The recording; its ``repairs`` list what was corrected.

    Raises:
        GearjaxError: the file is not such a table, or the table may be damaged; the message is one line that says
            where the fault is.

    Example:
        >>> import gearjax as gj, pathlib, tempfile
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "te.csv"
        >>> rows = "\\n".join(f"{10 * i},{0.1 * (i % 7)}" for i in range(50))
        >>> _ = file.write_text(f"input angle [deg],te [arcmin]\\n{rows}\\n")
        >>> gj.read_measurement(file, torque=40.0).theta.shape
        (50,)
    """
    check_path("file", file)
    path = Path(file).expanduser()
    key = f"file: {file}"
    beside = beside_of(path)
    header, lines = read_rows("file", path)
    columns, own = columns_of(key, header, beside), _Reader(key, beside)
    if "output angle" in columns and columns.pop("te", None) is not None:
        own.repairs["column te left out, as it follows from both angles"] = 1
    next(lines)  # refuses a file without rows, or whose first row has more or fewer cells than there are names
    _even(key, path, len(header))
    table, averaged = _table(key, path, columns, own)
    record = _record(key, beside.get("name", path.stem), table, beside, torque, own, averaged)
    for words in record.told():
        warnings.warn(words, RepairedData, stacklevel=2)
    return record


def _even(key: str, path: Path, columns: int) -> None:
    """Refuse lines with more values than names, whose values would be read into wrong columns."""
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if line.count(b",") >= columns and b'"' not in line:
                words = f"has {line.count(b',') + 1} values, the first line has {columns}"
                raise GearjaxError(f"{key}: line {number} {words}")


class _Reader:
    """State while a file is read: the repairs so far, the turns of each angle, and which angles wrap around."""

    def __init__(self, key: str, beside: dict[str, Any]):
        self.key, self.beside = key, beside
        self.repairs: dict[str, int] = {}
        self.wrapped: dict[str, tuple[float, float]] = {}
        self.wraps: set[str] = set()

    def count(self, what: str, where: np.ndarray) -> None:
        """Add to the count of a repair; ``where`` marks the rows concerned, or holds numbers to add."""
        number = int(where.sum())
        if number:
            self.repairs[what] = self.repairs.get(what, 0) + number


def _chunks(key: str, path: Path, columns: dict[str, Column]) -> Iterator[dict[str, np.ndarray]]:
    """Read a file in parts, as numbers in SI; a cell without a number gives nan."""
    import pandas as pd  # the import takes half a second, which other commands need not wait for

    places = sorted({column.place for column in columns.values()})
    try:
        with pd.read_csv(
            path, header=0, usecols=places, chunksize=CHUNK, skipinitialspace=True, encoding="utf-8-sig", engine="c"
        ) as parts:
            for part in parts:
                numbers = {
                    place: np.asarray(pd.to_numeric(part.iloc[:, i], errors="coerce"), dtype=float)
                    for i, place in enumerate(places)
                }
                yield {name: column.size * numbers[column.place] for name, column in columns.items()}
    except (pd.errors.ParserError, UnicodeDecodeError, ValueError) as fault:
        raise GearjaxError(f"{key}: each line must have as many values as the first line has names") from fault
    except OSError as fault:
        raise GearjaxError(f"{key}: cannot be read ({fault.strerror or fault})") from fault


def _table(key: str, path: Path, columns: dict[str, Column], own: _Reader) -> tuple[dict[str, np.ndarray], int]:
    """The cleaned rows, and the number of rows of the file that each of them is the mean of."""
    kept: list[dict[str, np.ndarray]] = []
    size, averaged, rows = path.stat().st_size, 1, 0
    for number, part in enumerate(_chunks(key, path, columns)):
        length = part["input angle"].size
        rows += length
        if number == 0 and length == CHUNK:
            per_row = _bytes_of(path, CHUNK) / CHUNK
            averaged = max(1, int(np.ceil(size / per_row / MOST_KEPT)))
        part = _whole_rows(part, own)
        if not part["input angle"].size:
            continue
        if averaged > 1:
            _in_order(part, own)
            part = {name: means_of(values, averaged) for name, values in _continued(part, own).items()}
        kept.append(part)
    lacking = own.repairs.get("rows with missing values left out", 0)
    if not kept or lacking > MOST_MISSING * rows:
        raise GearjaxError(f"{key}: {lacking} of {rows} rows lack a value in a column that is needed")
    if rows < SHORTEST:
        raise GearjaxError(f"{key}: has {rows} rows, at least {SHORTEST} are needed")
    table = {name: np.concatenate([part[name] for part in kept]) for name in columns}
    if averaged == 1:
        table = _continued(_distinct(_ordered(table, own), own), own)
    return table, averaged


def _in_order(part: dict[str, np.ndarray], own: _Reader) -> None:
    """Refuse rows that are not in order of time in a file that is averaged while it is read."""
    if "time" in part:
        times = np.concatenate([[own.wrapped.get("time", (part["time"][0], 0.0))[0]], part["time"]])
        if (np.diff(times) < 0).any():
            words = f"rows are not in order of time: sort a file of more than {MOST_KEPT} rows before gearjax reads it"
            raise GearjaxError(f"{own.key}: {words}")
        own.wrapped["time"] = float(part["time"][-1]), 0.0


def _bytes_of(path: Path, rows: int) -> int:
    """Approximate number of bytes of the first rows of a file, estimated from its first megabyte."""
    with path.open("rb") as file:
        begin = file.read(1_000_000)
    return max(1, round(rows * len(begin) / max(begin.count(b"\n"), 1)))


def _whole_rows(part: dict[str, np.ndarray], own: _Reader) -> dict[str, np.ndarray]:
    """Rows without missing values."""
    good = np.logical_and.reduce([np.isfinite(values) for values in part.values()])
    own.count("rows with missing values left out", ~good)
    return {name: values[good] for name, values in part.items()}


def _ordered(table: dict[str, np.ndarray], own: _Reader) -> dict[str, np.ndarray]:
    """Rows sorted by time or, if there are no times, by the input angle."""
    if "time" in table:
        steps = np.diff(table["time"])
        if (steps < 0).any():
            order = np.argsort(table["time"], kind="stable")
            own.count("rows out of the order of time sorted", order != np.arange(order.size))
            return {name: values[order] for name, values in table.items()}
        return table
    steps = np.diff(table["input angle"])
    moving = np.abs(steps[steps != 0])
    far = 20 * np.median(moving) if moving.size else 0.0
    way = np.sign(np.sum(np.sign(steps)))
    wrong = way * steps < -far
    wraps = np.ptp(table["input angle"]) < 2 * np.pi * 1.001 and np.abs(steps).max(initial=0.0) > np.pi
    if wrong.mean() < SHUFFLED and not wraps and wrong.any():
        words = "an angle may wrap around at 360 deg only, and without a column time rows cannot be ordered"
        raise GearjaxError(f"{own.key}: the input angle jumps back {int(wrong.sum())} times: {words}")
    if not wraps and wrong.any():
        order = np.argsort(way * table["input angle"], kind="stable")
        own.count("rows out of the order of the input angle sorted", order != np.arange(order.size))
        return {name: values[order] for name, values in table.items()}
    return table


def _distinct(table: dict[str, np.ndarray], own: _Reader) -> dict[str, np.ndarray]:
    """Rows that do not repeat the row before them."""
    same = np.logical_and.reduce([np.diff(table[name]) == 0 for name in table])
    own.count("repeated rows left out", same)
    keep = np.concatenate([[True], ~same])
    return {name: values[keep] for name, values in table.items()}


def _continued(table: dict[str, np.ndarray], own: _Reader) -> dict[str, np.ndarray]:
    """Unwrap angles that wrap around once a turn, and leave out rows whose zeros stand for missing values."""
    for name in ("te", "output angle", "input angle"):
        if name in table:
            stray = _stray(table[name])
            own.count(f"rows with a zero in place of the {name} left out", stray)
            table = {key: values[~stray] for key, values in table.items()}
    for name in ("input angle", "output angle"):
        if name in table:
            table[name] = _unwrapped(name, table[name], own, table.get("time"))
    return table


def _stray(values: np.ndarray) -> np.ndarray:
    """Mark values that are exactly zero while the nearest nonzero values before and behind are far from zero."""
    zero = values == 0
    others = np.flatnonzero(~zero)
    if not zero.any() or zero.mean() > ALONE or others.size < 2:
        return np.zeros(values.shape, bool)
    steps = np.abs(np.diff(values[others]))
    moving = steps[steps > 0]  # with coarse encoders most steps are zero
    usual = 20 * max(float(np.median(moving)) if moving.size else 0.0, 1e-12)
    behind = np.searchsorted(others, np.arange(values.size))
    within = (behind > 0) & (behind < others.size)  # a recording may begin and end at zero
    behind = np.clip(behind, 1, others.size - 1)
    far = (np.abs(values[others[behind]]) > usual) & (np.abs(values[others[behind - 1]]) > usual)
    return zero & within & far


def _unwrapped(name: str, angle: np.ndarray, own: _Reader, time: np.ndarray | None) -> np.ndarray:
    """Unwrap an angle that falls back by a turn once a turn, and continue it from part to part of a file."""
    turn = 2 * np.pi
    before, turns = own.wrapped.get(name, (angle[0], 0.0))
    given = np.concatenate([[before], angle])
    steps = np.diff(given)
    wraps = np.ptp(given) <= turn * 1.001 and bool((np.abs(steps) > turn / 2).any())
    falls = -np.round(steps / turn) if wraps else np.zeros(angle.size)
    if wraps:
        own.wraps.add(name)
        usual = np.median(np.abs(steps + turn * falls))
        if usual > FARTHEST * turn:
            words = f"moves {usual / units.deg:.3g} deg from row to row, more than {360 * FARTHEST:.3g} deg"
            raise GearjaxError(f"{own.key}: the {name} wraps around and {words}: its turns cannot be counted")
        own.count(f"jumps of the {name} by whole turns removed", np.abs(falls))
        missing = _missing_turns(steps[1:] + turn * falls[1:], time)
        own.count(f"turns of the {name} in gaps counted by the time", np.abs(missing))
        falls[1:] += missing
    moved = angle + turn * (turns + np.cumsum(falls))
    own.wrapped[name] = float(angle[-1]), float(turns + falls.sum())
    return moved


def _missing_turns(steps: np.ndarray, time: np.ndarray | None) -> np.ndarray:
    """Whole turns that an angle makes in gaps between rows, which its values cannot show: the time does."""
    passed = np.zeros(steps.shape) if time is None else np.diff(time)
    usual = float(np.median(passed))
    if time is None or usual <= 0:
        return np.zeros(steps.shape)
    speed = float(np.median(steps[passed > 0] / passed[passed > 0]))
    return np.where(passed > GAP * usual, np.round((speed * passed - steps) / (2 * np.pi)), 0.0)


def _record(
    key: str,
    name: str,
    table: dict[str, np.ndarray],
    beside: dict[str, Any],
    torque: float | None,
    own: _Reader,
    averaged: int,
) -> Measurement:
    """Make the recording from the cleaned rows."""
    for column in ("input angle", "output angle", "te", "time"):
        if column in table and np.ptp(table[column]) == 0:
            raise GearjaxError(f"{key}: the column {column} holds the same value in every row")
    if "torque" in beside:
        if "torque" in table:
            raise ParameterError(
                f"{beside['file']}: torque", beside["torque"], "is also a column of the CSV file: give only one of them"
            )
        torque = read_quantity(f"{beside['file']}: torque", beside["torque"], units.TORQUE)
    counts = [beside.get(f"{side}_counts") for side in ("input", "output")]
    resolution = None if counts[1] is None else 2 * np.pi / counts[1]
    try:
        return Measurement(
            table["input angle"],
            table.get("output angle"),
            table.get("te"),
            table.get("torque", torque),
            table.get("time"),
            name,
            beside.get("turned", {}),
            resolution,
            own.repairs,
            averaged,
            "input angle" in own.wraps,
        )
    except ParameterError as fault:
        raise GearjaxError(f"{key}: {fault}") from fault
