"""Excitation of the steps of an oscillator, block by block: tables, or polynomials evaluated within a step.

Chebyshev nodes cover a block of steps. The steps of a single motion read a table, computed for one block at a time: XLA
without options makes one function of a loop of such small steps, but not of steps that sum over nodes, which then take
three times as long. Windows and batches, whose steps are vectors, sum over the nodes within each step; with a table,
windows take 1.3 to 1.5 times as long.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from gearjax.analysis import chebyshev
from gearjax.analysis.equation import Instant
from gearjax.analysis.fast.oscillator import Fast, Harmonics, Oscillator, Slow, mesh_phases, mesh_rate
from gearjax.dependence import depends
from gearjax.typing import Array, Float, Scalar

COARSE, EXACT = 20, 1e-14  # nodes that cover several blocks, and their accuracy, which is that of rounding


class StepForcing(NamedTuple):
    """Functions from rows to the excitation of steps.

    Args:
        at: function from one row to the numbers of its step.
        table: function from all rows to the numbers of all steps, each an array whose first axis is the row.
        put: function from such numbers to slow and fast excitation.
    """

    at: Callable[[Any], Any]
    table: Callable[[Any], Any]
    put: Callable[[Any], tuple[Slow, Fast]]

    def __call__(self, row: Any) -> tuple[Slow, Fast]:
        """Slow and fast excitation of the step of one row."""
        return self.put(self.at(row))


class Forcing(eqx.Module):
    """The signals that drive an oscillator.

    Args:
        oscillator: the driven oscillator.
        harmonics: harmonics of its stiffness.
        held: its slow signals at one time; their constant leaves are used.
        changing: for each leaf of the slow signals, whether it changes over time.
    """

    oscillator: Oscillator
    harmonics: Harmonics
    held: Slow
    changing: tuple[bool, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, oscillator: Oscillator, time: Scalar) -> "Forcing":
        """The signals of an oscillator; ``time`` [s] may be that of any sample."""
        changing = tuple(depends(oscillator.slow_at, time))
        return cls(oscillator, Harmonics.of(oscillator.equation), oscillator.slow_at(time), changing)

    @property
    def meshes_evenly(self) -> bool:
        """Whether stiffness follows from waves that turn at one rate; otherwise from the mesh phase of each step."""
        return self.held.phase is None

    def columns(self, instant: Instant) -> tuple[Scalar, ...]:
        """The changing slow signals at an instant, as separate numbers; a batch computes one vector for each."""
        leaves = jax.tree.leaves(self.oscillator.slow(instant))
        return tuple(n for leaf, new in zip(leaves, self.changing, strict=True) if new for n in _numbers(leaf.ravel()))

    def slow(self, columns: Sequence[Array] | Array) -> Slow:
        """The slow signals, with given values of the changing ones.

        Args:
            columns: changing signals, shape (column,); a list of numbers gives signals as tuples of numbers.
        """
        apart = not isinstance(columns, jax.Array)
        taken, leaves = 0, []
        for leaf, new in zip(jax.tree.leaves(self.held), self.changing, strict=True):
            part = columns[taken : taken + leaf.size] if new else _numbers(leaf.ravel()) if apart else leaf.ravel()
            taken += leaf.size if new else 0
            leaves.append(part[0] if leaf.ndim == 0 else tuple(part) if apart else part)
        return jax.tree.unflatten(jax.tree.structure(self.held), leaves)

    def turned(self, time: Scalar) -> Harmonics:
        """Stiffness harmonics shifted, so that they count from a time [s]."""
        return self.harmonics.turned(mesh_phases(self.oscillator.equation, time))

    def torques(self, time: Scalar, steps: int) -> Array:
        """Load of each step of a block, less what the impacts carry [N m]; one number if it is constant."""
        if not self.oscillator.equation.load_varies:
            return self.oscillator.equation.load_less_impacts_at(time)
        return jax.vmap(lambda step: self.oscillator.equation.load_less_impacts_at(time + step * self.oscillator.step))(
            jnp.arange(steps).astype(time.dtype)
        )


class Basis(NamedTuple):
    """Arrays that all blocks of the same length share.

    Args:
        weights: weights of the nodes for each step and the first step of the next block, shape (step, node).
        cosine, sine: mesh harmonics at each step, counted from the start of a block, shape (step, harmonic).
        own: the same arrays for the block's own steps; slices within the loop over blocks would be made for each block.
    """

    weights: Array
    cosine: Array
    sine: Array
    own: tuple[Array, ...]

    @classmethod
    def of(cls, forcing: Forcing, steps: int, nodes: int) -> "Basis":
        """The basis of blocks with given numbers of steps and nodes."""
        weights = chebyshev.weights(steps, nodes, np.arange(steps + 1))
        rate = mesh_rate(forcing.oscillator.equation) * forcing.oscillator.step
        order = jnp.arange(1, forcing.harmonics.cosine.shape[0] + 1).astype(rate.dtype)
        angle = jnp.arange(steps + 1).astype(rate.dtype)[:, None] * (rate * order)[None, :]
        cosine, sine = (jnp.cos(angle), jnp.sin(angle)) if angle.size else (angle, angle)
        every = jnp.asarray(weights, rate.dtype), cosine, sine
        return cls(*every, tuple(part[:-1] for part in every))


class Given(NamedTuple):
    """Data of one block.

    Args:
        columns: changing slow signals at the nodes of the block, each of shape (node,).
        waves: stiffness harmonics, counted from the start of the block.
        torque: load torque of each step, or one number [N m].
    """

    columns: tuple[Array, ...] | Float[Array, "column node"]
    waves: Harmonics
    torque: Array


def at_nodes(
    forcing: Forcing, start: Scalar, steps: int, number: int, blocks: int
) -> Float[Array, "block column node"]:
    """Changing slow signals at the nodes of blocks, interpolated from fewer nodes that cover many blocks at once.

    Args:
        forcing: signals of the oscillator.
        start: time of the first step [s].
        steps: number of steps of a block.
        number: number of nodes of a block, enough to resolve its signals.
        blocks: number of consecutive blocks.
    """
    phase = chebyshev.reach(number, chebyshev.accuracy(start.dtype))
    enough = (n for n in range(number + 1, COARSE) if chebyshev.reach(n, EXACT) >= blocks * phase)
    coarse = next(enough, max(number, COARSE))
    together = max(1, min(blocks, int(chebyshev.reach(coarse, EXACT) / phase)))
    pieces = math.ceil(blocks / together)
    if pieces * coarse >= blocks * number:
        coarse, together, pieces = number, 1, blocks
    places = together * steps * np.arange(pieces)[:, None] + chebyshev.nodes(together * steps, coarse)[None, :]
    times = start + jnp.asarray(places, start.dtype) * forcing.oscillator.step
    nothing = jnp.zeros((0,), start.dtype)  # for bodies without errors, where nothing changes

    def together_at(time: Scalar) -> Float[Array, " column"]:
        return jnp.hstack([nothing, *forcing.columns(forcing.oscillator.equation.instant(time))])

    columns = jax.vmap(jax.vmap(together_at))(times)
    if together > 1:
        fine = (steps * np.arange(together)[:, None] + chebyshev.nodes(steps, number)[None, :]).ravel()
        weights = jnp.asarray(chebyshev.weights(together * steps, coarse, fine), start.dtype)
        columns = jax.vmap(_spread, in_axes=(None, 0))(weights, columns)
        columns = columns.reshape(pieces * together, number, columns.shape[-1])[:blocks]
    return columns.swapaxes(1, 2)


class Rows(NamedTuple):
    """Rows that a block reads: trees of arrays whose first axis is the step.

    Args:
        own: rows of the block's own steps.
        every: rows of these steps and of the first step of the next block.
    """

    own: Any
    every: Any


def tabulated(forcing: Forcing, basis: Basis, given: Given) -> tuple[Rows, StepForcing]:
    """Excitation of all steps of a block, computed before the first step, and the functions that read it."""
    rows, sums = written_out(forcing, basis, given)
    every = sums.table(rows.every)
    own = jax.tree.map(lambda column: column[:-1], every)
    return Rows(own, every), StepForcing(lambda row: row, lambda rows: rows, sums.put)


def written_out(forcing: Forcing, basis: Basis, given: Given) -> tuple[Rows, StepForcing]:
    """Weights of the nodes for the steps of a block, and the functions that sum over its nodes."""
    waves, torque = given.waves, given.torque
    torques = (torque,) if torque.ndim else ()
    evenly = forcing.meshes_evenly
    stiffness = (basis.cosine, basis.sine) if evenly else (_by_phase(forcing, basis, given),)
    weights, *waves_own = basis.own
    own = tuple(waves_own) if evenly else (stiffness[0][:-1],)
    rows = Rows((weights, own, tuple(part[:-1] for part in torques)), (basis.weights, stiffness, torques))

    def at(row: Any) -> tuple:
        # the step takes whole arrays, so that a batch can be arranged as vectors within the step
        weights, *fast = (_numbers(part) for part in (row[0], *row[1]))
        nothing = jnp.zeros((), waves.mean.dtype)
        slow = tuple(_product(weights, _numbers(column), nothing) for column in given.columns)
        if not evenly:
            return slow, tuple(fast[0]), row[2]
        series = zip(_numbers(waves.mean), waves.cosine.T, waves.sine.T, strict=True)
        stiffness = (_product(fast[1], _numbers(s), _product(fast[0], _numbers(c), mean)) for mean, c, s in series)
        return slow, tuple(stiffness), row[2]

    def table(rows: Any) -> tuple:
        weights, fast, torques = rows
        slow = tuple(summed(weights, column) for column in given.columns)
        if not evenly:
            return slow, tuple(fast[0].T), torques
        series = zip(_numbers(waves.mean), waves.cosine.T, waves.sine.T, strict=True)
        stiffness = (mean + summed(fast[0], c) + summed(fast[1], s) for mean, c, s in series)
        return slow, tuple(stiffness), torques

    def put(numbers: tuple) -> tuple[Slow, Fast]:
        columns, stiffness, torques = numbers
        return forcing.slow(columns), Fast(stiffness, torques[0] if torques else torque)

    return rows, StepForcing(at, table, put)


def _by_phase(forcing: Forcing, basis: Basis, given: Given) -> Float[Array, "step pair"]:
    """Stiffness of the pairs at the steps of a block [N/m], from their phases, the last of the changing signals."""
    changing = given.columns[-forcing.harmonics.mean.size :]
    phases = [summed(basis.weights, phase) for phase in changing]
    return jax.vmap(forcing.harmonics.at)(jnp.stack(phases, axis=1))


@jax.custom_jvp
def summed(weights: Float[Array, "step node"], values: Float[Array, " node"]) -> Float[Array, " step"]:
    """Sums over nodes, written out; their derivative is a matrix product."""
    nothing = jnp.zeros((weights.shape[0],), values.dtype)
    return _product([weights[:, node] for node in range(values.shape[0])], _numbers(values), nothing)


@partial(summed.defjvp, symbolic_zeros=True)
def _summed_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    weights, values = primals
    along = []
    if not isinstance(tangents[0], SymbolicZero):
        along.append(summed(tangents[0], values))
    if not isinstance(tangents[1], SymbolicZero):
        # in this order the transpose, used by gradients, reads the weights of a node consecutively: in half the time
        along.append(tangents[1] @ weights.T)
    return summed(weights, values), sum(along[1:], along[0])


def _numbers(values: Array) -> list[Array]:
    return [jax.lax.index_in_dim(values, index, keepdims=False) for index in range(values.shape[0])]


def _product(weights: list[Array], numbers: list[Array], total: Array) -> Array:
    """``total`` plus the sum of the products of weights and numbers."""
    for weight, number in zip(weights, numbers, strict=True):
        total = total + weight * number
    return total


def _spread(weights: Float[Array, "step node"], values: Float[Array, "node column"]) -> Float[Array, "step column"]:
    """Small matrix product, written out; in a loop it takes a quarter of the time of a library call."""
    total = jnp.zeros((weights.shape[0], values.shape[1]), weights.dtype)
    for node in range(values.shape[0]):
        total = total + weights[:, node, None] * values[node][None, :]
    return total
