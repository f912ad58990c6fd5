"""Metrics of a record."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import is_concrete, warn_the_caller
from gearjax.contact import Layout
from gearjax.typing import Array, Float, Int

FEWEST = 20.0  # angles per turn of the fastest rotation; with fewer, extremes between them may be missed


class FewAngles(UserWarning):
    """Extremes of a curve may be missed, because it was evaluated at too few angles."""


def angles_per_turn(theta: Float[Array, "... n"], fastest_order: float) -> float:
    """Smallest number of angles per turn of the fastest rotation; infinite for a single angle.

    Args:
        theta: input angles, increasing, shape (n,) [rad].
        fastest_order: order of the fastest rotation, in turns per turn of the input.
    """
    angles = np.asarray(theta)
    if angles.shape[-1] < 2 or fastest_order <= 0:
        return math.inf
    return float(2 * math.pi / (np.diff(angles, axis=-1).max() * fastest_order))


def few_angles(theta: Float[Array, "... n"], fastest_order: float) -> str | None:
    """Warning about the extremes in words; ``None`` if there are enough angles."""
    fewest = angles_per_turn(theta, fastest_order)
    if fewest > FEWEST * (1 - 1e-3):
        return None
    angles = np.asarray(theta)
    needed = math.ceil(FEWEST * fastest_order * float((angles[..., -1] - angles[..., 0]).max()) / (2 * math.pi)) + 1
    return (
        f"only {fewest:.3g} angles per cycle of the fastest order ({fastest_order:.4g} cycles per turn of the input): "
        f"peak-to-peak and amplitude may miss extremes; {needed} evenly spaced angles are enough"
    )


def warn_of_few_angles(theta: Float[Array, "... n"], fastest_order: float) -> None:
    """Warn if extremes between the angles may be missed.

    One or two angles are not a curve, and traced angles are not known: neither gives a warning.
    """
    if not is_concrete(theta) or theta.shape[-1] < 3:
        return
    words = few_angles(theta, fastest_order)
    if words is not None:
        warn_the_caller(words, FewAngles)


@jax.custom_jvp
def top(values: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Highest value along the last axis, with the derivative of that value.

    The built-in derivative of `max` compares each value with the maximum; in fused code the two may be rounded
    differently, and then no value matches.
    """
    return values.max(axis=-1)


@top.defjvp
def _top_jvp(primals: tuple, tangents: tuple) -> tuple:
    (values,), (slopes,) = primals, tangents
    where = jnp.argmax(values, axis=-1, keepdims=True)
    return top(values), jnp.take_along_axis(slopes, where, axis=-1)[..., 0]


def root(square: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root with derivative zero at zero, so that the deviation of a constant record has a gradient."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def deviation(record: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Standard deviation of each record."""
    centred = record - record.mean(axis=-1, keepdims=True)
    return root((centred * centred).mean(axis=-1))


def load_sharing(
    layout: Layout, forces: Float[Array, "... n contact"], carriers: Int[Array, "... n"] | int
) -> Float[Array, "... n"]:
    """`load_sharing_factor` of the pairs of a mesh; for a train the largest factor of its meshes.

    In a mesh of a train, the pairs that could carry are those of the side with the larger total force.
    """
    carried = layout.per_pair(forces)
    if not layout.mesh:
        return load_sharing_factor(carried, carriers)
    meshes = np.array([layout.mesh[members[0]] for members in layout.members])
    return jnp.stack([_sharing_of(layout, forces, carried, meshes == mesh) for mesh in set(layout.mesh)]).max(axis=0)


def _sharing_of(
    layout: Layout, forces: Float[Array, "... n contact"], carried: Float[Array, "... n pair"], inside: np.ndarray
) -> Float[Array, "... n"]:
    """Load sharing factor of the pairs inside one mesh of a train."""
    driving, back = (pairs[inside[pairs]] for pairs in layout.pairs_by_side)
    able = max(len(driving), len(back))
    if len(back) and len(back) != len(driving):
        within = inside[np.asarray(layout.pair)]
        pressed = [(forces * (within & (np.asarray(layout.side) == side))).sum(axis=-1) for side in (1, -1)]
        able = jnp.where(pressed[0] >= pressed[1], len(driving), len(back))
    return load_sharing_factor(carried[..., np.flatnonzero(inside)], able)


def load_sharing_factor(
    carried: Float[Array, "... n pair"], carriers: Int[Array, "... n"] | int
) -> Float[Array, "... n"]:
    """Load of the most loaded pair over the mean load of the pairs that could carry, shape (n,).

    It is 1 if the load is shared evenly, and the number of these pairs if one pair carries all. For planet wheels it is
    the mesh load factor ``K_gamma`` of ISO 6336-1 at each sample; nan without load.

    Args:
        carried: force of each pair, shape (n, pair) [N].
        carriers: number of pairs that could carry, shape (n,), or one number for all samples.
    """
    total = carried.sum(axis=-1)
    loaded = total > 0
    able = jnp.asarray(carriers, carried.dtype)
    return jnp.where(loaded, able * carried.max(axis=-1) / jnp.where(loaded, total, 1.0), jnp.nan)
