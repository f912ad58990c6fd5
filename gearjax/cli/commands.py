"""The commands of the command line. Each imports what it needs once its configuration has been read."""

import json
import math
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

import gearjax
from gearjax.checks import MissingExtraError, ParameterError, check_path, nearest
from gearjax.cli.report import Report, ReportOption
from gearjax.cli.written import replacing
from gearjax.files import writable, write_file
from gearjax.reproduce import NAMES
from gearjax.units import arcmin

if TYPE_CHECKING:
    from gearjax.reproduce import Row
    from gearjax.results import GradedGear
    from gearjax.scene import Scene

app = typer.Typer(rich_markup_mode=None)
_progress = Console(stderr=True, markup=False, emoji=False)


def _folder(text: str) -> Path:
    """The folder of an option; an empty text, as from a variable of the shell that is not set, is refused."""
    if not text:
        raise typer.BadParameter("is empty: give a folder, such as out/mine")
    return Path(text)


def _writable(out: Path | None) -> Path | None:
    """The folder of --out; it is refused before anything is computed if it cannot be written."""
    return None if out is None else writable(out)


ConfigArgument = Annotated[Path, typer.Argument(metavar="CONFIG", help="TOML file, or a results.nc to run again")]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="folder for results and figures", parser=_folder, callback=_writable),
]
CopiesOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="folder for the copies", parser=_folder, callback=_writable)
]
JsonOption = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else")]


def _show_version(wanted: bool | None) -> None:
    if wanted:
        print(f"gearjax {gearjax.__version__}")
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
    report: ReportOption = False,
) -> None:
    """Run every analysis that the configuration lists: table, figures and results file.

    Without --out the results go to out/NAME; with --json and no --out nothing is written.
    """
    text, scene = _read(config)
    folder = folder_for(out, json_, config)
    page, allowed = Report(report, folder), None if accuracy is None else _positive("--accuracy", accuracy)
    if scene.run is not None:
        told_read(config, scene)
    from gearjax.analysis import FewAngles

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewAngles)  # `remarks` reports it once, with what to change
        with page.listening():
            _run(config, text, scene, folder, json_, allowed, page)


def _run(
    config: Path, text: str, scene: "Scene", folder: Path | None, json_: bool, allowed: float | None, page: Report
) -> None:
    from gearjax import results
    from gearjax.cli import tables
    from gearjax.config import self_contained

    stepper = None
    if allowed is not None and scene.run is not None and "dynamic" in scene.run.analyses:
        from gearjax.studies.accurate_step import accurate_step

        stepper = accurate_step(scene, allowed, say)
    for remark in results.remarks(scene):
        noted(page, remark)
    cases = []
    for case in results.run_cases(scene, stepper, workers=os.cpu_count() or 1):
        _progress.print(f"done: {case.title}", style="dim", soft_wrap=True)
        apart = results.separation_remark(scene, case, say) if stepper is None else None
        for remark in (results.growth_remark(scene, case), apart):
            if remark is not None:
                noted(page, remark)
        cases.append(case)
    remark = results.displacement_remark(scene, cases)
    if remark is not None:
        noted(page, remark, "warning")
    overlap = results.clash_of(scene, cases)
    words = None if overlap is None else overlap.told(scene)
    if words is not None:
        noted(page, words, "warning")
    graded = _graded(scene)
    told = {"config": str(config), "cases": [case.as_json() for case in cases]}
    if overlap is not None and words is not None:
        told["interference"] = overlap.as_json(scene)
    if graded:
        told["accuracy"] = [gear.as_json() for gear in graded]
    factors = results.face_load_factors(scene, cases)
    if factors:
        told["face_load_factor"] = factors
    impacts = results.impacts_as_json(results.impacts_of(scene, cases))
    if impacts:
        told["meshing_impact"] = impacts
    if folder is not None:
        from gearjax.plot import save_figures  # matplotlib takes a second to import; a run with --json need not wait

        with replacing(folder, "run", say) as new:
            new.add(results.save(scene, cases, self_contained(text, config.parent), new.folder))
            with page.drawing():
                new.add(save_figures(scene, cases, new.folder))
            new.add(page.write(new.folder, f"gearjax run {config.name}", told, text))
    if json_:
        print(json.dumps(told, allow_nan=False))
    else:
        tables.print_cases(cases, 1 / scene.system.orders["output"], scene.system.told_of_forces)
        tables.print_face_load(factors)
        tables.print_impacts(impacts)
        tables.print_accuracy(graded)


def noted(page: Report, words: str, kind: str = "note") -> None:
    """Report something that a reader of the results should know, now and on the page of a report."""
    page.note(words)
    _progress.print(f"{kind}: {words}", soft_wrap=True)


def _graded(scene: "Scene") -> "list[GradedGear]":
    """Measured gears with their grades; none, and a note, if their sizes are outside the range of the standard."""
    from gearjax.results import graded_gears

    try:
        return graded_gears(scene)
    except ParameterError as fault:
        _progress.print(f"note: no grades of accuracy: {fault}", soft_wrap=True)
        return []


def _papers(incomplete: str) -> list[str]:
    """Names of papers with which a shell can complete an argument."""
    return [name for name in NAMES if name.startswith(incomplete)]


PaperArgument = Annotated[
    str | None,
    typer.Argument(metavar="[NAME]", help=f"{', '.join(NAMES)}; if left out, all papers", autocompletion=_papers),
]

AllOption = Annotated[bool, typer.Option("--all", help="every paper, as one page in Markdown")]


@app.command()
def reproduce(
    name: PaperArgument = None,
    out: OutOption = None,
    json_: JsonOption = False,
    all_: AllOption = False,
) -> None:
    """Compare the published values of a paper with ours.

    With --out a table of the values is written, and figures of every paper. With --all every paper is written as one
    page in Markdown, to standard output or to validation.md in --out.
    """
    if name is not None and name not in NAMES:
        raise ParameterError("reproduce", name, f"unknown paper; {nearest(name, NAMES)}")
    if name is not None and all_:
        raise ParameterError("reproduce", name, "give one paper or --all, not both")
    from gearjax.reproduce import PAPERS, validation_page

    reports = []
    for key, paper in PAPERS.items() if name is None else [(name, PAPERS[name])]:
        say(f"computing: {paper.title}")
        try:
            reports.append((paper.title, paper.rows(say)))
        except MissingExtraError as fault:
            if name is not None or all_:
                raise
            _progress.print(f"left out: {paper.title}: {fault}", soft_wrap=True)
            continue
        if out is not None:
            paper.save_all_figures(reports[-1][1], out, key)
    if out is not None:
        _write_rows(out, reports)
        if all_:
            write_file(out / "validation.md", validation_page(reports))
    objects = [{"paper": paper, "rows": [row.as_json() for row in rows]} for paper, rows in reports]
    if json_:
        print(json.dumps(objects[0] if len(objects) == 1 else {"papers": objects}))
        return
    if all_ and out is None:
        print(validation_page(reports), end="")
        return
    from gearjax.cli.tables import print_rows

    for paper, rows in reports:
        print_rows(paper, rows)


@app.command()
def optimise(
    config: ConfigArgument, out: OutOption = None, json_: JsonOption = False, report: ReportOption = False
) -> None:
    """Optimise assembly phases, or any other numbers, by grid search and by gradients; show before and after.

    Without --out the results go to out/NAME; with --json and no --out nothing is written.
    """
    text = text_of(config)
    from gearjax.config import loads_optimise

    scene, section = loads_optimise(text, config.parent)
    folder = folder_for(out, json_, config)
    page = Report(report, folder)
    told_read(config, scene)
    from gearjax.cli.tables import print_optimisation
    from gearjax.results import optimise as run_optimise
    from gearjax.results import save_optimisation

    with page.listening():
        optimisation = run_optimise(section, scene, say, workers=os.cpu_count() or 1)
    told = optimisation.as_json()
    if folder is not None:
        from gearjax.plot import save_optimisation_figures

        with replacing(folder, "optimise", say) as new:
            new.add(save_optimisation(optimisation, text, new.folder, config.parent))
            with page.drawing():
                new.add(save_optimisation_figures(optimisation, new.folder))
            new.add(page.write(new.folder, f"gearjax optimise {config.name}", told, text))
    if json_:
        print(json.dumps(told, allow_nan=False))
    else:
        print_optimisation(optimisation)


@app.command()
def tradeoff(
    config: ConfigArgument,
    error: Annotated[float, typer.Option("--error", metavar="ARCMIN", help="allowed error of a metric")] = 0.001,
    out: OutOption = None,
    json_: JsonOption = False,
) -> None:
    """Measure speed against accuracy of the dynamic TE for this scene: solvers, steps, contact laws, precision.

    With a tolerance section the command also measures how far float32 shifts the quantiles of its measures.

    Without --out the results go to out/NAME; with --json and no --out nothing is written.
    """
    text, scene = _read(config)
    folder, allowed = folder_for(out, json_, config), _positive("--error", error)
    if scene.run is not None:
        told_read(config, scene)
    from gearjax.cli.tables import print_shifts, print_tradeoff
    from gearjax.config import loads_tolerance, read_tables
    from gearjax.results import save_tradeoff, tradeoff_as_json
    from gearjax.results.tolerance import save_shifts, shifts, shifts_as_json
    from gearjax.studies.tradeoff import tradeoff as run_tradeoff

    shifted, compared = [], None
    if "tolerance" in read_tables(text):
        say("float32 against float64: quantiles of the tolerance study")
        shifted = shifts(loads_tolerance(text, config.parent)[2])
    if not shifted or (scene.run is not None and "dynamic" in scene.run.analyses):
        compared = run_tradeoff(scene, allowed, say, workers=os.cpu_count() or 1)
    if folder is not None:
        from gearjax.plot import save_tradeoff_figure

        with replacing(folder, "tradeoff", say) as new:
            new.add(save_shifts(shifted, new.folder))
            if compared is not None:
                new.add(save_tradeoff(compared, new.folder) + save_tradeoff_figure(compared, new.folder))
    if json_:
        entries = {"config": str(config)} if compared is None else tradeoff_as_json(str(config), compared)
        further = {"float32_quantiles": shifts_as_json(shifted)} if shifted else {}
        print(json.dumps(entries | further, allow_nan=False))
        return
    if compared is not None:
        print_tradeoff(compared)
    if shifted:
        print_shifts(shifted)


@app.command()
def tolerance(
    config: ConfigArgument,
    out: OutOption = None,
    json_: JsonOption = False,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler: tcp://HOST:8786, or local")
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", metavar="N", help="number of processes of a Dask cluster on this machine")
    ] = None,
    report: ReportOption = False,
) -> None:
    """Monte Carlo study: distributions, yields, sensitivities, allocation, assembly. A killed study can be resumed.

    Without --out the results go to out/NAME; with --json and no --out nothing is written, and nothing can be resumed.
    """
    text = text_of(config)
    _check_cluster(scheduler, workers)
    folder = folder_for(out, json_, config)
    from gearjax.cli.tolerance import print_tolerance, study
    from gearjax.results.tolerance import save_tolerance

    page = Report(report, folder)
    with page.listening():
        results, work = study(text, config.parent, folder, scheduler, workers, _progress, say)
    told = results.as_json()
    if folder is not None:
        from gearjax.plot import save_tolerance_figures

        with replacing(folder, "tolerance", say) as new:
            new.add(save_tolerance(results, work, text, new.folder, config.parent))
            with page.drawing():
                new.add(save_tolerance_figures(results, new.folder))
            new.add(page.write(new.folder, f"gearjax tolerance {config.name}", told, text))
    if json_:
        print(json.dumps(told, allow_nan=False))
    else:
        print_tolerance(results)


def _check_cluster(scheduler: str | None, workers: int | None) -> None:
    if scheduler is not None and workers is not None:
        raise ParameterError("--workers", workers, "belongs to a local cluster: leave --scheduler or --workers out")
    if workers is not None and workers < 1:
        raise ParameterError("--workers", workers, "must be at least 1")


def folder_for(out: Path | None, json_: bool, config: Path) -> Path | None:
    """Folder for the results: --out if given, none with --json, else out/NAME if that can be written."""
    return out if out is not None else None if json_ else writable(Path("out") / config.stem)


def _positive(option: str, given: float) -> float:
    """Check that a number of arcmin is positive, and convert it to rad."""
    if not (math.isfinite(given) and given > 0):
        raise ParameterError(option, given, "must be above 0 arcmin")
    return given * arcmin


def say(words: str) -> None:
    _progress.print(words, style="dim", soft_wrap=True)


def text_of(config: Path) -> str:
    """Text of a configuration file, or of the configuration inside a results file."""
    check_path("CONFIG", config)
    if config.suffix == ".nc":
        from gearjax.results import stored_config

        return stored_config(config)
    from gearjax.config import read_file

    return read_file(config)


def _read(config: Path) -> "tuple[str, Scene]":
    """Text and scene of a configuration file, or of the configuration inside a results file."""
    from gearjax.config import loads

    text = text_of(config)
    return text, loads(text, config.parent)


def told_read(config: Path, scene: "Scene") -> None:
    """Say that the configuration is good, before what computes is imported."""
    say(f"read {config}: {scene.system.kind}")


def _write_rows(folder: Path, reports: "list[tuple[str, list[Row]]]") -> None:
    lines = ["paper,item,published,computed,deviation,unit,status"]
    for paper, rows in reports:
        lines += [
            f'"{paper}","{row.item}",{row.published},{row.computed:.6g},'
            f"{f'{row.deviation:+.6g}' if row.published else ''},{row.unit},{row.status}"
            for row in rows
        ]
    write_file(folder / "published.csv", "\n".join(lines) + "\n")
