"""Non-circular gears on parallel axes: elliptic gears (Dong et al. 2020), and gears with a tabulated ratio."""

import abc
import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, is_concrete, nearest
from gearjax.contact import BodyView, Layout, Moved, Movements, Pose, Request
from gearjax.evaluate import evaluated
from gearjax.geometry import ratio_function, ratio_table
from gearjax.geometry.noncircular import AbstractRatio, EllipseRatio, PitchCurves, Placed, TabulatedRatio
from gearjax.geometry.noncircular_outline import Teeth, tooth_points
from gearjax.geometry.noncircular_teeth import closing_centre_distance, closing_eccentricity, faults
from gearjax.parameters import angle, check_parameters, count, length, name, number, series
from gearjax.sketch import ANTICLOCKWISE, CLOCKWISE, Sketch, SketchedBody
from gearjax.systems.base import AbstractSystem
from gearjax.typing import Array, Float, Number, Scalar

DRIVER, DRIVEN = "driver", "driven"
CURVE = 8.0  # cycles per lobe, up to which pitch curves and errors together have noticeable harmonics
CLOSES = 1e-4  # relative error of the perimeter that rounded numbers may cause
CORNERS = 181  # of a pitch curve in a sketch
FEWEST = 8  # fewest values of a table
BACKWARDS = (
    "gears that turn backwards turn forwards, seen from behind: give the size of the speed, phases of opposite sign, "
    "and a table of ratios in reverse (its first value stays first)"
)


class AbstractNoncircularPair(AbstractSystem):
    """Common base of all pairs of non-circular gears, independent of the shape of their pitch curves.

    One contact represents all driving flanks and a second one all back flanks. The flanks of one side are parallel
    curves, so that all teeth have the same gap (`gearjax.geometry.noncircular`). Levers and pressure angles change with
    the input angle.

    Bodies: ``driver`` and ``driven``. The phase of the driver is counted from the line of the axes, in the direction
    towards the driven gear; the phase of the driven gear from the same line, in the direction away from the driver.
    Both phases are positive in the sense in which the gear turns. Supports: x points along that line from the driver
    to the driven gear, y in the direction in which the teeth move at the mesh.
    """

    teeth: eqx.AbstractVar[int]
    module: eqx.AbstractVar[Array]
    pressure_angle: eqx.AbstractVar[Array]
    addendum: eqx.AbstractVar[Array]
    driver_lobes: eqx.AbstractVar[int]
    driven_lobes: eqx.AbstractVar[int]
    centre_distance: eqx.AbstractVar[Array | None]
    centre_distance_error: eqx.AbstractVar[Array | None]
    clearance: eqx.AbstractVar[str]

    @property
    @abc.abstractmethod
    def ratio_function(self) -> AbstractRatio:
        """Angle of the driven gear as a function of the driver's angle."""

    def _check(self) -> None:
        """Refuse gears whose pitch curves do not close, or that do not mesh.

        Raises:
            ParameterError: a value is wrong; the message names values that would be right.
        """
        check_parameters(self)
        driven = self.teeth * self.driven_lobes
        if driven % self.driver_lobes:
            words = f"the driven gear would have {driven / self.driver_lobes:.6g} teeth, must be a whole number"
            multiple = self.driver_lobes // math.gcd(self.driver_lobes, self.driven_lobes)
            raise ParameterError("teeth", self.teeth, f"{words}: give a multiple of {multiple}")
        self._check_ratio()
        shape = self.ratio_function, self.module, self.pressure_angle, self.addendum, self.centre_distance
        if not is_concrete(shape):
            return
        curves = evaluated(_ready, self)
        with jax.ensure_compile_time_eval():  # the check needs numbers even inside a traced function
            self._check_closure()
            for key, shown, words in faults(curves, float(self.module), float(self.addendum)):
                raise ParameterError(key, shown, words)

    def _check_ratio(self) -> None:
        """Refuse a ratio function of one's own whose pitch curves do not close."""
        ratio = self.ratio_function
        if isinstance(ratio, EllipseRatio | TabulatedRatio):
            return
        words = ratio_function.shape_fault(ratio)
        if words is not None:
            raise ParameterError("ratio_function", ratio, words)
        if is_concrete(ratio):
            numbers = evaluated(ratio_function.sampled, ratio)
            for words in ratio_function.faults(ratio, (self.driver_lobes, self.driven_lobes), numbers):
                raise ParameterError("ratio_function", ratio, words)

    def _check_closure(self) -> None:
        """Refuse pitch curves whose length is not the sum of the pitches of their teeth."""
        if self.centre_distance is None:
            return
        right, given = float(evaluated(_closing, self)), float(self.centre_distance)
        if abs(given / right - 1) <= CLOSES:
            return
        long = math.pi * float(self.module) * self.teeth
        module = float(self.module) * given / right
        ways = [f"centre_distance = {_mm(right)}", f"module = {_mm(module)}"]
        ratio = self.ratio_function
        if isinstance(ratio, EllipseRatio):
            numbers = self.teeth, float(self.module), float(self.pressure_angle)
            other = closing_eccentricity(ratio, given, *numbers)
            ways += [] if other is None else [f"eccentricity = {other:.8g}"]
        words = f"the driver's pitch curve is {_mm(long * given / right)} long, its {self.teeth} teeth {_mm(long)}"
        raise ParameterError("centre_distance", _mm(given), f"{words}: it closes with {' or '.join(ways)}")

    @property
    def curves(self) -> PitchCurves:
        """The pitch curves, without errors."""
        ratio, distance = self.ratio_function, self.centre_distance
        if distance is None:
            distance = closing_centre_distance(ratio, self.teeth, self.module)
        return PitchCurves(ratio, distance, self.pressure_angle)

    @property
    def bodies(self) -> tuple[str, ...]:
        return DRIVER, DRIVEN

    @property
    def coordinates(self) -> Mapping[str, tuple[str, ...]]:
        return dict.fromkeys(self.bodies, ("x", "y"))

    @property
    def orders(self) -> Mapping[str, float]:
        lobes = float(self.driver_lobes)
        output = lobes / self.driven_lobes
        return {"output": output, "driver": 1.0, "lobe": lobes, "curve": CURVE * lobes, "mesh": float(self.teeth)}

    def output(self, theta: Scalar) -> Scalar:
        return self.ratio_function.driven_angle(theta)

    def sketch(self) -> Sketch:
        turn = np.linspace(0.0, 2 * math.pi, CORNERS)
        driver, _, _, distance = (np.asarray(part) for part in _pitch(self, jnp.asarray(turn)))
        _, driven, turned, _ = (
            np.asarray(part) for part in _pitch(self, jnp.asarray(turn * self.driven_lobes / self.driver_lobes))
        )

        def closed(radius: np.ndarray, angle: np.ndarray, x: float) -> tuple[tuple[float, float], ...]:
            points = np.stack([x + radius * np.cos(angle) / distance, radius * np.sin(angle) / distance], axis=1)
            return tuple(map(tuple, points.tolist()))

        # the point of a gear that rolls through the pitch point later lies behind it on the gear
        first = SketchedBody(DRIVER, turns=ANTICLOCKWISE, outline=closed(driver, -turn, 0.0))
        outline = closed(driven, math.pi + turned, 1.0)
        second = SketchedBody(DRIVEN, (1.0, 0.0), sense=CLOCKWISE, turns=CLOCKWISE, outline=outline)
        pitch = (float(driver[0] / distance), 0.0), DRIVER
        return Sketch((first, second), (pitch,), (), ((1.0, 0.0), 0.25, CLOCKWISE))

    @property
    def cycle(self) -> float:
        return 2 * math.pi * self.driven_lobes / math.gcd(self.driver_lobes, self.driven_lobes)

    def choices(self) -> Mapping[str, AbstractSystem]:
        return {f'clearance = "{name}"': dataclasses.replace(self, clearance=name) for name in ("linear", "exact")}

    def contact_name(self, contact: int) -> str:
        return f"the {('driving', 'back')[contact]} flanks"

    def layout(self, request: Request) -> Layout:
        return Layout.of_flanks(1, request.back)

    def _side(self, request: Request, dtype: jnp.dtype) -> Float[Array, " contact"]:
        return jnp.asarray(self.layout(request).side, dtype)

    def pose(self, theta: Scalar, request: Request) -> Pose:
        curves, side = self.curves, self._side(request, theta.dtype)
        at = curves.at(theta)
        slant = curves.pressure_angle + side * at.lean
        sine, cosine = jnp.sin(slant), jnp.cos(slant)
        columns = [-side * at.driven_radius * cosine]
        for coordinate in request.coordinates:
            body, _, way = coordinate.partition(".")
            along = sine if way == "x" else side * cosine
            columns.append(along if body == DRIVER else -along)
        gap = jnp.zeros_like(side)
        if self.centre_distance_error is not None:
            gap = gap + self.centre_distance_error * sine
        views = {}
        for body in request.bodies:
            self._check_body(body)
            place = side * slant if body == DRIVER else -side * slant
            views[body] = BodyView(self._turn(body, theta), place, -side)
        mesh = None
        if request.mesh:
            mesh = (2 * math.pi * self.teeth * curves.turns(theta))[None]
        return Pose(theta, jnp.stack(columns, axis=1), gap, views, mesh)

    def _turn(self, body: str, theta: Scalar) -> Scalar:
        return theta if body == DRIVER else self.output(theta)

    def _check_body(self, body: str) -> None:
        if body not in self.bodies:
            raise ParameterError("body", body, nearest(body, self.bodies))

    def teeth_of(self, body: str, points: int, backlash: float) -> list[np.ndarray]:
        """Smooth pieces of a gear's outline (`gearjax.systems.GearOutlines`)."""
        self._check_body(body)
        number = self.teeth, self.teeth * self.driven_lobes // self.driver_lobes
        teeth = Teeth(evaluated(_ready, self), number, float(self.module), float(self.addendum), backlash)
        return tooth_points(teeth, self.bodies.index(body), points)

    @property
    def exact(self) -> bool:
        return self.clearance == "exact"

    def movements(self, body: str, theta: Scalar, request: Request) -> Movements:
        self._check_body(body)
        ones = jnp.ones_like(self._side(request, theta.dtype))
        ahead, turn = 1.0 if body == DRIVER else -1.0, self._turn(body, theta)
        x = BodyView(turn, 0.5 * math.pi * ones, ones)
        return Movements(x=x, y=BodyView(turn, 0.0 * ones, ahead * ones))

    def displaced_gaps(
        self, theta: Scalar, moved: Mapping[str, Moved], position: Scalar, request: Request
    ) -> tuple[Float[Array, " contact"], Float[Array, " contact"]]:
        side = self._side(request, theta.dtype)
        nothing = jnp.zeros_like(side)
        still = Moved(nothing, nothing, nothing, nothing)
        driver, driven = moved.get(DRIVER, still), moved.get(DRIVEN, still)
        sine, cosine = jnp.sin(position), jnp.cos(position)  # the eccentric centre of the driven gear turns with it
        x, y = driven.x * cosine + driven.y * sine, driven.y * cosine - driven.x * sine
        if self.centre_distance_error is not None:
            x = x + self.centre_distance_error
        # the driven gear turns clockwise, from x to -y
        carried = driven.y * cosine - driven.x * sine, -driven.x * cosine - driven.y * sine
        centres = (driver.x, driver.y), (x, y)
        # whole turns of the driver change no gap; a small position would lose digits beside a large angle
        within = theta - 2 * math.pi * jnp.round(theta / (2 * math.pi))
        placed = Placed(within, self.output(within) + position, centres, carried)
        gaps, rates = self.curves.displaced_gaps(placed, side)
        return gaps + driver.gap + driven.gap, rates


def _ready(system: AbstractNoncircularPair) -> PitchCurves:
    return system.curves


@eqx.filter_jit
def _pitch(system: AbstractNoncircularPair, t: Array) -> tuple[Array, Array, Array, Array]:
    """Radii of the pitch point on both gears, angle of the driven gear, and distance of the axes."""
    curves = system.curves
    at = curves.at(t)
    return at.radius, at.driven_radius, curves.ratio.driven_angle(t), curves.centre_distance


def _closing(system: AbstractNoncircularPair) -> Scalar:
    return closing_centre_distance(system.ratio_function, system.teeth, system.module)


class EllipticPair(AbstractNoncircularPair):
    """Two elliptic gears, each turning about a focus (Dong et al. 2020, eqs. 1 and 8), or gears with several lobes.

    The pitch curve of the driver is ``r1 = p / (1 - e cos(n t))``: with one lobe an ellipse about a focus, with two
    lobes an oval. Both gears are alike if they have the same number of lobes. At input angle zero the largest radius of
    the driver points at the driven gear.

    Args:
        teeth: tooth number of the driver; the driven gear has ``teeth * driven_lobes / driver_lobes`` teeth.
        module: module of the rack that cuts the gears [m].
        eccentricity: eccentricity e of the driver's pitch curve, which is a shape and not an error [-].
        pressure_angle: pressure angle alpha0 of the rack [rad].
        input_speed: speed of the driver [rad/s].
        driver_lobes: number of lobes of the driver's pitch curve.
        driven_lobes: number of lobes of the driven gear's pitch curve.
        centre_distance: distance of the axes without errors [m]; ``None`` for the distance at which the driver's pitch
            curve is ``pi m z`` long.
        centre_distance_error: actual distance of the axes minus the distance that the pitch curves need [m].
        addendum: height of the teeth above the pitch curves, in modules [-].
        clearance: how gaps and levers are calculated. ``"linear"`` is to first order in the errors. ``"exact"`` uses
            the common normals of the displaced gears; at run-outs of 50 um the first order differs from it by up to
            0.2 % of the peak-to-peak TE and 0.4 % of the largest TE. In motion, ``"exact"`` holds at the ideal position
            of the output.

    Raises:
        ParameterError: a value is not physical; the pitch curves do not close (the message gives numbers that close
            them); or the gears lock themselves, are undercut or pointed, or lose contact.
    """

    kind: ClassVar[str] = "elliptic_pair"
    size_of_teeth: ClassVar[str] = "module"

    teeth: int = count(at_least=3, at_most=2000, example=47)
    module: Number = length(at_least=1e-6, at_most=1.0, example="3 mm")
    eccentricity: Number = number(units.RATIO, at_least=0.0, below=1.0, example=0.3287)
    input_speed: Number = number(units.ANGULAR_SPEED, at_least=1e-9, at_most=1e6, example="600 rpm", negative=BACKWARDS)
    pressure_angle: Number = angle(above=0.0, below=math.pi / 4, default=20 * units.deg)
    driver_lobes: int = count(default=1, at_most=12)
    driven_lobes: int = count(default=1, at_most=12)
    centre_distance: Number | None = length(at_least=1e-6, at_most=100.0, default=None, example="145 mm")
    centre_distance_error: Number | None = length(at_least=-1e-2, at_most=1e-2, default=None, example="20 um")
    addendum: Number = number(units.RATIO, above=0.0, at_most=3.0, default=1.0)
    clearance: str = name(default="linear", names=("linear", "exact"))

    def __check_init__(self):
        self._check()

    @property
    def ratio_function(self) -> AbstractRatio:
        return EllipseRatio(
            eccentricity=self.eccentricity, driver_lobes=self.driver_lobes, driven_lobes=self.driven_lobes
        )


class NoncircularPair(AbstractNoncircularPair):
    """Two non-circular gears whose ratio is given by a table, through which a periodic spline of fifth degree is laid.

    Args:
        teeth: tooth number of the driver; the driven gear has ``teeth * driven_lobes / driver_lobes`` teeth.
        module: module of the rack that cuts the gears [m].
        ratio: ratio ``dt2/dt`` of the driven gear's speed to the driver's speed, at even steps of the driver's angle
            over one lobe, the first at input angle zero, shape (value,) [-]. The mean must be
            ``driver_lobes / driven_lobes``, so that the driven gear's pitch curve closes; a deviation of the mean up to
            0.1 % is taken as rounding and scaled away.
        pressure_angle: pressure angle alpha0 of the rack [rad].
        input_speed: speed of the driver [rad/s].
        driver_lobes: number of lobes of the driver's pitch curve.
        driven_lobes: number of lobes of the driven gear's pitch curve.
        centre_distance: distance of the axes without errors [m]; ``None`` for the distance at which the driver's pitch
            curve is ``pi m z`` long.
        centre_distance_error: actual distance of the axes minus the distance that the pitch curves need [m].
        addendum: height of the teeth above the pitch curves, in modules [-].
        clearance: how gaps and levers are calculated. ``"linear"`` is to first order in the errors. ``"exact"`` uses
            the common normals of the displaced gears; at run-outs of 50 um the first order differs from it by up to
            0.2 % of the peak-to-peak TE and 0.4 % of the largest TE. In motion, ``"exact"`` holds at the ideal position
            of the output.

    Raises:
        ParameterError: as for `EllipticPair`; or the table is too short or has a corner, or a pitch curve stays open.
    """

    kind: ClassVar[str] = "noncircular_pair"
    size_of_teeth: ClassVar[str] = "module"

    teeth: int = count(at_least=3, at_most=2000, example=48)
    module: Number = length(at_least=1e-6, at_most=1.0, example="3 mm")
    ratio: Float[Array, " value"] = series(
        units.RATIO, above=0.0, at_most=100.0, example=[1.4, 1.28, 1.0, 0.72, 0.6, 0.72, 1.0, 1.28]
    )
    input_speed: Number = number(units.ANGULAR_SPEED, at_least=1e-9, at_most=1e6, example="600 rpm", negative=BACKWARDS)
    pressure_angle: Number = angle(above=0.0, below=math.pi / 4, default=20 * units.deg)
    driver_lobes: int = count(default=1, at_most=12)
    driven_lobes: int = count(default=1, at_most=12)
    centre_distance: Number | None = length(at_least=1e-6, at_most=100.0, default=None, example="145.28 mm")
    centre_distance_error: Number | None = length(at_least=-1e-2, at_most=1e-2, default=None, example="20 um")
    addendum: Number = number(units.RATIO, above=0.0, at_most=3.0, default=1.0)
    clearance: str = name(default="linear", names=("linear", "exact"))

    def __check_init__(self):
        check_parameters(self)
        if jnp.ndim(self.ratio) != 1 or self.ratio.shape[0] < FEWEST:
            words = f"must be a list of {FEWEST} values or more, at even steps over one lobe"
            raise ParameterError("ratio", self.ratio, words)
        if is_concrete(self.ratio):
            values = np.asarray(self.ratio)
            for words in ratio_table.faults(values, self.driver_lobes, self.driven_lobes):
                raise ParameterError("ratio", values, words)
        self._check()

    @property
    def ratio_function(self) -> AbstractRatio:
        return TabulatedRatio(values=self.ratio, driver_lobes=self.driver_lobes, driven_lobes=self.driven_lobes)


def _mm(given: float) -> str:
    return f"{given / units.mm:.8g} mm"
