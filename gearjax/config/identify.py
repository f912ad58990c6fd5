"""The identify section: which recordings are read, which numbers are unknown, and what is known about them before."""

import dataclasses
import math
from pathlib import Path
from typing import Any

from gearjax import units
from gearjax.checks import ParameterError, nearest
from gearjax.config.quantities import read_plain, read_quantity
from gearjax.config.tables import Key, known_keys, read_parameter, read_whole
from gearjax.identification.identify import OFFSET_SPREAD
from gearjax.identification.reassembly import METRICS
from gearjax.identification.running import an_analysis
from gearjax.parameters import Parameter
from gearjax.scene import Scene
from gearjax.studies.select import members, numbers

IDENTIFY_KEYS = {
    "measured": Key("recordings of the same unit, a list of CSV files", '["te.csv"]', required=True),
    "where": Key(
        'unknowns, a list of errors or paths such as "errors.planet_1"; if left out, all errors and the stiffness'
    ),
    "priors": Key("prior knowledge, a table by path of standard deviations or pairs [mean, standard deviation]"),
    "offset_spread": Key(
        "standard deviation of the encoders' offset between recordings, an angle", default='"0.02 arcmin"'
    ),
    "analysis": Key(
        '"static", or "dynamic" for recordings at speed; the speed follows from the recorded times', default='"static"'
    ),
    "orders": Key(
        '"find", or a list of orders whose amplitude and phase are fitted, in cycles per turn of the input',
        default='"find"',
    ),
    "starts": Key(
        "number of starting points, a whole number; if left out, 64, or 4 if gaps are not linear in the unknowns", "64"
    ),
    "seed": Key("seed of the random starting points, a whole number from 0", default="0"),
    "reassemble": Key(
        "bodies that can be turned, a table: where, places (positions per turn, by path), metric, torque"
    ),
}
_REASSEMBLE = ("where", "places", "metric", "torque")
MOST_STARTS = 100_000


@dataclasses.dataclass(frozen=True)
class Reassemble:
    """Bodies that may be turned in their seats, with the settings of `gearjax.reassemble`."""

    where: tuple[str, ...] | None = None
    places: dict[str, int] = dataclasses.field(default_factory=dict)
    metric: str = "std"
    torque: float = 0.0


@dataclasses.dataclass(frozen=True)
class IdentifySection:
    """Settings of ``gearjax identify``; they have the meaning of the arguments of `gearjax.identify`."""

    measured: tuple[Path, ...] = ()
    where: tuple[str, ...] | None = None
    priors: dict[str, Any] = dataclasses.field(default_factory=dict)
    offset_spread: float = OFFSET_SPREAD
    analysis: str = "static"
    orders: str | tuple[float, ...] = "find"
    starts: int | None = None
    seed: int = 0
    reassemble: Reassemble | None = None


def read_identify(table: dict[str, Any], scene: Scene, folder: Path) -> IdentifySection:
    """Read the identify section of a configuration.

    Raises:
        ParameterError: a value is wrong.
    """
    known_keys("identify", table, IDENTIFY_KEYS)
    measured = _names("identify.measured", table.get("measured", []))
    given: dict[str, Any] = {"measured": tuple(folder / Path(name).expanduser() for name in measured)}
    if "where" in table:
        given["where"] = _names("identify.where", table["where"])
    if "priors" in table:
        given["priors"] = _priors(table["priors"], scene)
    if "offset_spread" in table:
        spread = read_quantity("identify.offset_spread", table["offset_spread"], units.ANGLE)
        if spread <= 0:
            raise ParameterError("identify.offset_spread", table["offset_spread"], "must be above 0")
        given["offset_spread"] = spread
    if "analysis" in table:
        an_analysis("identify.analysis", table["analysis"])
        given["analysis"] = table["analysis"]
    if "orders" in table:
        given["orders"] = _orders(table["orders"])
    if "starts" in table:
        given["starts"] = read_whole("identify.starts", table["starts"], 1, MOST_STARTS)
    given["seed"] = read_whole("identify.seed", table.get("seed", 0), 0, 2**31 - 1)
    if "reassemble" in table:
        given["reassemble"] = _reassemble(table["reassemble"])
    return IdentifySection(**given)


def _names(key: str, given: Any) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
        raise ParameterError(key, given, "must be a list of names in quotes")
    return tuple(given)


def _priors(given: Any, scene: Scene) -> dict[str, Any]:
    """Read standard deviations, or pairs of mean and standard deviation, in SI."""
    if not isinstance(given, dict):
        raise ParameterError("identify.priors", given, 'must be a table: {"errors.planet_1" = "5 um"}')
    known = numbers(scene)
    read = {}
    for path, value in given.items():
        key, parameter = f"identify.priors.{path}", _parameter(path, scene, known)
        values = value if isinstance(value, list) else [value]
        if isinstance(value, list) and len(value) != 2:
            raise ParameterError(key, value, "must be a standard deviation, or a pair [mean, standard deviation]")
        pair = tuple(read_parameter(key, each, parameter) for each in values)
        if not pair[-1] > 0:
            raise ParameterError(key, value, "must have a standard deviation above 0")
        read[path] = pair if len(pair) == 2 else pair[0]
    return read


def _parameter(path: str, scene: Scene, known: dict[str, Parameter]) -> Parameter:
    """Declaration of the number that a prior belongs to; for a whole error, the declaration of its first length."""
    error = path.partition(".")[2]
    if path.startswith("errors.") and error in scene.errors:
        own = [known[name] for name in known if name.startswith(f"{path}.") and known[name].dimension is units.LENGTH]
        return own[0]
    names = members(path, known)
    if names[0] not in known:
        valid = [f"errors.{name}" for name in scene.errors]
        raise ParameterError(f"identify.priors.{path}", path, nearest(path, [*valid, *known]))
    return known[names[0]]


def _orders(given: Any) -> str | tuple[float, ...]:
    if given == "find":
        return "find"
    if not isinstance(given, list):
        raise ParameterError("identify.orders", given, 'must be "find", or a list of cycles per turn of the input')
    orders = tuple(read_plain("identify.orders", order) for order in given)
    for order in orders:
        if not (math.isfinite(order) and 0 < order < 1e6):
            raise ParameterError("identify.orders", order, "must be above 0")
    return orders


def _reassemble(given: Any) -> Reassemble:
    if not isinstance(given, dict):
        raise ParameterError("identify.reassemble", given, 'must be a table: {where = ["errors.planet_1"]}')
    known_keys("identify.reassemble", given, _REASSEMBLE)
    where = None if "where" not in given else _names("identify.reassemble.where", given["where"])
    places = given.get("places", {})
    if not isinstance(places, dict):
        raise ParameterError("identify.reassemble.places", places, 'must be a table: {"errors.planet_1" = 50}')
    counts = {path: read_whole(f"identify.reassemble.places.{path}", n, 1, 100_000) for path, n in places.items()}
    metric = given.get("metric", "std")
    if metric not in METRICS:
        raise ParameterError("identify.reassemble.metric", metric, nearest(metric, METRICS))
    torque = 0.0
    if "torque" in given:
        torque = read_quantity("identify.reassemble.torque", given["torque"], units.TORQUE)
    return Reassemble(where, counts, metric, torque)
