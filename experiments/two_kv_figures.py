# %% [markdown]
# # Figures 4, 5, 6, 7, 11, 12 and 13 of Wang, Su and Zou (2020)
#
# `python experiments/two_kv_figures.py [DIR]` draws them as PNG, into `out/two_kv_figures` without DIR. Constants that
# the paper does not give (stiffness, mass, damping, backlash) are those of `gearjax.reproduce.two_kv`.
# Figures 8-10 of the paper come from a multibody program, 14-19 belong to its optimisation and its test bench.

# %%
import dataclasses
import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import gearjax as gj
from gearjax import plot
from gearjax.reproduce import two_kv
from gearjax.units import arcmin, mm

TORQUES = (30.0, 100.0, 300.0)


def times(duration: float, spacing: float = 1e-3) -> jax.Array:
    return jnp.linspace(0.0, duration, round(duration / spacing) + 1)


def angles(scene: gj.Scene, ts: jax.Array) -> jax.Array:
    return scene.system.input_speed * ts


def described(result) -> str:
    """Peak-to-peak, amplitude and mean for a legend."""
    values = (float(getattr(result, name)) / arcmin for name in ("peak_to_peak", "amplitude", "mean"))
    return "p-p {:.3f}, amplitude {:.3f}, mean {:.3f}".format(*values)


# %% Each pair alone over the major cycle of 15.8 s
def figure_4() -> Figure:
    figure, axes = plot.new_figure(2)
    for pair, ax in zip((1, 2), axes, strict=True):
        scene, ts = two_kv.scene(pair=pair), times(15.8)
        te = gj.transmission_error(scene, angles(scene, ts))
        plot.draw_curve(ax, ts, te.te, described(te).replace(", ", "\n"))
        plot.finish(ax, f"Fig. 4{'ab'[pair - 1]}: no-load TE of gear pair {pair}")
    return figure


# %% Both pairs together, without load and under static torque
def figure_5() -> Figure:
    figure, axes = plot.new_figure(2)
    scene, ts = two_kv.scene(), times(3.0)
    te = gj.transmission_error(scene, angles(scene, ts))
    plot.draw_curve(axes[0], ts, te.te, described(te).replace(", ", "\n"))
    plot.finish(axes[0], "Fig. 5a: no-load TE")
    for torque in TORQUES:
        static = gj.transmission_error(scene, angles(scene, ts), torque)
        plot.draw_curve(axes[1], ts, static.te, f"{torque:g} N m, mean {float(static.mean) / arcmin:.4f}")
    plot.finish(axes[1], "Fig. 5b: static TE")
    return figure


# %% In motion, and the means of both over the torque
def figure_6() -> Figure:
    figure, axes = plot.new_figure(2)
    scene, ts = two_kv.scene(stiffness=two_kv.DYNAMIC_STIFFNESS), times(3.0)
    for torque in TORQUES:
        motion = gj.simulate(scene, ts, torque, start="zero")
        plot.draw_curve(axes[0], ts, motion.te, f"{torque:g} N m", linewidth=0.6)
    plot.finish(axes[0], "Fig. 6a: dynamic TE (m, zeta, k0 inferred)")
    torques = jnp.linspace(10.0, 600.0, 25)  # without torque the output bounces in its backlash
    dynamic = [gj.simulate(scene, ts, torque, settle=0.05).mean / arcmin for torque in torques]
    axes[1].plot(torques, dynamic, label="dynamic TE", marker=".")
    for stiffness, label in (
        (two_kv.STATIC_STIFFNESS, "static TE"),
        (two_kv.DYNAMIC_STIFFNESS, "static TE, k0 of DTE"),
    ):
        stiff = two_kv.scene(stiffness=stiffness)
        static = [gj.transmission_error(stiff, angles(stiff, ts), torque).mean / arcmin for torque in torques]
        axes[1].plot(torques, static, label=label)
    plot.finish(axes[1], "Fig. 6b: mean TE over torque", x="load torque [N m]", y="mean TE [arcmin]")
    return figure


# %% Alternating torque: the output runs from one edge of the backlash to the other
def alternating(frequency: str, duration: float, mass: float = 3.0):
    """Motion under 30 N m at a frequency of the reducer, and the edges of its backlash."""
    scene = dataclasses.replace(
        two_kv.scene(stiffness=two_kv.DYNAMIC_STIFFNESS),
        load=gj.SinusoidalLoad(frequency),
        backlash=gj.InitialBacklash(0.2 * mm),
        inertia=gj.EquivalentMass(mass),
    )
    ts = times(duration, duration / 6000)
    motion = gj.simulate(scene, ts, 30.0, start="zero", stepper=gj.FixedStep(5e-6))
    return scene, ts, motion, gj.backlash(scene, angles(scene, ts))


def figure_7() -> Figure:
    figure, axes = plot.new_figure(2)
    for ax, frequency, duration, part in zip(axes, ("crank", "mesh"), (3.0, 0.5), "ab", strict=True):
        _, ts, motion, play = alternating(frequency, duration)
        plot.draw_curve(ax, ts, motion.te, "dynamic TE", linewidth=0.7)
        plot.draw_curve(ax, ts, play.lower, "no-load TE", color="k")
        plot.draw_curve(ax, ts, play.upper, "no-load TE\n+ backlash", color="k", linestyle="--")
        plot.finish(ax, f"Fig. 7{part}: +-30 N m at the {frequency} frequency (backlash 0.2 mm and m = 3 kg chosen)")
    return figure


def forces_under(frequency: str, duration: float, number: int) -> Figure:
    """TE and contact forces of the driving flanks, next to the static ones at the same torque."""
    figure, axes = plot.new_figure(2)
    scene, ts, motion, play = alternating(frequency, duration)
    plot.draw_curve(axes[0], ts, motion.te, "dynamic TE", linewidth=0.7)
    plot.draw_curve(axes[0], ts, play.lower, "no-load TE", color="k")
    plot.draw_curve(axes[0], ts, play.upper, "no-load TE\n+ backlash", color="k", linestyle="--")
    plot.finish(axes[0], f"Fig. {number}a: dynamic TE, +-30 N m at the {frequency} frequency")
    cycles = scene.system.orders[frequency] * np.asarray(angles(scene, ts)) / (2 * np.pi)
    static = gj.transmission_error(scene, angles(scene, ts), 30.0 * jnp.sin(2 * jnp.pi * cycles))
    for pair in range(2):
        axes[1].plot(*plot.thin(ts, motion.forces[:, pair]), label=f"pair {pair + 1}", linewidth=0.7)
        line = {"color": "k", "linewidth": 0.7, "linestyle": ("-", ":")[pair]}
        axes[1].plot(*plot.thin(ts, static.forces[:, pair]), label=f"pair {pair + 1}, static", **line)
    title = f"Fig. {number}b: contact forces of the driving flanks"
    plot.finish(axes[1], title, y="contact force [N]")
    return figure


# %% Phase groups of Table 3
def figure_13() -> Figure:
    figure, axes = plot.new_figure(1, height=4.0)
    ts = times(15.8)
    for group in ("group 1", "group 2", "group 3, output wheel 120 deg"):
        scene = two_kv.scene(group, te_radius="ring")
        te = gj.transmission_error(scene, angles(scene, ts))
        plot.draw_curve(
            axes[0], ts, te.te, f"{group.replace(', ', chr(10))}\namplitude {float(te.amplitude) / arcmin:.3f}"
        )
    plot.finish(axes[0], "Fig. 13: no-load TE with the phases of Table 3 (base circle of the ring)")
    return figure


# %%
def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "figure_04": figure_4,
        "figure_05": figure_5,
        "figure_06": figure_6,
        "figure_07": figure_7,
        "figure_11": lambda: forces_under("crank", 3.0, 11),
        "figure_12": lambda: forces_under("mesh", 0.5, 12),
        "figure_13": figure_13,
    }
    for name, draw in figures.items():
        draw().savefig(folder / f"{name}.png", dpi=130)
        print(folder / f"{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out/two_kv_figures"))
