"""Quasi-static analyses: transmission error without load and under a static torque, and backlash."""

import dataclasses
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.extremes import Extremes, extremes, extremes_of_samples
from gearjax.analysis.metrics import deviation, load_sharing, warn_of_few_angles
from gearjax.analysis.resting import Interference, carriers, clash, edge, edges, rest
from gearjax.batches import in_batches
from gearjax.checks import FewCandidates, ParameterError, SceneError, is_concrete, nearest
from gearjax.compliance import AbstractSliceCompliance, couples
from gearjax.contact import Equilibrium, Layout, Pose, Request
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Bool, Float, Int, Scalar
from gearjax.units import deg

EXTREMES = ("between", "samples")
MOST_NUMBERS = 2**21  # of the influence matrices of coupled contacts that are in memory at the same time


class TransmissionError(eqx.Module):
    """Transmission error over input angles: output position minus ideal position, positive when the output leads.

    In a batch (`jax.vmap`) every array has the axes of the batch first, and so have the metrics.

    Args:
        theta: input angles, shape (n,) [rad].
        te: transmission error, shape (n,) [rad].
        forces: contact force of each contact in the order of the layout, shape (n, contact) [N]; ``None`` without
            torque.
        result: 0 found, 1 no flank can carry the torque, 2 rigid bodies interfere (`interference`), 3 the search for
            the equilibrium did not converge, shape (n,).
        extremes: highest and lowest value over the span of theta, also between samples unless ``extremes="samples"``
            was asked for [rad].
        layout: sides and pairs of the contacts.
        fastest_order: order of the fastest rotation that the curve follows, in turns per turn of the input.
        carriers: number of pairs that could carry the torque, those with a flank on the loaded side, shape (n,);
            ``None`` without torque.
        interference: overlap of the rigid bodies, if each contact touches both flanks, or if the gear set knows its
            own clearance, whether or not back flanks are modelled. ``None`` otherwise, and under a torque if back
            flanks are modelled; `gearjax.interference` computes it for every scene.
        moved: displacements in the other coordinates, shape (n, coordinate) [m, rad]; ``None`` without torque, or if
            there are no other coordinates.
        coordinates: names of the coordinates: the output, then the others.
        crowded: whether an outermost candidate contact carries load, shape (n,); then teeth beside it, which are not
            modelled, would carry load too. ``None`` without torque, or if all teeth are candidates.
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
        """Displacement from the ideal motion in each coordinate, the output's first [rad, m]."""
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
            raise SceneError("loaded contacts need a torque: transmission_error(scene, theta, torque=...)")
        return (self.forces > 0).sum(axis=-1)

    @property
    def pair_forces(self) -> Float[Array, "... n pair"]:
        """Load of each pair, the sum of the forces of its contacts, shape (n, pair) [N].

        The pairs are in the order of ``layout.pair``. In an `InvoluteRV` these are the driving flanks of one external
        gear after the other, then the back flanks (`contact_name` of the system names a contact). In an `RVCycloidal`
        they are the pins of each disc, in a `TwoKV` the planet wheels with both flanks together.
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
        """Load of the most loaded pair over the mean load of the pairs that could carry, shape (n,) [-].

        The pairs that could carry have a flank on the loaded side. The value is 1 if they share the load evenly, and
        their number if one pair carries all.
        """
        if self.forces is None or self.carriers is None:
            raise SceneError("load sharing needs a torque: transmission_error(scene, theta, torque=...)")
        return load_sharing(self.layout, self.forces, self.carriers)


class Backlash(eqx.Module):
    """Backlash over input angles: travel of the output between the driving and the back flanks.

    Args:
        theta: input angles, shape (n,) [rad].
        lower: output position at which the first driving flank touches (the no-load TE), shape (n,) [rad].
        upper: output position at which the first back flank touches, shape (n,) [rad].
        extremes: largest and smallest backlash over the span of theta, also between samples [rad].
        interference: overlap of the rigid bodies.
        fastest_order: order of the fastest rotation that the curve follows, in turns per turn of the input.
    """

    theta: Float[Array, " n"]
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    extremes: Extremes
    interference: Interference
    fastest_order: float = eqx.field(static=True)

    @property
    def result(self) -> Int[Array, "... n"]:
        """0 no interference, 2 rigid bodies interfere, shape (n,)."""
        return self.interference.result

    @property
    def backlash(self) -> Float[Array, "... n"]:
        """Backlash, upper minus lower edge, shape (n,) [rad]; negative if both flanks are jammed."""
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

    Without torque the first contact to close decides: ``max_i(gap_i / J_i)`` over the driving flanks (Wang et al. 2020,
    eqs. 1-8). Under torque it is the exact equilibrium of the one-sided springs with their mean stiffness
    (eqs. 10-18).

    Args:
        scene: the scene; with ``torque`` it needs a compliance.
        theta: input angles, increasing, shape (n,) [rad].
        torque: load torque on the output, a number or shape (n,) [N m]; a positive torque loads the driving flanks.
        extremes: where to search for the highest and lowest value: ``"between"`` also between samples, ``"samples"``
            only at the samples, which is several times faster if bodies are on supports. By default between samples;
            for coupled springs and slices under torque at the samples, as their derivatives take long to compile.

    Returns:
        The error at each angle and its metrics [rad].

    Raises:
        SceneError: the scene lacks a part that the torque needs.
        ParameterError: ``extremes`` has another value.

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
        return _with_interference(scene, _transmission_error(scene.precomputed(), theta, None, extremes or "between"))
    require(scene, "static", "compliance")
    torque = torque_on(scene, theta, torque)
    places = extremes or ("samples" if each_is_dear(scene) else "between")
    te = _transmission_error(scene.precomputed("backlash", "compliance"), theta, torque, places)
    _warn_of_few_candidates(scene, te)
    return te if scene.has_back else _with_interference(scene, te)


def _with_interference(scene: Scene, te: TransmissionError) -> TransmissionError:
    """The result with the interference added, if the gear set knows its clearance; this is a separate program."""
    if not (scene.system.has_clearance and scene.has_clearance):
        return te
    found = _interference(scene.precomputed("backlash"), te.theta)
    return dataclasses.replace(te, interference=found, result=found.result if te.forces is None else te.result)


def each_is_dear(scene: Scene) -> bool:
    """Whether an equilibrium takes so long that by default extremes are searched only at the samples."""
    return isinstance(scene.compliance, AbstractSliceCompliance) or couples(scene.compliance)


def _most_at_once(scene: Scene) -> int:
    """Number of angles whose equilibria are searched side by side: their matrices fill only a part of the memory."""
    contacts = len(scene.layout.side)
    return max(1, MOST_NUMBERS // contacts**2) if couples(scene.compliance) else 2**31


def _warn_of_few_candidates(scene: Scene, te: TransmissionError) -> None:
    """Warn if outermost candidates carry load, so that teeth beside them, which are left out, would too.

    Inside a trace the forces are not known, and there is no warning.
    """
    if te.crowded is None or not is_concrete(te.crowded) or not bool(te.crowded.any()):
        return
    worst = int(np.argmax(np.asarray(te.crowded)))
    ends = scene.system.outermost(te.theta[worst], Request(scene.has_back))
    assert te.forces is not None
    assert ends is not None  # since some of them carry load
    name = scene.system.contact_name(int(jnp.argmax(jnp.where(ends, te.forces[worst], 0.0))))
    words = f"the outermost candidate contacts carry load at {100 * float(te.crowded.mean()):.3g} % of the angles"
    words = f"{words} ({name}, input angle {float(te.theta[worst]) / deg:.5g} deg): further teeth would too"
    warnings.warn(f"{words}, give more system.pairs", FewCandidates, stacklevel=4)


@arguments.checked()
def backlash(scene: Scene, theta: ArrayLike) -> Backlash:
    """Time-varying backlash, from the first driving flank to the first back flank (Wang et al. 2020, eqs. 7 and 9).

    Args:
        scene: the scene, with an initial backlash.
        theta: input angles, increasing, shape (n,) [rad].

    Raises:
        SceneError: the scene lists no backlash.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> play = gj.backlash(scene, jnp.linspace(0.0, scene.system.cycle, 1001))
        >>> bool((play.backlash > 0).all())
        True
    """
    require(scene, "backlash", "backlash")
    return _backlash(scene.precomputed("backlash"), angles_of(scene, theta))


@arguments.checked()
def interference(scene: Scene, theta: ArrayLike) -> Interference:
    """Least overlap of rigid bodies over all positions of the output, at each input angle.

    A positive overlap means jammed teeth, or pins for which a disc leaves no room. Elastic bodies must deflect by the
    overlap when they are assembled, and are then preloaded. Rigid bodies have no position free of overlap: no-load TE
    and backlash have ``result`` 2 at such angles.

    Args:
        scene: the scene, with back flanks, or with a gear set that knows its own clearance.
        theta: input angles, increasing, shape (n,) [rad].

    Raises:
        SceneError: the clearance between driving and back flanks is not known.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/rv_cycloidal/hu_2020.toml")
        >>> bool(gj.interference(scene, jnp.linspace(0.0, 6.2, 50)).interferes.any())
        False
    """
    if not scene.has_clearance:
        require(scene, "interference", "backlash")
    return _interference(scene.precomputed("backlash"), angles_of(scene, theta))


def angles_of(scene: Scene, theta: ArrayLike) -> Float[Array, " n"]:
    """Checked input angles of an analysis, shape (n,) [rad]."""
    theta = jnp.asarray(theta, dtype=scene.dtype)
    if theta.ndim != 1 or theta.shape[0] == 0:
        raise SceneError(f"theta has shape {theta.shape}: give input angles of shape (n,)")
    if is_concrete(theta) and not bool((np.diff(np.asarray(theta)) > 0).all()):
        raise SceneError("theta must increase")
    return theta


def torque_on(scene: Scene, theta: Float[Array, " n"], torque: ArrayLike) -> Array:
    """Checked load torque of an analysis, a number or shape (n,) [N m].

    Raises:
        SceneError: the shape of the torque does not match the angles, or it loads flanks that the scene lacks.
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
    """No-load TE at one input angle or pose [rad], the lower edge of the backlash."""
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

    def loaded(at: tuple[Scalar, ...]) -> tuple[Equilibrium, Array]:
        angle, load = at if torque.ndim else (*at, torque)
        return rest(scene, angle, load), carriers(scene, angle, load)

    rests, able = in_batches(loaded, (theta, torque) if torque.ndim else (theta,), _most_at_once(scene))
    if places == "between":
        peaks = extremes(_static_between, (scene, torque, theta), theta, rests.position)
    else:
        peaks = extremes_of_samples(theta, rests.position)
    record = rests.position, rests.forces, rests.result

    def crowd(angle: Scalar, forces: Array) -> Array | None:
        ends = scene.system.outermost(angle, Request(scene.has_back))
        return None if ends is None else (ends & (forces > 0)).any()

    crowded = jax.vmap(crowd)(theta, rests.forces)
    moved = rests.moved, scene.coordinates
    return TransmissionError(theta, *record, peaks, layout, fastest, able, None, *moved, crowded)


def _static_between(physics: tuple[Scene, Array, Array], angle: Scalar) -> Scalar:
    """Static TE at one angle [rad]; a torque over angles is interpolated between its samples."""
    scene, torque, theta = physics
    return static((scene, torque if torque.ndim == 0 else jnp.interp(angle, theta, torque)), angle)


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
