"""What the documentation shows, runs."""

import ast
import doctest
import importlib
import inspect
import pkgutil
import re

import pytest

import gearjax
from gearjax.cli import app
from tests.conftest import ROOT

LONG = (
    "gearjax.studies.compensate",
    "gearjax.studies.minimise",
    "gearjax.studies.sensitivity",
    "gearjax.analysis.torsion",
)
MODULES = [
    pytest.param(info.name, marks=[pytest.mark.slow] if info.name in LONG else [])
    for info in pkgutil.walk_packages(gearjax.__path__, "gearjax.")
    if "__main__" not in info.name
]


@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.failed == 0


def test_there_are_examples():
    counted = sum(
        len(test.examples)
        for param in MODULES
        for name in param.values
        for test in doctest.DocTestFinder().find(importlib.import_module(name))
    )
    assert counted > 15


def test_public_names_have_docstrings():
    for name in gearjax.__all__:
        assert inspect.getdoc(getattr(gearjax, name)), name


PAGES = [ROOT / "README.md", *sorted((ROOT / "experiments" / "site").glob("*.md"))]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_of_pages_run(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict = {}  # later blocks go on from earlier ones
    for block in blocks:
        ast.parse(block)
        exec(compile(block, page.name, "exec"), names)
    assert blocks or page.stem in ("accuracy", "models")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_commands_of_pages_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        assert link.startswith("https://") or (page.parent / link).exists(), link
    known = {command.name or command.callback.__name__: command for command in app.registered_commands}
    for line in re.findall(r"^(?:    )?(?:python -m pip .*&& )?gearjax (.*)$", text, flags=re.MULTILINE):
        command, *words = line.split("#")[0].split()
        if command.startswith("-"):
            continue
        assert command in known, line
        for word in words:
            if word.startswith("configs/"):
                assert (ROOT / word).exists(), line
        options = set(inspect.signature(known[command].callback).parameters)
        for option in (word for word in words if word.startswith("--")):
            assert option[2:].replace("-", "_").split("=")[0] in {name.strip("_") for name in options}, line


def test_the_readme_is_short():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150


def test_the_readme_names_the_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "python -m pip install -e . && gearjax run configs/two_kv/wang_2020.toml" in text
    assert 'python -m pip install -e ".[test]" && python -m pytest' in text
