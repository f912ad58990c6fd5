"""Unknowns: numbers of a scene that are identified from recordings, in a form in which the TE is as linear as possible.

An eccentricity is represented by its components ``a cos(phase)`` and ``a sin(phase)``, because gaps are linear in
them. A stiffness is represented by its reciprocal, to which a static deflection is proportional. Other numbers are
unknowns themselves.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, nearest
from gearjax.errors import AbstractMeasured
from gearjax.errors.eccentricity import Displacement
from gearjax.parameters import Parameter
from gearjax.scene import Scene
from gearjax.studies.select import Free, numbers, pick
from gearjax.typing import Array, Float
from gearjax.units import um

COMPONENTS = ("cos", "sin")
STIFF = (units.STIFFNESS, units.LINE_STIFFNESS, units.PRESSURE)  # dimensions of numbers that make contacts stiffer


@dataclasses.dataclass(frozen=True)
class Unknown:
    """One number that is identified.

    Args:
        name: name such as ``errors.planet_1.cos`` or ``compliance.mean``.
        kind: ``"component"`` of a vector, ``"number"``, or ``"reciprocal"`` of a number.
        path: path of the error for a component, else of the number.
        scale: size of one unit of the search, SI; for a reciprocal, the number at which the unknown is 1.
        unit, per_unit: unit in which values are shown, and its size in SI.
    """

    name: str
    kind: str
    path: str
    scale: float
    unit: str
    per_unit: float


@dataclasses.dataclass(frozen=True)
class Prior:
    """Prior knowledge of a number: mean and standard deviation, SI.

    If the mean is ``None``, it is the number of the scene; for components of a vector it is zero.
    """

    mean: float | None
    deviation: float


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """The unknowns of a scene, one column each.

    Args:
        scene: the scene; its other numbers are known.
        each: the unknowns, in the order of the columns.
    """

    scene: Scene
    each: tuple[Unknown, ...]

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return [unknown.name for unknown in self.each]

    @property
    def vectors(self) -> dict[str, tuple[int, int]]:
        """Columns of the two components of each vector, by the path of its error."""
        paths = [unknown.path for unknown in self.each]
        return {
            unknown.path: (i, i + 1)
            for i, unknown in enumerate(self.each)
            if unknown.kind == "component" and paths.index(unknown.path) == i
        }

    @property
    def reciprocals(self) -> np.ndarray:
        """Whether each unknown is a reciprocal, shape (unknown,)."""
        return np.array([unknown.kind == "reciprocal" for unknown in self.each], bool)

    @functools.cached_property
    def allowed(self) -> np.ndarray:
        """Lowest and highest values of a search, in its units, shape (2, unknown).

        They are the declared bounds, except a lower bound of zero: noise may make the best value of a small backlash
        negative.
        """
        declared, ends = numbers(self.scene), []
        for unknown in self.each:
            low, high = (0.0, math.inf) if unknown.kind == "reciprocal" else (-math.inf, math.inf)
            if unknown.kind == "number":
                low, high = (end / unknown.scale for end in declared[unknown.path].range)
                low = low if low > 0 else -math.inf
            ends.append((low, high))
        return np.array(ends).T

    @functools.cached_property
    def start(self) -> np.ndarray:
        """Values in the scene, in units of the search, shape (unknown,)."""
        return self.columns(self.scene)

    def columns(self, scene: Scene) -> np.ndarray:
        """Values in a scene of the same parts, in units of the search, shape (unknown,)."""
        values = []
        for unknown in self.each:
            if unknown.kind == "component":
                vector = scene.errors[unknown.path.partition(".")[2]].proportional()
                assert isinstance(vector, Displacement)
                part = vector.sine if unknown.name.endswith(COMPONENTS[0]) else vector.cosine
                values.append(float(part) / unknown.scale)
            else:
                value = float(pick(scene, unknown.path).get(scene)[0])
                values.append(unknown.scale / value if unknown.kind == "reciprocal" else value / unknown.scale)
        return np.array(values)

    def finished(self, values: np.ndarray) -> Scene:
        """The scene with the values found; eccentricities are again given by amplitude and phase."""
        known: dict[str, float] = {}
        for path, (along, across) in self.vectors.items():
            x, y = (self.each[i].scale * float(values[i]) for i in (along, across))
            known |= {f"{path}.amplitude": math.hypot(x, y), f"{path}.phase": math.atan2(y, x)}
        for unknown, value in zip(self.each, values, strict=True):
            if unknown.kind == "number":
                known[unknown.path] = unknown.scale * float(value)
            elif unknown.kind == "reciprocal":
                known[unknown.path] = unknown.scale / float(value)
        declared = numbers(self.scene)
        for path in known:  # a fit ignores bounds, but a file with numbers beyond them could not be read
            low, high = declared[path].range
            known[path] = min(max(known[path], low), high)
        free = pick(self.scene, list(known))
        return free.set(self.scene, jnp.asarray(list(known.values()), self.scene.dtype))

    def shown(self, values: np.ndarray) -> np.ndarray:
        """Values in the units in which they are shown, shape (..., unknown)."""
        scales = np.array([unknown.scale for unknown in self.each])
        per = np.array([unknown.per_unit for unknown in self.each])
        with np.errstate(divide="ignore"):
            return np.where(self.reciprocals, scales / np.where(self.reciprocals, values, 1.0), scales * values) / per

    def errors_shown(self, values: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """Standard deviations in the units in which values are shown, to first order, shape (unknown,)."""
        shown = np.abs(self.shown(values) / np.where(values == 0, 1.0, values))
        plain = np.array([unknown.scale / unknown.per_unit for unknown in self.each])
        return deviations * np.where(self.reciprocals, shown, plain)


def scene_with(each: tuple[Unknown, ...], values: Float[Array, " unknown"], scene: Scene) -> Scene:
    """A scene with other values of the unknowns, vectors by their components; differentiable.

    Args:
        each: the unknowns.
        values: values in units of the search.
        scene: the scene; its other numbers are kept.
    """
    errors = dict(scene.errors)
    for i, unknown in enumerate(each):
        if unknown.kind == "component" and unknown.name.endswith(COMPONENTS[0]):
            name = unknown.path.partition(".")[2]
            vector = errors[name].proportional()
            assert isinstance(vector, Displacement)
            errors[name] = Displacement(
                vector.body, unknown.scale * values[i], unknown.scale * values[i + 1], vector.waves
            )
    scene = scene._with(errors=errors)
    others = [i for i, unknown in enumerate(each) if unknown.kind != "component"]
    if not others:
        return scene
    paths = tuple(each[i].path for i in others)
    free = Free(paths, (None,) * len(paths), ((-math.inf, math.inf),) * len(paths), (False,) * len(paths))
    told = [each[i].scale / values[i] if each[i].kind == "reciprocal" else each[i].scale * values[i] for i in others]
    return free.set(scene, jnp.stack(told))


def unknowns_of(scene: Scene, where: str | Sequence[str] | None, *, back: bool, loaded: bool) -> Unknowns:
    """The unknowns at given paths.

    Args:
        scene: the scene.
        where: paths of numbers, or of whole errors such as ``errors.planet_1``; by default all that a recording usually
            determines: the errors, the stiffness and the initial backlash.
        back: whether a recording touches the back flanks, whose position depends on the backlash.
        loaded: whether a recording is under torque, so that stiffness has an effect.

    Raises:
        ParameterError: a path does not exist, or is half of a vector.
    """
    known = numbers(scene)
    if where is None:
        paths = [f"errors.{name}" for name, error in scene.errors.items() if not isinstance(error, AbstractMeasured)]
        paths += stiffness_of(scene, known) if loaded else []
        paths += ["backlash.initial"] if back and "backlash.initial" in known else []
        if not paths:
            raise ParameterError("where", (), f"the scene has no errors to find; valid: {nearest('', known)}")
    else:
        if callable(where):
            raise ParameterError("where", where, 'must be paths such as "errors.planet_1" or "compliance.mean"')
        paths = [where] if isinstance(where, str) else list(where)
        if not paths:
            raise ParameterError("where", (), 'is empty: give paths such as "errors.planet_1" or "compliance.mean"')
    each: list[Unknown] = []
    for path in paths:
        if not isinstance(path, str):
            raise ParameterError("where", path, 'must be paths such as "errors.planet_1" or "compliance.mean"')
        if not loaded and path.partition(".")[0] in ("compliance", "supports", "shafts"):
            raise ParameterError("where", path, "needs a recording under torque: without torque nothing deflects")
        each += _of(scene, path, known)
    names = [unknown.name for unknown in each]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError("where", name, "is listed twice")
    return Unknowns(scene, tuple(each))


def stiffness_of(scene: Scene, known: Mapping[str, Parameter]) -> list[str]:
    """Path of the number that makes all contacts stiffer or softer; none if the compliance has no such number.

    It is the first stiffness or modulus of the compliance. Stored tables keep the modulus that they were made with.
    """
    if getattr(scene.compliance, "prepares", False):
        return []
    own = (path for path in known if path.startswith("compliance.") and known[path].dimension in STIFF)
    return list(own)[:1]


def _of(scene: Scene, path: str, known: Mapping[str, Parameter]) -> list[Unknown]:
    """The unknowns that a path stands for."""
    slot, _, name = path.partition(".")
    if slot == "errors" and name in scene.errors:
        error = scene.errors[name]
        if isinstance(error.proportional(), Displacement):
            return [Unknown(f"{path}.{part}", "component", path, um, "um", um) for part in COMPONENTS]
        inner = [other for other in known if other.startswith(f"{path}.") and _is_length(known[other])]
        return [unknown for other in inner for unknown in _of(scene, other, known)]
    if slot == "errors" and name.split(".")[0] not in scene.errors:
        raise ParameterError("where", path, nearest(path, [*(f"errors.{each}" for each in scene.errors), *known]))
    free = pick(scene, path)
    found = []
    for own in free.paths:
        parameter = known[own]
        owner = own.split(".")[1] if own.startswith("errors.") else ""
        if owner in scene.errors and isinstance(scene.errors[owner].proportional(), Displacement):
            raise ParameterError("where", own, f'is half of a vector: give "errors.{owner}", both parts are found')
        found.append(_number(scene, own, parameter))
    return found


def _is_length(parameter: Parameter) -> bool:
    return parameter.dimension is units.LENGTH


def _number(scene: Scene, path: str, parameter: Parameter) -> Unknown:
    """The unknown of one number: the number itself, or the reciprocal of a stiffness."""
    value = float(pick(scene, path).get(scene)[0])
    unit, per_unit = parameter.shown_in
    if parameter.dimension in (*STIFF, units.TORSION):
        if value <= 0:
            raise ParameterError("where", path, "is zero in the scene: give an approximate value")
        return Unknown(path, "reciprocal", path, value, unit, per_unit)
    if parameter.dimension is units.LENGTH:
        small = abs(value) <= 1e-3
        scale, unit, per_unit = (um, "um", um) if small else (1e-3 * abs(value), unit, per_unit)
    elif parameter.dimension is units.ANGLE:
        scale = 1e-3
    else:
        scale = abs(value) or 1.0
    return Unknown(path, "number", path, scale, unit, per_unit)


def priors_of(unknowns: Unknowns, priors: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Means and precisions of the priors, in units of the search, shape (unknown,) each; precision 0 without a prior.

    Args:
        unknowns: the unknowns.
        priors: by name, or by path of an error for all of its numbers: a standard deviation in SI, a pair of mean and
            standard deviation, or a distribution of a tolerance study.

    Raises:
        ParameterError: a name is not among the unknowns, or a value is no prior.
    """
    start, mean, precision = unknowns.start, np.zeros(len(unknowns.each)), np.zeros(len(unknowns.each))
    names = {unknown.name: [i] for i, unknown in enumerate(unknowns.each)}
    for i, unknown in enumerate(unknowns.each):
        names.setdefault(unknown.path, [])
        if i not in names[unknown.path]:
            names[unknown.path].append(i)
        for whole in (unknown.path.rpartition(".")[0], f"{unknown.path}.amplitude", unknown.path.rpartition("[")[0]):
            if whole:
                names.setdefault(whole, []).append(i)
    for name, given in priors.items():
        name = name.removesuffix("[*]")
        if name not in names:
            raise ParameterError(f"priors of {name}", given, f"is not among the unknowns; {nearest(name, names)}")
        prior = _prior(f"priors of {name}", given)
        for i in names[name]:
            unknown = unknowns.each[i]
            centre = start[i] * unknown.scale if prior.mean is None and unknown.kind == "number" else prior.mean or 0.0
            if unknown.kind == "reciprocal":
                centre = prior.mean or unknown.scale
                mean[i], spread = unknown.scale / centre, prior.deviation * unknown.scale / centre**2
            else:
                mean[i], spread = centre / unknown.scale, prior.deviation / unknown.scale
            precision[i] = 1 / spread**2
    return mean, precision


def _prior(key: str, given: Any) -> Prior:
    """The prior of a number, from what the user gives.

    A distribution of an amplitude gives each component a zero mean, and half of its mean square as the variance.
    """
    expected, deviation = getattr(given, "expected", None), getattr(given, "deviation", None)
    if expected is not None and deviation is not None:
        if not float(deviation) > 0:
            raise ParameterError(key, given, "must have a standard deviation above 0")
        if key.endswith(".amplitude"):
            return Prior(0.0, math.sqrt((float(expected) ** 2 + float(deviation) ** 2) / 2))
        return Prior(float(expected), float(deviation))
    try:
        array = np.asarray(given, float)
    except (TypeError, ValueError):
        array = np.array([])
    if array.shape not in ((), (2,)) or not (np.isfinite(array).all() and array.flat[-1] > 0):
        words = "must be a standard deviation, a pair of mean and standard deviation, or a distribution; SI"
        raise ParameterError(key, given, words)
    return Prior(None if array.shape == () else float(array[0]), float(array.flat[-1]))


def turned(unknowns: Unknowns, angles: Mapping[str, float]) -> np.ndarray:
    """Matrix by which the components change when bodies are turned in their seats, shape (unknown, unknown)."""
    turn = np.eye(len(unknowns.each))
    for path, angle in angles.items():
        along, across = unknowns.vectors[path]
        place = np.ix_([along, across], [along, across])
        turn[place] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    return turn
