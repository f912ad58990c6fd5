"""Imports point downwards only."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gearjax
from tests.conftest import CONFIG

PACKAGE = Path(gearjax.__file__).parent
LAYERS = {
    "units": 0,
    "typing": 0,
    "checks": 0,
    "choosing": 0,
    "dependence": 0,
    "elimination": 0,
    "batches": 0,
    "kernels": 0,
    "evaluate": 0,
    "files": 0,
    "markdown": 0,
    "memory": 0,
    "stopping": 0,
    "xla": 0,
    "timing": 0,
    "progress": 0,
    "parameters": 0,
    "geometry": 0,
    "contact": 0,
    "systems": 1,
    "errors": 1,
    "compliance": 1,
    "influence": 1,
    "load_torque": 1,
    "inertia": 1,
    "impact": 2,
    "supports": 1,
    "structure": 1,
    "sketch": 0,
    "coordinates": 1,
    "shafts": 1,
    "clearance": 1,
    "registry": 2,
    "run": 1,
    "scene": 2,
    "scene_checks": 2,
    "gear_set_checks": 2,
    "arguments": 2,
    "analysis": 3,
    "studies": 4,
    "tolerance": 4,
    "identification": 4,
    "config": 5,
    "results": 5,
    "plot": 5,
    "reproduce": 6,
    "cli": 6,
    "__main__": 6,
}


def room(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_rooms(source: str) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            module = node.module or ""
            names = [f"{module}.{alias.name}" for alias in node.names] if module == "gearjax" else [module]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        found |= {name.split(".")[1] for name in names if name.startswith("gearjax.")}
    return found


def upward(own: str, source: str) -> list[str]:
    """Rooms that a file of the room ``own`` imports from above its layer."""
    return [other for other in imported_rooms(source) if LAYERS.get(other, 99) > LAYERS[own]]


FILES = [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downwards(path):
    assert room(path) in LAYERS, "a new room needs a layer"
    assert upward(room(path), path.read_text(encoding="utf-8")) == []


def test_systems_never_import_each_other():
    folder = PACKAGE / "systems"
    shared = {"__init__", "base"}
    for path in folder.glob("*.py"):
        if path.stem == "__init__":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("gearjax.systems."):
                assert node.module.split(".")[2] in shared


def test_an_upward_import_is_found():
    assert upward("contact", "from gearjax.scene import Scene") == ["scene"]
    assert upward("systems", "import gearjax.analysis.dynamics") == ["analysis"]
    assert upward("analysis", "from gearjax import plot") == ["plot"]
    assert upward("scene", "from gearjax.contact import laws\nimport jax") == []


def test_the_library_never_touches_jax_config():
    touching = {room(path) for path in FILES if "config.update" in path.read_text(encoding="utf-8")}
    assert touching == {"cli"}


ORDERS = re.compile(r"two_sided|\[:\s*pairs\]|pairs \+ \w|\bpairs:\]|ContactFrame|\bFlank\b")


def test_only_a_layout_knows_the_order_of_contacts():
    """Which contact is of which side and pair stands in `gearjax.contact.Layout`, and nowhere else."""
    assert ORDERS.search("touch[: contacts.pairs + i]")
    assert ORDERS.search("if system.two_sided:")
    for path in FILES:
        assert ORDERS.search(path.read_text(encoding="utf-8")) is None, path


LATER = ("pint", "pandas", "matplotlib", "xarray", "zarr", "scipy.special", "scipy.optimize", "SALib", "typer", "skfem")
MOTION = ("diffrax", "optimistix", "lineax", "optax", "gearjax.analysis", "gearjax.studies", "gearjax.identification")


def imported(code: str, names: tuple[str, ...]) -> str:
    """Which of some modules a program has imported in a process of its own."""
    look = f"import sys; {code}; print([name for name in {names} if name in sys.modules])"
    return subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.slow
def test_importing_brings_nothing_that_only_some_analyses_need():
    """It is half of what a notebook waits for its first cell, and all that a command waits for its first line."""
    assert imported("import gearjax", ("jax", *LATER, *MOTION)) == "[]"
    load = f"import gearjax; gearjax.load({str(CONFIG)!r})"
    assert imported(load, (*LATER, *MOTION)) == "[]"
    assert imported("import gearjax; gearjax.simulate", LATER) == "[]"
    assert imported("import gearjax.cli", (*[name for name in LATER if name != "typer"], *MOTION)) == "[]"


@pytest.mark.parametrize("package", ["gearjax", "gearjax.config", "gearjax.results", "gearjax.reproduce"])
def test_a_public_name_is_no_module_of_the_same_name(package):
    """Names are imported when they are first used: whoever imports a module of the same name would hide them."""
    module = importlib.import_module(package)
    beside = {path.stem for path in Path(module.__file__).parent.iterdir()}
    assert set(module.__all__) & beside <= {"units"}
    assert set(dir(module)) >= set(module.__all__)
    for name in ("nothing_of_this_name", "_nothing"):
        with pytest.raises(AttributeError, match=name):
            getattr(module, name)
