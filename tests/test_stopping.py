"""Ctrl-C: real processes and real signals; and the same study printed twice."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gearjax import stopping
from gearjax.cli import main
from gearjax.results.store import NAME
from tests.conftest import CONFIG, ROOT, compiled_as_tests
from tests.test_tolerance_command import CONFIG as WHOLE
from tests.test_tolerance_command import LONG, command, small

PHASES = ROOT / "configs" / "two_kv" / "wang_2020_phases.toml"
NOTHING = "nothing of this run was saved; run the same command again"
# A process of a script's background inherits that SIGINT is ignored, and so would the commands that are started here.
HEARS_SIGINT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
os.execv(sys.argv[1], sys.argv[1:])
"""


class Running:
    """A command as a process of its own, which ends with the ``with`` block."""

    def __init__(self, *arguments: str, folder: Path, python: tuple[str, ...] = ()):
        self.errors = folder / "stderr"
        with self.errors.open("wb") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-c", HEARS_SIGINT, sys.executable, *python, "-m", "gearjax", *arguments],
                stdout=subprocess.PIPE,
                stderr=errors,
                cwd=ROOT,
                # every program is compiled, as in this process: numbers are the same to the last bit
                env={**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), **compiled_as_tests()},
                start_new_session=True,
            )

    def __enter__(self) -> "Running":
        return self

    def __exit__(self, *_fault: object) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate()

    def stopped(self, once: Callable[[], bool], group: bool = False) -> str:
        """What it says when SIGINT comes as soon as something holds, which is checked to end it at once."""
        deadline = time.monotonic() + 240
        while not once():
            assert time.monotonic() < deadline
            assert self.process.poll() is None, self.said
            time.sleep(0.01)
        sent = time.monotonic()
        (os.killpg if group else os.kill)(self.process.pid, signal.SIGINT)
        printed, _ = self.process.communicate(timeout=60)
        assert time.monotonic() - sent < 10
        assert self.process.returncode == 130
        assert printed == b""
        assert "Traceback" not in self.said
        *_, last = (line for line in self.said.splitlines() if not line.startswith("import time:"))
        assert self.said.count("gearjax: stopped: ") == 1
        assert last.startswith("gearjax: stopped: ")
        return last

    @property
    def said(self) -> str:
        return self.errors.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "begun"),
    [
        (["run", str(CONFIG)], "done: "),
        (["optimise", str(PHASES)], "grid of"),
        (["tradeoff", str(CONFIG)], "beside them"),
        (["reproduce", "two_kv"], "computing"),
        (["reproduce", "involute_rv"], "finite elements"),
    ],
)
def test_ctrl_c_ends_a_command_with_a_line(tmp_path, arguments, begun):
    out = tmp_path / "out"
    with Running(*arguments, "--out", str(out), folder=tmp_path) as running:
        assert running.stopped(lambda: begun in running.said).endswith(NOTHING)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("imported", ["numpy", "jax._src.core", "jax"])
def test_ctrl_c_while_a_command_is_still_imported(tmp_path, imported):
    out = tmp_path / "out"
    with Running("run", str(CONFIG), "--out", str(out), folder=tmp_path, python=("-X", "importtime")) as running:
        last = running.stopped(lambda: re.search(rf"\| +{re.escape(imported)}\n", running.said) is not None)
    assert last.endswith(NOTHING)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("earlier", [True, False])
def test_ctrl_c_while_results_are_written_leaves_the_earlier_ones(tmp_path, earlier):
    out = tmp_path / "out"
    if earlier:
        out.mkdir()
        (out / "metrics.csv").write_text("of another run", encoding="utf-8")
    text = CONFIG.read_text(encoding="utf-8").replace('duration = "3 s"', 'duration = "0.1 s"')
    short = tmp_path / "short.toml"
    short.write_text(text.replace("samples = 3001", "samples = 101"), encoding="utf-8")
    with Running("run", str(short), "--out", str(out), folder=tmp_path) as running:
        assert running.stopped(lambda: any(out.glob(".run.*.part/*.csv"))).endswith(NOTHING)
    assert [path.name for path in out.rglob("*")] == ["metrics.csv"] * earlier
    assert out.exists() == earlier


@pytest.mark.slow
def test_a_stopped_study_says_how_to_go_on_and_goes_on(tmp_path, capsys):
    config, out = tmp_path / "study.toml", tmp_path / "out"
    config.write_text(small(samples=LONG, chunk=128, extremes="samples"), encoding="utf-8")
    line = ["tolerance", str(config), "--json", "--out", str(out)]
    marks = out / NAME / "done" / "c"
    with Running(*line, folder=tmp_path) as running:
        last = running.stopped(lambda: marks.exists() and len(list(marks.iterdir())) > 3)
    found = re.fullmatch(
        rf"gearjax: stopped: (\d+) of {LONG} samples are saved in (.*); run the same command to continue", last
    )
    assert found
    assert found[2] == str(out)
    kept = int(found[1])
    assert 3 * 128 <= kept < LONG
    assert [path for path in out.rglob("*") if path.name.endswith((".part", ".new"))] == []
    assert command(*line[1:]) == 0
    printed = capsys.readouterr()
    assert f"resuming: {kept} of {LONG} samples are already computed" in printed.err
    assert command(*line[1:-1], str(tmp_path / "whole")) == 0
    ended, other = json.loads(printed.out), json.loads(capsys.readouterr().out)
    assert ended["computed"] == LONG - kept
    assert ended["measures"] == other["measures"]


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--workers", "2"]])
def test_a_stopped_study_without_a_folder_keeps_nothing(tmp_path, options):
    config = tmp_path / "study.toml"
    config.write_text(small(samples=1_000_000), encoding="utf-8")
    begun = "cluster" if options else "needs"
    with Running("tolerance", str(config), "--json", *options, folder=tmp_path) as running:
        assert running.stopped(lambda: begun in running.said, group=True).endswith(NOTHING)


@pytest.mark.parametrize("fault", [KeyboardInterrupt, EOFError])
def test_within_another_program_ctrl_c_is_a_line_too(monkeypatch, capsys, fault):
    def interrupted(*_arguments, **_words):
        raise fault

    monkeypatch.setattr("gearjax.results.run_cases", interrupted)
    with pytest.raises(SystemExit) as ended:
        main(["run", str(CONFIG), "--json"])
    assert ended.value.code == stopping.CODE
    shown = capsys.readouterr()
    assert shown.err.splitlines()[-1] == f"gearjax: stopped: {NOTHING}"
    assert "Traceback" not in shown.err


def without_times(found: dict) -> dict:
    """A JSON object without run times, whose names have the word "second" in them."""
    return {
        key: without_times(value) if isinstance(value, dict) else value
        for key, value in found.items()
        if "second" not in key
    }


@pytest.mark.slow
def test_the_same_study_twice_prints_the_same(tmp_path):
    """Every study of the example, in two processes, to the last bit."""
    text = WHOLE.read_text(encoding="utf-8")
    for old, new in (
        ("samples = 20000", "samples = 100"),
        ("= 1024 ", "= 16 "),
        ("units = 1000", "units = 4"),
        ("samples = 1581", "samples = 101"),
        ("# extremes =", "extremes ="),  # allocation counts good ones among 20,000 at each of its turns
        ('    { name = "static.peak_to_peak", torque = "30 N*m" },\n', ""),
        ('    { name = "static.peak_to_peak", torque = "300 N*m" },\n', ""),
    ):
        assert old in text
        text = text.replace(old, new)
    config = tmp_path / "whole.toml"
    config.write_text(text, encoding="utf-8")
    line = [sys.executable, "-m", "gearjax", "tolerance", str(config), "--json"]
    environment = os.environ | compiled_as_tests()
    printed = [subprocess.run(line, capture_output=True, check=True, cwd=ROOT, env=environment).stdout for _ in (1, 2)]
    first, second = (without_times(json.loads(text)) for text in printed)
    assert {"sensitivity", "allocation", "assembly", "halved_tolerance_yield"} <= set(first)
    assert json.dumps(first) == json.dumps(second)
