"""Every public function and every command on every gear set, every one of them for a number of each kind.

Each gives finite numbers, or refuses in one line that names what is missing. A new function, command or gear set that
is not listed here fails. Functions of numbers, commands, and functions on supports meet in pairs: every function with
every gear set, with every kind and on supports, every gear set with every kind and on supports, and all refusals. With
the variable ``GEARJAX_TESTS_WHOLE`` set to anything they meet in every combination, which takes three times as long.
"""

import dataclasses
import inspect
import itertools
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.cli import app, main
from gearjax.config import read_file, read_tables
from gearjax.studies.select import pick
from gearjax.systems import SYSTEMS
from gearjax.units import arcmin, um
from tests.conftest import ROOT

TORQUE = 20.0
RUN = {
    "duration": "0.3 s",
    "samples": 61,
    "analyses": ["no_load", "backlash", "static", "dynamic"],
    "torques": ["20 N*m"],
}


@dataclasses.dataclass(frozen=True)
class Number:
    """A number of a scene that a study may change: its path, and its bounds as a configuration has them and in SI."""

    path: str
    written: tuple[str | float, str | float] | None = None
    ends: tuple[float, float] = (-np.pi, np.pi)

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        return {} if self.written is None else {self.path: self.ends}

    @property
    def step(self) -> float:
        return (self.ends[1] - self.ends[0]) / 2

    @property
    def spread(self) -> gj.UniformPhase | gj.Uniform:
        return gj.UniformPhase() if self.written is None else gj.Uniform(*self.ends)

    @property
    def written_spread(self) -> dict[str, Any]:
        if self.written is None:
            return {"kind": "uniform_phase"}
        return {"kind": "uniform", "low": self.written[0], "high": self.written[1]}


@dataclasses.dataclass(frozen=True)
class GearSet:
    """A small gear set: a shipped configuration, changed, with numbers of each kind."""

    file: str
    changes: Mapping[str, Any]
    numbers: Mapping[str, Number]

    @property
    def tables(self) -> dict[str, Any]:
        found = read_tables(read_file(ROOT / "configs" / self.file))
        found["system"] |= self.changes["system"]
        return found | {"run": RUN} | {key: part for key, part in self.changes.items() if key != "system"}

    @property
    def scene(self) -> gj.Scene:
        return gj.loads(tomli_w.dumps(self.tables))


PINS = {"kind": "positions", "body": "pin_ring", "outward": [f"{x} um" for x in (1, 0, -1, 0, 2, 0)], "around": []}
DISC = {"kind": "eccentricity", "body": "disc_1", "amplitude": "2 um", "phase": "20 deg"}
RUN_OUT = {"kind": "eccentricity", "body": "wheel_1", "amplitude": "10 um", "phase": "120 deg"}
RELIEF = {"kind": "tip_relief", "body": "pinion_1", "amount": ["12 um"], "length": "7 mm"}
GEAR_SETS = {
    "two_kv": GearSet(
        "two_kv/wang_2020.toml",
        {"system": {}},
        {
            "phase": Number("errors.planet_1.phase"),
            "amplitude": Number("errors.planet_1.amplitude", ("2 um", "8 um"), (2 * um, 8 * um)),
            "element": Number("compliance.relative_amplitudes[0]", (0.05, 0.15), (0.05, 0.15)),
            "system": Number("system.module", ("2.45 mm", "2.55 mm"), (2.45e-3, 2.55e-3)),
        },
    ),
    "rv_cycloidal": GearSet(
        "rv_cycloidal/hu_2020.toml",
        {
            "system": {
                "pins": 6,
                "pin_circle": "20 mm",
                "pin_radius": "2 mm",
                "eccentricity": "1.2 mm",
                "discs": 1,
                "input_speed": "300 rpm",
            },
            "errors": {"disc_1": DISC, "pins": PINS},
        },
        {
            "phase": Number("errors.disc_1.phase"),
            "amplitude": Number("errors.disc_1.amplitude", ("1 um", "3 um"), (1 * um, 3 * um)),
            "element": Number("errors.pins.outward[4]", ("-3 um", "3 um"), (-3 * um, 3 * um)),
            "system": Number("system.isometric_modification", ("-24 um", "-20 um"), (-24 * um, -20 * um)),
        },
    ),
}
GEAR_SETS["involute_rv"] = GearSet(
    "involute_rv/yang_2019.toml",
    {
        "system": {"pairs": 7, "profile_points": 1, "input_speed": "60 rpm"},
        "compliance": {
            "kind": "harmonic_stiffness",
            "mean": "2e8 N/m",
            "relative_amplitudes": [0.1],
            "phases": ["0 deg"],
        },
        "load": {"kind": "constant"},
        "inertia": {"moment_of_inertia": "0.5 kg*m^2"},
        "damping": {"ratio": 0.05},
    },
    {
        "phase": Number("errors.gear_1.phase"),
        "amplitude": Number("errors.gear_1.amplitude", ("1 um", "3 um"), (1 * um, 3 * um)),
        "element": Number("compliance.relative_amplitudes[0]", (0.05, 0.15), (0.05, 0.15)),
        "system": Number("system.centre_distance", ("1.498 mm", "1.5 mm"), (1.498e-3, 1.5e-3)),
    },
)
GEAR_SETS["helical_pair"] = GearSet(
    "helical/guo_2018.toml",
    {
        "system": {"slices": 1, "input_speed": "600 rpm"},
        "compliance": {
            "kind": "harmonic_stiffness",
            "mean": "8e8 N/m",
            "relative_amplitudes": [0.1],
            "phases": ["0 deg"],
        },
        "backlash": {"initial": "20 um"},
        "inertia": {"moment_of_inertia": "0.4 kg*m^2"},
        "damping": {"ratio": 0.05},
        "run": RUN | {"analyses": ["no_load", "backlash", "static"]},
    },
    {
        "phase": Number("errors.pinion.phase"),
        "amplitude": Number("errors.pinion.amplitude", ("10 um", "20 um"), (10 * um, 20 * um)),
        "element": Number("compliance.relative_amplitudes[0]", (0.05, 0.15), (0.05, 0.15)),
        "system": Number("system.centre_distance", ("201 mm", "201.2 mm"), (0.201, 0.2012)),
    },
)
GEAR_SETS["elliptic_pair"] = GearSet(
    "elliptic/dong_2020.toml",
    {"system": {"input_speed": "60 rpm"}},
    {
        "phase": Number("errors.driver.phase"),
        "amplitude": Number("errors.driver.amplitude", ("10 um", "20 um"), (10 * um, 20 * um)),
        "element": Number("compliance.relative_amplitudes[0]", (0.05, 0.15), (0.05, 0.15)),
        "system": Number("system.eccentricity", (0.3, 0.35), (0.3, 0.35)),
    },
)
GEAR_SETS["helical_train"] = GearSet(
    "helical/two_stage.toml",
    {
        "system": {"slices": 1, "pairs": 3, "input_speed": "60 rpm"},
        "backlash": {"initial": "20 um"},
        "compliance": {"kind": "line_stiffness", "per_length": "14 N/mm/um"},
        "errors": {"run_out_2": RUN_OUT, "tip_1": RELIEF},
    },
    {
        "phase": Number("errors.run_out_2.phase"),
        "amplitude": Number("errors.run_out_2.amplitude", ("5 um", "10 um"), (5 * um, 10 * um)),
        "element": Number("errors.tip_1.amount[0]", ("5 um", "15 um"), (5 * um, 15 * um)),
        "system": Number("system.face_width[1]", ("33 mm", "35 mm"), (33e-3, 35e-3)),
    },
)
KINDS = ("phase", "amplitude", "element", "system")
OTHER_RATIO = [1.4, 1.28, 1.0, 0.72, 0.6, 0.72, 1.0, 1.28]  # of a noncircular_pair, else an elliptic_pair


class Case:
    """A gear set, and a number of it."""

    def __init__(self, gear_set: str, *kinds: str):
        self.gear_set = GEAR_SETS[gear_set]
        self.numbers = [self.gear_set.numbers[kind] for kind in kinds]
        self.scene = self.gear_set.scene
        self.where = [number.path for number in self.numbers]
        self.ts = np.linspace(0.0, 0.05, 26)
        self.theta = float(self.scene.system.input_speed) * np.linspace(0.0, 0.3, 31)

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        return {path: ends for number in self.numbers for path, ends in number.bounds.items()}

    @property
    def steps(self) -> dict[str, float]:
        return {number.path: number.step for number in self.numbers}

    @property
    def moved(self) -> gj.Scene:
        """The gear set with its numbers moved within their bounds."""
        values = jnp.asarray([number.ends[0] + 0.3 * number.step for number in self.numbers])
        return pick(self.scene, self.where).set(self.scene, values)

    @property
    def still(self) -> gj.Scene:
        """The same without errors, whose TE repeats with the order of ``repeats``."""
        return dataclasses.replace(self.moved, errors={}, reference=None)

    @property
    def repeats(self) -> dict[str, Any]:
        """The order with which the excitation repeats, and enough steps: the mesh, or all meshes of a turn."""
        by_mesh = self.scene.system.turns_evenly and not self.scene.is_train
        return {"order": "mesh", "steps": 160} if by_mesh else {"order": "output", "steps": 8192}

    @property
    def period(self) -> float:
        """Time after which the TE without errors repeats [s]."""
        return 2 * np.pi / float(self.scene.system.orders[self.repeats["order"]] * self.scene.system.input_speed)

    @property
    def rest(self) -> np.ndarray:
        """A guess for `gj.shooting`, which then shares its program with `gj.periodic_motion`."""
        return np.zeros(2 if self.scene.output_alone else (2, len(self.scene.coordinates)))

    @property
    def population(self) -> gj.Tolerances:
        return gj.Tolerances(self.scene, {number.path: number.spread for number in self.numbers})

    @property
    def recording(self) -> gj.Measurement:
        return gj.synthetic_measurement(self.moved, TORQUE, rows=64, turns=2 * self.scene.system.orders["output"])

    @property
    def identified(self) -> gj.Identification:
        first = next(name for name, error in self.scene.errors.items() if isinstance(error, gj.Eccentricity))
        return gj.identify(self.moved, self.recording, [f"errors.{first}"], starts=1, orders=[], suggest=False)

    def te(self, torque: float | None = None) -> Any:
        return gj.transmission_error(self.moved, self.theta, torque)


def _written(export: Callable[..., Any], scene: gj.Scene) -> Any:
    """A file that a function writes."""
    return export(scene, Path(tempfile.mkdtemp()) / "disc.csv", tolerance=1e-5)


LOSS, MEASURE = "no_load_std", "no_load.std"
STEEL = gj.HertzLineContact(206e9, 0.3, 10e-3)
QUICK = ("lost_motion", "order_spectrum", "ratio_error", "separation_speed", "torsion", "transmission_error")
OF_A_SCENE: dict[str, Callable[[Case], Any]] = {
    "backlash": lambda case: gj.backlash(case.moved, case.theta),
    "chosen_steps": lambda case: gj.chosen_steps(case.moved, case.ts, TORQUE).step,
    "accuracy_grades": lambda case: gj.accuracy_grades(case.scene, case.scene.system.bodies[0]),
    "compare": lambda case: [record.computed for record in gj.compare(case.moved, case.recording).records],
    "bearing_forces": lambda case: gj.bearing_forces(case.moved, case.te(TORQUE)).forces,
    "contact_pressure": lambda case: gj.contact_pressure(case.moved, case.te(TORQUE), STEEL),
    "face_load": lambda case: gj.face_load(case.moved, case.te(TORQUE)).factor,
    "identify": lambda case: case.identified.fit.values,
    "interference": lambda case: gj.interference(case.moved, case.theta),
    "joint_model": lambda case: gj.joint_model(case.moved, TORQUE).cosine,
    "export_joint": lambda case: len(gj.export_joint(case.moved, tempfile.mkdtemp(), torque=TORQUE)),
    "export_profile": lambda case: np.loadtxt(_written(gj.export_profile, case.moved), delimiter=",", skiprows=1),
    "growth_rate": lambda case: gj.growth_rate(case.moved, case.ts, TORQUE),
    "fourier_series": lambda case: gj.fourier_series(case.still, TORQUE, case.period, harmonics=3).te,
    "harmonic_balance": lambda case: gj.harmonic_balance(case.still, TORQUE, case.period, harmonics=3).te,
    "lost_motion": lambda case: gj.lost_motion(case.moved, case.theta, TORQUE),
    "meshing_impact": lambda case: gj.meshing_impact(case.moved, TORQUE).force,
    "mesh_stiffness": lambda case: gj.mesh_stiffness(case.moved, case.theta, TORQUE),
    "natural_modes": lambda case: gj.natural_modes(case.moved, TORQUE).frequencies,
    "one_contact": lambda case: gj.one_contact(case.still, TORQUE).error(0.8 * TORQUE),
    "order_spectrum": lambda case: gj.order_spectrum(case.te().te, case.theta),
    "ratio_error": lambda case: gj.ratio_error(case.moved, case.theta),
    "separation_speed": lambda case: gj.separation_speed(case.moved, TORQUE),
    "posterior": lambda case: gj.posterior(case.identified, chains=2, draws=4, warm_up=10).draws,
    "periodic_motion": lambda case: (
        gj.periodic_motion(case.still, TORQUE, case.period, steps=case.repeats["steps"], longest=1, settle=12).te
    ),
    "reassemble": lambda case: gj.reassemble(case.identified, steps={case.identified.vectors[0]: 4}, draws=4).after,
    "shooting": lambda case: (
        gj.shooting(case.still, TORQUE, case.period, steps=case.repeats["steps"], guess=case.rest).te
    ),
    "simulate": lambda case: gj.simulate(case.moved, case.ts, TORQUE),
    "speed_sweep": lambda case: gj.speed_sweep(case.still, TORQUE, np.array([20.0, 30.0]), periods=4, **case.repeats),
    "synthetic_measurement": lambda case: case.recording.output,
    "torque_sweep": lambda case: gj.torque_sweep(
        case.moved, np.arange(12) * np.pi / 6 / case.scene.system.orders["mesh"], np.array([0.5 * TORQUE, TORQUE])
    ),
    "torsion": lambda case: gj.torsion(case.moved, case.theta[:3], np.array([-TORQUE, TORQUE])),
    "transmission_error": lambda case: [case.te(), case.te(TORQUE)],
    "waterfall": lambda case: (
        gj.waterfall(case.still, TORQUE, np.array([20.0, 30.0]), harmonics=2, **case.repeats).peak_to_peak
    ),
}
OF_NUMBERS: dict[str, Callable[[Case], Any]] = {
    "allocate": lambda case: (
        gj.allocate(
            case.population,
            gj.Measure.named("static.peak_to_peak@20Nm", limit=3 * arcmin),
            required=0.5,
            costs=dict.fromkeys(case.where, ((0.5, 2.0), (1.0, 1.0))),
            n=64,
            judged=256,
            theta=case.theta,
            extremes="samples",
        ).factors
    ),
    "compensate": lambda case: (
        gj.compensate(case.scene, case.theta, TORQUE, case.where, bounds=case.bounds).after.mean_lag
    ),
    "grid_search": lambda case: (
        gj.grid_search(
            "static_peak_to_peak",
            case.scene,
            where=case.where,
            step=case.steps,
            bounds=case.bounds,
            theta=case.theta,
            torque=TORQUE,
            keep=2,
        ).objectives
    ),
    "local_sensitivity": lambda case: (
        gj.local_sensitivity(LOSS, case.scene, where=case.where, bounds=case.bounds, theta=case.theta).worst
    ),
    "matched_assembly": lambda case: (
        gj.matched_assembly(
            case.population,
            MEASURE,
            where=tuple(case.where),
            units=4,
            starts=2,
            theta=case.theta,
            extremes="samples",
        ).matched
    ),
    "minimise": lambda case: (
        gj.minimise(
            LOSS,
            case.scene,
            where=case.where,
            bounds=case.bounds,
            theta=case.theta,
            starts=2,
            steps=3,
            polish_steps=2,
        ).ends
    ),
    "monte_carlo": lambda case: (
        gj.monte_carlo(
            case.population,
            ["no_load.std", "static.mean@20Nm", "backlash.minimum"],
            n=8,
            theta=case.theta,
            extremes="samples",
        ).values
    ),
    "sensitivities": lambda case: [
        found.total
        for found in gj.sensitivities(case.population, "static.mean@20Nm", n=16, theta=case.theta, extremes="samples")
    ],
}
OF_NO_GEAR_SET = {
    "flank_tolerance",
    "read_flank",
    "read_measurement",
    "read_pitch",
    "influence_between",
    "influence_on_grid",
    "read_influence",
    "save_influence",
    "tooth_influence",
    "it_tolerance",
    "iso6336_stiffness",
    "load",
    "loads",
    "run_out_tolerance",
    "register",
    "single_pitch_tolerance",
    "total_pitch_tolerance",
    "xla_options",
}
MOTION = (
    *(
        "chosen_steps",
        "fourier_series",
        "growth_rate",
        "harmonic_balance",
        "natural_modes",
        "periodic_motion",
        "shooting",
        "simulate",
    ),
    *("speed_sweep", "waterfall"),
)
REFUSED = {  # function, gear set and kind of number, or "" for all: what is missing
    ("accuracy_grades", "", ""): "lists no measured_flank",
    ("bearing_forces", "", ""): "need supports",
    ("contact_pressure", "two_kv", ""): "line contacts",
    **{
        ("meshing_impact", kind, ""): "is for a helical_pair"
        for kind in ("two_kv", "rv_cycloidal", "involute_rv", "elliptic_pair", "helical_train")
    },
    ("contact_pressure", "elliptic_pair", ""): "line contacts",
    **{
        ("face_load", kind, ""): "needs slices across the face"
        for kind in ("two_kv", "rv_cycloidal", "involute_rv", "elliptic_pair")
    },
    **{
        (name, "elliptic_pair", ""): "needs an output that turns evenly"
        for name in ("one_contact", "joint_model", "export_joint")
    },
    ("one_contact", "helical_train", ""): "errors repeat after",  # its meshes do not repeat together
    **{(name, "involute_rv", ""): "more than 131072" for name in ("joint_model", "export_joint")},
    **{
        ("separation_speed", kind, ""): "an output that turns unevenly"
        for kind in ("two_kv", "rv_cycloidal", "involute_rv", "helical_pair", "helical_train")
    },
    **{
        ("export_profile", kind, ""): "has no disc with a profile"
        for kind in ("two_kv", "involute_rv", "helical_pair", "helical_train")
    },
    ("allocate", "", "phase"): "is no tolerance",
    **{(name, "helical_pair", ""): "reduces all to one contact" for name in MOTION},
    ("matched_assembly", "helical_train", "phase"): "only the output moves",
    **{("matched_assembly", "", kind): "phases" for kind in KINDS[1:]},
    **{
        (name, kind, "element"): "does not depend on it"
        for name in ("compensate", "grid_search", "minimise", "optimise")
        for kind in ("two_kv", "involute_rv", "helical_pair", "elliptic_pair")
    },
}
MOVES = [name for name in GEAR_SETS if ("simulate", name, "") not in REFUSED]  # by their own contacts


def refusal(function: str, gear_set: str, kind: str) -> str | None:
    """What a function says that it lacks for a gear set and a kind of number; ``None`` where it works."""
    keys = [(function, a, b) for a in (gear_set, "") for b in (kind, "")]
    return next((REFUSED[key] for key in keys if key in REFUSED), None)


WHOLE = "GEARJAX_TESTS_WHOLE" in os.environ


def chosen(names: Iterable[str], pairs: tuple[tuple[int, int], ...]) -> list[tuple[str, str, str]]:
    """Few of the combinations of a name, a gear set and a kind in which all pairs of these occur, and all refusals.

    Args:
        names: of functions or commands.
        pairs: places of those that are to meet in a combination.
    """
    every = list(itertools.product(names, GEAR_SETS, KINDS))
    found = [one for one in every if refusal(*one)]
    missing = {(pair, tuple(one[i] for i in pair)) for one in every if not refusal(*one) for pair in pairs}

    def news(one: tuple[str, str, str]) -> int:
        return len({(pair, tuple(one[i] for i in pair)) for pair in pairs} & missing)

    while missing:
        best = max((one for one in every if not refusal(*one)), key=news)
        missing -= {(pair, tuple(best[i] for i in pair)) for pair in pairs}
        found.append(best)
    return every if WHOLE else sorted(found, key=every.index)


def test_chosen_combinations_have_all_pairs():
    every = set(itertools.product(OF_NUMBERS, GEAR_SETS, KINDS))
    found = set(chosen(OF_NUMBERS, ((0, 1), (0, 2), (1, 2))))
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert {(one[i], one[j]) for one in found} == {(one[i], one[j]) for one in every}
    assert {one for one in every if refusal(*one)} <= found
    assert WHOLE or len(found) < 100


def is_finite(found: Any) -> bool:
    """Whether all numbers of a result are, and there are some."""
    leaves = [leaf for leaf in jax.tree.leaves(found) if isinstance(leaf, (jax.Array, np.ndarray, float, int))]
    return bool(leaves) and all(np.isfinite(leaf).all() for leaf in leaves)


def check(name: str, call: Callable[[Case], Any], gear_set: str, *kinds: str) -> None:
    judge(call, Case(gear_set, *kinds), refusal(name, gear_set, kinds[0] if len(kinds) == 1 else ""))


def judge(call: Callable[[Case], Any], case: Case, words: str | None) -> None:
    """Finite numbers, or the words of a refusal in one line."""
    if words is None:
        assert is_finite(call(case))
        return
    with pytest.raises(gj.GearjaxError) as caught:
        call(case)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_function_and_every_gear_set_is_listed():
    functions = {name for name in gj.__all__ if inspect.isfunction(getattr(gj, name))}
    assert functions == set(OF_A_SCENE) | set(OF_NUMBERS) | OF_NO_GEAR_SET
    for name in OF_NO_GEAR_SET:
        annotations = map(str, inspect.get_annotations(getattr(gj, name)).values())
        assert not any(word in text for text in annotations for word in ("scene: ", "tolerances: "))
    assert {*GEAR_SETS, "noncircular_pair"} == {system.kind for system in SYSTEMS}
    assert all(tuple(gear_set.numbers) == KINDS for gear_set in GEAR_SETS.values())


@pytest.mark.filterwarnings("ignore::gearjax.UnclosedRecord")  # one mesh of gears with errors
@pytest.mark.parametrize("gear_set", GEAR_SETS)
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in OF_A_SCENE]
)
def test_functions_of_a_scene(name, gear_set):
    """With a number of each kind moved, together; one by one too where that is quick."""
    check(name, OF_A_SCENE[name], gear_set, *KINDS)
    for kind in KINDS if WHOLE or name in QUICK else ():
        check(name, OF_A_SCENE[name], gear_set, kind)


@pytest.mark.slow
@pytest.mark.parametrize("gear_set", GEAR_SETS)
def test_contacts_take_numbers_of_python(gear_set):
    scene = Case(gear_set, "system").scene
    for one, other in zip(
        jax.tree.leaves(scene.contacts(0.3)), jax.tree.leaves(scene.contacts(jnp.asarray(0.3))), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    traced, known = jax.jit(lambda at: scene.contacts(at))(1), scene.contacts(1)  # whole numbers stay no integers
    np.testing.assert_allclose(traced.gap, known.gap, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(traced.jacobian, known.jacobian, rtol=1e-9, atol=1e-15)
    with pytest.raises(gj.ParameterError, match=r'^theta = "poses at 2 angles": must be one pose'):
        scene.contacts(jax.vmap(scene.pose)(jnp.array([0.1, 0.2])))
    other = Case("elliptic_pair" if gear_set != "elliptic_pair" else "two_kv", "system").scene
    with pytest.raises(gj.ParameterError, match=r'^theta = "a pose .*: must be scene.pose\(angle\) of'):
        scene.contacts(other.pose(0.3))
    for wrong in (1j, np.nan, np.array([0.1, 0.2]), jnp.array([0.1, 0.2]), jax.random.key(0)):
        for name, ask in {"theta": scene.contacts, "position": lambda at: scene.contacts(0.3, position=at)}.items():
            with pytest.raises(gj.ParameterError, match=f"^{name} = .*: must be one finite angle in rad$"):
                ask(wrong)
    with pytest.raises(gj.ParameterError, match=r"^theta = .*: must be one finite angle in rad"):  # JAX adds a note
        jax.jit(lambda at: scene.pose(at))(jnp.array([0.1, 0.2]))
    with pytest.raises(gj.ParameterError, match=r"^theta = .*bool"):
        jax.jit(lambda at: scene.pose(at))(True)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")
@pytest.mark.parametrize("name", ["ratio_error", "simulate", "grid_search", "minimise", "monte_carlo"])
def test_functions_of_gears_by_a_table(name):
    """A noncircular_pair is an elliptic_pair with another ratio function: what asks for it in each way."""
    case = Case("elliptic_pair", "system")
    tables = case.gear_set.tables
    system = {key: tables["system"][key] for key in ("module", "input_speed")}
    system |= {"kind": "noncircular_pair", "teeth": 48, "ratio": OTHER_RATIO}
    case.scene = gj.loads(tomli_w.dumps(tables | {"system": system}))
    case.numbers = [Number("system.ratio[2]", (0.999, 1.001), (0.999, 1.001))]
    case.where = [number.path for number in case.numbers]
    judge((OF_A_SCENE | OF_NUMBERS)[name], case, None)


@pytest.mark.filterwarnings("ignore::gearjax.UnclosedRecord")
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")  # what comes out matters here, not how exact it is
@pytest.mark.parametrize(
    ("name", "gear_set", "kind"),
    [
        pytest.param(*one, marks=[] if refusal(one[0], "", one[2]) else pytest.mark.slow)
        for one in chosen(OF_NUMBERS, ((0, 1), (0, 2), (1, 2)))
    ],
)
def test_functions_of_numbers(name, kind, gear_set):
    check(name, OF_NUMBERS[name], gear_set, kind)


def on_supports(scene: gj.Scene) -> gj.Scene:
    """All bodies free in x and y, with the inertia that they then need."""
    supports = dict.fromkeys(scene.system.coordinates, gj.Support(x=2e8, y=3e8))
    held = dataclasses.replace(scene, supports=supports, body_inertia={})
    needs = {body: held.moving.coordinates.needs(body) for body in supports}
    inertia = {body: gj.BodyInertia(0.5, 1e-3 if "polar" in own else None) for body, own in needs.items()}
    return dataclasses.replace(held, body_inertia=inertia)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles", "ignore::gearjax.UnclosedRecord")
@pytest.mark.parametrize(
    ("name", "gear_set"),
    [
        (name, gear_set)
        for place, name in enumerate([*OF_A_SCENE, *OF_NUMBERS])
        for number, gear_set in enumerate(GEAR_SETS)
        if WHOLE or (number - place) % len(GEAR_SETS) == 0
    ],
)
def test_functions_on_supports(name, gear_set):
    """Bodies that give way: still an answer, or a refusal that names the section."""
    case = Case(gear_set, "amplitude")
    assert case.scene.system.coordinates
    case.scene = on_supports(case.scene)
    refused = None if name == "bearing_forces" else refusal(name, gear_set, "amplitude")
    judge((OF_A_SCENE | OF_NUMBERS)[name], case, refused)


COMMANDS: dict[str, Callable[[Number], dict[str, Any]] | None] = {
    "run": lambda _: {},
    "optimise": lambda number: {
        "optimise": {
            "objective": "no_load_std",
            "where": [number.path],
            "starts": 2,
            "grid_step": {number.path: "90 deg"} if number.written is None else {},
            "bounds": {} if number.written is None else {number.path: list(number.written)},
        }
    },
    "tolerance": lambda number: {
        "tolerance": {
            "samples": 16,
            "measures": [{"name": "static.peak_to_peak", "torque": "20 N*m", "limit": "3 arcmin"}],
            "extremes": "samples",
            number.path: number.written_spread,
        }
    },
    "tradeoff": None,  # some forty settings: tests/test_tradeoff.py
    "compare": None,  # of recordings: tests/test_bench_commands.py; both functions are above
    "identify": None,
    "example": None,  # of files that are shipped: tests/test_examples.py
    "show": None,  # of results: tests/test_report.py
    "new": None,  # of a kind, not of a configuration: tests/test_config_new.py
    "reproduce": None,  # of papers, not of a configuration: test_published.py and others
}


def test_every_command_is_listed():
    listed = {command.name or getattr(command.callback, "__name__", "") for command in app.registered_commands}
    assert listed == set(COMMANDS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "gear_set", "kind"),
    [
        *(("run", gear_set, KINDS[0]) for gear_set in GEAR_SETS),
        *chosen(("optimise", "tolerance"), ((0, 1), (0, 2))),
    ],
)
def test_commands(command, kind, gear_set, tmp_path, capsys):
    """Exit code 0 and an object without nan, or 2 and one line."""
    sections = COMMANDS[command]
    assert sections is not None
    chosen = GEAR_SETS[gear_set]
    config = tmp_path / "mine.toml"
    config.write_text(tomli_w.dumps(chosen.tables | sections(chosen.numbers[kind])), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main([command, str(config), "--json"])
    told = capsys.readouterr()
    words = refusal(command, gear_set, kind)
    if words is None:
        assert ended.value.code == 0, told.err
        assert json.loads(told.out)
        return
    assert ended.value.code == 2
    last = told.err.strip().splitlines()[-1]
    assert last.startswith("gearjax: error: ")
    assert words in last
