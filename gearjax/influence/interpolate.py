"""Influence between any points of the flanks of one gear, interpolated in its table."""

import jax.numpy as jnp
import numpy as np

from gearjax.influence.table import InfluenceTable
from gearjax.typing import Array, Float, Int


def influence_between(
    table: InfluenceTable, radius: Float[Array, " point"], face: Float[Array, " point"], tooth: Int[Array, " point"]
) -> Float[Array, "point point"]:
    """Normal displacement of each point per normal force on each point, on teeth of one gear.

    The matrix is ``S = B C B^T``. The rows of ``B`` are cubic splines along the radius and linear functions across the
    face, which are exact at the nodes of the table. ``C`` is the block of the table for the distance between the two
    teeth. The matrix is symmetric. Points beyond the nodes of the table count as at its edge; teeth at a larger
    distance than the table contains do not move each other.

    Args:
        table: table of the flanks that the points are on; `InfluenceTable.mirrored` for flanks that face decreasing
            polar angles.
        radius: radii of the points about the gear's centre, shape (point,) [m].
        face: places of the points across the face, from where two gears begin to overlap, shape (point,) [m].
        tooth: number of the tooth of each point, counted towards increasing polar angles, shape (point,).

    Returns:
        The influence matrix, shape (point, point) [m/N]. It is singular if a tooth has more points than the table has
        nodes; the sum with the influence of a second gear is positive definite if the points are nodes of that gear.
    """
    weights = along_radius(table, radius)[:, :, None] * across_face(table, face)[:, None, :]
    return influence_of(table, weights.reshape(len(radius), -1), tooth)


def influence_of(
    table: InfluenceTable, weights: Float[Array, "point node"], tooth: Array
) -> Float[Array, "point point"]:
    """Influence between points whose forces are distributed over several nodes.

    Args:
        table: as for `influence_between`.
        weights: share of each force that acts on each node, which is also the weight of the node's displacement in the
            displacement of the point, shape (point, node).
        tooth: as for `influence_between`, whole numbers of any type.
    """
    apart = tooth[:, None] - tooth[None, :]
    influence = jnp.zeros((len(weights), len(weights)), weights.dtype)
    for distance, block in enumerate(table.matrix):
        behind = weights @ block @ weights.T  # [from, to], where `to` is `distance` teeth ahead of `from`
        influence = influence + jnp.where(apart == -distance, behind, 0.0)
        if distance:
            influence = influence + jnp.where(apart == distance, behind.T, 0.0)
    return influence


def influence_on_grid(table: InfluenceTable, radius: Float[Array, "tooth profile"]) -> Float[Array, "point point"]:
    """Influence between points of consecutive teeth at all face nodes of the table.

    Only the radius is interpolated, block by block.

    Args:
        table: as for `influence_between`.
        radius: radii of the points of each tooth, teeth in the order of increasing polar angles, shape (tooth, profile)
            [m].

    Returns:
        The influence matrix, shape (tooth * profile * face, tooth * profile * face) [m/N], points in the order tooth,
        profile, face.
    """
    teeth, profile = radius.shape
    radii, faces = len(table.radius), len(table.face)
    weights = along_radius(table, radius.ravel()).reshape(teeth, profile, radii)
    size = profile * faces
    influence = jnp.zeros((teeth, size, teeth, size), weights.dtype)
    for distance, block in enumerate(table.matrix[:teeth]):
        block = block.reshape(radii, faces, radii, faces)
        near, far = np.arange(teeth - distance), np.arange(distance, teeth)
        one, other = weights[near], weights[far]
        half = jnp.einsum("tpa,aibj->tpibj", one, block)
        between = jnp.einsum("tpibj,tqb->tpiqj", half, other).reshape(len(near), size, size)
        influence = influence.at[near, :, far].set(between)
        if distance:
            influence = influence.at[far, :, near].set(jnp.swapaxes(between, 1, 2))
    return influence.reshape(teeth * size, teeth * size)


def along_radius(table: InfluenceTable, radius: Float[Array, " point"]) -> Float[Array, "point radius"]:
    """Weight of each node's value in a cubic spline through the nodes, at each point, shape (point, radius) [-]."""
    place, step, share = _places(table.radius, radius)
    s, rest = share[:, None], 1 - share[:, None]
    nodes = np.arange(len(table.radius), dtype=np.int32)[None]
    left, right = (nodes == place[:, None]), (nodes == place[:, None] + 1)
    values = jnp.where(left, rest * rest * (1 + 2 * s), 0.0) + jnp.where(right, s * s * (1 + 2 * rest), 0.0)
    tilt = rest * s * step[:, None]
    return values + tilt * (rest * table.slopes[place] - s * table.slopes[place + 1])


def across_face(table: InfluenceTable, face: Float[Array, " point"]) -> Float[Array, "point face"]:
    """Weight of each node's value in a linear interpolation between nodes, at each point, shape (point, face) [-]."""
    place, _, share = _places(table.face, face)
    nodes = np.arange(len(table.face), dtype=np.int32)[None]
    left, right = (nodes == place[:, None]), (nodes == place[:, None] + 1)
    return jnp.where(left, 1 - share[:, None], 0.0) + jnp.where(right, share[:, None], 0.0)


def _places(nodes: Array, at: Array) -> tuple[Int[Array, " point"], Array, Array]:
    """Number of the interval of nodes that contains each point, its length, and its share before the point [-]."""
    at = jnp.clip(at, nodes[0], nodes[-1])
    place = jnp.clip(jnp.searchsorted(nodes, at, side="right").astype(jnp.int32) - 1, 0, len(nodes) - 2)
    step = nodes[place + 1] - nodes[place]
    return place, step, (at - nodes[place]) / step
