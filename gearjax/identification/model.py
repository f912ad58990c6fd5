"""Recordings as a least-squares problem: the model that suits a scene, and the sums of the problem."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gearjax.contact import HardContact
from gearjax.identification.measurement import Measurement
from gearjax.identification.rows import Rows
from gearjax.identification.tables import AbstractCurves, Plain, Tables, looked, positions_at, sums, tabulated
from gearjax.identification.unknowns import Unknowns, turned
from gearjax.scene import Scene, Stiffness
from gearjax.typing import Array
from gearjax.units import arcmin

KEPT = 4  # curves that a problem keeps: a search that goes on begins where it ended
LEAST_POINTS = 64  # room in the program of the sums of several points; a search starts from so many by default
FEW = 6  # contacts, up to which their balance is written as one expression
LOOKS = 7  # rows at which the linearity of the gaps is tested
TRIED = 3  # points that are compared at these rows
# slots that act in motion only; a model at rest keeps those with unknowns too
MOVING = ("load", "inertia", "damping", "impact")
STRAIGHT = 1e-6  # of the largest change of a gap or stiffness: deviation up to which the model counts as linear


class Normal(NamedTuple):
    """Sums of a least-squares problem at several points.

    Args:
        cost: weighted sum of squares, shape (point,) [arcmin^2].
        matrix: ``J^T W J``, shape (point, number, number).
        slope: ``J^T W r``, shape (point, number).
    """

    cost: np.ndarray
    matrix: np.ndarray
    slope: np.ndarray


@dataclasses.dataclass(frozen=True)
class Model:
    """Recordings of a gear set as a function of the unknowns.

    Args:
        unknowns: unknowns of the scene.
        scene: the parts of the scene that the model depends on.
        loaded: whether a torque deflects the teeth.
        straight: whether gaps are linear in the unknowns, so that tables of influence suffice (`Tables`).
        turns: for each recording, the matrix by which turned bodies change the components.
        opens: 1 where an unknown changes a gap, else 0, shape (unknown, contact); ``None`` if derivatives are not
            computed contact by contact.
        groups: groups of unknowns of which no two change the same gap.
    """

    unknowns: Unknowns
    scene: Scene
    loaded: bool
    straight: bool
    turns: np.ndarray
    opens: Array | None = None
    groups: tuple[tuple[int, ...], ...] = ()

    @classmethod
    def of(cls, unknowns: Unknowns, records: Sequence[Measurement], *, loaded: bool) -> "Model":
        """The model of some recordings; the fast one (`Tables`) if the scene allows it."""
        scene = dataclasses.replace(unknowns.scene, contact=HardContact(), run=None)
        slots = ["backlash", *(["compliance", "supports"] if loaded else [])]
        slots += [slot for slot in MOVING if any(each.path.startswith(f"{slot}.") for each in unknowns.each)]
        scene = scene.physics(*slots)
        model = cls(unknowns, scene, loaded, False, _turns(unknowns, records))
        if model._is_straight(records):
            return dataclasses.replace(model, straight=True)
        return model._patterned(records) if model._is_apart else model

    def beside(self, records: Sequence[Measurement]) -> "Model":
        """The same model for other recordings."""
        return dataclasses.replace(self, turns=_turns(self.unknowns, records))

    @property
    def _is_apart(self) -> bool:
        """Whether only the output moves, and its contacts are uncoupled linear springs or rigid."""
        return (self.scene.springs_apart if self.loaded else self.scene.output_alone) and not self.scene.is_train

    def _patterned(self, records: Sequence[Measurement]) -> "Model":
        """The same model with ``opens`` and ``groups``: which unknown changes which gap."""
        few, start = self._few(records), self.unknowns.start
        _, rate, _, _ = tabulated(self.unknowns.each, self.scene, self._way, few, jnp.asarray(start))
        opened = np.abs(np.asarray(rate)).max(axis=0).T  # (unknown, contact)
        opens = opened > 1e-9 * opened.max(initial=0.0)
        opens[self.unknowns.reciprocals] = True  # a stiffness changes no gap, but it may change every spring
        plain = np.array([unknown.path.startswith("errors.") for unknown in self.unknowns.each])
        opens[~plain] = True
        for along, across in self.unknowns.vectors.values():  # turning a body in its seat mixes both components
            opens[[along, across]] = opens[along] | opens[across]
        groups: list[list[int]] = []
        for number in range(len(opens)):
            own = next((g for g in groups if not (opens[g].any(axis=0) & opens[number]).any()), None)
            if own is None:
                groups.append([number])
            else:
                own.append(number)
        return dataclasses.replace(self, opens=jnp.asarray(1.0 * opens), groups=tuple(map(tuple, groups)))

    def _few(self, records: Sequence[Measurement]) -> Array:
        """Some input angles of the recordings."""
        theta = np.concatenate([record.theta for record in records])
        shares = np.modf(np.arange(1, LOOKS + 1) * (np.sqrt(5) - 1) / 2)[0]  # uneven: no wave is zero at all of them
        return jnp.asarray(theta[(shares * theta.size).astype(int)])

    @property
    def _way(self) -> Stiffness:
        return "mean" if self.loaded else "rigid"

    def _is_straight(self, records: Sequence[Measurement]) -> bool:
        """Whether gaps are linear in the unknowns, levers are constant and all springs share one reciprocal."""
        each, start = self.unknowns.each, self.unknowns.start
        soft = self.unknowns.reciprocals
        if self.scene.system.exact or not self._is_apart or soft.sum() > 1:
            return False
        few = self._few(records)
        rng = np.random.default_rng(0)
        steps = np.array([10.0 if unknown.kind == "component" else 1.0 for unknown in each])
        points = start + steps * rng.standard_normal((TRIED, start.size))
        points[:, soft] = rng.uniform(0.7, 1.4, (TRIED, int(soft.sum())))
        gap, lever, stiffness = (
            np.asarray(part)
            for part in looked(each, self.scene, self._way, few, jnp.asarray(np.concatenate([start[None], points])))
        )
        nominal, rate, _, _ = (
            np.asarray(part) for part in tabulated(each, self.scene, self._way, few, jnp.asarray(start))
        )
        expected = nominal + np.einsum("ncu,su->snc", rate, points - start)
        share = points[:, soft].reshape(TRIED, -1)
        relaxed = stiffness[1:] * (share[:, :1, None] if soft.any() else 1.0)
        return (
            _close(gap[1:], expected, np.abs(gap[1:] - gap[0]).max())
            and _close(lever[1:], lever[:1], np.abs(lever).max())
            and _close(relaxed, stiffness[:1] * (start[soft][0] if soft.any() else 1.0), np.abs(stiffness).max())
        )

    def at(self, rows: Rows) -> AbstractCurves:
        """The model at rows."""
        loaded, touching = bool(np.any(rows.torque != 0)), bool(np.any(rows.torque == 0))
        each, theta = self.unknowns.each, jnp.asarray(rows.theta)
        if not self.straight:
            return Plain(
                self.scene, theta, jnp.asarray(rows.torque), jnp.asarray(rows.back), jnp.asarray(self.turns),
                jnp.asarray(rows.record), self.opens, each, self.groups, loaded, touching,
            )  # fmt: skip
        start = self.unknowns.start
        nominal, rate, lever, stiffness = tabulated(each, self.scene, self._way, theta, jnp.asarray(start))
        soft = self.unknowns.reciprocals
        root = jnp.sqrt(stiffness * (start[soft][0] if soft.any() else 1.0))
        influence = jnp.einsum("ncu,nuv->vcn", rate, jnp.asarray(self.turns)[jnp.asarray(rows.record)])
        nominal = nominal - rate @ jnp.asarray(start)
        levers = np.asarray(lever)
        few = levers.shape[1] <= FEW and bool(((levers > 0).all(axis=0) | (levers < 0).all(axis=0)).all())
        side = tuple(-1 if arm > 0 else 1 for arm in levers[0]) if few else ()
        return Tables(
            (lever * root).T, (nominal * root).T, influence * root.T[None], jnp.asarray(rows.torque),
            jnp.asarray(rows.back), side, int(np.argmax(soft)) if soft.any() else None, loaded, touching,
        )  # fmt: skip


def _turns(unknowns: Unknowns, records: Sequence[Measurement]) -> np.ndarray:
    """For each recording, the matrix by which turned bodies change the components."""
    return np.stack([turned(unknowns, record.turned) for record in records])


def _close(one: np.ndarray, other: np.ndarray, size: float) -> bool:
    return bool(np.all(np.abs(one - other) <= STRAIGHT * max(size, 1e-30)))


class Problem:
    """A least-squares problem: a model, and the rows that it is compared with.

    Args:
        model: the model of the recordings.
        rows: the rows that the model is compared with.
    """

    def __init__(self, model: Model, rows: Rows):
        self.rows = rows
        self.padded = rows.padded()
        self.model = model.at(self.padded)
        self._curves: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self._te, self._basis = jnp.asarray(self.padded.te), jnp.asarray(self.padded.basis)

    def normal(self, values: np.ndarray, weight: np.ndarray) -> Normal:
        """Sums at several points; ``values`` has shape (point, number)."""
        if not isinstance(self.model, Tables):  # uses the program of `curve`, as another one takes seconds to compile
            return Normal(*(np.stack(parts) for parts in zip(*(self._summed(v, weight) for v in values), strict=True)))
        points, room = len(values), max(LEAST_POINTS, 1 << (len(values) - 1).bit_length())
        weights = np.concatenate([weight, np.zeros(self.padded.theta.size - weight.size)])
        whole = np.concatenate([values, np.zeros((room - points, values.shape[1]))])
        given, number = jnp.asarray(whole), jnp.asarray(points)
        parts = sums(self.model, given, number, self._te, jnp.asarray(weights), self._basis)
        return Normal(*(np.asarray(part)[:points] for part in parts))

    def _summed(self, values: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Sums at one point."""
        curve, jacobian = self.curve(values)
        residual = self.rows.te - curve
        pulled = weight[:, None] * jacobian
        return float((weight * residual**2).sum()), pulled.T @ jacobian, pulled.T @ residual

    def curve(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The model's curve [arcmin] and its derivatives at one point, shape (n,) and (n, number)."""
        point = values.tobytes()
        if point not in self._curves:
            self._curves = dict(list(self._curves.items())[1 - KEPT :]) | {point: self._computed(values)}
        return self._curves[point]

    def _computed(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, size = self.rows, values.size - self.rows.basis.shape[1]
        q, rate = (
            np.asarray(part)[0, : rows.theta.size]
            for part in positions_at(self.model, jnp.asarray(values[None, :size]))
        )
        curve = q / arcmin + rows.basis @ values[size:]
        return curve, np.concatenate([rate / arcmin, rows.basis], axis=1)
