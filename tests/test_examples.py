"""``gearjax example``: shipped configurations, from a clone and from a built wheel."""

import json
import os
import subprocess
import sys
import venv

import pytest

import gearjax as gj
from gearjax.config.examples import copy_example, examples
from tests.conftest import ROOT
from tests.test_bench_commands import told_by

NAMES = sorted(folder.name for folder in (ROOT / "configs").iterdir())


def test_every_example_is_known():
    assert sorted(examples()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_copy_loads(name, tmp_path):
    """With the files that it names."""
    for file in copy_example(name, tmp_path / name):
        assert gj.load(file).run is not None


def test_the_command_says_what_it_copied_and_keeps_what_is_there(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = told_by(capsys, "example", "two_kv").out.split()
    assert "two_kv/wang_2020.toml" in told
    assert (tmp_path / "two_kv" / "measured_turned_150.toml").exists()  # beside its table, not a configuration
    assert "two_kv/measured_turned_150.toml" not in told
    assert "exists already" in told_by(capsys, "example", "two_kv", code=2).err
    assert "two_kv" in told_by(capsys, "example", code=2).err
    assert "elliptic_pair/dong_2020.toml" in told_by(capsys, "example", "elliptic_pair").out
    assert "two_kv" in told_by(capsys, "example", "two_vk", code=2).err


@pytest.mark.slow
def test_a_wheel_works_in_an_environment_of_its_own(tmp_path):
    """The examples and the mark of typed packages come along; dependencies are those of this environment."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", str(tmp_path), str(ROOT)], check=True, timeout=300)
    (wheel,) = tmp_path.glob("gearjax-*.whl")
    venv.create(tmp_path / "own", with_pip=False)
    own = next((tmp_path / "own").glob("lib/*/site-packages"), tmp_path / "own" / "Lib" / "site-packages")
    subprocess.run([*pip, "install", "--no-deps", "--target", str(own), str(wheel)], check=True, timeout=300)
    assert (own / "gearjax" / "py.typed").exists()
    places = [own, *(place for place in sys.path if place.endswith("site-packages"))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, places))}
    python = str(next((tmp_path / "own").glob("bin/python")))

    def run(*words: str) -> str:
        ran = subprocess.run(
            [python, "-m", "gearjax", *words],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert ran.returncode == 0, ran.stderr
        return ran.stdout

    assert run("--version").startswith("gearjax 0")
    where = subprocess.run(
        [python, "-c", "import gearjax; print(gearjax.__file__)"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert str(own) in where.stdout
    assert "elliptic/dong_2020.toml" in run("example", "elliptic").replace(os.sep, "/")
    assert json.loads(run("run", "elliptic/dong_2020.toml", "--json"))
