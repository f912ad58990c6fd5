"""Free numbers of a scene: chosen by path or by function, with their periods, bounds and transforms."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import MISSING, ParameterError, nearest
from gearjax.parameters import Parameter, declared
from gearjax.scene import Scene
from gearjax.typing import Array, Float

Where = str | Sequence[str] | Callable[[Scene], Any]
Bounds = Mapping[str, tuple[float, float]]
PARTS = (
    "system",
    "errors",
    "backlash",
    "compliance",
    "supports",
    "shafts",
    "inertia",
    "damping",
    "impact",
    "load",
    "contact",
)
OF_BODIES = {"inertia": "body_inertia"}  # slot with the numbers of single bodies, [inertia.BODY]
_PROBE = 1e-6  # replaces a zero beside a free number when the influence of the free number is tested [SI]


class Free(eqx.Module):
    """Numbers of a scene that a study may change.

    Args:
        paths: dotted paths such as ``errors.planet_1.phase``, or ``compliance.phases[0]`` in a series.
        periods: period of each number, ``2 pi`` for angles, else ``None``.
        bounds: lowest and highest value of each number in SI; infinite if the declaration sets none.
        searchable: whether each number may be searched between its bounds: if the user gave them, or if they are
            declared close to each other.
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    periods: tuple[float | None, ...] = eqx.field(static=True)
    bounds: tuple[tuple[float, float], ...] = eqx.field(static=True)
    searchable: tuple[bool, ...] = eqx.field(static=True)

    def get(self, scene: Scene) -> Float[Array, " free"]:
        """Values of the free numbers in a scene, shape (free,), SI."""
        return jnp.stack([_number(scene, path) for path in self.paths])

    def set(self, scene: Scene, values: Float[Array, " free"]) -> Scene:
        """The scene with other values of the free numbers."""
        whole: dict[str, Any] = {}
        parts: dict[str, dict[int, int]] = {}  # by leaf: place in the leaf, and place in the values
        for column, path in enumerate(self.paths):
            leaf, place = _split(path)
            if place is None:
                whole[leaf] = values[column]
            else:
                parts.setdefault(leaf, {})[place] = column
        for leaf, columns in parts.items():
            known = _leaf(scene, leaf)
            sources = [len(known) + columns[i] if i in columns else i for i in range(len(known))]
            whole[leaf] = jnp.concatenate([known, values])[np.array(sources)]  # all at once, as there may be many
        return eqx.tree_at(lambda s: [_leaf(s, path) for path in whole], scene, list(whole.values()))

    @property
    def scales(self) -> np.ndarray:
        """Size of one unit of each number in a search: a radian, or the span between the bounds, shape (free,)."""
        spans = [1.0 if period else high - low for period, (low, high) in zip(self.periods, self.bounds, strict=True)]
        return np.array(spans)

    @property
    def origins(self) -> np.ndarray:
        """Origin of each number in a search: zero for angles, else the lowest value, shape (free,)."""
        return np.array([0.0 if p else low for p, (low, _) in zip(self.periods, self.bounds, strict=True)])

    @property
    def periodic(self) -> np.ndarray:
        """Whether each number is an angle, shape (free,)."""
        return np.array([period is not None for period in self.periods])

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest values to draw from, shape (free,) each."""
        low, high = np.array(self.bounds).T
        return np.where(self.periodic, -np.pi, low), np.where(self.periodic, np.pi, high)

    def wrapped(self, values: np.ndarray) -> np.ndarray:
        """Angles within half a turn of zero, other numbers within their bounds; shape (..., free)."""
        low, high = np.array(self.bounds).T
        return np.where(self.periodic, _turned(values), np.clip(values, low, high))

    def way(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Vector from one point to another, angles in the shorter direction; shape (..., free)."""
        return np.where(self.periodic, _turned(end - start), end - start)

    def unconstrained(self, values: Float[Array, " free"]) -> Float[Array, " free"]:
        """Unconstrained numbers: angles unchanged, bounded numbers as the logit of their place between the bounds."""
        origins, scales = (jnp.asarray(part, values.dtype) for part in (self.origins, self.scales))
        place = jnp.clip((values - origins) / scales, 1e-3, 1 - 1e-3)
        return jnp.where(self.periodic, values, jnp.log(place / (1 - place)))

    def constrained(self, numbers: Float[Array, " free"]) -> Float[Array, " free"]:
        """The inverse of `unconstrained`."""
        origins, scales = (jnp.asarray(part, numbers.dtype) for part in (self.origins, self.scales))
        return jnp.where(self.periodic, numbers, origins + scales * jax.nn.sigmoid(numbers))

    def require_bounds(self) -> None:
        """Refuse numbers that are neither angles nor have bounds to search between.

        Raises:
            ParameterError: names the number.
        """
        for path, period, (low, high), known in zip(
            self.paths, self.periods, self.bounds, self.searchable, strict=True
        ):
            if period is None and not known:
                raise ParameterError(f"bounds of {path}", MISSING, "must be given: lowest and highest value")
            if period is None and not (math.isfinite(low) and math.isfinite(high) and high > low):
                raise ParameterError(f"bounds of {path}", (low, high), "must be finite, lowest first")


def pick(scene: Scene, where: Where, bounds: Bounds | None = None) -> Free:
    """Choose free numbers by their paths, or by a function of the scene that returns its leaves.

    Args:
        scene: the scene.
        where: one path, several, or ``lambda scene: scene.errors["planet_1"].phase`` (or a list of such leaves); a path
            that ends with ``[*]`` stands for every number of its series.
        bounds: narrower bounds than the declared ones, by path, in SI.

    Raises:
        ParameterError: a path does not exist, or is not that of one number; the nearest path is named.
    """
    known = numbers(scene)
    paths = _paths(scene, where, known)
    narrower = {name: limits for path, limits in (bounds or {}).items() for name in members(path, known)}
    for path in paths:
        if path not in known:
            raise ParameterError("where", path, f"is no number of this scene; {nearest(path, known)}")
    for path, limits in narrower.items():
        if path not in paths:
            raise ParameterError(f"bounds of {path}", limits, f"is not free; {nearest(path, paths)}")
    periods, limits, searchable = [], [], []
    for path in paths:
        if paths.count(path) > 1:
            raise ParameterError("where", path, "is listed twice")
        parameter = known[path]
        periods.append(2 * math.pi if parameter.periodic else None)
        limits.append(narrower.get(path, parameter.range))
        searchable.append(path in narrower or parameter.is_tight)
    if not paths:
        raise ParameterError("where", (), f"names no number; valid: {', '.join(known)}")
    return Free(paths, tuple(periods), tuple(limits), tuple(searchable))


def members(path: str, known: Mapping[str, Parameter]) -> tuple[str, ...]:
    """The numbers that a path stands for: all numbers of a series if it ends with ``[*]``, else one number."""
    if not isinstance(path, str) or not path.endswith("[*]"):
        return (path,)
    return tuple(name for name in known if series_of(name) == path) or (path,)


def series_of(path: str) -> str:
    """The path with ``[*]`` for the series that a number belongs to; empty if it belongs to none."""
    return re.sub(r"\[\d+\]$", "[*]", path) if path.endswith("]") else ""


def _paths(scene: Scene, where: Where, known: Mapping[str, Parameter]) -> tuple[str, ...]:
    if not callable(where):
        return tuple(name for path in ([where] if isinstance(where, str) else where) for name in members(path, known))
    leaves = jax.tree.leaves(where(scene))
    paths = [path for leaf in leaves for path in known if _leaf(scene, _split(path)[0]) is leaf]
    if len({_split(path)[0] for path in paths}) < len(leaves):
        raise ParameterError("where", where, "must return numbers of the scene that is passed to it")
    return tuple(paths)


def numbers(scene: Scene) -> dict[str, Parameter]:
    """All numbers of a scene with their declarations, by path."""
    parameters: dict[str, Parameter] = {}

    def visit(path: str, part: Any) -> None:
        if isinstance(part, Mapping):
            for key, value in part.items():
                visit(f"{path}.{key}", value)
        elif isinstance(part, eqx.Module):
            for name, parameter in declared(part).items():
                value = getattr(part, name)
                if isinstance(value, jax.Array) and value.ndim == 0:
                    parameters[f"{path}.{name}"] = parameter
                elif isinstance(value, jax.Array) and value.ndim == 1:
                    parameters.update({f"{path}.{name}[{index}]": parameter for index in range(value.shape[0])})

    for slot in PARTS:
        visit(slot, getattr(scene, slot))
        visit(slot, getattr(scene, OF_BODIES.get(slot, ""), None))
    return parameters


def probed(scene: Scene, free: Free) -> Scene:
    """The scene with small numbers in place of zeros beside free numbers, such as the amplitude of a free phase.

    With a zero beside it, a free number has no influence at present, although the model depends on it.
    """
    owners = {path.rpartition(".")[0] for path in free.paths}
    zeros = [
        path
        for path in numbers(scene)
        if path.rpartition(".")[0] in owners and path not in free.paths and float(_number(scene, path)) == 0.0
    ]
    if not zeros:
        return scene
    beside = pick(scene, zeros)
    return beside.set(scene, jnp.full((len(zeros),), _PROBE, scene.dtype))


def _turned(angles: np.ndarray) -> np.ndarray:
    """Angles within half a turn of zero."""
    with np.errstate(invalid="ignore"):  # a start may be infinite
        return angles - 2 * np.pi * np.round(angles / (2 * np.pi))


def _split(path: str) -> tuple[str, int | None]:
    """Path of the leaf, and the number's place in it, ``None`` for a scalar."""
    match = re.fullmatch(r"(.*)\[(\d+)\]", path)
    return (match[1], int(match[2])) if match else (path, None)


def _leaf(scene: Any, path: str) -> Any:
    """The leaf at a path."""
    slot, *steps = path.split(".")
    bodies = getattr(scene, OF_BODIES.get(slot, ""), {})
    part = bodies if steps[0] in bodies else getattr(scene, slot)
    for step in steps:
        part = part[step] if isinstance(part, Mapping) else getattr(part, step)
    return part


def owners(scene: Scene, paths: Sequence[str]) -> list[Any]:
    """The parts of a scene to which numbers belong, such as its system and some of its errors."""
    parents = dict.fromkeys(_split(path)[0].rpartition(".")[0] for path in paths)
    return [_leaf(scene, parent) if "." in parent else getattr(scene, parent) for parent in parents]


def _number(scene: Any, path: str) -> Array:
    leaf, index = _split(path)
    value = _leaf(scene, leaf)
    return value if index is None else value[index]
