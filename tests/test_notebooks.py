"""Pages to run, from first to last cell, each in a process of its own."""

import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT, compiled_as_tests, with_programs_of_tests

OF_ITS_OWN = {"from_measurement_to_reassembly"}  # tests/test_bench_commands.py reads what it tells
COMPUTE = {"rv_compensation"}
"""Pages that compute longer than they compile; the others, compiled as the tests are, take half the time."""
PAGES = [page for page in sorted((ROOT / "experiments" / "notebooks").glob("*.py")) if page.stem not in OF_ITS_OWN]


def test_pages_are_text_that_notebooks_read():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert "format_name: percent" in text
        assert text.count("# %% [markdown]") >= 3
        assert "# What to change next" in text


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_runs(page):
    """As a process of its own, as a kernel is: it sets JAX's options, and may register a gear set."""
    environment = os.environ | with_programs_of_tests() | {"MPLBACKEND": "agg"}
    if page.stem not in COMPUTE:
        environment |= compiled_as_tests()
    ran = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:gearjax", str(page)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ran.returncode == 0, ran.stderr
    assert "Warning" not in ran.stderr, ran.stderr
    assert ran.stdout
