"""Figures of measured gears: flank deviations as maps, pitch deviations tooth by tooth."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
    places = [np.asarray(part) / mm for part in (flank.roll, flank.across)]
    for number, (ax, grid) in enumerate(zip(axes, shown, strict=True)):
        # a single place stands for the whole width or the whole height
        edges = [np.array([part[0] - 1, part[0] + 1]) if part.size == 1 else _edges(part) for part in places]
        drawn = ax.pcolormesh(edges[0], edges[1], grid.T, cmap="RdBu_r", vmin=-most, vmax=most)
        told = f"tooth {int(flank.teeth[number])}" if flank.teeth.size else f"tooth {number}"
        ax.set_title(told if flank.grids > 1 or flank.teeth.size else "all teeth", fontsize="medium")
        ax.set_xlabel("length of roll [mm]")
    axes[0].set_ylabel("across the face [mm]")
    figure.colorbar(drawn, ax=axes, label="material beyond the ideal flank [um]")
    more = f", {len(shown)} of {flank.grids} measured teeth" if flank.grids > len(shown) else ""
    figure.suptitle(f"{name}: {_flanks(flank.flank)} of {flank.body}{more}")


def _edges(places: np.ndarray) -> np.ndarray:
    """Boundaries of the cells around places."""
    middles = 0.5 * (places[1:] + places[:-1])
    return np.concatenate([places[:1], middles, places[-1:]])


def _draw_pitches(ax: Axes, body: str, pitches: list[MeasuredPitch]) -> None:
    """Draw cumulative deviations tooth by tooth, one curve for each flank."""
    for pitch in pitches:
        values = np.asarray(pitch.deviation) / um
        ax.plot(np.arange(values.size), values, marker="o", markersize=3, linewidth=1.0, label=_flanks(pitch.flank))
    finish(ax, f"Cumulative pitch deviation of {body}", x="tooth", y="flank ahead by [um]")


def _flanks(flank: str) -> str:
    return f"{flank} flanks" if flank in FLANKS else "both flanks"
