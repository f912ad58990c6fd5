"""Accuracy grades: limits of run-out and pitch deviations (ISO 1328), and of sizes (ISO 286), from grade and size."""

import math
from bisect import bisect_left
from collections.abc import Callable

from gearjax.checks import ParameterError, nearest
from gearjax.units import mm, um

EDITIONS = ("2013", "1995")
"""Editions of ISO 1328: "2013" has formulas of the gear's own size; in "1995" they are of the geometric mean of a range
of sizes, as in the printed tables."""
_DIAMETERS = (5, 20, 50, 125, 280, 560, 1000, 1600, 2500, 4000, 6000, 8000, 10000)  # mm
_MODULES = (0.5, 2, 3.5, 6, 10, 16, 25, 40, 70)  # mm
_SIZES = (3, 6, 10, 18, 30, 50, 80, 120, 180, 250, 315, 400, 500, 630, 800, 1000, 1250, 1600, 2000, 2500, 3150)  # mm
_IT = {  # um, by grade; each value is for sizes up to and including the size at the same place of _SIZES
    5: (4, 5, 6, 8, 9, 11, 13, 15, 18, 20, 23, 25, 27, 32, 36, 40, 47, 55, 65, 78, 96),
    6: (6, 8, 9, 11, 13, 16, 19, 22, 25, 29, 32, 36, 40, 44, 50, 56, 66, 78, 92, 110, 135),
    7: (10, 12, 15, 18, 21, 25, 30, 35, 40, 46, 52, 57, 63, 70, 80, 90, 105, 125, 150, 175, 210),
    8: (14, 18, 22, 27, 33, 39, 46, 54, 63, 72, 81, 89, 97, 110, 125, 140, 165, 195, 230, 280, 330),
    9: (25, 30, 36, 43, 52, 62, 74, 87, 100, 115, 130, 140, 155, 175, 200, 230, 260, 310, 370, 440, 540),
    10: (40, 48, 58, 70, 84, 100, 120, 140, 160, 185, 210, 230, 250, 280, 320, 360, 420, 500, 600, 700, 860),
    11: (60, 75, 90, 110, 130, 160, 190, 220, 250, 290, 320, 360, 400, 440, 500, 560, 660, 780, 920, 1100, 1350),
}
IT_GRADES = range(5, 17)


def single_pitch_tolerance(grade: int, module: float, diameter: float, edition: str = "2013") -> float:
    """Limit of the single pitch deviation, of either sign [m].

    ISO 1328-1:2013, 5.3.2, formula (5): ``(0.001 d + 0.4 m + 5) sqrt(2)^(grade - 5)`` um; ISO 1328-1:1995, clause 6
    and table 1: ``0.3 (m + 0.4 sqrt(d)) + 4`` at grade 5.

    Args:
        grade: accuracy grade, 1 to 11 (2013) or 0 to 12 (1995).
        module: normal module [m].
        diameter: reference diameter [m].
        edition: edition of the standard, ``"2013"`` or ``"1995"``.

    Raises:
        ParameterError: a value is outside the range of the standard.
    """
    return _iso_1328(
        (grade, module, diameter, edition),
        lambda m, d: 0.001 * d + 0.4 * m + 5,
        lambda m, d: 0.3 * (m + 0.4 * math.sqrt(d)) + 4,
    )


def total_pitch_tolerance(grade: int, module: float, diameter: float, edition: str = "2013") -> float:
    """Limit of the total cumulative pitch deviation [m].

    ISO 1328-1:2013, 5.3.3, formula (6): ``(0.002 d + 0.55 sqrt(d) + 0.7 m + 12) sqrt(2)^(grade - 5)`` um;
    ISO 1328-1:1995, clause 6 and table 2: ``0.3 m + 1.25 sqrt(d) + 7`` at grade 5.

    Args, raises: as `single_pitch_tolerance`.
    """
    return _iso_1328(
        (grade, module, diameter, edition),
        lambda m, d: 0.002 * d + 0.55 * math.sqrt(d) + 0.7 * m + 12,
        lambda m, d: 0.3 * m + 1.25 * math.sqrt(d) + 7,
    )


def run_out_tolerance(grade: int, module: float, diameter: float, edition: str = "2013") -> float:
    """Limit of the radial run-out of the teeth, highest minus lowest reading: twice the eccentricity [m].

    ISO 1328-1:2013, annex E: 0.9 of the total cumulative pitch tolerance; ISO 1328-2:1997, annex B and table B.1:
    ``0.24 m + 1.0 sqrt(d) + 5.6`` at grade 5.

    Args, raises: as `single_pitch_tolerance`.
    """
    return _iso_1328(
        (grade, module, diameter, edition),
        lambda m, d: 0.9 * (0.002 * d + 0.55 * math.sqrt(d) + 0.7 * m + 12),
        lambda m, d: 0.24 * m + math.sqrt(d) + 5.6,
    )


def flank_tolerance(deviation: str, grade: int, module: float, diameter: float, width: float) -> float:
    """Limit of a deviation of profile or helix, for slopes of either sign (ISO 1328-1:2013, 5.3) [m].

    At grade 5, in um, with sizes in mm: profile slope ``f_H_alpha`` 0.4 m + 0.001 d + 4, profile form ``f_f_alpha``
    0.55 m + 5, helix slope ``f_H_beta`` 0.05 sqrt(d) + 0.35 sqrt(b) + 4, helix form ``f_f_beta`` 0.07 sqrt(d) +
    0.45 sqrt(b) + 4. The total deviations ``F_alpha`` and ``F_beta`` are the root of the sum of the squares of slope
    and form. Each grade allows ``sqrt(2)`` times as much as the grade before.

    Args:
        deviation: name of the deviation, as above.
        grade: accuracy grade, 1 to 11.
        module: normal module [m].
        diameter: reference diameter [m].
        width: face width [m].

    Raises:
        ParameterError: there is no such deviation, or a value is outside the range of the standard.
    """
    if deviation not in _OF_FLANKS:
        raise ParameterError("deviation", deviation, nearest(deviation, _OF_FLANKS))
    if not _WIDTHS[0] <= width / mm <= _WIDTHS[1]:
        raise ParameterError("width", f"{width / mm:g} mm", f"must be {_WIDTHS[0]} to {_WIDTHS[1]} mm")

    def at_grade_5(m: float, d: float) -> float:
        return math.hypot(*(formula(m, d, width / mm) for formula in _OF_FLANKS[deviation]))

    return _iso_1328((grade, module, diameter, "2013"), at_grade_5, at_grade_5)


_SINGLE: dict[str, Callable[[float, float, float], float]] = {
    "f_H_alpha": lambda m, d, _: 0.4 * m + 0.001 * d + 4,
    "f_f_alpha": lambda m, _d, _b: 0.55 * m + 5,
    "f_H_beta": lambda _, d, b: 0.05 * math.sqrt(d) + 0.35 * math.sqrt(b) + 4,
    "f_f_beta": lambda _, d, b: 0.07 * math.sqrt(d) + 0.45 * math.sqrt(b) + 4,
}
_OF_FLANKS = {name: (formula,) for name, formula in _SINGLE.items()} | {
    f"F_{way}": (_SINGLE[f"f_H_{way}"], _SINGLE[f"f_f_{way}"]) for way in ("alpha", "beta")
}
_WIDTHS = (4, 1200)  # mm

Formula = Callable[[float, float], float]


def _iso_1328(given: tuple[int, float, float, str], now: Formula, before: Formula) -> float:
    grade, module, diameter, edition = given
    if edition not in EDITIONS:
        raise ParameterError("edition", edition, nearest(edition, EDITIONS))
    grades = range(1, 12) if edition == "2013" else range(13)
    if isinstance(grade, bool) or not isinstance(grade, int) or grade not in grades:
        raise ParameterError("grade", grade, f"must be a whole number from {grades[0]} to {grades[-1]}")
    highest = 15000 if edition == "2013" else _DIAMETERS[-1]
    if not _MODULES[0] <= module / mm <= _MODULES[-1]:
        raise ParameterError("module", f"{module / mm:g} mm", f"must be {_MODULES[0]} to {_MODULES[-1]} mm")
    if not _DIAMETERS[0] <= diameter / mm <= highest:
        raise ParameterError("diameter", f"{diameter / mm:g} mm", f"must be {_DIAMETERS[0]} to {highest} mm")
    if edition == "2013":
        base = now(module / mm, diameter / mm)
    else:
        base = before(_middle(module / mm, _MODULES), _middle(diameter / mm, _DIAMETERS))
    return _rounded(base * math.sqrt(2) ** (grade - 5)) * um


def _middle(size: float, bounds: tuple[int | float, ...]) -> float:
    """Geometric mean of the ends of the range that contains a size (ISO 1328-1:1995, clause 6)."""
    place = max(1, bisect_left(bounds, size * (1 - 1e-12)))
    return math.sqrt(bounds[place - 1] * bounds[place])


TIE = 1e-9  # a value in the middle is rounded up, although binary numbers may put it below


def _rounded(value: float) -> float:
    """A value rounded to 1 um above 10 um, to 0.5 um from 5 um on, else to 0.1 um (ISO 1328-1:1995, 6; 2013, 5)."""
    step = 1.0 if value > 10 else 0.5 if value >= 5 else 0.1
    return math.floor(value / step + 0.5 + TIE) * step


def it_tolerance(grade: int, size: float) -> float:
    """Standard tolerance IT of a size: highest minus lowest allowed size [m] (ISO 286-1:2010, table 1).

    Its values follow ``k i`` with ``i = 0.45 D^(1/3) + 0.001 D`` um up to 500 mm (ISO 286-1:1988, A.3.2); IT 12 to 16
    are ten times IT 7 to 11.

    Args:
        grade: tolerance grade, 5 to 16.
        size: nominal size, above 0 to 3150 mm [m].

    Raises:
        ParameterError: a value is outside the table.
    """
    if isinstance(grade, bool) or not isinstance(grade, int) or grade not in IT_GRADES:
        raise ParameterError("grade", grade, f"must be a whole number from {IT_GRADES[0]} to {IT_GRADES[-1]}")
    if not 0 < size / mm <= _SIZES[-1]:
        raise ParameterError("size", f"{size / mm:g} mm", f"must be above 0 to {_SIZES[-1]} mm")
    place = bisect_left(_SIZES, size / mm * (1 - 1e-12))
    return (10 * _IT[grade - 5][place] if grade > 11 else _IT[grade][place]) * um
