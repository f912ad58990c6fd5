"""Whether the excitation of a scene repeats after a period, as periodic motions need it."""

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import SceneError, is_concrete
from gearjax.contact import LinearSprings, LineSprings
from gearjax.evaluate import evaluated
from gearjax.scene import Scene
from gearjax.typing import Array, ArrayLike, Float, Scalar

ANGLES = 5  # input angles, at uneven places, at which the contacts are compared
DEEP = 1e-6  # m, approach at which the stiffness of contacts is compared
ROUNDED = 4.0  # spacings of the dtype by which an angle may be rounded
ROUNDINGS = 1e3  # spacings of the dtype by which gaps, stiffness and load may be rounded, over their sizes
NOTHING = 1e-9  # difference of gaps that counts as none [m]; and of stiffness and load, over their sizes


def check_repeats(scene: Scene, angle: float, speeds: ArrayLike | None = None) -> None:
    """Refuse a period after which contacts, load or the ideal output differ, if all numbers of the scene are known.

    Args:
        scene: the scene, with compliance and load.
        angle: input angle of the period [rad].
        speeds: input speeds of the motions [rad/s], on which a load with a frequency of its own depends; without them,
            the speed of the scene.

    Raises:
        SceneError: tells what differs, and after which angle errors repeat.
    """
    words = what_differs(scene, angle, speeds)
    if words is not None:
        cycle = f"errors repeat after scene.system.cycle = {scene.system.cycle:.6g} rad of the input"
        raise SceneError(
            f"the excitation does not repeat after a period of {angle:.6g} rad of the input: {words}; {cycle}"
        )


def what_differs(scene: Scene, angle: float, speeds: ArrayLike | None = None) -> str | None:
    """What differs after an input angle [rad], in words; ``None`` if nothing does or not all numbers are known.

    At ``speeds`` [rad/s] that are not known, the load is not looked at.
    """
    if not is_concrete(scene):
        return None
    places = angle * np.modf(np.arange(1, ANGLES + 1) * (np.sqrt(5) - 1) / 2)[0]
    with jax.ensure_compile_time_eval():  # also inside the trace of something else
        physics = scene.physics("backlash", "compliance", "load")
    eps = float(jnp.finfo(scene.dtype).eps)
    later = places + angle
    beside = later * (1 + ROUNDED * eps)  # what differs by the rounding of the angle alone does not count
    given = scene.system.input_speed if speeds is None else speeds
    known = np.atleast_1d(np.asarray(given, float)) if is_concrete(given) else np.zeros(0)
    seen = [
        jax.tree.map(np.asarray, part) for part in evaluated(_seen, physics, np.stack([places, later, beside]), known)
    ]

    def differs(part: Float[np.ndarray, "3 angle *rest"], least: float) -> np.ndarray:
        """Which entries differ between the angles and a period later, by how much; zero for rounding."""
        first, then, rounded = part
        off = np.abs(then - first).max(axis=0)
        allowed = least + ROUNDINGS * eps * np.abs(first).max(initial=0.0) + np.abs(rounded - then).max(initial=0.0)
        return np.where(off > allowed, off, 0.0)

    if (off := differs(seen[0], NOTHING).max(initial=0.0)) > 0:
        return f"gaps differ by {off * 1e6:.3g} um"
    *alike, load = [differs(part, NOTHING * float(np.abs(part[0]).max(initial=0.0))) for part in seen[1:]]
    told = "stiffness differs", "levers differ", "output's acceleration differs"
    for words, off in zip(told, alike, strict=True):
        if off.any():
            return f"its {words}"
    if load.any():
        return "its load differs" + ("" if speeds is None else f" at {known[np.argmax(load)]:.6g} rad/s")
    return None


def _seen(scene: Scene, angles: Float[Array, "3 angle"], speeds: Float[Array, " speed"]) -> tuple[Array, ...]:
    """Gaps, stiffness, levers, acceleration of the ideal output and load at input angles and speeds.

    Contacts may have changed places; therefore each is sorted.
    """
    speed, speeds = scene.system.input_speed, speeds.astype(scene.dtype)

    def at(theta: Scalar) -> tuple[Array, ...]:
        contacts, turns = scene.contacts(theta, "varying"), theta / (2 * jnp.pi)
        stiffness = jnp.zeros_like(contacts.gap)
        if contacts.springs is not None:
            assert isinstance(contacts.springs, LinearSprings | LineSprings)
            stiffness = contacts.springs.secant(jnp.full_like(contacts.gap, DEEP))
        levers, turning = jnp.sort(contacts.jacobian, axis=0), jnp.zeros_like(theta)
        if not scene.system.turns_evenly:
            turning = scene.system.output_acceleration(theta / speed)
        load = jnp.ones_like(speeds)
        if scene.load is not None:
            load = jax.vmap(scene.load.shape, (None, 0, None))(turns, theta / speeds, scene.system.orders)
        return jnp.sort(contacts.gap), jnp.sort(stiffness), levers, turning, load

    return jax.vmap(jax.vmap(at))(angles.astype(scene.dtype))
