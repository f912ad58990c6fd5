"""Motion of bodies on supports: errors and times of constant modes beside other solvers, in one run.

Both examples with all their discs or planet wheels on supports, 5 coordinates; the solvers take turns, times are
medians after compilation. Errors of the output are the largest against Dopri8 at 1e-12. At equal error: what constant
modes would take for the error of Tsit5, between the two step lengths around it, or along their order beyond them.

Derivatives are of the mean square of the deviation of the output, with respect to the factors of four numbers of the
scene; lanes are masses of the bodies, side by side.

    python experiments/supports_bench.py [--repeats 5] [--only two_kv]

As installed, and with the options that the command sets itself:

    XLA_FLAGS="$(python -c 'import gearjax; print(gearjax.xla_options())')" python experiments/supports_bench.py
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from peers import interleaved

import gearjax as gj
from gearjax.units import arcmin

CONFIGS = Path(__file__).parents[1] / "configs"
STIFFNESS, DAMPING, MASS = 2e8, 400.0, 0.8
LANES = 64
TIGHT = 1e-7  # tolerance of the peer


def on_supports(name: str) -> gj.Scene:
    """An example with every body that may move on a support."""
    scene = gj.load(CONFIGS / name)
    support = gj.Support(x=STIFFNESS, y=STIFFNESS, x_damping=DAMPING, y_damping=DAMPING)
    bodies = scene.system.coordinates
    inertia = dict.fromkeys(bodies, gj.BodyInertia(MASS))
    return dataclasses.replace(scene, supports=dict.fromkeys(bodies, support), body_inertia=inertia)


def measure(name: str, torque: float, duration: float, per_sample: tuple[int, ...], repeats: int) -> None:
    """Print a row per solver, then what constant modes take at equal error, per step, for derivatives and per lane."""
    scene, ts = on_supports(name), np.linspace(0.0, duration, 41)
    rigid = dataclasses.replace(scene, supports={}, body_inertia={})
    steppers: dict[str, gj.FixedStep | gj.AdaptiveStep] = {
        f"constant modes, {number} steps a sample": gj.FixedStep(per_sample=number) for number in per_sample
    }
    steppers |= {
        f"Runge-Kutta, {number} steps a sample": gj.FixedStep(per_sample=number, solver=gj.RungeKutta4())
        for number in per_sample[-2:]
    }
    for tolerance in (1e-5, TIGHT, 1e-9):
        steppers[f"Tsit5, {tolerance:g}"] = gj.AdaptiveStep(tolerance, tolerance, diffrax.Tsit5())
    steppers["truth"] = gj.AdaptiveStep(1e-12, 1e-12)
    tasks: dict[str, Callable[[], Any]] = {
        key: lambda stepper=stepper: gj.simulate(scene, ts, torque, stepper=stepper)
        for key, stepper in steppers.items()
    }
    tasks["output alone, fitted march"] = lambda: gj.simulate(rigid, ts, torque)
    more = derivatives(scene, ts, torque, per_sample[0])
    results, first, times = interleaved(tasks | more, repeats, slow=2.0)
    print(f"{name}, {torque:g} N m, {duration:g} s")
    errors = {}
    for key in tasks:
        errors[key] = np.abs(np.asarray(results[key].te - results["truth"].te)).max() / arcmin
        error = "" if "alone" in key else f"error {errors[key]:.1e} arcmin"
        print(f"  {key:40s} {1e3 * times[key]:9.2f} ms  first {first[key]:5.1f} s  {error}")
    modes = [key for key in tasks if "modes" in key]
    peer = f"Tsit5, {TIGHT:g}"
    equal = time_at([errors[key] for key in modes], [times[key] for key in modes], errors[peer])
    steps = [number * (len(ts) - 1) for number in per_sample]
    each = (times[modes[-1]] - times[modes[0]]) / (steps[-1] - steps[0])
    print(f"  at the error of {peer}: {1e3 * equal:.2f} ms, {times[peer] / equal:.1f} times as fast")
    print(f"  a step: {1e9 * each:.0f} ns; besides, a call: {1e3 * (times[modes[0]] - each * steps[0]):.2f} ms")
    for key in more:
        if key != "primal":
            print(f"  {key}: {times[key] / times['primal']:.2f} times the primal, first {first[key]:.1f} s")
    print(f"  a step of a lane: {1e9 * times[f'{LANES} lanes'] / LANES / steps[0]:.0f} ns", flush=True)


def time_at(errors: list[float], times: list[float], error: float) -> float:
    """Time that an error takes, by powers between two lengths of step or beyond the last two [s]."""
    logs = np.log(errors), np.log(times)
    at = int(np.clip(np.searchsorted(-np.asarray(errors), -error) - 1, 0, len(errors) - 2))
    power = (logs[1][at + 1] - logs[1][at]) / (logs[0][at + 1] - logs[0][at])
    return float(np.exp(logs[1][at] + power * (np.log(error) - logs[0][at])))


def derivatives(scene: gj.Scene, ts: np.ndarray, torque: float, number: int) -> dict[str, Callable[[], Any]]:
    """A loss, its derivatives in both modes, and motions side by side, each as a program."""
    body = next(iter(scene.supports))

    def numbers(scene: gj.Scene) -> list[Any]:
        own = scene.body_inertia[body].mass, scene.supports[body].x, scene.supports[body].x_damping
        return [*own, jax.tree.leaves(scene.inertia)[0]]

    def loss(factors: jax.Array) -> jax.Array:
        changed = [known * factor for known, factor in zip(numbers(scene), factors, strict=True)]
        other = eqx.tree_at(numbers, scene, changed)
        return jnp.mean((gj.simulate(other, ts, torque, stepper=gj.FixedStep(per_sample=number)).te * 1e6) ** 2)

    ones, lanes = jnp.ones(4), jnp.linspace(0.9, 1.1, LANES)
    beside = jax.jit(jax.vmap(lambda factor: loss(jnp.ones(4).at[0].set(factor))))
    programs = {"primal": jax.jit(loss), "reverse": jax.jit(jax.grad(loss)), "forward": jax.jit(jax.jacfwd(loss))}
    tasks = {key: lambda program=program: program(ones) for key, program in programs.items()}
    return tasks | {f"{LANES} lanes": lambda: beside(lanes)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    examples = {
        "two_kv/wang_2020.toml": (100.0, 0.2, (96, 192, 384)),
        "rv_cycloidal/hu_2020.toml": (784.0, 0.02, (512, 1024)),
    }
    for name, (torque, duration, per_sample) in examples.items():
        if given.only in name:
            measure(name, torque, duration, per_sample, given.repeats)
