"""Motion of bodies on supports: errors and times of constant modes beside other solvers, in one run.

Both examples with all their discs or planet wheels on supports, 5 coordinates; the solvers take turns, times are
medians after compilation. Errors of the output are the largest against Dopri8 at 1e-12.

    python experiments/supports_bench.py [--repeats 5]
"""

import argparse
import dataclasses
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import diffrax
import numpy as np
from peers import interleaved

import gearjax as gj
from gearjax.units import arcmin

CONFIGS = Path(__file__).parents[1] / "configs"
STIFFNESS, DAMPING, MASS = 2e8, 400.0, 0.8


def on_supports(name: str) -> gj.Scene:
    """An example with every body that may move on a support."""
    scene = gj.load(CONFIGS / name)
    support = gj.Support(x=STIFFNESS, y=STIFFNESS, x_damping=DAMPING, y_damping=DAMPING)
    bodies = scene.system.coordinates
    inertia = dict.fromkeys(bodies, gj.BodyInertia(MASS))
    return dataclasses.replace(scene, supports=dict.fromkeys(bodies, support), body_inertia=inertia)


def measure(name: str, torque: float, duration: float, per_sample: tuple[int, ...], repeats: int) -> None:
    """Print a row per solver."""
    scene, ts = on_supports(name), np.linspace(0.0, duration, 41)
    rigid = dataclasses.replace(scene, supports={}, body_inertia={})
    steppers: dict[str, gj.FixedStep | gj.AdaptiveStep] = {
        f"constant modes, {number} steps a sample": gj.FixedStep(per_sample=number) for number in per_sample
    }
    steppers |= {
        f"Runge-Kutta, {number} steps a sample": gj.FixedStep(per_sample=number, solver=gj.RungeKutta4())
        for number in per_sample[-2:]
    }
    for tolerance in (1e-5, 1e-7, 1e-9):
        steppers[f"Tsit5, {tolerance:g}"] = gj.AdaptiveStep(tolerance, tolerance, diffrax.Tsit5())
    steppers["truth"] = gj.AdaptiveStep(1e-12, 1e-12)
    tasks = {
        key: lambda stepper=stepper: gj.simulate(scene, ts, torque, stepper=stepper)
        for key, stepper in steppers.items()
    }
    tasks["output alone, fitted march"] = lambda: gj.simulate(rigid, ts, torque)
    results, first, times = interleaved(tasks, repeats, slow=2.0)
    print(f"{name}, {torque:g} N m, {duration:g} s")
    for key, seconds in times.items():
        off = np.abs(np.asarray(results[key].te - results["truth"].te)).max() / arcmin
        error = "" if "alone" in key else f"error {off:.1e} arcmin"
        print(f"  {key:40s} {1e3 * seconds:9.2f} ms  first {first[key]:5.1f} s  {error}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    measure("two_kv/wang_2020.toml", 100.0, 0.2, (96, 192, 384), repeats)
    measure("rv_cycloidal/hu_2020.toml", 784.0, 0.02, (512, 1024), repeats)
