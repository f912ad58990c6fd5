"""``gearjax new``: prints a commented configuration as a starting point."""

from typing import Annotated

import typer

from gearjax.checks import MISSING, ParameterError
from gearjax.cli.commands import app


def _kinds() -> list[str]:
    from gearjax.registry import kinds

    return [system.kind for system in kinds("gearjax.systems")]


@app.command()
def new(
    kind: Annotated[
        str | None, typer.Argument(metavar="KIND", help="kind of gear set, such as two_kv", autocompletion=_kinds)
    ] = None,
) -> None:
    """Print a configuration of a kind of gear set, with every key, its unit, its bounds and its meaning.

    The text goes to stdout: gearjax new two_kv > mine.toml
    """
    if kind is None:
        raise ParameterError("new", MISSING, f"needs a kind of gear set: {', '.join(_kinds())}")
    from gearjax.config import template

    print(template(kind), end="")
