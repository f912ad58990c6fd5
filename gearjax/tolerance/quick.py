"""Measures of quasi-static curves with hard contacts that a program of their own computes, for any torque.

Studies of the same population share these programs, whichever other measures each of them has.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gearjax.scene import Scene
from gearjax.studies.select import Free
from gearjax.tolerance.curves import Curves, Touches
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.record import Record, coded, lost, of_curve
from gearjax.typing import Array, Float, Int, Scalar

ENDS = {"maximum": (1.0,), "minimum": (-1.0,), "peak_to_peak": (-1.0, 1.0), "amplitude": (-1.0, 1.0)}
"""Which ends of a curve metrics need, as signs of the values whose highest is sought."""


@dataclasses.dataclass(frozen=True, eq=False)
class QuickMeasures:
    """Metrics of analyses under one torque, as a function of the numbers of a gear set and of the torque.

    Args:
        free: which numbers of the scene vary.
        physics: the scene, reduced to what quasi-static analyses depend on.
        curves: what the curves of all gear sets have in common.
        metrics: analysis and metric of each measure.
    """

    free: Free
    physics: Scene
    curves: Curves
    metrics: tuple[tuple[str, str], ...]

    def __call__(self, values: Float[Array, " free"], torque: Scalar) -> tuple[Float[Array, " metric"], Int[Array, ""]]:
        """The metrics of a gear set, nan if it failed, and its result code; without load the torque has no effect."""
        touches = self.curves.touches(self.free.set(self.physics, values))
        records = {}
        for analysis in dict.fromkeys(analysis for analysis, _ in self.metrics):
            metrics = [metric for one, metric in self.metrics if one == analysis]
            records[analysis] = recorded(touches, analysis, torque if analysis == "static" else None, metrics)
        own = [(records[analysis], metric) for analysis, metric in self.metrics]
        return coded([record.metrics[metric]() for record, metric in own], [record.code for record, _ in own])


class Part(NamedTuple):
    """Measures that one program computes, under one torque after the other.

    Args:
        one: function from the numbers of a gear set, and the torque if there are torques, to measures and result code.
        torques: the torques [N m]; ``None`` if the program takes none.
        columns: for each torque, the places of its measures among all measures of a study.
    """

    one: Callable
    torques: tuple[float, ...] | None
    columns: tuple[tuple[int, ...], ...]

    def given(self, rows: np.ndarray) -> list[tuple[tuple[np.ndarray, ...], tuple[int, ...]]]:
        """For each torque, what the program takes for rows of numbers, and the places of its measures."""
        if self.torques is None:
            return [((rows,), self.columns[0])]
        loads = [np.full(len(rows), torque, rows.dtype) for torque in self.torques]
        return [((rows, load), places) for load, places in zip(loads, self.columns, strict=True)]


def parts(measures: Sequence[Measure], one: Callable[[tuple], QuickMeasures], *, unloaded: bool) -> list[Part]:
    """Quasi-static measures, those of the same analyses and metrics together.

    Args:
        measures: the measures.
        one: function that returns the function of the analysis and metric of each measure.
        unloaded: whether all analyses without load are one part: quicker by a quarter where samples alone are looked
            at, which compiles soon, but shared with studies of the same measures only.
    """
    columns: dict[tuple, list[int]] = {}
    for place, measure in enumerate(measures):
        together = unloaded and measure.torque is None
        columns.setdefault(("" if together else measure.analysis, measure.torque), []).append(place)
    alike: dict[tuple, list[tuple]] = {}
    for (_, torque), places in columns.items():
        metrics = tuple((measures[place].analysis, measures[place].metric) for place in places)
        alike.setdefault(metrics, []).append((torque or 0.0, tuple(places)))
    return [Part(one(key), *(tuple(each) for each in zip(*rows, strict=True))) for key, rows in alike.items()]


def recorded(touches: Touches, analysis: str, torque: Scalar | None, metrics: Sequence[str]) -> Record:
    """The record of a quasi-static curve with hard contacts; extremes are computed for the given metrics alone."""
    values = touches.curve(analysis, torque)
    signs = sorted({sign for metric in metrics for sign in ENDS.get(metric, ())})
    ends = functools.cache(lambda: touches.ends(analysis, torque, values, signs))

    def high() -> Scalar:
        return ends()[signs.index(1.0)]

    def low() -> Scalar:
        return -ends()[signs.index(-1.0)]

    code = jnp.where(lost(values, analysis), 3, 0)
    if touches.alike is not None:
        code = jnp.where(touches.alike, code, 4)
    return Record(of_curve(values, high, low), code)
