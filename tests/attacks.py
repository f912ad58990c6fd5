"""Configurations made wrong at random, the same ones for the same seed."""

import copy
import re
import tomllib
from collections.abc import Iterator
from typing import Any

import numpy as np
import tomli_w

from tests.conftest import ROOT

SHIPPED = sorted(path for path in (ROOT / "configs").rglob("*.toml") if not path.with_suffix(".csv").exists())
VALUES: tuple[Any, ...] = (
    *(
        float("nan"),
        float("inf"),
        float("-inf"),
        1e308,
        -1e308,
        1e-320,
        10**18,
        -(10**18),
        0,
        -1,
        1,
        2,
        3.5,
        True,
        False,
    ),
    *(
        "",
        " ",
        "0",
        "nan",
        "nan mm",
        "inf N*m",
        "-5 mm",
        "1e300 km",
        "5 kg",
        "3 deg",
        "7 rpm",
        "1 Hz",
        "0 s",
        "1e-300 s",
    ),
    *("10 dB*m", "5 degC", "3 dBm", "100 J", "10'", "2,5 mm", "5 furlong", "mm", "5 mm mm mm mm mm mm mm mm", "²5 mm"),
    *(
        "\0",
        "a\0b",
        "x" * 10_000,
        "9" * 3000 + " mm",
        "\u202e5 mm",
        "\U0001d7d9\U0001d7da mm",
        "५ mm",
        "🦷",
        "\x1b[31m",
        "line\nline",
        "\\",
        '"',
    ),
    *("errors.planet_1.phase", "errors.pins.outward[*]", "../../etc/passwd", "/dev/zero", "two_kv", "hard", "planet_1"),
    *([], [[]], [["x"]], [[1.0, 2.0], [3.0]], {}, {"kind": {}}, {"a": {"b": {"c": 1}}}, [{}]),
    *(["5 mm"] * 3, [0.1] * 2000, [float("nan")], {"kind": "normal"}, {"kind": ["x"]}, ["no_load", "no_load"]),
)
NAMES = (
    "a.b",
    "",
    " ",
    "[0]",
    "x" * 500,
    "\0",
    "ä",
    "kind",
    "errors",
    "errors.pins",
    "__class__",
    "1",
    "a b",
    '"',
    "*",
)
SNIPPETS = (
    "[",
    "]",
    "]]",
    "=",
    '"',
    "'",
    "\n",
    "#",
    "\0",
    "\ufeff",
    "\u2028",
    "{",
    "}",
    ",",
    "nan",
    "0x",
    "1_0",
    '"""',
    "é",
)


def attacks(number: int, seed: int) -> Iterator[bytes]:
    """Mutated configurations, from the shipped ones in turn."""
    texts = [path.read_text(encoding="utf-8") for path in SHIPPED]
    for index in range(number):
        rng = np.random.default_rng([seed, index])
        text = texts[index % len(texts)]
        yield _in_tables(text, rng).encode() if rng.random() < 0.65 else _in_text(text, rng)


def _in_tables(text: str, rng: np.random.Generator) -> str:
    """One to three values or keys changed."""
    tables = tomllib.loads(text)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        tables = copy.deepcopy(tables)
        owner, key = _place(tables, rng)
        choice = rng.random()
        if choice < 0.3:
            owner[key] = _scaled(owner[key], rng)
        elif choice < 0.65:
            owner[key] = copy.deepcopy(VALUES[rng.integers(len(VALUES))])
        elif choice < 0.75:
            del owner[key]
        elif isinstance(owner, dict) and choice < 0.9:
            owner[_renamed(key, rng)] = owner.pop(key)
        elif isinstance(owner, dict):
            other, there = _place(tables, rng)
            owner[key] = copy.deepcopy(other[there])
        else:
            owner.insert(key, copy.deepcopy(owner[key]))
    return tomli_w.dumps(tables)


def _place(tables: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """A table or list somewhere in the tables, and a key in it."""
    owner: Any = tables
    while True:
        keys = list(owner) if isinstance(owner, dict) else list(range(len(owner)))
        key = keys[rng.integers(len(keys))]
        inner = owner[key]
        if not isinstance(inner, dict | list) or not inner or rng.random() < 0.15:
            return owner, key
        owner = inner


def _scaled(value: Any, rng: np.random.Generator) -> Any:
    """A number of another size, with its unit."""
    factor = float(10 ** rng.uniform(-15, 15)) * rng.choice([-1, 1, 1, 1]) if rng.random() < 0.5 else rng.uniform(0, 3)
    match = re.match(r"-?\d+(?:\.\d+)?(?:e-?\d+)?(?= ?[a-zA-Z])", value) if isinstance(value, str) else None
    if match:
        return f"{float(match[0]) * factor:.6g}{value[match.end() :]}"
    return type(value)(value * factor) if isinstance(value, int | float) and value == value else value


def _renamed(key: str, rng: np.random.Generator) -> str:
    if rng.random() < 0.5:
        return NAMES[rng.integers(len(NAMES))]
    place = int(rng.integers(len(key) + 1))
    return key[:place] + "xyz._"[rng.integers(5)] + key[place:]


def _in_text(text: str, rng: np.random.Generator) -> bytes:
    """The text cut, spoilt, doubled or shuffled."""
    lines, raw, choice = text.splitlines(), text.encode(), int(rng.integers(7))
    place = int(rng.integers(len(text)))
    if choice == 0:
        return raw[:place]
    if choice == 1:
        return raw[:place] + bytes(rng.integers(0, 256, 1 + int(rng.integers(20)), dtype=np.uint8)) + raw[place:]
    if choice == 2:
        return (text[:place] + SNIPPETS[rng.integers(len(SNIPPETS))] + text[place:]).encode()
    if choice == 3:
        begin = int(rng.integers(len(lines)))
        return "\n".join(lines + lines[begin : begin + 12]).encode()
    if choice == 4:
        return "\n".join(lines[i] for i in rng.permutation(len(lines))).encode()
    if choice == 5:
        kept = rng.random(len(lines)) > 0.1
        return "\n".join(line for line, keep in zip(lines, kept, strict=True) if keep).encode()
    return text.replace("=", "= " + SNIPPETS[rng.integers(len(SNIPPETS))], 1 + int(rng.integers(3))).encode()
