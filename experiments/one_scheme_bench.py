"""One coordinate by constant modes, beside the exponentially fitted march, in one run: can one scheme do for both?

The shipped examples, whose output alone moves: dampers that act in contact and back flanks (2K-V), levers that turn
(RV). Both schemes as programs of the same scene; errors are the largest of the output against Dopri8 at 1e-12, relative
to its travel; ratios at equal error interpolate along powers between step lengths.

What was found: not for all, so both stay. Levers that stand still (2K-V): constant modes take 2 to 6 times as long as
the march at equal error, 2 to 7 times as long as its windows, 10 to 12 times for a gradient backwards, and 30 to 70
times for 64 lanes, which the march lays last. Levers that turn (RV): with 48 steps a sample their error is a hundredth
of that of the march with 192, in a third of its time (as installed, where the march is slow, a sixtieth); at equal
steps a gradient takes 0.2 (reverse) to 0.4 (forward) of its time, lanes as long. Such gear sets take constant
modes (`by_constant_modes`), which this bench turns off.

    python experiments/one_scheme_bench.py [--repeats 5] [--only two_kv]

As installed, and with the options that the command sets itself:

    XLA_FLAGS="$(python -c 'import gearjax; print(gearjax.xla_options())')" python experiments/one_scheme_bench.py
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from peers import interleaved
from supports_bench import time_at

import gearjax as gj
from gearjax.analysis import modes
from gearjax.analysis.choice import MODELLED, phase_of, suitable_step
from gearjax.analysis.equation import Equation

gj.RVCycloidal.by_constant_modes = False  # by both schemes

CONFIGS = Path(__file__).parents[1] / "configs"
LANES = 64
Scheme = Callable[[gj.Scene, int], tuple[jax.Array, ...]]


def schemes(known: gj.Scene, ts: np.ndarray, torque: float) -> dict[str, Scheme]:
    """Both schemes: from a scene and a number of steps between samples to the output's deviation, forces
    and extremes at the samples."""

    def fitted(scene: gj.Scene, number: int) -> tuple[jax.Array, ...]:
        return recorded(gj.simulate(scene, ts, torque, stepper=gj.FixedStep(per_sample=number)))

    def constant_modes(scene: gj.Scene, number: int) -> tuple[jax.Array, ...]:
        physics, load, begin = scene.physics(*MODELLED), jnp.asarray(torque), jnp.asarray(ts[0])
        alone, equation = Equation.of(physics, load), modes.StructureEquation.of(physics, load)
        state = alone.initial(begin, "equilibrium") * alone.scale * jnp.stack([jnp.ones(()), alone.frequency])
        steps = modes.Steps.of(equation, begin, jnp.asarray((ts[1] - ts[0]) / number))
        phase = phase_of(known.physics(*MODELLED), ts, number)
        spacing = modes.Spacing.of(len(ts), number, phase, ts.dtype)
        found = modes.march(steps, state[:1], state[1:], spacing)
        forces = jax.vmap(equation.forces)(jnp.asarray(ts), found.states[:, 0])
        return found.states[:, 0, 0], forces, found.highest, found.lowest

    return {"fitted": fitted, "modes": constant_modes}


def recorded(motion: gj.Motion) -> tuple[jax.Array, ...]:
    """What is compared, and what else a record holds."""
    return motion.te, motion.forces, motion.highest, motion.lowest


def numbers(scene: gj.Scene) -> list[Any]:
    """Four numbers of a scene that derivatives are with respect to."""
    return [
        jax.tree.leaves(scene.inertia)[0],
        scene.damping.ratio,
        scene.compliance.mean,
        next(iter(scene.errors.values())).amplitude,
    ]


def programs(scene: gj.Scene, scheme: Scheme, number: int) -> dict[str, Callable[[], Any]]:
    """A loss, its derivatives, and motions of several masses side by side."""

    def loss(factors: jax.Array) -> jax.Array:
        changed = [known * factor for known, factor in zip(numbers(scene), factors, strict=True)]
        return jnp.mean((scheme(eqx.tree_at(numbers, scene, changed), number)[0] * 1e6) ** 2)

    ones, lanes = jnp.ones(4), jnp.linspace(0.9, 1.1, LANES)
    beside = jax.jit(jax.vmap(lambda factor: loss(jnp.ones(4).at[0].set(factor))))
    kinds = {"primal": jax.jit(loss), "reverse": jax.jit(jax.grad(loss)), "forward": jax.jit(jax.jacfwd(loss))}
    found = {key: lambda program=program: program(ones) for key, program in kinds.items()}
    return found | {"lanes": lambda: beside(lanes)}


def measure(name: str, torque: float, duration: float, samples: int, per_sample: tuple[int, ...], repeats: int) -> None:
    """Print errors and times of both schemes, and ratios."""
    scene, ts = gj.load(CONFIGS / name), np.linspace(0.0, duration, samples)
    truth = np.asarray(gj.simulate(scene, ts, torque, stepper=gj.AdaptiveStep(1e-12, 1e-12)).te)
    both, tasks = schemes(scene, ts, torque), {}
    for key, scheme in both.items():
        for number in per_sample:
            tasks[f"{key} {number}"] = jax.jit(lambda scheme=scheme, number=number: scheme(scene, number))
        for kind, task in programs(scene, scheme, per_sample[1]).items():
            tasks[f"{key} {kind}"] = task
    windows = suitable_step(scene, duration).windows
    if windows is not None:
        for number in per_sample:
            stepper = gj.FixedStep(per_sample=number, windows=windows)
            tasks[f"windows {number}"] = jax.jit(
                lambda stepper=stepper: recorded(gj.simulate(scene, ts, torque, stepper=stepper))
            )
    results, first, times = interleaved(tasks, repeats)
    print(f"{name}, {torque:g} N m, {duration:g} s")
    curves = {}
    for key in ("fitted", "modes", "windows"):
        rows = [f"{key} {number}" for number in per_sample if f"{key} {number}" in tasks]
        errors = [float(np.abs(np.asarray(results[row][0]) - truth).max() / np.ptp(truth)) for row in rows]
        for row, error in zip(rows, errors, strict=True):
            print(f"  {row:16s} {1e3 * times[row]:8.2f} ms  first {first[row]:5.1f} s  error {error:.1e}")
        curves[key] = errors, [times[row] for row in rows]
    errors, own = curves["modes"]
    for key in ("fitted", "windows"):
        if curves[key][0]:
            ratios = [mine / time_at(*curves[key], error) for error, mine in zip(errors, own, strict=True)]
            print(f"  modes over {key} at equal error: " + ", ".join(f"{ratio:.2f}" for ratio in ratios))
    for kind in ("primal", "reverse", "forward", "lanes"):
        mine, other = (times[f"{key} {kind}"] for key in ("modes", "fitted"))
        over = [times[f"{key} {kind}"] / times[f"{key} primal"] for key in ("modes", "fitted")]
        print(f"  {kind}: modes {mine / other:.2f} of fitted; over their primals {over[0]:.2f} and {over[1]:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    examples = {
        "two_kv/wang_2020.toml": (100.0, 1.0, 201, (8, 16, 32, 64)),
        "rv_cycloidal/hu_2020.toml": (784.0, 0.002, 21, (48, 96, 192)),
    }
    for name, (torque, duration, samples, per_sample) in examples.items():
        if given.only in name:
            measure(name, torque, duration, samples, per_sample, given.repeats)
