"""Tables on terminals of any width: whole as a table, or row by row, but no number is cut."""

import io
import itertools

import pytest
from rich.console import Console
from rich.table import Table

from gearjax.cli.tables import show
from gearjax.cli.tolerance import _bar

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


def test_progress_in_a_file_is_lines_that_become_fewer(monkeypatch):
    """On no terminal there is no bar; chunks of 100 samples take 2 s each here."""
    clock, said = [0.0], []
    monkeypatch.setattr("gearjax.cli.tolerance.time.monotonic", lambda: clock[0])
    with _bar(Console(file=io.StringIO()), 10_000, 1000, lambda words: said.append((clock[0], words))) as advance:
        for _ in range(90):
            clock[0] += 2.0
            advance(100, 75)
    times = [at for at, _ in said]
    assert times[0] == 6.0
    assert all(late - early >= 5.0 for early, late in itertools.pairwise(times))
    assert times[-1] - times[-2] > 2 * (times[1] - times[0])
    assert times[-1] < 180.0  # the end is told by the results
    assert said[0][1] == "1300 of 10000 samples, about 3 min left, 50 samples/s, 75.00 % within all limits"
