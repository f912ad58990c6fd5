"""Figure of the load over the planes of action of helical and spur pairs, and of trains of them."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gearjax.analysis.face_load import FaceLoad, across_face
from gearjax.compliance import AbstractSliceCompliance
from gearjax.contact import HelicalMesh
from gearjax.plot.axes import gear_set_of
from gearjax.scene import Scene
from gearjax.systems import HelicalPair, HelicalTrain
from gearjax.typing import Array, ArrayLike
from gearjax.units import mm

MOST_ANGLES = 2000  # largest number of angles in the search for the highest loads
CELLS = 60  # cells along the path of contact
PER_MM = 1e-3


def plane_of_action_figure(scene: Scene, theta: ArrayLike, forces: ArrayLike) -> Figure:
    """Draw the load per length over the plane of action of each mesh: along the path of contact, and across the face.

    The first drawing of a mesh shows the contact lines at the first angle, coloured by their load per length. The
    second shows the highest load per length of all angles at each place, the third the mean load per width across the
    face.

    Args:
        scene: scene with a `HelicalPair` or a `HelicalTrain`.
        theta: input angles, shape (n,) [rad].
        forces: contact forces under a torque, shape (n, contact) [N].

    Raises:
        SceneError: the scene has another gear set.
    """
    kinds = HelicalPair, HelicalTrain
    system: HelicalPair | HelicalTrain = gear_set_of(scene.system, "a helical_pair or a helical_train", *kinds)
    every = -(-len(np.atleast_1d(theta)) // MOST_ANGLES)
    all_forces = np.nan_to_num(np.atleast_2d(forces))
    angles, some = np.atleast_1d(theta)[::every], all_forces[::every]
    meshes = len(system.stages)
    figure = Figure(figsize=(13.0, 4.2 * meshes), layout="constrained")
    rows = figure.subplots(meshes, 3, sharey="row", width_ratios=(1.0, 1.0, 0.6), squeeze=False)
    of_contacts = np.array(scene.layout.mesh or (0,) * all_forces.shape[1])
    for mesh, (row, stage) in enumerate(zip(rows, system.stages, strict=True)):
        turned = angles * (system.mesh_orders[mesh] / stage.pair.teeth[0])
        loads = _lines(scene, stage, turned, some[:, of_contacts == mesh])
        of = "" if meshes == 1 else f"mesh {mesh + 1}: "
        _draw_mesh(figure, list(row), stage, loads, of, float(turned[0]))
        face = across_face(scene, jnp.asarray(all_forces), mesh)
        _draw_mean(row[2], face, float(stage.pair.face_width) / stage.slices)
    return figure


def _draw_mesh(
    figure: Figure,
    row: Sequence[Axes],
    stage: HelicalMesh,
    loads: tuple[np.ndarray, np.ndarray, np.ndarray],
    of: str,
    turn: float,
) -> None:
    """The contact lines of a mesh at the first angle, and the highest loads of all angles."""
    roll, across, load = loads
    lines, highest, _ = row
    path = stage.pair.contact_path
    ends = float(path.begin) / mm, float(path.end) / mm
    half = 0.5 * float(stage.pair.face_width) / mm
    scale = Normalize(0.0, max(float(load.max()), 1e-9))
    _draw_lines(lines, stage, (roll[0], across[0], load[0]), scale)
    edges = np.linspace(*ends, CELLS + 1), np.linspace(-half, half, stage.slices + 1)
    cells = [
        np.clip(np.digitize(part, edge) - 1, 0, len(edge) - 2) for part, edge in zip((roll, across), edges, strict=True)
    ]
    table = np.zeros((CELLS, stage.slices))
    np.maximum.at(table, tuple(cells), load)
    drawn = highest.pcolormesh(*edges, np.stack([_filled(row) for row in table.T]), norm=scale, cmap="viridis")
    figure.colorbar(drawn, ax=[lines, highest], label="load per length [N/mm]")
    lines.set_title(f"{of}contact lines, pinion at {np.degrees(turn) % 360:.1f} deg", fontsize="medium")
    highest.set_title(f"{of}maximum of {len(load)} angles, {load.max():.3g} N/mm", fontsize="medium")
    for axes in (lines, highest):
        axes.add_patch(Rectangle((ends[0], -half), ends[1] - ends[0], 2 * half, fill=False, edgecolor="0.4"))
        axes.axvline(float(path.pitch) / mm, color="0.6", linewidth=0.8, linestyle="--")
        axes.set_xlabel("length of roll of the pinion [mm], dashed: pitch point")
        axes.set(xlim=(ends[0] - 1, ends[1] + 1), ylim=(-1.05 * half, 1.05 * half))
    lines.set_ylabel("across the face [mm]")


def _draw_mean(axes: Axes, face: FaceLoad, width: float) -> None:
    """Mean load per width across the face, and the face load factor.

    Args:
        axes: axes to draw in.
        face: load across the face.
        width: width of a slice [m].
    """
    mean = np.asarray(face.mean) * PER_MM
    axes.barh(np.asarray(face.across) / mm, mean, height=width / mm, color="0.75")
    axes.axvline(mean.mean(), color="C3", linewidth=1.0)
    axes.set_title(f"K_Hbeta {float(face.factor):.3g}, line: mean", fontsize="medium")
    axes.set_xlabel("mean load per width [N/mm]")


def _filled(row: np.ndarray) -> np.ndarray:
    """Loads along the path, interpolated over cells without a load; nan beyond the first and the last loaded cell."""
    places, known = np.arange(len(row)), np.flatnonzero(row)
    if not len(known):
        return np.full(len(row), np.nan)
    return np.interp(places, known, row[known], left=np.nan, right=np.nan)


def _lines(
    scene: Scene, stage: HelicalMesh, turned: np.ndarray, forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position and load of all slices on the side that carries, shape (n, contact) each.

    These are lengths of roll of the pinion [mm], places across the face [mm] and loads per length [N/mm].
    """
    slices = _slices(stage, jnp.asarray(turned, scene.dtype), scene.backlash is not None)
    shape = (len(turned), -1)
    line = np.asarray(slices[2]).reshape(shape)
    if not isinstance(scene.compliance, AbstractSliceCompliance):
        # springs of whole pairs: a slice that is partly on the path carries as if all of it were there
        whole = stage.pair.face_width / (stage.slices * jnp.cos(stage.pair.base_helix_angle))
        line = np.where(line > 0, float(whole), 0.0)
    load = np.where(line > 0, forces / np.where(line > 0, line, 1.0), 0.0) * PER_MM
    half = line.shape[1] // (2 if scene.backlash is not None else 1)
    back = load[:, half:].sum() > load[:, :half].sum()
    side = slice(half, None) if back else slice(half)
    roll, across = (np.asarray(one).reshape(shape)[:, side] / mm for one in slices[:2])
    return roll, across, load[:, side]


@eqx.filter_jit
def _slices(stage: HelicalMesh, turned: Array, back: bool) -> tuple[Array, Array, Array]:
    def at(angle: Array) -> tuple[Array, Array, Array]:
        slices = stage.contacts(angle, back).slices
        return slices.roll[0], slices.across, slices.lengths

    return jax.vmap(at)(turned)


def _draw_lines(
    axes: Axes, stage: HelicalMesh, at: tuple[np.ndarray, np.ndarray, np.ndarray], scale: Normalize
) -> None:
    """The slices that carry, as far as they are on the path of contact."""
    roll, across, load = at
    half = 0.5 * float(stage.pair.face_width) / mm / stage.slices
    lean = float(np.tan(stage.pair.base_helix_angle))
    path = stage.pair.contact_path
    low, high = float(path.begin) / mm, float(path.end) / mm
    ends = []
    for x, z in zip(roll, across, strict=True):
        reach = (-half, half) if abs(lean) < 1e-9 else sorted(((low - x) / lean, (high - x) / lean))
        part = max(-half, reach[0]), min(half, reach[1])
        ends.append([(x + each * lean, z + each) for each in part])
    carrying = load > 0
    shown = [end for end, carries in zip(ends, carrying, strict=True) if carries]
    axes.add_collection(LineCollection(shown, array=load[carrying], norm=scale, cmap="viridis", linewidths=4))
