"""Nodes on the outline of one tooth, with the fillet at its root."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gearjax.checks import GearjaxError
from gearjax.geometry.involute import InvoluteGear

GROWTH = 1.4  # ratio of the sizes of successive elements outside the zone where teeth touch
ROUNDED = 1e-6  # share of the tip radius that counts as rounding: a gear may have single precision


class Outline(NamedTuple):
    """Half a tooth and half the space beside it, in polar coordinates about the gear's centre.

    Angles are counted from the axis of the tooth towards the middle of the space.

    Args:
        radius, angle: polar coordinates of the flank's nodes from the foot to the tip, shape (row,) [m], [rad].
        space_radius, space_angle: polar coordinates of the nodes from the foot to the middle of the space, shape
            (place,) [m], [rad].
        rim: radius of the fixed boundary [m].
        touching: numbers of the rows at the requested radii, shape (radius,).
    """

    radius: np.ndarray
    angle: np.ndarray
    space_radius: np.ndarray
    space_angle: np.ndarray
    rim: float
    touching: np.ndarray


def outline(gear: InvoluteGear, radii: np.ndarray, *, rim: float, fillet: float, space_elements: int) -> Outline:
    """Outline of a tooth, with nodes at requested radii.

    Args:
        gear: gear with its flanks, root circle and tip circle; its flanks are radial below the base circle.
        radii: radii where teeth may touch, in order from the root to the tip, shape (radius,) [m].
        rim: depth of the fixed boundary of the rim under the root circle [m].
        fillet: radius of the arc between flank and root circle [m].
        space_elements: number of elements over half of the space between two teeth, in addition to those of the fillet.

    Raises:
        GearjaxError: the radii lie beyond the tip or in the fillet, or the fillet does not fit.
    """
    outward = -1.0 if gear.internal else 1.0  # from the root to the tip
    root, tip = float(gear.root_radius), float(gear.tip_radius)
    if outward * (tip - root) <= 0:
        raise GearjaxError(f"root circle {root:.6g} m, tip circle {tip:.6g} m: the tooth has no height")
    upper, lower = _fillet(gear, fillet)
    end = upper[0, -1]
    heights, room = outward * (radii - end), outward * (tip - end)
    slack = ROUNDED * tip
    if heights[0] < -slack or heights[-1] > room + slack or (np.diff(heights) <= 0).any():
        raise GearjaxError(
            f"radii from {radii[0]:.6g} to {radii[-1]:.6g} m: must go from the end of the fillet ({end:.6g} m) "
            f"towards the tip ({tip:.6g} m)"
        )
    below = heights[0] - graded(heights[0], heights[1] - heights[0], slack)[::-1]
    above = heights[-1] + graded(room - heights[-1], heights[-1] - heights[-2], slack)
    upper = upper[:, :-1]  # the end of the fillet is the first node of the flank
    flank = np.concatenate([end + outward * below, radii, end + outward * above])
    flat = np.linspace(lower[1, -1], np.pi / gear.teeth, space_elements + 1)[1:]
    return Outline(
        radius=np.concatenate([upper[0], flank]),
        angle=np.concatenate([upper[1], flank_angle(gear, flank)]),
        space_radius=np.concatenate([lower[0], np.full(len(flat), root)]),
        space_angle=np.concatenate([lower[1], flat]),
        rim=root - outward * rim,
        touching=upper.shape[1] + len(below) + np.arange(len(radii)),
    )


def flank_angle(gear: InvoluteGear, radius: np.ndarray) -> np.ndarray:
    """Half of the angle that a tooth fills [rad] at radii of any shape [m]; flanks are radial below the base circle."""
    return np.asarray(gear.half_angle(jnp.asarray(np.maximum(radius, float(gear.base_radius) * (1 + ROUNDED)))))


def graded(length: float, first: float, slack: float = 0.0) -> np.ndarray:
    """Ends of elements that fill a length; their sizes grow from about the given first size, shape (element,)."""
    if length <= slack:
        return np.empty(0)
    sizes = [first]
    while sum(sizes) < 0.999 * length:
        sizes.append(sizes[-1] * GROWTH)
    if len(sizes) > 1 and sum(sizes) - length > 0.5 * sizes[-1]:
        sizes.pop()
    return np.cumsum(sizes) * (length / sum(sizes))


def _fillet(gear: InvoluteGear, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Arc between flank and root circle, as radii and angles of its upper and its lower half, shape (2, node) each.

    The upper half goes from the middle of the arc up to the flank, the lower half from the middle down to the root
    circle. Heights and widths are measured as if the root circle were straight.
    """
    outward = -1.0 if gear.internal else 1.0
    root, pitch = float(gear.root_radius), np.pi / gear.teeth
    if radius <= 0:
        corner = np.array([[root], flank_angle(gear, np.array([root]))])
        return corner, corner

    def width(height: float) -> float:
        """Half the width of the space at a height over the root circle [m]."""
        return root * float(pitch - flank_angle(gear, np.array(root + outward * height)))

    def lean(height: float) -> float:
        """Angle between the flank and the radius at a height over the root circle [rad]."""
        step = 1e-2 * radius
        return np.arctan((width(height + step) - width(height - step)) / (2 * step))

    from scipy.optimize import brentq  # this import takes a tenth of a second, and only this function needs it

    root_of = brentq(lambda height: height - radius * (1 - np.sin(lean(height))), -radius, 2 * radius)
    touch = float(np.asarray(root_of))
    middle = width(touch) - radius * np.cos(lean(touch))
    if middle < 0:
        raise GearjaxError(f"fillet = {radius:.4g} m: it does not fit into the space, at most {_largest(width):.3g} m")
    end = -lean(touch)
    half = 0.5 * (end - 0.5 * np.pi)

    def nodes(angles: np.ndarray) -> np.ndarray:
        heights = radius * (1 + np.sin(angles))
        across = middle + radius * np.cos(angles)
        return np.stack([root + outward * heights, pitch - across / root])

    return nodes(np.linspace(half, end, 3)), nodes(np.linspace(half, -0.5 * np.pi, 3))


def _largest(width) -> float:
    """Radius of a fillet that fits: about half of the width of the space at the root [m]."""
    return 0.9 * width(0.0)
