"""Static positions of the output: edges of its backlash, equilibrium under a torque, interference.

To first order, the overlaps at one input angle are linear in the position of the output. With exact geometry the gaps
are curved, so that they are linearised again at the position found. Two rounds are enough, because the error of a round
is about the square of the error before (0.3 um, 0.05 nm, nothing).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.contact import ContactSet, Equilibrium, Overlap, Pose, equilibrium, first_contact, least_overlap
from gearjax.contact.search import spring_forces
from gearjax.dependence import changes
from gearjax.scene import Scene
from gearjax.typing import Array, Float, Int, Scalar
from gearjax.units import deg, um

ROUNDS = 2
TOUCHING = 1e-12  # m, largest overlap of bodies that just touch


def tolerated(dtype: jnp.dtype) -> float:
    """Largest overlap that may be due to rounding, for machines of some metres [m]; 0.5 um in float32."""
    return max(TOUCHING, 4 * float(jnp.finfo(dtype).eps))


class Interference(eqx.Module):
    """Interference: overlap of rigid bodies that no position of the output avoids.

    Args:
        theta: input angles, shape (n,) [rad].
        overlap: overlap of the deepest contact, at the position of the output where it is least, shape (n,) [m]. The
            bodies must deflect by this amount to be assembled; it is negative if all contacts can be clear.
        contact: the contact with the shorter lever of the two that overlap most, or come closest to it, shape (n,).
        position: position of the output with that least overlap, shape (n,) [rad].
    """

    theta: Float[Array, " n"]
    overlap: Float[Array, " n"]
    contact: Int[Array, " n"]
    position: Float[Array, " n"]

    @property
    def interferes(self) -> Array:
        """Whether bodies overlap by more than rounding, shape (n,)."""
        return self.overlap > tolerated(self.overlap.dtype)

    @property
    def result(self) -> Int[Array, "... n"]:
        """0 no interference, 2 interference, shape (n,)."""
        return jnp.where(self.interferes, 2, 0)

    @property
    def worst(self) -> Int[Array, "..."]:
        """Index of the angle with the largest overlap."""
        return jnp.argmax(self.overlap, axis=-1)

    def told(self, scene: Scene) -> str | None:
        """Description of the largest overlap in words; ``None`` if there is no interference."""
        if not bool(self.interferes.any()):
            return None
        worst = int(self.worst)
        share, name = float(self.interferes.mean()), scene.system.contact_name(int(self.contact[worst]))
        return (
            f"interference: rigid bodies overlap at {100 * share:.3g} % of the angles, by up to "
            f"{float(self.overlap[worst]) / um:.3g} um ({name}, input angle {float(self.theta[worst]) / deg:.5g} deg): "
            "no position of the output avoids it, and no-load TE and backlash there are not meaningful"
        )

    def as_json(self, scene: Scene) -> dict[str, Any] | None:
        """The largest overlap as a JSON object; ``None`` if there is no interference."""
        if not bool(self.interferes.any()):
            return None
        worst = int(self.worst)
        return {
            "overlap_um": float(self.overlap[worst]) / um,
            "contact": scene.system.contact_name(int(self.contact[worst])),
            "input_angle_deg": float(self.theta[worst]) / deg,
            "share_of_angles": float(self.interferes.mean()),
        }


def edge(scene: Scene, angle: Scalar | Pose) -> Scalar:
    """Lower edge of the backlash at an angle: position of the output at which the first driving flank touches [rad]."""
    return _touching(_lower, scene, angle)


def edges(scene: Scene, angle: Scalar | Pose) -> tuple[Scalar, Scalar]:
    """Both edges of the backlash [rad], for a scene with back flanks."""
    if scene.system.exact:
        return edge(scene, angle), _touching(_upper, scene, angle)
    lower, upper = first_contact(scene.contacts(angle), scene.contact)
    assert upper is not None  # the caller requires back flanks
    return lower, upper


def _touching(position: Callable[..., Scalar], scene: Scene, angle: Scalar | Pose) -> Scalar:
    """Position of the output at which bodies touch, with all its derivatives [rad]."""
    place = position(_about(position, scene, angle), scene, angle)
    return _held((place, ()), (scene, angle), whole=_Touch(position))[0] if scene.system.exact else place


def rest(scene: Scene, angle: Scalar | Pose, torque: Scalar) -> Equilibrium:
    """Equilibrium under a load torque at an angle, with the mean stiffness and the scene's contact law.

    Args:
        scene: the scene, with a compliance.
        angle: input angle [rad], or the pose at that angle.
        torque: load torque [N m].
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

    # a Newton step in which the levers change too; it has right first derivatives
    given = scene, angle, torque
    (total, _, touching, contacts), (slope, *_) = _with_slopes(lambda at: _balance(at, given), place)
    slope = jax.lax.stop_gradient(slope)
    position = jnp.where(slope > 0, place - total / jnp.where(slope > 0, slope, 1.0), touching)
    forces = spring_forces(contacts, scene.contact)(contacts.lever * position - contacts.gap)
    position, (forces,) = _held((position, (forces,)), given, whole=_balance)
    good = result == 0
    return Equilibrium(jnp.where(good, position, jnp.nan), jnp.where(good, forces, 0.0), result)


def resistance(scene: Scene, angle: Scalar | Pose, torque: Scalar) -> tuple[Equilibrium, Scalar]:
    """Equilibrium under a load torque [N m] at an angle, and the tangent torsional stiffness [N m/rad].

    The tangent stiffness is ``dT / dq`` of the output while the input is held; nan if there is no equilibrium.
    """

    def position(load: Scalar) -> tuple[Scalar, Equilibrium]:
        balanced = rest(scene, angle, load)
        return balanced.position, balanced

    _, way, balanced = jax.jvp(position, (torque,), (jnp.ones_like(torque),), has_aux=True)
    held = (balanced.result == 0) & (way < 0)
    return balanced, jnp.where(held, -1 / jnp.where(held, way, -1.0), jnp.nan)


def carriers(scene: Scene, angle: Scalar | Pose, torque: Scalar) -> Int[Array, ""]:
    """Number of pairs that could carry a load torque [N m] at an angle."""
    layout = scene.layout
    return scene.contacts(angle).carriers(-torque) if layout.sides_turn else layout.carriers(-torque)


def clash(scene: Scene, angle: Scalar | Pose) -> Overlap:
    """Least overlap of the rigid bodies at an angle, for a scene with back flanks."""
    return least_overlap(scene.contacts(angle, position=_about(_deepest, scene, angle)))


# derivatives of positions in exact geometry, of any order ---------------------------------------------------------


def _with_slopes(function: Callable[[Scalar], tuple], at: Scalar) -> tuple[tuple, tuple]:
    """Values of a function of the position, and their slopes."""
    return jax.jvp(function, (at,), (jnp.ones_like(at),))


def _balance(at: Scalar, given: tuple) -> tuple[Scalar, tuple[Array], Scalar, ContactSet]:
    """Of a position: torque that is missing, forces, the position at which the loaded side touches, contacts there."""
    scene, angle, torque = given
    contacts = scene.contacts(angle, "mean", at)
    forces = spring_forces(contacts, scene.contact)(contacts.lever * at - contacts.gap)
    lower, upper = first_contact(contacts, scene.contact)
    touching = lower if upper is None else jnp.where(torque < 0, upper, lower)
    return (contacts.lever * forces).sum() + torque, (forces,), touching, contacts


class _Touch(eqx.Module):
    """Like `_balance` for bodies that touch, which carry no torque."""

    position: Callable[..., Scalar] = eqx.field(static=True)

    def __call__(self, at: Scalar, given: tuple) -> tuple[Scalar, tuple[()], Scalar, None]:
        return jnp.zeros_like(at), (), self.position(at, *given), None


@eqx.filter_custom_jvp
def _held(found: tuple[Scalar, tuple], given: Any, *, whole: Callable[..., tuple]) -> tuple[Scalar, tuple]:
    """A position and the results that depend on it, unchanged, with right derivatives of any order.

    The Newton step that ``found`` comes from has right first derivatives only. Here the implicit function theorem gives
    the change of the position. It is evaluated at the position with its own derivatives, so that it can be
    differentiated again.

    Args:
        found: the position, and the further results of ``whole`` there.
        given: what they depend on, a tree of arrays.
        whole: function of the position and of ``given``, with four results: what is zero at the position; the further
            results; where bodies touch, which is the position if nothing carries; and one that is not used here.
    """
    del given, whole
    return found


@_held.def_jvp
def _held_jvp(primals: tuple, tangents: tuple, *, whole: Callable[..., tuple]) -> tuple[Any, Any]:
    (found, given), (_, moves) = primals, tangents
    found = _held(found, given, whole=whole)
    _, (slope, by_position, _, _) = _with_slopes(lambda at: whole(at, given), found[0])
    _, (lacking, by_rest, touching, _) = changes(lambda given: whole(found[0], given), given, moves)
    change = jnp.where(slope > 0, -lacking / jnp.where(slope > 0, slope, 1.0), touching)
    return found, (change, jax.tree.map(lambda rest, own: rest + own * change, by_rest, by_position))


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
    """Position at which contacts linearised there give the same position; ``None`` if the contacts are linear anyway.

    It has no derivatives.
    """
    if not scene.system.exact:
        return None
    frozen = jax.lax.stop_gradient((scene, *rest))
    start = jnp.zeros_like(scene.system.input_speed)
    return jax.lax.fori_loop(0, ROUNDS, lambda _, at: jnp.where(jnp.isfinite(at), position(at, *frozen), at), start)
