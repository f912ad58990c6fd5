"""Static transmission error against the torque: its swing, and its harmonics of the mesh or of another order."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.analysis.period import what_differs
from gearjax.analysis.quasi_static import EXTREMES, angles_of, transmission_error
from gearjax.batches import in_batches
from gearjax.checks import ParameterError, SceneError, is_concrete, nearest, warn_the_caller
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, ArrayLike, Float, Scalar

AT_ONCE = 16  # torques that are computed side by side; more of them take turns, so that memory is bounded
WHOLE = 1e-5  # share of its span by which a record may miss a whole number of periods


class UnclosedRecord(UserWarning):
    """The harmonics of a curve that does not repeat after its record contain the jump at its end."""


class TorqueSweep(eqx.Module):
    """Static transmission error at several torques.

    Args:
        torques: load torques, shape (m,) [N m].
        mean: mean TE at each torque, shape (m,) [rad].
        peak_to_peak: highest minus lowest TE at each torque, shape (m,) [rad].
        harmonics: amplitudes of the first, second and further harmonics of the order, shape (m, harmonic) [rad].
        result: 0 found, or the number of the first fault at each torque, as in `TransmissionError`, shape (m,).
        order: name of the order.
    """

    torques: Float[Array, " m"]
    mean: Float[Array, " m"]
    peak_to_peak: Float[Array, " m"]
    harmonics: Float[Array, "m harmonic"]
    result: Array
    order: str = eqx.field(static=True)


@arguments.checked(torques=arguments.numbers, harmonics=arguments.whole(1))
def torque_sweep(
    scene: Scene,
    theta: ArrayLike,
    torques: ArrayLike,
    *,
    harmonics: int = 3,
    order: str = "mesh",
    extremes: str = "samples",
) -> TorqueSweep:
    """Static transmission error over a range of torques, for the choice of reliefs and of an operating torque.

    A pair with tip relief runs smoothest near the torque that its relief was made for; the curve of the peak-to-peak
    TE over the torque has its minimum there (Harris 1958).

    Args:
        scene: the scene, with compliance.
        theta: input angles over one or more whole periods of the order, evenly spaced, without the end point:
            ``jnp.linspace(0.0, periods * 2 * jnp.pi / scene.system.orders["mesh"], n, endpoint=False)`` [rad].
        torques: load torques on the output, shape (m,) [N m].
        harmonics: number of harmonics.
        order: name of the order whose harmonics are computed.
        extremes: where to search for the highest and lowest value, as in `transmission_error`.

    Raises:
        SceneError: the scene lacks a compliance, or theta is uneven or no whole number of periods.
        UnclosedRecord: as a warning, if errors differ after the record, as run-outs do after one mesh.
        ParameterError: there is no such order, or an argument has the wrong shape.

    Example:
        >>> import gearjax as gj, jax.numpy as jnp
        >>> scene = gj.load("configs/helical/blankenship_1995.toml")
        >>> mesh = jnp.linspace(0.0, 2 * jnp.pi / 50, 64, endpoint=False)
        >>> sweep = gj.torque_sweep(scene, mesh, jnp.array([50.0, 150.0, 300.0]))
        >>> sweep.harmonics.shape
        (3, 3)
    """
    require(scene, "static", "compliance")
    theta, torques = angles_of(scene, theta), jnp.asarray(torques, scene.dtype)
    if torques.ndim != 1 or not torques.size:
        raise ParameterError("torques", torques.shape, "is a shape: give load torques of shape (m,)")
    if order not in scene.system.orders:
        raise ParameterError("order", order, nearest(order, scene.system.orders))
    if extremes not in EXTREMES:
        raise ParameterError("extremes", extremes, nearest(extremes, EXTREMES))
    turns = scene.system.orders[order]
    _check_periods(theta, turns, order, harmonics)
    if is_concrete((theta, scene)):
        known = np.asarray(theta)
        angle = float(known[-1] + known[1] - 2 * known[0])
        words = what_differs(scene.physics("backlash", "compliance"), angle)
        if words is not None:
            again = f"after theta's {angle:.6g} rad {words}: the harmonics contain the jump at the end of the record"
            right = f"theta over scene.system.cycle = {scene.system.cycle:.6g} rad has none"
            warn_the_caller(f"{again}; {right}", UnclosedRecord)
    return _torque_sweep(scene, theta, torques, harmonics, order, extremes)


def harmonics_of(
    te: Float[Array, "*m n"], theta: Float[Array, " n"], order: float, number: int
) -> Float[Array, "*m harmonic"]:
    """Amplitudes of the harmonics of an order, from even samples over whole periods [rad]."""
    waves = order * (1 + jnp.arange(number, dtype=theta.dtype))
    angle = waves[:, None] * theta[None, :]
    parts = (jnp.tensordot(te, wave(angle), ([-1], [-1])) * (2 / theta.shape[0]) for wave in (jnp.cos, jnp.sin))
    squared = sum(part**2 for part in parts)
    # the root has no derivative at zero, where a harmonic is absent
    return jnp.where(squared == 0, 0.0, jnp.sqrt(jnp.where(squared == 0, 1.0, squared)))


def whole_periods(theta: np.ndarray, order: float) -> bool:
    """Whether even angles without their end point cover a whole number of periods of an order."""
    if len(theta) < 2:
        return False
    steps = np.diff(theta)
    periods = len(theta) * steps.mean() * order / (2 * np.pi)
    even = np.allclose(steps, steps.mean(), rtol=1e-3, atol=0)
    return bool(even and round(periods) >= 1 and abs(periods - round(periods)) < WHOLE * periods)


def _check_periods(theta: Float[Array, " n"], turns: float, order: str, harmonics: int) -> None:
    if not is_concrete(theta):
        return
    angles = np.asarray(theta, float)
    if not whole_periods(angles, turns):
        words = f'theta must cover whole periods of the order "{order}", evenly, without the end point'
        raise SceneError(f"{words}: linspace(0, periods * {2 * np.pi / turns:.9g}, n, endpoint=False)")
    per_period = 2 * np.pi / turns / (angles[1] - angles[0])
    if per_period < 2 * harmonics + 1 - WHOLE:
        words = f"must be at least {2 * harmonics + 1}"
        raise SceneError(f"theta has {per_period:.4g} angles per period; for {harmonics} harmonics there {words}")


@eqx.filter_jit
def _torque_sweep(scene: Scene, theta: Array, torques: Array, harmonics: int, order: str, extremes: str) -> TorqueSweep:
    def at(torque: Scalar) -> tuple[Array, Array, Array]:
        found = transmission_error(scene, theta, torque, extremes=extremes)
        return found.te, found.extremes.maximum - found.extremes.minimum, found.result.max()

    te, swing, result = in_batches(at, torques, AT_ONCE)
    amplitudes = harmonics_of(te, theta, scene.system.orders[order], harmonics)
    return TorqueSweep(torques, te.mean(axis=-1), swing, amplitudes, result, order)
