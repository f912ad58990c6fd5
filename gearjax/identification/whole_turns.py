"""Whole turns that encoders of a single turn do not show: the other encoder and the first recording tell them.

The output angle counts up to whole turns only, and so does an input angle that wraps around. The encoders are not
zeroed between recordings: at the same input angle the output angle is the same, but for the TE, which is small beside
the angle of the output in a turn of the input.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gearjax.checks import GearjaxError
from gearjax.identification.measurement import Measurement, ideal, largest_error
from gearjax.scene import Scene
from gearjax.units import deg

TURN = 2 * np.pi
NEAR = 0.1  # deviation from whole turns that is no chance, as a share of the angle between two possible places
SAME = 1e-9  # turns: places of the output that are the same but for rounding


def joined(scene: Scene, records: Sequence[Measurement]) -> tuple[list[Measurement], list[str]]:
    """The recordings with their whole turns counted from those of the first one, and what was found, in words.

    Args:
        scene: the gear set.
        records: recordings; those without an output angle stay as they are.
    """
    first: Measurement | None = None
    zero, moved, notes = 0.0, [], []
    for record in records:
        if record.output is None:
            moved.append(record)
            continue
        place = float(np.median(record.error(scene)))
        inputs = 0 if first is None else _input_turns(scene, first, record, place - zero)
        left = place - _gained(scene, inputs) - zero
        outputs = round(left / TURN)
        left -= TURN * outputs
        if first is None:
            first, zero = record, left
        elif inputs:
            words = f"{inputs:+d} turns of its input angle, which wraps around, as its output angle shows beside that"
            notes.append(f"{record.name}: moved by {words} of {first.name}")
        elif abs(left) > largest_error(scene):
            words = f"{left / deg:.4g} deg from that of {first.name} at the same input angle"
            cause = "the encoders were zeroed anew between them, or whole turns of the input are missing"
            notes.append(f"{record.name}: its output angle lies {words}: {cause}")
        theta = record.theta + TURN * inputs
        moved.append(dataclasses.replace(record, theta=theta, output=record.output - TURN * outputs))
    return moved, notes


def check_joined(scene: Scene, records: Sequence[Measurement], spread: float) -> None:
    """Refuse recordings whose offsets differ by more than a transmission error can.

    Args:
        scene: the gear set.
        records: the recordings, after `joined`.
        spread: standard deviation of the encoders' offset between recordings [rad].

    Raises:
        GearjaxError: says by how much, and what may be wrong.
    """
    places = [(record.name, float(np.median(record.error(scene)))) for record in records if record.output is not None]
    for name, place in places[1:]:
        if abs(place - places[0][1]) > max(largest_error(scene), 4 * spread):
            words = f"its output angle lies {(place - places[0][1]) / deg:.4g} deg from that of {places[0][0]}"
            right = "give input angles that do not wrap around, or, if the encoders were zeroed anew, offset_spread"
            raise GearjaxError(
                f"{name}: {words} at the same input angle: whole turns of the input are missing: {right}"
            )


def _gained(scene: Scene, turns: int) -> float:
    """Angle of the output in whole turns of the input, if it turns evenly [rad]."""
    return turns * float(np.diff(ideal(scene, np.array([0.0, TURN])))[0])


def _input_turns(scene: Scene, first: Measurement, record: Measurement, apart: float) -> int:
    """Turns of the input that explain how far the output is from its place in the first recording; 0 if none do.

    Cycles of the gear set, after which it is the same, are added so that the angles of both recordings overlap.
    """
    number = round(scene.system.cycle / TURN)
    if not record.input_wraps or not scene.system.turns_evenly or abs(number * TURN / scene.system.cycle - 1) > SAME:
        return 0
    turns, each = np.arange(number), _gained(scene, 1)
    left = np.abs(np.remainder(apart - turns * each + np.pi, TURN) - np.pi)
    best = int(np.argmin(left))
    others = np.abs(np.remainder((turns - best) * each + np.pi, TURN) - np.pi)
    others[best] = TURN
    between = float(others.min())  # zero if the output comes back before slower bodies do
    if between <= SAME or left[best] > NEAR * between:
        return 0
    cycles = (first.theta.mean() - record.theta.mean()) / TURN - best
    return best + number * round(float(cycles) / number)
