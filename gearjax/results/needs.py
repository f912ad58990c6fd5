"""Memory, disk space and time that a tolerance study needs, estimated and reported before anything is set up.

Most sizes follow from the data of the study: its results, its further studies, and the curves of the example gear sets
from which its program is made. The memory of a program itself was measured (peaks of whole runs on two cores, float64;
the numbers below are above all these peaks, by a factor of up to two). It depends on the kind of the curves.
"""

import dataclasses
import math
import os
import shutil
from pathlib import Path

import jax

from gearjax.analysis.choice import suitable_step
from gearjax.checks import ParameterError, place
from gearjax.config import ToleranceSection
from gearjax.contact import HardContact
from gearjax.memory import GIB, fitting, free_memory, size_words
from gearjax.results.store import NAME
from gearjax.scene import Scene
from gearjax.studies.select import numbers
from gearjax.tolerance.closer import places_for
from gearjax.tolerance.curves import FINE
from gearjax.tolerance.measures import TOGETHER
from gearjax.tolerance.population import EXAMPLES
from gearjax.tolerance.variance import DERIVATIVES, LEVELS, TIGHTENED_SAMPLES

PROGRAM = 0.625 * GIB  # bytes of Python, JAX, and programs of few contacts while they are compiled
PROGRAM_PER_CONTACT = 4e6
NUMBER = 8.0  # bytes
JUDGED = 5  # numbers for each sample in the statistics of a measure: values, good ones, sorted, below, drawn
STRATA = 6  # the same for a Latin hypercube, which keeps its orders of strata for up to four names
RESAMPLED = 1000  # numbers for each base sample while SALib resamples it, 100 times
ROWS = 6  # copies of the numbers from which a chunk is drawn, on the host and on the devices
LISTED = 300  # bytes for each chunk of a study
TAKEN = 5  # number of arrays that are as large as the curves of the examples
LOOKED_AT = 9  # arrays for each curve, as large as the contacts of the gear sets, for analyses done in full
STEPS = 8  # numbers for each step and gear set of a motion
BLOCK = 4096  # bytes: smallest size of a file on disk
# seconds for each contact and angle on two cores, see `_work`
SECONDS = {"quick": 0.6e-9, "balances": 7e-10, "other": 40e-9, "train": 400e-9, "dynamic": 3e-9}
SLOPES = 5  # derivatives by all numbers take some times as long as the values
DRAWN = 4e-7  # seconds for each number drawn, on the host
BETWEEN = {"quick": 4.0, "other": 7.0}  # times as long if extremes are searched between the samples
SLOWER = 2.5  # the same for each angle of two-sided contacts, which then need more angles too
SEARCHED = 2e-4  # seconds for each contact of a curve whose extremes are searched in full


@dataclasses.dataclass(frozen=True)
class Needs:
    """Memory, disk space and time that a study needs.

    Args:
        memory: peak memory, by the key of the configuration with which it grows; "" for the part that is constant [B].
        disk: disk space of the stored samples [B].
        files: number of files that hold the stored samples.
        seconds: rough time of the samples, without compilation [s].
        further: the same of sensitivities and of tolerances that are tightened [s].
    """

    memory: dict[str, float]
    disk: float
    files: int
    seconds: float
    further: float = 0.0

    def words(self, stored: bool) -> str:
        """The needs in words, as they are reported."""
        disk = f", {size_words(self.disk)} on disk" if stored else ""
        memory = size_words(sum(self.memory.values()))
        further = f", and {_time(self.further)} for sensitivities" if self.further else ""
        words = f"the study needs about {memory} of memory{disk} and roughly {_time(self.seconds)}{further}"
        return f"{words}, without compiling"


def needs(section: ToleranceSection, devices: int) -> Needs:
    """Estimate what the study of a section needs, without making arrays of its size.

    Args:
        section: settings of the study.
        devices: number of devices that compute in parallel.
    """
    free, measured = len(section.tolerances.paths), len(section.measures)
    chunk = min(section.chunk, section.samples)
    chunks = math.ceil(section.samples / chunk)
    contacts = _contacts(section.tolerances.scene)
    kinds = _kinds(section)
    judged = JUDGED + (STRATA if section.sampler == "latin_hypercube" else 0)
    memory = {
        "": PROGRAM + PROGRAM_PER_CONTACT * contacts,
        "tolerance.samples": section.samples * (NUMBER * (measured + judged) + 4),
        "tolerance.chunk": chunk * ROWS * NUMBER * (free + measured) + chunks * LISTED,
        "run.samples": sum(_curves(section, kind, contacts, devices) for kind in kinds),
        "tolerance.sensitivity.samples": section.sensitivity * NUMBER * (RESAMPLED + 4 * (free + 2) * free),
        "tolerance.assembly.units": 0.0,
    }
    if section.assembly is not None:
        rows = section.assembly.units * section.assembly.starts
        memory["tolerance.assembly.units"] = rows * NUMBER * (4 * free + 4 * len(section.assembly.where))
    column, codes = (math.ceil(chunk * size / BLOCK) for size in (NUMBER, NUMBER / 2))
    disk = float(chunks * BLOCK * (column * measured + codes + 1))
    work = {kind: free * DRAWN + 2 / devices * _work(section, kind, contacts) for kind in kinds}
    still = sum(seconds for kind, seconds in work.items() if kind != "dynamic")
    return Needs(memory, disk, chunks * (measured + 2), section.samples * sum(work.values()), _further(section) * still)


def _further(section: ToleranceSection) -> float:
    """Gear sets that sensitivities and tightened tolerances evaluate."""
    if not section.sensitivity:
        return 0.0
    free = len(section.tolerances.paths)
    slopes = SLOPES * min(section.sensitivity, DERIVATIVES)
    halved = min(section.samples, TIGHTENED_SAMPLES) * (1 + len(section.tolerances.tolerated))
    limited = any(measure.is_limited and measure.analysis != "dynamic" for measure in section.measures)
    return float(section.sensitivity * (free + 2) + free * len(LEVELS) + slopes + halved * limited)


def affordable(section: ToleranceSection, devices: int, folder: Path | None) -> Needs:
    """Estimate what the study of a section needs, and refuse the study if this machine does not have it.

    Args:
        section: settings of the study.
        devices: number of devices that compute in parallel.
        folder: folder of the stored samples; ``None`` if they are not stored.

    Raises:
        ParameterError: there is too little memory or disk space; the message states what would fit.
    """
    needed, available = needs(section, devices), free_memory()
    total = sum(needed.memory.values())
    if available is not None and total > available:
        key = max((key for key in needed.memory if key), key=needed.memory.__getitem__)
        share = (available - (total - needed.memory[key])) / needed.memory[key]
        words = f"needs about {size_words(total)} of memory, {size_words(available)} are free"
        raise ParameterError(key, _given(section, key), f"{words}; {_fitting(_given(section, key), share, key)}")
    if folder is not None:
        _check_disk(section, needed, folder)
    return needed


def _check_disk(section: ToleranceSection, needed: Needs, folder: Path) -> None:
    level = next(level for level in (folder, *folder.absolute().parents) if level.exists())
    marks = folder / NAME / "done" / "c"
    chunks = math.ceil(section.samples / min(section.chunk, section.samples))
    left = max(0.0, 1 - (len(os.listdir(marks)) if marks.is_dir() else 0) / chunks)
    free = shutil.disk_usage(level).free
    if needed.disk * left > free:
        share = free / (needed.disk * left)
        words = (
            f"its samples take {size_words(needed.disk * left)} on disk, {size_words(free)} are free in {place(level)}"
        )
        fits = _fitting(section.samples, share, "tolerance.samples")
        raise ParameterError("tolerance.samples", section.samples, f"{words}; {fits}, or leave --out out with --json")
    if not hasattr(os, "statvfs"):
        return
    disk = os.statvfs(level)
    if disk.f_files and needed.files * left > disk.f_favail:  # 0 if the file system sets no limit
        least = math.ceil(section.chunk * needed.files * left / max(disk.f_favail, 1))
        words = f"its samples take {needed.files} files, {disk.f_favail} more can be made in {place(level)}"
        raise ParameterError("tolerance.chunk", section.chunk, f"{words}; raise it to {least} or more")


def _given(section: ToleranceSection, key: str) -> int:
    run, assembly = section.tolerances.scene.run, section.assembly
    return {
        "tolerance.samples": section.samples,
        "tolerance.chunk": section.chunk,
        "run.samples": 0 if run is None else run.samples,
        "tolerance.sensitivity.samples": section.sensitivity,
        "tolerance.assembly.units": 0 if assembly is None else assembly.units,
    }[key]


def _fitting(given: int, share: float, key: str) -> str:
    if key == "tolerance.chunk" and given < 1024:
        return "raise it: each chunk takes memory of its own"
    return fitting(given * share)


def _contacts(scene: Scene) -> int:
    """Number of candidate contacts of a gear set, both flanks included."""
    contacts = jax.eval_shape(scene.contacts, jax.ShapeDtypeStruct((), scene.dtype))
    return contacts.gap.shape[0]


def _kinds(section: ToleranceSection) -> set[str]:
    """The ways to compute the curves of the measures, as `gearjax.tolerance.measures` chooses them."""
    scene, paths = section.tolerances.scene, section.tolerances.paths
    kinds = {"dynamic"} if any(measure.analysis == "dynamic" for measure in section.measures) else set()
    still = [measure for measure in section.measures if measure.analysis != "dynamic"]
    if not still:
        return kinds
    varies = any(path.startswith("system.") for path in paths)
    if not isinstance(scene.contact, HardContact) or varies:
        return kinds | {"other"}
    linear = all(m.analysis != "static" for m in still) or scene.springs_apart
    if not scene.layout.sides_turn:
        return kinds | {"quick" if linear and not scene.is_train else "other"}
    return kinds | {"balances" if linear and _places(section) is not None else "other"}


def _places(section: ToleranceSection) -> int | None:
    """Number of angles per spacing of the samples at which curves of kind ``balances`` are computed."""
    if section.extremes == "samples":
        return 1
    run, scene = section.tolerances.scene.run, section.tolerances.scene
    assert run is not None
    if run.samples < 3:
        return None
    return places_for(scene, float(scene.system.input_speed) * run.duration / (run.samples - 1), run.samples)


def _angles(section: ToleranceSection) -> int:
    run = section.tolerances.scene.run
    assert run is not None  # read_tolerance refuses a scene without a run section
    return run.samples


def _numbers_of(section: ToleranceSection, dynamic: bool) -> int:
    """Number of different curves that are computed for each gear set."""
    return len({(m.analysis, m.torque) for m in section.measures if (m.analysis == "dynamic") == dynamic})


def _curves(section: ToleranceSection, kind: str, contacts: int, devices: int) -> float:
    """Memory of the curves over all input angles [B]."""
    scene = section.tolerances.scene
    together = TOGETHER[kind] * devices
    if kind == "dynamic":
        return (_steps(scene) + _angles(section) * contacts) * STEPS * NUMBER * together
    if kind == "quick":  # examples at the angles and between them, and gear sets in parallel
        shared = EXAMPLES * FINE * TAKEN
        return _angles(section) * NUMBER * contacts * (shared + together * _numbers_of(section, False))
    if kind == "balances":  # gap per unit of each number; errors of single pins need arrays over all pins
        known = numbers(scene)
        tables = 5 + 2 * len({path.split(".")[1] for path in section.tolerances.paths if path.count(".")})
        angles = _angles(section) * (_places(section) or 1)
        return angles * NUMBER * contacts * tables * (1 + sum(path.endswith("]") for path in known))
    return _angles(section) * NUMBER * contacts * together * LOOKED_AT * _numbers_of(section, False)


def _work(section: ToleranceSection, kind: str, contacts: int) -> float:
    """Rough time of one gear set on two cores [s]."""
    if kind == "dynamic":
        return _numbers_of(section, True) * _steps(section.tolerances.scene) * SECONDS[kind]
    seconds = _angles(section) * SECONDS["train" if kind == "other" and section.tolerances.scene.is_train else kind]
    if kind == "balances":
        seconds *= SLOWER * (_places(section) or 1) if section.extremes == "between" else 1.0
    elif section.extremes == "between":
        seconds = BETWEEN[kind] * seconds + (SEARCHED if kind == "other" else 0.0)
    return _numbers_of(section, False) * contacts * seconds


def _steps(scene: Scene) -> float:
    """Number of time steps of a motion."""
    run = scene.run
    assert run is not None
    return max(run.duration / suitable_step(scene, run.duration).step, float(run.samples))


def _time(seconds: float) -> str:
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.2g} {unit}" if seconds < 99 * size else f"{seconds / size:,.0f} {unit}"
    return f"{max(1, round(seconds))} s"
