"""Drawings of cycloidal stages to scale: discs, pins and contact forces."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from gearjax.geometry.cycloid import profile
from gearjax.plot.axes import save_figure
from gearjax.systems import RVCycloidal
from gearjax.typing import ArrayLike
from gearjax.units import mm

POINTS_PER_TOOTH = 60
LONGEST_ARROW = 0.35  # share of the radius of the pin circle


def stage_figure(system: RVCycloidal, theta: float, forces: ArrayLike | None = None) -> Figure:
    """Draw each disc among its pins at an input angle, and the force of each pin on the disc, to scale.

    Args:
        system: the reducer.
        theta: input angle [rad].
        forces: contact forces, shape (contact,) [N].
    """
    figure = Figure(figsize=(6.2 * system.discs, 6.4), layout="constrained")
    axes = figure.subplots(1, system.discs, squeeze=False)[0]
    own = np.zeros((system.discs, system.pins)) if forces is None else np.asarray(forces).reshape(system.discs, -1)
    disc = system.profile
    circle, throw, short = (float(x) for x in (disc.pin_circle / mm, disc.throw / mm, disc.short_width))
    places = 2 * np.pi * np.arange(system.pins) / system.pins
    pins = circle * np.stack([np.cos(places), np.sin(places)], axis=1)
    largest = max(float(own.max()), 1e-12)
    for index, ax in enumerate(axes):
        crank = system.orders["crank"] * theta + 2 * np.pi * index / system.discs
        centre = throw * np.array([np.cos(crank), np.sin(crank)])
        ax.fill(*placed_outline(system, crank).T / mm, facecolor="0.92", edgecolor="tab:blue", linewidth=0.8)
        radius = float(disc.pin_radius / mm)
        ax.add_collection(PatchCollection([Circle(tuple(p), radius) for p in pins], facecolor="none", edgecolor="0.3"))
        pitch_point = short * circle * np.array([np.cos(crank), np.sin(crank)])
        carrying = own[index] > 0
        towards = pitch_point - pins[carrying]
        size = LONGEST_ARROW * circle * own[index][carrying] / largest
        arrows = towards / np.linalg.norm(towards, axis=1, keepdims=True) * size[:, None]
        if carrying.any():
            ax.quiver(*pins[carrying].T, *arrows.T, angles="xy", scale_units="xy", scale=1, color="tab:red", width=4e-3)
        ax.plot(*centre, "+", color="tab:blue", label="axis of the disc")
        ax.plot(*pitch_point, "x", color="tab:red", markersize=5, label="pitch point")
        if forces is not None:
            ax.plot([], [], color="tab:red", marker=r"$\rightarrow$", linestyle="none", label="force of a pin")
        ax.legend(loc="lower right", fontsize="small")
        ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        words = f", longest arrow {largest:.0f} N" if forces is not None else ""
        ax.set_title(f"disc {index + 1}, crank at {np.degrees(crank) % 360:.1f} deg{words}", fontsize="medium")
    return figure


def placed_outline(system: RVCycloidal, crank: float) -> np.ndarray:
    """Outline of a disc among the pins, with its throw at an angle from the first pin [rad]; shape (n, 2) [m]."""
    disc, turn = system.profile, -crank / (system.pins - 1)
    phase = np.linspace(0.0, 2 * np.pi * disc.teeth, POINTS_PER_TOOTH * disc.teeth + 1)
    outline = np.asarray(profile(disc, jnp.asarray(phase))) * [1.0, -1.0]  # its mirror image rolls in the ring
    turned = outline @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return turned + float(disc.throw) * np.array([np.cos(crank), np.sin(crank)])


def save_stage_figure(system: RVCycloidal, theta: float, forces: ArrayLike | None, path: Path) -> Path:
    """Write `stage_figure` as PNG.

    Raises:
        GearjaxError: the file cannot be written.
    """
    return save_figure(stage_figure(system, theta, forces), path)
