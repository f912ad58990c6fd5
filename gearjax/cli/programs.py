"""Compilation of programs for the command line, and the folder in which they are kept."""

import contextlib
import hashlib
import os
import platform
from pathlib import Path

import jax
import jaxlib.version

from gearjax.checks import GearjaxError
from gearjax.files import write_file
from gearjax.xla import chosen, known_options

WHERE_FROM = "jax_include_full_tracebacks_in_locations"


def leave_out_where_from() -> None:
    """Leave the lines of Python behind each operation out of programs; this saves a tenth of the time to make them."""
    if WHERE_FROM in jax.config.values:
        jax.config.update(WHERE_FROM, False)


def kept_in() -> Path | None:
    """Keep compiled programs between runs, unless the user has set a folder for JAX's cache or disabled the cache.

    Returns:
        The folder, one for each kind of processor; ``None`` if gearjax does not keep programs.
    """
    told = jax.config.values
    if told["jax_compilation_cache_dir"] is not None or not told["jax_enable_compilation_cache"]:
        return None
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gearjax" / _processor()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.02)
    return folder


def _processor() -> str:
    try:
        processor = [line for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines() if "flags" in line]
    except OSError:
        processor = [platform.processor()]
    return hashlib.sha256("".join([platform.machine(), *processor[:1]]).encode()).hexdigest()[:12]


def set_options(folder: Path | None, *, runs_long: bool) -> None:
    """Set XLA's options before XLA starts, unless the user has set them or the shell only completes a word.

    Args:
        folder: folder to keep the list of options that suit this version of XLA, which it takes seconds to find.
        runs_long: whether the command computes longer than it compiles.
    """
    if "XLA_FLAGS" in os.environ or "_GEARJAX_COMPLETE" in os.environ:
        return
    file = folder / f"usable-options-{jaxlib.version.__version__}.txt" if folder is not None else None
    try:
        known = file.read_text(encoding="utf-8") if file is not None else None
    except OSError:
        known = None
    if known is None:
        known = known_options()
        if file is not None:
            with contextlib.suppress(GearjaxError):  # another command may have written it just now
                write_file(file, known)
    os.environ["XLA_FLAGS"] = chosen(known, quick_compiler=not runs_long)
