"""Remarks on a run: short or coarse records, motions that are chaotic or need finer steps, wrong units."""

import math
import warnings
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from gearjax.analysis import Backlash, FixedStep, Motion, simulate
from gearjax.analysis.choice import stiffness_order
from gearjax.analysis.dynamics import chosen_steps, growth_rate
from gearjax.analysis.growth import LOST
from gearjax.analysis.metrics import few_angles
from gearjax.evaluate import evaluated
from gearjax.results.cases import Case, belongs, required_run, torques_of
from gearjax.run import Run
from gearjax.scene import Scene
from gearjax.typing import Array, Scalar
from gearjax.units import mm

LITTLE = 2e-3  # angle of the output [rad] with which no gear set gets that far
FEWEST_PER_WAVE = 4  # samples per wave of the stiffness, from which on a curve shows the wave
OFTEN = 0.02  # share of the samples in which a mesh carries nothing, from which on half the steps are tried
AGREES = 0.01  # change of a curve by half the steps, over its swing, up to which nothing is said


def remarks(scene: Scene) -> list[str]:
    """Remarks on the record of the run section that a reader of the metrics should know."""
    run, speed = required_run(scene), float(scene.system.input_speed)
    lines = []
    words = few_angles(jnp.asarray(run.times * speed), scene.system.fastest_order)
    if words is not None:
        lines.append(f"{words}: raise run.samples")
    undamped = scene.damping is None or float(np.max(np.asarray(scene.damping.ratio))) == 0
    if "dynamic" in run.analyses and undamped:
        lines.append(
            "without [damping] what the motion starts with never dies away, and at a resonance it grows without limit"
        )
    asked = [(name, torque) for name, torques in torques_of(run).items() for torque in torques]
    alone = [entry for entry in run.published if not any(belongs(entry, *case) for case in asked)]
    if alone:
        words = ", ".join(f"{entry.analysis} at {entry.torque:g} N m" for entry in alone)
        lines.append(f"published values of analyses that [run] does not ask for are not shown: {words}")
    missed = _missed_waves(scene, run)
    if missed is not None and words is None:
        lines.append(missed)
    return lines


def _missed_waves(scene: Scene, run: Run) -> str | None:
    """Remark if a motion has too few samples for the waves of the stiffness: metrics include them, curves do not."""
    waves = stiffness_order(scene) * float(scene.system.input_speed) * run.duration / (2 * math.pi)
    if "dynamic" not in run.analyses or run.samples - 1 >= FEWEST_PER_WAVE * waves:
        return None
    return (
        f"the stiffness has {waves:.0f} waves in the record of {run.samples} samples; curves, load sharing and "
        f"spectrum of the motion do not show them: raise run.samples to {math.ceil(2 * FEWEST_PER_WAVE * waves) + 1}"
    )


def growth_remark(scene: Scene, case: Case) -> str | None:
    """Remark on a chaotic motion; ``None`` if disturbances do not grow, or if the load does not alternate."""
    run = required_run(scene)
    if case.analysis != "dynamic" or scene.load is None or not scene.load.alternates:
        return None
    rate = float(growth_rate(scene, run.times, case.torque, start=run.start))
    if not rate * run.duration > LOST:
        return None
    return f"{case.title}: a disturbance grows at {rate:.3g} 1/s, the motion is chaotic: its metrics scatter"


def separation_remark(scene: Scene, case: Case, told: Callable[[str], None]) -> str | None:
    """Remark on a motion whose teeth separate, if half the default steps change it; ``None`` if all is well.

    Impacts are where a step errs most, and how much depends on what follows: after many of them, of several lightly
    damped bodies, default steps were off by a fifth of the swing.

    Args:
        scene: the scene.
        case: a motion by the steps that are chosen by default.
        told: function that is told what takes time.
    """
    if not isinstance(case.result, Motion) or _apart(case.result) < OFTEN:
        return None
    run = required_run(scene)
    chosen = chosen_steps(scene, run.times, case.torque)
    if chosen.step is None:
        return None
    told(f"{case.title}: teeth separate, the motion is repeated with half the steps")
    finer = FixedStep(chosen.step / 2)
    with warnings.catch_warnings():  # the reader has seen those of the motion itself
        warnings.simplefilter("ignore")
        again = simulate(scene, run.times, case.torque, start=run.start, settle=run.settle, stepper=finer)
    used = np.asarray(again.settled)
    change = np.abs(np.asarray(again.te) - np.asarray(case.result.te))[used].max()
    swing = max(float(again.peak_to_peak), 1e-300)
    if not change > AGREES * swing:
        return None
    moved = f"{100 * change / swing:.2g} % of its swing"
    return (
        f"{case.title}: teeth separate, and half the steps change the curve by up to {moved}: gearjax run "
        "--accuracy 0.01 takes steps that agree with other ones to 0.01 arcmin"
    )


def _apart(motion: Motion) -> float:
    """Share of the samples in which a mesh carries nothing."""
    forces = np.asarray(motion.forces)[np.asarray(motion.settled)]
    mesh = np.array(motion.layout.mesh or (0,) * forces.shape[1])
    apart = [(forces[:, mesh == number] == 0).all(axis=1) for number in np.unique(mesh)]
    return float(np.stack(apart).any(axis=0).mean())


def displacement_remark(scene: Scene, cases: list[Case]) -> str | None:
    """Remark on an output that is off by as much as no teeth allow, as a wrong unit makes it; ``None`` if none is."""
    name, limit = scene.system.size_of_teeth, scene.system.largest_displacement
    angles = {
        case.title: float(np.nanmax(np.abs(case.record), initial=0.0))
        for case in cases
        if not isinstance(case.result, Backlash)
    }
    title, angle = max(angles.items(), key=lambda item: item[1], default=("", 0.0))
    if limit is None or angle < LITTLE:
        return None
    levers = evaluated(_output_levers, scene.physics("backlash"), jnp.zeros(()))
    moved = angle * float(np.abs(levers).max())
    if not moved > limit:
        return None
    return (
        f"{title}: the output is off by {moved / mm:.3g} mm at the teeth, more than a quarter of system.{name}, while "
        "displacements are taken as small: check the units of errors, torque, stiffness and inertia"
    )


def _output_levers(scene: Scene, theta: Scalar) -> Array:
    """Levers of the contacts on the output at an input angle [m/rad]."""
    return scene.contacts(theta).jacobian[:, 0]
