"""RV (cycloidal) reducer, its pin stage and optionally its involute first stage (Hu, Li, Zhu, Cui 2020)."""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, is_concrete, nearest
from gearjax.contact import BodyView, ContactFrame, Flank, Rim
from gearjax.geometry import base_radius
from gearjax.geometry.cycloid import Cycloid, curvature, exact_gap, gap, largest_offset, touch
from gearjax.geometry.line_contact import Radii
from gearjax.parameters import angle, check_parameters, count, length, name, number
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar


class RVCycloidal(AbstractSystem):
    """Cycloidal discs that roll in a fixed ring of pins and turn the output, one tooth fewer than pins.

    Every pin is a candidate contact of every disc, ``J = -r_c L`` with the lever of Hu et al. (2020), eq. 36; its sign
    tells which flank touches. Discs sit evenly around the crank: disc i is where disc 1 is ``(i - 1) / discs`` of a
    turn of the crank later. With a first stage the input is its sun, which turns the cranks through planet wheels on
    the output; without, the input is the crank.

    Bodies: ``disc_1``, ``disc_2``, ...: run-out turns with the disc, phase counted from the throw while the throw
    points at the first pin. ``throw``: of all cranks, phase 0 along the throw, which it lengthens.
    ``pin_ring``: fixed, phase counted from the first pin. ``sun``, ``planet``: of the first stage, counted from its
    line of action.

    Args:
        pins: number of pins.
        pin_circle: radius of the circle of pin centres, r_p [m].
        pin_radius: radius of a pin, r_rp [m].
        eccentricity: throw of the cranks, a [m].
        isometric_modification: of the profile, positive removes material [m].
        shifting_modification: of the pin circle that the profile is generated from [m].
        input_speed: of the sun, or of the crank without a first stage [rad/s].
        discs: number of discs.
        thickness_modification: material removed from both flanks along the pin circle, or ``None`` [m]: its gap is
            ``K modification |L| / 2``, a reading of the paper's modification of the cumulative error.
        clearance: ``"linear"``, the gap of the modification to first order, or ``"exact"``, by the foot of its normal.
        sun_teeth, planet_teeth, first_stage_module: of the first stage; all or none of them.
        first_stage_pressure_angle: [rad].

    Raises:
        ParameterError: a value is not physical, or the profile would be undercut.
    """

    kind: ClassVar[str] = "rv_cycloidal"
    two_sided: ClassVar[bool] = True

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
        first = {key: getattr(self, key) for key in ("sun_teeth", "planet_teeth", "first_stage_module")}
        missing = [key for key, value in first.items() if value is None]
        if 0 < len(missing) < len(first):
            raise ParameterError(missing[0], None, f"a first stage needs {', '.join(first)}: give all or none")
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
        """Profile of the discs, and the pins."""
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
        """Turns of the input per turn of the output: ``1 + z_2 z_p / z_1`` with a first stage, else ``z_c``."""
        if self.sun_teeth is None or self.planet_teeth is None:
            return Fraction(self.pins - 1)
        return 1 + Fraction(self.planet_teeth * self.pins, self.sun_teeth)

    @property
    def tip_clearance(self) -> Scalar:
        """Radial gap at the tips and roots of the teeth [m]."""
        return self.isometric_modification - self.shifting_modification

    @property
    def bodies(self) -> tuple[str, ...]:
        first = () if self.sun_teeth is None else ("sun", "planet")
        return *(f"disc_{i + 1}" for i in range(self.discs)), "throw", "pin_ring", *first

    @property
    def orders(self) -> Mapping[str, float]:
        crank = (self.pins - 1) / self.ratio
        # "pin" next to "mesh": steps and blocks resolve the fastest of all orders but the mesh
        orders = {"output": 1 / self.ratio, "crank": crank, "pin": crank * self.pins, "mesh": crank * self.pins}
        if self.sun_teeth is not None:
            orders |= {"sun": 1 - 1 / self.ratio, "planet": self.pins / self.ratio}  # seen from the output
        return {name: float(order) for name, order in orders.items()}

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
        return jnp.repeat(per_disc, self.pins, total_repeat_length=self.discs * self.pins)

    def frame(self, theta: Scalar, flank: Flank) -> ContactFrame:
        profile, angles = self.profile, self._angles(theta)
        at = touch(profile.short_width, angles)
        open_by = exact_gap(profile, angles) if self.clearance == "exact" else gap(profile, angles)
        if self.thickness_modification is not None:
            open_by = open_by + 0.5 * profile.short_width * self.thickness_modification * jnp.abs(at.lever)
        return ContactFrame((-profile.rolling_radius * at.lever)[:, None], open_by)

    def view(self, body: str, theta: Scalar, flank: Flank) -> BodyView:
        if body not in self.bodies:
            raise ParameterError("body", body, nearest(body, self.bodies))
        profile = self.profile
        at = touch(profile.short_width, self._angles(theta))
        direction = jnp.arctan2(at.along_throw, at.lever)  # sine and cosine of the normal, seen from the throw
        ones, still = jnp.ones_like(direction), jnp.zeros_like(theta)
        short = profile.short_width
        if body == "throw":
            return BodyView(still, direction, ones)
        if body == "pin_ring":
            rim = Rim(jnp.tile(self._pins(theta.dtype), self.discs), at.outward, -short * at.lever, self.pins)
            return BodyView(still, direction - self._each(self._crank(theta)), -ones, rim)
        if body in ("sun", "planet"):
            assert self.planet_teeth is not None
            assert self.first_stage_module is not None
            radius = base_radius(self.planet_teeth, self.first_stage_module, self.first_stage_pressure_angle)
            influence = profile.rolling_radius * at.lever / (self.pins * radius)  # an output that lags opens gaps
            return BodyView(self.orders[body] * theta, jnp.zeros_like(direction), influence)
        own = np.repeat(np.arange(self.discs) == int(body.removeprefix("disc_")) - 1, self.pins)
        share = jnp.asarray(own, theta.dtype)
        turn = self._crank(theta) / profile.teeth  # of the disc, against the crank
        place = jnp.tile(self._pins(theta.dtype), self.discs) + self._each(turn)
        rim = Rim(place, -share * at.outward, share * short * profile.teeth / self.pins * at.lever, None)
        return BodyView(still, direction - self._each(self._crank(theta) + turn), share, rim)

    def radii(self, theta: Scalar) -> Radii:
        """Radii of the line contacts, shape (contact,) [m], [1/m]."""
        curved = curvature(self.profile, self._angles(theta))
        return Radii(jnp.broadcast_to(self.pin_radius, curved.shape), curved)

    def mesh_angle(self, theta: Scalar) -> Float[Array, " contact"]:
        return jnp.broadcast_to(self.orders["mesh"] * theta, (self.discs * self.pins,))
