"""Tolerance studies of the 2K-V reducer: gearjax against numpy and numba, in one run.

No-load TE and backlash (peak-to-peak, mean, minimum) of reducers with Rayleigh eccentricities and random phases over
one cycle of 1,581 input angles, of the samples alone, as the peers look at them:

- numpy, formulas: the sines of every error, flank and pair as they stand in the formulas, whole arrays at a time;
- numpy, products: the algorithm of gearjax, curves as products of matrices, which numpy hands to a BLAS;
- numba: the same sums of a few tables, written out, ``prange`` over reducers, ``fastmath``;
- gearjax on one device per core, float64 and float32, and with the extremes between the samples.

Then static TE at 30, 100 and 300 N m, dynamic TE of 3 s, and the peak memory of ``gearjax tolerance`` at 10,000 and
1,000,000 reducers. Medians of interleaved repeats, compile time apart. Needs numba.

    python experiments/tolerance_bench.py [--samples 1000000] [--repeats 5]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
import jax.numpy as jnp
import numba
import numpy as np
from peers import agree, sized

import gearjax as gj
from gearjax.timing import Stopwatch
from gearjax.tolerance.monte_carlo import Work

ANGLES = 1581
CONFIG = Path(__file__).parents[1] / "configs" / "two_kv" / "wang_2020_tolerance.toml"
BODIES = ("planet_1", "planet_2", "revolution", "output_wheel")
NAMES = ["no_load.peak_to_peak", "no_load.mean", "backlash.peak_to_peak", "backlash.minimum", "backlash.mean"]
PART = 64  # reducers at once in numpy
HIGHEST = """
import sys
from gearjax.cli import main
try:
    main(sys.argv[1:])
finally:
    print([line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")][0])
"""


def population(dtype=jnp.float64) -> gj.Tolerances:
    """Rayleigh eccentricities and random phases."""
    scene = jax.tree.map(lambda leaf: leaf.astype(dtype), gj.load(CONFIG))
    spreads: dict = {f"errors.{body}.amplitude": gj.Rayleigh(6e-6) for body in BODIES}
    return gj.Tolerances(scene, spreads | {f"errors.{body}.phase": gj.UniformPhase() for body in BODIES})


class Formulas:
    """Gaps of the four contacts by the formulas of the reference (Wang et al. 2020, eqs. 1-9, signs mended)."""

    def __init__(self, scene: gj.Scene, theta: np.ndarray):
        system = scene.system
        self.radius = float(system.radius)
        self.initial = float(scene.backlash.initial)
        orders = system.orders
        self.turns = [orders["planet"] * theta] * 3 + [orders["crank"] * theta]
        self.lines = [-flank * float(system.working_pressure_angle) for flank in (1, -1)]

    def terms(self):
        """For each contact: its sign, and (body, angles over time) of what it sees."""
        for side, line in enumerate(self.lines):
            for pair in (0, 1):
                seen = [(pair, self.turns[0] + line)]
                seen += [(body, self.turns[body] + line - pair * np.pi) for body in (2, 3)]
                yield (-1.0 if side == 0 else 1.0), side, seen

    def numpy(self, rows: np.ndarray) -> np.ndarray:
        """As the formulas stand."""
        found = []
        for sign, side, seen in self.terms():
            gap = np.zeros((len(rows), len(self.turns[0])))
            for body, angle in seen:
                size, phase = rows[:, body, None], rows[:, 4 + body, None]
                gap += sign * size * (np.sin(angle[None] + phase) - np.sin(angle[0] + phase))
            found.append((gap + side * self.initial) / (sign * self.radius))
        return metrics(np.maximum(found[0], found[1]), np.minimum(found[2], found[3]))

    def tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Sines over time, shape (5, n): of both orders, and one; and place of each order."""
        planet, crank = self.turns[0], self.turns[3]
        return np.stack([np.sin(planet), np.cos(planet), np.sin(crank), np.cos(crank), np.ones_like(planet)])

    def weights(self, rows: np.ndarray) -> np.ndarray:
        """Weights of the tables, shape (reducer, contact, 5)."""
        found = np.zeros((len(rows), 4, 5))
        for contact, (sign, side, seen) in enumerate(self.terms()):
            for body, angle in seen:
                first = 2 * (body == 3)
                place = angle[0] - self.turns[body][0] + rows[:, 4 + body]
                size = rows[:, body]
                found[:, contact, first] += sign * size * np.cos(place)
                found[:, contact, first + 1] += sign * size * np.sin(place)
                found[:, contact, 4] -= sign * size * np.sin(angle[0] + rows[:, 4 + body])
            found[:, contact, 4] += side * self.initial
            found[:, contact] /= sign * self.radius
        return found


def metrics(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Measures of whole arrays."""
    play = upper - lower
    columns = [np.ptp(lower, axis=1), lower.mean(axis=1), np.ptp(play, axis=1), play.min(axis=1), play.mean(axis=1)]
    return np.stack(columns, axis=1)


def products(weights: np.ndarray, tables: np.ndarray) -> np.ndarray:
    """Curves as products of matrices."""
    touch = weights.transpose(1, 0, 2) @ tables
    return metrics(np.maximum(touch[0], touch[1]), np.minimum(touch[2], touch[3]))


@numba.njit(parallel=True, fastmath=True, cache=False)
def by_numba(weights, tables, found):
    """The same, written out."""
    number = tables.shape[1]
    for index in numba.prange(weights.shape[0]):
        w = weights[index]
        high, low, total = -1e30, 1e30, 0.0
        wide, narrow, whole = -1e30, 1e30, 0.0
        for t in range(number):
            a, b, c, d = tables[0, t], tables[1, t], tables[2, t], tables[3, t]
            first = w[0, 0] * a + w[0, 1] * b + w[0, 2] * c + w[0, 3] * d + w[0, 4]
            second = w[1, 0] * a + w[1, 1] * b + w[1, 2] * c + w[1, 3] * d + w[1, 4]
            third = w[2, 0] * a + w[2, 1] * b + w[2, 2] * c + w[2, 3] * d + w[2, 4]
            fourth = w[3, 0] * a + w[3, 1] * b + w[3, 2] * c + w[3, 3] * d + w[3, 4]
            lower = max(first, second)
            play = min(third, fourth) - lower
            high, low, total = max(high, lower), min(low, lower), total + lower
            wide, narrow, whole = max(wide, play), min(narrow, play), whole + play
        found[index, 0], found[index, 1] = high - low, total / number
        found[index, 2], found[index, 3], found[index, 4] = wide - narrow, narrow, whole / number


def timed(function) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def quasi_static(samples: int, repeats: int) -> None:
    """The comparison; peers that are slower get fewer reducers."""
    tolerances = population()
    theta = np.linspace(0.0, tolerances.scene.system.cycle, ANGLES)
    formulas = Formulas(tolerances.scene, theta)
    works = {
        "gearjax, float64": Work(tolerances, NAMES, number=samples, theta=theta, extremes="samples"),
        "gearjax, float32": Work(population(jnp.float32), NAMES, number=samples, theta=theta, extremes="samples"),
        "gearjax, extremes between": Work(tolerances, NAMES, number=samples // 8, theta=theta),
    }
    few = max(PART, samples // 100)
    rows = works["gearjax, float64"].inputs(0, few)
    tables, weights = formulas.tables(), formulas.weights(rows)
    many = np.ascontiguousarray(np.tile(weights, (10, 1, 1)))
    found = np.empty((len(many), len(NAMES)))

    def all_of(work: Work) -> None:
        for _ in work.each(work.chunks):
            pass

    def in_parts(function, *arrays) -> None:
        for begin in range(0, few, PART):
            function(*(array[begin : begin + PART] for array in arrays))

    runs = {
        "numpy, formulas": (few, lambda: in_parts(formulas.numpy, rows)),
        "numpy, products": (few, lambda: in_parts(lambda part: products(part, tables), weights)),
        "numba, two threads": (len(many), lambda: by_numba(many, tables, found)),
    } | {name: (work.number, lambda work=work: all_of(work)) for name, work in works.items()}
    first = {}
    for name, (_, run) in runs.items():
        with Stopwatch() as watch:
            run()
        first[name] = watch.compile_seconds
    ours = works["gearjax, float64"].evaluate(rows)[0]
    for name, theirs in (("numpy", formulas.numpy(rows[:PART])), ("numba", found[:few])):
        apart = np.abs(theirs - ours[: len(theirs)]).max() / gj.units.arcmin
        agree(f"{name}: largest difference from gearjax", apart, 1e-12, "arcmin")
    rates = {name: [] for name in runs}
    for _ in range(repeats):
        for name, (number, run) in runs.items():
            rates[name].append(number / timed(run))
    base = np.median(rates["gearjax, float64"])
    print(f"{'':28}{'samples/s':>12}{'ns/angle':>10}{'gearjax is':>14}{'compile [s]':>13}")
    for name, values in rates.items():
        rate = np.median(values)
        print(f"{name:28}{rate:12.0f}{1e9 / rate / ANGLES:10.2f}{base / rate:12.2f} x{first[name]:13.1f}", flush=True)


def others(repeats: int, share: float) -> None:
    """Static and dynamic TE, of a share of the usual numbers of reducers."""
    tolerances = population()
    system = tolerances.scene.system
    theta = np.linspace(0.0, system.cycle, ANGLES)
    static = [f"static.peak_to_peak@{torque}Nm" for torque in (30, 100, 300)]
    motion = float(system.input_speed) * np.linspace(0.0, 3.0, 3001)
    cases = (
        ("static, 3 torques, samples", static, 100_000, {"theta": theta, "extremes": "samples"}),
        ("static, 3 torques, between", static, 20_000, {"theta": theta}),
        ("dynamic, 3 s, 100 N m", ["dynamic.peak_to_peak@100Nm"], 1000, {"theta": motion}),
    )
    for name, measures, usual, options in cases:
        number = max(PART, round(share * usual))
        studies = [gj.monte_carlo(tolerances, measures, n=number, **options) for _ in range(min(repeats, 3))]
        seconds = np.median([study.seconds for study in studies])
        words = f"{number / seconds:.0f} samples/s, {len(studies[0].failed)} failed {studies[0].faults or ''}"
        print(
            f"{name}: {number} in {seconds:.2f} s, compiled in {studies[0].compile_seconds:.1f} s, {words}", flush=True
        )


def memory(most: int) -> None:
    """Peak memory of the command."""
    text = CONFIG.read_text(encoding="utf-8")
    text = text[: text.index("[tolerance.sensitivity]")].replace("# extremes", "extremes")
    peaks = {}
    for number in (most // 100, most):
        with tempfile.TemporaryDirectory() as folder:
            config = Path(folder) / "study.toml"
            config.write_text(text.replace("samples = 20000", f"samples = {number}\nchunk = 8192"))
            line = [sys.executable, "-c", HIGHEST, "tolerance", str(config), "--out", folder]
            ended = subprocess.run(line, capture_output=True, text=True, check=True)
            peaks[number] = int(ended.stdout.split()[-1]) / 1024
    few, many = peaks.values()
    print(f"peak memory of the command: {few:.0f} MiB, {many:.0f} MiB with {most} samples: {many / few:.2f} times")


def main() -> None:
    parser = argparse.ArgumentParser(description="tolerance studies: ratios to other programs")
    given = sized(parser, samples=(1_000_000, 2000), repeats=(5, 1))
    print(f"{given.samples} reducers x {ANGLES} angles, {len(jax.devices())} devices, medians of {given.repeats}")
    quasi_static(given.samples, given.repeats)
    others(given.repeats, given.samples / 1_000_000)
    if not given.short:  # no other program has a command
        memory(given.samples)


if __name__ == "__main__":
    main()
