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
from gearjax.analysis.resting import tolerated
from gearjax.checks import SceneError, is_concrete
from gearjax.contact import HardContact
from gearjax.load_torque import ConstantLoad
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float

ROUNDING = 1e3  # negative squares of frequencies up to this many units of rounding are zero
UNIT = 1e-6  # deviation from one of the largest component of a mode


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

    The stiffness is the mean stiffness of the contacts that carry the torque in the static equilibrium at input angle
    0, with the hard contact law, and their dampers act; without torque that is the contact that touches. For slices of
    contact lines it is the mean of the whole mesh, and for line contacts that under the mean force (`DampingRatio`).
    Gyroscopic forces of bodies on cranks are neglected.

    Args:
        scene: the scene, with compliance and inertia.
        torque: load torque [N m]; its sign decides which flanks carry, its size how many contacts.

    Returns:
        The modes, differentiable in the numbers of the scene if the frequencies are distinct.

    Raises:
        SceneError: the scene lacks a part, its springs are not linear and independent of each other, there is no
            equilibrium, or centrifugal forces are stronger than the supports.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> gj.natural_modes(scene, 100.0).frequencies.shape
        (1,)
    """
    require(scene, "natural modes", "compliance", "inertia")
    scene = dataclasses.replace(scene, load=ConstantLoad(), contact=HardContact())
    if is_concrete(torque) and float(np.asarray(torque)) < 0 and not scene.layout.has_back:
        words = "no flank carries a negative torque: list [backlash] for back flanks"
        raise SceneError(f'"natural modes" under {float(np.asarray(torque)):g} N*m: {words}')
    modes = _natural_modes(scene.precomputed(*MODELLED), jnp.asarray(torque, scene.dtype))
    if is_concrete(modes):
        _check_stable(modes, torque)
    return modes


def _check_stable(modes: NaturalModes, torque: ArrayLike) -> None:
    """Refuse modes of a structure that has no equilibrium, or that moves away from it."""
    unstable = np.isnan(np.asarray(modes.frequencies))
    if not unstable.any():
        return
    shape = np.asarray(modes.shapes)[np.argmax(unstable)]
    words = "there is no static equilibrium"
    if np.isfinite(shape).all():
        name = modes.coordinates[int(np.argmax(np.abs(shape - 1) < UNIT))]
        words = f"its structure is unstable in {name}: centrifugal forces are stronger than the support"
    raise SceneError(f'"natural modes" under {float(np.asarray(torque)):g} N*m: {words}')


@eqx.filter_jit
def _natural_modes(scene: Scene, torque: Array) -> NaturalModes:
    equation = StructureEquation.of(scene, torque)
    stiffness, damping = _about_rest(equation)
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
    least = -ROUNDING * jnp.finfo(squares.dtype).eps * jnp.abs(squares).max()
    rates = jnp.where(squares >= least, jnp.sqrt(jnp.maximum(squares, 0.0)), jnp.nan)
    critical = jnp.where(rates > 0, 2 * rates, 1.0)
    drags = jnp.einsum("cm,cd,dm->m", modes, reduced(damping), modes)
    shapes = jax.scipy.linalg.solve_triangular(factor.T, modes, lower=False).T
    largest = jnp.argmax(jnp.abs(shapes), axis=1)
    shapes = shapes / jnp.take_along_axis(shapes, largest[:, None], axis=1) * scale[None, :]
    shapes = shapes / scale[largest][:, None]
    return NaturalModes(rates / (2 * jnp.pi), shapes, drags / critical, equation.structure.names)


def _about_rest(equation: StructureEquation) -> tuple[Array, Array]:
    """Stiffness and damping of the structure about its equilibrium, with contacts that carry [N/m, N s/m]; or nan."""
    now = equation.excitation(jnp.zeros_like(equation.torque))
    if equation.springs.sliced:
        return Lines.of(equation, now).whole
    place, forces = equation.resting(now.jacobian, now.gap, now.springs, now.torque)
    overlap = now.jacobian @ place - now.gap
    touches = jnp.abs(overlap) <= tolerated(overlap.dtype)
    closed = jnp.where(now.torque == 0, touches, forces > 0)
    parts, held = equation.structure, jnp.where(closed, equation.springs.mean, 0.0)
    stiffness = parts.stiffness + now.jacobian.T @ (held[:, None] * now.jacobian)
    stiffness = jnp.where(jnp.isfinite(place).all(), stiffness, jnp.nan)
    if equation.coefficient is None:
        return stiffness, parts.damping
    acting = jnp.where(closed, jnp.inf, -jnp.inf).astype(overlap.dtype)
    drag, damped = equation.drag(now.springs) * equation.engaged(acting), now.jacobian[equation.springs.damped]
    return stiffness, parts.damping + damped.T @ (drag[:, None] * damped)
