"""Figures of published values next to ours."""

from pathlib import Path

from gearjax.reproduce.involute_rv_pair import PHASE, POINTS, RIM
from gearjax.reproduce.rows import Row
from gearjax.units import mm

TEETH = sorted(POINTS)
SERIES = (  # item of the rows, label, whether to draw the printed value or ours
    ("Table 5, tooth {}", "paper, finite elements and linear programme", True),
    ("Table 5, ANSYS, tooth {}", "paper, ANSYS", True),
    ("Table 5, tooth {}", f"gearjax, rim {RIM / mm:g} mm and phase {PHASE} fitted", False),
)


def save_loads_figure(rows: list[Row], folder: Path) -> list[Path]:
    """Draw the tooth loads of Yang, Tang and Liang (2019), Table 5, and the differences from the paper's own method.

    Args:
        rows: rows of the paper.
        folder: folder of the file ``involute_rv_loads.png``.

    Raises:
        GearjaxError: the file cannot be written.
    """
    from gearjax.plot import finish, new_figure, save_figure  # the import of matplotlib takes a second

    by_item = {row.item: row for row in rows}
    figure, (above, below) = new_figure(2, width=9.0)
    first: list[float] = []
    for place, (item, label, printed) in enumerate(SERIES):
        series = [by_item.get(item.format(tooth)) for tooth in TEETH]
        loads = [0.0 if row is None else float(row.published) if printed else row.computed for row in series]
        first = first or loads
        at = [tooth + 0.27 * (place - 1) for tooth in TEETH]
        above.bar(at, loads, width=0.25, label=label, color=f"C{place}")
        if place:
            off = [load - other for load, other in zip(loads, first, strict=True)]
            below.bar(at, off, width=0.25, label=label, color=f"C{place}")
    below.axhline(0.0, color="black", linewidth=0.8)
    finish(above, "Yang, Tang, Liang (2019), Table 5: loads under 100 N m", x="tooth pair", y="load [N]")
    finish(below, "Difference from the paper's own method", x="tooth pair", y="difference [N]")
    for ax in (above, below):
        ax.set(xticks=TEETH, xlim=(TEETH[0] - 0.5, TEETH[-1] + 0.5))
        ax.legend(fontsize="small", loc="upper right")
    return [save_figure(figure, folder / "involute_rv_loads.png")]
