"""The papers that are reproduced."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from gearjax.progress import Progress
from gearjax.reproduce import elliptic, helical, involute_rv, rv_cycloidal, two_kv
from gearjax.reproduce.figures import save_loads_figure
from gearjax.reproduce.rows import Row


class Paper(NamedTuple):
    """A paper that is reproduced.

    Args:
        title: authors, year and title of the paper.
        rows: function that computes the values of the paper next to ours, and reports its progress.
        save_figures: function that draws these values into a folder and returns the files; ``None`` for no figure.
    """

    title: str
    rows: Callable[[Progress], list[Row]]
    save_figures: Callable[[list[Row], Path], list[Path]] | None = None


PAPERS = {
    "two_kv": Paper(two_kv.PAPER, two_kv.rows),
    "rv_cycloidal": Paper(rv_cycloidal.PAPER, rv_cycloidal.rows),
    "involute_rv": Paper(involute_rv.PAPER, involute_rv.rows, save_loads_figure),
    "helical": Paper(helical.PAPER, helical.rows, helical.save_sidebands_figure),
    "elliptic": Paper(elliptic.PAPER, elliptic.rows, elliptic.save_elliptic_figures),
}
