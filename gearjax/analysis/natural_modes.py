"""Natural frequencies and modes of a scene about its loaded position."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.modes import StructureEquation
from gearjax.analysis.modes.lines import Lines
from gearjax.checks import SceneError, is_concrete
from gearjax.load_torque import ConstantLoad
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float


class NaturalModes(eqx.Module):
    """Natural frequencies and modes, slowest first.

    Args:
        frequencies: natural frequencies of the undamped motion, shape (mode,) [Hz].
        shapes: mode shapes, relative to their largest component, shape (mode, coordinate) [unit of the coordinate over
            that of the largest]. To find the largest, a rotation counts by the displacement of the contacts.
        damping: damping ratio of each mode, without coupling between modes, shape (mode,) [-].
        coordinates: names of the coordinates.
    """

    frequencies: Float[Array, " mode"]
    shapes: Float[Array, "mode coordinate"]
    damping: Float[Array, " mode"]
    coordinates: tuple[str, ...] = eqx.field(static=True)


@arguments.checked()
def natural_modes(scene: Scene, torque: ArrayLike) -> NaturalModes:
    """Natural frequencies and modes of a scene about its loaded position at input angle 0.

    The stiffness is the mean stiffness of the contacts that carry the torque; for slices of contact lines it is the
    mean of the whole mesh, and for line contacts that under the mean force (`DampingRatio`). Gyroscopic forces of
    bodies on cranks are neglected.

    Args:
        scene: the scene, with compliance and inertia.
        torque: load torque [N m]; its sign decides which flanks carry. If the lever of a contact decides its side, the
            size decides how many contacts carry.

    Returns:
        The modes, differentiable in the numbers of the scene if the frequencies are distinct.

    Raises:
        SceneError: the scene lacks a part, or its springs are not linear and independent of each other.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> gj.natural_modes(scene, 100.0).frequencies.shape
        (1,)
    """
    require(scene, "natural modes", "compliance", "inertia")
    scene = dataclasses.replace(scene, load=ConstantLoad())
    if is_concrete(torque) and float(np.asarray(torque)) < 0 and not scene.layout.has_back:
        words = "no flank carries a negative torque: list [backlash] for back flanks"
        raise SceneError(f'"natural modes" under {float(np.asarray(torque)):g} N*m: {words}')
    return _natural_modes(scene.precomputed(*MODELLED), jnp.asarray(torque, scene.dtype))


@eqx.filter_jit
def _natural_modes(scene: Scene, torque: Array) -> NaturalModes:
    equation = StructureEquation.of(scene, torque)
    stiffness, damping = Lines.of(equation, equation.excitation(jnp.zeros_like(torque))).whole
    scale = equation.scale  # brings rotations and displacements to the same size
    mass, stiffness, damping = (
        part * scale[:, None] * scale[None, :] for part in (equation.structure.mass, stiffness, damping)
    )
    factor = jnp.linalg.cholesky(mass)

    def reduced(matrix: Array) -> Array:
        half = jax.scipy.linalg.solve_triangular(factor, matrix, lower=True)
        return jax.scipy.linalg.solve_triangular(factor, half.T, lower=True).T

    springs = reduced(stiffness)
    squares, modes = jnp.linalg.eigh(0.5 * (springs + springs.T))
    rates = jnp.sqrt(jnp.maximum(squares, 0.0))
    critical = jnp.where(rates > 0, 2 * rates, 1.0)
    drags = jnp.einsum("cm,cd,dm->m", modes, reduced(damping), modes)
    shapes = jax.scipy.linalg.solve_triangular(factor.T, modes, lower=False).T
    largest = jnp.argmax(jnp.abs(shapes), axis=1)
    shapes = shapes / jnp.take_along_axis(shapes, largest[:, None], axis=1) * scale[None, :]
    shapes = shapes / scale[largest][:, None]
    return NaturalModes(rates / (2 * jnp.pi), shapes, drags / critical, equation.structure.names)
