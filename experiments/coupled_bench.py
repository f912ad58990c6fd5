"""Contacts coupled by a matrix: times beside other solvers, in one run, and how many random problems fail.

Process times of one core, the solvers take turns, medians. The vmapped exact steps are what `jax.vmap` makes of the
active set without conjugate gradients.

    python experiments/coupled_bench.py [--repeats 5] [--only shared]
"""

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import jax

jax.config.update("jax_enable_x64", True)

import coupled_peers as peers
import jax.numpy as jnp
import numpy as np
from peers import agree, sized

from gearjax.contact.active_set import carrying
from gearjax.contact.coupled import coupled_balance

FEW = 20  # lanes of the short form, which also leaves sizes out
SHARED = jax.jit(jax.vmap(coupled_balance, (None, None, 0, 0)))
SINGLE = jax.jit(coupled_balance)


def active_set(matrix, lever, gap, load):
    """The exact steps alone, from all loaded contacts."""
    edge = (gap / lever).max()
    apart = jnp.where(gap / lever == edge, 0.0, gap - lever * edge)
    held = jnp.ones(gap.shape, bool)
    return carrying(matrix, lever[:, None], apart, load[None], held, held)[1]


PLAIN = jax.jit(jax.vmap(active_set, (None, None, 0, 0)))


def in_turns(tasks: dict[str, Callable[[], Any]], repeats: int) -> tuple[dict[str, Any], dict[str, float]]:
    """Results, and median process times of tasks that take turns [s]."""
    results = {name: jax.block_until_ready(task()) for name, task in tasks.items()}
    times = {name: [] for name in tasks}
    for _ in range(repeats):
        for name, task in tasks.items():
            began = time.process_time()
            jax.block_until_ready(task())
            times[name].append(time.process_time() - began)
    return results, {name: float(np.median(spent)) for name, spent in times.items()}


def row(name: str, target: float, shown: float, most: bool = True) -> None:
    """One line: target, measured, held or not."""
    held = shown <= target if most else shown >= target
    print(
        f"  {name:64s} {'<=' if most else '>='} {target:<8.3g} {shown:<10.3g} {'held' if held else 'NOT HELD'}",
        flush=True,
    )


def weighed(matrix, lever, gap, load):
    """A number of the answer, to differentiate."""
    position, forces, _ = coupled_balance(matrix, lever, gap, load)
    return position + forces @ jnp.cos(jnp.arange(len(gap)))


GRADIENT = jax.jit(jax.vmap(jax.value_and_grad(weighed, (2, 3)), (None, None, 0, 0)))


def shared(repeats: int, lanes: int) -> None:
    """Many gaps and loads under one matrix."""
    for number, of_c, of_plain in ((99, 0.7, 4), (240, 0.45, 10))[: 2 if lanes > FEW else 1]:
        rng = np.random.default_rng(number)
        matrix, lever = peers.slices(number, rng)
        gaps, loads = peers.slice_gaps(number, lanes, rng)
        given = [jnp.asarray(part) for part in (matrix, lever, gaps, loads)]
        tasks = {
            "shared": lambda given=given: SHARED(*given),
            "c": peers.by_c(matrix, lever, gaps, loads),
            "plain": lambda given=given: PLAIN(*given),
            "gradient": lambda given=given: GRADIENT(*given),
            "float32": lambda given=given: SHARED(*(part.astype(jnp.float32) for part in given)),
        }
        results, times = in_turns(tasks, repeats)
        print(
            f"one matrix, n = {number}, {lanes} lanes: us each",
            {k: round(1e6 * t / lanes, 1) for k, t in times.items()},
        )
        known = np.array([peers.by_numpy(matrix, lever, gaps[i], loads[i])[1] for i in range(min(lanes, 50))])
        off = {name: error(results[name][1][: len(known)], known) for name in ("shared", "float32")}
        agree("  largest error of a force, of the largest, against numpy", off["shared"], 1e-10)
        agree("  the same, float32", off["float32"], 2e-5)
        agree("  the same, C", error(results["c"][: len(known)], known), 1e-10)
        row("time over C", of_c, times["shared"] / times["c"])
        row("times as fast as the vmapped exact steps", of_plain, times["plain"] / times["shared"], most=False)
        row("gradient over primal", 1.4, times["gradient"] / times["shared"])


def error(forces, known) -> float:
    """Largest error of a force over the largest force of its problem."""
    return float((np.abs(np.asarray(forces) - known).max(axis=-1) / known.max(axis=-1)).max())


def large(repeats: int, lanes: int) -> None:
    """1,274 contacts as finite elements see them."""
    batch = 64 if lanes > FEW else 4
    matrix, lever, gaps, loads = peers.tooth_points(np.random.default_rng(0), batch)
    given = [jnp.asarray(part) for part in (matrix, lever, gaps, loads)]
    one = [given[0], given[1], given[2][0], given[3][0]]
    tasks = {
        "single": lambda: SINGLE(*one),
        "numpy": lambda: peers.by_numpy(matrix, lever, gaps[0], loads[0]),
        "batch": lambda: SHARED(*given),
    }
    results, times = in_turns(tasks, min(repeats, 3))
    print("n = 1274: ms", {k: round(1e3 * t / (batch if k == "batch" else 1), 2) for k, t in times.items()})
    known = np.array([peers.by_numpy(matrix, lever, gaps[i], loads[i])[1] for i in range(min(batch, 16))])
    agree("  largest error of a force, batch", error(results["batch"][1][: len(known)], known), 1e-10)
    agree("  largest error of a force, single", error(results["single"][1], known[0]), 1e-10)
    row("single, cold, over numpy", 0.45, times["single"] / times["numpy"])
    row(f"batch of {batch}, each, over numpy", 0.2, times["batch"] / batch / times["numpy"])


def random(problems: int) -> None:
    """Random problems of five families: how many fail, and by how much forces miss their conditions."""
    failed, worst = 0, 0.0
    numbers = (10, 30, 60, 100) if problems > 4 * FEW else (10, 30)
    for number in numbers:
        for turn in range(problems // len(numbers)):
            rng = np.random.default_rng(10_000 * number + turn)
            given = peers.random_problem(peers.FAMILIES[turn % 5], number, rng)
            matrix, lever, gap, load = given
            position, forces, result = (np.asarray(part) for part in SINGLE(*given))
            if result:
                failed += 1
                continue
            opening = matrix @ forces + gap - lever * position
            longest = np.abs(gap).max() + np.abs(matrix @ forces).max()
            missed = -forces.min() / forces.max(), -opening.min() / longest, abs(lever @ forces / load - 1)
            worst = np.max([worst, *missed])  # max would drop nan
    print(f"{problems} random problems of five families")
    agree("  failures", failed, 0)
    agree("  conditions missed by, relative", worst, 1e-10)


def small(repeats: int, lanes: int) -> None:
    """Few contacts, and other programs of one problem: microseconds."""
    for number in (3, 9, 30, 99, 240) if lanes > FEW else (9,):
        rng = np.random.default_rng(number)
        matrix, lever = peers.slices(number, rng)
        gaps, loads = peers.slice_gaps(number, 256, rng)
        given = [jnp.asarray(part) for part in (matrix, lever, gaps, loads)]
        one = [given[0], given[1], given[2][0], given[3][0]]
        host = matrix, lever, gaps[0], loads[0]
        tasks: dict[str, Callable[[], Any]] = {
            "256 lanes": lambda given=given: SHARED(*given),
            "single": lambda one=one: SINGLE(*one),
            "numpy": lambda host=host: peers.by_numpy(*host),
        }
        if number >= 9:
            tasks |= {"nnls": lambda host=host: peers.by_least_squares(*host)}
            tasks |= {"HiGHS": lambda host=host: peers.by_highs(*host)}
        results, times = in_turns(tasks, 4 * repeats)
        known = results["numpy"][1]
        for name, most in (("nnls", 1e-6), ("HiGHS", 1e-6)):
            if name in results:
                agree(f"  largest error of a force by {name}", error(results[name], known), most)
        shown = {name: round(1e6 * spent / (256 if "lanes" in name else 1), 2) for name, spent in times.items()}
        print(f"n = {number}, us:", shown, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="")
    chosen = sized(parser, repeats=(5, 1), problems=(2000, 40), lanes=(1000, FEW))
    parts = {"shared": shared, "large": large, "small": small}
    for name, part in parts.items():
        if chosen.only in name:
            part(chosen.repeats, chosen.lanes)
    if chosen.only in "random":
        random(chosen.problems)
