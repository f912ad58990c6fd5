"""Tests run in float64, and refuse silent promotion of ranks and dtypes.

What starts the workers loads this file too, and runs no test: gearjax is imported where tests need it, as its checked
signatures take seconds to make.
"""

import ctypes
import dataclasses
import gc
import os
import runpy
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

# Before numpy loads: workers share the cores, where threads of linear algebra that wait for each other cost a quarter.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "configs" / "two_kv" / "wang_2020.toml"
BODIES = ("planet_1", "planet_2", "revolution", "output_wheel")
AMPLITUDES = [f"errors.{body}.amplitude" for body in BODIES]
PHASES = [f"errors.{body}.phase" for body in BODIES]


FOUND = "GEARJAX_TESTS_COMPILER"  # what the process that starts the workers found out, for them
PROGRAMS = "GEARJAX_TESTS_PROGRAMS"  # the folder of compiled programs that the workers share
ONE_PIECE = "--xla_cpu_parallel_codegen_split_count=1"  # the workers share the cores: pieces cost a tenth of the time
WORTH_KEEPING = 0.02  # s that a program takes to compile
FEWER_COLLECTIONS = 100_000, 50, 100  # traces make many objects: looking for cycles took 6 % of the time of two files
_ours: list[str] = []


def _share_programs() -> None:
    """What one worker has compiled no other compiles again. CI names a folder, for both of its runs."""
    if PROGRAMS not in os.environ:
        os.environ[PROGRAMS] = tempfile.mkdtemp()
        _ours.append(os.environ[PROGRAMS])
    jax.config.update("jax_compilation_cache_dir", os.environ[PROGRAMS])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)


def pytest_unconfigure() -> None:
    for folder in _ours:
        shutil.rmtree(folder, ignore_errors=True)


def _quick_options() -> str:
    """XLA's options that make compiling quicker, as far as this version of it knows them."""
    xla = runpy.run_path(str(ROOT / "gearjax" / "xla.py"))
    quick = xla["QUICK_COMPILER"]
    return next((options for options in (f"{quick} {ONE_PIECE}", quick) if xla["is_usable"](options)), "")


def pytest_configure(config: pytest.Config) -> None:
    """Most tests take longer to compile than to run.

    They have the quicker of XLA's compilers for kernels, and what LLVM spends most time on is left to those that are
    marked ``runs_long``. Commands that tests start as processes of their own are compiled as a user's are unless they
    ask for `compiled_as_tests`, and so is everything where ``XLA_FLAGS`` is set, to nothing too.
    """
    _share_programs()
    if "XLA_FLAGS" not in os.environ and FOUND not in os.environ:
        os.environ[FOUND] = _quick_options()
    if _starts_workers(config):
        return
    from gearjax.cli.programs import leave_out_where_from

    leave_out_where_from()
    gc.set_threshold(*FEWER_COLLECTIONS)
    if "XLA_FLAGS" in os.environ:
        return
    os.environ["XLA_FLAGS"] = os.environ[FOUND]
    jax.devices()  # reads the flags
    del os.environ["XLA_FLAGS"]


def compiled_as_tests() -> dict[str, str]:
    """Variables with which a process that a test starts compiles as the tests do; none where ``XLA_FLAGS`` is set."""
    if "XLA_FLAGS" in os.environ:
        return {}
    return {"XLA_FLAGS": os.environ[FOUND], "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}


def with_programs_of_tests() -> dict[str, str]:
    """Variables with which a process that a test starts shares the compiled programs of the tests."""
    return {
        "JAX_COMPILATION_CACHE_DIR": os.environ[PROGRAMS],
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": str(WORTH_KEEPING),
        "JAX_INCLUDE_FULL_TRACEBACKS_IN_LOCATIONS": "0",  # a changed line elsewhere leaves programs as they are
    }


def _starts_workers(config: pytest.Config) -> bool:
    """Whether the tests run in other processes than this one."""
    return bool(getattr(config.option, "tx", None)) and not hasattr(config, "workerinput")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish() -> None:
    """One look for cycles finds what would have warned: pytest has five, of seconds each after many traces."""
    gc.collect()
    gc.freeze()


MOST_WORKERS = 4  # each takes up to 7 GB


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """A worker for each core that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, MOST_WORKERS)


UNTIL = "GEARJAX_TESTS_UNTIL"  # time, in seconds since 1970, after which no long test begins
NO_TIME = "no time left"


def pytest_runtest_setup(item: pytest.Item) -> None:
    if time.time() > float(os.environ.get(UNTIL, "inf")):
        pytest.skip(NO_TIME)
    careful = "XLA_FLAGS" in os.environ or item.get_closest_marker("runs_long") is not None
    jax.config.update("jax_disable_most_optimizations", not careful)


LONGEST = (  # files, of both runs of CI
    "test_matrix.py",
    "test_spectra.py",
    "test_peers.py",
    "test_docs.py",
    "test_config_new.py",
    "test_identify_motion.py",
    "test_notebooks.py",
    "test_trains.py",
    "test_gear_sets_in_motion.py",
    "test_tradeoff.py",
    "test_periodic_modes.py",
    "test_involute_loads.py",
    "test_modes.py",
    "test_slices_in_motion.py",
    "test_fitted.py",
    "test_helical_train.py",
    "test_rv_studies.py",
    "test_tolerance_studies.py",
    "test_identify.py",
    "test_rv_cycloidal.py",
    "test_dynamics.py",
    "test_gradients.py",
    "test_minimise.py",
    "test_involute_rv_published.py",
    "test_stopping.py",
    "test_elliptic_motion.py",
    "test_xla.py",
    "test_bench_commands.py",
    "test_helical_system.py",
    "test_cli.py",
    "test_grid_search.py",
    "test_exact_geometry.py",
    "test_supports.py",
    "test_extremes.py",
    "test_measured.py",
    "test_tolerance_command.py",
    "test_involute_rv.py",
    "test_involute_search.py",
    "test_mesh_stiffness.py",
    "test_scatter.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, so that no worker is left with one at the end.

    A worker has a file to itself: what its tests have in common is traced once. That takes a fifth less than tests one
    by one to whichever worker is free. Where the time is limited, each day begins a third of the files later than the
    day before, so that what had no time left on one day has it on the next.
    """
    place = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))
    if UNTIL in os.environ:
        files = list(dict.fromkeys(item.path for item in items))
        first = int(float(os.environ[UNTIL]) // 86_400) % 3 * len(files) // 3
        place = {path: place for place, path in enumerate(files[first:] + files[:first])}
        items.sort(key=lambda item: place[item.path])


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """How many tests had no time left, and where they are."""
    late = [report for report in terminalreporter.stats.get("skipped", []) if NO_TIME in str(report.longrepr)]
    if late:
        files = sorted({Path(report.nodeid.partition("::")[0]).name for report in late})
        terminalreporter.write_line(f"{len(late)} tests of {len(files)} files had no time left: {', '.join(files)}")


MOST_MAPS = 30_000
MOST_BYTES = 6e9  # that a worker may hold: one of them once took 15 GB, and was killed
TESTS_BETWEEN_LOOKS = 10
MAPS = Path("/proc/self/maps")
_finished = 0


def pytest_runtest_logfinish() -> None:
    """Compiled programs take memory maps, some hundred a test; Linux gives a process 65,530."""
    global _finished
    _finished += 1
    if _finished % TESTS_BETWEEN_LOOKS == 0 and MAPS.exists():
        with MAPS.open(encoding="ascii", errors="replace") as maps:
            crowded = sum(1 for _ in maps) > MOST_MAPS
        held = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
        if crowded or held > MOST_BYTES:
            jax.clear_caches()
        if held > MOST_BYTES:
            gc.collect()
            _give_back()


def _give_back() -> None:
    """Return freed memory to the system, which glibc does not do by itself.

    Without it a worker that has once held too much looks as if it still did: workers of CI cleared all their programs
    every ten tests from the tenth minute on.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


@pytest.fixture
def config_text() -> str:
    return CONFIG.read_text(encoding="utf-8")


@pytest.fixture
def rv_text() -> str:
    return (ROOT / "configs" / "rv_cycloidal" / "hu_2020.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def scene():
    """The reducer of Wang et al. (2020), phases before optimisation, without a run section."""
    from gearjax.reproduce import two_kv

    return two_kv.scene()


@pytest.fixture(scope="session")
def theta(scene) -> jax.Array:
    """Three seconds of input angles, 1 ms apart."""
    return scene.system.input_speed * jax.numpy.linspace(0.0, 3.0, 3001)


@pytest.fixture
def rng(request) -> np.random.Generator:
    """Random numbers, different for each test and the same in each run."""
    return np.random.default_rng(sum(request.node.name.encode()))


@pytest.fixture(scope="session")
def with_contact():
    """The scene with another contact law."""
    return lambda scene, law: dataclasses.replace(scene, contact=law)


@pytest.fixture(scope="session")
def population(scene):
    """Reducers with Rayleigh eccentricities and random phases."""
    import gearjax as gj

    amplitudes = dict.fromkeys(AMPLITUDES, gj.Rayleigh(6 * gj.units.um))
    return gj.Tolerances(scene, amplitudes | dict.fromkeys(PHASES, gj.UniformPhase()))


@pytest.fixture(scope="session")
def angles(scene) -> np.ndarray:
    """Input angles of one cycle, quickly gone through."""
    return np.linspace(0.0, scene.system.cycle, 801)
