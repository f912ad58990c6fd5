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
# # First transmission error, and what its curve says
#
# The 2K-V reducer of this page has four eccentric bodies (an eccentricity is half of the run-out that a dial gauge
# shows). How far is its output from the position that the ideal ratio gives, without load and under torque? Ten lines
# compute this transmission error (TE); the rest explains its curve. The page takes some twenty seconds, mostly to
# compile.

# %%
import dataclasses
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax.config.examples import examples
from gearjax.plot import schematic_figure
from gearjax.units import arcmin, um

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)
scene = gj.load(examples()["two_kv"] / "wang_2020.toml")
theta = jnp.linspace(0.0, scene.system.cycle, 4001)  # input angle [rad], one cycle of the errors
free = gj.transmission_error(scene, theta)
loaded = {torque: gj.transmission_error(scene, theta, torque=torque) for torque in (30.0, 100.0, 300.0)}
print(f"without load: peak-to-peak {free.peak_to_peak / arcmin:.3f} arcmin, std {free.std / arcmin:.3f} arcmin")
for torque, te in loaded.items():
    print(f"{torque:5.0f} N m: peak-to-peak {te.peak_to_peak / arcmin:.3f} arcmin, mean {te.mean / arcmin:.3f} arcmin")

# %% [markdown]
# ## The curve
# A torque on the output makes the output lag, so the curve moves down. The larger the torque, the smoother the curve.
# One pair of teeth carries the load alone if the eccentricities put it well ahead of the other pair; both pairs carry
# if they are nearly level. The curve has a kink where the other pair comes into contact.

# %%
turns = theta / (2 * jnp.pi)
figure, axes = plt.subplots(2, 1, sharex=True, figsize=(8, 6))
for name, te in {"without load": free, **{f"{torque:g} N m": te for torque, te in loaded.items()}}.items():
    axes[0].plot(turns, te.te / arcmin, label=name, linewidth=1)
axes[0].set_ylabel("transmission error [arcmin]")
axes[0].legend(loc="upper right", ncols=4, fontsize=8)
for pair, forces in enumerate(loaded[100.0].pair_forces.T):
    axes[1].plot(turns, forces / 1e3, linewidth=1, color=f"C{4 + pair}", label=f"planet wheel {pair + 1}")
axes[1].legend(loc="upper right", ncols=2, fontsize=8)
axes[1].set_ylabel("tooth forces at 100 N m [kN]")
axes[1].set_xlabel("turns of the input")
figure.savefig(OUT / "first_te.svg")
print(f"figures are written to {OUT}")

# %% [markdown]
# ## The gear set
# The drawing shows the bodies at input angle zero. gearjax draws every gear set in this way (a run writes the drawing
# as `schematic.png`). A dashed line on each body shows the direction of phase zero, an arc the sense in which phases
# count, and a thick arrow the eccentricity. The sun turns the crank, which carries both planet wheels around in the
# fixed ring. The planet wheels turn slowly in the opposite sense, and the output turns with them. A positive
# transmission error means that the output is ahead of its ideal position.

# %%
drawing = schematic_figure(scene)
drawing.savefig(OUT / "first_te_bodies.svg")
drawing

# %% [markdown]
# ## Which body makes which wave
# Each eccentricity turns with its body. What counts is the turn of the body relative to the line of action, which goes
# around the ring with the crank. `scene.system.orders` gives how often the waves repeat per turn of the input. In it,
# `planet` is the order of both planet wheels and of the revolution (26 per turn of the output), `crank` that of the
# output wheel (25 per turn of the output). `output` is one turn of the output: no body makes this wave alone, it comes
# from the difference of the other two, as the pair in contact changes. Without load, the eccentricities cause the
# largest waves of the TE.

# %%
count = 8192
theta = jnp.arange(count) * (scene.system.cycle / count)  # whole cycles: each line of the spectrum is one order
te = gj.transmission_error(scene, theta).te
amplitudes = 2 / count * np.abs(np.fft.rfft(te))
orders = np.arange(amplitudes.size) * (2 * np.pi / scene.system.cycle)
for line in np.argsort(-amplitudes[1:])[:4] + 1:
    waves = {f"{n} x {body}": n * order for body, order in scene.system.orders.items() for n in (1, 2, 3)}
    near = min(waves, key=lambda name: abs(waves[name] - orders[line]))
    print(f"order {orders[line]:.4f} per turn of the input: {amplitudes[line] / arcmin:.3f} arcmin ({near})")

# %% [markdown]
# ## What would a better bearing seat buy?
# One gradient answers for all eccentricities at once: how much the peak-to-peak TE falls per micrometre less of each.
# A negative value means that a smaller eccentricity makes it worse. The last column is the change that one micrometre
# less really brings. The names are listed once, outside: inside `tree_at` and other functions of JAX a dictionary is
# sorted by its keys.

# %%
names = list(scene.errors)


def peak_to_peak(amplitudes):
    changed = eqx.tree_at(lambda s: [s.errors[name].amplitude for name in names], scene, list(amplitudes))
    return gj.transmission_error(changed, theta).peak_to_peak


amplitudes = jnp.array([scene.errors[name].amplitude for name in names])
slopes = np.asarray(jax.grad(peak_to_peak)(amplitudes))
before = peak_to_peak(amplitudes)
assert np.isclose(before, gj.transmission_error(scene, theta).peak_to_peak)
for place, name in enumerate(names):
    less = before - peak_to_peak(amplitudes.at[place].add(-um))
    print(f"{name:14} {slopes[place] * um / arcmin:+.4f} arcmin per um; 1 um less: {less / arcmin:+.4f} arcmin")

# %% [markdown]
# ## A reducer with other tooth numbers
# Here a planet wheel with 60 teeth rolls in a ring with 62 teeth. The difference of the tooth numbers is the same, so
# the working pressure angle does not change. The errors turn at other orders and repeat after another input angle.
# The TE falls to 50/60 for a plain reason: with the same module the wheels are 1.2 times as large, and the same
# micrometres turn the output by less.

# %%
other = dataclasses.replace(scene, system=dataclasses.replace(scene.system, planet_teeth=60, ring_teeth=62))
whole = jnp.linspace(0.0, other.system.cycle, 4001)
changed = gj.transmission_error(other, whole).peak_to_peak
print(f"peak-to-peak: {changed / arcmin:.3f} arcmin of 60/62 teeth, {free.peak_to_peak / arcmin:.3f} of 50/52")

# %% [markdown]
# What to change next: `gearjax new two_kv > mine.toml` and `gj.load("mine.toml")` for a reducer of your own; the
# phases of the eccentricities (page `assembly_phases`); their tolerances (page `tolerance_study`).
