"""The scan over the steps of a motion of many coordinates, with a derivative that costs little more than the scan.

A derivative of the loop by the rules would carry every tangent through every operation of every step. But what is not
linear in a step are the inputs of the lines and what a parabola misses, and their slopes can be worked out for all
steps at once, after the scan, from the states and inputs that it records. What is left in sequence is linear, in the
state, the inputs now and a step before, and the overlap before a step:

    dc = F (dx, du, du_) + g,    du' = A dc_s + a,    df = dc_f + W du',    dm = P do + Q df_s + b,    dx' = df_x + V dm

with F, W and V of `gearjax.analysis.modes.products`, slopes A of the inputs, P and Q of what is missed, and what
everything else moves them by: g, a and b. Its transpose is another linear scan, backwards; so both modes follow.

Where lines are not contacts, but coordinates that many of them act on, slopes are matrices that few contacts fill, and
the derivative is that of the loop.
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

UNROLL = 4  # steps that are written out: as installed, one by one takes 1.4 times as long; with options, the same


class Begun(NamedTuple):
    """Where steps begin.

    Args:
        whole: state with the inputs of the lines now and a step before, shape (state + 2 line,).
        known: known inputs a step before, shape (known,).
        now: what drives the motion now.
        overlap: of the contacts now, shape (contact,) [m]; of a start from the coordinates themselves, as without a
            torque it is zero, whose sign decides.
    """

    whole: Array
    known: Array
    now: Driving
    overlap: Array


def recur(
    lines: Lines, products: Products, begun: Begun, table: Driving, shares: np.ndarray | None
) -> tuple[Begun, Array]:
    """Where the steps end, and state and inputs after each, shape (step, state + line).

    Args:
        lines: of the contacts.
        products: of a step.
        begun: where they begin.
        table: what drives them, each leaf with rows as its first axis.
        shares: of the rows in each step, shape (block, step of a block, row); ``None`` where there is one per step.
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
    """What drives each step, or the last ones."""
    if shares is None:
        return jax.tree.map(lambda column: column[-last:], table)
    flat, unpacked = packed(table)
    return unpacked(jnp.asarray(shares.reshape(-1, len(flat))[-last:], flat.dtype) @ flat)


def _at(rows: Driving, place: int) -> Driving:
    return jax.tree.map(lambda column: column[place], rows)


def packed(driving: Driving) -> tuple[Float[Array, "time number"], Callable[[Array], Driving]]:
    """Numbers of several times as the rows of one table, and what such rows mean."""
    leaves, tree = jax.tree.flatten(driving)
    ends = np.cumsum([0, *(leaf[0].size for leaf in leaves)])

    def unpacked(rows: Array) -> Driving:
        parts = zip(ends[:-1], ends[1:], leaves, strict=True)
        own = [rows[:, begin:end].reshape(len(rows), *leaf.shape[1:]) for begin, end, leaf in parts]
        return jax.tree.unflatten(tree, own)

    return jnp.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1), unpacked


# the steps themselves ------------------------------------------------------------------------------------------


def _kinks(lines: Lines) -> bool:
    return isinstance(lines.equation.scene.contact, HardContact)


def _advance(lines: Lines, products: Products, carry: tuple, now: Driving) -> tuple[tuple, Array]:
    """A step, from what drives it at its end."""
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
        # written out it is no call, but many contacts then take twice the time of one
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
    """What was known at each step.

    Args:
        whole: state and inputs that it began from, shape (step, state + 2 line).
        overlap: there, shape (step, contact) [m].
        expected, corrected, ended: sights at its end: if inputs go on, without what is missed, and with it, shape
            (step, sight).
        inputs, missed: inputs at its end, and what a parabola missed, shape (step, line).
    """

    whole: Array
    overlap: Array
    expected: Array
    corrected: Array
    ended: Array
    inputs: Array
    missed: Array | None


class Linear(NamedTuple):
    """All steps at once, and what moves them; arguments as of `recur`."""

    lines: Lines
    products: Products
    begun: Begun
    table: Driving
    shares: np.ndarray | None

    def coming(self, rows: Driving, whole: Array) -> Array:
        """Sights and states without the inputs at the ends of the steps."""
        coming, products = whole @ self.products.free.T, self.products
        if products.given is not None:
            return coming + products.given[None]
        new = jax.vmap(self.lines.known)(rows)
        now = _before(self.lines.known(self.begun.now), new)
        parts = zip(products.known, (new, now, _before(self.begun.known, now)), strict=True)
        return sum((one @ part.T for part, one in parts), coming)

    def path(self, record: Array) -> Path:
        """What was known at each step, from states and inputs after it."""
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
        """What a step makes besides what it began from and looks at, which are held: sights and states; inputs; what is
        missed, and the overlap."""
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
        """Of the inputs by the sights that they are taken at, shape (step, line, sight), and of what is missed by the
        overlap at the beginning and by the sights at the end."""
        rows, lines, layout = rows_of(self.table, self.shares), self.lines, self.lines.equation.layout
        flank = np.zeros(len(layout.pair), int)
        for number, contacts in enumerate(layout.flanks):
            flank[contacts] = number
        pair = np.asarray(layout.pair)
        seen, heard = (pair, flank), (pair, flank)
        if lines.hears_speed:
            first = layout.flanks[0]
            heard = np.concatenate([pair, pair[first]]), np.concatenate([flank, np.full(layout.teeth, flank.max() + 1)])
        of_inputs = jax.vmap(lambda row, at: _slope(partial(lines.inputs, row), at, pair, heard))(rows, path.expected)
        if path.missed is None:
            return of_inputs, None

        def of_missed(row: Driving, before: Array, at: Array) -> tuple[Array, Array]:
            begun = _slope(lambda before: lines.missed(row, before, at), before, pair, seen)
            return begun, _slope(lambda at: lines.missed(row, before, at), at, pair, heard)

        return of_inputs, jax.vmap(of_missed)(rows, path.overlap, path.corrected)

    def moved(self, slopes: tuple, driven: tuple, start: tuple[Array, Array]) -> Array:
        """How states and inputs after each step move, from how the beginning does."""
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


def _before(first: Array, rest: Array) -> Array:
    """Rows a step before."""
    return jnp.concatenate([first[None], rest[:-1]])


def _slope(function: Callable[[Array], Array], at: Array, pair: np.ndarray, seen: tuple) -> Array:
    """Slopes of numbers of contacts of some pairs by numbers, of which pairs and kinds are told: only those of one pair
    see each other, so that all of a kind are moved together."""
    pairs, kinds = seen
    ways = (jnp.asarray(kinds == kind, at.dtype) for kind in range(kinds.max() + 1))
    along = jnp.stack([jax.jvp(function, (at,), (way,))[1] for way in ways])
    return jnp.where(pair[:, None] == pairs[None, :], along[kinds].T, 0.0)


def _product(matrix: Array, vector: Array) -> Array:
    """Of a matrix with a vector, so that it stays within the kernel of the loop for many vectors too (5 times as fast),
    and turned round (1.4 times)."""
    return (matrix * vector[None]).sum(axis=1)
