"""The validation page: every published value of every paper next to ours, in Markdown."""

import math
from collections import Counter
from collections.abc import Iterable

from gearjax.markdown import plain
from gearjax.reproduce.rows import Row

HEAD = """\
# Validation: published values next to ours

Written by `gearjax reproduce --all`; the tests fail where this page differs from what gearjax computes.

- **reproduced**: within a limit that the precision of the printed value, or of its reading, allows;
- **inferred**: it rests on constants that the paper does not give, fitted to published values; the note says which;
- **not reproduced**: it is outside the limit, or the paper lacks data that it needs; the note says why;
- **not published**: a value of ours that explains others.

"""
ROUNDING = 1e-6  # smaller values, in whatever unit, are rounding errors, which differ from machine to machine
STATUSES = ("reproduced", "inferred", "not reproduced", "not published")


def validation_page(reports: Iterable[tuple[str, list[Row]]]) -> str:
    """The text of the validation page.

    Args:
        reports: the title of each paper, and its values.
    """
    reports = list(reports)
    counts = "".join(counted(title, rows) for title, rows in reports)
    table = f"| paper | {' | '.join(STATUSES)} |\n|---|{'---:|' * len(STATUSES)}\n{counts}"
    return HEAD + table + "".join(section(title, rows) for title, rows in reports)


def section(title: str, rows: list[Row]) -> str:
    """The section of one paper: a table, and the notes to which the table refers."""
    notes = {why: number for number, why in enumerate(dict.fromkeys(row.why for row in rows if row.why), 1)}
    lines = "".join(f"| {' | '.join(_cells(row, notes))} |\n" for row in rows)
    said = "".join(f"{number}. {plain(why)}\n" for why, number in notes.items())
    head = "| value | published | ours | unit | | note |\n|---|---:|---:|---|---|---|\n"
    return f"\n## {title}\n\n{head}{lines}" + (f"\nNotes:\n\n{said}" if notes else "")


def counted(title: str, rows: list[Row]) -> str:
    """The line of one paper in the table at the head of the page: how many values have each status."""
    of = Counter(row.status for row in rows)
    return f"| {title} | {' | '.join(str(of[status]) for status in STATUSES)} |\n"


def _cells(row: Row, notes: dict[str, int]) -> tuple[str, ...]:
    ours = f"{row.computed:.5g}" if math.isfinite(row.computed) else ""
    if abs(row.computed) < ROUNDING:
        ours = f"below {ROUNDING:g}"
    return plain(row.item), row.published, ours, plain(row.unit), row.status, str(notes.get(row.why, ""))
