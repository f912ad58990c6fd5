"""Command line. Tables and JSON go to stdout, progress and one-line errors to stderr; a mistake ends with code 2."""

import hashlib
import json
import math
import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Annotated

import jax
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from gearjax.checks import GearjaxError, ParameterError, nearest, writing
from gearjax.config import loads, loads_optimise, read_file
from gearjax.reproduce import PAPERS, Row
from gearjax.results import (
    Case,
    Optimisation,
    growth_remark,
    highest_load_sharing,
    remarks,
    run_cases,
    save,
    save_optimisation,
    save_tradeoff,
    stored_config,
    tradeoff_as_json,
)
from gearjax.results import optimise as run_optimise
from gearjax.scene import METRICS, Scene
from gearjax.studies.select import pick
from gearjax.studies.tradeoff import Tradeoff, accurate_step
from gearjax.studies.tradeoff import tradeoff as run_tradeoff
from gearjax.units import arcmin, deg

app = typer.Typer(add_completion=False, rich_markup_mode=None)
_progress = Console(stderr=True)

ConfigArgument = Annotated[Path, typer.Argument(metavar="CONFIG", help="TOML file, or a results.nc to run again")]
OutOption = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="folder for results and figures")]
JsonOption = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else")]


def _show_version(wanted: bool | None) -> None:
    if wanted:
        print(f"gearjax {metadata.version('gearjax')}")
        raise typer.Exit


@app.callback()
def _app(
    version: Annotated[
        bool | None, typer.Option("--version", help="print the version", callback=_show_version, is_eager=True)
    ] = None,
) -> None:
    """Differentiable gear dynamics: transmission error without load, under load and in motion."""
    del version  # its callback has printed it


@app.command()
def run(
    config: ConfigArgument,
    out: OutOption = None,
    json_: JsonOption = False,
    accuracy: Annotated[
        float | None, typer.Option("--accuracy", metavar="ARCMIN", help="allowed error of the dynamic metrics")
    ] = None,
) -> None:
    """Every analysis that the configuration lists: table, figures and results file.

    Without --out they go to out/NAME; with --json and no --out nothing is written.
    """
    text, scene = _read(config)
    stepper = None
    if accuracy is not None:
        allowed = _positive("--accuracy", accuracy)
        if scene.run is not None and "dynamic" in scene.run.analyses:
            stepper = accurate_step(scene, allowed, _say)
    for remark in remarks(scene):
        _progress.print(f"note: {remark}", soft_wrap=True)
    cases = []
    for case in run_cases(scene, stepper, workers=os.cpu_count() or 1):
        _progress.print(f"done: {case.title}", style="dim", soft_wrap=True)
        remark = growth_remark(scene, case)
        if remark is not None:
            _progress.print(f"note: {remark}", soft_wrap=True)
        cases.append(case)
    folder = out if out is not None else None if json_ else Path("out") / config.stem
    if folder is not None:
        from gearjax.plot import save_figures  # matplotlib takes a second that a run with --json need not wait

        written = save(scene, cases, text, folder) + save_figures(scene, cases, folder)
        _progress.print(f"written to {folder}: {', '.join(path.name for path in written)}", style="dim", soft_wrap=True)
    if json_:
        print(json.dumps({"config": str(config), "cases": [case.as_json() for case in cases]}, allow_nan=False))
    else:
        _print_cases(cases)


@app.command()
def reproduce(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="a paper; all of them without")] = None,
    out: OutOption = None,
    json_: JsonOption = False,
) -> None:
    """Published figures of a paper next to ours."""
    if name is not None and name not in PAPERS:
        raise ParameterError("reproduce", name, f"unknown paper; {nearest(name, PAPERS)}")
    reports = []
    for key in [name] if name is not None else PAPERS:
        paper, rows = PAPERS[key]
        _progress.print(f"computing: {paper}", style="dim", soft_wrap=True)
        reports.append((paper, rows()))
    if out is not None:
        _write_rows(out, reports)
    objects = [{"paper": paper, "rows": [row.as_json() for row in rows]} for paper, rows in reports]
    if json_:
        print(json.dumps(objects[0] if len(objects) == 1 else {"papers": objects}))
        return
    for paper, rows in reports:
        _print_rows(paper, rows)


@app.command()
def optimise(config: ConfigArgument, out: OutOption = None, json_: JsonOption = False) -> None:
    """Assembly phases, or any other numbers: grid search and gradients side by side, before and after.

    Without --out the results go to out/NAME; with --json and no --out nothing is written.
    """
    text = _read_text(config)
    scene, section = loads_optimise(text)

    found = run_optimise(section, scene, _say)
    folder = out if out is not None else None if json_ else Path("out") / config.stem
    if folder is not None:
        from gearjax.plot import save_optimisation_figures

        written = save_optimisation(found, text, folder) + save_optimisation_figures(found, folder)
        _progress.print(f"written to {folder}: {', '.join(path.name for path in written)}", style="dim", soft_wrap=True)
    if json_:
        print(json.dumps(found.as_json(), allow_nan=False))
    else:
        _print_optimisation(found)


@app.command()
def tradeoff(
    config: ConfigArgument,
    error: Annotated[float, typer.Option("--error", metavar="ARCMIN", help="allowed error of a metric")] = 0.001,
    out: OutOption = None,
    json_: JsonOption = False,
) -> None:
    """Speed against accuracy of the dynamic TE for this scene, measured: solvers, steps, contact laws, precision.

    Without --out the results go to out/NAME; with --json and no --out nothing is written.
    """
    _, scene = _read(config)
    found = run_tradeoff(scene, _positive("--error", error), _say)
    folder = out if out is not None else None if json_ else Path("out") / config.stem
    if folder is not None:
        from gearjax.plot import save_tradeoff_figure

        written = save_tradeoff(found, folder) + save_tradeoff_figure(found, folder)
        _say(f"written to {folder}: {', '.join(path.name for path in written)}")
    if json_:
        print(json.dumps(tradeoff_as_json(str(config), found), allow_nan=False))
    else:
        _print_tradeoff(found)


def _positive(option: str, given: float) -> float:
    """A positive number of arcmin, in rad."""
    if not (math.isfinite(given) and given > 0):
        raise ParameterError(option, given, "must be above 0 arcmin")
    return given * arcmin


def _say(words: str) -> None:
    _progress.print(words, style="dim", soft_wrap=True)


def _print_tradeoff(found: Tradeoff) -> None:
    table = Table(title="What each choice costs and buys; one run, one torque")
    for column in ("setting", "", "error [arcmin]", "run [ms]", "gradient [ms]", "compile [s]"):
        table.add_column(escape(column), justify="left" if column in ("setting", "") else "right")
    for row in found.rows:
        gradient = "" if row.gradient_seconds is None else f"{1e3 * row.gradient_seconds:.1f}"
        error = f"{row.error / arcmin:.2g}"
        table.add_row(row.group, row.name, error, f"{1e3 * row.seconds:.1f}", gradient, f"{row.compile_seconds:.1f}")
    console = _output()
    console.print(table)
    allowed = f"{found.error / arcmin:g} arcmin"
    if found.best is None:
        console.print(f"no setting is within {allowed}", soft_wrap=True)
    else:
        console.print(f"cheapest within {allowed}: {found.best.group}: {found.best.name}", soft_wrap=True)


def _print_optimisation(found: Optimisation) -> None:
    console = _output()
    table = Table(title=f"{found.section.objective.name}, {found.section.window:g} s")
    parameters = found.parameters
    units = [p.dimension.shown if p.dimension else "" for p in parameters.values()]
    columns = ["", "arcmin", *(f"{path} [{unit}]" for path, unit in zip(parameters, units, strict=True))]
    for column in (*columns, "evaluations", "run [s]", "compile [s]"):
        table.add_column(escape(column), justify="right" if column else "left", overflow="fold")

    def row(title: str, objective: float, point, *rest: str) -> None:
        shown = [f"{found.shown(path, float(value)):.6g}" for path, value in zip(parameters, point, strict=True)]
        table.add_row(title, f"{objective / arcmin:.5f}", *shown, *rest)

    row("before", found.before, pick(found.scene, found.section.where).get(found.scene), "", "", "")
    grid, search = found.grid, found.gradient
    if grid is not None:
        count = f"{grid.combinations} ({grid.evaluated} on all times)"
        row("grid", grid.objective, grid.best, count, f"{grid.seconds:.2f}", f"{grid.compile_seconds:.1f}")
    count = f"{search.evaluations}, {len(search.starts)} starts"
    row("gradients", search.objective, search.best, count, f"{search.seconds:.2f}", f"{search.compile_seconds:.1f}")
    console.print(table)
    console.print(
        f"{search.within(0.01)} of {len(search.starts)} starts within 1 % of the best, in "
        f"{int(search.valley.max()) + 1} valleys; {search.failed} dropped because they were not finite",
        soft_wrap=True,
    )
    around = found.sensitivity
    for direction, rise, flat in zip(around.directions, around.rises, around.flat, strict=True):
        if flat:
            words = ", ".join(f"{path} {share:+.2f}" for path, share in zip(around.paths, direction, strict=True))
            console.print(f"flat: 10 deg along ({words}) cost {100 * rise:.1f} %", soft_wrap=True)
    for deviation, mean, worst in zip(around.deviations, around.mean, around.worst, strict=True):
        console.print(
            f"assembled with errors of up to {deviation / deg:g} deg: {mean / arcmin:.4f} arcmin on average, "
            f"{worst / arcmin:.4f} at worst",
            soft_wrap=True,
        )
    _print_stages(console, found)


def _print_stages(console: Console, found: Optimisation) -> None:
    table = Table(title="Transmission error in arcmin, before and after")
    for column in ("case", "window [s]", "stage", *(name.replace("_", "-") for name in METRICS)):
        table.add_column(escape(column), justify="left" if column in ("case", "stage") else "right")
    for row, case in enumerate(found.cases["before"]):
        for stage, cases in found.cases.items():
            title = (case.title, f"{case.window:g}") if stage == "before" else ("", "")
            table.add_row(*title, stage, *(f"{cases[row].metrics[name] / arcmin:.4f}" for name in METRICS))
    console.print(table)


def _read_text(config: Path) -> str:
    """Text of a configuration, or of the one inside a results file."""
    return stored_config(config) if config.suffix == ".nc" else read_file(config)


def _read(config: Path) -> tuple[str, Scene]:
    """Text and scene of a configuration, or of a results file's own configuration."""
    text = _read_text(config)
    return text, loads(text)


def _print_cases(cases: list[Case]) -> None:
    compared = any(case.published for case in cases)
    table = Table(title="Transmission error in arcmin" + (", published values in brackets" if compared else ""))
    for column in ("case", "window [s]", *(name.replace("_", "-") for name in METRICS), "highest load sharing"):
        table.add_column(escape(column), justify="left" if column == "case" else "right")
    for case in cases:
        known = dict(case.published.metrics) if case.published else {}
        values = [_cell(case.metrics[name], known.get(name)) for name in METRICS]
        sharing = highest_load_sharing(case)
        table.add_row(case.title, f"{case.window:g}", *values, "" if sharing is None else f"{sharing:.3f}")
    console = _output()
    console.print(table)
    for note in dict.fromkeys(case.published.note for case in cases if case.published and case.published.note):
        titles = ", ".join(case.title for case in cases if case.published and case.published.note == note)
        console.print(f"{titles}: {note}", style="dim", soft_wrap=True)


def _output() -> Console:
    """Standard output; wide enough for every table where it is not a terminal."""
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False)


def _cell(value: float, published: float | None) -> str:
    text = f"{value / arcmin:.4f}"
    return text if published is None else f"{text} ({published / arcmin:.3f})"


def _print_rows(paper: str, rows: list[Row]) -> None:
    table = Table(title=f"{paper}, in arcmin")
    for column in ("item", "published", "ours", "deviation", "status"):
        table.add_column(column, justify="left" if column in ("item", "status") else "right")
    for row in rows:
        table.add_row(row.item, row.published, f"{row.computed:.4f}", f"{row.deviation:+.4f}", row.status)
    console = _output()
    console.print(table)
    for why in dict.fromkeys(row.why for row in rows if row.why):
        items = dict.fromkeys(row.item.rpartition(",")[0] for row in rows if row.why == why)
        console.print(f"{'; '.join(items)}: {why}", style="dim", soft_wrap=True)


def _write_rows(folder: Path, reports: list[tuple[str, list[Row]]]) -> None:
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lines = ["paper,item,published,computed,deviation,unit,status"]
        for paper, rows in reports:
            lines += [
                f'"{paper}","{row.item}",{row.published},{row.computed:.6g},{row.deviation:+.6g},{row.unit},{row.status}'
                for row in rows
            ]
        (folder / "published.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def keep_programs() -> None:
    """Keep compiled programs between runs, apart for each kind of processor, unless JAX was told where to."""
    told = jax.config.values
    if told["jax_compilation_cache_dir"] is not None or not told["jax_enable_compilation_cache"]:
        return
    try:
        processor = [line for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines() if "flags" in line]
    except OSError:
        processor = [platform.processor()]
    kind = hashlib.sha256("".join([platform.machine(), *processor[:1]]).encode()).hexdigest()[:12]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gearjax" / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.02)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the command ``gearjax``."""
    jax.config.update("jax_enable_x64", True)
    keep_programs()
    try:
        given = sys.argv[1:] if arguments is None else arguments
        code = app(given or ["--help"], prog_name="gearjax", standalone_mode=False)
    except Exception as fault:
        message = getattr(fault, "format_message", None)  # how typer's own errors print themselves
        if not isinstance(fault, GearjaxError) and message is None:
            raise
        words = " ".join(str(message() if message else fault).split())
        print(f"gearjax: error: {words}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("gearjax: stopped", file=sys.stderr)
        sys.exit(130)
    sys.exit(code if isinstance(code, int) else 0)
