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
# # The exponentially fitted scheme: derived, its order, its windows
#
# The output of a gear set rests on its teeth: it is an oscillator whose springs act only during contact. Between two
# changes of contact it is linear, so a time step can be *exact* if the stiffness is held constant over the step. This
# is the scheme behind `gj.simulate`. It computes the forces once per step; errors arise only where contacts change and
# where the excitation changes. This page runs for a minute.
#
# ## Derivation
# With a stiffness $k$ and a damper $c$ on a mass $m$, the position $x$ obeys $\ddot x + d\,\dot x + w\,x = F$ with
# $d = c/m$, $w = k/m$ and the force per mass $F$. Under a constant $F$ the distance from the rest position,
# $y = x - F/w$, is
#
# $$y(t) = e^{-d t/2}\,(A \cos \omega t + B \sin \omega t), \qquad \omega^2 = w - d^2/4 .$$
#
# Take three positions, $y_-, y, y_+$, one time step $h$ apart, and let $u = d h/2$, $s = \omega h$. In the sum
# $e^{u} y_+ + e^{-u} y_-$ the terms with $B$ cancel: it is $2 \cos s \; y$. Therefore
#
# $$y_+ - y = e^{-2u}\,(y - y_-) - \left(1 + e^{-2u} - 2 e^{-u} \cos s\right) y .$$
#
# Let $z = w h^2$. Then $s^2 = z - u^2$ and $-y\,z = h^2 (F - w x)$. With $1 + e^{-2u} = 2 e^{-u} \cosh u$ this gives
#
# $$x_+ - x = e^{-2u}\,(x - x_-) + 2 e^{-u}\, D\; h^2 (F - w x),$$
#
# $$D(z, u) = \frac{\cosh u - \cos\sqrt{z - u^2}}{z}.$$
#
# $D$ is an entire function of $z$, as its power series shows. Therefore it needs no square root and no case for strong
# damping (the few lines below take the root, for brevity). At $z = u = 0$ it is $1/2$, and the formula is Verlet's.
# The scheme is Gautschi's (1961) with damping included. If $F$ and $w$ change smoothly, it is of second order.

# %%
import dataclasses
import warnings
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax.config.examples import examples
from gearjax.units import arcmin

plt.style.use("gearjax.plot.gearjax")
OUT = Path("out") / "notebooks"
OUT.mkdir(parents=True, exist_ok=True)


# %% [markdown]
# ## Exact on an oscillator
# The formula takes three lines. It is compared with the known solution, for steps of up to two rad of the oscillation.
# (At a damping ratio of 1 the two roots are equal. The code separates them by 1e-6 of their value, so the known
# solution is accurate to that only.)


# %%
def divided(z, u):
    """(cosh u - cos sqrt(z - u^2)) / z; over-damped where the root is imaginary."""
    return (jnp.cosh(u) - jnp.real(jnp.cos(jnp.sqrt(jnp.asarray(z - u**2, complex))))) / z


w, force = 4.0e6, 3.0  # omega = 2000 rad/s
for ratio in (0.0, 0.1, 1.0, 3.0):
    d = 2 * ratio * np.sqrt(w)
    roots = np.roots([1.0, d, w]).astype(complex)
    roots[1] += 1e-6 * roots[0] if ratio == 1.0 else 0.0  # two equal roots, separated
    share = np.linalg.solve([[1, 1], roots], [-force / w, 0.0])  # from rest at zero

    def exact(t, share=share, roots=roots):
        return force / w + (share[0] * np.exp(roots[0] * t) + share[1] * np.exp(roots[1] * t)).real

    for h in (1e-5, 1e-4, 1e-3):
        z, u = w * h**2, d * h / 2
        factor = 2 * np.exp(-u) * float(divided(z, u)) * h**2
        before, at = exact(0.0), exact(h)
        for _ in range(50):
            before, at = at, at + np.exp(-2 * u) * (at - before) + factor * (force - w * at)
        off = abs(at - exact(51 * h)) / (force / w)
        print(f"damping ratio {ratio:3}, step {h:.0e} s: off by {off:.1e} after 50 steps")

# %% [markdown]
# ## Its order on a gear set
# The 2K-V reducer runs under a steady torque, and under a torque that changes its sign (a sine of 20 Hz), so that teeth
# cross the backlash and hit the other flank. The reference is Runge-Kutta with steps of 0.2 us. Under the steady torque
# both schemes have their textbook orders. At an impact the force has a kink, and it jumps if a damper engages at once.
# There neither scheme has an order: errors fall irregularly with the step, and four forces per step gain little.

# %%
steady = gj.load(examples()["two_kv"] / "wang_2020.toml")
alternating = dataclasses.replace(steady, load=gj.SinusoidalLoad(20.0))
ts = jnp.linspace(0.0, 0.05, 101)
steps = np.array([2e-5, 1e-5, 5e-6])
figure, order = plt.subplots()
for words, scene, line in (("steady", steady, "-"), ("alternating", alternating, "--")):
    truth = gj.simulate(scene, ts, 100.0, stepper=gj.FixedStep(2e-7, solver=gj.RungeKutta4())).te
    for name, solver, colour in (("fitted", gj.ExponentialFit(), "C0"), ("Runge-Kutta", gj.RungeKutta4(), "C1")):
        errors = []
        for step in steps:
            te = gj.simulate(scene, ts, 100.0, stepper=gj.FixedStep(float(step), solver=solver)).te
            errors.append(np.abs(np.asarray(te - truth)).max() / arcmin)
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        found = f", order {slope:.1f}" if scene is steady else ", impacts"
        order.loglog(1e6 * steps, errors, line, color=colour, marker="o", label=f"{name}, {words} torque{found}")
        print(f"{words} torque, {name}{found}: error {', '.join(f'{error:.1e}' for error in errors)} arcmin")
order.set_xticks(1e6 * steps, [f"{step:g}" for step in 1e6 * steps])
order.minorticks_off()
order.set_xlabel("step [us]")
order.set_ylabel("largest error of a sample [arcmin]")
order.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
figure.savefig(OUT / "fitted_scheme.svg")

# %% [markdown]
# ## Windows
# Time steps must be computed one after the other, but a damped gear set soon forgets its initial state. A record can
# therefore be cut into windows that run in parallel. Each window starts some time earlier, from rest on the teeth. Over
# this warm-up time $t$, the error of the initial state falls as $e^{-\zeta \omega t}$. gearjax compares the windows
# where they meet. If they do not agree, it gives a warning and computes the record in one go.

# %%
whole = gj.simulate(steady, ts, 100.0, stepper=gj.FixedStep(5e-6)).te
warm_ups = np.array([0.0, 0.004, 0.008, 0.012])
left = []
for warm_up in warm_ups:
    stepper = gj.FixedStep(5e-6, windows=gj.Windows(4, float(warm_up)))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        te = gj.simulate(steady, ts, 100.0, stepper=stepper).te
    off = np.abs(np.asarray(te - whole)).max() / arcmin
    left.append(np.nan if told else off)
    words = str(told[0].message) if told else f"off by {off:.1e} arcmin"
    print(f"4 windows, warm-up {1e3 * warm_up:4.1f} ms: {words}")
figure, windows = plt.subplots()
windows.semilogy(1e3 * warm_ups, left, marker="s")
windows.set_xlabel("warm-up before each window [ms]")
windows.set_ylabel("off from one go [arcmin]")
figure.savefig(OUT / "fitted_scheme_windows.svg")

# %% [markdown]
# ## What its derivatives are
# In forward and in reverse mode, gradients are the derivatives of the time steps themselves. They are therefore exact
# for the numbers that the steps give. Here they are compared with central differences.


# %%
def spread(mean):
    stiffness = gj.HarmonicStiffness(mean, np.array([0.1]), np.array([0.0]))
    return gj.simulate(dataclasses.replace(steady, compliance=stiffness), ts, 100.0, stepper=gj.FixedStep(5e-6)).std


mean = 9.2e7
change = 1e-4 * mean
forward = jax.jit(lambda mean: jax.jvp(spread, (mean,), (1.0,)))  # the value and its derivative
reverse = jax.jit(jax.grad(spread))(mean)
differences = (forward(mean + change)[0] - forward(mean - change)[0]) / (2 * change)
print(f"d std / d k: forward {forward(mean)[1]:.6e}, reverse {reverse:.6e}, differences {differences:.6e} rad m/N")

# %% [markdown]
# What to change next: `gj.DampingRatio(0.1, acting="always")`, whose dampers do not engage suddenly; the damping ratio,
# which changes the warm-up; bodies on supports, whose many coordinates `gj.ExponentialParabola` steps in the same way.
