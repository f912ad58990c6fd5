"""The construction by which Dong et al. (2020) find the ratio error of elliptic gears, and its simplified forms.

The line through the displaced axes has a point P', which divides it in the same ratio as the pitch point divides the
line through the ideal axes. The construction draws the line of action through P' and reads the ratio from the point
where the line of action cuts the line through the ideal axes. Lever and pressure angle are those of the ideal gears at
the same angle. The construction neglects the changes of both, so that its result is not the transmission error; in the
simplified forms a constant of the centre distance also enters the ratio. Computed with numpy; angles in rad, lengths in
m.
"""

from typing import NamedTuple

import numpy as np


class Ellipse(NamedTuple):
    """Elliptic gears at given angles of the driver, eqs. 1, 8 and 11.

    Args:
        semi_axis: A, half the centre distance [m].
        eccentricity: e [-].
        pressure_angle: alpha0 [rad].
        t1: angles of the driver, shape (n,) [rad].
    """

    semi_axis: float
    eccentricity: float
    pressure_angle: float
    t1: np.ndarray

    @property
    def t2(self) -> np.ndarray:
        e = self.eccentricity
        return self.t1 + 2 * np.arctan2(e * np.sin(self.t1), 1 - e * np.cos(self.t1))

    @property
    def radii(self) -> tuple[np.ndarray, np.ndarray]:
        """Pitch radii R01 and R02."""
        e = self.eccentricity
        first = self.semi_axis * (1 - e * e) / (1 - e * np.cos(self.t1))
        return first, 2 * self.semi_axis - first

    @property
    def slant(self) -> np.ndarray:
        """Pressure angle of the driving flanks, eq. 11."""
        e = self.eccentricity
        return self.pressure_angle + np.arctan2(e * np.sin(self.t1), 1 - e * np.cos(self.t1))


class RunOuts(NamedTuple):
    """Eccentricity errors of both wheels, and their phases [m, rad]."""

    driver: float
    driven: float
    driver_phase: float = 0.0
    driven_phase: float = 0.0


def _points(gears: Ellipse, errors: RunOuts) -> tuple[np.ndarray, ...]:
    """Axes of both wheels with their errors, O1' and O2', from the driven wheel's ideal axis (14): x1, y1, x3, y3."""
    first, second = gears.radii
    one, other = gears.t1 + errors.driver_phase, gears.t2 + errors.driven_phase
    apart = first + second + errors.driver + errors.driven
    own = -errors.driver * np.sin(one), errors.driver * np.cos(one) - apart
    return *own, errors.driven * np.sin(other), errors.driven * np.cos(other)


def constructed(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """Distance from the driven wheel's axis to where the line of action through P' cuts the line of the axes.

    It is computed directly from the points (14) and slopes (18); shape (n,) [m].
    """
    first, second = gears.radii
    x1, y1, x3, y3 = _points(gears, errors)
    share = second / (first + second)
    x2, y2 = x3 - share * (x3 - x1), y3 - share * (y3 - y1)
    # (18) with the slopes multiplied out, because the axes may stand exactly below each other
    tangent = np.tan(gears.slant)
    slope = ((x3 - x1) + (y3 - y1) * tangent) / (tangent * (x3 - x1) - (y3 - y1))
    return y2 - slope * x2


def corrected(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """The same distance by eq. 19 corrected, with ``L = (R01 + R02) / R02`` and x3 in its second product.

    Shape (n,) [m].
    """
    first, second = gears.radii
    return _equation_19(gears, errors, (first + second) / second, _points(gears, errors)[2])


def printed(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """The same distance by eq. 19 as it is printed, shape (n,) [m]."""
    first, second = gears.radii
    return _equation_19(gears, errors, (first + second) / first, _points(gears, errors)[3])


def _equation_19(gears: Ellipse, errors: RunOuts, whole: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Eq. 19 with a given L (``whole``) and a given factor of y1 in its second product (``other``)."""
    x1, y1, x3, y3 = _points(gears, errors)
    tangent = np.tan(gears.slant)
    above = -y1 * y1 - (whole - 2) * y1 * y3 - whole * y1 * other * tangent - x1 * x1
    above = above + whole * x1 * y3 * tangent - (whole - 2) * x1 * x3 + (whole - 1) * (x3 * x3 + y3 * y3)
    return above / (whole * (tangent * (x1 - x3) - (y1 - y3)))


def constructed_ratio_error(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """Ratio error of the construction (20), shape (n,) [-]."""
    first, second = gears.radii
    apart = first + second + errors.driver + errors.driven
    return apart / np.abs(constructed(gears, errors)) - (first + second) / second


def linear_ratio_error(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """Ratio error of the construction to first order, with the axes at their ideal distance, shape (n,) [-]."""
    first, second = gears.radii
    alpha = gears.slant
    one = errors.driver * np.cos(gears.t1 + errors.driver_phase + alpha) / second
    other = errors.driven * first / second**2 * np.cos(gears.t2 + errors.driven_phase - alpha)
    return (one + other) / np.cos(alpha)


def simplified_ratio_error(gears: Ellipse, errors: RunOuts, constant: float = 0.0) -> np.ndarray:
    """Simplified ratio error (21), shape (n,) [-].

    The pressure angle is that of (11), and its sign on the driver is corrected.

    Args:
        gears: the gears at the angles.
        errors: eccentricity errors of both wheels.
        constant: length that is added in the numerator; without it the values of Table 2 cannot be reached [m].
    """
    e, alpha = gears.eccentricity, gears.slant
    low, high = 1 - e * np.cos(gears.t1), 1 + e * np.cos(gears.t2)
    one = errors.driver * low * np.cos(gears.t1 + errors.driver_phase + alpha)
    other = errors.driven * high**2 * np.cos(gears.t2 + errors.driven_phase - alpha) / low
    p = gears.semi_axis * (1 - e * e)
    return (constant * (1 + e * np.cos(gears.t1)) + (one + other) / np.cos(alpha)) / p


def simplified_error(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """Simplified transmission error (25), shape (n,) [rad]."""
    e, alpha = gears.eccentricity, gears.pressure_angle
    one = np.sin(gears.t1 + errors.driver_phase + alpha) - np.sin(errors.driver_phase + alpha)
    other = np.sin(gears.t2 + errors.driven_phase + alpha) - np.sin(errors.driven_phase - alpha)
    p = gears.semi_axis * (1 - e * e)
    return (1 + e * np.cos(gears.t2)) / (p * np.cos(alpha)) * (errors.driver * one + errors.driven * other)


def integrated(t1: np.ndarray, ratio_error: np.ndarray) -> np.ndarray:
    """Transmission error as the integral of a ratio error from the first angle on (24), shape (n,) [rad]."""
    steps = 0.5 * (ratio_error[1:] + ratio_error[:-1]) * np.diff(t1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def right_flank(gears: Ellipse, along: np.ndarray, as_printed: bool) -> np.ndarray:
    """Right flank of a tooth, cut from the pitch points at ``t1``, in axes of the gear, shape (n, 2) [m].

    As printed, the flank follows (2) above the pitch curve and (4) below it. Otherwise it follows (6), whose line goes
    on below the pitch curve with reversed sign. The angle from the pitch radius to the tangent is mu, with
    ``tan mu = (1 - e cos t1) / (e sin t1)``.

    Args:
        gears: the gears at the angles of the pitch points.
        along: distance of the flank from the pitch points, positive above the pitch curve, shape (n,) [m].
        as_printed: whether points below the pitch curve follow (4).
    """
    e, t1 = gears.eccentricity, gears.t1
    mu = np.arctan2(1 - e * np.cos(t1), e * np.sin(t1))
    size, below = np.abs(along), along < 0
    alpha = gears.pressure_angle
    angle = np.where(below & as_printed, t1 - mu - alpha, t1 - mu + alpha)
    sign = np.where(below & (not as_printed), -1.0, 1.0)
    radius = gears.radii[0]
    x, y = radius * np.cos(t1) + sign * size * np.cos(angle), radius * np.sin(t1) + sign * size * np.sin(angle)
    return np.stack([x, y], axis=-1)
