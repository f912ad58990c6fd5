"""Whether the excitation of a scene repeats after a period, as periodic motions need it."""

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import SceneError, is_concrete
from gearjax.evaluate import evaluated_once
from gearjax.scene import Scene
from gearjax.typing import Array, Scalar

ANGLES = 5  # input angles, at uneven places, at which the contacts are compared
NOTHING = 1e-9  # difference of gaps that counts as none [m]; and of stiffness and load, over their sizes


def check_repeats(scene: Scene, angle: Scalar | float) -> None:
    """Refuse a period of known numbers after which gaps, stiffness or load differ.

    Args:
        scene: the scene.
        angle: input angle of the period [rad].

    Raises:
        SceneError: tells what differs, and after which angle errors repeat.
    """
    if not is_concrete((scene, angle)):
        return
    physics = scene.physics("backlash", "compliance", "load")
    both = evaluated_once(_compared, physics, jnp.asarray(angle, scene.dtype))
    (gap, after), (stiffness, stiffer), (load, other) = ([np.asarray(part) for part in each] for each in both)
    rounding = 1e3 * float(jnp.finfo(scene.dtype).eps)
    off = float(np.abs(after - gap).max(initial=0.0))
    cycle = f"errors repeat after scene.system.cycle = {scene.system.cycle:.6g} rad of the input"
    whole = f"the excitation does not repeat after a period of {float(angle):.6g} rad of the input"
    if off > NOTHING + rounding * np.abs(gap).max(initial=0.0):
        raise SceneError(f"{whole}: gaps differ by {off * 1e6:.3g} um; {cycle}")
    for name, before, then in (("stiffness", stiffness, stiffer), ("load", load, other)):
        if np.abs(then - before).max(initial=0.0) > (NOTHING + rounding) * np.abs(before).max(initial=0.0):
            raise SceneError(f"{whole}: its {name} differs; {cycle}")


def _compared(scene: Scene, angle: Scalar) -> tuple[tuple[Array, Array], ...]:
    """Gaps, stiffness and shape of the load at some angles and a period later; contacts may have changed places."""
    shares = np.modf(np.arange(1, ANGLES + 1) * (np.sqrt(5) - 1) / 2)[0]
    speed = scene.system.input_speed

    def at(theta: Scalar) -> tuple[Array, Array, Array]:
        contacts = scene.contacts(theta, "varying" if scene.compliance is not None else "rigid")
        springs = contacts.linear if contacts.linear is not None else jnp.zeros_like(contacts.gap)
        shape = jnp.ones_like(theta)
        if scene.load is not None:
            shape = jnp.asarray(scene.load.shape(theta / (2 * jnp.pi), theta / speed, scene.system.orders))
        return jnp.sort(contacts.gap), jnp.sort(springs), jnp.broadcast_to(shape, theta.shape)

    places = angle * jnp.asarray(shares, scene.dtype)
    return tuple(zip(jax.vmap(at)(places), jax.vmap(at)(places + angle), strict=True))
