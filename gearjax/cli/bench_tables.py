"""Tables of ``gearjax compare`` and ``gearjax identify`` on standard output."""

import numpy as np
from rich.table import Table

from gearjax.cli.tables import output, show
from gearjax.identification import Comparison
from gearjax.units import arcmin, deg


def print_comparison(beside: Comparison) -> None:
    table = Table(title="Transmission error in arcmin, measured and computed")
    columns = (
        "recording",
        "rows",
        "offset",
        "start [deg]",
        "explained [%]",
        "peak-to-peak",
        "computed",
        "std",
        "computed",
    )
    for column in columns:
        table.add_column(column, justify="left" if column == "recording" else "right")
    for record in beside.records:
        values = [f"{value / arcmin:.4f}" for pair in record.metrics.values() for value in pair]
        told = f"{record.offset / arcmin:.4f}", f"{record.start / deg:.4g}", f"{100 * record.explained:.4g}"
        table.add_row(record.name, str(record.theta.size), *told, *values)
    console = output()
    show(console, table)
    if beside.lost_motion is not None:
        one, other = (value / arcmin for value in beside.lost_motion)
        console.print(f"lost motion: measured {one:.4f} arcmin, computed {other:.4f} arcmin", soft_wrap=True)
    for record in beside.records:
        table = Table(title=f"{record.name}: largest orders")
        for column in ("body or mesh", "order", "measured [arcmin]", "computed", "phase [deg]", "computed"):
            table.add_column(column, justify="left" if column == "body or mesh" else "right")
        for each in record.orders:
            phases = [f"{np.degrees(phase):.1f}" for phase in (each.phase_measured, each.phase_computed)]
            sizes = [f"{value / arcmin:.4f}" for value in (each.measured, each.computed)]
            table.add_row(each.name, f"{each.order:.5g}", *sizes, *phases)
        show(console, table)


def print_found(result) -> None:
    found, console = result.found, output()
    table = Table(title=f"Identified numbers; standard deviation of the residual {found.fit.sigma:.4g} arcmin")
    for column in ("number", "value", "standard error", "95 % from", "to", "unit"):
        table.add_column(column, justify="left" if column in ("number", "unit") else "right")
    for each in found.estimates:
        interval = each.interval
        told = ("not identified", "", "") if interval is None else tuple(f"{v:.5g}" for v in (each.error, *interval))
        table.add_row(each.name, f"{each.value:.5g}", *told, each.unit)
    show(console, table)
    if found.visible.combinations:
        table = Table(title="Identified only as a sum")
        for column in ("sum", "value", "standard error", "unit"):
            table.add_column(column, justify="left" if column in ("sum", "unit") else "right")
        for each in found.visible.combinations:
            table.add_row(each.words, f"{each.value:.5g}", f"{each.error:.3g}", each.unit)
        show(console, table)
    for words in found.hidden:
        console.print(f"hidden: {words}", soft_wrap=True)
    for order in found.orders:
        words = f"{order.name}, {order.amplitude:.4g} arcmin, {np.degrees(order.phase):.1f} deg: {order.body}"
        console.print(f"order that the gear set does not explain: {words}", soft_wrap=True)
    for drift in found.drifts:
        words = f"{drift.change:.3g} arcmin from its start to its end, its middle off by {-drift.bend:.3g} arcmin"
        console.print(f"{drift.name} (temperature, or a slipping coupling): {words}", soft_wrap=True)
    for one, other, value in found.correlations[:8]:
        console.print(f"correlated: {one} and {other} ({value:+.3f})", soft_wrap=True)
    for each in found.suggestions[:3]:
        console.print(f"a further recording would show {' and '.join(each.shows)}: {each.words}", soft_wrap=True)
    print_comparison(result.beside)
    if result.advice is not None:
        _print_advice(console, result.advice)


def _print_advice(console, advice) -> None:
    turns = ", ".join(f"{path.partition('.')[2]} by {angle / deg:.1f} deg" for path, angle in advice.turns.items())
    gain = advice.gain
    console.print(
        f"reassembly: turn {turns}: {advice.metric.replace('_', '-')} {advice.before / arcmin:.4f} -> "
        f"{advice.after / arcmin:.4f} arcmin expected; ratio after/before {gain.median:.2f} (5 % {gain.low:.2f}, 95 % "
        f"{gain.high:.2f}), worse than before in {100 * gain.worse:.0f} %",
        soft_wrap=True,
    )
    if advice.second is not None:
        second = advice.second
        console.print(
            f"with one more recording first ({advice.second_words}): ratio {second.median:.2f} (5 % {second.low:.2f}, "
            f"95 % {second.high:.2f}), worse in {100 * second.worse:.0f} %",
            soft_wrap=True,
        )
