"""Suggestions for further recordings that would determine what the recordings so far hide."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gearjax.identification.fit import Fit
from gearjax.identification.measurement import Measurement
from gearjax.identification.model import Model, Problem
from gearjax.identification.rows import rows_of
from gearjax.identification.visible import Visible, hidden_directions, hidden_in_words
from gearjax.progress import Progress, silent
from gearjax.units import deg

ROWS = 2000
TURN = 90 * deg
LIGHT = 0.1  # of the smallest torque so far
TOLD_APART = 30.0  # variances of a row: sum of squares by which another solution must differ to be distinguished


@dataclasses.dataclass(frozen=True)
class Suggestion:
    """A further recording.

    Args:
        words: what to record.
        hidden: number of directions that stay hidden with this recording.
        shows: what the recording would show, in words.
    """

    words: str
    hidden: int
    shows: tuple[str, ...]


def suggestions(
    model: Model, fit: Fit, told: Visible, records: Sequence[Measurement], progress: Progress = silent
) -> list[Suggestion]:
    """Further recordings that would show hidden directions, or distinguish between solutions; the best first.

    Each recording is tried on the model: its rows are computed at the solution, with the noise found, and added to the
    measured rows.
    """
    if not len(told.hidden) and not len(fit.others):
        return []
    progress("searching for further recordings that would determine more")
    found = []
    before = set(hidden_in_words(model.unknowns, told.hidden))
    for words, record in _tried(model, told, records):
        if record.back.any() and not model.scene.has_back and not model.scene.layout.sides_turn:
            continue
        hidden, apart, far = _with(model, fit, record)
        after = set(hidden_in_words(model.unknowns, hidden))
        shows = []
        if len(hidden) < len(told.hidden):
            shows.append(f"{len(told.hidden) - len(hidden)} of {len(told.hidden)} hidden directions")
        if apart:
            every, number = apart == len(fit.others), 1 + len(fit.others)
            shows.append(
                f"which of {number} solutions is right" if every else f"that {apart} of {number} solutions are wrong"
            )
        if far and not shows:
            shows.append("how far the hidden directions reach, at least in part")
        if shows:
            found.append((len(hidden), -apart, len(after - before), Suggestion(words, len(hidden), tuple(shows))))
    found.sort(key=lambda each: each[:3])
    return [each[3] for each in found]


def _tried(model: Model, told: Visible, records: Sequence[Measurement]) -> list[tuple[str, Measurement]]:
    """Recordings to try, with a description of each."""
    first = records[0]
    theta = np.linspace(first.theta.min(), first.theta.max(), min(ROWS, first.theta.size))
    flat = np.zeros(theta.shape)
    torques = [float(np.median(record.loads)) for record in records]
    largest = max(torques, key=abs)
    tried = []
    if model.loaded and largest:
        light = LIGHT * min(abs(torque) for torque in torques if torque) * np.sign(largest)
        tried.append((f"the same recording under a light torque of {light:.3g} N m", light, {}))
        if not any(torque * largest < 0 for torque in torques):
            tried.append((f"the same recording under a driving torque, {-largest:.4g} N m", -largest, {}))
        if len(set(torques)) == 1:
            tried.append((f"the same recording under another torque, {0.3 * largest:.4g} N m", 0.3 * largest, {}))
    hidden = told.is_hidden(len(model.unknowns.each))
    tells = largest if model.loaded else 0.0
    for path, (along, across) in model.unknowns.vectors.items():
        if hidden[along] or hidden[across]:
            body = path.partition(".")[2]
            tried.append((f"the same recording after turning {body} by 90 deg in its seat", tells, {path: TURN}))
    return [
        (words, Measurement(theta, te=flat, torque=np.full(theta.shape, torque), turned=turned))
        for words, torque, turned in tried
    ]


def _with(model: Model, fit: Fit, record: Measurement) -> tuple[np.ndarray, int, int]:
    """Directions that stay hidden with a further recording, and how many other solutions it distinguishes.

    The last number is that of the points in the same flat valley that it distinguishes.
    """
    size = len(model.unknowns.each)
    rows = rows_of([record], model.scene, [], False)
    problem = Problem(model.beside([record]), rows)
    curve, jacobian = problem.curve(fit.values[: size + 1])
    more = np.zeros((rows.theta.size, fit.values.size))
    more[:, :size] = jacobian[:, :size] - jacobian[:, :size].mean(axis=0)  # the recording has an unknown offset
    whole = dataclasses.replace(fit, matrix=fit.matrix + more.T @ more)

    def apart(points: np.ndarray) -> int:
        curves = (problem.curve(point[: size + 1])[0] for point in points)
        return sum(_off(other - curve) > TOLD_APART * fit.sigma**2 for other in curves)

    return hidden_directions(whole, size), apart(fit.others), apart(fit.within)


def _off(difference: np.ndarray) -> float:
    return float(((difference - difference.mean()) ** 2).sum())
