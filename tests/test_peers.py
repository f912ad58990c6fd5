"""The commands of the page that compares gearjax with other programs, in the short form of each.

Every bench ends with an error where the programs differ by more than they may. Two of the other programs need
environments of their own, which are made here.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, compiled_as_tests, with_programs_of_tests

COMPARISONS = ROOT / "experiments" / "site" / "comparisons.md"
SHOWN = re.findall(r"`python (experiments/\w+\.py)([^`]*)`", COMPARISONS.read_text(encoding="utf-8"))
NEWER_PYTHONS = ("python3.13", "python3.14")
OF_ITS_OWN = {  # options that name another Python: what is installed for it, and which Pythons will do
    "--ross-python": ([["ross-rotordynamics>=3.1,<3.2"]], NEWER_PYTHONS),
    # without its user interface, which takes most of the time to install
    "--cycloidgen-python": ([["numpy", "scipy", "pydantic"], ["--no-deps", "cycloidgen>=8,<9"]], (sys.executable,)),
}


def another_python(option: str, folder: Path) -> str:
    """The Python of a new environment with the other program."""
    installs, pythons = OF_ITS_OWN[option]
    known = [found for name in pythons if (found := shutil.which(name)) and works(found)]
    known += [str(found) for found in sorted(Path.home().glob(".pyenv/versions/3.1[34]*/bin/python"))]
    if not known:
        pytest.skip(f"{installs[0][0]} needs one of {', '.join(pythons)}, and this machine has none")
    subprocess.run([known[0], "-m", "venv", folder], check=True)
    python = folder / "bin" / "python"
    for packages in installs:
        install = [python, "-m", "pip", "install", "--quiet", "--no-compile", *packages]
        done = subprocess.run(install, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
    return str(python)


def works(python: str) -> bool:
    """Whether a Python found on the path starts: one of a version manager may only say that none is chosen."""
    return subprocess.run([python, "-c", ""], capture_output=True, check=False).returncode == 0


def test_the_page_shows_the_commands():
    assert len(SHOWN) == len({script for script, _ in SHOWN}) == 10
    assert {option for _, words in SHOWN for option in re.findall(r"--\S+", words)} == set(OF_ITS_OWN)


@pytest.mark.slow
@pytest.mark.parametrize(("script", "words"), SHOWN, ids=[Path(script).stem for script, _ in SHOWN])
def test_programs_agree(script, words, tmp_path):
    options = re.findall(r"--\S+", words)
    others = [(option, another_python(option, tmp_path / "environment")) for option in options]
    command = [sys.executable, script, "--short", *(word for pair in others for word in pair)]
    # sizes are small: most of the time would be compiling
    environment = os.environ | compiled_as_tests() | with_programs_of_tests()
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "(at most " in done.stdout, "nothing was compared"
