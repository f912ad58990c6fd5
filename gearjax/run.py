"""What can be computed of a scene, and what a configuration asks for."""

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
"""Analyses of a scene, and the optional slots that each needs."""
METRICS = ("peak_to_peak", "amplitude", "mean", "std")
"""What is told of every record."""


@dataclasses.dataclass(frozen=True)
class Published:
    """Published or measured values to show next to computed ones.

    Args:
        analysis, torque: the case they belong to; torque in N m, 0 without load.
        metrics: pairs of a metric's name and its value [rad].
        note: what a reader of the comparison should know.
    """

    analysis: str
    torque: float
    metrics: tuple[tuple[str, float], ...]
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Run:
    """What a configuration asks to be computed. Times in seconds, torques in N m.

    Args:
        duration: length of the record [s].
        samples: number of samples of the record, both ends included.
        analyses: of ``no_load``, ``backlash``, ``static``, ``dynamic``.
        torques: sizes of the load torque [N m].
        start: of the dynamic TE, ``"equilibrium"`` or ``"zero"``.
        settle: time that the metrics of the dynamic TE leave out [s].
        published: values to show next to the computed ones.

    Raises:
        ParameterError: a value that cannot be.
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
