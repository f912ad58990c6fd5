"""Torsional stiffness of a gear set under a torque at each input angle: contacts, supports and shafts in series."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax import arguments
from gearjax.analysis.quasi_static import angles_of, torque_on
from gearjax.analysis.resting import edge, edges, resistance
from gearjax.contact import Equilibrium
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float, Int, Scalar

SLIGHTEST = 1e-9  # N m, used in place of zero torque, under which no contact is closed and there is no slope


class MeshStiffness(eqx.Module):
    """Torsional stiffness of the output over input angles, while the input is held.

    ``stiffness.tangent.mean() * gj.units.arcmin`` is in N m/arcmin, ``stiffness.tangent / r_b**2`` in N/m along the
    line of action for a base radius ``r_b``. In a batch (`jax.vmap`) every array has the axes of the batch first.

    Args:
        theta: input angles, shape (n,) [rad].
        torque: load torque, shape (n,) [N m].
        secant: secant stiffness, torque over lag, shape (n,) [N m/rad].
        tangent: tangent stiffness, change of torque per further rotation, ``dT / dq``, shape (n,) [N m/rad].
        lag: rotation of the output from its unloaded position, shape (n,) [rad]; it has the sign of the torque.
        result: 0 found, 1 no flank can carry the torque, 3 the search for the equilibrium did not converge, shape
            (n,); if it is not 0, the other results are nan.
    """

    theta: Float[Array, " n"]
    torque: Float[Array, " n"]
    secant: Float[Array, " n"]
    tangent: Float[Array, " n"]
    lag: Float[Array, " n"]
    result: Int[Array, " n"]

    @property
    def ripple(self) -> Float[Array, "..."]:
        """Highest minus lowest tangent stiffness of the samples, over their mean [-]; it excites vibration."""
        high, low = self.tangent.max(axis=-1), self.tangent.min(axis=-1)
        return (high - low) / self.tangent.mean(axis=-1)


@arguments.checked(torque=arguments.torques)
def mesh_stiffness(scene: Scene, theta: ArrayLike, torque: ArrayLike) -> MeshStiffness:
    """Secant and tangent torsional stiffness of a gear set under a static torque, at each input angle.

    Let ``q(T)`` be the position of the output at which contacts, supports and shafts balance the torque. Then

        secant = T / (q(0) - q(T)),   tangent = -1 / (dq / dT)

    This is the mesh stiffness c_gamma of ISO 6336-1 as a torsional stiffness; the standard defines it along the path of
    contact. The secant gives the lag of the output, the tangent its motion about the loaded
    position. More torque closes more contacts, so that the tangent is above the secant if nothing is jammed. For a
    torque of zero both are those at 1e-9 N m, which the first contact alone carries. At the unloaded position the
    flanks that the torque loads just touch; if elastic bodies are jammed, it is their rest position.

    Args:
        scene: the scene, with a compliance; trains and bodies on supports are allowed.
        theta: input angles, increasing, shape (n,) [rad].
        torque: load torque on the output, a number or shape (n,) [N m]; a negative torque loads the back flanks.

    Returns:
        The stiffness at each angle [N m/rad]. It is differentiable in all numbers of the scene and in the torque, with
        one-sided derivatives where contacts open or close.

    Raises:
        SceneError: the scene lacks a compliance or the flanks that the torque loads, or shapes do not match.
        ParameterError: an argument is not allowed.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> stiffness = gj.mesh_stiffness(scene, jnp.linspace(0.0, scene.system.cycle, 201), 100.0)
        >>> bool((stiffness.tangent >= stiffness.secant * (1 - 1e-9)).all())
        True
    """
    require(scene, "mesh stiffness", "compliance")
    theta = angles_of(scene, theta)
    torque = jnp.broadcast_to(torque_on(scene, theta, torque), theta.shape)
    return _mesh_stiffness(scene.precomputed("backlash", "compliance"), theta, torque)


@eqx.filter_jit
def _mesh_stiffness(scene: Scene, theta: Array, torque: Array) -> MeshStiffness:
    scene = scene.anchored()

    def at(angle: Scalar, torque: Scalar) -> tuple[Array, Array, Array, Array]:
        none = torque == 0
        unloaded, rest, tangent = _both(scene, angle, torque, jnp.where(none, SLIGHTEST, torque))
        lag = jnp.where(none, 0.0, unloaded - rest.position)
        secant = jnp.where(none, tangent, torque / jnp.where(none, 1.0, lag))
        return secant, tangent, lag, rest.result

    return MeshStiffness(theta, torque, *jax.vmap(at)(theta, torque))


def _both(scene: Scene, angle: Scalar, torque: Scalar, load: Scalar) -> tuple[Scalar, Equilibrium, Scalar]:
    """Unloaded position of the output [rad], and equilibrium and tangent stiffness under a load [N m].

    The sign of ``torque`` [N m] decides which flanks touch at the unloaded position.
    """
    if not scene.has_back:
        return edge(scene, angle), *resistance(scene, angle, load)
    # both loads in one batch: the solver for coupled springs takes long to compile
    loads = jnp.stack([jnp.zeros_like(load), load])
    rests, tangents = jax.vmap(lambda load: resistance(scene, angle, load))(loads)
    rest, tangent = jax.tree.map(lambda part: part[1], (rests, tangents))
    lower, upper = edges(scene, angle)
    touching = jnp.where(torque < 0, upper, lower)
    return jnp.where(upper < lower, rests.position[0], touching), rest, tangent
