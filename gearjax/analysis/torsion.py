"""How the output gives way under torque: torsion curve, stiffness, lost motion, and pressure in the contacts."""

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
from gearjax.scene_checks import require
from gearjax.systems.base import pose_of
from gearjax.typing import Array, ArrayLike, Float, Scalar

LOST_MOTION_SHARE = 0.03  # of the rated torque, as in catalogues of precision reducers


class Torsion(eqx.Module):
    """Positions of the output under torques, the input held; without friction there is no hysteresis.

    Args:
        theta: input angles, shape (n,) [rad].
        torque: shape (m,) [N m].
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
        lost_motion: travel of the output between a small torque in either direction, shape (n,) [rad].
        backlash: the part that needs no torque, shape (n,) [rad].
    """

    theta: Float[Array, " n"]
    lost_motion: Float[Array, " n"]
    backlash: Float[Array, " n"]

    @property
    def wind_up(self) -> Float[Array, " n"]:
        """The part that is elastic, shape (n,) [rad]."""
        return self.lost_motion - self.backlash


@arguments.checked()
def torsion(scene: Scene, theta: ArrayLike, torques: ArrayLike) -> Torsion:
    """Torsion curve: position of the output under torques in either direction, the input held.

    Args:
        scene: the scene, with a compliance; a negative torque needs back flanks.
        theta: input angles, increasing, shape (n,) [rad].
        torques: load torques, increasing, shape (m,) [N m].

    Raises:
        SceneError: the scene lacks what a torque needs.
        ParameterError: torques do not increase.

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
        raise SceneError("torques: negative ones load the back flanks, which need [backlash], not listed here")
    return Torsion(theta, torques, _positions(scene.physics("backlash", "compliance"), theta, torques))


@arguments.checked()
def lost_motion(scene: Scene, theta: ArrayLike, rated_torque: ArrayLike) -> LostMotion:
    """Lost motion as catalogues give it: backlash and wind-up at 3 % of the rated torque in either direction.

    Args:
        scene: the scene, with a compliance and back flanks.
        theta: input angles, increasing, shape (n,) [rad].
        rated_torque: [N m].

    Raises:
        SceneError: the scene lacks what a torque needs.

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
    back, drive = _positions(scene.physics("backlash", "compliance"), theta, jnp.stack([-small, small]))
    return LostMotion(theta, back - drive, backlash(scene, theta).backlash)


@arguments.checked(
    te=arguments.an(TransmissionError, "must be a result of transmission_error(scene, theta, torque=...)"),
    law=arguments.an(AbstractLineContact, "must be a line contact, such as HertzLineContact(206e9, 0.3, 11e-3)"),
)
def contact_pressure(
    scene: Scene, te: TransmissionError, law: AbstractLineContact | None = None
) -> Float[Array, "n contact"]:
    """Highest pressure in each contact, shape (n, contact) [Pa].

    Of pins on discs it is that of Hertz. Of involute flanks in each other it is the larger one of Hertz' with their
    relative curvature and of the even one on the part of the flank that the contact stands for
    (`AbstractLineContact.flank_pressure`), which is coarse where few candidates stand along the profile: 9 of them and
    14 across the face tell more than the 5 and 1 that the forces need.

    Args:
        scene: the scene.
        te: its transmission error under a torque.
        law: material and face width, where the scene's compliance does not have them.

    Raises:
        SceneError: there are no forces, radii or material to work with.

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
    return pressures(scene, law, te.theta, te.forces)


def pressures(
    scene: Scene, law: AbstractLineContact | None, theta: Float[Array, " n"], forces: Float[Array, "n contact"]
) -> Float[Array, "n contact"]:
    """Pressure in each contact under given forces [Pa], as `contact_pressure`."""
    if law is None:
        own = scene.compliance
        law = own if isinstance(own, AbstractLineContact) else getattr(own, "line_contact", None)
    system = scene.system
    if law is None or not (system.has_radii or system.has_places or system.has_slices):
        raise SceneError(
            "pressure needs line contacts of known radii, and their material: give law=HertzLineContact(...)"
        )
    return _pressures(scene.physics("backlash"), law, theta, forces)


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
