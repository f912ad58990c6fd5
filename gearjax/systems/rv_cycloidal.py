"""RV (cycloidal) reducer: its pin stage, and optionally its involute first stage (Hu, Li, Zhu, Cui 2020)."""

import dataclasses
import math
from collections.abc import Mapping
from fractions import Fraction
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, is_concrete, nearest
from gearjax.contact import BodyView, Layout, Moved, Movements, Pose, Request, Rim
from gearjax.geometry.cycloid import Cycloid, Touch, curvature, gap, largest_offset, pin_distance, touch
from gearjax.geometry.first_stage import FirstStage
from gearjax.geometry.line_contact import Radii
from gearjax.parameters import angle, check_parameters, count, length, name, number
from gearjax.sketch import Sketch, SketchedBody, on_cranks
from gearjax.structure import Orbit
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar


class RVCycloidal(AbstractSystem):
    """Cycloidal discs that roll in a fixed ring of pins and turn the output; each disc has one tooth fewer than pins.

    Every pin is a candidate contact of every disc. Its lever is ``J = r_c L`` with L of Hu et al. (2020), eq. 36; the
    sign of L states which flank touches. The disc turns against the crank. Pins ahead of the throw (L < 0) therefore
    carry a load that resists the output, and pins behind the throw carry a load that drives it. The discs are spaced
    evenly around the crank: disc i is where disc 1 will be ``(i - 1) / discs`` of a turn of the crank later.

    With a first stage, the input is its sun, which turns the cranks through planet wheels on the output. Without a
    first stage, the input is the crank. While the sun is held, the cranks turn by ``1 + z_1 / z_2`` per turn of the
    output, so that a contact has the lever ``J = a (z_p + z_1 / z_2) L``.

    Bodies: ``disc_1``, ``disc_2``, ...: the run-out turns with the disc; its phase is counted from the throw while the
    throw points at the first pin. ``throw``: error of the throw of all cranks; phase 0 lengthens the throw.
    ``pin_ring``: fixed; its phase is counted from the first pin. These phases count in the direction in which the crank
    turns, that of a disc too, which turns against it. ``sun``, ``planet``: gears of the first stage; the phase is
    counted from the line of action of that stage, and a run-out whose sine is positive turns the cranks ahead.

    A disc may have a support on its cranks. Its x points along the throw. Its y points across the throw, in the
    direction in which the crank turns.

    Args:
        pins: number of pins.
        pin_circle: radius of the circle of pin centres, r_p [m].
        pin_radius: radius of a pin, r_rp [m].
        eccentricity: throw of the cranks, a [m].
        isometric_modification: isometric (equidistant) modification of the profile; positive removes material [m].
        shifting_modification: change of the radius of the pin circle that the profile is generated from [m].
        input_speed: speed of the sun, or of the crank if there is no first stage [rad/s].
        discs: number of discs.
        thickness_modification: material removed from both flanks along the pin circle, or ``None`` [m]. It opens the
            gaps by ``K modification |L| / 2``, an interpretation of the paper's modification of the cumulative error.
        clearance: how gaps and levers are calculated. ``"linear"`` is to first order in modification and errors.
            ``"exact"`` uses the foot of the normal of each displaced pin on its displaced and turned disc. First order
            is accurate for positions of the output (some 0.01 arcmin at errors of some um), but changes single pin
            forces by 3 to 18 % of the largest force.
        sun_teeth: tooth number of the sun of the first stage; give all numbers of the first stage or none.
        planet_teeth: tooth number of the planet wheels of the first stage; give all numbers of that stage or none.
        first_stage_module: module of the first stage; give all numbers of that stage or none [m].
        first_stage_pressure_angle: pressure angle of the rack of the first stage [rad].

    Raises:
        ParameterError: a value is not physical, or the profile would be undercut.
    """

    kind: ClassVar[str] = "rv_cycloidal"
    size_of_teeth: ClassVar[str] = "pin_radius"
    has_radii: ClassVar[bool] = True
    by_constant_modes: ClassVar[bool] = True

    pins: int = count(at_least=3, at_most=1000, example=40)
    pin_circle: Number = length(at_least=1e-6, at_most=100.0, example="76 mm")
    pin_radius: Number = length(at_least=1e-9, at_most=100.0, example="3 mm")
    eccentricity: Number = length(at_least=1e-9, at_most=100.0, example="1.5 mm")
    isometric_modification: Number = length(at_least=-1e-2, at_most=1e-2, example="-22 um")
    shifting_modification: Number = length(at_least=-1e-2, at_most=1e-2, example="-43.7 um")
    input_speed: Number = number(units.ANGULAR_SPEED, at_least=1e-9, at_most=1e6, example="1170 rpm")
    discs: int = count(default=2, at_most=4)
    thickness_modification: Number | None = length(at_least=-1e-2, at_most=1e-2, default=None)
    clearance: str = name(default="linear", names=("linear", "exact"))
    sun_teeth: int | None = count(default=None, example=22)
    planet_teeth: int | None = count(default=None, example=60)
    first_stage_module: Number | None = length(at_least=1e-6, at_most=1.0, default=None, example="1.25 mm")
    first_stage_pressure_angle: Number = angle(above=0.0, below=math.pi / 4, default=20 * units.deg)

    def __check_init__(self):
        check_parameters(self)
        _ = self._first_stage
        profile = self.profile
        if not is_concrete(profile):
            return
        short = max(float(profile.short_width), float(profile.modified_short_width))
        if short >= 1:
            largest = float(self.pin_circle + jnp.minimum(self.shifting_modification, 0.0)) / self.pins
            words = f"looped profile, eccentricity * pins must be below pin_circle: at most {largest / units.mm:.6g} mm"
            raise ParameterError("eccentricity", f"{float(self.eccentricity) / units.mm:.6g} mm", words)
        circle = float(self.pin_circle + self.shifting_modification)
        largest = largest_offset(self.pins, circle, float(profile.modified_short_width))
        largest -= float(self.isometric_modification)
        if float(self.pin_radius) >= largest:
            words = f"undercuts the disc: must be below {largest / units.mm:.6g} mm"
            raise ParameterError("pin_radius", f"{float(self.pin_radius) / units.mm:.6g} mm", words)
        spacing = float(self.pin_circle) * math.sin(math.pi / self.pins)
        if float(self.pin_radius) >= spacing:
            words = f"pins overlap: must be below {spacing / units.mm:.6g} mm"
            raise ParameterError("pin_radius", f"{float(self.pin_radius) / units.mm:.6g} mm", words)

    @property
    def profile(self) -> Cycloid:
        """Profile of the discs, with the pins."""
        return Cycloid(
            self.pins,
            self.pin_circle,
            self.pin_radius,
            self.eccentricity,
            self.isometric_modification,
            self.shifting_modification,
        )

    @property
    def ratio(self) -> Fraction:
        """Turns of the input per turn of the output: ``1 + z_2 z_p / z_1`` with a first stage, ``z_c`` without one."""
        first = self._first_stage
        return Fraction(self.pins - 1) if first is None else first.ratio(Fraction(self.pins))

    @property
    def _first_stage(self) -> FirstStage | None:
        numbers = self.sun_teeth, self.planet_teeth, self.first_stage_module, self.first_stage_pressure_angle
        return FirstStage.of(*numbers)

    @property
    def tip_clearance(self) -> Scalar:
        """Radial gap at the tips and roots of the teeth [m]."""
        return self.isometric_modification - self.shifting_modification

    @property
    def bodies(self) -> tuple[str, ...]:
        first = () if self.sun_teeth is None else ("sun", "planet")
        return *(f"disc_{i + 1}" for i in range(self.discs)), "throw", "pin_ring", *first

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return {f"disc_{i + 1}": ("x", "y") for i in range(self.discs)}

    @property
    def orbits(self) -> Mapping[str, Orbit]:
        # the output turns against the crank; with a first stage the crank turns along with the output
        return dict.fromkeys(self.coordinates, Orbit(self.orders["crank"], self.eccentricity, -self.with_output))

    @property
    def orders(self) -> Mapping[str, float]:
        crank = (self.pins - 1) / self.ratio
        # "pin" repeats the order of "mesh", because steps and blocks resolve the fastest order except the mesh
        orders = {"output": 1 / self.ratio, "crank": crank, "pin": crank * self.pins, "mesh": crank * self.pins}
        if self.sun_teeth is not None:
            orders |= {"sun": 1 - 1 / self.ratio, "planet": self.pins / self.ratio}  # relative to the output
        return {name: float(order) for name, order in orders.items()}

    def choices(self) -> Mapping[str, AbstractSystem]:
        return {f'clearance = "{name}"': dataclasses.replace(self, clearance=name) for name in ("linear", "exact")}

    @property
    def told_of_forces(self) -> str | None:
        if self.exact:
            return None
        return (
            "forces of single pins are to first order in modification and errors, which changes them by 3 to 18 % of "
            'the largest force: clearance = "exact" uses the exact geometry'
        )

    def contact_name(self, contact: int) -> str:
        return f"pin {contact % self.pins + 1} on disc_{contact // self.pins + 1}"

    def sketch(self) -> Sketch:
        throws = tuple(2 * math.pi * i / self.discs for i in range(self.discs))
        discs = tuple(SketchedBody(f"disc_{i + 1}", zero=-throw / (self.pins - 1)) for i, throw in enumerate(throws))
        throw, ring = SketchedBody("throw"), SketchedBody("pin_ring", radius=1.0)
        first = (SketchedBody(name, zero=None) for name in ("sun", "planet") if name in self.bodies)
        return on_cranks(discs, throws, (throw, ring, *first), mesh=False)

    @property
    def cycle(self) -> float:
        return 2 * math.pi * float(self.ratio * self.ratio.denominator)

    def _crank(self, theta: Scalar) -> Float[Array, " disc"]:
        """Angle of the throw of each disc from the first pin [rad]."""
        places = np.arange(self.discs) * (2 * math.pi / self.discs)
        return self.orders["crank"] * theta + jnp.asarray(places, theta.dtype)

    def _pins(self, dtype: jnp.dtype) -> Float[Array, " pin"]:
        return jnp.asarray(np.arange(self.pins) * (2 * math.pi / self.pins), dtype)

    def _angles(self, theta: Scalar) -> Float[Array, " contact"]:
        """Angle from each pin to the throw, disc by disc [rad]."""
        return (self._crank(theta)[:, None] - self._pins(theta.dtype)[None, :]).ravel()

    def _each(self, per_disc: Float[Array, " disc"]) -> Float[Array, " contact"]:
        """One value per contact from one value per disc."""
        return jnp.repeat(per_disc, self.pins, total_repeat_length=self.discs * self.pins)

    @property
    def with_output(self) -> Scalar:
        """Turns of the cranks per turn of the output while the input is held: ``1 + z_1 / z_2``, 0 without a first
        stage."""
        first = self._first_stage
        return jnp.asarray(0.0 if first is None else first.with_output, self.eccentricity.dtype)

    @property
    def lever_radius(self) -> Scalar:
        """Largest lever of a contact on the output while the input is held: ``a z_c`` under a held crank,
        ``a (z_p + z_1 / z_2)`` under a held sun [m]."""
        return self.eccentricity * (self.pins - 1 + self.with_output)

    @property
    def exact(self) -> bool:
        return self.clearance == "exact"

    def layout(self, request: Request) -> Layout:
        return Layout.either(self.discs * self.pins)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        profile, angles = self.profile, self._angles(theta)
        at = touch(profile.short_width, angles)
        views = {body: self._view(body, theta, at) for body in request.bodies}
        mesh, radii = None, None
        if request.mesh:
            mesh = jnp.broadcast_to(self.orders["mesh"] * theta, angles.shape)
        if request.radii:
            curved = curvature(profile, angles)
            radii = Radii(jnp.broadcast_to(self.pin_radius, curved.shape), curved)
        jacobian = (self.lever_radius * at.lever)[:, None]
        if request.coordinates:
            moving = [self._moving(coordinate, at) for coordinate in request.coordinates]
            jacobian = jnp.stack([jacobian[:, 0], *moving], axis=1)
        return Pose(theta, jacobian, self._thinned(gap(profile, angles), at), views, mesh, radii)

    def _thinned(self, open_by: Array, at: Touch) -> Array:
        """Gaps including the gap of the thickness modification [m]."""
        if self.thickness_modification is None:
            return open_by
        return open_by + 0.5 * self.profile.short_width * self.thickness_modification * jnp.abs(at.lever)

    def movements(self, body: str, theta: Scalar, request: Request) -> Movements:
        del request  # every pin may touch both flanks, so that no back flanks are requested
        self._check_body(body)
        nothing = jnp.zeros((self.discs * self.pins,), theta.dtype)
        ones, still, quarter = nothing + 1, jnp.zeros_like(theta), nothing + 0.5 * math.pi
        if body == "throw":  # x is along the throw, y across it
            return Movements(x=BodyView(still, quarter, ones), y=BodyView(still, nothing, ones))
        if body in ("sun", "planet"):
            return Movements(turn=BodyView(self.orders[body] * theta, nothing, ones / self._planet_radius))
        if body == "pin_ring":
            place = jnp.tile(self._pins(theta.dtype), self.discs)
            cosine, sine = jnp.cos(place), jnp.sin(place)
            x = BodyView(still, quarter, ones, Rim(place, cosine, -sine, self.pins))
            return Movements(x=x, y=BodyView(still, nothing, ones, Rim(place, sine, cosine, self.pins)))
        share, place = self._share(body, theta.dtype), self._place_on_disc(theta)

        def rim(outward: Array, around: Array) -> Rim:
            return Rim(place, outward, around, None, own=share)

        x = BodyView(still, quarter, share, rim(share * jnp.cos(place), nothing))
        y = BodyView(still, nothing, share, rim(share * jnp.sin(place), nothing))
        turn = BodyView(still, nothing, nothing, rim(nothing, share / self.pin_circle))
        return Movements(x=x, y=y, turn=turn)

    def displaced_gaps(
        self, theta: Scalar, moved: Mapping[str, Moved], position: Scalar, request: Request
    ) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        del request

        def gaps(position: Scalar) -> Float[Array, " contact"]:
            return self._gaps_at(theta, moved, position)

        return jax.jvp(gaps, (position,), (jnp.ones_like(position),))

    def _gaps_at(self, theta: Scalar, moved: Mapping[str, Moved], position: Scalar) -> Float[Array, " contact"]:
        """Gaps of displaced bodies, shape (contact,) [m].

        Whole turns of the output change no gap. They are left out, because a small position loses digits beside a large
        angle.
        """
        turn = 2 * math.pi * self.ratio
        theta = theta - turn * jnp.round(theta / turn)
        nothing = jnp.zeros((self.discs * self.pins,), theta.dtype)
        still = Moved(nothing, nothing, nothing, nothing)
        ring, throw = moved.get("pin_ring", still), moved.get("throw", still)
        sun, planet = moved.get("sun", still), moved.get("planet", still)
        crank = self._each(self._crank(theta))
        discs = [moved[f"disc_{i + 1}"] for i in range(self.discs) if f"disc_{i + 1}" in moved]
        # each disc's own displacement is zero at the contacts of the others
        disc = jax.tree.map(lambda *parts: sum(parts, nothing), *discs) if discs else still
        pins = jnp.tile(self._pins(theta.dtype), self.discs)
        psi = crank + sun.turn + planet.turn - self.with_output * position
        disc_turn = -crank / self.profile.teeth - position
        centre = _rotated(self.eccentricity + throw.x, throw.y, psi)
        off = _rotated(disc.x, disc.y, disc_turn)
        x = self.pin_circle * jnp.cos(pins) + ring.x - centre[0] - off[0]
        y = self.pin_circle * jnp.sin(pins) + ring.y - centre[1] - off[1]
        # turn each pin to the tooth of the first pin, where the trochoid begins
        seen = _rotated(x, y, -disc_turn - disc.turn - pins * (self.pins / self.profile.teeth))
        open_by = pin_distance(self.profile, seen, self._angles(theta)) + self.isometric_modification
        open_by = self._thinned(open_by, touch(self.profile.short_width, self._angles(theta)))
        return open_by + ring.gap + disc.gap

    def _moving(self, coordinate: str, at: Touch) -> Float[Array, " contact"]:
        """Change of overlap per displacement of a disc [-]."""
        body, _, direction = coordinate.partition(".")
        return -self._share(body, at.lever.dtype) * (at.along_throw if direction == "x" else at.lever)

    def _view(self, body: str, theta: Scalar, at: Touch) -> BodyView:
        """View of a displacement fixed on a body, from the lines of action."""
        self._check_body(body)
        profile = self.profile
        direction = jnp.arctan2(at.along_throw, at.lever)  # sine and cosine of the normal, seen from the throw
        ones, still = jnp.ones_like(direction), jnp.zeros_like(theta)
        short = profile.short_width
        if body == "throw":
            return BodyView(still, direction, ones)
        if body == "pin_ring":
            rim = Rim(jnp.tile(self._pins(theta.dtype), self.discs), at.outward, -short * at.lever, self.pins)
            return BodyView(still, direction - self._each(self._crank(theta)), -ones, rim)
        if body in ("sun", "planet"):
            # a crank that is turned ahead opens the gaps behind the throw
            influence = profile.throw * at.lever / self._planet_radius
            return BodyView(self.orders[body] * theta, jnp.zeros_like(direction), influence)
        share, place, crank = self._share(body, theta.dtype), self._place_on_disc(theta), self._each(self._crank(theta))
        around = share * short * profile.teeth / self.pins * at.lever
        rim = Rim(place, -share * at.outward, around, None, own=share)
        # the disc turns against the crank
        return BodyView(still, direction - crank * (self.pins / profile.teeth), share, rim)

    def _check_body(self, body: str) -> None:
        if body not in self.bodies:
            raise ParameterError("body", body, nearest(body, self.bodies))

    @property
    def _planet_radius(self) -> Scalar:
        """Base radius of the first stage's planet wheels [m]."""
        first = self._first_stage
        assert first is not None
        return first.planet_radius

    def _share(self, body: str, dtype: jnp.dtype) -> Float[Array, " contact"]:
        """One at the contacts of a disc, zero at the contacts of the other discs."""
        own = np.arange(self.discs) == int(body.removeprefix("disc_")) - 1
        return jnp.asarray(np.repeat(own, self.pins), dtype)

    def _place_on_disc(self, theta: Scalar) -> Float[Array, " contact"]:
        """Angle of each contact on its disc [rad]."""
        return jnp.tile(self._pins(theta.dtype), self.discs) + self._each(self._crank(theta)) / self.profile.teeth


def _rotated(x: Array, y: Array, angle: Array) -> tuple[Array, Array]:
    """A vector turned by an angle [rad]."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return x * cosine - y * sine, x * sine + y * cosine
