"""Whole turns that encoders of a single turn do not show: the other encoder and another recording tell them.

The output angle counts up to whole turns only, and so does an input angle that wraps around. The encoders are not
zeroed between recordings: at the same input angle the output angle is the same, but for the TE and lost motion, which
are small beside the angle between two places that the output can have.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from gearjax.checks import GearjaxError
from gearjax.identification.measurement import Measurement, ideal
from gearjax.scene import Scene
from gearjax.units import deg

TURN = 2 * np.pi
NEAR = 0.1  # share of the angle between two places, up to which an output angle counts as one of them
SMALLEST = 0.5 * deg  # angle between two places that lost motion and torsion are small beside
WHOLE = 1e-9  # relative rounding of a whole number of turns
MOST_CYCLES = 1000  # cycles of the gear set after which the input has made whole turns
STARTS = np.array([0.0, 1.0, 2.5])  # input angles from which a turn is looked at [rad]
WIDTHS = 4.0  # standard deviations of the encoders' offset between recordings that are possible


class Places(NamedTuple):
    """Places of the output after whole turns of the input.

    Args:
        number: turns of the input after which all repeats: a cycle of the gear set, or the fewest cycles that are whole
            turns.
        each: angle of the output in a turn of the input [rad].
        between: smallest angle between two places, beyond whole turns of the output [rad].
    """

    number: int
    each: float
    between: float

    @classmethod
    def of(cls, scene: Scene) -> "Places | None":
        """The places; ``None`` if some are too close to be told apart, or turns of the input differ."""
        cycle = scene.system.cycle / TURN
        cycles = Fraction(cycle).limit_denominator(MOST_CYCLES)
        turning = ideal(scene, STARTS + TURN) - ideal(scene, STARTS)
        each, number = float(turning[0]), cycles.numerator
        if abs(float(cycles) / cycle - 1) > WHOLE or np.abs(turning - each).max() > WHOLE * TURN:
            return None
        between = float(np.abs(_within(np.arange(1, number) * each)).min(initial=TURN))
        return cls(number, each, between) if between > SMALLEST else None


def joined(scene: Scene, records: Sequence[Measurement], spread: float = 0.0) -> tuple[list[Measurement], list[str]]:
    """The recordings with their whole turns counted as in one of them, and what was found, in words.

    That one is the first recording whose input angle does not wrap around, or else the first one. Turns of the input
    are counted for recordings whose input angle wraps around, without other bodies turned in their seats.

    Args:
        scene: the gear set.
        records: recordings; those without an output angle stay as they are.
        spread: standard deviation of the encoders' offset between recordings [rad]; if it is large, no turns of the
            input can be counted.
    """
    first, places = _reference(records), Places.of(scene)
    if first is None:
        return list(records), []
    zero = _offset(scene, first)
    zero -= TURN * round(zero / TURN)
    moved, notes = [], []
    for record in records:
        if record.output is None:
            moved.append(record)
            continue
        left, inputs = _offset(scene, record) - zero, 0
        if places is not None and record is not first and record.input_wraps and _same_seats(record, first):
            inputs = _input_turns(places, first, record, left, spread)
            left -= places.each * inputs
        if inputs:
            words = "its output angle tells them, but for whole cycles of the gear set"
            notes.append(f"{record.name}: moved by {inputs:+d} turns of its input angle, which wraps around: {words}")
        output = record.output - TURN * round(left / TURN)
        moved.append(dataclasses.replace(record, theta=record.theta + TURN * inputs, output=output))
    cause = "the encoders were zeroed anew between them, or whole turns of the input are missing"
    return moved, [*notes, *(f"{words}: {cause}" for words, _ in _far_apart(scene, moved))]


def check_joined(scene: Scene, records: Sequence[Measurement], spread: float) -> None:
    """Refuse recordings whose offsets differ so much that whole turns of the input are missing.

    Args:
        scene: the gear set.
        records: the recordings, after `joined`.
        spread: standard deviation of the encoders' offset between recordings [rad].

    Raises:
        GearjaxError: says by how much, and what may be wrong.
    """
    for words, apart in _far_apart(scene, records):
        if apart > WIDTHS * spread:
            right = "give input angles that do not wrap around, or, if the encoders were zeroed anew, offset_spread"
            raise GearjaxError(f"{words}: whole turns of the input are missing: {right}")


def farthest(scene: Scene) -> float:
    """Difference of two recordings' offsets from which whole turns of the input may be missing [rad]."""
    places = Places.of(scene)
    return np.inf if places is None else places.between / 2


def _far_apart(scene: Scene, records: Sequence[Measurement]) -> Iterator[tuple[str, float]]:
    """Recordings from whose offset turns of the input seem to be missing: in words, and by how much [rad].

    Bodies that are turned in their seats may move the output, so that such recordings are not compared.
    """
    first, most = _reference(records), farthest(scene)
    for record in records:
        if first is None or record.output is None or not _same_seats(record, first):
            continue
        apart = _offset(scene, record) - _offset(scene, first)
        if abs(apart) > most:
            words = f"{apart / deg:.4g} deg from that of {first.name} at the same input angle"
            yield f"{record.name}: its output angle lies {words}", abs(apart)


def _reference(records: Sequence[Measurement]) -> Measurement | None:
    """The recording whose turns are known best."""
    usable = [record for record in records if record.output is not None]
    return min(usable, key=lambda record: record.input_wraps, default=None)


def _same_seats(record: Measurement, other: Measurement) -> bool:
    """Whether the same bodies were turned in their seats by the same angles."""
    return dict(record.turned) == dict(other.turned)


def _offset(scene: Scene, record: Measurement) -> float:
    """Offset of the output angle from the ideal one [rad]."""
    return float(np.median(record.error(scene)))


def _within(angle: np.ndarray) -> np.ndarray:
    """Angles between minus half a turn and half a turn [rad]."""
    return np.remainder(angle + np.pi, TURN) - np.pi


def _input_turns(places: Places, first: Measurement, record: Measurement, apart: float, spread: float) -> int:
    """Turns of the input that explain how far the output is from its place in the first recording; 0 if none do.

    Cycles of the gear set, after which it is the same, are added so that the angles of both recordings overlap.
    """
    near = NEAR * places.between
    left = np.abs(_within(apart - np.arange(places.number) * places.each))
    best = int(np.argmin(left))
    if WIDTHS * spread > near or left[best] > near:
        return 0
    cycles = (first.theta.mean() - record.theta.mean()) / TURN - best
    return best + places.number * round(float(cycles) / places.number)
