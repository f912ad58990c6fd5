"""Figure of the static transmission error against the torque."""

import numpy as np
from matplotlib.figure import Figure

from gearjax.analysis.torque_sweep import TorqueSweep
from gearjax.plot.axes import COLOURS, finish, new_figure
from gearjax.units import arcmin


def torque_sweep_figure(sweep: TorqueSweep) -> Figure:
    """Draw the swing of the static TE and its harmonics against the torque, and the mean TE below.

    Args:
        sweep: result of `torque_sweep`.
    """
    figure, (swing, mean) = new_figure(2)
    order = np.argsort(np.asarray(sweep.torques))
    torques = np.asarray(sweep.torques)[order]
    name = sweep.order
    swing.plot(torques, np.asarray(sweep.peak_to_peak)[order] / arcmin, ".-", color="black", label="peak to peak")
    for number, amplitudes in enumerate(np.asarray(sweep.harmonics)[order].T):
        colour = COLOURS[number % len(COLOURS)]
        words = f"harmonic {number + 1} of the {name} order"
        swing.plot(torques, amplitudes / arcmin, ".-", color=colour, linewidth=1.0, label=words)
    swing.set_ylim(bottom=0.0)
    finish(swing, "Static transmission error against the torque", x="load torque [N m]", y="swing, amplitudes [arcmin]")
    mean.plot(torques, np.asarray(sweep.mean)[order] / arcmin, ".-", color="black")
    finish(mean, "Mean", x="load torque [N m]", y="mean TE [arcmin]")
    return figure
