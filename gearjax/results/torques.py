"""Static TE of a run against its torques."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from gearjax.analysis import TorqueSweep, TransmissionError
from gearjax.analysis.torque_sweep import harmonics_of, whole_periods
from gearjax.scene import Scene

if TYPE_CHECKING:
    from gearjax.results.cases import Case  # that module imports this one

FEWEST = 3  # torques that make a curve
HARMONICS = 3
CLOSED = 1e-3  # share of its swing by which the TE may differ at both ends of a record that repeats


def against_torque(scene: Scene, cases: "list[Case]") -> TorqueSweep | None:
    """Static TE of a run against the torque, with harmonics of the mesh.

    ``None`` if the run has fewer than three static torques, or if its record is no whole number of meshes or the TE
    does not repeat after it.
    """
    found = {
        case.torque: case.result
        for case in cases
        if isinstance(case.result, TransmissionError) and case.result.forces is not None
    }
    order = scene.system.orders["mesh"]
    if len(found) < FEWEST:
        return None
    each = [found[torque] for torque in sorted(found)]
    theta = each[0].theta[:-1]  # records have both ends
    if not whole_periods(np.asarray(theta, float), order):
        return None
    te = jnp.stack([result.te for result in each])
    if (np.abs(te[:, -1] - te[:, 0]) > CLOSED * np.ptp(te, axis=1)).any():
        return None
    te = te[:, :-1]
    return TorqueSweep(
        jnp.asarray(sorted(found), te.dtype),
        te.mean(axis=-1),
        jnp.stack([result.extremes.maximum - result.extremes.minimum for result in each]),
        harmonics_of(te, theta, order, HARMONICS),
        jnp.stack([result.result.max() for result in each]),
        "mesh",
    )
