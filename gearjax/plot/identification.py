"""Figures of recordings next to computed curves, and of the numbers identified from recordings."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from gearjax.identification import Comparison, Identification, IdentifiedNumber
from gearjax.identification.compare import RecordBeside
from gearjax.identification.orders import candidates, waves
from gearjax.plot.axes import finish, new_figure, save_figure, thin
from gearjax.units import arcmin

MOST_DRAWN = 6  # largest number of recordings in a figure
MEASURED, COMPUTED, LEFT = "0.55", "tab:blue", "tab:red"
LONGEST_NAME = 36


def comparison_figure(comparison: Comparison) -> Figure:
    """Draw each recording with its computed curve, and their difference, over turns of the input.

    Args:
        comparison: result of `gearjax.compare`.
    """
    records = comparison.records[:MOST_DRAWN]
    figure, axes = new_figure(2 * len(records), height=1.9)
    for record, above, below in zip(records, axes[::2], axes[1::2], strict=True):
        turns, measured, computed = thin(record.theta / (2 * np.pi), record.measured, record.computed)
        centre = record.offset
        above.plot(turns, (measured - centre) / arcmin, ".", color=MEASURED, markersize=1.5, label="measured")
        above.plot(turns, (computed - centre) / arcmin, color=COMPUTED, linewidth=0.8, label="computed")
        below.plot(turns, (measured - computed) / arcmin, ".", color=LEFT, markersize=1.2, label="difference")
        finish(
            above, f"{_short(record.name)}: {100 * record.explained:.4g} % of the variance explained", "", "TE [arcmin]"
        )
        finish(below, "", "turns of the input", "difference [arcmin]")
    return figure


def _short(name: str) -> str:
    """A name that fits into a title: the middle of a long one is left out."""
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME // 2]} … {name[-LONGEST_NAME // 2 :]}"


def orders_figure(comparison: Comparison) -> Figure:
    """Draw amplitudes and phases of the largest orders, measured and computed.

    Args:
        comparison: result of `gearjax.compare`.
    """
    records = comparison.records[:MOST_DRAWN]
    figure, axes = new_figure(2 * len(records), height=2.1)
    for record, above, below in zip(records, axes[::2], axes[1::2], strict=True):
        _orders(record, above, below)
    return figure


def _orders(record: RecordBeside, above, below) -> None:
    orders = record.orders
    place = np.arange(len(orders))
    pairs = (
        ("measured", MEASURED, [(each.measured, each.phase_measured) for each in orders], -0.2),
        ("computed", COMPUTED, [(each.computed, each.phase_computed) for each in orders], 0.2),
    )
    largest = max((max(each.measured, each.computed) for each in orders), default=0.0)
    for label, colour, values, shift in pairs:
        above.bar(place + shift, [value / arcmin for value, _ in values], 0.38, color=colour, label=label)
        shown = [i for i, (value, _) in enumerate(values) if value > 0.02 * largest]
        phases = [np.degrees(values[i][1]) for i in shown]
        below.plot(place[shown] + shift, phases, "o", color=colour, markersize=4, label=label)
    names = [each.name.replace(" per turn of the output", " / output") for each in orders]
    for ax in (above, below):
        ax.set_xticks(place, [""] * len(orders) if ax is above else names)
    below.tick_params(axis="x", labelrotation=60, labelsize="x-small")
    below.set_yticks([-180, -90, 0, 90, 180])
    finish(above, f"{_short(record.name)}: largest orders", "", "amplitude [arcmin]")
    finish(below, "", "", "phase [deg]")
    for ax in (above, below):
        ax.set_xlim(-0.6, len(orders) - 0.4)


def estimates_figure(found: Identification) -> Figure:
    """Draw identified errors with intervals of 95 %, hidden ones as hollow points; other numbers stand in the title.

    Args:
        found: result of `gearjax.identify`.
    """
    own = found.estimates[: len(found.unknowns.each)]
    groups: dict[str, list[IdentifiedNumber]] = {}
    for each in own:
        groups.setdefault(each.unit if each.name.startswith("errors.") else "", []).append(each)
    others = groups.pop("", []) if len(groups) > 1 else []
    figure, axes = new_figure(len(groups), height=3.0)
    for ax, (unit, members) in zip(axes, groups.items(), strict=True):
        place = np.arange(len(members))
        told = np.array([each.error is not None for each in members])
        values = np.array([each.value for each in members])
        spread = np.array([0.0 if each.error is None else 1.96 * each.error for each in members])
        ax.axhline(0.0, color="0.6", linewidth=0.8)
        label = "identified, 95 % interval"
        ax.errorbar(place[told], values[told], spread[told], fmt="o", capsize=3, color=COMPUTED, label=label)
        if not told.all():
            ax.plot(place[~told], values[~told], "o", color=COMPUTED, fillstyle="none", label="not identified")
        ax.set_xticks(place, [each.name.removeprefix("errors.") for each in members])
        ax.tick_params(axis="x", labelrotation=60, labelsize="x-small")
        finish(ax, "", "", f"value [{unit or members[0].unit or '-'}]")
    words = [
        f"{each.name} {each.value:.4g}{'' if each.error is None else f' ± {1.96 * each.error:.2g}'} {each.unit}"
        for each in others
    ]
    axes[0].set_title("\n".join(["Identified numbers", *words]), fontsize="small")
    return figure


def residual_figure(found: Identification) -> Figure:
    """Draw the spectrum of the first recording and of its residual, over orders of the output.

    Args:
        found: result of `gearjax.identify`.
    """
    figure, (ax,) = new_figure(height=3.4)
    theta, measured, computed = found.curves()[0]
    known = candidates(found.scene, theta, np.zeros(theta.size, int))
    orders = np.array(sorted({*known, *(each.order for each in found.orders)}))
    output = found.scene.system.orders.get("output", 1.0)
    for curve, label, colour in ((measured, "measured", MEASURED), (measured - computed, "residual", LEFT)):
        amplitude, _ = waves(theta, curve, list(orders))
        ax.vlines(orders / output, 1e-6, np.maximum(amplitude / arcmin, 1e-6), color=colour, linewidth=1.4)
        ax.plot(orders / output, amplitude / arcmin, ".", color=colour, label=label, markersize=4)
    noise = found.fit.sigma * np.sqrt(4 / theta.size)
    ax.axhline(noise, color="0.3", linewidth=0.8, linestyle="--", label="noise")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(bottom=0.2 * noise)
    finish(ax, f"{_short(found.records[0].name)}: orders", "cycles per turn of the output", "amplitude [arcmin]")
    return figure


def save_identification_figures(found: Identification, beside: Comparison, folder: Path) -> list[Path]:
    """Write the figures of an identification into a folder."""
    return [
        *save_comparison_figures(beside, folder),
        save_figure(estimates_figure(found), folder / "estimates.png"),
        save_figure(residual_figure(found), folder / "residual.png"),
    ]


def save_comparison_figures(beside: Comparison, folder: Path) -> list[Path]:
    """Write the figures of a comparison into a folder."""
    return [
        save_figure(comparison_figure(beside), folder / "comparison.png"),
        save_figure(orders_figure(beside), folder / "orders.png"),
    ]
