"""Where the output of a scene is held: edges of its play, equilibrium under a torque, interference.

To first order the contacts of an angle are one set of straight lines. Where a system's geometry is exact their gaps
bend with the output's position, so that the lines are laid anew at the position found: twice, as the error of each
round is about the square of that of the one before (0.3 um, 0.05 nm, nothing).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.contact import ContactSet, Equilibrium, Overlap, Pose, equilibrium, first_contact, least_overlap
from gearjax.contact.search import spring_forces
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Int, Scalar
from gearjax.units import deg, um

ROUNDS = 2
TOUCHING = 1e-12  # m, overlap up to which bodies just touch


def tolerated(dtype: jnp.dtype) -> float:
    """Overlap that is no more than rounding, of machines of some metres [m]: 0.5 um in float32."""
    return max(TOUCHING, 4 * float(jnp.finfo(dtype).eps))


class Interference(eqx.Module):
    """Rigid bodies that overlap wherever the output is.

    Args:
        theta: input angles, shape (n,) [rad].
        overlap: the least that the deepest contact overlaps by, whatever the output's position: how far the bodies
            must give way to be assembled; negative where all are clear, shape (n,) [m].
        contact: of the two contacts that overlap most, or are closest to it, the one of the shorter lever, shape (n,).
        position: of the output there [rad].
    """

    theta: Float[Array, " n"]
    overlap: Float[Array, " n"]
    contact: Int[Array, " n"]
    position: Float[Array, " n"]

    @property
    def interferes(self) -> Array:
        """Whether bodies overlap, beyond rounding, shape (n,)."""
        return self.overlap > tolerated(self.overlap.dtype)

    @property
    def result(self) -> Int[Array, "... n"]:
        """0 clear, 2 interference, shape (n,)."""
        return jnp.where(self.interferes, 2, 0)

    @property
    def worst(self) -> Int[Array, "..."]:
        """Index of the angle with the largest overlap."""
        return jnp.argmax(self.overlap, axis=-1)

    def told(self, scene: Scene) -> str | None:
        """The worst of it in words, ``None`` where all are clear."""
        if not bool(self.interferes.any()):
            return None
        worst = int(self.worst)
        share, name = float(self.interferes.mean()), scene.system.contact_name(int(self.contact[worst]))
        return (
            f"interference: rigid bodies overlap at {100 * share:.3g} % of the angles, by up to "
            f"{float(self.overlap[worst]) / um:.3g} um ({name}, input angle {float(self.theta[worst]) / deg:.5g} deg): "
            "no position of the output clears it, and no-load TE and backlash there mean little"
        )

    def as_json(self, scene: Scene) -> dict[str, Any] | None:
        """The worst of it by name, ``None`` where all are clear."""
        if not bool(self.interferes.any()):
            return None
        worst = int(self.worst)
        return {
            "overlap_um": float(self.overlap[worst]) / um,
            "contact": scene.system.contact_name(int(self.contact[worst])),
            "input_angle_deg": float(self.theta[worst]) / deg,
            "share_of_angles": float(self.interferes.mean()),
        }


def edge(scene: Scene, angle: Scalar | Pose, *, derivatives: int = 1) -> Scalar:
    """Lower edge of the play at an angle: output position at which the first driving flank touches [rad].

    Args:
        scene: the scene.
        angle: of the input [rad], or the pose there.
        derivatives: up to which order they hold where geometry is exact; of other scenes all do.
    """
    place = _about(_lower, scene, angle)
    for _ in range(derivatives if scene.system.exact else 1):  # each round carries one order more
        place = _lower(place, scene, angle)
    assert place is not None  # it was worked out at least once
    return place


def edges(scene: Scene, angle: Scalar | Pose) -> tuple[Scalar, Scalar]:
    """Both edges of the play [rad], of a scene with back flanks."""
    if scene.system.exact:
        return edge(scene, angle), _upper(_about(_upper, scene, angle), scene, angle)
    lower, upper = first_contact(scene.contacts(angle), scene.contact)
    assert upper is not None  # the caller requires back flanks
    return lower, upper


def rest(scene: Scene, angle: Scalar | Pose, torque: Scalar, *, derivatives: int = 1) -> Equilibrium:
    """Equilibrium under a load torque [N m] at an angle, with the mean stiffness, by the scene's contact law.

    Args:
        scene: with a compliance.
        angle: of the input [rad], or the pose there.
        torque: [N m].
        derivatives: up to which order they hold where geometry is exact; of other scenes the second ones do too.
    """
    if not scene.system.exact:
        return equilibrium(scene.contacts(angle, "mean"), -torque, scene.contact)
    frozen = jax.lax.stop_gradient((scene, angle, torque))

    def straight(_: Any, at: tuple[Scalar, Array]) -> tuple[Scalar, Array]:
        scene, angle, torque = frozen
        balanced = equilibrium(scene.contacts(angle, "mean", at[0]), -torque, scene.contact)
        return jnp.where(balanced.result == 0, balanced.position, at[0]), balanced.result

    start = jnp.zeros_like(scene.system.input_speed), jnp.zeros((), int)
    place, result = jax.lax.fori_loop(0, ROUNDS, straight, start)

    def moment(at: Scalar) -> tuple[Scalar, ContactSet]:
        contacts = scene.contacts(angle, "mean", at)
        forces = spring_forces(contacts, scene.contact)(contacts.lever * at - contacts.gap)
        return (contacts.lever * forces).sum(), contacts

    # more steps of Newton's method, along which the levers turn too, carry the derivatives, one order each
    position = place
    for _ in range(derivatives):
        total, slope, contacts = jax.jvp(moment, (position,), (jnp.ones_like(place),), has_aux=True)
        slope = jax.lax.stop_gradient(slope)
        lower, upper = first_contact(contacts, scene.contact)
        touching = lower if upper is None else jnp.where(torque < 0, upper, lower)
        position = jnp.where(slope > 0, position - (total + torque) / jnp.where(slope > 0, slope, 1.0), touching)
    forces = spring_forces(contacts, scene.contact)(contacts.lever * position - contacts.gap)
    good = result == 0
    return Equilibrium(jnp.where(good, position, jnp.nan), jnp.where(good, forces, 0.0), result)


def resistance(scene: Scene, angle: Scalar | Pose, torque: Scalar) -> tuple[Equilibrium, Scalar]:
    """Equilibrium under a load torque [N m] at an angle, and the tangent torsional stiffness there, ``dT / dq`` of the
    output against the load while the input is held [N m/rad]; nan where there is no equilibrium."""

    def position(load: Scalar) -> tuple[Scalar, Equilibrium]:
        balanced = rest(scene, angle, load, derivatives=2)
        return balanced.position, balanced

    _, way, balanced = jax.jvp(position, (torque,), (jnp.ones_like(torque),), has_aux=True)
    held = (balanced.result == 0) & (way < 0)
    return balanced, jnp.where(held, -1 / jnp.where(held, way, -1.0), jnp.nan)


def carriers(scene: Scene, angle: Scalar | Pose, torque: Scalar) -> Int[Array, ""]:
    """Number of pairs that could carry a load torque [N m] at an angle."""
    return scene.contacts(angle).carriers(-torque)


def clash(scene: Scene, angle: Scalar | Pose) -> Overlap:
    """Least overlap of the rigid bodies at an angle, of a scene with back flanks."""
    return least_overlap(scene.contacts(angle, position=_about(_deepest, scene, angle)))


Place = Scalar | None


def _lower(at: Place, scene: Scene, angle: Scalar | Pose) -> Scalar:
    return first_contact(scene.contacts(angle, position=at), scene.contact)[0]


def _upper(at: Place, scene: Scene, angle: Scalar | Pose) -> Scalar:
    upper = first_contact(scene.contacts(angle, position=at), scene.contact)[1]
    assert upper is not None  # the caller requires back flanks
    return upper


def _deepest(at: Place, scene: Scene, angle: Scalar | Pose) -> Scalar:
    return least_overlap(scene.contacts(angle, position=at)).position


def _about(position: Callable[..., Scalar], scene: Scene, *rest: Any) -> Place:
    """The position about which straight contacts give that position, ``None`` where they are straight anyway; it takes
    no part in derivatives."""
    if not scene.system.exact:
        return None
    frozen = jax.lax.stop_gradient((scene, *rest))
    start = jnp.zeros_like(scene.system.input_speed)
    return jax.lax.fori_loop(0, ROUNDS, lambda _, at: jnp.where(jnp.isfinite(at), position(at, *frozen), at), start)
