"""``gearjax tolerance``: its JSON, its files, resuming, clusters and devices, and what it refuses."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.cli import main
from gearjax.config import loads_tolerance
from gearjax.results.store import NAME, Store, held
from gearjax.results.tolerance import prepared
from tests.conftest import PROGRAMS, ROOT, compiled_as_tests

CONFIG = ROOT / "configs" / "two_kv" / "wang_2020_tolerance.toml"
STUDIES = "[tolerance.sensitivity]"
LONG = 8_000  # samples, of which a process does not come to the end before it is stopped


def small(**words) -> str:
    """The example's own configuration without the further studies, with three measures and few samples."""
    text = CONFIG.read_text(encoding="utf-8")
    options = {"samples": 200, "chunk": 64, **words}
    lines = text[: text.index(STUDIES)].splitlines()
    lines = [line for line in lines if not ("torque = " in line and "100 N*m" not in line)]
    written = "\n".join(f"{key} = {json.dumps(value)}" for key, value in options.items())
    return "\n".join(lines).replace("samples = 20000", written).replace("samples = 1581", "samples = 201")


def shared_programs() -> dict[str, str]:
    """Variables with which a process compiles as this one does, and takes the programs that are compiled already."""
    return compiled_as_tests() | {
        "JAX_COMPILATION_CACHE_DIR": os.environ[PROGRAMS],
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.02",
    }


def command(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["tolerance", *arguments])
    return int(ended.value.code or 0)


@pytest.fixture
def config(tmp_path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(small(), encoding="utf-8")
    return path


@pytest.mark.slow
def test_json_is_what_it_promises(config, capsys):
    assert command(str(config), "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["samples"], found["failed"], found["seed"]) == (200, 0, 0)
    entry = found["measures"]["no_load.peak_to_peak"]
    assert (entry["unit"], entry["limit"]) == ("arcmin", pytest.approx(2.0))
    for level in ("0.05", "0.5", "0.95"):
        value, low, high = entry["quantiles"][level]
        assert low <= value <= high
    share, low, high = entry["yield"]
    assert 0 <= low <= share <= high <= 1
    assert found["measures"]["backlash.minimum"]["at_least"] == pytest.approx(4.0)
    assert list(found["measures"])[2] == "static.peak_to_peak@100Nm"
    assert found["sensitivity"] == {}
    assert found["seconds"] > 0
    assert found["samples_per_second"] == pytest.approx(200 / found["seconds"])
    section = loads_tolerance(config.read_text())[2]
    study = gj.monte_carlo(section.tolerances, section.measures, n=200, sampler="sobol")
    name = "no_load.peak_to_peak"
    assert entry["mean"] == pytest.approx(study.mean(name) / gj.units.arcmin, rel=1e-12)
    assert entry["quantiles"]["0.5"][1] == pytest.approx(study.quantile(name, 0.5).low / gj.units.arcmin, rel=1e-12)


@pytest.mark.slow
def test_the_worst_sample_is_a_configuration(config, tmp_path, capsys):
    out = tmp_path / "out"
    assert command(str(config), "--out", str(out), "--json") == 0
    found = json.loads(capsys.readouterr().out)
    scene = gj.load(out / "worst_no_load.peak_to_peak.toml")
    theta = scene.system.input_speed * np.asarray(scene.run.times)
    with pytest.warns(gj.FewAngles):  # of a short record: the study says nothing else of it
        value = float(gj.transmission_error(scene, theta).peak_to_peak)
    section = loads_tolerance(config.read_text())[2]
    study = gj.monte_carlo(section.tolerances, section.measures, n=200, sampler="sobol")
    assert value == pytest.approx(study.column("no_load.peak_to_peak").max(), rel=3e-3)
    assert found["measures"]["no_load.peak_to_peak"]["worst_sample"] == study.worst("no_load.peak_to_peak")
    assert study.worst("backlash.minimum") == int(np.argmin(study.column("backlash.minimum")))


def stored(config: Path, out: Path) -> Store:
    tables, _, section = loads_tolerance(config.read_text(), config.parent)
    return Store(out, tables, prepared(section), config.read_text())


@pytest.mark.slow
def test_what_is_there_is_not_worked_out_again(config, tmp_path):
    out = tmp_path / "out"
    first = stored(config, out)
    assert len(first.pending) == 4
    for chunk, found in first.work.each(first.pending[1:3]):
        first.put(chunk, found)
    begun = stored(config, out)
    assert begun.pending == [(0, 64), (192, 200)]
    assert begun.samples_done == 128
    other = np.full((64, len(begun.work.names)), 7.0), np.zeros(64, np.int32)
    begun.put((64, 128), other)  # is there already
    for chunk, found in begun.work.each(begun.pending):
        begun.put(chunk, found)
    values, codes = stored(config, out).load()
    whole = Store(tmp_path / "other", loads_tolerance(config.read_text())[0], begun.work, "")
    for chunk, found in whole.work.each(whole.pending):
        whole.put(chunk, found)
    np.testing.assert_array_equal(values, whole.load()[0])
    assert (codes == 0).all()


@pytest.mark.slow
def test_a_killed_run_ends_with_the_same_numbers(tmp_path, capsys):
    """The run that is killed is a process of its own; those before and after it are commands of this one."""
    config = tmp_path / "study.toml"
    config.write_text(small(samples=LONG, chunk=128, extremes="samples"), encoding="utf-8")
    line = [str(config), "--json", "--out"]
    killed = subprocess.Popen(
        [sys.executable, "-m", "gearjax", "tolerance", *line, str(tmp_path / "killed")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | shared_programs(),  # numbers are the same to the last bit
    )
    flags = tmp_path / "killed" / NAME / "done" / "c"
    deadline = time.monotonic() + 120
    while (len(list(flags.iterdir())) if flags.exists() else 0) < 3:
        assert time.monotonic() < deadline
        assert killed.poll() is None
        time.sleep(0.02)
    killed.send_signal(signal.SIGSTOP)  # it holds the folder, however long the next command takes to begin
    assert command(*line, str(tmp_path / "killed")) == 2
    assert "another run is writing there" in capsys.readouterr().err
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    results = []
    for folder in ("killed", "whole"):
        assert command(*line, str(tmp_path / folder)) == 0
        results.append(json.loads(capsys.readouterr().out))
    assert results[0]["measures"] == results[1]["measures"]
    assert 0 < results[0]["computed"] < results[1]["computed"] == LONG


@pytest.mark.slow
def test_another_study_is_refused_and_differences_named(config, tmp_path, capsys):
    out = tmp_path / "out"
    assert command(str(config), "--out", str(out), "--json") == 0
    for old, new, words in (
        ('scale = "6 um"', 'scale = "7 um"', "errors.planet_1.amplitude"),
        ("seed = 0", "seed = 1", "tolerance.seed: 0 there, 1 now"),
        ("ratio = 0.1", "ratio = 0.2", "damping.ratio: 0.1 there, 0.2 now"),
    ):
        config.write_text(small().replace(old, new, 1))
        assert command(str(config), "--out", str(out)) == 2
        assert words in capsys.readouterr().err
    config.write_text(small().replace('limit = "2 arcmin"', 'limit = "1 arcmin"'))
    assert command(str(config), "--out", str(out), "--json") == 0  # the same samples, judged anew
    found = json.loads(capsys.readouterr().out)
    assert (found["computed"], found["measures"]["no_load.peak_to_peak"]["limit"]) == (0, 1.0)
    config.write_text(small())
    with held(out):
        assert command(str(config), "--out", str(out)) == 2
    assert "another run is writing there" in capsys.readouterr().err
    (out / NAME / "zarr.json").write_text("{}")
    assert command(str(config), "--out", str(out)) == 2
    assert "not a study of gearjax" in capsys.readouterr().err


@pytest.mark.slow
def test_measured_values_come_from_a_file(tmp_path, capsys):
    (tmp_path / "measured.csv").write_text("unit,e\n1,5.0\n2,7.5\n3,6.0\n", encoding="utf-8")
    spread = '{ kind = "empirical", file = "measured.csv", column = "e", unit = "um" }'
    text = small().replace('{ kind = "rayleigh", scale = "6 um" }', spread, 1)
    config = tmp_path / "measured.toml"
    config.write_text(text)
    for written in ('"errors.planet_1".amplitude', "errors.planet_1.amplitude", "errors.planet_1.'amplitude'"):
        other = text.replace('"errors.planet_1.amplitude"', written)
        again = loads_tolerance(tomli_w.dumps(loads_tolerance(other, tmp_path)[0]))[2]
        values = again.tolerances.distributions["errors.planet_1.amplitude"].values
        assert values == pytest.approx((5e-6, 6e-6, 7.5e-6))
    tables, _, section = loads_tolerance(text, tmp_path)
    assert section.tolerances.distributions["errors.planet_1.amplitude"].values == pytest.approx((5e-6, 6e-6, 7.5e-6))
    assert tables["tolerance"]["errors.planet_1.amplitude"]["values"][0].endswith(" m")
    assert gj.load(config).run.samples == 201
    assert command(str(config), "--json") == 0
    capsys.readouterr()
    for old, new, words in (
        ('column = "e"', 'column = "f"', "none of the 2 columns"),
        ('unit = "um"', 'unit = "kg"', "is a mass; needs a length"),
        ("measured.csv", "missing.csv", "cannot be read"),
    ):
        config.write_text(text.replace(old, new))
        assert command(str(config), "--json") == 2
        assert words in capsys.readouterr().err
    (tmp_path / "measured.csv").write_text("unit,e\n1,5.0\n2,oops\n", encoding="utf-8")
    config.write_text(text)
    assert command(str(config), "--json") == 2
    assert "line 3" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('scale = "6 um"', 'scale = "6 kg"', "tolerance.errors.planet_1.amplitude.scale"),
        ('scale = "6 um"', 'sigma = "6 um"', "unknown key"),
        ('kind = "rayleigh"', 'kind = "releigh"', 'did you mean "rayleigh"'),
        ('"errors.planet_1.amplitude" =', '"errors.planet_7.amplitude" =', "did you mean"),
        ('"backlash.initial" = {', '"backlash.initial" = { kind = "uniform_phase" } #', "period of one turn"),
        ("no_load.peak_to_peak", "no_load.peaktopeak", "did you mean"),
        ("no_load.peak_to_peak", "no_load.peak", 'tolerance.measures[0].name = "no_load.peak"'),
        ('limit = "2 arcmin"', 'limit = "2 um"', "is a length; needs an angle"),
        (', torque = "100 N*m"', "", "needs a torque"),
        ('sampler = "sobol"', 'sampler = "sobel"', "did you mean"),
        ("samples = 200", "samples = 0", "whole number"),
        ("seed = 0", "seed = -1", "whole number"),
        ('kind = "rayleigh"', 'kind = ["rayleigh"]', "tolerance.errors.planet_1.amplitude.kind"),
        ("[run]", "[tolerance.asembly]\n[run]", 'did you mean "assembly"'),
        ("[run]", "[tolerance.assembly]\nunits = 1\n[run]", "tolerance.assembly.units"),
        ('limit = "2 arcmin"', 'limit = "2 arcmin", at_least = "3 arcmin"', "above at_least"),
        ('"static.peak_to_peak", torque', '"static.peak_to_peak@3Nm", torque', "gives a torque already"),
        ("# correlated = [{ between", 'correlated = [{ between = ["a", "b"], coefficient = 0.5 }] #', "correlated[0]"),
        ('low = "0.135 mm"', 'low = "0.2 mm"', "must be above low"),
        ('limit = "2 arcmin"', 'limit = "-2 arcmin"', "peak_to_peak is never negative"),
        ('"static.peak_to_peak", torque', '"dynamic.peak_to_peak", torque', "needs [load] and [inertia]"),
    ],
)
def test_mistakes_are_named_in_one_line(config, capsys, old, new, words):
    text = config.read_text()
    assert old in text
    text = text.replace(old, new, 1)
    if "dynamic" in new:  # the only section that says that the gears move
        text = re.sub(r"\[(inertia|load)\]\n(\w+ = .*\n)+", "", text).replace(', "dynamic"]', "]")
    config.write_text(text)
    assert command(str(config), "--json") == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("gearjax: error: ")
    assert shown.err.count("\n") == 1
    assert words in shown.err


def test_options_that_contradict_each_other(config, capsys):
    assert command(str(config), "--workers", "2", "--scheduler", "tcp://127.0.0.1:1") == 2
    assert "--workers" in capsys.readouterr().err
    assert command(str(config), "--workers", "0") == 2
    assert "at least 1" in capsys.readouterr().err
    assert command(str(ROOT / "configs" / "two_kv" / "wang_2020.toml")) == 2
    assert "no [tolerance]" in capsys.readouterr().err


@pytest.mark.slow
def test_two_devices_find_what_one_finds(tmp_path):
    config = tmp_path / "study.toml"
    config.write_text(small(samples=500), encoding="utf-8")
    code = (
        "import sys, json, jax; jax.config.update('jax_enable_x64', True);"
        "jax.config.update('jax_num_cpu_devices', 2);"
        "from gearjax.config import loads_tolerance; from gearjax.results.tolerance import prepared;"
        "work = prepared(loads_tolerance(open(sys.argv[1]).read())[2]);"
        "found = [v for _, v in work.each(work.chunks)];"
        "print(json.dumps([len(work.devices), [part[0].tolist() for part in found]]))"
    )
    line, options = [sys.executable, "-c", code, str(config)], os.environ | {"XLA_FLAGS": ""} | compiled_as_tests()
    devices, parts = json.loads(subprocess.run(line, capture_output=True, text=True, check=True, env=options).stdout)
    assert devices == 2
    work = prepared(loads_tolerance(config.read_text())[2])
    assert len(work.devices) == 1
    one = np.concatenate([found[0] for _, found in work.each(work.chunks)])
    assert one.shape == (500, 3)
    np.testing.assert_allclose(np.concatenate(parts), one, rtol=1e-10)


@pytest.mark.slow
def test_a_cluster_survives_the_death_of_a_worker(tmp_path, capsys, monkeypatch):
    distributed = pytest.importorskip("distributed")
    config = tmp_path / "study.toml"
    config.write_text(small(samples=LONG, chunk=128, extremes="samples"), encoding="utf-8")
    for name, value in shared_programs().items():  # which the run and the workers inherit
        monkeypatch.setenv(name, value)
    line = [sys.executable, "-m", "gearjax", "tolerance", str(config), "--json"]
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="") as cluster:
        out = tmp_path / "out"
        run = subprocess.Popen(
            [*line, "--out", str(out), "--scheduler", cluster.scheduler_address], stdout=subprocess.PIPE, text=True
        )
        flags = out / NAME / "done" / "c"
        deadline = time.monotonic() + 120
        while (len(list(flags.iterdir())) if flags.exists() else 0) < 4:
            assert time.monotonic() < deadline
            assert run.poll() is None
            time.sleep(0.02)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        printed, _ = run.communicate(timeout=300)
    assert run.returncode == 0
    spread = json.loads(printed)
    assert command(str(config), "--json") == 0
    alone = json.loads(capsys.readouterr().out)
    assert (spread["samples"], spread["failed"], spread["computed"]) == (LONG, 0, LONG)
    for name, entry in alone["measures"].items():
        assert spread["measures"][name]["mean"] == pytest.approx(entry["mean"], rel=1e-12)
        assert spread["measures"][name]["quantiles"]["0.95"] == pytest.approx(entry["quantiles"]["0.95"], rel=1e-10)


def test_sensitivities_of_motions_alone_are_refused(tmp_path, capsys):
    text = small().replace("no_load.peak_to_peak", "dynamic.peak_to_peak@100Nm")
    assert text.count("@100Nm") == 1
    kept = [line for line in text.splitlines() if "static." not in line and "backlash.minimum" not in line]
    config = tmp_path / "study.toml"
    config.write_text("\n".join(kept) + "\n[tolerance.sensitivity]\nsamples = 16\n", encoding="utf-8")
    assert command(str(config), "--json") == 2
    shown = capsys.readouterr().err
    assert shown.startswith("gearjax: error: tolerance.sensitivity")
    assert "all measures are" in shown
    assert shown.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["latin_hypercube", "sobol"])
def test_halved_tolerances_begin_with_the_gear_sets_of_the_study(tmp_path, capsys, sampler):
    config = tmp_path / "study.toml"
    text = small().replace('sampler = "sobol"', f'sampler = "{sampler}"')
    config.write_text(text + "\n[tolerance.sensitivity]\nsamples = 16\n", encoding="utf-8")
    assert command(str(config), "--json") == 0
    shown = capsys.readouterr()
    found = json.loads(shown.out)
    assert set(found["halved_tolerance_yield"]) == {name for name, one in found["measures"].items() if "yield" in one}
    for name, rows in found["halved_tolerance_yield"].items():
        assert all(row["before"] == found["measures"][name]["yield"] for row in rows.values())
    assert re.search(r"roughly .* s, and .* s for sensitivities, without compiling", shown.err)


@pytest.mark.slow
def test_the_tradeoff_tells_what_float32_costs(config, capsys, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        main(["tradeoff", str(config), "--json", "--out", str(out)])
    assert not ended.value.code
    rows = json.loads(capsys.readouterr().out)["float32_quantiles"]
    assert len(rows) == 9
    for row in rows:
        assert row["relative_shift"] < 1e-3
        assert row["float32_arcmin"] == pytest.approx(row["float64_arcmin"], rel=1e-3)
    assert len((out / "float32_quantiles.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(rows)
