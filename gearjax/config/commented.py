"""A commented configuration with every key, for ``gearjax new``, generated from the declarations of the parts."""

import dataclasses
import math
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from gearjax.analysis.choice import stiffness_order
from gearjax.checks import GearjaxError, ParameterError, SceneError, nearest, with_article
from gearjax.clearance import InitialBacklash, ZeroAtStart
from gearjax.config.build import CONTACTS, REFERENCE_KEYS, loads
from gearjax.config.distributions import COLUMN_KEYS, distribution_keys
from gearjax.config.identify import IDENTIFY_KEYS
from gearjax.config.meaning import both, example, limits, meanings, summary, told
from gearjax.config.optimise import OPTIMISE_KEYS, OptimiseSection
from gearjax.config.run import PUBLISHED_KEYS, RUN_KEYS
from gearjax.config.tables import Key, as_toml, keys_of
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
from gearjax.impact import MeshingImpact
from gearjax.inertia import OF_WAY, BodyInertia, DampingRatio, EquivalentMass, MomentOfInertia
from gearjax.load_torque import LOADS
from gearjax.parameters import Parameter, declared
from gearjax.registry import kinds
from gearjax.run import NEEDS, Published, Run
from gearjax.scene import Scene
from gearjax.scene_checks import require
from gearjax.studies.select import numbers
from gearjax.supports import Support
from gearjax.tolerance import DISTRIBUTIONS, Empirical
from gearjax.units import LENGTH

TOGETHER = "# Give either all of the next keys or none of them:"
INSTEAD = "# Instead of the one above:"
_WIDTH = 118
_TURNS = 40  # turns of the fastest order in the record of the example run
_PER_TURN = 20  # samples of one such turn
_PER_WAVE = 8  # samples of one wave of the mesh stiffness


def _slots() -> tuple[tuple[str, tuple[Any, ...]], ...]:
    """Sections of optional parts, and the kinds that each section may name."""
    return (
        ("backlash", (InitialBacklash,)),
        ("compliance", tuple(kinds("gearjax.compliances"))),
        ("inertia", (EquivalentMass, MomentOfInertia)),
        ("damping", (DampingRatio,)),
        ("load", LOADS),
        ("contact", CONTACTS),
    )


_EXAMPLES = {  # values of keys of distributions for which the example of the number that varies does not suit
    "low": "5 um",
    "high": "15 um",
    "sigma": 0.3,
    "std": "1 um",
    "scale": "1 um",
    "probabilities": [1.0],
    "grade": 6,
    "module": "2.5 mm",
    "diameter": "125 mm",
    "size": "50 mm",
}


def template(kind: str) -> str:
    """A configuration of a gear set, with every key of every section that suits the gear set.

    A required key has a value with which the configuration runs. An optional key is commented out, with its default or,
    if it has none, with an example. ``# `` begins an explanation; ``#`` without a space begins a line to activate.

    Args:
        kind: kind of the gear set, such as ``"two_kv"``.

    Raises:
        GearjaxError: there is no such kind, or the examples of its declared fields give no gear set that loads.

    Example:
        >>> from gearjax.config import loads, template
        >>> loads(template("two_kv")).system.planets
        2
    """
    systems = {system.kind: system for system in kinds("gearjax.systems")}
    if kind not in systems:
        raise ParameterError("new", kind, f"unknown kind of gear set; {nearest(kind, systems)}")
    head = _prose(
        f"{with_article(kind).capitalize()} reducer: gearjax run FILE. Physical values have their unit, such "
        'as "30 N*m". Lines that begin with # and a space explain; remove the # in front of a key to use it.'
    )
    try:
        text = head + _part("system", systems[kind], kind)
        text = head + _part("system", systems[kind], kind, _together(text))
        scene = loads(text)
    except ParameterError as fault:
        raise GearjaxError(
            f"new {kind}: its fields give no example that loads, declare some with example=...: {fault}"
        ) from fault
    text += _errors(text, scene)
    text += _reference(text)
    for slot, parts in _slots():
        text += _slot(text, slot, parts)
    text += _impact(text) + _supports(text, scene)
    text += _run(loads(text))
    for section in (_optimise, _identify, _tolerance):
        text += _if_it_loads(text, section(loads(text)))
    return _noted(text)


def _prose(words: str) -> str:
    """A text as wrapped comment lines."""
    return "".join(f"# {line}\n" for line in textwrap.wrap(words, _WIDTH, break_long_words=False))


def _line(name: str, key: Key, meaning: str, value: str = "", *, active: bool | None = None) -> str:
    """The line of a key, with its meaning above it; the line is commented out if the key is optional."""
    value = value or (key.example if key.required else key.default or key.example)
    mark = "" if (key.required if active is None else active) else "#"
    default = f"; default {key.default}" if key.default else "" if key.required else "; may be left out"
    says = both(meaning, key.words)
    return f"{_prose(says + default)}{mark}{name} = {value}\n" if value else _prose(f"{name}: {says}{default}")


def _keys(part: Any, given: Mapping[str, str] | None = None, last: Iterable[str] = ()) -> str:
    """The lines of the keys of a part, from its fields; the keys in ``last`` stand together at the end."""
    says, parameters = meanings(part), declared(part)
    lines = {}
    for name, key in keys_of(part).items():
        own = dataclasses.replace(key, words=limits(parameters[name]))
        value = (given or {}).get(name) or (key.default or example(parameters[name]))
        lines[name] = _line(name, own, says.get(name, ""), value)
    alone = "".join(line for name, line in lines.items() if name not in last)
    return alone + (f"{TOGETHER}\n{''.join(lines[name] for name in last)}" if last else "")


def _part(path: str, part: Any, kind: str = "", last: Iterable[str] = (), **given: str) -> str:
    """The section of one part."""
    named = f'kind = "{kind}"\n' if kind else ""
    prose = "".join(map(_prose, summary(part)))
    return f"\n{prose}[{path}]\n{named}{_keys(part, given, tuple(last))}"


def _commented(section: str) -> str:
    """A section that can be activated as a whole, without comments, which the active section above has already."""
    lines = [line for line in section.strip().splitlines() if not line.startswith("#")]
    return "".join(f"#{line}\n" for line in lines)


def options(text: str) -> list[tuple[int, ...]]:
    """Numbers of the lines of a template that can be activated, each line by itself or a block of lines together."""
    lines = text.splitlines()
    blocks: list[tuple[int, ...]] = []
    block: list[int] = []
    together = section = False
    for place, line in enumerate([*lines, ""]):
        together = together or line == TOGETHER
        section = section or line.startswith("#[")
        if together or section:
            if line.startswith("#") and not line.startswith("# "):
                block.append(place)
            elif not line or (section and not line.startswith("#")):
                blocks.append(tuple(block))
                block, together, section = [], False, False
        elif line.startswith("#") and not line.startswith("# "):
            blocks.append((place,))
    return blocks


def put_in(text: str, places: Iterable[int]) -> str:
    """The template with some lines activated; they replace the key or the section to which they are an alternative."""
    places = tuple(places)
    lines = text.splitlines()
    first = lines[places[0]][1:]
    if first.startswith("[[") or (first not in lines and first.startswith("[")):
        dropped = range(0)
    elif first.startswith("["):
        begin = lines.index(first)
        dropped = range(begin, next(i for i in range(begin, len(lines)) if not lines[i]))
    else:
        begin = max(i for i in range(places[0]) if lines[i].startswith("["))
        key = first.split(" = ")[0]
        dropped = [i for i in range(begin, places[0]) if lines[i].split(" = ")[0] == key]
    kept = (line[1:] if i in places else line for i, line in enumerate(lines) if i not in dropped)
    return "\n".join(kept) + "\n"


def _noted(text: str) -> str:
    """The template with a note above each section that cannot be activated without another change."""
    lines, notes = text.splitlines(), {}
    for places in options(text):
        if lines[places[0]].startswith("#["):
            try:
                loads(put_in(text, places))
            except GearjaxError as fault:
                notes[places[0]] = _prose(f"Other sections must change too: {fault}")
    return "".join(f"{notes.get(i, '')}{line}\n" for i, line in enumerate(lines))


def _together(text: str) -> list[str]:
    """Keys that a section accepts only all together."""
    apart = [places[0] for places in options(text) if _fault(put_in(text, places))]
    return [text.splitlines()[place][1:].split(" = ")[0] for place in apart]


def _fault(text: str) -> str:
    """What is wrong with a configuration; empty if nothing is wrong."""
    try:
        loads(text)
    except GearjaxError as fault:
        return fault.right if isinstance(fault, ParameterError) else str(fault)
    return ""


def _if_it_loads(text: str, section: str) -> str:
    fault = _fault(text + section)
    return f"\n{_prose(f'Left out: {fault}')}" if fault else section


def _errors(text: str, scene: Scene) -> str:
    """A section for each kind of error, on the first body that can have it."""
    sections = "\n" + _prose(
        "Errors: one section [errors.NAME] for each error. Choose any NAME; it stands in paths such as "
        f"errors.NAME.amplitude. Bodies: {', '.join(scene.system.bodies)}."
    )
    refused: dict[str, list[str]] = {}
    for part in kinds("gearjax.errors"):
        fault = "it has no bodies"
        for body in scene.system.bodies:
            section = _part(f"errors.{part.kind}", part, part.kind, body=as_toml(body))
            fault = _fault(text + section)
            if not fault:
                sections += section
                break
        if fault:
            refused.setdefault(fault, []).append(part.kind)
    for fault, names in refused.items():
        words = f"No {', '.join(names)} for {with_article(scene.system.kind)}: {fault}"
        sections += f"\n{_prose(words)}"
    return sections


def _reference(text: str) -> str:
    key = REFERENCE_KEYS["zero"]
    section = f"\n{''.join(map(_prose, summary(ZeroAtStart)))}[reference]\n{_line('zero', key, '')}"
    return _if_it_loads(text, section)


def _slot(text: str, slot: str, parts: Iterable[Any]) -> str:
    """The sections of an optional part: the first kind that suits the gear set, and the others commented out."""
    sections = ""
    for part in parts:
        kind = getattr(part, "kind", "")
        section = _part(slot, part, kind)
        fault = _fault(text + section)
        if fault:
            sections += f"\n{_prose(f'No [{slot}] {kind}: {fault}')}"
        elif f"[{slot}]" not in sections.splitlines():
            sections += section
        else:
            words = {name: limits(parameter) for name, parameter in declared(part).items()}
            prose = "".join(map(_prose, summary(part) + told(part, words, words)))
            sections += f"\n{prose}{INSTEAD}\n{_commented(section)}"
    return sections


def _impact(text: str) -> str:
    """The section of impacts, commented out; empty if the gear set has none."""
    section = _part("impact", MeshingImpact)
    if _fault(text + section):
        return ""
    known = declared(MeshingImpact)
    says = summary(MeshingImpact) + told(MeshingImpact, dict.fromkeys(known), {n: limits(p) for n, p in known.items()})
    keys = "".join(f"{name} = {example(parameter)}\n" for name, parameter in known.items())
    return f"\n{''.join(map(_prose, says))}{_commented(f'[impact]{chr(10)}{keys}')}"


def _supports(text: str, scene: Scene) -> str:
    """Support and inertia of the first body that may have them, commented out."""
    offered = scene.system.coordinates
    if not offered:
        return ""
    body = next(iter(offered))
    keys = [key for way in offered[body] for key in (way, f"{way}_damping")]
    inertia = dict.fromkeys(OF_WAY[way] for way in offered[body])
    words = f"Supports, one section [supports.BODY] for each body, and the inertia of the bodies: {', '.join(offered)}."
    section, says = "", [words]
    for slot, part, names in (("supports", Support, keys), ("inertia", BodyInertia, inertia)):
        known = declared(part)
        section += f"[{slot}.{body}]\n" + "".join(f"{name} = {example(known[name])}\n" for name in names)
        words = {name: limits(known[name]) for name in names}
        says += summary(part) + told(part, words, words)
    if _fault(text + section):
        return ""
    return f"\n{''.join(map(_prose, says))}{_commented(section)}"


def _run(scene: Scene) -> str:
    """The run section: all analyses that the scene allows, over some turns of the fastest order."""
    orders = {name: order for name, order in scene.system.orders.items() if name != "mesh"}
    turns = min(_TURNS, max(orders.values()) * scene.system.cycle / (2 * math.pi))
    duration = turns * 2 * math.pi / (max(orders.values()) * float(scene.system.input_speed))
    waves = stiffness_order(scene) * float(scene.system.input_speed) * duration / (2 * math.pi)
    of_waves = waves * _PER_WAVE if _can(scene, "dynamic") else 0.0
    given = {
        "duration": f'"{duration:.4g} s"',
        "samples": str(math.ceil(max(turns * _PER_TURN, of_waves)) + 1),
        "analyses": as_toml([analysis for analysis in NEEDS if _can(scene, analysis)]),
        "torques": RUN_KEYS["torques"].example,
    }
    lines = "".join(
        _line(name, key, meanings(Run)[name], given.get(name, ""), active=name in given)
        for name, key in RUN_KEYS.items()
    )
    published = "".join(f"#{name} = {key.example}\n" for name, key in PUBLISHED_KEYS.items())
    words = {name: key.words for name, key in PUBLISHED_KEYS.items()}
    says = "".join(map(_prose, summary(Published) + told(Published, words, words)))
    return f"\n{_prose('Settings of gearjax run.')}[run]\n{lines}\n{says}#[[published]]\n{published}"


def _can(scene: Scene, analysis: str) -> bool:
    try:
        require(scene, analysis, *NEEDS[analysis])
    except SceneError:
        return False
    return True


def _phases(scene: Scene) -> list[str]:
    return [path for path, parameter in numbers(scene).items() if parameter.periodic and path.startswith("errors.")]


def _optimise(scene: Scene) -> str:
    """The section of ``gearjax optimise``; the free numbers are the phases of the errors."""
    phases, says = _phases(scene), meanings(OptimiseSection)
    assert scene.run is not None
    bounds = "{ " + ", ".join(f'"{path}" = ["-90 deg", "90 deg"]' for path in phases) + " }"
    given = {"where": as_toml(phases), "bounds": bounds, "window": f'"{scene.run.duration:.4g} s"'}
    terms = '[{ name = "static_order", torque = "30 N*m", order = "output", weight = 1.0 }]'
    about = "Settings of gearjax optimise, which optimises assembly phases or any other numbers."
    section = f"\n{_prose(about)}[optimise]\n"
    for name, key in OPTIMISE_KEYS.items():
        if name in ("torque", "order"):  # they belong to the objective and are only explained
            section += _prose(f"{name}: {key.words}")
            continue
        value = given.get(name) or key.example or key.default
        section += _line(name, key, says.get(name, ""), value)
        if name == "objective":
            section += f"{INSTEAD}\n#objective = {terms}\n"
    return section


def _identify(scene: Scene) -> str:
    """The section of ``gearjax identify``; the unknowns are the errors."""
    errors, vectors = (
        list(dict.fromkeys(path.rpartition(".")[0] for path in paths))
        for paths in ([path for path in numbers(scene) if path.startswith("errors.")], _phases(scene))
    )
    given = {
        "where": as_toml(errors),
        "priors": f'{{ "{vectors[0]}" = "5 um" }}' if vectors else "",
        "reassemble": f'{{ where = {as_toml(vectors)}, metric = "std" }}' if vectors else "",
    }
    about = "Settings of gearjax identify; gearjax compare reads the same recordings."
    lines = "".join(_line(name, key, "", given.get(name, "")) for name, key in IDENTIFY_KEYS.items())
    return f"\n{_prose(about)}[identify]\n{lines}"


def _tolerance(scene: Scene) -> str:
    """The section of ``gearjax tolerance``; the errors vary."""
    known, says = numbers(scene), meanings(ToleranceSection)
    sizes = [path for path in known if path.startswith("errors.") and path.endswith("amplitude")]
    measures = '[{ name = "no_load.peak_to_peak", limit = "2 arcmin" }]'
    section = f"\n{_prose('Settings of gearjax tolerance.')}[tolerance]\n"
    for name, key in TOLERANCE_KEYS.items():
        value = {"measures": measures}.get(name, key.default)
        section += _line(name, key, says.get(name, ""), value)
        if name == "measures":
            section += "".join(_prose(f"{each}: {one.words}") for each, one in MEASURE_KEYS.items())
    section += _prose("Numbers that vary, by path; [*] stands for every number of a list.")
    section += "".join(f'"{path}" = {{ kind = "uniform_phase" }}\n' for path in _phases(scene))
    for path in sizes:
        section += f'"{path}" = {{ kind = "rayleigh", scale = "1 um" }}\n'
    if sizes:
        section += _prose("Alternatives to the last distribution:") + _distributions(sizes[-1], known[sizes[-1]])
    return section + _studies(sizes, _phases(scene))


def _distributions(path: str, parameter: Parameter) -> str:
    """Every distribution that a number may have, commented out."""
    lines = ""
    for part in DISTRIBUTIONS:
        keys = distribution_keys(part, parameter)
        lines += "".join(map(_prose, [f"{part.kind}: {' '.join(summary(part))}", *told(part, keys, {})]))
        if part is Empirical:
            says = "; ".join(f"{name}: {key.words}" for name, key in COLUMN_KEYS.items())
            lines += _prose(f"or, in place of values, from a CSV file: {says}")
        if part.kind == "uniform_phase":
            continue
        declared_of = {field.name: field.metadata["parameter"] for field in dataclasses.fields(part) if field.metadata}
        entries = {"kind": part.kind} | {name: _drawn(name, declared_of[name]) for name in keys}
        lines += f'#"{path}" = {{ {", ".join(f"{name} = {as_toml(value)}" for name, value in entries.items())} }}\n'
    return lines


def _drawn(name: str, parameter: Parameter) -> Any:
    """An example value for one key of a distribution of lengths."""
    if name in _EXAMPLES:
        return _EXAMPLES[name]
    if parameter.names:
        return parameter.names[0]
    return [LENGTH.example] if parameter.kind == "series" else LENGTH.example


def _studies(sizes: list[str], phases: list[str]) -> str:
    """The further studies, each commented out as a whole."""
    costs = "{ " + ", ".join(f'"{path}" = 1.0' for path in sizes) + " }"
    measure = '"no_load.peak_to_peak"'
    sections: dict[str, tuple[Any, dict[str, Key], dict[str, str]]] = {
        "sensitivity": (object, SENSITIVITY_KEYS, {}),
        "allocation": (Allocation, ALLOCATION_KEYS, {"measure": measure, "cost": costs}),
        "assembly": (Assembly, ASSEMBLY_KEYS, {"measure": measure, "where": as_toml(phases)}),
    }
    studies = ""
    for name, (part, keys, given) in sections.items():
        words = {each: key.words + (f"; default {key.default}" if key.default else "") for each, key in keys.items()}
        sensitivity = ["Sensitivity to each tolerance, and the yield with each tolerance halved"]
        about = summary(part) if part is not object else sensitivity
        says = "".join(map(_prose, about + told(part, keys, words)))
        lines = "".join(f"#{each} = {given.get(each) or key.default or key.example}\n" for each, key in keys.items())
        studies += f"\n{says}#[tolerance.{name}]\n{lines}"
    return studies
