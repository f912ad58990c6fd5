"""Integration of the equation of motion by diffrax: even steps of any of its solvers, and its adaptive loop."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import diffrax
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from gearjax.analysis.equation import Equation
from gearjax.analysis.modes.equation import StructureEquation
from gearjax.analysis.motion import Motion
from gearjax.analysis.solvers import LONGEST_STEP, AdaptiveStep, highest_between
from gearjax.typing import Array, Float, Scalar

MOST_ROWS = 256  # largest number of steps whose excitation is tabulated at once


@runtime_checkable
class Motive(Protocol):
    """Interface of an equation of motion: its excitation and its rates."""

    @property
    def frequency(self) -> Scalar:
        """Angular frequency that scales time [rad/s]."""
        ...

    def excitation(self, time: Scalar) -> Any:
        """Everything except the state that the rates depend on, at a time [s]."""
        ...

    def rate(self, now: Any, state: Array) -> Array:
        """Change of the scaled state per scaled time."""
        ...


class Even(NamedTuple):
    """Even steps of a solver of diffrax."""

    solver: diffrax.AbstractSolver
    steps: int


def integrated(
    equation: Equation | StructureEquation, ts: Array, settle: Array, start: str, method: Even | AdaptiveStep
) -> Motion:
    """A motion by a solver of diffrax."""
    state = equation.initial(ts[0], start)
    there, state = jnp.isfinite(state).all(), jnp.nan_to_num(state)
    if isinstance(method, AdaptiveStep):
        states, highest, lowest, failed = adaptive_steps(equation, ts, state, method)
    else:
        states, highest, lowest = even_steps(equation, ts, state, method.solver, method.steps)
        too_long = (ts[1:] - ts[:-1]).max() / method.steps * equation.fastest_rate() > LONGEST_STEP
        failed = jnp.where(too_long, 2, 0)
    scale = jnp.broadcast_to(equation.scale, states[:, 0].shape)
    place, speed = states[:, 0] * scale, states[:, 1] * (scale * equation.frequency)
    forces = jax.vmap(equation.forces)(ts, place)
    failed = jnp.where(there, failed, 4)
    return recorded(equation, ts, (place, speed), (highest * scale, lowest * scale), forces, settle, failed)


def recorded(
    equation: Equation | StructureEquation,
    ts: Array,
    states: tuple[Array, Array],
    extremes: tuple[Array, Array],
    forces: Array,
    settle: Array,
    failed: Array,
) -> Motion:
    """A motion from its records, each of the output, shape (n,), or of all coordinates, shape (n, coordinate).

    Args:
        equation: equation of motion.
        ts: sample times [s].
        states: coordinates and velocities [rad, m].
        extremes: highest and lowest values up to each sample.
        forces: forces of the contacts, shape (n, contact) [N].
        settle: time that the metrics leave out [s].
        failed: result code.
    """
    layout, whole = equation.layout, jnp.zeros_like(settle)
    if isinstance(equation, Equation):
        return Motion(ts, *states, forces, *extremes, settle, failed, whole, layout)
    place, speed, highest, lowest = (part if part.ndim == 1 else part[:, 0] for part in (*states, *extremes))
    names = equation.structure.names
    moved, rates = (part[:, 1:] if len(names) > 1 else None for part in states)
    return Motion(ts, place, speed, forces, highest, lowest, settle, failed, whole, layout, None, moved, names, rates)


def even_steps(equation: Motive, ts: Array, state: Array, solver: diffrax.AbstractSolver, steps: int):
    """Integrate by even steps: a scan over the sample intervals, cut into parts of `MOST_ROWS` steps, and their steps.

    The excitation is tabulated at once for all ends and middles of the steps of a part (vectorised, outside of the
    sequential loop). Within a step it is interpolated, which is exact at the nodes of Runge-Kutta. The time within a
    step runs from 0 to 1.
    """

    now, unpack = ravel_pytree(equation.excitation(ts[0]))

    def field(time, state, args):
        rows, span = args
        return span * equation.rate(unpack(_within(rows, time)), state)

    terms = diffrax.ODETerm(field)
    parts = -(-steps // MOST_ROWS)
    steps = -(-steps // parts)

    def interval(carry, times):
        origin, length = times
        span = length * equation.frequency / steps
        nodes = origin + jnp.arange(2 * steps + 1).astype(ts.dtype) * (0.5 / steps) * length
        table = jax.vmap(lambda time: ravel_pytree(equation.excitation(time))[0])(nodes)
        rows = jnp.stack([table[:-1:2], table[1::2], table[2::2]], axis=1)

        def step(inner, now):
            rows, first = now
            state, memory, highest, lowest = inner
            new, _, _, memory, _ = solver.step(terms, 0.0, 1.0, state, (rows, span), memory, first)
            highest = jnp.maximum(highest, highest_between(state[0], new[0], state[1], new[1], span))
            lowest = jnp.minimum(lowest, -highest_between(-state[0], -new[0], -state[1], -new[1], span))
            return (new, memory, highest, lowest), None

        state, memory = carry
        firsts = jnp.arange(steps) == 0
        start = (state, memory, state[0], state[0])
        # reverse mode computes each step again, because storing its inner values is slower and takes more memory
        carry, _ = jax.lax.scan(jax.checkpoint(step, prevent_cse=False), start, (rows, firsts))
        state, memory, highest, lowest = carry
        return (state, memory), (state, highest, lowest)

    memory = solver.init(terms, 0.0, 1.0, state, (jnp.stack([now, now, now]), jnp.ones_like(ts[0])))
    lengths = (ts[1:] - ts[:-1]) / parts
    origins = ts[:-1, None] + lengths[:, None] * jnp.arange(parts).astype(ts.dtype)[None, :]
    intervals = (origins.ravel(), jnp.repeat(lengths, parts))
    _, (states, highest, lowest) = jax.lax.scan(interval, (state, memory), intervals)
    first = state[:1]
    return (
        jnp.concatenate([state[None, :], states[parts - 1 :: parts]]),
        jnp.concatenate([first, highest.reshape(-1, parts, *first.shape[1:]).max(axis=1)]),
        jnp.concatenate([first, lowest.reshape(-1, parts, *first.shape[1:]).min(axis=1)]),
    )


def _within(rows: Float[Array, "3 row"], time: float | Scalar) -> Float[Array, " row"]:
    """Excitation at a time from 0 to 1 within a step: the parabola through the rows of its start, middle and end."""
    if isinstance(time, float) and time in (0.0, 0.5, 1.0):
        return rows[round(2 * time)]
    weights = 2 * (time - 0.5) * (time - 1), 4 * time * (1 - time), 2 * time * (time - 0.5)
    return weights[0] * rows[0] + weights[1] * rows[1] + weights[2] * rows[2]


def adaptive_steps(equation: Motive, ts: Array, state: Array, stepper: AdaptiveStep):
    """Integrate by the adaptive loop of diffrax; extremes are those of the samples."""

    def field(tau, state, origin):
        return equation.rate(equation.excitation(origin + tau / equation.frequency), state)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        stepper.solver,
        t0=jnp.zeros_like(ts[0]),
        t1=(ts[-1] - ts[0]) * equation.frequency,
        dt0=jnp.full_like(ts[0], 0.05),
        y0=state,
        args=ts[0],
        saveat=diffrax.SaveAt(ts=(ts - ts[0]) * equation.frequency),
        stepsize_controller=diffrax.PIDController(rtol=stepper.rtol, atol=stepper.atol),
        max_steps=stepper.max_steps,
        adjoint=stepper.adjoint,
        throw=False,
    )
    states = jnp.asarray(solution.ys)
    failed = jnp.where(solution.result == diffrax.RESULTS.successful, 0, 3)
    return states, states[:, 0], states[:, 0], failed
