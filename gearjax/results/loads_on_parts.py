"""What a run tells of the loads on faces and bearings, and of impacts."""

from typing import TYPE_CHECKING, Any

import numpy as np

from gearjax.analysis import (
    Backlash,
    BearingForces,
    MeshingImpacts,
    Motion,
    TransmissionError,
    bearing_forces,
    face_load,
    meshing_impact,
)
from gearjax.impact import MeshingImpact
from gearjax.scene import Scene

if TYPE_CHECKING:
    from gearjax.results.cases import Case  # that module imports this one


def face_load_factors(scene: Scene, cases: "list[Case]") -> dict[str, float]:
    """Face load factor K_Hbeta of each loaded case at rest, by its title, and by mesh if there are several.

    The result is empty if the gear set has no slices. A record shorter than a mesh has
    none, as the mean over a part of a mesh depends on the part.
    """
    factors = {}
    for case in cases:
        te = case.result
        if not scene.system.has_slices or not isinstance(te, TransmissionError) or te.forces is None:
            continue
        orders = scene.system.mesh_orders
        for mesh, order in enumerate(orders):
            if float(te.theta[-1] - te.theta[0]) * order / (2 * np.pi) > 1 - 1e-9:
                title = case.title if len(orders) == 1 else f"{case.title}, mesh {mesh + 1}"
                factors[title] = float(face_load(scene, te, mesh).factor)
    return {title: factor for title, factor in factors.items() if np.isfinite(factor)}


def forces_on_bearings(scene: Scene, result: TransmissionError | Backlash | Motion) -> BearingForces | None:
    """Forces on the supports under the loads of a result; ``None`` without supports or forces."""
    if not scene.supports or not isinstance(result, TransmissionError | Motion) or result.forces is None:
        return None
    return bearing_forces(scene, result)


def impacts_of(scene: Scene, cases: "list[Case]") -> dict[str, MeshingImpacts]:
    """Impacts of the teeth as they come into mesh in each case in motion, by its title; empty if none are listed."""
    if not isinstance(scene.impact, MeshingImpact):
        return {}
    moving = [case for case in cases if case.analysis == "dynamic" and case.torque > 0]
    return {case.title: meshing_impact(scene, case.torque) for case in moving}


def impacts_as_json(impacts: dict[str, MeshingImpacts]) -> dict[str, dict[str, Any]]:
    """Means and largest values of the impacts of each case, for JSON."""
    return {
        title: {
            "pairs": len(found.force),
            "force_N": float(found.force.mean()),
            "largest_force_N": float(found.force.max()),
            "velocity_m_s": float(found.velocity.mean()),
            "duration_us": float(found.duration.mean()) * 1e6,
            "ahead_um": float(found.ahead.mean()) * 1e6,
        }
        for title, found in impacts.items()
    }
