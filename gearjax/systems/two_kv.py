"""2K-V small-tooth-difference reducer (Wang, Su, Zou 2020)."""

import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, is_concrete, nearest
from gearjax.contact import BodyView, Layout, Pose, Request
from gearjax.geometry import FewTeethDifference, base_radius, internal_centre_distance
from gearjax.parameters import Named, angle, check_parameters, count, length, number
from gearjax.sketch import CLOCKWISE, Sketch, SketchedBody, on_cranks
from gearjax.structure import Orbit
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar


class TwoKV(AbstractSystem):
    """2K-V reducer: an external first stage on the carrier, then planet wheels that roll in a fixed ring.

    Pair i is planet wheel i in the ring; its line of action turns with the crank. The planet wheels are spaced evenly
    around the crank. The revolution is the way of the planet wheels around the axis, by the throw of the crank; its
    eccentricity and that of the output wheel act on pair i later than on pair 1, by ``(i - 1) / planets`` of a turn.
    The phase of a planet wheel is counted from its own line of action. The phase of an error adds to the angle of its
    body. At input angle zero this angle is minus the working pressure angle at the driving flank of pair 1, and plus
    the working pressure angle at its back flank.

    Relative to the line of action, planet wheels and revolution turn ``z_r / (z_r - z_p)`` times per turn of the output
    and the output wheel ``z_p / (z_r - z_p)`` times (26 and 25 for 50 and 52 teeth; Wang et al. 2020, eqs. 1-4).

    A planet wheel may have a support on its crank. Its x points along the throw, towards the mesh. Its y points across
    the throw, in the direction in which the crank turns.

    Args:
        sun_teeth: tooth number of the sun. The first stage has no errors: of its tooth numbers only the ratio counts.
        first_stage_planet_teeth: tooth number of the planet wheels of the first stage.
        planet_teeth: tooth number of the planet wheels of the second stage.
        ring_teeth: tooth number of the ring.
        module: module of the second stage [m].
        cutting_pressure_angle: pressure angle of the rack [rad].
        working_pressure_angle: working pressure angle of the second stage [rad].
        input_speed: speed of the sun [rad/s].
        te_radius: radius that turns a displacement along the line of action into an angle of the output [m], or the
            name of a formula with the base radii r_b3 of the ring and r_b2 of the planet wheel. ``"held_sun"`` is
            ``r_b3 + (r_b3 - r_b2) z_1 / z_2``, valid on a test bench whose input is held. ``"planet"`` is r_b2, as in
            most of Wang et al. (2020). ``"ring"`` is r_b3, as in their figure 13. The three differ by some 5 %.
        planets: number of planet wheels.

    Raises:
        ParameterError: a value is not physical.
    """

    kind: ClassVar[str] = "two_kv"
    size_of_teeth: ClassVar[str] = "module"

    sun_teeth: int = count(example=12)
    first_stage_planet_teeth: int = count(example=36)
    planet_teeth: int = count(at_least=2, example=50)
    ring_teeth: int = count(at_least=3, example=52)
    module: Number = length(at_least=1e-6, at_most=1.0, example="2.5 mm")
    cutting_pressure_angle: Number = angle(above=0.0, below=math.pi / 4, example="20 deg")
    working_pressure_angle: Number = angle(above=0.0, below=math.pi / 2, example="35.266 deg")
    input_speed: Number = number(units.ANGULAR_SPEED, at_least=1e-9, at_most=1e6)
    te_radius: Named | Number = length(at_least=1e-6, at_most=100.0, names=("planet", "ring", "held_sun"))
    planets: int = count(default=2, at_most=5)

    def __check_init__(self):
        check_parameters(self)
        if self.planet_teeth >= self.ring_teeth:
            raise ParameterError("planet_teeth", self.planet_teeth, f"must be below ring_teeth ({self.ring_teeth})")
        angles = self.cutting_pressure_angle, self.working_pressure_angle
        if is_concrete(angles) and float(angles[1]) < float(angles[0]) * (1 - 1e-6):
            raise ParameterError(
                "working_pressure_angle",
                f"{float(angles[1]) / units.deg:.6g} deg",
                f"must be from {float(angles[0]) / units.deg:.6g} deg to 90 deg: the centre distance a must be at "
                "least its standard value, with a cos(working) = module (ring_teeth - planet_teeth) cos(cutting) / 2",
            )

    @property
    def train(self) -> FewTeethDifference:
        """Kinematics of the two stages."""
        return FewTeethDifference(self.sun_teeth, self.first_stage_planet_teeth, self.planet_teeth, self.ring_teeth)

    @property
    def centre_distance(self) -> Scalar:
        """Working centre distance of the second stage: throw of the crank [m]."""
        return internal_centre_distance(
            self.ring_teeth - self.planet_teeth, self.module, self.cutting_pressure_angle, self.working_pressure_angle
        )

    @property
    def radius(self) -> Scalar:
        """Radius that turns line-of-action lengths into output angles [m]."""
        if not isinstance(self.te_radius, Named):
            return self.te_radius
        teeth = float(self.planet_teeth if self.te_radius.name == "planet" else self.ring_teeth)
        if self.te_radius.name == "held_sun":  # the crank turns by 1 + z_1 / z_2 per turn of the output
            teeth += (self.ring_teeth - self.planet_teeth) * self.sun_teeth / self.first_stage_planet_teeth
        return base_radius(teeth, self.module, self.cutting_pressure_angle)

    @property
    def bodies(self) -> tuple[str, ...]:
        return *(f"planet_{i + 1}" for i in range(self.planets)), "revolution", "output_wheel"

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return {f"planet_{i + 1}": ("x", "y") for i in range(self.planets)}

    @property
    def orbits(self) -> Mapping[str, Orbit]:
        # the lever is longer than the base radius because a crank that turns back with the output moves the planet back
        longer = self.radius - base_radius(self.planet_teeth, self.module, self.cutting_pressure_angle)
        follows = -longer / (self.centre_distance * jnp.cos(self.working_pressure_angle))
        orbit = Orbit(self.orders["crank"], self.centre_distance, follows)
        return dict.fromkeys(self.coordinates, orbit)

    @property
    def orders(self) -> Mapping[str, float]:
        train = self.train
        per_output_turn = {
            "output": 1,
            "crank": train.crank_to_frame,
            "planet": train.crank_to_output,
            "mesh": train.mesh,
        }
        return {name: float(order / train.ratio) for name, order in per_output_turn.items()}

    def contact_name(self, contact: int) -> str:
        flank = "back" if contact >= self.planets else "driving"
        return f"the {flank} flank of planet_{contact % self.planets + 1}"

    def sketch(self) -> Sketch:
        throws = tuple(-2 * math.pi * i / self.planets for i in range(self.planets))
        # relative to the throw a planet wheel turns clockwise, and phase zero is away from the mesh
        planets = tuple(
            SketchedBody(f"planet_{i + 1}", zero=throw + math.pi, sense=CLOCKWISE) for i, throw in enumerate(throws)
        )
        central = (SketchedBody(name, zero=math.pi, sense=CLOCKWISE) for name in ("revolution", "output_wheel"))
        return on_cranks(planets, throws, tuple(central))

    @property
    def cycle(self) -> float:
        return 2 * math.pi * float(self.train.ratio * self.train.cycle)

    def layout(self, request: Request) -> Layout:
        return Layout.of_flanks(self.planets, request.back)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        layout, radius = self.layout(request), self.radius
        jacobian = jnp.asarray(-np.array(layout.side), radius.dtype)[:, None] * radius
        if request.coordinates:
            moving = [self._moving(coordinate, layout) for coordinate in request.coordinates]
            jacobian = jnp.stack([jacobian[:, 0], *moving], axis=1)
        views = {body: self._view(body, theta, layout) for body in request.bodies}
        mesh = jnp.broadcast_to(self.orders["mesh"] * theta, (self.planets,)) if request.mesh else None
        return Pose(theta, jacobian, jnp.zeros((len(layout.side),), jacobian.dtype), views, mesh)

    def _view(self, body: str, theta: Scalar, layout: Layout) -> BodyView:
        """View of a displacement fixed on a body, from the lines of action."""
        if body not in self.bodies:
            raise ParameterError("body", body, nearest(body, self.bodies))
        order = self.orders["crank" if body == "output_wheel" else "planet"]
        side, planet = np.array(layout.side), np.array(layout.pair)
        dtype = self.working_pressure_angle.dtype
        if body.startswith("planet_"):
            behind, seen = np.zeros(len(side)), planet == int(body.removeprefix("planet_")) - 1
        else:
            behind, seen = planet * (2 * math.pi / self.planets), np.ones(len(side))
        place = jnp.asarray(-side, dtype) * self.working_pressure_angle - jnp.asarray(behind, dtype)
        # by the addition theorem from the sine of one number: XLA would compute the sines of all places again at every
        # input angle
        sine, cosine = jnp.sin(self.working_pressure_angle), jnp.cos(self.working_pressure_angle)
        ahead, across = jnp.asarray(np.cos(behind), dtype), jnp.asarray(np.sin(behind), dtype)
        flank = jnp.asarray(side, dtype)
        of_place = -(flank * ahead * sine + across * cosine), ahead * cosine - flank * across * sine
        return BodyView(order * theta, place, jnp.asarray(-side * seen, dtype), of_place=of_place)

    def _moving(self, coordinate: str, layout: Layout) -> Float[Array, " contact"]:
        """Change of overlap per displacement of a planet wheel [-]."""
        body, _, direction = coordinate.partition(".")
        side = np.array(layout.side)
        own = np.array(layout.pair) == int(body.removeprefix("planet_")) - 1
        if direction == "x":
            return jnp.asarray(1.0 * own, self.module.dtype) * jnp.sin(self.working_pressure_angle)
        return jnp.asarray(1.0 * side * own, self.module.dtype) * jnp.cos(self.working_pressure_angle)
