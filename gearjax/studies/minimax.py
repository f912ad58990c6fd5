"""Polish of a sum of largest values: its epigraph form, solved by proximal linear steps.

    minimise sum_k w_k s_k   subject to   v_kj(x) <= s_k

The values are local extremes of a curve over time. Each step linearises all of them, so that no active set has to be
chosen, adds ``mu |d|^2 / 2`` and solves this convex quadratic programme by a primal-dual interior-point method (Nocedal
and Wright 2006, ch. 16). A step that does not lower the sum is taken back, and mu grows. If steps reach the predicted
decrease, mu falls, and the optimum at a kink is then approached as fast as by Newton's method. One start; batched by
vmap.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.elimination import eliminated
from gearjax.studies.objective import Pieces
from gearjax.typing import Array, Float, Scalar

INTERIOR_STEPS = 12
FIRST_MU, SMALLEST_MU, LARGEST_MU = 0.1, 1e-4, 1e6
LONGEST = 1.0  # longest step of one scaled number
LEAST = 1e-3  # smallest size of an objective in `least_slope`, over its slope
NEAR = 0.01  # step per slope, relative to the objective, in `least_slope`


class Polished(NamedTuple):
    """The end of a polish.

    Args:
        numbers: scaled numbers at the end, shape (free,).
        value: the objective at the end.
        promise: share of the objective by which one more step would lower it, by the linear model.
        history: the best objective after each evaluation, shape (steps,).
    """

    numbers: Float[Array, " free"]
    value: Scalar
    promise: Scalar
    history: Float[Array, " step"]


def polish(
    pieces: Callable[[Float[Array, " free"]], list[Pieces]],
    start: Float[Array, " free"],
    lowest: np.ndarray,
    highest: np.ndarray,
    steps: int,
    bend: Callable[[Float[Array, " free"]], Float[Array, "free free"]] | None = None,
) -> Polished:
    """Lower a sum of largest values, from one start.

    Args:
        pieces: function from scaled numbers, shape (free,), to values and weights.
        start: scaled numbers to start from, shape (free,).
        lowest, highest: bounds, infinite for an unbounded number, shape (free,) each.
        steps: number of evaluations of the pieces and their derivatives.
        bend: function from scaled numbers to the curvature of the smooth part of the objective, positive semidefinite;
            ``None`` for no curvature.
    """
    dtype = start.dtype
    group = groups(pieces, start)

    def step(carry, _):
        best, trial, value, promised, values, slopes, curvature, mu = carry
        new_values, new_slopes, weights, new = linearised(pieces, trial, group)
        better = new < value
        kept = (value - new) / jnp.maximum(value - promised, jnp.finfo(dtype).tiny)
        change = jnp.where(kept > 0.7, 0.25, jnp.where(kept > 0.3, 1.0, 4.0))
        mu = jnp.clip(mu * jnp.where(jnp.isfinite(value), change, 1.0), SMALLEST_MU, LARGEST_MU)
        best = jnp.where(better, trial, best)
        value = jnp.where(better, new, value)
        values = jnp.where(better, new_values, values)
        slopes = jnp.where(better, new_slopes, slopes)
        if bend is not None:
            curvature = jnp.where(better, bend(trial), curvature)
        scale = jnp.abs(value) + jnp.finfo(dtype).tiny
        below = jnp.maximum(jnp.asarray(lowest, dtype) - best, -LONGEST)
        above = jnp.minimum(jnp.asarray(highest, dtype) - best, LONGEST)
        matrix = curvature / scale + mu * jnp.eye(start.shape[0], dtype=dtype)
        move, model = proximal_step(values / scale, slopes / scale, weights, group, matrix, below, above)
        move = jnp.clip(move, below, above)
        return (best, best + move, value, model * scale, values, slopes, curvature, mu), value

    size = group.shape[0]
    infinite = jnp.asarray(jnp.inf, dtype)
    free = start.shape[0]
    empty = tuple(jnp.zeros(shape, dtype) for shape in ((size,), (size, free), (free, free)))
    begin = (start, start, infinite, infinite, *empty, jnp.asarray(FIRST_MU, dtype))
    (best, _, value, promised, *_), history = jax.lax.scan(step, begin, None, length=steps)
    promise = (value - promised) / (jnp.abs(value) + jnp.finfo(dtype).tiny)
    return Polished(best, value, promise, history)


def groups(pieces: Callable[[Float[Array, " free"]], list[Pieces]], numbers: Float[Array, " free"]) -> np.ndarray:
    """Number of the largest value (the piece) to which each value belongs, shape (m,)."""
    sizes = [piece.values.shape[0] for piece in jax.eval_shape(pieces, numbers)]
    return np.repeat(np.arange(len(sizes)), sizes)


def linearised(
    pieces: Callable[[Float[Array, " free"]], list[Pieces]], numbers: Float[Array, " free"], group: np.ndarray
) -> tuple[Float[Array, " m"], Float[Array, "m free"], Float[Array, " k"], Scalar]:
    """Values, their slopes, the weights of the pieces, and the weighted sum of the largest values.

    ``group`` is from `groups`.
    """

    def both(numbers):
        parts = pieces(numbers)
        values = jnp.concatenate([piece.values for piece in parts])
        return values, (values, jnp.stack([jnp.asarray(piece.weight, numbers.dtype) for piece in parts]))

    slopes, (values, weights) = jax.jacfwd(both, has_aux=True)(numbers)
    tops = [values[group == k].max() for k in range(weights.shape[0])]  # never differentiated
    return values, slopes, weights, (weights * jnp.stack(tops)).sum()


def least_slope(
    pieces: Callable[[Float[Array, " free"]], list[Pieces]], numbers: Float[Array, " free"]
) -> Float[Array, " free"]:
    """The gradient, or at a kink the shortest vector in the convex hull of the gradients: zero at an optimum.

    At a kink several values are the largest. Values that a step of `NEAR` could make the largest count as well.
    """
    group = groups(pieces, numbers)
    values, slopes, weights, value = linearised(pieces, numbers, group)
    least = LEAST * jnp.abs(slopes).max(initial=0.0)  # the value itself may be zero
    scale = jnp.maximum(jnp.abs(value), least) + jnp.finfo(numbers.dtype).tiny
    far, bend = jnp.full_like(numbers, LONGEST), jnp.eye(numbers.shape[0], dtype=numbers.dtype) / NEAR
    step, _ = proximal_step(values / scale, slopes / scale, weights, group, bend, -far, far)
    return -step * scale / NEAR


def proximal_step(
    values: Float[Array, " m"],
    slopes: Float[Array, "m free"],
    weights: Float[Array, " k"],
    group: np.ndarray,
    bend: Float[Array, "free free"],
    below: Float[Array, " free"],
    above: Float[Array, " free"],
) -> tuple[Float[Array, " free"], Scalar]:
    """The step d that minimises ``sum_k w_k max_j (v_kj + g_kj d) + d' B d / 2`` within a box.

    Args:
        values, slopes: v and g, shapes (m,) and (m, free).
        weights: w, shape (k,).
        group: k of each value, shape (m,).
        bend: B, positive definite, shape (free, free).
        below, above: the box, shape (free,) each.

    Returns:
        The step, shape (free,), and the modelled objective after it.
    """
    free, dtype = slopes.shape[1], values.dtype
    member = jnp.asarray(group[:, None] == np.arange(weights.shape[0]), dtype)
    unit = jnp.eye(free, dtype=dtype)
    none = jnp.zeros((free, weights.shape[0]), dtype)
    rows = jnp.concatenate(
        [jnp.concatenate([-slopes, member], 1), jnp.concatenate([unit, none], 1), jnp.concatenate([-unit, none], 1)]
    )
    limits = jnp.concatenate([values, below, -above])  # rows z >= limits, z = (d, s)
    padded = jnp.diag(jnp.full((free + weights.shape[0],), 1e-12, dtype)).at[:free, :free].add(bend)
    cost = jnp.concatenate([jnp.zeros((free,), dtype), weights])
    tops = jnp.where(member > 0, values[:, None], -jnp.inf).max(axis=0)
    point = jnp.concatenate([jnp.zeros((free,), dtype), tops + 0.1])
    slack = jnp.maximum(rows @ point - limits, 1e-2)
    shares = (member * (weights / member.sum(axis=0))[None, :]).sum(axis=1)
    prices = jnp.concatenate([shares, jnp.full((2 * free,), 1e-2, dtype)])

    def newton(_, state):
        point, slack, prices = state
        target = 0.1 * (slack * prices).mean()
        missing = rows @ point - limits - slack
        ratio = prices / slack
        matrix = padded + rows.T @ (ratio[:, None] * rows)
        right = rows.T @ (target / slack - ratio * missing) - padded @ point - cost
        change = eliminated(matrix, right[:, None])[:, 0]
        slack_change = rows @ change + missing
        price_change = (target - prices * slack_change) / slack - prices
        limit = jnp.maximum((-slack_change / slack).max(), (-price_change / prices).max())
        length = jnp.minimum(1.0, 0.95 / jnp.maximum(limit, 1e-9))
        return point + length * change, slack + length * slack_change, prices + length * price_change

    point, _, _ = jax.lax.fori_loop(0, INTERIOR_STEPS, newton, (point, slack, prices))
    step = point[:free]
    return step, (weights * point[free:]).sum() + 0.5 * step @ bend @ step
