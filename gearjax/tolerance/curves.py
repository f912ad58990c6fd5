"""Quasi-static curves of many gear sets over the same input angles, by a fast method.

A contact touches at the output position ``gap / lever``. As a function of the input angle, this position lies in a
space of few dimensions for all gear sets of a population, for example sums of a few harmonics. A pivoted QR
factorisation of sampled curves finds the input angles that determine a curve, and the weights that give the rest
(interpolative decomposition; Cheng, Gimbutas, Martinsson, Rokhlin 2005), exact to rounding for all kinds of errors.
Each gear set is then evaluated at these few angles only, and at three more to check whether it is like the examples. If
there are no such few angles, each gear set is evaluated at all angles. Where levers vary with the angle, so does the
stiffness of each contact on the output: its squared lever is one of these curves.

For extremes between the samples, the touching position of each contact is a polynomial of the angle around the best
samples, and the curve is computed again at closer angles.

Each contact is one array over the input angles, because this form vectorises.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.metrics import top
from gearjax.contact import HardContact, Pose
from gearjax.contact.equilibrium import hard_edges, hard_rest
from gearjax.scene import Scene, Stiffness
from gearjax.tolerance.refined import highest_between, in_search_order, stored
from gearjax.typing import Array, Float, Int, Scalar

CHECKS = 3  # angles at which every gear set is compared with the interpolation from the few angles
ACCURACY = 1e-12  # of the interpolation, relative to the largest deviation from the ideal position
FEW, MOST = 16, 0.1  # number and share of the angles, above both of which interpolation is not worthwhile
MOST_TERMS = 12  # of the polynomials, which are valid from the sample before to the sample after
FITS = 1e-6  # deviation of the polynomials, relative to the largest weight, below which more terms are not worthwhile
FAR_OFF = 1e-5  # the same, above which samples are too far apart for polynomials
FINE = 8  # steps between two samples to which the polynomials are fitted


class Curves(eqx.Module):
    """Data for curves that are common to all gear sets of a population.

    Args:
        poses: poses at the angles that determine a curve, or at all angles; if numbers of the system vary, poses are
            those of each gear set, and this is all the input angles [rad].
        weights: weights that give all angles, in the order of `in_search_order`, from these, shape (n, angle); ``None``
            if all angles are evaluated.
        checks: weights of the angles that are checked, shape (check, angle).
        allowed: largest deviation of a gear set from the interpolation at these angles [rad].
        series: the weights near each sample as polynomials of the place, which counts in spacings of samples, shape
            (n, term, angle).
        side: side of each contact, 1 for driving flanks and -1 for back flanks.
        stiffness: ``"rigid"``, or ``"mean"`` for curves under torque.
        levers_vary: whether levers vary with the angle, and with them the stiffness on the output.
    """

    poses: Pose | Float[Array, " n"]
    weights: Float[Array, "n angle"] | None
    checks: Float[Array, "check angle"] | None
    allowed: float = eqx.field(static=True)
    series: Float[Array, "n term angle"] | None
    side: tuple[int, ...] = eqx.field(static=True)
    stiffness: Stiffness = eqx.field(static=True)
    levers_vary: bool = eqx.field(static=True)

    @classmethod
    def of(cls, examples: Scene, theta: Float[Array, " n"], stiffness: Stiffness, fixed_system: bool) -> "Curves":
        """The common data, from examples of the population.

        Args:
            examples: scenes of gear sets, every number with a leading axis; one half checks the result of the other.
            theta: input angles, shape (n,) [rad].
            stiffness: ``"mean"`` for curves under torque.
            fixed_system: whether no number of the system varies.
        """
        # through numpy: JAX would compile a program for each shape
        first = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[0]), examples)
        side = first.layout.side

        def everywhere() -> Curves:
            return cls(_poses(first, theta) if fixed_system else theta, None, None, 0.0, None, side, stiffness, True)

        if not fixed_system or not isinstance(first.contact, HardContact) or len(theta) < 3:
            return everywhere()
        between = np.interp(np.arange(FINE * (len(theta) - 1) + 1) / FINE, np.arange(len(theta)), np.asarray(theta))
        accuracy = max(ACCURACY, 16 * float(np.finfo(theta.dtype).eps))
        touch, lever = _sampled(examples, _poses(first, jnp.asarray(between, theta.dtype)))
        curves, squared = np.asarray(touch, dtype=float), np.asarray(lever, dtype=float) ** 2
        largest, levers_vary = float(np.abs(curves).max()), bool(np.ptp(np.asarray(lever), axis=1).any())
        if levers_vary:
            curves = np.concatenate([curves, squared * (largest / squared.max())], axis=2)
        samples = curves[:, ::FINE]
        chosen = _chosen(samples, accuracy)
        if chosen is None:
            return everywhere()
        weights, fine = _weights(samples, chosen, accuracy), _weights(curves, FINE * chosen, accuracy)
        if weights is None or fine is None:
            return everywhere()
        series = _series(fine, len(theta))
        if series is None:
            return everywhere()
        weights, series = jnp.asarray(weights, theta.dtype), jnp.asarray(series, theta.dtype)
        besides = np.linspace(0, len(theta) - 1, CHECKS + 2).round().astype(int)[1:-1]
        poses = _poses(first, jnp.asarray(np.asarray(theta)[np.concatenate([chosen, besides])]))
        checks, weights = weights[besides], weights[in_search_order(len(theta))]
        allowed = 100 * accuracy * largest
        return cls(poses, weights, checks, allowed, series, side, stiffness, levers_vary)

    def touches(self, scene: Scene) -> "Touches":
        """The positions at which the contacts of one gear set touch, at all angles."""
        touch, strength = self._looked_at(scene)
        columns = [touch[:, i] for i in range(touch.shape[1])]
        if self.weights is None:
            strengths = None if strength is None else [strength[:, i] for i in range(touch.shape[1])]
            return Touches(columns, strengths, self.side)
        assert self.checks is not None
        number = self.weights.shape[1]
        strengths, each = None, None
        if strength is not None and self.levers_vary:
            each = [strength[:number, i] for i in range(touch.shape[1])]
            strengths = [_weighted(self.weights, column) for column in each]
        elif strength is not None:
            strengths = [strength[0, i] for i in range(touch.shape[1])]
        besides = [column[number:] - _weighted(self.checks, column[:number]) for column in columns]
        alike = (jnp.abs(jnp.stack(besides)) <= self.allowed).all()
        columns = [column[:number] for column in columns]
        spread = [_weighted(self.weights, column) for column in columns]
        closer = None if self.series is None else (self.series, columns, each)
        return Touches(spread, strengths, self.side, closer, alike)

    def curve(self, scene: Scene, analysis: str, torque: float | None) -> Float[Array, " n"]:
        """The curve of an analysis of one gear set, at the samples [rad]."""
        curve = self.touches(scene).curve(analysis, None if torque is None else jnp.asarray(torque, scene.dtype))
        return curve if self.weights is None else curve[np.argsort(in_search_order(len(curve)))]

    def _looked_at(self, scene: Scene) -> tuple[Array, Array | None]:
        anchored = scene.anchored()

        def at(pose: Pose | Scalar) -> tuple[Array, Array | None]:
            contacts = anchored.contacts(pose, self.stiffness)
            lever, stiffness = contacts.lever, contacts.linear
            return contacts.gap / lever, None if stiffness is None else stiffness * lever * lever

        return jax.vmap(at)(self.poses)  # (angle, contact)


def _weighted(weights: Float[Array, "n angle"], column: Float[Array, " angle"]) -> Float[Array, " n"]:
    """A curve from its values at a few angles; the sum is written out, so that XLA fuses it with its uses."""
    return functools.reduce(jnp.add, [row * column[j] for j, row in enumerate(weights.T)])


class Touches(eqx.Module):
    """The positions at which the contacts of a gear set touch, over input angles, one array for each contact.

    Args:
        position: position of the output at which each contact touches, shape (n,) or (place, group) each [rad].
        strength: stiffness of each contact on the output, shape (n,) or () each [N m/rad].
        side: side of each contact, 1 for driving flanks and -1 for back flanks.
        closer: weights near each sample as polynomials, and each contact's positions at the angles that they weight,
            and its stiffness on the output there if it varies; ``None`` without interpolation.
        alike: whether the gear set is like the examples, so that its curves are right; ``None`` if all angles were
            evaluated.
    """

    position: Sequence[Float[Array, "..."]]
    strength: Sequence[Array] | None
    side: tuple[int, ...] = eqx.field(static=True)
    closer: tuple[Array, Sequence[Array], Sequence[Array] | None] | None = None
    alike: Array | None = None

    def near(self, samples: Int[Array, " m"], places: Float[Array, "k #m"]) -> "Touches":
        """The touching positions near some samples, at places in spacings of samples, shape (k, m)."""
        assert self.closer is not None
        series, columns, strengths = self.closer
        # a matrix product, because XLA would fuse elementwise sums with their uses and compute them for every place
        terms = jnp.einsum("mta,ca->tcm", series[samples], jnp.stack([*columns, *(strengths or [])]))[:, :, None]
        spread = functools.reduce(lambda sum_, term: sum_ * places[None] + term, terms[::-1])
        position, varying = list(spread[: len(columns)]), list(spread[len(columns) :])
        return Touches(position, self.strength if strengths is None else varying, self.side)

    def ends(
        self, analysis: str, torque: Scalar | None, curve: Float[Array, " n"], signs: Sequence[float]
    ) -> Sequence[Scalar]:
        """Highest value of a curve times each sign, also between the samples if polynomials are known [rad]."""
        if self.closer is None:
            return [top(curve if sign > 0 else -curve) for sign in signs]
        sign = jnp.asarray(signs, curve.dtype)
        curve = stored(curve)

        def near(numbers: tuple[Touches, Scalar | None], samples: Array, places: Array) -> Array:
            touches, torque = numbers
            return touches.near(samples, places).curve(analysis, torque)

        alone = dataclasses.replace(self, position=[], alike=None)
        if self.closer[2] is not None:
            alone = dataclasses.replace(alone, strength=[])
        return [*jax.vmap(lambda sign: highest_between(near, (alone, torque), curve, sign))(sign)]

    def curve(self, analysis: str, torque: Scalar | None) -> Float[Array, "..."]:
        """The curve of an analysis, of the shape of the positions [rad]."""
        if torque is not None:
            return self.static(torque)
        return self.no_load() if analysis == "no_load" else self.backlash()

    def no_load(self) -> Float[Array, "..."]:
        """No-load TE [rad]."""
        return hard_edges(self.position, self.side)[0]

    def backlash(self) -> Float[Array, "..."]:
        """Backlash [rad]."""
        lower, upper = hard_edges(self.position, self.side)
        assert upper is not None  # the measure requires a backlash
        return upper - lower

    def static(self, torque: Scalar) -> Float[Array, "..."]:
        """Static TE [rad] under a torque [N m]; nan if no flank can carry the torque."""
        assert self.strength is not None  # the measure requires a compliance
        return hard_rest(self.position, self.strength, self.side, -torque)


@eqx.filter_jit
def _poses(scene: Scene, theta: Float[Array, " n"]) -> Pose:
    return jax.vmap(scene.pose)(theta)


@eqx.filter_jit
def _sampled(scenes: Scene, poses: Pose) -> tuple[Array, Array]:
    def one(scene: Scene) -> tuple[Array, Array]:
        anchored = scene.anchored()

        def at(pose: Pose) -> tuple[Array, Array]:
            contacts = anchored.contacts(pose)
            return contacts.gap / contacts.lever, contacts.lever

        return jax.vmap(at)(poses)

    return jax.vmap(one)(scenes)


def _chosen(touch: np.ndarray, accuracy: float) -> np.ndarray | None:
    """The angles that determine a curve, shape (angle,); ``None`` if there are too many.

    Args:
        touch: curves of examples, shape (example, n, contact).
        accuracy: accuracy of the interpolation, relative to the largest value.
    """
    from scipy import linalg

    curves = touch.transpose(0, 2, 1)[: len(touch) // 2].reshape(-1, touch.shape[1])
    decomposition: Any = linalg.qr(curves, mode="economic", pivoting=True)
    _, factor, order = decomposition
    sizes = np.abs(np.diag(factor))
    rank = max(1, int((sizes > 0.1 * accuracy * sizes[0]).sum()))
    return None if rank > max(FEW, MOST * touch.shape[1]) or rank >= min(curves.shape) else order[:rank]


def _weights(touch: np.ndarray, chosen: np.ndarray, accuracy: float) -> np.ndarray | None:
    """Weights of the values at the chosen angles, shape (n, angle), from the first half of the examples.

    ``None`` if they do not reproduce the second half.
    """
    from scipy import linalg

    curves, half = touch.transpose(0, 2, 1), len(touch) // 2
    first, fresh = (part.reshape(-1, touch.shape[1]) for part in (curves[:half], curves[half:]))
    solved: Any = linalg.lstsq(first[:, chosen], first)
    weights = solved[0].T
    missed = np.abs(fresh - fresh[:, chosen] @ weights.T).max()
    return weights if missed <= accuracy * max(np.abs(curves).max(), 1e-300) else None


def _series(fine: np.ndarray, number: int) -> np.ndarray | None:
    """Polynomials of the weights near each sample, shape (number, term, angle), with as many terms as they need.

    ``None`` if samples are too far apart for them. The first and the last sample have the polynomials of their
    neighbours, and are not asked for (`highest_between`).
    """
    steps = np.arange(-FINE, FINE + 1) / FINE
    centres = np.clip(np.arange(number), 1, number - 2)
    rows = fine[FINE * centres[:, None] + np.arange(-FINE, FINE + 1)]  # (number, step, angle)
    allowed = FITS * np.abs(fine).max()
    for terms in range(1, MOST_TERMS + 1):
        powers = np.vander(steps, terms, increasing=True)
        fitted = np.linalg.pinv(powers) @ rows  # (number, term, angle)
        off = np.abs(powers @ fitted - rows).max()
        if off <= allowed:
            break
    return fitted if off <= FAR_OFF / FITS * allowed else None
