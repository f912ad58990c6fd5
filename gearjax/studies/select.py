"""Free leaves of a scene: picked by path or by function, with their levels, periods and bounds."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.checks import ParameterError, nearest
from gearjax.parameters import Parameter, declared
from gearjax.scene import Scene
from gearjax.typing import Array, Float

Where = str | Sequence[str]


class Free(eqx.Module):
    """Numbers of a scene that a study may change.

    Args:
        paths: dotted paths such as ``errors.planet_1.phase``; each leads to one number.
        periods: period of each, ``2 pi`` for angles, else ``None``.
        bounds: lowest and highest value of each in SI; infinite where the declaration sets none.
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    periods: tuple[float | None, ...] = eqx.field(static=True)
    bounds: tuple[tuple[float, float], ...] = eqx.field(static=True)

    def get(self, scene: Scene) -> Float[Array, " free"]:
        """Values in a scene, shape (free,), SI."""
        return jnp.stack([_leaf(scene, path) for path in self.paths])

    def set(self, scene: Scene, values: Float[Array, " free"]) -> Scene:
        """The scene with other values."""
        return eqx.tree_at(lambda s: [_leaf(s, path) for path in self.paths], scene, list(values))


def pick(scene: Scene, where: Where, bounds: Mapping[str, tuple[float, float]] | None = None) -> Free:
    """Free leaves by their paths.

    Args:
        scene: the scene.
        where: one path or several.
        bounds: narrower bounds than the declared ones, by path, in SI.

    Raises:
        ParameterError: a path leads nowhere, or not to one number; the nearest path is named.
    """
    paths = (where,) if isinstance(where, str) else tuple(where)
    known = numbers(scene)
    periods, limits = [], []
    for path in paths:
        if path not in known:
            raise ParameterError("where", path, f"no number of this scene; {nearest(path, known)}")
        if paths.count(path) > 1:
            raise ParameterError("where", path, "is listed twice")
        parameter = known[path]
        periods.append(2 * math.pi if parameter.periodic else None)
        limits.append((bounds or {}).get(path, parameter.range))
    return Free(paths, tuple(periods), tuple(limits))


def numbers(scene: Scene) -> dict[str, Parameter]:
    """Every single number of a scene with its declaration, by path."""
    found: dict[str, Parameter] = {}

    def visit(path: str, part: Any) -> None:
        if isinstance(part, Mapping):
            for key, value in part.items():
                visit(f"{path}.{key}", value)
        elif isinstance(part, eqx.Module):
            for name, parameter in declared(part).items():
                value = getattr(part, name)
                if isinstance(value, jax.Array) and value.ndim == 0:
                    found[f"{path}.{name}"] = parameter

    for slot in ("system", "errors", "backlash", "compliance", "inertia", "damping", "load", "contact"):
        visit(slot, getattr(scene, slot))
    return found


def _leaf(scene: Any, path: str) -> Any:
    """The number that a path leads to."""
    part: Any = scene
    for step in path.split("."):
        part = part[step] if isinstance(part, Mapping) else getattr(part, step)
    return part
