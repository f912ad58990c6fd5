"""Units as engineers write them: ``Nm``, ``N·mm``, ``kgm2``, ``1/min``. A unit that is not listed here is unknown.

The list is short on purpose. Force, pressure, energy, frequency and angle are dimensions of their own: a joule is not a
newton metre, and a hertz is not a radian per second, although SI gives both units of such a pair the same base units.
Units with an offset or a logarithmic scale, and units that look like others (becquerel, gray, sievert), are not listed.
"""

import functools
import itertools
import re
from collections.abc import Iterator
from typing import Any, NamedTuple, cast

_DEFINITIONS = """
nano- = 1e-9 = n-
micro- = 1e-6 = µ- = μ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
deci- = 1e-1 = d-
deca- = 1e1 = da-
hecto- = 1e2 = h-
kilo- = 1e3 = k-
mega- = 1e6 = M-
giga- = 1e9 = G-

meter = [length] = m = metre
inch = 0.0254 * meter = in = inches
foot = 12 * inch = ft = feet
thou = 1e-3 * inch = thou
micron = 1e-6 * meter = micron

radian = [angle] = rad
degree = 3.141592653589793 / 180 * radian = deg = °
arcminute = degree / 60 = arcmin
arcsecond = degree / 3600 = arcsec
turn = 360 * degree = turn = rev = revolution
gon = 0.9 * degree = gon

second = [time] = s = sec
minute = 60 * second = min
hour = 60 * minute = h = hr

kilogram = [mass] = kg
gram = 1e-3 * kilogram = g
tonne = 1e3 * kilogram = t
pound = 0.45359237 * kilogram = lb

newton = [force] = N
kilogram_force = 9.80665 * newton = kgf = kp
pound_force = 4.4482216152605 * newton = lbf

pascal = [pressure] = Pa
bar = 1e5 * pascal = bar
pound_per_square_inch = 6894.757293168361 * pascal = psi
kilopound_per_square_inch = 6894757.293168361 * pascal = ksi

joule = [energy] = J
electronvolt = 1.602176634e-19 * joule = eV
calorie = 4.184 * joule = cal
watt_hour = 3600 * joule = Wh
british_thermal_unit = 1055.05585262 * joule = BTU = Btu
erg = 1e-7 * joule = erg
watt = [power] = W

hertz = [frequency] = Hz
rpm = turn / minute = rpm = RPM
percent = 0.01 = %
"""

_PREFIXES = {  # prefixes that occur in gear engineering; others, such as a megametre, are typing mistakes
    "meter": ("nano", "micro", "milli", "centi", "deci", "kilo"),
    "radian": ("nano", "micro", "milli"),
    "degree": ("milli",),
    "second": ("nano", "micro", "milli"),
    "gram": ("micro", "milli", "kilo"),
    "newton": ("micro", "milli", "centi", "deca", "kilo", "mega"),
    "pascal": ("hecto", "kilo", "mega", "giga"),
    "joule": ("milli", "kilo", "mega"),
    "watt_hour": ("kilo", "mega"),
    "calorie": ("kilo",),
    "electronvolt": ("milli", "kilo", "mega", "giga"),
    "watt": ("milli", "kilo", "mega"),
    "hertz": ("milli", "kilo", "mega", "giga"),
    "bar": ("milli",),
}
_USUAL = (
    *("m", "mm", "um", "nm", "cm", "km", "in", "ft", "rad", "mrad", "urad", "deg", "arcmin", "arcsec", "turn", "rev"),
    *("s", "ms", "us", "min", "h", "rpm", "Hz", "kHz", "MHz", "GHz", "kg", "g", "t", "lb"),
    *("N", "kN", "MN", "mN", "daN", "kgf", "lbf"),
    *("Nm", "kNm", "MNm", "mNm", "Nmm", "Ncm", "kNmm", "Pa", "kPa", "MPa", "GPa", "bar", "psi", "ksi", "kgm", "gcm"),
)
_TOLD_APART = {
    "grad": "grad may mean degree or gon: write deg or gon",
    "mil": "mil may mean an angle or a thousandth of an inch: write thou, um or mrad",
    "c": "c may be a centi or the speed of light: write the unit out",
    "hp": "hp is not one unit but several: use SI",
}
_SUPERSCRIPTS = str.maketrans("⁻¹²³⁴⁺", "-1234+")
_SIGNS = str.maketrans({"·": "*", "⋅": "*", "∙": "*", "•": "*", "\u2212": "-"})
_FACTOR = re.compile(r"([A-Za-zµμ°%]{1,20})(?:\^?([+-]?[1-4]))?")
_BETWEEN = re.compile(r"\s*([*/.]|-(?=[A-Za-z])|(?<=\s)(?=[A-Za-z]))\s*")
_RUN_TOGETHER = re.compile(r"([num]|da|[ckM])?(N)([nuµμmc]?m)|(kgf|kp|lbf)([nuµμmc]?m|in|ft)|(k?g)([mc]?m)")
_MOST_FACTORS = 6


class UnknownUnit(ValueError):
    """A unit cannot be read; the message says why."""


class Factor(NamedTuple):
    """The name of a unit and its exponent, as written."""

    name: str
    power: int


@functools.cache
def registry() -> Any:
    """The units of gearjax as a registry of pint."""
    import pint  # the import takes a fifth of a second, which a scene made in Python need not wait for

    known = pint.UnitRegistry(cast(Any, None), cache_folder=None)  # None: begin without any units
    known.load_definitions(_DEFINITIONS.splitlines())
    return known


def without_typography(text: str) -> str:
    """The text with spaces, minus signs and product signs as on a keyboard."""
    return " ".join(text.translate(_SIGNS).split())


def factors(text: str) -> tuple[Factor, ...]:
    """Split a unit into its names and their exponents, in the order written.

    Raises:
        UnknownUnit: the text is not a product of named units.
    """
    rest = text.translate(_SUPERSCRIPTS).replace("**", "^").strip()
    if set(rest) & set("'\"\u2032\u2033"):
        raise UnknownUnit("the signs ' and \" may mean angles or lengths: write arcmin, arcsec, ft or in")
    below, written = False, []
    if rest.startswith(("1/", "1 /", "/")):
        rest, below = rest.split("/", 1)[1].lstrip(), True
    while True:
        match = _FACTOR.match(rest)
        if match is None or len(written) == _MOST_FACTORS:
            raise UnknownUnit(f'unknown unit "{text}"')
        power = int(match[2] or 1)
        written.append(Factor(match[1], -power if below else power))
        rest = rest[match.end() :]
        if not rest:
            return tuple(written)
        sign = _BETWEEN.match(rest)
        if sign is None:
            raise UnknownUnit(f'unknown unit "{text}"')
        if below and sign[1] != "/":
            raise UnknownUnit(f'"{text}" is ambiguous: write a / before each unit of the denominator')
        below = below or sign[1] == "/"
        rest = rest[sign.end() :]


@functools.lru_cache(maxsize=1024)  # a configuration writes the same few units again and again
def unit_of(written: tuple[Factor, ...]) -> Any:
    """The unit of pint that is the product of some factors.

    Raises:
        UnknownUnit: a name is not known.
    """
    known = registry()
    whole = known.Unit("dimensionless")
    if len(written) == 2 and written[0] in (("U", 1), ("r", 1), ("tr", 1)) and written[1][0] in ("min", "s"):
        written = (Factor("turn", 1), written[1])  # U/min and r/min on nameplates count turns
    for factor in written:
        for name, power in _apart(factor):
            whole = whole * known.Unit(_canonical(name)) ** power
    return whole


def _apart(factor: Factor) -> Iterator[Factor]:
    """Split ``kNm`` into kN and m; an exponent belongs to the last unit, so that ``kgm^2`` is kg m^2."""
    match = _RUN_TOGETHER.fullmatch(factor.name)
    if match is None:
        yield factor
        return
    parts = "".join(match.group(1, 2)) if match[1] else next(filter(None, match.group(2, 4, 6)))
    yield Factor(parts, 1 if factor.power > 0 else -1)
    yield Factor(factor.name[len(parts) :], factor.power)


def _canonical(name: str) -> str:
    """The name under which pint knows a unit.

    Raises:
        UnknownUnit: the name is not a unit, or its prefix does not suit the unit.
    """
    if name in _TOLD_APART:
        raise UnknownUnit(_TOLD_APART[name])
    known = registry().parse_unit_name(name)
    if not known:
        raise UnknownUnit(f'unknown unit "{name}"')
    prefix, unit, _ = known[0]
    if prefix and prefix not in _PREFIXES.get(unit, ()):
        raise UnknownUnit(f'"{name}" is read as {prefix}{unit}')
    return f"{prefix}{unit}"


def _alike(name: str) -> list[str]:
    """Usual units whose names differ from a name only in capital letters."""
    return [usual for usual in _USUAL if usual.casefold() == name.casefold() and usual != name]


def variants(written: tuple[Factor, ...]) -> Iterator[tuple[Factor, ...]]:
    """The same unit with other capital letters in its names."""
    choices = [[factor, *(Factor(alike, factor.power) for alike in _alike(factor.name))] for factor in written]
    yield from itertools.product(*choices)


def as_written(written: tuple[Factor, ...]) -> str:
    """A unit as text such as ``kg*m^2/s^2``, from its factors."""
    above = [_powered(name, power) for name, power in written if power > 0]
    below = [_powered(name, -power) for name, power in written if power < 0]
    return "/".join(["*".join(above) or "1", *below])


def _powered(name: str, power: int) -> str:
    return name if power == 1 else f"{name}^{power}"
