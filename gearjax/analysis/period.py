"""Whether the excitation of a scene repeats after a period, as periodic motions need it."""

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import SceneError, is_concrete
from gearjax.contact import LinearSprings, LineSprings
from gearjax.evaluate import evaluated
from gearjax.scene import Scene
from gearjax.typing import Array, Scalar

ANGLES = 5  # input angles, at uneven places, at which the contacts are compared
DEEP = 1e-6  # m, approach at which the stiffness of contacts is compared
NOTHING = 1e-9  # difference of gaps that counts as none [m]; and of stiffness and load, over their sizes


def check_repeats(scene: Scene, angle: float) -> None:
    """Refuse a period after which gaps, stiffness or load differ, if all numbers of the scene are known.

    Args:
        scene: the scene, with compliance and load.
        angle: input angle of the period [rad].

    Raises:
        SceneError: tells what differs, and after which angle errors repeat.
    """
    words = what_differs(scene, angle)
    if words is not None:
        cycle = f"errors repeat after scene.system.cycle = {scene.system.cycle:.6g} rad of the input"
        raise SceneError(
            f"the excitation does not repeat after a period of {angle:.6g} rad of the input: {words}; {cycle}"
        )


def what_differs(scene: Scene, angle: float) -> str | None:
    """What differs after an input angle [rad], in words; ``None`` if nothing does or not all numbers are known."""
    if not is_concrete(scene):
        return None
    places = angle * np.modf(np.arange(1, ANGLES + 1) * (np.sqrt(5) - 1) / 2)[0]
    with jax.ensure_compile_time_eval():  # also inside the trace of something else
        physics = scene.physics("backlash", "compliance", "load")
    both = evaluated(_compared, physics, places, places + angle)
    (gap, after), (stiffness, stiffer), (load, other) = ([np.asarray(part) for part in each] for each in both)
    rounding = 1e3 * float(jnp.finfo(scene.dtype).eps)
    off = float(np.abs(after - gap).max(initial=0.0))
    if off > NOTHING + rounding * np.abs(gap).max(initial=0.0):
        return f"gaps differ by {off * 1e6:.3g} um"
    for name, before, then in (("stiffness", stiffness, stiffer), ("load", load, other)):
        if np.abs(then - before).max(initial=0.0) > (NOTHING + rounding) * np.abs(before).max(initial=0.0):
            return f"its {name} differs"
    return None


def _compared(scene: Scene, before: Array, after: Array) -> tuple[tuple[Array, Array], ...]:
    """Gaps, stiffness and shape of the load at input angles and a period later; contacts may have changed places."""

    def at(theta: Scalar) -> tuple[Array, Array, Array]:
        contacts = scene.contacts(theta, "varying")
        stiffness = jnp.zeros_like(contacts.gap)
        if contacts.springs is not None:
            assert isinstance(contacts.springs, LinearSprings | LineSprings)
            stiffness = contacts.springs.secant(jnp.full_like(contacts.gap, DEEP))
        load = jnp.ones_like(theta)
        if scene.load is not None:
            turns, time = theta / (2 * jnp.pi), theta / scene.system.input_speed
            load = jnp.broadcast_to(scene.load.shape(turns, time, scene.system.orders), theta.shape)
        return jnp.sort(contacts.gap), jnp.sort(stiffness), load

    angles = (jnp.asarray(part, scene.dtype) for part in (before, after))
    return tuple(zip(*(jax.vmap(at)(part) for part in angles), strict=True))
