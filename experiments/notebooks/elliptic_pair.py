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
# # Elliptic pair: a ratio that changes, and what errors make of it
#
# Two ellipses that roll on each other turn the driven gear faster and slower within each turn. How do run-out and a
# wrong centre distance change this motion? And how fast may the pair turn before the inertia of the output separates
# the teeth? This page runs for some twenty seconds.

# %%
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
import dataclasses

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax.config.examples import examples
from gearjax.units import arcmin, deg, rpm, um

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)
pair = gj.load(examples()["elliptic"] / "dong_2020.toml")
turn = jnp.linspace(0.0, 2 * jnp.pi, 361)

# %% [markdown]
# ## The ratio that is wanted, and its error
# The ratio is the derivative of the ideal output angle with respect to the input angle. Run-out and a wrong centre
# distance add a TE to the output angle. The derivative of the TE is the error of the ratio.

# %%
ratio = jax.vmap(jax.grad(lambda angle: type(pair.system).output(pair.system, angle)))(turn)
te, error = gj.transmission_error(pair, turn), gj.ratio_error(pair, turn)
figure, axes = plt.subplots(3, 1, sharex=True, figsize=(7, 7))
axes[0].plot(turn / deg, ratio)
axes[0].set_ylabel("ratio [-]")
axes[1].plot(turn / deg, te.te / arcmin)
axes[1].set_ylabel("TE [arcmin]")
axes[2].plot(turn / deg, 1e3 * error.error)
axes[2].set_ylabel("ratio error [1e-3]")
axes[2].set_xlabel("input angle [deg]")
print(f"ratio {float(ratio.min()):.3f} to {float(ratio.max()):.3f}, TE {te.peak_to_peak / arcmin:.3f} arcmin")
figure.savefig(OUT / "elliptic_pair.svg")

# %% [markdown]
# ## Which error matters?
# The code computes the gradient of the peak-to-peak TE with respect to both eccentricities. Then it finds the phase of
# the driven gear's eccentricity at which the peak-to-peak TE is smallest.

# %%
names = [name for name, each in pair.errors.items() if isinstance(each, gj.Eccentricity)]


def peak_to_peak(amplitudes):
    changed = eqx.tree_at(lambda s: [s.errors[name].amplitude for name in names], pair, list(amplitudes))
    return gj.transmission_error(changed, turn).peak_to_peak


slopes = jax.grad(peak_to_peak)(jnp.array([pair.errors[name].amplitude for name in names]))
for name, slope in zip(names, slopes, strict=True):
    print(f"{name:10} {float(slope) * um / arcmin:+.4f} arcmin per um")
found = gj.minimise("no_load_peak_to_peak", pair, where=[f"errors.{names[-1]}.phase"], theta=turn, starts=8)
best = float(found.objective) / arcmin
print(f"{names[-1]} turned to {float(found.best[0]) / deg % 360:.0f} deg: {best:.3f} arcmin")

# %% [markdown]
# ## How fast before teeth lift off?
# The output speeds up and slows down within each turn. Above a certain input speed, the load torque is too small to
# decelerate the output, and the teeth separate.

# %%
for torque in (5.0, 10.0, 20.0):
    print(f"{torque:4.0f} N m: teeth stay in contact up to {float(gj.separation_speed(pair, torque)) / rpm:.0f} rpm")
limit = float(gj.separation_speed(pair, 10.0))
for share in (0.8, 1.2):
    fast = dataclasses.replace(pair, system=dataclasses.replace(pair.system, input_speed=share * limit))
    motion = gj.simulate(fast, jnp.linspace(0.0, 4 * np.pi / (share * limit), 4001), 10.0)
    apart = 100 * float(np.mean(~np.any(np.asarray(motion.forces) > 0, axis=1)))
    print(f"at {share:g} of that speed: no tooth touches in {apart:.1f} % of the time")

# %% [markdown]
# What to change next: `gj.NoncircularPair` with a ratio of your own (a table or a function), `clearance = "exact"`,
# more lobes (`two_lobes.toml`), profiles as DXF (`gj.export_profile(pair, "driven.dxf", body="driven")`).
