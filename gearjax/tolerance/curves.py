"""Quasi-static curves of many gear sets over the same input angles, quickly.

Where a contact touches, ``gap / lever`` as a function of the input angle, lies in a space of few dimensions for all
gear sets of a population: sums of a few harmonics, for example. A pivoted QR factorisation of sampled curves finds the
input angles that determine a curve and the weights that give the rest (interpolative decomposition; Cheng,
Gimbutas, Martinsson, Rokhlin 2005), exact to rounding, whatever the kinds of errors. Each gear set is then looked at
in full at these few angles alone, and at three more that tell whether it is like the examples. Where there are no such
few angles, or levers vary, it is looked at at all of them.

Extremes between the samples: around the best samples each contact is a polynomial of the angle, and the curve is worked
out again, closer.

Contacts are written out as one array each, over the input angles, which is what vectorises.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.metrics import top
from gearjax.contact import HardContact, Pose
from gearjax.contact.equilibrium import hard_edges, hard_rest
from gearjax.scene import Scene, Stiffness
from gearjax.typing import Array, Float, Int, Scalar

CHECKS = 3  # angles at which every gear set is compared with what the few angles say
ACCURACY = 1e-12  # of the interpolation, relative to the largest deviation from the ideal position
MOST = 0.1  # share of the angles above which interpolation is not worth it
GROUPS = 32  # of the samples; of each, the highest one is looked at closely
TERMS = 6  # of the polynomials that hold from one sample before to one after
FINE = 8  # steps between two samples that they are fitted to
OFFSETS = np.linspace(-1.0, 1.0, 49)  # places near a sample that are looked at, in spacings


class Curves(eqx.Module):
    """What all gear sets of a population share.

    Args:
        poses: at the angles that determine a curve, or at all angles.
        weights: of these in all angles, shape (n, angle); ``None`` where all angles are looked at.
        checks: of the angles that are looked at besides, shape (check, angle).
        allowed: how far a gear set may be off there [rad].
        series: the same as polynomials of the place near each sample in spacings, shape (n, term, angle).
        side: of each contact, 1 for driving flanks and -1 for back flanks.
        stiffness: ``"rigid"``, or ``"mean"`` where torques are looked at.
    """

    poses: Pose
    weights: Float[Array, "n angle"] | None
    checks: Float[Array, "check angle"] | None
    allowed: float = eqx.field(static=True)
    series: Float[Array, "n term angle"] | None
    side: tuple[int, ...] = eqx.field(static=True)
    stiffness: Stiffness = eqx.field(static=True)

    @classmethod
    def of(cls, examples: Scene, theta: Float[Array, " n"], stiffness: Stiffness, fixed_system: bool) -> "Curves":
        """From examples of the population.

        Args:
            examples: scenes of gear sets, every number with a leading axis; half of them check what the others gave.
            theta: input angles, shape (n,) [rad].
            stiffness: ``"mean"`` to look at torques.
            fixed_system: whether no number of the system varies.
        """
        first = jax.tree.map(lambda leaf: leaf[0], examples)
        side = first.layout.side
        everywhere = cls(_poses(first, theta), None, None, 0.0, None, side, stiffness)
        if not fixed_system or not isinstance(first.contact, HardContact) or len(theta) < 3:
            return everywhere
        between = np.interp(np.arange(FINE * (len(theta) - 1) + 1) / FINE, np.arange(len(theta)), np.asarray(theta))
        chosen: np.ndarray | None = None
        weights = fine = np.empty(0)
        accuracy, largest = max(ACCURACY, 16 * float(np.finfo(theta.dtype).eps)), 0.0
        for part in (np.asarray(theta), between):
            touch, lever = _sampled(examples, _poses(first, jnp.asarray(part, theta.dtype)))
            if np.ptp(np.asarray(lever), axis=1).any():
                return everywhere
            curves = np.asarray(touch, dtype=float)
            largest = max(largest, float(np.abs(curves).max()))
            if chosen is None:
                chosen = _chosen(curves, accuracy)
                if chosen is None:
                    return everywhere
                weights = _weights(curves, chosen, accuracy)
            else:
                fine = _weights(curves, FINE * chosen, accuracy)
        if weights is None or fine is None or chosen is None:
            return everywhere
        weights, series = (jnp.asarray(part, theta.dtype) for part in (weights, _series(fine, len(theta))))
        besides = np.linspace(0, len(theta) - 1, CHECKS + 2).round().astype(int)[1:-1]
        poses = _poses(first, theta[np.concatenate([chosen, besides])])
        allowed = 100 * accuracy * largest
        return cls(poses, weights, weights[besides], allowed, series, side, stiffness)

    def touches(self, scene: Scene) -> "Touches":
        """Where the contacts of one gear set touch, in all angles."""
        touch, strength = self._looked_at(scene)
        columns = [touch[:, i] for i in range(touch.shape[1])]
        if self.weights is None:
            strengths = None if strength is None else [strength[:, i] for i in range(touch.shape[1])]
            return Touches(columns, strengths, self.side)
        assert self.checks is not None
        number = self.weights.shape[1]
        strengths = None if strength is None else [strength[0, i] for i in range(touch.shape[1])]
        besides = [column[number:] - _weighted(self.checks, column[:number]) for column in columns]
        alike = (jnp.abs(jnp.stack(besides)) <= self.allowed).all()
        columns = [column[:number] for column in columns]
        spread = [_weighted(self.weights, column) for column in columns]
        return Touches(spread, strengths, self.side, None if self.series is None else (self.series, columns), alike)

    def curve(self, scene: Scene, analysis: str, torque: float | None) -> Float[Array, " n"]:
        """The curve of an analysis of one gear set, at the samples [rad]."""
        return self.touches(scene).curve(analysis, torque)

    def _looked_at(self, scene: Scene) -> tuple[Array, Array | None]:
        anchored = scene.anchored()

        def at(pose: Pose) -> tuple[Array, Array | None]:
            contacts = anchored.contacts(pose, self.stiffness)
            lever, stiffness = contacts.lever, contacts.linear
            return contacts.gap / lever, None if stiffness is None else stiffness * lever * lever

        return jax.vmap(at)(self.poses)  # (angle, contact)


def _weighted(weights: Float[Array, "n angle"], column: Float[Array, " angle"]) -> Float[Array, " n"]:
    """A curve from its values at a few angles; written out, so that it fuses with what uses it."""
    return functools.reduce(jnp.add, [row * column[j] for j, row in enumerate(weights.T)])


class Touches(eqx.Module):
    """Where the contacts of a gear set touch, over input angles, one array for each contact.

    Args:
        position: position of the output at which each contact touches, shape (n,) each [rad].
        strength: stiffness on the output, shape (n,) or () each [N m/rad].
        side: of each contact, 1 for driving flanks and -1 for back flanks.
        closer: weights of closer angles, and what they weigh for each contact; ``None`` where there are none.
        alike: whether the gear set is like the examples, so that its curves are right; ``None`` where all is seen.
    """

    position: Sequence[Float[Array, " n"]]
    strength: Sequence[Array] | None
    side: tuple[int, ...] = eqx.field(static=True)
    closer: tuple[Array, Sequence[Array]] | None = None
    alike: Array | None = None

    def near(self, samples: Int[Array, " m"]) -> "Touches":
        """The same close to some samples, at `OFFSETS` from each."""
        assert self.closer is not None
        series, columns = self.closer
        # products of matrices: elementwise sums would be fused with what uses them, and worked out for every place
        terms = jnp.einsum("mta,ca->cmt", series[samples], jnp.stack(columns))
        powers = jnp.asarray(np.vander(OFFSETS, TERMS, increasing=True).T, series.dtype)
        spread = jnp.matmul(terms, powers).reshape(len(columns), -1)
        return Touches(list(spread), self.strength, self.side)

    def highest(self, curve: Callable[["Touches"], Float[Array, " n"]], values: Float[Array, " n"]) -> Scalar:
        """Highest value of a curve, between its samples too where polynomials are known.

        Args:
            curve: the curve of these or of closer places.
            values: the curve of these samples, shape (n,).
        """
        if self.closer is None:
            return top(values)
        size = -(-values.shape[0] // GROUPS)
        filled = jnp.concatenate([values, jnp.full((GROUPS * size - values.shape[0],), -jnp.inf, values.dtype)])
        places = jnp.argmax(jax.lax.stop_gradient(filled).reshape(GROUPS, size), axis=1)
        samples = jnp.minimum(jnp.arange(GROUPS) * size + places, values.shape[0] - 1)
        return top(curve(self.near(samples)))

    def curve(self, analysis: str, torque: float | None) -> Float[Array, " n"]:
        """The curve of an analysis, shape (n,) [rad]."""
        if torque is not None:
            return self.static(jnp.asarray(torque, self.position[0].dtype))
        return self.no_load() if analysis == "no_load" else self.backlash()

    def no_load(self) -> Float[Array, " n"]:
        """No-load TE, shape (n,) [rad]."""
        return hard_edges(self.position, self.side)[0]

    def backlash(self) -> Float[Array, " n"]:
        """Backlash, shape (n,) [rad]."""
        lower, upper = hard_edges(self.position, self.side)
        assert upper is not None  # the measure requires a backlash
        return upper - lower

    def static(self, torque: Scalar) -> Float[Array, " n"]:
        """Static TE under a torque [N m], shape (n,) [rad]; nan where no flank can carry it."""
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
    """The angles that determine a curve, shape (angle,); ``None`` where they are too many.

    Args:
        touch: curves of examples, shape (example, n, contact).
        accuracy: relative to the largest value.
    """
    from scipy import linalg

    curves = touch.transpose(0, 2, 1)[: len(touch) // 2].reshape(-1, touch.shape[1])
    decomposition: Any = linalg.qr(curves, mode="economic", pivoting=True)
    _, factor, order = decomposition
    sizes = np.abs(np.diag(factor))
    rank = max(1, int((sizes > 0.1 * accuracy * sizes[0]).sum()))
    return None if rank > max(4, MOST * touch.shape[1]) or rank >= min(curves.shape) else order[:rank]


def _weights(touch: np.ndarray, chosen: np.ndarray, accuracy: float) -> np.ndarray | None:
    """Weights of the values at the chosen angles, shape (n, angle), from the first half of the examples; ``None`` where
    the second half does not follow them."""
    from scipy import linalg

    curves, half = touch.transpose(0, 2, 1), len(touch) // 2
    first, fresh = (part.reshape(-1, touch.shape[1]) for part in (curves[:half], curves[half:]))
    solved: Any = linalg.lstsq(first[:, chosen], first)
    weights = solved[0].T
    missed = np.abs(fresh - fresh[:, chosen] @ weights.T).max()
    return weights if missed <= accuracy * max(np.abs(curves).max(), 1e-300) else None


def _series(fine: np.ndarray, number: int) -> np.ndarray:
    """Polynomials of the weights near each sample, shape (number, term, angle); beside the ends, of the next sample,
    moved."""
    steps = np.arange(-FINE, FINE + 1) / FINE
    centres = np.clip(np.arange(number), 1, number - 2)
    rows = fine[FINE * centres[:, None] + np.arange(-FINE, FINE + 1)]  # (number, step, angle)
    moved = np.arange(number) - centres
    coefficients = np.empty((number, TERMS, fine.shape[1]))
    for move in (-1, 0, 1):
        fit = np.linalg.pinv(np.vander(steps - move, TERMS, increasing=True))
        coefficients[moved == move] = np.einsum("ts,nsa->nta", fit, rows[moved == move])
    return coefficients
