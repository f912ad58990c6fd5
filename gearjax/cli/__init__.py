"""Command line. Tables and JSON go to stdout, progress and one-line errors to stderr; a user's mistake gives code 2."""

import atexit
import gc
import sys
import warnings

import jax
import typer

from gearjax import stopping
from gearjax.checks import GearjaxError
from gearjax.cli import bench as _bench  # noqa: F401  (adds its commands)
from gearjax.cli import example as _example  # noqa: F401  (adds its command)
from gearjax.cli import new as _new  # noqa: F401  (adds its command)
from gearjax.cli import programs
from gearjax.cli import show as _show  # noqa: F401  (adds its command)
from gearjax.cli.commands import app

__all__ = ["app", "main"]


def _collect_seldom() -> None:
    """Let the garbage collector run less often and look only at new objects: tracing makes many objects that stay.

    Garbage collection took a third of the time of a short command, half of that at the end of the process.
    """
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)
    atexit.register(gc.freeze)


def _say_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning as one line, without the line of code that raised it."""
    print(f"gearjax: warning: {' '.join(str(message).split())}", file=sys.stderr)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the command ``gearjax``."""
    stopping.say_when_stopped(stopping.nothing_kept)
    if arguments is None:
        stopping.listen()
        warnings.showwarning = _say_warning
    jax.config.update("jax_enable_x64", True)
    programs.leave_out_where_from()
    folder, given = programs.kept_in(), sys.argv[1:] if arguments is None else arguments
    if arguments is None:
        programs.set_options(folder, runs_long=given[:1] == ["tolerance"])
        _collect_seldom()
    try:
        code = app(given or ["--help"], prog_name="gearjax", standalone_mode=False)
        if not given and not code:
            code = 2  # no command was given; only the help was printed
    except (KeyboardInterrupt, typer.Abort):  # if `stopping` does not handle Ctrl-C, some versions of typer
        code = stopping.CODE  # abort, and others return this code
    except Exception as fault:
        message = getattr(fault, "format_message", None)  # typer's own errors have this method
        if not isinstance(fault, GearjaxError) and message is None:
            raise
        words = " ".join(str(message() if message else fault).split())
        print(f"gearjax: error: {words}", file=sys.stderr)
        sys.exit(2)
    if code == stopping.CODE:
        print(stopping.message(), file=sys.stderr)
    sys.exit(code if isinstance(code, int) else 0)
