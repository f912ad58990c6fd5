"""Contacts coupled by a matrix: times beside other solvers, in one run, and how many random problems fail.

Process times of one core, the solvers take turns, medians. The vmapped exact steps are what `jax.vmap` makes of the
active set without conjugate gradients.

    python experiments/coupled_bench.py [--repeats 5] [--only shared]
"""

import argparse
import dataclasses
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import jax

jax.config.update("jax_enable_x64", True)

import coupled_peers as peers
import jax.numpy as jnp
import numpy as np
from faces_peers import by_c
from peers import agree, sized

import gearjax as gj
from gearjax.contact.active_set import carrying
from gearjax.contact.coupled import coupled_balance
from gearjax.contact.springs import block_diagonal
from gearjax.units import um

CONFIG = Path(__file__).parents[1] / "configs" / "helical" / "guo_2018.toml"
TORQUE, SHARES = 830.0, (0.2, 0.4, 0.6, 0.8, 1.0)  # N m, and shares of it
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


class Cycle:
    """A mesh cycle of the helical pair of Guo and Fang (2018) at a torque: slices coupled along the face."""

    def __init__(self, slices: int, angles: int):
        scene = gj.load(CONFIG)
        errors = {name: scene.errors[name] for name in ("tip", "root", "crowning")}
        system = dataclasses.replace(scene.system, slices=slices)
        compliance = dataclasses.replace(scene.compliance, coupling_length=1.5)
        self.scene = dataclasses.replace(scene, system=system, compliance=compliance, errors=errors, run=None)
        self.theta = np.arange(angles) * 2 * np.pi / (system.pinion_teeth * angles)
        found = jax.jit(jax.vmap(lambda angle: self.scene.contacts(angle, "mean")))(self.theta)
        self.faces, self.lever, self.gap = found.springs.blocks, found.jacobian[:, :, 0], found.gap

    def swing(self, numbers):
        """Peak-to-peak TE with other reliefs, crowning, steel, bores, coupling length, face width and torque."""
        names = ("tip", "root", "crowning")
        errors = {
            name: dataclasses.replace(
                self.scene.errors[name], amount=self.scene.errors[name].amount + numbers[place] * um
            )
            for place, name in enumerate(names)
        }
        own, system = self.scene.compliance, self.scene.system
        compliance = dataclasses.replace(
            own,
            youngs_modulus=own.youngs_modulus * (1 + numbers[3]),
            poissons_ratio=own.poissons_ratio * (1 + numbers[4]),
            pinion_bore=own.pinion_bore * (1 + numbers[5]),
            wheel_bore=own.wheel_bore * (1 + numbers[6]),
            coupling_length=own.coupling_length * (1 + numbers[7]),
        )
        system = dataclasses.replace(system, face_width=system.face_width * (1 + numbers[8]))
        scene = dataclasses.replace(self.scene, errors=errors, compliance=compliance, system=system)
        torque = TORQUE * (1 + numbers[9])
        return gj.transmission_error(scene, self.theta, torque=torque, extremes="samples").peak_to_peak


def faces(repeats: int, lanes: int) -> None:
    """Slices coupled along tooth faces: one variant, gradients of its peak-to-peak TE, and many variants at torques."""
    short = lanes <= FEW
    cycle = Cycle(9 if short else 40, 8 if short else 64)
    own = jax.jit(jax.vmap(lambda *given: coupled_balance(*given, jnp.asarray(-TORQUE))))
    loads = np.full(len(cycle.gap), -TORQUE)
    matrices = np.array(jax.vmap(lambda faces: block_diagonal(faces.blocks))(cycle.faces))
    host = np.asarray(cycle.lever), np.asarray(cycle.gap)
    zero = jnp.zeros(10)
    primal, reverse = jax.jit(cycle.swing), jax.jit(jax.value_and_grad(cycle.swing))
    forward = jax.jit(lambda numbers: (cycle.swing(numbers), jax.jacfwd(cycle.swing)(numbers)))
    tasks: dict[str, Callable[[], Any]] = {
        "cycle": lambda: own(cycle.faces, cycle.lever, cycle.gap),
        "c": by_c(cycle.faces, *host, loads, 1),
        "numpy": lambda: [peers.by_numpy(matrices[i], host[0][i], host[1][i], -TORQUE)[1] for i in range(len(loads))],
        "TE": lambda: primal(zero),
        "reverse": lambda: reverse(zero),
        "forward": lambda: forward(zero),
    }
    results, times = in_turns(tasks, 3 * repeats)
    shown = {name: round(1e3 * spent, 3) for name, spent in times.items()}
    print(f"slices of three faces, {cycle.gap.shape[1]} contacts, {len(loads)} angles: ms", shown)
    agree("  largest error of a force, against numpy", error(results["cycle"][1], np.array(results["numpy"])), 1e-10)
    agree("  the same, C", error(results["c"], np.array(results["numpy"])), 1e-10)
    row("cycle over C", 1.1, times["cycle"] / times["c"])
    row("times as fast as numpy", 30, times["numpy"] / times["cycle"], most=False)
    row("gradient of peak-to-peak by 10 numbers, reverse, over TE", 1.7, times["reverse"] / times["TE"])
    row("the same, forward", 3, times["forward"] / times["TE"])
    many_faces(cycle, repeats, 4 if short else 256)


def many_faces(cycle: Cycle, repeats: int, variants: int) -> None:
    """Variants of the gaps of a mesh cycle, each at five torques."""
    rng = np.random.default_rng(0)
    rough = jnp.asarray(rng.uniform(0, 1 * um, (variants, *cycle.gap.shape)))
    gaps = jnp.repeat(cycle.gap + rough, len(SHARES), axis=0)
    loads = jnp.tile(-TORQUE * jnp.asarray(SHARES), variants)
    angles = jax.vmap(coupled_balance, (0, 0, 0, None))
    ours = jax.jit(jax.vmap(angles, (None, None, 0, 0)))
    of_c = jax.tree.map(lambda part: np.tile(part, (len(loads), *[1] * (part.ndim - 1))), (cycle.faces, cycle.lever))
    each = np.asarray(gaps).reshape(-1, cycle.gap.shape[1]), np.repeat(np.asarray(loads), len(cycle.gap))
    single = jax.tree.map(lambda part: part.astype(jnp.float32), (cycle.faces, cycle.lever, gaps, loads))
    tasks: dict[str, Callable[[], Any]] = {
        "gearjax": lambda: ours(cycle.faces, cycle.lever, gaps, loads),
        "float32": lambda: ours(*single),
        "c": by_c(*of_c, *each, 32),
    }
    results, times = in_turns(tasks, repeats)
    number = len(each[1])
    print(f"{number} problems: us each", {name: round(1e6 * spent / number, 2) for name, spent in times.items()})
    forces = np.asarray(results["gearjax"][1]).reshape(number, -1)
    agree("  largest error of a force, against C", error(results["c"], forces), 1e-10)
    # in single precision, slices that hardly touch count as open in a few of many problems
    agree("  the same, float32", error(np.asarray(results["float32"][1]).reshape(number, -1), forces), 1e-4)
    row("time over C", 3, times["gearjax"] / times["c"])
    row("the same, float32", 3.7, times["float32"] / times["c"])
    some = range(0, number, max(number // 50, 1))
    host = [np.asarray(block_diagonal(cycle.faces.blocks)), np.asarray(cycle.lever)]
    began = time.process_time()
    for i in some:
        at = i % len(cycle.gap)
        peers.by_numpy(host[0][at], host[1][at], each[0][i], each[1][i])
    by_numpy = (time.process_time() - began) / len(some)
    row("times as fast as numpy", 100, by_numpy / (times["gearjax"] / number), most=False)


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
    parts = {"shared": shared, "faces": faces, "large": large, "small": small}
    for name, part in parts.items():
        if chosen.only in name:
            part(chosen.repeats, chosen.lanes)
    if chosen.only in "random":
        random(chosen.problems)
