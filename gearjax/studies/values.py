"""Values of an objective at many points, in blocks of one shape, so that any number of points compiles once."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError
from gearjax.contact import ContactSet
from gearjax.scene import Scene
from gearjax.studies.blocks import in_blocks
from gearjax.studies.objective import Objective
from gearjax.studies.select import Free, probed
from gearjax.typing import Array, Float, Scalar

BLOCKS = (16, 64, 512, 8192)
CALL = 16  # cost of the call of a block, in points
MOST_AT_ONCE = 512
MOST_SAMPLES = 2**21  # samples times points computed at once, for motions
MOST_GAPS = 2**19  # samples times contacts times points computed at once: more do not fit into the processor's cache
TRIED = 12  # points at which the influence of a number is tested
Values = Callable[[np.ndarray], np.ndarray]


def values(objective: Objective, scene: Scene, free: Free, kind: str = "hard", block: int | None = None) -> Values:
    """A function from points, shape (n, free), to objectives, shape (n,).

    Args:
        objective: the objective.
        scene: the scene.
        free: the free numbers.
        kind: ``"hard"``, ``"refined"`` or ``"sampled"``: method of the objective, from the slowest to the fastest.
        block: number of points of a block, so that one program serves any number of points; by default the best one of
            `BLOCKS` for each number of points.
    """
    physics, dtype = objective.physics(scene, free), objective.theta.dtype
    at_once = _at_once(objective, physics)

    def evaluate(points: np.ndarray) -> np.ndarray:
        size = block or min(BLOCKS, key=lambda size: -(-len(points) // size) * (size + CALL))  # the last is padded
        batch = min(at_once, size)
        return in_blocks(
            lambda part: _block(objective, physics, free, jnp.asarray(part, dtype), kind, batch), size, points
        )

    return evaluate


def _at_once(objective: Objective, physics: Scene) -> int:
    """Number of points that are computed at once: a power of two, which divides a block."""
    samples = objective.theta.shape[0]
    if objective.function is not None or objective.is_dynamic:
        most = MOST_SAMPLES // samples
    else:
        most = MOST_GAPS // (samples * jax.eval_shape(_contacts, physics, objective.theta[0]).gap.shape[0])
    if objective.scatter is not None:
        most //= len(objective.scatter.values)
    return 1 << (max(1, min(MOST_AT_ONCE, most)).bit_length() - 1)


def _contacts(physics: Scene, theta: Scalar) -> ContactSet:
    """The contacts at an input angle. As a function, not a bound method, jax caches its shapes and traces it once."""
    return physics.contacts(theta)


@eqx.filter_jit
def _block(objective: Objective, physics: Scene, free: Free, points: Float[Array, "n free"], kind: str, batch: int):
    def one(point: Float[Array, " free"]):
        return getattr(objective, kind)(free.set(physics, point))

    return jax.lax.map(one, points, batch_size=batch)


def require_influence(
    objective: Objective, scene: Scene, free: Free, low: np.ndarray, high: np.ndarray, kind: str = "sampled"
) -> None:
    """Refuse a free number that does not change the objective, tested at some points.

    Args:
        objective, scene, free: objective, scene and free numbers of the study.
        low, high: limits between which points are drawn, shape (free,) each.
        kind: method of the objective, as in `values`.

    Raises:
        ParameterError: names the number.
    """
    rng = np.random.default_rng(0)
    size = len(free.paths)
    points = low + rng.random((TRIED, size)) * (high - low)
    moved = np.repeat(points[None], size, axis=0)
    for index in range(size):
        moved[index, :, index] = low[index] + rng.random(TRIED) * (high[index] - low[index])
    evaluate = values(objective, probed(scene, free), free, kind)
    objectives = evaluate(np.concatenate([points, moved.reshape(-1, size)])).reshape(size + 1, TRIED)
    for index, path in enumerate(free.paths):
        same = (objectives[index + 1] == objectives[0]) | ~np.isfinite(objectives[index + 1] + objectives[0])
        if high[index] > low[index] and np.isfinite(objectives).any() and same.all():
            raise ParameterError("where", path, f"the objective {objective.name} does not depend on it")
