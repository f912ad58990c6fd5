"""Flanks and pitches of single teeth from a measuring machine (ISO 1328-1; Guo and Fang 2018)."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import ParameterError, is_concrete
from gearjax.contact import BodyView, GearSize, ProfilePlace, Rim
from gearjax.errors.base import AbstractError
from gearjax.errors.profile import profile_of
from gearjax.errors.rim import spread
from gearjax.geometry.spline import ENDS, GridSpline, surface
from gearjax.parameters import check_parameters, name, series
from gearjax.typing import Array, Float, Int, Number
from gearjax.units import mm

ON_FACE = 0.01  # share of half of the face width that places may lie beyond its ends
FLANKS = {"driving": 1, "back": -1}


class AbstractMeasured(AbstractError):
    """Measured deviations of driving flanks, back flanks or both."""

    on_rim: ClassVar[bool] = True
    deviations: ClassVar[tuple[str, ...]] = ("deviation",)
    deviation: eqx.AbstractVar[Number]
    flank: eqx.AbstractVar[str]

    def of_flank(self, place: ProfilePlace, gap: Float[Array, " contact"]) -> Float[Array, " contact"]:
        """Changes of gap at contacts on the flank that was measured, zero at contacts on the other flank."""
        if self.flank == "both":
            return gap
        if place.side is None:
            raise ParameterError("flank", self.flank, 'must be "both": contacts of this body have no known flank')
        return jnp.where(place.side == FLANKS[self.flank], gap, 0.0)

    def tells_of(self, flank: str) -> bool:
        """Whether the deviations apply to a flank, ``"driving"`` or ``"back"``."""
        return self.flank in (flank, "both")

    def check(self, size: Callable[[], GearSize | None]) -> None:
        super().check(size)
        gear = size()
        if gear is not None and is_concrete((self, tuple(gear))):
            self.check_places(gear)

    def check_places(self, gear: GearSize) -> None:
        """Refuse places and teeth that the gear does not have; raises as `check`."""
        del gear


class MeasuredFlank(AbstractMeasured):
    """Measured flanks: deviations on a grid over length of roll and face, for one tooth or several.

    Bicubic splines interpolate between the places of the grid (Guo and Fang 2018, section 2.1). A configuration may
    name a CSV file instead of roll, across, deviation and teeth: file = "pinion.csv", with the columns roll in mm,
    deviation in um and, if needed, across in mm, tooth and flank.

    If the values were measured from the involute, they contain the designed reliefs and crowning. In a configuration,
    ``contains = ["tip", "crowning"]`` with the names of these errors takes them out of the measured values, so that
    each counts once, and so that grades (`accuracy_grades`) are those of the deviations from the design.

    Beyond the grid, the deviation is the deviation at the nearest measured place. A tooth that was not measured has the
    mean of the measured teeth. With one place across the face, the profile is the same over the whole face. With one
    length of roll, the helix is the same at all heights.

    Args:
        body: gear that carries the error.
        roll: lengths of roll of the grid, counted from the base circle, in rising order, shape (row,) [m].
        across: places of the grid across the face, counted from its middle, in rising order along the axis about which
            the pinion turns, shape (column,) [m].
        deviation: material beyond the ideal flank, along the base tangent of a transverse section: one list of all
            teeth, rows and columns in this order, shape (tooth * row * column,), columns counting fastest [m].
        teeth: numbers of the measured teeth, from 0, in the order of ``deviation``. Without them, ``deviation`` has
            either one tooth, which counts for all teeth, or all teeth of the gear.
        flank: flanks that were measured: ``"driving"``, those that touch while the pinion drives, ``"back"``, the
            others, or ``"both"``.
        ends: end condition of the splines, ``"not_a_knot"``, or ``"double_vertices"`` as in the paper.
    """

    kind: ClassVar[str] = "measured_flank"
    body: str = name()
    roll: Number = series(units.LENGTH, at_least=0.0, at_most=10.0, example=["10 mm", "30 mm"])
    deviation: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["0 um", "2 um"])
    across: Number = series(units.LENGTH, at_least=-10.0, at_most=10.0, default=(0.0,), example=["0 mm"])
    teeth: Number = series(units.RATIO, at_least=0.0, at_most=1e5, default=(), example=[0])
    flank: str = name(default="both", names=("both", *FLANKS))
    ends: str = name(default=ENDS[0], names=ENDS)

    def __check_init__(self):
        check_parameters(self)
        for key in ("roll", "across"):
            places = getattr(self, key)
            if not places.size:
                raise ParameterError(key, "no values", "must have one or more")
            if is_concrete(places) and not (np.diff(np.asarray(places, float)) > 0).all():
                raise ParameterError(key, f"{places.size} values", "must increase from each value to the next")
        points = self.roll.size * self.across.size
        if not self.deviation.size or self.deviation.size % points:
            words = f"must be {self.roll.size} x {self.across.size} = {points} values per tooth, for roll and across"
            raise ParameterError("deviation", f"{self.deviation.size} values", words)
        if self.teeth.size not in (0, self.grids):
            raise ParameterError(
                "teeth", f"{self.teeth.size} values", f"must be {self.grids}, one per tooth of deviation"
            )
        if is_concrete(self.teeth) and len({*np.asarray(self.teeth).tolist()}) < self.teeth.size:
            raise ParameterError("teeth", f"{self.teeth.size} values", "must list each tooth once")

    @property
    def grids(self) -> int:
        """How many teeth were measured."""
        return self.deviation.size // (self.roll.size * self.across.size)

    @property
    def grid(self) -> Float[Array, "tooth row column"]:
        """Deviations by tooth, length of roll and place across the face [m]."""
        return self.deviation.reshape(self.grids, self.roll.size, self.across.size)

    def without(self, design: Sequence[AbstractError], gear: GearSize) -> "MeasuredFlank":
        """The measured deviations from the designed flank, which ISO 1328-1 grades, not from the involute.

        Add the designed modifications to the errors of the scene then: together they are what was measured.

        Args:
            design: modifications of the same gear that the measured values contain, such as `TipRelief` and `Crowning`.
            gear: sizes of the gear, from `AbstractSystem.gear_size`.

        Raises:
            ParameterError: an error is of another gear, or is no modification along the profile or across the face, or
                an argument is something else.
        """
        if not isinstance(gear, GearSize):
            raise ParameterError("gear", gear, f'must be sizes of a gear: system.gear_size("{self.body}")')
        if not isinstance(design, Sequence) or not all(isinstance(error, AbstractError) for error in design):
            raise ParameterError("design", design, "must be a list of modifications, such as [gj.TipRelief(...)]")
        roll, across = jnp.meshgrid(self.roll, self.across, indexing="ij")
        known = self.teeth if self.teeth.size else jnp.arange(self.grids, dtype=self.roll.dtype)
        shape = self.grids, *roll.shape
        places = [jnp.broadcast_to(part[None], shape).ravel() for part in (roll, across)]
        nothing = jnp.zeros_like(places[0])
        tooth = jnp.broadcast_to(known[:, None, None], shape).ravel().astype(int)
        rim = Rim(nothing, nothing, nothing, gear.teeth, tooth)
        low, high = gear.roll
        from_tip = places[0] - low if gear.internal else high - places[0]
        side = FLANKS.get(self.flank, 1) * jnp.ones_like(nothing)
        place = ProfilePlace(from_tip, high - low, places[1], gear.width, roll=places[0], side=side, ahead=nothing)
        view = BodyView(nothing[0], nothing, nothing, rim, flank=place)
        removed = nothing
        for error in design:
            if error.body != self.body:
                raise ParameterError("design", error.body, f'must be modifications of "{self.body}"')
            if not error.on_flank:
                words = "is no modification along the profile or across the face, such as tip_relief or crowning"
                raise ParameterError("design", error.kind, words)
            removed = removed + error.gap(view)
        return dataclasses.replace(self, deviation=self.deviation + removed)

    def check_places(self, gear: GearSize) -> None:
        low, high = (float(end) / mm for end in gear.roll)
        first, last = float(self.roll[0]) / mm, float(self.roll[-1]) / mm
        if first > high or last < low:
            words = f"must include lengths of roll that can touch, {low:.4g} to {high:.4g} mm: is their unit right?"
            raise ParameterError("roll", f"{first:.4g} to {last:.4g} mm", words)
        half, most = 0.5 * float(gear.width) / mm, float(np.max(np.abs(self.across))) / mm
        if most > half * (1 + ON_FACE):
            words = f"must be on the face, up to {half:.4g} mm from its middle: is their unit right?"
            raise ParameterError("across", f"up to {most:.4g} mm", words)
        known = np.asarray(self.teeth)
        odd = known[(known >= gear.teeth) | (known != np.round(known))]
        if odd.size:
            raise ParameterError("teeth", f"{odd[0]:g}", f"must be whole numbers from 0 to {gear.teeth - 1}")

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        if place.roll is None or place.across is None:
            raise ParameterError("body", self.body, "has no known places of the contacts on its flanks")
        values, grid = self._of_teeth(view)
        splines = GridSpline(self.roll, self.ends), GridSpline(self.across, self.ends)
        return self.of_flank(place, place.seen(-surface(*splines, values, grid, (place.roll, place.across))))

    def _of_teeth(self, view: BodyView) -> tuple[Float[Array, "grid row column"], Int[Array, " contact"]]:
        """Grids of deviations, and the number of the grid that each contact is on."""
        grid, rim = self.grid, view.rim
        if self.grids == 1:
            return grid, jnp.zeros(view.influence.shape, jnp.int32)
        if rim is None or rim.element is None or rim.elements is None:
            raise ParameterError(
                "deviation", f"{self.grids} teeth", "give one: contacts of this body have no known tooth"
            )
        if self.teeth.size:
            same = rim.element[:, None].astype(self.teeth.dtype) == self.teeth[None, :]
            number = jnp.where(same.any(axis=1), jnp.argmax(same, axis=1), self.grids)
            return jnp.concatenate([grid, grid.mean(axis=0, keepdims=True)]), number
        if self.grids != rim.elements:
            words = f"must be 1 or {rim.elements} teeth; for other numbers of teeth, list them in teeth"
            raise ParameterError("deviation", f"{self.grids} teeth", words)
        return grid, rim.element


class MeasuredPitch(AbstractMeasured):
    """Measured cumulative pitch deviations of single teeth (ISO 1328-1).

    A positive deviation means that the flank is ahead along the reference circle, in the sense in which its gear turns.
    A configuration may name a CSV file instead of deviation: file = "pitch.csv", with the columns tooth and cumulative
    in um, or single in um for the deviations from each tooth to the next, and flank if both flanks were measured.

    Args:
        body: gear that carries the error.
        deviation: cumulative pitch deviation: one value per tooth, shape (tooth,), or one for all [m].
        flank: flanks that were measured: ``"driving"``, those that touch while the pinion drives, ``"back"``, the
            others, or ``"both"``.
    """

    kind: ClassVar[str] = "measured_pitch"
    body: str = name()
    deviation: Number = series(units.LENGTH, at_least=-1.0, at_most=1.0, example=["0 um"])
    flank: str = name(default="both", names=("both", *FLANKS))

    def __check_init__(self):
        check_parameters(self)

    def gap(self, view: BodyView) -> Float[Array, " contact"]:
        place = profile_of(self.body, view)
        if place.ahead is None:
            raise ParameterError("body", self.body, "has no reference circle to measure its pitch on")
        return self.of_flank(place, spread("deviation", self.deviation, view) * place.ahead)
