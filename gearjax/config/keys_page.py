"""The page of all keys of a configuration, in Markdown, generated from the declarations of the parts."""

from collections.abc import Iterable, Mapping
from typing import Any

from gearjax.clearance import InitialBacklash, ZeroAtStart
from gearjax.config.build import CONTACTS, CONTAINS, REFERENCE_KEYS
from gearjax.config.distributions import COLUMN_KEYS, distribution_keys
from gearjax.config.identify import IDENTIFY_KEYS
from gearjax.config.meaning import both, limits, meanings, summary
from gearjax.config.measured import READERS
from gearjax.config.optimise import OPTIMISE_KEYS, TERM_KEYS, OptimiseSection
from gearjax.config.run import PUBLISHED_KEYS, RUN_KEYS
from gearjax.config.tables import Key, keys_of
from gearjax.config.tolerance import (
    ALLOCATION_KEYS,
    ASSEMBLY_KEYS,
    MEASURE_KEYS,
    SENSITIVITY_KEYS,
    TOLERANCE_KEYS,
    Allocation,
    Assembly,
    ToleranceSection,
)
from gearjax.errors import MeasuredFlank
from gearjax.impact import MeshingImpact
from gearjax.inertia import BodyInertia, DampingRatio, EquivalentMass, MomentOfInertia
from gearjax.load_torque import LOADS
from gearjax.markdown import plain
from gearjax.parameters import Parameter, declared
from gearjax.registry import kinds
from gearjax.run import Published, Run
from gearjax.shafts import Shaft
from gearjax.supports import Support
from gearjax.tolerance import DISTRIBUTIONS, Empirical
from gearjax.units import LENGTH

HEAD = """\
# Every key of a configuration

This page is generated from the source of gearjax; a test fails if it is out of date. `gearjax new KIND` writes a
configuration of a gear set with every key that suits the gear set.

A configuration is a TOML file. Physical values are strings with their unit, such as `"30 N*m"` or `"10 um"`; ratios
are numbers or `"5 %"`. A key without a default must be given, unless the table says "may be left out". Bounds are in
SI units or in usual units such as `deg` and `rpm`.
"""
OF_DESIGN = "names of the errors of the same gear that the measured values contain by design"
FILE = "the name of a CSV file in quotes, in place of the values"


def keys_page() -> str:
    """The text of the page: every section with its keys, their meanings, units, bounds and defaults."""
    chapters = {
        "The gear set": _of_kinds("system", kinds("gearjax.systems")),
        "Errors": _of_kinds("errors.NAME", kinds("gearjax.errors")),
        "Contact, backlash and compliance": [
            _section("[reference]", summary(ZeroAtStart), _rows(REFERENCE_KEYS)),
            _part("[backlash]", InitialBacklash),
            *_of_kinds("compliance", kinds("gearjax.compliances")),
            *_of_kinds("contact", CONTACTS),
        ],
        "Inertia, damping, impact, supports, shafts, load": [
            _part("[inertia], as a mass", EquivalentMass),
            _part("[inertia], about the axis of the output", MomentOfInertia),
            _part("[inertia.BODY]", BodyInertia),
            _part("[damping]", DampingRatio),
            _part("[impact]", MeshingImpact),
            _part("[supports.BODY]", Support),
            _part("[shafts.NAME]", Shaft),
            *_of_kinds("load", LOADS),
        ],
        "gearjax run": [
            _section("[run]", summary(Run), _rows(RUN_KEYS, Run)),
            _section("[[published]]", summary(Published), _rows(PUBLISHED_KEYS, Published)),
        ],
        "gearjax optimise": [
            _section("[optimise]", summary(OptimiseSection), _rows(OPTIMISE_KEYS, OptimiseSection)),
            _section("A term of a list in objective", [], _rows(TERM_KEYS)),
        ],
        "gearjax compare, gearjax identify": [_section("[identify]", [], _rows(IDENTIFY_KEYS))],
        "gearjax tolerance": _tolerance(),
    }
    return HEAD + "".join(f"\n## {title}\n" + "".join(sections) for title, sections in chapters.items())


def _tolerance() -> list[str]:
    """The sections of the tolerance study: measures, distributions and further studies."""
    about = [
        "The numbers that vary are listed by path, each with a distribution; [*] stands for every number of a list.",
        "Values of a distribution have the unit of the number that varies; the tables below show them for a length.",
    ]
    sections = [
        _section("[tolerance]", about, _rows(TOLERANCE_KEYS, ToleranceSection)),
        _section("A measure", [], _rows(MEASURE_KEYS)),
    ]
    for part in DISTRIBUTIONS:
        rows = _rows(distribution_keys(part, Parameter(LENGTH)), part)
        rows += [(name, key.words, key.default) for name, key in COLUMN_KEYS.items()] if part is Empirical else []
        sections.append(_section(f'A distribution, kind = "{part.kind}"', summary(part), rows))
    about = ["Sensitivity to each tolerance, and the yield with each tolerance halved."]
    return [
        *sections,
        _section("[tolerance.sensitivity]", about, _rows(SENSITIVITY_KEYS)),
        _section("[tolerance.allocation]", summary(Allocation), _rows(ALLOCATION_KEYS, Allocation)),
        _section("[tolerance.assembly]", summary(Assembly), _rows(ASSEMBLY_KEYS, Assembly)),
    ]


def _of_kinds(path: str, parts: Iterable[Any]) -> list[str]:
    return [_part(f'[{path}] kind = "{part.kind}"', part) for part in parts]


def _part(title: str, part: Any) -> str:
    """The section of the page for one part of the scene."""
    rows = _rows(_of_fields(part), part)
    if getattr(part, "kind", "") in READERS:
        rows.append(("file", FILE, "may be left out"))
    if getattr(part, "kind", "") == MeasuredFlank.kind:
        rows.append((CONTAINS, OF_DESIGN, "may be left out"))
    return _section(title, summary(part), rows)


def _of_fields(part: Any) -> dict[str, Key]:
    """The keys of a part, with unit and bounds in words."""
    known, keys = declared(part), keys_of(part)
    return {name: Key(limits(known[name]), default=key.default, required=key.required) for name, key in keys.items()}


def _rows(keys: Mapping[str, Key], part: Any = None) -> list[tuple[str, str, str]]:
    """Name, meaning and default of each key."""
    says = meanings(part) if part is not None else {}
    rows = []
    for name, key in keys.items():
        without = f"`{key.default}`" if key.default else "" if key.required else "may be left out"
        rows.append((name, both(says.get(name, ""), key.words), without))
    return rows


def _section(title: str, paragraphs: Iterable[str], rows: Iterable[tuple[str, str, str]]) -> str:
    about = "".join(f"{plain(paragraph)}\n\n" for paragraph in paragraphs)
    table = "".join(f"| `{name}` | {plain(words)} | {default} |\n" for name, words, default in rows)
    head = "| key | meaning | default |\n|---|---|---|\n"
    return f"\n### `{title}`\n\n{about}" + (head + table if table else "No keys.\n")
