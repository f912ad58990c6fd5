"""Impact of teeth as they come into mesh, from the loaded teeth before (Guo and Fang 2018, eqs. 10 to 18)."""

import dataclasses
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax import arguments
from gearjax.analysis.resting import rest
from gearjax.batches import in_batches
from gearjax.checks import SceneError, with_article
from gearjax.contact import ContactSet, CoupledSprings
from gearjax.impact import AT_ONCE, MeshingImpact, Pulses, of_pair, pitch_of
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float, Int, Scalar

LOOKS, HALVES = 64, 30  # angles at which a pair is looked at as it comes into mesh, and halvings of the interval found


class MeshingImpacts(eqx.Module):
    """Impacts of successive pairs of teeth as they come into mesh.

    Args:
        theta: input angle at which each pair touches, shape (pair,) [rad].
        ahead: how far before the beginning of the path of contact each pair touches, along the line of action; negative
            if it touches on the path, shape (pair,) [m].
        velocity: speed v_s at which the flanks meet, along their normal, shape (pair,) [m/s].
        stiffness: stiffness K_s of each pair, along the normal, shape (pair,) [N/m].
        mass: equivalent mass m_e along the normal [kg].
        force: largest force F_s of each impact, shape (pair,) [N].
        duration: time t_s in which the speed becomes zero, shape (pair,) [s].
        pitch: input angle from one pair to the next [rad].
        result: 0 found; 1 the teeth touch before the search begins, or not until the middle of their path, or there is
            no equilibrium under the torque, shape (pair,). If it is not 0, place, speed and force are nan.
    """

    theta: Float[Array, " pair"]
    ahead: Float[Array, " pair"]
    velocity: Float[Array, " pair"]
    stiffness: Float[Array, " pair"]
    mass: Scalar
    force: Float[Array, " pair"]
    duration: Float[Array, " pair"]
    pitch: float = eqx.field(static=True)
    result: Int[Array, " pair"]

    @property
    def impulse(self) -> Float[Array, "..."]:
        """Impulse of each pulse, ``m_e v_s``, shape (pair,) [N s]."""
        return self.mass * self.velocity

    @property
    def pulses(self) -> Pulses:
        """The impacts as a force over the input angle: `Scene.impact`, also of a scene with one contact."""
        return Pulses(self.theta, self.force, self.duration, self.pitch)


@arguments.checked(torque=arguments.positive_torque, stiffness=arguments.one_positive)
def meshing_impact(scene: Scene, torque: ArrayLike, *, stiffness: ArrayLike | None = None) -> MeshingImpacts:
    """Impact of each pair of teeth of a helical or spur pair as it comes into mesh under a load torque.

    The teeth in mesh deflect under the load. The pair that follows therefore touches before the beginning of its path
    of contact, at the corner of a tip, or on the path while relieved flanks still approach each other. There the flanks
    meet with the speed v_s at which their gap closes if both gears turn evenly. With the equivalent mass m_e and the
    stiffness K_s of this pair,

        F_s = v_s sqrt(m_e K_s),   t_s = (pi / 2) m_e v_s / F_s = (pi / 2) sqrt(m_e / K_s)

    and the force is ``F_s sin(pi t / t_s)`` while ``0 <= t <= t_s``. Its impulse is m_e v_s, the momentum that
    becomes zero; rebound is not modelled. If teeth differ, or gears run out, every pair has an impact of its own.

    Args:
        scene: the scene of a helical pair with compliance and inertia. Contact at the corners of the tips counts, also
            if its ``tip_contact`` is ``"ends"``.
        torque: load torque on the wheel, positive [N m].
        stiffness: stiffness K_s of the pair that strikes [N/m]. By default that of `Scene.impact`, or else that of the
            pair's own springs if it touches across the whole face, more than a helical pair has at its first corner.

    Returns:
        The impacts, of one pair if all pairs are alike, otherwise of all pairs of a cycle. They are differentiable in
        all numbers of the scene and in the torque.

    Raises:
        SceneError: the scene is not of a pair of gears cut into slices, lacks compliance or inertia, or too many pairs
            of teeth differ.
        ParameterError: an argument is not allowed.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/helical/guo_2018_measured.toml")
        >>> impact = gj.meshing_impact(scene, 830.0, stiffness=5e8)
        >>> len(impact.force)
        893
    """
    require(scene, "meshing impact", "compliance")
    _require_meshing_in(scene)
    if scene.inertia is None:
        raise SceneError('"meshing impact" needs [inertia], which this scene does not list')
    impact = scene.impact if isinstance(scene.impact, MeshingImpact) else MeshingImpact()
    if stiffness is not None:
        impact = dataclasses.replace(impact, stiffness=jnp.asarray(stiffness, scene.dtype))
    whole = scene.precomputed("backlash", "compliance", "inertia")
    return _impacts(whole, jnp.asarray(torque, scene.dtype), impact.counted(scene))


def _require_meshing_in(scene: Scene) -> None:
    """Refuse a gear set whose teeth do not come into mesh at the beginning of a path of contact.

    Raises:
        SceneError: the gear set does not say how its teeth come into mesh.
    """
    if scene.system.meshing_in is None:
        raise SceneError(f'"meshing impact" is for a helical_pair, not for {with_article(scene.system.kind)}')


def pulses_of(scene: Scene, torque: Scalar) -> Pulses | None:
    """The impacts that a scene lists, as a force, under a load torque [N m]; ``None`` if it lists none."""
    if scene.impact is None or isinstance(scene.impact, Pulses):
        return scene.impact
    pulses = _impacts(scene, torque, scene.impact).pulses
    # without a load on the driving flanks nothing deflects, and the teeth come into mesh without an impact
    force, theta = (jnp.where(torque > 0, part, 0.0) for part in (pulses.force, pulses.theta))
    return dataclasses.replace(pulses, force=force, theta=theta)


@eqx.filter_jit
def _impacts(scene: Scene, torque: Scalar, impact: MeshingImpact) -> MeshingImpacts:
    impact = impact.counted(scene)
    assert impact.pairs is not None  # it is counted
    entering, pitch, stiffness = scene.system.meshing_in, pitch_of(scene), impact.stiffness
    assert entering is not None  # `_require_meshing_in` refuses the others
    scene = dataclasses.replace(scene, system=entering.system, impact=None)
    first = entering.begin.min()
    looks = jax.lax.stop_gradient(jnp.linspace(first - entering.early, first + entering.late, LOOKS))

    def overlaps(angle: Scalar) -> tuple[Array, ContactSet]:
        """Overlap of all contacts under the load [m], and the contacts."""
        balanced, contacts = rest(scene, angle, torque), scene.contacts(angle, "mean")
        moved = jnp.zeros(0, angle.dtype) if balanced.moved is None else balanced.moved
        place = jnp.concatenate([balanced.position[None], moved])
        return jnp.where(balanced.result == 0, contacts.jacobian @ place - contacts.gap, jnp.nan), contacts

    def of_one(pair: Scalar) -> tuple[Array, ...]:
        own = of_pair(scene, pair)
        angle, found = _first_touch(lambda angle: overlaps(angle)[0][own].max(), looks + pair * pitch)
        whole, contacts = overlaps(angle)
        found = found & jnp.isfinite(whole).all()
        touching = jnp.argmax(whole[own])
        place = own[touching]
        _, closing = jax.jvp(lambda at: scene.contacts(at).gap[place], (angle,), (jnp.ones_like(angle),))
        kept = _stiffness(contacts, own, whole.max()) if stiffness is None else stiffness
        ahead = (entering.begin[touching] + pair * pitch - angle) * entering.radius
        # gaps are what the wheel turns by, with the lever of the path: at a corner the normal has another one
        parts = angle, ahead, -scene.system.input_speed * closing * entering.leverage(ahead)
        return *(jnp.where(found, part, jnp.nan) for part in parts), kept, _mass(scene, contacts, place), found

    pairs = jnp.arange(impact.pairs).astype(scene.dtype)
    theta, ahead, velocity, kept, mass, found = in_batches(of_one, pairs, AT_ONCE)
    force, duration = velocity * jnp.sqrt(mass * kept), 0.5 * math.pi * jnp.sqrt(mass / kept)
    return MeshingImpacts(theta, ahead, velocity, kept, mass[0], force, duration, pitch, jnp.where(found, 0, 1))


def _first_touch(overlap: Callable[[Scalar], Scalar], looks: Float[Array, " look"]) -> tuple[Scalar, Array]:
    """Angle at which a pair of teeth first touches [rad], and whether it does so between the first and the last look.

    Where it does not, the angle is the first one. All looks and halvings share one evaluation of the program.
    """

    def search(overlap: Callable[[Scalar], Scalar], begin: Scalar) -> tuple[Scalar, Array]:
        def look(count: Array, ends: tuple[Scalar, Scalar, Array]) -> tuple[Scalar, Scalar, Array]:
            low, high, touched = ends
            looking = (count < LOOKS) & ~touched
            angle = jnp.where(looking, looks[jnp.minimum(count, LOOKS - 1)], 0.5 * (low + high))
            is_open = overlap(angle) <= 0
            halving = touched & (count >= LOOKS)
            moves = looking | halving
            return (
                jnp.where(moves & is_open, angle, low),
                jnp.where(moves & ~is_open, angle, high),
                touched | (looking & ~is_open),
            )

        low, high, touched = jax.lax.fori_loop(0, LOOKS + HALVES, look, (begin - 1.0, begin, jnp.asarray(False)))
        found = touched & (low >= begin)  # open at the first look
        return jnp.where(found, 0.5 * (low + high), begin), found.astype(begin.dtype)  # only numbers have derivatives

    def solve(linear: Callable[[Scalar], Scalar], right: Scalar) -> Scalar:
        return right / linear(jnp.ones_like(right))

    begin = looks[0]
    angle, found = jax.lax.custom_root(overlap, begin, search, solve, has_aux=True)
    return angle, found > 0.5


def _stiffness(contacts: ContactSet, own: Int[Array, " slice"], approach: Scalar) -> Scalar:
    """Tangent stiffness of one pair that is pressed evenly across the face [N/m].

    Args:
        contacts: all contacts.
        own: the contacts of the pair.
        approach: approach of the flanks, on which springs that are not linear depend [m].
    """
    if isinstance(contacts.springs, CoupledSprings):
        matrix = contacts.springs.influence[own][:, own]
        return jnp.linalg.solve(matrix, jnp.ones(len(own), matrix.dtype)).sum()
    assert contacts.springs is not None
    even = jnp.broadcast_to(approach, contacts.gap.shape)
    return jax.jvp(contacts.springs.force, (even,), (jnp.ones_like(even),))[1][own].sum()


def _mass(scene: Scene, contacts: ContactSet, place: Int[Array, ""]) -> Scalar:
    """Equivalent mass of all that turns about its own axis, along the normal of a contact [kg]."""
    assert scene.inertia is not None
    levers = contacts.jacobian[place]
    answer = levers[0] ** 2 / scene.inertia.moment(contacts.output_levers)
    for column, name in enumerate(scene.coordinates):
        body, _, way = name.partition(".")
        if way == "rz":
            polar = scene.body_inertia[body].polar if body in scene.body_inertia else None
            if polar is None:
                raise SceneError(f'"meshing impact" needs [inertia.{body}] with polar, which this scene does not list')
            answer = answer + levers[column] ** 2 / polar
    return 1 / answer
