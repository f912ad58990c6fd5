"""Periodic response by the Fourier series method of Guo and Fang (2018, eqs. 26-31), a shortcut without iteration."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.harmonic_balance import BALANCED, Balance, check_samples
from gearjax.analysis.periodic import Periodic
from gearjax.analysis.return_map import Problem
from gearjax.checks import SceneError, is_concrete
from gearjax.scene import Scene
from gearjax.typing import ArrayLike


@arguments.checked(
    harmonics=arguments.whole(1),
    samples=arguments.whole(3),
    static=arguments.an(Scene, "must be a scene, such as the same one without its run-outs"),
)
def fourier_series(
    scene: Scene,
    torque: ArrayLike,
    period: ArrayLike,
    *,
    harmonics: int = 16,
    samples: int | None = None,
    static: Scene | None = None,
) -> Periodic:
    """Motion that repeats after a period, by a shortcut: the static equilibrium in the varying part of the stiffness.

    The varying part of the stiffness acts on the static displacement in place of the motion, so that each harmonic
    follows from one linear equation. Contacts are permanent: those that carry in the static equilibrium push and pull.
    The result is right to first order in the motion's difference from the static displacement: far below the natural
    frequencies, or where the stiffness hardly varies. `harmonic_balance` has no such limit and is the reference.

    Guo and Fang (2018) take the static displacement of the flanks alone, without run-outs and pitch deviations: give
    that scene as ``static``. The varying stiffness then acts on the run-outs themselves, which adds sidebands at the
    mesh order plus and minus one per turn of each gear (1.1 and 1.4 um for their pair) that no gear set has: with the
    static displacement of the whole scene, the default, they are below 0.001 um.

    Args:
        scene: the scene, with compliance, load and inertia.
        torque: size of the load torque [N m].
        period: common period of everything that drives it [s].
        harmonics: number of harmonics of the series.
        samples: number of times per period at which forces are evaluated; by default 16 per harmonic.
        static: scene whose static equilibrium takes the place of the motion; by default the scene itself.

    Returns:
        One period. ``residual`` is the error of the equation of motion, relative to the motion; ``result`` is 1 if it
        is above 1e-6, as usual for a shortcut. Floquet multipliers are nan.

    Raises:
        SceneError: a scene lacks a part, has no static equilibrium, or ``static`` has other contacts or coordinates.

    Example:
        >>> import gearjax as gj, dataclasses, math
        >>> whole = gj.load("configs/two_kv/wang_2020.toml")
        >>> parts = {"inertia": gj.EquivalentMass(3.0), "damping": gj.DampingRatio(0.1), "reference": None}
        >>> pair = dataclasses.replace(whole, errors={}, **parts)
        >>> mesh = 2 * math.pi / (float(pair.system.input_speed) * pair.system.orders["mesh"])
        >>> gj.fourier_series(pair, 113.0, mesh).te.shape
        (256,)
    """
    samples = check_samples(harmonics, samples)
    problem = Problem.of(scene, torque, period)
    still = problem if static is None else Problem.of(static, torque, period)
    same = problem.scene.layout == still.scene.layout and problem.scene.coordinates == still.scene.coordinates
    if not same:
        words = "must have the contacts and coordinates of the scene: leave out errors only"
        raise SceneError(f"fourier_series: static {words}")
    found = _fourier_series(problem, None if static is None else still, harmonics, samples)
    if is_concrete(found.residual) and not np.isfinite(float(found.residual)):
        raise SceneError("fourier_series: there is no static equilibrium under this torque")
    return found


@eqx.filter_jit
def _fourier_series(problem: Problem, static: Problem | None, harmonics: int, samples: int) -> Periodic:
    balance = Balance.of(problem, harmonics, samples)
    other = balance if static is None else Balance.of(static, harmonics, samples)
    waves = balance.answer(balance.coefficients(balance.seen(other.rest)), balance.carries)
    numbers = balance.coefficients(balance.seen(balance.values(waves)))
    rest = jnp.abs(balance.lacking(numbers)).max() / jnp.abs(numbers).max()
    return balance.motion(waves, jnp.where(balance.rests & other.rests, rest, jnp.nan), BALANCED)
