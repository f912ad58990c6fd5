"""The meanings of the keys of a configuration, taken from the docstrings of the classes behind them."""

import functools
import inspect
import re
from collections.abc import Iterable, Mapping
from typing import Any

from gearjax import units
from gearjax.config.tables import as_toml
from gearjax.parameters import Parameter

_ENTRY = re.compile(r"    (\w+(?:, \w+)*): (.*)")


@functools.cache
def meanings(part: Any) -> dict[str, str]:
    """The ``Args`` of a class's docstring by name, without units: a configuration states the unit with each value."""
    _, _, listed = inspect.cleandoc(part.__doc__ or "").partition("Args:\n")
    texts: dict[str, str] = {}
    names: list[str] = []
    for line in listed.splitlines():
        if line and not line.startswith("    "):
            break
        entry = _ENTRY.fullmatch(line)
        if entry:
            names = entry[1].split(", ")
        for name in names:
            texts[name] = f"{texts.get(name, '')} {entry[2] if entry else line.strip()}".strip()
    return {name: _plain(text) for name, text in texts.items()}


def told(part: Any, names: Iterable[str], words: Mapping[str, str]) -> list[str]:
    """One line for each key, or for several keys with the same explanation: ``low, high: limits (a length)``.

    Args:
        part: the class.
        names: names of the keys.
        words: the allowed values in words, by name; a key may be missing here if they need no explanation.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for name in names:
        groups.setdefault((meanings(part).get(name, ""), words.get(name, "")), []).append(name)
    return [f"{', '.join(same)}: {both(*pair)}" for pair, same in groups.items()]


def both(meaning: str, words: str) -> str:
    """A meaning followed by the allowed values in brackets, unless the meaning names these values already."""
    names = re.findall(r'"\w+"', words)
    if meaning and names and all(name in meaning for name in names) and not re.sub(r'"\w+"| or |, ', "", words):
        return meaning
    return f"{meaning} ({words})" if meaning and words else meaning or words


def summary(part: Any) -> list[str]:
    """The paragraphs of a class's docstring above its ``Args``."""
    text = re.split(r"\n(?:Args|Raises|Example)\b.*:\n", inspect.cleandoc(part.__doc__ or ""))[0]
    return [f"{_plain(' '.join(paragraph.split()))}." for paragraph in text.split("\n\n")]


def _plain(text: str) -> str:
    """The text without the markup of a docstring and without units such as ``[m]``."""
    text = re.sub(r"`+([^`]*)`+", r"\1", text)
    text = re.sub(r",? ?(?:shape \(\w+,\)|\[[^\]\"]{1,9}\])", "", text)
    return re.sub(r"\s+([.,:;])(?!\.)", r"\1", text).strip(" ,;").removesuffix(".")


MOST_SHOWN = 1e5  # rad: wider bounds of an angle tell its user nothing


def limits(parameter: Parameter) -> str:
    """The allowed values of a parameter in words: ``a length, at least 1e-06 m and at most 1 m``."""
    words = [f'"{name}"' for name in parameter.names]
    if parameter.kind == "count":
        words.append("a whole number")
    elif parameter.kind == "counts":
        words.append("a list of whole numbers")
    elif parameter.kind == "list":
        words.append("a list of names")
    elif parameter.kind == "series" and parameter.dimension is not None:
        words.append(f"a list of {parameter.dimension.several}, [] for none")
    elif parameter.dimension is not None:
        words.append(parameter.dimension.described)
    elif not words:
        words.append("a name")
    if parameter.words:
        words.append('a name such as "crank"')
    low, high = parameter.range
    is_turns = parameter.dimension is units.ANGLE and high - low > MOST_SHOWN
    bounds = "" if is_turns else parameter.allowed()
    return " or ".join(words) + (f", {bounds}" if bounds else "")


def example(parameter: Parameter) -> str:
    """An example value that the declaration allows, as TOML."""
    if parameter.example is not None:
        return as_toml(parameter.example)
    if parameter.names:
        return as_toml(parameter.names[0])
    if parameter.kind == "count":
        return str(int(max(parameter.range[0], 1)))
    assert parameter.dimension is not None
    value = float(parameter.dimension.example) if not parameter.dimension.unit else parameter.dimension.example
    return as_toml([value] if parameter.kind == "series" else value)
