"""The moving structure of a gear set: masses, supports and dampers in all its coordinates.

    M q'' + C q' + K q + J^T f = Q(t)

q counts from the ideal motion: the output's position first [rad], then displacements of bodies [m]. The moment of
inertia of a scene whose output alone moves is the smallest case.

A body that a crank carries goes round with it. With the throw a, the crank's speed W and the turn i of the crank per
turn of the output while the input is held, its centre is at ``(a + x) e_r + y e_t`` of axes that have turned by
``W t + i q_output``; Lagrange's equations of its kinetic energy, to first order in q, are

    mass        m (e_x e_x^T + t t^T),                   t = e_y + a i e_output
    gyroscopic  2 m W (t e_x^T - e_x t^T)                Coriolis force, no damping
    stiffness   -m W^2 (e_x e_x^T + e_y e_y^T)           centrifugal force
    force       m a W^2 e_x

with only the coordinates that are listed. The moment of inertia of the output holds what turns with it when nothing
gives way, the orbits included, so that ``m (a i)^2`` is not added to it.
"""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from gearjax.inertia import BodyInertia
from gearjax.supports import Support
from gearjax.typing import Array, Float, Number, Scalar


class Orbit(NamedTuple):
    """How a body goes round, carried by a crank: its x points along the throw, its y ahead.

    Args:
        order: turns of the crank per turn of the input.
        throw: distance of the body's centre from the axis [m].
        follows: turn of the crank, ahead, per turn of the output while the input is held [-].
    """

    order: float
    throw: Number
    follows: Number


class Structure(eqx.Module):
    """Mass, stiffness and damping of the coordinates that move.

    Args:
        names: of the coordinates, the output first.
        mass: shape (coordinate, coordinate) [kg m2, kg m, kg].
        stiffness: of the supports, centrifugal forces included; same shape [N/m].
        damping: of the supports, and Coriolis forces; same shape [N s/m].
        push: constant force that the ideal motion takes, shape (coordinate,) [N].
    """

    names: tuple[str, ...] = eqx.field(static=True)
    mass: Float[Array, "coordinate coordinate"]
    stiffness: Float[Array, "coordinate coordinate"]
    damping: Float[Array, "coordinate coordinate"]
    push: Float[Array, " coordinate"]

    @classmethod
    def of(
        cls,
        output: Scalar,
        supports: Mapping[str, Support],
        inertia: Mapping[str, BodyInertia],
        orbits: Mapping[str, Orbit],
        speed: Scalar,
    ) -> "Structure":
        """The structure of bodies on supports.

        Args:
            output: moment of inertia that turns with the output [kg m2].
            supports: of the bodies that move.
            inertia: of the same bodies.
            orbits: of those that a crank carries.
            speed: of the input [rad/s].
        """
        names = ("output", *(f"{body}.{way}" for body, support in supports.items() for way in support.directions))
        unit = jnp.eye(len(names), dtype=jnp.result_type(speed))
        stiffness, damping, push = jnp.zeros_like(unit), jnp.zeros_like(unit), jnp.zeros_like(unit[0])
        mass = output * jnp.outer(unit[0], unit[0])
        for body, support in supports.items():
            axes = {way: unit[names.index(f"{body}.{way}")] for way in support.directions}
            for way, axis in axes.items():
                along = jnp.outer(axis, axis)
                stiffness = stiffness + getattr(support, way) * along
                resistance = getattr(support, f"{way}_damping")
                damping = damping if resistance is None else damping + resistance * along
            weight, orbit = inertia[body].mass, orbits.get(body)
            x, y = (axes.get(way, jnp.zeros_like(push)) for way in "xy")
            if orbit is None:
                mass = mass + weight * (jnp.outer(x, x) + jnp.outer(y, y))
                continue
            turning, arm = orbit.order * speed, orbit.throw * orbit.follows
            around = y + arm * unit[0]
            mass = mass + weight * (jnp.outer(x, x) + jnp.outer(around, around) - arm**2 * jnp.outer(unit[0], unit[0]))
            damping = damping + 2 * weight * turning * (jnp.outer(around, x) - jnp.outer(x, around))
            stiffness = stiffness - weight * turning**2 * (jnp.outer(x, x) + jnp.outer(y, y))
            push = push + weight * orbit.throw * turning**2 * x
        return cls(names, mass, stiffness, damping, push)
