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
ROUNDED = 4.0  # spacings of the dtype by which an angle may be rounded
ROUNDINGS = 1e3  # spacings of the dtype by which gaps, stiffness and load may be rounded, over their sizes
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
    eps = float(jnp.finfo(scene.dtype).eps)
    later = places + angle
    beside = later * (1 + ROUNDED * eps)  # what differs by the rounding of the angle alone does not count
    compared = evaluated(_compared, physics, places, later, beside)
    gap, stiffness, load = ([np.asarray(part) for part in each] for each in compared)

    def differs(parts: list[np.ndarray], least: float) -> float:
        first, then, rounded = parts
        off = np.abs(then - first).max(initial=0.0)
        allowed = least + ROUNDINGS * eps * np.abs(first).max(initial=0.0) + np.abs(rounded - then).max(initial=0.0)
        return float(off) if off > allowed else 0.0

    if off := differs(gap, NOTHING):
        return f"gaps differ by {off * 1e6:.3g} um"
    for name, parts in (("stiffness", stiffness), ("load", load)):
        if differs(parts, NOTHING * float(np.abs(parts[0]).max(initial=0.0))):
            return f"its {name} differs"
    return None


def _compared(scene: Scene, *angles: Array) -> tuple[tuple[Array, ...], ...]:
    """Gaps, stiffness and shape of the load, at each series of input angles; contacts may have changed places."""

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

    return tuple(zip(*(jax.vmap(at)(jnp.asarray(part, scene.dtype)) for part in angles), strict=True))
