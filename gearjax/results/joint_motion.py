"""What a joint of one coordinate keeps of a gear set's motion: damping and moment of inertia of the output."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.analysis.choice import MODELLED
from gearjax.analysis.modes.equation import StructureEquation
from gearjax.checks import SceneError
from gearjax.contact import HardContact
from gearjax.load_torque import ConstantLoad
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.typing import Array, Bool, Scalar

ANGLES = 48  # of a cycle: means of damping and inertia
TURNS = 16  # of the search for the contacts that carry


def damping_and_inertia(scene: Scene, torque: float) -> tuple[float, float | None]:
    """Damping [N m s/rad] and moment of inertia [kg m2] of the output under a torque, means over a cycle.

    Other coordinates (supports, shafts) follow the output as they do at rest (Guyan 1965). The damping is zero if the
    scene has none, or springs that motion does not take; the moment of inertia is ``None`` if the scene has none.

    Args:
        scene: the scene.
        torque: load torque [N m].
    """
    if scene.inertia is None:
        return 0.0, None
    lever = scene.contacts(jnp.zeros_like(scene.system.input_speed)).output_levers
    if scene.damping is None or not _moves(scene):
        return 0.0, float(scene.inertia.moment(lever))
    scene = dataclasses.replace(scene, load=ConstantLoad(), contact=HardContact(), impact=None, run=None)
    # uneven shares of the cycle meet no wave at the same place each time
    shares = np.modf(np.arange(1, ANGLES + 1) * (np.sqrt(5) - 1) / 2)[0]
    times = jnp.asarray(shares * scene.system.cycle) / scene.system.input_speed
    damping, inertia = _followed(scene.physics(*MODELLED), jnp.asarray(torque, scene.dtype), times)
    return float(jnp.mean(damping)), float(jnp.mean(inertia))


def _moves(scene: Scene) -> bool:
    """Whether the scene has springs that motion takes."""
    try:
        require(scene, "damping of a joint", "compliance", "inertia")
    except SceneError:
        return False
    return True


@eqx.filter_jit
def _followed(scene: Scene, torque: Scalar, times: Array) -> tuple[Array, Array]:
    equation = StructureEquation.of(scene, torque)
    parts, driving = equation.structure, jnp.asarray(np.asarray(equation.layout.side) == 1)

    def at(time: Scalar) -> tuple[Scalar, Scalar]:
        now = equation.excitation(time)
        stiffness = equation.springs.linear(now.springs)

        def held(closed: Bool[Array, " contact"]) -> tuple[Array, Array]:
            springs = jnp.where(closed, stiffness, 0.0)
            pull = equation.given(now) + now.jacobian.T @ (springs * now.gap)
            return parts.stiffness + now.jacobian.T @ (springs[:, None] * now.jacobian), pull

        def next_closed(_: Any, closed: Bool[Array, " contact"]) -> Bool[Array, " contact"]:
            return now.jacobian @ jnp.linalg.solve(*held(closed)) - now.gap > 0

        closed = jax.lax.fori_loop(0, TURNS, next_closed, driving)
        matrix, pull = held(closed)
        overlap = now.jacobian @ jnp.linalg.solve(matrix, pull) - now.gap
        rows = now.jacobian[equation.springs.damped]
        drag = equation.drag(now.springs) * equation.engaged(overlap)
        damping = parts.damping + rows.T @ (drag[:, None] * rows)
        follow = jnp.concatenate([jnp.ones(1), -jnp.linalg.solve(matrix[1:, 1:], matrix[1:, 0])])
        return follow @ damping @ follow, follow @ parts.mass @ follow

    return jax.lax.map(at, times)
