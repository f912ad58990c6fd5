"""Figures of non-circular gears: teeth, a close-up of the mesh, pressure angles, levers, ratio and contact ratio."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gearjax.checks import GearjaxError, ParameterError, SceneError, with_article
from gearjax.geometry.noncircular_outline import outline, placed
from gearjax.geometry.noncircular_teeth import circular_contact_ratio
from gearjax.plot.axes import finish, gear_set_of
from gearjax.scene import Scene
from gearjax.systems import AbstractNoncircularPair
from gearjax.typing import Array
from gearjax.units import deg, mm

ANGLES = 361  # angles of a turn
POINTS = 24  # points of each flank, tip and root
NEAR = 4.0  # modules around the pitch point that the close-up shows
COLOURS = "C0", "C1"
PER_SECOND = 20  # frames of an animation
NAMES = "driver", "driven"


def noncircular_figure(scene: Scene, theta: float = 0.0) -> Figure:
    """Draw non-circular gears at an input angle, and how their mesh changes over a turn of the driver.

    The gears are drawn whole, and in a close-up with the lines of action. Curves show ratio, pressure angles, levers
    and contact ratio over a turn of the driver.

    Args:
        scene: scene with a non-circular pair.
        theta: input angle [rad].

    Raises:
        SceneError: the scene has another gear set.
    """
    system = gear_set_of(scene.system, "non-circular gears", AbstractNoncircularPair)
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    (whole, near), (left, right) = figure.subplots(2, 2)
    _draw_gears(scene, system, theta, whole, near)
    _draw_turn(system, theta, left, right)
    return figure


def _draw_gears(scene: Scene, system: AbstractNoncircularPair, theta: float, whole: Axes, near: Axes) -> None:
    backlash = _backlash(scene)
    distance = float(system.curves.centre_distance)
    driven = float(system.output(jnp.asarray(theta)))
    for gear, turned in enumerate((theta, driven)):
        points = placed(outline(system.teeth_of(system.bodies[gear], POINTS, backlash)), gear, turned, distance) / mm
        points = np.concatenate([points, points[:1]])
        for ax in (whole, near):
            ax.plot(*points.T, color=COLOURS[gear], linewidth=1.0, label=NAMES[gear])
        whole.plot(gear * distance / mm, 0.0, "+", color="black")
        near.fill(*points.T, color=COLOURS[gear], alpha=0.12)
    at = system.curves.at(jnp.asarray(theta))
    pitch = float(at.radius) / mm
    reach = NEAR * float(system.module) / mm
    for side, style, name in ((1.0, "-", "driving"), (-1.0, "--", "back")):
        slant = float(system.curves.normal_angle(jnp.asarray(theta), jnp.asarray(side)))
        way = reach * np.array([-1.0, 1.0])
        label = f"line of action, {name}"
        near.plot(
            pitch + way * np.sin(slant), side * way * np.cos(slant), style, color="0.4", linewidth=0.9, label=label
        )
    whole.set_aspect("equal")
    near.set_aspect("equal")
    near.set(xlim=(pitch - reach, pitch + reach), ylim=(-reach, reach))
    turn = theta / deg % 360
    finish(whole, f"driver at {turn:.1f} deg, turning counter-clockwise", x="x [mm]", y="y [mm]")
    finish(near, f"near the pitch point, backlash {backlash / mm * 1e3:.4g} um", x="x [mm]", y="y [mm]")


@eqx.filter_jit  # one program, because single operations would each be compiled separately
def _turn(system: AbstractNoncircularPair, t: Array) -> tuple[Array, ...]:
    curves = system.curves
    at = curves.at(t)
    slants = [curves.normal_angle(t, jnp.asarray(side, t.dtype)) for side in (1.0, -1.0)]
    levers = [at.driven_radius * jnp.cos(slant) for slant in slants]
    return at.ratio, *slants, *levers, circular_contact_ratio(curves, t, system.module, system.addendum)


def _draw_turn(system: AbstractNoncircularPair, theta: float, left: Axes, right: Axes) -> None:
    t = np.linspace(0.0, 2 * np.pi, ANGLES)
    ratio, drive, back, lever, other, contact = (np.asarray(part) for part in _turn(system, jnp.asarray(t)))
    for values, style, name in ((drive, "-", "driving flanks"), (back, "--", "back flanks")):
        left.plot(t / deg, values / deg, style, color="C2", label=name)
    for values, style, name in ((lever, "-", "driving flanks"), (other, "--", "back flanks")):
        right.plot(t / deg, values / mm, style, color="C3", label=name)
    for ax, values, label, colour in ((left, ratio, "ratio [-]", "C4"), (right, contact, "contact ratio [-]", "C5")):
        beside = ax.twinx()
        beside.plot(t / deg, values, color=colour)
        beside.set_ylabel(label, color=colour)
        beside.tick_params(axis="y", colors=colour)
        ax.axvline(theta / deg % 360, color="0.6", linewidth=0.8, linestyle=":")
        ax.set(xlabel="input angle [deg]", xlim=(0, 360), xticks=range(0, 361, 60))
        ax.grid(alpha=0.3)
    left.set_ylabel("pressure angle [deg]")
    right.set_ylabel("lever on the driven gear [mm]")
    for ax in (left, right):
        ax.legend(fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)


def save_noncircular_animation(scene: Scene, path: str | Path, *, frames: int = 120) -> Path:
    """Write an animation of the gears over one turn of the driver, without errors, as a GIF or, with ffmpeg, an MP4.

    Args:
        scene: scene with a non-circular pair.
        path: path of the file, which ends in ``.gif`` or ``.mp4``.
        frames: number of frames of a turn.

    Returns:
        The path.

    Raises:
        ParameterError: the path has another ending, there are fewer than two frames, or an MP4 is asked for without
            ffmpeg.
        SceneError: the scene has another gear set.
        GearjaxError: the file cannot be written.
    """
    from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter

    system, path = scene.system, Path(path)
    if not isinstance(system, AbstractNoncircularPair):
        raise SceneError(f"an animation is of non-circular gears, which those of {with_article(system.kind)} are not")
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise ParameterError("path", str(path), "must end in .gif or .mp4")
    if path.suffix.lower() == ".mp4" and not FFMpegWriter.isAvailable():
        raise ParameterError("path", str(path), "needs the program ffmpeg: install it, or give a .gif")
    if isinstance(frames, bool) or not isinstance(frames, int) or frames < 2:
        raise ParameterError("frames", frames, "must be a whole number, at least 2")
    angles = 2 * np.pi * np.arange(frames) / frames
    turned = np.asarray(jax.vmap(system.output)(jnp.asarray(angles)))
    gears = [outline(system.teeth_of(body, POINTS, _backlash(scene))) for body in system.bodies]
    distance = float(system.curves.centre_distance)
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    ax = figure.subplots()
    lines = [ax.plot([], [], color=colour, linewidth=0.8)[0] for colour in COLOURS]
    reach = max(float(np.hypot(*gear.T).max()) for gear in gears) / mm
    ax.set(aspect="equal", xlim=(-reach, distance / mm + reach), ylim=(-reach, reach), xlabel="x [mm]", ylabel="y [mm]")

    def draw(number: int) -> list[Line2D]:
        for gear, line in enumerate(lines):
            angle = float((angles, turned)[gear][number])
            points = placed(gears[gear], gear, angle, distance) / mm
            line.set_data(*np.concatenate([points, points[:1]]).T)
        ax.set_title(f"driver at {angles[number] / deg:.1f} deg", fontsize="medium")
        return lines

    film = FuncAnimation(figure, draw, frames=frames)
    writer = PillowWriter(fps=PER_SECOND) if path.suffix.lower() == ".gif" else FFMpegWriter(fps=PER_SECOND)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        film.save(path, writer=writer, dpi=100)
    except OSError as fault:
        raise GearjaxError(f"{path}: cannot be written: {fault}") from fault
    return path


def _backlash(scene: Scene) -> float:
    return 0.0 if scene.backlash is None else float(scene.backlash.initial)
