"""Stiffness of the teeth of a pair by ISO 6336-1, method B."""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError, is_concrete
from gearjax.geometry.helical_checks import longer_contact, misfits
from gearjax.geometry.helical_pair import InvolutePair
from gearjax.parameters import as_leaf, is_numeric
from gearjax.typing import Array, Bool, Float, Scalar
from gearjax.units import deg, mm

PLAIN = (0.04723, 0.15551, 0.25791)
"""C1 to C3 of ISO 6336-1, table 9 [mm um/N]: constant, over the virtual tooth numbers of pinion and wheel."""
SHIFTED = (-0.00635, -0.11654, -0.00193, -0.24188, 0.00529, 0.00182)
"""C4 to C9: of the shift of the pinion, and over its tooth number; of the wheel; squares of both."""
PER_MM_UM = 1e9  # N/m^2 in one N/(mm um)
SOLID = 0.8  # C_M: teeth measured over teeth calculated
FULL = 1e5  # N/m, load per face width from which on the stiffness is constant
LEAST = 1e3  # N/m, below which a load is rather one in N/mm
HIGHEST = 1.6e6  # N/m, to which ISO compared its formula with measurements
LOW_LOAD = 0.25


class Iso6336Stiffness(eqx.Module):
    """Stiffness of the teeth of a pair by ISO 6336-1, in the transverse section, per face width.

    Times the face width they are stiffnesses along the line of action [N/m]; divided by 1e9 they are in N/(mm um), as
    ISO has them.

    Args:
        theoretical: ``c'_th``, of one pair of teeth, of the rack of 1.2 modules of dedendum [N/m per m].
        single: ``c'``, the highest of one pair of teeth [N/m per m].
        mesh_alpha: ``c_gamma_alpha``, mean of the mesh, for vibration and load sharing [N/m per m].
        mesh_beta: ``c_gamma_beta``, mean of the mesh, for load distribution across the face [N/m per m].
        transverse_contact_ratio: ``eps_alpha`` [-].
        overlap_ratio: ``eps_beta`` [-].
        within_limits: whether the pair is one that ISO states its formulas for (`iso6336_stiffness`).
    """

    theoretical: Float[Array, ""]
    single: Float[Array, ""]
    mesh_alpha: Float[Array, ""]
    mesh_beta: Float[Array, ""]
    transverse_contact_ratio: Float[Array, ""]
    overlap_ratio: Float[Array, ""]
    within_limits: Bool[Array, ""]


def iso6336_stiffness(
    *,
    teeth: Any,
    normal_module: Any,
    normal_pressure_angle: Any,
    helix_angle: Any,
    profile_shifts: Any,
    face_width: Any,
    centre_distance: Any,
    tip_diameters: Any = None,
    rack: Any = "ISO 53 A",
    blank_factor: Any = 1.0,
    internal: Any = False,
    load_per_width: Any = None,
    low_load_exponent: Any = LOW_LOAD,
) -> Iso6336Stiffness:
    """Single and mesh stiffness of a pair of steel gears, ISO 6336-1:2006 and :2019, 9.3, method B.

        q' = C1 + C2/z_n1 + C3/z_n2 + C4 x_1 + C5 x_1/z_n1 + C6 x_2 + C7 x_2/z_n2 + C8 x_1^2 + C9 x_2^2
        z_n = z / (cos^2 beta_b cos beta),   c'_th = 1 / q'
        c' = c'_th C_M C_R C_B cos beta,   C_M = 0.8,   C_R = blank_factor
        C_B = (1 + 0.5 (1.2 - h_fP / m_n)) (1 - 0.02 (20 deg - alpha_Pn)), the mean of both gears' racks
        c_gamma_alpha = c' (0.75 eps_alpha + 0.25),   c_gamma_beta = 0.85 c_gamma_alpha

    Below 100 N/mm of load, ``c'`` is multiplied by ``(load_per_width / 100 N/mm)^0.25``. Both editions have these
    formulas; :2019 counts the mesh load factor K_gamma to the load, :2006 does not. Some calculations reduce in
    proportion to the load instead: `low_load_exponent` = 1. Of an internal pair ``z_n2`` is infinite; its ``x_2``
    stays, in ISO's sign. Where eps_alpha is below 1.2 ISO lets c_gamma_alpha be up to 10 % lower; it is not lowered
    here.

    ISO states the formulas for ``x_1 >= x_2`` and ``-0.5 <= x_1 + x_2 <= 2`` (in its signs), helix angles to 45 deg,
    eps_alpha from 1.2 to 2.5 and loads of 100 to 1600 N/mm. Pairs outside are calculated all the same, as ISO's users
    do, and `within_limits` is false: a number of the result, so that it tells of each pair of a batch, where a warning
    could not.

    Args:
        teeth: of the pinion and of the wheel.
        normal_module: [m].
        normal_pressure_angle: of the basic rack [rad].
        helix_angle: at the reference circle, of either sign [rad].
        profile_shifts: of both gears, in normal modules; a positive one takes teeth outwards, of an internal gear too:
            its ``x_2`` of ISO is the negative one [-].
        face_width: common to both [m].
        centre_distance: [m].
        tip_diameters: of both gears [m]; without them as rack and shifts make them, not shortened.
        rack: ``"ISO 53 A"`` to ``"ISO 53 D"``, a `BasicRack`, or one for each gear.
        blank_factor: ``C_R``, 1 for solid discs, for rims on webs ``1 + ln(b_s / b) / (5 exp(s_R / (5 m_n)))`` [-].
        internal: whether the wheel is an internal gear.
        load_per_width: ``F_t K_A / b`` [N/m]; without it full load, 100 N/mm or more.
        low_load_exponent: of the load below 100 N/mm [-].

    Returns:
        The stiffness. Differentiable in every number that is not a count; all numbers are single ones, of batches by
        `jax.vmap`. What is traced is not checked.

    Raises:
        ParameterError: an argument is not what it should be, or the gears do not fit into each other.

    Example:
        Example 1 of ISO/TR 6336-30:2017 (there 17.46 N/(mm um)):

        >>> import gearjax as gj
        >>> from gearjax.units import deg, mm
        >>> stiffness = gj.iso6336_stiffness(
        ...     teeth=(17, 103), normal_module=8 * mm, normal_pressure_angle=20 * deg, helix_angle=15.8 * deg,
        ...     profile_shifts=(0.145, 0.0), face_width=100 * mm, centre_distance=500 * mm, rack="ISO 53 D")
        >>> round(float(stiffness.mesh_alpha) / 1e9, 1)
        17.5
    """
    _check_counts(teeth, internal)
    _check_numbers(normal_module, normal_pressure_angle, helix_angle, face_width)
    _check_pair_of("profile_shifts", profile_shifts, -5.0, 5.0, "must be two numbers in modules, from -5 to 5")
    _check_number("blank_factor", blank_factor, 0.1, 1.5, "must be from 0.1 to 1.5; 1 for solid discs")
    _check_number("low_load_exponent", low_load_exponent, 0.0, 2.0, "must be from 0 to 2")
    if load_per_width is not None:
        words = "is in N/m: must be from 1e3 to 1e9, such as 100e3 for 100 N/mm"
        _check_number("load_per_width", load_per_width, LEAST, 1e9, words)
    _check_number("centre_distance", centre_distance, 1e-6, 100.0, "is in metres: must be from 1e-6 to 100")
    if tip_diameters is not None:
        _check_pair_of("tip_diameters", tip_diameters, 1e-6, 100.0, "must be two diameters in metres")
    sizes = normal_module, normal_pressure_angle, helix_angle, profile_shifts, face_width, centre_distance
    pair = InvolutePair(teeth, *sizes, tip_diameters=tip_diameters, rack=rack, internal=internal)
    if is_concrete(pair):
        _check_fit(pair)
    load = None if load_per_width is None else as_leaf(load_per_width)
    return stiffness_of(pair, as_leaf(blank_factor), load, as_leaf(low_load_exponent))


@eqx.filter_jit
def stiffness_of(pair: InvolutePair, blank: Any, load: Any, exponent: Any) -> Iso6336Stiffness:
    """The same of a pair that is known to fit.

    Args:
        pair: the gears.
        blank, load, exponent: ``blank_factor``, ``load_per_width`` and ``low_load_exponent``.
    """
    theoretical = PER_MM_UM / _compliance(pair)
    single = theoretical * SOLID * blank * _rack_factor(pair) * jnp.cos(pair.helix_angle)
    if load is not None:
        single = single * jnp.minimum(load / FULL, 1.0) ** exponent
    ratio = pair.transverse_contact_ratio
    mesh = single * (0.75 * ratio + 0.25)
    within = _within_limits(pair, load)
    return Iso6336Stiffness(theoretical, single, mesh, 0.85 * mesh, ratio, pair.overlap_ratio, within)


def _compliance(pair: InvolutePair) -> Scalar:
    """``q'`` [mm um/N]."""
    first, second = _iso_shifts(pair)
    scale = jnp.cos(pair.base_helix_angle) ** 2 * jnp.cos(pair.helix_angle)
    own = scale / pair.teeth[0]
    other = 0.0 if pair.internal else scale / pair.teeth[1]
    terms = first, first * own, second, second * other, first**2, second**2
    shifted = sum(factor * term for factor, term in zip(SHIFTED, terms, strict=True))
    return PLAIN[0] + PLAIN[1] * own + PLAIN[2] * other + shifted


def _iso_shifts(pair: InvolutePair) -> tuple[Scalar, Scalar]:
    """In ISO's signs."""
    first, second = pair.profile_shifts
    return first, -second if pair.internal else second


def _rack_factor(pair: InvolutePair) -> Scalar:
    """``C_B``."""
    dedendum = 0.5 * (pair.racks[0].dedendum + pair.racks[1].dedendum)
    return (1 + 0.5 * (1.2 - dedendum)) * (1 - 0.02 * (20 - pair.normal_pressure_angle / deg))


def _within_limits(pair: InvolutePair, load: Any) -> Bool[Array, ""]:
    first, second = _iso_shifts(pair)
    ratio, rounding = pair.transverse_contact_ratio, 1e-6
    within = (first >= second - rounding) & (first + second >= -0.5 - rounding) & (first + second <= 2 + rounding)
    within &= (ratio >= 1.2) & (ratio <= 2.5) & (jnp.abs(pair.helix_angle) <= 45 * deg + rounding)
    return within if load is None else within & (load >= FULL) & (load <= HIGHEST)


def _check_counts(teeth: Any, internal: Any) -> None:
    whole = isinstance(teeth, Sequence) and len(teeth) == 2 and not isinstance(teeth, str)
    if not whole or not all(isinstance(z, int | np.integer) and 5 <= z <= 5000 for z in teeth):
        raise ParameterError("teeth", teeth, "must be two whole numbers from 5 to 5000, those of an internal gear too")
    if not isinstance(internal, bool):
        raise ParameterError("internal", internal, "must be True or False")
    if internal and teeth[0] >= teeth[1]:
        raise ParameterError("teeth", teeth, "the internal gear, of more teeth than the pinion, must be the second one")
    if teeth[0] > teeth[1]:
        raise ParameterError("teeth", teeth, "the pinion, of fewer teeth, must be the first one")


def _check_numbers(module: Any, pressure_angle: Any, helix_angle: Any, width: Any) -> None:
    words = "is in metres: must be from 1e-6 to 0.1, such as 2.5 * gj.units.mm"
    _check_number("normal_module", module, 1e-6, 0.1, words)
    words = "is in radians: must be 5 to 45 deg, such as 20 * gj.units.deg"
    _check_number("normal_pressure_angle", pressure_angle, 5 * deg, 45 * deg, words)
    words = "is in radians: must be within 60 deg either way, such as 15 * gj.units.deg; ISO's formulas go to 45 deg"
    _check_number("helix_angle", helix_angle, -math.pi / 3, math.pi / 3, words)
    words = "is in metres: must be above 0 and at most 10, such as 40 * gj.units.mm"
    _check_number("face_width", width, 1e-9, 10.0, words)


def _check_number(key: str, value: Any, low: float, high: float, words: str) -> None:
    """Refuse what is known and not one number within bounds."""
    if not is_concrete(value):
        return
    if value is None or not is_numeric(value):
        raise ParameterError(key, value, words)
    if np.ndim(value):
        raise ParameterError(key, np.shape(value), "is a shape: must be one number; batches are made by jax.vmap")
    rounding = 1e-6 * abs(high)  # of bounds in degrees, in float32
    if not low - min(rounding, 0.5 * abs(low)) <= float(value) <= high + rounding:
        raise ParameterError(key, value, words)


def _check_pair_of(key: str, values: Any, low: float, high: float, words: str) -> None:
    try:
        two = len(values) == 2 and not isinstance(values, str)
    except TypeError:  # one number
        two = False
    if not two:
        raise ParameterError(key, values, words + ", of the pinion and of the wheel")
    for i in range(2):
        _check_number(f"{key}[{i}]", values[i], low, high, words)


def _check_fit(pair: InvolutePair) -> None:
    """Refuse gears that cannot be, or that do not fit into each other."""
    module, width = float(pair.normal_module), float(pair.face_width)
    if width > 1000 * module:
        raise ParameterError("face_width", width, f"is in metres: more than 1000 modules of {module / mm:g} mm")
    for i, (tip, reference) in enumerate(zip(pair.tip_diameters, pair.reference_diameters, strict=True)):
        if not abs(float(tip) - float(reference)) <= 15 * module:
            words = f"is in metres: must be within 15 modules of the reference diameter, {float(reference):.6g} m"
            raise ParameterError(f"tip_diameters[{i}]", tip, words)
    for key, shown, words in misfits(pair):
        raise ParameterError(key, shown, words)
    ratio = float(pair.transverse_contact_ratio)
    if ratio < 1:
        words = f"the transverse contact ratio is {ratio:.4g}, must be at least 1: {longer_contact(pair)}"
        raise ParameterError("centre_distance", f"{float(pair.centre_distance) / mm:.6g} mm", words)
