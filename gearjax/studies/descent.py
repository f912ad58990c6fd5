"""Gradient descent of a smoothed objective with falling temperature, from one start; batched by vmap.

The optimiser is an object. An optax gradient transformation makes one step at each temperature of a geometric series;
an optimistix minimiser runs until it stops at each of `LEVELS` temperatures.
"""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
import optimistix

from gearjax.checks import GearjaxError
from gearjax.typing import Array, Float, Int, Scalar

if TYPE_CHECKING:
    import optax  # functions import it themselves, because the import takes longer than many runs

    Optimiser: TypeAlias = optax.GradientTransformation | optimistix.AbstractMinimiser
else:
    Optimiser = Any

LEVELS = 4
Loss = Callable[[Float[Array, " free"], Array], Scalar]


@functools.cache
def default_optimiser(steps: int, rate: float = 0.4) -> Optimiser:
    """Adam with a short memory, whose learning rate falls to zero as a cosine."""
    import optax

    return optax.adam(optax.cosine_decay_schedule(rate, max(steps, 1)), b1=0.8, b2=0.95)


def check_optimiser(optimiser: Any) -> None:
    """Refuse anything but an optimiser from optax or optimistix.

    Raises:
        GearjaxError: says what would be right.
    """
    import optax

    if not isinstance(optimiser, optax.GradientTransformation | optimistix.AbstractMinimiser):
        raise GearjaxError(
            f"optimiser = {type(optimiser).__name__}: give one of optax, such as optax.adam(0.1), or an optimistix "
            "minimiser, such as optimistix.BFGS(rtol=1e-4, atol=1e-6)"
        )


def descend(
    loss: Loss, start: Float[Array, " free"], optimiser: Optimiser, steps: int, temperatures: tuple[Array, Array]
) -> tuple[Float[Array, " free"], Float[Array, " step"], Int[Array, ""]]:
    """Descend from one start: the end, the losses on the way, and the number of evaluations of loss and gradient.

    Args:
        loss: ``loss(numbers, temperature)``.
        start: unconstrained numbers, shape (free,).
        optimiser: optimiser from optax or optimistix.
        steps: number of steps; for an optimistix minimiser the largest number, over all temperatures.
        temperatures: first and last temperature, numbers or arrays of the shape that the loss takes.
    """
    if isinstance(optimiser, optimistix.AbstractMinimiser):
        return _levels(loss, start, optimiser, steps, temperatures)
    import optax

    first, last = temperatures
    update = optax.with_extra_args_support(optimiser).update

    def step(carry, share):
        numbers, state = carry
        temperature = first * (last / first) ** share

        def at(numbers):
            return loss(numbers, temperature)

        value, slope = jax.value_and_grad(at)(numbers)
        # optax mixes dtypes and ranks, which a user may have forbidden in jax
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            change, state = update(slope, state, numbers, value=value, grad=slope, value_fn=at)
        return (numbers + change, state), value

    shares = jnp.linspace(0.0, 1.0, steps, dtype=start.dtype)
    (numbers, _), losses = jax.lax.scan(step, (start, optimiser.init(start)), shares)
    return numbers, losses, jnp.asarray(steps)


def _levels(loss, start, optimiser, steps, temperatures):
    each = max(1, steps // LEVELS)

    def level(numbers, temperature):
        solution = optimistix.minimise(
            lambda numbers, _: loss(numbers, temperature), optimiser, numbers, max_steps=each, throw=False
        )
        ended = jnp.where(jnp.isfinite(solution.value), solution.value, numbers)
        return ended, (loss(ended, temperature), solution.stats["num_steps"] + 1)

    first, last = temperatures
    fall = first * (last / first) ** jnp.linspace(0.0, 1.0, LEVELS, dtype=start.dtype)
    numbers, (losses, evaluations) = jax.lax.scan(level, start, fall)
    return numbers, losses, evaluations.sum()
