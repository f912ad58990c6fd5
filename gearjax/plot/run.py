"""Figures of a run."""

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gearjax.analysis import Motion, TransmissionError
from gearjax.coordinates import unit_of
from gearjax.errors import AbstractMeasured
from gearjax.plot.axes import add_input_angle, draw_curve, finish, new_figure, save_figure, styles_of, thin
from gearjax.plot.cycloid import stage_figure
from gearjax.plot.involute import pair_figure
from gearjax.plot.measured import measured_figure
from gearjax.plot.noncircular import noncircular_figure
from gearjax.plot.plane_of_action import plane_of_action_figure
from gearjax.plot.schematic import schematic_figure
from gearjax.plot.torque_sweep import torque_sweep_figure
from gearjax.results import Case, against_torque, forces_on_bearings, impacts_of, order_lines, required_run
from gearjax.scene import Scene
from gearjax.systems import AbstractNoncircularPair, AbstractSystem, HelicalPair, HelicalTrain, InvoluteRV, RVCycloidal
from gearjax.units import arcmin, um

MOST_LINES = 12
NO_BODIES = ("curve", "waves")  # orders that steps have to resolve, at which no body turns
MOST_NAMES = 9  # contacts of an image that are named beside it


def error_figure(scene: Scene, cases: list[Case]) -> Figure:
    """Draw the transmission error over time, without load, static and dynamic under each torque, and the backlash."""
    groups = [
        (title, [case for case in cases if case.analysis in kinds])
        for title, kinds in (
            ("Transmission error without load and under static torque", ("no_load", "static")),
            ("Dynamic transmission error", ("dynamic",)),
            ("Backlash", ("backlash",)),
        )
    ]
    groups = [(title, members) for title, members in groups if members]
    figure, axes = new_figure(len(groups))
    run = required_run(scene)
    time, styles = run.times, styles_of(case.title for case in cases)
    for ax, (title, members) in zip(axes, groups, strict=True):
        for case in members:
            draw_curve(ax, time, case.record, case.title, **styles[case.title])
        finish(ax, title, y="backlash [arcmin]" if title == "Backlash" else "transmission error [arcmin]")
        add_input_angle(ax, float(scene.system.input_speed))
    return figure


def force_figure(scene: Scene, cases: list[Case]) -> Figure | None:
    """Contact force of each flank that may carry over time, one row per loaded case; ``None`` without loaded cases.

    A case with more than `MOST_LINES` contacts is drawn as an image, with one image row for each contact.
    """
    loaded = [case for case in cases if getattr(case.result, "forces", None) is not None]
    if not loaded:
        return None
    shown = [case.result for case in loaded if isinstance(case.result, (TransmissionError, Motion))]
    many = any(result.forces is not None and result.forces.shape[1] > MOST_LINES for result in shown)
    figure, axes = new_figure(len(loaded), height=4.0 if many else 2.2)
    run = required_run(scene)
    time = run.times
    for ax, case in zip(axes, loaded, strict=True):
        assert isinstance(case.result, (TransmissionError, Motion))
        forces = np.asarray(case.result.forces)
        if forces.shape[1] > MOST_LINES:
            _waterfall(ax, time, forces, case.title, scene.system)
            continue
        for contact in range(forces.shape[1]):
            layout = case.result.layout
            pair, back = layout.pair[contact] + 1, layout.side[contact] < 0
            if back and not forces[:, contact].any():
                continue
            ax.plot(
                *thin(time, forces[:, contact]), label=f"pair {pair}{', back flank' if back else ''}", linewidth=1.0
            )
        finish(ax, case.title, y="contact force [N]")
    add_input_angle(axes[0], float(scene.system.input_speed))
    return figure


def moved_figure(scene: Scene, cases: list[Case]) -> Figure | None:
    """Draw what moves besides the output over time; ``None`` if nothing else moves.

    There is one row per loaded case for displacements, and one for turns.
    """
    shown = [
        (case, case.result)
        for case in cases
        if isinstance(case.result, TransmissionError | Motion) and case.result.moved is not None
    ]
    rows = []
    for case, result in shown:
        curves = list(zip(result.coordinates[1:], np.asarray(result.moved).T, strict=True))
        for unit, label, size in (("m", "displacement [um]", um), ("rad", "rotation [arcmin]", arcmin)):
            own = [(name, moved / size) for name, moved in curves if unit_of(name) == unit]
            rows += [(case, label, own)] if own else []
    if not rows:
        return None
    return _of_bodies(scene, "Motion of bodies other than the output", rows)


def bearing_figure(scene: Scene, cases: list[Case]) -> Figure | None:
    """Draw the forces and moments of bodies on their supports over time; ``None`` without supports or loads."""
    rows = []
    for case in cases:
        found = forces_on_bearings(scene, case.result)
        if found is None:
            continue
        for unit, label in (("m", "bearing force [N]"), ("rad", "bearing moment [N m]")):
            own = [(name, np.asarray(found.of(name))) for name in found.names if unit_of(name) == unit]
            rows += [(case, label, own)] if own else []
    return _of_bodies(scene, "Forces of bodies on their supports", rows) if rows else None


def impact_figure(scene: Scene, cases: list[Case]) -> Figure | None:
    """Draw the force of the impacts over one pitch, and the largest force of each pair; ``None`` without impacts."""
    impacts = impacts_of(scene, cases)
    if not impacts:
        return None
    several = any(len(found.force) > 1 for found in impacts.values())
    figure, axes = new_figure(2 if several else 1)
    speed = float(scene.system.input_speed)
    for title, found in impacts.items():
        pulses, start = found.pulses, float(found.theta[0])
        time = np.linspace(-0.1, 1.1, 601) * found.pitch / speed
        force = jax.vmap(pulses.at, (0, None))(jnp.asarray(start + time * speed), scene.system.input_speed)
        axes[0].plot(1e3 * time, np.asarray(force), label=title)
        if several:
            axes[1].plot(np.arange(len(found.force)), np.asarray(found.force), linewidth=0.8, label=title)
    finish(axes[0], "Meshing impact", x="time after the first pair touches [ms]", y="force [N]")
    if several:
        finish(axes[1], "Largest force of each pair of teeth", y="force [N]", x="pair of teeth")
    return figure


def _of_bodies(scene: Scene, title: str, rows: list[tuple[Case, str, list[tuple[str, np.ndarray]]]]) -> Figure:
    """Curves of several bodies over time: case, label of the axis, and the curves by name, in each row."""
    figure, axes = new_figure(len(rows), height=2.6)
    for ax, (case, label, curves) in zip(axes, rows, strict=True):
        for name, values in curves:
            ax.plot(*thin(required_run(scene).times, values), label=name, linewidth=1.0)
        finish(ax, f"{title}, {case.title}", y=label)
    add_input_angle(axes[0], float(scene.system.input_speed))
    return figure


def _waterfall(ax: Axes, time: np.ndarray, forces: np.ndarray, title: str, system: AbstractSystem) -> None:
    """Draw the forces of many contacts over time as an image, with one image row for each contact."""
    time, forces = thin(time, forces)
    shown = np.ma.masked_less_equal(forces.T, 0.0)
    drawn = ax.pcolormesh(time, np.arange(1, forces.shape[1] + 1), shown, shading="nearest", cmap="viridis")
    ax.figure.colorbar(drawn, ax=ax, label="contact force [N]")
    finish(ax, title, y="contact")
    named = np.unique(np.linspace(0, forces.shape[1] - 1, MOST_NAMES).round().astype(int))
    ax.set_yticks(named + 1, [system.contact_name(int(contact)) for contact in named], fontsize="x-small")


def spectrum_figure(scene: Scene, cases: list[Case]) -> Figure | None:
    """Draw order spectra per turn of the output: errors of the bodies, and up to the mesh order for a motion.

    The spectra are of whole cycles if possible (`order_lines`); then they have no leakage between the lines. The crank
    order and its multiples are marked; for a motion, and in a system without crank, the mesh order. The orders of other
    bodies are marked too, for a motion as sidebands of the mesh order.
    """
    groups = [
        (title, [case for case in cases if case.analysis in kinds])
        for title, kinds in (("without load and static", ("no_load", "static")), ("dynamic", ("dynamic",)))
    ]
    groups = [(title, members) for title, members in groups if members]
    if not groups:
        return None
    figure, axes = new_figure(len(groups), height=3.6)
    run, orders, styles = required_run(scene), scene.system.orders, styles_of(case.title for case in cases)
    theta = run.times * float(scene.system.input_speed)
    turn = 2 * np.pi / orders["output"]
    name = "crank" if "crank" in orders else "mesh"
    highest = np.pi / (theta[1] - theta[0]) * turn / (2 * np.pi)
    for ax, (title, members) in zip(axes, groups, strict=True):
        dynamic = title == "dynamic"
        spectra = [(case, lines) for case in members if (lines := order_lines(scene, case)) is not None]
        if not spectra:
            continue
        for case, lines in spectra:
            ax.semilogy(lines.order, lines.amplitude / arcmin, label=case.title, linewidth=1.0, **styles[case.title])
        limit = 2.2 * orders["mesh"] if dynamic else 8 * orders.get("crank", scene.system.fastest_order)
        ax.set_xlim(0, min(limit / orders["output"], highest))
        top = ax.get_ylim()[1]
        ax.set_ylim(1e-5 * top, 2 * top)
        mark = orders["mesh"] if dynamic else orders[name]
        mark_multiples(ax, mark / orders["output"], "mesh" if dynamic else name)
        _mark_others(ax, scene.system, mark, dynamic)
        window = "whole cycles" if all(lines.whole for _, lines in spectra) else "Hann window"
        apart = f"{spectra[0][1].order[1]:.2g}"
        finish(
            ax,
            f"Order spectrum, {title}",
            x=f"order [cycles per turn of the output], lines {apart} order{'s' * (apart != '1')} apart ({window})",
            y="amplitude [arcmin]",
        )
    return figure


def mark_multiples(ax: Axes, base: float, name: str) -> None:
    """Draw dotted lines at an order and its multiples."""
    for number in range(1, int(ax.get_xlim()[1] / base) + 1):
        label = f"{name} order {base:g}\nand multiples" if number == 1 else None
        ax.axvline(number * base, color="0.5", linestyle=":", linewidth=0.8, label=label)


def _mark_others(ax: Axes, system: AbstractSystem, marked: float, sidebands: bool) -> None:
    """Draw dashed lines at the other named orders, in a spectrum up to the mesh order at its sidebands by them.

    The other meshes of a train have lines of their own in both.
    """
    orders, meshes = system.orders, {round(order, 9) for order in system.mesh_orders}
    known = {round(marked, 9), round(orders["output"], 9), round(orders["mesh"], 9)}
    others: dict[float, str] = {}
    for name, order in orders.items():
        if round(order, 9) not in known and name not in NO_BODIES:
            others.setdefault(round(order, 9), name)
    for number, (order, name) in enumerate(others.items()):
        beside = sidebands and order not in meshes
        places = [marked - order, marked + order] if beside else [order]
        size = f"{order / orders['output']:g}"
        label = f"sidebands: mesh\n+- {size} ({name})" if beside else f"{name} order {size}"
        for place in places:
            style = {"color": f"C{7 + number % 3}", "linestyle": "--", "linewidth": 0.7, "alpha": 0.8}
            if 0 < place / orders["output"] < ax.get_xlim()[1]:
                ax.axvline(place / orders["output"], label=label, **style)
                label = None


def _stage(scene: Scene, te: TransmissionError) -> Figure:
    assert te.forces is not None
    assert isinstance(scene.system, RVCycloidal)
    return stage_figure(scene.system, float(te.theta[0]), te.forces[0])


def _pair(scene: Scene, te: TransmissionError) -> Figure:
    assert te.forces is not None
    return pair_figure(scene, float(te.theta[0]), te.forces[0])


def _plane_of_action(scene: Scene, te: TransmissionError) -> Figure:
    assert te.forces is not None
    return plane_of_action_figure(scene, te.theta, te.forces)


def _noncircular(scene: Scene, te: TransmissionError) -> Figure:
    return noncircular_figure(scene, float(te.theta[0]))


OF_GEAR_SETS: dict[type[AbstractSystem], tuple[str, Callable[[Scene, TransmissionError], Figure]]] = {
    RVCycloidal: ("stage.png", _stage),
    InvoluteRV: ("pair.png", _pair),
    HelicalPair: ("plane_of_action.png", _plane_of_action),
    HelicalTrain: ("plane_of_action.png", _plane_of_action),
    AbstractNoncircularPair: ("pair.png", _noncircular),
}
"""File name and drawing function of each gear set under static torque."""


def save_figures(scene: Scene, cases: list[Case], folder: Path) -> list[Path]:
    """Write the figures of a run as PNG.

    Raises:
        GearjaxError: a file cannot be written.
    """
    figures = {
        "schematic.png": None if scene.system.sketch() is None else schematic_figure(scene),
        "transmission_error.png": error_figure(scene, cases),
        "contact_forces.png": force_figure(scene, cases),
        "order_spectrum.png": spectrum_figure(scene, cases),
        "support_displacements.png": moved_figure(scene, cases),
        "bearing_forces.png": bearing_figure(scene, cases),
        "meshing_impact.png": impact_figure(scene, cases),
        "torque_sweep.png": None if (sweep := against_torque(scene, cases)) is None else torque_sweep_figure(sweep),
    }
    if any(isinstance(error, AbstractMeasured) for error in scene.errors.values()):
        figures["measured.png"] = measured_figure(scene)
    for case in cases:
        result = case.result
        if not isinstance(result, TransmissionError) or result.forces is None:
            continue
        for gear_set, (name, figure) in OF_GEAR_SETS.items():
            if isinstance(scene.system, gear_set):
                drawn = figure(scene, result)
                drawn.suptitle(case.title)
                figures[name] = drawn
    return [save_figure(figure, folder / name) for name, figure in figures.items() if figure is not None]
