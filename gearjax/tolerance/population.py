"""A population of gear sets: one scene, and the distributions of its toleranced numbers."""

import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np

from gearjax import arguments
from gearjax.checks import ParameterError, SceneError, nearest
from gearjax.scene import Scene
from gearjax.studies.scatter import Scatter
from gearjax.studies.select import Free, members, numbers, pick
from gearjax.tolerance.distributions import AbstractDistribution
from gearjax.tolerance.sampling import points
from gearjax.typing import Array, Float

Made = TypeVar("Made")
SHARED = 64  # programs and tables that studies of one population share, at most
EXAMPLES = 64
_EXAMPLE_SEED = 0x6561


@dataclasses.dataclass(frozen=True)
class Correlation:
    """Two numbers that vary together.

    Args:
        first, second: paths of the numbers.
        coefficient: correlation of their normal scores (a Gaussian copula), between -1 and 1.
    """

    first: str
    second: str
    coefficient: float


def _check_distributions(given: Any) -> None:
    """Refuse anything but distributions of gearjax by path."""
    if not isinstance(given, Mapping):
        raise ParameterError("distributions", given, 'must be by path: {"errors.planet_1.amplitude": Rayleigh(6e-6)}')
    for path, spread in given.items():
        if isinstance(spread, AbstractDistribution):
            continue
        if type(spread).__module__.startswith("scipy"):
            words = "is of scipy: give a distribution of gearjax, or gj.Empirical(values) of numbers drawn from it"
            raise ParameterError(str(path), type(spread).__name__, words)
        words = "must be a distribution such as gj.Normal(mean, std); numbers that do not vary belong in the scene"
        raise ParameterError(str(path), spread, words)


def _each(scene: Scene, given: Mapping[str, AbstractDistribution]) -> dict[str, AbstractDistribution]:
    """Distributions of single numbers, from paths that may stand for a series."""
    spreads: dict[str, AbstractDistribution] = {}
    known = numbers(scene)
    for path, spread in given.items():
        for name in members(path, known):
            if name in spreads:
                raise ParameterError(name, type(spread).__name__, f"is listed twice, once as {path}")
            spreads[name] = spread
    return spreads


def a_population(name: str, value: Any) -> None:
    """Refuse anything but a population, as an argument of a public function."""
    if not isinstance(value, Tolerances):
        raise ParameterError(name, value, "must be Tolerances(scene, {path: distribution})")


class Tolerances:
    """A population of gear sets: a scene, and how its numbers vary from one gear set to another.

    Args:
        scene: the gear set; numbers that are not listed keep its values.
        distributions: distribution of each toleranced number, by path such as ``errors.planet_1.amplitude``; a path
            that ends with ``[*]`` stands for every number of a series, each drawn independently.
        correlations: pairs of numbers that vary together; all other numbers are independent.

    Raises:
        ParameterError: a path does not exist, most of a distribution lies outside the bounds of its number, or the
            correlations contradict each other.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> tolerances = gj.Tolerances(scene, {"errors.planet_1.amplitude": gj.Rayleigh(6e-6)})
        >>> tolerances.values(np.array([[0.5]])).round(9).tolist()
        [[7.064e-06]]
    """

    @arguments.checked()
    def __init__(
        self,
        scene: Scene,
        distributions: Mapping[str, AbstractDistribution],
        correlations: Sequence[Correlation] = (),
    ):
        _check_distributions(distributions)
        self.scene, self.distributions = scene, _each(scene, distributions)
        self.correlations = tuple(correlations)
        self.free: Free = pick(scene, list(self.distributions))
        self._check_ranges()
        self._mixing = self._factor()
        self._shared: dict[Hashable, Any] = {}

    def once(self, key: Hashable, made: Callable[[], Made]) -> Made:
        """What several studies of this population use, worked out by the first of them.

        What was not asked for longest is forgotten, so that studies of ever other angles or measures do not fill the
        memory.
        """
        value = self._shared.pop(key) if key in self._shared else made()
        self._shared[key] = value
        if len(self._shared) > SHARED:
            del self._shared[next(iter(self._shared))]
        return value

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths of the toleranced numbers."""
        return tuple(self.distributions)

    @property
    def tolerated(self) -> tuple[str, ...]:
        """Paths of the numbers that manufacturing could narrow: all but random assembly phases."""
        return tuple(path for path, spread in self.distributions.items() if spread.is_tolerance)

    @property
    def centres(self) -> np.ndarray:
        """Value to which each number is narrowed: zero for the size of an error, else the mean; shape (free,), SI."""
        known = numbers(self.scene)
        sizes = [path.startswith("errors.") and known[path].range[0] == 0 for path in self.paths]
        spreads = self.distributions.values()
        return np.array([0.0 if size else spread.expected for size, spread in zip(sizes, spreads, strict=True)])

    @property
    def examples(self) -> np.ndarray:
        """Numbers of example gear sets that cover the whole population, shape (n, free), SI.

        Each number is at an end of its distribution in a third of the gear sets; its combinations with others are
        random.
        """
        drawn = points("monte_carlo", _EXAMPLE_SEED, self.paths, EXAMPLES, 0, EXAMPLES)
        stretched = np.clip(1.5 * drawn - 0.25, 1e-9, 1 - 1e-9)
        return np.concatenate([self.values(stretched[i::2]) for i in (0, 1)])

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviation of each number, shape (free,), SI."""
        return np.array([spread.deviation for spread in self.distributions.values()])

    def values(self, points: np.ndarray) -> np.ndarray:
        """Numbers of gear sets [SI] from points of the unit cube; both have the shape (n, free)."""
        points = self._correlated(np.asarray(points, dtype=float))
        columns = [spread.quantile(points[:, i]) for i, spread in enumerate(self.distributions.values())]
        return np.stack(columns, axis=1)

    def scatter(self, number: int = 32, *, around: Sequence[str] = (), seed: int = 0) -> Scatter:
        """Gear sets drawn from the population, for objectives of gear sets as they are made (`gearjax.Objective.of`).

        Args:
            number: number of gear sets (Latin hypercube).
            around: paths of numbers that the study changes: their deviations from the mean of their distribution are
                added to what the study tries. All other numbers have the drawn values.
            seed: seed of the random numbers.

        Raises:
            ParameterError: a path is not toleranced, or the number is below 1.

        Example:
            >>> import gearjax as gj
            >>> scene = gj.load("configs/two_kv/wang_2020.toml")
            >>> tolerances = gj.Tolerances(scene, {"errors.planet_1.amplitude": gj.Rayleigh(6e-6)})
            >>> loss = gj.Objective.of("no_load_amplitude", scene, scatter=tolerances.scatter(16))
            >>> found = gj.minimise(loss, scene, where=["errors.planet_1.phase"], starts=4)
        """
        arguments.whole(1)("number", number)
        for path in around:
            if path not in self.paths:
                raise ParameterError("around", path, f"is not toleranced; {nearest(path, self.paths)}")
        drawn = self.values(points("latin_hypercube", seed, self.paths, number, 0, number))
        shifted = tuple(path in around for path in self.paths)
        means = np.array([spread.expected for spread in self.distributions.values()])
        drawn = np.where(shifted, drawn - means, drawn)
        low, high = (np.where(shifted, end, bound) for end, bound in zip((-np.inf, np.inf), self.bounds, strict=True))
        return Scatter(self.free, jnp.asarray(np.clip(drawn, low, high), self.scene.dtype), shifted)

    def with_values(self, values: Float[Array, " free"]) -> Scene:
        """The gear set with given numbers, shape (free,), SI."""
        return self.free.set(self.scene, jnp.asarray(values, self.scene.dtype))

    def allowed(self, values: np.ndarray) -> np.ndarray:
        """Whether the numbers of each gear set are within their declared bounds, shape (n,)."""
        low, high = self.bounds
        return np.all(np.isfinite(values) & (values >= low) & (values <= high), axis=1)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest value that each number may have, infinite for angles, shape (free,) each."""
        known = numbers(self.scene)
        ends = [(-np.inf, np.inf) if known[path].periodic else known[path].range for path in self.paths]
        low, high = np.array(ends, dtype=float).T
        return low, high

    def _check_ranges(self) -> None:
        known = numbers(self.scene)
        for path, spread in self.distributions.items():
            middle = float(spread.quantile(np.array(0.5)))
            if not known[path].holds(middle):
                words = f"its median {middle:.6g} must be {known[path].allowed()}"
                raise ParameterError(path, spread.kind, words)

    def _factor(self) -> np.ndarray | None:
        if not self.correlations:
            return None
        place = {path: index for index, path in enumerate(self.paths)}
        matrix = np.eye(len(place))
        for index, pair in enumerate(self.correlations):
            key = f"correlated[{index}]"
            for path in (pair.first, pair.second):
                if path not in place:
                    raise ParameterError(f"{key}.between", path, f"is not toleranced; {nearest(path, place)}")
            if pair.first == pair.second:
                raise ParameterError(f"{key}.between", pair.first, "is correlated with itself")
            if not -1 < pair.coefficient < 1:
                raise ParameterError(f"{key}.coefficient", pair.coefficient, "must be above -1 and below 1")
            i, j = place[pair.first], place[pair.second]
            if matrix[i, j]:
                raise ParameterError(f"{key}.between", pair.first, f"is correlated with {pair.second} already")
            matrix[i, j] = matrix[j, i] = pair.coefficient
        try:
            return np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError as fault:
            raise SceneError(
                "correlated: the coefficients contradict each other (no such correlation matrix)"
            ) from fault

    def _correlated(self, points: np.ndarray) -> np.ndarray:
        """The points with their normal scores mixed for the correlations.

        This is done column by column, so that no sum depends on how many points are computed at once.
        """
        from scipy import special

        if self._mixing is None:
            return points
        scores = special.ndtri(points)
        mixed = points.copy()
        for row, weights in enumerate(self._mixing):
            if weights[row] != 1.0:
                used = np.flatnonzero(weights)
                total = sum(weights[column] * scores[:, column] for column in used)
                mixed[:, row] = np.clip(special.ndtr(total), 2.0**-53, 1 - 2.0**-53)
        return mixed
