"""``--report``: one self-contained page of what a command found."""

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
    """What one command keeps for its page, or nothing where none is asked for.

    Args:
        wanted: whether there will be a page.
        folder: where it goes.

    Raises:
        ParameterError: a page is wanted and there is no folder.
    """

    def __init__(self, wanted: bool, folder: Path | None):
        if wanted and folder is None:
            raise ParameterError("--report", "with --json", "needs a folder: give --out DIR")
        self.folder = folder if wanted else None
        self.notes: list[str] = []
        self.figures: Mapping[str, Figure] = {}

    def note(self, words: str) -> None:
        """Something that a reader of the page should know."""
        self.notes.append(words)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Keep warnings meanwhile; they are told as ever."""
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
        """Keep the figures that are saved meanwhile."""
        from gearjax.plot import figures_kept

        with figures_kept() as self.figures:
            yield

    def write(self, title: str, told: Mapping[str, Any], config: str) -> list[Path]:
        """The page: a title, the results, the text of the configuration; no file where none is asked for."""
        if self.folder is None:
            return []
        from gearjax.plot import report_page

        page = report_page(title, told, self.figures, config, dict.fromkeys(self.notes))
        return [write_file(self.folder / NAME, page)]
