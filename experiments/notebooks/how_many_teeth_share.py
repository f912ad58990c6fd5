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
# An external gear with 236 teeth runs in an internal gear with 240 teeth. Their flanks are nearly parallel, so that six
# or seven pairs come into contact as the teeth deflect. This page runs for half a minute.

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
from gearjax.units import arcmin, mm, um

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)
scene = gj.load(examples()["involute_rv"] / "yang_2019.toml")
mesh = jnp.linspace(0.0, 2 * jnp.pi / 240, 41)  # one mesh period, as an angle of the crank

# %%
for torque in (5.0, 25.0, 100.0):
    te = gj.transmission_error(scene, mesh, torque=torque)
    carry = np.asarray(te.engaged_pairs)
    largest = float(te.pair_forces.max())
    print(f"{torque:5.0f} N m: {carry.min()} to {carry.max()} pairs carry, the most loaded one {largest:.0f} N")

# %% [markdown]
# ## The load of each pair as it goes through the mesh
# The pairs take over the load from one another. The gap between the flanks of a pair without load decides how much of
# the load the pair takes.

# %%
te = gj.transmission_error(scene, mesh, torque=100.0)
figure, axes = plt.subplots(figsize=(8, 4))
axes.plot(mesh / mesh[-1], te.pair_forces, linewidth=1)
axes.set_xlabel("mesh period [-]")
axes.set_ylabel("load of each pair at 100 N m [N]")
figure.savefig(OUT / "how_many_teeth_share.svg")

# %% [markdown]
# ## Stiffness
# The secant stiffness gives the lag of the output under a torque. The tangent stiffness gives the motion about that
# loaded position.

# %%
stiffness = gj.mesh_stiffness(scene, mesh, 100.0)
print(f"secant  {float(stiffness.secant.mean()) * arcmin:.0f} N m/arcmin")
print(
    f"tangent {float(stiffness.tangent.mean()) * arcmin:.0f} N m/arcmin, ripple {100 * float(stiffness.ripple):.0f} %"
)

# %% [markdown]
# ## What a relief at the tips buys
# The flanks lie against each other, but the pressure is highest where the corner of a tip touches. A tip relief of
# 0.2 um removes the contact at the corner, and reduces the stiffness a little. More relief has no further benefit.

# %%
for relief in (0.0, 0.2, 0.5, 1.0):
    errors = dict(scene.errors) | ({"tips": gj.TipRelief("gear_1", relief * um, 3e-4)} if relief else {})
    each = dataclasses.replace(scene, errors=errors)
    te = gj.transmission_error(each, mesh, torque=100.0)
    pressure, carry = float(gj.contact_pressure(each, te).max()) / 1e6, np.asarray(te.engaged_pairs)
    words = f"{carry.min()} to {carry.max()} pairs, highest pressure {pressure:.0f} MPa"
    print(f"{relief:3.1f} um: {words}, mean TE {float(te.mean) / arcmin:.4f} arcmin")

# %% [markdown]
# ## What a clearance between the flanks buys
# A smaller centre distance moves the gear away from the ring and opens a clearance between the back flanks. It gives
# backlash, but no better sharing of the load: the same pairs carry nearly the same loads, because the driving flanks
# lie against each other as before.

# %%
for distance in (1.4997, 1.49, 1.48):
    each = dataclasses.replace(scene, system=dataclasses.replace(scene.system, centre_distance=distance * mm))
    te = gj.transmission_error(each, mesh, torque=100.0)
    carry, clearance = np.asarray(te.engaged_pairs), float(each.system.pair.backlash) / um
    words = f"{carry.min()} to {carry.max()} pairs, the most loaded one {float(te.pair_forces.max()):.0f} N"
    print(f"{distance:.4f} mm: clearance {clearance:4.1f} um, {words}")

# %% [markdown]
# What to change next: `[compliance]` by the finite elements of the package (extra `fem`), errors of single teeth, the
# tooth numbers in `gearjax new involute_rv > mine.toml`.
