"""Quasi-static analyses: transmission error without load and under a static torque, and backlash."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.metrics import Extremes, deviation, extremes, load_sharing_factor
from gearjax.checks import SceneError, is_concrete
from gearjax.contact import ContactSet, Equilibrium, equilibrium, first_contact
from gearjax.contact.frame import Pose
from gearjax.scene import Scene, require
from gearjax.typing import Array, ArrayLike, Float, Int, Scalar


class TransmissionError(eqx.Module):
    """Transmission error over input angles: output position minus ideal position, positive when the output leads.

    Of a batch (`jax.vmap`) every array has the batch's axes in front, and so have the metrics.

    Args:
        theta: input angles, shape (n,) [rad].
        te: transmission error, shape (n,) [rad].
        forces: compression of each contact, driving flanks first, shape (n, contact) [N]; ``None`` without torque.
        result: 0 found, 1 no flank can carry the torque, shape (n,).
        extremes: highest and lowest value over the span of theta, between samples too [rad].
        pairs: number of driving contacts.
    """

    theta: Float[Array, " n"]
    te: Float[Array, " n"]
    forces: Float[Array, "n contact"] | None
    result: Int[Array, " n"]
    extremes: Extremes
    pairs: int = eqx.field(static=True)

    @property
    def peak_to_peak(self) -> Float[Array, "..."]:
        """Highest minus lowest [rad]."""
        return self.extremes.maximum - self.extremes.minimum

    @property
    def amplitude(self) -> Float[Array, "..."]:
        """Largest absolute value [rad]."""
        return jnp.maximum(self.extremes.maximum, -self.extremes.minimum)

    @property
    def mean(self) -> Float[Array, "..."]:
        """Mean of the samples [rad]."""
        return self.te.mean(axis=-1)

    @property
    def std(self) -> Float[Array, "..."]:
        """Standard deviation of the samples [rad]."""
        return deviation(self.te)

    @property
    def engaged(self) -> Int[Array, "... n"]:
        """Number of contacts that carry force, shape (n,)."""
        if self.forces is None:
            raise SceneError("contacts that carry need a torque: transmission_error(scene, theta, torque=...)")
        return (self.forces > 0).sum(axis=-1)

    @property
    def load_sharing(self) -> Float[Array, "... n"]:
        """Load of the most loaded pair over the mean load, shape (n,) [-]."""
        if self.forces is None:
            raise SceneError("load sharing needs a torque: transmission_error(scene, theta, torque=...)")
        return load_sharing_factor(self.forces, self.pairs)


class Backlash(eqx.Module):
    """Backlash over input angles: travel of the output between its driving and its back flanks.

    Args:
        theta: input angles, shape (n,) [rad].
        lower: output position at which the first driving flank touches (the no-load TE), shape (n,) [rad].
        upper: output position at which the first back flank touches, shape (n,) [rad].
        extremes: largest and smallest backlash over the span of theta, between samples too [rad].
    """

    theta: Float[Array, " n"]
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    extremes: Extremes

    @property
    def backlash(self) -> Float[Array, "... n"]:
        """Upper minus lower edge, shape (n,) [rad]; negative where both flanks are jammed."""
        return self.upper - self.lower

    @property
    def range(self) -> Float[Array, "..."]:
        """Largest minus smallest backlash [rad]."""
        return self.extremes.maximum - self.extremes.minimum

    peak_to_peak = range

    @property
    def amplitude(self) -> Float[Array, "..."]:
        """Largest absolute value [rad]."""
        return jnp.maximum(self.extremes.maximum, -self.extremes.minimum)

    @property
    def mean(self) -> Float[Array, "..."]:
        """Mean of the samples [rad]."""
        return self.backlash.mean(axis=-1)

    @property
    def std(self) -> Float[Array, "..."]:
        """Standard deviation of the samples [rad]."""
        return deviation(self.backlash)


@arguments.checked(torque=arguments.torques)
def transmission_error(scene: Scene, theta: ArrayLike, torque: ArrayLike | None = None) -> TransmissionError:
    """Transmission error without load, or under a static torque.

    Without torque it is the first contact to close, ``max_i(gap_i / J_i)`` over the driving flanks
    (Wang et al. 2020, eqs. 1-8). Under torque it is the exact equilibrium of the one-sided springs with their mean
    stiffness (eqs. 10-18).

    Args:
        scene: the scene; with ``torque`` it needs a compliance.
        theta: input angles, increasing, shape (n,) [rad].
        torque: load torque on the output, a number or shape (n,) [N m]; positive loads the driving flanks.

    Returns:
        The error at each angle and its metrics [rad].

    Raises:
        SceneError: the scene lacks what the torque needs.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> te = gj.transmission_error(scene, jnp.linspace(0.0, 3 * scene.system.input_speed, 3001))
        >>> round(float(te.peak_to_peak / gj.units.arcmin), 3)
        2.246
    """
    theta = angles_of(scene, theta)
    if torque is None:
        return _transmission_error(scene.physics(), theta, None)
    require(scene, "static", "compliance")
    torque = jnp.asarray(torque, dtype=theta.dtype)
    if torque.ndim and torque.shape != theta.shape:
        raise SceneError(f"torque has shape {torque.shape}: give one number, or one per theta {theta.shape}")
    if not scene.has_back and is_concrete(torque) and bool((torque < 0).any()):
        raise SceneError(
            f"torque = {float(torque.min()):g} N*m loads the back flanks, which this scene lacks: list a [backlash]"
        )
    return _transmission_error(scene.physics("backlash", "compliance"), theta, torque)


@arguments.checked()
def backlash(scene: Scene, theta: ArrayLike) -> Backlash:
    """Time-varying backlash, from the first driving flank to the first back flank (Wang et al. 2020, eqs. 7 and 9).

    Args:
        scene: the scene, with an initial backlash.
        theta: input angles, increasing, shape (n,) [rad].

    Raises:
        SceneError: the scene has no backlash.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> play = gj.backlash(scene, jnp.linspace(0.0, scene.system.cycle, 1001))
        >>> bool((play.backlash > 0).all())
        True
    """
    require(scene, "backlash", "backlash")
    return _backlash(scene.physics("backlash"), angles_of(scene, theta))


def angles_of(scene: Scene, theta: ArrayLike) -> Float[Array, " n"]:
    """Input angles of an analysis, checked, shape (n,) [rad]."""
    theta = jnp.asarray(theta, dtype=scene.dtype)
    if theta.ndim != 1 or theta.shape[0] == 0:
        raise SceneError(f"theta has shape {theta.shape}: give input angles of shape (n,)")
    if is_concrete(theta) and not bool((np.diff(np.asarray(theta)) > 0).all()):
        raise SceneError("theta must increase")
    return theta


def rest(contacts: ContactSet, scene: Scene, torque: Scalar) -> Equilibrium:
    """Equilibrium under a load torque [N m], by the scene's contact law."""
    return equilibrium(contacts, -torque, scene.contact)


def no_load(scene: Scene, angle: Scalar | Pose) -> Scalar:
    """No-load TE at one input angle or pose [rad]: the lower edge of the play."""
    return first_contact(scene.contacts(angle), scene.contact)[0]


def static(physics: tuple[Scene, Scalar], angle: Scalar | Pose) -> Scalar:
    """Static TE of a scene under a torque [N m] at one angle [rad]."""
    scene, torque = physics
    return rest(scene.contacts(angle, "mean"), scene, torque).position


def play(scene: Scene, angle: Scalar | Pose) -> Scalar:
    """Backlash at one angle [rad]."""
    lower, upper = _edges(scene, angle)
    return upper - lower


def _edges(scene: Scene, angle: Scalar | Pose) -> tuple[Scalar, Scalar]:
    lower, upper = first_contact(scene.contacts(angle), scene.contact)
    assert upper is not None  # the caller requires a backlash
    return lower, upper


@eqx.filter_jit
def _transmission_error(scene: Scene, theta: Array, torque: Array | None) -> TransmissionError:
    scene = scene.anchored()
    pairs = jax.eval_shape(scene.contacts, theta[0]).pairs
    if torque is None:
        te = jax.vmap(no_load, in_axes=(None, 0))(scene, theta)
        result = jnp.zeros(theta.shape, int)
        return TransmissionError(theta, te, None, result, extremes(no_load, scene, theta, te), pairs)

    def at(angle: Scalar, torque: Array) -> Scalar:
        """Torque at an angle, between its samples too."""
        return torque if torque.ndim == 0 else jnp.interp(angle, theta, torque)

    def under(physics: tuple[Scene, Array], angle: Scalar) -> Scalar:
        scene, torque = physics
        return static((scene, at(angle, torque)), angle)

    axis = 0 if torque.ndim else None
    each = jax.vmap(lambda angle, size: rest(scene.contacts(angle, "mean"), scene, size), in_axes=(0, axis))
    rests = each(theta, torque)
    found = extremes(under, (scene, torque), theta, rests.position)
    return TransmissionError(theta, rests.position, rests.forces, rests.result, found, pairs)


@eqx.filter_jit
def _backlash(scene: Scene, theta: Array) -> Backlash:
    scene = scene.anchored()

    lower, upper = jax.vmap(_edges, in_axes=(None, 0))(scene, theta)
    return Backlash(theta, lower, upper, extremes(play, scene, theta, upper - lower))
