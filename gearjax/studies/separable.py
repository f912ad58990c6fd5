"""Grid search of the no-load transmission error, by its structure.

The gaps are sums of contributions of single errors, so a grid over numbers of errors needs sines once per axis, level
and time: ``te_i(t) = base_i(t) + sum_axis table_axis[level, t, i]``. The highest value over time of the largest pair is
the largest of the pairs' own highest values; only the lowest one, ``min_t max_i te_i``, needs every combination.
Axes that several pairs feel are walked outside, axes that one pair feels form the inner outer product.

Certified minimum: any subset of times bounds the amplitude from below, so combinations whose bound exceeds an amplitude
already reached are out; the rest is evaluated on all times.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.scene import Scene
from gearjax.studies.select import Free
from gearjax.typing import Array, Float

BLOCK = 32  # times written out in the inner loop


class Tables(NamedTuple):
    """Contributions to the transmission error of each pair [rad].

    Args:
        base: of everything that is not free, shape (time, pair).
        axes: of each free number, shape (level, time, pair) each.
    """

    base: Float[Array, "time pair"]
    axes: tuple[Float[Array, "level time pair"], ...]


def is_separable(free: Free) -> bool:
    """Whether every free number belongs to an error of its own."""
    owners = [tuple(path.split(".")[:2]) for path in free.paths]
    return all(owner[0] == "errors" for owner in owners) and len(set(owners)) == len(owners)


def tables(scene: Scene, free: Free, levels: tuple[np.ndarray, ...], theta: Float[Array, " time"]) -> Tables:
    """The tables of a scene; only its hard no-load TE is separable."""

    def each(scene: Scene) -> Float[Array, "time pair"]:
        def at(angle):
            contacts = scene.contacts(angle)
            return (contacts.gap / contacts.lever)[: contacts.pairs]

        return jax.vmap(at)(theta)

    owners = [path.split(".")[1] for path in free.paths]
    ideal = eqx.tree_at(lambda s: s.errors, scene, {})
    rest = {key: error for key, error in scene.errors.items() if key not in owners}
    zero = each(ideal)
    base = each(eqx.tree_at(lambda s: s.errors, scene, rest)) if rest else zero

    def alone(path: str, owner: str, levels: np.ndarray) -> Float[Array, "level time pair"]:
        name = path.split(".")[2]

        def one(level):
            error = eqx.tree_at(lambda e: getattr(e, name), scene.errors[owner], level)
            return each(eqx.tree_at(lambda s: s.errors, scene, {owner: error})) - zero

        return jax.vmap(one)(jnp.asarray(levels, theta.dtype))

    return Tables(base, tuple(alone(*item) for item in zip(free.paths, owners, levels, strict=True)))


class Plan(NamedTuple):
    """Which axes are walked outside and which inside, from where the tables are zero."""

    outer: tuple[int, ...]
    inner: tuple[tuple[int, ...], ...]  # per pair


def plan(tables: Tables) -> Plan:
    """Axes that one pair feels are inner, axes that several feel are outer."""
    felt = [np.asarray(jnp.abs(axis).max(axis=(0, 1)) > 0) for axis in tables.axes]
    inner = tuple(
        tuple(a for a, pairs in enumerate(felt) if pairs.sum() == 1 and pairs[i]) for i in range(tables.base.shape[1])
    )
    outer = tuple(a for a, pairs in enumerate(felt) if pairs.sum() != 1)
    return Plan(outer, inner)


class Grid(NamedTuple):
    """The tables laid out for the walk: own curves of each pair, and what every outer combination adds.

    Args:
        own: curves over the inner axes of each pair, shape (time, inner) each, in the order of `itertools.product`.
        outer: added by each outer combination, shape (outer, time, pair).
    """

    own: tuple[Float[Array, "time inner"], ...]
    outer: Float[Array, "outer time pair"]


def lay_out(tables: Tables, plan: Plan, times: np.ndarray) -> Grid:
    """The grid at some of the times."""
    base = tables.base[times]
    axes = [axis[:, times] for axis in tables.axes]

    def combined(chosen: tuple[int, ...]) -> Float[Array, "combination time pair"]:
        total = jnp.zeros((1, *base.shape), base.dtype)
        for axis in chosen:
            total = (total[:, None] + axes[axis][None, :]).reshape(-1, *base.shape)
        return total

    own = tuple((combined(inner) + base[None])[:, :, i].T for i, inner in enumerate(plan.inner))
    return Grid(own, combined(plan.outer))


@jax.jit
def lowest(grid: Grid) -> Float[Array, "outer ..."]:
    """``min_t max_i te_i`` of every combination, shape (outer, inner of pair 1, inner of pair 2, ...)."""
    missing = -grid.own[0].shape[0] % BLOCK
    own = [jnp.concatenate([curve, jnp.repeat(curve[-1:], missing, axis=0)]) for curve in grid.own]
    sizes = tuple(curve.shape[1] for curve in own)

    def walk(shift: Float[Array, "time pair"]) -> Float[Array, "..."]:
        shift = jnp.concatenate([shift, jnp.repeat(shift[-1:], missing, axis=0)])
        rows = [(curve + shift[:, i, None]).reshape(-1, BLOCK, sizes[i]) for i, curve in enumerate(own)]

        def block(low, rows):
            for time in range(BLOCK):
                low = jnp.minimum(low, _largest([row[time] for row in rows]))
            return low, None

        return jax.lax.scan(block, jnp.full(sizes, jnp.inf, shift.dtype), rows)[0]

    return jax.lax.map(walk, grid.outer)


@jax.jit
def highest(grid: Grid) -> Float[Array, "outer ..."]:
    """``max_t max_i te_i`` of every combination: the largest of the pairs' own, same shape as `lowest`."""

    def walk(shift: Float[Array, "time pair"]) -> Float[Array, "..."]:
        return _largest([(curve + shift[:, i, None]).max(axis=0) for i, curve in enumerate(grid.own)])

    return jax.lax.map(walk, grid.outer)


def _largest(rows: list[Array]) -> Float[Array, "..."]:
    """Largest of the pairs for every combination of their inner axes, shape (inner of pair 1, inner of pair 2, ...)."""
    axes = range(len(rows))
    return functools.reduce(
        jnp.maximum, [jnp.expand_dims(row, [a for a in axes if a != i]) for i, row in enumerate(rows)]
    )


@jax.jit
def range_at(tables: Tables, levels: tuple[Array, ...]) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Lowest and highest no-load TE over all times of single combinations, given the level of each axis, (n,) each."""

    def one(levels):
        curve = tables.base
        for axis, level in zip(tables.axes, levels, strict=True):
            curve = curve + axis[level]
        te = curve.max(axis=1)
        return te.min(), te.max()

    return jax.lax.map(one, levels, batch_size=64)
