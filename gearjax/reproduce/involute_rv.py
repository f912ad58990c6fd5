"""Yang, Tang and Liang (2019): loads of the teeth of an involute RV reducer's internal pair."""

from typing import NamedTuple

import numpy as np

from gearjax.influence.element import scikit_fem
from gearjax.progress import Progress, silent
from gearjax.reproduce.involute_rv_methods import Pressed, by_programme, pair_stiffness, pressed, two_dimensional
from gearjax.reproduce.involute_rv_pair import (
    FIRST,
    PHASE,
    POINTS,
    RIM,
    Candidates,
    Tables,
    candidates,
    influence,
    tables,
    total_load,
)
from gearjax.reproduce.rows import Row
from gearjax.units import mm, um

PAPER = (
    "Yang, Tang, Liang (2019), Tooth Surface Contact Analysis of Involute Rotate Vector Reducer Based on a Finite "
    "Element Linear Programming Method"
)
OTHER_RIM = 0.8 * mm  # second depth of the rim, to show the effect of the depth
STEP = 0.005  # step of the phase to both sides

TEETH = {  # Table 5: by finite elements with linear programming, by ANSYS [N]
    14: ("58.6", "57.5"),
    15: ("244.2", "244.6"),
    16: ("379.7", "381.7"),
    17: ("407.8", "409.0"),
    18: ("315.1", "315.4"),
    19: ("149.5", "149.3"),
}
UNLOADED = (13, 20, 21)
TABLE_2 = {14: "115.1", 15: "270.4", 16: "338.9", 17: "362.9", 18: "276.3", 19: "183", 20: "8.3"}  # N

FITTED = (
    f"two numbers, the place of tooth {FIRST} (phase {PHASE}) and the depth of the fixed rim ({RIM / mm:g} mm), are "
    "fitted to six loads of a known sum; the paper prints neither number"
)
ANSYS = (
    "the same loads of ours; limit 3 N, as the paper's own two methods differ by up to 2 N; ANSYS' loads add up to "
    "1557.4 N, not to T / r_b1"
)
FOUNDATION = "eqs. (9) and (10), nothing fitted to these loads: the teeth stand on a half-plane"
LARGEST = {15: (0.224, 3.58), 16: (0.199, 3.84), 18: (0.198, 3.69), 19: (0.058, 0.91)}  # Table 7: N, % of the largest
AT_POINTS = (
    "points at the edge of contact, with errors above 50 % in the paper; the limit is the difference between the "
    "paper's own two methods there, so that even zero may count as reproduced"
)


class _Point(NamedTuple):
    """A point of Tables 7 and 8; the error is that of the paper's other method, eq. (11)."""

    tooth: int
    face: tuple[float, float]  # mm, on the external and on the internal gear
    radius: tuple[str, str]  # mm
    error: tuple[int, int]  # %
    force: tuple[str, str]  # N, by ANSYS


# Tables 7 and 8 line by line; the printed (15,0,5,68.26) is read as 15, 0.5, 68.26.
_PRINTED = """
15 0.0 68.19 69.6   100 100  0.224 0.223
15 0.5 68.26 69.66  100 100  0.002 0.002
16 1.0 68.01 69.4   117 117  0.036 0.036
16 1.5 68.01 69.4   100 100  0.129 0.129
16 2.0 68.01 69.4   100 100  0.128 0.127
16 2.5 68.01 69.4   100 100  0.123 0.122
16 3.0 68.01 69.4   100 100  0.121 0.12
16 3.5 68.01 69.4   100 100  0.118 0.117
16 4.0 68.01 69.4   100 100  0.118 0.118
16 4.5 68.01 69.4   94 95    0.108 0.108
16 5.0 68.01 69.4   54 55    0.078 0.077
16 5.5 68.01 69.4   72 72    0.15 0.149
16 6.0 67.95 69.34  52 52    0.199 0.198
18 0.0 68.51 69.86  59 58    0.104 0.106
18 0.5 68.51 69.86  98 112   0.035 0.031
18 1.0 68.51 69.86  1158 2965 0.008 0.003
18 1.5 68.51 69.86  101 97   0.104 0.108
18 2.0 68.51 69.86  62 60    0.169 0.173
18 2.5 68.51 69.86  55 54    0.191 0.195
18 3.0 68.51 69.86  53 52    0.196 0.201
18 3.5 68.51 69.86  53 52    0.198 0.203
18 4.0 68.51 69.86  54 53    0.194 0.199
18 4.5 68.51 69.86  62 60    0.169 0.174
18 5.0 68.51 69.86  117 111  0.09 0.094
18 5.5 68.51 69.86  141 167  0.031 0.026
18 6.0 68.51 69.86  607 870  0.013 0.009
19 6.5 68.22 69.56  58 58    0.058 0.058
"""


def _points() -> list[_Point]:
    points = []
    for line in _PRINTED.strip().splitlines():
        tooth, face, own, mate, error, other, force, same = line.split()
        faces = float(face), float(face) + 0.5
        points.append(_Point(int(tooth), faces, (own, mate), (int(error), int(other)), (force, same)))
    return points


class Case(NamedTuple):
    """Points where teeth may touch, the influence between the points, and their forces under the torque."""

    points: Candidates
    influence: np.ndarray
    carried: Pressed

    @property
    def loads(self) -> np.ndarray:
        """Load of each tooth from 13 to 21, shape (tooth,) [N]."""
        return np.array([self.carried.forces[self.points.tooth == tooth].sum() for tooth in sorted(POINTS)])


def case(both: Tables, phase: float = PHASE) -> Case:
    """Compute the pair by finite elements.

    Args:
        both: influence tables of both gears.
        phase: place of tooth 17 on its path of contact [-].
    """
    points = candidates(phase)
    matrix = influence(both, points)
    return Case(points, matrix, pressed(matrix, points.gap))


def rows(say: Progress = silent) -> list[Row]:
    """Every load and force of the paper next to ours, and the effect of the numbers that the paper does not print.

    Args:
        say: function that is called with what is being computed.

    Raises:
        GearjaxError: scikit-fem is missing.
    """
    scikit_fem()
    say("two-dimensional method of Table 2")
    report = _table_2()
    say(f"finite elements of both gears, rim {RIM / mm:g} mm")
    both = tables()
    fitted = case(both)
    say(f"finite elements of both gears, rim {OTHER_RIM / mm:g} mm")
    other = case(tables(OTHER_RIM))
    say("loads at phases beside the fitted one")
    aside = [case(both, PHASE + step).loads for step in (-STEP, STEP)]
    report += _table_5(fitted)
    report += _owed(fitted, other, aside)
    say("linear programme of the paper")
    return report + _programme(fitted) + _tables_7_and_8(fitted)


def rms(loads: np.ndarray, published: dict[int, str]) -> float:
    """Root mean square deviation from printed loads [N].

    Args:
        loads: loads of teeth 13 to 21 [N].
        published: printed loads by tooth [N].
    """
    return float(np.sqrt(np.mean([(_of(loads, tooth) - float(text)) ** 2 for tooth, text in published.items()])))


def _of(loads: np.ndarray, tooth: int) -> float:
    return float(loads[sorted(POINTS).index(tooth)])


def _row(item: str, published: str, computed: float, unit: str, limit: float, why: str) -> Row:
    """A row that rests on fitted numbers: inferred if it is within the limit, not reproduced if it is not."""
    return Row(item, published, computed, unit, limit, why=why).inferred_if_close


def _table_2() -> list[Row]:
    # pairs are in order of increasing polar angle, in which the numbers of the teeth fall
    loads = two_dimensional(pair_stiffness(), total_load())[::-1]
    limit = 0.02 * max(map(float, TABLE_2.values()))
    why = f"{FOUNDATION}; limit 2 % of the largest load"
    report = [_row(f"Table 2, tooth {t}", load, _of(loads, t), "N", limit, why) for t, load in TABLE_2.items()]
    carry = float((loads > 0).sum())
    report.append(_row("Table 2, loaded pairs", "7", carry, "-", 0.5, f"teeth 14 to 20; {FOUNDATION}"))
    return [*report, Row("Table 2, rms of the loads", "", rms(loads, TABLE_2), "N", 0.0, why=FOUNDATION)]


def _table_5(fitted: Case) -> list[Row]:
    loads, forces = fitted.loads, fitted.carried.forces
    why = "T / r_b1, eq. (5), independent of the fitted numbers"
    report = [Row("Table 5, sum of the loads", "1554.9", float(loads.sum()), "N", 0.05, why=why)]
    ours, theirs = ({tooth: pair[column] for tooth, pair in TEETH.items()} for column in (0, 1))
    for tooth, load in ours.items():
        report.append(_row(f"Table 5, tooth {tooth}", load, _of(loads, tooth), "N", 1.0, f"{FITTED}; limit 1 N"))
    for tooth in UNLOADED:
        report.append(_row(f"Table 5, unloaded, tooth {tooth}", "0", _of(loads, tooth), "N", 1e-9, "printed as --"))
    for tooth, load in theirs.items():
        report.append(_row(f"Table 5, ANSYS, tooth {tooth}", load, _of(loads, tooth), "N", 3.0, ANSYS))
    why = "the 556 points are those of ANSYS; at least 8 of them do not touch in the paper's own method"
    touching = float((forces > 0).sum())
    return [*report, Row("Text, points in contact", "556", touching, "-", 8.0, why=why)]


def _owed(fitted: Case, other: Case, aside: list[np.ndarray]) -> list[Row]:
    """Effect of the two fitted numbers on the loads."""
    ours = {tooth: pair[0] for tooth, pair in TEETH.items()}
    report = []
    for one, rim in ((fitted, RIM), (other, OTHER_RIM)):
        told = f"Table 5, rim {rim / mm:g} mm, phase {PHASE}"
        report.append(Row(f"{told}, rms of the loads", "", rms(one.loads, ours), "N", 0.0, why="six loads"))
        report.append(Row(f"{told}, approach", "", one.carried.approach / um, "um", 0.0, why="r_b1 theta"))
    changes = (
        ("per 0.01 of the phase", (aside[1] - aside[0]) * (0.01 / (2 * STEP)), f"to both sides of {PHASE}"),
        (
            "per 0.1 mm of rim",
            (other.loads - fitted.loads) * (0.1 * mm / (OTHER_RIM - RIM)),
            f"from {RIM / mm:g} to {OTHER_RIM / mm:g} mm",
        ),
    )
    for name, change, why in changes:
        for tooth in TEETH:
            report.append(Row(f"Table 5, change {name}, tooth {tooth}", "", _of(change, tooth), "N", 0.0, why=why))
    return report


def _programme(fitted: Case) -> list[Row]:
    carried = by_programme(fitted.influence, fitted.points.gap, total_load())
    largest = float(np.abs(carried.forces - fitted.carried.forces).max())
    why = "largest difference between the forces by HiGHS and by the solver of this package, at all 1274 points"
    return [Row("Eqs. (3) and (4), linear programme against ours", "", largest, "N", 0.0, why=why)]


def _tables_7_and_8(fitted: Case) -> list[Row]:
    points, forces = fitted.points, fitted.carried.forces
    report = []
    why = "ANSYS, from the ratios that Table 7 prints; limit 12 %, below which most errors of the paper are"
    for tooth, (force, ratio) in LARGEST.items():
        published, computed = 100 * force / ratio, float(forces[points.tooth == tooth].max())
        item = f"Table 7, largest force at a point, tooth {tooth}"
        report.append(_row(item, f"{published:.2f}", computed, "N", 0.12 * published, why))
    for column, table in enumerate(("Table 7", "Table 8")):
        own, missed = [], []
        for point in _points():
            computed = float(forces[_nearest(points, point, column)])
            limit = 0.01 * point.error[column] * float(point.force[column])
            item = f"{table}, tooth {point.tooth} at {point.face[column]:g} mm and {point.radius[column]} mm"
            own.append(_row(item, point.force[column], computed, "N", limit, AT_POINTS))
            missed.append(own[-1].deviation)
        told = f"over 27 points; {sum(row.status == 'not reproduced' for row in own)} of them are beyond their limits"
        off = float(np.sqrt(np.mean(np.square(missed))))
        report += [*own, Row(f"{table}, rms of the forces", "", off, "N", 0.0, why=told)]
    return report


def _nearest(points: Candidates, point: _Point, column: int) -> int:
    """Index of our point that is nearest to a point of Table 7 or 8; radii and places are printed to 0.01 mm."""
    radius = (points.radius, points.mate)[column]
    beside = np.abs(points.face - point.face[0] * mm) + np.abs(radius - float(point.radius[column]) * mm)
    return int(np.argmin(np.where(points.tooth == point.tooth, beside, np.inf)))
