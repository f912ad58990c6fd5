"""What the mesh of the finite elements and the depth of the fixed rim do to the loads of an involute RV reducer.

The reducer of Yang, Tang and Liang (2019) under 100 N m, its tooth 17 at the fitted place, as many candidates along
each profile and across the face as there are elements: under fewer ones, forces on single nodes tell of the elements,
and the lag grows as these shrink. Each mesh is compared with the finest one; rims are those of the usual mesh. A table,
and a figure beside this file.

    python experiments/influence_refinement.py [--quick]
"""

import argparse
import dataclasses
import time
from pathlib import Path
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import gearjax as gj
from gearjax.systems import flank_radii
from gearjax.units import mm

HERE = Path(__file__).parent
CONFIG = HERE.parent / "configs" / "involute_rv" / "yang_2019.toml"
TORQUE, PHASE, RIM = 100.0, 0.3417, 0.8 * mm
STEEL = {"youngs_modulus": 206e9, "poissons_ratio": 0.3, "external_width": 6.5 * mm, "internal_width": 14 * mm}
USUAL = (10, 13)  # elements along the profile, and across the face
MESHES = ((5, 7), (7, 9), USUAL, (14, 18))
RIMS = (0.6, 0.7, 0.8, 1.0, 1.4)  # mm
TEETH = range(14, 20)
PUBLISHED = (58.6, 244.2, 379.7, 407.8, 315.1, 149.5)  # N, Table 5


class Answer(NamedTuple):
    """Loads of the teeth 14 to 19, which carry nearly all [N]; static TE [rad]; processor time of the elements [s]."""

    loads: np.ndarray
    te: float
    seconds: float


def reducer() -> tuple[gj.Scene, float]:
    """The reducer without errors, and the input angle [rad]."""
    scene = gj.load(CONFIG)
    own = dataclasses.replace(scene.system, pairs=9)
    begin, end = own.pair.path
    space = float(own.pair.space_of_roll(begin + PHASE * (end - begin)))
    theta = (-space % (2 * np.pi / own.internal_teeth)) / own.orders["crank"]
    return dataclasses.replace(scene, system=own, errors={}, backlash=None, compliance=None, run=None), theta


def answer(scene: gj.Scene, theta: float, mesh: tuple[int, int], rim: float) -> Answer:
    own = dataclasses.replace(scene.system, profile_points=mesh[0], face_points=mesh[1])
    scene = dataclasses.replace(scene, system=own)
    began = time.process_time()
    matrix = gj.InfluenceMatrix(**STEEL, rim=rim, profile_elements=mesh[0], layers=mesh[1])
    matrix = matrix.made_for(*flank_radii(scene.system))
    seconds = time.process_time() - began
    te = gj.transmission_error(dataclasses.replace(scene, compliance=matrix), jnp.asarray([theta]), torque=TORQUE)
    pairs = np.asarray(te.pair_forces[0])
    centre = scene.system.candidates(jnp.asarray(theta), False).tooth.ravel()
    loads = pairs[np.argsort(-centre)]  # the paper numbers its teeth against ours
    first = int(np.argmax(np.convolve(loads, np.ones(len(TEETH)), "valid")))
    return Answer(loads[first : first + len(TEETH)], float(te.te[0]), seconds)


def told(name: str, own: Answer, finest: Answer | None = None) -> str:
    loads = " ".join(f"{load:6.1f}" for load in own.loads)
    off = "" if finest is None else f", largest difference {np.abs(own.loads - finest.loads).max():5.2f} N"
    lag = -own.te / gj.units.arcmin
    return f"{name:>14}: {loads} N, lag {lag:.5f} arcmin{off}, elements {own.seconds:.0f} s"


def rms(own: Answer) -> float:
    return float(np.sqrt(np.mean((own.loads - np.array(PUBLISHED)) ** 2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="without the finest mesh")
    chosen = parser.parse_args()
    scene, theta = reducer()
    meshes = MESHES[:3] if chosen.quick else MESHES
    by_mesh: dict[tuple[int, int], Answer] = {}
    for mesh in reversed(meshes):
        by_mesh[mesh] = answer(scene, theta, mesh, RIM)
        print(told(f"{mesh[0]} x {mesh[1]}", by_mesh[mesh], by_mesh[meshes[-1]]), flush=True)
    by_mesh = {mesh: by_mesh[mesh] for mesh in meshes}
    by_rim = {rim: answer(scene, theta, USUAL, rim * mm) for rim in RIMS}
    for rim, own in by_rim.items():
        print(f"{told(f'rim {rim:g} mm', own)}, rms from Table 5 {rms(own):.2f} N")
    draw(by_mesh, by_rim)


def draw(by_mesh: dict[tuple[int, int], Answer], by_rim: dict[float, Answer]) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    *coarser, finest = by_mesh.values()
    for mesh, own in zip(by_mesh, coarser, strict=False):
        left.plot(TEETH, own.loads - finest.loads, "o-", label=f"{mesh[0]} x {mesh[1]}")
    last = list(by_mesh)[-1]
    left.set(xlabel="tooth", ylabel=f"load minus that of {last[0]} x {last[1]} elements [N]")
    left.legend(title="elements along profile x face")
    right.plot(list(by_rim), [rms(own) for own in by_rim.values()], "o-")
    right.set(xlabel="depth of the fixed rim [mm]", ylabel="rms from the loads of Table 5 [N]", ylim=(0, None))
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(HERE / "influence_refinement.png", dpi=130)


if __name__ == "__main__":
    main()
