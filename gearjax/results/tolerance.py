"""Results of ``gearjax tolerance``: distributions and yields, sensitivities, allocation, matched assembly."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gearjax.analysis.quasi_static import each_is_dear
from gearjax.checks import GearjaxError
from gearjax.compliance import COUPLED
from gearjax.config import ToleranceSection, with_numbers
from gearjax.files import finite, write_file
from gearjax.progress import Progress
from gearjax.results.further import Further
from gearjax.results.needs import affordable
from gearjax.studies.select import numbers
from gearjax.tolerance import Study, Tolerances, Work
from gearjax.tolerance.allocation import AllocatedTolerances, allocate
from gearjax.tolerance.assembly import MatchedAssembly, matched_assembly
from gearjax.tolerance.impossible import Impossible, impossible
from gearjax.tolerance.interference import Clashes, clashes
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.monte_carlo import QUANTILES
from gearjax.tolerance.precision import PrecisionShift, in_float32, precision_shifts
from gearjax.tolerance.statistics import Estimate
from gearjax.tolerance.variance import TIGHTENED_SAMPLES, Sensitivities, sensitivities, tightened
from gearjax.units import arcmin

CHECKED_OF_DEAR = 16  # the same as below, where each equilibrium takes long
CHECKED = 256  # samples whose interference and extremes between the input angles are checked
MADE = 64  # samples of which is told how many are impossible
TRIED = 8  # samples of which at least one must be possible
SHIFTED = 10_000  # samples on which float32 is compared with float64
LISTED = 20  # failed samples that the JSON lists
NO_MOTION = ("no_load", "static", "backlash")


@dataclasses.dataclass(frozen=True)
class ToleranceResults:
    """Results of all studies that were asked for.

    Args:
        section: settings of the studies.
        study: the Monte Carlo study.
        missed: by measure, how far its value from the samples alone lies below its value with the extremes between the
            samples, on average [rad]; empty if the study computes these extremes.
        sensitivity: sensitivities of each measure.
        tightened: yields with one tolerance halved, by measure and path.
        allocation, assembly: results of these studies, or ``None``.
        seconds: wall time of the Monte Carlo study for the samples of this run, without compilation [s].
        computed: number of samples computed in this run; the others were stored before.
        problems: studies that could not be made, with the reasons.
        clashes: interference of the first gear sets; ``None`` if the clearance between both flanks is not known.
        impossible: impossible ones of the first gear sets.
    """

    section: ToleranceSection
    study: Study
    missed: dict[str, float]
    sensitivity: list[Sensitivities]
    tightened: dict[str, dict[str, tuple[Estimate, Estimate]]]
    allocation: AllocatedTolerances | None
    assembly: MatchedAssembly | None
    seconds: float
    computed: int
    problems: tuple[str, ...] = ()
    clashes: Clashes | None = None
    impossible: Impossible | None = None

    def as_json(self) -> dict[str, Any]:
        """The object that ``gearjax tolerance --json`` prints."""
        study, section = self.study, self.section
        entries: dict[str, Any] = {
            "samples": study.samples,
            "failed": len(study.failed),
            "failures": {"by_reason": study.faults, "first": study.failed[:LISTED].tolist()},
            "seed": section.seed,
            "sampler": section.sampler,
            "extremes": section.extremes,
            "precision": section.precision,
            "measures": {measure.name: self._measure(measure.name) for measure in study.measures},
            "sensitivity": {one.name: self._sensitivity(one) for one in self.sensitivity},
            "seconds": self.seconds,
            "compile_seconds": study.compile_seconds,
            "samples_per_second": self.computed / self.seconds if self.seconds > 0 else None,
            "computed": self.computed,
        }
        if self.clashes is not None and self.clashes.interfering:
            entries["interference"] = self.clashes.as_json()
        if self.impossible is not None and self.impossible.refused:
            entries["impossible"] = self.impossible.as_json()
        if self.problems:
            entries["problems"] = list(self.problems)
        if self.missed:
            entries["missed_between_samples_arcmin"] = {n: finite(value / arcmin) for n, value in self.missed.items()}
        if self.tightened:
            entries["halved_tolerance_yield"] = {
                name: {path: {"before": list(pair[0]), "after": list(pair[1])} for path, pair in rows.items()}
                for name, rows in self.tightened.items()
            }
        if self.allocation is not None:
            entries["allocation"] = _allocation(self.allocation)
        if self.assembly is not None:
            entries["assembly"] = _assembly(self.assembly)
        return entries

    def _measure(self, name: str) -> dict[str, Any]:
        study = self.study
        measure = next(m for m in study.measures if m.name == name)
        levels = {f"{level:g}": [finite(x / arcmin) for x in study.quantile(name, level)] for level in QUANTILES}
        entry: dict[str, Any] = {
            "unit": "arcmin",
            "mean": finite(study.mean(name) / arcmin),
            "std": finite(study.std(name) / arcmin),
            "quantiles": levels,
            "worst_sample": study.worst(name),
        }
        for word, limit in (("limit", measure.limit), ("at_least", measure.at_least)):
            if limit is not None:
                entry[word] = float(f"{limit / arcmin:.12g}")
        if measure.is_limited:
            entry["yield"] = list(study.share_within(name))
        return entry

    def _sensitivity(self, shares: Sensitivities) -> dict[str, Any]:
        columns = ("linear", "first", "first_error", "total", "total_error", "one_at_a_time")
        rows = {
            path: {column: finite(float(getattr(shares, column)[i])) for column in columns}
            for i, path in enumerate(shares.paths)
        }
        about = {"samples": shares.samples, "failed": shares.failed, "correlations_left_out": shares.correlated}
        return {"numbers": rows, **about, "linear_fails": shares.linear_fails or None}


def _allocation(allocation: AllocatedTolerances) -> dict[str, Any]:
    return {
        "measure": allocation.measure,
        "required": allocation.required,
        "met": allocation.met,
        "factors": dict(zip(allocation.paths, allocation.factors.tolist(), strict=True)),
        "cost": float(allocation.cost),
        "cost_before": float(allocation.cost_before),
        "yield_before": list(allocation.before),
        "yield": list(allocation.after),
    }


def _assembly(assembly: MatchedAssembly) -> dict[str, Any]:
    entry: dict[str, Any] = {"measure": assembly.measure.name, "units": len(assembly.random), "failed": assembly.failed}
    entry["where"] = list(assembly.where)
    for place, name in enumerate(("random", "matched")):
        values = (assembly.random, assembly.matched)[place]
        entry[name] = {
            "mean": finite(float(np.nanmean(values)) / arcmin),
            "std": finite(float(np.nanstd(values)) / arcmin),
            "quantiles": {
                f"{level:g}": [finite(x / arcmin) for x in assembly.quantiles(level)[place]] for level in QUANTILES
            },
        }
        if assembly.measure.is_limited:
            entry[name]["yield"] = list(assembly.shares()[place])
    return entry


def prepared(section: ToleranceSection) -> Work:
    """The Monte Carlo study of a section, in its floating-point precision.

    Raises:
        GearjaxError: the scene lacks what a measure needs, or all of the first gear sets are impossible.
    """
    tolerances, options = _in_precision(section)
    work = Work(
        tolerances,
        section.measures,
        number=section.samples,
        seed=section.seed,
        sampler=section.sampler,
        **options,
    )
    tried = impossible(section.tolerances, work.inputs(0, min(TRIED, section.samples)))
    if tried.refused == tried.looked_at:
        raise GearjaxError(f"tolerance: none of the first {tried.looked_at} gear sets can be made: {tried.reason}")
    return work


def _in_precision(section: ToleranceSection) -> tuple[Tolerances, dict[str, Any]]:
    tolerances = section.tolerances
    if section.precision == "float32":
        tolerances = in_float32(tolerances)
    return tolerances, {"extremes": section.extremes, "chunk": section.chunk, "workers": os.cpu_count() or 1}


def finished(
    section: ToleranceSection,
    work: Work,
    study: Study,
    seconds: float,
    computed: int,
    kept: Further,
    progress: Progress,
) -> ToleranceResults:
    """Make the further studies of a section after its Monte Carlo study.

    Args:
        section: settings of the studies.
        work, study: the Monte Carlo study and its result.
        seconds, computed: wall time without compilation [s], and number of samples computed in this run.
        kept: results of further studies that an earlier run has left.
        progress: function that is called with lines of progress.
    """
    problems: list[str] = []

    def tried(name: str, study: Callable[[ToleranceSection, Progress], Any], otherwise: Any) -> Any:
        """Make a further study; if it fails, the other results are kept."""
        try:
            return kept.get(name, lambda: study(section, progress))
        except GearjaxError as fault:
            problems.append(str(fault))
            return otherwise

    shares, narrowed = tried("sensitivities", _sensitivities, []), tried("tightened", _tightened, {})
    bought, matched = tried("allocation", _allocated, None), tried("assembly", _matched, None)
    missed = kept.get("missed", lambda: _missed(section, work)) if section.extremes == "samples" else {}
    number = min(CHECKED, section.samples)
    interference = kept.get("interference", lambda: clashes(_in_precision(section)[0], work.inputs(0, number)))
    refused = impossible(section.tolerances, work.inputs(0, min(MADE, section.samples)))
    if kept.shown_again:
        progress(f"kept from the run before: {', '.join(kept.shown_again)}")
    told = tuple(problems)
    return ToleranceResults(
        section, study, missed, shares, narrowed, bought, matched, seconds, computed, told, interference, refused
    )


def _sensitivities(section: ToleranceSection, progress: Progress) -> list[Sensitivities]:
    measures = _without_motion(section)
    if not section.sensitivity or not measures:
        return []
    tolerances, options = _in_precision(section)
    return sensitivities(tolerances, measures, n=section.sensitivity, key=section.seed, progress=progress, **options)


def _tightened(section: ToleranceSection, progress: Progress) -> dict[str, dict[str, tuple[Estimate, Estimate]]]:
    measures = [measure for measure in _without_motion(section) if measure.is_limited]
    if not section.sensitivity or not measures:
        return {}
    tolerances, options = _in_precision(section)
    progress("each tolerance halved")
    given = {"number": section.samples, "seed": section.seed, "sampler": section.sampler}
    work = Work(tolerances, measures, **given, **options)
    return tightened(work, min(TIGHTENED_SAMPLES, section.samples), progress=progress)


def _without_motion(section: ToleranceSection) -> list[Measure]:
    return [measure for measure in section.measures if measure.analysis in NO_MOTION]


def _allocated(section: ToleranceSection, progress: Progress) -> AllocatedTolerances | None:
    asked = section.allocation
    if asked is None:
        return None
    tolerances, options = _in_precision(section)
    bounds = {"tightest": asked.tightest, "loosest": asked.loosest}
    return allocate(
        tolerances,
        _named(section, asked.measure),
        required=asked.required,
        costs=asked.costs,
        key=section.seed,
        progress=progress,
        **bounds,
        **options,
    )


def _matched(section: ToleranceSection, progress: Progress) -> MatchedAssembly | None:
    asked = section.assembly
    if asked is None:
        return None
    tolerances, options = _in_precision(section)
    return matched_assembly(
        tolerances,
        _named(section, asked.measure),
        where=asked.where,
        units=asked.units,
        starts=asked.starts,
        key=section.seed,
        progress=progress,
        **options,
    )


def shifts(section: ToleranceSection) -> list[PrecisionShift]:
    """How far float32 shifts the quantiles of a section's measures.

    Raises:
        GearjaxError: the scene lacks what a measure needs, or there is too little memory.
    """
    options = {"sampler": section.sampler, "extremes": section.extremes, "chunk": section.chunk}
    number = min(SHIFTED, section.samples)
    looked_at = dataclasses.replace(section, samples=number, sensitivity=0, allocation=None, assembly=None)
    affordable(looked_at, len(jax.local_devices()), None)
    return precision_shifts(section.tolerances, section.measures, n=number, key=section.seed, **options)


def shifts_as_json(shifted: list[PrecisionShift]) -> list[dict[str, Any]]:
    """The entry of ``gearjax tradeoff --json`` for a tolerance study."""
    return [
        {
            "measure": shift.name,
            "quantile": shift.level,
            "float64_arcmin": shift.double / arcmin,
            "float32_arcmin": shift.single / arcmin,
            "relative_shift": shift.relative,
        }
        for shift in shifted
    ]


def save_shifts(shifted: list[PrecisionShift], folder: Path) -> list[Path]:
    """Write ``float32_quantiles.csv``; no file if no quantiles are given.

    Raises:
        GearjaxError: the folder cannot be written.
    """
    lines = ["measure,quantile [-],float64 [arcmin],float32 [arcmin],relative shift [-]"]
    lines += [",".join(str(value) for value in entry.values()) for entry in shifts_as_json(shifted)]
    return [write_file(folder / "float32_quantiles.csv", "\n".join(lines) + "\n")] if shifted else []


def _named(section: ToleranceSection, name: str):
    return next(measure for measure in section.measures if measure.name == name)


def _missed(section: ToleranceSection, work: Work) -> dict[str, float]:
    """By how much the samples of quasi-static curves miss the extremes between them, on average, by measure [rad].

    Nothing where one matrix couples teeth: a look between the samples of a few gear sets takes longer than the study.
    """
    measures = [m for m in section.measures if m.analysis in NO_MOTION and m.metric not in ("mean", "std")]
    scene = section.tolerances.scene
    if not measures or isinstance(scene.compliance, COUPLED):
        return {}
    dear = each_is_dear(scene)
    number = min(CHECKED_OF_DEAR if dear else CHECKED, section.samples)
    tolerances, options = _in_precision(section)
    closer = Work(tolerances, measures, number=number, seed=section.seed, **{**options, "extremes": "between"})
    inputs = work.inputs(0, number)
    known, _ = work.evaluate(inputs)
    exact, _ = closer.evaluate(inputs)
    known = known[:, [work.names.index(measure.name) for measure in measures]]
    return dict(zip(closer.names, np.nanmean(exact - known, axis=0).tolist(), strict=True))


def save_tolerance(results: ToleranceResults, work: Work, config: str, folder: Path, base: Path) -> list[Path]:
    """Write ``tolerance.json``, and the worst sample of each measure as ``worst_MEASURE.toml``.

    Args:
        results: results of the study.
        work: the Monte Carlo study.
        config: text of the configuration.
        folder: folder of the files.
        base: folder to which file names in the configuration are relative.

    Raises:
        GearjaxError: the folder cannot be written.
    """
    import json

    texts = {"tolerance.json": json.dumps(results.as_json(), allow_nan=False, indent=1) + "\n"}
    parameters = numbers(results.section.tolerances.scene)
    for name in results.study.names:
        index = results.study.worst(name)
        if index >= 0:
            row = work.inputs(index, index + 1)[0].tolist()
            values = dict(zip(work.sample.paths, row, strict=True))
            texts[f"worst_{name}.toml"] = with_numbers(config, values, parameters, base)
    return [write_file(folder / name, text) for name, text in texts.items()]
