"""Options of XLA for gearjax on CPUs. XLA reads them from the variable ``XLA_FLAGS`` when JAX starts."""

import functools
import os
import subprocess
import sys
from pathlib import Path

LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000"
"""Compiles a loop to one kernel; without it XLA calls several kernels for each step of the loop."""
WIDE = "--xla_cpu_prefer_vector_width=512"
"""Uses the full vector width of processors with AVX-512."""
QUICK_COMPILER = "--xla_cpu_use_fusion_emitters=false"
"""Uses the older kernel compiler: compiling takes half the time, and the compiled program 1 to 1.4 times as long."""


def xla_options(*, quick_compiler: bool = False) -> str:
    """Options that make gearjax faster on CPUs: those of `LOOPS` and `WIDE` that this version of XLA knows.

    The command ``gearjax`` sets them itself, unless ``XLA_FLAGS`` is set. In Python, set them before any computation:

        import os
        import gearjax as gj
        os.environ["XLA_FLAGS"] = gj.xla_options()

    They change results by rounding only. An option that XLA does not know would end the process; therefore the options
    are tried first, which takes a second or two.

    Args:
        quick_compiler: whether to add `QUICK_COMPILER`, for work that compiles longer than it runs.

    Returns:
        The options as the value of ``XLA_FLAGS``; empty if this version of XLA knows none of them.
    """
    return chosen(known_options(), quick_compiler=quick_compiler)


def chosen(known: str, *, quick_compiler: bool) -> str:
    """The known options, without `QUICK_COMPILER` unless it is wanted."""
    return " ".join(option for option in known.split() if quick_compiler or option != QUICK_COMPILER)


def known_options() -> str:
    """All options of this file that suit the processor and that this version of XLA knows."""
    return _known_of((LOOPS, *((WIDE,) if _has_wide_vectors() else ()), QUICK_COMPILER))


@functools.cache
def _known_of(options: tuple[str, ...]) -> str:
    together = " ".join(options)
    return together if is_known(together) else " ".join(option for option in options if is_known(option))


def is_known(options: str) -> bool:
    """Whether the XLA of this environment starts with these options; this is tried in a separate process."""
    environment = os.environ | {"XLA_FLAGS": options, "JAX_PLATFORMS": "cpu"}
    tried = [sys.executable, "-c", "import jax; jax.devices()"]
    return not subprocess.run(tried, env=environment, capture_output=True, check=False).returncode


def _has_wide_vectors() -> bool:
    try:
        return "avx512f" in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return False
