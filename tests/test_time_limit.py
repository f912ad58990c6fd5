"""Long tests have a time limit on slow machines, and say what they had no time for."""

import os
import subprocess
import sys
import time

import pytest

from tests.conftest import ROOT, UNTIL


@pytest.mark.slow
def test_no_test_begins_after_the_limit(tmp_path):
    (tmp_path / "conftest.py").write_text("from tests.conftest import *\n", encoding="utf-8")
    text = "def test_one():\n    pass\n\n\ndef test_two():\n    pass\n"
    (tmp_path / "test_short.py").write_text(text, encoding="utf-8")
    environment = os.environ | {UNTIL: str(time.time() - 1), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", "--rootdir", str(tmp_path)]
    done = subprocess.run(
        [*command, "-c", "/dev/null", str(tmp_path / "test_short.py")],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 skipped" in done.stdout
    assert "2 tests of 1 files had no time left: test_short.py" in done.stdout
