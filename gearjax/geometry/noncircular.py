"""Pitch curves of non-circular gears that roll on each other, and the flanks that a rack cuts along them.

The driver turns by the angle ``t``, the driven gear by ``t2(t)`` in the opposite sense. With ``i = dt2/dt`` and the
distance a of the axes, the pitch point is at ``r1 = a i / (1 + i)`` from the driver's axis and at ``r2 = a / (1 + i)``
from the driven gear's axis. Both pitch curves have the parameter t, the angle of the driver at which a point of the
curve is the pitch point.

Directions are measured from the line at right angles to the line of the axes, along which the teeth move at the pitch
point when the gears turn ahead. The common tangent of both curves leans from this line towards the driven gear by
``psi = atan(-r1' / r1)``, the normal of the drive flanks by ``alpha0 + psi`` and the normal of the back flanks by
``alpha0 - psi`` (Dong et al. 2020, eqs. 9 and 11).

A rack with the pressure angle alpha0 that rolls on a pitch curve touches a tooth on a line through the pitch point. The
flank of this tooth is ``P(t) + (s(t) - s_k) cos(alpha0) u(t)``. P is the pitch point on the gear, s the arc length, s_k
the arc length at which the flank crosses the pitch curve, and u the normal. The flanks of one side are therefore
parallel curves, and the flanks of both gears touch on the same line.
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.dependence import changes
from gearjax.typing import Array, Float, Scalar

NODES = 8  # nodes of a Gauss-Legendre rule
PIECES = 128  # pieces of a lobe, with one such rule each: exact to rounding up to eccentricities of 0.9
STEPS = 8  # steps of Newton's method
FURTHEST = 0.3  # rad, longest of these steps
DEGREE = 5  # degree of splines through tables


class AbstractRatio(eqx.Module):
    """Angle of the driven gear as a function of the driver's angle.

    The function repeats with each lobe: ``driver_lobes`` lobes pass in one turn of the driver, ``driven_lobes`` in one
    turn of the driven gear.
    """

    driver_lobes: eqx.AbstractVar[int]
    driven_lobes: eqx.AbstractVar[int]

    @abc.abstractmethod
    def driven_angle(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """Angle of the driven gear at an angle of the driver [rad]; it is zero at the angle zero."""

    def rates(self, t: Float[Array, "..."]) -> tuple[Array, Array, Array]:
        """The ratio ``i = dt2/dt`` and its first and second derivative by the driver's angle [-]."""

        def rate(t: Array) -> Array:
            return jax.jvp(self.driven_angle, (t,), (jnp.ones_like(t),))[1]

        def bend(t: Array) -> tuple[Array, Array]:
            return jax.jvp(rate, (t,), (jnp.ones_like(t),))

        (ratio, slope), (_, bent) = jax.jvp(bend, (t,), (jnp.ones_like(t),))
        return ratio, slope, bent


class EllipseRatio(AbstractRatio):
    """Ratio of a driver with the pitch curve ``r1 = p / (1 - e cos(n t))`` (Dong et al. 2020, eq. 1).

    With one lobe the curve is an ellipse about a focus. The parameter p is chosen so that the pitch curve of the driven
    gear closes; if both gears have one lobe, both curves are the same ellipse.

    Args:
        eccentricity: eccentricity e of the driver's pitch curve [-].
        driver_lobes, driven_lobes: numbers of lobes n of both gears.
    """

    eccentricity: Scalar
    driver_lobes: int = eqx.field(static=True, default=1)
    driven_lobes: int = eqx.field(static=True, default=1)

    @property
    def parameter(self) -> Scalar:
        """Ratio ``p / a`` at which the driven gear's pitch curve closes [-].

        It is ``(1 - e^2) / 2`` if both gears have the same number of lobes.
        """
        share, e = (self.driven_lobes / self.driver_lobes) ** 2, self.eccentricity
        if share == 1:
            return 0.5 * (1 - e * e)
        return (1 - e * e) / (1 + jnp.sqrt(share + e * e * (1 - share)))

    def driven_angle(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        # tan(n2 t2 / 2) = k tan(n t / 2), written in a form without jumps
        rest, e, turned = 1 - self.parameter, self.eccentricity, self.driver_lobes * t
        # if both gears have the same number of lobes, (rest - e) (rest + e) is the square of (1 - e^2) / 2, and b is e
        alike = self.driver_lobes == self.driven_lobes
        b = e if alike else e / (rest + jnp.sqrt((rest - e) * (rest + e)))
        return (turned + 2 * jnp.arctan2(b * jnp.sin(turned), 1 - b * jnp.cos(turned))) / self.driven_lobes

    def rates(self, t: Float[Array, "..."]) -> tuple[Array, Array, Array]:
        n, u = self.driver_lobes, self.parameter
        sine, cosine = self.eccentricity * jnp.sin(n * t), self.eccentricity * jnp.cos(n * t)
        below = 1 - u - cosine
        ratio = u / below
        slope = -ratio * n * sine / below
        return ratio, slope, -ratio * n * n * cosine / below - 2 * slope * n * sine / below


class TabulatedRatio(AbstractRatio):
    """Ratio as a periodic spline of fifth degree through values at even steps of the driver's angle over one lobe.

    The values are scaled by the factor `closes_by`, so that the driven gear's pitch curve closes.

    Args:
        values: N values of ``dt2/dt`` at the angles ``2 pi k / (n N)``, shape (value,) [-].
        driver_lobes, driven_lobes: numbers of lobes of both gears.
    """

    values: Float[Array, " value"]
    driver_lobes: int = eqx.field(static=True, default=1)
    driven_lobes: int = eqx.field(static=True, default=1)

    @property
    def closes_by(self) -> Scalar:
        """Factor of the values with which the driven gear turns by one of its lobes per lobe of the driver [-]."""
        return self.driver_lobes / self.driven_lobes / self.values.mean()

    def driven_angle(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        whole, share, pieces = self._piece(t)
        # integral of the ratio minus its mean: over all pieces before the angle's piece, and within that piece
        raised = pieces / np.arange(1.0, DEGREE + 2)[None].astype(pieces.dtype)
        passed = jnp.cumsum(raised.sum(axis=1)) - raised.sum(axis=1)
        near = jnp.mod(whole, pieces.shape[0])
        within = share * _polynomial([raised[near, power] for power in range(DEGREE + 1)], share)
        return (self.driver_lobes / self.driven_lobes) * t + self._step * (passed[near] + within)

    def rates(self, t: Float[Array, "..."]) -> tuple[Array, Array, Array]:
        whole, share, pieces = self._piece(t)
        near, step = pieces[jnp.mod(whole, pieces.shape[0])], self._step
        parts = [near[..., power] for power in range(DEGREE + 1)]
        first = [power * part for power, part in enumerate(parts)][1:]
        second = [power * part for power, part in enumerate(first)][1:]
        mean = self.driver_lobes / self.driven_lobes
        return mean + _polynomial(parts, share), _polynomial(first, share) / step, _polynomial(second, share) / step**2

    @property
    def _step(self) -> float:
        return 2 * np.pi / (self.driver_lobes * self.values.shape[0])

    def _piece(self, t: Float[Array, "..."]) -> tuple[Array, Array, Array]:
        """Piece of the spline that contains an angle, with its coefficients.

        Returns:
            Number of the piece, counted from zero; share of the piece before the angle; coefficients of all pieces for
            the ratio minus its mean, by rising powers of that share.
        """
        swing = self.values * self.closes_by - self.driver_lobes / self.driven_lobes
        at = t / self._step
        whole = jnp.floor(jax.lax.stop_gradient(at))
        return whole.astype(int), at - whole, _pieces(swing)


def _pieces(values: Float[Array, " value"]) -> Float[Array, "value power"]:
    """Coefficients of the periodic spline of fifth degree through values at whole numbers, piece by piece.

    They are ordered by rising powers of the share of each piece.
    """
    from scipy.interpolate import BSpline, PPoly  # this import takes 0.2 s, and only tables need it

    whole = PPoly.from_spline(BSpline.basis_element(np.arange(DEGREE + 2)), extrapolate=False)
    basis = whole.c[::-1, np.searchsorted(whole.x, np.arange(DEGREE + 1) + 0.5) - 1]
    middle = np.zeros(values.shape[0])
    np.add.at(middle, np.arange(-2, 3) % len(middle), basis[0, 1:])  # the basis function at whole numbers
    turned = jnp.fft.rfft(values)
    weights = jnp.fft.irfft(turned / jnp.asarray(np.fft.rfft(middle), turned.dtype), values.shape[0])
    # a basis function that begins at a place has its k-th part on the piece k places later; its middle is at 3
    shifted = jnp.stack([jnp.roll(weights, part - 3) for part in range(DEGREE + 1)], axis=-1)
    return shifted @ jnp.asarray(basis.T, values.dtype)


def _polynomial(coefficients: list[Array], x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Value of a polynomial at x, from its coefficients by rising powers."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


class PitchPoint(NamedTuple):
    """Pitch point, where both pitch curves touch, at angles of the driver; all arrays have the shape of the angles.

    Args:
        ratio: ratio ``i = dt2/dt`` [-].
        radius: distance of the pitch point from the driver's axis [m].
        driven_radius: distance of the pitch point from the driven gear's axis [m].
        lean: angle psi by which the common tangent leans towards the driven gear [rad].
        lean_rate: derivative of the lean by the driver's angle [-].
        speed: arc length per angle of the driver, ``ds/dt`` [m].
    """

    ratio: Array
    radius: Array
    driven_radius: Array
    lean: Array
    lean_rate: Array
    speed: Array

    @property
    def curvatures(self) -> tuple[Array, Array]:
        """Curvatures of the driver's and of the driven gear's pitch curve, positive on convex parts [1/m].

        Their inverses are the radii of Dong et al. (2020), eq. 12, with ``(i')^2`` in place of the printed ``(i'')^2``.
        """
        return (1 + self.lean_rate) / self.speed, (self.ratio - self.lean_rate) / self.speed


class PitchCurves(eqx.Module):
    """Two pitch curves that roll on each other, and the rack that cuts teeth along them.

    Args:
        ratio: angle of the driven gear as a function of the driver's angle.
        centre_distance: distance a of the axes [m].
        pressure_angle: pressure angle alpha0 of the rack [rad].
    """

    ratio: AbstractRatio
    centre_distance: Scalar
    pressure_angle: Scalar

    def at(self, t: Float[Array, "..."]) -> PitchPoint:
        """The pitch point at an angle of the driver [rad]."""
        ratio, slope, bent = self.ratio.rates(t)
        driven = self.centre_distance / (1 + ratio)
        across = ratio * (1 + ratio)
        lean = jnp.arctan2(-slope, across)
        rate = (slope * slope * (1 + 2 * ratio) - bent * across) / (across * across + slope * slope)
        return PitchPoint(ratio, driven * ratio, driven, lean, rate, driven * ratio / jnp.cos(lean))

    def normal_angle(self, t: Float[Array, "..."], side: Float[Array, "..."]) -> Float[Array, "..."]:
        """Operating pressure angle of drive flanks (side 1) and back flanks (side -1) [rad].

        It is ``alpha0 + side psi`` (Dong et al. 2020, eq. 11).
        """
        return self.pressure_angle + side * self.at(t).lean

    def arc_length(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """Arc length of the pitch curves from the angle zero, the same on both gears [m]."""
        return self._rolled(t)[0]

    def turns(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """Arc length from the angle zero in perimeters of the driver [-]; teeth are spaced by arc length, not angle."""
        arc, lobe = self._rolled(t)
        return arc / (self.ratio.driver_lobes * lobe)

    def _rolled(self, t: Float[Array, "..."]) -> tuple[Array, Array]:
        """Arc length from the angle zero, and arc length of a lobe [m]."""
        lobe = 2 * np.pi / self.ratio.driver_lobes
        passed = jnp.concatenate([jnp.zeros(1, t.dtype), jnp.cumsum(self._pieces(t.dtype))])
        whole = jnp.floor(jax.lax.stop_gradient(t) / lobe)
        piece = jnp.clip(jnp.floor((jax.lax.stop_gradient(t) - whole * lobe) * (PIECES / lobe)), 0, PIECES - 1)
        start = whole * lobe + piece * (lobe / PIECES)
        return whole * passed[-1] + passed[piece.astype(int)] + self.between(start, t), passed[-1]

    @property
    def perimeter(self) -> Scalar:
        """Perimeter of the driver's pitch curve [m]."""
        return self.ratio.driver_lobes * self._pieces(jnp.result_type(self.centre_distance)).sum()

    def _pieces(self, dtype: jnp.dtype) -> Float[Array, " piece"]:
        """Arc length of each piece of a lobe [m]."""
        places, weights = np.polynomial.legendre.leggauss(NODES)
        half = np.pi / self.ratio.driver_lobes / PIECES
        nodes = half * (2 * np.arange(PIECES)[:, None] + 1 + places)
        return half * (self.at(jnp.asarray(nodes, dtype)).speed @ jnp.asarray(weights, dtype))

    def between(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Arc length between two angles, by a single Gauss rule that needs angles near each other [m]."""
        places, weights = np.polynomial.legendre.leggauss(NODES)
        half, middle = 0.5 * (end - start), 0.5 * (end + start)
        nodes = jnp.stack([middle + half * float(place) for place in places], axis=-1)
        return half * (self.at(nodes).speed @ jnp.asarray(weights, half.dtype))

    def displaced_gaps(self, placed: "Placed", side: Float[Array, "..."]) -> tuple[Array, Array]:
        """Distance of the flanks of both displaced gears along their common normal, and its derivative [m, m/rad].

        The derivative is by the driven gear's angle. The flanks of one side are parallel curves, so that the distance
        is the same for all teeth. Newton's method finds two unknowns: the parameters of both pitch curves at which the
        normals of the flanks lie on one line. The distance is stationary in both parameters, its derivative is not. One
        more step carries their first derivatives, `_feet` carries all.

        Args:
            placed: positions of both gears.
            side: 1 for drive flanks, -1 for back flanks.
        """
        frozen = jax.lax.stop_gradient((self, placed))

        def search(_: Any, place: tuple[Array, Array]) -> tuple[Array, Array]:
            lines = _Lines(*frozen, side, *place)
            return lines.stepped(lines.slopes)

        start = jnp.broadcast_to(frozen[1].driver, jnp.broadcast_shapes(jnp.shape(placed.driver), side.shape))
        place = jax.lax.fori_loop(0, STEPS, search, (start, start))
        lines = _Lines(self, placed, side, *place)
        place = _feet(lines.stepped(jax.lax.stop_gradient(lines.slopes)), (self, placed), side=side)
        return _Lines(self, placed, side, *place).distance


class Placed(NamedTuple):
    """Positions of both gears, at any angles and with displaced centres.

    Args:
        driver: angle of the driver [rad].
        driven: angle of the driven gear [rad].
        centres: displacement of each gear's centre from its ideal place; x points along the line of the axes towards
            the driven gear, y in the direction in which the teeth move at the mesh [m].
        carried: derivative of the driven gear's displacement by its angle [m/rad].
    """

    driver: Array
    driven: Array
    centres: tuple[tuple[Array, Array], tuple[Array, Array]]
    carried: tuple[Array, Array]


class _Lines:
    """Normals of the flanks of both gears at given parameters of both pitch curves, for displaced gears.

    Args:
        curves: the pitch curves.
        placed: positions of both gears.
        side: 1 for drive flanks, -1 for back flanks.
        own, other: parameters of the driver's and of the driven gear's pitch curve [rad].
    """

    def __init__(self, curves: PitchCurves, placed: Placed, side: Array, own: Array, other: Array):
        self.curves, self.placed, self.side, self.place = curves, placed, side, (own, other)
        self.at, self.beyond = curves.at(own), curves.at(other)
        self.ahead = placed.driven - curves.ratio.driven_angle(other)
        self.lean = self.at.lean + own - placed.driver
        slant = curves.pressure_angle + side * self.lean
        self.normal = jnp.sin(slant), side * jnp.cos(slant)
        (x1, y1), (x2, y2) = placed.centres
        back = placed.driver - own
        self.arm = self.beyond.driven_radius * jnp.cos(self.ahead), self.beyond.driven_radius * jnp.sin(self.ahead)
        self.apart = (
            x2 - x1 + curves.centre_distance - self.arm[0] - self.at.radius * jnp.cos(back),
            y2 - y1 + self.arm[1] - self.at.radius * jnp.sin(back),
        )
        self.along = self.apart[0] * self.normal[0] + self.apart[1] * self.normal[1]

    @property
    def slopes(self) -> tuple[Array, Array, Array, Array]:
        """Jacobian of both conditions by both parameters."""
        sine = jnp.sin(self.curves.pressure_angle)
        turns, other = 1 + self.at.lean_rate, self.beyond.ratio - self.beyond.lean_rate
        return turns, other, -self.at.speed * sine - self.along * turns, self.beyond.speed * sine

    def stepped(self, slopes: tuple[Array, Array, Array, Array]) -> tuple[Array, Array]:
        """Parameters after a Newton step towards two normals that have the same direction and lie on one line."""
        first = self.lean - self.beyond.lean - self.ahead
        second = self.apart[0] * self.normal[1] - self.apart[1] * self.normal[0]
        a, b, c, d = slopes
        whole = a * d - b * c
        steps = (d * first - b * second) / whole, (a * second - c * first) / whole
        own, other = (at - jnp.clip(step, -FURTHEST, FURTHEST) for at, step in zip(self.place, steps, strict=True))
        return own, other

    @property
    def distance(self) -> tuple[Array, Array]:
        """Distance of the flanks on that line, and its derivative by the driven gear's angle [m, m/rad]."""
        passed = self.side * jnp.cos(self.curves.pressure_angle) * self.curves.between(*self.place)
        (x, y), (carried_x, carried_y) = self.normal, self.placed.carried
        return self.along + passed, (self.arm[1] + carried_x) * x + (self.arm[0] + carried_y) * y


@eqx.filter_custom_jvp
def _feet(place: tuple[Array, Array], given: tuple[PitchCurves, Placed], *, side: Array) -> tuple[Array, Array]:
    """The parameters of both pitch curves at which the normals lie on one line, with derivatives of any order."""
    del given, side
    return place


@_feet.def_jvp
def _feet_jvp(
    primals: tuple[tuple[Array, Array], tuple[PitchCurves, Placed]], tangents: tuple, *, side: Array
) -> tuple[tuple, tuple]:
    """The change of a Newton step from the place itself, which moves too when this is differentiated."""
    (place, given), (_, moves) = primals, tangents
    own, other = place = _feet(place, given, side=side)
    slopes = _Lines(*given, side, own, other).slopes

    def stepped(given: tuple[PitchCurves, Placed]) -> tuple[Array, Array]:
        return _Lines(*given, side, own, other).stepped(slopes)

    return place, changes(stepped, given, moves)[1]
