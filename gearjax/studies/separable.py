"""Grid search of the no-load transmission error, which uses that gaps are sums of contributions of single errors.

A grid over numbers of errors therefore needs sines only once per axis (free number), level and time:
``te_i(t) = base_i(t) + sum_axis table_axis[level, t, i]``. The highest value over time and pairs is the largest of the
pairs' own highest values; only the lowest value, ``min_t max_i te_i``, needs every combination. An outer loop, called
the walk, runs over the axes that affect several pairs. Axes that affect one pair only form an outer product inside it.
The walk is distributed over the local devices.

The minimum is certified: any subset of times bounds the amplitude from below, so combinations whose bound exceeds an
amplitude already reached are excluded. The others are evaluated on all times.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from gearjax.evaluate import accepted
from gearjax.scene import Scene
from gearjax.studies.blocks import in_blocks
from gearjax.studies.select import Free, pick
from gearjax.typing import Array, Float

BLOCK = 16  # times by which the inner loop is unrolled
TOGETHER = 4  # outer combinations computed together
COARSE, MEDIUM = 16, 96  # times from which the lowest and the highest value are bounded
SURVIVORS = 512  # combinations evaluated at once
WIDE = ({"xla_cpu_prefer_vector_width": 512},)
"""Full vectors of processors with AVX-512, for a program of sums and comparisons; see `gearjax.xla` on other ones."""


class Contributions(NamedTuple):
    """Contributions to the transmission error of each pair [rad].

    Args:
        base: contribution of everything that is not free, shape (time, pair).
        axes: contributions of each free number, shape (level, time, pair) each.
    """

    base: Float[Array, "time pair"]
    axes: tuple[Float[Array, "level time pair"], ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of levels of each axis."""
        return tuple(axis.shape[0] for axis in self.axes)


def is_separable(scene: Scene, free: Free) -> bool:
    """Whether the TE is a sum over free numbers: each belongs to another error, and the same contacts always drive.

    In a layout whose ``sides_turn``, the driving contacts change with the input angle. In a train, the touching
    contacts change as its shafts turn. Exact gaps of several errors are no sums.
    """
    owners = [tuple(path.split(".")[:2]) for path in free.paths]
    apart = all(owner[0] == "errors" for owner in owners) and len(set(owners)) == len(owners)
    return apart and not (scene.layout.sides_turn or scene.is_train or scene.system.exact)


@eqx.filter_jit
def contributions(scene: Scene, free: Free, levels: tuple[Array, ...], theta: Float[Array, " time"]) -> Contributions:
    """The contributions of a scene over the levels of its free numbers; only the hard no-load TE is separable."""

    def each(scene: Scene) -> Float[Array, "time pair"]:
        def at(angle):
            contacts = scene.contacts(angle)
            return (contacts.gap / contacts.lever)[contacts.layout.on(1)]

        return jax.vmap(at)(theta)

    scene = scene.physics()
    owners = [path.split(".")[1] for path in free.paths]
    ideal = eqx.tree_at(lambda s: s.errors, scene, {})
    rest = {key: error for key, error in scene.errors.items() if key not in owners}
    zero = each(ideal)
    base = each(eqx.tree_at(lambda s: s.errors, scene, rest)) if rest else zero

    def alone(path: str, owner: str, levels: Array) -> Float[Array, "level time pair"]:
        bare = eqx.tree_at(lambda s: s.errors, scene, {owner: scene.errors[owner]})
        chosen = pick(bare, path)

        def one(level):
            return each(chosen.set(bare, level[None])) - zero

        return jax.vmap(one)(levels)

    return Contributions(base, tuple(alone(*item) for item in zip(free.paths, owners, levels, strict=True)))


class Plan(NamedTuple):
    """Axes of the walk and axes inside it, found from where the contributions are zero."""

    outer: tuple[int, ...]
    inner: tuple[tuple[int, ...], ...]  # per pair

    @property
    def axes(self) -> tuple[int, ...]:
        """All axes, the outer ones first, in the order in which combinations are numbered."""
        return (*self.outer, *(axis for inner in self.inner for axis in inner))


def plan(contributions: Contributions) -> Plan:
    """The plan of a grid: axes that affect one pair are inner axes, all others are outer axes."""
    felt = [np.any(np.asarray(axis), axis=(0, 1)) for axis in contributions.axes]
    inner = tuple(
        tuple(a for a, pairs in enumerate(felt) if pairs.sum() == 1 and pairs[i])
        for i in range(contributions.base.shape[1])
    )
    outer = tuple(a for a, pairs in enumerate(felt) if pairs.sum() != 1)
    return Plan(outer, inner)


class Grid(NamedTuple):
    """The contributions arranged for the walk: curves of each pair, and the contributions of outer combinations.

    Args:
        own: curves over the inner axes of each pair, shape (time, inner) each, in the order of `itertools.product`.
        outer: contribution of each outer combination, shape (outer, time, pair).
    """

    own: tuple[Float[Array, "time inner"], ...]
    outer: Float[Array, "outer time pair"]


@functools.partial(jax.jit, static_argnames=("plan", "number"))
def lay_out(contributions: Contributions, plan: Plan, number: int) -> Grid:
    """The grid at ``number`` evenly spread times; the last time is repeated to fill up blocks."""
    size = contributions.base.shape[0]
    times = np.linspace(0, size - 1, min(number, size)).round().astype(int)
    block = min(BLOCK, len(times))
    times = np.concatenate([times, np.repeat(times[-1:], -len(times) % block)])
    base = contributions.base[times]
    axes = [axis[:, times] for axis in contributions.axes]

    def combined(chosen: tuple[int, ...]) -> Float[Array, "combination time pair"]:
        total = jnp.zeros((1, *base.shape), base.dtype)
        for axis in chosen:
            total = (total[:, None] + axes[axis][None, :]).reshape(-1, *base.shape)
        return total

    own = tuple((combined(inner) + base[None])[:, :, i].T for i, inner in enumerate(plan.inner))
    return Grid(own, combined(plan.outer))


def walk(
    own: tuple[Array, ...], shift: Float[Array, "time pair"]
) -> tuple[Float[Array, "..."], list[Float[Array, " inner"]]]:
    """Lowest values of one outer combination, and the highest values of each pair.

    The lowest values are ``min_t max_i te_i``, shape (inner of pair 1, inner of pair 2, ...); the highest values have
    the shape (inner,) for each pair. Maxima are written as selections: a maximum that propagates nan takes twice the
    time.
    """
    sizes = tuple(curve.shape[1] for curve in own)
    block = min(BLOCK, shift.shape[0])
    rows = [(curve + shift[:, i, None]).reshape(-1, block, sizes[i]) for i, curve in enumerate(own)]

    def several(carry, rows):
        low, tops = carry
        for time in range(block):
            now = [row[time] for row in rows]
            largest = _largest(now)
            low = jnp.where(largest < low, largest, low)
            tops = [_greater(top, row) for top, row in zip(tops, now, strict=True)]
        return (low, tops), None

    tops = [jnp.full((size,), -jnp.inf, shift.dtype) for size in sizes]
    return jax.lax.scan(several, (jnp.full(sizes, jnp.inf, shift.dtype), tops), rows)[0]


def score(low: Array, high: Array, spread: bool) -> Array:
    """Peak-to-peak (``spread``) or amplitude, from the lowest and the highest value."""
    return high - low if spread else jnp.maximum(high, -low)


def sweep(lowest: Grid, highest: Grid | None, spread: bool) -> tuple[Float[Array, "outer ..."], Float[Array, " outer"]]:
    """Score of every combination at the times of two grids, and the least score of each outer combination.

    Args:
        lowest, highest: grids at the times used for the lowest and the highest values; if ``highest`` is ``None``,
            ``lowest`` serves for both.
        spread: whether scores are peak-to-peak values instead of amplitudes.
    """
    return _sweep_program()(lowest, highest, spread)


@functools.cache
def _sweep_program() -> Callable[[Grid, Grid | None, bool], tuple[Array, Array]]:
    return jax.jit(_sweep, static_argnames="spread", compiler_options=accepted(WIDE))


def _sweep(lowest: Grid, highest: Grid | None, spread: bool) -> tuple[Array, Array]:
    devices = jax.local_devices()
    grids = (lowest,) if highest is None else (lowest, highest)
    missing = -lowest.outer.shape[0] % len(devices)
    shifts = tuple(jnp.concatenate([grid.outer, grid.outer[:missing]]) for grid in grids)
    sizes = tuple(curve.shape[1] for curve in lowest.own)

    def part(shifts, curves):
        def one(shift):
            low, tops = walk(curves[0], shift[0])
            if highest is not None:
                tops = walk(curves[1], shift[1])[1]
            inner = score(low, _largest(tops), spread)[tuple(slice(size) for size in sizes)]
            return inner, inner.min()

        return jax.lax.map(one, shifts, batch_size=TOGETHER)

    along = PartitionSpec("outer")
    spread_out = jax.shard_map(
        part, mesh=Mesh(devices, ("outer",)), in_specs=(along, PartitionSpec()), out_specs=along, check_vma=False
    )
    scores, least = spread_out(shifts, tuple(_padded(grid.own) for grid in grids))
    count = lowest.outer.shape[0]
    return scores[:count], least[:count]


def _padded(own: tuple[Array, ...]) -> tuple[Array, ...]:
    """The curves of all pairs, those of the last pair padded to whole vectors of the processor."""
    lanes = 64 // own[-1].dtype.itemsize
    return (*own[:-1], jnp.pad(own[-1], ((0, 0), (0, -own[-1].shape[1] % lanes)), mode="edge"))


def _greater(one: Array, other: Array) -> Array:
    return jnp.where(one > other, one, other)


def _largest(rows: list[Array]) -> Float[Array, "..."]:
    """Largest value of the pairs for each combination of inner axes, shape (inner of pair 1, inner of pair 2, ...)."""
    axes = range(len(rows))
    return functools.reduce(_greater, [jnp.expand_dims(row, [a for a in axes if a != i]) for i, row in enumerate(rows)])


def scores_at(contributions: Contributions, plan: Plan, flat: np.ndarray, spread: bool) -> np.ndarray:
    """Scores over all times of combinations, which are given by their number in the order of the walk, shape (n,)."""

    def each(part: np.ndarray) -> Float[Array, " n"]:
        return _scores_at(contributions, levels_of(part, plan, contributions.shape), spread)

    return in_blocks(each, SURVIVORS, flat)


@functools.partial(jax.jit, static_argnames="spread")
def _scores_at(contributions: Contributions, levels: tuple[Array, ...], spread: bool) -> Float[Array, " n"]:
    def one(levels):
        curve = contributions.base
        for axis, level in zip(contributions.axes, levels, strict=True):
            curve = curve + axis[level]
        te = curve.max(axis=1)
        return score(te.min(), te.max(), spread)

    return jax.lax.map(one, levels, batch_size=16)


def levels_of(flat: np.ndarray, plan: Plan, shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Level of each axis from the number of a combination in the order of the walk."""
    levels = np.unravel_index(flat, tuple(shape[axis] for axis in plan.axes))
    by_axis = dict(zip(plan.axes, levels, strict=True))
    return tuple(by_axis[axis] for axis in range(len(shape)))


class Best(NamedTuple):
    """Combinations that may be among the best, sorted by their scores over all times, best first.

    Args:
        flat: numbers of the combinations in the order of the walk.
        scores: scores of the combinations.
        evaluated: how many combinations were evaluated on all times.
    """

    flat: np.ndarray
    scores: np.ndarray
    evaluated: int


def certified(contributions: Contributions, plan: Plan, *, spread: bool, keep: int, reach=None) -> Best:
    """All combinations that may be among the best: others are excluded by bounds, these are evaluated on all times.

    Args:
        contributions, plan: the grid.
        spread: whether scores are peak-to-peak values instead of amplitudes.
        keep: number of best combinations.
        reach: function from combinations to objectives, which are not below the scores. It is evaluated for the
            ``keep`` best combinations by score; combinations whose bound is above the worst of these objectives are
            excluded. Without it, objectives are the scores.
    """
    coarse, medium = (lay_out(contributions, plan, number) for number in (COARSE, MEDIUM))
    lower, least = (np.asarray(part) for part in sweep(coarse, medium, spread))
    inner = lower[0].size
    outers = np.argsort(least, kind="stable")[: 8 * keep]
    candidates = outers * inner + lower[outers].reshape(len(outers), -1).argmin(axis=1)
    if len(candidates) < keep:
        candidates = np.argsort(lower, axis=None, kind="stable")[: 8 * keep]
    first = scores_at(contributions, plan, candidates, spread)
    chosen = np.argsort(first, kind="stable")[:keep]
    reached = (first[chosen] if reach is None else reach(candidates[chosen])).max()
    survivors = np.flatnonzero(lower <= reached * (1 + 1e-12))  # the walk and `reach` are rounded differently
    values = scores_at(contributions, plan, survivors, spread)
    order = np.argsort(values, kind="stable")
    return Best(survivors[order], values[order], int(survivors.size))
