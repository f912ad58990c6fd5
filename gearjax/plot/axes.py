"""Helpers that all figures share. Angles are drawn in arcmin, forces in N, times in seconds."""

import contextlib
import io
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gearjax.checks import SceneError, with_article
from gearjax.files import write_file
from gearjax.systems.base import AbstractSystem
from gearjax.typing import ArrayLike
from gearjax.units import arcmin, deg

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
"""Colours of Okabe and Ito (2008), which colour-blind readers tell apart, and a grey."""
STYLES = ("-", "--", ":", "-.")
MOST_DEGREES = 3600.0  # longer records show turns of the input
MOST_POINTS = 20_000  # largest number of points drawn per curve
Shown = TypeVar("Shown", bound=AbstractSystem)
DPI = 130  # of figures as pixels
_kept: ContextVar[dict[str, Figure] | None] = ContextVar("_kept", default=None)


def gear_set_of(system: AbstractSystem, drawn: str, *kinds: type[Shown]) -> Shown:
    """A gear set of the kinds that a figure draws.

    Args:
        system: the gear set.
        drawn: words for what the figure draws.
        kinds: classes of these gear sets.

    Raises:
        SceneError: it is of another kind.
    """
    if not isinstance(system, kinds):
        raise SceneError(f"this figure draws {drawn}, the scene has {with_article(system.kind)}")
    return system


def thin(*arrays: ArrayLike) -> tuple[np.ndarray, ...]:
    """Every k-th sample, so that no curve has more than `MOST_POINTS`."""
    drawn = [np.asarray(array) for array in arrays]
    every = max(1, len(drawn[0]) // MOST_POINTS)
    return tuple(array[::every] for array in drawn)


def new_figure(
    rows: int = 1, columns: int = 1, *, width: float = 8.0, height: float = 3.2
) -> tuple[Figure, list[Axes]]:
    """A figure with rows and columns of axes, independent of any interactive window."""
    figure = Figure(figsize=(width, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, [ax for row in axes for ax in row]


def draw_curve(ax: Axes, time: ArrayLike, angle: ArrayLike, label: str, **style) -> None:
    """Draw an angle [rad] over time [s], in arcmin."""
    time, angle = thin(time, angle)
    ax.plot(time, angle / arcmin, label=label, linewidth=style.pop("linewidth", 1.0), **style)


def styles_of(names: Iterable[str]) -> dict[str, dict[str, str]]:
    """Colour and line style of each case: one of them means one case in all panels of a figure."""
    return {
        name: {"color": COLOURS[place % len(COLOURS)], "linestyle": STYLES[place // len(COLOURS) % len(STYLES)]}
        for place, name in enumerate(dict.fromkeys(names))
    }


def add_input_angle(ax: Axes, speed: float) -> None:
    """Add an axis of the input angle above a time axis.

    Args:
        ax: axes over time [s].
        speed: speed of the input [rad/s].
    """
    last = speed * ax.get_xlim()[1] / deg
    unit, words = (deg, "input angle [deg]") if last <= MOST_DEGREES else (360 * deg, "turns of the input [-]")
    per_second = speed / unit

    def angle_at(time: npt.ArrayLike) -> npt.ArrayLike:
        return np.asarray(time) * per_second

    def time_of(angle: npt.ArrayLike) -> npt.ArrayLike:
        return np.asarray(angle) / per_second

    above = ax.secondary_xaxis("top", functions=(angle_at, time_of))
    above.set_xlabel(words, fontsize="small")
    above.tick_params(labelsize="small")


def finish(ax: Axes, title: str, x: str = "time [s]", y: str = "transmission error [arcmin]") -> None:
    """Add title, labels, grid and legend."""
    ax.set(title=title, xlabel=x, ylabel=y)
    ax.grid(alpha=0.3)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0.0, frameon=False)
    ax.margins(x=0.01)


@contextlib.contextmanager
def figures_kept() -> Iterator[dict[str, Figure]]:
    """Keep the figures that are saved in the block, by the names of their files."""
    figures: dict[str, Figure] = {}
    token = _kept.set(figures)
    try:
        yield figures
    finally:
        _kept.reset(token)


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure in the format that its file name ends in: ``.png``, or ``.svg`` and ``.pdf`` for vector graphics.

    Raises:
        GearjaxError: the file cannot be written.
    """
    kept = _kept.get()
    if kept is not None:
        kept[path.name] = figure
    drawn = io.BytesIO()
    kind = path.suffix.removeprefix(".") or "png"
    with _laid_out(figure) if kind == "png" else contextlib.nullcontext():
        figure.savefig(drawn, dpi=DPI, format=kind)
    return write_file(path, drawn.getvalue())


@contextlib.contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """Place everything once; matplotlib alone would draw the whole figure a second time to do so."""
    engine, dpi = figure.get_layout_engine(), figure.dpi
    if engine is None:
        yield
        return
    figure.set_dpi(DPI)
    try:
        engine.execute(figure)
        figure.set_layout_engine(None)  # "none" would leave a placeholder, for which it is drawn twice too
        yield
    finally:
        figure.set_layout_engine(engine)
        figure.set_dpi(dpi)
