"""A robot's joint in MuJoCo with its reducer and with an ideal one, beside gearjax's own motion.

A motor of great inertia turns evenly, the link carries a load torque. With `gj.export_joint` the joint has the
reducer's transmission error, play, stiffness and damping; without, its output follows the motor through one spring.

    python -m pip install -e ".[mujoco]"
    python experiments/joint_in_mujoco.py [--config configs/two_kv/wang_2020.toml] [--torque 100] [--seconds 0.4]
"""

import argparse
import importlib
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import mujoco
import numpy as np
from peers import agree, sized

import gearjax as gj
from gearjax.plot import draw_curve, finish, new_figure, save_figure
from gearjax.units import arcmin

ROOT = Path(__file__).parents[1]
EVERY = 50  # steps between samples
SETTLED = 0.05  # s


def turned(text: str, install: Callable, speed: float, torque: float, start: tuple[float, float], seconds: float):
    """Times and positions of the output from its ideal one, of a motor that turns evenly."""
    model = mujoco.MjModel.from_xml_string(text.replace("1e-4 1e-4 1e-4", "1e4 1e4 1e4"))
    data = mujoco.MjData(model)
    ratio = install(model)
    data.qvel[:] = speed, start[1]
    data.qpos[1], data.ctrl[1] = start[0], -torque
    rows = []
    for step in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if step % EVERY == EVERY - 1:
            rows.append((data.time, data.qpos[1] - data.qpos[0] / ratio))
    mujoco.set_mjcb_passive(None)
    return np.array(rows).T


def main() -> None:
    parser = argparse.ArgumentParser(description="a joint with its reducer in MuJoCo")
    parser.add_argument("--config", type=Path, default=ROOT / "configs" / "two_kv" / "wang_2020.toml")
    parser.add_argument("--torque", type=float, default=100.0, help="load on the output [N m]")
    asked = sized(parser, seconds=(0.4, 0.15))
    scene, folder = gj.load(asked.config), Path(tempfile.mkdtemp())
    gj.export_joint(scene, folder, torque=1.5 * asked.torque)
    joint, speed = gj.joint_model(scene, 1.5 * asked.torque), float(scene.system.input_speed)
    sys.path.insert(0, str(folder))
    te_model, joint_mujoco = (importlib.import_module(name) for name in ("te_model", "joint_mujoco"))

    def reducer(model: mujoco.MjModel) -> float:
        joint_mujoco.install(model)
        return te_model.RATIO

    def ideal(_model: mujoco.MjModel) -> float:
        def passive(_same, data):
            away = data.qpos[1] - data.qpos[0] / joint.ratio
            rate = data.qvel[1] - data.qvel[0] / joint.ratio
            carried = -joint.stiffness * away - joint.damping * rate
            data.qfrc_passive[:] += -carried / joint.ratio, carried

        mujoco.set_mjcb_passive(passive)
        return joint.ratio

    text = (folder / "joint.xml").read_text(encoding="utf-8")
    first = float(te_model.te(0.0, asked.torque))
    rate = speed / joint.ratio
    start = first, rate + float(te_model.slope(0.0, asked.torque)) * speed
    curves = {"MuJoCo, with the reducer": turned(text, reducer, speed, asked.torque, start, asked.seconds)}
    rest = -asked.torque / joint.stiffness, rate
    curves["MuJoCo, one spring"] = turned(text, ideal, speed, asked.torque, rest, asked.seconds)
    ts = curves["MuJoCo, with the reducer"][0]
    te = np.asarray(gj.simulate(scene, jnp.concatenate([jnp.zeros(1), jnp.asarray(ts)]), asked.torque).te)[1:]
    curves["gearjax"] = np.stack([ts, te])
    figure, (ax,) = new_figure()
    settled = {name: positions[times > SETTLED] for name, (times, positions) in curves.items()}
    for name, (times, positions) in curves.items():
        mean, std = settled[name].mean() / arcmin, settled[name].std() / arcmin
        print(f"{name:26} mean {mean:8.4f}, std {std:.4f} arcmin")
        draw_curve(ax, times, positions, name, linestyle="--" if name == "gearjax" else "-")
    mujoco_te, own = settled["MuJoCo, with the reducer"], settled["gearjax"]
    agree("mean, relative difference", abs(mujoco_te.mean() / own.mean() - 1), 0.01)
    agree("standard deviation, relative difference", abs(mujoco_te.std() / own.std() - 1), 0.03)
    finish(ax, f"{scene.system.kind} under {asked.torque:g} N m", "time [s]", "output from its ideal position [arcmin]")
    print(f"written: {save_figure(figure, folder / 'joint.png')}")


if __name__ == "__main__":
    main()
