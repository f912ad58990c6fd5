"""Fields of a part: each physical parameter is declared once, with its dimension and the values that it may have.

Configurations, error messages and tables read the declaration from the dataclass metadata. Every physical number is
stored as a floating-point array leaf, because a Python float would lead to one compilation per value. Tooth numbers and
names are static.
"""

import dataclasses
import math
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gearjax import units
from gearjax.checks import GearjaxError, ParameterError, is_concrete, nearest, shown

T = TypeVar("T", bound=eqx.Module)
TIGHT = 100.0  # largest ratio of upper to lower bound of a tightly bounded number
_LENGTHS = {"um": units.um, "mm": units.mm}
TIGHT_SPAN = 2.0  # largest difference of the bounds of a tightly bounded ratio or angle [rad]


@dataclasses.dataclass(frozen=True)
class Parameter:
    """Declaration of one field of a part: its dimension and the values that it may have.

    Args:
        dimension: physical dimension; ``None`` for tooth numbers and names.
        kind: ``"number"``, ``"series"`` (a list of numbers), ``"count"``, ``"counts"`` (a list of whole numbers),
            ``"name"`` or ``"list"`` (of names).
        above, at_least, below, at_most: bounds, in SI units.
        names: words that are allowed in place of a number, or the words that are allowed as a name.
        periodic: whether the number is an angle to which full turns may be added without effect.
        words: whether any word is allowed in place of a number; the scene checks the word.
        example: a sensible value as written in a configuration, such as ``"2.5 mm"`` or 12; ``None`` to use the example
            of the dimension.
        is_file: whether a name is that of a file or a folder; configurations look for it from their own folder on.
        negative: what to give in place of a negative number, in words.
    """

    dimension: units.Dimension | None
    kind: str = "number"
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    names: tuple[str, ...] = ()
    words: bool = False
    periodic: bool = False
    example: Any = None
    is_file: bool = False
    negative: str = ""

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest value; infinite if there is no bound."""
        low = [bound for bound in (self.above, self.at_least) if bound is not None]
        high = [bound for bound in (self.below, self.at_most) if bound is not None]
        return max(low, default=-math.inf), min(high, default=math.inf)

    @property
    def is_tight(self) -> bool:
        """Whether the bounds are close enough to search between them.

        Those of a pressure angle may be, those of a length of up to a metre are not.
        """
        low, high = self.range
        plain = self.dimension in (units.RATIO, units.ANGLE)
        return (low > 0 and high <= TIGHT * low) or (plain and high - low <= TIGHT_SPAN)

    @property
    def shown_in(self) -> tuple[str, float]:
        """Unit in which results show the number, and its size in SI; for a length the unit of the example."""
        if self.dimension is None:
            return "", 1.0
        first = self.example[0] if isinstance(self.example, list) and self.example else self.example
        unit = str(first or self.dimension.example).rpartition(" ")[2]
        if self.dimension is units.LENGTH and unit in _LENGTHS:
            return unit, _LENGTHS[unit]
        return self.dimension.shown, self.dimension.per_shown

    def allowed(self) -> str:
        """The bounds in words."""
        unit, size = (self.dimension.shown, self.dimension.per_shown) if self.dimension else ("", 1.0)
        words = [
            f"{word} {bound / size:g} {unit}".rstrip()
            for word, bound in (
                ("above", self.above),
                ("at least", self.at_least),
                ("below", self.below),
                ("at most", self.at_most),
            )
            if bound is not None
        ]
        return " and ".join(words)

    def right(self, value: Any) -> str:
        """What would be right in place of a value outside the bounds, in words."""
        words = f"must be {self.allowed() or 'finite'}"
        return f"{words}: {self.negative}" if self.negative and np.any(np.asarray(value) < 0) else words

    def holds(self, value: Any) -> bool:
        """Whether all values are finite and within the bounds."""
        value = np.asarray(value)
        return bool(
            np.all(np.isfinite(value))
            and (self.above is None or np.all(value > self.above))
            and (self.at_least is None or np.all(value >= self.at_least))
            and (self.below is None or np.all(value < self.below))
            and (self.at_most is None or np.all(value <= self.at_most))
        )


class Named(eqx.Module):
    """A word that stands for a number which another part defines (``"crank"``, ``"planet"``)."""

    name: str = eqx.field(static=True)

    def __str__(self) -> str:
        return self.name


def with_known(part: T, **known: Any) -> T:
    """A copy of a part, not checked again, with what is known of it beside its parameters.

    The fields of what is known are not arguments of the class, so that `dataclasses.replace` leaves them out: they do
    not outlive the parameters that they follow from.
    """
    copy = object.__new__(type(part))
    for field in dataclasses.fields(part):
        object.__setattr__(copy, field.name, known.get(field.name, getattr(part, field.name)))
    return copy


def known_beside() -> Any:
    """Field of a part for what is known of it beside its parameters (`with_known`)."""
    return eqx.field(init=False, default=None, repr=False)


def as_leaf(value: Any) -> Any:
    """The number as a floating-point array; an array that is floating-point already keeps its precision."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
        return value
    if is_concrete(value) and not is_numeric(value):
        raise GearjaxError(f"expected a number in SI, got {shown(value)}")
    return jnp.asarray(value, dtype=float)


def is_numeric(value: Any) -> bool:
    """Whether a value that is not traced is a real number, or an array of real numbers."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):  # rows of different lengths
        return False
    return array.dtype.kind in "iuf" or jnp.issubdtype(array.dtype, jnp.floating)


def strong(value: Any) -> Any:
    """The number as an array with a definite dtype; a weakly typed array would compile the program again."""
    leaf = as_leaf(value)
    # most arrays have a definite dtype already, and copies of all would take as long as a short analysis
    if not leaf.weak_type:
        return leaf
    if not is_concrete(leaf):
        return jnp.asarray(leaf, dtype=leaf.dtype)
    with jax.ensure_compile_time_eval():  # a known number stays one inside the trace of something else
        return jnp.asarray(leaf, dtype=leaf.dtype)


def leaf_or_given(value: Any) -> Any:
    """A number as an array; anything else stays as it is, for `check_parameters` to refuse by the name of its field."""
    return value if is_concrete(value) and not is_numeric(value) else as_leaf(value)


def leaf_or_named(value: Any) -> Any:
    """A number as an array, or a word as a `Named`."""
    return Named(value) if isinstance(value, str) else leaf_or_given(value)


def _field(parameter: Parameter, **keywords: Any) -> Any:
    return eqx.field(metadata={"parameter": parameter}, **keywords)


def number(dimension: units.Dimension, *, default: Any = dataclasses.MISSING, **bounds: Any) -> Any:
    """A field for a physical number of the given dimension.

    ``names=`` or ``words=True`` allow words in place of the number; ``default=None`` makes the number optional.
    """
    parameter = Parameter(dimension, **bounds)
    converter = leaf_or_named if parameter.names or parameter.words else leaf_or_given
    if default is None:
        return _field(parameter, converter=lambda value: None if value is None else converter(value), default=None)
    keywords = {} if default is dataclasses.MISSING else {"default": default}
    return _field(parameter, converter=converter, **keywords)


def length(**bounds: Any) -> Any:
    """A field for a length [m]."""
    return number(units.LENGTH, **bounds)


def angle(**bounds: Any) -> Any:
    """A field for an angle [rad]."""
    return number(units.ANGLE, **bounds)


def series(dimension: units.Dimension, *, default: Any = dataclasses.MISSING, **bounds: Any) -> Any:
    """A field for a list of numbers of the given dimension, of any length; one number becomes a list of one."""

    def listed(given: Any) -> Any:
        leaf = leaf_or_given(given)
        if isinstance(given, list | tuple) and np.ndim(leaf) > 1:  # lists in lists; arrays may be many parts at once
            return given
        return leaf.reshape(1) if isinstance(leaf, jax.Array) and not leaf.ndim else leaf

    keywords = {} if default is dataclasses.MISSING else {"default": default}
    return _field(Parameter(dimension, "series", **bounds), converter=listed, **keywords)


def count(
    *, default: Any = dataclasses.MISSING, at_least: int = 1, at_most: int = 100_000, example: int | None = None
) -> Any:
    """A static field for a whole number, such as a number of teeth; a change of it compiles the program again."""
    parameter = Parameter(None, "count", at_least=float(at_least), at_most=float(at_most), example=example)
    keywords = {} if default is dataclasses.MISSING else {"default": default}
    return _field(parameter, static=True, converter=_plain, **keywords)


def _plain(given: Any) -> Any:
    """Python's own whole numbers in place of numpy's, which JAX would trace."""
    return int(given) if isinstance(given, np.integer) else given


def counts(*, at_least: int = 1, at_most: int = 100_000, example: list[int] | None = None) -> Any:
    """A static field for a list of whole numbers, such as tooth numbers; a change of it compiles the program again."""

    def keep(given: Any) -> Any:
        return tuple(map(_plain, given)) if isinstance(given, list | tuple | np.ndarray) else given

    parameter = Parameter(None, "counts", at_least=float(at_least), at_most=float(at_most), example=example)
    return _field(parameter, static=True, converter=keep)


def name(*, default: Any = dataclasses.MISSING, names: tuple[str, ...] = ()) -> Any:
    """A static field for a word; one of ``names``, if these are given."""
    keywords = {} if default is dataclasses.MISSING else {"default": default}
    return _field(Parameter(None, "name", names=names), static=True, **keywords)


def file_name(*, default: Any = dataclasses.MISSING) -> Any:
    """A static field for the name of a file or a folder."""
    keywords = {} if default is dataclasses.MISSING else {"default": default}
    return _field(Parameter(None, "name", is_file=True), static=True, **keywords)


def name_list(*, example: Any = None) -> Any:
    """A static field for a list of words, such as names of bodies."""

    def keep(given: Any) -> Any:
        return tuple(given) if isinstance(given, list) else given

    return _field(Parameter(None, "list", example=example), static=True, converter=keep)


def declared(part: Any) -> dict[str, Parameter]:
    """The declared parameters of a part (class or instance), by field name."""
    return {
        field.name: field.metadata["parameter"] for field in dataclasses.fields(part) if "parameter" in field.metadata
    }


def check_parameters(part: Any) -> None:
    """Refuse values that the declarations of the fields do not allow.

    Traced values pass, because they cannot be read, and so do absent ones of fields that may be left out.

    Raises:
        ParameterError: a value is not allowed; the message names the field, the value and what would be right.
    """
    shapes = {}
    optional = {field.name for field in dataclasses.fields(part) if field.default is None}
    for key, parameter in declared(part).items():
        value = getattr(part, key)
        if value is None and key in optional:
            continue
        check_value(key, parameter, value)
        if parameter.kind == "number" and isinstance(value, jax.Array | np.ndarray):
            shapes[key] = value.shape
    if len(set(shapes.values())) > 1:  # many parts at once have the same leading axes everywhere
        key = next(key for key, shape in shapes.items() if shape)
        words = f"has shape {shapes[key]}, must be one number as the others are: make many parts by jax.vmap"
        raise ParameterError(key, getattr(part, key), words)


def check_value(key: str, parameter: Parameter, value: Any) -> None:
    """Refuse a value that the parameter's declaration does not allow.

    Raises:
        ParameterError: the value is not allowed; the message names the key, the value and what would be right.
    """
    if isinstance(value, Named):
        value = value.name
    if isinstance(value, str) and (parameter.names or parameter.words or parameter.kind == "name"):
        if parameter.names and value not in parameter.names:
            raise ParameterError(key, value, nearest(value, parameter.names))
        return
    if parameter.kind == "list":
        if not isinstance(value, tuple) or not value or not all(isinstance(word, str) for word in value):
            raise ParameterError(key, value, "must be a list of names in quotes")
        return
    if not is_concrete(value):
        return
    if parameter.kind == "counts":
        if not isinstance(value, tuple) or not value:
            raise ParameterError(key, value, "must be a list of whole numbers")
        for index, each in enumerate(value):
            check_value(f"{key}[{index}]", dataclasses.replace(parameter, kind="count"), each)
        return
    if parameter.kind == "series" and is_numeric(value) and not hasattr(value, "ndim") and np.ndim(value) > 1:
        raise ParameterError(key, value, "must be a list of numbers, not of lists")
    if parameter.kind != "count" and not is_numeric(value):
        raise ParameterError(key, value, "must be a number, in SI")
    if parameter.kind == "count" and (isinstance(value, bool) or not isinstance(value, (int, np.integer))):
        raise ParameterError(key, value, "must be a whole number")
    if parameter.kind == "count" and abs(int(value)) > 2**62:
        raise ParameterError(key, value, f"must be {parameter.allowed()}")
    if not parameter.holds(value):
        raise ParameterError(key, value, parameter.right(value))
