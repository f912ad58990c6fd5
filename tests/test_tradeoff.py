"""The trade-off report: what it measures, what it recommends, and what it refuses."""

import dataclasses
import itertools
import json

import diffrax
import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.config import loads
from gearjax.plot.tradeoff import tradeoff_figure
from gearjax.run import METRICS, Run
from gearjax.studies.accurate_step import accurate_step
from gearjax.studies.motion_choices import RUNGE_KUTTA_WORK, STEPS, reference, resolving, settings
from gearjax.studies.static_choices import choices_of, static_choices
from gearjax.studies.tradeoff import Expected, Measured, Tradeoff, _seconds, apart, first_run, tradeoff
from gearjax.units import arcmin
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, TEETH, scene_of
from tests.test_cli import command
from tests.test_matrix import GEAR_SETS, MOVES, RUN

GROUPS = ("solver", "contact", "samples", "harmonics", "fidelity", "precision")


@pytest.fixture
def short(config_text, tmp_path):
    """The reducer over 0.2 s under one torque, from a file."""
    text = config_text.replace('duration = "3 s"', 'duration = "0.2 s"').replace("samples = 3001", "samples = 201")
    text = text.replace('["30 N*m", "100 N*m", "300 N*m"]', '["100 N*m"]').split("[[published]]")[0]
    path = tmp_path / "short.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_tradeoff(short, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gearjax.studies.motion_choices.STEPS", STEPS[::2])
    code, out, _ = command(capsys, "tradeoff", short, "--error", "0.01", "--out", tmp_path / "out", "--json")
    assert code == 0
    found = json.loads(out)
    rows = {f"{row['group']}: {row['name']}": row for row in found["settings"]}
    assert {row["group"] for row in found["settings"]} == set(GROUPS)
    errors = [rows[f"solver: fitted, {size} rad"]["error_arcmin"] for size in ("0.8", "0.2", "0.05")]
    assert errors[2] < errors[1] < errors[0]
    # its extremes are those of samples, as the reference's are then: 0.3 arcmin are between the samples
    assert rows["solver: Dopri8, 1e-07"]["error_arcmin"] < 1e-4
    assert rows["contact: softplus, 1 um"]["error_arcmin"] > rows["contact: softplus, 0.01 um"]["error_arcmin"]
    assert rows["fidelity: quasi-static"]["gradient_seconds"] > 0
    fitted = [row for name, row in rows.items() if name.startswith("solver: fitted")]
    assert sum(row["gradient_measured"] for row in fitted) == 1  # the others by its multiple of a run
    assert np.ptp([row["gradient_seconds"] / row["seconds"] for row in fitted]) < 1e-9
    best = rows[found["recommended"]]
    good = [row for row in found["settings"] if row["error_arcmin"] <= 0.01]
    assert best["seconds"] == min(row["seconds"] for row in good)
    for name in ("tradeoff.csv", "tradeoff.png"):
        assert (tmp_path / "out" / name).stat().st_size > 500


@pytest.mark.slow
@pytest.mark.parametrize("gear_set", [name for name in MOVES if name != "two_kv"])
def test_every_gear_set_has_a_report(gear_set, tmp_path, capsys, monkeypatch):
    """One setting of each group; gradients are those of the 2K-V above.

    Motions and gradients of every gear set are held against others in tests/test_gear_sets_in_motion.py.
    """
    every = settings

    def one_of_each(*given):
        found = {}
        for setting in every(*given):
            found.setdefault(setting.group, setting)
        return list(found.values())

    monkeypatch.setattr("gearjax.studies.tradeoff.settings", one_of_each)
    monkeypatch.setattr("gearjax.studies.tradeoff.LONGEST_GRADIENT", 0.0)
    path = tmp_path / "mine.toml"
    tables = GEAR_SETS[gear_set].tables | {"run": RUN | {"duration": "0.02 s", "samples": 21}}
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    code, out, err = command(capsys, "tradeoff", path, "--json")
    assert code == 0, err
    assert json.loads(out)


def test_long_runs_are_timed_once_and_short_ones_several_times(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("gearjax.studies.tradeoff.time.perf_counter", lambda: now[0])

    def taking(seconds):
        runs = []

        def run():
            runs.append(None)
            now[0] += seconds

        return _seconds(run), len(runs)

    assert taking(0.1) == (pytest.approx(0.1), 3)
    assert taking(1.5) == (pytest.approx(1.5), 2)
    assert taking(50.0) == (pytest.approx(50.0), 1)


def test_the_time_foretold_is_that_of_runs_and_compiling(scene):
    run = Run(duration=0.2, samples=101, analyses=("dynamic",), torques=(100.0, 300.0))
    moving = dataclasses.replace(scene, run=run)
    resolved = resolving(moving, run)
    given = [reference(moving, run, resolved), *settings(moving, run, resolved)]
    assert given[0].work == pytest.approx(RUNGE_KUTTA_WORK * resolved.usual.step / given[0].stepper.step)
    works = {setting.name: setting.work for setting in given}
    assert works["fitted, 0.4 rad"] == pytest.approx(1.0)
    assert works["fitted, 0.1 rad"] == pytest.approx(4.0)
    quick, slow, parallel = (
        Expected(10.0, seconds, 2, workers) for seconds, workers in ((1e-4, 1), (20.0, 1), (20.0, 2))
    )
    schemes = {setting.of_gradient for setting in given if setting.group in ("solver", "fidelity")}
    assert quick.whole(given) == pytest.approx(10.0 * (len(given) + 5 * len(schemes)), rel=0.01)
    assert slow.first(given[0]) == pytest.approx(10.0 + 2 * 20.0 * given[0].work)
    assert parallel.first(given[0]) == pytest.approx(slow.first(given[0]) / 2)
    # each run takes longer than what is repeated, and its gradient is left out
    whole = 10.0 * len(given) + 60.0 * sum(setting.work for setting in given) - 20.0 * given[0].work
    assert slow.whole(given) == pytest.approx(whole)


@pytest.mark.slow
def test_a_setting_that_fails_ends_the_comparison_at_once(scene, monkeypatch):
    begun = []

    def failing(setting):
        begun.append(setting.name)
        if setting.group == "reference":
            raise gj.SceneError("no reference")
        return first_run(setting)

    monkeypatch.setattr("gearjax.studies.tradeoff.first_run", failing)
    run = Run(duration=0.02, samples=21, analyses=("dynamic",), torques=(100.0,))
    with pytest.raises(gj.SceneError, match=r"^no reference$"):
        tradeoff(dataclasses.replace(scene, run=run), 1e-3 * arcmin)
    assert begun[:2] == ["usual", "Runge-Kutta"]
    assert len(begun) <= 3


def test_slices_do_not_move_with_a_stiffness_per_pair(tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(GEAR_SETS["helical_pair"].tables | {"run": RUN}), encoding="utf-8")
    code, out, err = command(capsys, "tradeoff", path)
    assert (code, out) == (2, "")
    assert "one_contact(scene, torque)" in err


def bearings(scene: gj.Scene, stiffness: float, **run) -> gj.Scene:
    """The reducer with planet wheels on bearings, and another run section."""
    names = ("planet_1", "planet_2")
    return dataclasses.replace(
        scene,
        supports={name: gj.Support(x=stiffness, y=stiffness) for name in names},
        body_inertia={name: gj.BodyInertia(0.8) for name in names},
        run=Run(analyses=("static", "dynamic"), torques=(100.0,), samples=101, **run),
    )


@pytest.mark.slow
def test_bodies_on_supports(scene, monkeypatch):
    """Steps of constant modes against Runge-Kutta: the listed errors are those of another reference, too."""
    monkeypatch.setattr("gearjax.studies.tradeoff.LONGEST_GRADIENT", 0.0)
    every = settings
    monkeypatch.setattr(
        "gearjax.studies.tradeoff.settings", lambda *given: [one for one in every(*given) if "modes, 0" in one.name][:3]
    )
    times = np.linspace(0.0, 0.02, 101)
    moving = bearings(scene, 2e8, duration=0.02)
    found = tradeoff(moving, 1e-3 * arcmin)
    assert [row.name for row in found.rows] == [f"constant modes, {size} rad" for size in (0.8, 0.4, 0.2)]
    true = gj.simulate(moving, times, 100.0, stepper=gj.AdaptiveStep(1e-10, 1e-10, diffrax.Dopri8()))
    assert found.truth[100.0]["std"] == pytest.approx(float(true.std), abs=1e-7 * arcmin)
    assert found.rows[2].error < found.rows[0].error < 1e-2 * arcmin
    own = float(
        gj.simulate(moving, times, 100.0, stepper=gj.FixedStep(0.8 * resolving(moving, moving.run).longest)).std
    )
    assert own - float(true.std) == pytest.approx(found.rows[0].metrics[100.0]["std"] - float(true.std), rel=1e-6)
    assert {(row.part, row.name) for row in found.statics} == {
        ("supports", "rigid bearings"),
        ("supports", "elastic bearings"),
    }
    stiff = bearings(scene, 1e14, duration=1.0)
    with pytest.raises(gj.SceneError, match=r"the reference needs .* Runge-Kutta steps .* leave out stiff supports"):
        tradeoff(stiff, 1e-3 * arcmin)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::gearjax.FewAngles")
def test_models_of_parts_without_motion(tmp_path, capsys):
    """Slices and coupled teeth: errors fall towards the most exact model of each part."""
    text = (ROOT / "configs/involute_rv/yang_2019.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("samples = 4801", "samples = 41").replace("pairs = 11", "pairs = 9"), encoding="utf-8")
    code, out, err = command(capsys, "tradeoff", path, "--out", tmp_path / "out", "--json")
    assert code == 0, err
    found = json.loads(out)
    assert (found["settings"], found["recommended"]) == ([], None)
    points = [row["name"] for row in found["static_choices"] if row["part"] == "system"]
    assert points == ["profile_points = 3", "profile_points = 5", "profile_points = 9"]
    errors = {row["name"]: row["error_arcmin"] for row in found["static_choices"]}
    assert errors["neighbours = 0"] > errors["neighbours = 1"] > errors["neighbours = 2"] > 0.0
    assert errors["neighbours = 3"] == errors["profile_points = 9"] == 0.0
    scene = loads(path.read_text(encoding="utf-8"))
    theta = scene.system.input_speed * np.asarray(scene.run.times)
    teeth = [dataclasses.replace(scene.compliance, neighbours=n) for n in (0, 3)]
    metrics = [
        gj.transmission_error(dataclasses.replace(scene, compliance=own), theta, scene.run.torques[0]) for own in teeth
    ]
    largest = max(
        abs(float(getattr(metrics[0], name) - getattr(metrics[1], name)))
        for name in ("mean", "std", "amplitude", "peak_to_peak")
    )
    assert errors["neighbours = 0"] == pytest.approx(largest / arcmin, rel=1e-9)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "static_choices.csv",
        "static_choices.png",
        "written.json",
    ]


@pytest.mark.slow
def test_slices_are_choices_of_a_helical_pair():
    apart, coupled = (
        scene_of(GUO_1, {}, dataclasses.replace(TEETH, coupling_length=length), slices=8) for length in (None, 1.5)
    )
    run = Run(duration=0.001, samples=21, analyses=("static",), torques=(830.0,))
    rows = static_choices(dataclasses.replace(apart, run=run))
    assert [row.name for row in rows] == ["slices = 2", "slices = 4", "slices = 8", "slices = 16"]
    assert rows[0].error > rows[1].error > rows[2].error > rows[3].error == 0.0
    names = [row.name for row in static_choices(dataclasses.replace(coupled, run=run)) if row.part == "compliance"]
    assert names == ["slices apart", "coupled slices"]


@pytest.mark.slow
def test_accuracy(short):
    """A stricter accuracy takes shorter steps; one that no step reaches is refused."""
    scene = loads(short.read_text(encoding="utf-8"))
    coarse, fine = (accurate_step(scene, error * arcmin) for error in (1e-2, 1e-5))
    assert fine.step < coarse.step


@pytest.mark.slow
@pytest.mark.parametrize("error", [1e-2, 1e-3, 1e-4])
def test_what_accuracy_promises_holds_against_an_independent_reference(short, error):
    """Dormand and Prince of eighth order at 1e-11, another scheme than those that steps are chosen by."""
    scene = loads(short.read_text(encoding="utf-8"))
    run = scene.run
    found = gj.simulate(scene, run.times, 100.0, stepper=accurate_step(scene, error * arcmin))
    true = gj.simulate(scene, run.times, 100.0, stepper=gj.AdaptiveStep(1e-11, 1e-11, diffrax.Dopri8()))
    for metric in ("mean", "std", "peak_to_peak", "amplitude"):
        assert abs(float(getattr(found, metric) - getattr(true, metric))) <= error * arcmin


@pytest.mark.slow
def test_choices_of_geometry_are_told_with_their_cost(rv_text):
    text = rv_text.replace("samples = 801", "samples = 41").replace(', "dynamic"', "")
    rows = static_choices(loads(text))
    assert [row.name for row in rows] == ['clearance = "linear"', 'clearance = "exact"']
    assert 1e-4 < rows[0].error / arcmin < 0.05
    assert 0.02 < rows[0].force_error < 0.3
    assert rows[1].error == rows[1].force_error == 0.0


@pytest.mark.parametrize("path", ["elliptic/dong_2020.toml", "rv_cycloidal/hu_2020.toml"])
def test_a_choice_that_another_part_refuses_is_left_out(path):
    """An exact clearance does not go together with supports."""
    scene = gj.load(ROOT / "configs" / path)
    assert list(choices_of(scene)) == ["system"]
    body = next(iter(scene.system.coordinates))
    chosen = choices_of(dataclasses.replace(scene, supports={body: gj.Support(x=2e8)}))
    assert {part: list(named) for part, named in chosen.items()} == {"supports": ["rigid bearings", "elastic bearings"]}


def test_a_metric_that_is_not_a_number_is_no_accuracy():
    good = {torque: dict.fromkeys(METRICS, 0.0) for torque in (1.0, 2.0)}
    bad = good | {2.0: dict.fromkeys(METRICS, float("nan"))}
    assert apart(good, good) == 0.0
    assert np.isnan(apart(bad, good))


@pytest.mark.slow
def test_names_in_the_figure_do_not_overlap(rng):
    """Those of settings that no other one beats in both time and error; the others have a marker only."""
    times, errors = np.geomspace(1e-4, 0.1, 14), np.geomspace(1e-3, 1e-7, 14)
    beaten = [(2 * time, 3 * error) for time, error in zip(times, errors, strict=True)]
    measured = [
        Measured(GROUPS[place % len(GROUPS)], f"setting {place}", error, {}, time, time, True, 1.0)
        for place, (time, error) in enumerate([*zip(times, errors, strict=True), *beaten])
    ]
    rng.shuffle(measured)
    figure = tradeoff_figure(Tradeoff({}, 1.0, measured, 1e-5))
    figure.draw_without_rendering()
    for ax in figure.axes:
        assert sorted(text.get_text() for text in ax.texts) == sorted(f"setting {place}" for place in range(14))
        boxes = [text.get_window_extent() for text in ax.texts]
        assert not [one for one, other in itertools.combinations(boxes, 2) if one.overlaps(other)]
        inside = ax.get_window_extent()
        assert all(inside.x0 < box.x0 and box.x1 < inside.x1 and box.y1 < inside.y1 for box in boxes)


@pytest.mark.parametrize("option", [["--error", "0"], ["--error", "nan"]])
def test_wrong_errors(short, capsys, option):
    code, _, err = command(capsys, "tradeoff", short, *option)
    assert code == 2
    assert "--error" in err


def test_nothing_dynamic(scene):
    with pytest.raises(ValueError, match=r'must list "dynamic"'):
        tradeoff(scene, 1e-6)
