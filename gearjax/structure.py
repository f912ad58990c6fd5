"""The moving structure of a gear set: masses, supports and dampers in all its coordinates.

    M q'' + C q' + K q + J^T f = Q(t)

q is the displacement from the ideal motion: first the position of the output [rad], then the other coordinates
(`gearjax.coordinates`), displacements [m] and rotations [rad] of shafts and bodies. If the output alone moves, M is one
number, the moment of inertia.

A body that a crank carries moves round with it. Let a be the throw, W the speed of the crank, and i the rotation of the
crank per rotation of the output while the input is held. The centre of the body is at ``(a + x) e_r + y e_t``, with
axes rotated by ``W t + i q_output``. Lagrange's equations of its kinetic energy give, to first order in q,

    mass        m (e_x e_x^T + t t^T),                   t = e_y + a i e_output
    gyroscopic  2 m W (t e_x^T - e_x t^T)                Coriolis force, no damping
    stiffness   -m W^2 (e_x e_x^T + e_y e_y^T)           centrifugal force
    force       m a W^2 e_x

with only the coordinates that are listed. The moment of inertia of the output covers all that turns with it if supports
and shafts are rigid, including the bodies on cranks. Therefore ``m (a i)^2`` is not added to it.
"""

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.coordinates import Coordinates, Meshes
from gearjax.inertia import OF_WAY, BodyInertia
from gearjax.shafts import Shaft
from gearjax.supports import DIRECTIONS, Support
from gearjax.typing import Array, Float, Number, Scalar


class Orbit(NamedTuple):
    """Motion of a body that a crank carries: x points along the throw, y in the direction of the crank's rotation.

    Args:
        order: turns of the crank per turn of the input.
        throw: distance of the body's centre from the axis [m].
        follows: rotation of the crank, positive in its direction of rotation, per rotation of the output while the
            input is held [-].
    """

    order: float
    throw: Number
    follows: Number


class Structure(eqx.Module):
    """Mass, stiffness and damping matrices of the coordinates.

    Args:
        names: names of the coordinates, the output first.
        mass: mass matrix, shape (coordinate, coordinate) [kg m2, kg m, kg].
        stiffness: stiffness of supports and shafts, including centrifugal forces; same shape [N/m, N m/rad].
        damping: damping of supports and shafts, including Coriolis forces; same shape [N s/m, N m s/rad].
        push: constant centrifugal force of the ideal motion, shape (coordinate,) [N].
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
        moving: "Moving",
        inertia: Mapping[str, BodyInertia],
        orbits: Mapping[str, Orbit],
        speed: Scalar,
    ) -> "Structure":
        """The structure of bodies on supports and shafts.

        Args:
            output: moment of inertia that turns with the output [kg m2].
            moving: the coordinates, with their supports and shafts.
            inertia: inertia of the bodies that move on their own.
            orbits: motions of the bodies that a crank carries.
            speed: speed of the input [rad/s].
        """
        dtype = jnp.result_type(speed)
        names, along = moving.coordinates.names, moving.coordinates.along
        stiffness, damping = moving.springs(dtype), moving.dampers(dtype)
        unit = jnp.eye(len(names), dtype=dtype)
        mass, push = output * jnp.outer(unit[0], unit[0]), jnp.zeros_like(unit[0])
        for body, own in inertia.items():
            orbit = orbits.get(body)
            rows = {way: along(body, way) for way in DIRECTIONS}
            axes = {way: jnp.asarray(row, dtype) for way, row in rows.items() if row is not None}
            for way, axis in axes.items():
                if (size := getattr(own, OF_WAY[way])) is not None and (orbit is None or way not in "xy"):
                    mass = mass + size * jnp.outer(axis, axis)
            if orbit is None:
                continue
            x, y = (axes.get(way, jnp.zeros_like(push)) for way in "xy")
            turning, arm = orbit.order * speed, orbit.throw * orbit.follows
            around, weight = y + arm * unit[0], own.mass
            assert weight is not None  # a body that a crank carries moves in x or y
            mass = mass + weight * (jnp.outer(x, x) + jnp.outer(around, around) - arm**2 * jnp.outer(unit[0], unit[0]))
            damping = damping + 2 * weight * turning * (jnp.outer(around, x) - jnp.outer(x, around))
            stiffness = stiffness - weight * turning**2 * (jnp.outer(x, x) + jnp.outer(y, y))
            push = push + weight * orbit.throw * turning**2 * x
        return cls(names, mass, stiffness, damping, push)


class Moving(NamedTuple):
    """The coordinates of a scene, with the supports and shafts that hold them.

    Args:
        coordinates: coordinates of the scene.
        supports: supports, by body.
        shafts: shafts, by name.
    """

    coordinates: Coordinates
    supports: Mapping[str, Support]
    shafts: Mapping[str, Shaft]

    @classmethod
    def of(cls, meshes: Meshes, supports: Mapping[str, Support], shafts: Mapping[str, Shaft]) -> "Moving":
        """The coordinates that follow from supports and shafts; raises the errors of `Coordinates.of`."""
        return cls(Coordinates.of(meshes, supports, shafts), supports, shafts)

    def springs(self, dtype: jnp.dtype) -> Float[Array, "coordinate coordinate"]:
        """Stiffness matrix of supports and shafts [N/m, N m/rad]; zero for the output and shafts that turn freely."""
        return self._sum("", dtype)

    def dampers(self, dtype: jnp.dtype) -> Float[Array, "coordinate coordinate"]:
        """Damping matrix of supports and shafts [N s/m, N m s/rad]."""
        return self._sum("_damping", dtype)

    def _sum(self, kind: str, dtype: jnp.dtype) -> Float[Array, "coordinate coordinate"]:
        number = len(self.coordinates.names)
        matrix = jnp.zeros((number, number), dtype)
        for body, support in self.supports.items():
            for way in support.directions:
                matrix = _with(matrix, getattr(support, way + kind), self.coordinates.along(body, way))
        for shaft in self.shafts.values():
            for one, other in itertools.pairwise(shaft.bodies):
                torsion, bending = (getattr(shaft, name + kind, None) for name in ("torsion", "bending"))
                matrix = _with(matrix, torsion, self._apart(one, other, "rz"))
                for way in "xy":
                    matrix = _with(matrix, bending, self._apart(one, other, way))
        return matrix

    def _apart(self, one: str, other: str, way: str) -> np.ndarray | None:
        """Relative motion of two bodies per unit of each coordinate; ``None`` if one of them cannot move that way."""
        ends = [self.coordinates.along(body, way) for body in (one, other)]
        if way == "rz":  # the body that the input turns is held: its row is zero
            ends = [np.zeros(len(self.coordinates.names)) if end is None else end for end in ends]
        return None if ends[0] is None or ends[1] is None else ends[0] - ends[1]


def _with(matrix: Array, size: Number | None, along: np.ndarray | None) -> Array:
    """The matrix with a spring or damper added along a motion."""
    if size is None or along is None:
        return matrix
    return matrix + size * jnp.asarray(np.outer(along, along), matrix.dtype)
