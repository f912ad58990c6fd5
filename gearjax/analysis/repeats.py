"""The motion that a scene settles to, and the number of periods after which it repeats, if it does.

From a distant guess Newton's method may assume wrong contact states; integration never does. Therefore the motion is
integrated until it returns to its state of one or several periods before. Newton's method then makes it exact.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.periodic import Periodic, check_resolved, shoot
from gearjax.analysis.return_map import Problem, return_map
from gearjax.checks import SceneError, is_concrete
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike

ROUND = 12  # periods that are integrated before each check for a return
RETURNED = 1e-3  # distance of a return, over the size of the motion, below which Newton's method starts
NEUTRAL = 1e-6  # distance of multipliers outside the unit circle that counts as neutral
SAME = 1e-4  # largest way of Newton's method from the return, over the size of the motion


@arguments.checked(steps=arguments.whole(8), longest=arguments.whole(1), settle=arguments.whole(1))
def periodic_motion(
    scene: Scene,
    torque: ArrayLike,
    period: ArrayLike,
    *,
    steps: int = 512,
    longest: int = 4,
    settle: int = 240,
) -> Periodic:
    """Periodic motion that a scene settles to from its equilibrium, over one period or several.

    A motion with impacts may repeat only after two or three periods of the excitation, or never. The motion starts from
    the state at which a linear structure would be periodic, and is integrated until it returns. The shooting method
    then finds it exactly, with multipliers and implicit derivatives. Unstable motions, which `shooting` may find, are
    not returned.

    Args:
        scene: the scene, with compliance, load and inertia; not under `jax.jit` or `jax.vmap`.
        torque: size of the load torque [N m].
        period: common period of the whole excitation [s].
        steps: steps per period, as for `shooting`, a multiple of 8.
        longest: largest number of periods after which the motion may repeat.
        settle: largest number of periods to integrate, in rounds of twelve, or of ``longest`` plus one.

    Returns:
        The motion over ``periods`` periods. If the motion does not return to itself, ``result`` is 2 and the motion
        covers the last periods; `growth_rate` then shows whether it is chaotic.

    Raises:
        SceneError: the scene lacks a part, ``steps`` is not a multiple of 8 or too few for the fastest motion, numbers
            are traced, or there is no equilibrium to start from.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> period = 1 / (scene.system.orders["mesh"] * float(scene.system.input_speed) / (2 * 3.141592653589793))
        >>> calm = gj.Scene(scene.system, compliance=scene.compliance, load=scene.load, inertia=scene.inertia,
        ...                 damping=scene.damping)
        >>> gj.periodic_motion(calm, 100.0, period, steps=64).periods
        1
    """
    if steps % 8:
        raise SceneError(f"steps = {steps}: must be a multiple of 8")
    problem = Problem.of(scene, torque, period)
    if not is_concrete(problem):
        raise SceneError(
            "periodic_motion needs known numbers, not traced ones: use shooting under jit, vmap and gradients"
        )
    check_resolved(problem, steps)
    state, scale = _linear_start(problem, steps)
    if not bool(jnp.isfinite(state).all()):
        raise SceneError(
            f"there is no equilibrium to start from: no flank carries torque = {float(problem.torque):g} N*m"
        )
    for _ in range(-(-settle // ROUND)):
        state, ends = _some(problem, steps, state, max(ROUND, longest + 1))
        ends = np.asarray(ends)
        away = [_distance(ends[-1], ends[-1 - periods]) for periods in range(1, longest + 1)]
        for periods in (number for number, distance in enumerate(away, start=1) if distance < RETURNED):
            motion = _shot(problem, steps, state * scale, periods)
            begins = np.asarray(motion.start).reshape(2, -1) / np.asarray(scale)
            near = _distance(begins, ends[-1]) < max(SAME, 10 * away[periods - 1])
            stays = bool((jnp.abs(motion.multipliers) < 1 + NEUTRAL).all())  # undamped motions neither grow nor die out
            if int(motion.result) == 0 and stays and near:
                return motion
    return dataclasses.replace(_shot(problem, steps, state * scale, longest, search=0), result=jnp.asarray(2))


def _distance(one: np.ndarray, other: np.ndarray) -> float:
    """Largest distance of two scaled states, relative to the size of the motion."""
    far, size = float(np.abs(one - other).max()), float(np.abs(one[0]).max())
    return far / size if size > 0 and np.isfinite(far) else (0.0 if far == 0 else np.inf)


def _shot(problem: Problem, steps: int, guess: Array, periods: int, search: int = 40) -> Periodic:
    """Shooting from a state over several periods; with ``search`` 0 the motion is integrated only."""
    several = problem._replace(period=problem.period * periods)
    motion = shoot(several, periods * steps, guess, 0, search)
    return dataclasses.replace(motion, periods=periods)


@eqx.filter_jit
def _linear_start(problem: Problem, steps: int) -> tuple[Array, Array]:
    """Scaled initial state of the motion that would be periodic if the contacts kept their first state, and its scale.

    The state is one Newton step away from the equilibrium.
    """
    motion = return_map(problem, steps)
    begin = motion.resting()
    ended, slope = motion.end_and_slope(begin.ravel())
    lacking = ended - begin.ravel()
    start = begin + jnp.linalg.solve(jnp.eye(len(lacking), dtype=begin.dtype) - slope, lacking).reshape(begin.shape)
    return jnp.where(jnp.isfinite(start).all(), start, begin), motion.scale


@eqx.filter_jit
def _some(problem: Problem, steps: int, state: Array, number: int) -> tuple[Array, Array]:
    """The state after a number of periods, and the states at the start and after each period."""
    motion = return_map(problem, steps)

    def once(state: Array, _: None) -> tuple[Array, Array]:
        end = motion.end(state)
        return end, end

    end, ends = jax.lax.scan(once, state, None, length=number)
    return end, jnp.concatenate([state[None], ends])
