"""A recording of a test bench: angles of the input and the output, or the transmission error, row by row in time."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import GearjaxError, ParameterError, nearest, with_article
from gearjax.scene import Scene
from gearjax.units import arcmin, deg

RATIO_TOLERANCE = 2e-3  # relative deviation of the output's slope from that of the gear set
FACTORS = {  # factors of a wrong slope, and the likely cause
    180 / np.pi: "the input angle seems to be in radians, or the output angle in degrees, contrary to its header",
    np.pi / 180: "the input angle seems to be in degrees, or the output angle in radians, contrary to its header",
    360.0: "one of the angles seems to be in turns, contrary to its header",
    1 / 360.0: "one of the angles seems to be in turns, contrary to its header",
    60.0: "one of the angles seems to be in arcmin, contrary to its header",
    1 / 60.0: "one of the angles seems to be in arcmin, contrary to its header",
}
SHORTEST = 3  # rows
PITCHES = 3.0  # pitches of the fastest mesh, as an angle of the output: a larger transmission error is impossible
MOST_FAR = 0.02  # share of the rows that may be so far off: a few are outliers
FLIPS = 0.05  # share of the rows with a change of sign, above which a torque may be noise
ALL_NOISE = 1.2  # standard deviation of a torque over that of its noise from row to row, up to which it is steady
FEWEST_OF_NOISE = 30  # rows of which noise can be told from waves
BOTH_WAYS = 0.2  # share of its span that a recording may turn against its direction, because encoders jitter


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement:
    """One run on a test bench: one direction of rotation, rows in the order of time.

    Args:
        theta: input angle of each row; its zero is the zero of the phases, shape (n,) [rad].
        output: output angle, shape (n,) [rad], or ``None`` if the transmission error was recorded.
        te: transmission error, shape (n,) [rad], or ``None`` if both angles were recorded.
        torque: load torque on the output, positive resists its positive rotation, shape (n,) [N m]; ``None`` for none.
        time: time of each row, shape (n,) [s], or ``None``.
        name: name in messages and figures.
        turned: angles by which bodies were turned in their seats before this run, by error, such as
            ``{"errors.planet_1": 0.5}`` [rad]; they are added to the phases of these errors.
        resolution: smallest step of the transmission error that the encoders resolve [rad]; ``None`` if unknown.
        repairs: faults of the file that were repaired during reading, and how often.
        averaged: number of rows of the file that each row is the mean of.
        input_wraps: whether the input angle was that of an encoder of a single turn, so that whole turns before the
            first row are unknown.

    Raises:
        ParameterError: arrays do not fit together, or contain numbers that are not finite.
    """

    theta: Any  # a list is accepted too, and stored as an array
    output: Any = None
    te: Any = None
    torque: Any = None
    time: Any = None
    name: str = "measured"
    turned: Mapping[str, float] = dataclasses.field(default_factory=dict)
    resolution: float | None = None
    repairs: Mapping[str, int] = dataclasses.field(default_factory=dict)
    averaged: int = 1
    input_wraps: bool = False

    def __post_init__(self):
        theta = _row(self, "theta", None)
        if theta.size < SHORTEST:
            raise ParameterError("theta", theta.size, f"is a number of rows: at least {SHORTEST} are needed")
        if (self.output is None) == (self.te is None):
            raise ParameterError(
                "output", "both or none", "give either the output angle or the transmission error (te)"
            )
        for key in ("output", "te", "time"):
            if getattr(self, key) is not None:
                _row(self, key, theta.size)
        if self.torque is not None:
            if isinstance(self.torque, int | float | np.number):
                object.__setattr__(self, "torque", np.full(theta.shape, float(self.torque)))
            _row(self, "torque", theta.size)
        if np.ptp(theta) == 0:
            raise ParameterError("theta", float(theta[0]), "is the same in every row: the input does not turn")

    @property
    def loads(self) -> np.ndarray:
        """Torque of each row, zero where none was recorded, its mean if it is steady, shape (n,) [N m]."""
        if self.torque is None or self.is_noise:
            return np.zeros(self.theta.shape)
        return np.full(self.theta.shape, np.mean(self.torque)) if self.is_steady else np.asarray(self.torque)

    @property
    def is_steady(self) -> bool:
        """Whether the torque changes only by noise of its sensor, which differs from row to row."""
        if self.torque is None or self.torque.size < FEWEST_OF_NOISE or np.ptp(self.torque) == 0:
            return False
        return bool(np.std(self.torque) < ALL_NOISE * np.std(np.diff(self.torque, 2)) / np.sqrt(6))

    @property
    def is_noise(self) -> bool:
        """Whether the torque is only noise of its sensor about zero."""
        if self.torque is None or not np.any(self.torque):
            return False
        flips = np.mean(np.diff(np.sign(self.torque)) != 0)
        return bool(flips > FLIPS and abs(np.mean(self.torque)) < np.std(self.torque))

    @property
    def is_loaded(self) -> bool:
        """Whether a torque other than zero was recorded."""
        return bool(np.any(self.loads))

    @property
    def turns_back(self) -> bool:
        """Whether the input angle decreases."""
        return bool(self.theta[-1] < self.theta[0])

    @property
    def back(self) -> np.ndarray:
        """Whether the back flanks carry in each row: under a negative torque, or unloaded if the input turns back."""
        return np.where(self.loads == 0, self.turns_back, self.loads < 0)

    def repeats(self, other: "Measurement") -> bool:
        """Whether another recording has the same angles and values."""
        own, its = self.output if self.te is None else self.te, other.output if other.te is None else other.te
        return bool(np.array_equal(self.theta, other.theta) and np.array_equal(own, its))

    def error(self, scene: Scene) -> np.ndarray:
        """Transmission error of the recording, ``phi_out - phi_in / i`` (Wang et al. 2020, eq. 22), shape (n,) [rad].

        For gear sets whose ratio is not constant: output angle minus ideal output angle.
        """
        if self.te is not None:
            return self.te
        assert self.output is not None
        return self.output - ideal(scene, self.theta)

    def check(self, scene: Scene) -> list[str]:
        """Refuse a recording that cannot be of this gear set; return remarks for the reader.

        Raises:
            GearjaxError: its ratio or direction differs, units or columns are exchanged, or it is aliased.
        """
        steps = np.diff(self.theta)
        if min(np.abs(steps[steps > 0]).sum(), np.abs(steps[steps < 0]).sum()) > BOTH_WAYS * np.ptp(self.theta):
            raise GearjaxError(
                f"{self.name}: the input angle goes forth and back: give one recording for each direction, rows in the "
                "order of time, and angles that wrap around at 360 deg or not at all"
            )
        if self.output is not None:
            _check_ratio(self, scene)
        words = [f"{self.name}: its torque is taken as zero, because it is noise about zero"] if self.is_noise else []
        if self.is_steady and not self.is_noise:
            words.append(f"{self.name}: its torque is taken as {self.loads[0]:.4g} N m: it changes only by noise")
        span = _check_span(self, scene)
        _check_size(self, scene)
        if self.torque is None and scene.compliance is not None:
            span.append(f"{self.name} states no torque: it is taken as a recording without load")
        return [*self.told(), *words, *span]

    def averaged_by(self, size: int) -> "Measurement":
        """The same recording, with the mean of each ``size`` successive rows as one row."""
        parts = {
            key: None if (values := getattr(self, key)) is None else means_of(values, size)
            for key in ("theta", "output", "te", "torque", "time")
        }
        return dataclasses.replace(self, **parts, averaged=self.averaged * size)

    def every(self, size: int) -> "Measurement":
        """The same recording with one in ``size`` rows."""
        parts = {
            key: None if (values := getattr(self, key)) is None else values[::size]
            for key in ("theta", "output", "te", "torque", "time")
        }
        return dataclasses.replace(self, **parts)

    def told(self) -> list[str]:
        """What was repaired or averaged during reading, in words."""
        words = [f"{number} {what}" for what, number in self.repairs.items()]
        if self.averaged > 1:
            words.append(f"each row is the mean of {self.averaged} rows of the file")
        return [f"{self.name}: {', '.join(words)}"] if words else []


def means_of(values: np.ndarray, size: int) -> np.ndarray:
    """Mean of each ``size`` successive values."""
    return values[: values.size // size * size].reshape(-1, size).mean(axis=1)


def ideal(scene: Scene, theta: np.ndarray) -> np.ndarray:
    """Ideal output angle at input angles, shape (n,) [rad]."""
    system = scene.system
    return np.asarray(jax.vmap(lambda angle: type(system).output(system, angle))(jnp.asarray(theta, scene.dtype)))


def _row(measured: Measurement, key: str, size: int | None) -> np.ndarray:
    """One of the arrays, stored as float64."""
    try:
        array = np.array(getattr(measured, key), dtype=float)
    except (TypeError, ValueError) as fault:
        raise ParameterError(key, getattr(measured, key), "must be numbers, in SI") from fault
    if array.ndim != 1 or (size is not None and array.size != size):
        raise ParameterError(key, array.shape, f"is a shape: must be ({'n' if size is None else size},), as theta")
    if not np.isfinite(array).all():
        where = int(np.argmin(np.isfinite(array)))
        raise ParameterError(
            f"{key}[{where}]", array[where], "must be finite: gj.read_measurement leaves such rows out"
        )
    object.__setattr__(measured, key, array)
    return array


def _check_ratio(measured: Measurement, scene: Scene) -> None:
    """Refuse an output that turns at another ratio, or in the other direction."""
    expected, output = ideal(scene, measured.theta), measured.output
    assert output is not None
    if np.ptp(output) == 0:
        raise GearjaxError(f"{measured.name}: the output angle is the same in every row")
    slope = robust_slope(expected, output)
    off = abs(slope - 1)
    if off * np.ptp(expected) < 2 * deg or off < RATIO_TOLERANCE:  # a short recording hardly determines the slope
        return
    order = robust_slope(expected, measured.theta)
    words = f"{measured.name}: the output turns {slope:.6g} times as far as {with_article(scene.system.kind)}'s should"
    for factor, meaning in FACTORS.items():
        if abs(abs(slope) / factor - 1) < 0.02:
            raise GearjaxError(f"{words}: {meaning}")
    if abs(abs(slope) / order**2 - 1) < 0.02:
        raise GearjaxError(f"{words}: input angle and output angle look exchanged")
    if abs(slope + 1) < RATIO_TOLERANCE:
        raise GearjaxError(f"{words[:-7]}: it turns in the opposite direction, give sign = -1 in the TOML file")
    raise GearjaxError(
        f"{words}: the recording fits a ratio of {order / slope:.6g} turns of the input per turn of the output, this "
        f"gear set has {order:.6g}: other tooth numbers, or another body is the input"
    )


def robust_slope(x: np.ndarray, y: np.ndarray) -> float:
    """Slope of y over x, as the median of differences over half of the rows: a few outliers do not change it."""
    half = x.size // 2
    run = x[half:] - x[: x.size - half]
    good = np.abs(run) > 0.1 * np.ptp(x)
    if not good.any():
        return float(np.polyfit(x, y, 1)[0])
    return float(np.median((y[half:] - y[: y.size - half])[good] / run[good]))


def _check_size(measured: Measurement, scene: Scene) -> None:
    """Refuse a transmission error of several tooth pitches: gears would have to skip teeth."""
    orders = scene.system.orders
    pitch = 2 * np.pi * orders.get("output", 1.0) / max(orders.values(), default=1.0)
    error = measured.error(scene)
    far = np.abs(error - np.median(error)) > PITCHES * pitch
    if far.mean() > MOST_FAR:
        words = f"{far.sum()} of {far.size} rows, from row {int(np.argmax(far)) + 1} on, have a transmission error of"
        limit = f"more than {PITCHES:g} tooth pitches ({PITCHES * pitch / arcmin:.3g} arcmin) beside its median"
        raise GearjaxError(f"{measured.name}: {words} {limit}: the unit of a column is wrong, or values are missing")


def _check_span(measured: Measurement, scene: Scene) -> list[str]:
    """Remarks on what a short or coarse recording cannot show; an aliased recording is refused."""
    theta, orders = measured.theta, scene.system.orders
    fastest = max(1.0, orders.get("output", 1.0)) * 1.01  # bodies turn at most so fast; higher orders are teeth or pins
    bodies = {name: order for name, order in orders.items() if order <= fastest}
    step = float(np.median(np.abs(np.diff(theta))))
    told = []
    for name, order in bodies.items():
        if order * step >= np.pi:
            raise GearjaxError(
                f"{measured.name}: aliased, {2 * np.pi / step:.3g} rows per turn of the input, in which the {name} "
                f"makes {order:.4g} turns: at least {2 * order:.3g} rows are needed"
            )
    if max(orders.values(), default=0.0) * step >= np.pi:
        name = max(orders, key=lambda each: orders[each])
        told.append(f"{measured.name}: fewer than two rows per period of order {name}: it is aliased to lower orders")
    slow = min(bodies, key=lambda name: bodies[name]) if bodies else "input"
    turns = float(np.ptp(theta)) * bodies.get(slow, 1.0) / (2 * np.pi)
    if turns < 0.98:
        told.append(
            f"{measured.name}: covers {turns:.2g} turns of the {slow}: errors of slow bodies are hard to separate "
            "from the encoders' offset"
        )
    gap = float(np.abs(np.diff(theta)).max())
    if gap > 20 * step:
        told.append(f"{measured.name}: has a gap of {gap / deg:.4g} deg of the input")
    return told


def a_measurement(name: str, value: Any) -> None:
    """Refuse anything but a recording or several, as an argument of a public function."""
    for record in several(value):
        if not isinstance(record, Measurement):
            words = "must be a Measurement, or a list of them: gj.read_measurement(path) reads one"
            raise ParameterError(name, str(record) if not np.ndim(record) else np.shape(record), words)
    if not several(value):
        raise ParameterError(name, value, "must contain a recording")
    for i, record in enumerate(several(value)):
        for other in several(value)[:i]:
            if record.repeats(other):
                words = f"has the same rows as {other.name}: give each recording once"
                raise ParameterError(name, record.name, words)


def several(records: Any) -> list[Any]:
    """A list of recordings, from one recording or several."""
    return list(records) if isinstance(records, list | tuple) else [records]


def check_turned(records: list[Measurement], names: list[str]) -> None:
    """Refuse a body turned before a run if its eccentricity is not among the unknowns.

    Raises:
        ParameterError: names the error.
    """
    for record in records:
        for name, angle in record.turned.items():
            if name not in names:
                words = nearest(name, names) if names else "where has no eccentricity"
                raise ParameterError(
                    f"turned of {record.name}", name, f"must be among the eccentricities that are identified; {words}"
                )
            if not isinstance(angle, int | float | np.number) or not np.isfinite(angle):
                raise ParameterError(f"turned of {record.name}", angle, "must be a finite angle [rad]")


def binned(
    theta: np.ndarray, values: tuple[np.ndarray, ...], width: float
) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
    """Means over even steps of the angle: angle, values and number of rows of each step."""
    place = np.floor((theta - theta.min()) / width).astype(int)
    number = np.bincount(place)
    filled = number > 0
    means = [np.bincount(place, part)[filled] / number[filled] for part in (theta, *values)]
    return means[0], tuple(means[1:]), number[filled].astype(float)
