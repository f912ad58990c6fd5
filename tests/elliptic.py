"""Elliptic gears by numpy and scipy alone: closed forms of the ellipse about a focus, flanks by their envelope."""

import math

import numpy as np
from scipy.integrate import quad
from scipy.optimize import fsolve
from scipy.special import ellipe, ellipeinc

TEETH, MODULE, E, ALPHA = 47, 3e-3, 0.3287, math.radians(20)


class Ellipses:
    """Two equal ellipses about their foci.

    The driver turns counter-clockwise about the origin, the driven gear clockwise about (2 A, 0); polar angles of a
    pitch point on a gear are counted back from the line of the axes.
    """

    def __init__(self, e: float = E, semi_axis: float | None = None, alpha: float = ALPHA):
        self.e, self.alpha = e, alpha
        self.a = math.pi * MODULE * TEETH / (4 * ellipe(e * e)) if semi_axis is None else semi_axis

    def r1(self, t):
        return self.a * (1 - self.e**2) / (1 - self.e * np.cos(t))

    def r2(self, t):
        return 2 * self.a - self.r1(t)

    def psi(self, t):
        return np.arctan2(self.e * np.sin(t), 1 - self.e * np.cos(t))

    def t2(self, t):
        return t + 2 * self.psi(t)

    def ratio(self, t):
        return (1 - self.e**2) / (1 + self.e**2 - 2 * self.e * np.cos(t))

    def bend(self, t):
        """Second derivative of the driven gear's angle."""
        return -2 * (1 - self.e**2) * self.e * np.sin(t) / (1 + self.e**2 - 2 * self.e * np.cos(t)) ** 2

    def speed(self, t):
        return self.r1(t) / np.cos(self.psi(t))

    def arc(self, t):
        """Arc length, by the eccentric anomaly and an incomplete elliptic integral."""
        k = math.sqrt((1 + self.e) / (1 - self.e))
        b = (k - 1) / (k + 1)
        anomaly = t + 2 * np.arctan2(b * np.sin(t), 1 - b * np.cos(t))
        return self.a * (ellipeinc(anomaly + math.pi / 2, self.e**2) - ellipe(self.e**2))

    def flank(self, gear: int, side: int, t, crossing):
        """Points of flanks where the gears stand at angle zero: what a rack that rolls on the pitch curve touches."""
        psi, turned = self.psi(t), (t if gear == 0 else -self.t2(t))
        if gear == 0:
            point = self.r1(t) * np.array([np.cos(t), -np.sin(t)])
        else:
            point = self.r2(t) * np.array([-np.cos(self.t2(t)), -np.sin(self.t2(t))])
        lean = psi + turned
        slant = self.alpha + side * lean
        along = side * (self.arc(t) - crossing) * math.cos(self.alpha)
        return point + along * np.array([np.sin(slant), side * np.cos(slant)])

    def apart(self, place, t, angle, driver, driven, distance: float, side: int) -> tuple[float, float, float]:
        """Of the normals at two parameters of the pitch curves: how far their directions are apart, how far the lines
        are apart across, and the flanks along them; over the semi-axis."""
        own, other = place
        (e1, p1), (e2, p2) = driver, driven
        ahead = angle - self.t2(other)
        x1 = e1 * math.cos(t + p1) + self.r1(own) * math.cos(t - own)
        y1 = e1 * math.sin(t + p1) + self.r1(own) * math.sin(t - own)
        x2 = 2 * self.a + distance + e2 * math.cos(angle + p2) - self.r2(other) * math.cos(ahead)
        y2 = -e2 * math.sin(angle + p2) + self.r2(other) * math.sin(ahead)
        lean = self.psi(own) + own - t
        nx, ny = math.sin(self.alpha + side * lean), side * math.cos(self.alpha + side * lean)
        between = quad(self.speed, own, other, epsabs=1e-16)[0]
        along = (x2 - x1) * nx + (y2 - y1) * ny + side * math.cos(self.alpha) * between
        return lean - self.psi(other) - ahead, ((x2 - x1) * ny - (y2 - y1) * nx) / self.a, along / self.a

    def exact(self, t, driver=(0.0, 0.0), driven=(0.0, 0.0), distance: float = 0.0, side: int = 1) -> float:
        """Transmission error with which flanks of a side touch: three unknowns, the parameters of both curves and the
        driven gear's angle, from normals of one direction, on one line, at the same place along it."""

        def wrong(unknown):
            return self.apart(unknown[:2], t, unknown[2], driver, driven, distance, side)

        found = fsolve(wrong, [t, t, self.t2(t)], xtol=1e-12)
        assert np.abs(wrong(found)).max() < 1e-12
        return found[2] - self.t2(t)

    def distance(self, t, angle, driver=(0.0, 0.0), driven=(0.0, 0.0), distance: float = 0.0, side: int = 1) -> float:
        """Distance of the flanks of a side along their common normal, wherever the gears are [m]."""

        def wrong(place):
            return self.apart(place, t, angle, driver, driven, distance, side)[:2]

        found = fsolve(wrong, [t, t], xtol=1e-12)
        assert np.abs(wrong(found)).max() < 1e-12
        return self.a * self.apart(found, t, angle, driver, driven, distance, side)[2]
