"""Geometry of two involute gears on parallel axes, spur or helical, external or internal (ISO 21771).

In a transverse section the pair is a pair of two `InvoluteGear` with transverse module and transverse pressure angle;
their profile shifts and tooth heights are in transverse modules. The helix turns this section along the face.

Lengths on the line of action are counted from the point where the line touches the base circle of gear 1: they are
lengths of roll of gear 1. The contact point in the middle of the face moves along the line by ``r_b1`` times the angle
of gear 1, and the contact line is inclined by the base helix angle:

    xi(z) = xi + z tan(beta_b),   z: from the middle of the face
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax import units
from gearjax.checks import ParameterError, nearest
from gearjax.geometry.internal_pair import InternalPair
from gearjax.geometry.involute import InvoluteGear, inverse_involute, involute
from gearjax.parameters import as_leaf, check_parameters, number
from gearjax.typing import Array, Number, Scalar

NARROWEST = 1e-7  # smallest overlap ratio that is divided by: the contact line of a spur gear jumps in length


class BasicRack(eqx.Module):
    """The basic rack of a gear; all its lengths are in normal modules (ISO 53).

    Args:
        addendum: height of the tips above the reference line, ``h_aP / m_n`` [-].
        dedendum: depth of the roots below the reference line, ``h_fP / m_n`` [-].
        fillet_radius: radius of the fillet at the root, ``rho_fP / m_n`` [-].

    Raises:
        ParameterError: a value is not physical.

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
"""Addendum, dedendum and fillet radius of the racks in ISO 53:1998, table 2, in normal modules."""


def rack_of(rack: Any, key: str = "rack") -> BasicRack:
    """A basic rack from its name in ISO 53; a `BasicRack` is returned unchanged.

    Raises:
        ParameterError: ISO 53 has no rack of that name.
    """
    if isinstance(rack, BasicRack):
        return rack
    if not isinstance(rack, str) or rack not in ISO_53:
        raise ParameterError(key, rack, f"{nearest(rack, ISO_53)}, or a gj.BasicRack(addendum, dedendum)")
    return BasicRack(*ISO_53[rack])


def racks_of(rack: Any) -> tuple[BasicRack, BasicRack]:
    """The basic racks of both gears, from one common rack or from one rack for each gear."""
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
    """A pair of involute gears on parallel axes (ISO 21771). Gear 2 may be internal.

    The numbers of an internal gear have the package's own signs, as in `InvoluteGear`: its tooth number is positive,
    and a positive profile shift moves its teeth outwards, away from its axis. In ISO 21771 and ISO 6336 its tooth
    number is negative and a positive shift moves its teeth inwards: ``z_2 = -teeth[1]``, ``x_2 = -profile_shifts[1]``.
    Diameters and the centre distance are positive here.

    Args:
        teeth: tooth numbers of gear 1 and of gear 2.
        normal_module: normal module [m].
        normal_pressure_angle: normal pressure angle of the rack [rad].
        helix_angle: helix angle at the reference circles [rad]; 0 for spur gears. Its sign is the hand of gear 1 and
            changes no result of this class.
        profile_shifts: profile shifts of both gears, in normal modules [-].
        face_width: common face width of both gears [m].
        centre_distance: centre distance [m]; without it, the centre distance without backlash.
        tip_diameters: tip diameters of both gears [m]; without them, they follow from rack and profile shift, without
            tip shortening.
        rack: common rack of both gears or one rack for each: a name of ISO 53, such as ``"ISO 53 A"``, or a
            `BasicRack`.
        internal: whether gear 2 is an internal gear.

    Attributes:
        transverse_module: ``m_t = m_n / cos beta`` [m]. Like the other attributes it is calculated only once, because
            the pose of a gear set uses it many times.
        transverse_pressure_angle: ``tan alpha_t = tan alpha_n / cos beta`` [rad].
        base_helix_angle: helix angle at the base circles, ``sin beta_b = sin beta cos alpha_n`` [rad].
        gears: both gears in a transverse section; their shifts and heights are in transverse modules.
        base_distance: sum of the base radii, or their difference for an internal pair [m].
        base_pitch: distance of successive flanks along the line of action in the transverse section,
            ``p_bt = pi m_t cos alpha_t`` [m].
        working_pressure_angle: working pressure angle in the transverse section, ``cos alpha_wt = (r_b2 + r_b1) / a``,
            with the difference for an internal pair [rad].
        tangent_length: length of the line of action between the points where it touches the base circles,
            ``a sin alpha_wt`` [m].
        contact_path: path of contact from A to E between the tips of both gears [m]. It does not consider undercut,
            which `helical_checks.faults` reports.
        backlash: travel along the line of action between the flanks, in the transverse section [m]; negative if the
            teeth overlap.
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
    backlash: Scalar

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
        kind = jnp.result_type(self.normal_module)  # of racks by name, which are in double precision where JAX has it
        one, other = (jax.tree.map(lambda part: jnp.asarray(part, kind), own) for own in racks_of(rack))
        self.racks = one, other
        to_transverse = jnp.cos(self.helix_angle)  # transverse modules per normal module
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
        tight = self.tight_pressure_angle
        self.centre_distance = as_leaf(
            self.base_distance / jnp.cos(tight) if centre_distance is None else centre_distance
        )
        self._work_out_contact(tight)

    def _gears(
        self, to_transverse: Scalar, tip_diameters: Sequence[Any] | Array | None
    ) -> tuple[InvoluteGear, InvoluteGear]:
        """Both gears in a transverse section; their heights follow from the rack or from given tip diameters."""

        def gear(number: int) -> InvoluteGear:
            rack, internal = self.racks[number], self.internal and number == 1
            shift, height = (to_transverse * part for part in (self.profile_shifts[number], rack.addendum))
            if tip_diameters is not None:
                beyond = 0.5 * tip_diameters[number] / self.transverse_module - 0.5 * self.teeth[number]
                height = shift - beyond if internal else beyond - shift
            shared = self.transverse_module, self.transverse_pressure_angle
            return InvoluteGear(self.teeth[number], *shared, shift, height, to_transverse * rack.dedendum, internal)

        return gear(0), gear(1)

    def _work_out_contact(self, tight: Scalar) -> None:
        """Set the working pressure angle, the length of the line of action, the path of contact and the backlash."""
        distance, base, (first, second) = self.centre_distance, self.base_distance, self.gears
        self.working_pressure_angle = jnp.arccos(base / distance)
        self.tangent_length = jnp.sqrt((distance - base) * (distance + base))
        end, other_end = (gear.base_radius * gear.tip_roll for gear in (first, second))
        pitch = first.base_radius * self.tangent_length / base
        self.contact_path = ContactPath(self._sign * (self.tangent_length - other_end), pitch, end)
        teeth = self.teeth[1] + self._sign * self.teeth[0]
        wider = involute(self.working_pressure_angle) - involute(tight)
        self.backlash = self._sign * teeth * self.base_pitch / jnp.pi * wider

    @property
    def _sign(self) -> int:
        """Sign in the sums over both gears: -1 for an internal pair, else 1."""
        return -1 if self.internal else 1

    @property
    def internal_pair(self) -> InternalPair:
        """The transverse section of an internal pair, as the class that calculates nearly touching flanks."""
        return InternalPair(*self.gears, self.centre_distance)

    @property
    def reference_diameters(self) -> tuple[Scalar, Scalar]:
        """Reference diameters, ``d = z m_n / cos beta`` [m]."""
        return _both(2 * gear.reference_radius for gear in self.gears)

    @property
    def base_diameters(self) -> tuple[Scalar, Scalar]:
        """Base diameters, ``d_b = d cos alpha_t`` [m]."""
        return _both(2 * gear.base_radius for gear in self.gears)

    @property
    def root_diameters(self) -> tuple[Scalar, Scalar]:
        """Root diameters that the rack generates [m]."""
        return _both(2 * gear.root_radius for gear in self.gears)

    @property
    def tight_pressure_angle(self) -> Scalar:
        """Working pressure angle without backlash [rad]; negative if the shifts leave backlash at every distance."""
        shifts = self.profile_shifts[1] + self._sign * self.profile_shifts[0]
        teeth = self.teeth[1] + self._sign * self.teeth[0]
        own = involute(self.transverse_pressure_angle)
        return inverse_involute(own + 2 * jnp.tan(self.normal_pressure_angle) * shifts / teeth)

    @property
    def tight_centre_distance(self) -> Scalar:
        """Centre distance without backlash [m].

        It follows from ``inv alpha_wt = inv alpha_t + 2 tan alpha_n (x_1 + x_2) / (z_1 + z_2)``. External gears have
        backlash at a longer centre distance, an internal pair at a shorter one.
        """
        return self.base_distance / jnp.cos(self.tight_pressure_angle)

    def other_roll(self, length: Array) -> Array:
        """Lengths of roll of gear 2 at the contact points with given lengths of roll of gear 1, any shape [m]."""
        return self.tangent_length + length if self.internal else self.tangent_length - length

    @property
    def transverse_contact_ratio(self) -> Scalar:
        """Transverse contact ratio ``eps_alpha``: length of the path of contact over the base pitch [-]."""
        path = self.contact_path
        return (path.end - path.begin) / self.base_pitch

    @property
    def overlap_ratio(self) -> Scalar:
        """Overlap ratio ``eps_beta = b sin |beta| / (pi m_n)`` [-]."""
        return self.face_width * jnp.abs(jnp.sin(self.helix_angle)) / (jnp.pi * self.normal_module)

    @property
    def total_contact_ratio(self) -> Scalar:
        """Total contact ratio ``eps_gamma = eps_alpha + eps_beta`` [-]."""
        return self.transverse_contact_ratio + self.overlap_ratio

    def contact_line_length(self, angle: Array) -> Array:
        """Total length of all contact lines within the path of contact and the face [m].

        In a transverse section ``floor(e) - floor(a)`` pairs touch, where e and a are the distances of a pair from the
        end and from the beginning of the path of contact, in base pitches. Along the face e and a change linearly, by
        the overlap ratio in total. The mean of a fractional part over such a range has a closed form. The length is
        therefore exact for any number of pairs, continuous, and linear between the angles at which a contact line
        reaches a corner of the plane of action. For spur gears it jumps at these angles.

        Args:
            angle: angle of gear 1 from the position in which a pair of teeth touches at the pitch point, in the middle
                of the face [rad], any shape.
        """
        path = self.contact_path
        ahead = self.gears[0].base_radius * angle + path.pitch
        ends = [(end - ahead) / self.base_pitch for end in (path.end, path.begin)]
        width = jnp.maximum(self.overlap_ratio, NARROWEST)
        first, last = (_mean_fraction(end, width) for end in ends)
        pairs = self.transverse_contact_ratio - first + last
        return self.face_width / jnp.cos(self.base_helix_angle) * pairs


def _mean_fraction(place: Array, width: Scalar) -> Array:
    """Mean of the fractional part over a range of a given width about a place."""
    place = place - jnp.floor(place)  # small numbers keep their digits
    # the place minus the mean integer part: exact if the range contains no integer, however short the range is
    return place - (_summed_whole(place + 0.5 * width) - _summed_whole(place - 0.5 * width)) / width


def _summed_whole(place: Array) -> Array:
    """Integral of the integer part from zero to a place."""
    whole = jnp.floor(place)
    return whole * (place - 0.5 * (whole + 1))


def _both(parts: Any) -> tuple[Any, Any]:
    """The values of gear 1 and of gear 2 as a tuple."""
    first, second = parts
    return first, second
