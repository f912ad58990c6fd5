"""What the benches share: peers in C, and times of tasks that take turns."""

import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fno-finite-math-only", "-shared", "-fPIC")


def compiled_c(source: str, *flags: str) -> ctypes.CDLL:
    """A library of C, compiled by gcc."""
    folder = Path(tempfile.mkdtemp())
    (folder / "peer.c").write_text(source, encoding="utf-8")
    command = ["gcc", *FLAGS, *flags, "-o", folder / "peer.so", folder / "peer.c", "-lm", "-lpthread"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(folder / "peer.so"))


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """The numbers of an array, for C."""
    return array.ctypes.data_as(ctypes.c_void_p)


def interleaved(
    tasks: dict[str, Callable[[], Any]], repeats: int, slow: float = np.inf
) -> tuple[dict[str, Any], dict[str, float], dict[str, float]]:
    """Results, first-call times and median times of tasks that take turns.

    Args:
        tasks: by name.
        repeats: turns of each.
        slow: a first call that takes longer [s] has three turns only.
    """
    results, first, times = {}, {}, {name: [] for name in tasks}
    for name, task in tasks.items():
        began = time.perf_counter()
        results[name] = jax.block_until_ready(task())
        first[name] = time.perf_counter() - began
    for turn in range(repeats):
        for name, task in tasks.items():
            if turn < 3 or first[name] < slow:
                began = time.perf_counter()
                jax.block_until_ready(task())
                times[name].append(time.perf_counter() - began)
    return results, first, {name: float(np.median(values)) for name, values in times.items()}
