"""CSV files with named columns.

Messages state where a fault is, but do not quote the content of the file: the user may have named a wrong file.
"""

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from gearjax.checks import GearjaxError

MOST_ROWS = 1_000_000
_LARGEST_FILE = 1_000_000_000  # bytes
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)


class Row(NamedTuple):
    """One line of a CSV file.

    Args:
        file: name of the file, for messages.
        line: line number, counted from 1.
        cells: texts of the cells, one for each column.
    """

    file: str
    line: int
    cells: list[str]

    @property
    def where(self) -> str:
        """File and line number, for messages."""
        return f"{self.file}: line {self.line}"

    def number(self, column: int) -> float:
        """The number in a column, counted from 0.

        Raises:
            GearjaxError: the cell does not hold a finite number.
        """
        cell = self.cells[column]
        if not _NUMBER.fullmatch(cell) or not math.isfinite(float(cell)):
            raise GearjaxError(f"{self.where}, column {column + 1}: is no number such as 0.5 or 5e-1")
        return float(cell)


def read_rows(key: str, path: Path) -> tuple[list[str], Iterator[Row]]:
    """Read the names of the columns from the first line, and prepare an iterator over the lines below.

    The lines are read only when the iterator is advanced.

    Args:
        key: key of the configuration that names the file, for messages.
        path: path of the file.

    Raises:
        GearjaxError: the file cannot be read, or is not a CSV file in UTF-8. The iterator raises it if a line has more
            or fewer cells than the first line, or if there are no lines or too many.
    """
    lines = _lines(key, path)
    header = [name.strip() for name in next(lines, Row("", 0, [])).cells]
    return header, _below(f"{key}: {path}", len(header), lines)


def _lines(key: str, path: Path) -> Iterator[Row]:
    """All lines of a file except empty ones, such as the last line."""
    name = f"{key}: {path}"
    try:
        if path.exists() and not path.is_file():
            raise GearjaxError(f"{name}: cannot be read (not a file)")
        if path.stat().st_size > _LARGEST_FILE:
            raise GearjaxError(f"{name}: has more than {_LARGEST_FILE} bytes")
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file, strict=True)
            for cells in lines:
                if len(cells) > 1 or "".join(cells).strip():
                    yield Row(name, lines.line_num, cells)
    except OSError as fault:
        raise GearjaxError(f"{name}: cannot be read ({fault.strerror or fault})") from fault
    except (UnicodeDecodeError, csv.Error) as fault:
        raise GearjaxError(f"{name}: not a CSV file in UTF-8") from fault


def _below(name: str, columns: int, lines: Iterator[Row]) -> Iterator[Row]:
    """The lines below the first one, each with a check of its number of cells."""
    number = 0
    for number, row in enumerate(lines, start=1):
        if len(row.cells) != columns:
            raise GearjaxError(f"{row.where} has {len(row.cells)} values, the first line has {columns}")
        if number > MOST_ROWS:
            raise GearjaxError(f"{name}: has more than {MOST_ROWS} rows")
        yield row
    if not number:
        raise GearjaxError(f"{name}: has no rows below its first line")
