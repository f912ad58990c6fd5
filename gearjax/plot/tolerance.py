"""Figures of a tolerance study: distributions, convergence, sensitivities, allocation and matched assembly."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gearjax.plot.axes import finish, new_figure, save_figure
from gearjax.results.tolerance import ToleranceResults
from gearjax.tolerance import Study
from gearjax.tolerance.assembly import MatchedAssembly
from gearjax.tolerance.monte_carlo import QUANTILES
from gearjax.tolerance.statistics import quantile, share
from gearjax.units import arcmin

BINS = 80
MARKS = 24  # numbers of samples at which convergence is shown
WIDTHS = {"linear": "tab:orange", "first": "tab:blue", "total": "tab:cyan", "one_at_a_time": "0.6"}
LABELS = {
    "linear": "linear (derivatives)",
    "first": "Sobol, alone",
    "total": "Sobol, with others",
    "one_at_a_time": "one at a time",
}


def histogram_figure(study: Study) -> Figure:
    """Draw a histogram of each measure with its quantiles and limits."""
    figure, axes = new_figure(len(study.names), width=9.0, height=2.8)
    for ax, name in zip(axes, study.names, strict=True):
        good = study.good(name) / arcmin
        if good.size:
            low, high = np.quantile(good, [0.0005, 0.9995])
            room = 0.05 * (high - low) + 1e-12
            ax.hist(good, bins=BINS, range=(low - room, high + room), color="tab:blue", alpha=0.6, density=True)
            for level in QUANTILES:
                value = study.quantile(name, level).value / arcmin
                ax.axvline(value, color="0.3", linewidth=0.9, linestyle=":", label=f"{100 * level:g} %: {value:.3f}")
        _limits(ax, study, name)
        finish(ax, f"{name}: {good.size} gear sets", x=f"{name} [arcmin]", y="density [1/arcmin]")
    return figure


def _limits(ax: Axes, study: Study, name: str, vertical: bool = True) -> None:
    for measure in study.measures:
        if measure.name == name and measure.is_limited:
            estimate = study.share_within(name)
            words = f"limit; good: {100 * estimate.value:.2f} % [{100 * estimate.low:.2f}, {100 * estimate.high:.2f}]"
            for limit in (measure.limit, measure.at_least):
                if limit is not None:
                    line = ax.axvline if vertical else ax.axhline
                    line(limit / arcmin, color="tab:red", linewidth=1.2, label=words)


def convergence_figure(study: Study) -> Figure:
    """Draw quantiles and, for measures with limits, yields, with their intervals, over the number of samples."""
    limited = [measure.name for measure in study.measures if measure.is_limited]
    figure, axes = new_figure(len(study.names) + len(limited), width=9.0, height=2.6)
    numbers = np.unique(np.geomspace(min(32, study.samples), study.samples, MARKS).round().astype(int))
    for ax, name in zip(axes, study.names, strict=False):
        column = study.column(name) / arcmin
        for level, colour in zip(QUANTILES, ("tab:blue", "black", "tab:red"), strict=True):
            quantiles = [
                quantile(part[np.isfinite(part)], level, _sizes(part)) for part in (column[:n] for n in numbers)
            ]
            _band(ax, numbers, np.array(quantiles), f"{100 * level:g} %", colour)
        finish(ax, name, x="samples", y="quantile [arcmin]")
    for ax, name in zip(axes[len(study.names) :], limited, strict=True):
        measure = next(m for m in study.measures if m.name == name)
        good = measure.holds(study.column(name))
        shares = np.array([share(good[:n], _sizes(good[:n])) for n in numbers])
        _band(ax, numbers, 100 * shares, "good", "tab:green")
        finish(ax, f"{name}: yield", x="samples", y="yield [%]")
    return figure


def _sizes(part: np.ndarray) -> np.ndarray:
    """Size of the one design of a part of the samples: the first samples are treated as independent."""
    return np.array([len(part)])


def _band(ax: Axes, numbers: np.ndarray, estimates: np.ndarray, label: str, colour: str) -> None:
    ax.semilogx(numbers, estimates[:, 0], color=colour, linewidth=1.1, label=label)
    ax.fill_between(numbers, estimates[:, 1], estimates[:, 2], color=colour, alpha=0.18, linewidth=0)


def sensitivity_figure(results: ToleranceResults) -> Figure:
    """Draw the shares of the variance of each measure, computed in three ways."""
    sensitivity = results.sensitivity
    height = 0.9 + 0.42 * len(sensitivity[0].paths)
    figure, axes = new_figure(len(sensitivity), width=9.5, height=height)
    for ax, one in zip(axes, sensitivity, strict=True):
        order = np.argsort(one.total)
        places = np.arange(len(order))
        for step, (kind, colour) in enumerate(WIDTHS.items()):
            values = getattr(one, kind)[order]
            errors = getattr(one, f"{kind}_error", None)
            bars = None if errors is None else errors[order]
            offset = (1.5 - step) * 0.2
            ax.barh(places + offset, values, 0.19, xerr=bars, color=colour, label=LABELS[kind], error_kw={"lw": 0.7})
        longest = max(1.0, float((one.total + one.total_error).max()) * 1.05)
        over = float(one.linear.max())
        ax.set_xlim(min(0.0, float(one.first.min()) - 0.02), min(max(longest, over * 1.05), 2 * longest))
        cut = ax.get_xlim()[1]
        for step, kind in enumerate(WIDTHS):
            values = getattr(one, kind)[order]
            for place in np.flatnonzero(values > cut):
                words = f"{values[place]:.3g} \N{RIGHTWARDS ARROW}"
                height = places[place] + (1.5 - step) * 0.2
                box = {"facecolor": "white", "edgecolor": WIDTHS[kind], "pad": 1.0}
                ax.text(cut, height, words, ha="right", va="center", fontsize="x-small", bbox=box)
        ax.set_yticks(places, [one.paths[i] for i in order], fontsize="small")
        title = f"{one.name}: share of the variance"
        finish(ax, title + (f"\n{one.linear_fails}" if one.linear_fails else ""), x="share [-]", y="")
    return figure


def assembly_figure(assembly: MatchedAssembly) -> Figure:
    """Draw the same gear sets assembled at random and matched: distributions, shares within a limit, each unit."""
    figure, axes = new_figure(1, 3, width=15.0, height=4.6)
    parts = {"at random": (assembly.random, "0.55"), "matched": (assembly.matched, "tab:green")}
    top = float(np.nanmax([assembly.random, assembly.matched])) / arcmin
    bins = np.linspace(min(0.0, float(np.nanmin(assembly.matched)) / arcmin), top, 60).tolist()
    for label, (values, colour) in parts.items():
        good = np.sort(values[np.isfinite(values)]) / arcmin
        middle = float(np.median(good))
        axes[0].hist(good, bins=bins, color=colour, alpha=0.65, label=f"{label}: median {middle:.3f}")
        axes[1].plot(good, 100 * np.arange(1, len(good) + 1) / len(good), color=colour, label=label)
    for limit in (assembly.measure.limit, assembly.measure.at_least):
        if limit is not None:
            random, matched = assembly.shares()
            words = f"limit: {100 * random.value:.1f} % to {100 * matched.value:.1f} %"
            axes[0].axvline(limit / arcmin, color="tab:red", linewidth=1.2)
            axes[1].axvline(limit / arcmin, color="tab:red", linewidth=1.2, label=words)
    axes[2].scatter(assembly.random / arcmin, assembly.matched / arcmin, s=5, color="tab:green", alpha=0.6)
    axes[2].plot([0, top], [0, top], color="0.55", linewidth=0.9, label="matched = at random")
    name = f"{assembly.measure.name} [arcmin]"
    finish(axes[0], f"{len(assembly.random)} units, the same parts", x=name, y="units")
    finish(axes[1], "Share of units within a limit", x=name, y="share [%]")
    finish(axes[2], "Each unit", x=f"at random: {name}", y=f"matched: {name}")
    for ax, place in zip(axes, ("upper right", "lower right", "upper left"), strict=True):
        ax.legend(loc=place, fontsize="small")
    return figure


def allocation_figure(results: ToleranceResults) -> Figure:
    """Draw the factors on the tolerances, and yield and cost before and after."""
    bought = results.allocation
    assert bought is not None
    figure, axes = new_figure(1, 2, width=12.0, height=1.2 + 0.4 * max(3, len(bought.paths)))
    places = np.arange(len(bought.paths))
    axes[0].barh(places, bought.factors, color="tab:blue")
    axes[0].axvline(1.0, color="0.3", linewidth=0.9)
    axes[0].set_yticks(places, bought.paths, fontsize="small")
    finish(axes[0], "Cheapest tolerances", x="factor on the tolerance [-]", y="")
    costs = (float(bought.cost_before), float(bought.cost))
    for cost, estimate, label in zip(costs, (bought.before, bought.after), ("as given", "found"), strict=True):
        spread = [[100 * (estimate.value - estimate.low)], [100 * (estimate.high - estimate.value)]]
        axes[1].errorbar([cost], [100 * estimate.value], yerr=spread, fmt="o", capsize=4, label=label)
    axes[1].axhline(100 * bought.required, color="tab:red", linewidth=1.0, label="required")
    finish(axes[1], f"{bought.measure}: yield and cost", x="cost", y="yield [%]")
    axes[1].margins(x=0.2, y=0.2)
    return figure


def save_tolerance_figures(results: ToleranceResults, folder: Path) -> list[Path]:
    """Write the figures of all studies that were made.

    Raises:
        GearjaxError: the folder cannot be written.
    """
    figures = {"histograms.png": histogram_figure(results.study), "convergence.png": convergence_figure(results.study)}
    if results.sensitivity:
        figures["sensitivity.png"] = sensitivity_figure(results)
    if results.allocation is not None:
        figures["allocation.png"] = allocation_figure(results)
    if results.assembly is not None:
        figures["assembly.png"] = assembly_figure(results.assembly)
    return [save_figure(figure, folder / name) for name, figure in figures.items()]
