"""Figure of periodic motions over the input speed."""

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from gearjax.analysis import NaturalModes, Waterfall
from gearjax.plot.axes import finish, new_figure
from gearjax.units import arcmin, rpm

FAINT = 1e-3  # share of the largest amplitude at which the colour scale begins


def waterfall_figure(waterfall: Waterfall, modes: NaturalModes | None = None) -> Figure:
    """Draw peak-to-peak TE and dynamic factor over the speed, and a Campbell diagram.

    The Campbell diagram shows amplitudes by speed and frequency, with natural frequencies as dashed lines. Speeds
    without a stable motion are marked.

    Args:
        waterfall: periodic motions of one scene.
        modes: natural modes of the same scene, to be marked.
    """
    speed = np.asarray(waterfall.speeds) / rpm
    figure, (height, factor, map_) = new_figure(3, height=2.8)
    swing = np.asarray(waterfall.peak_to_peak) / arcmin
    lost = ~np.asarray(waterfall.stable) | (np.asarray(waterfall.result) != 0)
    for ax, values, y in (
        (height, swing, "TE, peak-to-peak [arcmin]"),
        (factor, np.asarray(waterfall.dynamic_factor), "dynamic factor [-]"),
    ):
        ax.plot(speed, np.where(lost, np.nan, values), linewidth=1.2)
        if lost.any():
            ax.plot(speed[lost], values[lost], "x", markersize=4, color="tab:red", label="unstable, or no solution")
        finish(ax, "", x="input speed [rpm]", y=y)
    height.set_title(f"Motions that repeat with order {float(waterfall.orders[0]):g}")
    amplitude = np.where(lost[:, None], np.nan, np.asarray(waterfall.amplitudes)) / arcmin
    frequency = np.outer(speed / 60, np.asarray(waterfall.orders))
    largest = float(np.nanmax(amplitude, initial=1e-12))
    scale = LogNorm(FAINT * largest, largest)
    drawn = map_.scatter(
        np.repeat(speed, amplitude.shape[1]), frequency, c=np.clip(amplitude, FAINT * largest, None), s=6, norm=scale
    )
    figure.colorbar(drawn, ax=map_, label="amplitude of the TE [arcmin]")
    for natural in () if modes is None else np.asarray(modes.frequencies):
        if 0 < natural <= frequency.max():
            map_.axhline(natural, color="0.4", linewidth=0.8, linestyle="--")
    finish(
        map_,
        f"Amplitudes of multiples of order {float(waterfall.orders[0]):g}",
        x="input speed [rpm]",
        y="frequency [Hz]",
    )
    return figure
