"""Identification from recordings of gear sets that are known: how often the truth is found, and how long it takes.

    python experiments/identification_bench.py [--units 200] [--stages 100] [--rigs 50]
        [--reassembled 40] [--seed 1000]

The gear sets are written out apart from gearjax (`tests/bench_units.py`): an algebraic 2K-V reducer, recordings of
10,000 rows, 0.05 arcmin of noise, encoders of 20 bits, whose zero drifts by 0.02 arcmin between runs; and a pin stage
by exact curves, three such recordings of 3,335 rows.
"""

import argparse
import dataclasses
import sys
import time
import warnings
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from peers import agree, sized
from scipy import optimize

import gearjax as gj
from gearjax.units import arcmin, um
from tests.bench_units import (
    PinStageUnit,
    TwoKVUnit,
    estimates,
    pin_stage,
    pin_stage_runs,
    random_unit,
    recorded,
    truth,
    two_kv,
)

DRIFT = 0.02 * arcmin
TORQUES = 10.0, 150.0, -40.0
PER_TURN = 145  # rows per turn of the crank of a pin stage
TOLERANCE = 9.9 * um  # of amplitudes of 4 to 22 um and any phase


def drifting_runs(unit: TwoKVUnit, seed: int, **options) -> list[gj.Measurement]:
    """Recordings between which the encoders' zero drifts."""
    offsets = DRIFT * np.random.default_rng(seed).standard_normal(len(TORQUES))
    pairs = enumerate(zip(TORQUES, offsets, strict=True))
    return [recorded(unit, torque, 100 * seed + i, offset=offset, **options) for i, (torque, offset) in pairs]


def told(name: str, scores: np.ndarray) -> None:
    """Share of units and of numbers that lie within their errors."""
    whole, single, cover = (scores.max(axis=1) < 3).mean(), (scores < 3).mean(), (scores < 1.96).mean()
    print(f"{name}: all numbers within 3 standard errors in {100 * whole:.1f} % of the units,")
    print(f"  single numbers in {100 * single:.2f} %, intervals of 95 % cover {100 * cover:.1f} %", flush=True)
    agree("  share of numbers that differ from the truth by more than 3 standard errors", 1 - single, 0.05)


def two_kv_units(number: int, seed: int) -> None:
    """Random 2K-V reducers."""
    scene, scores, seconds, false = two_kv(), [], [], 0
    for k in range(seed, seed + number):
        unit = random_unit(k)
        records = drifting_runs(unit, k)
        begin = time.perf_counter()
        found = gj.identify(scene, records, suggest=False)
        seconds.append(time.perf_counter() - begin)
        false += len(found.orders)
        values, errors = estimates(found)
        each = [np.abs(values - one) / errors for one in truth(unit)]
        scores.append(min(each, key=np.max))
    told(f"{number} 2K-V units, modulo names", np.array(scores))
    print(f"  orders named that are not there: {false}; {np.median(seconds):.2f} s each, the first {seconds[0]:.1f} s")


def missing_orders(number: int, seed: int) -> None:
    """Rigs with an order of their own."""
    scene, first, scores, more = two_kv(), 0, [], 0
    for k in range(seed, seed + number):
        rng = np.random.default_rng(k)
        order, size, phase = rng.integers(1, 40), rng.uniform(0.02, 0.3) * arcmin, rng.uniform(0, 2 * np.pi)
        unit = random_unit(k)

        def extra(theta: np.ndarray, n=order, a=size, p=phase) -> np.ndarray:
            return a * np.cos(n * theta / 79 + p)

        found = gj.identify(scene, drifting_runs(unit, k, extra=extra), suggest=False)
        first += bool(found.orders) and abs(found.orders[0].order * 79 - order) < 0.3
        more += max(len(found.orders) - 1, 0)
        values, errors = estimates(found)
        scores.append(min((np.abs(values - one) / errors for one in truth(unit)), key=np.max))
    print(f"{number} rigs with an order of their own: named first {first} times, {more} named beside it")
    told("  the gear sets' numbers then", np.array(scores))


def pin_stages(number: int, seed: int) -> None:
    """Random pin stages by exact curves."""
    scene, scores, seconds = pin_stage(), [], []
    for k in range(seed, seed + number):
        rng = np.random.default_rng(k)
        larger = 0.3 * um * rng.standard_normal(24)
        larger[rng.choice(24, 2, replace=False)] += rng.uniform(1, 4, 2) * um * rng.choice([-1, 1], 2)
        unit = PinStageUnit(larger, rng.uniform(1, 5) * um * np.exp(2j * np.pi * rng.random()), rng.uniform(1e8, 1.6e8))
        records = pin_stage_runs(unit, k, drift=DRIFT, noise=0.05 * arcmin, per_turn=PER_TURN, counts=2**20)
        begin = time.perf_counter()
        found = gj.identify(scene, records, starts=1, suggest=False)
        seconds.append(time.perf_counter() - begin)
        own = found.estimates[:27]
        values, errors = np.array([each.value for each in own]), np.array([each.error for each in own])
        true = np.concatenate([larger / um, [unit.run_out.real / um, unit.run_out.imag / um, unit.stiffness]])
        scores.append(np.abs(values - true) / errors)
    scores = np.array(scores)
    told(f"{number} pin stages, exact", scores)
    cover = [100 * (part < 1.96).mean() for part in (scores[:, :24], scores[:, 24:26], scores[:, 26])]
    print("  intervals cover: pins {:.1f} %, run-out {:.1f} %, stiffness {:.1f} %".format(*cover))
    print(f"  {np.median(seconds):.1f} s each, the first {seconds[0]:.1f} s")


def reassembled(number: int, seed: int) -> None:
    """What advice delivers on the unit itself, from three recordings and from a fourth after turning a planet wheel.

    The tolerances of the errors are known, as priors: standard deviations of the components of such units.
    """
    bodies = "planet_1", "planet_2", "revolution", "output_wheel"
    priors = {f"errors.{body}": TOLERANCE for body in bodies}
    scene, paths = two_kv(), ["errors.planet_1", "errors.planet_2"]
    theta = np.linspace(0.0, scene.system.cycle, 4000, endpoint=False)
    rows: dict[str, list[tuple[float, bool]]] = {"three recordings": [], "four": []}
    for k in range(seed, seed + number):
        unit = random_unit(k)
        records = drifting_runs(unit, k, rows=3334)
        turned = dataclasses.replace(unit, planet_1=unit.planet_1 * 1j)
        more = recorded(turned, 150.0, 7 * k, rows=3334)
        more = dataclasses.replace(more, turned={paths[0]: np.pi / 2}, name="turned")
        for name, own in zip(rows, (records, [*records, more]), strict=True):
            advice = gj.reassemble(gj.identify(scene, own, priors=priors, suggest=False), paths)
            turns = [np.exp(1j * advice.turns[path]) for path in paths]
            moved = dataclasses.replace(unit, planet_1=unit.planet_1 * turns[0], planet_2=unit.planet_2 * turns[1])
            gain = moved.te(theta, 0.0).std() / unit.te(theta, 0.0).std()
            rows[name].append((gain, advice.gain.low - 1e-3 <= gain <= advice.gain.high + 1e-3))
    for name, told in rows.items():
        gains, within = np.array(told).T
        words = f"after over before {np.median(gains):.2f} (median), worse in {100 * (gains > 1).mean():.0f} %"
        print(f"{number} units reassembled from {name}: {words},")
        print(f"  within the promised 5 to 95 % in {100 * within.mean():.0f} %", flush=True)


def speed(starts: int) -> None:
    """64 starts against scipy's least squares on a numpy model, all rows, from the same kind of starts."""
    scene, unit = two_kv(), random_unit(7)
    cases = (3334, "10,000 rows in three recordings"), (10_000, "30,000 rows")
    for rows, words in cases[: 2 if starts > 1 else 1]:
        records = drifting_runs(unit, 7, rows=rows)
        gj.identify(scene, records, suggest=False, orders=[])
        ours = []
        for _ in range(5):
            begin = time.perf_counter()
            gj.identify(scene, records, suggest=False, orders=[])
            ours.append(time.perf_counter() - begin)
        measured = np.concatenate([record.error(scene) for record in records]) / arcmin

        def residual(x: np.ndarray, records=records, measured=measured) -> np.ndarray:
            parts = x[:6] * um
            own = TwoKVUnit(
                parts[0] + 1j * parts[1], parts[2] + 1j * parts[3], 0, parts[4] + 1j * parts[5], 1e8 / x[6], x[7] * um
            )
            curves = [own.te(record.theta, float(record.loads[0])) / arcmin for record in records]
            return np.concatenate(curves) + x[8] - measured

        rng, begin = np.random.default_rng(0), time.perf_counter()
        for k in range(starts):
            size = 15.0 if k % 2 else 0.7
            start = np.concatenate([size * rng.standard_normal(6), [1.0, 150.0, 0.0]])
            optimize.least_squares(residual, start, method="lm")
        scipys = (time.perf_counter() - begin) * 64 / starts
        ratio = scipys / np.median(ours)
        print(f"{words}, 64 starts: {np.median(ours):.3f} s; scipy's lm {scipys:.1f} s, {ratio:.0f} times", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    sizes = {"units": (200, 1), "stages": (100, 0), "rigs": (50, 1), "reassembled": (40, 1)}
    asked = sized(parser, starts=(16, 1), seed=(1000, 1000), **sizes)
    warnings.simplefilter("ignore")
    speed(asked.starts)
    if asked.units:
        two_kv_units(asked.units, asked.seed)
    if asked.rigs:
        missing_orders(asked.rigs, asked.seed)
    if asked.reassembled:
        reassembled(asked.reassembled, asked.seed)
    if asked.stages:
        pin_stages(asked.stages, asked.seed)


if __name__ == "__main__":
    main()
