"""Motion of bodies on supports in even steps: constant modes, one evaluation of the contacts a step, exact kinks.

The structure is taken together with mean springs and dampers of its contacts, so that what is left for the inputs is
small and changes slowly:

    M q'' + (C + L^T c L) q' + (K + L^T k L) q = G u,     u = k s + c s' - f(s, s', t),     s = L q

What L and u are, `gearjax.analysis.modes.lines` tells. Steps are those of `gearjax.analysis.modes.parabola`, the inputs
taken at the s that their last two values lead to.

A block of steps is a shift register: what will be seen of the state, without the inputs to come, is one product for the
whole block; each step adds its response to what the others will see. Only that stands between one step and the next.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import tables
from gearjax.analysis.modes.equation import Excitation, StructureEquation
from gearjax.analysis.modes.lines import Lines, times
from gearjax.analysis.modes.parabola import Scaled, Weights, weights
from gearjax.analysis.solvers import highest_between
from gearjax.contact import HardContact
from gearjax.typing import Array, Float, Scalar

LONGEST_BLOCK = 16  # steps of a register
UNROLL = 4  # steps of it that are written out


def block_length(each: int) -> int:
    """Steps of a block, where there are some between samples."""
    return next(n for n in range(LONGEST_BLOCK, 0, -1) if each % n == 0)


class Register(NamedTuple):
    """A block of steps as products; a state stands with the inputs now and a step before.

    Args:
        free: what will be seen of a state at each step, shape (step, sight, state).
        echo: what is seen of a line's input, at its own step and those after, shape (step, sight, line).
        known: what is seen at each step of known inputs at each step, shape (step sight, step known).
        kink: what is seen of what a parabola misses, shape (step, sight, line).
        last: the state after the block of that before it, and of inputs and misses, latest last.
        told: position and velocity per step of the output at each step, of the same three.
    """

    free: Array
    echo: Array
    known: Array
    kink: Array
    last: tuple[Array, Array, Array]
    told: tuple[Array, Array, Array]

    @classmethod
    def of(cls, lines: Lines, scaled: Scaled, step: Scalar, part: Weights, length: int) -> "Register":
        """Products of a block of some steps."""
        states, inputs = part.after.shape
        number = lines.seen.shape[0]
        unit, nothing = jnp.eye(inputs, dtype=part.kept.dtype), jnp.zeros((inputs, inputs), part.kept.dtype)
        wide = jnp.zeros((inputs, states), part.kept.dtype)
        once = jnp.block([[part.kept, part.now, part.before], [wide, nothing, nothing], [wide, unit, nothing]])
        entry = jnp.concatenate([part.after, unit, nothing])
        bump = jnp.concatenate([part.kink, nothing, nothing])[:, :number]
        sights = (
            [lines.seen @ scaled.place, lines.seen @ scaled.speed] if lines.hears_speed else [lines.seen @ scaled.place]
        )
        sight = _widened(jnp.concatenate(sights), 2 * inputs)
        output = _widened(jnp.stack([scaled.place[0], step * scaled.speed[0]]), 2 * inputs)

        def further(power: Array, _: None) -> tuple[Array, Array]:
            return once @ power, power

        end, powers = jax.lax.scan(further, jnp.eye(len(once), dtype=once.dtype), None, length=length)
        after = powers @ once
        backwards = powers[::-1]
        last = end, _side_by_side(backwards @ entry), _side_by_side(backwards @ bump)
        shown = output @ powers
        told = (output @ after).reshape(2 * length, -1), _toeplitz(shown @ entry), _toeplitz(shown @ bump)
        seen = sight @ powers
        return cls(
            sight @ after, seen @ entry[:, :number], _toeplitz(seen @ entry[:, number:]), seen @ bump, last, told
        )


def _widened(rows: Array, by: int) -> Array:
    """Rows of a state that do not look at the inputs that stand with it."""
    return jnp.pad(rows, ((0, 0), (0, by)))


def _side_by_side(columns: Float[Array, "step row column"]) -> Float[Array, "row step_column"]:
    return columns.transpose(1, 0, 2).reshape(columns.shape[1], -1)


def _toeplitz(responses: Float[Array, "step row column"]) -> Float[Array, "step_row step_column"]:
    """What is seen at each step of what enters at each step, before or at it."""
    length, rows, columns = responses.shape
    later = jnp.arange(length)[:, None] - jnp.arange(length)[None, :]
    found = jnp.where((later >= 0)[:, :, None, None], responses[jnp.maximum(later, 0)], 0.0)
    return found.transpose(0, 2, 1, 3).reshape(length * rows, length * columns)


class Steps(eqx.Module):
    """Even steps of one motion.

    Args:
        lines: of its contacts.
        scaled: its structure, with mean springs and dampers.
        products: of a block of steps.
        begin, step: time of the start, and of a step [s].
        length: of a block.
    """

    lines: Lines
    scaled: Scaled
    products: Register
    begin: Scalar
    step: Scalar
    length: int = eqx.field(static=True)

    @classmethod
    def of(cls, equation: StructureEquation, begin: Scalar, step: Scalar, each: int) -> "Steps":
        """Steps of a record with a number of them between samples."""
        lines = Lines.of(equation, begin)
        parts, seen = equation.structure, lines.seen
        stiffness = parts.stiffness + seen.T @ lines.stiffness @ seen
        damping = parts.damping if lines.damping is None else parts.damping + seen.T @ lines.damping @ seen
        scaled = Scaled.of(parts, stiffness, damping, step)
        part = weights(scaled.matrix, scaled.inputs @ lines.acting)
        length = block_length(each)
        return cls(lines, scaled, Register.of(lines, scaled, step, part, length), begin, step, length)

    def start(self, place: Array, speed: Array) -> tuple[Array, Array]:
        """State with its inputs now and a step before, and the overlap of the contacts, from the coordinates.

        A start whose inputs have no slope would make the whole motion first order.
        """
        equation = self.lines.equation
        now = equation.excitation(self.begin)

        def inputs(time: Scalar, place: Array, speed: Array) -> Array:
            seen, heard = (self.lines.seen @ part for part in (place, speed))
            now = equation.excitation(time)
            own = self.lines.inputs(now, seen, heard if self.lines.hears_speed else None)
            return jnp.concatenate([own, self.lines.known(now)])

        along = jnp.ones_like(self.begin), speed, equation.acceleration(now, place, speed)
        here, slope = jax.jvp(inputs, (self.begin, place, speed), along)
        state = self.scaled.back @ jnp.concatenate([place, speed])
        whole = jnp.concatenate([state, here, here - self.step * slope])
        return whole, self.lines.overlap(now, self.lines.seen @ place)

    def block(self, carry: tuple[Array, Array], rows: Excitation) -> tuple[tuple[Array, Array], Array]:
        """A block of steps, from what drives it at their ends: what `start` gives after it, and position and velocity
        per step of the output at each step, shape (step, 2) [rad]."""
        lines, register = self.lines, self.products
        state, overlap = carry
        inputs, number = lines.acting.shape[1], lines.seen.shape[0]
        now, before = state[-2 * inputs : -inputs][:number], state[-inputs:][:number]
        known = jax.vmap(lines.known)(rows)
        hard = isinstance(lines.equation.scene.contact, HardContact)

        def sighted(sight: Array) -> tuple[Array, Array | None]:
            return sight[:number], sight[number:] if lines.hears_speed else None

        def step(inner: tuple, row: Excitation) -> tuple[tuple, tuple[Array, Array]]:
            coming, now, before, overlap = inner
            ahead = coming[0] + times(register.echo[0], 2 * now - before)
            after = lines.inputs(row, *sighted(ahead))
            coming = coming + times(register.echo, after)
            missed = jnp.zeros((number,), after.dtype)
            if hard:
                missed = lines.missed(row, overlap, *sighted(coming[0]))
                coming = coming + times(register.kink, missed)
                overlap = lines.overlap(row, sighted(coming[0])[0])
            shifted = jnp.pad(coming[1:], ((0, 1), (0, 0)))
            return (shifted, after, now, overlap), (after, missed)

        free = register.free @ state + (register.known @ known.ravel()).reshape(self.length, -1)
        (*_, overlap), (own, all_missed) = jax.lax.scan(
            step, (free, now, before, overlap), rows, unroll=min(UNROLL, self.length)
        )
        parts = state, jnp.concatenate([own, known], axis=1).ravel(), all_missed.ravel()
        parts, sides = (parts, (0, 1, 2)) if hard else (parts[:2], (0, 1))
        after = sum(
            (register.last[side] @ part for side, part in zip(sides, parts, strict=True)), jnp.zeros_like(state)
        )
        nothing = jnp.zeros((2 * self.length,), state.dtype)
        told = sum((register.told[side] @ part for side, part in zip(sides, parts, strict=True)), nothing)
        return (after, overlap), told.reshape(self.length, 2)

    def driven(self, time: Scalar) -> Excitation:
        """What drives the steps: without what stands still."""
        now = self.lines.equation.excitation(time)
        return now._replace(jacobian=None, jacobian_rate=None) if self.lines.apart else now

    def coordinates(self, state: Array) -> Float[Array, "2 coordinate"]:
        """Coordinates and their velocities."""
        alone = state[: self.scaled.place.shape[1]]
        return jnp.stack([self.scaled.place @ alone, self.scaled.speed @ alone])


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
        span: steps whose excitation is worked out together, a multiple of those of a block.
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
        length, accuracy = block_length(each), tables.accuracy(dtype)
        best = cls(samples, each, length, None)
        if phase is None:
            return best
        for span in (n * length for n in range(1, each // length + 1) if (each // length) % n == 0):
            enough = (k for k in range(4, tables.MOST_NODES + 1) if tables.reach(k, accuracy) >= phase * span)
            nodes = next(enough, span)
            if nodes < span and nodes / span < (1.0 if best.nodes is None else best.nodes / best.span):
                best = cls(samples, each, span, nodes)
        return best


def march(steps: Steps, place: Array, speed: Array, spacing: Spacing) -> March:
    """Motion from coordinates and velocities over samples with some steps between them."""
    blocks = spacing.span // steps.length
    seconds = steps.step * spacing.each

    def block(inner: tuple, rows: Excitation) -> tuple[tuple, None]:
        carry, told, highest, lowest = inner
        carry, found = steps.block(carry, rows)
        earlier = jnp.concatenate([told[None], found[:-1]])
        one = jnp.ones_like(told[0])
        high = highest_between(earlier[:, 0], found[:, 0], earlier[:, 1], found[:, 1], one)
        low = -highest_between(-earlier[:, 0], -found[:, 0], -earlier[:, 1], -found[:, 1], one)
        return (carry, found[-1], jnp.maximum(highest, high.max()), jnp.minimum(lowest, low.min())), None

    # worked out again where a derivative runs backwards: its memory grows with blocks, not with steps
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def span(inner: tuple, origin: Array) -> tuple[tuple, None]:
        ends = jnp.arange(1, spacing.span + 1).astype(origin.dtype).reshape(blocks, steps.length)
        if spacing.nodes is None:

            def direct(inner: tuple, ends: Array) -> tuple[tuple, None]:
                return block(inner, jax.vmap(steps.driven)(origin + ends * steps.step))

            return jax.lax.scan(direct, inner, ends)
        places = jnp.asarray(tables.nodes(spacing.span, spacing.nodes), origin.dtype)
        known = jax.vmap(steps.driven)(origin + places * steps.step)
        at = np.arange(1, spacing.span + 1, dtype=float)
        shares = tables.weights(spacing.span, spacing.nodes, at).reshape(blocks, steps.length, -1)

        def between(inner: tuple, share: Array) -> tuple[tuple, None]:
            return block(inner, jax.tree.map(lambda leaf: jnp.tensordot(share, leaf, 1), known))

        return jax.lax.scan(between, inner, jnp.asarray(shares, origin.dtype))

    def interval(outer: tuple, number: Array) -> tuple[tuple, tuple]:
        carry, told = outer
        parts = jnp.arange(spacing.each // spacing.span).astype(seconds.dtype)
        origins = steps.begin + number.astype(seconds.dtype) * seconds + parts * (spacing.span * steps.step)
        (carry, told, highest, lowest), _ = jax.lax.scan(span, (carry, told, told[0], told[0]), origins)
        return (carry, told), (steps.coordinates(carry[0]), highest, lowest)

    told = jnp.stack([place[0], speed[0] * steps.step])
    numbers = jnp.arange(spacing.samples - 1)
    _, (states, highest, lowest) = jax.lax.scan(interval, (steps.start(place, speed), told), numbers)
    parts = (jnp.stack([place, speed]), states), (place[0], highest), (place[0], lowest)
    return March(*(jnp.concatenate([first[None], rest]) for first, rest in parts))
