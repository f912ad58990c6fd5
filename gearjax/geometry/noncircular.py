"""Pitch curves of non-circular gears that roll on each other, and the flanks that a rack cuts along them.

The driver turns evenly by ``t``, the driven gear by ``t2(t)``, the other way round. With ``i = dt2/dt`` and the
distance of the axes a the pitch point is ``r1 = a i / (1 + i)`` from the driver's axis and ``r2 = a / (1 + i)`` from
the driven gear's. Both curves have the parameter t of the driver: the point that is the pitch point at that angle.

Directions are told from the line at right angles to that of the axes, on which the pitch point moves as gears turn
ahead: the tangent of both curves leans by ``psi = atan(-r1' / r1)`` towards the driven gear, the drive flanks' normal
by ``alpha0 + psi``, the back flanks' by ``alpha0 - psi`` (Dong et al. 2020, eqs. 9 and 11).

A rack of the pressure angle alpha0 that rolls on a pitch curve touches a tooth on a line through the pitch point. That
tooth's flank is ``P(t) + (s(t) - s_k) cos(alpha0) u(t)``: P the pitch point on the gear, s the arc length, s_k that at
which the flank crosses the pitch curve, u the normal. Flanks of one side are therefore parallel curves, and those of
both gears touch on the same line.
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Scalar

NODES = 8  # of a Gauss-Legendre rule
PIECES = 128  # of a lobe's arc length, each by such a rule: to rounding up to eccentricities of 0.9
STEPS = 8  # of Newton's method
FURTHEST = 0.3  # rad, of one of them
DEGREE = 5  # of splines through tables


class AbstractRatio(eqx.Module):
    """How a driven gear turns as its driver does.

    Curves repeat with each lobe: ``driver_lobes`` of them pass while the driver turns once, ``driven_lobes`` while the
    driven gear does.
    """

    driver_lobes: eqx.AbstractVar[int]
    driven_lobes: eqx.AbstractVar[int]

    @abc.abstractmethod
    def driven_angle(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """Angle of the driven gear at an angle of the driver, zero at zero [rad]."""

    def rates(self, t: Float[Array, "..."]) -> tuple[Array, Array, Array]:
        """The ratio ``i = dt2/dt`` and its first and second derivative by the driver's angle [-]."""

        def rate(t: Array) -> Array:
            return jax.jvp(self.driven_angle, (t,), (jnp.ones_like(t),))[1]

        def bend(t: Array) -> tuple[Array, Array]:
            return jax.jvp(rate, (t,), (jnp.ones_like(t),))

        (ratio, slope), (_, bent) = jax.jvp(bend, (t,), (jnp.ones_like(t),))
        return ratio, slope, bent


class EllipseRatio(AbstractRatio):
    """The driver's pitch curve ``r1 = p / (1 - e cos(n t))``, an ellipse about a focus where it has one lobe
    (Dong et al. 2020, eq. 1); the driven gear's one closes, and is the same ellipse where it has one lobe too.

    Args:
        eccentricity: e of the driver's curve [-].
        driver_lobes, driven_lobes: n of both gears.
    """

    eccentricity: Scalar
    driver_lobes: int = eqx.field(static=True, default=1)
    driven_lobes: int = eqx.field(static=True, default=1)

    @property
    def parameter(self) -> Scalar:
        """``p / a`` with which the driven gear's curve closes: ``(1 - e^2) / 2`` with as many lobes on both [-]."""
        share, e = (self.driven_lobes / self.driver_lobes) ** 2, self.eccentricity
        if share == 1:
            return 0.5 * (1 - e * e)
        return (1 - e * e) / (1 + jnp.sqrt(share + e * e * (1 - share)))

    def driven_angle(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        # tan(n2 t2 / 2) = k tan(n t / 2), without its jumps
        rest, e, turned = 1 - self.parameter, self.eccentricity, self.driver_lobes * t
        # with as many lobes on both gears (rest - e) (rest + e) is the square of (1 - e^2) / 2, and b is e
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
    """A ratio through values at even steps of the driver's angle over one lobe: a periodic spline of fifth degree.

    The values are scaled so that the driven gear's curve closes; `closes_by` tells by how much.

    Args:
        values: ``dt2/dt`` at ``2 pi k / (n N)``, of N values, shape (value,) [-].
        driver_lobes, driven_lobes: lobes of both gears.
    """

    values: Float[Array, " value"]
    driver_lobes: int = eqx.field(static=True, default=1)
    driven_lobes: int = eqx.field(static=True, default=1)

    @property
    def closes_by(self) -> Scalar:
        """What the values have to be multiplied by so that the driven gear turns by whole lobes [-]."""
        return self.driver_lobes / self.driven_lobes / self.values.mean()

    def driven_angle(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        whole, share, pieces = self._piece(t)
        # of each piece: what the ratio adds to its mean by its end, and up to a share of it
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
        """The piece of the spline that an angle is in, counted from zero, the share of it that has passed, and the
        coefficients of all pieces for the ratio less its mean, by rising powers of that share."""
        swing = self.values * self.closes_by - self.driver_lobes / self.driven_lobes
        at = t / self._step
        whole = jnp.floor(jax.lax.stop_gradient(at))
        return whole.astype(int), at - whole, _pieces(swing)


def _pieces(values: Float[Array, " value"]) -> Float[Array, "value power"]:
    """Pieces of the periodic spline of fifth degree through values at whole places, by rising powers of the share of
    each piece."""
    from scipy.interpolate import BSpline, PPoly  # 0.2 s that only tables take

    whole = PPoly.from_spline(BSpline.basis_element(np.arange(DEGREE + 2)), extrapolate=False)
    basis = whole.c[::-1, np.searchsorted(whole.x, np.arange(DEGREE + 1) + 0.5) - 1]
    middle = np.zeros(values.shape[0])
    np.add.at(middle, np.arange(-2, 3) % len(middle), basis[0, 1:])  # the basis at whole places
    turned = jnp.fft.rfft(values)
    weights = jnp.fft.irfft(turned / jnp.asarray(np.fft.rfft(middle), turned.dtype), values.shape[0])
    # the basis that begins at a place has its k-th part on the piece that is k further on; its middle is at 3
    shifted = jnp.stack([jnp.roll(weights, part - 3) for part in range(DEGREE + 1)], axis=-1)
    return shifted @ jnp.asarray(basis.T, values.dtype)


def _polynomial(coefficients: list[Array], x: Float[Array, "..."]) -> Float[Array, "..."]:
    """A polynomial by rising powers."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


class PitchPoint(NamedTuple):
    """Where both pitch curves touch at an angle of the driver; all of the shape of that angle.

    Args:
        ratio: ``i = dt2/dt`` [-].
        radius: of the pitch point about the driver's axis [m].
        driven_radius: about the driven gear's axis [m].
        lean: psi, of the common tangent towards the driven gear [rad].
        lean_rate: its change with the driver's angle [-].
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
        """Of the driver's and the driven gear's pitch curve, positive where convex [1/m]; their inverses are the radii
        of Dong et al. (2020), eq. 12, with ``(i')^2`` in place of the printed ``(i'')^2``."""
        return (1 + self.lean_rate) / self.speed, (self.ratio - self.lean_rate) / self.speed


class PitchCurves(eqx.Module):
    """Two pitch curves that roll on each other, and the rack that cuts teeth along them.

    Args:
        ratio: how the driven gear turns.
        centre_distance: of the axes, a [m].
        pressure_angle: of the rack, alpha0 [rad].
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
        """Pressure angle in motion of drive flanks (side 1) and back flanks (-1), ``alpha0 + side psi``
        (Dong et al. 2020, eq. 11) [rad]."""
        return self.pressure_angle + side * self.at(t).lean

    def arc_length(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """Arc length of both pitch curves from angle zero [m]."""
        return self._rolled(t)[0]

    def turns(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """The same in perimeters of the driver: teeth pass by arc length, not by angle [-]."""
        arc, lobe = self._rolled(t)
        return arc / (self.ratio.driver_lobes * lobe)

    def _rolled(self, t: Float[Array, "..."]) -> tuple[Array, Array]:
        """Arc length from angle zero, and that of a lobe [m]."""
        lobe = 2 * np.pi / self.ratio.driver_lobes
        passed = jnp.concatenate([jnp.zeros(1, t.dtype), jnp.cumsum(self._pieces(t.dtype))])
        whole = jnp.floor(jax.lax.stop_gradient(t) / lobe)
        piece = jnp.clip(jnp.floor((jax.lax.stop_gradient(t) - whole * lobe) * (PIECES / lobe)), 0, PIECES - 1)
        start = whole * lobe + piece * (lobe / PIECES)
        return whole * passed[-1] + passed[piece.astype(int)] + self.between(start, t), passed[-1]

    @property
    def perimeter(self) -> Scalar:
        """Of the driver's pitch curve [m]."""
        return self.ratio.driver_lobes * self._pieces(jnp.result_type(self.centre_distance)).sum()

    def _pieces(self, dtype: jnp.dtype) -> Float[Array, " piece"]:
        """Arc length of each piece of a lobe [m]."""
        places, weights = np.polynomial.legendre.leggauss(NODES)
        half = np.pi / self.ratio.driver_lobes / PIECES
        nodes = half * (2 * np.arange(PIECES)[:, None] + 1 + places)
        return half * (self.at(jnp.asarray(nodes, dtype)).speed @ jnp.asarray(weights, dtype))

    def between(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Arc length between angles that are not far apart [m]."""
        places, weights = np.polynomial.legendre.leggauss(NODES)
        half, middle = 0.5 * (end - start), 0.5 * (end + start)
        nodes = jnp.stack([middle + half * float(place) for place in places], axis=-1)
        return half * (self.at(nodes).speed @ jnp.asarray(weights, half.dtype))

    def displaced_gaps(self, placed: "Placed", side: Float[Array, "..."]) -> tuple[Array, Array]:
        """Distance of the flanks of both gears along their common normal, wherever the gears are, and its change with
        the driven gear's angle [m, m/rad].

        Flanks of a side are parallel curves, so that it is the same for all teeth. Two unknowns, the parameters of both
        curves whose normals lie on one line, by Newton's method; the distance is stationary in both. One more step
        carries their derivatives.

        Args:
            placed: where the gears are.
            side: 1 for drive flanks, -1 for back flanks.
        """
        frozen = jax.lax.stop_gradient((self, placed))

        def search(_: Any, place: tuple[Array, Array]) -> tuple[Array, Array]:
            lines = _Lines(*frozen, side, *place)
            return lines.stepped(lines.slopes)

        start = jnp.broadcast_to(frozen[1].driver, jnp.broadcast_shapes(jnp.shape(placed.driver), side.shape))
        place = jax.lax.fori_loop(0, STEPS, search, (start, start))
        lines = _Lines(self, placed, side, *place)
        own, other = lines.stepped(jax.lax.stop_gradient(lines.slopes))
        return _Lines(self, placed, side, own, other).distance


class Placed(NamedTuple):
    """Where both gears are, wherever that is.

    Args:
        driver: angle of the driver [rad].
        driven: angle of the driven gear [rad].
        centres: displacement of each gear's centre from where it would be, x along the line of the axes towards the
            driven gear, y ahead [m].
        carried: change of the driven gear's displacement with its angle [m/rad].
    """

    driver: Array
    driven: Array
    centres: tuple[tuple[Array, Array], tuple[Array, Array]]
    carried: tuple[Array, Array]


class _Lines:
    """The normals of both pitch curves' flanks at two parameters, wherever the gears are.

    Args:
        curves: the pitch curves.
        placed: where the gears are.
        side: 1 for drive flanks, -1 for back flanks.
        own, other: parameter of the driver's and of the driven gear's pitch curve [rad].
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
        """Change of both conditions with both parameters."""
        sine = jnp.sin(self.curves.pressure_angle)
        turns, other = 1 + self.at.lean_rate, self.beyond.ratio - self.beyond.lean_rate
        return turns, other, -self.at.speed * sine - self.along * turns, self.beyond.speed * sine

    def stepped(self, slopes: tuple[Array, Array, Array, Array]) -> tuple[Array, Array]:
        """Parameters after a step of Newton's method to where both normals have one direction and lie on one line."""
        first = self.lean - self.beyond.lean - self.ahead
        second = self.apart[0] * self.normal[1] - self.apart[1] * self.normal[0]
        a, b, c, d = slopes
        whole = a * d - b * c
        steps = (d * first - b * second) / whole, (a * second - c * first) / whole
        own, other = (at - jnp.clip(step, -FURTHEST, FURTHEST) for at, step in zip(self.place, steps, strict=True))
        return own, other

    @property
    def distance(self) -> tuple[Array, Array]:
        """Of the flanks on that line, and its change with the driven gear's angle."""
        passed = self.side * jnp.cos(self.curves.pressure_angle) * self.curves.between(*self.place)
        (x, y), (carried_x, carried_y) = self.normal, self.placed.carried
        return self.along + passed, (self.arm[1] + carried_x) * x + (self.arm[0] + carried_y) * y
