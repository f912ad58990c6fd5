# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Speed against accuracy, and what breaks at the extremes
#
# A motion can be computed in steps of any length, in windows side by side, in float32, or not at all, where the static
# TE will do. What does each choice cost, and how far off is it? And what does gearjax do at extreme stiffness, mass and
# damping? One to two minutes. `gearjax tradeoff CONFIG` answers the first question for a scene of yours.

# %%
import dataclasses
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax.config.examples import examples
from gearjax.units import arcmin

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)
scene = gj.load(examples()["two_kv"] / "wang_2020.toml")
ts = jnp.linspace(0.0, 1.0, 1001)
TORQUE = 100.0


def measured(stepper, scene=scene, ts=ts):
    """TE of a record, and the seconds that it takes once it is compiled: the median of five runs."""
    run = eqx.filter_jit(lambda: gj.simulate(scene, ts, TORQUE, stepper=stepper).te)
    te = run().block_until_ready()
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        run().block_until_ready()
        seconds.append(time.perf_counter() - start)
    return np.asarray(te, float), float(np.median(seconds))


# %% [markdown]
# ## Steps, schemes, windows
# The yardstick is Runge-Kutta with steps of 0.5 us. Each choice has its place by its time and by the largest error of
# its samples. Down and to the left is better. Runge-Kutta has half the error of the fitted scheme at the same step, and
# takes some twenty times as long: three times its step costs less and errs less. Windows use the cores side by side.

# %%
truth, _ = measured(gj.FixedStep(0.5e-6, solver=gj.RungeKutta4()))
choices = {"fitted scheme": [], "fitted, 16 windows": [], "Runge-Kutta": []}
for step in (4e-6, 1e-5, 2.5e-5, 5e-5):
    choices["fitted scheme"].append(gj.FixedStep(step))
    choices["fitted, 16 windows"].append(gj.FixedStep(step, windows=gj.Windows(16, 0.03)))
    choices["Runge-Kutta"].append(gj.FixedStep(step, solver=gj.RungeKutta4()))
figure, axes = plt.subplots()
for (name, steppers), marker in zip(choices.items(), "os^", strict=True):
    points = []
    for stepper in steppers:
        te, seconds = measured(stepper)
        points.append((1e3 * seconds, np.abs(te - truth).max() / arcmin))
        print(f"{name:20} step {stepper.step:.1e} s: {points[-1][0]:8.3f} ms, error {points[-1][1]:.1e} arcmin")
    axes.loglog(*zip(*points, strict=True), marker=marker, label=name)
static = gj.transmission_error(scene, scene.system.input_speed * ts, TORQUE).te
axes.axhline(np.abs(np.asarray(static) - truth).max() / arcmin, color="0.5", linestyle=":", label="static TE instead")
axes.set_xlabel("time of one record of 1 s [ms]")
axes.set_ylabel("largest error of a sample [arcmin]")
axes.legend()
figure.savefig(OUT / "speed_and_accuracy.svg")

# %% [markdown]
# ## float32
# Half of the memory, and on processors twice the speed in large batches (on an accelerator 1.2 times). Rounding adds to
# the error of the steps.

# %%
with jax.enable_x64(False):
    single = gj.load(examples()["two_kv"] / "wang_2020.toml")
    rough, _ = measured(gj.FixedStep(1e-5), single, jnp.linspace(0.0, 1.0, 1001))
fine, _ = measured(gj.FixedStep(1e-5))
print(f"float32 against float64 at the same step: {np.abs(rough - fine).max() / arcmin:.1e} arcmin")

# %% [markdown]
# ## At the extremes
# Stiffness, mass and damping over many powers of ten, the step left to gearjax: `gj.chosen_steps` says what it takes. A
# step that is too long for a pair is refused before it blows up. Over many periods of the oscillation the mean is that
# of the static TE: every record stays within a hundredth of its size.

# %%
few = jnp.linspace(0.0, 0.1, 201)
for stiffness, mass in ((1e6, 3.0), (1e8, 300.0), (1e8, 0.03), (1e10, 3.0)):
    for ratio in (0.0, 1.0):
        extreme = dataclasses.replace(
            scene,
            compliance=gj.HarmonicStiffness(stiffness, np.array([0.1]), np.array([0.0])),
            damping=gj.DampingRatio(ratio),
            inertia=gj.EquivalentMass(mass),
        )
        chosen = gj.chosen_steps(extreme, few, TORQUE)
        motion = gj.simulate(extreme, few, TORQUE)
        still = gj.transmission_error(extreme, extreme.system.input_speed * few, TORQUE)
        told = f"{motion.mean / arcmin:9.4f} arcmin, static {still.mean / arcmin:9.4f}"
        print(f"k = {stiffness:.0e} N/m, m = {mass:5} kg, zeta = {ratio}: step {chosen.step:.1e} s, mean {told}")
        assert abs(motion.mean - still.mean) < 0.01 * np.abs(still.te).max()
try:
    gj.simulate(extreme, few, TORQUE, stepper=gj.FixedStep(1e-3))
except gj.SceneError as fault:
    print("refused:", fault)

# %% [markdown]
# What to change next: `TORQUE`, down to where teeth lift off; `gj.AdaptiveStep(rtol=1e-9, atol=1e-12)` as another
# yardstick; the scene, to a reducer of your own.
