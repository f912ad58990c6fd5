"""Motion without integration: the output follows its quasi-static position, with a first correction for inertia."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.analysis.equation import Equation
from gearjax.typing import Array, Float, Scalar


class QuasiStatic(eqx.Module):
    """The cheapest approximation of a motion: equilibrium at each time under the stiffness and load of that time.

    Args:
        inertia: whether to add the first correction for inertia and damping, ``-(M q'' + d q') / k``. It is valid if
            the whole excitation is slow compared with the natural frequency.
    """

    inertia: bool = eqx.field(static=True, default=True)


def follow(equation: Equation, ts: Float[Array, " n"], method: QuasiStatic) -> tuple[Array, Array]:
    """Position [rad] and velocity [rad/s] at each time, shape (n,) each."""

    def position(time: Scalar) -> Scalar:
        return equation.resting(time, equation.springs(time)[1], equation.torque_at(time))

    def at(time: Scalar) -> tuple[Scalar, Scalar]:
        def rate(time: Scalar) -> tuple[Scalar, Scalar]:
            return jax.jvp(position, (time,), (jnp.ones_like(time),))

        if not method.inertia:
            return rate(time)
        (place, velocity), (_, acceleration) = jax.jvp(rate, (time,), (jnp.ones_like(time),))
        # the correction is the residual of the equation of motion at this position, over the stiffness
        now = equation.excitation(time)
        missing = acceleration - equation.acceleration(now, place, velocity)
        closed = equation.scene.contact.closed(now.gaps.lever * place - now.gaps.gap)
        stiffness = (closed * now.stiffness * now.gaps.lever**2).sum()
        step = jnp.where(stiffness > 0, equation.inertia * missing / jnp.where(stiffness > 0, stiffness, 1.0), 0.0)
        return place - step, velocity

    return jax.vmap(at)(ts)
