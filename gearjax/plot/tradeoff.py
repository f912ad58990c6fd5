"""Work-precision figure of the settings of a scene."""

from pathlib import Path

from matplotlib.figure import Figure

from gearjax.plot.axes import finish, new_figure, save_figure
from gearjax.studies.tradeoff import Tradeoff
from gearjax.units import arcmin

LEAST = 1e-8  # arcmin; smaller errors are drawn at this value
LEANS = ((35, "left"), (-35, "left"), (-40, "right"), (40, "right"), (8, "left"), (-65, "left"))
"""Angle of the labels of a group [deg], and which end of a label is at its point, so that groups do not overlap."""


def tradeoff_figure(comparison: Tradeoff) -> Figure:
    """Draw the error of the metrics against the time of a run and of a gradient, with a colour for each group."""
    figure, axes = new_figure(2, height=5.0)
    for ax, kind in zip(axes, ("run", "gradient"), strict=True):
        for index, group in enumerate(dict.fromkeys(row.group for row in comparison.rows)):
            rows = [row for row in comparison.rows if row.group == group]
            times = [row.seconds if kind == "run" else row.gradient_seconds for row in rows]
            points = [
                (1e3 * seconds, max(row.error / arcmin, LEAST), row.name)
                for row, seconds in zip(rows, times, strict=True)
                if seconds is not None
            ]
            if not points:
                continue
            x, y, names = zip(*points, strict=True)
            ax.loglog(x, y, "osD^v<>P"[index % 8], color=f"C{index}", label=group, markersize=5)
            turned, end = LEANS[index % len(LEANS)]
            for place in zip(x, y, names, strict=True):
                ax.annotate(
                    place[2],
                    place[:2],
                    fontsize=5.5,
                    xytext=(3 if end == "left" else -3, 3 if (turned > 0) == (end == "left") else -3),
                    textcoords="offset points",
                    horizontalalignment=end,
                    verticalalignment="center",
                    rotation=turned,
                    rotation_mode="anchor",
                )
        ax.axhline(comparison.error / arcmin, color="0.4", linestyle="--", linewidth=0.9, label="allowed")
        title = "one run" if kind == "run" else "gradient of the standard deviation, measured once per scheme"
        finish(ax, f"Error against time: {title}", x="time [ms]", y="largest error of a metric [arcmin]")
        ax.margins(x=0.15, y=0.18)
    return figure


def save_tradeoff_figure(comparison: Tradeoff, folder: Path) -> list[Path]:
    """Write ``tradeoff.png``.

    Raises:
        GearjaxError: the file cannot be written.
    """
    return [save_figure(tradeoff_figure(comparison), folder / "tradeoff.png")]
