"""Quasi-static analyses: transmission error without load and under a static torque, and backlash."""

import dataclasses
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.metrics import (
    Extremes,
    deviation,
    extremes,
    extremes_of_samples,
    load_sharing,
    warn_of_few_angles,
)
from gearjax.analysis.resting import Interference, carriers, clash, edge, edges, rest
from gearjax.checks import FewCandidates, ParameterError, SceneError, is_concrete, nearest
from gearjax.compliance import AbstractSliceCompliance, couples
from gearjax.contact import Equilibrium, Layout, Pose, Request
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Bool, Float, Int, Scalar
from gearjax.units import deg

EXTREMES = ("between", "samples")


class TransmissionError(eqx.Module):
    """Transmission error over input angles: output position minus ideal position, positive when the output leads.

    Of a batch (`jax.vmap`) every array has the batch's axes in front, and so have the metrics.

    Args:
        theta: input angles, shape (n,) [rad].
        te: transmission error, shape (n,) [rad].
        forces: compression of each contact in the order of the layout, shape (n, contact) [N]; ``None`` without torque.
        result: 0 found, 1 no flank can carry the torque, 2 rigid bodies interfere (`interference`), 3 the search for
            the equilibrium did not end, shape (n,).
        extremes: highest and lowest value over the span of theta, between samples too unless told otherwise [rad].
        layout: sides and pairs of the contacts.
        fastest_order: turns of what the curve follows fastest per turn of the input.
        carriers: number of pairs that could carry the torque, those with a flank on the loaded side, shape (n,);
            ``None`` without torque.
        interference: of rigid bodies, where each contact touches both flanks or the gear set knows the room between
            them, back flanks modelled or not. ``None`` under a torque that modelled back flanks carry in spite of it
            (`gearjax.interference` tells it for every scene).
        moved: displacements in the other coordinates, shape (n, coordinate) [m, rad]; ``None`` without any, or torque.
        coordinates: names of what moves: the output, then those displacements.
        crowded: whether a candidate carries beside which others are left out, shape (n,): more would carry. ``None``
            where all teeth are candidates, or without torque.
    """

    theta: Float[Array, " n"]
    te: Float[Array, " n"]
    forces: Float[Array, "n contact"] | None
    result: Int[Array, " n"]
    extremes: Extremes
    layout: Layout = eqx.field(static=True)
    fastest_order: float = eqx.field(static=True)
    carriers: Int[Array, " n"] | None = None
    interference: Interference | None = None
    moved: Float[Array, "n coordinate"] | None = None
    coordinates: tuple[str, ...] = eqx.field(static=True, default=("output",))
    crowded: Bool[Array, " n"] | None = None

    @property
    def q(self) -> Float[Array, "... n coordinate"]:
        """Displacements from the ideal motion in each of the coordinates, the output's first [rad, m]."""
        te = self.te[..., None]
        return te if self.moved is None else jnp.concatenate([te, self.moved], axis=-1)

    @property
    def peak_to_peak(self) -> Float[Array, "..."]:
        """Highest minus lowest [rad]."""
        warn_of_few_angles(self.theta, self.fastest_order)
        return self.extremes.maximum - self.extremes.minimum

    @property
    def amplitude(self) -> Float[Array, "..."]:
        """Largest absolute value [rad]."""
        warn_of_few_angles(self.theta, self.fastest_order)
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
    def pair_forces(self) -> Float[Array, "... n pair"]:
        """Load of each pair, the forces of its contacts added, shape (n, pair) [N].

        Pairs stand in the order of ``layout.pair``: of an `InvoluteRV` those of the driving flanks, of each external
        gear after the other, then those of the back ones (`contact_name` of the system tells a contact's); of an
        `RVCycloidal` the pins of each disc; of a `TwoKV` the planet wheels, both flanks together.
        """
        if self.forces is None:
            raise SceneError("loads of pairs need a torque: transmission_error(scene, theta, torque=...)")
        return self.layout.per_pair(self.forces)

    @property
    def engaged_pairs(self) -> Int[Array, "... n"]:
        """Number of pairs that carry force, shape (n,)."""
        return (self.pair_forces > 0).sum(axis=-1)

    @property
    def load_sharing(self) -> Float[Array, "... n"]:
        """Load of the most loaded pair over the mean load of those that could carry, which have a flank on the loaded
        side, shape (n,) [-]: 1 where they share evenly, their number where one carries all."""
        if self.forces is None or self.carriers is None:
            raise SceneError("load sharing needs a torque: transmission_error(scene, theta, torque=...)")
        return load_sharing(self.layout, self.forces, self.carriers)


class Backlash(eqx.Module):
    """Backlash over input angles: travel of the output between its driving and its back flanks.

    Args:
        theta: input angles, shape (n,) [rad].
        lower: output position at which the first driving flank touches (the no-load TE), shape (n,) [rad].
        upper: output position at which the first back flank touches, shape (n,) [rad].
        extremes: largest and smallest backlash over the span of theta, between samples too [rad].
        interference: of rigid bodies.
        fastest_order: turns of what the curve follows fastest per turn of the input.
    """

    theta: Float[Array, " n"]
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    extremes: Extremes
    interference: Interference
    fastest_order: float = eqx.field(static=True)

    @property
    def result(self) -> Int[Array, "... n"]:
        """0 clear, 2 rigid bodies interfere, shape (n,)."""
        return self.interference.result

    @property
    def backlash(self) -> Float[Array, "... n"]:
        """Upper minus lower edge, shape (n,) [rad]; negative where both flanks are jammed."""
        return self.upper - self.lower

    @property
    def range(self) -> Float[Array, "..."]:
        """Largest minus smallest backlash [rad]."""
        warn_of_few_angles(self.theta, self.fastest_order)
        return self.extremes.maximum - self.extremes.minimum

    peak_to_peak = range

    @property
    def amplitude(self) -> Float[Array, "..."]:
        """Largest absolute value [rad]."""
        warn_of_few_angles(self.theta, self.fastest_order)
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
def transmission_error(
    scene: Scene, theta: ArrayLike, torque: ArrayLike | None = None, *, extremes: str | None = None
) -> TransmissionError:
    """Transmission error without load, or under a static torque.

    Without torque it is the first contact to close, ``max_i(gap_i / J_i)`` over the driving flanks
    (Wang et al. 2020, eqs. 1-8). Under torque it is the exact equilibrium of the one-sided springs with their mean
    stiffness (eqs. 10-18).

    Args:
        scene: the scene; with ``torque`` it needs a compliance.
        theta: input angles, increasing, shape (n,) [rad].
        torque: load torque on the output, a number or shape (n,) [N m]; positive loads the driving flanks.
        extremes: where the highest and lowest value are looked for: ``"between"`` the samples too, or at the
            ``"samples"`` alone, which is several times quicker where bodies give way. Without, between them, but under
            torque at the samples where a matrix couples the springs: their derivatives take long to compile.

    Returns:
        The error at each angle and its metrics [rad].

    Raises:
        SceneError: the scene lacks what the torque needs.
        ParameterError: extremes are looked for at no such places.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> te = gj.transmission_error(scene, jnp.linspace(0.0, 3 * scene.system.input_speed, 3001))
        >>> round(float(te.peak_to_peak / gj.units.arcmin), 3)
        2.246
    """
    theta = angles_of(scene, theta)
    if extremes is not None and extremes not in EXTREMES:
        raise ParameterError("extremes", extremes, nearest(extremes, EXTREMES))
    if torque is None:
        return _with_interference(scene, _transmission_error(scene.physics(), theta, None, extremes or "between"))
    require(scene, "static", "compliance")
    torque = torque_on(scene, theta, torque)
    places = extremes or ("samples" if _each_is_dear(scene) else "between")
    te = _transmission_error(scene.physics("backlash", "compliance"), theta, torque, places)
    _warn_of_few_candidates(scene, te)
    return te if scene.has_back else _with_interference(scene, te)


def _with_interference(scene: Scene, te: TransmissionError) -> TransmissionError:
    """The same with what both flanks of a gear set that knows the room between them tell, by a program of its own."""
    if not (scene.system.has_clearance and scene.has_clearance):
        return te
    found = _interference(scene.physics("backlash"), te.theta)
    return dataclasses.replace(te, interference=found, result=found.result if te.forces is None else te.result)


def _each_is_dear(scene: Scene) -> bool:
    """Whether each equilibrium, or what it is of, takes so long that extremes are looked for at the angles alone."""
    return isinstance(scene.compliance, AbstractSliceCompliance) or couples(scene.compliance)


def _warn_of_few_candidates(scene: Scene, te: TransmissionError) -> None:
    """Warn where candidates carry that others are left out beside; inside a trace nothing is known."""
    if te.crowded is None or not is_concrete(te.crowded) or not bool(te.crowded.any()):
        return
    worst = int(np.argmax(np.asarray(te.crowded)))
    ends = scene.system.outermost(te.theta[worst], Request(scene.has_back))
    assert te.forces is not None
    assert ends is not None  # some of them carry
    name = scene.system.contact_name(int(jnp.argmax(jnp.where(ends, te.forces[worst], 0.0))))
    words = f"the outermost candidates carry load at {100 * float(te.crowded.mean()):.3g} % of the angles"
    words = f"{words} ({name}, input angle {float(te.theta[worst]) / deg:.5g} deg): teeth beside them would too"
    warnings.warn(f"{words}, give more system.pairs", FewCandidates, stacklevel=4)


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


@arguments.checked()
def interference(scene: Scene, theta: ArrayLike) -> Interference:
    """How far rigid bodies overlap at each input angle wherever the output is: jammed teeth, pins that a disc cannot
    clear.

    Elastic bodies give way by that much when they are assembled, and are under preload. Without load there is no
    position that is free of it: the no-load TE and the backlash have ``result`` 2 there.

    Args:
        scene: the scene, with back flanks or a gear set that knows the room between its own.
        theta: input angles, increasing, shape (n,) [rad].

    Raises:
        SceneError: the room between both flanks is not known.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> bool(gj.interference(scene, jnp.linspace(0.0, 6.2, 50)).interferes.any())
        False
    """
    if not scene.has_clearance:
        require(scene, "interference", "backlash")
    return _interference(scene.physics("backlash"), angles_of(scene, theta))


def angles_of(scene: Scene, theta: ArrayLike) -> Float[Array, " n"]:
    """Input angles of an analysis, checked, shape (n,) [rad]."""
    theta = jnp.asarray(theta, dtype=scene.dtype)
    if theta.ndim != 1 or theta.shape[0] == 0:
        raise SceneError(f"theta has shape {theta.shape}: give input angles of shape (n,)")
    if is_concrete(theta) and not bool((np.diff(np.asarray(theta)) > 0).all()):
        raise SceneError("theta must increase")
    return theta


def torque_on(scene: Scene, theta: Float[Array, " n"], torque: ArrayLike) -> Array:
    """Load torque of an analysis, checked, a number or shape (n,) [N m].

    Raises:
        SceneError: its shape suits no angles, or it loads flanks that the scene lacks.
    """
    torque = jnp.asarray(torque, dtype=theta.dtype)
    if torque.ndim and torque.shape != theta.shape:
        raise SceneError(f"torque has shape {torque.shape}: give one number, or one per theta {theta.shape}")
    if is_concrete(torque) and (np.asarray(torque) < 0).any() and not scene.has_back:
        raise SceneError(
            f"torque = {float(torque.min()):g} N*m loads the back flanks, which this scene lacks: list a [backlash]"
        )
    return torque


def no_load(scene: Scene, angle: Scalar | Pose) -> Scalar:
    """No-load TE at one input angle or pose [rad]: the lower edge of the play."""
    return edge(scene, angle)


def static(physics: tuple[Scene, Scalar], angle: Scalar | Pose) -> Scalar:
    """Static TE of a scene under a torque [N m] at one angle [rad]."""
    scene, torque = physics
    return rest(scene, angle, torque).position


def play(scene: Scene, angle: Scalar | Pose) -> Scalar:
    """Backlash at one angle [rad]."""
    lower, upper = edges(scene, angle)
    return upper - lower


@eqx.filter_jit
def _transmission_error(scene: Scene, theta: Array, torque: Array | None, places: str = "between") -> TransmissionError:
    scene = scene.anchored()
    layout, fastest = scene.layout, scene.system.fastest_order
    if torque is None:
        te = jax.vmap(no_load, in_axes=(None, 0))(scene, theta)
        peaks = extremes(no_load, scene, theta, te) if places == "between" else extremes_of_samples(theta, te)
        overlap = _clash(scene, theta) if scene.has_back else None
        result = jnp.zeros(theta.shape, int) if overlap is None else overlap.result
        return TransmissionError(theta, te, None, result, peaks, layout, fastest, None, overlap)

    def at(angle: Scalar, torque: Array) -> Scalar:
        """Torque at an angle, between its samples too."""
        return torque if torque.ndim == 0 else jnp.interp(angle, theta, torque)

    def under(physics: tuple[Scene, Array], angle: Scalar) -> Scalar:
        scene, torque = physics
        return static((scene, at(angle, torque)), angle)

    def loaded(angle: Scalar, torque: Scalar) -> tuple[Equilibrium, Array]:
        return rest(scene, angle, torque), carriers(scene, angle, torque)

    rests, able = jax.vmap(loaded, (0, 0 if torque.ndim else None))(theta, torque)
    if places == "between":
        peaks = extremes(under, (scene, torque), theta, rests.position)
    else:
        peaks = extremes_of_samples(theta, rests.position)
    record = rests.position, rests.forces, rests.result

    def crowd(angle: Scalar, forces: Array) -> Array | None:
        ends = scene.system.outermost(angle, Request(scene.has_back))
        return None if ends is None else (ends & (forces > 0)).any()

    crowded = jax.vmap(crowd)(theta, rests.forces)
    moved = rests.moved, scene.coordinates
    return TransmissionError(theta, *record, peaks, layout, fastest, able, None, *moved, crowded)


@eqx.filter_jit
def _backlash(scene: Scene, theta: Array) -> Backlash:
    scene = scene.anchored()

    lower, upper = jax.vmap(edges, in_axes=(None, 0))(scene, theta)
    peaks, overlap = extremes(play, scene, theta, upper - lower), _clash(scene, theta)
    return Backlash(theta, lower, upper, peaks, overlap, scene.system.fastest_order)


@eqx.filter_jit
def _interference(scene: Scene, theta: Array) -> Interference:
    return _clash(scene.both_flanks.anchored(), theta)


def _clash(scene: Scene, theta: Array) -> Interference:
    overlap = jax.vmap(lambda angle: clash(scene, angle))(theta)
    return Interference(theta, overlap.overlap, overlap.contact, overlap.position)
