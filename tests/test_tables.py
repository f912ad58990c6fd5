"""Tables on terminals of any width: whole as a table, or row by row, but no number is cut."""

import io

import pytest
from rich.console import Console
from rich.table import Table

from gearjax.cli.tables import show

ROWS = [
    ("static.peak_to_peak@784Nm", "0.2183", "0.091 [0.090, 0.092]", "<= 0.25"),
    ("", "1234567.8901", "-0.793 [-0.793, -0.793]", ""),
]


def printed(width: int) -> str:
    table = Table(title="some gear sets; in arcmin")
    for column in ("measure", "mean", "5 %", ""):
        table.add_column(column, justify="right")
    for row in ROWS:
        table.add_row(*row)
    console = Console(width=width, file=io.StringIO(), highlight=False, markup=False)
    show(console, table)
    return console.file.getvalue()


@pytest.mark.parametrize("width", [10, 40, 60, 80, 140])
def test_no_number_is_cut(width):
    text = printed(width)
    assert "…" not in text
    for word in " ".join(cell for row in ROWS for cell in row).split():
        assert word in text


def test_narrow_terminals_get_one_value_per_line():
    assert printed(40).splitlines() == [
        "some gear sets; in arcmin",
        "static.peak_to_peak@784Nm",
        "    mean: 0.2183",
        "    5 %: 0.091 [0.090, 0.092]",
        "    <= 0.25",
        "    mean: 1234567.8901",
        "    5 %: -0.793 [-0.793, -0.793]",
    ]
    assert "┃" in printed(80)
