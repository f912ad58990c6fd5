"""Extremes between samples of curves whose active contacts change with the input angle, for many gear sets at once.

Gaps and levers of single contacts are smooth in the input angle, even if the curve that results from them has kinks.
Near the highest places of a record they are therefore interpolated by polynomials through the angles around. The curve
is computed from them, closer and closer to its highest point, also at a kink.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.extremes import highest
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Int

PER_PERIOD = 4  # angles of the record that the polynomials need per period of the highest order
MOST = 64  # angles from one sample to the next
PLACES = 4  # highest places, and as many lowest ones, that are refined
REACH = 3  # angles on either side that a polynomial goes through
HALVINGS = 6  # of the distance between two angles
FITTING = 2e-3  # of the largest entry: error of polynomials through every other angle; through all it is a hundredth
PerContact = Float[Array, "contact lane"]
Curve = Callable[[PerContact, PerContact, Float[Array, " lane"]], Float[Array, " lane"]]


def places_between(scene: Scene, theta: Float[Array, " n"]) -> int | None:
    """Number of angles that polynomials need from one sample to the next; 1 if the samples are close enough.

    ``None`` if there are too many angles, or the samples are not evenly spaced.
    """
    if theta.shape[0] < 3:
        return None
    steps = np.diff(np.asarray(theta, dtype=float))
    if np.ptp(steps) > 1e-3 * steps.mean():
        return None
    return places_for(scene, float(steps.max()), theta.shape[0])


def places_for(scene: Scene, step: float, samples: int) -> int | None:
    """Number of angles that polynomials need from one evenly spaced sample to the next; ``None`` if too many.

    Args:
        scene: the scene.
        step: angle from one sample to the next [rad].
        samples: number of samples.
    """
    needed = np.ceil(PER_PERIOD * step * scene.system.fastest_order / (2 * np.pi) - 1e-3)
    places = max(1, int(needed), -(-2 * (2 * REACH + 1) // (samples - 1)))
    return places if places <= MOST else None


def closer(theta: Float[Array, " n"], places: int) -> Float[Array, " m"]:
    """The angles of the samples, and further angles evenly spaced between them [rad]."""
    number = theta.shape[0]
    steps = np.arange(places * (number - 1) + 1) / places
    return jnp.asarray(np.interp(steps, np.arange(number), np.asarray(theta)), theta.dtype)


def is_followed(table: Float[Array, "m ..."]) -> bool:
    """Whether polynomials through neighbours reproduce every entry; neighbours are twice as far apart as in `ends`."""
    values = np.asarray(table, dtype=float).reshape(len(table), -1)
    distances = np.arange(-2 * REACH + 1, 2 * REACH, 2)
    weights = [np.prod([-d / (c - d) for d in distances if d != c]) for c in distances]
    inner = np.arange(2 * REACH, len(values) - 2 * REACH)
    fitted = sum(weight * values[inner + distance] for weight, distance in zip(weights, distances, strict=True))
    return bool(np.abs(fitted - values[inner]).max(initial=0.0) <= FITTING * np.abs(values).max(initial=0.0))


def ends(
    curve: Curve,
    tables: Callable[[Int[Array, "node place row"]], tuple[Array, Array]],
    values: Float[Array, "m row"],
) -> tuple[Float[Array, " row"], Float[Array, " row"]]:
    """Highest and lowest value of a curve of each gear set, also between the angles of its record.

    Args:
        curve: function that computes the curve from levers and gaps, shape (contact, lane) each, and values nearby;
            lanes are the places of all gear sets, one after the other.
        tables: function from numbers of angles to levers and gaps, shape (node, contact, place, row) each.
        values: the curve at the angles.
    """
    number, rows = values.shape
    frozen = jax.lax.stop_gradient(values)
    best_of = jax.vmap(lambda column: highest(column, PLACES), in_axes=-1, out_axes=-1)
    tops = jnp.concatenate([best_of(frozen), best_of(-frozen)])  # (place, row)
    half = tops.shape[0] // 2
    sign = jnp.asarray(np.repeat([1.0, -1.0], half * rows), values.dtype)
    centre = jnp.clip(tops, REACH, number - 1 - REACH)
    nodes = centre[None] + jnp.arange(-REACH, REACH + 1, dtype=centre.dtype)[:, None, None]
    lever, gap = jax.lax.optimization_barrier(tuple(part.reshape(*part.shape[:2], -1) for part in tables(nodes)))
    first, last = (edge.ravel().astype(values.dtype) for edge in (-centre, number - 1 - centre))

    def at(place: Float[Array, " lane"], lever: Array, gap: Array) -> Float[Array, " lane"]:
        weights = _weights(place)[:, None]
        # the barrier makes XLA compute the sums once: fused with their uses, they would be computed for each use
        lever, gap = jax.lax.optimization_barrier(((weights * lever).sum(axis=0), (weights * gap).sum(axis=0)))
        return sign * curve(lever, gap, near)

    near = jnp.take_along_axis(frozen, tops, axis=0).ravel()
    fixed = jax.lax.stop_gradient((lever, gap))

    def closer_by(state: tuple[Array, Array, Array], step: Array) -> tuple[tuple[Array, Array, Array], None]:
        middle, place, best = state
        tried = jnp.clip(middle + step, first, last)
        value = at(tried, *fixed)
        better = value > best
        place, best = jnp.where(better, tried, place), jnp.where(better, value, best)
        return (jnp.where(step > 0, place, middle), place, best), None  # both sides are tried from the same middle

    start = (tops - centre).ravel().astype(values.dtype)
    steps = np.outer(0.5 ** np.arange(1, HALVINGS + 1), [-1.0, 1.0]).ravel()
    (_, place, _), _ = jax.lax.scan(closer_by, (start, start, sign * near), jnp.asarray(steps, values.dtype))
    peaks = at(jax.lax.stop_gradient(place), lever, gap).reshape(2, half, rows)
    best = jnp.argmax(jax.lax.stop_gradient(peaks), axis=1)[:, None]
    high, low = jnp.take_along_axis(peaks, best, axis=1)[:, 0]
    return high, -low


def _weights(place: Float[Array, " lane"]) -> Float[Array, "node lane"]:
    """Lagrange weights of the polynomial through the angles around a place, which counts from the middle angle."""
    nodes = np.arange(-REACH, REACH + 1)
    weights = []
    for one in nodes:
        weight = jnp.ones_like(place)
        for other in nodes[nodes != one]:
            weight = weight * (place - float(other)) * (1.0 / float(one - other))
        weights.append(weight)
    return jnp.stack(weights)
