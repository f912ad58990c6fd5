"""Mesh of bricks for some teeth of one gear and the rim under them."""

from typing import Any, NamedTuple

import numpy as np

from gearjax.influence.element import scikit_fem
from gearjax.influence.outline import Outline, graded

# corners of a brick in scikit-fem's order: first across the teeth, then along the profile, then across the face
CORNERS = ((1, 1, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))


class TeethMesh(NamedTuple):
    """Mesh of some teeth of a gear; the axis of the middle tooth is at polar angle zero.

    Args:
        mesh: hexahedra of scikit-fem [m].
        fixed: whether each node is fixed, shape (node,).
        flank: numbers of the nodes where teeth may touch, on flanks that face increasing polar angles, (tooth, radius,
            face).
        axes: polar angles of the axes of the teeth [rad], shape (tooth,).
    """

    mesh: Any
    fixed: np.ndarray
    flank: np.ndarray
    axes: np.ndarray


def teeth_mesh(
    shape: Outline, pitch: float, teeth: int, face: np.ndarray, zone: slice, *, thickness_elements: int
) -> TeethMesh:
    """Mesh of some teeth, fixed at the rim and at both ends.

    Args:
        shape: outline of half a tooth.
        pitch: angle from tooth to tooth [rad].
        teeth: number of teeth, odd.
        face: nodes across the face, shape (node,) [m].
        zone: range of the face nodes that meet the other gear.
        thickness_elements: number of elements through a tooth from flank to flank.
    """
    plane, quads, fixed, rows = _section(shape, pitch, teeth, thickness_elements)
    levels = len(face)
    points = np.concatenate([np.repeat(plane, levels, axis=1), np.tile(face, plane.shape[1])[None]])
    steps = np.arange(levels - 1)
    bricks = np.stack([(quads[a, b][:, None] * levels + steps + c).ravel() for a, b, c in CORNERS])
    flank = rows[:, shape.touching, None] * levels + np.arange(levels)[zone]
    axes = pitch * (np.arange(teeth) - teeth // 2)
    return TeethMesh(scikit_fem().MeshHex(points, bricks), np.repeat(fixed, levels), flank, axes)


def _section(
    shape: Outline, pitch: float, teeth: int, thickness_elements: int
) -> tuple[np.ndarray, dict[tuple[int, int], np.ndarray], np.ndarray, np.ndarray]:
    """Mesh of one cross-section.

    Returns:
        Nodes, shape (2, node); the node at each corner of the quadrangles, by corner; whether each node is fixed; and
        the nodes of the flanks, shape (tooth, row).
    """
    across = np.linspace(-1, 1, thickness_elements + 1)
    # the rim has columns under half a space, a tooth and half a space; the last column is the first of the next tooth
    beside = len(shape.space_angle) - 1
    angle = np.concatenate([-shape.space_angle[:0:-1], shape.angle[0] * across, shape.space_angle[1:]])
    top = np.concatenate([shape.space_radius[:0:-1], np.full(len(across), shape.radius[0]), shape.space_radius[1:]])
    axes = pitch * (np.arange(teeth) - teeth // 2)
    columns = len(angle) - 1
    all_angles = np.append((axes[:, None] + angle[:-1]).ravel(), axes[-1] + angle[-1])
    all_tops = np.append(np.tile(top[:-1], teeth), top[-1])
    depth = abs(shape.rim - shape.radius[0])
    share = np.append(0.0, graded(depth, max(abs(shape.radius[1] - shape.radius[0]), 0.1 * depth))) / depth
    radii = all_tops + share[:, None] * (shape.rim - all_tops)
    rim = _polar(radii, np.broadcast_to(all_angles, radii.shape))
    tooth = _polar(
        np.broadcast_to(shape.radius[1:, None], (teeth, len(shape.radius) - 1, len(across))),
        axes[:, None, None] + shape.angle[1:, None] * across,
    )
    under = np.arange(radii.size).reshape(radii.shape)
    over = radii.size + np.arange(tooth[0].size).reshape(tooth[0].shape)
    foot = under[0, columns * np.arange(teeth)[:, None] + beside + np.arange(len(across))]
    whole = np.concatenate([foot[:, None], over], axis=1)  # (tooth, row, across)
    grids = [under, *whole]
    quads = {
        (a, b): np.concatenate([grid[b : len(grid) - 1 + b, a : grid.shape[1] - 1 + a].ravel() for grid in grids])
        for a in (0, 1)
        for b in (0, 1)
    }
    fixed = np.zeros(radii.size + tooth[0].size, dtype=bool)
    fixed[under[-1]] = fixed[under[:, 0]] = fixed[under[:, -1]] = True
    nodes = np.concatenate([rim.reshape(2, -1), tooth.reshape(2, -1)], axis=1)
    return nodes, quads, fixed, whole[:, :, -1]


def _polar(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)])
