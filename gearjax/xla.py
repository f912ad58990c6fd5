"""Options of XLA for the programs of gearjax on CPUs. XLA reads them when JAX starts, from ``XLA_FLAGS``."""

import functools
import os
import subprocess
import sys
from pathlib import Path

LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000"
"""A loop is one kernel, where XLA calls several for each of its steps."""
WIDE = "--xla_cpu_prefer_vector_width=512"
"""Vectors of processors with AVX-512 in full."""
QUICK_COMPILER = "--xla_cpu_use_fusion_emitters=false"
"""The older compiler for kernels: it takes half the time, and what it compiles 1 to 1.4 times as long."""


def xla_options(*, quick_compiler: bool = False) -> str:
    """Options that make the programs of gearjax quicker on CPUs: those of `LOOPS` and `WIDE` that are known here.

    The command ``gearjax`` sets them itself, unless ``XLA_FLAGS`` is set. In Python, before anything is computed:

        import os
        import gearjax as gj
        os.environ["XLA_FLAGS"] = gj.xla_options()

    They change results by rounding alone. Finding out what this version of XLA knows takes a second or two: one that it
    does not know would end the process.

    Args:
        quick_compiler: whether to add `QUICK_COMPILER`, for work that compiles longer than it runs.

    Returns:
        For ``XLA_FLAGS``; empty where this version of XLA knows none of them.
    """
    return chosen(known_options(), quick_compiler=quick_compiler)


def chosen(known: str, *, quick_compiler: bool) -> str:
    """Those of some known options that a work wants."""
    return " ".join(option for option in known.split() if quick_compiler or option != QUICK_COMPILER)


def known_options() -> str:
    """All options of this file that suit the processor and are known to this version of XLA."""
    return _known_of((LOOPS, *((WIDE,) if _has_wide_vectors() else ()), QUICK_COMPILER))


@functools.cache
def _known_of(options: tuple[str, ...]) -> str:
    together = " ".join(options)
    return together if is_known(together) else " ".join(option for option in options if is_known(option))


def is_known(options: str) -> bool:
    """Whether the XLA of this environment starts with these options, tried in a process of its own."""
    environment = os.environ | {"XLA_FLAGS": options, "JAX_PLATFORMS": "cpu"}
    tried = [sys.executable, "-c", "import jax; jax.devices()"]
    return not subprocess.run(tried, env=environment, capture_output=True, check=False).returncode


def _has_wide_vectors() -> bool:
    try:
        return "avx512f" in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return False
