"""The command line as a user meets it."""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

from gearjax.cli import main
from gearjax.units import arcmin
from tests.conftest import CONFIG, ROOT, compiled_as_tests

FAST = CONFIG.read_text(encoding="utf-8").replace('"3 s"', '"0.2 s"').replace("3001", "201")


@pytest.fixture
def fast(tmp_path):
    path = tmp_path / "fast.toml"
    path.write_text(FAST, encoding="utf-8")
    return path


def command(capsys, *arguments) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of ``gearjax *arguments``."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return int(stopped.value.code or 0), out, err


@pytest.mark.slow
def test_run_json(capsys, tmp_path, monkeypatch, fast):
    monkeypatch.chdir(tmp_path)
    code, out, err = command(capsys, "run", fast, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["config"] == str(fast)
    cases = found["cases"]
    names = [(case["analysis"], case["torque_Nm"]) for case in cases]
    assert names[:2] == [("no_load", 0.0), ("backlash", 0.0)]
    assert names[2:] == [(kind, torque) for kind in ("static", "dynamic") for torque in (30.0, 100.0, 300.0)]
    assert [case["window_s"] for case in cases] == pytest.approx([0.2] * 5 + [0.15] * 3)
    metrics = {"peak_to_peak_arcmin", "amplitude_arcmin", "mean_arcmin", "std_arcmin"}
    assert all(set(case["metrics"]) == metrics for case in cases)
    assert "done: static, 100 N m" in err
    assert list(tmp_path.iterdir()) == [fast], "nothing is written without --out"


@pytest.mark.slow
def test_run_writes_what_it_shows(capsys, tmp_path, fast):
    folder = tmp_path / "deep" / "results"
    code, out, _ = command(capsys, "run", fast, "--out", folder)
    assert code == 0
    assert "static, 300 N m" in out
    assert "(2.848)" in out, "published values stand in brackets"
    names = {path.name for path in folder.iterdir()}
    figures = {"schematic.png", "transmission_error.png", "contact_forces.png", "order_spectrum.png"}
    assert names == {"results.nc", "curves.csv", "metrics.csv", "written.json"} | figures
    with xr.open_dataset(folder / "results.nc", engine="scipy") as stored:
        assert stored.attrs["config"] == FAST
        assert stored.no_load.attrs["units"] == "rad"
        assert stored.time.attrs["units"] == "s"
        assert stored.static_300_Nm.dims == ("time",)
        assert stored.dynamic_30_Nm_force.dims == ("time", "contact")
        names = stored.dynamic_30_Nm_force.attrs["contacts"].split("; ")
        assert names[0] == "the driving flank of planet_1"
        assert len(names) == stored.dynamic_30_Nm_force.shape[1]
        assert stored.no_load.attrs["peak_to_peak_rad"] >= float(np.ptp(stored.no_load.values))
    with (folder / "curves.csv").open() as lines:
        rows = list(csv.reader(lines))
    assert rows[0][:3] == ["time [s]", "input angle [rad]", "no-load [arcmin]"]
    assert len(rows) == 202
    with (folder / "metrics.csv").open() as lines:
        table = list(csv.DictReader(lines))
    assert [row["analysis"] for row in table] == ["no_load", "backlash"] + ["static"] * 3 + ["dynamic"] * 3
    assert 1.0 <= float(table[2]["load sharing factor [-]"]) <= 2.0
    for name in figures:
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_results_file_runs_again(capsys, tmp_path, fast):
    _, first, _ = command(capsys, "run", fast, "--json", "--out", tmp_path / "first")
    code, again, _ = command(capsys, "run", tmp_path / "first" / "results.nc", "--json")
    assert code == 0
    assert json.loads(again)["cases"] == json.loads(first)["cases"]


@pytest.mark.slow
def test_without_out_the_pictures_go_to_a_folder_named_after_the_config(capsys, tmp_path, monkeypatch, fast):
    monkeypatch.chdir(tmp_path)
    code, _, err = command(capsys, "run", fast)
    assert code == 0
    assert (tmp_path / "out" / "fast" / "transmission_error.png").exists()
    assert "out/fast" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "no/such.toml"], "no/such.toml: cannot be read"),
        (["runn"], "No such command 'runn'"),
        (["run"], "Missing argument 'CONFIG'"),
        (["run", "x.toml", "--jason"], "No such option: --jason"),
        (["run", "broken.nc"], "not a results file"),
        (["reproduce", "two_k"], 'unknown paper; did you mean "two_kv"?'),
    ],
)
def test_mistakes_are_one_line(capsys, arguments, words):
    code, out, err = command(capsys, *arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("gearjax: error: ")
    assert words in err


def test_config_mistakes_exit_with_two(capsys, fast):
    fast.write_text(FAST.replace('[inertia]\nmass = "3 kg"', ""), encoding="utf-8")
    code, out, err = command(capsys, "run", fast, "--json")
    assert (code, out) == (2, "")
    assert err == 'gearjax: error: run.analyses: "dynamic" needs [inertia], which this scene does not list\n'
    fast.write_text(FAST.replace('duration = "0.2 s"', 'duration = "1e9 s"'), encoding="utf-8")
    code, _, err = command(capsys, "run", fast, "--json")
    assert code == 2
    assert "run.duration = 1e+09 s needs" in err
    assert err.count("\n") == 3, "that it was read, a note and the error: refused before anything is computed"
    fast.write_text(FAST[: FAST.index("[run]")], encoding="utf-8")
    code, _, err = command(capsys, "run", fast)
    assert code == 2
    assert "no [run]" in err


@pytest.mark.slow
def test_an_output_folder_that_cannot_be_written(capsys, tmp_path, fast):
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "blocked" / "transmission_error.png").mkdir(parents=True)
    for folder in ("file", "blocked"):
        code, _, err = command(capsys, "run", fast, "--out", tmp_path / folder)
        assert code == 2
        assert err.splitlines()[-1].startswith("gearjax: error: --out")


def test_a_damaged_results_file(capsys, tmp_path):
    for size in (0, 3, 50):
        (tmp_path / "cut.nc").write_bytes(b"CDF\x02"[:size] + b"x" * max(0, size - 4))
        code, out, err = command(capsys, "run", tmp_path / "cut.nc")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "not a results file" in err


@pytest.mark.slow
def test_torques_that_print_alike_keep_their_curves(capsys, tmp_path, fast):
    alike = FAST.replace('"30 N*m", "100 N*m", "300 N*m"', '"100000.1 N*m", "100000.2 N*m"')
    fast.write_text(alike.replace(', "dynamic"]', "]"), encoding="utf-8")
    assert command(capsys, "run", fast, "--out", tmp_path / "x")[0] == 0
    with xr.open_dataset(tmp_path / "x" / "results.nc", engine="scipy") as stored:
        assert {"static_100000.1_Nm", "static_100000.2_Nm"} <= set(stored)


def test_version_and_help(capsys):
    assert command(capsys, "--version")[1].startswith("gearjax 0.")
    assert "reproduce" in command(capsys)[1]
    assert "--json" in command(capsys, "run", "--help")[1]


@pytest.mark.slow
def test_as_a_module_in_a_fresh_process(fast):
    """The command sets float64 itself; stdout holds JSON alone."""
    fast.write_text(FAST.replace(', "static", "dynamic"]', "]"), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "gearjax", "run", str(fast), "--json"],
        cwd=ROOT,
        env=os.environ | compiled_as_tests(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    cases = json.loads(done.stdout)["cases"]
    assert cases[0]["metrics"]["peak_to_peak_arcmin"] > 1.0
    assert "Warning" not in done.stderr


@pytest.mark.slow
def test_programs_are_kept_between_runs(fast, tmp_path):
    """Under the user's cache; a folder that cannot be made is no error; JAX's own switch turns it off."""

    def run(**environment):
        command = [sys.executable, "-m", "gearjax", "run", str(fast), "--json"]
        environment = {**os.environ, **compiled_as_tests(), **environment}
        return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)

    fast.write_text(FAST.replace(', "static", "dynamic"]', "]"), encoding="utf-8")

    def kept():
        return sorted(path.name for path in (tmp_path / "cache" / "gearjax").rglob("*transmission_error*-cache"))

    first = run(XDG_CACHE_HOME=str(tmp_path / "cache"))
    programs = kept()
    assert len(programs) == 1
    assert run(XDG_CACHE_HOME=str(tmp_path / "cache")).stdout == first.stdout
    assert kept() == programs, "the same one is taken, none is added"
    (tmp_path / "file").write_text("")
    assert run(XDG_CACHE_HOME=str(tmp_path / "file")).stdout == first.stdout
    run(XDG_CACHE_HOME=str(tmp_path / "off"), JAX_ENABLE_COMPILATION_CACHE="0")
    assert not (tmp_path / "off").exists()


@pytest.mark.slow
def test_alternating_loads_run(capsys, fast):
    fast.write_text(FAST.replace('kind = "constant"', 'kind = "sinusoidal"\nfrequency = "crank"'), encoding="utf-8")
    code, out, _ = command(capsys, "run", fast, "--json")
    assert code == 0
    static = json.loads(out)["cases"][2]
    assert static["metrics"]["peak_to_peak_arcmin"] * arcmin > 0


@pytest.mark.slow
def test_smooth_contacts_run(capsys, fast):
    text = FAST.replace('kind = "hard"', 'kind = "quadratic"\nwidth = "0.5 um"')
    fast.write_text(text.replace(', "static", "dynamic"]', ', "static"]'), encoding="utf-8")
    code, out, _ = command(capsys, "run", fast, "--json")
    assert code == 0
    assert json.loads(out)["cases"][0]["metrics"]["mean_arcmin"] < 0


@pytest.mark.slow
def test_the_record_that_is_told_has_all_errors_in_it(capsys, fast):
    """A motion whose start is left out needs so much longer a record."""
    told = command(capsys, "run", fast)[1]
    cycle, whole = (float(told.partition(words)[2].split(" s")[0]) for words in ("s of the ", 'duration = "'))
    assert whole == pytest.approx(cycle + 0.05, rel=1e-5)  # settle of the example


@pytest.mark.slow
def test_a_wrong_unit_is_noticed_by_how_far_the_output_is_off(capsys, fast):
    words = "the output is off by 9.23 mm at the teeth, more than a quarter of system.module"
    for unit, noticed in (("N*m", False), ("kN*m", True)):
        text = FAST.replace(', "static", "dynamic"]', ', "static"]').replace(
            '"30 N*m", "100 N*m", "300 N*m"', f'"100 {unit}"'
        )
        fast.write_text(text, encoding="utf-8")
        code, _, told = command(capsys, "run", fast, "--json")
        assert code == 0
        assert (words in " ".join(told.split())) == noticed
