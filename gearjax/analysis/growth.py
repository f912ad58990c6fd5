"""Growth rate of a disturbance of a motion: if it is high, single samples and their gradients mean nothing."""

import math
import warnings
from typing import Any

import jax
import jax.numpy as jnp

from gearjax.analysis import modes
from gearjax.analysis.fast import march
from gearjax.analysis.fast.signals import Forcing
from gearjax.typing import Array, Scalar

MOST_STEPS = 2048  # steps after which the disturbance is scaled back to its first size
LOST = math.log(1e6)  # growth over a record after which gradients of its samples mean nothing


def growth(forcing: Forcing, start: Scalar, carry: tuple[Scalar, Scalar], spacing: march.Spacing) -> Scalar:
    """Mean growth rate of a small disturbance after the first part of a record [1/s]; negative if it dies out.

    It is the largest Lyapunov exponent, from the linearised steps of the motion (Benettin et al. 1980). The size of the
    disturbance is measured in position and in velocity over the natural frequency.

    Args:
        forcing, start, carry, spacing: as for `gearjax.analysis.fast.march.march`.
    """
    parts = max(1, spacing.samples * spacing.each // MOST_STEPS)
    part = spacing._replace(samples=max(1, spacing.samples // parts)).of_whole_blocks()
    length = part.samples * spacing.each * forcing.oscillator.step
    velocity = 1 / (forcing.oscillator.step * forcing.oscillator.equation.frequency)

    def follow(state: tuple, number: Array) -> tuple[tuple, Array]:
        state, way = state
        begun = start + number.astype(start.dtype) * length
        nodes = march.nodes_of(forcing, begun, part)
        state, way = jax.jvp(lambda *state: march.run_blocks(forcing, begun, state, part, nodes)[0], state, way)
        size = jnp.sqrt(way[0] ** 2 + (way[1] * velocity) ** 2)
        nothing = size == 0  # the disturbance died out within one part
        safe = jnp.where(nothing, 1.0, size)
        kept = tuple(jnp.where(nothing, fresh, one / safe) for fresh, one in zip(seed, way, strict=True))
        return (state, kept), jnp.log(jnp.where(nothing, jnp.finfo(size.dtype).tiny, size))

    seed = jnp.ones_like(start), jnp.zeros_like(start)
    _, grown = jax.lax.scan(follow, (carry, seed), jnp.arange(parts))
    grown = grown[min(1, parts - 1) :]
    return grown.mean() / length


def growth_in_modes(steps: modes.Steps, place: Array, speed: Array, spacing: modes.Spacing) -> Scalar:
    """`growth` for bodies on supports, from their coordinates and velocities; arguments as for `modes.march`.

    The size of the disturbance is measured in all scaled coordinates and velocities.
    """
    parts = max(1, spacing.samples * spacing.each // MOST_STEPS)
    part = spacing._replace(samples=1 + max(1, (spacing.samples - 1) // parts))
    length = (part.samples - 1) * spacing.each * steps.step
    equation = steps.lines.equation
    scale = jnp.outer(jnp.stack([jnp.ones_like(length), equation.frequency]), equation.scale)

    def follow(carry: tuple[Array, Array], number: Array) -> tuple[tuple[Array, Array], Array]:
        begun = steps.beginning(steps.begin + number.astype(length.dtype) * length)
        after, way = jax.jvp(
            lambda state: modes.march(begun, state[0], state[1], part).states[-1], carry[:1], carry[1:]
        )
        size = jnp.linalg.norm(way / scale)
        nothing = size == 0
        way = jnp.where(nothing, seed, way / jnp.where(nothing, 1.0, size))
        return (after, way), jnp.log(jnp.where(nothing, jnp.finfo(size.dtype).tiny, size))

    seed = scale.at[1].set(0.0)
    _, grown = jax.lax.scan(follow, (jnp.stack([place, speed]), seed), jnp.arange(parts))
    return grown[min(1, parts - 1) :].mean() / length


def watch(
    record: march.March, forcing: Forcing, start: Scalar, carry: tuple[Scalar, Scalar], spacing: march.Spacing
) -> march.March:
    """The same march, with a warning if it is differentiated while its disturbances grow; arguments as for `growth`."""

    @jax.custom_jvp
    def same(record: march.March, given: tuple) -> march.March:
        del given
        return record

    @same.defjvp
    def warning(primals: tuple, tangents: tuple) -> tuple:
        record, given = primals
        length = spacing.samples * spacing.each * given[0].oscillator.step
        jax.debug.callback(_warn, growth(given[0], given[1], given[2], spacing), length)
        return record, tangents[0]

    return same(record, (forcing, start, carry))


def _warn(rate: Any, length: Any) -> None:
    if float(rate) * float(length) > LOST:
        warnings.warn(
            f"a disturbance of this motion grows at {float(rate):.3g} 1/s: gradients of its samples mean nothing after "
            f"some {LOST / float(rate):.2g} s; use statistics over a shorter record, or the static errors",
            stacklevel=2,
        )
