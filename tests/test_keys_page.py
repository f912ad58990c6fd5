"""The page of every configuration key: as gearjax reads them now, and complete."""

import re
import tomllib

from gearjax.config.build import SECTIONS
from gearjax.config.keys_page import keys_page
from tests.conftest import ROOT

PAGE = (ROOT / "experiments" / "site" / "keys.md").read_text(encoding="utf-8")
STUDIES = ("sensitivity", "allocation", "assembly")


def test_the_page_is_what_gearjax_reads():
    assert keys_page() == PAGE


def test_it_has_every_section():
    assert set(re.findall(r"^### `\[+(\w+)", PAGE, flags=re.MULTILINE)) == set(SECTIONS)


def test_it_has_every_key_of_the_shipped_configurations():
    told = set(re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE))
    for file in (ROOT / "configs").glob("*/*.toml"):
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
        for section, table in tables.items():
            inner = section in ("errors", "supports", "shafts", "published")
            parts = (table if isinstance(table, list) else table.values()) if inner else [table]
            for part in parts:
                keys = [key for key in part if "." not in key and key != "kind" and not isinstance(part[key], dict)]
                assert told.issuperset(keys), (file.name, section)


def test_every_key_says_what_it_is():
    rows = re.findall(r"^\| `\w+` \| (.*) \| (.*) \|$", PAGE, flags=re.MULTILINE)
    assert len(rows) > 200
    assert all(words.strip() for words, _ in rows)
