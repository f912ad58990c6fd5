"""The result of an identification: numbers with their errors, what is hidden, which other solutions fit."""

import dataclasses
import math
from typing import Any

import numpy as np

from gearjax.checks import ParameterError, nearest
from gearjax.identification.advice import Suggestion
from gearjax.identification.fit import Fit
from gearjax.identification.measurement import Measurement
from gearjax.identification.model import Model
from gearjax.identification.orders import Drift, Order
from gearjax.identification.unknowns import Unknowns
from gearjax.identification.visible import Visible, hidden_in_words, strongest_correlations
from gearjax.identification.weights import OUTLYING
from gearjax.scene import Scene
from gearjax.units import arcmin

Z = 1.959964  # standard errors to either side of an interval of 95 %
SIZES = 16  # sizes of hidden errors that draws have
LOOSELY = 0.3  # of its value: assumed standard deviation of a hidden number that is no error
SOFTEST = 0.05  # least reciprocal that is drawn, in units of the search


@dataclasses.dataclass(frozen=True)
class IdentifiedNumber:
    """One identified number.

    Args:
        name: name such as ``errors.planet_1.cos``.
        value: value in ``unit``.
        error: standard error in ``unit``; ``None`` if the recordings hide the number.
        unit: unit of the value and its error.
    """

    name: str
    value: float
    error: float | None
    unit: str

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval; ``None`` if the recordings hide the number."""
        return None if self.error is None else (self.value - Z * self.error, self.value + Z * self.error)


@dataclasses.dataclass(frozen=True, eq=False)
class Identification:
    """The numbers of a gear set that were identified from recordings.

    Args:
        scene: the scene with the numbers found; where the recordings leave a choice, the errors nearest to zero.
        records: the recordings.
        unknowns: the unknowns.
        fit: the result of the fit.
        visible: what the fit determines and hides.
        orders: unexplained waves that were found and set free; orders that the user set free are among ``names``.
        drifts: drifts of the encoders' offset within recordings that were found and set free.
        names: names of all numbers: unknowns of the scene, offsets, free orders and drifts.
        notes: remarks for the reader.
        suggestions: further recordings that would show more.
    """

    scene: Scene
    records: tuple[Measurement, ...]
    unknowns: Unknowns
    model: Model
    fit: Fit
    visible: Visible
    orders: tuple[Order, ...]
    drifts: tuple[Drift, ...]
    names: tuple[str, ...]
    notes: tuple[str, ...]
    suggestions: tuple[Suggestion, ...]

    @property
    def sigma(self) -> float:
        """Standard deviation of the residual per row [rad]."""
        return self.fit.sigma * arcmin

    @property
    def vectors(self) -> list[str]:
        """Errors that were identified as vectors: their bodies may be turned in their seats."""
        return list(self.unknowns.vectors)

    @property
    def is_hidden(self) -> np.ndarray:
        """Whether the recordings hide each unknown, shape (unknown,)."""
        return self.visible.is_hidden(len(self.unknowns.each))

    @property
    def estimates(self) -> tuple[IdentifiedNumber, ...]:
        """Estimates of the unknowns of the scene, then of offsets, free orders and drifts [arcmin]."""
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
        """One of the estimates by its name.

        Raises:
            ParameterError: no number has that name.
        """
        for each in self.estimates:
            if each.name == name:
                return each
        raise ParameterError("name", name, nearest(name, self.names))

    @property
    def alternatives(self) -> tuple[dict[str, float], ...]:
        """Other values of the unknowns that explain the recordings equally well, by name."""
        size = len(self.unknowns.each)
        shown = [self.unknowns.shown(values[:size]) for values in self.fit.others]
        return tuple(dict(zip(self.unknowns.names, map(float, each), strict=True)) for each in shown)

    @property
    def correlations(self) -> list[tuple[str, str, float]]:
        """Pairs of unknowns whose errors are strongly correlated, with the correlation; the strongest first."""
        return strongest_correlations(self.unknowns, self.visible.covariance, ~self.is_hidden)

    @property
    def hidden(self) -> list[str]:
        """What the recordings cannot determine, in words."""
        words = hidden_in_words(self.unknowns, self.visible.hidden)
        shown = {each.name: each.value for each in self.estimates}
        for other in self.alternatives:
            moved = [
                f"{name} = {value:.4g}"
                for name, value in other.items()
                if abs(value - shown[name]) > 1e-3 * max(abs(value), 1e-3)
            ]
            words.append(f"another solution fits equally well: {', '.join(moved[:12])}")
        return words

    def curves(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Input angle [rad], measured and computed TE [rad] of each recording, with offsets, orders and drifts."""
        rows = self.fit.problem.rows
        curve = self.fit.problem.curve(self.fit.values)[0]
        own = [rows.record == i for i in range(len(self.records))]
        return [(rows.theta[each], rows.te[each] * arcmin, curve[each] * arcmin) for each in own]

    def draws(self, number: int, key: int = 0, *, size: float | None = None) -> np.ndarray:
        """Draw unknowns that the recordings leave possible, shape (draw, unknown), in units of the search.

        Hidden directions are drawn from the priors, or else from vectors as large as those that were found. How large
        the vectors of such a gear set are is itself uncertain, as few of them were found.

        Args:
            number: number of draws.
            key: seed of the draws.
            size: standard deviation of hidden errors, in units of the search; by default that of the vectors found.
        """
        unknowns, rng = len(self.unknowns.each), np.random.default_rng(key)
        sizes = self._sizes() if size is None else [size]
        drawn = np.empty((number, unknowns))
        for i, each in enumerate(sizes):
            centre, root = self.gaussian(self.visible.inflation, each)
            own = rng.standard_normal((len(range(i, number, len(sizes))), centre.size))
            drawn[i :: len(sizes)] = (centre + own @ root.T)[:, :unknowns]
        rng.shuffle(drawn)
        soft = self.unknowns.reciprocals
        drawn[:, soft] = np.maximum(drawn[:, soft], SOFTEST)
        others = [values[:unknowns] for values in self.fit.others]
        if others:  # solutions that are equally good get an equal share of the draws each
            shifts = np.stack([np.zeros(unknowns), *(self._towards(other) for other in others)])
            drawn = drawn + shifts[np.arange(number) % len(shifts)]
        return drawn

    def held(self, size: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Assumed means and precisions of the unknowns that neither recordings nor priors determine.

        They are in units of the search and add to the priors of the fit. Errors have a mean of zero and the size of the
        vectors found as standard deviation; other numbers have the mean of the scene and 30 % of it as deviation.

        Args:
            size: standard deviation of hidden errors, in units of the search; by default that of the vectors found.
        """
        unknowns = len(self.unknowns.each)
        mean, precision = np.zeros(self.fit.values.size), np.zeros(self.fit.values.size)
        hidden = self.is_hidden & (self.fit.known.precision[:unknowns] == 0) & (not self.visible.settled)
        spread = size or self._found_size()[0]
        start = self.unknowns.start
        for i in np.flatnonzero(hidden):
            if self.unknowns.each[i].path.startswith("errors."):
                precision[i] = 1 / (spread or 1.0) ** 2
            else:
                mean[i], precision[i] = start[i], 1 / max(LOOSELY * abs(start[i]), 1e-3) ** 2
        return mean, precision

    def gaussian(self, inflation: float, size: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Mean and a root of the covariance of the numbers that the recordings leave possible, in units of the search.

        Args:
            inflation: factor on the variance of a row.
            size: standard deviation of hidden errors, as in `held`.
        """
        mean, extra = self.held(size)
        told = self.fit.matrix / (self.fit.sigma**2 * inflation) + np.diag(self.fit.known.precision / self.fit.sigma**2)
        whole = told + np.diag(extra)
        diagonal = np.diag(whole)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        values, vectors = np.linalg.eigh(whole / scale[:, None] / scale[None, :])
        values = np.maximum(values, 1e-12 * values[-1])  # smaller ones are rounding, from recordings without noise
        pull = vectors.T @ ((told @ self.fit.values + extra * mean) / scale)
        return vectors @ (pull / values) / scale, vectors / np.sqrt(values) / scale[:, None]

    def shown(self, values: np.ndarray) -> np.ndarray:
        """All numbers converted from units of the search to those in which they are shown, shape (..., number)."""
        size = len(self.unknowns.each)
        return np.concatenate([self.unknowns.shown(values[..., :size]), values[..., size:]], axis=-1)

    def _found_size(self) -> tuple[float, int]:
        """Standard deviation of the components of the vectors, in units of the search, and how many tell it.

        The components that were found have no part in the hidden directions, where they are as near to zero as they
        can be: so many fewer tell the size.
        """
        vectors = [i for pair in self.unknowns.vectors.values() for i in pair]
        if not vectors:
            return 1.0, 1
        hidden = self.visible.hidden[:, vectors]
        told = max(len(vectors) - (int(np.linalg.matrix_rank(hidden)) if hidden.size else 0), 1)
        return float(np.sqrt((self.fit.values[vectors] ** 2).sum() / told)) or 1.0, told

    def _sizes(self) -> list[float | None]:
        """Standard deviations of the vectors that the ones found leave possible, equally probable."""
        size, told = self._found_size()
        if not self.is_hidden.any() or self.visible.settled:
            return [None]
        from scipy import special  # this import takes a third of a second, and only draws need it

        shares = (np.arange(SIZES) + 0.5) / SIZES
        return [size * math.sqrt(0.5 * told / float(special.gammaincinv(0.5 * told, share))) for share in shares]

    def _towards(self, other: np.ndarray) -> np.ndarray:
        return other - self.fit.values[: other.size]

    def as_json(self) -> dict[str, Any]:
        """The results for a file."""
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
            "outlying_rows": int((self.fit.share < OUTLYING).sum()),
            "orders": [dataclasses.asdict(each) for each in self.orders],
            "drifts": [dataclasses.asdict(each) for each in self.drifts],
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
