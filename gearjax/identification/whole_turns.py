"""Whole turns that encoders of a single turn do not show: the other encoder and another recording tell them.

The output angle counts up to whole turns only, and so does an input angle that wraps around. The encoders are not
zeroed between recordings: at the same input angle the output angle is the same, but for the TE and lost motion, which
are small beside the angle between two places that the output can have.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gearjax.checks import GearjaxError
from gearjax.identification.measurement import Measurement, ideal
from gearjax.scene import Scene
from gearjax.units import deg

TURN = 2 * np.pi
NEAR = 0.1  # share of the angle between two places, up to which an output angle counts as one of them
SMALLEST = 0.5 * deg  # angle between two places that lost motion and torsion are small beside
WHOLE = 1e-9  # relative rounding of a whole number of turns
WIDTHS = 4.0  # standard deviations of the encoders' offset between recordings that are possible


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
    first = _reference(records)
    if first is None:
        return list(records), []
    place = _place(scene, first)
    zero = place - TURN * round(place / TURN)
    moved, notes = [], []
    for record in records:
        if record.output is None:
            moved.append(record)
            continue
        apart = _place(scene, record) - zero
        countable = record is not first and record.input_wraps and dict(record.turned) == dict(first.turned)
        inputs = _input_turns(scene, first, record, apart, spread) if countable else 0
        left = apart - (_gained(scene) * inputs if inputs else 0.0)
        outputs = round(left / TURN)
        if inputs:
            words = "its output angle tells them, but for whole cycles of the gear set"
            notes.append(f"{record.name}: moved by {inputs:+d} turns of its input angle, which wraps around: {words}")
        elif _too_far(scene, first, record, left - TURN * outputs):
            words = f"{(left - TURN * outputs) / deg:.4g} deg from that of {first.name} at the same input angle"
            cause = "the encoders were zeroed anew between them, or whole turns of the input are missing"
            notes.append(f"{record.name}: its output angle lies {words}: {cause}")
        theta, output = record.theta + TURN * inputs, record.output - TURN * outputs
        moved.append(dataclasses.replace(record, theta=theta, output=output))
    return moved, notes


def check_joined(scene: Scene, records: Sequence[Measurement], spread: float) -> None:
    """Refuse recordings whose offsets differ so much that whole turns of the input are missing.

    Args:
        scene: the gear set.
        records: the recordings, after `joined`.
        spread: standard deviation of the encoders' offset between recordings [rad].

    Raises:
        GearjaxError: says by how much, and what may be wrong.
    """
    first = _reference(records)
    for record in records:
        if first is None or record.output is None:
            continue
        apart = _place(scene, record) - _place(scene, first)
        if _too_far(scene, first, record, apart) and abs(apart) > WIDTHS * spread:
            words = f"its output angle lies {apart / deg:.4g} deg from that of {first.name} at the same input angle"
            right = "give input angles that do not wrap around, or, if the encoders were zeroed anew, offset_spread"
            raise GearjaxError(f"{record.name}: {words}: whole turns of the input are missing: {right}")


def farthest(scene: Scene) -> float:
    """Difference of two recordings' offsets from which whole turns of the input may be missing [rad]."""
    between = _between(scene)
    return between / 2 if between > SMALLEST else np.inf


def _reference(records: Sequence[Measurement]) -> Measurement | None:
    """The recording whose turns are known best."""
    usable = [record for record in records if record.output is not None]
    return min(usable, key=lambda record: record.input_wraps, default=None)


def _place(scene: Scene, record: Measurement) -> float:
    """Angle of the output beside the ideal one [rad]."""
    return float(np.median(record.error(scene)))


def _too_far(scene: Scene, first: Measurement, record: Measurement, apart: float) -> bool:
    """Whether an offset shows that turns are missing; bodies that are turned in their seats may move the output."""
    return dict(record.turned) == dict(first.turned) and abs(apart) > farthest(scene)


def _gained(scene: Scene) -> float:
    """Angle of the output in a turn of the input, if it turns evenly [rad]."""
    return float(np.diff(ideal(scene, np.array([0.0, TURN])))[0])


def _turns(scene: Scene) -> int:
    """Turns of the input in a cycle of the gear set; 0 if it does not turn evenly, or not in whole turns."""
    number = round(scene.system.cycle / TURN)
    whole = abs(number * TURN / scene.system.cycle - 1) < WHOLE
    return number if whole and scene.system.turns_evenly else 0


def _between(scene: Scene) -> float:
    """Smallest angle between the places of the output after whole turns of the input; 0 if some are the same [rad]."""
    number = _turns(scene)
    others = np.arange(1, number) * _gained(scene) if number else np.zeros(1)
    return float(np.abs(_within(others)).min(initial=TURN))


def _within(angle: np.ndarray) -> np.ndarray:
    """Angles between minus half a turn and half a turn [rad]."""
    return np.remainder(angle + np.pi, TURN) - np.pi


def _input_turns(scene: Scene, first: Measurement, record: Measurement, apart: float, spread: float) -> int:
    """Turns of the input that explain how far the output is from its place in the first recording; 0 if none do.

    Cycles of the gear set, after which it is the same, are added so that the angles of both recordings overlap.
    """
    number, between = _turns(scene), _between(scene)
    if between < SMALLEST or WIDTHS * spread > NEAR * between:
        return 0
    left = np.abs(_within(apart - np.arange(number) * _gained(scene)))
    best = int(np.argmin(left))
    if left[best] > NEAR * between:
        return 0
    cycles = (first.theta.mean() - record.theta.mean()) / TURN - best
    return best + number * round(float(cycles) / number)
