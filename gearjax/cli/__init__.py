"""Command line. Tables and JSON go to stdout, progress and one-line errors to stderr; a mistake ends with code 2."""

import atexit
import gc
import hashlib
import os
import platform
import sys
from pathlib import Path

import jax
import typer

from gearjax.checks import GearjaxError
from gearjax.cli import new as _new  # noqa: F401  (adds its command)
from gearjax.cli import stopping
from gearjax.cli.commands import app

__all__ = ["app", "keep_programs", "main"]


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


def _collect_seldom() -> None:
    """Have the garbage collector look at new objects alone, and less often: tracing makes many that stay.

    It took a third of a short command's time, half of that when the process ended.
    """
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)
    atexit.register(gc.freeze)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the command ``gearjax``."""
    stopping.say_when_stopped(stopping.nothing_kept)
    if arguments is None:
        stopping.listen()
    jax.config.update("jax_enable_x64", True)
    keep_programs()
    if arguments is None:
        _collect_seldom()
    try:
        given = sys.argv[1:] if arguments is None else arguments
        code = app(given or ["--help"], prog_name="gearjax", standalone_mode=False)
        if not given and not code:
            code = 2  # nothing was asked for; the help tells what could be
    except (KeyboardInterrupt, typer.Abort):  # where Ctrl-C is not listened for; some versions of typer abort,
        code = stopping.CODE  # others return this code
    except Exception as fault:
        message = getattr(fault, "format_message", None)  # how typer's own errors print themselves
        if not isinstance(fault, GearjaxError) and message is None:
            raise
        words = " ".join(str(message() if message else fault).split())
        print(f"gearjax: error: {words}", file=sys.stderr)
        sys.exit(2)
    if code == stopping.CODE:
        print(stopping.message(), file=sys.stderr)
    sys.exit(code if isinstance(code, int) else 0)
