"""Accuracy and cost of the models that the parts of a scene offer, under static torque."""

import dataclasses
import warnings
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from gearjax.analysis import transmission_error
from gearjax.analysis.metrics import FewAngles
from gearjax.checks import FewCandidates, SceneError
from gearjax.choosing import Choosing
from gearjax.progress import Progress, silent
from gearjax.run import METRICS
from gearjax.scene import Scene
from gearjax.timing import Stopwatch


@dataclasses.dataclass(frozen=True)
class StaticChoice:
    """Accuracy and cost of one model of a part under static torque.

    Args:
        part: the part of the scene.
        name: name of the choice.
        error: largest deviation of the metrics of the static TE under all torques from the most exact choice of the
            part [rad].
        force_error: largest deviation of the load of a pair of teeth, over the largest load [-].
        seconds: time of one torque, without compilation [s].
        compile_seconds: compile time [s].
    """

    part: str
    name: str
    error: float
    force_error: float
    seconds: float
    compile_seconds: float


def choices_of(scene: Scene) -> dict[str, dict[str, Scene]]:
    """The scene with each model that one of its parts offers, by part and name; the most exact model is last.

    Models that do not go together with another part of the scene are left out, and parts with a single model.
    """
    changes: dict[str, dict[str, dict[str, Any]]] = {}
    for slot in (field.name for field in dataclasses.fields(scene)):
        own = getattr(scene, slot)
        offered = own.choices() if isinstance(own, Choosing) else {}
        changes[slot] = {name: {slot: part} for name, part in offered.items()}
    if scene.supports:
        changes["supports"] = {"rigid bearings": {"supports": {}, "body_inertia": {}}, "elastic bearings": {}}
    found = {part: dict(_possible(scene, offered)) for part, offered in changes.items()}
    return {part: chosen for part, chosen in found.items() if len(chosen) > 1}


def _possible(scene: Scene, offered: dict[str, dict[str, Any]]) -> Iterator[tuple[str, Scene]]:
    """The scene with each of some changes, by name, but for those that it refuses."""
    for name, parts in offered.items():
        try:
            yield name, dataclasses.replace(scene, **parts)
        except SceneError:
            continue


def static_choices(scene: Scene, progress: Progress = silent) -> list[StaticChoice]:
    """Accuracy and cost of each choice under static torque, compared with the most exact choice of the same part.

    Empty if no part offers a choice, or the run section lists no static analysis.

    Args:
        scene: a scene with a run section.
        progress: called with a line of text for each choice.
    """
    if scene.run is None or "static" not in scene.run.analyses:
        return []
    return [row for part, chosen in choices_of(scene).items() for row in _compared(part, chosen, progress)]


def _compared(part: str, chosen: dict[str, Scene], progress: Progress) -> list[StaticChoice]:
    metrics, loads, times = {}, {}, {}
    for name, scene in chosen.items():
        run = scene.run
        assert run is not None
        theta = scene.system.input_speed * jnp.asarray(run.times)
        with Stopwatch() as watch, warnings.catch_warnings():
            warnings.simplefilter("ignore", FewAngles)  # all choices are compared at the same angles
            warnings.simplefilter("ignore", FewCandidates)
            errors = [transmission_error(scene, theta, torque) for torque in run.torques]
            metrics[name] = np.array([[float(getattr(te, metric)) for metric in METRICS] for te in errors])
        loads[name] = np.stack([np.asarray(te.pair_forces) for te in errors])
        times[name] = watch.seconds / len(run.torques), watch.compile_seconds
        progress(f"static TE, {part}: {name}: {times[name][0]:.3g} s")
    exact = list(chosen)[-1]
    largest = float(loads[exact].max())
    return [
        StaticChoice(
            part,
            name,
            float(np.abs(metrics[name] - metrics[exact]).max()),
            float(np.abs(loads[name] - loads[exact]).max()) / largest if largest > 0 else 0.0,
            *times[name],
        )
        for name in chosen
    ]
