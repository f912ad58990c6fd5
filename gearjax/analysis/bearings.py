"""Forces on the supports of bodies."""

import equinox as eqx
import jax.numpy as jnp

from gearjax import arguments
from gearjax.analysis.motion import Motion
from gearjax.analysis.quasi_static import TransmissionError
from gearjax.checks import SceneError
from gearjax.scene import Scene
from gearjax.typing import Array, Float


class BearingForces(eqx.Module):
    """Forces and moments of bodies on their supports, in the axes of the supports.

    Args:
        names: body and direction of each, such as ``"pinion.x"``.
        forces: forces [N] for x, y and z, moments [N m] for rx, ry and rz, at each angle or time, shape (n, support).
    """

    names: tuple[str, ...] = eqx.field(static=True)
    forces: Float[Array, "n support"]

    def of(self, name: str) -> Float[Array, "... n"]:
        """One force or moment, shape (n,) [N, N m], such as ``of("pinion.x")``.

        Raises:
            SceneError: the scene lists no such support.
        """
        if name not in self.names:
            raise SceneError(f'no support "{name}"; there are {", ".join(self.names)}')
        return self.forces[..., self.names.index(name)]

    def radial(self, body: str) -> Float[Array, "... n"]:
        """Size of the radial force of a body, ``sqrt(x^2 + y^2)`` of the directions that are listed, shape (n,) [N].

        Raises:
            SceneError: the body has no support in x or y.
        """
        ways = [f"{body}.{way}" for way in "xy" if f"{body}.{way}" in self.names]
        if not ways:
            raise SceneError(f'"{body}" has no support in x or y; there are {", ".join(self.names)}')
        return jnp.linalg.norm(jnp.stack([self.of(way) for way in ways], axis=-1), axis=-1)


@arguments.checked(
    result=arguments.an((TransmissionError, Motion), "must be a result of transmission_error or simulate")
)
def bearing_forces(scene: Scene, result: TransmissionError | Motion) -> BearingForces:
    """Forces of the bodies on their supports, from the displacements of a loaded or moving gear set.

    The force is ``k u``, in motion ``k u + c du/dt``, with the displacement u, the stiffness k and the damping c of
    each listed direction. Directions that are not listed are rigid; the forces that they carry are not computed.

    Args:
        scene: the scene, with supports.
        result: its transmission error under a torque, or its motion.

    Returns:
        The forces [N] and moments [N m]; they are differentiable in all numbers of the scene and in the torque.

    Raises:
        SceneError: the scene lists no supports, the result is without load or of another scene.

    Example:
        >>> import dataclasses, gearjax as gj, jax.numpy as jnp
        >>> pair = gj.load("configs/helical/guo_2018.toml")
        >>> held = dataclasses.replace(pair, supports={"wheel": gj.Support(x=5e8, y=5e8)})
        >>> te = gj.transmission_error(held, jnp.linspace(0.0, 0.3, 5), torque=830.0)
        >>> gj.bearing_forces(held, te).names
        ('wheel.x', 'wheel.y')
    """
    if not scene.supports:
        raise SceneError("bearing forces need supports: list [supports.BODY] with the stiffness of a direction")
    if result.forces is None:
        raise SceneError("bearing forces need a torque: transmission_error(scene, theta, torque=...)")
    if result.coordinates != scene.coordinates:
        theirs, ours = (", ".join(names) for names in (result.coordinates, scene.coordinates))
        raise SceneError(f"the result is of another scene: it moves in {theirs}, this scene in {ours}")
    along, q = scene.moving.coordinates.along, result.q
    rate = result.rates if isinstance(result, Motion) else None
    names, forces = [], []
    for body, support in scene.supports.items():
        for way in support.directions:
            row = along(body, way)
            assert row is not None  # a direction of a support is a motion of its body
            row = jnp.asarray(row, q.dtype)
            force = getattr(support, way) * (q @ row)
            damping = getattr(support, f"{way}_damping")
            if damping is not None and rate is not None:
                force = force + damping * (rate @ row)
            names.append(f"{body}.{way}")
            forces.append(force)
    return BearingForces(tuple(names), jnp.stack(forces, axis=-1))
