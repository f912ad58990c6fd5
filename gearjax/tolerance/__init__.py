"""Tolerance studies: populations of gear sets, distributions of their numbers, yields and sensitivities."""

from gearjax.tolerance.distributions import (
    AbstractDistribution,
    Discrete,
    Empirical,
    Lognormal,
    Normal,
    Rayleigh,
    TruncatedNormal,
    Uniform,
    UniformPhase,
)
from gearjax.tolerance.graded import Iso286, Iso1328RunOut
from gearjax.tolerance.grades import (
    flank_tolerance,
    it_tolerance,
    run_out_tolerance,
    single_pitch_tolerance,
    total_pitch_tolerance,
)
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.monte_carlo import Study, Work, monte_carlo
from gearjax.tolerance.population import Correlation, Tolerances

DISTRIBUTIONS: tuple[type[AbstractDistribution], ...] = (
    Normal,
    TruncatedNormal,
    Uniform,
    UniformPhase,
    Rayleigh,
    Lognormal,
    Discrete,
    Empirical,
    Iso1328RunOut,
    Iso286,
)

__all__ = [
    "DISTRIBUTIONS",
    "AbstractDistribution",
    "Correlation",
    "Discrete",
    "Empirical",
    "Iso286",
    "Iso1328RunOut",
    "Lognormal",
    "Measure",
    "Normal",
    "Rayleigh",
    "Study",
    "Tolerances",
    "TruncatedNormal",
    "Uniform",
    "UniformPhase",
    "Work",
    "flank_tolerance",
    "it_tolerance",
    "monte_carlo",
    "run_out_tolerance",
    "single_pitch_tolerance",
    "total_pitch_tolerance",
]
