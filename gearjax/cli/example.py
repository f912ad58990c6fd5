"""``gearjax example``: copies a shipped example as a starting point."""

from pathlib import Path
from typing import Annotated

import typer

from gearjax.checks import MISSING, ParameterError
from gearjax.cli.commands import CopiesOption, app, say
from gearjax.config.examples import copy_example, examples


@app.command()
def example(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", help="name of an example, such as two_kv", autocompletion=lambda: list(examples())
        ),
    ] = None,
    out: CopiesOption = None,
) -> None:
    """Copy the configurations of an example, with the files that they name: gearjax example two_kv

    Without --out they go to a folder with the name of the example.
    """
    if name is None:
        raise ParameterError("example", MISSING, f"needs a name: {', '.join(examples())}")
    for file in copy_example(name, Path(name) if out is None else out):
        print(file)
    say("use one of these files with gearjax run, optimise or tolerance")
