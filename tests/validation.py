"""The validation page as it is committed."""

from gearjax.reproduce import PAPERS, Row
from gearjax.reproduce.page import counted, section
from tests.conftest import ROOT

PAGE = ROOT / "experiments" / "site" / "validation.md"


def assert_shown(paper: str, rows: list[Row]) -> None:
    """The page shows what a paper's values are now; else ``gearjax reproduce --all`` writes it anew."""
    title = PAPERS[paper].title
    shown = PAGE.read_text(encoding="utf-8")
    here = shown[shown.index(f"\n## {title}") :]
    end = here.find("\n## ", 1)
    assert (here if end < 0 else here[:end]) == section(title, rows)
    assert counted(title, rows) in shown
