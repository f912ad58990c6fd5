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
from gearjax.load import ConstantLoad
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float


class NaturalModes(eqx.Module):
    """Natural frequencies and modes, slowest first.

    Args:
        frequencies: of the undamped motion, shape (mode,) [Hz].
        shapes: of the modes, over their largest part, turns counted by how far they move the contacts, shape (mode,
            coordinate) [rad or m by the coordinate, over that of the largest].
        damping: share of critical damping of each mode, the modes taken one by one, shape (mode,) [-].
        coordinates: names of what moves.
    """

    frequencies: Float[Array, " mode"]
    shapes: Float[Array, "mode coordinate"]
    damping: Float[Array, " mode"]
    coordinates: tuple[str, ...] = eqx.field(static=True)


@arguments.checked()
def natural_modes(scene: Scene, torque: ArrayLike) -> NaturalModes:
    """Natural frequencies and modes, with the mean stiffness of the contacts that hold a torque at input angle 0; of
    slices of contact lines the mean of the whole mesh. Forces of cranks that turn with the velocity are left out.

    Args:
        scene: the scene, with compliance and inertia.
        torque: whose sign tells which flanks carry, of contacts whose levers tell also how many [N m].

    Returns:
        The modes, differentiable in the numbers of the scene where frequencies are apart.

    Raises:
        SceneError: the scene lacks a part, or its springs are not linear, one by one.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> gj.natural_modes(scene, 100.0).frequencies.shape
        (1,)
    """
    require(scene, "natural modes", "compliance", "inertia")
    scene = dataclasses.replace(scene, load=ConstantLoad())
    if is_concrete(torque) and float(np.asarray(torque)) < 0 and not scene.layout.has_back:
        words = "nothing holds a negative torque: list [backlash] for back flanks"
        raise SceneError(f'"natural modes" under {float(np.asarray(torque)):g} N*m: {words}')
    return _natural_modes(scene.physics(*MODELLED), jnp.asarray(torque, scene.dtype))


@eqx.filter_jit
def _natural_modes(scene: Scene, torque: Array) -> NaturalModes:
    equation = StructureEquation.of(scene, torque)
    stiffness, damping = Lines.of(equation, jnp.zeros_like(torque)).whole
    scale = equation.scale  # so that turns and displacements are of one size
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
