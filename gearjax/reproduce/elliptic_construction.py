"""The construction by which Dong et al. (2020) find the ratio error of elliptic gears, and its simplified forms.

It lays the line of action through the point that divides the line of the displaced axes as the pitch point divides that
of the axes, and reads the ratio off where it cuts the latter. Lever and pressure angle are those of the ideal gears at
the same angle, so that it leaves out how both change: it is no transmission error, and for the simplified forms a
constant of the centre distance goes into the ratio. By numpy; angles in rad, lengths in m.
"""

from typing import NamedTuple

import numpy as np


class Ellipse(NamedTuple):
    """Elliptic gears at angles of the driver, eqs. 1, 8 and 11.

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
        """R01 and R02."""
        e = self.eccentricity
        first = self.semi_axis * (1 - e * e) / (1 - e * np.cos(self.t1))
        return first, 2 * self.semi_axis - first

    @property
    def slant(self) -> np.ndarray:
        """Pressure angle of the driving flanks (11)."""
        e = self.eccentricity
        return self.pressure_angle + np.arctan2(e * np.sin(self.t1), 1 - e * np.cos(self.t1))


class RunOuts(NamedTuple):
    """Eccentricity errors of both wheels, and their phases [m, rad]."""

    driver: float
    driven: float
    driver_phase: float = 0.0
    driven_phase: float = 0.0


def _points(gears: Ellipse, errors: RunOuts) -> tuple[np.ndarray, ...]:
    """Axes of both wheels with their errors, O1' and O2', about the driven wheel's own axis (14): x1, y1, x3, y3."""
    first, second = gears.radii
    one, other = gears.t1 + errors.driver_phase, gears.t2 + errors.driven_phase
    apart = first + second + errors.driver + errors.driven
    own = -errors.driver * np.sin(one), errors.driver * np.cos(one) - apart
    return *own, errors.driven * np.sin(other), errors.driven * np.cos(other)


def constructed(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """Where the line of action through P' cuts the line of the axes, from the driven wheel's, by the points (14) and
    slopes (18) themselves, shape (n,) [m]."""
    first, second = gears.radii
    x1, y1, x3, y3 = _points(gears, errors)
    share = second / (first + second)
    x2, y2 = x3 - share * (x3 - x1), y3 - share * (y3 - y1)
    # (18), the slopes multiplied out: the axes may stand right below each other
    tangent = np.tan(gears.slant)
    slope = ((x3 - x1) + (y3 - y1) * tangent) / (tangent * (x3 - x1) - (y3 - y1))
    return y2 - slope * x2


def corrected(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """The same by eq. 19 as it should stand, with ``L = (R01 + R02) / R02`` and x3 in its second product, shape (n,)
    [m]."""
    first, second = gears.radii
    return _equation_19(gears, errors, (first + second) / second, _points(gears, errors)[2])


def printed(gears: Ellipse, errors: RunOuts) -> np.ndarray:
    """The same by eq. 19 as it is printed, shape (n,) [m]."""
    first, second = gears.radii
    return _equation_19(gears, errors, (first + second) / first, _points(gears, errors)[3])


def _equation_19(gears: Ellipse, errors: RunOuts, whole: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Eq. 19 with its L, and what y1 is multiplied by in its second product."""
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
    """The construction to first order, the axes as far apart as they should be, shape (n,) [-]."""
    first, second = gears.radii
    alpha = gears.slant
    one = errors.driver * np.cos(gears.t1 + errors.driver_phase + alpha) / second
    other = errors.driven * first / second**2 * np.cos(gears.t2 + errors.driven_phase - alpha)
    return (one + other) / np.cos(alpha)


def simplified_ratio_error(gears: Ellipse, errors: RunOuts, constant: float = 0.0) -> np.ndarray:
    """Simplified ratio error (21), with the pressure angle of (11) and its sign on the driver as it should be, shape
    (n,) [-].

    Args:
        gears: at the angles.
        errors: of both wheels.
        constant: a length that stands in the numerator with them, and without which Table 2 cannot be had [m].
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
    """Transmission error by integration of a ratio error from the first angle (24), shape (n,) [rad]."""
    steps = 0.5 * (ratio_error[1:] + ratio_error[:-1]) * np.diff(t1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def right_flank(gears: Ellipse, along: np.ndarray, as_printed: bool) -> np.ndarray:
    """Right flank of a tooth, cut from the pitch points at ``t1``, in axes of the gear, shape (n, 2) [m].

    By (2) above the pitch curve and (4) below it, as printed, or by (6), whose line runs on with its sign turned: mu is
    the angle from the pitch radius to the tangent, ``tan mu = (1 - e cos t1) / (e sin t1)``.

    Args:
        gears: at the angles of the pitch points.
        along: distance of the flank from them, above the pitch curve positive, shape (n,) [m].
        as_printed: whether points below are by (4).
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
