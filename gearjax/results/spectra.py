"""Spectra of the cases of a run. Over whole cycles of the gear set each order is one line, with nothing between."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis import order_spectrum, simulate
from gearjax.analysis.choice import memory_of
from gearjax.analysis.quasi_static import no_load, static
from gearjax.parameters import Named
from gearjax.results.cases import Case, required_run, torque_history
from gearjax.run import Run
from gearjax.scene import Scene
from gearjax.typing import Array, Float

MOST_SAMPLES = 100_000  # largest number of samples of a cycle that is computed only for its spectrum
FEWEST_SAMPLES = 8
MEET = 1e-4  # share of its swing by which pieces of a motion may differ where they meet
WHOLE = 1e-6  # deviation up to which a number of cycles, samples or turns counts as whole


class OrderLines(NamedTuple):
    """Order spectrum of a case.

    Args:
        order: cycles per turn of the output, shape (m,) [-].
        amplitude: amplitude of the sine at each order, shape (m,) [rad].
        whole: whether the spectrum is of whole cycles; if not, it is of the record as it is, with a Hann window.
    """

    order: np.ndarray
    amplitude: np.ndarray
    whole: bool


def order_lines(scene: Scene, case: Case) -> OrderLines | None:
    """The order spectrum of a case; ``None`` if its record is too short for a spectrum.

    The spectrum is taken over the whole cycles at the end of the record. If the record holds no whole cycle, one cycle
    is computed for the spectrum, with about the spacing of the record. The record as it is, with a Hann window, is used
    if the load does not repeat with the gear set, or if its cycle would take more than `MOST_SAMPLES`.
    """
    turn = 2 * math.pi / scene.system.orders["output"]
    record = _whole_cycles(scene, case)
    whole = record is not None
    if record is None:
        run, speed = required_run(scene), float(scene.system.input_speed)
        counted = run.times >= (run.settle if case.analysis == "dynamic" else 0.0)
        record = case.record[counted], run.times[counted] * speed
        if len(record[0]) < FEWEST_SAMPLES:
            return None
    spectrum = order_spectrum(*record, turn=turn, window="none" if whole else "hann")
    return OrderLines(np.asarray(spectrum.order), np.asarray(spectrum.amplitude), whole)


def _whole_cycles(scene: Scene, case: Case) -> tuple[np.ndarray, np.ndarray] | None:
    """Values and input angles of whole cycles, evenly spaced, without the end point; ``None`` if there are none."""
    run, speed = required_run(scene), float(scene.system.input_speed)
    spacing, cycle = run.duration / (run.samples - 1), scene.system.cycle / speed
    number, settled = round(cycle / spacing), run.settle if case.analysis == "dynamic" else 0.0
    if number < FEWEST_SAMPLES or not _repeats(scene):
        return None
    cycles = math.floor((run.duration - settled) / cycle + WHOLE)
    if cycles and abs(cycle / spacing - number) < WHOLE * number:
        return case.record[-cycles * number :], run.times[-cycles * number :] * speed
    if number > MOST_SAMPLES:
        return None
    number = math.ceil(cycle / spacing * (1 - WHOLE))  # no longer steps than the record has: the same program
    first = math.ceil(settled / cycle * number)
    ts = np.arange(first + number) * (cycle / number)
    if case.analysis == "dynamic":
        values = _moved(scene, run, ts, case.torque)
    else:
        torque = torque_history(scene, jnp.asarray(ts), case.torque) if case.analysis == "static" else None
        values = _curve(scene.precomputed("backlash", "compliance"), jnp.asarray(ts * speed, scene.dtype), torque)
    return np.asarray(values)[first:], ts[first:] * speed


def _moved(scene: Scene, run: Run, ts: np.ndarray, torque: float) -> np.ndarray:
    """Dynamic TE at even times, in pieces as long as the record if a motion forgets how it began.

    The pieces have the program of the record, where one of another length would take seconds to trace and compile.
    Where they meet they must agree, as a motion that separates may have several forms.
    """
    memory, size, spacing = memory_of(scene), run.samples, ts[1] - ts[0]
    over = size if memory is None or run.start != "equilibrium" else math.ceil(memory / spacing)
    agree, values = 2 * over <= size < len(ts), np.empty(0)
    while agree and len(values) < len(ts):
        begin = max(len(values) - over, 0)
        piece = np.asarray(simulate(scene, (begin + np.arange(size)) * spacing, torque).te)
        known = len(values) - begin
        agree = not known or abs(piece[known - 1] - values[-1]) <= MEET * np.ptp(piece)
        values = np.concatenate([values, piece[known:]])
    return values[: len(ts)] if agree else np.asarray(simulate(scene, ts, torque, start=run.start).te)


def _repeats(scene: Scene) -> bool:
    """Whether the load repeats with the errors of the bodies."""
    if scene.load is None or not scene.load.alternates:
        return True
    frequency = getattr(scene.load, "frequency", None)
    if not isinstance(frequency, Named):
        return False
    turns = scene.system.orders[frequency.name] * scene.system.cycle / (2 * math.pi)
    return abs(turns - round(turns)) < WHOLE * turns


@eqx.filter_jit
def _curve(scene: Scene, theta: Float[Array, " n"], torque: Array | float | None) -> Float[Array, " n"]:
    """Quasi-static TE at input angles, without the other results of an analysis."""
    scene = scene.anchored()
    if torque is None:
        return jax.vmap(no_load, in_axes=(None, 0))(scene, theta)
    torques = jnp.broadcast_to(jnp.asarray(torque, theta.dtype), theta.shape)
    return jax.vmap(lambda angle, size: static((scene, size), angle))(theta, torques)
