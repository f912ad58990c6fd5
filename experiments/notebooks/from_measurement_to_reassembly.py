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
# # From measurement to reassembly
#
# A reducer was measured on a test bench: input and output angle under two torques and in both directions. Which errors
# explain its transmission error? Which errors can the recordings not determine? And how should the reducer be
# reassembled? This page runs for about a minute. Its recordings are synthetic; `gj.read_measurement` reads your own
# (CSV with names and units).

# %%
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax.config.examples import examples
from gearjax.plot.identification import comparison_figure, estimates_figure, residual_figure
from gearjax.units import arcmin, deg, um

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)
scene = gj.load(examples()["two_kv"] / "measured.toml")  # geometry, and the unknown errors

# %% [markdown]
# ## The unit on the bench
# The errors of the unit are known here; the identification does not use them. The bench adds an order that the gear set
# does not have: a coupling that turns three times per turn of the output.

# %%
rng = np.random.default_rng(2)
names = ["planet_1", "planet_2", "revolution", "output_wheel"]
unit = eqx.tree_at(
    lambda s: [getattr(s.errors[name], key) for name in names for key in ("amplitude", "phase")],
    scene,
    [jnp.array(value) for _ in names for value in (rng.uniform(5, 16) * um, rng.uniform(0, 2 * np.pi))],
)
rig = {3 * scene.system.orders["output"]: (0.15 * arcmin, 1.0)}
bench = {"rows": 4000, "input_counts": 2**18, "output_counts": 2**22, "noise": 0.05 * arcmin}
bench |= {"waves": rig, "ripple": 0.02}
runs = [gj.synthetic_measurement(unit, torque, key=i, **bench) for i, torque in enumerate((10.0, 150.0, -40.0))]

# %% [markdown]
# ## What explains it?

# %%
found = gj.identify(scene, runs)
for each in found.estimates:
    error = "not identified" if each.error is None else f"± {1.96 * each.error:.3g}"
    print(f"{each.name:28} {each.value:12.5g} {error} {each.unit}")
print("\nidentified only as a sum:")
for each in found.visible.combinations:
    print(f"  {each.words} = {each.value:.3f} ± {1.96 * each.error:.3f} {each.unit}")
print("\nhidden:", *found.hidden, sep="\n  ")
print("\norders that the gear set does not explain:")
for order in found.orders:
    print(f"  {order.name}: {order.amplitude:.3f} arcmin ({order.body})")

# %%
figure = comparison_figure(gj.compare(found.scene, runs[:1]))
figure.savefig(OUT / "from_measurement_to_reassembly.svg")
figure

# %%
figure = residual_figure(found)
figure.savefig(OUT / "from_measurement_to_reassembly_2.svg")
figure

# %% [markdown]
# ## Reassemble now, or measure once more?
# Both planet wheels can be turned in their seats. The three recordings leave some errors undetermined, so the advice is
# uncertain. `gj.reassemble` reports this uncertainty, and how one more recording, after turning one of the wheels,
# would change it. For this, steps of five of their 50 teeth are fine enough.

# %%
planets = ["errors.planet_1", "errors.planet_2"]
advice = gj.reassemble(found, planets, steps=dict.fromkeys(planets, 10))
print(f"now: {advice.gain.median:.2f} of the TE's standard deviation, worse in {100 * advice.gain.worse:.0f} %")
assert advice.second is not None
print(f"after {advice.second_words}: {advice.second.median:.2f}, worse in {100 * advice.second.worse:.0f} %")
print("best next recording:", found.suggestions[0].words)

# %%
turned = gj.synthetic_measurement(unit, 150.0, key=9, turned={"errors.planet_1": 90 * deg}, name="turned", **bench)
settled = gj.identify(scene, [*runs, turned])
print("hidden now:", settled.hidden)
figure = estimates_figure(settled)
figure.savefig(OUT / "from_measurement_to_reassembly_3.svg")
figure

# %%
advice = gj.reassemble(settled, planets, steps=dict.fromkeys(planets, 50))  # in steps of one tooth
for path, angle in advice.turns.items():
    print(f"turn {path.partition('.')[2]} by {angle / deg:.1f} deg")
print(f"promised: {advice.gain.low:.2f} to {advice.gain.high:.2f} of the standard deviation")

# %% [markdown]
# ## Did it help?
# This can be checked only with a synthetic unit, whose true errors are known. The unit is turned as advised.

# %%
theta = np.linspace(0.0, scene.system.cycle, 4001)
moved = eqx.tree_at(
    lambda s: [s.errors["planet_1"].phase, s.errors["planet_2"].phase],
    unit,
    [unit.errors[path.partition(".")[2]].phase + advice.turns[path] for path in planets],
)
before, after = (float(gj.transmission_error(each, theta).std / arcmin) for each in (unit, moved))
print(f"standard deviation without load: {before:.3f} -> {after:.3f} arcmin, {after / before:.2f}")

# %% [markdown]
# What to change next: your own files in `runs`, a smaller torque, `priors={"errors.revolution": 3e-6}` from the
# drawing, `gj.posterior(settled)` to check the intervals, `gj.export_joint(settled.scene, "joint", torque=150.0)` for
# the simulation of a robot.
