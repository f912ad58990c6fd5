"""Comparison of a measured transmission error with the computed one."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError, SceneError, nearest, with_article
from gearjax.identification.measurement import Measurement, a_measurement, several
from gearjax.identification.moving import moving_error
from gearjax.identification.orders import candidates, waves
from gearjax.identification.running import an_analysis, check_running
from gearjax.identification.synthetic import computed_error, turned_scene
from gearjax.identification.whole_turns import farthest, joined
from gearjax.scene import Scene
from gearjax.units import arcmin

LISTED = 12  # orders
START_ANGLES = 720  # tried over a cycle, at least
SHIFTS = ("none", "find")
POLISHED = 24  # best start angles that are refined: because bodies repeat, many are nearly alike
CLOSE = {"xatol": 1e-6}  # rad
MOST_ROWS = 200_000  # of a recording; more rows are averaged in groups, or thinned out in motion
MIRRORED = 0.5  # share of the variance that another sign of the TE must explain to be named
SURELY = 0.9  # the same for a run that may begin in a later turn, where the phases of slow bodies are unknown
APART = 20.0  # a curve that is so many times as large as the other has a column in the wrong unit, or a wrong torque
FAR_OFF = -1.0  # share explained below which something is named as wrong: the difference is well above the TE
MOST_ANGLES = 1 << 17  # of a computed curve
ANGLES_PER_CURVE = 4000  # angles of the computed curve that is shifted, at least


@dataclasses.dataclass(frozen=True)
class OrderBeside:
    """One order of a measured curve and of the computed curve.

    Args:
        order: cycles per turn of the input.
        name: body or mesh that has this order.
        measured, computed: amplitudes [rad].
        phase_measured, phase_computed: phases of the cosines at input angle zero [rad].
    """

    order: float
    name: str
    measured: float
    computed: float
    phase_measured: float
    phase_computed: float


@dataclasses.dataclass(frozen=True, eq=False)
class RecordBeside:
    """One recording with the computed curve.

    Args:
        name: name of the recording.
        theta: input angle [rad].
        measured: measured TE [rad].
        computed: TE of the scene at these angles, with the offset and the start angle of the recording [rad].
        offset: offset of the TE by the zeros of the encoders [rad].
        start: input angle of the scene at the zero of the recording's input angle [rad].
        orders: the largest orders of both curves.
    """

    name: str
    theta: np.ndarray
    measured: np.ndarray
    computed: np.ndarray
    offset: float
    start: float
    orders: tuple[OrderBeside, ...]

    @property
    def explained(self) -> float:
        """Share of the measured variance that the computed curve explains; negative if the difference varies more."""
        return float(1 - np.var(self.measured - self.computed) / max(np.var(self.measured), 1e-300))

    @property
    def metrics(self) -> dict[str, tuple[float, float]]:
        """Peak-to-peak and standard deviation of both curves, measured first [rad]."""
        pair = self.measured - self.offset, self.computed - self.offset
        told = {"peak_to_peak": np.ptp, "std": np.std}
        return {name: (float(of(pair[0])), float(of(pair[1]))) for name, of in told.items()}


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of recordings with a scene.

    Args:
        scene: the scene.
        records: the recordings, each with its computed curve.
        lost_motion: mean lost motion, measured and computed [rad]; ``None`` without recordings of both flanks under
            torques of the same size.
        notes: remarks for the reader.
    """

    scene: Scene
    records: tuple[RecordBeside, ...]
    lost_motion: tuple[float, float] | None
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """The comparison for a file, in arcmin and degrees."""
        return {
            "records": [
                {
                    "name": record.name,
                    "rows": int(record.theta.size),
                    "offset_arcmin": record.offset / arcmin,
                    "start_deg": float(np.degrees(record.start)),
                    "explained": record.explained,
                    "metrics_arcmin": {
                        name: {"measured": a / arcmin, "computed": b / arcmin}
                        for name, (a, b) in record.metrics.items()
                    },
                    "orders": [
                        {
                            "order": each.order,
                            "name": each.name,
                            "measured_arcmin": each.measured / arcmin,
                            "computed_arcmin": each.computed / arcmin,
                            "phase_measured_deg": float(np.degrees(each.phase_measured)),
                            "phase_computed_deg": float(np.degrees(each.phase_computed)),
                        }
                        for each in record.orders
                    ],
                }
                for record in self.records
            ],
            "lost_motion_arcmin": None
            if self.lost_motion is None
            else {"measured": self.lost_motion[0] / arcmin, "computed": self.lost_motion[1] / arcmin},
            "notes": list(self.notes),
        }


def _a_shift(name: str, value: Any) -> None:
    if value not in SHIFTS:
        raise ParameterError(name, value, nearest(value, SHIFTS))


@arguments.checked(measured=a_measurement, shift=_a_shift, analysis=an_analysis)
def compare(
    scene: Scene, measured: Measurement | Sequence[Measurement], *, shift: str = "none", analysis: str = "static"
) -> Comparison:
    """Compare recordings with the transmission error computed for a scene: curves, orders with phases, metrics.

    Recordings under torque are compared with the static TE, others with the no-load TE (of the back flanks if the input
    turns backward). The zeros of the encoders are removed as one offset per recording.
    Of several recordings with output angles, these tell in which turn of the input a recording begins whose input angle
    wraps around.

    Args:
        scene: the scene.
        measured: one recording, or several.
        shift: ``"find"`` also searches the start angle, for a recording whose input angle does not count from the zero
            of the phases; ``"none"`` does not.
        analysis: ``"static"``, or ``"dynamic"`` for recordings at speed: recordings under torque are then compared with
            the dynamic TE at their speed. The start angle is found with the static TE in both cases.

    Raises:
        GearjaxError: a recording cannot be of this gear set.
        SceneError: the scene lacks a part that a recording needs.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> beside = gj.compare(scene, gj.synthetic_measurement(scene, 100.0, noise=1e-6))
        >>> beside.records[0].explained > 0.99
        True
    """
    records = several(measured)
    notes = [words for record in records for words in record.check(scene)]
    notes += check_running(scene, records) if analysis == "dynamic" else []
    records, words = joined(scene, records)
    notes += words
    found = []
    for record in records:
        own = turned_scene(scene, record.turned)
        if record.is_loaded and scene.compliance is None:
            raise SceneError(f"{record.name} is under torque: list a [compliance]")
        if record.theta.size > MOST_ROWS:
            size = -(-record.theta.size // MOST_ROWS)
            record = record.every(size) if analysis == "dynamic" else record.averaged_by(size)
        te = record.error(scene)
        start = _start_angle(own, record, te) if shift == "find" else 0.0
        if analysis == "dynamic" and record.is_loaded:
            curve, words = moving_error(own, record, record.theta + start)
            notes += words
        else:
            curve = _computed(own, record, record.theta + start)
        notes += _remarks(record, te, curve, shift)
        offset = float(np.mean(te - curve))
        found.append(
            RecordBeside(
                record.name, record.theta, te, curve + offset, offset, start, _orders(scene, record, te, curve)
            )
        )
    return Comparison(scene, tuple(found), _lost_motion(scene, records, found), tuple(notes))


def _remarks(record: Measurement, te: np.ndarray, curve: np.ndarray, shift: str) -> list[str]:
    """What seems to be wrong with a recording that the computed curve does not explain at all."""
    name = record.name
    share, other = (1 - np.var(te - sign * curve) / max(np.var(te), 1e-300) for sign in (1, -1))
    wraps = record.input_wraps and shift == "none"
    measured, computed = np.std(te) / arcmin, np.std(curve) / arcmin
    if share < 0 and other > (SURELY if wraps else MIRRORED):
        words = "the TE is the angle of the output minus the ideal one (sign = -1 in its TOML file turns it)"
        return [f"{name}: with the other sign of te {100 * other:.4g} % would be explained: {words}"]
    if not 1 / APART < computed / max(measured, 1e-300) < APART:
        words = "a column may have the wrong unit, te or torque, or errors are missing"
        return [f"{name}: the measured TE varies by {measured:.3g} arcmin, the computed one by {computed:.3g}: {words}"]
    if share < 0 and wraps:
        words = (
            'it may begin in a later turn of the input, which its angle does not show: --shift (shift="find") finds it'
        )
        return [f"{name}: {100 * share:.4g} % explained, and its input angle wraps around: {words}"]
    if share < FAR_OFF:
        words = "other errors than the scene's, or a wrong sign, unit or start angle (gearjax identify tests signs)"
        return [f"{name}: {100 * share:.4g} % explained is worse than no curve: {words}"]
    return []


def _computed(scene: Scene, record: Measurement, theta: np.ndarray) -> np.ndarray:
    """TE of a scene under the torque of a recording, at any input angles, shape (n,) [rad]."""
    order = np.argsort(theta, kind="stable")
    angles, back = np.unique(theta[order], return_inverse=True)
    loads = record.loads
    if np.ptp(loads) == 0:
        own = computed_error(scene, angles, float(loads[0]), bool(record.back[0]))
    else:
        sums = np.bincount(back, loads[order]) / np.bincount(back)
        own = computed_error(scene, angles, sums, bool(record.turns_back))
    curve = np.empty(theta.shape)
    curve[order] = own[back]
    return curve


def _start_angle(scene: Scene, record: Measurement, te: np.ndarray) -> float:
    """Start angle at which the computed curve is closest to the measured one [rad]."""
    from scipy import optimize

    cycle = scene.system.cycle
    kind = scene.system.kind
    if not scene.system.turns_evenly:
        raise SceneError(f"a start angle needs an output that turns evenly; that of {with_article(kind)} does not")
    size = max(ANGLES_PER_CURVE, int(20 * scene.system.fastest_order * cycle / (2 * np.pi)))
    if size > MOST_ANGLES:
        raise SceneError(
            f"a start angle needs {size} angles of the cycle of {with_article(kind)}, more than {MOST_ANGLES}"
        )
    grid = np.arange(size) * (cycle / size)
    torque = float(np.median(record.loads))
    curve = computed_error(scene, grid, torque, bool(record.back[0]))
    grid, curve = np.append(grid, cycle), np.append(curve, curve[0])
    rows = np.unique(np.linspace(0, record.theta.size - 1, min(record.theta.size, ANGLES_PER_CURVE)).astype(int))
    theta, own = record.theta[rows], te[rows]

    def off(start: float) -> float:
        return float(np.var(own - np.interp((theta + start) % cycle, grid, curve)))

    number = max(START_ANGLES, int(4 * scene.system.fastest_order * cycle / (2 * np.pi)))
    starts = np.arange(number) * (cycle / number)
    heights = np.array([off(start) for start in starts])
    lowest = np.flatnonzero((heights <= np.roll(heights, 1)) & (heights <= np.roll(heights, -1)))
    step = cycle / number
    ends: list[tuple[float, float]] = []
    for i in lowest[np.argsort(heights[lowest])][:POLISHED]:
        bounds = starts[i] - step, starts[i] + step
        end: Any = optimize.minimize_scalar(off, bounds=bounds, method="bounded", options=CLOSE)
        ends.append((float(end.fun), float(end.x)))
    angle = min(ends)[1]
    return angle if angle <= cycle / 2 else angle - cycle


def _orders(scene: Scene, record: Measurement, te: np.ndarray, curve: np.ndarray) -> tuple[OrderBeside, ...]:
    """The largest orders of both curves."""
    known = candidates(scene, record.theta, np.zeros(te.size, int))
    orders = list(known)
    if not orders:
        return ()
    measured, phases = waves(record.theta, te, orders)
    computed, own = waves(record.theta, curve, orders)
    largest = np.argsort(-np.maximum(measured, computed))[:LISTED]
    return tuple(
        OrderBeside(orders[i], known[orders[i]][0], *(float(part[i]) for part in (measured, computed, phases, own)))
        for i in sorted(largest, key=lambda i: orders[i])
    )


def _lost_motion(scene: Scene, records: list[Measurement], found: list[RecordBeside]) -> tuple[float, float] | None:
    """Mean lost motion, measured and computed, between recordings of both flanks under torques of the same size.

    Recordings whose angles are so far apart that their zeros differ are left out.
    """
    for i, ahead in enumerate(records):
        for j, behind in enumerate(records):
            same = np.isclose(abs(np.median(ahead.loads)), abs(np.median(behind.loads)), rtol=0.05)
            if ahead.back.any() or not behind.back.all() or not same:
                continue
            low = max(ahead.theta.min(), behind.theta.min())
            high = min(ahead.theta.max(), behind.theta.max())
            if high - low < 0.5 * np.ptp(ahead.theta):
                continue
            one, other = found[i], found[j]
            place = np.linspace(low, high, 4 * min(one.theta.size, other.theta.size))
            pairs = [(one.measured, other.measured), (one.computed - one.offset, other.computed - other.offset)]
            told = [float(np.mean(_at(place, other.theta, b) - _at(place, one.theta, a))) for a, b in pairs]
            if abs(told[0]) < farthest(scene):
                return told[0], told[1]
    return None


def _at(place: np.ndarray, theta: np.ndarray, values: np.ndarray) -> np.ndarray:
    order = np.argsort(theta)
    return np.interp(place, theta[order], values[order])
