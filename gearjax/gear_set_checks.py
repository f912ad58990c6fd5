"""Checks of gear sets and errors that are defined outside gearjax: what they return, and which orders they name."""

import math
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import SceneError, is_concrete, warn_the_caller
from gearjax.contact import Pose, Request

if TYPE_CHECKING:
    from gearjax.scene import Scene  # that module imports this one

SPANS, NODES, POINTS = 8, 14, 9  # stretches of half a wave of the fastest order, their nodes, and angles between these
COARSE = 1e-3  # share of a gap's range by which a curve through the nodes may miss it; waves ten times as fast reach it
_passed: set[Any] = set()


class UnnamedOrder(UserWarning):
    """A gear set or an error of one's own has waves that are faster than the orders which the gear set names."""


def check_gear_set(scene: "Scene") -> None:
    """Check what a gear set and errors from outside gearjax return, once for each structure of a scene.

    Raises:
        SceneError: an order is missing, an array of the pose has a wrong shape, or a lever has a wrong sign.
    """
    parts = (scene.system, *scene.errors.values())
    if all(type(part).__module__.partition(".")[0] == "gearjax" for part in parts):
        return
    with_back = scene.backlash is not None
    own = scene.system, dict(scene.errors)
    known = is_concrete(own)
    leaves, structure = jax.tree.flatten(own)
    numbers = [leaf for leaf in leaves if isinstance(leaf, int | float | np.ndarray | jax.Array)]
    shown = tuple(bool(np.any(leaf)) for leaf in numbers) if known else ()  # what is zero hides what it would do
    if (structure, with_back, shown) in _passed:
        return
    _check_orders(scene)
    bodies = tuple(dict.fromkeys(error.body for error in scene.errors.values()))
    _check_shapes(scene, Request(with_back, bodies, mesh=True))
    if known:
        with jax.ensure_compile_time_eval():
            _check_signs(scene)
            _look_for_fast_waves(scene)
        _passed.add((structure, with_back, shown))


def _check_orders(scene: "Scene") -> None:
    for name in ("output", "mesh"):
        if name not in scene.system.orders:
            raise SceneError(f'{scene.system.kind}: orders must name "{name}", in cycles per turn of the input')


def _check_shapes(scene: "Scene", request: Request) -> None:
    kind, layout = scene.system.kind, scene.layout
    angle = jax.ShapeDtypeStruct((), scene.dtype)
    pose: Pose = jax.eval_shape(lambda angle: scene.system.pose(angle, request), angle)
    contacts, pairs = len(layout.side), max(layout.pair) + 1
    wanted = {"gap": (contacts, "a gap for each contact"), "mesh_angle": (pairs, "a phase for each pair")}
    if pose.jacobian.ndim != 2 or pose.jacobian.shape[0] != contacts:
        told = f"({contacts}, 1) or more columns, a row for each contact of its layout"
        raise SceneError(f"{kind}: the jacobian of its pose has shape {pose.jacobian.shape}; must be {told}")
    for name, (number, words) in wanted.items():
        part = getattr(pose, name)
        if part is not None and part.shape != (number,):
            told = f"must be ({number},), {words} of its layout"
            raise SceneError(f"{kind}: {name} of its pose has shape {part.shape}; {told}")
    missing = [body for body in request.bodies if body not in pose.views]
    if missing:
        raise SceneError(f'{kind}: its pose has no view of "{missing[0]}", which carries an error')


def _check_signs(scene: "Scene") -> None:
    layout = scene.layout
    if layout.sides_turn:
        return
    pose = scene.system.pose(jnp.zeros((), scene.dtype), Request(scene.backlash is not None))
    for contact, (side, lever) in enumerate(zip(layout.side, np.asarray(pose.jacobian)[:, 0].tolist(), strict=True)):
        if side * lever > 0:
            flank, sign = ("driving", "negative") if side > 0 else ("back", "positive")
            raise SceneError(
                f"{scene.system.kind}: contact {contact} is on a {flank} flank and has the lever {lever:.6g} m/rad in "
                f"the first column of its jacobian; levers of {flank} flanks are {sign}"
            )


def _look_for_fast_waves(scene: "Scene") -> None:
    """Warn if gaps change faster than the fastest order: curves through some nodes of half a wave then miss them."""
    system = scene.system
    if system.fastest_order <= 0:
        return
    nodes = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    points = np.linspace(-0.97, 0.97, POINTS)
    through = np.polynomial.chebyshev.chebvander(points, NODES - 1) @ np.linalg.inv(
        np.polynomial.chebyshev.chebvander(nodes, NODES - 1)
    )
    half = 0.5 * math.pi / system.fastest_order
    starts = system.cycle * np.mod(0.1 + 0.618034 * np.arange(SPANS), 1.0)
    angles = starts[:, None] + half * (1 + np.concatenate([nodes, points]))
    gaps = jax.vmap(jax.vmap(lambda angle: scene.contacts(angle).gap))(jnp.asarray(angles, scene.dtype))
    gaps = np.asarray(gaps, float)
    missed = np.abs(np.einsum("pn,snc->spc", through, gaps[:, :NODES]) - gaps[:, NODES:]).max(axis=1)
    size = np.ptp(gaps, axis=(0, 1))
    noise = 100 * float(jnp.finfo(scene.dtype).eps) * np.abs(gaps).max(axis=(0, 1))
    # a tooth that leaves makes its gap jump in some stretches, far from contact; waves are in all of them
    share = np.sort(missed, axis=0)[1] / np.maximum(size, 1e-300)
    if ((share > COARSE) & (size > noise)).any():
        warn_the_caller(
            f"the gaps of {system.kind} have waves that are far faster than its fastest order "
            f"({system.fastest_order:.4g} cycles per turn of the input): steps in time and angles may miss them; name "
            "their order in `orders`, that of the teeth beside mesh too",
            UnnamedOrder,
        )
