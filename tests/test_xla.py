"""Options of XLA: set by the command before JAX starts, only what this version knows, and never against the user."""

import json
import os
import subprocess
import sys

import jax
import numpy as np
import pytest

import gearjax as gj
from gearjax import xla
from tests.conftest import ROOT, with_programs_of_tests

TELLS = """
import json, os, sys
from gearjax.cli import main
try:
    main()
finally:
    print(json.dumps(os.environ.get("XLA_FLAGS")), file=sys.stderr)
"""


def flags_after(*arguments: str, **environment: str) -> str | None:
    """What a command, in a process of its own, has in ``XLA_FLAGS`` at its end."""
    given = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"} | environment
    command = [sys.executable, "-c", TELLS, *arguments]
    ended = subprocess.run(command, cwd=ROOT, env=given, capture_output=True, text=True, check=False)
    return json.loads(ended.stderr.splitlines()[-1])


@pytest.fixture
def _fine_ones_known(monkeypatch):
    """No process is started to try options: those with "fine" in them are known."""
    monkeypatch.setattr(xla, "is_usable", lambda options: all("fine" in option for option in options.split()))
    xla._known_of.cache_clear()
    yield
    xla._known_of.cache_clear()


@pytest.mark.slow
def test_what_this_version_knows_is_told():
    options = gj.xla_options(quick_compiler=True).split()
    assert xla.is_usable(" ".join(options))
    assert set(options) <= {xla.LOOPS, xla.QUICK_COMPILER}
    assert xla.LOOPS in options
    assert gj.xla_options().split() == [option for option in options if option != xla.QUICK_COMPILER]


def test_an_option_that_is_not_known_is_found_out():
    assert not xla.is_usable("--xla_no_such_option=true")


@pytest.mark.slow
def test_an_option_that_compiles_functions_wrongly_is_found_out():
    """With full vectors of AVX-512, jax 0.10 and 0.11 compile the arctangent wrongly, other versions do not."""
    flag = "--xla_cpu_prefer_vector_width=512"
    code = """import jax, numpy as np
x = np.linspace(0, 1, 64, dtype="float32")
print(abs(jax.jit(jax.numpy.arctan)(x) - np.arctan(x)).max())"""
    environment = os.environ | {"XLA_FLAGS": flag, "JAX_PLATFORMS": "cpu"}
    ended = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert xla.is_usable(flag) == (float(ended.stdout) < 1e-5)


def test_the_trial_looks_at_the_functions(monkeypatch):
    assert xla.compiles_correctly()
    monkeypatch.setattr(jax.numpy, "arctan", lambda x: x - x**3 / 3)
    assert not xla.compiles_correctly()


EXAMPLES = (
    "two_kv/wang_2020",
    "rv_cycloidal/hu_2020",
    "involute_rv/yang_2019",
    "helical/blankenship_1995",
    "elliptic/dong_2020",
)
GEAR_SETS = """
import sys, numpy as np, gearjax as gj
for config in sys.argv[1:]:
    scene = gj.load(config)
    theta = np.linspace(0.0, 0.02 * scene.system.cycle, 65)
    torque = max(scene.run.torques)
    print(np.asarray(gj.transmission_error(scene, theta, torque=torque, extremes="samples").te).tolist())
"""


@pytest.mark.slow
def test_the_options_change_results_by_rounding_only():
    """TE under load of every gear set, by a process with the options and by one without."""
    configs = [str(ROOT / "configs" / f"{name}.toml") for name in EXAMPLES]
    sides = []
    for options in ("", gj.xla_options()):
        environment = os.environ | {"XLA_FLAGS": options, "JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu"}
        environment |= with_programs_of_tests()  # JAX keeps programs of other options apart
        command = [sys.executable, "-c", GEAR_SETS, *configs]
        ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
        sides.append([json.loads(line) for line in ended.stdout.splitlines()])
    for config, plain, other in zip(configs, *sides, strict=True):
        np.testing.assert_allclose(other, plain, rtol=1e-9, atol=1e-9 * np.abs(plain).max(), err_msg=config)


@pytest.mark.usefixtures("_fine_ones_known")
@pytest.mark.parametrize(
    ("options", "known"),
    [(("--fine", "--fine=2"), "--fine --fine=2"), (("--fine", "--odd"), "--fine"), (("--odd",), "")],
)
def test_one_unknown_option_does_not_take_the_others(options, known):
    assert xla._known_of(options) == known


@pytest.mark.slow
def test_the_command_sets_them_and_remembers_what_is_known(tmp_path):
    """The quick compiler too, but not for a command that runs longer than it compiles."""
    kept = {"XDG_CACHE_HOME": str(tmp_path)}
    assert flags_after("--version", **kept) == gj.xla_options(quick_compiler=True)
    assert flags_after("tolerance", "--help", **kept) == gj.xla_options()
    (file,) = tmp_path.rglob("usable-options-*.txt")
    assert file.read_text(encoding="utf-8") == gj.xla_options(quick_compiler=True)
    file.write_text("--xla_cpu_prefer_vector_width=256", encoding="utf-8")
    assert flags_after("--version", **kept) == "--xla_cpu_prefer_vector_width=256", "nothing is tried again"


@pytest.mark.slow
@pytest.mark.parametrize("flags", ["", "--xla_cpu_prefer_vector_width=128"])
def test_the_user_decides(tmp_path, flags):
    assert flags_after("--version", XDG_CACHE_HOME=str(tmp_path), XLA_FLAGS=flags) == flags
    assert not list(tmp_path.rglob("usable-options-*.txt"))


@pytest.mark.slow
def test_a_folder_that_cannot_be_made_is_no_mistake(tmp_path):
    (tmp_path / "file").write_text("")
    assert flags_after("--version", XDG_CACHE_HOME=str(tmp_path / "file")) == gj.xla_options(quick_compiler=True)


@pytest.mark.slow
def test_importing_gearjax_leaves_xla_asleep():
    """So that the options can be set after it."""
    code = "import gearjax; from jax._src import xla_bridge; print(xla_bridge.backends_are_initialized())"
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "False"
