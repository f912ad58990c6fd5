"""Results of further studies that a tolerance study keeps: shown again as they were, or worked out again."""

import json

import numpy as np
import pytest

from gearjax.results.further import FOLDER, NAMED, Further
from gearjax.tolerance.allocation import AllocatedTolerances
from gearjax.tolerance.assembly import MatchedAssembly
from gearjax.tolerance.interference import Clashes
from gearjax.tolerance.measure import Measure
from gearjax.tolerance.statistics import Estimate
from gearjax.tolerance.variance import Sensitivities
from tests.test_tolerance_command import command, small

TABLES = {"system": {"kind": "two_kv"}, "tolerance": {"samples": 10, "measures": ["no_load.mean"]}}


def results(rng: np.random.Generator) -> dict:
    """A result of each further study, of random numbers with all their digits."""

    def values(*shape):
        return np.abs(rng.standard_normal(shape)) * 10.0 ** rng.integers(-100, 100, shape)

    estimate = Estimate(*rng.random(3).tolist())
    columns = {name: values(3) for name in ("linear", "first", "first_error", "total", "total_error", "one_at_a_time")}
    measure = Measure("static", "peak_to_peak", 30.0, limit=1e-3)
    lost = values(5)
    lost[2] = np.nan
    return {
        "sensitivities": [Sensitivities("m", ("a", "b", "c"), **columns, samples=7, failed=0, correlated=True)],
        "tightened": {"m": {"errors.a": (estimate, Estimate(*values(3).tolist()))}},
        "allocation": AllocatedTolerances(
            "m", 0.95, ("a",), values(1), *rng.random(2).tolist(), estimate, estimate, True
        ),
        "assembly": MatchedAssembly(measure, ("a", "b"), lost, values(5), values(5, 2), 1.5, 2.5),
        "missed": {"m": float(values(1)[0])},
        "interference": Clashes(256, 3, 17, 1e-6, "pin 3", 0.1),
        "none": None,
        "unbounded": Estimate(0.1, -np.inf, np.inf),
    }


def equal(one, other) -> bool:
    """Whether two results are the same objects with the same digits."""
    if isinstance(one, np.ndarray):
        return type(other) is np.ndarray and one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(map(equal, one.values(), other.values()))
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(equal, one, other))
    return all(map(equal, vars(one).values(), vars(other).values())) if hasattr(one, "__dict__") else one == other


def never():
    raise AssertionError("worked out again")


def test_every_kind_of_result_is_kept_to_the_last_digit(tmp_path, rng):
    wanted = results(rng)
    first = Further(tmp_path, TABLES)
    for name, value in wanted.items():
        assert first.get(name, lambda value=value: value) is value
    assert first.shown_again == []
    second = Further(tmp_path, TABLES)
    for name, value in wanted.items():
        kept = second.get(name, never)
        assert equal(kept, value), name
        assert isinstance(kept, NAMED) == isinstance(value, NAMED)
    assert second.shown_again == [name for name in wanted if name != "none"]


def test_a_result_of_another_configuration_or_name_is_worked_out_again(tmp_path):
    Further(tmp_path, TABLES).get("missed", lambda: {"m": 1.0})
    other = TABLES | {"tolerance": {"samples": 11, "measures": ["no_load.mean"]}}
    assert Further(tmp_path, other).get("missed", lambda: {"m": 2.0}) == {"m": 2.0}
    (tmp_path / FOLDER / "missed.json").rename(tmp_path / FOLDER / "tightened.json")
    with pytest.raises(AssertionError, match="worked out again"):
        Further(tmp_path, other).get("tightened", never)


def test_damage_is_noticed_wherever_it_is(tmp_path, rng):
    further, wanted = Further(tmp_path, TABLES), results(rng)["assembly"]
    path = tmp_path / FOLDER / "assembly.json"
    further.get("assembly", lambda: wanted)
    whole = path.read_bytes()
    damaged = [b"", whole[: len(whole) // 2], b"\xff" + whole, whole.replace(b"1.5", b"1.4")]
    for place in rng.integers(len(whole), size=20):
        damaged.append(bytearray(whole))
        damaged[-1][place] ^= 1
    for content in damaged:
        path.write_bytes(content)
        again = Further(tmp_path, TABLES)
        assert again.get("assembly", lambda: wanted) is wanted
        assert again.shown_again == []
        assert path.read_bytes() == whole


@pytest.mark.parametrize("nothing", [None, [], {}])
def test_studies_that_were_not_asked_for_are_not_shown_again(tmp_path, nothing):
    for _ in range(2):
        further = Further(tmp_path, TABLES)
        assert further.get("tightened", lambda: nothing) == nothing
        assert further.shown_again == []


def test_without_a_folder_nothing_is_kept(tmp_path):
    further = Further(None, TABLES)
    assert [further.get("missed", lambda number=number: number) for number in (1, 2)] == [1, 2]
    assert list(tmp_path.iterdir()) == []


STUDIES = """
[tolerance.sensitivity]
samples = 64

[tolerance.allocation]
measure = "no_load.peak_to_peak"
yield = 0.9
cost = {"errors.planet_1.amplitude" = 1.0, "errors.revolution.amplitude" = 2.0}

[tolerance.assembly]
measure = "no_load.peak_to_peak"
where = ["errors.planet_1.phase"]
units = 8
starts = 2
"""


@pytest.mark.slow
def test_a_finished_study_is_shown_again_without_being_made_again(tmp_path, capsys, monkeypatch, rng):
    """The studies themselves are tested elsewhere: here each returns random results once, and fails the second time."""
    config, out, made = tmp_path / "study.toml", str(tmp_path / "out"), results(rng)
    config.write_text(small() + STUDIES, encoding="utf-8")
    studies = {"allocate": "allocation", "matched_assembly": "assembly", "clashes": "interference", "_missed": "missed"}
    studies |= {"sensitivities": "sensitivities", "tightened": "tightened"}
    for study, name in studies.items():
        monkeypatch.setattr(f"gearjax.results.tolerance.{study}", lambda *_, name=name, **__: made[name])
    monkeypatch.setattr("gearjax.plot.save_tolerance_figures", lambda *_: [])  # intervals beside their values fail
    assert command(str(config), "--json", "--out", out) == 0
    first = json.loads(capsys.readouterr().out)
    for study in studies:
        monkeypatch.setattr(f"gearjax.results.tolerance.{study}", lambda *_, **__: never())
    assert command(str(config), "--json", "--out", out) == 0
    shown = capsys.readouterr()
    again = json.loads(shown.out)
    assert "kept from the run before: sensitivities, tightened, allocation, assembly" in shown.err
    assert again["computed"] == 0
    for key in ("seconds", "compile_seconds", "samples_per_second", "computed"):  # of this run
        del first[key], again[key]
    assert again == first
    assert {"sensitivity", "halved_tolerance_yield", "allocation", "assembly", "interference"} <= first.keys()
