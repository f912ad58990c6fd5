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
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import chebyshev
from gearjax.analysis.metrics import top
from gearjax.analysis.modes.equation import StructureEquation
from gearjax.analysis.modes.lines import Driving, Lines
from gearjax.analysis.modes.parabola import Scaled, weights
from gearjax.analysis.modes.products import Products
from gearjax.analysis.modes.recurrence import Begun, recur
from gearjax.analysis.solvers import highest_between
from gearjax.dependence import depends
from gearjax.typing import Array, Float, Scalar

AT_ONCE = 16  # steps whose excitation is worked out together, where it is at each, or of many contacts
OF_FEW = 96  # of few contacts, between nodes: blocks have a price of their own
LONGEST_SPAN = 4096  # steps between nodes: a derivative backwards keeps them


def divisor(number: int, most: int) -> int:
    """The largest one that is not above a bound."""
    return next(n for n in range(min(number, most), 0, -1) if number % n == 0)


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

    def start(self, place: Array, speed: Array) -> Begun:
        """Where steps begin, from the coordinates.

        A start whose inputs have no slope would make the whole motion first order.
        """
        equation, lines = self.lines.equation, self.lines

        def inputs(time: Scalar, place: Array, speed: Array) -> tuple[tuple[Array, Array], Driving]:
            now = lines.driving(time)
            return (lines.inputs(now, lines.sights(place, speed)), lines.known(now)), now

        along = jnp.ones_like(self.begin), speed, equation.acceleration(equation.excitation(self.begin), place, speed)
        here, slope, now = jax.jvp(inputs, (self.begin, place, speed), along, has_aux=True)
        own_before, known_before = jax.tree.map(lambda x, dx: x - self.step * dx, here, slope)
        state = self.scaled.back @ jnp.concatenate([place, speed])
        overlap = lines.overlap(now, lines.sights(place, speed))
        return Begun(jnp.concatenate([state, here[0], own_before]), known_before, now, overlap)

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
        accuracy = chebyshev.accuracy(dtype)
        best = cls(samples, each, divisor(each, AT_ONCE), None)
        if phase is None:
            return best
        furthest = min(each, LONGEST_SPAN, int(chebyshev.reach(chebyshev.MOST_NODES, accuracy) / max(phase, 1e-12)))
        for span in (n for n in range(1, furthest + 1) if each % n == 0):
            enough = (k for k in range(4, chebyshev.MOST_NODES + 1) if chebyshev.reach(k, accuracy) >= phase * span)
            nodes = next(enough, span)
            if nodes < span and nodes / span < (1.0 if best.nodes is None else best.nodes / best.span):
                best = cls(samples, each, span, nodes)
        return best


def march(steps: Steps, place: Array, speed: Array, spacing: Spacing, table: Driving | None = None) -> March:
    """Motion from coordinates and velocities over samples with some steps between them.

    Args:
        steps: even ones.
        place, speed: coordinates and velocities at their start.
        spacing: how the record is cut.
        table: what drives the motion at the ends of the steps, where it is known; first axis of each leaf the steps.
            Of a spacing without nodes.
    """
    seconds = steps.step * spacing.each

    def driven(begun: Begun, given: Any) -> tuple[Begun, Array]:
        """The steps of a span: where they end, and their states."""
        lines, places, shares = steps.lines, np.arange(1, spacing.span + 1, dtype=float), None
        if spacing.nodes is not None:
            block = divisor(spacing.span, OF_FEW if lines.apart else AT_ONCE)
            shares = chebyshev.weights(spacing.span, spacing.nodes, places).reshape(-1, block, spacing.nodes)
            places = chebyshev.nodes(spacing.span, spacing.nodes)
        if table is None:
            given = jax.vmap(lines.driving)(given + jnp.asarray(places, given.dtype) * steps.step)
        begun, record = recur(lines, steps.products, begun, given, shares)
        return begun, record[:, : steps.products.sizes[2]]

    # worked out again where a derivative runs backwards: its memory grows with spans, not with steps
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def span(inner: tuple, given: Any) -> tuple[tuple, None]:
        carry, last, highest, lowest = inner
        carry, states = driven(carry, given)
        position, slope = steps.output(jnp.concatenate([last[None], states]))
        highest, lowest = jnp.maximum(highest, peak(position, slope)), jnp.minimum(lowest, -peak(-position, -slope))
        return (carry, states[-1], highest, lowest), None

    def interval(carry: Begun, given: Any) -> tuple[Begun, tuple]:
        if table is None:
            parts = jnp.arange(spacing.each // spacing.span).astype(seconds.dtype)
            given = steps.begin + given.astype(seconds.dtype) * seconds + parts * (spacing.span * steps.step)
        last = carry.whole[: steps.scaled.place.shape[1]]
        now = last[0] * steps.scaled.place[0, 0]
        (carry, _, highest, lowest), _ = jax.lax.scan(span, (carry, last, now, now), given)
        return carry, (steps.coordinates(carry.whole), highest, lowest)

    cut = spacing.samples - 1, spacing.each // spacing.span, spacing.span
    rows = jnp.arange(cut[0]) if table is None else jax.tree.map(lambda c: c.reshape(*cut, *c.shape[1:]), table)
    _, (states, highest, lowest) = jax.lax.scan(interval, steps.start(place, speed), rows)
    parts = (jnp.stack([place, speed]), states), (place[0], highest), (place[0], lowest)
    return March(*(jnp.concatenate([first[None], rest]) for first, rest in parts))


def peak(position: Float[Array, " n"], slope: Float[Array, " n"]) -> Scalar:
    """Highest value on the steps between positions, from their slopes per step."""
    return top(highest_between(position[:-1], position[1:], slope[:-1], slope[1:], jnp.ones_like(position[1:])))
