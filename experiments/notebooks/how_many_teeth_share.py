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
# # Involute RV reducer: how many teeth share one load, and what a clearance buys
#
# An internal pair of 236 in 240 teeth: the flanks are so nearly parallel that six or seven pairs come into contact as
# the teeth give way. Half a minute.

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
from gearjax.units import arcmin, um

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)
scene = gj.load(examples()["involute_rv"] / "yang_2019.toml")
mesh = jnp.linspace(0.0, 2 * jnp.pi / 240, 41)  # a mesh period of the crank

# %%
for torque in (5.0, 25.0, 100.0):
    te = gj.transmission_error(scene, mesh, torque=torque)
    carry = np.asarray(te.engaged_pairs)
    largest = float(te.pair_forces.max())
    print(f"{torque:5.0f} N m: {carry.min()} to {carry.max()} pairs carry, the most loaded one {largest:.0f} N")

# %% [markdown]
# ## The load of each pair as it goes through the mesh
# Pairs take over from each other; how far apart their flanks were before the load decides how much each takes.

# %%
te = gj.transmission_error(scene, mesh, torque=100.0)
figure, axes = plt.subplots(figsize=(8, 4))
axes.plot(mesh / mesh[-1], te.pair_forces, linewidth=1)
axes.set_xlabel("mesh period [-]")
axes.set_ylabel("load of each pair at 100 N m [N]")
figure.savefig(OUT / "how_many_teeth_share.svg")

# %% [markdown]
# ## Stiffness
# How far the output lags under a torque (secant), and how it moves about that position (tangent).

# %%
stiffness = gj.mesh_stiffness(scene, mesh, 100.0)
print(f"secant  {float(stiffness.secant.mean()) * arcmin:.0f} N m/arcmin")
print(
    f"tangent {float(stiffness.tangent.mean()) * arcmin:.0f} N m/arcmin, ripple {100 * float(stiffness.ripple):.0f} %"
)

# %% [markdown]
# ## What a relief at the tips buys
# The flanks lie on each other, but where the corner of a tip touches, the pressure is highest. A relief of 0.2 um
# takes the corner away, and a little of the stiffness; more of it buys nothing.

# %%
for relief in (0.0, 0.2, 0.5, 1.0):
    errors = dict(scene.errors) | ({"tips": gj.TipRelief("gear_1", relief * um, 3e-4)} if relief else {})
    each = dataclasses.replace(scene, errors=errors)
    te = gj.transmission_error(each, mesh, torque=100.0)
    pressure, carry = float(gj.contact_pressure(each, te).max()) / 1e6, np.asarray(te.engaged_pairs)
    words = f"{carry.min()} to {carry.max()} pairs, highest pressure {pressure:.0f} MPa"
    print(f"{relief:3.1f} um: {words}, mean TE {float(te.mean) / arcmin:.4f} arcmin")

# %% [markdown]
# What to change next: `[compliance]` by finite elements of the package (extra `fem`), errors of single teeth, tooth
# numbers in `gearjax new involute_rv > mine.toml`.
