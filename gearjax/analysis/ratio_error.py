"""Error of the ratio of a gear set, and the input speed above which an uneven output lifts its teeth off."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax import arguments
from gearjax.analysis.extremes import extremes
from gearjax.analysis.quasi_static import angles_of, torque_on
from gearjax.analysis.resting import edge
from gearjax.checks import ParameterError, SceneError, is_concrete, with_article
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float, Scalar

PLACES = 2049  # angles of a cycle at which the largest deceleration is searched, then also between them


class RatioError(eqx.Module):
    """Ratio of a gear set without load: speed of the output over speed of the input.

    Args:
        theta: input angles, shape (n,) [rad].
        ideal: ratio of ideal bodies, shape (n,) [-].
        error: actual ratio minus ideal ratio, shape (n,) [-]: the change of the transmission error with the input
            angle. It jumps where another contact begins to carry.
    """

    theta: Float[Array, " n"]
    ideal: Float[Array, " n"]
    error: Float[Array, " n"]

    @property
    def peak_to_peak(self) -> Float[Array, "..."]:
        """Highest minus lowest error of the samples [-]."""
        return self.error.max(axis=-1) - self.error.min(axis=-1)

    @property
    def mean(self) -> Float[Array, "..."]:
        """Mean error of the samples [-]; zero over a whole cycle without its last angle."""
        return self.error.mean(axis=-1)


@arguments.checked()
def ratio_error(scene: Scene, theta: ArrayLike) -> RatioError:
    """Error of the ratio without load, ``i' - i`` (Dong et al. 2020, eqs. 17 and 24).

    It is the derivative of the no-load transmission error with respect to the input angle.

    Args:
        scene: the scene.
        theta: input angles, increasing, shape (n,) [rad].

    Raises:
        SceneError: theta does not increase.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/elliptic/dong_2020.toml")
        >>> ratio = gj.ratio_error(scene, jnp.linspace(0.0, 6.28, 100))
        >>> round(float(ratio.peak_to_peak), 6)
        0.002546
    """
    return _ratio_error(scene.precomputed(), angles_of(scene, theta))


@eqx.filter_jit
def _ratio_error(scene: Scene, theta: Float[Array, " n"]) -> RatioError:
    scene = scene.anchored()

    def at(angle: Scalar) -> tuple[Scalar, Scalar]:
        ones = jnp.ones_like(angle)
        ideal = jax.jvp(scene.system.output, (angle,), (ones,))[1]
        return ideal, jax.jvp(lambda angle: edge(scene, angle), (angle,), (ones,))[1]

    return RatioError(theta, *jax.vmap(at)(theta))


@arguments.checked()
def separation_speed(scene: Scene, torque: float | Scalar) -> Scalar:
    """Input speed above which the inertia of an output that turns unevenly separates its teeth.

    At this speed the largest deceleration of the ideal output equals that by the load, ``T + I phi'' = 0``, for rigid
    teeth.

    Args:
        scene: scene with inertia, of a gear set whose ideal output turns unevenly.
        torque: constant load torque on the output [N m]; a positive torque loads the driving flanks.

    Returns:
        The input speed [rad/s], differentiable; infinite if the ideal output never decelerates.

    Raises:
        SceneError: the output turns evenly, the scene has no inertia, or the torque loads flanks that it lacks.
        ParameterError: the torque is zero.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/elliptic/dong_2020.toml")
        >>> round(float(gj.separation_speed(scene, 10.0) / gj.units.rpm), 3)
        296.354
    """
    if scene.system.turns_evenly:
        words = f"that of {with_article(scene.system.kind)} does not"
        raise SceneError(f'"separation_speed" needs an output that turns unevenly; {words}')
    require(scene, "separation_speed", "inertia")
    if is_concrete(torque) and float(torque) == 0.0:
        raise ParameterError("torque", torque, "must not be zero: without load teeth separate at any speed")
    load = torque_on(scene, jnp.zeros(1, scene.dtype), torque)
    return _separation_speed(scene.precomputed("inertia"), load)


@eqx.filter_jit
def _separation_speed(scene: Scene, torque: Scalar) -> Scalar:
    assert scene.inertia is not None
    moment = scene.inertia.moment(scene.contacts(jnp.zeros_like(scene.system.input_speed)).output_levers)
    theta = jnp.linspace(0.0, scene.system.cycle, PLACES, dtype=scene.dtype)

    def bend(scene: Scene, angle: Scalar) -> Scalar:
        def rate(angle: Scalar) -> Scalar:
            return jax.jvp(scene.system.output, (angle,), (jnp.ones_like(angle),))[1]

        return jax.jvp(rate, (angle,), (jnp.ones_like(angle),))[1]

    found = extremes(bend, scene, theta, jax.vmap(bend, in_axes=(None, 0))(scene, theta))
    lifts = jnp.where(torque > 0, -found.minimum, found.maximum)
    lifting = lifts > 0  # never true for pitch circles, which turn evenly
    return jnp.where(lifting, jnp.sqrt(jnp.abs(torque) / (moment * jnp.where(lifting, lifts, 1.0))), jnp.inf)
