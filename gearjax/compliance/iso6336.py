"""Tooth and mesh stiffness of a pair of gears by ISO 6336-1, method B."""

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
"""C1 to C3 of ISO 6336-1, table 9 [mm um/N]: the constant, and the factors of 1/z_n1 and 1/z_n2."""
SHIFTED = (-0.00635, -0.11654, -0.00193, -0.24188, 0.00529, 0.00182)
"""C4 to C9 of the same table: factors of x_1, x_1/z_n1, x_2, x_2/z_n2, x_1^2 and x_2^2."""
PER_MM_UM = 1e9  # N/m^2 in one N/(mm um)
SOLID = 0.8  # C_M: measured over calculated stiffness
FULL = 1e5  # N/m, load per face width from which on the stiffness is constant
LEAST = 1e3  # N/m; a smaller load was probably given in N/mm
HIGHEST = 1.6e6  # N/m, highest load for which ISO compared its formula with measurements
LOW_LOAD = 0.25  # exponent of loads below FULL


class Iso6336Stiffness(eqx.Module):
    """Tooth and mesh stiffness of a pair of gears by ISO 6336-1, in the transverse section, per face width.

    Multiplied by the face width, the values are stiffnesses along the line of action [N/m]. Divided by 1e9, they are in
    N/(mm um), the unit of ISO.

    Args:
        theoretical: theoretical single stiffness ``c'_th`` of one pair of teeth, for the rack with a dedendum of 1.2
            modules [N/m per m].
        single: single stiffness ``c'``, the highest stiffness of one pair of teeth [N/m per m].
        mesh_alpha: mean mesh stiffness ``c_gamma_alpha``, for vibration and load sharing [N/m per m].
        mesh_beta: mean mesh stiffness ``c_gamma_beta``, for the load distribution across the face [N/m per m].
        transverse_contact_ratio: transverse contact ratio ``eps_alpha`` [-].
        overlap_ratio: overlap ratio ``eps_beta`` [-].
        within_limits: whether the pair is within the limits of ISO's formulas (`iso6336_stiffness`).
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
    """Single and mesh stiffness of a pair of steel gears by ISO 6336-1:2006 and :2019, 9.3, method B.

        q' = C1 + C2/z_n1 + C3/z_n2 + C4 x_1 + C5 x_1/z_n1 + C6 x_2 + C7 x_2/z_n2 + C8 x_1^2 + C9 x_2^2
        z_n = z / (cos^2 beta_b cos beta),   c'_th = 1 / q'
        c' = c'_th C_M C_R C_B cos beta,   C_M = 0.8,   C_R = blank_factor
        C_B = (1 + 0.5 (1.2 - h_fP / m_n)) (1 - 0.02 (20 deg - alpha_Pn)), with the mean h_fP of both gears' racks
        c_gamma_alpha = c' (0.75 eps_alpha + 0.25),   c_gamma_beta = 0.85 c_gamma_alpha

    Below a load of 100 N/mm, ``c'`` is multiplied by ``(load_per_width / 100 N/mm)^0.25``. Both editions have these
    formulas; :2019 includes the mesh load factor K_gamma in the load, :2006 does not. Some calculations reduce ``c'``
    in proportion to the load instead: `low_load_exponent` = 1. For an internal pair ``z_n2`` is infinite, and ``x_2``
    is counted with ISO's sign. If eps_alpha is below 1.2, ISO allows for a c_gamma_alpha that is up to 10 % lower; it
    is not lowered here.

    ISO states the formulas for ``x_1 >= x_2`` and ``-0.5 <= x_1 + x_2 <= 2`` (in its signs), helix angles up to
    45 deg, eps_alpha from 1.2 to 2.5 and loads of 100 to 1600 N/mm. Pairs outside these limits are calculated all the
    same, as is common practice, and `within_limits` is false. It is a part of the result and not a warning, so that a
    batch has one value per pair.

    Args:
        teeth: tooth numbers of the pinion and of the wheel.
        normal_module: normal module [m].
        normal_pressure_angle: normal pressure angle of the basic rack [rad].
        helix_angle: helix angle at the reference circle, of either sign [rad].
        profile_shifts: profile shifts of both gears, in normal modules; a positive shift moves the teeth outwards, also
            on an internal gear, whose ``x_2`` in ISO has the opposite sign [-].
        face_width: common face width of both gears [m].
        centre_distance: centre distance [m].
        tip_diameters: tip diameters of both gears [m]; without them, they follow from rack and profile shifts, without
            tip shortening.
        rack: ``"ISO 53 A"`` to ``"ISO 53 D"``, a `BasicRack`, or one of these for each gear.
        blank_factor: gear blank factor ``C_R``: 1 for solid discs, ``1 + ln(b_s / b) / (5 exp(s_R / (5 m_n)))`` for
            rims on webs [-].
        internal: whether the wheel is an internal gear.
        load_per_width: load per face width ``F_t K_A / b`` [N/m]; without it, a load of 100 N/mm or more is assumed.
        low_load_exponent: exponent of the load below 100 N/mm [-].

    Returns:
        The stiffness, differentiable in every number that is not a count. All numbers are scalars; use `jax.vmap` for
        batches. Traced numbers are not checked.

    Raises:
        ParameterError: an argument is outside its range, or the gears do not fit into each other.

    Example:
        Example 1 of ISO/TR 6336-30:2017 (17.46 N/(mm um) there):

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
    """Stiffness of a pair that is known to fit, without checks of the arguments.

    Args:
        pair: the gears.
        blank, load, exponent: ``blank_factor``, ``load_per_width`` and ``low_load_exponent`` of `iso6336_stiffness`.
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
    """Minimum compliance ``q'`` of a pair of teeth [mm um/N]."""
    first, second = _iso_shifts(pair)
    scale = jnp.cos(pair.base_helix_angle) ** 2 * jnp.cos(pair.helix_angle)
    own = scale / pair.teeth[0]
    other = 0.0 if pair.internal else scale / pair.teeth[1]
    terms = first, first * own, second, second * other, first**2, second**2
    shifted = sum(factor * term for factor, term in zip(SHIFTED, terms, strict=True))
    return PLAIN[0] + PLAIN[1] * own + PLAIN[2] * other + shifted


def _iso_shifts(pair: InvolutePair) -> tuple[Scalar, Scalar]:
    """Profile shifts with ISO's signs, in normal modules."""
    first, second = pair.profile_shifts
    return first, -second if pair.internal else second


def _rack_factor(pair: InvolutePair) -> Scalar:
    """Basic rack factor ``C_B``."""
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
        raise ParameterError(
            "teeth", teeth, "must be two whole numbers from 5 to 5000, positive for an internal gear too"
        )
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
    words = (
        "is in radians: must be from -60 to 60 deg, such as 15 * gj.units.deg; ISO's formulas are valid up to 45 deg"
    )
    _check_number("helix_angle", helix_angle, -math.pi / 3, math.pi / 3, words)
    words = "is in metres: must be above 0 and at most 10, such as 40 * gj.units.mm"
    _check_number("face_width", width, 1e-9, 10.0, words)


def _check_number(key: str, value: Any, low: float, high: float, words: str) -> None:
    """Refuse a concrete value that is not a single number within its bounds; traced values pass."""
    if not is_concrete(value):
        return
    if value is None or not is_numeric(value):
        raise ParameterError(key, value, words)
    if np.ndim(value):
        raise ParameterError(key, np.shape(value), "is a shape: must be one number; batches are made by jax.vmap")
    rounding = 1e-6 * abs(high)  # bounds in degrees are rounded in float32
    if not low - min(rounding, 0.5 * abs(low)) <= float(value) <= high + rounding:
        raise ParameterError(key, value, words)


def _check_pair_of(key: str, values: Any, low: float, high: float, words: str) -> None:
    try:
        two = len(values) == 2 and not isinstance(values, str)
    except TypeError:  # a single number has no length
        two = False
    if not two:
        raise ParameterError(key, values, words + ", of the pinion and of the wheel")
    for i in range(2):
        _check_number(f"{key}[{i}]", values[i], low, high, words)


def _check_fit(pair: InvolutePair) -> None:
    """Refuse gears that are impossible or do not fit into each other."""
    module, width = float(pair.normal_module), float(pair.face_width)
    if width > 1000 * module:
        raise ParameterError("face_width", width, f"is in metres: must be at most 1000 modules of {module / mm:g} mm")
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
