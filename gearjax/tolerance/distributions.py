"""Distributions of a toleranced number, each with its quantile function, which is all that a sampling method needs.

All numbers are SI, in the unit of the parameter that is drawn. A distribution is static and compared by value; a
compiled program gets only the numbers drawn from it.
"""

import abc
import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np

from gearjax.checks import ParameterError
from gearjax.parameters import Parameter, check_value, is_numeric
from gearjax.units import RATIO

T = TypeVar("T")
FURTHEST = 10.0  # standard deviations from the most frequent value, beyond which a normal distribution has no weight


def declared_number(
    dimension: Any = None, *, kind: str = "number", default: Any = dataclasses.MISSING, **bounds: Any
) -> Any:
    """Declare a number of a distribution; without a dimension, it has the dimension of the number that is drawn."""
    keywords = {} if default is dataclasses.MISSING else {"default": default}
    return dataclasses.field(metadata={"parameter": Parameter(dimension, kind, **bounds)}, **keywords)


def check_declared(part: Any) -> None:
    """Refuse values that the fields of a distribution do not allow.

    Raises:
        ParameterError: names the field.
    """
    for field in dataclasses.fields(part):
        if "parameter" in field.metadata:
            check_value(field.name, field.metadata["parameter"], getattr(part, field.name))


def formerly(**names: str) -> Callable[[type[T]], type[T]]:
    """A decorator that also accepts fields of a distribution by their former names; ``names`` are new by old names."""

    def decorate(part: type[T]) -> type[T]:
        begin = part.__init__

        @functools.wraps(begin)
        def __init__(self: Any, *args: Any, **given: Any) -> None:  # noqa: N807
            begin(self, *args, **renamed(part, given))

        part.__init__ = __init__
        part.former_names = names  # pyright: ignore[reportAttributeAccessIssue]
        return part

    return decorate


def renamed(part: type, given: dict[str, Any]) -> dict[str, Any]:
    """Values of a distribution's fields by their present names.

    Raises:
        ParameterError: a field is given by both of its names.
    """
    former = getattr(part, "former_names", {})
    for old, new in former.items():
        if old in given and new in given:
            raise ParameterError(old, given[old], f"is the former name of {new}, which is given too")
    return {former.get(name, name): value for name, value in given.items()}


@dataclasses.dataclass(frozen=True)
class AbstractDistribution(abc.ABC):
    """Base of all distributions."""

    kind: ClassVar[str]
    former_names: ClassVar[Mapping[str, str]] = {}
    """Present names of fields by their former names."""

    @abc.abstractmethod
    def quantile(self, share: np.ndarray) -> np.ndarray:
        """Values below which the given shares (between 0 and 1) of the population lie, any shape."""

    @property
    @abc.abstractmethod
    def deviation(self) -> float:
        """Standard deviation."""

    @property
    @abc.abstractmethod
    def expected(self) -> float:
        """Mean."""

    @property
    def is_tolerance(self) -> bool:
        """Whether manufacturing could narrow the distribution; it cannot narrow a random assembly phase."""
        return self.deviation > 0


@dataclasses.dataclass(frozen=True)
class Normal(AbstractDistribution):
    """Normal distribution.

    Args:
        mean: mean.
        std: standard deviation.
    """

    kind: ClassVar[str] = "normal"
    mean: float = declared_number()
    std: float = declared_number(at_least=0.0)

    def __post_init__(self):
        check_declared(self)

    def quantile(self, share):
        from scipy import special

        return self.mean + self.std * special.ndtri(share)

    @property
    def deviation(self):
        return self.std

    @property
    def expected(self):
        return self.mean


@functools.cache
def _gauss() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of a Gaussian quadrature between -1 and 1."""
    return np.polynomial.legendre.leggauss(200)


@formerly(scale="std")
@dataclasses.dataclass(frozen=True)
class TruncatedNormal(AbstractDistribution):
    """Normal distribution after sorting: only values between two limits are delivered.

    Args:
        mean: mean before sorting.
        std: standard deviation before sorting.
        low: lower limit.
        high: upper limit.
    """

    kind: ClassVar[str] = "truncated_normal"
    mean: float = declared_number()
    std: float = declared_number(above=0.0)
    low: float = declared_number()
    high: float = declared_number()

    def __post_init__(self):
        check_declared(self)
        if not self.low < self.high:
            raise ParameterError("high", self.high, "must be above low")
        lower, upper = self._ends
        if max(lower, -upper) > 8:  # so far out in the tail is a mistake, and rounding destroys the quantiles
            raise ParameterError("mean", self.mean, "must lie within 8 std of the limits")

    @property
    def _ends(self) -> tuple[float, float]:
        return (self.low - self.mean) / self.std, (self.high - self.mean) / self.std

    @property
    def _mirrored(self) -> float:
        """-1 if the upper tail is kept, else 1: the lower tail is used instead, as shares close to 1 lose digits."""
        lower, upper = self._ends
        return -1.0 if lower + upper > 0 else 1.0

    def quantile(self, share):
        from scipy import special

        sign, ends = self._mirrored, self._ends
        lower, upper = sorted(sign * np.array(ends))
        low, high = special.ndtr(lower), special.ndtr(upper)
        along = share if sign > 0 else 1 - share
        value = self.mean + self.std * sign * special.ndtri(low + along * (high - low))
        return np.clip(value, self.low, self.high)

    @property
    def is_tolerance(self):
        return True  # values between two limits differ, which takes no moments to see

    @property
    def _moments(self) -> tuple[float, float]:
        """Mean and standard deviation by Gaussian quadrature: closed forms lose all digits if the limits are close."""
        lower, upper = self._ends
        lower, upper = max(lower, min(upper, 0.0) - FURTHEST), min(upper, max(lower, 0.0) + FURTHEST)
        nodes, weights = _gauss()
        apart = 0.5 * (upper - lower) * (1 + nodes)  # from the lower end
        start = lower if lower > 0 else 0.0  # where the density is 1, so that it does not underflow
        start = upper if upper < 0 else start
        weights = weights * np.exp(0.5 * (start**2 - (lower + apart) ** 2))
        weights = weights / weights.sum()
        mean = float((weights * apart).sum())
        variance = float((weights * (apart - mean) ** 2).sum())
        return self.mean + self.std * lower + self.std * mean, self.std * math.sqrt(variance)

    @property
    def deviation(self):
        return self._moments[1]

    @property
    def expected(self):
        return min(max(self._moments[0], self.low), self.high)


@dataclasses.dataclass(frozen=True)
class Uniform(AbstractDistribution):
    """Uniform distribution between two limits.

    Args:
        low: lower limit.
        high: upper limit.
    """

    kind: ClassVar[str] = "uniform"
    low: float = declared_number()
    high: float = declared_number()

    def __post_init__(self):
        check_declared(self)
        if self.high < self.low:
            raise ParameterError("high", self.high, "must be at least low")

    def quantile(self, share):
        return self.low + (self.high - self.low) * share

    @property
    def deviation(self):
        return (self.high - self.low) / math.sqrt(12)

    @property
    def expected(self):
        return 0.5 * (self.low + self.high)


@dataclasses.dataclass(frozen=True)
class UniformPhase(AbstractDistribution):
    """Uniform distribution of a phase from -180 to 180 deg, as of bodies that are assembled at random."""

    kind: ClassVar[str] = "uniform_phase"

    def quantile(self, share):
        return 2 * np.pi * (share - 0.5)

    @property
    def deviation(self):
        return 2 * math.pi / math.sqrt(12)

    @property
    def expected(self):
        return 0.0

    @property
    def is_tolerance(self):
        return False


@dataclasses.dataclass(frozen=True)
class Rayleigh(AbstractDistribution):
    """Length of a vector whose two components are normal with zero mean, such as an eccentricity from two offsets.

    Args:
        scale: standard deviation of each component.
    """

    kind: ClassVar[str] = "rayleigh"
    scale: float = declared_number(at_least=0.0)

    def __post_init__(self):
        check_declared(self)

    def quantile(self, share):
        from scipy import special

        return self.scale * np.sqrt(-2 * special.log1p(-share))

    @property
    def deviation(self):
        return self.scale * math.sqrt(2 - math.pi / 2)

    @property
    def expected(self):
        return self.scale * math.sqrt(0.5 * math.pi)


@dataclasses.dataclass(frozen=True)
class Lognormal(AbstractDistribution):
    """Distribution whose logarithm is normal.

    Args:
        median: median.
        sigma: standard deviation of the natural logarithm.
    """

    kind: ClassVar[str] = "lognormal"
    median: float = declared_number(above=0.0)
    sigma: float = declared_number(RATIO, at_least=0.0, at_most=10.0)

    def __post_init__(self):
        check_declared(self)

    def quantile(self, share):
        from scipy import special

        return self.median * np.exp(self.sigma * special.ndtri(share))

    @property
    def deviation(self):
        return self.median * math.exp(0.5 * self.sigma**2) * math.sqrt(math.expm1(self.sigma**2))

    @property
    def expected(self):
        return self.median * math.exp(0.5 * self.sigma**2)


def _numbers(key: str, given: Any) -> tuple[float, ...]:
    """The numbers of a list, one number being a list of one, in Python's own type."""
    if not is_numeric(given) or np.ndim(given) > 1:
        raise ParameterError(key, given, "must be a list of numbers, in SI")
    return tuple(np.ravel(np.asarray(given, dtype=float)).tolist())


@dataclasses.dataclass(frozen=True)
class Discrete(AbstractDistribution):
    """A few values, each with its probability.

    Args:
        values: the possible values.
        probabilities: probabilities of the values, which add to 1; equal probabilities if left out.
    """

    kind: ClassVar[str] = "discrete"
    values: tuple[float, ...] = declared_number(kind="series")
    probabilities: tuple[float, ...] = declared_number(RATIO, kind="series", default=(), at_least=0.0, at_most=1.0)

    def __post_init__(self):
        object.__setattr__(self, "values", _numbers("values", self.values))
        object.__setattr__(self, "probabilities", _numbers("probabilities", self.probabilities))
        check_declared(self)
        if not self.values:
            raise ParameterError("values", [], "needs at least one value")
        if self.probabilities and len(self.probabilities) != len(self.values):
            raise ParameterError("probabilities", self.probabilities, f"must be {len(self.values)}, one per value")
        if self.probabilities and abs(sum(self.probabilities) - 1) > 1e-9:
            raise ParameterError("probabilities", self.probabilities, "must add to 1")

    @property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        values = np.array(self.values)
        shares = np.array(self.probabilities) if self.probabilities else np.full(len(values), 1 / len(values))
        order = np.argsort(values, kind="stable")
        return values[order], shares[order]

    def quantile(self, share):
        values, shares = self._table
        place = np.searchsorted(np.cumsum(shares), share, side="left")
        return values[np.minimum(place, len(values) - 1)]

    @property
    def deviation(self):
        values, shares = self._table
        return math.sqrt(shares @ (values - shares @ values) ** 2)

    @property
    def expected(self):
        values, shares = self._table
        return float(shares @ values)


@dataclasses.dataclass(frozen=True)
class Empirical(AbstractDistribution):
    """Measured values, all equally likely.

    Args:
        values: the measured values.
    """

    kind: ClassVar[str] = "empirical"
    values: tuple[float, ...] = declared_number(kind="series")

    def __post_init__(self):
        object.__setattr__(self, "values", tuple(sorted(_numbers("values", self.values))))
        check_declared(self)
        if not self.values:
            raise ParameterError("values", [], "needs at least one value")

    @functools.cached_property
    def _ordered(self) -> np.ndarray:
        return np.array(self.values)

    def quantile(self, share):
        place = np.floor(np.asarray(share) * len(self.values)).astype(np.int64)
        return self._ordered[np.clip(place, 0, len(self.values) - 1)]

    @property
    def deviation(self):
        return float(np.std(self.values))

    @property
    def expected(self):
        return float(np.mean(self.values))
