"""Motion of bodies on supports in even steps: constant modes, one evaluation of the contacts a step, exact kinks.

The structure is taken together with mean springs and dampers of its contacts, so that what is left for the inputs is
small and changes slowly:

    M q'' + (C + L^T c L) q' + (K + L^T k L) q = G u,     u = k s + c s' - f(s, s', t),     s = L q

What L and u are, `gearjax.analysis.modes.lines` tells. Steps are those of `gearjax.analysis.modes.parabola`, the inputs
taken at the s that their last two values lead to.

A step is three small products, with what the contacts do in between: of the state, then of the inputs at its end, then
of what a parabola misses there. Their rows are sights (what the inputs depend on) and the state.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import tables
from gearjax.analysis.metrics import top
from gearjax.analysis.modes.equation import StructureEquation
from gearjax.analysis.modes.lines import Driving, Lines, total
from gearjax.analysis.modes.parabola import Scaled, Weights, weights
from gearjax.analysis.solvers import highest_between
from gearjax.contact import HardContact
from gearjax.dependence import depends
from gearjax.typing import Array, Float, Scalar

AT_ONCE = 16  # steps whose excitation is worked out together, where it is at each, or of many contacts
OF_FEW = 96  # of few contacts, between nodes: blocks have a price of their own
LONGEST_SPAN = 4096  # steps between nodes: a derivative backwards keeps them
UNROLL = 4  # steps that are written out: as installed, one by one takes 1.4 times as long; with options, the same


def divisor(number: int, most: int) -> int:
    """The largest one that is not above a bound."""
    return next(n for n in range(min(number, most), 0, -1) if number % n == 0)


class Products(NamedTuple):
    """What a step makes of the state with the inputs of the lines now and a step before.

    Args:
        free: without the inputs at its end: sights at the inputs that the last two lead to, sights, and the state,
            shape (2 sight + state, state + 2 line).
        after: of the inputs at its end: sights and the state, shape (sight + state, line).
        kink: of what a parabola misses, shape (sight + state, line).
        known: of known inputs at its end, now, and a step before, rows as of ``free``, each of shape (row, known).
        given: what known inputs make where they stand still, shape (2 sight + state,); ``None`` where they change.
    """

    free: Array
    after: Array
    kink: Array
    known: tuple[Array, Array, Array]
    given: Array | None

    @classmethod
    def of(cls, lines: Lines, scaled: Scaled, part: Weights, known: Array | None) -> "Products":
        """Those of a step; known inputs where they stand still."""
        number, sight = lines.seen.shape[0], lines.sights(scaled.place, scaled.speed)

        def rows(expected: Array, found: Array) -> Array:
            return jnp.concatenate([sight @ expected, sight @ found, found])

        kept, after, now, before = part
        own = rows(now + 2 * after, now)[:, :number], rows(before - after, before)[:, :number]
        free = jnp.concatenate([rows(kept, kept), *own], axis=1)
        last, kink = (jnp.concatenate([sight @ one, one])[:, :number] for one in (after, part.kink))
        of_known = rows(after, after)[:, number:], rows(now, now)[:, number:], rows(before, before)[:, number:]
        given = None if known is None else (of_known[0] + of_known[1] + of_known[2]) @ known
        return cls(free, last, kink, of_known, given)


class Steps(eqx.Module):
    """Even steps of one motion.

    Args:
        lines: of its contacts.
        scaled: its structure, with mean springs and dampers.
        products: of a step.
        begin, step: time of the start, and of a step [s].
    """

    lines: Lines
    scaled: Scaled
    products: Products
    begin: Scalar
    step: Scalar

    @classmethod
    def of(cls, equation: StructureEquation, begin: Scalar, step: Scalar) -> "Steps":
        """Steps of a length, with what carries at the start."""
        lines = Lines.of(equation, begin)
        scaled = Scaled.of(equation.structure, *lines.whole, step)
        part = weights(scaled.matrix, scaled.inputs @ lines.acting)
        (changes,) = depends(lambda time: lines.known(lines.driving(time)), begin)
        known = None if changes else lines.known(lines.driving(begin))
        return cls(lines, scaled, Products.of(lines, scaled, part, known), begin, step)

    def start(self, place: Array, speed: Array) -> tuple[Array, tuple[Array, Array], Array]:
        """State with the inputs of the lines now and a step before, known inputs now and a step before, and the overlap
        of the contacts, from the coordinates.

        A start whose inputs have no slope would make the whole motion first order.
        """
        equation, lines = self.lines.equation, self.lines

        def inputs(time: Scalar, place: Array, speed: Array) -> tuple[Array, Array]:
            now = lines.driving(time)
            return lines.inputs(now, lines.sights(place, speed)), lines.known(now)

        along = jnp.ones_like(self.begin), speed, equation.acceleration(equation.excitation(self.begin), place, speed)
        here, slope = jax.jvp(inputs, (self.begin, place, speed), along)
        (own, known), (own_before, known_before) = here, jax.tree.map(lambda x, dx: x - self.step * dx, here, slope)
        state = jnp.concatenate([self.scaled.back @ jnp.concatenate([place, speed]), own, own_before])
        return state, (known, known_before), lines.overlap(lines.driving(self.begin), lines.sights(place, speed))

    def advance(self, carry: tuple, now: Driving) -> tuple[tuple, Array]:
        """A step, from what drives it at its end: what `start` gives after it, and its state."""
        lines, products, (state, known, overlap) = self.lines, self.products, carry
        number, states = lines.seen.shape[0], self.scaled.place.shape[1]
        sights = len(products.after) - states
        coming, new = products.free @ state, lines.known(now)
        if products.given is not None:
            coming = coming + products.given
        else:
            coming = sum((part @ one for part, one in zip(products.known, (new, *known), strict=True)), coming)
        after = lines.inputs(now, coming[:sights])
        found = coming[sights:] + products.after @ after
        if isinstance(lines.equation.scene.contact, HardContact):
            missed = lines.missed(now, overlap, found[:sights])
            found = found + products.kink @ missed
            overlap = lines.overlap(now, found[:sights])
        whole = jnp.concatenate([found[sights:], after, state[states : states + number]])
        return (whole, (new, known[0]), overlap), found[sights:]

    def coordinates(self, state: Array) -> Float[Array, "2 coordinate"]:
        """Coordinates and their velocities."""
        alone = state[: self.scaled.place.shape[1]]
        return jnp.stack([self.scaled.place @ alone, self.scaled.speed @ alone])

    def output(self, states: Float[Array, "step state"]) -> tuple[Float[Array, " step"], Float[Array, " step"]]:
        """Position [rad], and velocity per step, of the output."""
        half = self.scaled.place.shape[0]
        return states[:, 0] * self.scaled.place[0, 0], states[:, half] * (self.scaled.speed[0, half] * self.step)


class March(NamedTuple):
    """A record at its samples: coordinates and velocities, shape (n, 2, coordinate), and extremes of the output over
    the steps up to each sample, shape (n,) [rad]."""

    states: Array
    highest: Array
    lowest: Array


class Spacing(NamedTuple):
    """How a record is cut.

    Args:
        samples, each: number of samples, and of steps between them.
        span: steps whose excitation is worked out together.
        nodes: of the polynomial through it; ``None`` where it is worked out at each step.
    """

    samples: int
    each: int
    span: int
    nodes: int | None

    @classmethod
    def of(cls, samples: int, each: int, phase: float | None, dtype: Any) -> "Spacing":
        """The cheapest cut.

        Args:
            samples, each: number of samples, and of steps between them.
            phase: of what drives the motion fastest, per step [rad]; ``None`` where it is not known.
            dtype: of the numbers.
        """
        accuracy = tables.accuracy(dtype)
        best = cls(samples, each, divisor(each, AT_ONCE), None)
        if phase is None:
            return best
        furthest = min(each, LONGEST_SPAN, int(tables.reach(tables.MOST_NODES, accuracy) / max(phase, 1e-12)))
        for span in (n for n in range(1, furthest + 1) if each % n == 0):
            enough = (k for k in range(4, tables.MOST_NODES + 1) if tables.reach(k, accuracy) >= phase * span)
            nodes = next(enough, span)
            if nodes < span and nodes / span < (1.0 if best.nodes is None else best.nodes / best.span):
                best = cls(samples, each, span, nodes)
        return best


def march(steps: Steps, place: Array, speed: Array, spacing: Spacing) -> March:
    """Motion from coordinates and velocities over samples with some steps between them."""
    seconds, few = steps.step * spacing.each, steps.lines.apart

    def along(carry: tuple, rows: Driving) -> tuple[tuple, Array]:
        return jax.lax.scan(lambda carry, row: steps.advance(carry, row), carry, rows, unroll=UNROLL)

    def driven(carry: tuple, origin: Array) -> tuple[tuple, Array]:
        """The steps of a span: their states."""
        ends = np.arange(1, spacing.span + 1, dtype=float)
        if spacing.nodes is None:
            times = origin + jnp.asarray(ends, origin.dtype) * steps.step
            return along(carry, jax.vmap(steps.lines.driving)(times))
        places = jnp.asarray(tables.nodes(spacing.span, spacing.nodes), origin.dtype)
        table, unpacked = packed(jax.vmap(steps.lines.driving)(origin + places * steps.step))
        block = divisor(spacing.span, OF_FEW if few else AT_ONCE)
        shares = tables.weights(spacing.span, spacing.nodes, ends).reshape(-1, block, spacing.nodes)

        def between(carry: tuple, share: Array) -> tuple[tuple, Array]:
            # written out it is no call, but many contacts then take twice the time of one
            return along(carry, unpacked(total(table[:, None], share.T[:, :, None]) if few else share @ table))

        carry, states = jax.lax.scan(between, carry, jnp.asarray(shares, origin.dtype))
        return carry, states.reshape(spacing.span, -1)

    # worked out again where a derivative runs backwards: its memory grows with spans, not with steps
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def span(inner: tuple, origin: Array) -> tuple[tuple, None]:
        carry, last, highest, lowest = inner
        carry, states = driven(carry, origin)
        position, slope = steps.output(jnp.concatenate([last[None], states]))
        highest, lowest = jnp.maximum(highest, peak(position, slope)), jnp.minimum(lowest, -peak(-position, -slope))
        return (carry, states[-1], highest, lowest), None

    def interval(carry: tuple, number: Array) -> tuple[tuple, tuple]:
        parts = jnp.arange(spacing.each // spacing.span).astype(seconds.dtype)
        origins = steps.begin + number.astype(seconds.dtype) * seconds + parts * (spacing.span * steps.step)
        last = carry[0][: steps.scaled.place.shape[1]]
        now = last[0] * steps.scaled.place[0, 0]
        (carry, _, highest, lowest), _ = jax.lax.scan(span, (carry, last, now, now), origins)
        return carry, (steps.coordinates(carry[0]), highest, lowest)

    numbers = jnp.arange(spacing.samples - 1)
    _, (states, highest, lowest) = jax.lax.scan(interval, steps.start(place, speed), numbers)
    parts = (jnp.stack([place, speed]), states), (place[0], highest), (place[0], lowest)
    return March(*(jnp.concatenate([first[None], rest]) for first, rest in parts))


def peak(position: Float[Array, " n"], slope: Float[Array, " n"]) -> Scalar:
    """Highest value on the steps between positions, from their slopes per step."""
    return top(highest_between(position[:-1], position[1:], slope[:-1], slope[1:], jnp.ones_like(position[1:])))


def packed(driving: Driving) -> tuple[Float[Array, "time number"], Callable[[Array], Driving]]:
    """Numbers of several times as the rows of one table, and what such rows mean."""
    leaves, tree = jax.tree.flatten(driving)
    ends = np.cumsum([0, *(leaf[0].size for leaf in leaves)])

    def unpacked(rows: Array) -> Driving:
        parts = zip(ends[:-1], ends[1:], leaves, strict=True)
        own = [rows[:, begin:end].reshape(len(rows), *leaf.shape[1:]) for begin, end, leaf in parts]
        return jax.tree.unflatten(tree, own)

    return jnp.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1), unpacked
