"""``gearjax compare`` and ``gearjax identify``: recordings of a test bench next to computed curves."""

import dataclasses
import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gearjax.checks import GearjaxError, RepairedData
from gearjax.cli.commands import (
    ConfigArgument,
    JsonOption,
    OutOption,
    app,
    folder_for,
    noted,
    say,
    text_of,
    told_read,
)
from gearjax.cli.report import Report, ReportOption
from gearjax.cli.written import replacing

if TYPE_CHECKING:
    from gearjax.config import IdentifySection
    from gearjax.identification import Measurement
    from gearjax.scene import Scene

MeasuredOption = Annotated[
    list[Path] | None,
    typer.Option("--measured", metavar="CSV", help="a recording; repeat --measured for several recordings of one unit"),
]

DynamicOption = Annotated[
    bool | None,
    typer.Option("--dynamic/--static", help="compare with the dynamic TE (needs times and [inertia])"),
]


@app.command()
def compare(
    config: ConfigArgument,
    measured: MeasuredOption = None,
    shift: Annotated[bool, typer.Option("--shift", help="find the start angle of each recording too")] = False,
    dynamic: DynamicOption = None,
    out: OutOption = None,
    json_: JsonOption = False,
) -> None:
    """Compare recordings of a test bench with what the configuration computes: curves, orders, metrics.

    Without --out the results go to out/NAME; with --json and no --out nothing is written.
    """
    scene, section, records = _read(config, text_of(config), measured, dynamic)
    folder = folder_for(out, json_, config)
    told_read(config, scene)
    from gearjax.cli.bench_tables import print_comparison
    from gearjax.identification import compare as beside_each_other
    from gearjax.results.identification import save_comparison

    say(f"computing the curves of {len(records)} recordings")
    beside = beside_each_other(scene, records, shift="find" if shift else "none", analysis=section.analysis)
    for words in beside.notes:
        say(f"note: {words}")
    if folder is not None:
        from gearjax.plot.identification import save_comparison_figures

        with replacing(folder, "compare", say) as results:
            results.add(save_comparison(beside, results.folder))
            results.add(save_comparison_figures(beside, results.folder))
    if json_:
        print(json.dumps({"config": str(config)} | beside.as_json(), allow_nan=False))
    else:
        print_comparison(beside)


@app.command()
def identify(
    config: ConfigArgument,
    measured: MeasuredOption = None,
    dynamic: DynamicOption = None,
    out: OutOption = None,
    json_: JsonOption = False,
    report: ReportOption = False,
) -> None:
    """Find the errors that explain recordings of a test bench, what stays hidden, and how to reassemble the unit.

    An [identify] section may state the unknowns, what is known about them before, and which bodies can be turned.
    Without --out the results go to out/NAME; with --json and no --out nothing is written.
    """
    text = text_of(config)
    scene, section, records = _read(config, text, measured, dynamic)
    folder = folder_for(out, json_, config)
    page = Report(report, folder)
    told_read(config, scene)
    from gearjax.cli.bench_tables import print_found
    from gearjax.results.identification import identified, save_identified

    with page.listening():
        result = identified(section, scene, records, say)
    for words in result.found.notes:
        noted(page, words)
    told = {"config": str(config)} | result.as_json()
    if folder is not None:
        from gearjax.plot.identification import save_identification_figures

        with replacing(folder, "identify", say) as results:
            results.add(save_identified(result, text, results.folder, config.parent))
            with page.drawing():
                results.add(save_identification_figures(result.found, result.beside, results.folder))
            results.add(page.write(results.folder, f"gearjax identify {config.name}", told, text))
    if json_:
        print(json.dumps(told, allow_nan=False))
    else:
        print_found(result)


def _read(
    config: Path, text: str, measured: list[Path] | None, dynamic: bool | None
) -> "tuple[Scene, IdentifySection, list[Measurement]]":
    """Scene, section with the analysis that the command line asks for, and recordings."""
    from gearjax.config import loads_identify

    scene, section = loads_identify(text, config.parent)
    if dynamic is not None:
        section = dataclasses.replace(section, analysis="dynamic" if dynamic else "static")
    return scene, section, _records(measured, section.measured)


def _records(given: list[Path] | None, listed: tuple[Path, ...]) -> "list[Measurement]":
    """The recordings given on the command line or, if there are none, the recordings of the configuration."""
    from gearjax.config import read_measurement

    files = list(given or listed)
    if not files:
        raise GearjaxError("no recording: give --measured FILE.csv, or measured = [...] in [identify]")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RepairedData)  # the results report the repairs again
        return [read_measurement(file) for file in files]
