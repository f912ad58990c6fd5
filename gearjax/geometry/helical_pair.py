"""Two involute gears on parallel axes, spur or helical, external or internal: geometry of the pair (ISO 21771).

All that happens in a transverse section is that of two `InvoluteGear` with transverse module and pressure angle, whose
shifts and heights count in transverse modules. The helix turns that section along the face.

Lengths on the line of action count from the point where it touches the base circle of gear 1: they are lengths of roll
of gear 1. A tooth pair in the middle of the face moves along it by ``r_b1`` times the turn of gear 1, and its contact
line is inclined by the base helix angle:

    xi(z) = xi + z tan(beta_b),   z: from the middle of the face
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from gearjax import units
from gearjax.checks import ParameterError, nearest
from gearjax.geometry.internal_pair import InternalPair
from gearjax.geometry.involute import InvoluteGear, inverse_involute, involute
from gearjax.parameters import as_leaf, check_parameters, number
from gearjax.typing import Array, Number, Scalar

NARROWEST = 1e-7  # overlap ratio below which a gear counts as one with so much of it: a spur gear's contact jumps


class BasicRack(eqx.Module):
    """The basic rack of a gear, all in normal modules (ISO 53).

    Args:
        addendum: height of the tips above the reference line, ``h_aP / m_n`` [-].
        dedendum: depth of the roots below it, ``h_fP / m_n`` [-].
        fillet_radius: at the root, ``rho_fP / m_n`` [-].

    Raises:
        ParameterError: a height is not physical.

    Example:
        >>> import gearjax as gj
        >>> rack = gj.BasicRack(addendum=1.2, dedendum=1.5, fillet_radius=0.3)
    """

    addendum: Number = number(units.RATIO, at_least=0.01, at_most=3.0)
    dedendum: Number = number(units.RATIO, at_least=0.01, at_most=3.0)
    fillet_radius: Number = number(units.RATIO, at_least=0.0, at_most=1.0, default=0.38)

    def __check_init__(self):
        check_parameters(self)


ISO_53 = {
    "ISO 53 A": (1.0, 1.25, 0.38),
    "ISO 53 B": (1.0, 1.25, 0.3),
    "ISO 53 C": (1.0, 1.25, 0.25),
    "ISO 53 D": (1.0, 1.4, 0.39),
}
"""Addendum, dedendum and fillet radius of the racks of ISO 53:1998, table 2, in normal modules."""


def rack_of(rack: Any, key: str = "rack") -> BasicRack:
    """A rack by its name in ISO 53, or as it is given.

    Raises:
        ParameterError: there is none of that name.
    """
    if isinstance(rack, BasicRack):
        return rack
    if not isinstance(rack, str) or rack not in ISO_53:
        raise ParameterError(key, rack, f"{nearest(rack, ISO_53)}, or a gj.BasicRack(addendum, dedendum)")
    return BasicRack(*ISO_53[rack])


def racks_of(rack: Any) -> tuple[BasicRack, BasicRack]:
    """The racks of both gears, from one of both or one of each."""
    if isinstance(rack, (tuple, list)):
        if len(rack) != 2:
            raise ParameterError("rack", rack, "must be one rack, or two: of gear 1 and of gear 2")
        return rack_of(rack[0], "rack[0]"), rack_of(rack[1], "rack[1]")
    return rack_of(rack), rack_of(rack)


class ContactPath(NamedTuple):
    """Points of the path of contact while gear 1 drives, as lengths of roll of gear 1 [m].

    Args:
        begin: A, at the tip of gear 2.
        pitch: C, where the line of action crosses the line of centres.
        end: E, at the tip of gear 1.
    """

    begin: Scalar
    pitch: Scalar
    end: Scalar


class InvolutePair(eqx.Module):
    """An involute pair on parallel axes (ISO 21771). Gear 2 may be internal.

    Numbers of an internal gear have the package's own signs, as in `InvoluteGear`: its teeth are counted as positive,
    and a positive profile shift takes its teeth outwards, away from its axis. In ISO 21771 and ISO 6336 its tooth
    number is negative and a positive shift takes its teeth inwards: ``z_2 = -teeth[1]``, ``x_2 = -profile_shifts[1]``.
    Diameters and the centre distance are positive here.

    Args:
        teeth: of gear 1 and of gear 2.
        normal_module: [m].
        normal_pressure_angle: of the rack [rad].
        helix_angle: at the reference circles [rad]; 0 for spur gears. Its sign, the hand of gear 1, changes no figure
            here.
        profile_shifts: of both gears, in normal modules [-].
        face_width: common to both [m].
        centre_distance: [m]; without one it is that of no backlash.
        tip_diameters: of both gears [m]; without them they follow from rack and shift, not shortened.
        rack: one of both gears or one of each: names of ISO 53, such as ``"ISO 53 A"``, or a `BasicRack`.
        internal: whether gear 2 is an internal gear.

    Attributes:
        transverse_module: ``m_t = m_n / cos beta`` [m]. Like the other attributes it is worked out once: what a gear
            set shows at an angle asks for them many times.
        transverse_pressure_angle: ``tan alpha_t = tan alpha_n / cos beta`` [rad].
        base_helix_angle: of the flanks at the base circles, ``sin beta_b = sin beta cos alpha_n`` [rad].
        gears: both in a transverse section; their shifts and heights are in transverse modules.
        base_distance: sum of the base radii; of an internal pair their difference [m].
        base_pitch: distance of the flanks along the line of action in the transverse section,
            ``p_bt = pi m_t cos alpha_t`` [m].
        working_pressure_angle: in the transverse section, ``cos alpha_wt = (r_b2 + r_b1) / a``; of an internal pair
            with the difference [rad].
        tangent_length: ``a sin alpha_wt``, of the line of action between the points where it touches the base circles
            [m].
        contact_path: A to E [m]: where tips let flanks touch, undercut or not (`helical_checks.faults` tells).
    """

    teeth: tuple[int, int] = eqx.field(static=True)
    normal_module: Scalar
    normal_pressure_angle: Scalar
    helix_angle: Scalar
    profile_shifts: tuple[Scalar, Scalar]
    face_width: Scalar
    racks: tuple[BasicRack, BasicRack]
    internal: bool = eqx.field(static=True)
    tip_diameters: tuple[Scalar, Scalar]
    centre_distance: Scalar
    transverse_module: Scalar
    transverse_pressure_angle: Scalar
    base_helix_angle: Scalar
    gears: tuple[InvoluteGear, InvoluteGear]
    base_distance: Scalar
    base_pitch: Scalar
    working_pressure_angle: Scalar
    tangent_length: Scalar
    contact_path: ContactPath

    def __init__(
        self,
        teeth: tuple[int, int],
        normal_module: Any,
        normal_pressure_angle: Any,
        helix_angle: Any,
        profile_shifts: Sequence[Any] | Array,
        face_width: Any,
        centre_distance: Any = None,
        *,
        tip_diameters: Sequence[Any] | Array | None = None,
        rack: Any = "ISO 53 A",
        internal: bool = False,
    ):
        self.teeth, self.internal = (int(teeth[0]), int(teeth[1])), internal
        self.normal_module, self.face_width = as_leaf(normal_module), as_leaf(face_width)
        self.normal_pressure_angle, self.helix_angle = as_leaf(normal_pressure_angle), as_leaf(helix_angle)
        self.profile_shifts = as_leaf(profile_shifts[0]), as_leaf(profile_shifts[1])
        self.racks = racks_of(rack)
        to_transverse = jnp.cos(self.helix_angle)  # transverse modules in a normal one
        self.transverse_module = self.normal_module / to_transverse
        self.transverse_pressure_angle = jnp.arctan(jnp.tan(self.normal_pressure_angle) / to_transverse)
        self.base_helix_angle = jnp.arcsin(jnp.sin(self.helix_angle) * jnp.cos(self.normal_pressure_angle))
        self.gears = self._gears(to_transverse, tip_diameters)
        self.tip_diameters = _both(2 * gear.tip_radius for gear in self.gears)
        if tip_diameters is not None:
            self.tip_diameters = as_leaf(tip_diameters[0]), as_leaf(tip_diameters[1])
        first, second = (gear.base_radius for gear in self.gears)
        self.base_distance = second + self._sign * first
        self.base_pitch = jnp.pi * self.transverse_module * jnp.cos(self.transverse_pressure_angle)
        tight = self.tight_centre_distance if centre_distance is None else centre_distance
        self.centre_distance = as_leaf(tight)
        self._work_out_contact()

    def _gears(
        self, to_transverse: Scalar, tip_diameters: Sequence[Any] | Array | None
    ) -> tuple[InvoluteGear, InvoluteGear]:
        """Both gears in a transverse section, as high as the rack makes them or as their tips are."""

        def gear(number: int) -> InvoluteGear:
            rack, internal = self.racks[number], self.internal and number == 1
            shift, height = (to_transverse * part for part in (self.profile_shifts[number], rack.addendum))
            if tip_diameters is not None:
                beyond = 0.5 * tip_diameters[number] / self.transverse_module - 0.5 * self.teeth[number]
                height = shift - beyond if internal else beyond - shift
            shared = self.transverse_module, self.transverse_pressure_angle
            return InvoluteGear(self.teeth[number], *shared, shift, height, to_transverse * rack.dedendum, internal)

        return gear(0), gear(1)

    def _work_out_contact(self) -> None:
        """Angle, length and path of contact at the centre distance."""
        distance, base, (first, second) = self.centre_distance, self.base_distance, self.gears
        self.working_pressure_angle = jnp.arccos(base / distance)
        self.tangent_length = jnp.sqrt((distance - base) * (distance + base))
        end, other_end = (gear.base_radius * gear.tip_roll for gear in (first, second))
        pitch = first.base_radius * self.tangent_length / base
        self.contact_path = ContactPath(self._sign * (self.tangent_length - other_end), pitch, end)

    @property
    def _sign(self) -> int:
        """Of gear 2's numbers: -1 of an internal gear."""
        return -1 if self.internal else 1

    @property
    def internal_pair(self) -> InternalPair:
        """The transverse section of a pair whose gear 2 is internal, with what nearly touching flanks need."""
        return InternalPair(*self.gears, self.centre_distance)

    @property
    def reference_diameters(self) -> tuple[Scalar, Scalar]:
        """``d = z m_n / cos beta`` [m]."""
        return _both(2 * gear.reference_radius for gear in self.gears)

    @property
    def base_diameters(self) -> tuple[Scalar, Scalar]:
        """``d_b = d cos alpha_t`` [m]."""
        return _both(2 * gear.base_radius for gear in self.gears)

    @property
    def root_diameters(self) -> tuple[Scalar, Scalar]:
        """As the rack makes them [m]."""
        return _both(2 * gear.root_radius for gear in self.gears)

    @property
    def tight_pressure_angle(self) -> Scalar:
        """Working pressure angle without backlash [rad]; negative where shifts leave backlash at every distance."""
        shifts = self.profile_shifts[1] + self._sign * self.profile_shifts[0]
        teeth = self.teeth[1] + self._sign * self.teeth[0]
        own = involute(self.transverse_pressure_angle)
        return inverse_involute(own + 2 * jnp.tan(self.normal_pressure_angle) * shifts / teeth)

    @property
    def tight_centre_distance(self) -> Scalar:
        """Centre distance without backlash [m], of ``inv alpha_wt = inv alpha_t + 2 tan alpha_n (x_1 + x_2) / (z_1 +
        z_2)``. External gears have backlash at a longer one, an internal pair at a shorter one."""
        return self.base_distance / jnp.cos(self.tight_pressure_angle)

    @property
    def backlash(self) -> Scalar:
        """Travel along the line of action between the flanks, in the transverse section [m]; negative where the teeth
        do not fit."""
        teeth = self.teeth[1] + self._sign * self.teeth[0]
        wider = involute(self.working_pressure_angle) - involute(self.tight_pressure_angle)
        return self._sign * teeth * self.transverse_module * jnp.cos(self.transverse_pressure_angle) * wider

    def other_roll(self, length: Array) -> Array:
        """Lengths of roll of gear 2 where those of gear 1 are given, any shape [m]."""
        return self.tangent_length + length if self.internal else self.tangent_length - length

    @property
    def transverse_contact_ratio(self) -> Scalar:
        """``eps_alpha``: length of the path of contact over the base pitch [-]."""
        path = self.contact_path
        return (path.end - path.begin) / self.base_pitch

    @property
    def overlap_ratio(self) -> Scalar:
        """``eps_beta = b sin |beta| / (pi m_n)`` [-]."""
        return self.face_width * jnp.abs(jnp.sin(self.helix_angle)) / (jnp.pi * self.normal_module)

    @property
    def total_contact_ratio(self) -> Scalar:
        """``eps_gamma = eps_alpha + eps_beta`` [-]."""
        return self.transverse_contact_ratio + self.overlap_ratio

    def contact_line_length(self, angle: Array) -> Array:
        """Length of all contact lines together, the parts that ends of teeth cut off left out [m].

        Over a slice of the face ``floor(e) - floor(a)`` pairs touch, where e and a tell by how many base pitches a pair
        is ahead of the ends of the path; along the face both grow evenly, by the overlap ratio in all. The mean of a
        fractional part over such a stretch has a closed form, so that the length is exact for any number of pairs,
        continuous, and straight between the angles where a line meets a corner. Of spur gears it jumps there.

        Args:
            angle: by which gear 1 is turned from where a pair of teeth touches at the pitch point, in the middle of the
                face [rad], any shape.
        """
        path = self.contact_path
        ahead = self.gears[0].base_radius * angle + path.pitch
        ends = [(end - ahead) / self.base_pitch for end in (path.end, path.begin)]
        width = jnp.maximum(self.overlap_ratio, NARROWEST)
        first, last = (_mean_fraction(end, width) for end in ends)
        pairs = self.transverse_contact_ratio - first + last
        return self.face_width / jnp.cos(self.base_helix_angle) * pairs


def _mean_fraction(place: Array, width: Scalar) -> Array:
    """Mean of the fractional part over a stretch about a place."""
    place = place - jnp.floor(place)  # small numbers keep their digits
    # the number less the mean of its whole part: exact where the stretch holds no whole number, however short it is
    return place - (_summed_whole(place + 0.5 * width) - _summed_whole(place - 0.5 * width)) / width


def _summed_whole(place: Array) -> Array:
    """Integral of the whole part from zero on."""
    whole = jnp.floor(place)
    return whole * (place - 0.5 * (whole + 1))


def _both(parts: Any) -> tuple[Any, Any]:
    """Of gear 1 and of gear 2."""
    first, second = parts
    return first, second
