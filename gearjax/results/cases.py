"""Results of a run: cases with their metrics, and the files that hold them with units and the configuration."""

import dataclasses
import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import (
    Backlash,
    FixedStep,
    Interference,
    Motion,
    TransmissionError,
    backlash,
    interference,
    simulate,
    transmission_error,
)
from gearjax.analysis.choice import suitable_step
from gearjax.checks import GearjaxError, SceneError
from gearjax.compliance import couples
from gearjax.coordinates import unit_of
from gearjax.files import write_file
from gearjax.results.loads_on_parts import forces_on_bearings
from gearjax.results.profile import FORMATS, export_profile
from gearjax.run import METRICS, Published, Run
from gearjax.scene import Scene
from gearjax.systems import DiscProfile
from gearjax.typing import Array, Scalar
from gearjax.units import arcmin

if TYPE_CHECKING:
    import xarray as xr  # imported in the functions that need it: the import takes a second


@dataclasses.dataclass(frozen=True)
class Case:
    """One analysis at one torque.

    Args:
        analysis: ``no_load``, ``backlash``, ``static`` or ``dynamic``.
        torque: size of the load torque [N m], 0 without load.
        window: length of the part of the record that the metrics use [s].
        settle: time at the start of the record that the metrics leave out [s].
        cycle: time after which the errors repeat [s]; a shorter window is a part of it.
        result: result of the analysis.
        metrics: metrics by name [rad].
        published: published values to compare with, or ``None``.
    """

    analysis: str
    torque: float
    window: float
    settle: float
    cycle: float
    result: TransmissionError | Backlash | Motion
    metrics: dict[str, float]
    published: Published | None

    @property
    def title(self) -> str:
        """Analysis and torque in words."""
        words = self.analysis.replace("_", "-")
        return words if self.analysis in ("no_load", "backlash") else f"{words}, {self.torque:g} N m"

    @property
    def span(self) -> str:
        """The window in seconds and, if the window is only a part of the cycle, the cycle in seconds."""
        return f"{self.window:g}" + (f" of {self.cycle:g}" if self.window < self.cycle * (1 - 1e-6) else "")

    @property
    def record(self) -> np.ndarray:
        """The curve of the case, shape (n,) [rad]."""
        return np.asarray(self.result.backlash if isinstance(self.result, Backlash) else self.result.te)

    def as_json(self) -> dict:
        """The case as ``gearjax run --json`` prints it."""
        metrics = {f"{name}_arcmin": value / arcmin for name, value in self.metrics.items()}
        window = {"window_s": self.window, "cycle_s": self.cycle}
        return {"analysis": self.analysis, "torque_Nm": self.torque, **window, "metrics": metrics}


def required_run(scene: Scene) -> Run:
    """The run section of a scene.

    Raises:
        SceneError: the scene has no run section.
    """
    if scene.run is None:
        raise SceneError("the configuration has no [run]: list duration, samples and analyses")
    return scene.run


def _cycle(scene: Scene) -> float:
    """Input angle after which all errors repeat [rad]: a mesh, if there are none or all teeth have the same."""
    system, errors = scene.system, scene.errors.values()
    alike = all(error.on_flank and all(np.size(leaf) == 1 for leaf in jax.tree.leaves(error)) for error in errors)
    by_mesh = alike and system.turns_evenly and not scene.is_train
    return 2 * math.pi / system.orders["mesh"] if by_mesh else system.cycle


def clash_of(scene: Scene, cases: list[Case]) -> Interference | None:
    """Interference of the rigid bodies over the record; ``None`` if the clearance between both flanks is not known.

    The first result of a case that holds the interference is used; if there is none, the interference is computed.
    """
    if not scene.has_clearance:
        return None
    for case in cases:
        clash = None if isinstance(case.result, Motion) else case.result.interference
        if clash is not None:
            return clash
    return interference(scene, scene.system.input_speed * jnp.asarray(required_run(scene).times))


def run_cases(scene: Scene, stepper: FixedStep | None = None, *, workers: int = 1) -> Iterator[Case]:
    """Run every analysis that the run section lists, one after the other.

    Args:
        scene: the scene.
        stepper: stepper of the dynamic TE, in place of `suitable_step`.
        workers: number of analyses whose programs are compiled in parallel, in threads. A thread uses the settings of
            the whole process, but not settings of the calling thread alone.

    Raises:
        SceneError: there is no run section, or an analysis cannot be done.
    """
    run = required_run(scene)
    if "dynamic" in run.analyses:
        suitable_step(scene, run.duration)  # raises its error before anything is computed
    ts = jnp.asarray(run.times)
    torques = torques_of(run)
    # XLA's threads wait for each other for ever if two programs with many small factorisations run in parallel
    if workers == 1 or couples(scene.compliance):
        for analysis in run.analyses:
            yield from (_computed(scene, run, analysis, torque, ts, stepper) for torque in torques[analysis])
        return
    with ThreadPoolExecutor(workers) as pool:
        # the program of the first torque serves all torques; the last analysis, the dynamic one, takes longest
        begun = {
            analysis: pool.submit(_computed, scene, run, analysis, torques[analysis][0], ts, stepper)
            for analysis in reversed(run.analyses)
        }
        for analysis in run.analyses:
            yield begun[analysis].result()
            yield from (_computed(scene, run, analysis, torque, ts, stepper) for torque in torques[analysis][1:])


def _computed(scene: Scene, run: Run, analysis: str, torque: float, ts: Array, stepper: FixedStep | None) -> Case:
    theta = scene.system.input_speed * ts
    if analysis == "no_load":
        return _case(scene, run, analysis, torque, transmission_error(scene, theta))
    if analysis == "backlash":
        return _case(scene, run, analysis, torque, backlash(scene, theta))
    if analysis == "static":
        result = transmission_error(scene, theta, torque_history(scene, ts, torque))
        if bool((result.result != 0).any()):
            words = "no flank of this scene can carry the torque"
            if not bool((result.result == 1).any()):
                words = "the equilibrium was not found, a value of the scene is too extreme"
            raise SceneError(f"static at {torque:g} N*m: {words}")
        return _case(scene, run, analysis, torque, result)
    motion = simulate(scene, ts, torque, start=run.start, settle=run.settle, stepper=stepper)
    return _case(scene, run, analysis, torque, motion)


def torque_history(scene: Scene, ts: Array, torque: float) -> Array | float:
    """Load torque of a scene over time [N m]: shape (n,) if it alternates, else one number."""
    if scene.load is None or not scene.load.alternates:
        return torque
    turns = scene.system.input_speed * ts / (2 * jnp.pi)
    return torque * scene.load.shape(turns, ts, scene.system.orders)


@eqx.filter_jit
def _metrics_of(result: TransmissionError | Backlash | Motion) -> dict[str, Scalar]:
    """All metrics in one program: otherwise each operation would be compiled separately."""
    return {name: getattr(result, name) for name in METRICS}


def torques_of(run: Run) -> dict[str, tuple[float, ...]]:
    """Torques of each analysis of a run [N m]."""
    return {name: run.torques if name in ("static", "dynamic") else (0.0,) for name in run.analyses}


def belongs(entry: Published, analysis: str, torque: float) -> bool:
    """Whether published values are those of an analysis under a torque [N m]."""
    return entry.analysis == analysis and abs(entry.torque - torque) < 1e-9 + 1e-9 * abs(torque)


def _case(scene: Scene, run: Run, analysis: str, torque: float, result: TransmissionError | Backlash | Motion) -> Case:
    metrics = {name: float(value) for name, value in _metrics_of(result).items()}
    if not np.isfinite(list(metrics.values())).all():
        raise SceneError(f"{analysis} at {torque:g} N*m: the result is not finite, a value of the scene is too extreme")
    settle = run.settle if analysis == "dynamic" else 0.0
    published = [entry for entry in run.published if belongs(entry, analysis, torque)]
    cycle = _cycle(scene) / float(scene.system.input_speed)
    return Case(
        analysis, torque, run.duration - settle, settle, cycle, result, metrics, published[0] if published else None
    )


def dataset(scene: Scene, cases: list[Case], config: str) -> "xr.Dataset":
    """All curves of a run with named dimensions, units as attributes and the configuration inside.

    Args:
        scene: the scene.
        cases: cases of the run.
        config: text of the configuration.
    """
    import xarray as xr

    run = required_run(scene)
    time = run.times
    theta = time * float(scene.system.input_speed)
    coordinates: dict[str, tuple] = {
        "time": ("time", time, {"units": "s", "long_name": "time"}),
        "theta": ("time", theta, {"units": "rad", "long_name": "input angle"}),
    }
    variables = {}
    for case in cases:
        name = case.analysis if case.analysis in ("no_load", "backlash") else f"{case.analysis}_{case.torque:.12g}_Nm"
        name = name.replace("-", "minus_").replace("+", "")
        attributes = {"units": "rad", "long_name": f"{case.title}", "window_s": case.window, "torque_Nm": case.torque}
        attributes |= {f"{metric}_rad": value for metric, value in case.metrics.items()}
        variables[name] = ("time", case.record, attributes)
        forces = getattr(case.result, "forces", None)
        if forces is not None:
            names = "; ".join(scene.system.contact_name(contact) for contact in range(np.shape(forces)[-1]))
            label = {"units": "N", "long_name": f"contact forces, {case.title}", "contacts": names}
            variables[f"{name}_force"] = (("time", "contact"), np.asarray(forces), label)
        if isinstance(case.result, TransmissionError | Motion) and case.result.moved is not None:
            moving = case.result.coordinates[1:]
            units = [unit_of(coordinate) for coordinate in moving]
            label = {
                "units": ", ".join(sorted(set(units))),
                "long_name": f"motion of bodies other than the output, {case.title}",
            }
            variables[f"{name}_moved"] = (("time", "coordinate"), np.asarray(case.result.moved), label)
            coordinates["coordinate"] = ("coordinate", list(moving), {})
            coordinates["coordinate_unit"] = ("coordinate", units, {})
        held = forces_on_bearings(scene, case.result)
        if held is not None:
            label = {"units": "N, N m", "long_name": f"forces of bodies on their supports, {case.title}"}
            variables[f"{name}_bearing_force"] = (("time", "support"), np.asarray(held.forces), label)
            coordinates["support"] = ("support", list(held.names), {})
        if isinstance(case.result, Backlash):
            for edge in ("lower", "upper"):
                label = {"units": "rad", "long_name": f"{edge} edge of the backlash"}
                variables[f"{name}_{edge}"] = ("time", np.asarray(getattr(case.result, edge)), label)
    return xr.Dataset(variables, coordinates, {"title": "gearjax run", "config": config})


def save(scene: Scene, cases: list[Case], config: str, folder: Path) -> list[Path]:
    """Write ``results.nc`` (netCDF), ``curves.csv`` and ``metrics.csv``; for a cycloidal disc its profile too.

    Raises:
        GearjaxError: the folder cannot be written.
    """
    contents = {
        "results.nc": bytes(dataset(scene, cases, config).to_netcdf(engine="scipy")),
        "curves.csv": _curves(scene, cases),
        "metrics.csv": _metrics(cases),
    }
    paths = [write_file(folder / name, content) for name, content in contents.items()]
    if isinstance(scene.system, DiscProfile):
        paths += [export_profile(scene.system, folder / f"disc{ending}") for ending in FORMATS]
    return paths


def stored_config(path: Path) -> str:
    """The configuration inside a results file.

    Raises:
        GearjaxError: the file is not a results file of gearjax.
    """
    import xarray as xr

    try:
        with xr.open_dataset(path, engine="scipy") as stored:
            return str(stored.attrs["config"])
    except Exception as fault:  # the reader raises many kinds of errors for damaged files
        raise GearjaxError(f"{path}: not a results file of gearjax") from fault


def _table(header: list[str], rows: list[list[str]]) -> str:
    return "\n".join([",".join(header), *(",".join(row) for row in rows)]) + "\n"


def _curves(scene: Scene, cases: list[Case]) -> str:
    run = required_run(scene)
    time = run.times
    header = ["time [s]", "input angle [rad]", *(f"{case.title.replace(',', '')} [arcmin]" for case in cases)]
    columns = [time, time * float(scene.system.input_speed), *(case.record / arcmin for case in cases)]
    return _table(header, [[f"{value:.9g}" for value in row] for row in np.stack(columns, axis=1)])


def _metrics(cases: list[Case]) -> str:
    header = [
        "analysis",
        "torque [N m]",
        "window [s]",
        *(f"{name} [arcmin]" for name in METRICS),
        "load sharing factor [-]",
    ]
    rows = []
    for case in cases:
        sharing = highest_load_sharing(case)
        values = [f"{case.metrics[name] / arcmin:.9g}" for name in METRICS]
        rows.append(
            [
                case.analysis,
                f"{case.torque:g}",
                f"{case.window:g}",
                *values,
                "" if sharing is None else f"{sharing:.9g}",
            ]
        )
    return _table(header, rows)


@eqx.filter_jit
def _sharing(result: TransmissionError | Motion) -> Array:
    """Load-sharing factor; nan for a motion before it has settled."""
    return (
        jnp.where(result.settled, result.load_sharing, jnp.nan) if isinstance(result, Motion) else result.load_sharing
    )


def highest_load_sharing(case: Case) -> float | None:
    """Highest load-sharing factor of a case, after settling; ``None`` if the case has no forces."""
    if isinstance(case.result, Backlash) or case.result.forces is None:
        return None
    sharing = np.asarray(_sharing(case.result))
    return float(np.nanmax(sharing)) if np.isfinite(sharing).any() else None
