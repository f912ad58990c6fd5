"""Results of the studies that follow a Monte Carlo study, kept in its folder so that they are not made twice.

Each result stands in a file of its own as JSON, after a hash of the whole configuration, of its name and of its text. A
result of another configuration, or a damaged one, does not match its hash and is worked out again.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import gearjax
from gearjax.checks import writing
from gearjax.config.build import contents
from gearjax.config.tables import flattened
from gearjax.files import write_file
from gearjax.tolerance.allocation import AllocatedTolerances
from gearjax.tolerance.assembly import MatchedAssembly
from gearjax.tolerance.interference import Clashes
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.statistics import Estimate
from gearjax.tolerance.variance import Sensitivities

FOLDER = "studies"
_FORMAT = 4  # is raised when results of before would be other ones now
_KIND = "kind of"
NAMED = Clashes, Estimate
_KINDS = {kind.__name__: kind for kind in (*NAMED, AllocatedTolerances, MatchedAssembly, Measure, Sensitivities)}


class Further:
    """Results of further studies in a folder.

    Args:
        folder: folder of the Monte Carlo study; ``None`` if nothing is kept.
        definition: tables of the configuration.

    Attributes:
        shown_again: names of the results that were not worked out again.
    """

    def __init__(self, folder: Path | None, definition: dict[str, Any]):
        self.folder = None if folder is None else folder / FOLDER
        wanted = {"format": _FORMAT, "gearjax": gearjax.__version__} | flattened(definition) | contents(definition)
        self._study = json.dumps(wanted, sort_keys=True)
        self.shown_again: list[str] = []

    def get(self, name: str, made: Callable[[], Any]) -> Any:
        """The result of a study: as it was kept, or made now and kept.

        Raises:
            GearjaxError: the study cannot be made, or the folder cannot be written.
        """
        if self.folder is None:
            return made()
        path = self.folder / f"{name}.json"
        try:
            mark, _, text = path.read_text(encoding="utf-8").partition("\n")
        except (OSError, ValueError):
            mark = text = ""
        if mark == self._mark(name, text):
            kept = _from_plain(json.loads(text))
            empty = kept is None or (isinstance(kept, list | dict) and not kept)
            if not empty:  # studies that were not asked for leave nothing to show
                self.shown_again.append(name)
            return kept
        value = made()
        text = json.dumps(_plain(value))
        with writing(self.folder):
            self.folder.mkdir(exist_ok=True)
            write_file(path, f"{self._mark(name, text)}\n{text}")
        return value

    def _mark(self, name: str, text: str) -> str:
        return hashlib.blake2b(f"{self._study}\0{name}\0{text}".encode(), digest_size=16).hexdigest()


def _plain(value: Any) -> Any:
    """A result as objects that JSON has."""
    if isinstance(value, np.ndarray):
        return {_KIND: "array", "dtype": value.dtype.str, "shape": value.shape, "values": value.ravel().tolist()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {_KIND: type(value).__name__} | fields
    if isinstance(value, NAMED):
        return {_KIND: type(value).__name__} | {key: _plain(part) for key, part in value._asdict().items()}
    if isinstance(value, tuple):
        return {_KIND: "tuple", "values": [_plain(part) for part in value]}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    return value.item() if isinstance(value, np.generic) else value


def _from_plain(value: Any) -> Any:
    """The result that `_plain` wrote."""
    if isinstance(value, list):
        return [_from_plain(part) for part in value]
    if not isinstance(value, dict):
        return value
    kind = value.get(_KIND)
    if kind == "array":
        return np.array(value["values"], np.dtype(value["dtype"])).reshape(value["shape"])
    if kind == "tuple":
        return tuple(_from_plain(part) for part in value["values"])
    parts = {key: _from_plain(part) for key, part in value.items() if key != _KIND}
    return parts if kind is None else _KINDS[kind](**parts)
