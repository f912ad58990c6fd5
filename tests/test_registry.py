"""Gear sets of one's own: registered by a program, or found by the command in installed packages."""

import inspect
import os
import subprocess
import sys
import types
import typing
from importlib import metadata
from typing import ClassVar

import jax.numpy as jnp
import pytest

import gearjax as gj
from gearjax import registry
from tests.conftest import ROOT
from tests.test_made_up_system import CONFIG, SpurPair

STATIC = CONFIG.replace('analyses = ["no_load", "backlash", "static", "dynamic"]', 'analyses = ["no_load"]')


def package(folder, name: str, source: str, entries: str) -> None:
    """A package as pip would install it."""
    (folder / f"{name}.py").write_text(source, encoding="utf-8")
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(entries, encoding="utf-8")


SPUR = "[gearjax.systems]\nspur = spur_pairs:SpurPair\n"


def spur_package(folder) -> None:
    source = inspect.getsource(sys.modules[SpurPair.__module__])
    begin, end = source.index("class SpurPair"), source.index("CONFIG = ")
    imports = "\n".join(line for line in source[:begin].splitlines() if line.startswith(("import", "from")))
    package(
        folder, "spur_pairs", imports + "\n\n\n" + source[begin:end], "[gearjax.systems]\nspur = spur_pairs:SpurPair\n"
    )


def gearjax_command(folder, *arguments: str) -> subprocess.CompletedProcess:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-m", "gearjax", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


@pytest.mark.slow
def test_the_command_runs_the_gear_set_of_a_package(tmp_path):
    spur_package(tmp_path)
    (tmp_path / "mine.toml").write_text(STATIC, encoding="utf-8")
    done = gearjax_command(tmp_path, "run", "mine.toml", "--json")
    assert done.returncode == 0, done.stderr
    assert '"analysis": "no_load"' in done.stdout
    # with a second package that takes the same kind, every configuration is refused and both are named
    package(tmp_path, "others", "from spur_pairs import SpurPair\n\nclass Other(SpurPair):\n    pass\n",
            "[gearjax.systems]\nother = others:Other\n")  # fmt: skip
    done = gearjax_command(tmp_path, "run", "mine.toml", "--json")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert 'kind = "spur_pair": is the kind of' in done.stderr
    assert "of package others" in done.stderr or "of package spur_pairs" in done.stderr


@pytest.fixture
def apart(monkeypatch):
    """Kinds of their own for a test."""
    monkeypatch.setattr(registry, "_kinds", {group: dict(known) for group, known in registry._kinds.items()})
    registry._read_plugins.cache_clear()
    yield
    registry._read_plugins.cache_clear()


class Taken(SpurPair):
    kind: ClassVar[str] = "two_kv"


class Nameless(SpurPair):
    kind: ClassVar[str] = "my gears"


@pytest.mark.usefixtures("apart")
@pytest.mark.parametrize(
    ("part", "words"),
    [
        (Taken, r'Taken\.kind = "two_kv": is the kind of gearjax\.systems\.two_kv\.TwoKV already'),
        (Nameless, r'Nameless\.kind = "my gears": must be a name of letters'),
        (gj.AbstractSystem, "is abstract: it lacks .*layout, orders, pose"),
        (gj.Scene, "must be a class that is a subclass of one of AbstractSystem"),
        ("two_kv", 'register = "two_kv": must be a class'),
    ],
)
def test_what_cannot_be_registered(part, words):
    with pytest.raises(gj.ParameterError, match=words) as caught:
        gj.register(part)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("apart")
def test_errors_and_compliances_are_registered_too(config_text):
    class Waviness(gj.AbstractError):
        kind: ClassVar[str] = "waviness"
        body: str

        def gap(self, view):
            return 0.0 * view.influence

    class Steady(gj.AbstractCompliance):
        kind: ClassVar[str] = "steady"
        harmonics: ClassVar[int] = 0

        def mean_stiffness(self, pairs):
            return jnp.full((pairs,), 1e8)

        def stiffness(self, mesh_angle):
            return jnp.full(mesh_angle.shape, 1e8)

        def peak_stiffness(self):
            return jnp.asarray(1e8)

    assert gj.register(Waviness) is Waviness
    gj.register(Waviness)  # again does no harm
    assert Waviness in registry.kinds("gearjax.errors")
    with pytest.raises(gj.ParameterError, match=r'did you mean "waviness"\?'):
        gj.loads(config_text.replace('kind = "eccentricity"', 'kind = "wavines"', 1))
    gj.register(Steady)
    begin, end = config_text.index("[compliance]"), config_text.index("[inertia]")
    scene = gj.loads(config_text[:begin] + '[compliance]\nkind = "steady"\n' + config_text[end:])
    assert isinstance(scene.compliance, Steady)


@pytest.mark.usefixtures("apart")
@pytest.mark.parametrize(
    ("group", "value", "words"),
    [
        ("gearjax.systems", "nowhere:Gears", r"nowhere:Gears cannot be loaded \(ModuleNotFoundError"),
        ("gearjax.systems", "gearjax:NoSuch", r"gearjax:NoSuch cannot be loaded \(AttributeError"),
        ("gearjax.systems", "gearjax:Scene", "must be a class that is a subclass"),
        ("gearjax.errors", "gearjax:TwoKV", "belongs to the group gearjax.systems, not gearjax.errors"),
        ("gearjax.systems", "tests.test_registry:Taken", "is the kind of gearjax.systems.two_kv.TwoKV already"),
    ],
)
def test_broken_plugins_are_named(monkeypatch, config_text, group, value, words):
    entry = metadata.EntryPoint("mine", value, group)
    vars(entry).update(dist=types.SimpleNamespace(name="my-gears"))
    monkeypatch.setattr(registry.metadata, "entry_points", lambda group: [entry] if group == entry.group else [])
    for _ in range(2):  # it does not pass the second time
        with pytest.raises(gj.GearjaxError, match=f'plug-in "mine" of package my-gears: .*{words}') as caught:
            gj.loads(config_text)
        assert "\n" not in str(caught.value)


def test_what_functions_return_can_be_asked_for_help():
    """Classes that public functions return, their fields and their bases are public too."""
    functions = [f for name in gj.__all__ if inspect.isfunction(f := getattr(gj, name))]
    returned = {typing.get_type_hints(f).get("return") for f in functions}
    own = {part for part in returned if inspect.isclass(part) and part.__module__.startswith("gearjax.")}
    assert {gj.TransmissionError, gj.Backlash, gj.Motion, gj.Study, gj.Spectrum, gj.Torsion, gj.LostMotion} <= own
    public = {getattr(gj, name) for name in gj.__all__ if name != "units"}
    assert own <= public
    bases = {base for part in public if inspect.isclass(part) for base in part.__mro__}
    assert {b for b in bases if b.__module__.startswith("gearjax.") and b.__name__.startswith("Abstract")} <= public
