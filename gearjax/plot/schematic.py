"""Schematic of a gear set: its bodies, where the phases of their errors begin, lines of action, torque and TE."""

import math
from typing import Literal

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon

from gearjax.checks import SceneError, with_article
from gearjax.contact import Request
from gearjax.errors import Eccentricity
from gearjax.plot.axes import COLOURS
from gearjax.scene import Scene
from gearjax.sketch import MIDDLE, THROW, Point, Sketch, beyond
from gearjax.systems.base import pose_of
from gearjax.units import deg, um

LONGEST, SHORTEST = 0.3, 0.08  # lengths of the arrows of run-outs
ZERO = 0.34  # length of the line at phase zero
LINE = 0.3  # half the length of a line of action
TORQUE, AHEAD = "#B00020", "0.15"


def schematic_figure(scene: Scene) -> Figure:
    """Draw the bodies of a gear set at input angle zero, with the run-outs of the scene; not to scale.

    A dashed line on each body shows where phase zero points, with an arc in the sense in which phases count; an arrow
    shows each run-out in its direction. Lines of action are drawn through the pitch points, solid for driving flanks
    and dotted for back flanks. Arrows at the output show a positive transmission error and a positive torque.

    Args:
        scene: the scene.

    Raises:
        SceneError: the gear set gives no sketch.
    """
    sketch = scene.system.sketch()
    if sketch is None:
        raise SceneError(f"{with_article(scene.system.kind)} gives no sketch: add a method sketch to its class")
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    ax = figure.subplots()
    colours = {body.name: COLOURS[index % len(COLOURS)] for index, body in enumerate(sketch.bodies)}
    _draw_bodies(ax, sketch, colours)
    handles = [
        *_drawn_output(ax, sketch),
        *_drawn_lines_of_action(ax, scene, sketch),
        *_drawn_run_outs(ax, scene, sketch, colours),
    ]
    others = {key: error for key, error in scene.errors.items() if not isinstance(error, Eccentricity)}
    labels = [f"{key}: {error.kind} of {error.body}" for key, error in others.items()]
    handles += [Line2D([], [], linestyle="none", label=words) for words in labels]
    figure.legend(handles=handles, loc="outside right upper", fontsize="small", frameon=False)
    ax.set_aspect("equal")
    ax.margins(0.08)
    if sketch.throws:
        ax.set_xlim(-1.4, 1.55)  # room for words beside the ring
    ax.axis("off")
    ax.set_title(f"{scene.system.kind} at input angle 0, not to scale", fontsize="medium")
    return figure


def _draw_bodies(ax: Axes, sketch: Sketch, colours: dict[str, str]) -> None:
    if sketch.throws:  # the ring in which the wheels roll
        ax.add_patch(Circle(MIDDLE, 1.0, facecolor="none", edgecolor="0.45", linewidth=2.5))
        ax.text(0.0, 1.03, "fixed ring", ha="center", va="bottom", fontsize="small", color="0.35")
    for index, body in enumerate(sketch.bodies):
        colour = colours[body.name]
        if body.outline:
            ax.add_patch(Polygon(body.outline, facecolor=colour, alpha=0.08))
            ax.add_patch(Polygon(body.outline, facecolor="none", edgecolor=colour))
        elif body.radius and (body.turns or not sketch.throws):
            ax.add_patch(Circle(body.axis, body.radius, facecolor=colour, alpha=0.08))
            ax.add_patch(Circle(body.axis, body.radius, facecolor="none", edgecolor=colour))
        ax.plot(*body.axis, "+", color=colour, markersize=8)
        if body.turns:
            reach = body.radius or 0.45
            _turning_arrow(ax, body.axis, 0.85 * reach, 0.6 * np.pi + 0.2 * index, body.turns, colour)
    _name_bodies(ax, sketch, colours)
    for throw in sketch.throws:
        _arrow(ax, MIDDLE, beyond(MIDDLE, throw, THROW), "0.3", width=1.6)
    if sketch.throws:
        _turning_arrow(ax, MIDDLE, 1.12, -0.12 * np.pi, 1, "0.35")
        ax.text(1.14, -0.1, "crank turns", color="0.35", fontsize="small", va="center")


def _name_bodies(ax: Axes, sketch: Sketch, colours: dict[str, str]) -> None:
    """Names of the bodies: of wheels on cranks at their rim, of what shares the central axis in a corner."""
    central = [body for body in sketch.bodies if sketch.throws and body.axis == MIDDLE]
    named: list[tuple[float, float]] = []
    for body in sketch.bodies:
        if body in central:
            continue
        below = 12 * sum(math.dist(body.axis, other) < 1e-6 for other in named)  # bodies on one shaft share their axis
        named.append(body.axis)
        place = beyond(body.axis, body.frame - 0.35 * np.pi, 0.78 * body.radius) if sketch.throws else body.axis
        colour = colours[body.name]
        text = ax.annotate(body.name, place, (4, -6 - below), textcoords="offset points", color=colour, va="top")
        text.set_fontsize("small")
    if central:
        ax.text(-1.35, -0.8, "on the central axis:", fontsize="small", color="0.35")
    for index, body in enumerate(central):
        ax.text(-1.35, -0.88 - 0.08 * index, body.name, fontsize="small", color=colours[body.name])


def _drawn_output(ax: Axes, sketch: Sketch) -> list[Line2D]:
    """Senses of a positive transmission error and a positive torque at the output, and their entries in the legend."""
    place, radius, sense = sketch.output
    handles = []
    for share, way, colour, words in (
        (0.95, sense, AHEAD, "direction of the output; TE > 0: output ahead"),
        (0.7, -sense, TORQUE, "torque > 0 on the output: resists its rotation"),
    ):
        _turning_arrow(ax, place, share * radius, -0.5 * np.pi, way, colour, width=1.8)
        handles.append(Line2D([], [], color=colour, linewidth=1.8, label=words))
    return handles


def _drawn_lines_of_action(ax: Axes, scene: Scene, sketch: Sketch) -> list[Line2D]:
    """Lines of action through the pitch points, and their entries in the legend."""
    styles: dict[int, Literal["-", ":"]] = {1: "-", -1: ":"}
    names = {1: "line of action, driving flanks", -1: "line of action, back flanks"}
    drawn = set()
    for point, body in sketch.pitch_points:
        frame, normals, sides = sketch.body(body).frame, *_normals(scene, body)
        turned = normals @ np.array([[np.cos(frame), np.sin(frame)], [-np.sin(frame), np.cos(frame)]])
        for side in sorted(set(sides)):
            own = turned[(sides == side) & (np.abs(turned).max(axis=1) > 0)]
            if not len(own):
                continue
            way = LINE * own.mean(axis=0) / np.linalg.norm(own.mean(axis=0))
            ends = np.array([point - way, point + way])
            ax.plot(*ends.T, styles[side], color="0.2", linewidth=1.2)
            drawn.add(side)
    return [Line2D([], [], linestyle=styles[side], color="0.2", label=names[side]) for side in sorted(drawn)[::-1]]


def _normals(scene: Scene, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Change of the gaps per displacement of a body along its axes, shape (contact, 2), and sides of the contacts."""
    system = scene.system
    request = Request(back=not scene.layout.sides_turn, coordinates=(f"{body}.x", f"{body}.y"))
    motions = pose_of(system, jnp.zeros((), scene.dtype), request).jacobian[:, 1:]
    return -np.asarray(motions), np.asarray(system.layout(request).side)


def _drawn_run_outs(ax: Axes, scene: Scene, sketch: Sketch, colours: dict[str, str]) -> list[Line2D]:
    """Lines at phase zero and arrows of the run-outs, and their entries in the legend."""
    run_outs = {key: error for key, error in scene.errors.items() if isinstance(error, Eccentricity)}
    largest = max((float(error.amplitude) for error in run_outs.values()), default=0.0) or 1.0
    for index, body in enumerate(sketch.bodies):
        if body.zero is None:
            continue
        size = ZERO + 0.04 * sum(other.axis == body.axis for other in sketch.bodies[:index])
        end = beyond(body.axis, body.zero, size)
        ax.plot(*np.array([body.axis, end]).T, "--", color=colours[body.name], linewidth=0.9)
        _turning_arrow(ax, body.axis, size, body.zero, body.sense, colours[body.name], span=0.35)
    handles = []
    for key, error in run_outs.items():
        body, colour = sketch.body(error.body), colours[error.body]
        amplitude, phase = float(error.amplitude), float(error.phase)
        words = f"{key}: {amplitude / um:.4g} um at {phase / deg:.4g} deg"
        handles.append(Line2D([], [], color=colour, linewidth=2.2, label=words))
        if body.zero is not None and amplitude > 0:
            size = max(LONGEST * amplitude / largest, SHORTEST)
            _arrow(ax, body.axis, beyond(body.axis, body.zero + body.sense * phase, size), colour, width=2.2)
    dashed = Line2D([], [], linestyle="--", color="0.4", label="phase zero of a body, direction of growing phase")
    return [dashed, *handles]


def _arrow(ax: Axes, start: Point, end: Point, colour: str, *, width: float) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", xy=end, xytext=start, arrowprops=style)


def _turning_arrow(
    ax: Axes,
    place: Point,
    radius: float,
    start: float,
    sense: int,
    colour: str,
    *,
    span: float = 0.6,
    width: float = 1.0,
) -> None:
    """An arc with an arrow at its end, about a place."""
    angles = start + sense * np.linspace(0.0, span, 20)
    points = np.array([beyond(place, angle, radius) for angle in angles])
    ax.plot(*points[:-1].T, color=colour, linewidth=width)
    _arrow(ax, tuple(points[-3]), tuple(points[-1]), colour, width=width)
