"""``gearjax new``: a configuration with every key, which loads as it is and with each of its options put in."""

import functools
import re
import tomllib

import pytest

import gearjax as gj
from gearjax import registry
from gearjax.cli import main
from gearjax.compliance import COMPLIANCES
from gearjax.config import loads_identify, loads_optimise, loads_tolerance, template
from gearjax.config.build import CONTACTS
from gearjax.config.commented import TOGETHER, options, put_in
from gearjax.config.identify import IDENTIFY_KEYS
from gearjax.config.meaning import meanings, summary
from gearjax.config.optimise import OPTIMISE_KEYS
from gearjax.config.run import PUBLISHED_KEYS, RUN_KEYS
from gearjax.config.tolerance import ALLOCATION_KEYS, ASSEMBLY_KEYS, MEASURE_KEYS, SENSITIVITY_KEYS, TOLERANCE_KEYS
from gearjax.errors import ERRORS
from gearjax.inertia import DampingRatio, EquivalentMass, MomentOfInertia
from gearjax.load_torque import LOADS
from gearjax.parameters import declared
from gearjax.systems import SYSTEMS
from gearjax.tolerance import DISTRIBUTIONS
from tests.test_made_up_system import SpurPair

KINDS = [system.kind for system in SYSTEMS]


written = functools.cache(template)


OTHERS = [pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS if kind != "two_kv"]


@pytest.fixture(scope="module", params=["two_kv", *OTHERS])
def text(request) -> str:
    return written(request.param)


def mistake(text: str) -> str:
    try:
        gj.loads(text)
    except gj.GearjaxError as fault:
        return str(fault)
    return ""


@pytest.mark.slow
def test_it_loads_as_it_is(text):
    scene = gj.loads(text)
    assert scene.run is not None
    motion = () if scene.system.has_slices else ("dynamic",)
    assert scene.run.analyses == ("no_load", "backlash", "static", *motion)
    assert loads_optimise(text)[1].where
    assert loads_tolerance(text)[2].measures
    assert loads_identify(text)[1].measured


@pytest.mark.slow
def test_each_option_loads_when_it_is_put_in(text):
    found = options(text)
    assert len(found) > 25
    lines, changed, refused = text.splitlines(), 0, []
    for places in found:
        other = put_in(text, places)
        changed += tomllib.loads(other) != tomllib.loads(text)
        assert tomllib.loads(other).keys() <= {*tomllib.loads(text), "published", "supports", "impact"}
        fault = mistake(other)
        if fault:
            noted = " ".join(line[2:] for line in lines[: places[0]] if line.startswith("# "))
            assert f"Other sections must change too: {fault}" in noted
            refused.append(lines[places[1]])
    assert changed == len(found) - 1, "all but the rayleigh distribution, which is there already, change something"
    without_motion = {
        "two_kv": [],
        "rv_cycloidal": [],
        "involute_rv": ['#kind = "elastic_teeth"'],
        "helical_pair": [],
        "helical_train": [],
        "elliptic_pair": [],
        "noncircular_pair": [],
    }
    assert refused == without_motion[tomllib.loads(text)["system"]["kind"]]


@pytest.mark.slow
def test_every_declared_name_occurs(text):
    kind = tomllib.loads(text)["system"]["kind"]
    system = next(system for system in SYSTEMS if system.kind == kind)
    parts = [system, EquivalentMass, MomentOfInertia, DampingRatio, *LOADS, *CONTACTS]
    kinds = set(re.findall(r'^#?kind = "(\w+)"', text, flags=re.MULTILINE))
    parts += [part for part in (*ERRORS, *COMPLIANCES) if part.kind in kinds]
    assert len(parts) > 10
    written = set(re.findall(r"^#?(\w+) = ", text, flags=re.MULTILINE))
    for names in re.findall(r"^# (\w+(?:, \w+)*): ", text, flags=re.MULTILINE):  # of a part that may be put in instead
        written |= set(names.split(", "))
    for part in parts:
        assert declared(part).keys() <= written, part
        assert getattr(part, "kind", kind) in kinds
    studies = TOLERANCE_KEYS, SENSITIVITY_KEYS, ALLOCATION_KEYS, ASSEMBLY_KEYS
    for keys in (RUN_KEYS, IDENTIFY_KEYS, PUBLISHED_KEYS, *studies):
        assert keys.keys() <= written
    assert OPTIMISE_KEYS.keys() - {"torque", "order"} <= written
    for name in ("torque", "order", *MEASURE_KEYS, "file", "column", "unit", "correlated"):
        assert re.search(rf"\b{name}\b", text)
    for part in DISTRIBUTIONS:
        assert f"# {part.kind}: " in text


@pytest.mark.slow
def test_what_does_not_suit_is_said():
    assert (
        "# No positions, sizes, cumulative_pitch for a two_kv: each body of this two_kv has no rim of pins or teeth"
        in written("two_kv")
    )
    assert "[backlash] is not for an rv_cycloidal" in written("rv_cycloidal")
    assert TOGETHER in written("rv_cycloidal")


def test_meaning_units_bounds_and_default_stand_above_a_key():
    text = written("two_kv")
    assert ('# module of the second stage (a length, at least 1e-06 m and at most 1 m)\nmodule = "2.5 mm"\n') in text
    assert "# number of planet wheels (a whole number, at least 1 and at most 5); default 2\n#planets = 2\n" in text
    assert (
        "# number of starting points of the gradient search (a whole number from 1 to 1000000); default 300\n" in text
    )


def test_meanings_are_those_of_the_docstrings():
    class Part:
        """A part.

        It has `things`.

        Args:
            one, two: of ``both``, which
                go on here [m].
            three: shape (n,), a list.

        Raises:
            ParameterError: never.
        """

    both = "of both, which go on here"
    assert meanings(Part) == {"one": both, "two": both, "three": "a list"}
    assert summary(Part) == ["A part.", "It has things."]


@pytest.mark.slow
def test_a_gear_set_of_ones_own(monkeypatch):
    """From its declared fields alone: no example is given in them."""
    monkeypatch.setitem(registry._kinds, "gearjax.systems", {part.kind: part for part in (*SYSTEMS, SpurPair)})
    text = template(SpurPair.kind)
    scene = gj.loads(text)
    assert isinstance(scene.system, SpurPair)
    assert declared(SpurPair).keys() <= set(re.findall(r"^#?(\w+) = ", text, flags=re.MULTILINE))


@pytest.mark.slow
def test_the_command(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["new", "two_kv"])
    assert not stopped.value.code
    assert capsys.readouterr().out == written("two_kv")
    for arguments, words in (
        ([], "needs a kind of gear set: two_kv, rv_cycloidal"),
        (["two_k"], 'did you mean "two_kv"?'),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(["new", *arguments])
        assert stopped.value.code == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert words in err


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_what_it_writes_runs_without_a_warning(kind, tmp_path, capsys):
    (tmp_path / "mine.toml").write_text(written(kind), encoding="utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(["run", str(tmp_path / "mine.toml"), "--json"])
    assert not stopped.value.code
    assert ('"dynamic"' in capsys.readouterr().out) == (not kind.startswith("helical_"))
