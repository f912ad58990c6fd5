"""Reassembly of a measured gear set: turns of its bodies in their seats that make it more accurate."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError, nearest
from gearjax.identification.fit import without_further
from gearjax.identification.found import Identification
from gearjax.identification.measurement import Measurement
from gearjax.identification.model import Problem
from gearjax.identification.rows import rows_of
from gearjax.identification.tables import Tables, curves_at
from gearjax.identification.unknowns import turned
from gearjax.progress import Progress, silent
from gearjax.typing import Array
from gearjax.units import deg

METRICS = ("std", "peak_to_peak")
DRAWS, COARSE_DRAWS = 200, 16
ROWS = 1021  # per curve, at least; a prime, so that rows do not meet the same phases of a wave again
PER_TURN = 24  # rows per cycle of the highest order
PLACES = 24  # angles of a freely turning body on the first grid
MOST_CHOICES = 1200  # combinations of a grid; beyond it, bodies are turned one after the other
SWEEPS = 4
LANES = 2_000_000  # positions computed at once
SECOND_TRUTHS, SECOND_DRAWS = 24, 4
FEW_TRUTHS = 6  # for scenes whose gaps are not linear in the unknowns (`Plain`), which take longer
SECOND_TURN = 90 * deg


@dataclasses.dataclass(frozen=True)
class Gain:
    """Ratio of a metric after to before reassembly, over the gear sets that the recordings leave possible.

    Args:
        low, median, high: quantiles of 5 %, 50 % and 95 % of the ratio.
        worse: share of the gear sets that get worse.
    """

    low: float
    median: float
    high: float
    worse: float

    @classmethod
    def of(cls, ratios: np.ndarray) -> "Gain":
        """The gain from ratios of after to before."""
        low, median, high = (float(part) for part in np.quantile(ratios, [0.05, 0.5, 0.95]))
        return cls(low, median, high, float((ratios > 1).mean()))


@dataclasses.dataclass(frozen=True)
class Reassembly:
    """Recommended turns of bodies in their seats.

    Args:
        turns: angle by which to turn the body of each error, added to the phase of the error [rad].
        metric: the metric that was minimised.
        before, after: mean of the metric over the gear sets that the recordings leave possible [rad].
        gain: ratio of the metric after to before.
        second: the same ratio if another recording is made first, after turning one of the bodies by 90 deg; ``None``
            if the recordings hide nothing of the bodies and have one solution.
        second_words: description of that recording.
    """

    turns: dict[str, float]
    metric: str
    before: float
    after: float
    gain: Gain
    second: Gain | None
    second_words: str

    def as_json(self) -> dict[str, Any]:
        """The results for a file, in degrees and arcmin."""
        return {
            "turn_deg": {path: float(np.degrees(angle)) for path, angle in self.turns.items()},
            "metric": self.metric,
            "before_arcmin": float(np.degrees(self.before) * 60),
            "after_arcmin": float(np.degrees(self.after) * 60),
            "gain": dataclasses.asdict(self.gain),
            "with_second_recording": None if self.second is None else dataclasses.asdict(self.second),
            "second_recording": self.second_words,
        }


def _steps(name: str, value: Any) -> None:
    if not isinstance(value, Mapping):
        raise ParameterError(name, value, 'must be by error: {"errors.planet_1": 50} for 50 positions per turn')
    for path, places in value.items():
        arguments.whole(1)(f"{name} of {path}", places)


def _metric(name: str, value: Any) -> None:
    if value not in METRICS:
        raise ParameterError(name, value, nearest(value, METRICS))


@arguments.checked(
    found=arguments.an(Identification, "must be a result of gj.identify(...)"),
    steps=_steps,
    metric=_metric,
    draws=arguments.whole(2),
    key=arguments.whole(0),
    torque=arguments.torque,
)
def reassemble(
    found: Identification,
    where: str | Sequence[str] | None = None,
    *,
    steps: Mapping[str, int] | None = None,
    metric: str = "std",
    torque: float = 0.0,
    draws: int = DRAWS,
    key: int = 0,
    progress: Progress = silent,
) -> Reassembly:
    """Find turns of bodies in their seats that make the expected transmission error small.

    Gear sets that the recordings leave possible are drawn (`Identification.draws`). The turns minimise the mean of the
    metric over these draws; the gain is reported with its spread, and with the share of draws that get worse. Curves
    are those without load or under static load, also where the errors were identified in motion.

    Args:
        found: result of `identify`.
        where: errors whose bodies can be turned, such as ``errors.planet_1``; by default all eccentricities found.
        steps: number of positions per turn in which a body fits (teeth, splines, bolts), by error; a body that is not
            listed fits at any angle.
        metric: ``"std"`` or ``"peak_to_peak"`` of the transmission error over a cycle.
        torque: load torque on the output, for the static TE under it; 0 for the no-load TE [N m].
        draws: number of draws.
        key: seed of the draws.
        progress: called with a line of text now and then.

    Raises:
        ParameterError: an error was not found, or is no eccentricity.

    Example:
        >>> import gearjax as gj, dataclasses
        >>> scene = dataclasses.replace(gj.load("configs/two_kv/wang_2020.toml"), reference=None)
        >>> runs = [gj.synthetic_measurement(scene, torque=t, noise=1e-5) for t in (10.0, 100.0, -10.0)]
        >>> advice = gj.reassemble(gj.identify(scene, runs, suggest=False), ["errors.output_wheel"])
        >>> advice.after <= advice.before
        True
    """
    vectors = found.unknowns.vectors
    paths = list(vectors) if where is None else [where] if isinstance(where, str) else list(where)
    for argument, path in [*(("where", path) for path in paths), *(("steps", path) for path in steps or {})]:
        if path not in vectors:
            raise ParameterError(argument, path, f"is not an identified eccentricity; {nearest(path, vectors)}")
    for path in steps or {}:
        if path not in paths:
            raise ParameterError("steps", path, f"is not among the errors in where; {nearest(path, paths)}")
    if not paths:
        raise ParameterError("where", (), f"names no identified eccentricity; {nearest('', vectors)}")
    if torque < 0 and not (found.scene.has_back or found.scene.layout.sides_turn):
        raise ParameterError("torque", torque, "loads the back flanks, which this scene lacks")
    if torque and not found.model.loaded:
        raise ParameterError("torque", torque, "needs recordings under torque: the stiffness was not identified")
    progress(f"turning {', '.join(path.partition('.')[2] for path in paths)}")
    turning = _Turning(found, paths, steps or {}, metric, torque)
    drawn = found.draws(draws, key)
    best = turning.best(drawn[:COARSE_DRAWS], drawn)
    judged = found.draws(draws, key + 1)  # turns look too good on the draws for which they were chosen
    before, after = turning.values(judged, np.zeros((1, len(paths))))[0], turning.values(judged, best[None])[0]
    second, words = _with_second(found, turning, drawn, key)
    return Reassembly(
        dict(zip(paths, (float(angle) for angle in best), strict=True)),
        metric,
        float(before.mean()),
        float(after.mean()),
        Gain.of(after / before),
        second,
        words,
    )


class _Turning:
    """Metrics of TE curves over a cycle, for draws of the gear set and turns of its bodies."""

    def __init__(self, found: Identification, paths: list[str], steps: Mapping[str, int], metric: str, torque: float):
        scene = found.scene
        number = max(ROWS, int(PER_TURN * scene.system.fastest_order * scene.system.cycle / (2 * np.pi)))
        theta = np.linspace(
            0.0, scene.system.cycle, min(number, (20 if found.model.straight else 2) * ROWS), endpoint=False
        )
        record = Measurement(theta, te=np.zeros(theta.shape), torque=np.full(theta.shape, torque))
        self._curves = Problem(found.model.beside([record]), rows_of([record], scene, [], False))
        self._rows = theta.size
        self.found, self.paths, self.steps, self.metric = found, paths, steps, metric

    def values(self, drawn: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Metric of each draw after each choice of turns, shape (choice, draw) [rad]."""
        unknowns = self.found.unknowns
        every = np.stack([turned(unknowns, dict(zip(self.paths, each, strict=True))) for each in turns])
        points = np.einsum("cuv,dv->cdu", every, drawn).reshape(-1, drawn.shape[1])
        contacts = self._curves.model.lever.shape[0] if isinstance(self._curves.model, Tables) else 1
        size = 1 << max(0, (LANES // (self._rows * max(1, contacts // 4))).bit_length() - 1)
        size = min(size, 1 << max(0, (len(points) - 1).bit_length()))
        told = []
        for begin in range(0, len(points), size):
            part = points[begin : begin + size]
            part = np.concatenate([part, np.repeat(part[-1:], size - len(part), axis=0)])
            curves = self._te(part)[: len(points) - begin]
            told.append(np.ptp(curves, axis=1) if self.metric == "peak_to_peak" else curves.std(axis=1))
        return np.concatenate(told).reshape(len(turns), len(drawn))

    def _te(self, points: np.ndarray) -> np.ndarray:
        curves: Array = curves_at(self._curves.model, jnp.asarray(points))
        return np.asarray(curves)[:, : self._rows]

    def best(self, few: np.ndarray, many: np.ndarray | None) -> np.ndarray:
        """Turns with the least expected metric: first on a grid with a few draws, then nearby with all draws."""
        places = [self._places(path) for path in self.paths]
        if np.prod([len(each) for each in places], dtype=float) <= MOST_CHOICES:
            choices = np.array(list(itertools.product(*places)))
            best = choices[int(np.argmin(self.values(few, choices).mean(axis=1)))]
        else:
            best = self._one_by_one(few, places)
        free = np.array([path not in self.steps for path in self.paths])
        if many is not None and free.any():
            best = self._nearby(many, best, free)
        # bodies are turned only if this is better than leaving them in place
        draws = few if many is None else many
        still, moved = self.values(draws, np.stack([np.zeros(len(self.paths)), best])).mean(axis=1)
        return best if moved < still else np.zeros(len(self.paths))

    def _places(self, path: str) -> np.ndarray:
        number = self.steps.get(path, PLACES)
        turns = np.arange(number) * (2 * np.pi / number)
        return (turns + np.pi) % (2 * np.pi) - np.pi if number > 2 else turns

    def _one_by_one(self, draws: np.ndarray, places: list[np.ndarray]) -> np.ndarray:
        best = np.zeros(len(places))
        for _ in range(SWEEPS):
            for i, each in enumerate(places):
                choices = np.repeat(best[None], len(each) + 1, axis=0)
                choices[:-1, i] = each
                best = choices[int(np.argmin(self.values(draws, choices).mean(axis=1)))]
        return best

    def _nearby(self, draws: np.ndarray, best: np.ndarray, free: np.ndarray) -> np.ndarray:
        from scipy import optimize

        def expected(angles: np.ndarray) -> float:
            turns = best.copy()
            turns[free] = angles
            return float(self.values(draws, turns[None]).mean())

        size = 2 * np.pi / PLACES
        simplex = np.concatenate([best[free][None], best[free] + 0.5 * size * np.eye(int(free.sum()))])
        options = {
            "maxfev": (60 if self.found.model.straight else 10) * int(free.sum()),
            "xatol": 1e-3,
            "fatol": 1e-12,
            "initial_simplex": simplex,
        }
        end = optimize.minimize(expected, best[free], method="Nelder-Mead", options=options)
        turns = best.copy()
        turns[free] = (end.x + np.pi) % (2 * np.pi) - np.pi
        return turns


def _with_second(found: Identification, turning: _Turning, drawn: np.ndarray, key: int) -> tuple[Gain | None, str]:
    """Gain if a further recording is made first, after turning one of the bodies.

    Drawn gear sets serve as the truth. The information of the further recording is added to that of the fit, to first
    order.
    """
    hidden = found.is_hidden
    vectors = found.unknowns.vectors
    turnable = [path for path in turning.paths if hidden[list(vectors[path])].any()]
    if not turnable and not len(found.fit.others):
        return None, ""
    path = turnable[0] if turnable else turning.paths[0]
    first = found.records[int(np.argmax([abs(np.median(record.loads)) for record in found.records]))]
    theta = np.linspace(first.theta.min(), first.theta.max(), min(2000, first.theta.size))
    loads = np.full(theta.shape, float(np.median(first.loads)))
    record = Measurement(theta, te=np.zeros(theta.shape), torque=loads, turned={path: SECOND_TURN})
    problem = Problem(found.model.beside([record]), rows_of([record], found.scene, [], False))
    rng, size = np.random.default_rng(key + 1), len(found.unknowns.each)
    spread = float(np.sqrt(np.mean(found.fit.values[[i for pair in vectors.values() for i in pair]] ** 2))) or 1.0
    share = first.theta.size / theta.size
    # information of the recordings so far and of the priors
    before = without_further(found.fit.matrix + np.diag(found.fit.known.precision), size) / found.fit.sigma**2
    before = before + np.eye(size) / (10 * spread) ** 2
    ratios = []
    for truth in drawn[: SECOND_TRUTHS if found.model.straight else FEW_TRUTHS]:
        _, jacobian = problem.curve(np.concatenate([truth, [0.0]]))
        jacobian = jacobian - jacobian.mean(axis=0)
        information = before + share * jacobian[:, :size].T @ jacobian[:, :size] / found.fit.sigma**2
        factor = np.linalg.cholesky(np.linalg.inv(information))
        known = truth + (factor @ rng.standard_normal((size, SECOND_DRAWS))).T
        best = turning.best(known, None)
        now, then = turning.values(truth[None], np.stack([np.zeros(len(best)), best]))[:, 0]
        ratios.append(then / now)
    body = path.partition(".")[2]
    words = f"{first.name} again after turning {body} by {SECOND_TURN / deg:g} deg in its seat"
    return Gain.of(np.array(ratios)), words
