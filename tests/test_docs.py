"""What the documentation shows, runs."""

import ast
import doctest
import importlib
import inspect
import pkgutil
import re

import pytest

import gearjax
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


@pytest.mark.slow
def test_the_readme_example_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert blocks
    names: dict = {}  # later blocks go on from earlier ones
    for block in blocks:
        ast.parse(block)
        exec(compile(block, "README.md", "exec"), names)


def test_the_readme_names_the_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "python -m pip install -e . && gearjax run configs/two_kv/wang_2020.toml" in text
    assert 'python -m pip install -e ".[test]" && python -m pytest' in text
