"""Loaded TE of many RV reducers: gearjax against scipy and numba, in one run; and linear against exact gaps.

Reducers with 40 pins and two discs, every pin displaced by itself, run-out of both discs, error of the throw;
peak-to-peak and mean of the static TE under 784 N m over 320 crank angles of one turn.

- scipy: ``brentq`` on the sum of the contacts' moments, one angle after the other, gaps by numpy; of a few reducers;
- numba: the algorithm of gearjax written out for these errors, ``prange`` over reducers, ``fastmath``;
- gearjax on one device per core.

All three agree before they are timed. Medians of interleaved repeats, compile time apart. Needs numba.

    python experiments/rv_cycloidal_bench.py [--samples 100000] [--repeats 3] [--turns 39] [--short]

As installed, and with the options that the command sets itself:

    XLA_FLAGS="$(python -c 'import gearjax; print(gearjax.xla_options())')" python experiments/rv_cycloidal_bench.py
"""

import argparse
import dataclasses
import os
import time

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
import jax.numpy as jnp
import numba
import numpy as np
from peers import agree, sized
from scipy import optimize

import gearjax as gj
from gearjax.timing import Stopwatch
from gearjax.tolerance.monte_carlo import Work
from gearjax.units import arcmin, um

CONFIG = "configs/rv_cycloidal/hu_2020.toml"
TORQUE, STIFFNESS, ANGLES, PINS = 784.0, 1.6465e8, 320, 40
NAMES = [f"static.peak_to_peak@{TORQUE:g}Nm", f"static.mean@{TORQUE:g}Nm"]


def population() -> gj.Tolerances:
    """Displaced pins, run-out of both discs, throw."""
    scene, none = gj.load(CONFIG), [0.0] * PINS
    errors = {key: scene.errors[key] for key in ("throw", "disc_1", "disc_2")}
    scene = dataclasses.replace(scene, errors={"pins": gj.Positions("pin_ring", none, none), **errors})
    spreads: dict = {
        f"errors.pins.{way}[{i}]": gj.Normal(0.0, 2 * um) for way in ("outward", "around") for i in range(PINS)
    }
    spreads["errors.throw.amplitude"] = gj.Uniform(0.0, 2.5 * um)
    for disc in (1, 2):
        spreads[f"errors.disc_{disc}.amplitude"] = gj.Rayleigh(2 * um)
        spreads[f"errors.disc_{disc}.phase"] = gj.UniformPhase()
    return gj.Tolerances(scene, spreads)


def shared(theta: np.ndarray) -> dict[str, np.ndarray]:
    """What the formulas of the reference need of each contact and angle, shape (angle, contact)."""
    circle, throw, rolling = 76e-3, 1.5e-3, 58.5e-3
    short = throw * PINS / circle
    crank = theta[:, None] + np.repeat([0.0, np.pi], PINS)[None]
    u = crank - np.tile(2 * np.pi * np.arange(PINS) / PINS, 2)[None]
    root = np.sqrt(1 + short**2 - 2 * short * np.cos(u))
    lever, outward, along = np.sin(u) / root, (1 - short * np.cos(u)) / root, (short - np.cos(u)) / root
    turn = crank + crank / (PINS - 1)
    return {
        "arm": rolling * lever,
        "base": -22e-6 + 43.7e-6 * outward,
        "outward": outward,
        "around": -short * lever,
        "along": along,
        "sine": along * np.cos(turn) - lever * np.sin(turn),
        "cosine": along * np.sin(turn) + lever * np.cos(turn),
    }


@numba.njit(parallel=True, fastmath=True)
def by_numba(rows, load, arm, base, outward, around, along, sine, cosine):
    angles, contacts = arm.shape
    found = np.empty((len(rows), 2))
    for n in numba.prange(len(rows)):
        row, gap = rows[n], np.empty(contacts)
        waves = np.empty((2, 2))
        for disc in range(2):
            waves[disc, 0] = row[81 + 2 * disc] * np.cos(row[82 + 2 * disc])
            waves[disc, 1] = row[81 + 2 * disc] * np.sin(row[82 + 2 * disc])
        low, high, total, position = 1e9, -1e9, 0.0, 0.0
        for a in range(angles):
            for disc in range(2):
                for pin in range(40):
                    c = 40 * disc + pin
                    gap[c] = (
                        base[a, c]
                        + row[pin] * outward[a, c]
                        + row[40 + pin] * around[a, c]
                        + row[80] * along[a, c]
                        + waves[disc, 0] * sine[a, c]
                        + waves[disc, 1] * cosine[a, c]
                    )
            if a == 0:
                pull, slope = 0.0, 0.0
                for c in range(contacts):
                    if arm[a, c] < 0:
                        pull += arm[a, c] * gap[c]
                        slope += arm[a, c] * arm[a, c]
                position = (load + pull) / slope
            for _ in range(60):
                moment, slope = -load, 0.0
                for c in range(contacts):
                    overlap = arm[a, c] * position - gap[c]
                    closed = 1.0 if overlap > 0 else 0.0
                    moment += closed * arm[a, c] * overlap
                    slope += closed * arm[a, c] * arm[a, c]
                move = moment / slope
                position -= move
                if abs(move) <= 1e-12 * abs(position):
                    break
            low, high, total = min(low, position), max(high, position), total + position
        found[n, 0], found[n, 1] = high - low, total / angles
    return found


def by_scipy(rows: np.ndarray, tables: dict[str, np.ndarray]) -> np.ndarray:
    """One root after the other."""
    found = []
    for row in rows:
        waves = row[81::2] * np.exp(1j * row[82::2])
        each = np.repeat(waves, PINS)
        gap = tables["base"] + np.tile(row[:40], 2) * tables["outward"] + np.tile(row[40:80], 2) * tables["around"]
        gap = gap + row[80] * tables["along"] + each.real * tables["sine"] + each.imag * tables["cosine"]

        def moment(position: float, arm: np.ndarray, gap: np.ndarray) -> float:
            return TORQUE + STIFFNESS * (arm * np.maximum(arm * position - gap, 0.0)).sum()

        places = [
            optimize.brentq(moment, -0.01, 0.01, args=pair, xtol=1e-16) for pair in zip(tables["arm"], gap, strict=True)
        ]
        found.append([np.ptp(places), np.mean(places)])
    return np.array(found)


def timed(program) -> tuple[float, np.ndarray]:
    begun = time.perf_counter()
    found = program()
    return time.perf_counter() - begun, found


def compare(samples: int, repeats: int) -> None:
    theta = np.arange(ANGLES) * (2 * np.pi / ANGLES)
    people = population()
    work = Work(people, NAMES, number=samples, theta=theta, extremes="samples", chunk=min(samples, 16384))
    rows, tables = work.inputs(0, samples), shared(theta)
    arrays = [np.ascontiguousarray(table) for table in tables.values()]
    by_numba(rows[:4], -TORQUE / STIFFNESS, *arrays)
    with Stopwatch() as watch:
        work.evaluate(rows[: work.chunk])
    few = rows[: max(4, samples // 10000)]
    expected = by_scipy(few, tables)
    for name, values in (
        ("numba", by_numba(few, -TORQUE / STIFFNESS, *arrays)),
        ("gearjax", work.evaluate(few)[0]),
    ):
        agree(f"{name}: largest difference from scipy", np.abs(values - expected).max() / arcmin, 1e-12, "arcmin")
    programs = {
        "scipy brentq": (lambda: by_scipy(few, tables), len(few)),
        "numba, parallel": (lambda: by_numba(rows, -TORQUE / STIFFNESS, *arrays), samples),
        "gearjax": (lambda: work.evaluate(rows)[0], samples),
    }
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, (program, number) in programs.items():
            seconds[name].append(timed(program)[0] / number)
    own = np.median(seconds["gearjax"])
    print(f"{samples} reducers x {ANGLES} angles, two discs; compile {watch.compile_seconds:.1f} s apart")
    for name, values in seconds.items():
        each = np.median(values)
        print(f"{name:18s} {1 / each:12.0f} reducers/s, time over gearjax' {each / own:8.2f}")


def gaps(repeats: int, turns: int) -> None:
    """Static TE over turns of the crank with gaps of first order, and by the foot of the normal."""
    theta = jnp.asarray(np.arange(ANGLES * turns) * (2 * np.pi / ANGLES))
    scene = gj.load(CONFIG)
    found = {}
    for clearance in ("linear", "exact"):
        own = dataclasses.replace(scene, system=dataclasses.replace(scene.system, clearance=clearance))
        program = jax.jit(lambda theta, own=own: gj.transmission_error(own, theta, TORQUE, extremes="samples"))
        with Stopwatch() as watch:
            te = jax.block_until_ready(program(theta))
        taken = [timed(lambda program=program: jax.block_until_ready(program(theta)))[0] for _ in range(repeats)]
        found[clearance] = te
        print(f"{clearance}: {np.median(taken):.3f} s for {len(theta)} angles, compile {watch.compile_seconds:.1f} s")
    apart = float(jnp.abs(found["linear"].te - found["exact"].te).max()) / arcmin
    swings = [float(jnp.ptp(te.te)) / arcmin for te in found.values()]
    print(f"largest difference {apart:.5f} arcmin; peak-to-peak {swings[0]:.5f} and {swings[1]:.5f} arcmin")


if __name__ == "__main__":
    given = sized(argparse.ArgumentParser(), samples=(100_000, 1000), repeats=(3, 1), turns=(39, 1))
    compare(given.samples, given.repeats)
    gaps(given.repeats, given.turns)
