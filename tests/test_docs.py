"""What the documentation shows, runs."""

import ast
import doctest
import importlib
import importlib.util
import inspect
import json
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator

import pytest

import gearjax
from gearjax import registry
from gearjax.cli import app, main
from tests.conftest import ROOT
from tests.test_spectra import COMMANDS

LONG = (
    "gearjax.analysis.repeats",
    "gearjax.config.commented",
    "gearjax.identification.identify",
    "gearjax.identification.posterior",
    "gearjax.identification.reassembly",
    "gearjax.tolerance.population",
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


SITE = ROOT / "experiments" / "site"
PAGES = [ROOT / "README.md", *sorted(SITE.glob("**/*.md"))]
WITHOUT_PYTHON = ("accuracy", "comparisons", "index", "keys", "models", "theory", "validation")


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_of_pages_run(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    known = {group: dict(kinds) for group, kinds in registry._kinds.items()}
    monkeypatch.setattr(registry, "_kinds", known)  # a page may register a part of its own
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict = {}  # later blocks go on from earlier ones
    for block in blocks:
        ast.parse(block)
        exec(compile(block, page.name, "exec"), names)
    assert bool(blocks) != (page.stem in WITHOUT_PYTHON)


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


SCRIPTS = sorted((ROOT / "experiments").glob("*.py"))


def names_used(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Module and name of everything of gearjax that a script imports or reaches by ``gj``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "gearjax":
            yield from ((str(node.module), alias.name) for alias in node.names)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "gj":
            yield "gearjax", node.attr


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_scripts_use_what_there_is(script):
    """Benches take minutes and other programs; that what they name is still there takes none."""
    for module, name in names_used(ast.parse(script.read_text(encoding="utf-8"))):
        found = importlib.import_module(module)
        assert hasattr(found, name) or importlib.util.find_spec(f"{module}.{name}"), f"{module}.{name}"


def test_scripts_of_pages_have_their_options():
    pattern = re.compile(r"python (experiments/\S+\.py)((?: --?[\w-]+(?: [\w./]+)?)*)")
    shown = [match for page in PAGES for match in pattern.findall(page.read_text(encoding="utf-8"))]
    assert len(shown) > 8
    for file, words in shown:
        text = (ROOT / file).read_text(encoding="utf-8")
        for option in re.findall(r"--[\w-]+", words):
            assert f'"{option}"' in text, f"{file} {option}"


def test_every_public_name_has_an_example_and_its_place_in_the_manual():
    """The examples are run above; each name is told once, on the page that shows it."""
    told = []
    for page in (SITE / "reference").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        shown = "\n".join(re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL))
        names = " ".join(re.findall(r"```{names}\n(.*?)```", text, flags=re.DOTALL)).split()
        assert names, page.name
        told += names
        for name in names:
            assert re.search(rf"\bgj\.{name}\b|from gearjax import .*\b{name}\b", shown), (page.name, name)
    assert sorted(told) == sorted(gearjax.__all__)


@pytest.mark.slow
def test_the_manual_builds_without_a_warning(tmp_path):
    """Pages, docstrings, links and notebooks; these are run by tests of their own."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-c", str(SITE), "-D", "nb_execution_mode=off"]
    done = subprocess.run([*command, str(ROOT), str(tmp_path / "manual")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    start = (tmp_path / "manual" / "index.html").read_text(encoding="utf-8")
    target = re.search(r'url=(\S+)"', start)
    assert target
    assert (tmp_path / "manual" / target[1]).exists()
    statics = (tmp_path / "manual" / "experiments" / "site" / "reference" / "statics.html").read_text(encoding="utf-8")
    assert 'id="gearjax.transmission_error"' in statics
    pages = (tmp_path / "manual").glob("**/*.html")
    assert not [page for page in pages if re.search(r'<(script|link|img)[^>]*(src|href)="https?://', page.read_text())]


RUN_ELSEWHERE = {  # commands of pages, and the tests that run them
    "tradeoff configs/two_kv/wang_2020.toml --error 0.001": "test_tradeoff.py, in process",
    "new two_kv > mine.toml": "test_config_new.py",
    "run mine.toml": "test_config_new.py",
    "example two_kv": "test_examples.py",
    'tolerance CONFIG --out DIR --scheduler "$(cat address)"': "test_tolerance_command.py, on a cluster of its own",
    "reproduce involute_rv --out out/yang": "test_involute_rv_published.py",
    "reproduce rv_cycloidal": "test_rv_studies.py",
    "reproduce helical": "test_helical_published.py",
    "reproduce elliptic": "test_elliptic_published.py",
    "compare configs/two_kv/wang_2020.toml --measured configs/two_kv/measured_forward_150.csv": "below",
}


def test_every_command_of_a_page_is_run_by_a_test():
    shipped = {f"{word} configs/{name}" for word, name in COMMANDS}  # tests/test_spectra.py runs these
    pattern = re.compile(r"^(?:    )?(?:python -m pip .*&& )?gearjax ([^#\n]*[^#\s])", flags=re.MULTILINE)
    shown = {command for page in PAGES for command in pattern.findall(page.read_text(encoding="utf-8"))}
    assert shown <= shipped | set(RUN_ELSEWHERE)
    assert set(RUN_ELSEWHERE) <= shown


def test_another_reducer_beside_a_recording(monkeypatch, capsys):
    """The page of the test bench says that it explains less than nothing."""
    monkeypatch.chdir(ROOT)
    shown = next(command for command in RUN_ELSEWHERE if command.startswith("compare"))
    with pytest.raises(SystemExit, match="0"):
        main([*shown.split(), "--json"])
    (record,) = json.loads(capsys.readouterr().out)["records"]
    assert record["explained"] < 0


def test_the_readme_is_short():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150


def test_the_readme_names_the_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "python -m pip install -e . && gearjax run configs/two_kv/wang_2020.toml" in text
    assert 'python -m pip install -e ".[test]" && python -m pytest' in text
