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
# # A gear set of one's own, from a sketch of its contact to its transmission error
#
# gearjax describes a gear set by its contacts alone: where they are, how the output moves them, how errors of bodies
# open them. Two spur gears with run-out need one class of some 40 lines. Every analysis then works for them: TE,
# backlash, forces, motion, gradients, batches, tolerances, identification. This page runs for half a minute, mostly to
# compile.
#
# The sketch: the teeth touch along the line of action, which is inclined by the pressure angle. The driving flank is on
# one side, the back flank on the other. If the output turns by `q`, a contact closes by `lever * q`. An eccentricity
# `e` of a gear that has turned by `angle` contributes `e sin(angle + phase + pressure angle)` along the line of action.

# %%
import math
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import jax

jax.config.update("jax_enable_x64", True)
import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax import units
from gearjax.contact import BodyView, Layout, Pose, Request
from gearjax.parameters import check_parameters, count, length, number
from gearjax.typing import Number, Scalar

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)


# %%
@gj.register
class TwoSpurWheels(gj.AbstractSystem):
    """Two spur wheels with run-out: one contact per flank."""

    kind: ClassVar[str] = "two_spur_wheels"
    pinion_teeth: int = count()
    wheel_teeth: int = count()
    wheel_base_radius: Number = length(above=0.0)
    pressure_angle: Number = number(units.ANGLE, above=0.0)
    input_speed: Number = number(units.ANGULAR_SPEED, above=0.0)

    def __check_init__(self):
        check_parameters(self)

    @property
    def bodies(self) -> tuple[str, ...]:
        return ("pinion", "wheel")

    # Cycles per turn of the input of every wave in the gaps, so that angles and time steps resolve it. "mesh" may vary
    # the stiffness only: gaps that change from tooth to tooth name the teeth again, as "tooth".
    @property
    def orders(self) -> Mapping[str, float]:
        return {"output": self.pinion_teeth / self.wheel_teeth, "mesh": float(self.pinion_teeth)}

    @property
    def cycle(self) -> float:  # input angle after which everything repeats [rad]
        return 2 * math.pi * self.wheel_teeth / math.gcd(self.pinion_teeth, self.wheel_teeth)

    def layout(self, request: Request) -> Layout:
        return Layout.of_flanks(1, request.back)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        side = jnp.asarray(self.layout(request).side, theta.dtype)
        turned = {"pinion": theta, "wheel": -self.pinion_teeth / self.wheel_teeth * theta}
        sign = {"pinion": -side, "wheel": side}  # change of the gap per shift of the body along the line of action
        # angle of the body and of its mark from the line of action, and that sign, for each contact
        views = {body: BodyView(turned[body], side * self.pressure_angle, sign[body]) for body in request.bodies}
        mesh = jnp.reshape(self.pinion_teeth * theta, (1,)) if request.mesh else None  # a phase for each pair of teeth
        # levers of driving flanks are negative: they close when the output turns back
        return Pose(theta, -side[:, None] * self.wheel_base_radius, jnp.zeros_like(side), views, mesh)


# %% [markdown]
# ## It is a configuration now
# The fields of the class are now keys of a configuration, with the units, bounds and error messages that were declared.

# %%
scene = gj.loads("""
[system]
kind = "two_spur_wheels"
pinion_teeth = 20
wheel_teeth = 31
wheel_base_radius = "30 mm"
pressure_angle = "20 deg"
input_speed = "600 rpm"
[errors.pinion_runout]
kind = "eccentricity"
body = "pinion"
amplitude = "8 um"
phase = "10 deg"
[errors.wheel_runout]
kind = "eccentricity"
body = "wheel"
amplitude = "15 um"
phase = "70 deg"
[backlash]
initial = "0.1 mm"
[compliance]
kind = "harmonic_stiffness"
mean = "2e8 N/m"
relative_amplitudes = [0.1]
phases = ["0 deg"]
[inertia]
mass = "2 kg"
[damping]
ratio = 0.08
[load]
kind = "constant"
""")
theta = jnp.linspace(0.0, scene.system.cycle, 2001)
te = gj.transmission_error(scene, theta)

# %% [markdown]
# ## Against the sketch, by hand
# The TE by hand is the sum of both eccentricities along the line of action, divided by the base radius of the wheel.

# %%
lean = math.radians(20)
by_hand = 8e-6 * np.sin(theta + lean + math.radians(10)) - 15e-6 * np.sin(-20 / 31 * theta + lean + math.radians(70))
print("off by at most", float(np.abs(te.te - by_hand / 0.03).max()), "rad")
assert np.abs(te.te - by_hand / 0.03).max() < 1e-14

# %% [markdown]
# ## And it has all the rest
# Two examples: the motion under a load, and the influence of each run-out on the peak-to-peak TE.

# %%
motion = gj.simulate(scene, jnp.linspace(0.0, 3.1, 6001), 20.0, settle=0.05)
figure, axes = plt.subplots(figsize=(8, 4))
axes.plot(theta / (2 * jnp.pi), te.te / units.arcmin, label="without load")
axes.plot(
    motion.ts * scene.system.input_speed / (2 * jnp.pi),
    motion.te / units.arcmin,
    label="in motion, 20 N m",
    linewidth=0.7,
)
axes.set_xlabel("turns of the input")
axes.set_ylabel("transmission error [arcmin]")
axes.legend()


names = list(scene.errors)  # listed outside: inside functions of JAX a dictionary is sorted by its keys


def peak_to_peak(amplitudes):
    changed = eqx.tree_at(lambda s: [s.errors[name].amplitude for name in names], scene, list(amplitudes))
    return gj.transmission_error(changed, theta).peak_to_peak


slopes = jax.grad(peak_to_peak)(jnp.array([8e-6, 15e-6]))
for name, slope in zip(names, slopes, strict=True):
    print(f"{name}: {slope * units.um / units.arcmin:.4f} arcmin per um")
figure.savefig(OUT / "own_gear_set.svg")

# %% [markdown]
# What to change next: several pairs (`Layout.of_flanks(2, ...)`), levers that change with the angle (return them from
# `pose`), bodies on supports. A pair of teeth that leaves comes back as the pair that enters: with n pairs, contact i
# stays with every n-th tooth, and the gap may jump where it is wide open. A wave that `orders` does not name is told by
# a warning (`gj.UnnamedOrder`), also if an error of your own makes it (page "parts of one's own"). Test your class
# against equations that you write down independently, as above. To use the class with the command `gearjax`, put it
# into a package and list it as an entry point in the group `gearjax.systems`.
