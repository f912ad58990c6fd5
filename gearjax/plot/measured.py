"""Figures of measured gears: flank deviations as maps, pitch deviations tooth by tooth."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gearjax.errors import MeasuredFlank, MeasuredPitch
from gearjax.errors.measured import FLANKS
from gearjax.plot.axes import finish
from gearjax.scene import Scene
from gearjax.units import mm, um

MOST_MAPS = 4  # largest number of teeth that are drawn of a flank


def measured_figure(scene: Scene) -> Figure:
    """Draw the measured flanks and pitches of a scene.

    Each measured flank has a row with a map of deviations for each of its first teeth. Each gear with measured pitches
    has a row too.

    Args:
        scene: scene with `MeasuredFlank` or `MeasuredPitch` among its errors.
    """
    flanks = [(name, error) for name, error in scene.errors.items() if isinstance(error, MeasuredFlank)]
    pitches: dict[str, list[MeasuredPitch]] = {}
    for error in scene.errors.values():
        if isinstance(error, MeasuredPitch):
            pitches.setdefault(error.body, []).append(error)
    figure = Figure(figsize=(11.0, 3.2 * (len(flanks) + len(pitches))), layout="constrained")
    rows = iter(np.ravel(figure.subfigures(len(flanks) + len(pitches), 1, squeeze=False)))
    for name, flank in flanks:
        _draw_flank(next(rows), name, flank)
    for body, own in pitches.items():
        _draw_pitches(next(rows).subplots(), body, own)
    return figure


def _draw_flank(figure, name: str, flank: MeasuredFlank) -> None:
    """Draw the maps of a flank, one for each tooth, with a common scale."""
    shown = np.asarray(flank.grid)[:MOST_MAPS] / um
    axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    most = max(float(np.abs(shown).max()), 1e-9)
    roll, across = (np.asarray(part) / mm for part in (flank.roll, flank.across))
    for number, (ax, grid) in enumerate(zip(axes, shown, strict=True)):
        corners = np.broadcast_to(grid.T, (max(across.size, 2), max(roll.size, 2)))
        drawn = ax.pcolormesh(
            _ends(roll),
            _ends(across),
            corners,
            cmap="RdBu_r",
            vmin=-most,
            vmax=most,
            shading="gouraud",
            rasterized=True,
        )
        told = f"tooth {int(flank.teeth[number])}" if flank.teeth.size else f"tooth {number}"
        ax.set_title(told if flank.grids > 1 or flank.teeth.size else "all teeth", fontsize="medium")
        ax.set_xlabel("length of roll [mm]" if roll.size > 1 else "the same over the roll")
        if roll.size == 1:
            ax.set_xticks([])
    axes[0].set_ylabel("across the face [mm]" if across.size > 1 else "the same across the face")
    if across.size == 1:
        axes[0].set_yticks([])
    figure.colorbar(drawn, ax=axes, label="material beyond the ideal flank [um]")
    more = f", {len(shown)} of {flank.grids} measured teeth" if flank.grids > len(shown) else ""
    figure.suptitle(f"{name}: {_flanks(flank.flank)} of {flank.body}{more}")


def _ends(places: np.ndarray) -> np.ndarray:
    """The places; a single one stands for the whole width or height, drawn from 0 to 1."""
    return places if places.size > 1 else np.array([0.0, 1.0])


def _draw_pitches(ax: Axes, body: str, pitches: list[MeasuredPitch]) -> None:
    """Draw cumulative deviations tooth by tooth, one curve for each flank."""
    most = max(np.size(pitch.deviation) for pitch in pitches)
    for pitch in pitches:
        values = np.asarray(pitch.deviation) / um
        shown = np.full(max(most, 2), values[0]) if values.size == 1 else values
        marker = "" if values.size == 1 else "o"
        ax.plot(np.arange(shown.size), shown, marker=marker, markersize=3, linewidth=1.0, label=_flanks(pitch.flank))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    teeth = "tooth" if most > 1 else "the same for all teeth"
    finish(ax, f"Cumulative pitch deviation of {body}", x=teeth, y="flank ahead by [um]")
    if most == 1:
        ax.set_xticks([])


def _flanks(flank: str) -> str:
    return f"{flank} flanks" if flank in FLANKS else "both flanks"
