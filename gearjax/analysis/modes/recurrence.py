"""Scan over the steps of a motion of many coordinates, with a derivative that costs little more than the scan.

Automatic differentiation of the loop would carry every tangent through every operation of every step. In a step only
two things are not linear: the inputs of the lines and the correction for kinks. Their slopes can be computed for all
steps at once after the scan, from the recorded states and inputs. The remaining recurrence is linear in the state, the
inputs now and a step before, and the overlap before the step:

    dc = F (dx, du, du_) + g,    du' = A dc_s + a,    df = dc_f + W du',    dm = P do + Q df_s + b,    dx' = df_x + V dm

with the matrices F, W and V of `gearjax.analysis.modes.products`, the slopes A of the inputs, and the slopes P and Q of
the correction for kinks. g, a and b are the changes by everything else. The transpose of this recurrence is another
linear scan, backwards, so that forward and reverse mode both follow.

If lines are coordinates and not contacts, many contacts act on each line. The slopes are then no sparse matrices of
single pairs, and the derivative is that of the loop.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from gearjax.analysis.modes.lines import Driving, Lines, total
from gearjax.analysis.modes.products import Products
from gearjax.contact import HardContact
from gearjax.typing import Array, Float

UNROLL = 4  # steps written out: one by one takes 1.4 times as long with default XLA, the same with `xla_options`


class Begun(NamedTuple):
    """Data at the start of steps.

    Args:
        whole: state, followed by the inputs of the lines now and a step before, shape (state + 2 line,).
        known: known inputs a step before, shape (known,).
        now: excitation now.
        overlap: overlap of the contacts now, shape (contact,) [m]. At the start it comes from the coordinates
            themselves: without a torque it is zero, and rounding must not change its sign.
    """

    whole: Array
    known: Array
    now: Driving
    overlap: Array


def recur(
    lines: Lines, products: Products, begun: Begun, table: Driving, shares: np.ndarray | None
) -> tuple[Begun, Array]:
    """Run the steps: the data at their end, and state and inputs after each step, shape (step, state + line).

    Args:
        lines: lines of the contacts.
        products: matrices of a step.
        begun: data at the start.
        table: rows of the excitation, the first axis of each leaf.
        shares: weights of the rows for each step, shape (block, step of a block, row); ``None`` if each step has its
            own row.
    """
    arrays, rest = eqx.partition(lines, eqx.is_inexact_array)
    march = _recur if lines.apart else _primal
    record = march((rest, shares), arrays, products, begun, table)
    _, number, states = products.sizes
    inputs = jnp.concatenate([begun.whole[None, states : states + number], record[-2:, states:]])
    last = rows_of(table, shares, 2)
    known = lines.known(begun.now if len(record) == 1 else _at(last, 0))
    overlap = lines.overlap(_at(last, -1), products.sight @ record[-1, :states])
    return Begun(jnp.concatenate([record[-1], inputs[-2]]), known, _at(last, -1), overlap), record


def rows_of(table: Driving, shares: np.ndarray | None, last: int = 0) -> Driving:
    """Excitation of each step, or of the ``last`` ones."""
    if shares is None:
        return jax.tree.map(lambda column: column[-last:], table)
    flat, unpacked = packed(table)
    return unpacked(jnp.asarray(shares.reshape(-1, len(flat))[-last:], flat.dtype) @ flat)


def _at(rows: Driving, place: int) -> Driving:
    return jax.tree.map(lambda column: column[place], rows)


def packed(driving: Driving) -> tuple[Float[Array, "time number"], Callable[[Array], Driving]]:
    """Excitation at several times as rows of one table, and the function that converts such rows back."""
    leaves, tree = jax.tree.flatten(driving)
    ends = np.cumsum([0, *(leaf[0].size for leaf in leaves)])

    def unpacked(rows: Array) -> Driving:
        parts = zip(ends[:-1], ends[1:], leaves, strict=True)
        own = [rows[:, begin:end].reshape(len(rows), *leaf.shape[1:]) for begin, end, leaf in parts]
        return jax.tree.unflatten(tree, own)

    return jnp.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1), unpacked


def returned(
    lines: Lines, products: Products, start: Callable[[Array], Begun], state: Array, table: Driving
) -> tuple[Array, Array]:
    """State after the steps of a table, and its slopes with respect to the numbers of the start.

    All tangents share the matrix of a step. A product of two matrices takes a tenth of the time of as many products
    with vectors, which automatic differentiation would use.

    Args:
        lines, products, table: as for `recur`; the lines are contacts.
        start: function from the numbers to the data at the start of the steps.
        state: the numbers, shape (number,).

    Returns:
        State after the steps, shape (state,), and its slopes, shape (state, number).
    """
    states = products.sizes[2]

    def begin(state: Array) -> tuple[tuple[Array, Array], Begun]:
        begun = start(state)
        return (begun.whole, begun.overlap), begun

    moved, begun = jax.jacfwd(begin, has_aux=True)(state)
    arrays, rest = eqx.partition(lines, eqx.is_inexact_array)
    record = _primal((rest, None), arrays, products, begun, table)
    linear = Linear(lines, products, begun, table, None)
    ended = linear.carried(linear.slopes(linear.path(record)), moved)
    return record[-1, :states], ended[:states]


# the steps themselves ------------------------------------------------------------------------------------------


def _kinks(lines: Lines) -> bool:
    return isinstance(lines.equation.scene.contact, HardContact)


def _advance(lines: Lines, products: Products, carry: tuple, now: Driving) -> tuple[tuple, Array]:
    """One step, from the excitation at its end."""
    whole, known, overlap = carry
    sights, number, states = products.sizes
    coming, new = products.free @ whole, lines.known(now)
    if products.given is not None:
        coming = coming + products.given
    else:
        coming = sum((part @ one for part, one in zip(products.known, (new, *known), strict=True)), coming)
    after = lines.inputs(now, coming[:sights])
    corrected = coming[sights:] + products.after @ after
    if _kinks(lines):
        missed = lines.missed(now, overlap, corrected[:sights])
        corrected = corrected + products.kink @ missed
        overlap = lines.overlap(now, corrected[:sights])
    whole = jnp.concatenate([corrected[sights:], after, whole[states : states + number]])
    return (whole, (new, known[0]), overlap), whole[: states + number]


def _primal(
    static: tuple, arrays: Lines, products: Products, begun: Begun, table: Driving
) -> Float[Array, "step number"]:
    rest, shares = static
    lines = eqx.combine(arrays, rest)

    def along(carry: tuple, rows: Driving) -> tuple[tuple, Array]:
        return jax.lax.scan(partial(_advance, lines, products), carry, rows, unroll=UNROLL)

    carry = begun.whole, (lines.known(begun.now), begun.known), begun.overlap
    if shares is None:
        return along(carry, table)[1]
    flat, unpacked = packed(table)

    def between(carry: tuple, share: Array) -> tuple[tuple, Array]:
        # written out, the product needs no library call; for many contacts it would take twice the time of a call
        rows = total(flat[:, None], share.T[:, :, None]) if lines.apart else share @ flat
        return along(carry, unpacked(rows))

    record = jax.lax.scan(between, carry, jnp.asarray(shares, flat.dtype))[1]
    return record.reshape(-1, record.shape[-1])


# their derivative ----------------------------------------------------------------------------------------------


_recur = jax.custom_jvp(_primal, nondiff_argnums=(0,))


@partial(_recur.defjvp, symbolic_zeros=True)
def _recur_jvp(static: tuple, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    rest, shares = static
    record = _recur(static, *primals)

    def motion(parts: list) -> Linear:
        arrays, products, begun, table = jax.tree.unflatten(tree, parts)
        return Linear(eqx.combine(arrays, rest), products, begun, table, shares)

    values, tree = jax.tree.flatten(primals)
    ways = {i: way for i, way in enumerate(jax.tree.leaves(tangents)) if not isinstance(way, SymbolicZero)}
    held = motion(values)
    path = held.path(record)

    def pushes(moved: dict) -> tuple:
        return motion([moved.get(i, value) for i, value in enumerate(values)]).pushes(path)

    _, driven = jax.jvp(pushes, ({i: values[i] for i in ways},), (ways,))
    whole, overlap = (
        jnp.zeros_like(value) if isinstance(way, SymbolicZero) else way
        for value, way in ((primals[2].whole, tangents[2].whole), (primals[2].overlap, tangents[2].overlap))
    )
    return record, held.moved(held.slopes(path), driven, (whole, overlap))


class Path(NamedTuple):
    """Quantities of each step, computed again from the record.

    Args:
        whole: state and inputs at the start of the step, shape (step, state + 2 line).
        overlap: overlap at the start, shape (step, contact) [m].
        expected, corrected, ended: sights at the end of the step: with extrapolated inputs, without the correction for
            kinks, and with it, shape (step, sight).
        inputs, missed: inputs at the end, and the correction for kinks, shape (step, line).
    """

    whole: Array
    overlap: Array
    expected: Array
    corrected: Array
    ended: Array
    inputs: Array
    missed: Array | None


class Linear(NamedTuple):
    """All steps at once, and their linearisation; arguments as for `recur`."""

    lines: Lines
    products: Products
    begun: Begun
    table: Driving
    shares: np.ndarray | None

    def coming(self, rows: Driving, whole: Array) -> Array:
        """Sights and states at the ends of the steps, without the inputs at the ends."""
        coming, products = whole @ self.products.free.T, self.products
        if products.given is not None:
            return coming + products.given[None]
        new = jax.vmap(self.lines.known)(rows)
        now = _before(self.lines.known(self.begun.now), new)
        parts = zip(products.known, (new, now, _before(self.begun.known, now)), strict=True)
        return sum((one @ part.T for part, one in parts), coming)

    def path(self, record: Array) -> Path:
        """Quantities of each step, from states and inputs after the steps."""
        sights, number, states = self.products.sizes
        rows, begun, lines = rows_of(self.table, self.shares), self.begun.whole, self.lines
        now = _before(begun[: states + number], record)
        whole = jnp.concatenate([now, _before(begun[states + number :], now[:, states:])], axis=1)
        coming, inputs = self.coming(rows, whole), record[:, states:]
        corrected = coming[:, sights : 2 * sights] + inputs @ self.products.after[:sights].T
        ended = record[:, :states] @ self.products.sight.T
        overlap = _before(self.begun.overlap, jax.vmap(lines.overlap)(rows, ended))
        missed = jax.vmap(lines.missed)(rows, overlap, corrected) if _kinks(lines) else None
        return Path(whole, overlap, coming[:, :sights], corrected, ended, inputs, missed)

    def pushes(self, path: Path) -> tuple[Array, Array, tuple[Array, Array] | None]:
        """Results of each step, to be differentiated with respect to everything except the state.

        The results are sights and states, inputs, and the correction with the overlap. The data at the start of the
        steps, and the sights that inputs are evaluated at, are held fixed.
        """
        sights, products, lines = self.products.sizes[0], self.products, self.lines
        rows = rows_of(self.table, self.shares)
        whole = self.coming(rows, path.whole).at[:, sights:].add(path.inputs @ products.after.T)
        inputs = jax.vmap(lines.inputs)(rows, path.expected)
        if path.missed is None:
            return whole, inputs, None
        whole = whole.at[:, 2 * sights :].add(path.missed @ products.kink[sights:].T)
        overlap = jax.vmap(lines.overlap)(rows, path.ended)
        overlap = overlap + path.missed @ products.kink[: overlap.shape[1]].T
        return whole, inputs, (jax.vmap(lines.missed)(rows, path.overlap, path.corrected), overlap)

    def slopes(self, path: Path) -> tuple[Array, tuple[Array, Array] | None]:
        """Slopes of the inputs with respect to their sights, shape (step, line, sight), and slopes of the correction.

        The correction depends on the overlap at the start of a step and on the sights at its end.
        """
        rows, lines, layout = rows_of(self.table, self.shares), self.lines, self.lines.equation.layout
        flank = np.zeros(len(layout.pair), int)
        for number, contacts in enumerate(layout.flanks):
            flank[contacts] = number
        pair = np.asarray(layout.pair)
        seen, heard = (pair, flank), (pair, flank)
        if lines.hears_speed:
            damped = lines.equation.springs.damped
            heard = np.concatenate([pair, pair[damped]]), np.concatenate([flank, flank[damped] + flank.max() + 1])
        of_inputs = jax.vmap(lambda row, at: _slope(partial(lines.inputs, row), at, pair, heard))(rows, path.expected)
        if path.missed is None:
            return of_inputs, None

        def of_missed(row: Driving, before: Array, at: Array) -> tuple[Array, Array]:
            begun = _slope(lambda before: lines.missed(row, before, at), before, pair, seen)
            return begun, _slope(lambda at: lines.missed(row, before, at), at, pair, heard)

        return of_inputs, jax.vmap(of_missed)(rows, path.overlap, path.corrected)

    def moved(self, slopes: tuple, driven: tuple, start: tuple[Array, Array]) -> Array:
        """Tangents of states and inputs after each step, from the tangents at the start."""
        products, (sights, number, states) = self.products, self.products.sizes

        def step(carry: tuple[Array, Array], given: tuple) -> tuple[tuple[Array, Array], Array]:
            (of_inputs, of_missed), (push, push_inputs, push_missed) = given
            whole, overlap = carry
            coming = _product(products.free, whole) + push
            after = _product(of_inputs, coming[:sights]) + push_inputs
            corrected = coming[sights:] + _product(products.after, after)
            if of_missed is not None:
                begun, ended = of_missed
                missed = _product(begun, overlap) + _product(ended, corrected[:sights]) + push_missed[0]
                corrected = corrected + _product(products.kink, missed)
                overlap = corrected[: len(overlap)] + push_missed[1]
            whole = jnp.concatenate([corrected[sights:], after, whole[states : states + number]])
            return (whole, overlap), whole[: states + number]

        return jax.lax.scan(step, start, (slopes, driven), unroll=UNROLL)[1]

    def carried(self, slopes: tuple, start: tuple[Array, Array]) -> Array:
        """Tangents of state and inputs at the end of the steps, one in each column, from those at the start.

        The derivative of a step is a constant matrix with two corrections of low rank, by the slopes of the inputs and
        by those of the correction for kinks.
        """
        products, (sights, number, states) = self.products, self.products.sizes
        (of_inputs, of_missed), (whole, overlap) = slopes, start
        contacts = 0 if of_missed is None else len(overlap)
        free = jnp.pad(products.free, ((0, 0), (0, contacts)))  # columns: state, inputs now and before, overlap
        earlier = jnp.eye(number, free.shape[1], states, dtype=free.dtype)
        own = jnp.eye(number, dtype=free.dtype)

        def rows(sight: Array, state: Array, after: Array, before: Array) -> Array:
            return jnp.concatenate([state, after, before, sight[:contacts]])

        held = rows(free[sights : 2 * sights], free[2 * sights :], jnp.zeros_like(earlier), earlier)
        by_inputs = rows(products.after[:sights], products.after[sights:], own, jnp.zeros_like(own))
        inputs = of_inputs @ free[:sights]  # shape (step, line, column)
        ways = [(by_inputs, inputs)]
        if of_missed is not None:
            begun, ended = of_missed
            sight = free[None, sights : 2 * sights] + jnp.einsum("sl,nlc->nsc", products.after[:sights], inputs)
            missed = (ended @ sight).at[:, :, -contacts:].add(begun)
            by_missed = rows(products.kink[:sights], products.kink[sights:], jnp.zeros_like(own), jnp.zeros_like(own))
            ways.append((by_missed, missed))
            whole = jnp.concatenate([whole, overlap])
        acting = jnp.concatenate([act for act, _ in ways], axis=1).T[:, :, None]
        along = jnp.concatenate([slope for _, slope in ways], axis=1)[:, :, None]

        def step(tangents: Array, slope: Array) -> tuple[Array, None]:
            return (held + total(acting, slope)) @ tangents, None

        return jax.lax.scan(step, whole, along)[0]


def _before(first: Array, rest: Array) -> Array:
    """The rows shifted by one step, with ``first`` in front."""
    return jnp.concatenate([first[None], rest[:-1]])


def _slope(function: Callable[[Array], Array], at: Array, pair: np.ndarray, seen: tuple) -> Array:
    """Slopes of a function of contacts. ``seen`` gives the pair and the kind of each argument.

    Only contacts and arguments of the same pair influence each other. One tangent can therefore move all arguments of a
    kind together.
    """
    pairs, kinds = seen
    ways = (jnp.asarray(kinds == kind, at.dtype) for kind in range(kinds.max() + 1))
    along = jnp.stack([jax.jvp(function, (at,), (way,))[1] for way in ways])
    return jnp.where(pair[:, None] == pairs[None, :], along[kinds].T, 0.0)


def _product(matrix: Array, vector: Array) -> Array:
    """Product of a matrix with a vector, written so that it stays within the kernel of the loop.

    This is 5 times as fast for a batch of vectors, and 1.4 times for the transpose.
    """
    return (matrix * vector[None]).sum(axis=1)
