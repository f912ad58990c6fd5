"""Kinds of parts that a configuration may name: built-in ones, and those that programs register or plug-ins bring."""

import functools
import inspect
from importlib import metadata
from typing import Any, TypeVar, get_args

from gearjax.checks import GearjaxError, ParameterError
from gearjax.compliance import COMPLIANCES, AnyCompliance
from gearjax.errors import ERRORS, AbstractError
from gearjax.systems import SYSTEMS, AbstractSystem

T = TypeVar("T")

GROUPS: dict[str, tuple[type, ...]] = {
    "gearjax.systems": (AbstractSystem,),
    "gearjax.errors": (AbstractError,),
    "gearjax.compliances": get_args(AnyCompliance),
}
"""Groups of entry points that plug-ins are read from, and the base classes of the parts in each group."""

_kinds: dict[str, dict[str, Any]] = {
    "gearjax.systems": {part.kind: part for part in SYSTEMS},
    "gearjax.errors": {part.kind: part for part in ERRORS},
    "gearjax.compliances": {part.kind: part for part in COMPLIANCES},
}


def register(part: T) -> T:
    """Register your own gear set, error or compliance, so that configurations can name it by its ``kind``.

    The function may also be used as a decorator of the class. The registration holds in this process only. For the
    command ``gearjax``, a package lists its classes as entry points of the groups ``gearjax.systems``,
    ``gearjax.errors`` or ``gearjax.compliances``.

    Args:
        part: a final subclass of `AbstractSystem`, `AbstractError`, `AbstractCompliance`, `AbstractLineContact`,
            `AbstractCoupledCompliance` or `AbstractToothCompliance`.

    Returns:
        The same class.

    Raises:
        ParameterError: the part is something else or abstract, or its kind is not a name or belongs to another class.

    Example:
        >>> import gearjax as gj
        >>> gj.register(gj.TwoKV) is gj.TwoKV
        True
    """
    _add(part, _group_of(part))
    return part


def kinds(group: str) -> list[Any]:
    """Classes of a group, including those of plug-ins.

    Raises:
        GearjaxError: a plug-in is broken, or two parts have the same kind; the message names the package.
    """
    _read_plugins()
    return list(_kinds[group].values())


def _group_of(part: Any) -> str:
    for group, bases in GROUPS.items():
        if isinstance(part, type) and issubclass(part, bases):
            return group
    names = ", ".join(base.__name__ for bases in GROUPS.values() for base in bases)
    raise ParameterError("register", part, f"must be a class that is a subclass of one of {names}")


def _add(part: Any, group: str) -> None:
    """Add a class to a group."""
    kind, name = getattr(part, "kind", None), f"{part.__module__}.{part.__qualname__}"
    if inspect.isabstract(part):
        missing = ", ".join(sorted(part.__abstractmethods__))
        raise ParameterError("register", name, f"is abstract: it lacks {missing}")
    if not isinstance(kind, str) or not kind.isidentifier():
        raise ParameterError(f"{name}.kind", kind, 'must be a name of letters, digits and _, such as "spur_pair"')
    other = _kinds[group].get(kind, part)
    taken = f"{other.__module__}.{other.__qualname__}"
    if taken != name:  # a class of the same name is the same class, defined again in a notebook
        raise ParameterError(f"{name}.kind", kind, f"is the kind of {taken} already: choose another")
    _kinds[group][kind] = part


@functools.cache
def _read_plugins() -> None:
    """Add the classes that installed packages list as entry points, once per process."""
    for group in GROUPS:
        for entry in metadata.entry_points(group=group):
            package = entry.dist.name if entry.dist is not None else entry.module
            where = f'plug-in "{entry.name}" of package {package}'
            try:
                part = entry.load()
            except Exception as fault:  # importing a package may raise anything
                words = " ".join(f"{type(fault).__name__}: {fault}".split())
                raise GearjaxError(f"{where}: {entry.value} cannot be loaded ({words})") from fault
            try:
                own = _group_of(part)
                if own != group:
                    raise GearjaxError(f"{entry.value} belongs to the group {own}, not {group}")
                _add(part, group)
            except GearjaxError as fault:
                raise GearjaxError(f"{where}: {fault}") from fault
