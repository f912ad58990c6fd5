"""Deflection of the output under torque: torsion curve, torsional stiffness, lost motion, and contact pressure."""

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax import arguments
from gearjax.analysis.quasi_static import TransmissionError, angles_of, backlash
from gearjax.analysis.resting import rest
from gearjax.checks import ParameterError, SceneError, is_concrete
from gearjax.compliance import AbstractLineContact
from gearjax.contact import Request
from gearjax.scene import Scene
from gearjax.scene_checks import check_result, require
from gearjax.systems.base import pose_of
from gearjax.typing import Array, ArrayLike, Float, Scalar

LOST_MOTION_SHARE = 0.03  # share of the rated torque, as in catalogues of precision reducers


class Torsion(eqx.Module):
    """Positions of the output under torques while the input is held. There is no friction, hence no hysteresis.

    Args:
        theta: input angles, shape (n,) [rad].
        torque: load torques on the output, shape (m,) [N m].
        te: transmission error under each torque, shape (m, n) [rad].
    """

    theta: Float[Array, " n"]
    torque: Float[Array, " m"]
    te: Float[Array, "m n"]

    @property
    def stiffness(self) -> Float[Array, "step n"]:
        """Torsional stiffness between neighbouring torques, shape (m - 1, n) [N m/rad]."""
        return -jnp.diff(self.torque)[:, None] / jnp.diff(self.te, axis=0)


class LostMotion(eqx.Module):
    """Lost motion over input angles.

    Args:
        theta: input angles, shape (n,) [rad].
        lost_motion: travel of the output between the same small torque in both directions, shape (n,) [rad].
        backlash: the part of the lost motion that needs no torque, shape (n,) [rad].
    """

    theta: Float[Array, " n"]
    lost_motion: Float[Array, " n"]
    backlash: Float[Array, " n"]

    @property
    def wind_up(self) -> Float[Array, " n"]:
        """Elastic part of the lost motion, shape (n,) [rad]."""
        return self.lost_motion - self.backlash


@arguments.checked()
def torsion(scene: Scene, theta: ArrayLike, torques: ArrayLike) -> Torsion:
    """Torsion curve: position of the output under torques in both directions while the input is held.

    Args:
        scene: the scene, with a compliance; negative torques also need back flanks.
        theta: input angles, increasing, shape (n,) [rad].
        torques: load torques, increasing, shape (m,) [N m].

    Raises:
        SceneError: the scene lacks a compliance, or the back flanks that a negative torque needs.
        ParameterError: the torques do not increase.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> curve = gj.torsion(scene, jnp.array([0.0, 1.0]), jnp.array([400.0, 800.0]))
        >>> curve.stiffness.shape
        (1, 2)
    """
    require(scene, "torsion", "compliance")
    theta = angles_of(scene, theta)
    torques = jnp.atleast_1d(jnp.asarray(torques, theta.dtype))
    if is_concrete(torques) and bool((jnp.diff(torques) <= 0).any()):
        raise ParameterError("torques", torques.tolist(), "must increase")
    if is_concrete(torques) and bool((torques < 0).any()) and not scene.has_back:
        raise SceneError("torques: negative torques load the back flanks, which this scene lacks: list a [backlash]")
    return Torsion(theta, torques, _positions(scene.precomputed("backlash", "compliance"), theta, torques))


@arguments.checked()
def lost_motion(scene: Scene, theta: ArrayLike, rated_torque: ArrayLike) -> LostMotion:
    """Lost motion as in catalogues: backlash plus elastic wind-up at 3 % of the rated torque in both directions.

    Args:
        scene: the scene, with a compliance and back flanks.
        theta: input angles, increasing, shape (n,) [rad].
        rated_torque: rated torque of the output [N m].

    Raises:
        SceneError: the scene lacks a compliance or a backlash.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> lost = gj.lost_motion(scene, jnp.linspace(0.0, 6.2, 50), 784.0)
        >>> bool((lost.lost_motion > lost.backlash).all())
        True
    """
    require(scene, "lost motion", "backlash", "compliance")
    theta = angles_of(scene, theta)
    small = LOST_MOTION_SHARE * jnp.asarray(rated_torque, theta.dtype)
    if is_concrete(small) and not float(small) > 0:
        raise ParameterError("rated_torque", float(small) / LOST_MOTION_SHARE, "must be positive")
    back, drive = _positions(scene.precomputed("backlash", "compliance"), theta, jnp.stack([-small, small]))
    return LostMotion(theta, back - drive, backlash(scene, theta).backlash)


@arguments.checked(
    te=arguments.an(TransmissionError, "must be a result of transmission_error(scene, theta, torque=...)"),
    law=arguments.an(AbstractLineContact, "must be a line contact, such as HertzLineContact(206e9, 0.3, 11e-3)"),
)
def contact_pressure(
    scene: Scene, te: TransmissionError, law: AbstractLineContact | None = None
) -> Float[Array, "n contact"]:
    """Highest pressure in each contact, shape (n, contact) [Pa].

    For pins on discs and for slices of contact lines it is the Hertzian pressure. For involute flanks of an external in
    an internal gear (`InvoluteRV`) it is the larger of two pressures (`AbstractLineContact.flank_pressure`): the
    Hertzian one from the relative curvature, and the force spread evenly over the part of the flank that the contact
    represents. The second is coarse with few candidates along the profile: 9 along the profile and 14 across the face
    resolve more than the 5 and 1 that are enough for the forces.

    Args:
        scene: the scene.
        te: its transmission error under a torque.
        law: material and face width, needed if the scene's compliance does not have them.

    Raises:
        SceneError: forces, radii of curvature or the material are not known, or the result is of another scene.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> te = gj.transmission_error(scene, jnp.linspace(0.0, 6.2, 50), 784.0)
        >>> steel = gj.HertzLineContact(206e9, 0.3, 11e-3)
        >>> bool(gj.contact_pressure(scene, te, steel).max() < 2e9)
        True
    """
    if te.forces is None:
        raise SceneError("pressure needs a torque: transmission_error(scene, theta, torque=...)")
    check_result(scene, te.forces)
    return pressures(scene, law, te.theta, te.forces)


def pressures(
    scene: Scene, law: AbstractLineContact | None, theta: Float[Array, " n"], forces: Float[Array, "n contact"]
) -> Float[Array, "n contact"]:
    """Pressure in each contact under given forces [Pa], see `contact_pressure`."""
    if law is None:
        own = scene.compliance
        law = own if isinstance(own, AbstractLineContact) else getattr(own, "line_contact", None)
    system = scene.system
    if law is None or not (system.has_radii or system.has_places or system.has_slices):
        raise SceneError(
            "pressure needs line contacts of known radii, and their material: give law=HertzLineContact(...)"
        )
    return _pressures(scene.precomputed("backlash"), law, theta, forces)


@eqx.filter_jit
def _pressures(scene: Scene, law: AbstractLineContact, theta: Array, forces: Array) -> Array:
    def at(angle: Scalar, forces: Float[Array, " contact"]) -> Float[Array, " contact"]:
        if scene.system.has_radii:
            radii = pose_of(scene.system, angle, Request(radii=True)).radii
            assert radii is not None  # the system has them
            return law.pressure(radii, forces)
        back = scene.backlash is not None
        if scene.system.has_slices:
            slices = pose_of(scene.system, angle, Request(back, slices=True)).slices
            assert slices is not None  # the system has them
            return law.slice_pressure(slices, forces)
        places = pose_of(scene.system, angle, Request(back, places=True)).places
        assert places is not None  # the system has them
        return law.flank_pressure(places, forces)

    return jax.vmap(at)(theta, forces)


@eqx.filter_jit
def _positions(scene: Scene, theta: Array, torques: Array) -> Array:
    scene = scene.anchored()

    def one(angle: Array) -> Array:
        return jax.vmap(lambda torque: rest(scene, angle, torque).position)(torques)

    return jax.vmap(one, out_axes=1)(theta)
