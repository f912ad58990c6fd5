"""Orders of a curve: which bodies have them, and which waves and drifts a model does not explain."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError
from gearjax.identification.fit import Fit
from gearjax.identification.measurement import Measurement
from gearjax.identification.rows import Rows, Trend, Wave
from gearjax.scene import Scene

SIGNIFICANT = 12.0  # Fisher's F ratio of a significant order, two degrees of freedom
PER_OUTPUT_TURN = 60  # highest order that is tried, in cycles per turn of the output
MULTIPLES = 3  # multiples of the bodies' orders that are tried
NEIGHBOURS = np.arange(2, 10)  # waves more or less in a recording: orders whose squares tell the noise beside one
LEAST_WAVES = 0.9  # of an order that is tried in a recording
LEFT = 0.01  # share of a wave's square that the model's derivatives must leave: below, they can take its place
SHORTEST_WAVE = 0.5  # part of a wave of a free order that the longest recording must contain
MOST_STEPS = 1 << 18  # even steps of the angle, at most, for the spectrum in which any other wave is looked for
FINER = 4  # orders of that spectrum for each one that the recordings can tell from its neighbours
SHARP = 1e-3  # error with which the order of a wave is then determined, over the step of that spectrum
ENOUGH = 2e-3  # waves in a recording by which an order must move before the fit is repeated
NO_BODY = "no body of the gear set: the test rig, or a shift of its zero"


@dataclasses.dataclass(frozen=True)
class Order:
    """A wave that a model does not explain.

    Args:
        order: cycles per turn of the input.
        name: name such as ``output`` or ``13 per turn of the output``.
        body: the body that has this order, in words.
        amplitude: amplitude of the wave [arcmin].
        phase: phase of its cosine at input angle zero [rad].
        significance: Fisher's F ratio.
    """

    order: float
    name: str
    body: str
    amplitude: float
    phase: float
    significance: float

    @property
    def column(self) -> Wave:
        """The wave as further numbers of a fit."""
        return Wave(self.order, self.name)

    @property
    def in_words(self) -> str:
        """Name and size of the wave."""
        return f"{self.name} ({self.amplitude:.3g} arcmin)"

    def with_values(self, cosine: float, sine: float) -> "Order":
        """The wave with other values of its numbers [arcmin]."""
        return dataclasses.replace(
            self, amplitude=float(np.hypot(cosine, sine)), phase=float(np.arctan2(-sine, cosine))
        )


@dataclasses.dataclass(frozen=True)
class Drift:
    """A drift of the encoders' offset within a recording, which a model does not explain.

    Args:
        record: number of the recording, from 0.
        name: name such as ``drift of forward_10``.
        change: offset at the end of the recording minus that at its start [arcmin].
        bend: mean of the offsets at both ends minus that in the middle of the recording [arcmin].
        significance: Fisher's F ratio.
    """

    record: int
    name: str
    change: float
    bend: float
    significance: float

    @property
    def column(self) -> Trend:
        """The drift as further numbers of a fit."""
        return Trend(self.record, self.name)

    @property
    def in_words(self) -> str:
        """Name and size of the drift."""
        return f"{self.name} ({self.change:.3g} arcmin from its start to its end)"

    def with_values(self, line: float, parabola: float) -> "Drift":
        """The drift with other values of its numbers [arcmin]."""
        return dataclasses.replace(self, change=2 * line, bend=1.5 * parabola)


def candidates(scene: Scene, theta: np.ndarray, record: np.ndarray) -> dict[float, tuple[str, str]]:
    """Orders that are tried, with their names and bodies.

    Of orders that are too close for a recording to distinguish, only the one of the lower multiple is tried.
    """
    orders = {name: order for name, order in scene.system.orders.items() if order > 0}
    output = orders.get("output", 1.0)
    span = span_of(theta, record)
    step = float(np.median(np.abs(np.diff(theta))))
    found: dict[float, tuple[str, str]] = {}

    def add(order: float, name: str, body: str) -> None:
        if (
            order * step < np.pi
            and order * span > LEAST_WAVES
            and all(abs(order - other) * span > 0.3 for other in found)
        ):
            found[order] = name, body

    for times in range(1, MULTIPLES + 1):
        for name, order in ({"input": 1.0} | orders).items():
            body = f"the {name}" if name != "output" else "the output, what is mounted on it, or its encoder"
            body = body if name != "input" else "the input, or its encoder"
            add(times * order, name if times == 1 else f"{times} x {name}", body)
    for times in range(1, PER_OUTPUT_TURN + 1):
        add(times * output, f"{times} per turn of the output", NO_BODY)
    return found


def given_waves(orders: Any, records: Sequence[Measurement]) -> list[Wave]:
    """Waves that the user sets free; none for ``"find"``."""
    if isinstance(orders, str):
        if orders != "find":
            raise ParameterError("orders", orders, 'must be "find", or orders in cycles per turn of the input')
        return []
    given = arguments.finite("orders", orders)
    span = max(float(np.ptp(record.theta)) for record in records) / (2 * np.pi)
    step = min(float(np.median(np.abs(np.diff(record.theta)))) for record in records)
    free: list[Wave] = []
    for order in [] if given is None else np.atleast_1d(given).tolist():
        if not (order * span > SHORTEST_WAVE and order * step < np.pi):
            words = f"from {SHORTEST_WAVE / span:.3g} (half a wave in a recording) to {np.pi / step:.3g}"
            raise ParameterError("orders", order, f"must be {words} (two rows per wave), cycles per turn of the input")
        if any(abs(order - other.order) * span < 0.3 for other in free):
            raise ParameterError("orders", order, "is too close to another of the given orders")
        free.append(Wave(order, f"order {order:.6g}"))
    return free


def unexplained(
    fit: Fit, scene: Scene, names: Sequence[str], known: Sequence[Wave | Trend] = ()
) -> Order | Drift | None:
    """The largest of the significant waves and drifts in the residual of a model, ``None`` if there is none.

    Of each, only the part orthogonal to the model's derivatives counts: the model can represent the rest itself. It
    must be larger than the noise of all rows, and than that of the waves beside it. Waves of the bodies and of whole
    cycles per turn of the output are tried, and the largest wave of any other order.

    Args:
        fit: the fit of the model.
        scene: the scene whose bodies have the orders.
        names: names of the recordings.
        known: waves and drifts that the model has already.
    """
    rows = fit.problem.rows
    left = _Left.of(fit.problem.curve(fit.values)[1], fit.residual, fit)
    ways: list[tuple[Wave | Trend, str, float]] = [
        (Wave(order, name), body, SIGNIFICANT)
        for order, (name, body) in candidates(scene, rows.theta, rows.record).items()
    ]
    ways += [(Trend(i, f"drift of {names[i]}"), "", SIGNIFICANT) for i in np.unique(rows.record).tolist()]
    ways += left.other_wave([each.order for each, _, _ in ways if isinstance(each, Wave)], scene)
    done = {each.name for each in known}
    most, found = 0.0, None
    for way, body, least in ways:
        gained, ratio, parts = left.gain(way) if way.name not in done else (0.0, 0.0, ())
        if ratio > least and gained > most:
            most = gained
            if isinstance(way, Wave):
                found = Order(way.order, way.name, body, 0.0, 0.0, ratio).with_values(*parts)
            else:
                found = Drift(way.record, way.name, 0.0, 0.0, ratio).with_values(*parts)
    return found


def sharpened(known: Sequence[Order | Drift], fit: Fit, scene: Scene) -> list[Order | Drift]:
    """Waves and drifts of a fit, the orders of no body determined again beside all others.

    Args:
        known: the waves and drifts, whose numbers are the last of the fit.
        fit: the fit.
        scene: the scene whose bodies have the other orders.
    """
    rows, jacobian = fit.problem.rows, fit.problem.curve(fit.values)[1]
    named, output = candidates(scene, rows.theta, rows.record), scene.system.orders.get("output", 1.0)
    found = list(known)
    for i, each in enumerate(known):
        if isinstance(each, Order) and each.order not in named:
            left = _Left.without(fit, jacobian, 2 * (len(known) - i))
            order = left.sharpened(each.order)
            if abs(order - each.order) < ENOUGH / left.span:
                continue
            found[i] = dataclasses.replace(each, order=order, name=f"{order / output:.4g} per turn of the output")
    return found


def weighed(known: Sequence[Order | Drift], fit: Fit) -> list[Order | Drift]:
    """Waves and drifts of a fit with their significance beside all others, some of which were found later.

    Args:
        known: the waves and drifts, whose numbers are the last of the fit.
        fit: the fit.
    """
    jacobian = fit.problem.curve(fit.values)[1]
    left = (_Left.without(fit, jacobian, 2 * (len(known) - i)) for i in range(len(known)))
    return [
        dataclasses.replace(each, significance=float(part.gain(each.column)[1]))
        for each, part in zip(known, left, strict=True)
    ]


@dataclasses.dataclass(frozen=True)
class _Left:
    """What a model leaves of its rows.

    Args:
        base: orthonormal base of the model's derivatives, shape (n, number).
        scaled: residual times the square root of the weights [arcmin].
        root: square root of the weights.
        rows: the rows.
    """

    base: np.ndarray
    scaled: np.ndarray
    root: np.ndarray
    rows: Rows

    @classmethod
    def of(cls, jacobian: np.ndarray, residual: np.ndarray, fit: Fit) -> "_Left":
        """What a model with some derivatives leaves of a residual."""
        root = np.sqrt(fit.weight)
        scaled = jacobian * root[:, None]
        size = np.linalg.norm(scaled, axis=0)
        base, values, _ = np.linalg.svd(scaled / np.where(size > 0, size, 1.0), full_matrices=False)
        return cls(base[:, values > 1e-6 * values[0]], root * residual, root, fit.problem.rows)

    @classmethod
    def without(cls, fit: Fit, jacobian: np.ndarray, last: int) -> "_Left":
        """What a fit leaves without two of its numbers, of which the first is the ``last``-th from the end."""
        first = fit.values.size - last
        place = [first, first + 1]
        return cls.of(np.delete(jacobian, place, axis=1), fit.residual + jacobian[:, place] @ fit.values[place], fit)

    @functools.cached_property
    def left(self) -> np.ndarray:
        """The part of the residual that is orthogonal to the model's derivatives."""
        return self.scaled - self.base @ (self.base.T @ self.scaled)

    @property
    def span(self) -> float:
        """Turns of the input of the longest recording."""
        return span_of(self.rows.theta, self.rows.record)

    def gain(self, way: Wave | Trend) -> tuple[float, float, tuple[float, ...]]:
        """Sum of squares that a wave or drift takes, Fisher's F ratio, and its two numbers [arcmin].

        Both are zero if the model can take its place.
        """
        taken, parts = self._taken(way)
        gained = float((taken**2).sum())
        freedom = max(self.rows.theta.size - self.base.shape[1] - 2, 1)
        ratio = gained / 2 / (max(float((self.left**2).sum()) - gained, 1e-300) / freedom)
        if ratio > SIGNIFICANT:
            order = way.order if isinstance(way, Wave) else 0.0
            own = slice(None) if isinstance(way, Wave) else self.rows.record == way.record
            root, theta, left = self.root[own], self.rows.theta[own], (self.left - taken)[own]
            span = self.span if isinstance(way, Wave) else float(np.ptp(theta)) / (2 * np.pi)
            ratio = min(ratio, gained / 2 / max(_beside(order, span, root, theta, left), 1e-300))
        return gained, ratio, parts

    def _taken(self, way: Wave | Trend) -> tuple[np.ndarray, tuple[float, ...]]:
        """What a wave or drift takes from the residual, shape (n,), and its two numbers [arcmin]."""
        columns = np.stack(way.columns(self.rows.theta, self.rows.record), axis=1) * self.root[:, None]
        beside = columns - self.base @ (self.base.T @ columns)
        if (beside**2).sum() < LEFT * (columns**2).sum():
            return np.zeros(self.left.shape), (0.0, 0.0)
        parts, *_ = np.linalg.lstsq(beside, self.left, rcond=None)
        return beside @ parts, tuple(map(float, parts))

    def other_wave(self, orders: Sequence[float], scene: Scene) -> list[tuple[Wave, str, float]]:
        """The largest wave of the residual, if its order is none of the given ones."""
        theta, span = self.rows.theta, self.span
        fine = max(float(np.median(np.abs(np.diff(theta)))), 1e-300)
        steps = min(int(np.ceil(np.ptp(theta) / fine)) + 1, MOST_STEPS)
        place = np.round((theta - theta.min()) / max(np.ptp(theta), 1e-300) * (steps - 1)).astype(int)
        length = 1 << int(np.ceil(np.log2(FINER * steps)))
        spectrum = np.abs(np.fft.rfft(np.bincount(place, self.root * self.left, steps), length))
        every = np.arange(spectrum.size) * 2 * np.pi * (steps - 1) / max(np.ptp(theta), 1e-300) / length
        fits = (every * span > LEAST_WAVES) & (every * fine < np.pi)
        if not fits.any():
            return []
        order = float(every[fits][np.argmax(spectrum[fits])])
        if any(abs(order - other) * span < 0.5 for other in orders):
            return []
        order = self.sharpened(order)
        output = scene.system.orders.get("output", 1.0)
        least = SIGNIFICANT + np.log(max(0.5 * np.ptp(theta) / fine, 1.0))  # the largest of so many independent waves
        return [(Wave(order, f"{order / output:.4g} per turn of the output"), NO_BODY, least)]

    def sharpened(self, order: float) -> float:
        """The order near another one whose wave takes most from the residual."""
        from scipy import optimize  # this import takes a while, and few recordings need it

        apart = 1 / (FINER * self.span)
        within = max(order - apart, LEAST_WAVES / self.span), order + apart
        best: Any = optimize.minimize_scalar(
            lambda at: -float((self._taken(Wave(at, ""))[0] ** 2).sum()),
            bounds=within,
            method="bounded",
            options={"xatol": SHARP * apart},
        )
        return float(best.x)


def span_of(theta: np.ndarray, record: np.ndarray) -> float:
    """Turns of the input of the longest of some recordings."""
    return max(float(np.ptp(theta[record == i])) for i in np.unique(record)) / (2 * np.pi)


def _beside(order: float, span: float, root: np.ndarray, theta: np.ndarray, left: np.ndarray) -> float:
    """Square of the noise near an order: successive rows may hang together, so that slow waves of noise are larger.

    It is the median over neighbours that a recording can tell from the order, so that a few waves among them count
    little.
    """
    near = order + np.concatenate([-NEIGHBOURS, NEIGHBOURS]) / span
    near = near[near * span > LEAST_WAVES]
    parts = np.exp(1j * np.outer(near, theta)) @ (root * left)
    squares = np.abs(parts) ** 2 / max(float((root**2).sum()), 1e-300)
    return float(np.median(squares)) / np.log(2)  # squares of noise are exponentially distributed


def waves(theta: np.ndarray, curve: np.ndarray, orders: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes and phases of orders in a curve, by least squares; phases are of cosines at input angle zero [rad].

    The mean and all orders are fitted together, so that a recording need not consist of whole turns.
    """
    columns = [np.ones(theta.shape)]
    for order in orders:
        columns += [np.cos(order * theta), np.sin(order * theta)]
    parts, *_ = np.linalg.lstsq(np.stack(columns, axis=1), curve, rcond=1e-10)
    cosine, sine = parts[1::2], parts[2::2]
    return np.hypot(cosine, sine), np.arctan2(-sine, cosine)
