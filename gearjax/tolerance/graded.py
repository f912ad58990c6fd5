"""Distributions of numbers whose limits are given by an accuracy or tolerance grade of a standard."""

import dataclasses
import math
from typing import ClassVar

from gearjax.tolerance.distributions import (
    AbstractDistribution,
    Normal,
    Rayleigh,
    check_declared,
    declared_number,
)
from gearjax.tolerance.grades import EDITIONS, it_tolerance, run_out_tolerance
from gearjax.units import LENGTH

WITHIN = 0.9973
"""Share of the parts within the limits of a grade: that within three standard deviations of a normal distribution."""


@dataclasses.dataclass(frozen=True)
class Iso1328RunOut(AbstractDistribution):
    """Eccentricity of a gear of an accuracy grade.

    A `Rayleigh` distribution with 99.73 % of the gears within the limit of run-out (`run_out_tolerance`), which is
    twice the eccentricity.

    Args:
        grade: accuracy grade.
        module: normal module [m].
        diameter: reference diameter [m].
        edition: edition of ISO 1328, ``"2013"`` or ``"1995"``.
    """

    kind: ClassVar[str] = "iso_1328_run_out"
    grade: int = declared_number(kind="count", at_least=0.0, at_most=12.0)
    module: float = declared_number(LENGTH, above=0.0, example="2.5 mm")
    diameter: float = declared_number(LENGTH, above=0.0, example="120 mm")
    edition: str = declared_number(kind="name", default=EDITIONS[0], names=EDITIONS)

    def __post_init__(self):
        check_declared(self)
        _ = self.law

    @property
    def law(self) -> Rayleigh:
        """The Rayleigh distribution of the eccentricity."""
        limit = 0.5 * run_out_tolerance(self.grade, self.module, self.diameter, self.edition)
        return Rayleigh(limit / math.sqrt(-2 * math.log(1 - WITHIN)))

    def quantile(self, share):
        return self.law.quantile(share)

    @property
    def deviation(self):
        return self.law.deviation

    @property
    def expected(self):
        return self.law.expected


@dataclasses.dataclass(frozen=True)
class Iso286(AbstractDistribution):
    """Size of a tolerance grade IT: a `Normal` distribution, its tolerance six standard deviations (`it_tolerance`).

    Args:
        mean: middle of the tolerance.
        grade: tolerance grade, IT 5 to 16.
        size: nominal size that the grade refers to [m].
    """

    kind: ClassVar[str] = "iso_286"
    mean: float = declared_number()
    grade: int = declared_number(kind="count", at_least=1.0, at_most=18.0)
    size: float = declared_number(LENGTH, above=0.0, example="80 mm")

    def __post_init__(self):
        check_declared(self)
        _ = self.deviation

    def quantile(self, share):
        return Normal(self.mean, self.deviation).quantile(share)

    @property
    def deviation(self):
        return it_tolerance(self.grade, self.size) / 6

    @property
    def expected(self):
        return self.mean
