"""Figures of an optimisation: the scene before and after, and the search itself."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gearjax.analysis import order_spectrum
from gearjax.plot.axes import draw_curve, finish, new_figure, save_figure
from gearjax.results import Case, Optimisation, required_run
from gearjax.studies.sensitivity import FLAT_STEP
from gearjax.units import arcmin

NAMED_VALLEYS = 5
COLOURS = {"before": "0.55", "grid": "tab:blue", "after": "tab:red"}


def before_after_figure(optimisation: Optimisation) -> Figure:
    """Curve and order spectrum of every case, before and after (figs. 14-16 of Wang et al. 2020)."""
    count = len(optimisation.cases["before"])
    figure, axes = new_figure(count, 2, width=13.0, height=2.5)
    for row in range(count):
        cases = {stage: optimisation.cases[stage][row] for stage in ("before", "after")}
        _curves(axes[2 * row], optimisation, cases)
        _spectra(axes[2 * row + 1], optimisation, cases)
    return figure


def _above(ax: Axes) -> None:
    """Put the title on the left above the axes and the legend beside it, where no curve is."""
    ax.set_title(ax.get_title(), loc="left", fontsize="medium")
    ax.set_title("")
    ax.legend(fontsize="small", loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, borderaxespad=0.1)


def _curves(ax: Axes, optimisation: Optimisation, cases: dict[str, Case]) -> None:
    run = required_run(optimisation.scene)
    time = run.times
    for stage, case in cases.items():
        spread = case.metrics["peak_to_peak"] / arcmin
        draw_curve(ax, time, case.record, f"{stage}: p-p {spread:.3f}", linewidth=0.8, color=COLOURS[stage])
    case = cases["before"]
    dynamic = case.analysis == "dynamic"
    if dynamic and run.settle:
        settled = np.concatenate([c.record[time >= run.settle] for c in cases.values()]) / arcmin
        room = 0.08 * np.ptp(settled)
        ax.set_ylim(settled.min() - room, settled.max() + room)
    finish(ax, case.title, y="backlash [arcmin]" if case.analysis == "backlash" else "TE [arcmin]")
    _above(ax)


def _spectra(ax: Axes, optimisation: Optimisation, cases: dict[str, Case]) -> None:
    scene = optimisation.scene
    run, orders = required_run(scene), scene.system.orders
    theta = run.times * float(scene.system.input_speed)
    turn = 2 * np.pi / orders["output"]
    dynamic = cases["before"].analysis == "dynamic"
    start = int(np.searchsorted(theta, run.settle * float(scene.system.input_speed))) if dynamic else 0
    fastest, drawn = max(order for name, order in orders.items() if name != "mesh"), 0.0
    for stage, case in cases.items():
        spectrum = order_spectrum(case.record[start:], theta[start:], turn=turn, window="hann")
        height = np.asarray(spectrum.amplitude) / arcmin
        ax.plot(spectrum.order, height, label=stage, linewidth=0.9, color=COLOURS[stage])
        drawn = max(drawn, height.max())
    highest = np.pi / (theta[1] - theta[0]) * turn / (2 * np.pi)
    ax.set_xlim(0, min(6 * fastest / orders["output"], highest))
    if drawn > 0:  # without errors the no-load TE is zero and has no logarithmic scale
        ax.set_yscale("log")
        ax.set_ylim(1e-5 * drawn, 3 * drawn)
    finish(ax, f"{cases['before'].title}: spectrum", x="order [cycles per turn of the output]", y="amplitude [arcmin]")
    _above(ax)


def search_figure(optimisation: Optimisation) -> Figure:
    """End points of the starts, their descent, directions of curvature, and the cost of assembly errors."""
    figure, axes = new_figure(2, 2, width=12.0, height=3.6)
    _ends(axes[0], optimisation)
    _history(axes[1], optimisation)
    _directions(axes[2], optimisation)
    _deviations(axes[3], optimisation)
    return figure


def _reference_lines(ax: Axes, optimisation: Optimisation) -> None:
    before, grid, size = optimisation.before, optimisation.grid, optimisation.unit.per_shown
    ax.axhline(before / size, label="before", linestyle="--", linewidth=0.9, color=COLOURS["before"])
    if grid is not None:
        ax.axhline(grid.objective / size, label="best of the grid", linewidth=0.9, color=COLOURS["grid"])


def _ends(ax: Axes, optimisation: Optimisation) -> None:
    search = optimisation.gradient
    good = np.isfinite(search.objectives)
    order = np.argsort(search.objectives[good])
    heights, valleys = search.objectives[good][order] / optimisation.unit.per_shown, search.valley[good][order]
    place = np.arange(1, heights.size + 1)
    named = list(dict.fromkeys(valleys.tolist()))[:NAMED_VALLEYS]
    for valley in named:
        mine = valleys == valley
        label = f"valley {valley + 1}: {mine.sum()} start{'s' if mine.sum() > 1 else ''}"
        ax.plot(place[mine], heights[mine], ".", markersize=5, label=label)
    others = ~np.isin(valleys, named)
    if others.any():
        number = len(set(valleys[others].tolist()))
        label = f"{number} other valleys: {others.sum()} starts" if number > 1 else f"one other: {others.sum()}"
        ax.plot(place[others], heights[others], ".", markersize=5, color="0.6", label=label)
    _reference_lines(ax, optimisation)
    objective = f"{optimisation.section.objective.name.replace('_', ' ')} [{optimisation.unit.shown}]"
    finish(ax, f"End points of {len(search.starts)} starts, best first", x="start [-]", y=objective)
    ax.legend(fontsize="small", loc="best", framealpha=0.8)


def _history(ax: Axes, optimisation: Optimisation) -> None:
    history = optimisation.gradient.history[np.isfinite(optimisation.gradient.objectives)] / optimisation.unit.per_shown
    steps = np.arange(history.shape[1])
    low, middle, high = np.quantile(history, [0.1, 0.5, 0.9], axis=0)
    ax.fill_between(steps, low, high, alpha=0.25, color="tab:red", label="10 to 90 % of the starts")
    ax.plot(steps, middle, color="tab:red", linewidth=1.2, label="median")
    ax.plot(steps, np.fmin.reduce(history, axis=0), color="black", linewidth=0.9, label="best")
    _reference_lines(ax, optimisation)
    finish(
        ax,
        "Objective during the search: smoothed, then refined",
        x="evaluations of objective and gradient per start [-]",
        y=f"objective [{optimisation.unit.shown}]",
    )
    ax.legend(fontsize="small", loc="best", framealpha=0.8)


def _directions(ax: Axes, optimisation: Optimisation) -> None:
    around = optimisation.sensitivity
    names = [_short(path) for path in around.paths]
    width = 0.8 / len(names)
    place = np.arange(len(around.rises))
    for index, name in enumerate(names):
        ax.bar(place + (index + 0.5) * width - 0.4, around.directions[:, index], width, label=name)
    costs = [
        optimisation.rise_shown(rise) + ("\nflat" if flat else "")
        for rise, flat in zip(around.rises, around.flat, strict=True)
    ]
    ax.set_xticks(place, costs)
    finish(
        ax,
        "Directions of curvature",
        x=f"rise of the objective by {around.told(FLAT_STEP)} along the direction",
        y="share of each number [-]",
    )
    ax.legend(fontsize="small", loc="best", framealpha=0.8)


def _deviations(ax: Axes, optimisation: Optimisation) -> None:
    around, unit = optimisation.sensitivity, optimisation.unit
    names = [_short(path) for path in around.paths]
    place = np.arange(len(names) + 2)
    width = 0.8 / len(around.deviations)
    for index, deviation in enumerate(around.deviations):
        single = around.single[index].max(axis=1)
        heights = np.array([*single, around.mean[index], around.worst[index]]) / unit.per_shown
        ax.bar(place + (index + 0.5) * width - 0.4, heights, width, label=f"error of {around.told(deviation)}")
    ax.axhline(around.objective / unit.per_shown, color="black", linewidth=0.9, label="as optimised")
    if (grid := optimisation.grid) is not None:
        ax.axhline(grid.objective / unit.per_shown, label="best of the grid", linewidth=0.9, color=COLOURS["grid"])
    ax.set_xticks(place, [*names, "all: mean", "all: worst"], rotation=20, ha="right", fontsize="small")
    finish(ax, "Effect of assembly errors", x="number with an error", y=f"objective [{unit.shown}]")
    ax.set_ylim(0.0, 1.4 * ax.get_ylim()[1])  # room for the legend
    ax.legend(fontsize="small", loc="upper left", framealpha=0.8)


def _short(path: str) -> str:
    """``planet_1`` for the phase of planet_1; for other numbers the path without its section."""
    parts = path.split(".")[1:]
    return parts[0] if parts[-1] == "phase" else ".".join(parts)


def save_optimisation_figures(optimisation: Optimisation, folder: Path) -> list[Path]:
    """Write ``before_after.png`` and ``search.png``.

    Raises:
        GearjaxError: a file cannot be written.
    """
    figures = {"before_after.png": before_after_figure(optimisation), "search.png": search_figure(optimisation)}
    return [save_figure(figure, folder / name) for name, figure in figures.items()]
