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

SLIGHTEST = 1e-9  # N m, torque in place of none: under none at all nothing touches firmly enough to have a slope


class MeshStiffness(eqx.Module):
    """Torsional stiffness of the output over input angles, the input held.

    ``stiffness.tangent.mean() * gj.units.arcmin`` is in N m/arcmin, ``stiffness.tangent / r_b**2`` in N/m along the
    line of action of a base radius ``r_b``. Of a batch (`jax.vmap`) every array has the batch's axes in front.

    Args:
        theta: input angles, shape (n,) [rad].
        torque: load torque, shape (n,) [N m].
        secant: torque over the lag against the unloaded position, shape (n,) [N m/rad].
        tangent: change of torque per further turn, ``dT / dq``, shape (n,) [N m/rad].
        lag: by how far the torque turns the output, shape (n,) [rad]; it has the sign of the torque.
        result: 0 found, 1 no flank can carry the torque, 3 the search for the equilibrium did not end, shape (n,); nan
            there.
    """

    theta: Float[Array, " n"]
    torque: Float[Array, " n"]
    secant: Float[Array, " n"]
    tangent: Float[Array, " n"]
    lag: Float[Array, " n"]
    result: Int[Array, " n"]

    @property
    def ripple(self) -> Float[Array, "..."]:
        """Highest minus lowest tangent stiffness of the samples over their mean [-]: what excites motion."""
        high, low = self.tangent.max(axis=-1), self.tangent.min(axis=-1)
        return (high - low) / self.tangent.mean(axis=-1)


@arguments.checked(torque=arguments.torques)
def mesh_stiffness(scene: Scene, theta: ArrayLike, torque: ArrayLike) -> MeshStiffness:
    """Secant and tangent torsional stiffness of a gear set under a static torque, at each input angle.

    With the position ``q(T)`` of the output that contacts, supports and shafts balance the torque in,

        secant = T / (q(0) - q(T)),   tangent = -1 / (dq / dT)

    (the mesh stiffness c_gamma of ISO 6336-1, which is taken along the path of contact there, as a torsional one).
    The secant tells how far the output lags, the tangent how it moves about that position. More torque closes more
    contacts, so that the tangent lies above the secant where nothing is jammed. Under a torque of zero both are those
    of the slightest one, 1e-9 N m, which the first contact alone carries. The unloaded position is where the flanks
    just touch that the torque loads, or where elastic bodies rest that are jammed in each other.

    Args:
        scene: the scene, with a compliance; trains, and bodies on supports too.
        theta: input angles, increasing, shape (n,) [rad].
        torque: load torque on the output, a number or shape (n,) [N m]; a negative one loads the back flanks.

    Returns:
        The stiffness at each angle [N m/rad]. Differentiable in all numbers of the scene and in the torque, from
        either side of where contacts come and go.

    Raises:
        SceneError: the scene lacks a compliance, or the flanks that the torque loads, or shapes do not suit.
        ParameterError: an argument is not what it should be.

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
    return _mesh_stiffness(scene.physics("backlash", "compliance"), theta, torque)


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
    """Position of the output before a torque [N m] begins to act [rad], equilibrium and tangent under a load [N m]."""
    if not scene.has_back:
        return edge(scene, angle), *resistance(scene, angle, load)
    # one program of both, which takes long to compile where a matrix couples the springs
    loads = jnp.stack([jnp.zeros_like(load), load])
    rests, tangents = jax.vmap(lambda load: resistance(scene, angle, load))(loads)
    rest, tangent = jax.tree.map(lambda part: part[1], (rests, tangents))
    lower, upper = edges(scene, angle)
    touching = jnp.where(torque < 0, upper, lower)
    return jnp.where(upper < lower, rests.position[0], touching), rest, tangent
