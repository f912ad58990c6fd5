"""Published figures next to ours, one module per paper."""

from collections.abc import Callable

from gearjax.reproduce import rv_cycloidal, two_kv
from gearjax.reproduce.rows import Row

PAPERS: dict[str, tuple[str, Callable[[], list[Row]]]] = {
    "two_kv": (two_kv.PAPER, two_kv.rows),
    "rv_cycloidal": (rv_cycloidal.PAPER, rv_cycloidal.rows),
}

__all__ = ["PAPERS", "Row"]
