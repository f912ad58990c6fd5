"""The analyses of a scene that a configuration can ask for, and its [run] section."""

import dataclasses

import numpy as np

from gearjax.checks import ParameterError, nearest
from gearjax.parameters import is_numeric

NEEDS = {
    "no_load": (),
    "backlash": ("backlash",),
    "static": ("compliance",),
    "dynamic": ("compliance", "load", "inertia"),
}
ANALYSES = tuple(NEEDS)
"""Names of the analyses; `NEEDS` gives the optional parts of a scene that each needs."""
METRICS = ("peak_to_peak", "amplitude", "mean", "std")
"""Metrics that are reported for every record."""


@dataclasses.dataclass(frozen=True)
class Published:
    """Published or measured values to show next to computed ones.

    Args:
        analysis: analysis to which the values belong.
        torque: load torque to which the values belong [N m]; 0 without load.
        metrics: pairs of a metric's name and its value [rad].
        note: remark for readers of the comparison.
        configuration: eight digits that tell for which gears, errors and loads the values hold; a run of others leaves
            the values out and says its own digits. Empty for values that are shown with any.
    """

    analysis: str
    torque: float
    metrics: tuple[tuple[str, float], ...]
    note: str = ""
    configuration: str = ""


@dataclasses.dataclass(frozen=True)
class Run:
    """Analyses that a configuration asks for, and their record. Times are in seconds, torques in N m.

    Args:
        duration: length of the record [s].
        samples: number of samples of the record, including both ends.
        analyses: names of the analyses: ``no_load``, ``backlash``, ``static``, ``dynamic``.
        torques: sizes of the load torque [N m].
        start: initial state of the dynamic TE: ``"equilibrium"``, or ``"zero"`` for rest at the ideal position.
        settle: initial time that the metrics of the dynamic TE leave out [s].
        published: published or measured values to show next to the computed ones.

    Raises:
        ParameterError: a value is not allowed.
    """

    duration: float
    samples: int
    analyses: tuple[str, ...]
    torques: tuple[float, ...] = ()
    start: str = "equilibrium"
    settle: float = 0.0
    published: tuple[Published, ...] = ()

    def __post_init__(self):
        for key, given, least in (("duration", self.duration, 1e-9), ("settle", self.settle, 0.0)):
            if not is_numeric(given) or not least <= float(given) < np.inf:
                raise ParameterError(f"run.{key}", given, f"must be finite and at least {least:g} s")
        if self.settle >= self.duration:
            raise ParameterError("run.settle", self.settle, "must be below run.duration")
        if isinstance(self.samples, bool) or not isinstance(self.samples, int | np.integer) or self.samples < 2:
            raise ParameterError("run.samples", self.samples, "must be a whole number, at least 2")
        for analysis in self.analyses:
            if analysis not in ANALYSES:
                raise ParameterError("run.analyses", analysis, nearest(analysis, ANALYSES))
        if not is_numeric(self.torques) or not np.isfinite(self.torques).all():
            raise ParameterError("run.torques", self.torques, "must be finite numbers [N m]")

    @property
    def times(self) -> np.ndarray:
        """Sample times, shape (samples,) [s]."""
        return np.linspace(0.0, self.duration, self.samples)
