"""Results of ``gearjax compare`` and ``gearjax identify``, and the files that hold them."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from gearjax.checks import ParameterError, SceneError
from gearjax.config import IdentifySection, with_numbers
from gearjax.files import write_file
from gearjax.identification import Comparison, Identification, Measurement, Reassembly, compare, identify, reassemble
from gearjax.progress import Progress
from gearjax.results.joint import export_joint
from gearjax.scene import Scene
from gearjax.studies.select import numbers, pick


@dataclasses.dataclass(frozen=True, eq=False)
class Identified:
    """Result of an identification, comparison with the recordings, and advice on reassembly.

    Args:
        section: settings of the identification.
        found: the identified numbers.
        beside: comparison of the recordings with the identified scene.
        advice: turns of bodies to reassemble the unit, ``None`` if they were not asked for.
    """

    section: IdentifySection
    found: Identification
    beside: Comparison
    advice: Reassembly | None

    def as_json(self) -> dict[str, Any]:
        """The object that ``gearjax identify --json`` prints."""
        told = self.found.as_json() | {"comparison": self.beside.as_json()}
        return told if self.advice is None else told | {"reassembly": self.advice.as_json()}


def identified(section: IdentifySection, scene: Scene, records: list[Measurement], progress: Progress) -> Identified:
    """Identify the unknowns, compare with the recordings and, if asked for, advise on reassembly."""
    found = identify(
        scene,
        records,
        section.where,
        priors=section.priors,
        offset_spread=section.offset_spread,
        starts=section.starts,
        analysis=section.analysis,
        orders=section.orders,
        key=section.seed,
        progress=progress,
    )
    beside = compare(found.scene, records, analysis=section.analysis)
    ask = section.reassemble
    advice = None
    if ask is not None:
        given = {"steps": ask.places, "metric": ask.metric, "torque": ask.torque, "key": section.seed}
        try:
            advice = reassemble(found, ask.where, **given, progress=progress)
        except ParameterError as fault:
            key = {"steps": "places"}.get(fault.key, fault.key)
            raise ParameterError(f"identify.reassemble.{key}", fault.given, fault.right) from fault
    return Identified(section, found, beside, advice)


def save_identified(result: Identified, text: str, folder: Path, base: Path) -> list[Path]:
    """Write ``identification.json``, ``identified.toml``, ``residual.csv``, and a model of the reducer in ``joint``.

    The model in ``joint`` is for other programs. It is left out if no recording has a torque. If the reducer has no
    such model, ``joint.txt`` states why.

    Args:
        result: result of the identification.
        text: text of the configuration before the identification.
        folder: folder of the files.
        base: folder to which file names in the configuration are relative.
    """
    found = result.found
    paths = [path for path in numbers(found.scene) if path.startswith("errors.") or path in found.unknowns.names]
    values = pick(found.scene, paths).get(found.scene)
    known = numbers(found.scene)
    numbers_found = dict(zip(paths, map(float, values), strict=True))
    without = ("reference",) if found.scene.reference is None else ()
    changed = with_numbers(text, numbers_found, {path: known[path] for path in paths}, base, without)
    written = [
        write_file(folder / "identification.json", json.dumps(result.as_json(), indent=1, allow_nan=False) + "\n"),
        write_file(folder / "identified.toml", changed),
        write_file(folder / "residual.csv", _residual(found)),
    ]
    torques = [float(np.abs(record.loads).max()) for record in found.records]
    if max(torques) > 0:
        try:
            written += export_joint(found.scene, folder / "joint", torque=max(torques))
        except SceneError as fault:
            written.append(write_file(folder / "joint.txt", f"no joint model: {fault}\n"))
    return written


def save_comparison(beside: Comparison, folder: Path) -> list[Path]:
    """Write ``comparison.json``."""
    return [write_file(folder / "comparison.json", json.dumps(beside.as_json(), indent=1, allow_nan=False) + "\n")]


def _residual(found: Identification) -> str:
    lines = ["recording,input angle [rad],measured [rad],computed [rad],weight"]
    begin = 0
    for record, (theta, measured, computed) in zip(found.records, found.curves(), strict=True):
        weight = found.fit.weight[begin : begin + theta.size]
        begin += theta.size
        name = record.name.replace('"', "'")
        rows = zip(theta, measured, computed, weight, strict=True)
        lines += [f'"{name}",{a:.9g},{b:.9g},{c:.9g},{w:.4g}' for a, b, c, w in rows]
    return "\n".join(lines) + "\n"
