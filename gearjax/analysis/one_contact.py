"""Reduction of a gear set to one contact by its loaded analysis, for motion of gear sets with coupled springs."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.meshing_impact import pulses_of
from gearjax.analysis.resting import resistance
from gearjax.checks import ParameterError, SceneError, is_concrete, with_article
from gearjax.clearance import InitialBacklash
from gearjax.compliance.wave_stiffness import WaveStiffness
from gearjax.geometry.waves import Waves
from gearjax.parameters import Named
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.systems.one_contact import OneContact
from gearjax.typing import Array, ArrayLike, Float, Scalar

AFTER = 2  # angles after a period, at which the TE is compared
REPEATS = 1e-6  # share of the mean lag by which the static TE may differ after a period


class Reduction(eqx.Module):
    """A gear set reduced to one contact at one torque.

    Args:
        scene: scene with the one contact, for `gearjax.simulate` and the other analyses of motion.
        whole: scene that was reduced.
        torque: load torque of the reduction [N m].
        theta: input angles of one period at which the whole scene was analysed, shape (n,) [rad].
    """

    scene: Scene
    whole: Scene
    torque: Scalar
    theta: Float[Array, " n"]

    def static(self, torque: ArrayLike) -> Float[Array, " n"]:
        """Static TE of the one contact under a positive torque [N m], shape (n,) [rad].

        It uses the stiffness at each angle, not the mean stiffness.
        """
        system, compliance = self.scene.system, self.scene.compliance
        assert isinstance(system, OneContact)
        assert isinstance(compliance, WaveStiffness)
        phase = system.orders["mesh"] * self.theta
        torque = jnp.asarray(torque, self.theta.dtype)
        pressed = torque / (system.lever * compliance.stiffness(phase))
        return -(system.gaps[0].at(phase) + pressed) / system.lever

    def error(self, torque: ArrayLike) -> Scalar:
        """Largest difference of the static TE from that of the whole scene, under a positive torque [N m] [rad].

        At the torque of the reduction it is the effect of the harmonics that are left out; at other torques also that
        of another number of contacts.
        """
        torque = jnp.asarray(torque, self.theta.dtype)
        return jnp.abs(self.static(torque) - _rest(self.whole, _with_end(self.theta), torque)[0][:-AFTER]).max()


@arguments.checked()
def one_contact(
    scene: Scene,
    torque: ArrayLike,
    *,
    period: float | None = None,
    samples: int = 128,
    harmonics: int = 16,
) -> Reduction:
    """Reduce a scene to one contact in place of all, by its loaded analysis at one torque.

    The stiffness of the contact is the tangent stiffness of the whole scene at each angle, ``k = (dT/dq) / r^2``. Its
    gap is ``gap = -r q - T / (r k)``, so that it has the same position under the torque. The reduction describes motion
    under torques near this one, also for scenes with coupled springs, which `gearjax.simulate` refuses.

    It neglects contacts that open or close with the torque (`Reduction.error` gives the error at other torques), and
    the masses of bodies on supports, which move without delay. [damping] counts as many pairs as carry on average, and
    the pulses of [impact] are those at this torque. If [backlash] is listed, the back flank has the position under the
    reversed torque and the stiffness of the driving flank. Static analyses of the reduced scene use the mean stiffness,
    as for every gear set; `Reduction.static` uses the stiffness at each angle.

    Args:
        scene: the scene, with a compliance.
        torque: load torque about which the scene moves, positive [N m].
        period: input angle after which the static TE repeats [rad]; by default one mesh period, right without errors.
        samples: number of input angles per period at which the scene is analysed.
        harmonics: number of harmonics of the period that stiffness and gap keep; less than half of ``samples``.

    Returns:
        The reduction. It is differentiable in the numbers of the scene and in the torque.

    Raises:
        SceneError: the scene lacks a compliance, its output turns unevenly, there is no equilibrium under the torque,
            or the TE does not repeat.
        ParameterError: the torque is not positive, or there are too few samples.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> reduced = gj.one_contact(scene, 100.0, period=scene.system.cycle, samples=2048, harmonics=256)
        >>> reduced.scene.system.kind
        'one_contact'
    """
    require(scene, "one contact", "compliance")
    system = scene.system
    if not system.turns_evenly:
        words = f"that of {with_article(system.kind)} does not"
        raise SceneError(f'"one contact" needs an output that turns evenly; {words}')
    mesh = 2 * math.pi / system.orders["mesh"]
    period = mesh if period is None else float(period)
    _check(scene, torque, period, mesh, samples, harmonics)
    torque = jnp.asarray(torque, scene.dtype)
    theta = jnp.asarray(period / samples * np.arange(samples), scene.dtype)
    whole = scene.physics("backlash", "compliance")
    place, stiffness, pairs, result = _rest(whole, _with_end(theta), torque)
    if is_concrete(result):
        _check_rest(whole, place, result, torque, period)
    place, stiffness, pairs = (each[:-AFTER] for each in (place, stiffness, pairs))
    lever = jnp.abs(whole.contacts(theta[0]).output_levers).mean()
    waves = Waves.of(stiffness / lever**2, harmonics)
    compliance = WaveStiffness(waves)
    phase = jnp.asarray(2 * np.pi / samples * np.arange(samples), scene.dtype)
    pressed = torque / (lever * waves.at(phase))
    gaps = [-lever * place - pressed]
    if whole.has_back:
        gaps.append(lever * _rest(whole, _with_end(theta), -torque)[0][:-AFTER] - pressed)
    names = tuple((name, order) for name, order in system.orders.items() if name not in ("mesh", "waves"))
    reduced = OneContact(
        jnp.asarray(system.input_speed), lever, tuple(Waves.of(gap, harmonics) for gap in gaps), period, names
    )
    parts = {name: getattr(scene, name) for name in ("load", "contact", "inertia", "run")}
    if scene.impact is not None:
        parts["impact"] = pulses_of(scene.precomputed(*MODELLED), torque)
    if whole.has_back:
        parts["backlash"] = InitialBacklash(jnp.zeros((), scene.dtype))
    if scene.damping is not None:  # the ratio is that of one pair, whose stiffness is a part of the whole
        each = dataclasses.replace(scene.damping, ratio=scene.damping.ratio * jnp.sqrt(pairs.mean()))
        parts["damping"] = each
    return Reduction(Scene(reduced, compliance=compliance, **parts), whole, torque, theta)


def _with_end(theta: Float[Array, " n"]) -> Float[Array, " m"]:
    """Angles of a period, its end and the middle of the next one; all callers then share one program.

    The last two show whether the TE repeats: a slow wave may happen to have the same value at both ends of a period.
    """
    end = theta[-1] + theta[1]
    return jnp.concatenate([theta, jnp.stack([end, end + theta[theta.size // 2]])])


@eqx.filter_jit
def _rest(scene: Scene, theta: Array, torque: Scalar) -> tuple[Array, Array, Array, Array]:
    """Positions, tangent stiffness [N m/rad], numbers of pairs that carry, and result codes, shape (n,) each."""
    scene = scene.anchored()
    members = [np.asarray(own) for own in scene.layout.members]

    def at(angle: Scalar) -> tuple[Array, Array, Array, Array]:
        rest, stiffness = resistance(scene, angle, torque)
        carrying = jnp.stack([(rest.forces[own] > 0).any() for own in members])
        return rest.position, stiffness, carrying.sum().astype(theta.dtype), rest.result

    return jax.vmap(at)(theta)


def _check(scene: Scene, torque: ArrayLike, period: float, mesh: float, samples: int, harmonics: int) -> None:
    if is_concrete(torque) and not (np.ndim(torque) == 0 and float(np.asarray(torque)) > 0):
        raise ParameterError("torque", np.asarray(torque).tolist(), "must be one positive number [N m]")
    if not 0 < period < math.inf:
        raise ParameterError("period", period, "must be a positive input angle [rad]")
    if harmonics < 1:
        raise ParameterError("harmonics", harmonics, "must be at least 1")
    if samples <= 2 * harmonics:
        raise ParameterError("samples", samples, f"must be more than twice the {harmonics} harmonics")
    frequency = getattr(scene.load, "frequency", None)
    if isinstance(frequency, Named) and frequency.name == "mesh" and not math.isclose(period, mesh):
        raise SceneError('one contact: a load at the frequency "mesh" needs a period of one mesh: give frequency in Hz')


def _check_rest(scene: Scene, place: Array, result: Array, torque: Scalar, period: float) -> None:
    if (np.asarray(result) != 0).any():
        raise SceneError(f"one contact: there is no equilibrium under {float(torque):g} N*m at some angles")
    middle = (place.size - AFTER) // 2
    off, lag = float(jnp.abs(place[-AFTER:] - place[np.array([0, middle])]).max()), abs(float(place.mean()))
    if off > max(REPEATS, 100 * float(jnp.finfo(place.dtype).eps)) * lag:
        words = f"the static TE differs by {off:.2g} rad after a period of {period:g} rad"
        raise SceneError(f"one contact: {words}: errors repeat after scene.system.cycle = {scene.system.cycle:.6g} rad")
