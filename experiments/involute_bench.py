"""Studies of an involute RV reducer whose teeth share the load: times in one run, beside a numpy active set.

- errors: samples of run-outs and a pitch wave of the reducer of Yang, Tang and Liang (2019), loaded TE of each over a
  mesh cycle, by ``gj.monte_carlo`` on one device per core; and by an active set in numpy and scipy for each angle of
  fewer samples, in one process, which is given the gaps and matrices worked out. Their TE is compared first.
- search: micro-geometries (tip relief of both gears, its length, slope of the profile), each descended by gradients to
  the most even load by ``gj.minimise``; and a hundredth of them with profile shift and centre distance, which change
  the matrices of every design: each takes some seconds.

Wall times, medians of repeats that take turns, compilation apart.

    python experiments/involute_bench.py [--samples 10000] [--starts 1000] [--repeats 3] [--only errors]
        [--neighbours 2]
"""

import argparse
import dataclasses
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)

import coupled_peers as peers
import jax.numpy as jnp
import numpy as np

import gearjax as gj
from gearjax.timing import Stopwatch
from gearjax.tolerance.monte_carlo import Work
from gearjax.units import mm, um

CONFIG = Path(__file__).parents[1] / "configs" / "involute_rv" / "yang_2019.toml"
TORQUE, ANGLES, SEARCHED = 100.0, 64, 16  # N m; angles of a mesh cycle, and of one in a search
FEW = 8  # samples of the peer, and as many in which both are compared
MEASURES = [f"static.{metric}@{TORQUE:g}Nm" for metric in ("peak_to_peak", "mean", "minimum", "maximum")]


NEIGHBOURS = 0  # teeth that a loaded one moves; 2 in the example, where the matrix of a flank is one block


def reducer() -> gj.Scene:
    scene = gj.load(CONFIG)
    assert isinstance(scene.compliance, gj.ElasticTeeth)
    teeth = dataclasses.replace(scene.compliance, neighbours=NEIGHBOURS)
    return dataclasses.replace(scene, compliance=teeth, run=None)


def mesh_cycle(scene: gj.Scene, number: int) -> np.ndarray:
    """Input angles of one tooth [rad]."""
    return np.linspace(0.0, 2 * np.pi / scene.system.orders["mesh"], number, endpoint=False)


def population() -> gj.Tolerances:
    """Rayleigh run-outs of both gears and a pitch wave of the external one, at random phases."""
    bodies = ("gear_1", "ring", "pitch")
    spreads: dict = {f"errors.{body}.amplitude": gj.Rayleigh(2 * um) for body in bodies}
    return gj.Tolerances(reducer(), spreads | {f"errors.{body}.phase": gj.UniformPhase() for body in bodies})


class Peer:
    """Loaded TE by an active set in numpy, for each sample and angle by itself."""

    def __init__(self, tolerances: gj.Tolerances, rows: np.ndarray, theta: np.ndarray):
        angles = jnp.asarray(theta)

        def contacts(row):
            scene = tolerances.free.set(tolerances.scene, row).physics("backlash", "compliance").anchored()
            return jax.vmap(lambda angle: scene.contacts(angle, "mean"))(angles)

        found = [jax.jit(contacts)(jnp.asarray(row)) for row in rows]
        self.gaps = np.array([each.gap for each in found])
        self.lever = np.asarray(found[0].jacobian[..., 0])
        self.influence = np.asarray(found[0].springs.influence)

    def __call__(self) -> np.ndarray:
        """TE, shape (sample, angle) [rad]."""
        each = [
            [peers.by_numpy(self.influence[i], self.lever[i], gap[i], -TORQUE)[0] for i in range(ANGLES)]
            for gap in self.gaps
        ]
        return np.array(each)


def timed(function) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def errors(samples: int, repeats: int) -> None:
    """Loaded TE of many samples."""
    tolerances = population()
    theta = mesh_cycle(tolerances.scene, ANGLES)
    work = Work(tolerances, MEASURES, number=samples, theta=theta, extremes="samples")
    peer = Peer(tolerances, work.inputs(0, FEW), theta)
    with Stopwatch() as watch:
        ours = work.evaluate(work.inputs(0, samples))[0][:FEW]
    known = peer()
    known = np.stack([np.ptp(known, axis=1), known.mean(axis=1), known.min(axis=1), known.max(axis=1)], axis=1)
    apart = np.abs(ours - known).max() / np.abs(known).max()
    carry = np.count_nonzero(peers.by_numpy(peer.influence[0], peer.lever[0], peer.gaps[0, 0], -TORQUE)[1])
    print(f"{samples} samples x {ANGLES} angles, {peer.lever.shape[1]} contacts, {carry} of them carry at the first")
    print(f"  largest difference of a measure from numpy, relative: {apart:.1e}", flush=True)
    assert apart < 1e-9
    seconds = {"gearjax": [], "numpy": []}
    for _ in range(repeats):
        seconds["gearjax"].append(timed(lambda: work.evaluate(work.inputs(0, samples))))
        seconds["numpy"].append(timed(peer) * samples / FEW)
    mine, theirs = (float(np.median(spent)) for spent in seconds.values())
    each = 1e6 / (samples * ANGLES)
    print(f"  gearjax, {len(jax.devices())} devices: {mine:.2f} s, {mine * each:.2f} us for each angle", end="")
    print(f" (compiled in {watch.compile_seconds:.1f} s)")
    print(f"  numpy, of {FEW} samples: {theirs:.1f} s, {theirs * each:.1f} us for each angle")
    held = "held" if theirs / mine >= 50 else "NOT HELD"
    print(f"  {'numpy over gearjax':40s} >= 50       {theirs / mine:<10.3g} {held}", flush=True)


def designs() -> tuple[gj.Scene, dict, dict]:
    """A reducer with modified flanks, bounds of its micro-geometry, and of its gears."""
    amount = jnp.asarray([0.5 * um])
    errors = {
        "tip": gj.TipRelief(body="gear_1", amount=amount, length=0.2 * mm),
        "ring_tip": gj.TipRelief(body="ring", amount=amount, length=0.2 * mm),
        "slope": gj.ProfileSlope(body="gear_1", slope=jnp.asarray([0.0])),
    }
    micro = {
        "errors.tip.amount[0]": (0.0, 3 * um),
        "errors.tip.length": (0.05 * mm, 0.6 * mm),
        "errors.ring_tip.amount[0]": (0.0, 3 * um),
        "errors.slope.slope[0]": (-2 * um, 2 * um),
    }
    gears = {"system.external_shift": (-0.41, -0.39), "system.centre_distance": (1.495 * mm, 1.5 * mm)}
    return dataclasses.replace(reducer(), errors=errors), micro, gears


def search(starts: int, repeats: int) -> None:
    """Load evenness by gradients."""
    scene, micro, gears = designs()
    theta = mesh_cycle(scene, SEARCHED)
    for name, bounds, number in (
        ("micro-geometry", micro, starts),
        ("and gears", micro | gears, max(4, starts // 100)),
    ):
        options = {"bounds": bounds, "starts": number, "theta": theta, "torque": TORQUE, "steps": 20, "polish_steps": 8}
        runs = [
            gj.minimise("static_load_sharing", scene, where=list(bounds), **options)
            for _ in range(min(repeats, 1 if name == "and gears" else 3))
        ]
        found, seconds = runs[0], np.median([run.seconds for run in runs])
        begun = found.history[0, 0]
        print(f"{name}: {number} designs of {len(bounds)} numbers, {SEARCHED} angles, {found.evaluations} evaluations")
        print(f"  {seconds:.1f} s (compiled in {found.compile_seconds:.1f} s), {found.failed} failed")
        print(f"  load sharing {begun:.4f} as given, {found.objective:.4f} at best, {found.within()} within 1 % of it")
        held = "held" if seconds * starts / number <= 300 else "NOT HELD"
        print(f"  {f'seconds for {starts}':40s} <= 300      {seconds * starts / number:<10.3g} {held}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--starts", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", default="")
    parser.add_argument("--neighbours", type=int, default=NEIGHBOURS)
    chosen = parser.parse_args()
    NEIGHBOURS = chosen.neighbours
    if chosen.only in "errors":
        errors(chosen.samples, chosen.repeats)
    if chosen.only in "search":
        search(chosen.starts, chosen.repeats)
