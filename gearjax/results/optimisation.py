"""Results of ``gearjax optimise``: grid search and gradient search, and the scene before and after."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.config import OptimiseSection, with_numbers
from gearjax.files import finite, write_file
from gearjax.parameters import Parameter
from gearjax.progress import Progress
from gearjax.results.cases import Case, run_cases
from gearjax.run import METRICS
from gearjax.scene import Scene
from gearjax.studies import GridSearch, LocalSensitivity, Minimisation, grid_search, local_sensitivity, minimise
from gearjax.studies.select import numbers, pick
from gearjax.studies.sensitivity import SMALLEST
from gearjax.studies.terms import SHARE
from gearjax.studies.values import values
from gearjax.units import Dimension, arcmin

MOST_SHARE = 100.0  # share of the objective from which on a rise is told in its unit
ALIKE = np.deg2rad(10.0)  # differences of two phases within this arc are told as one


@dataclasses.dataclass(frozen=True)
class Optimisation:
    """Results of the grid search and the gradient search, and the analyses before and after.

    Args:
        section: settings of the optimisation.
        scene: the scene before the optimisation.
        before: objective of the scene before the optimisation [rad, or - for load sharing].
        grid: result of the grid search, ``None`` if no step was given.
        gradient: result of the gradient search.
        best: the better point of both searches, shape (free,), SI.
        sensitivity: local sensitivity around the best point.
        cases: analyses of the run section by stage: ``before``, ``grid`` and ``after`` (the best of both searches).
        others: mean objective before and after on other drawn gear sets, if the objective is one of drawn gear sets.
    """

    section: OptimiseSection
    scene: Scene
    before: float
    grid: GridSearch | None
    gradient: Minimisation
    best: np.ndarray
    sensitivity: LocalSensitivity
    cases: dict[str, list[Case]]
    others: tuple[float, float] | None = None

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Declarations of the free numbers."""
        known = numbers(self.scene)
        return {path: known[path] for path in self.gradient.paths}

    @property
    def judging(self) -> int:
        """Number of the other drawn gear sets that judge the result; 0 without any."""
        judged = self.section.judged
        return 0 if judged is None or judged.scatter is None else len(judged.scatter.values)

    def shown(self, path: str, value: float) -> float:
        """A free number in the unit in which it is shown."""
        return value / self.parameters[path].shown_in[1]

    def rise_shown(self, rise: float) -> str:
        """A rise of the objective, a share of it, in per cent; in its unit if the objective is all but zero."""
        if rise < MOST_SHARE:
            return f"{100 * rise:+.1f} %"
        return f"{rise * max(abs(self.sensitivity.objective), SMALLEST) / self.unit.per_shown:+.3g} {self.unit.shown}"

    def as_json(self) -> dict:
        """The object that ``gearjax optimise --json`` prints; a number that is not finite is ``None``."""
        gradient = self.gradient
        entries = {
            "objective": self.section.objective.name,
            "window_s": self.section.window,
            self._key("objective_before"): self.before / self.unit.per_shown,
            "grid": None,
            "gradient": {
                **self._point(gradient.objective, gradient.best),
                "starts": len(gradient.starts),
                "evaluations": gradient.evaluations,
                "within_1_percent": gradient.within(0.01),
                **self._choice(),
                "failed": gradient.failed,
                "improved": gradient.improved,
                "valleys": int(gradient.valley.max()) + 1,
                "seconds": gradient.seconds,
                "compile_seconds": gradient.compile_seconds,
            },
            "before": _metrics(self.cases["before"]),
            "after": _metrics(self.cases["after"]),
            "sensitivity": self._sensitivity(),
        }
        if self.others is not None:
            before, after = (value / self.unit.per_shown for value in self.others)
            words = {self._key("other_gear_sets_before"): before, self._key("other_gear_sets_after"): after}
            entries["scatter"] = {"gear_sets": self.section.scatter, "other_gear_sets": self.judging} | words
        if self.grid is not None:
            entries["grid"] = {
                **self._point(self.grid.objective, self.grid.best),
                "combinations": self.grid.combinations,
                "evaluated": self.grid.evaluated,
                "seconds": self.grid.seconds,
                "compile_seconds": self.grid.compile_seconds,
                "metrics": _metrics(self.cases["grid"]),
            }
        return finite(entries)

    def choice(self) -> tuple[dict[str, float], dict[tuple[str, str], float]]:
        """`in_common` of the end points within 1 % of the best."""
        return in_common(self.gradient, [parameter.periodic for parameter in self.parameters.values()])

    @property
    def unit(self) -> Dimension:
        """Unit in which the objective is shown."""
        return self.section.objective.dimension

    def _key(self, name: str) -> str:
        """The name of an entry, with the unit of the objective if it has one."""
        return name if self.unit is SHARE else f"{name}_{self.unit.shown}"

    def _point(self, objective: float, point: np.ndarray) -> dict:
        periodic = {path: parameter.periodic for path, parameter in self.parameters.items()}
        shown = {
            path: float(f"{self.shown(path, float(value)):.12g}") for path, value in zip(periodic, point, strict=True)
        }
        entry: dict = {
            self._key("objective"): objective / self.unit.per_shown,
            "phases_deg": {path: value for path, value in shown.items() if periodic[path]},
        }
        others = {
            path: {"value": value, "unit": self.parameters[path].shown_in[0]}
            for path, value in shown.items()
            if not periodic[path]
        }
        return entry | ({"values": others} if others else {})

    def _choice(self) -> dict:
        spans, alike = self.choice()
        return {
            "spans_within_1_percent": {
                path: {"value": self.shown(path, span), "unit": self.parameters[path].shown_in[0]}
                for path, span in spans.items()
            },
            "differences_in_common_deg": {f"{other} - {one}": apart for (one, other), apart in alike.items()},
        }

    def _sensitivity(self) -> dict:
        around, size = self.sensitivity, self.unit.per_shown
        return {
            self._key("gradient"): dict(zip(around.paths, (around.gradient / size).tolist(), strict=True)),
            self._key("hessian_eigenvalues"): (around.eigenvalues / size).tolist(),
            "directions": around.directions.tolist(),
            "flat": around.flat.tolist(),
            **({"deviations_deg": np.rad2deg(around.deviations).tolist()} if any(around.angles) else {}),
            **({} if all(around.angles) else {"deviations_of_bounds": around.deviations.tolist()}),
            self._key("worst"): (around.worst / size).tolist(),
            self._key("mean"): (around.mean / size).tolist(),
        }


def in_common(
    search: Minimisation, periodic: Sequence[bool], share: float = 0.01
) -> tuple[dict[str, float], dict[tuple[str, str], float]]:
    """What the end points within a share of the best objective have in common, and what is left to choose.

    Args:
        search: the search.
        periodic: of each free number, whether it is a phase.
        share: of the best objective, by which others may be worse.

    Returns:
        The span of each free number among them, SI (of phases the smallest arc that has all); for each pair of phases
        of wide spans whose difference is the same in all, to `ALIKE`, this difference [deg, 0 to 360].
    """
    good = search.ends[search.objectives <= search.objective + share * abs(search.objective)]
    spans = {
        path: _arc(values) if turns else float(np.ptp(values))
        for path, values, turns in zip(search.paths, good.T, periodic, strict=True)
    }
    wide = [place for place in np.flatnonzero(periodic) if spans[search.paths[place]] > 4 * ALIKE]
    alike = {}
    for one, other in itertools.combinations(wide, 2):
        apart = good[:, other] - good[:, one]
        if _arc(apart) < ALIKE:
            middle = np.rad2deg(np.angle(np.exp(1j * apart).mean()))
            alike[search.paths[one], search.paths[other]] = float((middle + 0.5) % 360 - 0.5)  # 0, not 360
    return spans, alike


def _arc(phases: np.ndarray) -> float:
    """The smallest arc that has all phases [rad]."""
    around = np.sort(phases % (2 * np.pi))
    return float(2 * np.pi - np.diff(around, append=around[0] + 2 * np.pi).max())


def _metrics(cases: list[Case]) -> dict:
    """Metrics of the first case, and all cases as ``gearjax run --json`` prints them."""
    entries = [case.as_json() for case in cases]
    return {**entries[0]["metrics"], "cases": entries}


def optimise(section: OptimiseSection, scene: Scene, progress: Progress, *, workers: int = 1) -> Optimisation:
    """Search by grid and by gradients, take the better result, and analyse the scene before and after.

    Args:
        section: what to search for.
        scene: the scene.
        progress: function that is called with lines of progress.
        workers: number of analyses whose programs are compiled in parallel (`run_cases`).

    Raises:
        ParameterError: the objective does not depend on one of the free numbers.
        SceneError: an analysis of the run section cannot be done.
    """
    asked = {"where": section.where, "bounds": section.bounds, "progress": progress}
    grid = None
    if section.grid_step:
        grid = grid_search(section.objective, scene, step=section.grid_step, **asked)
        progress(f"grid: {grid.seconds:.2f} s, compiled in {grid.compile_seconds:.1f} s")
    gradient = minimise(section.objective, scene, starts=section.starts, key=jax.random.key(section.seed), **asked)
    progress(f"gradients: {gradient.seconds:.2f} s, compiled in {gradient.compile_seconds:.1f} s")
    free = pick(scene, section.where, section.bounds)
    best = grid.best if grid is not None and grid.objective < gradient.objective else gradient.best
    points = {"after": best} if grid is None else {"grid": grid.best, "after": best}
    moved = {stage: free.set(scene, jnp.asarray(point, scene.dtype)) for stage, point in points.items()}
    progress("sensitivity at the optimum, then all analyses before and after")
    around = local_sensitivity(section.objective, scene, where=section.where, at=best, bounds=section.bounds)
    cases = {}
    for stage, changed in {"before": scene, **moved}.items():
        cases[stage] = []
        for case in run_cases(changed, workers=workers):
            progress(f"{stage}: {case.title}")
            cases[stage].append(case)
    point = np.asarray(free.get(scene), dtype=float)
    before = float(values(section.objective, scene, free)(point[None])[0])
    others = None
    if section.judged is not None:
        others = tuple(values(section.judged, scene, free)(np.stack([point, np.asarray(best, dtype=float)])).tolist())
    return Optimisation(section, scene, before, grid, gradient, best, around, cases, others)


def save_optimisation(optimisation: Optimisation, config: str, folder: Path, base: Path) -> list[Path]:
    """Write ``starts.csv`` (end point of every start), ``metrics.csv`` (before, grid, after) and ``optimised.toml``.

    Args:
        optimisation: the optimisation.
        config: text of the configuration before the optimisation.
        folder: folder of the files.
        base: folder to which file names in the configuration are relative.

    Raises:
        GearjaxError: the folder cannot be written.
    """
    search = optimisation.gradient
    parameters = optimisation.parameters
    header = [f"{path} [{p.shown_in[0] or '-'}]" for path, p in parameters.items()]
    unit = optimisation.unit
    lines = [",".join(["start", *header, f"objective [{unit.shown}]", "valley", "result"])]
    for index, end in enumerate(search.ends):
        shown = [f"{optimisation.shown(path, value):.9g}" for path, value in zip(parameters, end, strict=True)]
        last = [
            f"{search.objectives[index] / unit.per_shown:.9g}",
            str(search.valley[index]),
            str(search.result[index]),
        ]
        lines.append(",".join([str(index), *shown, *last]))
    rows = [",".join(["stage", "analysis", "torque [N m]", "window [s]", *(f"{name} [arcmin]" for name in METRICS)])]
    for stage, cases in optimisation.cases.items():
        for case in cases:
            numbers = [f"{case.metrics[name] / arcmin:.9g}" for name in METRICS]
            rows.append(",".join([stage, case.analysis, f"{case.torque:g}", f"{case.window:g}", *numbers]))
    best = dict(zip(search.paths, optimisation.best.tolist(), strict=True))
    texts = {
        "starts.csv": "\n".join(lines) + "\n",
        "metrics.csv": "\n".join(rows) + "\n",
        "optimised.toml": with_numbers(config, best, parameters, base),
    }
    return [write_file(folder / name, text) for name, text in texts.items()]
