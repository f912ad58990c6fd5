"""Load of a pair of gears across the face, and the face load factor K_Hbeta."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.motion import Motion
from gearjax.analysis.quasi_static import TransmissionError
from gearjax.checks import ParameterError, SceneError
from gearjax.contact import Request
from gearjax.geometry.plane_of_action import middles
from gearjax.scene import Scene
from gearjax.scene_checks import check_result
from gearjax.systems.base import pose_of
from gearjax.typing import Array, Float


class FaceLoad(eqx.Module):
    """Load per width of the face at each angle or time.

    Args:
        across: places from the middle of the face, the middles of the slices, shape (slice,) [m].
        load: force along the normal of the flanks per width of the face, summed over the pairs of teeth, shape (n,
            slice) [N/m].
    """

    across: Float[Array, " slice"]
    load: Float[Array, "n slice"]

    @property
    def mean(self) -> Float[Array, "... slice"]:
        """Mean over the angles or times at each place, shape (slice,) [N/m]."""
        return self.load.mean(axis=-2)

    @property
    def factor(self) -> Float[Array, "..."]:
        """Face load factor K_Hbeta (ISO 6336-1): the highest load across the face over the mean load, of `mean` [-]."""
        return self.mean.max(axis=-1) / self.mean.mean(axis=-1)


@arguments.checked(
    result=arguments.an((TransmissionError, Motion), "must be a result of transmission_error or simulate"),
    mesh=arguments.whole(0),
)
def face_load(scene: Scene, result: TransmissionError | Motion, mesh: int = 0) -> FaceLoad:
    """Load across the face of a pair of gears with slices, from the forces of a loaded or moving pair.

    The face load factor K_Hbeta of ISO 6336-1 is the highest load per width over the mean. Here it comes from the
    contact analysis: misalignment, crowning, helix deviations and deflections of supports count as far as the scene
    lists them. For spur teeth that are misaligned by F along the face of width b, and that touch on all of it, it is
    ``1 + F c b / (2 F_t)``, with the mean stiffness c per width, as in method C of the standard.

    Args:
        scene: the scene.
        result: its transmission error under a torque, or its motion, over one or more whole meshes: the mean over a
            part of a mesh depends on the part.
        mesh: number of the mesh of a train, counted from 0 at the input.

    Returns:
        Load per width at each angle or time [N/m]; it is differentiable in all numbers of the scene and in the torque.

    Raises:
        SceneError: the teeth of the gear set are not cut into slices, or the result is without load or of another
            scene.
        ParameterError: there is no such mesh.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/helical/guo_2018.toml")
        >>> mesh = jnp.linspace(0.0, 2 * jnp.pi / 19, 32, endpoint=False)
        >>> te = gj.transmission_error(scene, mesh, torque=830.0)
        >>> bool(gj.face_load(scene, te).factor > 1.2)
        True
    """
    system = scene.system
    if not system.has_slices:
        raise SceneError(f"the load across the face needs slices across the face, which {system.kind} does not have")
    if result.forces is None:
        raise SceneError("the load across the face needs a torque: transmission_error(scene, theta, torque=...)")
    check_result(scene, result.forces)
    if mesh >= len(system.mesh_orders):
        raise ParameterError("mesh", mesh, f"must be below {len(system.mesh_orders)}, the number of meshes")
    return across_face(scene, result.forces, mesh)


def across_face(scene: Scene, forces: Float[Array, "... n contact"], mesh: int = 0) -> FaceLoad:
    """Load across the face from the forces of a gear set with slices, shape (n, contact) [N]; see `face_load`."""
    if scene.layout.mesh:
        forces = forces[..., np.flatnonzero(np.asarray(scene.layout.mesh) == mesh)]
    slices = pose_of(scene.system, jnp.zeros((), scene.dtype), Request(back=False, slices=True)).slices
    assert slices is not None  # the system has them
    number, face_width = slices[mesh].share.shape[-1], slices[mesh].pair.face_width
    of_slices = forces.reshape(*forces.shape[:-1], -1, number).sum(axis=-2)
    return FaceLoad(middles(face_width, number), of_slices * (number / face_width))
