"""Values of an objective at many points, in blocks of one shape so that any number of them compiles once."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError
from gearjax.scene import Scene
from gearjax.studies.blocks import in_blocks
from gearjax.studies.objective import Objective
from gearjax.studies.select import Free, probed
from gearjax.typing import Array, Float

BLOCKS = (16, 512, 8192)
MOST_AT_ONCE = 512
MOST_NUMBERS = 2**21  # samples times points worked on at once
TRIED = 12  # points from which a number is tried for its influence
Values = Callable[[np.ndarray], np.ndarray]


def values(objective: Objective, scene: Scene, free: Free, kind: str = "hard") -> Values:
    """A function from points, shape (n, free), to objectives, shape (n,).

    Args:
        objective: the objective.
        scene: the scene.
        free: the free numbers.
        kind: ``"hard"``, ``"refined"`` or ``"sampled"``: methods of the objective, the later the faster.
    """
    physics, dtype = objective.physics(scene, free), objective.theta.dtype

    def evaluate(points: np.ndarray) -> np.ndarray:
        block = next((size for size in BLOCKS if len(points) <= size), BLOCKS[-1])
        return in_blocks(lambda part: _block(objective, physics, free, jnp.asarray(part, dtype), kind), block, points)

    return evaluate


@eqx.filter_jit
def _block(objective: Objective, physics: Scene, free: Free, points: Float[Array, "n free"], kind: str):
    def one(point: Float[Array, " free"]):
        return getattr(objective, kind)(free.set(physics, point))

    batch = max(1, min(MOST_AT_ONCE, points.shape[0], MOST_NUMBERS // objective.theta.shape[0]))
    batch = 1 << (batch.bit_length() - 1)  # divides the block
    return jax.lax.map(one, points, batch_size=batch)


def require_influence(
    objective: Objective, scene: Scene, free: Free, low: np.ndarray, high: np.ndarray, kind: str = "sampled"
) -> None:
    """Refuse a free number that changes nothing, tried from some points.

    Args:
        objective, scene, free: what is studied.
        low, high: the box that points are drawn from, shape (free,) each.
        kind: of the values.

    Raises:
        ParameterError: naming the number.
    """
    rng = np.random.default_rng(0)
    size = len(free.paths)
    points = low + rng.random((TRIED, size)) * (high - low)
    moved = np.repeat(points[None], size, axis=0)
    for index in range(size):
        moved[index, :, index] = low[index] + rng.random(TRIED) * (high[index] - low[index])
    evaluate = values(objective, probed(scene, free), free, kind)
    found = evaluate(np.concatenate([points, moved.reshape(-1, size)])).reshape(size + 1, TRIED)
    for index, path in enumerate(free.paths):
        same = (found[index + 1] == found[0]) | ~np.isfinite(found[index + 1] + found[0])
        if high[index] > low[index] and np.isfinite(found).any() and same.all():
            raise ParameterError("where", path, f"the objective {objective.name} does not depend on it")
