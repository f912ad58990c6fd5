"""CSV files with named columns. Messages tell where a fault is, and nothing of what the file holds: it may be another
file than was meant."""

import csv
import math
import re
from pathlib import Path
from typing import NamedTuple

from gearjax.checks import GearjaxError

MOST_ROWS = 1_000_000
_LARGEST_FILE = 1_000_000_000  # bytes
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)


class Row(NamedTuple):
    """A line of a file.

    Args:
        where: it stands, for messages.
        cells: its texts, one for each column.
    """

    where: str
    cells: list[str]

    def number(self, column: int) -> float:
        """The number in a column, counted from 0.

        Raises:
            GearjaxError: there is none.
        """
        cell = self.cells[column]
        if not _NUMBER.fullmatch(cell) or not math.isfinite(float(cell)):
            raise GearjaxError(f"{self.where}, column {column + 1}: is no number such as 0.5 or 5e-1")
        return float(cell)


def read_rows(key: str, path: Path) -> tuple[list[str], list[Row]]:
    """Names of the columns, from the first line, and the lines below.

    Args:
        key: where the file is named, for messages.
        path: of the file.

    Raises:
        GearjaxError: the file cannot be read, or is none of this kind.
    """
    rows: list[Row] = []
    try:
        if path.exists() and not path.is_file():
            raise GearjaxError(f"{key}: {path}: cannot be read (not a file)")
        if path.stat().st_size > _LARGEST_FILE:
            raise GearjaxError(f"{key}: {path}: has more than {_LARGEST_FILE} bytes")
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file, strict=True)
            header = [name.strip() for name in next(lines, [])]
            for cells in lines:
                if not "".join(cells).strip() and len(cells) <= 1:  # an empty line, such as the last
                    continue
                where = f"{key}: {path}: line {lines.line_num}"
                if len(cells) != len(header):
                    raise GearjaxError(f"{where} has {len(cells)} values, the first line has {len(header)}")
                rows.append(Row(where, cells))
                if len(rows) > MOST_ROWS:
                    raise GearjaxError(f"{key}: {path}: has more than {MOST_ROWS} rows")
    except OSError as fault:
        raise GearjaxError(f"{key}: {path}: cannot be read ({fault.strerror or fault})") from fault
    except (UnicodeDecodeError, csv.Error) as fault:
        raise GearjaxError(f"{key}: {path}: not a CSV file in UTF-8") from fault
    return header, rows


def some(key: str, path: Path, rows: list[Row]) -> list[Row]:
    """The lines of a file, of which there must be some.

    Raises:
        GearjaxError: there are none.
    """
    if not rows:
        raise GearjaxError(f"{key}: {path}: has no rows below its first line")
    return rows
