"""Tables of results on standard output."""

import math
import sys
from typing import Any

import numpy as np
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from gearjax.reproduce import Row
from gearjax.results import Case, GradedGear, Optimisation, highest_load_sharing
from gearjax.results.optimisation import ALIKE
from gearjax.run import METRICS
from gearjax.studies.minimise import UNIMPROVED
from gearjax.studies.select import pick
from gearjax.studies.sensitivity import FLAT_STEP
from gearjax.studies.tradeoff import Tradeoff
from gearjax.tolerance.precision import PrecisionShift
from gearjax.units import arcmin, um

WIDE = 10_000  # wider than any table


def print_tradeoff(comparison: Tradeoff) -> None:
    console = output()
    if comparison.rows:
        _print_settings(console, comparison)
    if comparison.statics:
        words = "Models of parts under static torque, compared with the last and most exact one of each part"
        table = Table(title=words)
        for column in ("part", "choice", "error [arcmin]", "force error [%]", "run [ms]", "compile [s]"):
            table.add_column(column, justify="left" if column in ("part", "choice") else "right")
        for one in comparison.statics:
            off = f"{one.error / arcmin:.2g}", f"{100 * one.force_error:.2g}"
            table.add_row(one.part, one.name, *off, f"{1e3 * one.seconds:.0f}", f"{one.compile_seconds:.1f}")
        show(console, table)
    if not comparison.rows:
        return
    allowed = f"{comparison.error / arcmin:g} arcmin"
    if comparison.best is None:
        console.print(f"no setting is within {allowed}", soft_wrap=True)
    else:
        console.print(f"fastest within {allowed}: {comparison.best.group}: {comparison.best.name}", soft_wrap=True)


def _print_settings(console: Console, comparison: Tradeoff) -> None:
    table = Table(title="Error and time of each setting; one run, one torque")
    for column in ("setting", "", "error [arcmin]", "run [ms]", "gradient [ms]", "compile [s]"):
        table.add_column(column, justify="left" if column in ("setting", "") else "right")
    for row in comparison.rows:
        gradient = "" if row.gradient_seconds is None else f"{1e3 * row.gradient_seconds:.1f}"
        gradient = gradient if row.gradient_measured or not gradient else f"~{gradient}"
        error = f"{row.error / arcmin:.2g}"
        table.add_row(row.group, row.name, error, f"{1e3 * row.seconds:.1f}", gradient, f"{row.compile_seconds:.1f}")
    show(console, table)
    console.print("~: not measured, estimated from another setting of the same scheme, roughly", soft_wrap=True)
    words = "run: with the call from Python, some ms; gradients are compiled as a whole and have none"
    console.print(words, soft_wrap=True)


def print_face_load(factors: dict[str, float]) -> None:
    """Print the face load factors of cases; nothing if there are none."""
    if factors:
        each = "; ".join(f"{title}: {factor:.3f}" for title, factor in factors.items())
        words = "highest load per width across the face over the mean, of the loads averaged over the record"
        output().print(f"face load factor K_Hbeta: {each} ({words})", soft_wrap=True)


def print_impacts(impacts: dict[str, dict[str, Any]]) -> None:
    """Print the impacts of the teeth as they come into mesh; nothing if there are none."""
    for title, found in impacts.items():
        several = f", at most {found['largest_force_N']:.4g} N" if found["pairs"] > 1 else ""
        output().print(
            f"meshing impact, {title}: {found['force_N']:.4g} N{several}, for {found['duration_us']:.4g} us, at "
            f"{found['velocity_m_s']:.4g} m/s",
            soft_wrap=True,
        )


def print_accuracy(gears: list[GradedGear]) -> None:
    """Print deviations and grades of measured gears; nothing if there are none."""
    if not gears:
        return
    table = Table(title="Measured deviations in um, grades of ISO 1328-1:2013")
    for column in ("deviation", *(f"{gear.body}, {gear.flank} flanks" for gear in gears)):
        table.add_column(column, justify="left" if column == "deviation" else "right")
    for name in dict.fromkeys(name for gear in gears for name in gear.deviations):
        each = [gear.deviations.get(name) for gear in gears]
        table.add_row(name, *("" if one is None else f"{one.value / um:.1f}, {one.words}" for one in each))
    show(output(), table)


def print_optimisation(optimisation: Optimisation) -> None:
    console = output()
    table = Table(title=f"{optimisation.section.objective.name}, {optimisation.section.window:g} s")
    parameters = optimisation.parameters
    units = [p.shown_in[0] for p in parameters.values()]
    unit = optimisation.unit
    columns = ["", unit.shown, *(f"{path} [{unit}]" for path, unit in zip(parameters, units, strict=True))]
    for column in (*columns, "evaluations", "run [s]", "compile [s]"):
        table.add_column(column, justify="right" if column else "left", overflow="fold")

    def row(title: str, objective: float, point, *rest: str) -> None:
        shown = [f"{optimisation.shown(path, float(value)):.6g}" for path, value in zip(parameters, point, strict=True)]
        table.add_row(title, f"{objective / unit.per_shown:.5f}", *shown, *rest)

    row(
        "before",
        optimisation.before,
        pick(optimisation.scene, optimisation.section.where).get(optimisation.scene),
        "",
        "",
        "",
    )
    grid, search = optimisation.grid, optimisation.gradient
    if grid is not None:
        count = f"{grid.combinations} ({grid.evaluated} on all times)"
        row("grid", grid.objective, grid.best, count, f"{grid.seconds:.2f}", f"{grid.compile_seconds:.1f}")
    count = f"{search.evaluations}, {len(search.starts)} starts"
    row("gradients", search.objective, search.best, count, f"{search.seconds:.2f}", f"{search.compile_seconds:.1f}")
    show(console, table)
    console.print(
        f"{search.within(0.01)} of {len(search.starts)} starts within 1 % of the best; all ends lie in "
        f"{int(search.valley.max()) + 1} valleys (on the way from one to another the objective rises); "
        f"{search.failed} dropped because they were not finite",
        soft_wrap=True,
    )
    _print_choice(console, optimisation)
    if optimisation.others is not None:
        before, after = (value / unit.per_shown for value in optimisation.others)
        words = (
            f"mean of {optimisation.section.scatter} gear sets drawn from [tolerance]; of {optimisation.judging} others"
        )
        console.print(f"{words}: before {before:.5f} {unit.shown}, after {after:.5f} {unit.shown}", soft_wrap=True)
    if not search.improved:
        console.print(f"gradients: {UNIMPROVED}", soft_wrap=True)
    around = optimisation.sensitivity
    for direction, rise, flat in zip(around.directions, around.rises, around.flat, strict=True):
        if flat:
            words = ", ".join(f"{path} {share:+.2f}" for path, share in zip(around.paths, direction, strict=True))
            console.print(
                f"flat direction: {around.told(FLAT_STEP)} along ({words}) raise the objective by {100 * rise:.1f} %",
                soft_wrap=True,
            )
    for deviation, mean, worst in zip(around.deviations, around.mean, around.worst, strict=True):
        console.print(
            f"assembled without error or {around.told(deviation)} off to either side: "
            f"{mean / unit.per_shown:.4f} {unit.shown} on average, {worst / unit.per_shown:.4f} at worst",
            soft_wrap=True,
        )
    _print_stages(console, optimisation)


def _print_choice(console: Console, optimisation: Optimisation) -> None:
    """Print how far apart ends lie that are as good, and what they have in common."""
    spans, alike = optimisation.choice()
    if not any(spans.values()):
        return
    told = ", ".join(
        f"{path} {optimisation.shown(path, span):.3g} {optimisation.parameters[path].shown_in[0]}".rstrip()
        for path, span in spans.items()
    )
    console.print(f"those within 1 % span: {told}; all are in starts.csv", soft_wrap=True)
    for (one, other), apart in alike.items():
        words = f"{other} - {one} = {apart:.0f} deg"
        console.print(f"and have in common: {words}, within {np.rad2deg(ALIKE):.0f} deg", soft_wrap=True)


def _print_stages(console: Console, optimisation: Optimisation) -> None:
    table = Table(title="Transmission error in arcmin, before and after")
    for column in ("case", "window [s]", "stage", *(name.replace("_", " ") for name in METRICS)):
        table.add_column(column, justify="left" if column in ("case", "stage") else "right")
    for row, case in enumerate(optimisation.cases["before"]):
        for stage, cases in optimisation.cases.items():
            title = (case.title, case.span) if stage == "before" else ("", "")
            table.add_row(*title, stage, *(f"{cases[row].metrics[name] / arcmin:.4f}" for name in METRICS))
    show(console, table)


def print_cases(cases: list[Case], ratio: float, told: str | None = None) -> None:
    """Print the metrics of the cases, and a note for readers of their contact forces.

    Args:
        cases: cases of the run.
        ratio: turns of the input for a turn of the output.
        told: the note.
    """
    compared = any(case.published.metrics for case in cases if case.published)
    title = f"Transmission error in arcmin, reduction ratio {ratio:.6g}"
    table = Table(title=title + (", published values in brackets" if compared else ""))
    for column in ("case", "window [s]", *(name.replace("_", " ") for name in METRICS), "highest load sharing"):
        table.add_column(column, justify="left" if column == "case" else "right")
    for case in cases:
        known = dict(case.published.metrics) if case.published else {}
        values = [_cell(case.metrics[name], known.get(name)) for name in METRICS]
        sharing = highest_load_sharing(case)
        table.add_row(case.title, case.span, *values, "" if sharing is None else f"{sharing:.3f}")
    console = output()
    show(console, table)
    part = next((case for case in cases if " of " in case.span), None)
    if part is not None:
        words = f"the record has {part.window:g} s of the {part.cycle:g} s after which all errors repeat"
        whole = max(case.cycle + case.settle for case in cases)
        words += f': extremes may lie outside the record; [run] duration = "{whole:g} s" has all of it'
        console.print(f"{part.span}: {words}", style="dim", soft_wrap=True)
    console.print("amplitude: largest absolute value", style="dim", soft_wrap=True)
    for note in dict.fromkeys(case.published.note for case in cases if case.published and case.published.note):
        titles = "; ".join(case.title for case in cases if case.published and case.published.note == note)
        console.print(f"{titles}: {note}", style="dim", soft_wrap=True)
    if told is not None and any(getattr(case.result, "forces", None) is not None for case in cases):
        console.print(told, style="dim", soft_wrap=True)


def output() -> Console:
    """Console on standard output, wide enough for every table if it is not a terminal. Square brackets are text."""
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False, markup=False, emoji=False)


def show(console: Console, table: Table) -> None:
    """Print a table; if the terminal is too narrow for it, row by row with one value per line, so that none is cut."""
    if Measurement.get(console, console.options.update(width=WIDE), table).minimum <= console.width:
        console.print(table)
        return
    console.print(table.title, soft_wrap=True)
    heads = [str(column.header) for column in table.columns]
    for first, *others in zip(*(column.cells for column in table.columns), strict=True):
        if first:
            console.print(first, soft_wrap=True)
        for head, cell in zip(heads[1:], others, strict=True):
            if cell:
                console.print(f"    {head}: {cell}" if head else f"    {cell}", soft_wrap=True)


def _cell(value: float, published: float | None) -> str:
    text = f"{value / arcmin:.4f}"
    return text if published is None else f"{text} ({published / arcmin:.3f})"


def print_rows(paper: str, rows: list[Row]) -> None:
    table = Table(title=paper)
    for column in ("item", "published", "ours", "deviation", "unit", "status"):
        table.add_column(column, justify="left" if column in ("item", "unit", "status") else "right")
    for row in rows:
        values = (row.computed, ".5g"), (row.deviation, "+.2g")
        ours = [f"{value:{form}}" if math.isfinite(value) else "" for value, form in values]
        table.add_row(row.item, row.published, *ours, row.unit, row.status)
    console = output()
    show(console, table)
    for why in dict.fromkeys(row.why for row in rows if row.why):
        items = dict.fromkeys(row.item.rpartition(",")[0] for row in rows if row.why == why)
        console.print(f"{'; '.join(items)}: {why}", style="dim", soft_wrap=True)


def print_shifts(shifts: list[PrecisionShift]) -> None:
    """Print quantiles of a tolerance study in both precisions."""
    table = Table(title="Quantiles of the tolerance study in arcmin, for the same gear sets")
    for column in ("measure", "quantile", "float64", "float32", "shift [%]"):
        table.add_column(column, justify="left" if column == "measure" else "right")
    for shift in shifts:
        values = [f"{value / arcmin:.6f}" for value in (shift.double, shift.single)]
        table.add_row(shift.name, f"{100 * shift.level:g} %", *values, f"{100 * shift.relative:.5f}")
    show(output(), table)
