"""Accuracy of measured gears by ISO 1328-1:2013: deviations of profile, helix and pitch, and run-out."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.contact import GearSize
from gearjax.errors import MeasuredFlank, MeasuredPitch
from gearjax.errors.measured import FLANKS
from gearjax.scene import Scene
from gearjax.tolerance.grades import (
    flank_tolerance,
    run_out_tolerance,
    single_pitch_tolerance,
    total_pitch_tolerance,
)
from gearjax.units import um

GRADES = range(1, 12)
EVEN = 1001  # places at which a trace is evaluated
CLOSE = 1e-9  # um by which rounding may take a deviation above its limit


class GradedDeviation(NamedTuple):
    """A deviation of a gear by ISO 1328-1.

    Args:
        value: largest deviation of all teeth that were measured, of slopes with its sign [m].
        grade: the finest grade that allows the deviation, 1 to 11; ``None`` if even the coarsest does not.
    """

    value: float
    grade: int | None

    @property
    def words(self) -> str:
        """The grade in words, such as ``grade 6`` or ``beyond grade 11``."""
        return f"beyond grade {GRADES[-1]}" if self.grade is None else f"grade {self.grade}"


@arguments.checked()
def accuracy_grades(scene: Scene, body: str, flank: str = "driving") -> dict[str, GradedDeviation]:
    """Deviations of a measured gear, and their accuracy grades (ISO 1328-1:2013).

    Profiles are evaluated in the middle of the face, helices in the middle of the profile, both over the whole measured
    range. Values measured from the involute contain designed reliefs and crowning, which then count as deviations; take
    them out before (`MeasuredFlank.without`, in a configuration ``contains``). Slope deviations are those of the
    least-squares line, positive with more material at the tip, or at the high end of the face. Form deviations are the
    range about this line, total deviations the range of the trace. If several measured flanks are added, such as a grid
    of profiles and a grid of helices, each is graded by itself and the largest deviation counts.

    Args:
        scene: a scene with `MeasuredFlank` or `MeasuredPitch` of the body among its errors.
        body: the gear.
        flank: ``"driving"`` or ``"back"``.

    Returns:
        The deviations that were measured, by name: ``f_H_alpha``, ``f_f_alpha`` and ``F_alpha`` of profiles,
        ``f_H_beta``, ``f_f_beta`` and ``F_beta`` of helices, ``f_pt`` and ``F_p`` of pitches, and ``F_r``, the run-out
        of a ball that touches the flanks of the tooth spaces at the reference circle, from the pitches of both flanks.

    Raises:
        ParameterError: there is no such body or flank, or a size is outside the range of the standard.
        SceneError: no deviation of the gear was measured.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/helical/guo_2018_measured.toml")
        >>> gj.accuracy_grades(scene, "wheel")["F_p"].grade
        5
    """
    if body not in scene.system.bodies:
        raise ParameterError("body", body, nearest(body, scene.system.bodies))
    if flank not in FLANKS:
        raise ParameterError("flank", flank, nearest(flank, FLANKS))
    own = [error for error in scene.errors.values() if error.body == body]
    flanks = [error for error in own if isinstance(error, MeasuredFlank) and error.tells_of(flank)]
    pitches = [error for error in own if isinstance(error, MeasuredPitch)]
    size = scene.system.gear_size(body)
    if size is None or not (flanks or any(pitch.tells_of(flank) for pitch in pitches)):
        words = f"the scene lists no measured_flank or measured_pitch of the {flank} flanks of {body}"
        raise SceneError(f"accuracy grades: {words}")
    values: dict[str, float] = {}
    for measured in flanks:
        for name, value in _of_flank(measured, size.internal).items():
            values[name] = max(values.get(name, 0.0), value, key=abs)
    values |= _of_pitches(pitches, flank, size, drives=body == scene.system.meshes[0][0])
    if not values:
        raise SceneError(f"accuracy grades: single points of {body} were measured, no profile, helix or pitches")
    limits = _limits(size)
    return {name: GradedDeviation(value, _grade(abs(value), limits[name])) for name, value in values.items()}


def _limits(size: GearSize) -> Mapping[str, Callable[[int], float]]:
    """Limit of each deviation at a grade [m]."""
    module, diameter, width = (float(part) for part in (size.module, size.diameter, size.width))
    of_pitch = {"f_pt": single_pitch_tolerance, "F_p": total_pitch_tolerance, "F_r": run_out_tolerance}
    limits: dict[str, Callable[[int], float]] = {
        name: lambda grade, limit=limit: limit(grade, module, diameter) for name, limit in of_pitch.items()
    }
    for way in ("alpha", "beta"):
        for name in (f"f_H_{way}", f"f_f_{way}", f"F_{way}"):
            limits[name] = lambda grade, name=name: flank_tolerance(name, grade, module, diameter, width)
    return limits


def _grade(value: float, limit: Callable[[int], float]) -> int | None:
    return next((grade for grade in GRADES if value <= limit(grade) + CLOSE * um), None)


def _of_flank(measured: MeasuredFlank, internal: bool) -> dict[str, float]:
    """Deviations of profiles and helices, the largest of all teeth [m]."""
    grid, roll, across = (np.asarray(part, float) for part in (measured.grid, measured.roll, measured.across))
    values = {}
    for way, places, traces in (
        ("alpha", roll, grid[:, :, _nearest(across, 0.0)]),
        ("beta", across, grid[:, _nearest(roll, _middle(roll)), :]),
    ):
        if places.size > 1:
            each = np.array([_of_trace(places, trace) for trace in traces])
            for place, name in enumerate((f"f_H_{way}", f"f_f_{way}", f"F_{way}")):
                values[name] = float(max(each[:, place], key=abs))
    if internal and "f_H_alpha" in values:
        values["f_H_alpha"] = -values["f_H_alpha"]  # an internal gear has its tip at the least length of roll
    return values


def _middle(places: np.ndarray) -> float:
    return 0.5 * float(places[0] + places[-1])


def _nearest(places: np.ndarray, value: float) -> int:
    return int(np.argmin(np.abs(places - value)))


def _of_trace(places: np.ndarray, trace: np.ndarray) -> tuple[float, float, float]:
    """Slope, form and total deviation of a trace [m]."""
    even = np.linspace(-0.5, 0.5, EVEN)
    values = np.interp(_middle(places) + even * (places[-1] - places[0]), places, trace)
    slope = float(values @ even / (even @ even))
    rest = values - slope * even
    return slope, float(np.ptp(rest)), float(np.ptp(trace))


def _of_pitches(pitches: list[MeasuredPitch], flank: str, size: GearSize, drives: bool) -> dict[str, float]:
    """Single and total pitch deviation, and run-out of a ball in the tooth spaces [m]."""
    by_flank: dict[str, np.ndarray] = {}
    for pitch in pitches:
        for name in FLANKS if pitch.flank == "both" else (pitch.flank,):
            one = np.broadcast_to(np.asarray(pitch.deviation, float), (size.teeth,))
            by_flank[name] = by_flank.get(name, np.zeros(size.teeth)) + one
    if flank not in by_flank:
        return {}
    own = by_flank[flank]
    single = np.roll(own, -1) - own
    values = {"f_pt": float(np.max(np.abs(single))), "F_p": float(np.ptp(own))}
    if len(by_flank) == len(FLANKS) and all(pitch.flank != "both" for pitch in pitches):
        driving, back = by_flank["driving"], by_flank["back"]
        # a tooth space of the driver lies between a driving flank and the back flank of the tooth ahead of it; a tooth
        # space of the driven gear lies between a driving flank and the back flank of the next tooth
        room = np.roll(back, 1) - driving if drives else driving - np.roll(back, -1)
        # a ball touches both flanks half a space beside the line of its centre, by which their normals are turned
        slant = float(size.pressure_angle) + (-1 if size.internal else 1) * float(size.space)
        values["F_r"] = float(np.ptp(room)) * np.cos(float(size.pressure_angle)) / (2 * np.sin(slant))
    return values
