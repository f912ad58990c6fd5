"""Periodic motions at many speeds: waterfall diagram of their orders, and dynamic factors."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.period import check_repeats
from gearjax.analysis.periodic import at_speed, at_speeds, check_resolved_at, shoot
from gearjax.batches import in_batches
from gearjax.checks import SceneError
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike, Bool, Float, Int, Scalar

# speeds in one batch, of one coordinate, of several, and of many contacts: a batch waits for its slowest speed, but the
# work for contacts is quicker side by side
OF_ONE, OF_SEVERAL, OF_CONTACTS = 16, 8, 50


class Waterfall(eqx.Module):
    """Motions that repeat with an order, at several speeds.

    Args:
        speeds: input speeds, shape (n,) [rad/s].
        orders: multiples of the order, shape (harmonic,) [cycles per turn of the input].
        amplitudes: amplitude of the TE at each speed and order, shape (n, harmonic) [rad].
        peak_to_peak: peak-to-peak value of the TE at each speed, shape (n,) [rad].
        dynamic_factor: highest torque of the contacts on the output over the size of the load torque, shape (n,) [-];
            nan without a load torque.
        stable: whether a disturbance of the motion dies out, shape (n,).
        result: 0 if a motion was found, 1 if not, shape (n,); 3 if the steps are too long for the motion, of a scene
            whose numbers are traced: otherwise such steps are refused.
    """

    speeds: Float[Array, " n"]
    orders: Float[Array, " harmonic"]
    amplitudes: Float[Array, "n harmonic"]
    peak_to_peak: Float[Array, " n"]
    dynamic_factor: Float[Array, " n"]
    stable: Bool[Array, " n"]
    result: Int[Array, " n"]


@arguments.checked(steps=arguments.whole(8), settle=arguments.whole(0), harmonics=arguments.whole(1))
def waterfall(
    scene: Scene,
    torque: ArrayLike,
    speeds: ArrayLike,
    *,
    harmonics: int = 8,
    steps: int = 128,
    settle: int = 0,
    order: str = "mesh",
) -> Waterfall:
    """Motion that repeats with an order, at many input speeds in one batch, by the shooting method (`shooting`).

    Each speed starts from its own equilibrium. If several motions are possible at a speed, the result is the one to
    which this start leads, or the one reached after ``settle`` periods. `speed_sweep` follows the branches instead.

    Args:
        scene: the scene, with compliance, load and inertia; its whole excitation must repeat with the order.
        torque: size of the load torque [N m].
        speeds: input speeds, shape (n,) [rad/s].
        harmonics: number of multiples of the order that are reported.
        steps: steps per period, a multiple of 8 and at least four times ``harmonics``.
        settle: number of periods to integrate before shooting.
        order: name of the order that gives the period.

    Raises:
        SceneError: the scene lacks a part, the number of steps is not allowed, or the steps are too long for its
            fastest motion at a speed.
        ParameterError: there is no such order, or a speed is not positive.
    """
    speeds = at_speeds(scene, speeds, order)
    if steps % 8 or steps < 4 * harmonics:
        raise SceneError(f"steps = {steps}: must be a multiple of 8, and at least {4 * harmonics} for these harmonics")
    turns, torque = scene.system.orders[order], jnp.asarray(torque, scene.dtype)
    check_repeats(scene, 2 * np.pi / turns, speeds)
    physics = scene.precomputed(*MODELLED)
    check_resolved_at(physics, torque, turns, speeds, steps)
    return _waterfall(physics, torque, speeds, harmonics, steps, settle, turns)


@eqx.filter_jit
def _waterfall(
    scene: Scene, torque: Scalar, speeds: Array, harmonics: int, steps: int, settle: int, turns: float
) -> Waterfall:
    def at(speed: Scalar) -> tuple[Array, ...]:
        problem = at_speed(scene, torque, turns, speed)
        motion = shoot(problem, steps, None, settle, 40)
        lines = 2 / steps * jnp.abs(jnp.fft.rfft(motion.te)[1 : harmonics + 1])
        parts = problem.scene.structure(problem.scene.contacts(jnp.zeros_like(speed)))
        rates = (2 * jnp.pi / problem.period * jnp.arange(steps // 2 + 1).astype(speed.dtype))[:, None]
        springs, dampers, masses = (part[:1] for part in (parts.stiffness, parts.damping, parts.mass))
        dynamic_stiffness = jax.lax.complex(springs - rates * rates * masses, rates * dampers)
        held = jnp.fft.irfft((jnp.fft.rfft(motion.q, axis=0) * dynamic_stiffness).sum(axis=1), steps)
        if not problem.scene.system.turns_evenly:  # torque that accelerates the ideal output
            held = held + parts.mass[0, 0] * jax.vmap(problem.scene.system.output_acceleration)(motion.ts)
        course = problem.scene.load
        assert course is not None  # `at_speeds` requires it
        load = torque * course.shape(speed * motion.ts / (2 * jnp.pi), motion.ts, problem.scene.system.orders)
        factor = jnp.max((load + held - parts.push[0]) / torque)
        return lines, motion.peak_to_peak, factor, motion.stable, motion.result

    several = OF_SEVERAL if len(scene.layout.pair) <= len(scene.coordinates) else OF_CONTACTS
    most = OF_ONE if scene.output_alone else several
    found = in_batches(at, speeds, most)
    orders = turns * jnp.arange(1, harmonics + 1).astype(speeds.dtype)
    return Waterfall(speeds, orders, *found)
