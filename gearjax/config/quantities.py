"""Numbers with units, read from strings. Strings are data: their form is checked before pint sees the unit."""

import functools
import importlib.resources
import math
import re
from typing import Any, cast

import pint

from gearjax.checks import ParameterError
from gearjax.units import ANGLE, Dimension

_LONGEST = 64
_NUMBER = r"[+-]?(?:\d{1,30}(?:\.\d{0,30})?|\.\d{1,30})(?:[eE][+-]?\d{1,3})?"
_FACTOR = r"[A-Za-zµμΩ°%]{1,20}(?:(?:\*\*|\^)-?[1-4])?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*({_FACTOR}(?:\s*[*/·]\s*{_FACTOR}|\s+{_FACTOR}){{0,4}})?\s*", re.ASCII)


@functools.cache
def _registry() -> Any:
    """Units in which an angle is a dimension of its own: 5 Hz is not 5 rad/s, and 0.1 is not an angle."""
    folder = importlib.resources.files("pint")
    definitions = (folder / "default_en.txt").read_text(encoding="utf-8")
    constants = (folder / "constants_en.txt").read_text(encoding="utf-8")
    definitions = definitions.replace("@import constants_en.txt", constants)
    registry = pint.UnitRegistry(cast(Any, None), cache_folder=None)  # None: no units yet
    registry.load_definitions(definitions.replace("radian = []", "radian = [angle]").splitlines())
    return registry


def _si_unit(dimension: Dimension) -> str:
    return dimension.unit or "dimensionless"


def read_quantity(key: str, given: Any, dimension: Dimension) -> float:
    """A number in SI from a string such as ``"10 um"``.

    Args:
        key: where it stands, for messages.
        given: what the configuration holds there.
        dimension: the dimension that it must have.

    Raises:
        ParameterError: no unit, an unknown one, one of another dimension, or not a finite number.
    """
    right = f'give {dimension.described} with its unit, such as "{dimension.example}"'
    if isinstance(given, bool) or not isinstance(given, (str, int, float)):
        raise ParameterError(key, given, right)
    if not isinstance(given, str):
        raise ParameterError(key, given, f"has no unit: {right}")
    if len(given) > _LONGEST:
        raise ParameterError(key, given, f"is no quantity: {right}")
    match = _QUANTITY.fullmatch(given)
    if match is None:
        raise ParameterError(key, given, f"is no number with a unit: {right}")
    number, unit = float(match[1]), match[2]
    if unit is None:
        raise ParameterError(key, given, f"has no unit: {right}")
    registry = _registry()
    try:
        quantity = registry.Quantity(number, registry.parse_units(unit.replace("·", "*").replace("^", "**")))
    except Exception as fault:  # pint raises many kinds for a unit that it cannot read
        raise ParameterError(key, given, f'unknown unit "{unit}": {right}') from fault
    if not quantity.is_compatible_with(_si_unit(dimension)):
        dimensions = " ".join(str(quantity.dimensionality).split()) or "none"
        raise ParameterError(key, given, f"has the wrong dimension {dimensions}: {right}{_hint(dimension)}")
    try:
        value = float(quantity.to(_si_unit(dimension)).magnitude)
    except Exception as fault:
        raise ParameterError(key, given, f"cannot be converted: {right}") from fault
    if not math.isfinite(value):
        raise ParameterError(key, given, f"is not finite: {right}")
    return value


def _hint(dimension: Dimension) -> str:
    return " (angles are in deg or rad, angular speeds in rpm or rad/s)" if ANGLE.unit in dimension.unit else ""


def read_plain(key: str, given: Any) -> float:
    """A dimensionless number, written without quotes.

    Raises:
        ParameterError: not a finite number.
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
