"""Configurations made wrong at random: each loads, or is refused in one line."""

import json
import tomllib

import pytest
import tomli_w

import gearjax as gj
from gearjax.cli import main
from tests.attacks import SHIPPED, attacks

NUMBER, SEED, RUNS = 500, 5, 10
LONGEST = 400


def outcome(path) -> gj.Scene | None:
    """The scene of a file, or ``None`` where it is refused properly."""
    try:
        return gj.load(path)
    except gj.GearjaxError as fault:
        message = str(fault)
        assert message
        assert message.isprintable(), ascii(message)
        assert len(message) < LONGEST, message
        return None


@pytest.mark.slow
def test_a_few_of_the_attacks(tmp_path):
    path = tmp_path / "attack.toml"
    for raw in attacks(40, 17):
        path.write_bytes(raw)
        outcome(path)


def test_a_value_that_would_be_wrong_in_a_list_too_is_not_repeated_in_one(tmp_path):
    tables = tomllib.loads(SHIPPED[0].read_text(encoding="utf-8"))
    wrong = {"relative_amplitudes": "9e7 N/m", "phases": []}
    tables["compliance"] = {"kind": "harmonic_stiffness", "mean": "9e7 N/m", **wrong}
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    with pytest.raises(gj.GearjaxError, match=r"relative_amplitudes = .9e7 N/m.: must be a number without unit"):
        gj.load(path)


@pytest.mark.parametrize(("given", "shown"), [("10 %", '["10 %"]'), ("x" * 10_000, "[]"), ("\x1b[31m", "[]")])
def test_a_value_that_should_be_a_list_is_repeated_if_it_is_short(tmp_path, given, shown):
    tables = tomllib.loads(SHIPPED[0].read_text(encoding="utf-8"))
    tables["compliance"] = {"kind": "harmonic_stiffness", "mean": "9e7 N/m", "relative_amplitudes": given, "phases": []}
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    with pytest.raises(gj.GearjaxError) as fault:
        gj.load(path)
    assert f"must be a list of values, such as {shown}" in str(fault.value)
    assert len(str(fault.value)) < LONGEST
    assert str(fault.value).isprintable()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")  # the nine samples of a study that it lists
@pytest.mark.filterwarnings("ignore::gearjax.FewCandidates")  # of attacked numbers of pairs, and of attacked backlash
def test_attacks(tmp_path, capsys):
    """Those that load also run, shortened to one analysis of nine samples: results, or one line."""
    path, loaded, ran, refused = tmp_path / "attack.toml", 0, 0, 0
    for index, raw in enumerate(attacks(NUMBER, SEED)):
        path.write_bytes(raw)
        scene = outcome(path)
        if scene is None:
            refused += 1
            continue
        loaded += 1
        if scene.run is None or ran == RUNS:
            continue
        tables = tomllib.loads(raw.decode("utf-8-sig"))
        run = tables["run"]
        run.pop("settle", None)
        run |= {"samples": 9, "analyses": [run["analyses"][index % len(run["analyses"])]]}
        run |= {"torques": run["torques"][:1]} if "torques" in run else {}
        path.write_text(tomli_w.dumps(tables), encoding="utf-8")
        if outcome(path) is None:  # nine samples may be too few for a study that it lists
            continue
        ran += 1
        with pytest.raises(SystemExit) as stopped:
            main(["run", str(path), "--json"])
        out, err = capsys.readouterr()
        if stopped.value.code:
            assert (stopped.value.code, out) == (2, ""), index
            last = err.splitlines()[-1]
            assert last.startswith("gearjax: error: ")
            assert last.isprintable()
            assert len(last) < LONGEST + 20
        else:
            assert json.loads(out)["cases"], index
    assert (loaded > 50, refused > 250, ran) == (True, True, RUNS)


@pytest.mark.slow
def test_what_the_attacks_start_from_loads():
    assert len(SHIPPED) >= 5
    for path in SHIPPED:
        assert gj.load(path).run is not None
