"""The run section: what to compute."""

import hashlib
import json
import math
from typing import Any

from gearjax import units
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.config.quantities import read_quantity
from gearjax.config.tables import Key, known_keys, read_whole, require_keys
from gearjax.run import ANALYSES, METRICS, NEEDS, Published, Run
from gearjax.scene import Scene
from gearjax.scene_checks import require

STARTS = ("equilibrium", "zero")
MOST_SAMPLES = 10_000_000
RUN_KEYS = {
    "duration": Key('a time such as "3 s"', '"3 s"', required=True),
    "samples": Key(f"a whole number from 2 to {MOST_SAMPLES}", "3001", required=True),
    "analyses": Key(f"a list of: {', '.join(ANALYSES)}", '["no_load"]', required=True),
    "torques": Key('a list of torques such as ["30 N*m"]', '["30 N*m"]', "[]"),
    "start": Key('"equilibrium" or "zero"', '"zero"', '"equilibrium"'),
    "settle": Key('a time from "0 s" to below duration', '"0.05 s"', '"0 s"'),
}
PUBLISHED_KEYS = {
    "analysis": Key(f"one of {', '.join(ANALYSES)}", '"no_load"', required=True),
    "torque": Key('a torque such as "30 N*m"', '"30 N*m"', '"0 N*m"'),
    "note": Key("a text in quotes", '"where the values come from"', '""'),
    "configuration": Key("the eight digits of a configuration, in quotes", '"0123abcd"', '""'),
    "duration": Key("a time: the length of the record that the values are of", '"3 s"', "any length"),
    **{name: Key('an angle such as "1.2 arcmin"', '"1.2 arcmin"') for name in METRICS},
}


def read_run(table: dict[str, Any], published: tuple[Published, ...], scene: Scene) -> Run:
    """Read the run section, add the published values, and check that the scene has what the analyses need.

    Raises:
        ParameterError: a value is wrong.
        SceneError: an analysis needs a section that the scene does not list.
    """
    known_keys("run", table, RUN_KEYS)
    require_keys("run", table, RUN_KEYS)
    analyses = _words(table["analyses"])
    duration = read_quantity("run.duration", table["duration"], units.TIME)
    if not 1e-9 <= duration <= 1e9:
        raise ParameterError("run.duration", table["duration"], "must be at least 1e-9 s and at most 1e9 s")
    samples = read_whole("run.samples", table["samples"], 2, MOST_SAMPLES)
    start = table.get("start", "equilibrium")
    if start not in STARTS:
        raise ParameterError("run.start", start, nearest(start, STARTS))
    settle = read_quantity("run.settle", table.get("settle", "0 s"), units.TIME)
    if not 0 <= settle < duration:
        raise ParameterError("run.settle", table.get("settle"), "must be at least 0 s and below run.duration")
    torques = _torques(table, analyses, scene)
    return Run(duration, samples, analyses, torques, start, settle, published)


def _words(analyses: Any) -> tuple[str, ...]:
    if not isinstance(analyses, list) or not analyses:
        raise ParameterError("run.analyses", analyses, f"must be a list of: {', '.join(ANALYSES)}")
    for analysis in analyses:
        if analysis not in ANALYSES:
            raise ParameterError("run.analyses", analysis, f"unknown analysis; {nearest(analysis, ANALYSES)}")
    return tuple(dict.fromkeys(analyses))


def _torques(table: dict[str, Any], analyses: tuple[str, ...], scene: Scene) -> tuple[float, ...]:
    for analysis in analyses:
        try:
            require(scene, analysis, *NEEDS[analysis])
        except SceneError as fault:
            raise SceneError(f"run.analyses: {fault}") from fault
    given = table.get("torques", [])
    if not isinstance(given, list) or len(given) > 1000:
        raise ParameterError("run.torques", given, 'must be a list such as ["30 N*m"]')
    torques = tuple(read_quantity(f"run.torques[{i}]", value, units.TORQUE) for i, value in enumerate(given))
    for index, torque in enumerate(torques):
        if abs(torque) > 1e12:
            raise ParameterError(f"run.torques[{index}]", given[index], "must be at most 1e12 N*m")
    loaded = [analysis for analysis in analyses if analysis in ("static", "dynamic")]
    if loaded and not torques:
        raise ParameterError("run.torques", given, f'"{loaded[0]}" needs a list such as ["30 N*m"]')
    alternates = scene.load is not None and scene.load.alternates
    if loaded and not scene.has_back and (alternates or min(torques) < 0):
        raise SceneError(
            "run.torques: a torque that turns negative loads the back flanks, which need [backlash], not listed here"
        )
    return torques


NOT_OF_THE_GEARS = ("run", "published", "optimise", "identify", "tolerance")


def configuration_digits(tables: dict[str, Any]) -> str:
    """Eight digits of the sections that describe gears, errors and loads, which tell configurations apart."""
    described = {key: part for key, part in tables.items() if key not in NOT_OF_THE_GEARS}
    return hashlib.sha256(json.dumps(described, sort_keys=True, default=str).encode()).hexdigest()[:8]


def _length(tables: dict[str, Any]) -> float:
    """Length of the record of the run section [s], nan without one; `read_run` refuses a wrong one."""
    run = tables.get("run")
    given = run.get("duration") if isinstance(run, dict) else None
    return math.nan if given is None else read_quantity("run.duration", given, units.TIME)


def read_published(tables: dict[str, Any]) -> tuple[Published, ...]:
    """Read the values to show next to the computed ones, from the ``[[published]]`` sections.

    Values of another configuration are replaced by a note.
    """
    entries = tables.get("published", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise ParameterError("published", entries, "must be a list of sections: [[published]]")
    published, own = [], configuration_digits(tables)
    for index, entry in enumerate(entries):
        path = f"published[{index}]"
        known_keys(path, entry, PUBLISHED_KEYS)
        require_keys(path, entry, PUBLISHED_KEYS)
        if entry["analysis"] not in ANALYSES:
            raise ParameterError(f"{path}.analysis", entry["analysis"], f"must be one of {', '.join(ANALYSES)}")
        torque = read_quantity(f"{path}.torque", entry.get("torque", "0 N*m"), units.TORQUE)
        metrics = tuple(
            (name, read_quantity(f"{path}.{name}", entry[name], units.ANGLE)) for name in METRICS if name in entry
        )
        note, of = entry.get("note", ""), entry.get("configuration", "")
        for key, given in (("note", note), ("configuration", of)):
            if not isinstance(given, str):
                raise ParameterError(f"{path}.{key}", given, "must be text in quotes")
        if of and of != own:
            metrics, note = (), f"published values left out: they are of configuration {of}, and this is {own}"
        elif "duration" in entry:
            given, length = read_quantity(f"{path}.duration", entry["duration"], units.TIME), _length(tables)
            if not math.isclose(given, length, rel_tol=1e-6) and not math.isnan(length):
                metrics = ()
                note = f"published values left out: they are of a record of {given:g} s, and this has {length:g} s"
        published.append(Published(entry["analysis"], torque, metrics, note, of))
    return tuple(published)
