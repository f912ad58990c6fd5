"""``gearjax show``: the figures of a finished command."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from gearjax.checks import GearjaxError, check_path
from gearjax.cli.commands import app, say
from gearjax.cli.report import NAME
from gearjax.cli.written import Folder

FIGURES = (".png", ".svg", ".pdf", ".gif", ".mp4")


@app.command()
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="folder of results, such as out/wang_2020")],
) -> None:
    """Open the report of the last command in a folder of results, or else the figures; without a display, list them."""
    check_path("DIR", folder)
    if not folder.is_dir():
        raise GearjaxError(f"{folder}: is not a folder; give a folder of results, such as out/NAME")
    report, of = folder / NAME, Folder(folder)
    shown = [report] if report.exists() and of.last in (None, of.of(NAME)) else []
    if report.exists() and not shown:
        say(f"{NAME} is of gearjax {of.of(NAME) or 'something else'}, and gearjax {of.last} wrote here last")
    shown = shown or sorted(path for path in folder.iterdir() if path.suffix in FIGURES)
    if not shown:
        raise GearjaxError(f"{folder}: has no figures; gearjax run, optimise, tolerance or identify write some")
    for path in shown:
        print(path)
        if _has_display():
            typer.launch(str(path))
    if not _has_display():
        say("no display here: open these files on another machine")


def _has_display() -> bool:
    """Whether windows can be opened."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
