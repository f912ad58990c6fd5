"""What the benches share: their options, peers in C, agreement, and times of tasks that take turns."""

import argparse
import ctypes
import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import gearjax as gj

SHORT_FORM = "every comparison, in sizes that take seconds: its times mean nothing"
RUNS, SHORT, LONG = 5, 0.02, 0.2  # runs of a turn; of tasks shorter than [s]; longer ones run once [s]
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fno-finite-math-only", "-shared", "-fPIC")


def sized(parser: argparse.ArgumentParser, **sizes: tuple[float, float]) -> argparse.Namespace:
    """The options given, with one for each size and ``--short``.

    Args:
        parser: with the bench's other options.
        sizes: of each, the usual one and that of the short form, which tests run.
    """
    parser.add_argument("--short", action="store_true", help=SHORT_FORM)
    for name, (usual, short) in sizes.items():
        parser.add_argument(f"--{name}", type=type(usual), help=f"{usual} by default, {short} with --short")
    given = parser.parse_args()
    for name, pair in sizes.items():
        if getattr(given, name) is None:
            setattr(given, name, pair[given.short])
    return given


def agree(words: str, apart: float, most: float, unit: str = "") -> None:
    """One line with a difference and its limit; the bench ends with an error where it is larger, or nan."""
    line = f"{words}: {apart:.1e} {unit}".rstrip() + f" (at most {most:.1g})"
    print(line, flush=True)
    if not apart <= most:
        raise SystemExit(f"the programs differ by more than they may: {line.strip()}")


def by_another_python(python: str, source: str, given: dict[str, Any]) -> Any:
    """Answer of a program in another environment; it reads one JSON file and writes another, its two arguments."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "peer.py").write_text(source, encoding="utf-8")
        (folder / "given.json").write_text(json.dumps(given), encoding="utf-8")
        command = [python, folder / "peer.py", folder / "given.json", folder / "found.json"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return json.loads((folder / "found.json").read_text(encoding="utf-8"))


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


class Constants(ctypes.Structure):
    """What the peers know of the reducer."""

    _fields_ = [(name, ctypes.c_double) for name in ("k", "ka", "kphi", "c", "m", "pull", "w0", "w1", "w2")]

    def array(self) -> np.ndarray:
        """The same as an array."""
        return np.array([getattr(self, name) for name, _ in self._fields_])


def reducer(scene: gj.Scene, torque: float) -> tuple[np.ndarray, Constants]:
    """Gaps of a 2K-V reducer as sines, shape (4, 5), fitted to the scene exactly, and the other numbers."""
    system, speed = scene.system, float(scene.system.input_speed)
    w = [speed * system.orders[name] for name in ("planet", "crank", "mesh")]
    ts = np.linspace(0.0, 20.0, 400)
    gaps = np.asarray(jax.vmap(lambda t: scene.contacts(speed * t).gap)(jnp.asarray(ts)))
    basis = np.stack([np.ones_like(ts), *(f(w[i] * ts) for i in range(2) for f in (np.sin, np.cos))], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, gaps, rcond=None)
    assert np.abs(basis @ fitted - gaps).max() < 1e-15
    k, mass = float(scene.compliance.mean), float(scene.inertia.mass)
    amplitude, phase = (float(x[0]) for x in (scene.compliance.relative_amplitudes, scene.compliance.phases))
    damping = float(scene.damping.ratio) * np.sqrt(2 * k * mass)
    pull = torque / float(system.radius)
    return np.ascontiguousarray(fitted.T), Constants(k, amplitude, phase, damping, mass, pull, *w)


def interleaved(
    tasks: dict[str, Callable[[], Any]], repeats: int, slow: float = np.inf
) -> tuple[dict[str, Any], dict[str, float], dict[str, float]]:
    """Results, first-call times and median times of tasks that take turns, each run once more before it is timed, so
    that it finds its own caches and memory.

    Args:
        tasks: by name.
        repeats: turns of each, with `RUNS` runs where these are short.
        slow: a first call that takes longer [s] has three turns only.
    """
    results, first, times = {}, {}, {name: [] for name in tasks}
    for name, task in tasks.items():
        began = time.perf_counter()
        results[name] = jax.block_until_ready(task())
        first[name] = time.perf_counter() - began

    def timed(task: Callable[[], Any]) -> float:
        began = time.perf_counter()
        jax.block_until_ready(task())
        return time.perf_counter() - began

    for turn in range(repeats):
        for name, task in tasks.items():
            if turn < 3 or first[name] < slow:
                once = timed(task)
                times[name] += [timed(task) for _ in range(RUNS if once < SHORT else 1)] if once < LONG else [once]
    return results, first, {name: float(np.median(values)) for name, values in times.items()}
