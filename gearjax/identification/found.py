"""What recordings tell of a gear set: numbers with their errors, what is hidden, what else would fit."""

import dataclasses
import math
from typing import Any

import numpy as np

from gearjax.checks import ParameterError, nearest
from gearjax.identification.advice import Suggestion
from gearjax.identification.fit import Fit
from gearjax.identification.measurement import Measurement
from gearjax.identification.model import Model
from gearjax.identification.orders import Order
from gearjax.identification.unknowns import Unknowns
from gearjax.identification.visible import Visible, hidden_in_words, strongest_correlations
from gearjax.scene import Scene
from gearjax.units import arcmin

Z = 1.959964  # standard errors to either side of an interval of 95 %
LOOSELY = 0.3  # of its value, that a hidden number is held to by
SOFTEST = 0.05  # of a reciprocal, that is drawn
OUTLYING = 0.99  # weight below which a row counts as lying off


@dataclasses.dataclass(frozen=True)
class IdentifiedNumber:
    """A number found.

    Args:
        name: such as ``errors.planet_1.cos``.
        value: in its unit.
        error: standard error, ``None`` where the recordings do not tell the number.
        unit: of both.
    """

    name: str
    value: float
    error: float | None
    unit: str

    @property
    def interval(self) -> tuple[float, float] | None:
        """Of 95 %, ``None`` where the recordings do not tell the number."""
        return None if self.error is None else (self.value - Z * self.error, self.value + Z * self.error)


@dataclasses.dataclass(frozen=True, eq=False)
class Identification:
    """What recordings tell of a gear set.

    Args:
        scene: with the numbers found: the nearest to none where the recordings leave a choice.
        records: the recordings.
        unknowns: what was looked for.
        fit: the end of the fit.
        visible: what it tells and hides.
        orders: waves that the gear set does not explain, found and set free; those asked for are among the names.
        names: of all numbers: the scene's, offsets, free orders.
        notes: what a reader should know.
        suggestions: recordings that would show more.
    """

    scene: Scene
    records: tuple[Measurement, ...]
    unknowns: Unknowns
    model: Model
    fit: Fit
    visible: Visible
    orders: tuple[Order, ...]
    names: tuple[str, ...]
    notes: tuple[str, ...]
    suggestions: tuple[Suggestion, ...]

    @property
    def sigma(self) -> float:
        """Standard deviation of what is left, per row [rad]."""
        return self.fit.sigma * arcmin

    @property
    def vectors(self) -> list[str]:
        """Errors that were looked for as vectors: bodies that may be turned in their seats."""
        return list(self.unknowns.vectors)

    @property
    def is_hidden(self) -> np.ndarray:
        """Numbers of the scene that the recordings do not tell, shape (unknown,)."""
        return self.visible.is_hidden(len(self.unknowns.each))

    @property
    def estimates(self) -> tuple[IdentifiedNumber, ...]:
        """The numbers of the scene, then offsets and free orders [arcmin]."""
        size = len(self.unknowns.each)
        deviation = np.sqrt(np.maximum(np.diag(self.visible.covariance), 0.0))
        values = self.unknowns.shown(self.fit.values[:size])
        errors = self.unknowns.errors_shown(self.fit.values[:size], deviation[:size])
        hidden = self.is_hidden & (not self.visible.settled)
        found = [
            IdentifiedNumber(unknown.name, float(value), None if unseen else float(error), unknown.unit)
            for unknown, value, error, unseen in zip(self.unknowns.each, values, errors, hidden, strict=True)
        ]
        rest = zip(self.names[size:], self.fit.values[size:], deviation[size:], strict=True)
        return (*found, *(IdentifiedNumber(name, float(value), float(error), "arcmin") for name, value, error in rest))

    def estimate(self, name: str) -> IdentifiedNumber:
        """One of the numbers by its name.

        Raises:
            ParameterError: there is none of that name.
        """
        for each in self.estimates:
            if each.name == name:
                return each
        raise ParameterError("name", name, nearest(name, self.names))

    @property
    def alternatives(self) -> tuple[dict[str, float], ...]:
        """Other values of the scene's numbers that explain the recordings as well, by name."""
        size = len(self.unknowns.each)
        shown = [self.unknowns.shown(values[:size]) for values in self.fit.others]
        return tuple(dict(zip(self.unknowns.names, map(float, each), strict=True)) for each in shown)

    @property
    def correlations(self) -> list[tuple[str, str, float]]:
        """Pairs of numbers whose errors go together."""
        return strongest_correlations(self.unknowns, self.visible.covariance, ~self.is_hidden)

    @property
    def hidden(self) -> list[str]:
        """What the recordings cannot tell, in words."""
        words = hidden_in_words(self.unknowns, self.visible.hidden)
        shown = {each.name: each.value for each in self.estimates}
        for other in self.alternatives:
            moved = [
                f"{name} = {value:.4g}"
                for name, value in other.items()
                if abs(value - shown[name]) > 1e-3 * max(abs(value), 1e-3)
            ]
            words.append(f"as good a fit is elsewhere: {', '.join(moved[:12])}")
        return words

    def curves(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Input angle [rad], measured and computed TE [rad] of each recording, offsets and free orders included."""
        rows = self.fit.problem.rows
        curve = self.fit.problem.curve(self.fit.values)[0]
        own = [rows.record == i for i in range(len(self.records))]
        return [(rows.theta[each], rows.te[each] * arcmin, curve[each] * arcmin) for each in own]

    def draws(self, number: int, key: int = 0, *, size: float | None = None) -> np.ndarray:
        """Numbers of the scene drawn from what the recordings leave open, shape (draw, unknown), units of the search.

        Directions that the recordings hide are drawn from what was known before (``priors``), else from vectors as
        large as those that were found.

        Args:
            number: of draws.
            key: seed.
            size: standard deviation of hidden numbers, in units of the search.
        """
        unknowns, rng = len(self.unknowns.each), np.random.default_rng(key)
        centre, root = self.gaussian(self.visible.inflation, size)
        drawn = (centre + rng.standard_normal((number, centre.size)) @ root.T)[:, :unknowns]
        soft = self.unknowns.reciprocals
        drawn[:, soft] = np.maximum(drawn[:, soft], SOFTEST)
        others = [values[:unknowns] for values in self.fit.others]
        if others:  # ends that are as good, each with its share of the draws
            shifts = np.stack([np.zeros(unknowns), *(self._towards(other) for other in others)])
            drawn = drawn + shifts[np.arange(number) % len(shifts)]
        return drawn

    def held(self, size: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Means and precisions that hold what neither recordings nor priors tell, in units of the search, beside those
        of the fit: vectors to none, as large as those found or as told; other numbers to about what the scene has.

        Args:
            size: standard deviation of hidden vectors, in units of the search.
        """
        unknowns = len(self.unknowns.each)
        mean, precision = np.zeros(self.fit.values.size), np.zeros(self.fit.values.size)
        hidden = self.is_hidden & (self.fit.known.precision[:unknowns] == 0) & (not self.visible.settled)
        vectors = [i for pair in self.unknowns.vectors.values() for i in pair]
        spread = size or float(np.sqrt(np.mean(self.fit.values[vectors] ** 2))) if vectors else size or 1.0
        start = self.unknowns.start
        for i in np.flatnonzero(hidden):
            if self.unknowns.each[i].path.startswith("errors."):
                precision[i] = 1 / (spread or 1.0) ** 2
            else:
                mean[i], precision[i] = start[i], 1 / max(LOOSELY * abs(start[i]), 1e-3) ** 2
        return mean, precision

    def gaussian(self, inflation: float, size: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Centre of what the recordings leave open and a root of its covariance, in units of the search.

        Args:
            inflation: of the variance of a row.
            size: of hidden vectors, as of `held`.
        """
        mean, extra = self.held(size)
        told = self.fit.matrix / (self.fit.sigma**2 * inflation) + np.diag(self.fit.known.precision / self.fit.sigma**2)
        whole = told + np.diag(extra)
        diagonal = np.diag(whole)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        values, vectors = np.linalg.eigh(whole / scale[:, None] / scale[None, :])
        values = np.maximum(values, 1e-12 * values[-1])  # rounding, of recordings without noise
        pull = vectors.T @ ((told @ self.fit.values + extra * mean) / scale)
        return vectors @ (pull / values) / scale, vectors / np.sqrt(values) / scale[:, None]

    def shown(self, values: np.ndarray) -> np.ndarray:
        """All numbers in the units that they are shown in, of those in units of the search, shape (..., number)."""
        size = len(self.unknowns.each)
        return np.concatenate([self.unknowns.shown(values[..., :size]), values[..., size:]], axis=-1)

    def _towards(self, other: np.ndarray) -> np.ndarray:
        return other - self.fit.values[: other.size]

    def as_json(self) -> dict[str, Any]:
        """What was found, for a file."""
        return {
            "estimates": [dataclasses.asdict(each) | {"interval_95": each.interval} for each in self.estimates],
            "eccentricities": {path: self._vector(places) for path, places in self.unknowns.vectors.items()},
            "residual_arcmin": self.fit.sigma,
            "records": [
                {
                    "name": record.name,
                    "rows": int(record.theta.size),
                    "residual_arcmin": float(np.std(te - own) / arcmin),
                    "explained": float(1 - np.var(te - own) / max(np.var(te), 1e-300)),
                }
                for record, (_, te, own) in zip(self.records, self.curves(), strict=True)
            ],
            "told_together": [dataclasses.asdict(each) for each in self.visible.combinations],
            "hidden": self.hidden,
            "alternatives": list(self.alternatives),
            "correlations": [list(each) for each in self.correlations],
            "blocks": self.visible.blocks,
            "condition": self.visible.condition,
            "outlying_rows": int((self.fit.weight < OUTLYING).sum()),
            "orders": [dataclasses.asdict(each) for each in self.orders],
            "notes": list(self.notes),
            "suggestions": [dataclasses.asdict(each) for each in self.suggestions],
        }

    def _vector(self, places: tuple[int, int]) -> dict[str, Any]:
        along, across = (float(self.fit.values[i]) for i in places)
        return {
            "amplitude_um": math.hypot(along, across),
            "phase_deg": math.degrees(math.atan2(across, along)),
            "told": self.visible.settled or not bool(self.is_hidden[list(places)].any()),
        }
