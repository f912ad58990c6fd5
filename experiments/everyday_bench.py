"""What a user waits for: every command on every shipped configuration, imports, and first gradients.

    python experiments/everyday_bench.py [--before FOLDER] [--only WORD] [--runs 1]

Each command is a process of its own. It runs with an empty cache of compiled programs (cold), then again with the
cache that it has left (warm). FOLDER is a checkout of another version, whose commands take turns with ours; its own
copies of the configurations are used.
"""

import argparse
import dataclasses
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.test_spectra import COMMANDS

START = "import sys; from gearjax.cli import main; sys.exit(main(sys.argv[1:]))"
STATIC = "lambda phase: gj.transmission_error(with_phase(phase), theta, 100.0).te.std()"
MOTION = "lambda phase: gj.simulate(with_phase(phase), times, 100.0).te.std()"
GRADIENT = """
import dataclasses, time
begin = time.perf_counter()
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import gearjax as gj
scene = gj.load("configs/two_kv/wang_2020.toml")
body = scene.errors["planet_1"]
theta = jnp.linspace(0.0, 6.0, 1001)
times = jnp.linspace(0.0, 0.2, 401)
def with_phase(phase):
    return dataclasses.replace(scene, errors=dict(scene.errors) | {"planet_1": dataclasses.replace(body, phase=phase)})
slope = jax.jit(jax.grad(FUNCTION))
for _ in range(2):
    slope(jnp.asarray(0.3)).block_until_ready()
    print(time.perf_counter() - begin, flush=True)
    begin = time.perf_counter()
"""


@dataclasses.dataclass(frozen=True)
class Took:
    """One process: times to its first line and to its end, processor time [s], largest memory [GiB], and its lines."""

    first: float
    whole: float
    processor: float
    memory: float
    lines: list[str]


def run(folder: Path, cache: Path, words: list[str]) -> Took:
    """Run a process with the package of a checkout."""
    given = {"PYTHONPATH": str(folder), "XDG_CACHE_HOME": str(cache), "PYTHONUNBUFFERED": "1", "MPLBACKEND": "agg"}
    begin, lines, first = time.perf_counter(), [], 0.0
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    process = subprocess.Popen([sys.executable, *words], cwd=folder, env=os.environ | given, **both)
    assert process.stdout is not None
    for line in process.stdout:
        first = first or time.perf_counter() - begin
        lines.append(line)
    _, status, used = os.wait4(process.pid, 0)
    whole = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(words[1:])[:300]} in {folder}: {''.join(lines[-5:])}")
    return Took(first or whole, whole, used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20, lines)


def command(folder: Path, word: str, name: str) -> dict[str, Took]:
    """A command with an empty cache, and with a full one."""
    with tempfile.TemporaryDirectory() as place:
        cache = Path(place) / "cache"
        return {
            turn: run(folder, cache, ["-c", START, word, f"configs/{name}", "--out", f"{place}/{turn}"])
            for turn in ("cold", "warm")
        }


def commands(folders: dict[str, Path], only: str) -> None:
    """A line for each command and version."""
    print("| command | version | first line [s] | cold [s] | its processor time | warm [s] | memory [GiB] |")
    print("|---|---|---|---|---|---|---|")
    trades = [("tradeoff", name) for word, name in COMMANDS if word == "run"]
    for word, name in [*COMMANDS, *trades]:
        if only not in f"{word} {name}":
            continue
        for version, folder in folders.items():
            if not (folder / "configs" / name).exists():
                continue
            try:
                cold, warm = command(folder, word, name).values()
            except SystemExit as fault:  # tradeoff refuses scenes of coupled springs and trains
                print(f"| {word} {name} | {version} | {str(fault).splitlines()[-1]} | | | | |", flush=True)
                continue
            cells = [f"{cold.first:.1f}", f"{cold.whole:.1f}", f"{cold.processor:.1f}", f"{warm.whole:.1f}"]
            print(f"| {word} {name} | {version} | {' | '.join(cells)} | {cold.memory:.2f} |", flush=True)


def imports(folders: dict[str, Path], runs: int) -> None:
    """Import of the package beyond that of jax, and of what most notebooks begin with."""
    what = {"import jax": "import jax", "import gearjax": "import jax, gearjax"}
    what["gj.load"] = "import gearjax as gj; gj.load('configs/two_kv/wang_2020.toml')"
    with tempfile.TemporaryDirectory() as place:
        for version, folder in folders.items():
            for name, source in what.items():
                took = [run(folder, Path(place), ["-c", source]).whole for _ in range(2 * runs + 1)]
                print(f"{name}, {version}: {statistics.median(took):.2f} s", flush=True)


def gradients(folders: dict[str, Path]) -> None:
    """First and second gradient by a phase in a fresh process, without a cache."""
    for name, function in (("static TE", STATIC), ("motion", MOTION)):
        for version, folder in folders.items():
            with tempfile.TemporaryDirectory() as place:
                source = GRADIENT.replace("FUNCTION", function)
                first, second = map(float, run(folder, Path(place), ["-c", source]).lines)
                print(f"gradient of {name}, {version}: first {first:.1f} s, second {second:.4f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, help="checkout of another version")
    parser.add_argument("--only", default="", help="part of a command and configuration, such as 'run two_kv'")
    parser.add_argument("--runs", type=int, default=1, help="imports are repeated 2 RUNS + 1 times")
    asked = parser.parse_args()
    folders = {"now": ROOT} | ({"before": asked.before.resolve()} if asked.before else {})
    imports(folders, asked.runs)
    gradients(folders)
    commands(folders, asked.only)


if __name__ == "__main__":
    main()
