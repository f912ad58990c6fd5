"""A reducer for other programs: transmission error as orders, function without gearjax, joint of a robot."""

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from gearjax import arguments
from gearjax.analysis import backlash
from gearjax.checks import SceneError, with_article
from gearjax.files import writable, write_file
from gearjax.identification.synthetic import computed_error
from gearjax.results.joint_files import MUJOCO_FILE, TE_FILE, mjcf
from gearjax.results.joint_motion import damping_and_inertia
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.units import arcmin

SHARES = (0.01, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)  # shares of the largest torque at which curves are computed
PER_TURN = 24  # angles per turn of the fastest order
MOST_ANGLES = 1 << 17
FAINT = 1e-3  # share of the largest order; smaller orders are left out
MOST_ORDERS = 400


@dataclasses.dataclass(frozen=True, eq=False)
class Joint:
    """A reducer as a joint: the position of its output under a torque, at each input angle.

    Args:
        ratio: turns of the input per turn of the output; the output makes 1 / ratio turns per turn of the input.
        orders: cycles per turn of the input, shape (m,).
        torques: load torques, increasing, shape (k,) [N m].
        mean: mean TE under each torque, shape (k,) [rad].
        cosine, sine: amplitudes of each order under each torque, shape (k, m) [rad].
        left_out: largest standard deviation of the part of the TE that the orders leave out [rad].
        backlash: mean travel of the output without torque [rad]; 0 if no backlash is modelled.
        stiffness: mean torsional stiffness at the largest torque [N m/rad].
        damping: damping of the output against its ideal motion while flanks touch, at the largest torque; supports and
            shafts follow as they do at rest [N m s/rad]; 0 if none is modelled.
        inertia: moment of inertia of the output [kg m2]; ``None`` if none is modelled.
    """

    ratio: float
    orders: np.ndarray
    torques: np.ndarray
    mean: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    left_out: float
    backlash: float
    stiffness: float
    damping: float
    inertia: float | None

    def as_json(self) -> dict[str, Any]:
        """The object for a file, in SI and radians."""
        return {
            "ratio": self.ratio,
            "backlash_rad": self.backlash,
            "stiffness_N_m_per_rad": self.stiffness,
            "damping_N_m_s_per_rad": self.damping,
            "inertia_kg_m2": self.inertia,
            "orders_per_input_turn": self.orders.tolist(),
            "torque_N_m": self.torques.tolist(),
            "te_mean_rad": self.mean.tolist(),
            "te_cosine_rad": self.cosine.tolist(),
            "te_sine_rad": self.sine.tolist(),
            "left_out_std_rad": self.left_out,
        }


def _largest(name: str, value: Any) -> None:
    """Check that a torque is above zero."""
    arguments.torque(name, value)
    arguments.positive(name, value)


@arguments.checked(torque=_largest)
def joint_model(scene: Scene, torque: float) -> Joint:
    """Model a reducer as a joint for other programs.

    The model is the static TE under several torques, as orders over one cycle; it has torques in both directions if
    back flanks are modelled. Between the torques the position is interpolated linearly, so that the torque follows from
    a position and an input angle.

    Args:
        scene: the gear set, with a compliance.
        torque: largest load torque of the application [N m].

    Raises:
        SceneError: the scene has no compliance, its ratio is not constant, its cycle needs too many angles, or no flank
            carries some torque.

    Example:
        >>> import gearjax as gj
        >>> joint = gj.joint_model(gj.load("configs/two_kv/wang_2020.toml"), 100.0)
        >>> joint.ratio
        79.0
    """
    require(scene, "a joint model", "compliance")
    system = scene.system
    if not system.turns_evenly:
        raise SceneError(
            f"a joint model needs an output that turns evenly; that of {with_article(system.kind)} does not"
        )
    cycle = system.cycle
    size = 1 << max(8, int(np.ceil(np.log2(PER_TURN * system.fastest_order * cycle / (2 * np.pi)))))
    if size > MOST_ANGLES:
        raise SceneError(
            f"a joint model of {with_article(system.kind)} needs {size} angles for its cycle, more than {MOST_ANGLES}"
        )
    theta = np.arange(size) * (cycle / size)
    both = scene.has_back or scene.layout.sides_turn
    shares = [*(-share for share in reversed(SHARES)), *SHARES] if both else list(SHARES)
    torques = torque * np.array(shares)
    te = np.stack([computed_error(scene, theta, float(each), False) for each in torques])
    if not np.isfinite(te).all():
        raise SceneError("under some torque no flank carries: no joint model")
    lines = np.fft.rfft(te, axis=1) / size
    amplitude = 2 * np.abs(lines[:, 1:-1]).max(axis=0)
    kept = np.argsort(-amplitude)[:MOST_ORDERS]
    kept = np.sort(kept[amplitude[kept] > FAINT * amplitude.max(initial=0.0)]) + 1
    orders = kept * (2 * np.pi / cycle)
    cosine, sine = 2 * lines[:, kept].real, -2 * lines[:, kept].imag
    whole = np.zeros_like(lines)
    whole[:, 0], whole[:, kept] = lines[:, 0], lines[:, kept]
    left = te - np.fft.irfft(whole * size, size, axis=1)
    zero = torques.size // 2
    travel = 0.0
    if scene.has_back:
        travel = float(np.mean(backlash(scene, theta).backlash))
    elif both:  # without the elastic part of both sides
        elastic = torques[zero] * np.abs(np.diff(te[zero : zero + 2], axis=0)).mean() / np.diff(torques[zero:][:2])[0]
        travel = float((te[zero - 1] - te[zero]).mean() - 2 * elastic)
    stiffness = float(np.diff(torques[-2:])[0] / np.abs(np.diff(te[-2:], axis=0)).mean())
    return Joint(
        1 / system.orders["output"],
        orders,
        torques,
        te.mean(axis=1),
        cosine,
        sine,
        float(left.std(axis=1).max()),
        max(travel, 0.0),
        stiffness,
        *damping_and_inertia(scene, torque),
    )


@arguments.checked(torque=_largest)
def export_joint(scene: Scene, folder: str | Path, *, torque: float) -> list[Path]:
    """Write the files that model a reducer for other programs.

    ``orders.csv`` and ``orders.nc`` hold the TE as orders with phases, by torque. ``te_model.py`` holds the functions
    ``te(theta, torque)`` and ``torque_of(theta, position)``, which need only numpy. ``joint.json`` holds ratio,
    backlash, stiffness, damping and orders. ``joint.xml`` is a joint for MuJoCo (MJCF); ``joint_mujoco.py`` adds the
    forces of the reducer to it.

    Args:
        scene: the gear set, with a compliance, and with inertia and damping if the joint should have them.
        folder: folder of the files.
        torque: largest load torque of the application [N m].

    Returns:
        The paths of the files.

    Raises:
        SceneError: as for `joint_model`.
        GearjaxError: the folder cannot be written.

    Example:
        >>> import gearjax as gj, tempfile
        >>> files = gj.export_joint(gj.load("configs/two_kv/wang_2020.toml"), tempfile.mkdtemp(), torque=100.0)
        >>> [file.name for file in files][:2]
        ['orders.csv', 'orders.nc']
    """
    joint = joint_model(scene, torque)
    place = writable(Path(folder))
    model = TE_FILE.format(**{key: _array(value) for key, value in _arrays(joint).items()}, ratio=repr(joint.ratio))
    return [
        write_file(place / "orders.csv", _csv(joint)),
        write_file(place / "orders.nc", _netcdf(joint)),
        write_file(place / "te_model.py", model),
        write_file(place / "joint.json", json.dumps(joint.as_json(), indent=1) + "\n"),
        write_file(place / "joint.xml", mjcf(joint.inertia)),
        write_file(place / "joint_mujoco.py", MUJOCO_FILE.format(damping=repr(joint.damping))),
    ]


def _arrays(joint: Joint) -> dict[str, np.ndarray]:
    return {
        "orders": joint.orders,
        "torques": joint.torques,
        "mean": joint.mean,
        "cosine": joint.cosine,
        "sine": joint.sine,
    }


def _array(values: np.ndarray) -> str:
    rows = [values] if values.ndim == 1 else list(values)
    texts = ["[" + ", ".join(f"{value:.10e}" for value in row) + "]" for row in rows]
    return texts[0] if values.ndim == 1 else "[\n    " + ",\n    ".join(texts) + ",\n]"


def _csv(joint: Joint) -> str:
    lines = ["torque [N m],order [per turn of the input],amplitude [arcmin],phase of the cosine [deg]"]
    for k, torque in enumerate(joint.torques):
        lines.append(f"{torque:.6g},0,{joint.mean[k] / arcmin:.8g},0")
        for order, cosine, sine in zip(joint.orders, joint.cosine[k], joint.sine[k], strict=True):
            phase = np.degrees(np.arctan2(-sine, cosine))
            lines.append(f"{torque:.6g},{order:.10g},{np.hypot(cosine, sine) / arcmin:.8g},{phase:.8g}")
    return "\n".join(lines) + "\n"


def _netcdf(joint: Joint) -> bytes:
    import xarray as xr

    axes = {"torque": joint.torques, "order": joint.orders}
    table = xr.Dataset(
        {
            "mean": ("torque", joint.mean),
            "cosine": (("torque", "order"), joint.cosine),
            "sine": (("torque", "order"), joint.sine),
        },
        coords=axes,
        attrs={"ratio": joint.ratio, "unit": "rad, N m, cycles per turn of the input"},
    )
    written = table.to_netcdf(engine="scipy")
    return bytes(written) if not isinstance(written, io.BytesIO) else written.getvalue()
