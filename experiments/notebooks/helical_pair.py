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
# # Helical pair: from micro-geometry to vibration
#
# Teeth deflect under load, so the next pair comes into contact too early. Reliefs and crowning compensate for this at
# one torque. For a range of torques they are a compromise, which gradients find. The vibration over the speed then
# shows how much the micro-geometry improves. This page runs for about a minute.

# %%
import dataclasses
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax.config.examples import examples
from gearjax.plot import waterfall_figure
from gearjax.units import arcmin, rpm, um

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)
scene = gj.load(examples()["helical"] / "guo_2018_optimise.toml")  # without any modification
mesh = jnp.linspace(0.0, 2 * jnp.pi / scene.system.pinion_teeth, 33)  # one mesh period, as an angle of the pinion
torques = (400.0, 600.0, 830.0)

# %% [markdown]
# ## Without modifications
# The TE under load varies with the mesh stiffness, in proportion to the torque.

# %%
for torque in torques:
    te = gj.transmission_error(scene, mesh, torque=torque)
    print(f"{torque:4.0f} N m: peak-to-peak {te.peak_to_peak / arcmin:.4f} arcmin")

# %% [markdown]
# ## Relief and crowning for a range of torques
# The objective is the sum of the peak-to-peak TE under three torques. It is minimised by gradients from four starts.

# %%
paths = ["errors.tip.amount[0]", "errors.root.amount[0]", "errors.crowning.amount[0]"]
bounds = {paths[0]: (0.0, 40 * um), paths[1]: (0.0, 40 * um), paths[2]: (0.0, 20 * um)}
goal = [gj.Term("static_peak_to_peak", torque=torque) for torque in torques]
found = gj.minimise(goal, scene, where=paths, theta=mesh, bounds=bounds, starts=4)
for path, value in zip(paths, found.best, strict=True):
    print(f"{path.split('.')[1]:9} {value / um:5.1f} um")
tip, root, crowning = (jnp.reshape(jnp.asarray(value), (1,)) for value in found.best)
chosen = {"tip": tip, "root": root, "crowning": crowning}
errors = {name: dataclasses.replace(scene.errors[name], amount=amount) for name, amount in chosen.items()}
modified = dataclasses.replace(scene, errors=errors)

span = np.linspace(100.0, 1000.0, 10)
figure, axes = plt.subplots(figsize=(7, 4))
for name, each in {"without": scene, "modified": modified}.items():
    swing = jax.vmap(lambda torque, each=each: gj.transmission_error(each, mesh, torque=torque).peak_to_peak)
    axes.plot(span, swing(jnp.asarray(span)) / arcmin, "o-", label=name)
axes.set_xlabel("torque on the wheel [N m]")
axes.set_ylabel("peak-to-peak of the TE [arcmin]")
axes.set_ylim(bottom=0.0)
axes.legend()
for torque in torques:
    te = gj.transmission_error(modified, mesh, torque=torque)
    print(f"{torque:4.0f} N m: peak-to-peak {te.peak_to_peak / arcmin:.4f} arcmin")
figure.savefig(OUT / "helical_pair.svg")

# %% [markdown]
# ## The vibration over the speed
# Both gears are free to turn, and every slice of the contact lines has its own spring and damper. One batch computes
# the motion that repeats with the mesh, at 50 speeds. There is a resonance where a harmonic of the mesh frequency meets
# the natural frequency.

# %%
parts = {"inertia": gj.MomentOfInertia(0.0587), "damping": gj.DampingRatio(0.07)}
speeds = jnp.linspace(400.0, 12000.0, 50) * rpm
figure, axes = plt.subplots(figsize=(7, 4))
for name, each in {"without": scene, "modified": modified}.items():
    moving = dataclasses.replace(each, load=gj.ConstantLoad(), **parts)
    shaking = gj.waterfall(moving, 830.0, speeds, steps=64)
    axes.plot(speeds / rpm, shaking.dynamic_factor, label=name)
    worst = int(np.argmax(shaking.dynamic_factor))
    print(f"{name}: dynamic factor up to {shaking.dynamic_factor[worst]:.3f}, at {speeds[worst] / rpm:.0f} rpm")
axes.set_xlabel("speed of the pinion [rpm]")
axes.set_ylabel("dynamic factor at 830 N m [-]")
axes.legend()
figure.savefig(OUT / "helical_pair_2.svg")

# %%
figure = waterfall_figure(shaking, gj.natural_modes(moving, 830.0))
figure.savefig(OUT / "helical_pair_3.svg")
figure

# %% [markdown]
# What to change next: `youngs_modulus` and bores in the configuration, flanks from a measuring machine
# (`gj.MeasuredFlank`, `guo_2018_measured.toml`), bodies on bearings (`[supports.pinion]`), tolerances of the amounts of
# relief and crowning (`guo_2018_tolerance.toml`).
