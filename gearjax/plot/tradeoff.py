"""Work-precision figure of the settings of a scene."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from gearjax.plot.axes import finish, new_figure, save_figure, styles_of
from gearjax.studies.tradeoff import Measured, Tradeoff
from gearjax.units import arcmin

LEAST = 1e-8  # arcmin; smaller errors are drawn at this value
MARKERS = "osD^v<>P"
CLOSE = 300.0  # ratio of the ends of an axis below which ticks have plain numbers
APART = 13.0  # distance of labels above each other [pt]
Point = tuple[float, float, str]
"""Time [ms], error [arcmin] and name of a setting."""


def tradeoff_figure(comparison: Tradeoff) -> Figure:
    """Draw the error of the metrics against the time of a run and of a gradient, with a colour for each group.

    Named are the settings that no other one beats in both: the line through them is what accuracy costs.
    """
    figure, axes = new_figure(2, height=4.0)
    groups = styles_of(row.group for row in comparison.rows)
    best = {}
    for ax, kind in zip(axes, ("run", "gradient"), strict=True):
        points: list[Point] = []
        for place, (group, style) in enumerate(groups.items()):
            own = _points([row for row in comparison.rows if row.group == group], kind)
            if own:
                drawn = {"color": style["color"], "marker": MARKERS[place % len(MARKERS)], "label": group, "zorder": 4}
                ax.loglog([x for x, _, _ in own], [y for _, y, _ in own], linestyle="none", markersize=5, **drawn)
            points += own
        best[kind] = _unbeaten(points)
        line = [x for x, _, _ in best[kind]], [y for _, y, _ in best[kind]]
        ax.plot(*line, drawstyle="steps-post", color="0.6", linewidth=0.9, zorder=0, label="least error at this time")
        ax.axhline(comparison.error / arcmin, color="0.4", linestyle="--", linewidth=0.9, label="allowed")
        title = "one run" if kind == "run" else "gradient, measured once per scheme"
        smaller = f", {LEAST:g} if smaller" if any(y == LEAST for _, y, _ in points) else ""
        finish(ax, f"Error against time, {title}", x="time [ms]", y=f"largest error of a metric [arcmin]{smaller}")
        ax.margins(x=0.1, y=0.12)
        _few_ticks(ax)
    figure.draw_without_rendering()  # labels are placed on the page, so that its layout must be known
    for ax, kind in zip(axes, best, strict=True):
        _name(ax, best[kind], figure.dpi / 72)
    return figure


def _points(rows: list[Measured], kind: str) -> list[Point]:
    """The settings whose time is known."""
    timed = [(row.seconds if kind == "run" else row.gradient_seconds, row) for row in rows]
    return [(1e3 * seconds, max(row.error / arcmin, LEAST), row.name) for seconds, row in timed if seconds is not None]


def _unbeaten(points: list[Point]) -> list[Point]:
    """The points that are more accurate than all faster ones, the fastest first."""
    found: list[Point] = []
    for point in sorted(points):
        if not found or point[1] < found[-1][1]:
            found.append(point)
    return found


def _name(ax: Axes, points: list[Point], scale: float) -> None:
    """Write the names of points beside them, each at least `APART` above the one before; scale in pixels per point."""
    before = -float("inf")
    for x, y, name in reversed(points):
        place = ax.transData.transform((x, y))
        own = float(place[1]) / scale
        before = max(own + 5.0, before + APART)
        is_right = ax.transAxes.inverted().transform(place)[0] > 0.7
        ax.annotate(
            name,
            (x, y),
            fontsize="small",
            xytext=(-7 if is_right else 7, before - own),
            textcoords="offset points",
            horizontalalignment="right" if is_right else "left",
            verticalalignment="center",
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "alpha": 0.75, "linewidth": 0},
            arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 2},
        )


def save_tradeoff_figure(comparison: Tradeoff, folder: Path) -> list[Path]:
    """Write ``tradeoff.png``.

    Raises:
        GearjaxError: the file cannot be written.
    """
    figures = {}
    if comparison.rows:
        figures["tradeoff.png"] = tradeoff_figure(comparison)
    if comparison.statics:
        figures["static_choices.png"] = static_choices_figure(comparison)
    return [save_figure(figure, folder / name) for name, figure in figures.items()]


def static_choices_figure(comparison: Tradeoff) -> Figure:
    """Draw the error of each model of a part under static torque against its time, with a colour for each part.

    The most exact model of a part has no error; it is drawn at the lower edge.
    """
    figure, (ax,) = new_figure(1, height=4.0)
    parts, points = styles_of(one.part for one in comparison.statics), []
    known = [one.error / arcmin for one in comparison.statics if one.error > 0]
    least = max(LEAST, 0.1 * min(known, default=LEAST))
    for place, (part, style) in enumerate(parts.items()):
        own: list[Point] = [
            (1e3 * one.seconds, max(one.error / arcmin, least), one.name)
            for one in comparison.statics
            if one.part == part
        ]
        drawn = {"color": style["color"], "marker": MARKERS[place % len(MARKERS)], "label": part}
        ax.loglog([x for x, _, _ in own], [y for _, y, _ in own], linewidth=0.9, markersize=5, **drawn)
        points += own
    title = "Models under static torque; the most exact ones at the lower edge"
    finish(ax, title, x="time of one torque [ms]", y="largest error of a metric [arcmin]")
    ax.margins(x=0.15, y=0.12)
    _few_ticks(ax)
    figure.draw_without_rendering()
    _name(ax, sorted(points, key=lambda point: -point[1]), figure.dpi / 72)
    return figure


def _few_ticks(ax: Axes) -> None:
    """Ticks of logarithmic axes whose labels have room beside each other."""
    for axis in (ax.xaxis, ax.yaxis):
        low, high = axis.get_view_interval()
        axis.set_minor_formatter(NullFormatter())
        if high < CLOSE * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
