"""Elliptic pair of Dong et al. (2020): designs under static torque beside peers, and steps of motion beside a 2K-V's.

Designs: static TE over a turn of 1,000 pairs with other eccentricities, run-outs, phases and distances of the axes.
Peers: numpy with scipy's root finder at each angle, on some of the designs, and numpy for all angles of a design at
once. Exact geometry is ours alone. Motion: time of a step of the same scheme, of this pair and of the 2K-V example.
Tasks take turns, times are medians after compilation.

    python experiments/elliptic_bench.py [--designs 1000] [--repeats 5]
"""

import argparse
import dataclasses
import math
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from peers import agree, interleaved, sized
from scipy.optimize import brentq
from scipy.special import ellipe

import gearjax as gj
from gearjax.units import arcmin, um

CONFIGS = Path(__file__).parents[1] / "configs"
ANGLES, TORQUE, EACH, BY_ROOTS = 361, 10.0, 100, 20
STEPS = 20_000
LOW = np.array([0.0, 0.0, 0.0, -math.pi, -math.pi, 0.0])  # of e, both run-outs, both phases, the axes' distance
HIGH = np.array([0.6, 40 * um, 40 * um, math.pi, math.pi, 30 * um])


class Designs:
    """Static TE of many pairs, shape (design, angle) [rad]."""

    def __init__(self, number: int):
        self.scene = dataclasses.replace(gj.load(CONFIGS / "elliptic" / "dong_2020.toml"), run=None)
        self.theta = np.linspace(0.0, 2 * math.pi, ANGLES)
        self.numbers = np.random.default_rng(0).uniform(LOW, HIGH, (number, len(LOW)))

        def te(numbers: jax.Array, clearance: str) -> jax.Array:
            e, one, other, phase, turned, apart = numbers
            system = dataclasses.replace(
                self.scene.system, eccentricity=e, centre_distance_error=apart, clearance=clearance
            )
            errors = {
                "driver": gj.Eccentricity("driver", one, phase),
                "driven": gj.Eccentricity("driven", other, turned),
            }
            own = dataclasses.replace(self.scene, system=system, errors=errors)
            return gj.transmission_error(own, self.theta, torque=TORQUE, extremes="samples").te

        def batched(clearance: str):
            return jax.jit(lambda rows: jax.lax.map(lambda row: te(row, clearance), rows, batch_size=EACH))

        self._linear, self._exact = batched("linear"), batched("exact")

    def ours(self) -> jax.Array:
        return self._linear(jnp.asarray(self.numbers))

    def exactly(self) -> jax.Array:
        return self._exact(jnp.asarray(self.numbers))

    def _geometry(self, numbers: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Levers and gaps of both flanks, shape (2, angle)."""
        system = self.scene.system
        e, one, other, phase, turned, apart = numbers
        a, alpha = math.pi * float(system.module) * system.teeth / (4 * ellipe(e * e)), float(system.pressure_angle)
        lean = np.arctan2(e * np.sin(t), 1 - e * np.cos(t))
        radius = 2 * a - a * (1 - e * e) / (1 - e * np.cos(t))
        levers, gaps = [], []
        for side in (1.0, -1.0):
            slant = alpha + side * lean
            run_outs = one * np.sin(t + phase + side * slant) + other * np.sin(t + 2 * lean + turned - side * slant)
            levers.append(-side * radius * np.cos(slant))
            gaps.append(-side * run_outs + apart * np.sin(slant) + (side < 0) * float(self.scene.backlash.initial))
        return np.array(levers), np.array(gaps)

    @property
    def _stiffness(self) -> float:
        return float(self.scene.compliance.mean)

    def by_roots(self) -> np.ndarray:
        """At each angle of some of the designs by scipy's root finder."""
        found = []
        for numbers in self.numbers[:BY_ROOTS]:
            for t in self.theta:
                lever, gap = self._geometry(numbers, t)

                def missing(q: float, lever=lever, gap=gap) -> float:
                    return TORQUE + (lever * self._stiffness * np.maximum(lever * q - gap, 0.0)).sum()

                found.append(brentq(missing, -0.1, 0.1, xtol=1e-14))
        return np.array(found).reshape(BY_ROOTS, -1)

    def by_numpy(self) -> np.ndarray:
        """All angles at once, in closed form: the back flank touches too where the driving one alone is beyond it."""
        found = []
        for numbers in self.numbers:
            lever, gap = self._geometry(numbers, self.theta)
            k = self._stiffness
            alone = (k * lever[0] * gap[0] - TORQUE) / (k * lever[0] ** 2)
            both = (k * (lever * gap).sum(axis=0) - TORQUE) / (k * (lever**2).sum(axis=0))
            found.append(np.where(lever[1] * alone > gap[1], both, alone))
        return np.array(found)


class Motion:
    """Steps of the fitted march, of two gear sets."""

    def __init__(self):
        self.scenes = {
            "elliptic pair": (gj.load(CONFIGS / "elliptic" / "dong_2020.toml"), TORQUE),
            "2K-V": (gj.load(CONFIGS / "two_kv" / "wang_2020.toml"), 100.0),
        }
        self.ts = {}
        for name, (scene, torque) in self.scenes.items():
            step = gj.chosen_steps(scene, np.linspace(0.0, 0.1, 101), torque).step
            self.ts[name] = np.linspace(0.0, STEPS * step, STEPS // 100 + 1)

    def run(self, name: str) -> jax.Array:
        scene, torque = self.scenes[name]
        return gj.simulate(scene, self.ts[name], torque, stepper=gj.FixedStep(per_sample=100)).te


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options = sized(parser, designs=(1000, 40), repeats=(5, 1))
    designs = Designs(options.designs)
    tasks = {
        "gearjax": designs.ours,
        "gearjax, exact": designs.exactly,
        "numpy": designs.by_numpy,
        "scipy": designs.by_roots,
    }
    results, first, seconds = interleaved(tasks, options.repeats, slow=1.0)
    ours = np.asarray(results["gearjax"])
    print(f"static TE of {options.designs} pairs x {ANGLES} angles")
    for name, spent in seconds.items():
        share = options.designs / BY_ROOTS if name == "scipy" else 1.0
        told = f" ({BY_ROOTS} of them, times {share:g})" if name == "scipy" else ""
        ratio = spent * share / seconds["gearjax"]
        print(f"  {name:16s} {spent * share:8.4f} s, {ratio:7.1f} times ours (first call {first[name]:.1f} s){told}")
    apart = [np.abs(ours[: len(other)] - other).max() for other in (results["numpy"], results["scipy"])]
    for name, most in zip(("numpy", "scipy"), apart, strict=True):
        agree(f"  largest difference from {name}", most / arcmin, 1e-9, "arcmin")

    motion = Motion()
    tasks = {name: lambda name=name: motion.run(name) for name in motion.scenes}
    _, first, seconds = interleaved(tasks, options.repeats, slow=10.0)
    print(f"{STEPS} steps of motion")
    for name, spent in seconds.items():
        print(f"  {name:16s} {1e9 * spent / STEPS:8.1f} ns a step (first call {first[name]:.1f} s)")
    print(f"  ratio {seconds['elliptic pair'] / seconds['2K-V']:.2f}")


if __name__ == "__main__":
    main()
