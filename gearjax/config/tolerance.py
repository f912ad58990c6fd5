"""The tolerance section: the distributions of the toleranced numbers, the measures, and the studies to be made."""

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from gearjax import units
from gearjax.checks import MISSING, GearjaxError, ParameterError, SceneError, nearest
from gearjax.config.distributions import read_distribution
from gearjax.config.quantities import read_plain, read_quantity, read_ratio
from gearjax.config.tables import Key, flattened, known_keys, read_whole, require_keys
from gearjax.contact import HardContact
from gearjax.scene import Scene
from gearjax.studies.select import members, numbers, series_of
from gearjax.tolerance import Correlation, Empirical, Measure, Tolerances
from gearjax.tolerance.measures import EXTREMES, extremes_of
from gearjax.tolerance.monte_carlo import CHUNK
from gearjax.tolerance.sampling import SAMPLERS

MOST_SAMPLES = 1_000_000_000
PRECISIONS = ("float64", "float32")
MOST_YIELD = 0.9995  # a higher yield would need more gear sets to prove it
TOLERANCE_KEYS = {
    "measures": Key("a list of measures, names or tables", required=True),
    "samples": Key(f"a whole number from 2 to {MOST_SAMPLES}", default="10000"),
    "seed": Key("a whole number from 0", default="0"),
    "sampler": Key(" or ".join(f'"{word}"' for word in SAMPLERS), default='"monte_carlo"'),
    "extremes": Key(" or ".join(f'"{word}"' for word in EXTREMES), default='"between"'),
    "chunk": Key("a whole number from 1", default=str(CHUNK)),
    "precision": Key(" or ".join(f'"{word}"' for word in PRECISIONS), default=f'"{PRECISIONS[0]}"'),
    "correlated": Key("a list such as [{ between = [PATH, PATH], coefficient = 0.5 }]", default="[]"),
}
MEASURE_KEYS = {
    "name": Key('such as "no_load.peak_to_peak"', '"no_load.peak_to_peak"', required=True),
    "torque": Key('a torque such as "30 N*m", for static and dynamic measures', '"30 N*m"'),
    "limit": Key('an angle such as "1 arcmin"', '"2 arcmin"'),
    "at_least": Key('an angle such as "1 arcmin"', '"0 arcmin"'),
}
SENSITIVITY_KEYS = {"samples": Key("a whole number from 16; dynamic measures are left out", default="1024")}
ALLOCATION_KEYS = {
    "measure": Key("name of a measure with a limit", required=True),
    "yield": Key(f"above 0 and at most {MOST_YIELD}, or percent", "0.95", required=True),
    "cost": Key("costs by path, each a number or a list of [factor, cost]; if left out, 1 for each tolerance"),
    "tightest": Key("above 0 and below loosest", default="0.1"),
    "loosest": Key("at most 1000", default="2.0"),
}
ASSEMBLY_KEYS = {
    "measure": Key("name of a measure that is not dynamic; if left out, the first of these measures"),
    "where": Key("a list of paths of phases; if left out, the phases of all errors"),
    "units": Key("a whole number from 2", default="1000"),
    "starts": Key("a whole number from 1 to 1000", default="8"),
}
_LIMITS = ("limit", "at_least")
_STUDIES = ("sensitivity", "allocation", "assembly")


@dataclasses.dataclass(frozen=True)
class Allocation:
    """Search for the cheapest tolerances that reach a required yield.

    Args:
        measure: name of the measure whose yield counts.
        required: required yield, the share of good gear sets.
        costs: cost of each tolerance by path: pairs of a factor on the tolerance and its cost, the cheapest last; a
            single pair (1, c) stands for the reciprocal law ``c / factor``.
        tightest: smallest factor on a tolerance that can be bought.
        loosest: largest factor on a tolerance that can be bought.
    """

    measure: str
    required: float
    costs: dict[str, tuple[tuple[float, float], ...]]
    tightest: float
    loosest: float


@dataclasses.dataclass(frozen=True)
class Assembly:
    """Matched assembly: the phases of each unit are chosen from the measured errors of its parts.

    Args:
        measure: name of the measure that the choice of the phases makes small.
        where: paths of the phases that may be chosen in assembly.
        units: number of gear sets to assemble.
        starts: number of starting points of the search for each gear set.
    """

    measure: str
    where: tuple[str, ...]
    units: int
    starts: int


@dataclasses.dataclass(frozen=True)
class ToleranceSection:
    """Settings of ``gearjax tolerance``.

    Args:
        tolerances: the population of gear sets.
        measures: measures that are computed for each gear set.
        samples: number of gear sets of the Monte Carlo study.
        seed: seed of the random numbers.
        sampler: method by which the random numbers are drawn.
        extremes: where the highest and lowest values of a curve are searched: only at the ``"samples"`` of the run,
            which is quicker and the default for static measures of slices and coupled contacts, or also ``"between"``
            them.
        chunk: number of gear sets that are computed together and stored together.
        precision: floating-point precision, ``"float64"`` or ``"float32"``.
        sensitivity: number of samples of the sensitivity study, 0 for no such study.
        allocation, assembly: settings of further studies, or ``None``.
    """

    tolerances: Tolerances
    measures: tuple[Measure, ...]
    samples: int
    seed: int
    sampler: str
    extremes: str
    chunk: int
    precision: str
    sensitivity: int
    allocation: Allocation | None
    assembly: Assembly | None


def example_path(scene: Scene, number: str) -> str:
    """Path of a number of an error, one of the scene's own if it has such an error."""
    has = (key for key, error in scene.errors.items() if np.ndim(getattr(error, number, [])) == 0)
    return f"errors.{next(has, 'NAME')}.{number}"


def read_tolerance(table: dict[str, Any], scene: Scene, folder: Path) -> ToleranceSection:
    """Read the tolerance section of a configuration.

    Args:
        table: the section.
        scene: the scene.
        folder: folder to which file names in the section are relative.

    Raises:
        GearjaxError: a value is wrong.
    """
    if scene.run is None:
        raise SceneError("tolerance: the configuration has no [run]: list duration, samples and analyses")
    require_keys("tolerance", table, TOLERANCE_KEYS)
    leaves = _leaves(table, scene)
    known = numbers(scene)
    distributions = {path: read_distribution(f"tolerance.{path}", given, known[path], folder) for path, given in leaves}
    if not distributions:
        example = f'"{example_path(scene, "amplitude")}" = {{kind = "rayleigh", scale = "6 um"}}'
        raise GearjaxError(f"tolerance: no number varies; add {example}")
    measures = _measures(table["measures"])
    correlations = _correlations(table.get("correlated", []))
    try:
        tolerances = Tolerances(scene, distributions, correlations)
    except ParameterError as fault:
        raise ParameterError(f"tolerance.{fault.key}", fault.given, fault.right) from fault
    return ToleranceSection(
        tolerances,
        measures,
        read_whole("tolerance.samples", table.get("samples", 10_000), 2, MOST_SAMPLES),
        read_whole("tolerance.seed", table.get("seed", 0), 0, 2**31 - 1),
        _word(table, "sampler", "monte_carlo", SAMPLERS),
        _word(table, "extremes", extremes_of(measures, scene), EXTREMES),
        read_whole("tolerance.chunk", table.get("chunk", CHUNK), 1, 2**24),
        _word(table, "precision", PRECISIONS[0], PRECISIONS),
        _sensitivity(table.get("sensitivity"), measures),
        _allocation(table.get("allocation"), tolerances, measures),
        _assembly(table.get("assembly"), tolerances, measures),
    )


def inlined(tables: dict[str, Any], scene: Scene, folder: Path) -> dict[str, Any]:
    """The tables of a configuration, with measured values in place of the names of their files."""
    section = dict(tables["tolerance"])
    for path, given in _leaves(section, scene):
        if given.get("kind") == Empirical.kind and "file" in given:
            parameter = numbers(scene)[path]
            assert parameter.dimension is not None
            spread = read_distribution(f"tolerance.{path}", given, parameter, folder)
            assert isinstance(spread, Empirical)
            unit = f" {parameter.dimension.unit}" if parameter.dimension.unit else ""
            values = [f"{value!r}{unit}" if unit else value for value in spread.values]
            section = _forget(_forget(section, path), series_of(path))
            section[path] = {"kind": Empirical.kind, "values": values}
    return {**tables, "tolerance": section}


def sampled(tables: dict[str, Any]) -> dict[str, Any]:
    """The tables of a configuration that determine the samples: without limits and without further studies."""
    section = {key: value for key, value in tables["tolerance"].items() if key not in _STUDIES}
    measures = [{"name": entry} if isinstance(entry, str) else entry for entry in section["measures"]]
    section["measures"] = [{k: v for k, v in entry.items() if k not in _LIMITS} for entry in measures]
    others = {key: value for key, value in tables.items() if key not in ("optimise", "published")}
    return {**others, "tolerance": section}


def _forget(table: dict[str, Any], path: str) -> dict[str, Any]:
    """The table without one leaf, in whatever way its dotted path was written."""
    kept: dict[str, Any] = {}
    for key, value in table.items():
        if key == path:
            continue
        if path.startswith(f"{key}.") and isinstance(value, dict):
            value = _forget(value, path.removeprefix(f"{key}."))
            if not value:  # the leaf was the only entry
                continue
        kept[key] = value
    return kept


def _leaves(table: dict[str, Any], scene: Scene) -> list[tuple[str, dict[str, Any]]]:
    """Paths of the numbers that vary, each with the table of its distribution.

    A dotted key is a path whether it is quoted or not; ``[*]`` stands for every number of a series.
    """
    known, leaves = numbers(scene), []

    def visit(path: str, given: Any) -> None:
        if path.endswith("[*]") and (names := members(path, known)) != (path,):
            for name in names:
                visit(name, given)
            return
        if isinstance(given, dict) and given and "kind" not in given and path not in known:
            for key, value in given.items():
                visit(f"{path}.{key}", value)
            return
        if path not in known:
            words = (*known, *TOLERANCE_KEYS, *_STUDIES)
            raise ParameterError(f"tolerance.{path}", given, f"unknown key; {nearest(path, words)}")
        if not isinstance(given, dict):
            raise ParameterError(f"tolerance.{path}", given, 'must be a table such as {kind = "normal", ...}')
        if path in dict(leaves):
            raise ParameterError(f"tolerance.{path}", given.get("kind"), "is listed twice")
        leaves.append((path, given))

    for key, given in table.items():
        if key not in TOLERANCE_KEYS and key not in _STUDIES:
            visit(key, given)
    return leaves


def _measures(given: Any) -> tuple[Measure, ...]:
    if not isinstance(given, list) or not given:
        right = 'must be a list such as [{name = "no_load.peak_to_peak", limit = "1 arcmin"}]'
        raise ParameterError("tolerance.measures", given, right)
    measures: list[Measure] = []
    for index, entry in enumerate(given):
        key = f"tolerance.measures[{index}]"
        table = {"name": entry} if isinstance(entry, str) else entry
        if not isinstance(table, dict):
            raise ParameterError(key, entry, "must be a name or a table with a name")
        known_keys(key, table, MEASURE_KEYS)
        if not isinstance(table.get("name"), str):
            raise ParameterError(f"{key}.name", table.get("name", MISSING), 'give one such as "no_load.peak_to_peak"')
        rest = {name: read_quantity(f"{key}.{name}", table[name], units.ANGLE) for name in table if name in _LIMITS}
        if "torque" in table:
            rest["torque"] = read_quantity(f"{key}.torque", table["torque"], units.TORQUE)
        try:
            measure = Measure.named(table["name"], **rest)
        except ParameterError as fault:
            word = "name" if fault.key in ("measure", "metric") else fault.key
            raise ParameterError(f"{key}.{word}", table.get(word, fault.given), fault.right) from fault
        if measure.name in [other.name for other in measures]:
            raise ParameterError(key, measure.name, "is listed twice")
        measures.append(measure)
    return tuple(measures)


def _correlations(given: Any) -> list[Correlation]:
    if not isinstance(given, list):
        raise ParameterError(
            "tolerance.correlated", given, "must be a list of {between = [path, path], coefficient = 0.5}"
        )
    correlations = []
    for index, entry in enumerate(given):
        key = f"tolerance.correlated[{index}]"
        if not isinstance(entry, dict):
            raise ParameterError(key, entry, "must be a table {between = [path, path], coefficient = 0.5}")
        known_keys(key, entry, ("between", "coefficient"))
        pair = entry.get("between", MISSING)
        if not isinstance(pair, list) or len(pair) != 2 or not all(isinstance(path, str) for path in pair):
            raise ParameterError(f"{key}.between", pair, "must be two paths")
        coefficient = read_plain(f"{key}.coefficient", entry.get("coefficient", MISSING))
        correlations.append(Correlation(pair[0], pair[1], coefficient))
    return correlations


def _word(table: dict[str, Any], key: str, default: str, words: tuple[str, ...]) -> Any:
    given = table.get(key, default)
    if given not in words:
        raise ParameterError(f"tolerance.{key}", given, nearest(given, words))
    return given


def _section(key: str, given: Any, keys: dict[str, Key]) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise ParameterError(f"tolerance.{key}", given, f"must be a section: [tolerance.{key}]")
    known_keys(f"tolerance.{key}", given, keys)
    require_keys(f"tolerance.{key}", given, keys)
    return given


def _sensitivity(given: Any, measures: tuple[Measure, ...]) -> int:
    if given is None:
        return 0
    if all(measure.analysis == "dynamic" for measure in measures):
        words = "is of measures that are not dynamic, and all measures are"
        raise ParameterError(
            "tolerance.sensitivity", given, f"{words}: add one such as static.peak_to_peak, or leave it out"
        )
    table = _section("sensitivity", given, SENSITIVITY_KEYS)
    return read_whole("tolerance.sensitivity.samples", table.get("samples", 1024), 16, 2**24)


def _limited(key: str, given: Any, measures: tuple[Measure, ...]) -> str:
    names = [measure.name for measure in measures if measure.is_limited]
    if given not in names:
        raise ParameterError(key, given, f"must be a measure with a limit; {nearest(given, names)}")
    return given


def _allocation(given: Any, tolerances: Tolerances, measures: tuple[Measure, ...]) -> Allocation | None:
    if given is None:
        return None
    key = "tolerance.allocation"
    table = _section("allocation", given, ALLOCATION_KEYS)
    measure = _limited(f"{key}.measure", table.get("measure", MISSING), measures)
    required = read_ratio(f"{key}.yield", table.get("yield", MISSING))
    if not 0 < required <= MOST_YIELD:
        right = f"must be above 0 and at most {MOST_YIELD}: a higher yield cannot be verified"
        raise ParameterError(f"{key}.yield", required, right)
    tightest = read_plain(f"{key}.tightest", table.get("tightest", 0.1))
    loosest = read_plain(f"{key}.loosest", table.get("loosest", 2.0))
    if not 0 < tightest < loosest <= 1000:
        raise ParameterError(f"{key}.tightest", tightest, "must be above 0 and below loosest, at most 1000")
    if not tolerances.tolerated:
        raise SceneError(f"{key}: there is no tolerance to allocate: all numbers that vary are assembly phases")
    given_costs = table.get("cost", dict.fromkeys(tolerances.tolerated, 1.0))
    if not isinstance(given_costs, dict) or not given_costs:
        raise ParameterError(f"{key}.cost", given_costs, "must be a section of costs by path")
    costs = {}
    for path, cost in flattened(given_costs).items():
        if path not in tolerances.tolerated:
            raise ParameterError(f"{key}.cost.{path}", cost, nearest(path, tolerances.tolerated))
        costs[path] = _cost(f"{key}.cost.{path}", cost)
    return Allocation(measure, required, costs, tightest, loosest)


def _cost(key: str, given: Any) -> tuple[tuple[float, float], ...]:
    """Read the cost at the given tolerance (reciprocal law), or a table of factors and costs."""
    right = "must be a cost above 0, or a list of [factor, cost] with rising factors and falling costs"
    if not isinstance(given, list):
        cost = read_plain(key, given)
        if cost <= 0:
            raise ParameterError(key, given, right)
        return ((1.0, cost),)
    if len(given) < 2 or not all(isinstance(row, list) and len(row) == 2 for row in given):
        raise ParameterError(key, given, right)
    rows = tuple((read_plain(key, factor), read_plain(key, cost)) for factor, cost in given)
    ordered = all(a[0] < b[0] and a[1] >= b[1] for a, b in itertools.pairwise(rows))
    if not ordered or rows[0][0] <= 0 or rows[-1][1] < 0:
        raise ParameterError(key, given, right)
    return rows


def _assembly(given: Any, tolerances: Tolerances, measures: tuple[Measure, ...]) -> Assembly | None:
    if given is None:
        return None
    key = "tolerance.assembly"
    table = _section("assembly", given, ASSEMBLY_KEYS)
    names = [measure.name for measure in measures if measure.analysis != "dynamic"]
    measure = table.get("measure", names[0] if names else MISSING)
    if measure not in names:
        raise ParameterError(
            f"{key}.measure", measure, f"must be a measure that is not dynamic; {nearest(measure, names)}"
        )
    if not isinstance(tolerances.scene.contact, HardContact):
        raise SceneError(f'{key}: needs [contact] kind = "hard"')
    known = numbers(tolerances.scene)
    phases = [path for path in known if known[path].periodic]
    where = table.get("where", [path for path in phases if path.startswith("errors.")])
    if not isinstance(where, list) or not where:
        raise ParameterError(f"{key}.where", where, "must be a list of phases")
    for path in where:
        if path not in phases or where.count(path) > 1:
            raise ParameterError(f"{key}.where", path, f"must be phases, each once; {nearest(path, phases)}")
    units_ = read_whole(f"{key}.units", table.get("units", 1000), 2, 1_000_000)
    starts = read_whole(f"{key}.starts", table.get("starts", 8), 1, 1000)
    return Assembly(measure, tuple(where), units_, starts)
