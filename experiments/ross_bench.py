"""One spur pair with backlash, mesh-frequency error and constant torque: gearjax against ROSS (ross-rotordynamics 3).

ROSS needs an environment of its own, with Python 3.13 or newer; this file runs it in a subprocess:

    python3.13 -m venv ross_env && ross_env/bin/python -m pip install ross-rotordynamics
    python experiments/ross_bench.py --ross-python ross_env/bin/python

It takes some six minutes, nearly all of it ROSS; ``--short`` two, with one case. Both model two gears with 20 and 31
teeth, a constant mesh stiffness of 2e8 N/m, viscous mesh damping of ratio 0.07 while flanks touch (ROSS 3.0 always has
this ratio, ROSS 3.1 none unless it is asked for), hard flanks with a clearance, a constant torque, and a kinematic
error of 10 um at the mesh frequency. gearjax has one degree of freedom on the line of action, ROSS 24: two shafts of
one element, stiff and nearly massless, on stiff bearings. ROSS's ``initial_value`` is half of gearjax's backlash. Its
deflection is ``delta = rb1 t1 + rb2 t2 - error``, so that gearjax's TE, output minus ideal output where the driving
flanks touch, is ``initial_value - (rb1 t1 + rb2 t2)`` on the line of action. The statistics are those of the last half
of a record. ROSS starts in the middle of the clearance, gearjax where the driving flanks touch; but for "irregular",
both settle on the same motion, which repeats every mesh period.

The law is the same. What differs, each shown by a table:

- ROSS's default Newmark takes the mesh force from the state one step before. Under closed flanks that takes damping
  away, by an amount known in closed form: the rows "a force one step late" predict the standard deviation to 0.04 %.
  The difference falls in proportion to the step in all motions.
- ``newmark_type="robust"`` iterates the force within the step, at ten to fifteen times the cost per step, and agrees to
  0.2 % with 256 steps.
- Bearings: the mean under closed flanks moves with their flexibility, not with the step; here they add 0.001 %.
- gearjax's own step is chosen for the fastest motion and has an error of up to 0.5 % where flanks part. All differences
  count from its Runge-Kutta solution.
- Smooth flanks of ROSS (tanh): its default sigma of 1e4 1/m smooths over some 100 um, as wide as the clearance, and
  moves the mean by a quarter; the difference from hard flanks shrinks as sigma grows.
- An irregular motion has no common record: only statistics compare, and two starts in gearjax differ as much as the
  two programs do. Differences count from the first row there.

Times are medians, of three runs in ROSS (a torque takes ROSS the same each time, so that its loop over torques is its
time for one). The first call, which compiles, is apart; left out are numba's compilation and the building of the
machine in ROSS, once per design.

Before these, natural frequencies of a helical pair (`ross_modes`) and the mesh stiffness of spur pairs
(`ross_stiffness`).
"""

import argparse
import math
from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from peers import agree, by_another_python, interleaved, sized
from ross_modes import compare_modes
from ross_stiffness import compare_stiffness

import gearjax as gj
from gearjax import units
from gearjax.contact import BodyView, Layout, Pose, Request
from gearjax.parameters import check_parameters, count, length, number
from gearjax.systems import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar

TEETH = 20, 31
PRESSURE_ANGLE = 20 * units.deg
BASE_RADII = tuple(0.5 * 3 * units.mm * teeth * math.cos(PRESSURE_ANGLE) for teeth in TEETH)
INERTIAS = 0.01, 0.03  # kg m2
MASS = INERTIAS[0] * INERTIAS[1] / (INERTIAS[0] * BASE_RADII[1] ** 2 + INERTIAS[1] * BASE_RADII[0] ** 2)
STIFFNESS = 2e8
DAMPING = 0.07
ERROR = 10 * units.um
NATURAL = math.sqrt(STIFFNESS / MASS)
BEARING = 1e14  # N/m
SAMPLES = 64  # per mesh period
PERIODS = 100
BATCH = 256

LONG = 1000
STEPPERS = {
    "64 steps": gj.FixedStep(per_sample=1),  # what it takes by itself
    "256 steps": gj.FixedStep(per_sample=4),
    "1024 steps": gj.FixedStep(per_sample=16),
    "Runge-Kutta, 4096": gj.FixedStep(per_sample=64, solver=gj.RungeKutta4()),
}
TRUTH = "Runge-Kutta, 4096"
BATCHED = "64 steps", "256 steps"

SHORT = {"periods": 40, "repeats": 1}  # changes of a run in the short form
COMPARED = "parting: ROSS robust, 256 steps"

CASES = {  # torque on the wheel [N m], mesh frequency over natural frequency, half of the clearance [m]
    "closed": (1000.0, 0.9, 50 * units.um),
    "parting": (300.0, 0.9, 50 * units.um),
    "both flanks": (30.0, 0.7, 10 * units.um),
    "irregular": (30.0, 1.0, 50 * units.um),
}

ROSS = r"""
import contextlib, copy, inspect, io, json, sys, time
from importlib.metadata import version
import numpy as np
import ross as rs

given = json.load(open(sys.argv[1]))

def machine(bearing):
    stiff = rs.Material(name="stiff", rho=1.0, E=1e14, Poisson=0.3)
    rotors = []
    for inertia, teeth, radius, mass in zip(given["inertias"], given["teeth"], given["base_radii"], (2.0, 5.0)):
        gear = rs.GearElement(n=0, m=mass, Id=inertia / 2, Ip=inertia, n_teeth=teeth, base_diameter=2 * radius,
                              pr_angle=given["pressure_angle"])
        bearings = [rs.BearingElement(n=n, kxx=bearing, kyy=bearing, kzz=bearing, cxx=1e5, cyy=1e5, czz=1e5)
                    for n in (0, 1)]
        rotors.append(rs.Rotor([rs.ShaftElement(L=0.01, idl=0.0, odl=0.05, material=stiff)], [gear], bearings))
    backlash = {"enable": True, "initial_value": 0.0, "error_amp": given["error"], "smooth_operator": False,
                "sigma": 1e4}
    asked = {"gear_mesh_stiffness": given["stiffness"], "backlash": backlash}
    if "mesh_damping_ratio" in inspect.signature(rs.MultiRotor).parameters:  # ROSS 3.0 takes 0.07, whatever is asked
        asked["mesh_damping_ratio"] = given["damping"]
    return rs.MultiRotor(*rotors, coupled_nodes=(0, 0), **asked)

def march(built, run, count):
    own = copy.deepcopy(built)  # a run takes its machine's records with it
    backlash = own.mesh.backlash
    backlash.initial_value = run["half"]
    backlash.smooth_operator, backlash.sigma = run["sigma"] is not None, run["sigma"] or 1e4
    times = np.arange(count) * (2 * np.pi / run["speed"] / given["teeth"][0] / run["steps"])
    turns = [5, 6 * int(own.driven_nodes[0]) + 5]
    force = np.zeros((count, own.ndof))
    for turn, radius in zip(turns, given["base_radii"]):
        force[:, turn] = run["torque"] / given["base_radii"][1] * radius
    began = time.perf_counter()
    found = own.run_time_response(run["speed"], force, times, method="newmark", newmark_type=run["kind"])
    seconds = time.perf_counter() - began
    return run["half"] - found.yout[:, turns] @ np.array(given["base_radii"]), seconds, own.ndof

built, answers = {}, []
with contextlib.redirect_stdout(io.StringIO()):
    for run in given["runs"]:
        if run["bearing"] not in built:
            began = time.perf_counter()
            built[run["bearing"]] = machine(run["bearing"])
            build = time.perf_counter() - began
        if not answers:
            for kind in ("simple", "robust"):
                march(built[run["bearing"]], {**run, "kind": kind}, 8)
        half = run["periods"] // 2 * run["steps"]
        for repeat in range(run["repeats"]):
            record, seconds, freedoms = march(built[run["bearing"]], run, run["periods"] * run["steps"] + 1)
            te = record[-half - 1:]
            metrics = [te[:-1].mean(), te[:-1].std(), te.max() - te.min()]
            answers.append({"run": run["name"], "seconds": seconds, "metrics": [float(value) for value in metrics]})
found = {"version": version("ross-rotordynamics"), "build": build, "freedoms": freedoms, "answers": answers}
json.dump(found, open(sys.argv[2], "w"))
"""


class SpurPair(AbstractSystem):
    """Two ideal spur wheels, with one contact per flank; ``teeth`` is a body for errors at the mesh frequency."""

    kind: ClassVar[str] = "spur_pair"
    pinion_teeth: int = count()
    wheel_teeth: int = count()
    wheel_base_radius: Number = length(above=0.0)
    input_speed: Number = number(units.ANGULAR_SPEED, above=0.0)

    def __check_init__(self):
        check_parameters(self)

    @property
    def bodies(self) -> tuple[str, ...]:
        return ("teeth",)

    @property
    def orders(self) -> Mapping[str, float]:
        mesh = float(self.pinion_teeth)
        return {"output": self.pinion_teeth / self.wheel_teeth, "mesh": mesh, "teeth": mesh}

    @property
    def cycle(self) -> float:
        return 2 * math.pi * self.wheel_teeth / math.gcd(self.pinion_teeth, self.wheel_teeth)

    def layout(self, request: Request) -> Layout:
        return Layout.of_flanks(1, request.back)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        side = jnp.asarray(self.layout(request).side, theta.dtype)
        seen = BodyView(self.pinion_teeth * theta, jnp.zeros_like(side), side)
        mesh = jnp.reshape(self.pinion_teeth * theta, (1,)) if request.mesh else None
        jacobian = -side[:, None] * self.wheel_base_radius
        return Pose(theta, jacobian, jnp.zeros_like(side), dict.fromkeys(request.bodies, seen), mesh)


def input_speed(ratio: float) -> float:
    """Speed of the pinion at a ratio of mesh frequency to natural frequency [rad/s]."""
    return ratio * NATURAL / TEETH[0]


def scene(ratio: float, half: float) -> gj.Scene:
    """The pair in gearjax, at a frequency ratio and with half a clearance [m]."""
    return gj.Scene(
        SpurPair(
            pinion_teeth=TEETH[0],
            wheel_teeth=TEETH[1],
            wheel_base_radius=BASE_RADII[1],
            input_speed=input_speed(ratio),
        ),
        errors={"mesh": gj.Eccentricity("teeth", ERROR, 0.0)},
        backlash=gj.InitialBacklash(2 * half),
        compliance=gj.HarmonicStiffness(STIFFNESS, [], []),
        load=gj.ConstantLoad(),
        inertia=gj.EquivalentMass(MASS),
        damping=gj.DampingRatio(DAMPING * math.sqrt(2)),
    )


def ours(case: str, stepper: gj.FixedStep | None, periods: int = PERIODS, start: str = "zero"):
    """Metrics of a case on the line of action [m], of the last half of its record, as a function of the torque."""
    _, ratio, half = CASES[case]
    model, period = scene(ratio, half), 2 * math.pi / (ratio * NATURAL)
    ts = jnp.arange(periods * SAMPLES) * (period / SAMPLES)
    settle = (periods // 2 - 0.5 / SAMPLES) * period

    def metrics(torque: Scalar | float) -> Float[Array, "3"]:
        motion = gj.simulate(model, ts, torque, start=start, settle=settle, stepper=stepper)
        return jnp.stack([motion.mean, motion.std, motion.peak_to_peak]) * BASE_RADII[1]

    return metrics


def ross_runs() -> list[dict[str, Any]]:
    """What is asked of ROSS."""
    runs = []

    def add(name: str, case: str, kind: str, steps: int, repeats: int = 1, **other: Any) -> None:
        torque, ratio, half = CASES[case]
        usual = {"bearing": BEARING, "sigma": None, "periods": PERIODS}
        asked = {"torque": torque, "speed": input_speed(ratio), "half": half, "repeats": repeats}
        runs.append({"name": f"{case}: {name}", "kind": kind, "steps": steps, **asked, **usual, **other})

    for steps in (256, 1024, 4096):
        add(f"ROSS, {steps} steps", "parting", "simple", steps, 3)
    for steps in (64, 256):
        add(f"ROSS robust, {steps} steps", "parting", "robust", steps, 3)
    for case in ("closed", "both flanks"):
        for steps in (256, 1024, 4096):
            add(f"ROSS, {steps} steps", case, "simple", steps)
        add("ROSS robust, 256 steps", case, "robust", 256)
    add("ROSS, 256 steps", "irregular", "simple", 256, periods=LONG)
    for sigma in (1e4, 1e5, 1e6, 1e7):
        add(f"ROSS tanh, sigma {sigma:g} 1/m", "parting", "simple", 1024, sigma=sigma)
    for bearing in (1e11, 1e12, 1e13):
        add(f"ROSS, bearings {bearing:g} N/m", "closed", "simple", 1024, bearing=bearing)
    return runs


def by_ross(python: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Answers of ROSS to runs."""
    given = {
        "teeth": TEETH,
        "base_radii": BASE_RADII,
        "inertias": INERTIAS,
        "pressure_angle": PRESSURE_ANGLE,
        "stiffness": STIFFNESS,
        "damping": DAMPING,
        "error": ERROR,
        "runs": runs,
    }
    return by_another_python(python, ROSS, given)


def compare(peer: dict[str, Any]) -> None:
    """The run of ROSS that iterates the mesh force, against gearjax's Runge-Kutta."""
    case = COMPARED.split(": ")[0]
    truth = np.asarray(jax.jit(ours(case, STEPPERS[TRUTH]))(CASES[case][0]))
    found = next(one["metrics"] for one in peer["answers"] if one["run"] == COMPARED)
    for metric, theirs, own in zip(("mean", "standard deviation", "peak-to-peak"), found, truth, strict=True):
        agree(f"{COMPARED}: {metric}, relative difference", abs(theirs / own - 1), 2e-3)


def late(steps: int, ratio: float) -> float:
    """Standard deviation on the line of action, flanks closed, with the mesh force one step late [m]."""
    rate, damping = ratio * NATURAL, 2 * DAMPING * math.sqrt(STIFFNESS * MASS)
    spring = STIFFNESS + 1j * damping * rate
    delayed = spring * np.exp(-2j * np.pi / steps)
    return float(ERROR * abs(spring / (delayed - MASS * rate**2)) / math.sqrt(2)) if steps else 0.0


def heading(words: str) -> None:
    """A title, and what the columns are."""
    print(f"\n{words}")
    columns = [f"{name:>9s}" for name in ("mean", "std", "p-p [um]")]
    columns += [f"{name:>8s}" for name in ("mean", "std", 'p-p ["]', "mean", "std", "p-p [%]")]
    print(f"{'':34s} {' '.join(columns)}")


def line(name: str, metrics: np.ndarray, against: np.ndarray) -> None:
    """One row: metrics on the line of action and as angles of the wheel, and their differences in percent."""
    columns = [f"{value / units.um:9.3f}" for value in metrics]
    columns += [f"{value / BASE_RADII[1] / units.arcsec:8.2f}" for value in metrics]
    columns += [f"{value:+8.3f}" for value in 100 * (metrics / against - 1)]
    print(f"{name:34s} {' '.join(columns)}")


def main() -> None:
    parser = argparse.ArgumentParser(description="one spur pair with backlash: gearjax against ROSS")
    parser.add_argument("--ross-python", required=True, help="a Python that has ross-rotordynamics 3")
    given = sized(parser, repeats=(9, 1))
    compare_modes(given.ross_python)
    compare_stiffness(given.ross_python)
    runs = ross_runs()
    if given.short:
        compare(by_ross(given.ross_python, [run | SHORT for run in runs if run["name"] == COMPARED]))
        return
    peer = by_ross(given.ross_python, runs)
    compare(peer)
    answers: dict[str, np.ndarray] = {one["run"]: np.array(one["metrics"]) for one in peer["answers"]}
    seconds = {name: [one["seconds"] for one in peer["answers"] if one["run"] == name] for name in answers}
    tasks = {}
    for case, (torque, _, _) in CASES.items():
        if case == "irregular":
            for start in ("zero", "equilibrium"):
                tasks[f"{case}: gearjax, 256 steps, {start}"] = partial(
                    jax.jit(ours(case, STEPPERS["256 steps"], LONG, start)), torque
                )
            continue
        tasks[f"{case}: gearjax, as called"] = partial(ours(case, None), torque)
        for name, stepper in STEPPERS.items():
            tasks[f"{case}: gearjax, {name}"] = partial(jax.jit(ours(case, stepper)), torque)
    torques = jnp.linspace(100.0, 1000.0, BATCH)
    for name in BATCHED:
        tasks[f"batch, {name}"] = partial(jax.jit(jax.vmap(ours("parting", STEPPERS[name]))), torques)
    found, first, medians = interleaved(tasks, given.repeats, slow=2.0)
    found = {name: np.asarray(metrics) for name, metrics in found.items()} | answers
    medians |= {name: float(np.median(times)) for name, times in seconds.items()}

    print(
        f"ross-rotordynamics {peer['version']}, {peer['freedoms']} degrees of freedom, built in {peer['build']:.1f} s"
    )
    print(f"{MASS:.3f} kg on the line of action, {NATURAL / (2 * math.pi):.1f} Hz; steps are those of a mesh period")
    for case, (torque, ratio, half) in CASES.items():
        names = [name for name in found if name.startswith(f"{case}: ")]
        truth = found.get(f"{case}: gearjax, {TRUTH}", found[names[0]])
        heading(f"{case}: {torque:g} N m, {ratio:g} of the natural frequency, clearance {2 * half / units.um:g} um")
        for name in names:
            if "tanh" not in name and "bearings" not in name:
                line(name.removeprefix(f"{case}: "), found[name], truth)
        if case == "closed":
            for steps in (256, 1024, 4096):
                change = 100 * (late(steps, ratio) / late(10**9, ratio) - 1)
                words = f"a force one step late, {steps} steps"
                print(f"{words:34s} {'':9s} {late(steps, ratio) / units.um:9.3f} {'':55s} {change:+8.3f}")
    for words, case, word in (
        ("smooth flanks of ROSS, parting, 1024 steps, against its hard flanks", "parting", "tanh"),
        ("bearings of ROSS, closed, 1024 steps, against gearjax", "closed", "bearings"),
    ):
        hard = found[f"{case}: ROSS, 1024 steps"]
        truth = hard if word == "tanh" else found[f"{case}: gearjax, {TRUTH}"]
        heading(words)
        for name in answers:
            if word in name:
                line(name.removeprefix(f"{case}: "), found[name], truth)
        line("ROSS, hard flanks" if word == "tanh" else f"ROSS, bearings {BEARING:g} N/m", hard, truth)

    duration = PERIODS * 2 * math.pi / (CASES["parting"][1] * NATURAL)
    base, batch = medians["parting: gearjax, 256 steps"], medians["batch, 256 steps"] / BATCH
    print(f"\nparting, {PERIODS} mesh periods, {duration:.3f} s, per torque; ratios over gearjax with 256 steps")
    print(f"{'':34s} {'first [s]':>9s} {'ms':>9s} {'s / simulated s':>15s} {'ratio':>9s} {'of batch':>9s}")
    timed = [name for name in medians if name.startswith("parting: ") and not ("tanh" in name or "bearings" in name)]
    for name in (*timed, *(f"batch, {name}" for name in BATCHED)):
        each = medians[name] / (BATCH if name.startswith("batch") else 1)
        label = f"gearjax, {BATCH} torques, {name[7:]}" if name.startswith("batch") else name.removeprefix("parting: ")
        begun = max((value for key, value in first.items() if key.endswith(name.removeprefix("parting"))), default=None)
        begun = f"{begun:9.1f}" if begun else f"{'':9s}"
        print(f"{label:34s} {begun} {1e3 * each:9.2f} {each / duration:15.5f} {each / base:9.1f} {each / batch:9.1f}")


if __name__ == "__main__":
    main()
