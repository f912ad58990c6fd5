"""Batches of dynamic solves on an accelerator, against the same program on the CPU beside it, in one run.

1,000 to 1,000,000 reducers that differ in their assembly phases, 1,200 steps each, float32 and float64: steps of all
scenes a second, and the share of the chip's arithmetic peak where that is given, from the operations written in a step.
Names the devices. Without an accelerator the rows are those of the CPU alone.

    python experiments/dynamics_device_bench.py [--most 1000000] [--repeats 5] [--peak 67e12] [--peak64 34e12]
"""

import argparse
import functools
from collections.abc import Iterator

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from dynamics_batch_bench import BODIES, STEPS, by_gearjax
from jax.extend.core import Jaxpr, JaxprEqn
from peers import interleaved

ABREAST = {"cpu": 1024}  # scenes at a time; elsewhere as many as below
MANY = 131_072
ENOUGH = 10_000  # scenes on a CPU, whose time for each does not change beyond
ARITHMETIC = ("add", "sub", "mul", "div", "neg", "max", "min", "clamp", "select_n", "gt", "lt", "or", "and", "exp")


def scans(program: Jaxpr) -> Iterator[JaxprEqn]:
    """All scans of a program, inner ones after the outer ones that hold them."""
    for equation in program.eqns:
        if equation.primitive.name == "scan":
            yield equation
        for value in jax.tree.leaves(equation.params, is_leaf=lambda leaf: hasattr(leaf, "eqns")):
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                yield from scans(inner)


def operations(dtype: str) -> float:
    """Operations of one scene and step, as written in the innermost loop of a batch."""
    lanes = 64
    program = jax.make_jaxpr(functools.partial(by_gearjax, chunk=lanes))(jnp.zeros((lanes, len(BODIES)), dtype))
    *_, step = scans(program.jaxpr)
    counted = (e for e in step.params["jaxpr"].jaxpr.eqns if e.primitive.name in ARITHMETIC)
    return sum(int(np.prod(e.outvars[0].aval.shape)) for e in counted) / lanes


def main() -> None:
    parser = argparse.ArgumentParser(description="batches of dynamic solves on an accelerator")
    parser.add_argument("--most", type=int, default=1_000_000, help="scenes of the largest batch")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--peak", type=float, help="operations a second of the chip in float32")
    parser.add_argument("--peak64", type=float, help="the same in float64")
    given = parser.parse_args()
    devices = {device.platform: device for device in (jax.devices("cpu")[0], jax.devices()[0])}
    phases = np.random.default_rng(0).uniform(-np.pi, np.pi, (given.most, len(BODIES)))
    for dtype, peak in (("float32", given.peak), ("float64", given.peak64)):
        work = operations(dtype)
        tasks, counts = {}, {}
        for platform, device in devices.items():
            most = given.most if platform != "cpu" else min(given.most, ENOUGH)
            for number in sorted({min(most, 10**power) for power in (3, 4, 5, 6)}):
                chunk = min(number, ABREAST.get(platform, MANY))
                batch = jax.device_put(jnp.asarray(phases[:number], dtype), device)
                name = f"{device.device_kind}, {number:,} scenes"
                tasks[name] = functools.partial(jax.jit(functools.partial(by_gearjax, chunk=chunk)), batch)
                counts[name] = number
        results, first, medians = interleaved(tasks, given.repeats, slow=30.0)
        fewest = min(map(len, results.values()))
        truth = np.asarray(next(iter(results.values())))[:fewest]
        print(f"{dtype}: {STEPS} steps, {work:.0f} operations each, median of {given.repeats}")
        print(f"{'':40s} {'10^9 steps/s':>13s} {'of the peak':>12s} {'first [s]':>10s} {'from the CPU [um]':>18s}")
        for name, median in medians.items():
            rate = counts[name] * STEPS / median
            share = f"{rate * work / peak:12.2%}" if peak and not name.startswith("cpu") else f"{'':12s}"
            off = 1e6 * np.abs(np.asarray(results[name])[:fewest] - truth).max()
            print(f"{name:40s} {rate / 1e9:13.3f} {share} {first[name]:10.1f} {off:18.1e}")


if __name__ == "__main__":
    main()
