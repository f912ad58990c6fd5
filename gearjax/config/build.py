"""Building of a scene from the tables of a configuration. The keys of a table are the declared fields of its class."""

import dataclasses
import hashlib
import os
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gearjax.checks import MISSING, GearjaxError, ParameterError, check_name, check_path, nearest, with_article
from gearjax.clearance import InitialBacklash, ZeroAtStart
from gearjax.compliance import AbstractToothCompliance
from gearjax.config.measured import READERS
from gearjax.config.run import read_published, read_run
from gearjax.config.tables import Key, as_toml, keys_of, known_keys, read_parameter, require_keys, written
from gearjax.contact import HardContact, QuadraticContact, SoftplusContact
from gearjax.errors import AbstractError, MeasuredFlank
from gearjax.impact import MeshingImpact
from gearjax.inertia import BodyInertia, DampingRatio, EquivalentMass, MomentOfInertia
from gearjax.load_torque import LOADS
from gearjax.parameters import Parameter, declared
from gearjax.registry import kinds
from gearjax.scene import Scene
from gearjax.shafts import Shaft
from gearjax.supports import Support
from gearjax.systems import AbstractSystem, flank_radii

CONTAINS = "contains"  # key of a measured flank: the errors that its values contain by design
_LARGEST_FILE = 8_000_000  # bytes; 250,000 measured values written out in the file take 5 million
_SHORT = 40  # characters of a value that a message repeats as the only one of a list
_LONGEST_SERIES = 1_000_000
_DOTTED = re.compile(r"[^\s0-9]\s{0,3}\.|\.\s{0,3}\d{1,9}\s{0,3}\.")
CONTACTS = (HardContact, SoftplusContact, QuadraticContact)
REFERENCE_KEYS = {"zero": Key('"start" or "absolute"', '"start"', required=True)}
SECTIONS = (
    "system",
    "errors",
    "reference",
    "backlash",
    "compliance",
    "inertia",
    "damping",
    "impact",
    "supports",
    "shafts",
    "load",
    "contact",
    "run",
    "published",
    "optimise",
    "identify",
    "tolerance",
)


def load(path: str | Path) -> Scene:
    """Load a scene, with its run section, from a TOML file.

    Args:
        path: path of the file.

    Raises:
        GearjaxError: the file cannot be read, or something in it is wrong; the message is one line that says where.

    Example:
        >>> import gearjax as gj
        >>> scene = gj.load("configs/two_kv/wang_2020.toml")
        >>> scene.run.samples
        3001
    """
    return loads(read_file(path), Path(path).parent)


def read_file(path: str | Path) -> str:
    """Read the text of a configuration file.

    Raises:
        GearjaxError: the file cannot be read.
    """
    path = Path(path)
    check_path("CONFIG", path)
    try:
        if path.exists() and not path.is_file():
            raise GearjaxError(f"{path}: cannot be read (not a file)")
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise GearjaxError(f"{path}: {size} bytes, more than a configuration can have ({_LARGEST_FILE})")
        return path.read_text(encoding="utf-8-sig")
    except OSError as fault:
        raise GearjaxError(f"{path}: cannot be read ({fault.strerror or fault})") from fault
    except UnicodeDecodeError as fault:
        raise GearjaxError(f"{path}: not a text file in UTF-8") from fault


def loads(text: str, folder: str | Path = ".") -> Scene:
    """Load a scene, with its run section, from TOML text.

    Args:
        text: the configuration.
        folder: folder to which file names in the configuration are relative.

    Raises:
        GearjaxError: something in the text is wrong; the message is one line that says where.
    """
    return build(read_tables(text), folder)


def read_tables(text: str) -> dict[str, Any]:
    """Parse a TOML text into tables.

    Raises:
        GearjaxError: the text is not TOML.
    """
    for number, line in enumerate(text.splitlines(), start=1):
        if len(_DOTTED.findall(line)) > 50:  # the parser's time grows with the square of the number of parts of a key
            raise GearjaxError(f"not a TOML configuration: line {number} has a key of too many parts")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as fault:
        words = " ".join(str(fault).split(";")[0].split())[:120] or "nested too deeply"
        hint = ' (values with units are in quotes: module = "2.5 mm")' if "after a statement" in words else ""
        raise GearjaxError(f"not a TOML configuration: {words}{hint}") from fault


def build(tables: dict[str, Any], folder: str | Path = ".") -> Scene:
    """Build a scene from the tables of a configuration; the sections ``optimise`` and ``tolerance`` are checked too.

    Raises:
        ParameterError: a value is wrong; the message names the key, what was given and what would be right.
    """
    scene = scene_of(with_files(tables, Path(folder)))
    if "optimise" in tables or "tolerance" in tables:
        from gearjax.config.studies import check_studies  # brings along all that studies need: a second of imports

        check_studies(tables, scene, Path(folder))
    return scene


def with_files(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The tables of a configuration in a form that does not depend on a folder.

    Values of errors are read from their files into the tables. Names of files and folders in the compliance section are
    taken relative to ``folder`` and made absolute.

    Raises:
        GearjaxError: a file cannot be read, or something in it is wrong.
    """
    errors = tables.get("errors")
    if isinstance(errors, dict):
        tables = {**tables, "errors": {name: _read_in(name, table, folder) for name, table in errors.items()}}
    full = {key: os.path.abspath(folder / os.path.expanduser(name)) for key, name in _files_of(tables).items()}
    return {**tables, "compliance": {**tables["compliance"], **full}} if full else tables


def _files_of(tables: dict[str, Any]) -> dict[str, str]:
    """Names of files and folders in the compliance section, by key."""
    given = tables.get("compliance")
    if not isinstance(given, dict):
        return {}
    part = next((known for known in kinds("gearjax.compliances") if known.kind == given.get("kind")), None)
    files = [key for key, parameter in declared(part).items() if parameter.is_file] if part else []
    return {key: given[key] for key in files if isinstance(given.get(key), str) and given[key]}


def contents(tables: dict[str, Any]) -> dict[str, str]:
    """Hashes of the files that the tables of a configuration name still after `with_files`, by path of the key.

    A study belongs to the contents of these files, not to their names.
    """
    named = {key: Path(name) for key, name in _files_of(tables).items()}
    return {
        f"contents of compliance.{key}": hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        for key, path in named.items()
        if path.is_file()
    }


def _read_in(name: str, table: Any, folder: Path) -> Any:
    """The table of an error, with the values of its file if the table names one."""
    if not isinstance(table, dict) or "file" not in table or table.get("kind") not in READERS:
        return table
    key, kind = f"errors.{name}", table["kind"]
    if not isinstance(table["file"], str):
        raise ParameterError(f"{key}.file", table["file"], "must be the name of a CSV file in quotes")
    part = next(known for known in kinds("gearjax.errors") if known.kind == kind)
    try:
        values = READERS[kind](folder / os.path.expanduser(table["file"]), table.get("flank", "both"))
    except ParameterError as fault:
        raise ParameterError(f"{key}.{fault.key}", fault.given, fault.right) from fault
    except GearjaxError as fault:
        raise GearjaxError(f"{key}: {fault}") from fault
    both = [value for value in values if value in table and value != "flank"]
    if both:
        raise ParameterError(f"{key}.{both[0]}", table[both[0]], "is in the file too: give one of them")
    read = {value: written(given, declared(part)[value]) for value, given in values.items()}
    return {value: given for value, given in table.items() if value != "file"} | read


def scene_of(tables: dict[str, Any]) -> Scene:
    """The scene of tables that do not depend on a folder (`with_files`); sections of studies are not looked at.

    Raises:
        ParameterError: a value is wrong; the message names the key, what was given and what would be right.
    """
    for key in tables:
        if key not in SECTIONS:
            raise ParameterError(key, tables[key], f"unknown section; {nearest(key, SECTIONS)}")
        if not isinstance(tables[key], dict) and key != "published":
            raise ParameterError(key, tables[key], f"must be a section: [{key}]")
    if "system" not in tables:
        raise GearjaxError('no [system]: a configuration needs one, such as kind = "two_kv"')
    system = _one_of("system", tables["system"], kinds("gearjax.systems"))
    errors = {}
    contains: dict[str, Any] = {}
    for name, table in _tables("errors", tables).items():
        check_name("errors", name)
        if table.get("kind") == MeasuredFlank.kind and CONTAINS in table:
            contains[name] = table[CONTAINS]
            table = {key: value for key, value in table.items() if key != CONTAINS}
        errors[name] = _one_of(f"errors.{name}", table, kinds("gearjax.errors"))
    for name, design in contains.items():
        errors[name] = _without_design(name, design, errors, system)
    parts: dict[str, Any] = {}
    for section, known in (("compliance", kinds("gearjax.compliances")), ("load", LOADS), ("contact", CONTACTS)):
        if section in tables:
            parts[section] = _one_of(section, tables[section], known)
    compliance = parts.get("compliance")
    if isinstance(compliance, AbstractToothCompliance) and compliance.prepares and system.has_places:
        parts["compliance"] = compliance.made_for(*flank_radii(system))
    tables, of_bodies = _apart("inertia", tables)
    inertia = MomentOfInertia if "moment_of_inertia" in tables.get("inertia", {}) else EquivalentMass
    for section, part in (
        ("backlash", InitialBacklash),
        ("inertia", inertia),
        ("damping", DampingRatio),
        ("impact", MeshingImpact),
    ):
        if section in tables:
            parts[section] = _part(section, tables[section], part)
    for section, slot, part in (
        ("supports", "supports", Support),
        ("shafts", "shafts", Shaft),
        ("inertia", "body_inertia", BodyInertia),
    ):
        parts[slot] = {
            name: _part(f"{section}.{name}", table, part)
            for name, table in _tables(section, tables | of_bodies).items()
        }
    if "reference" in tables:
        parts["reference"] = _reference(tables["reference"])
    scene = Scene(system, errors, **parts)
    published = read_published(tables)
    if "run" in tables:
        scene = dataclasses.replace(scene, run=read_run(tables["run"], published, scene))
    return scene


def _without_design(name: str, design: Any, errors: dict[str, AbstractError], system: AbstractSystem) -> MeasuredFlank:
    """A measured flank without the designed modifications that its values contain, which are errors of their own."""
    key, measured = f"errors.{name}.{CONTAINS}", errors[name]
    assert isinstance(measured, MeasuredFlank)
    if not isinstance(design, list) or not all(isinstance(one, str) for one in design):
        raise ParameterError(key, design, 'must be a list of names of [errors.NAME], such as ["tip", "crowning"]')
    others = [one for one in errors if one != name]
    for one in design:
        if one not in others:
            raise ParameterError(key, one, nearest(one, others))
    size = system.gear_size(measured.body)
    if size is None:
        raise ParameterError(
            key, design, f"is not for {with_article(system.kind)}, which does not give the sizes of its gears"
        )
    try:
        return measured.without([errors[one] for one in design], size)
    except ParameterError as fault:
        raise ParameterError(key, fault.given, fault.right) from fault


def _apart(section: str, tables: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The tables without the inner sections of a section, such as ``[inertia.BODY]``, and the inner sections alone."""
    own = tables.get(section, {})
    inner = {key: value for key, value in own.items() if isinstance(value, dict)}
    rest = {key: value for key, value in own.items() if key not in inner}
    without = {key: value for key, value in tables.items() if key != section}
    return without | ({section: rest} if rest or (own and not inner) else {}), {section: inner}


def _tables(section: str, tables: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The inner sections of a section, such as ``[errors.NAME]``."""
    sections = tables.get(section, {})
    for name, table in sections.items():
        if not isinstance(table, dict):
            raise ParameterError(f"{section}.{name}", table, f"must be a section: [{section}.{name}]")
    return sections


def _reference(table: dict[str, Any]) -> ZeroAtStart | None:
    known_keys("reference", table, REFERENCE_KEYS)
    require_keys("reference", table, REFERENCE_KEYS)
    zero = table["zero"]
    if zero not in ("start", "absolute"):
        raise ParameterError("reference.zero", zero, 'must be "start" or "absolute"')
    return ZeroAtStart() if zero == "start" else None


def _one_of(path: str, table: dict[str, Any], kinds: Iterable[Any]) -> Any:
    """Build the part of the ``kind`` that a table names."""
    by_name = {part.kind: part for part in kinds}
    if "kind" not in table:
        raise ParameterError(f"{path}.kind", MISSING, nearest("", by_name))
    kind = table["kind"]
    if not isinstance(kind, str) or kind not in by_name:
        raise ParameterError(f"{path}.kind", kind, f"unknown kind; {nearest(kind, by_name)}")
    return _part(path, {key: value for key, value in table.items() if key != "kind"}, by_name[kind], kind)


def _part(path: str, table: dict[str, Any], part: Any, kind: str = "") -> Any:
    """Build a part from the values of its table."""
    parameters = declared(part)
    known_keys(path, table, parameters, f' of kind "{kind}"' if kind else "")
    require_keys(path, table, keys_of(part))
    values = {name: _value(f"{path}.{name}", given, parameters[name]) for name, given in table.items()}
    try:
        return part(**values)
    except ParameterError as fault:
        given = table.get(fault.key, fault.given)
        raise ParameterError(f"{path}.{fault.key}", given, fault.right) from fault


def _value(key: str, given: Any, parameter: Parameter) -> Any:
    """Read one value of a table, in SI."""
    if parameter.kind == "name":
        if not isinstance(given, str):
            raise ParameterError(key, given, "must be a name in quotes")
        return given
    if parameter.kind == "list":
        if not isinstance(given, list) or not all(isinstance(word, str) for word in given):
            raise ParameterError(key, given, 'must be a list of names such as ["wheel_1", "pinion_2"]')
        return given
    if parameter.kind == "counts":
        if not isinstance(given, list) or len(given) > _LONGEST_SERIES:
            raise ParameterError(key, given, "must be a list of whole numbers such as [19, 21]")
        return given
    if parameter.kind == "count":
        if isinstance(given, bool) or not isinstance(given, int):
            raise ParameterError(key, given, "must be a whole number")
        return given
    if parameter.kind == "series":
        if not isinstance(given, list):
            short = isinstance(given, str | int | float) and len(str(given)) < _SHORT and str(given).isprintable()
            if short:
                _number(key, given, parameter)  # a value that would be wrong in a list too is told as such
            example = as_toml([given]) if short else "[] for none"
            raise ParameterError(key, given, f"must be a list of values, such as {example}")
        if len(given) > _LONGEST_SERIES:
            raise ParameterError(key, given, f"must be a list of at most {_LONGEST_SERIES} values")
        return [_number(f"{key}[{index}]", value, parameter) for index, value in enumerate(given)]
    worded = parameter.names or parameter.words
    if worded and isinstance(given, str) and given.isidentifier():
        if parameter.names and given not in parameter.names:
            raise ParameterError(key, given, f"{nearest(given, parameter.names)}{_or_number(parameter)}")
        return given
    return _number(key, given, parameter)


def _or_number(parameter: Parameter) -> str:
    assert parameter.dimension is not None
    return f', or {parameter.dimension.described} such as "{parameter.dimension.example}"'


def _number(key: str, given: Any, parameter: Parameter) -> float:
    value = read_parameter(key, given, parameter)
    if not parameter.holds(value):
        raise ParameterError(key, given, parameter.right(value))
    return value
