"""Loss of precision of a tolerance study in float32: the shift of the quantiles that are reported."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from gearjax.tolerance.measure import Measure
from gearjax.tolerance.monte_carlo import QUANTILES, Work
from gearjax.tolerance.population import Tolerances


@dataclasses.dataclass(frozen=True)
class PrecisionShift:
    """A quantile of a measure in both precisions.

    Args:
        name: name of the measure.
        level: level of the quantile.
        double, single: the quantile in float64 and in float32 [rad].
        spread: difference of the highest and the lowest quantile of the measure [rad].
    """

    name: str
    level: float
    double: float
    single: float
    spread: float

    @property
    def relative(self) -> float:
        """Shift over the value, or over the spread of the measure if the spread is larger."""
        return abs(self.single - self.double) / max(abs(self.double), self.spread, 1e-300)


def in_float32(tolerances: Tolerances) -> Tolerances:
    """The same population with every number of its scene in float32."""

    def made() -> Tolerances:
        single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), tolerances.scene)
        return Tolerances(single, tolerances.distributions, tolerances.correlations)

    return tolerances.once("float32", made)


def precision_shifts(
    tolerances: Tolerances, measures: Sequence[Measure], *, n: int = 10_000, key: int = 0, **options
) -> list[PrecisionShift]:
    """Quantiles of the same gear sets in float64 and in float32.

    Args:
        tolerances: the population, in float64.
        measures: the measures.
        n: number of gear sets.
        key: seed of the samples.
        options: ``theta``, ``sampler``, ``extremes``, ``chunk`` and ``devices`` of `monte_carlo`.
    """
    studies = []
    for population in (tolerances, in_float32(tolerances)):
        work = Work(population, measures, number=n, seed=key, **options)
        studies.append(work.study(*work.evaluate(work.inputs(0, n))))
    double, single = studies
    shifts = []
    for name in double.names:
        values = [[study.quantile(name, level).value for level in QUANTILES] for study in (double, single)]
        spread = values[0][-1] - values[0][0]
        shifts += [
            PrecisionShift(name, level, one, other, spread)
            for level, one, other in zip(QUANTILES, *values, strict=True)
        ]
    return shifts
