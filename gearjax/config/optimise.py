"""The optimise section: which numbers are free, what is minimised, and how the search is done."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from gearjax import units
from gearjax.checks import MISSING, ParameterError, SceneError, nearest
from gearjax.config.quantities import read_plain, read_quantity
from gearjax.config.tables import Key, known_keys, read_parameter, read_whole, require_keys
from gearjax.parameters import Parameter
from gearjax.scene import Scene
from gearjax.studies import Objective, Term
from gearjax.studies.select import numbers, pick
from gearjax.studies.terms import NAMES, SHARES
from gearjax.tolerance import Tolerances

MOST_STARTS = 1_000_000
MOST_DRAWN = 10_000
FRESH = 256  # least number of other gear sets on which a result is judged
OPTIMISE_KEYS = {
    "objective": Key('a name such as "no_load_amplitude", or a list of terms', '"no_load_amplitude"', required=True),
    "where": Key('a list of paths such as "errors.planet_1.phase"', required=True),
    "torque": Key('a torque such as "30 N*m", for static and dynamic objectives', '"30 N*m"'),
    "order": Key(
        'a name such as "crank", or cycles per turn of the output, for objectives that end in _order', '"output"'
    ),
    "grid_step": Key("a step for all, or a table of steps by path", '"10 deg"'),
    "bounds": Key("a table of pairs [lowest, highest]; required for numbers that are not angles"),
    "starts": Key(f"a whole number from 1 to {MOST_STARTS}", default="300"),
    "window": Key('a time such as "3 s"; if left out, the duration of [run]', '"3 s"'),
    "scatter": Key(f"number of gear sets drawn from [tolerance], a whole number from 1 to {MOST_DRAWN}", "32"),
    "seed": Key("a whole number from 0", default="0"),
}
TERM_KEYS = {  # keys of one term, if the objective is a list of terms
    "name": Key('name of the quantity, such as "static_order"', '"static_order"', required=True),
    "torque": OPTIMISE_KEYS["torque"],
    "weight": Key("factor of the term in the objective, a number without unit", "1.0", "1.0"),
    "order": OPTIMISE_KEYS["order"],
}


@dataclasses.dataclass(frozen=True)
class OptimiseSection:
    """Settings of ``gearjax optimise``: free numbers are changed so that an objective becomes as small as possible.

    Args:
        objective: quantity that is minimised, computed over the window.
        window: length of the time window in which the objective is computed [s].
        where: paths of the free numbers, which the search may change.
        grid_step: spacing of the grid search, by path; without a step there is no grid search.
        bounds: lowest and highest value of each free number, by path.
        starts: number of starting points of the gradient search.
        seed: seed of the random starting points, and of the drawn gear sets.
        scatter: number of gear sets as they are made, drawn from the tolerance section, whose mean objective is
            minimised; without it, the scene alone counts.
        judged: the same objective on other drawn gear sets, which judges the result; ``None`` without ``scatter``.
    """

    objective: Objective
    window: float
    where: tuple[str, ...]
    grid_step: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    starts: int
    seed: int
    scatter: int | None = None
    judged: Objective | None = None


def read_optimise(
    table: dict[str, Any], scene: Scene, population: Callable[[], Tolerances | None] = lambda: None
) -> OptimiseSection:
    """Read the optimise section of a configuration.

    Args:
        table: the section.
        scene: the scene.
        population: function that reads the population of the tolerance section, ``None`` if there is no such section.

    Raises:
        ParameterError: a value is wrong.
        SceneError: the scene has no run section, from which the window and its samples are taken.
    """
    known_keys("optimise", table, OPTIMISE_KEYS)
    require_keys("optimise", table, OPTIMISE_KEYS)
    where = _where(table["where"], scene)
    known = numbers(scene)
    bounds = {path: _bounds(path, pair, known[path]) for path, pair in _by_path(table, "bounds", where, {}).items()}
    steps = table.get("grid_step", {})
    if not isinstance(steps, dict):
        steps = dict.fromkeys(where, steps)
    elif steps and set(steps) != set(where):
        missing = next(iter(set(where) - set(steps)), next(iter(steps)))
        raise ParameterError(f"optimise.grid_step.{missing}", steps.get(missing, MISSING), "give one step per number")
    grid_step = {path: read_parameter(f"optimise.grid_step.{path}", step, known[path]) for path, step in steps.items()}
    for path, step in grid_step.items():
        if step <= 0:
            raise ParameterError(f"optimise.grid_step.{path}", steps[path], "must be above 0")
    pick(scene, where, bounds).require_bounds()
    objective, window = _objective(table, scene)
    starts = read_whole("optimise.starts", table.get("starts", 300), 1, MOST_STARTS)
    seed = read_whole("optimise.seed", table.get("seed", 0), 0, 2**31 - 1)
    if "scatter" not in table:
        return OptimiseSection(objective, window, where, grid_step, bounds, starts, seed)
    number = read_whole("optimise.scatter", table["scatter"], 1, MOST_DRAWN)
    drawn = population()
    if drawn is None:
        raise ParameterError("optimise.scatter", number, "needs [tolerance], from whose numbers gear sets are drawn")
    around = [path for path in where if path in drawn.paths]
    sets = drawn.scatter(number, around=around, seed=seed)
    others = drawn.scatter(max(FRESH, number), around=around, seed=seed + 1)
    objective, judged = (dataclasses.replace(objective, scatter=part) for part in (sets, others))
    return OptimiseSection(objective, window, where, grid_step, bounds, starts, seed, number, judged)


def _where(given: Any, scene: Scene) -> tuple[str, ...]:
    known = numbers(scene)
    if not isinstance(given, list) or not given:
        raise ParameterError("optimise.where", given, 'must be a list of paths such as "errors.planet_1.phase"')
    for path in given:
        if not isinstance(path, str) or path not in known:
            raise ParameterError("optimise.where", path, f"no number of this scene; {nearest(path, known)}")
        if given.count(path) > 1:
            raise ParameterError("optimise.where", path, "is listed twice")
    return tuple(given)


def _by_path(table: dict[str, Any], key: str, where: tuple[str, ...], default: Any) -> dict[str, Any]:
    section = table.get(key, default)
    if not isinstance(section, dict):
        raise ParameterError(f"optimise.{key}", section, f"must be a section: [optimise.{key}]")
    for path in section:
        if path not in where:
            raise ParameterError(
                f"optimise.{key}.{path}", section[path], f"is not in optimise.where; {nearest(path, where)}"
            )
    return section


def _bounds(path: str, pair: Any, parameter: Parameter) -> tuple[float, float]:
    key = f"optimise.bounds.{path}"
    if not isinstance(pair, list) or len(pair) != 2:
        raise ParameterError(key, pair, "must be a pair: lowest, highest")
    low, high = (read_parameter(key, value, parameter) for value in pair)
    if not low < high:
        raise ParameterError(key, pair, "must have the lowest first")
    for value, given in zip((low, high), pair, strict=True):
        if not parameter.holds(value):
            raise ParameterError(key, given, f"must be {parameter.allowed()}")
    return low, high


def _objective(table: dict[str, Any], scene: Scene) -> tuple[Objective, float]:
    given = table["objective"]
    if isinstance(given, list):
        terms = tuple(_term(f"optimise.objective[{i}]", term) for i, term in enumerate(given))
        if not terms or "torque" in table or "order" in table:
            raise ParameterError("optimise.objective", given, "needs terms, each with its own torque and order")
        if len({term.dimension for term in terms}) > 1:
            raise ParameterError("optimise.objective", given, "adds angles to load sharing, which has no unit")
    else:
        term = {"name": given} | {key: table[key] for key in ("torque", "order") if key in table}
        terms = (_term("optimise.objective", term),)
    run = scene.run
    if run is None:
        raise SceneError("optimise: the configuration has no [run]: list duration, samples and analyses")
    window = run.duration
    if "window" in table:
        window = read_quantity("optimise.window", table["window"], units.TIME)
        if not 0 < window <= 1e9:
            raise ParameterError("optimise.window", table["window"], "must be above 0 s and at most 1e9 s")
    samples = max(2, round((run.samples - 1) * window / run.duration) + 1)
    if samples > 10_000_000:
        raise ParameterError("optimise.window", table.get("window"), f"has {samples} samples, more than 1e7")
    theta = scene.system.input_speed * jnp.linspace(0.0, window, samples)
    try:
        return Objective.of(terms, scene, theta), window
    except ParameterError as fault:
        raise ParameterError(f"optimise.{fault.key}", fault.given, fault.right) from fault


def _term(path: str, given: Any) -> Term:
    if not isinstance(given, dict):
        raise ParameterError(path, given, 'must be a name, or tables such as { name = "no_load_std", weight = 2.0 }')
    known_keys(path, given, TERM_KEYS)
    name = given.get("name", MISSING)
    if name not in (*NAMES, *SHARES):
        raise ParameterError(path, name, nearest(name, (*NAMES, *SHARES)))
    weight = read_plain(f"{path}.weight", given.get("weight", 1.0))
    torque = read_quantity(f"{path}.torque", given["torque"], units.TORQUE) if "torque" in given else None
    order = given.get("order")
    if order is not None and not isinstance(order, str):
        order = read_plain(f"{path}.order", order)
    try:
        return Term(name, torque, weight, order)
    except ParameterError as fault:
        place = path if fault.key == "objective" else f"{path}.{fault.key}"
        raise ParameterError(place, given.get(fault.key, fault.given), fault.right) from fault
