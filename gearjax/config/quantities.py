"""Numbers with units, read from strings. The form of a string is checked before pint sees the unit."""

import functools
import math
import re
from typing import Any

from gearjax import units
from gearjax.checks import ParameterError
from gearjax.config.spelling import (
    Factor,
    UnknownUnit,
    as_written,
    factors,
    registry,
    unit_of,
    variants,
    without_typography,
)
from gearjax.units import Dimension

_LONGEST = 64
_NUMBER = re.compile(r"([+-]?(?:\d{1,30}(?:\.\d{0,30})?|\.\d{1,30})(?:[eE][+-]?\d{1,3})?)(.*)", re.ASCII)
_SEPARATED = re.compile(r"[+-]?\d+(?:[,_']\d+)+(?:\.\d+)?(?:[eE][+-]?\d+)?\b", re.ASCII)
_FORMS = {  # what a unit may measure, for the message if another dimension is needed
    **{f"a {name}": (unit,) for name, unit in (("volume", "m^3"), ("speed", "m/s"), ("force", "N"), ("power", "W"))},
    "an area": ("m^2",),
    "an acceleration": ("m/s^2",),
    "an angular acceleration": ("rad/s^2",),
    "an energy": ("J",),
    "a torsional stiffness": ("N*m/rad",),
    "a damping coefficient": ("N*s/m",),
    "a mass times a length (kgf and lbf are forces)": ("kg*m",),
    "a force (by its mass)": ("kg*m/s^2",),
    **{
        dimension.described: (dimension.unit, *dimension.forms)
        for dimension in vars(units).values()
        if isinstance(dimension, Dimension) and dimension.unit
    },
    "a ratio": ("%",),
}
_INSTEAD = {
    units.ANGULAR_SPEED: ", in rpm, 1/min, deg/s or rad/s",
    units.ANGLE: ", in deg, arcmin, arcsec, rad or turn",
}


@functools.cache
def _dimensionality(unit: str) -> Any:
    return unit_of(factors(unit)).dimensionality


def _measured(unit: Any) -> str | None:
    """What a unit measures, in words: ``a length``, ``an energy``."""
    dimensionality = unit.dimensionality
    return next((words for words, forms in _FORMS.items() if dimensionality in map(_dimensionality, forms)), None)


_EVERYDAY: dict[str, tuple[Dimension, float]] = {
    "m": (units.LENGTH, 1.0),
    "mm": (units.LENGTH, units.mm),
    "um": (units.LENGTH, units.um),
    "rad": (units.ANGLE, 1.0),
    "deg": (units.ANGLE, units.deg),
    "arcmin": (units.ANGLE, units.arcmin),
    "arcsec": (units.ANGLE, units.arcsec),
    "rpm": (units.ANGULAR_SPEED, units.rpm),
    "rad/s": (units.ANGULAR_SPEED, 1.0),
    "s": (units.TIME, 1.0),
    "ms": (units.TIME, 1e-3),
    "Hz": (units.FREQUENCY, 1.0),
    "kg": (units.MASS, 1.0),
    "kg*m^2": (units.INERTIA, 1.0),
    "N*m": (units.TORQUE, 1.0),
    "N m": (units.TORQUE, 1.0),
    "N/m": (units.STIFFNESS, 1.0),
    "Pa": (units.PRESSURE, 1.0),
    "GPa": (units.PRESSURE, 1e9),
}
"""Units that most values have, with their dimensions and sizes; pint, which knows all, takes half a second to begin."""


@functools.lru_cache(maxsize=1024)
def _suits(unit: Any, dimension: Dimension) -> bool:
    if not dimension.unit:
        return unit.dimensionless
    return any(unit.dimensionality == _dimensionality(form) for form in (dimension.unit, *dimension.forms))


def read_quantity(key: str, given: Any, dimension: Dimension) -> float:
    """Read a number in SI from a string such as ``"10 um"``.

    Args:
        key: path of the value in the configuration, for messages.
        given: the value in the configuration.
        dimension: the dimension that the value must have.

    Raises:
        ParameterError: the unit is missing, unknown or of another dimension, or the number is not finite.
    """
    right = f'give {dimension.described} with its unit, such as "{dimension.example}"'
    if isinstance(given, bool) or not isinstance(given, (str, int, float)):
        raise ParameterError(key, given, right)
    if not isinstance(given, str):
        raise ParameterError(key, given, f"has no unit: {right}")
    if len(given) > _LONGEST:
        raise ParameterError(key, given, f"is no quantity: {right}")
    text = without_typography(given)
    if _SEPARATED.match(text):
        raise ParameterError(key, given, f"has a comma or a separator in its number (1000.5 has none): {right}")
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise ParameterError(key, given, f"is no number with a unit: {right}")
    if not match[2].strip():
        raise ParameterError(key, given, f"has no unit: {right}")
    value = float(match[1]) * unit_size(key, given, match[2].strip(), dimension)
    if not math.isfinite(value):
        raise ParameterError(key, given, f"is not finite: {right}")
    return value


def unit_size(key: str, given: Any, unit: str, dimension: Dimension) -> float:
    """Size of a unit in SI.

    Args:
        key: path of the value in the configuration, for messages.
        given: the value in the configuration.
        unit: the unit alone, such as ``"um"``.
        dimension: the dimension that the unit must have.

    Raises:
        ParameterError: the unit is unknown, or has another dimension.
    """
    everyday = _EVERYDAY.get(unit)
    if everyday is not None and everyday[0] == dimension:
        return everyday[1]
    needs = f"needs {dimension.described} such as {_quoted(dimension)}{_INSTEAD.get(dimension, '')}"
    written: tuple[Factor, ...] = ()
    try:
        written = factors(unit)
        measured = unit_of(written)
    except UnknownUnit as fault:
        raise ParameterError(key, given, f"{fault}{_meant(written, dimension)}; {needs}") from fault
    if dimension == units.ANGULAR_SPEED and written == (Factor("min", -1),):
        return units.rpm  # 1/min and min^-1 count turns on every nameplate; the meaning of 1/s is not clear
    if not _suits(measured, dimension):
        words = _measured(measured)
        told = f"is {words}" if words else f"is not written as {dimension.described}"
        raise ParameterError(key, given, f"{told}{_meant(written, dimension)}; {needs}")
    return _in_si(measured)


@functools.lru_cache(maxsize=1024)
def _in_si(unit: Any) -> float:
    return float(registry().Quantity(1.0, unit).to_base_units().magnitude)


def _meant(written: tuple[Factor, ...], dimension: Dimension) -> str:
    """A suggestion with other capital letters, if they give the right dimension: ``Nm`` for ``nm`` as a torque."""
    for other in variants(written):
        try:
            if _suits(unit_of(other), dimension):
                return f', did you mean "{as_written(other)}"?'
        except UnknownUnit:
            continue
    return ""


def _quoted(dimension: Dimension) -> str:
    return f'"{dimension.example}"' if dimension.unit else f'{dimension.example} or "10 %"'


def read_plain(key: str, given: Any) -> float:
    """Read a dimensionless number, written without quotes.

    Raises:
        ParameterError: the value is not a finite number.
    """
    if isinstance(given, bool) or not isinstance(given, (int, float)):
        raise ParameterError(key, given, "must be a number without unit, such as 0.1")
    try:
        value = float(given)
    except OverflowError as fault:
        raise ParameterError(key, given, "must be a finite number") from fault
    if not math.isfinite(value):
        raise ParameterError(key, given, "must be a finite number")
    return value


def read_ratio(key: str, given: Any) -> float:
    """Read a ratio: a number without quotes, or percent such as ``"10 %"``.

    Raises:
        ParameterError: the value is not a finite number.
    """
    match = _NUMBER.fullmatch(without_typography(given)) if isinstance(given, str) and len(given) <= _LONGEST else None
    if match is None or match[2].strip() != "%":
        if isinstance(given, str):
            raise ParameterError(key, given, 'must be a number without unit, such as 0.1, or percent, such as "10 %"')
        return read_plain(key, given)
    return float(match[1]) * 0.01
