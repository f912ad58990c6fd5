"""Options of XLA for gearjax on CPUs. XLA reads them from the variable ``XLA_FLAGS`` when JAX starts.

The full vector width of processors with AVX-512 (``xla_cpu_prefer_vector_width=512``) is none of them: it makes batches
up to a fifth faster, but jax 0.10 and 0.11 then compile the arctangent wrongly (`compiles_correctly` shows it).
"""

import functools
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000"
"""Compiles a loop to one kernel; without it XLA calls several kernels for each step of the loop."""
QUICK_COMPILER = "--xla_cpu_use_fusion_emitters=false"
"""Uses the older kernel compiler: compiling takes half the time, and the compiled program 1 to 1.4 times as long."""


def xla_options(*, quick_compiler: bool = False) -> str:
    """Options that make gearjax faster on CPUs: `LOOPS`, if this version of XLA knows it.

    The command ``gearjax`` sets them itself, unless ``XLA_FLAGS`` is set. In Python, set them before any computation:

        import os
        import gearjax as gj
        os.environ["XLA_FLAGS"] = gj.xla_options()

    They change results by rounding only. An option that XLA does not know would end the process, and one that makes it
    compile elementary functions wrongly would change results; therefore the options are tried first, which takes two
    or three seconds.

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
    """All options of this file that this version of XLA knows and compiles correctly with."""
    return _known_of((LOOPS, QUICK_COMPILER))


@functools.cache
def _known_of(options: tuple[str, ...]) -> str:
    together = " ".join(options)
    if is_usable(together):
        return together
    with ThreadPoolExecutor() as pool:  # each trial is a process, so they run at the same time
        return " ".join(option for option, usable in zip(options, pool.map(is_usable, options), strict=True) if usable)


def is_usable(options: str) -> bool:
    """Whether the XLA of this environment knows these options and compiles correctly with them.

    This is tried in a separate process, which an unknown option ends.
    """
    environment = os.environ | {"XLA_FLAGS": options, "JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": "1"}
    trial = f"import runpy, sys; sys.exit(not runpy.run_path({__file__!r})['compiles_correctly']())"
    ended = subprocess.run([sys.executable, "-c", trial], env=environment, capture_output=True, check=False)
    return ended.returncode == 0


def compiles_correctly() -> bool:
    """Whether compiled elementary functions of many numbers agree with those of numpy, in both precisions."""
    import jax  # here, so that finding out what is known does not start JAX in this process
    import jax.numpy as jnp
    import numpy as np

    names = ("sin", "cos", "tan", "arctan", "exp", "expm1", "log1p", "tanh", "sqrt", "square", "floor")
    for dtype, close in ((np.float64, 1e-12), (np.float32, 1e-5)):
        places = np.linspace(0.01, 1.4, 1001, dtype=dtype)
        wanted = [getattr(np, name)(places) for name in names] + [np.arctan2(places, places[::-1])]
        found = jax.jit(lambda x: [getattr(jnp, name)(x) for name in names] + [jnp.arctan2(x, x[::-1])])(places)
        if not all(np.allclose(one, other, rtol=close, atol=close) for one, other in zip(found, wanted, strict=True)):
            return False
    return True
