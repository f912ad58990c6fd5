"""Files of results: whole or not at all, and --out tried before anything is computed, in every command."""

import inspect
import os
from pathlib import Path

import pytest
import typer

from gearjax import files
from gearjax.checks import GearjaxError
from gearjax.cli import commands, main
from tests.conftest import CONFIG, ROOT

PHASES = ROOT / "configs" / "two_kv" / "wang_2020_phases.toml"
MEASURED = ROOT / "configs" / "two_kv" / "measured.toml"
STUDY = ROOT / "configs" / "two_kv" / "wang_2020_tolerance.toml"
ARGUMENTS = {
    "run": [str(CONFIG)],
    "reproduce": ["two_kv"],
    "optimise": [str(PHASES)],
    "tradeoff": [str(CONFIG)],
    "tolerance": [str(STUDY)],
    "compare": [str(MEASURED)],
    "identify": [str(MEASURED)],
    "example": ["two_kv"],
}
WITH_OUT = [
    entry.callback
    for entry in commands.app.registered_commands
    if entry.callback is not None and "out" in inspect.signature(entry.callback).parameters
]


def refused(arguments: list[str], capsys) -> str:
    """The one line of a command that is refused."""
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out) == (2, "")
    lines = [line for line in shown.err.splitlines() if not line.startswith("note: ")]
    assert len(lines) == 1, shown.err
    assert lines[0].startswith("gearjax: error: ")
    assert "--out" in lines[0]
    told = "cannot be written", "NUL", "null byte", "null character"  # typer or Python sees a NUL itself
    assert any(words in lines[0] for words in told)
    assert lines[0].isprintable()
    assert len(lines[0]) < 250
    return lines[0]


@pytest.fixture
def nothing_computed(monkeypatch):
    """Whatever a command would compute fails the test."""

    def computed(*_arguments, **_words):
        raise AssertionError("computed before --out was tried")

    monkeypatch.setattr("gearjax.results.run_cases", computed)
    monkeypatch.setattr("gearjax.results.optimise", computed)
    monkeypatch.setattr("gearjax.studies.tradeoff.tradeoff", computed)
    monkeypatch.setattr("gearjax.studies.accurate_step.accurate_step", computed)
    monkeypatch.setattr("gearjax.cli.tolerance.study", computed)
    monkeypatch.setattr("gearjax.identification.compare", computed)
    monkeypatch.setattr("gearjax.results.identification.identified", computed)
    monkeypatch.setattr("gearjax.reproduce.PAPERS", {"two_kv": ("a paper", computed)})


def test_every_command_with_a_folder_is_looked_at():
    assert {callback.__name__ for callback in WITH_OUT} == set(ARGUMENTS)
    for callback in WITH_OUT:  # one mechanism: a command of tomorrow has it with the option
        option = inspect.signature(callback).parameters["out"].annotation.__metadata__[0]
        assert isinstance(option, typer.models.OptionInfo)
        assert option.callback is commands._writable


@pytest.mark.usefixtures("nothing_computed")
@pytest.mark.parametrize("command", ARGUMENTS)
@pytest.mark.parametrize("out", ["under a file", "a file", "long", "deep", "nul", "proc", "full"])
def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path, capsys, monkeypatch, command, out):
    (tmp_path / "file").write_text("mine")
    place = {
        "under a file": tmp_path / "file" / "out",
        "a file": tmp_path / "file",
        "long": tmp_path / ("x" * 300),
        "deep": tmp_path / "/".join(["x" * 100] * 60),
        "nul": f"{tmp_path}/a\0b",
        "proc": "/proc/out",
        "full": tmp_path / "full",
    }[out]
    if out == "proc" and not Path("/proc/self").exists():
        pytest.skip("there is no /proc here")
    if out == "full":

        def full(**_words):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("tempfile.NamedTemporaryFile", full)
    refused([command, *ARGUMENTS[command], "--out", str(place)], capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.usefixtures("nothing_computed")
@pytest.mark.parametrize("command", [name for name in ARGUMENTS if name not in ("reproduce", "example")])
def test_the_folder_that_nobody_named_is_tried_too(tmp_path, capsys, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").write_text("mine")
    refused([command, *ARGUMENTS[command]], capsys)


def test_a_name_with_a_nul_is_no_folder(tmp_path):
    with pytest.raises(GearjaxError, match="has no character NUL"):
        files.writable(Path(f"{tmp_path}/a\0b"))


def test_trying_a_folder_leaves_nothing(tmp_path):
    assert files.writable(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a").mkdir()
    files.writable(tmp_path / "a" / "b")
    assert list(tmp_path.rglob("*")) == [tmp_path / "a"]


def test_a_file_is_written_through_before_it_takes_its_name(tmp_path, monkeypatch):
    path, steps = tmp_path / "file", []
    files.write_file(path, "old")
    synced, replaced = os.fsync, Path.replace

    def fsync(number: int) -> None:
        there = Path(f"/proc/self/fd/{number}").resolve() if Path("/proc/self/fd").exists() else number
        steps.append(("sync", getattr(there, "name", number), path.read_text()))
        synced(number)

    def replace(self: Path, target: Path):
        steps.append(("replace", self.name, path.read_text()))
        return replaced(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", replace)
    files.write_file(path, b"new")
    kinds = [(kind, there) for kind, _, there in steps]
    assert kinds == [("sync", "old"), ("replace", "old"), ("sync", "new")]  # the file, then its name
    if Path("/proc/self/fd").exists():
        assert [name for _, name, _ in steps] == [".file.part", ".file.part", tmp_path.name]


def test_what_fails_half_way_leaves_the_old_file(tmp_path, monkeypatch):
    path = files.write_file(tmp_path / "file", "old")

    def fsync(_number: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(GearjaxError, match="cannot be written"):
        files.write_file(path, "new")
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("file", "old")]
