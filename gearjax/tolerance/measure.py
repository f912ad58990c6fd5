"""A measure: one metric of one analysis, and its limits."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gearjax.arguments import one_number, torque
from gearjax.checks import ParameterError, nearest
from gearjax.run import ANALYSES, METRICS

MEASURED = (*METRICS, "minimum", "maximum")
NEVER_NEGATIVE = ("peak_to_peak", "amplitude", "std")


@dataclasses.dataclass(frozen=True)
class Measure:
    """One metric of one analysis, and its limits.

    Args:
        analysis: ``no_load``, ``static``, ``backlash`` or ``dynamic``.
        metric: ``peak_to_peak``, ``amplitude`` (largest absolute value), ``mean``, ``std``, ``minimum`` or ``maximum``.
        torque: load torque of a static or dynamic analysis [N m].
        limit: highest value of a good gear set [rad].
        at_least: lowest value of a good gear set [rad].

    Raises:
        ParameterError: a word is unknown, a torque is missing, or the analysis takes no torque.
    """

    analysis: str
    metric: str
    torque: float | None = None
    limit: float | None = None
    at_least: float | None = None

    def __post_init__(self):
        if self.analysis not in ANALYSES:
            raise ParameterError("analysis", self.analysis, nearest(self.analysis, ANALYSES))
        if self.metric not in MEASURED:
            raise ParameterError("metric", self.metric, nearest(self.metric, MEASURED))
        loaded = self.analysis in ("static", "dynamic")
        if loaded and self.torque is None:
            raise ParameterError("torque", self.torque, f"{self.analysis} needs a torque")
        for name, check in (("torque", torque), ("limit", one_number), ("at_least", one_number)):
            if getattr(self, name) is not None:
                check(name, getattr(self, name))
        if not loaded and self.torque is not None:
            raise ParameterError("torque", self.torque, f"{self.analysis} takes no torque")
        if self.limit is not None and self.limit < 0 and self.metric in NEVER_NEGATIVE:
            raise ParameterError("limit", self.limit, f"must be at least 0: {self.metric} is never negative")
        if self.limit is not None and self.at_least is not None and self.limit <= self.at_least:
            raise ParameterError("limit", self.limit, "must be above at_least")

    @classmethod
    def named(cls, name: str, **rest: Any) -> "Measure":
        """A measure from a name such as ``"no_load.peak_to_peak"``, or ``"static.std@100Nm"``."""
        words, _, torque = name.partition("@")
        analysis, _, metric = words.partition(".")
        if torque and rest.get("torque") is not None:
            raise ParameterError("torque", rest["torque"], f'"{name}" gives a torque already')
        if torque:
            try:
                rest["torque"] = float(torque.removesuffix("Nm"))
            except ValueError as fault:
                raise ParameterError("measure", name, 'give the torque as in "static.std@100Nm"') from fault
        if analysis not in ANALYSES or metric not in MEASURED:
            names = [f"{one}.{other}" for one in ANALYSES for other in MEASURED]
            raise ParameterError("measure", name, nearest(words, names))
        return cls(analysis, metric, **rest)

    @property
    def name(self) -> str:
        """Name from analysis, metric and torque."""
        torque = "" if self.torque is None else f"@{self.torque:g}Nm"
        return f"{self.analysis}.{self.metric}{torque}"

    @property
    def is_limited(self) -> bool:
        """Whether the measure has a limit."""
        return self.limit is not None or self.at_least is not None

    def excess(self, values: Any) -> Any:
        """Number that is small for a good gear set, from values as numpy or JAX arrays.

        With ``at_least``, it is how far a value is outside the limits, negative inside. Otherwise it is the value
        itself, or the size of a mean without limit.
        """
        if self.at_least is None:
            return abs(values) if self.limit is None and self.metric == "mean" else values
        below = self.at_least - values
        if self.limit is None:
            return below
        above = values - self.limit
        return 0.5 * (above + below + abs(above - below))

    def holds(self, values: np.ndarray) -> np.ndarray:
        """Whether each value is within the limits; values that are not finite are not."""
        good = np.isfinite(values)
        if self.limit is not None:
            good &= values <= self.limit
        if self.at_least is not None:
            good &= values >= self.at_least
        return good


def listed(measure: str | Measure | Sequence[str | Measure]) -> list[Measure]:
    """A list of measures, from measures or their names.

    Raises:
        ParameterError: the list is empty, or contains something else.
    """
    given = [measure] if isinstance(measure, str | Measure) else measure
    if not isinstance(given, Sequence) or not given:
        raise ParameterError("measure", measure, 'needs at least one, such as "no_load.peak_to_peak"')
    for one in given:
        if not isinstance(one, str | Measure):
            raise ParameterError("measure", one, 'must be a name such as "no_load.peak_to_peak", or a Measure')
    return [one if isinstance(one, Measure) else Measure.named(one) for one in given]
