"""Motion of bodies on supports by even steps of constant modes, with one contact evaluation per step and exact kinks.

Mean springs and dampers of the contacts are added to the structure, so that the remaining inputs are small and change
slowly:

    M q'' + (C + L^T c L) q' + (K + L^T k L) q = G u,     u = k s + c s' - f(s, s', t),     s = L q

`gearjax.analysis.modes.lines` defines L and u. Steps are those of `gearjax.analysis.modes.parabola`. The inputs at the
end of a step are evaluated at the s that follows if the last two inputs are extrapolated.

A step consists of three small matrix products, with evaluations of the contacts in between: with the state, with the
inputs at the end of the step, and with the correction for kinks. Their rows are sights (vectors on which the inputs
depend) and the state.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import chebyshev
from gearjax.analysis.metrics import top
from gearjax.analysis.modes.equation import Excitation, Instant, StructureEquation
from gearjax.analysis.modes.lines import Driving, Lines
from gearjax.analysis.modes.parabola import Scaled, weights
from gearjax.analysis.modes.products import Products
from gearjax.analysis.modes.recurrence import Begun, recur
from gearjax.analysis.solvers import highest_between
from gearjax.dependence import depends
from gearjax.typing import Array, Float, Scalar

AT_ONCE = 16  # steps whose excitation is computed together, if it is computed at each step or for many contacts
OF_FEW = 96  # the same for few contacts between nodes, where each block has a fixed cost
LONGEST_SPAN = 4096  # largest number of steps per span, all of which reverse mode stores


def divisor(number: int, most: int) -> int:
    """The largest divisor of a number that is not above ``most``."""
    return next(n for n in range(min(number, most), 0, -1) if number % n == 0)


class Steps(eqx.Module):
    """Even steps of one motion.

    Args:
        lines: lines of the contacts.
        scaled: the structure with mean springs and dampers, in scaled first-order form.
        products: matrices of a step.
        begin, step: time of the start, and length of a step [s].
        at_start: what the scene shows at the start.
    """

    lines: Lines
    scaled: Scaled
    products: Products
    begin: Scalar
    step: Scalar
    at_start: Instant

    @classmethod
    def of(cls, equation: StructureEquation, begin: Scalar, step: Scalar) -> "Steps":
        """Steps of a given length; mean springs are those of the contacts that carry at the start."""
        at_start = equation.instant(begin)
        lines = Lines.of(equation, at_start.now)
        scaled = Scaled.of(equation.structure, *lines.whole, step)
        part = weights(scaled.matrix, scaled.inputs @ lines.acting)
        (changes,) = depends(lambda time: lines.known(lines.driving(time)), begin)
        known = None if changes else lines.known(lines.driven(at_start.now))
        return cls(lines, scaled, Products.of(lines, scaled, part, known), begin, step, at_start)

    def beginning(self, begin: Scalar) -> "Steps":
        """The same steps from another time on [s]."""
        return dataclasses.replace(self, begin=begin, at_start=self.lines.equation.instant(begin))

    def initial(self, start: str) -> Float[Array, "2 coordinate"]:
        """Scaled positions and velocities at the start (`StructureEquation.starting`)."""
        return self.lines.equation.starting(self.at_start, start)

    def start(self, place: Array, speed: Array) -> Begun:
        """Initial data of the steps, from coordinates and velocities.

        Inputs a step before are extrapolated by their slope; without it the whole motion would be of first order.
        """
        lines, (excitation, rate) = self.lines, self.at_start

        def inputs(excitation: Excitation, place: Array, speed: Array) -> tuple[tuple[Array, Array], Driving]:
            now = lines.driven(excitation)
            return (lines.inputs(now, lines.sights(place, speed)), lines.known(now)), now

        along = rate, speed, lines.equation.acceleration(excitation, place, speed)
        here, slope, now = jax.jvp(inputs, (excitation, place, speed), along, has_aux=True)
        own_before, known_before = jax.tree.map(lambda x, dx: x - self.step * dx, here, slope)
        state = self.scaled.back @ jnp.concatenate([place, speed])
        overlap = lines.overlap(now, lines.sights(place, speed))
        return Begun(jnp.concatenate([state, here[0], own_before]), known_before, now, overlap)

    def coordinates(self, state: Array) -> Float[Array, "2 coordinate"]:
        """Coordinates and velocities of a state."""
        alone = state[: self.scaled.place.shape[1]]
        return jnp.stack([self.scaled.place @ alone, self.scaled.speed @ alone])

    def output(self, states: Float[Array, "step state"]) -> tuple[Float[Array, " step"], Float[Array, " step"]]:
        """Position [rad], and velocity per step, of the output."""
        half = self.scaled.place.shape[0]
        return states[:, 0] * self.scaled.place[0, 0], states[:, half] * (self.scaled.speed[0, half] * self.step)


class March(NamedTuple):
    """A record at its samples: coordinates and velocities, shape (n, 2, coordinate), and extremes of the output.

    The extremes are those over the steps up to each sample, shape (n,) [rad].
    """

    states: Array
    highest: Array
    lowest: Array


class Spacing(NamedTuple):
    """Division of a record into samples, steps and spans.

    Args:
        samples, each: number of samples, and of steps between two samples.
        span: number of steps whose excitation is computed together.
        nodes: nodes of the polynomial that interpolates it; ``None`` if it is computed at each step.
    """

    samples: int
    each: int
    span: int
    nodes: int | None

    @classmethod
    def of(cls, samples: int, each: int, phase: float | None, dtype: Any) -> "Spacing":
        """The cheapest division.

        Args:
            samples, each: number of samples, and of steps between two samples.
            phase: phase per step of the fastest excitation [rad]; ``None`` if it is not known.
            dtype: type of the numbers.
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
    """Motion from initial coordinates and velocities, recorded at samples with even steps between them.

    Args:
        steps: the even steps.
        place, speed: coordinates and velocities at the start.
        spacing: division of the record.
        table: excitation at the ends of the steps, if it is known already, for a spacing without nodes; the first axis
            of each leaf is the step.
    """
    seconds = steps.step * spacing.each

    def driven(begun: Begun, given: Any) -> tuple[Begun, Array]:
        """The steps of a span: the data at their end, and their states."""
        lines, places, shares = steps.lines, np.arange(1, spacing.span + 1, dtype=float), None
        if spacing.nodes is not None:
            block = divisor(spacing.span, OF_FEW if lines.apart else AT_ONCE)
            shares = chebyshev.weights(spacing.span, spacing.nodes, places).reshape(-1, block, spacing.nodes)
            places = chebyshev.nodes(spacing.span, spacing.nodes)
        if table is None:
            given = jax.vmap(lines.driving)(given + jnp.asarray(places, given.dtype) * steps.step)
        begun, record = recur(lines, steps.products, begun, given, shares)
        return begun, record[:, : steps.products.sizes[2]]

    # reverse mode computes each span again, so that its memory grows with the spans and not with the steps
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
    """Highest value on the steps between given positions, from the slopes per step at these positions."""
    return top(highest_between(position[:-1], position[1:], slope[:-1], slope[1:], jnp.ones_like(position[1:])))
