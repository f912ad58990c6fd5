"""Figures of published values next to ours."""

import math
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
STATUS_COLOURS = {"reproduced": "C0", "inferred": "C1", "not reproduced": "C3"}


def save_deviations_figure(title: str, rows: list[Row], path: Path) -> Path:
    """Draw by how many per cent each of our values deviates from the published one, and its limit as a grey bar.

    Args:
        title: title of the figure.
        rows: rows of a paper; those without a published value, with one of zero, or without ours are left out.
        path: path of the file.

    Raises:
        GearjaxError: the file cannot be written.
    """
    from gearjax.plot import finish, new_figure, save_figure  # the import of matplotlib takes a second

    rows = [row for row in rows if row.published and float(row.published) and math.isfinite(row.computed)]
    places = range(len(rows))
    size = [100 / abs(float(row.published)) for row in rows]
    figure, (ax,) = new_figure(width=9.0, height=1.5 + 0.16 * len(rows))
    for label, side in (("limit", -1), (None, 1)):  # values that rest on inferred constants need not be within a limit
        limits = [0.0 if row.inferred and row.is_beyond else side * row.tolerance for row in rows]
        widths = [limit * each for limit, each in zip(limits, size, strict=True)]
        ax.barh(places, widths, height=0.8, color="0.85", label=label)
    for status, colour in STATUS_COLOURS.items():
        shown = [place for place in places if rows[place].status == status]
        off = [rows[place].deviation * size[place] for place in shown]
        if shown:
            ax.plot(off, shown, "o", color=colour, markersize=3.5, label=status)
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.set_xscale("symlog", linthresh=0.1)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.set_yticks(places, [row.item for row in rows], fontsize="x-small")
    finish(ax, title, x="deviation from the published value [%]", y="")
    ax.set_ylim(len(rows) - 0.4, -0.6)
    return save_figure(figure, path)


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
