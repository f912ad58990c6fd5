"""Figure of the torsional stiffness over input angles."""

import numpy as np
from matplotlib.figure import Figure

from gearjax.analysis import MeshStiffness
from gearjax.plot.axes import finish, new_figure, thin
from gearjax.units import arcmin, deg


def stiffness_figure(stiffness: MeshStiffness, title: str = "") -> Figure:
    """Draw secant and tangent torsional stiffness over input angles, in N m/arcmin and degrees.

    Args:
        stiffness: stiffness of one scene.
        title: title of the figure; without it the title names the torque.
    """
    figure, (ax,) = new_figure()
    for name, values in (("secant", stiffness.secant), ("tangent", stiffness.tangent)):
        angle, drawn = thin(stiffness.theta / deg, values * arcmin)
        ax.plot(angle, drawn, label=f"{name}: mean {np.mean(drawn):.4g}", linewidth=1.2)
    ends = sorted({f"{float(torque):g}" for torque in (stiffness.torque.min(), stiffness.torque.max())}, key=float)
    told = title or f"Torsional stiffness under {' to '.join(ends)} N m"
    finish(ax, told, x="input angle [deg]", y="stiffness [N m/arcmin]")
    ax.set_ylim(bottom=0.0)
    return figure
