"""The papers that are reproduced."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from gearjax.progress import Progress
from gearjax.reproduce import elliptic, helical, involute_rv, rv_cycloidal, two_kv
from gearjax.reproduce.figures import save_deviations_figure, save_loads_figure
from gearjax.reproduce.rows import Row


class Paper(NamedTuple):
    """A paper that is reproduced.

    Args:
        title: authors, year and title of the paper.
        rows: function that computes the values of the paper next to ours, and reports its progress.
        save_figures: function that draws the paper's own curves into a folder and returns the files; ``None`` for none.
    """

    title: str
    rows: Callable[[Progress], list[Row]]
    save_figures: Callable[[list[Row], Path], list[Path]] | None = None

    def save_all_figures(self, rows: list[Row], folder: Path, name: str) -> list[Path]:
        """Draw the deviations of the values, into ``NAME_deviations.png``, and the paper's own curves.

        Raises:
            GearjaxError: a file cannot be written.
        """
        authors = self.title.partition(")")[0] + ")"
        deviations = save_deviations_figure(authors, rows, folder / f"{name}_deviations.png")
        return [deviations] + ([] if self.save_figures is None else self.save_figures(rows, folder))


PAPERS = {
    "two_kv": Paper(two_kv.PAPER, two_kv.rows),
    "rv_cycloidal": Paper(rv_cycloidal.PAPER, rv_cycloidal.rows),
    "involute_rv": Paper(involute_rv.PAPER, involute_rv.rows, save_loads_figure),
    "helical": Paper(helical.PAPER, helical.rows, helical.save_sidebands_figure),
    "elliptic": Paper(elliptic.PAPER, elliptic.rows, elliptic.save_elliptic_figures),
}
