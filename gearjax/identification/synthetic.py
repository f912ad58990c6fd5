"""Synthetic recordings, as a test bench would make them of a known gear set: to try identification or plan a bench."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis import backlash, transmission_error
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.identification.measurement import Measurement, ideal
from gearjax.identification.moving import moving_error
from gearjax.identification.running import an_analysis, check_running
from gearjax.scene import Scene
from gearjax.typing import ArrayLike
from gearjax.units import arcmin

ROWS = 10_000
NOISE = 0.05 * arcmin
MOST_COUNTS = 2**62


def _waves(name: str, value: object) -> None:
    """Refuse anything but pairs of amplitude and phase by order."""
    if not isinstance(value, Mapping):
        raise ParameterError(name, value, "must be pairs of amplitude and phase [rad] by order: {13.0: (1e-5, 0.0)}")
    for order, pair in value.items():
        array = arguments.finite(f"{name} of {order}", pair)
        if array is None or array.shape != (2,):
            raise ParameterError(f"{name} of {order}", pair, "must be a pair of amplitude and phase [rad]")


def _counts(name: str, value: object) -> None:
    arguments.whole(1)(name, value)
    if int(value) > MOST_COUNTS:  # pyright: ignore[reportArgumentType]
        raise ParameterError(name, value, "must be counts per turn, such as 2**20")


@arguments.checked(
    torque=arguments.torques,
    rows=arguments.whole(3),
    turns=arguments.one_positive,
    noise=arguments.one_number,
    ripple=arguments.one_number,
    offset=arguments.one_number,
    waves=_waves,
    input_counts=_counts,
    output_counts=_counts,
    analysis=an_analysis,
    key=arguments.whole(0),
)
def synthetic_measurement(
    scene: Scene,
    torque: float | ArrayLike = 0.0,
    *,
    rows: int = ROWS,
    turns: float | None = None,
    noise: float = NOISE,
    input_counts: int | None = None,
    output_counts: int | None = None,
    ripple: float = 0.0,
    offset: float = 0.0,
    waves: Mapping[float, tuple[float, float]] | None = None,
    backward: bool = False,
    turned: Mapping[str, float] | None = None,
    analysis: str = "static",
    key: int = 0,
    name: str | None = None,
) -> Measurement:
    """Make a recording of a gear set as a test bench would.

    Args:
        scene: the gear set.
        torque: load torque on the output, a number or shape (rows,), in the order of the rows [N m]; zero for the
            no-load TE.
        rows: number of rows, evenly spaced in time.
        turns: turns of the output; by default one cycle of the gear set.
        noise: standard deviation of the noise of the output angle [rad].
        input_counts, output_counts: counts per turn of the encoders, which round down; by default no rounding.
        ripple: amplitude of the input speed over the mean speed, one wave in seven turns of the input [-].
        offset: zero of the output encoder [rad].
        waves: waves that the bench or eccentric encoder discs add to the output angle: amplitude and phase [rad] of a
            cosine, by order in cycles per turn of the input.
        backward: whether the input turns backward.
        turned: angles by which bodies were turned in their seats, by path of the error such as ``errors.planet_1``
            [rad].
        analysis: ``"static"``, or ``"dynamic"`` for the motion at the scene's input speed under one torque.
        key: seed of the noise.
        name: name of the recording; by default its torque in words.

    Raises:
        SceneError: the scene lacks a part that the torque needs.
        ParameterError: an argument is wrong.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> gj.synthetic_measurement(scene, 40.0, rows=500, output_counts=2**20).theta.shape
        (500,)
    """
    system = scene.system
    order = system.orders.get("output", 1.0)
    span = system.cycle if turns is None else 2 * np.pi * turns / order
    time = np.linspace(0.0, span / float(system.input_speed), rows, endpoint=False)
    theta = float(system.input_speed) * time
    slow = 1 / 7
    if abs(ripple) >= 1:
        raise ParameterError("ripple", ripple, "must be below 1: the input would turn back")
    if ripple and analysis == "dynamic":
        raise ParameterError("ripple", ripple, 'must be 0 for analysis = "dynamic", which is computed at one speed')
    theta = theta + ripple / slow * np.sin(slow * theta)
    own = turned_scene(scene, turned or {})
    loads = np.broadcast_to(np.asarray(torque, float), theta.shape)
    along = np.asarray(torque, float)  # at increasing angles
    along = along[::-1] if backward and along.ndim else along
    if analysis == "dynamic":
        te = _in_motion(own, time, theta, along, backward)
    else:
        te = computed_error(own, theta, along, backward)
    rng = np.random.default_rng(key)
    output = ideal(scene, theta) + te + offset + noise * rng.standard_normal(rows)
    for wave, (amplitude, phase) in (waves or {}).items():
        output = output + amplitude * np.cos(wave * theta + phase)
    if input_counts is not None:
        theta = np.floor(theta / (2 * np.pi) * input_counts) * (2 * np.pi / input_counts)
    if output_counts is not None:
        output = np.floor(output / (2 * np.pi) * output_counts) * (2 * np.pi / output_counts)
    resolution = None if output_counts is None else 2 * np.pi / output_counts
    if backward:
        theta, output = theta[::-1], output[::-1]
    label = name or (f"{float(loads.flat[0]):g} N m" + (", backward" if backward else ""))
    return Measurement(theta, output, None, loads, time, label, dict(turned or {}), resolution)


def _in_motion(scene: Scene, time: np.ndarray, theta: np.ndarray, torque: float | ArrayLike, back: bool) -> np.ndarray:
    """Dynamic TE at the rows of a bench, in the order of increasing angles [rad]."""
    loads = np.asarray(torque, float)
    if loads.size > 1 and np.ptp(loads) > 0:
        raise ParameterError("torque", loads.shape, 'must be one number for analysis = "dynamic"')
    angles = theta[::-1] if back else theta
    record = Measurement(angles, te=np.zeros(angles.shape), torque=float(loads.flat[0]), time=time)
    check_running(scene, [record])
    te, _ = moving_error(scene, record)
    return te[::-1] if back else te


def turned_scene(scene: Scene, turned: Mapping[str, float]) -> Scene:
    """The scene with bodies turned in their seats: each angle is added to the phase of an error."""
    from gearjax.studies.select import numbers, pick

    for path, angle in turned.items():
        valid = [each.removesuffix(".phase") for each in numbers(scene) if each.endswith(".phase")]
        if path not in valid:
            raise ParameterError("turned", path, f"is no eccentricity of this scene; {nearest(path, valid)}")
        free = pick(scene, f"{path}.phase")
        scene = free.set(scene, free.get(scene) + angle)
    return scene


def computed_error(scene: Scene, theta: np.ndarray, torque: float | ArrayLike, backward: bool) -> np.ndarray:
    """Transmission error of a scene at increasing input angles, shape (n,) [rad].

    The static TE under a torque. Without torque, the position at which the first driving flank touches, or the first
    back flank if the input turns backward.
    """
    angles, loads = jnp.asarray(theta, scene.dtype), np.asarray(torque, float)
    te = np.zeros(theta.shape)
    rigid = np.broadcast_to(loads == 0, theta.shape)
    if not rigid.all():
        load = float(loads) if loads.ndim == 0 else jnp.asarray(loads)
        te = np.where(rigid, 0.0, np.asarray(transmission_error(scene, angles, load, extremes="samples").te))
    if rigid.any():
        if backward and not scene.has_back and not scene.layout.sides_turn:
            raise SceneError(
                "an input that turns back touches the back flanks, which this scene lacks: list a [backlash]"
            )
        own = backlash(scene, angles).upper if backward else transmission_error(scene, angles).te
        te = np.where(rigid, np.asarray(own), te)
    return te
