"""Checks of recordings at speed, and remarks on them for the reader."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.checks import GearjaxError, ParameterError, SceneError, nearest
from gearjax.contact import HardContact
from gearjax.identification.measurement import Measurement, robust_slope
from gearjax.load_torque import ConstantLoad
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Scalar
from gearjax.units import rpm

ANALYSES = ("static", "dynamic")
UNEVEN, TOO_UNEVEN = 0.01, 0.2  # relative variation of speed or torque above which it is reported, or refused
FEWEST, PART = 8, np.pi / 3  # parts whose speeds are compared: at least so many rows, and so long a turn [rad]
ANOTHER_UNIT = 5.0  # times the scene's speed, beyond which the unit of time is doubted


def an_analysis(name: str, value: object) -> None:
    """Refuse anything but an analysis of recordings."""
    if value not in ANALYSES:
        raise ParameterError(name, value, nearest(value, ANALYSES))


def under_torque(scene: Scene) -> Scene:
    """The scene with hard contacts and a constant load, as the recorded torque is given to the analysis."""
    return dataclasses.replace(scene, contact=HardContact(), load=ConstantLoad(), run=None)


def at_speed_of(scene: Scene, speed: float | Scalar) -> Scene:
    """The scene at another speed of its input [rad/s], negative if the input turns backward."""
    return eqx.tree_at(lambda each: each.system.input_speed, scene, jnp.asarray(speed, scene.dtype))


def speed_of(record: Measurement) -> float:
    """Mean speed of the input [rad/s].

    Raises:
        GearjaxError: times were not recorded, or give no speed.
    """
    if record.time is None:
        words = 'the dynamic TE needs the time of each row: a column "time", or analysis = "static"'
        raise GearjaxError(f"{record.name}: {words}")
    steps = np.diff(record.time)
    if (steps < 0).any():
        where = int(np.argmax(steps < 0))
        raise GearjaxError(f"{record.name}: time goes back after row {where}: sort the rows by time")
    if np.ptp(record.time) == 0:
        raise GearjaxError(f"{record.name}: time is {record.time[0]:.6g} s in every row, so the speed is unknown")
    speed = robust_slope(record.time, record.theta)
    if speed == 0 or not np.isfinite(speed):
        raise GearjaxError(f"{record.name}: the input stands still in most rows: remove them for the dynamic TE")
    return speed


def check_running(scene: Scene, records: Sequence[Measurement]) -> list[str]:
    """Refuse recordings or a scene that cannot be computed in motion; return remarks for the reader.

    Raises:
        GearjaxError: times give no speed, speed or torque varies too much, or no recording is under torque.
        SceneError: the scene lacks a part.
    """
    require(under_torque(scene), "dynamic", "compliance", "inertia")
    if jnp.dtype(scene.dtype) != jnp.float64:
        raise SceneError('recordings in motion need float64: switch "jax_enable_x64" on before the scene is loaded')
    loaded = [record for record in records if record.is_loaded]
    if not loaded:
        raise GearjaxError("the dynamic TE needs a recording under torque: there is none")
    told = []
    for record in loaded:
        told += _check(scene, record)
    told += [
        f"{each.name}: compared with the no-load TE, as it is without torque" for each in records if not each.is_loaded
    ]
    if scene.load is not None and not isinstance(scene.load, ConstantLoad):
        told.append("[load] is not used: the torque is that of the recording")
    if scene.damping is None or float(scene.damping.ratio) == 0:
        told.append("without [damping] vibrations never die out: the motion depends on the time before the recording")
    return told


def _check(scene: Scene, record: Measurement) -> list[str]:
    """The same for one recording under torque."""
    speed, loads = speed_of(record), record.loads
    if record.back.any() and not (scene.has_back or scene.layout.sides_turn):
        raise SceneError(f"{record.name} loads the back flanks, which this scene lacks: list a [backlash]")
    if loads.min() * loads.max() <= 0:
        words = "its torque is zero in some rows, or changes its sign: give one recording for each torque"
        raise GearjaxError(f"{record.name}: {words}")
    told = [f"{record.name}: the input turns at {abs(speed) / rpm:.5g} rpm, from its times"]
    ratio = abs(speed) / float(scene.system.input_speed)
    if not 1 / ANOTHER_UNIT < ratio < ANOTHER_UNIT:
        given = float(scene.system.input_speed) / rpm
        told[0] += f"; the scene has {given:.5g} rpm: is the unit of time right?"
    varies = float(np.std(loads) / abs(np.mean(loads)))
    for what, share in (("input speed", _unevenness(record, speed)), ("torque", varies)):
        words = f"{record.name}: its {what} varies by {100 * share:.2g} %"
        if share > TOO_UNEVEN:
            raise GearjaxError(f"{words}: the motion is computed for one value, give a part where it is steady")
        if share > UNEVEN:
            told.append(f"{words}: the motion is computed at its mean")
    return told


def _unevenness(record: Measurement, speed: float) -> float:
    """Standard deviation of the mean speeds of parts of a turn, divided by the mean speed."""
    assert record.time is not None
    step = max(float(np.median(np.abs(np.diff(record.theta)))), 1e-300)
    size = int(np.clip(np.ceil(PART / step), FEWEST, max(FEWEST, record.theta.size // 2)))
    parts = np.arange(0, record.theta.size, size)
    turned, taken = np.diff(record.theta[parts]), np.diff(record.time[parts])
    good = taken > 0
    return float(np.std(turned[good] / taken[good])) / abs(speed) if good.any() else 0.0
