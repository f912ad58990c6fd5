"""``--report``: one self-contained page with the results of a command."""

import contextlib
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gearjax.checks import ParameterError
from gearjax.files import write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "report.html"
ReportOption = Annotated[bool, typer.Option("--report", help=f"write {NAME} too: results and figures on one page")]


class Report:
    """Notes and figures that one command keeps for its page; no page is written if none is asked for.

    Args:
        wanted: whether a page is asked for.
        folder: folder of the results, if there is one.

    Raises:
        ParameterError: a page is asked for, but there is no folder.
    """

    def __init__(self, wanted: bool, folder: Path | None):
        if wanted and folder is None:
            raise ParameterError("--report", "with --json", "needs a folder: give --out DIR")
        self.wanted = wanted
        self.notes: list[str] = []
        self.figures: Mapping[str, Figure] = {}

    def note(self, words: str) -> None:
        """Add something that a reader of the page should know."""
        self.notes.append(words)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Keep the warnings raised in the block; they are shown as usual too."""
        tell = warnings.showwarning

        def told(message: Warning | str, *where: Any, **further: Any) -> None:
            self.notes.append(" ".join(str(message).split()))
            tell(message, *where, **further)

        warnings.showwarning = told
        try:
            yield
        finally:
            warnings.showwarning = tell

    @contextlib.contextmanager
    def drawing(self) -> Iterator[None]:
        """Keep the figures that are saved in the block."""
        from gearjax.plot import figures_kept

        with figures_kept() as self.figures:
            yield

    def write(self, folder: Path, title: str, told: Mapping[str, Any], config: str) -> list[Path]:
        """Write the page with title, results and text of the configuration; no file if no page is asked for."""
        if not self.wanted:
            return []
        from gearjax.plot import report_page

        page = report_page(title, told, self.figures, config, dict.fromkeys(self.notes))
        return [write_file(folder / NAME, page)]
