"""``gearjax compare`` and ``gearjax identify`` from files, their output and figures; reassembly and handing on."""

import dataclasses
import json
import re
import runpy
import sys
import tomllib
import types

import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.cli import main
from gearjax.results.joint_files import TE_FILE
from gearjax.units import arcmin, deg, um
from tests.bench_units import RATIO, TwoKVUnit, random_unit, recorded, runs, two_kv
from tests.conftest import CONFIG, ROOT

ROWS = 1500


def file_of(record, folder) -> str:
    """A CSV file of a recording."""
    path = folder / f"{record.name.replace(' ', '_')}.csv"
    table = np.stack([record.time, record.theta / deg, record.output / deg, record.loads], axis=1)
    header = "time [s],input angle [deg],output angle [deg],torque [N m]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9f")
    return str(path)


def told_by(capsys, *arguments: str, code: int = 0):
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    told = capsys.readouterr()
    assert ended.value.code == code, told.err
    return told


@pytest.fixture
def files(tmp_path):
    return [file_of(record, tmp_path) for record in runs(random_unit(3), 3, rows=ROWS)]


@pytest.fixture(scope="module")
def found():
    return gj.identify(two_kv(), runs(random_unit(3), 3, rows=ROWS), suggest=False)


def options(files) -> list[str]:
    return [part for file in files for part in ("--measured", file)]


@pytest.mark.slow
def test_identify_writes_what_it_found(files, tmp_path, capsys):
    out = tmp_path / "out"
    told = told_by(capsys, "identify", str(CONFIG), *options(files), "--out", str(out))
    assert "errors.output_wheel.cos" in told.out
    assert "hidden: the recordings do not change with" in told.out
    assert "a further recording would show 2 of 2 hidden directions" in told.out
    assert "[reference] is left out" in told.err
    names = {path.name for path in out.iterdir()}
    figures = {"comparison.png", "orders.png", "estimates.png", "residual.png"}
    assert names == {"identification.json", "identified.toml", "residual.csv", "joint", "written.json"} | figures
    written = json.loads((out / "identification.json").read_text(encoding="utf-8"))
    tables = tomllib.loads((out / "identified.toml").read_text(encoding="utf-8"))
    assert "reference" not in tables
    scene = gj.load(out / "identified.toml")
    for path, vector in written["eccentricities"].items():
        error = scene.errors[path.partition(".")[2]]
        assert float(error.amplitude) / um == pytest.approx(vector["amplitude_um"], rel=1e-6)
    # the file found explains the recordings
    told = told_by(capsys, "compare", str(out / "identified.toml"), *options(files), "--json")
    beside = json.loads(told.out)
    assert all(record["explained"] > 0.95 for record in beside["records"])


@pytest.mark.slow
def test_a_section_says_what_is_looked_for_and_turned(files, tmp_path, capsys):
    tables = tomllib.loads(CONFIG.read_text(encoding="utf-8"))
    tables.pop("reference")
    tables["identify"] = {
        "measured": [file.rpartition("/")[2] for file in files],
        "where": ["errors.planet_1", "errors.planet_2", "errors.output_wheel", "compliance.mean", "backlash.initial"],
        "priors": {"errors.planet_1": "8 um", "compliance.mean": ["9e7 N/m", "2e7 N/m"]},
        "offset_spread": "0.01 arcmin",
        "orders": [],
        "starts": 8,
        "reassemble": {"where": ["errors.planet_1"], "places": {"errors.planet_1": 50}, "torque": "10 N*m"},
    }
    config = tmp_path / "mine.toml"
    config.write_text(tomli_w.dumps(tables), encoding="utf-8")
    told = json.loads(told_by(capsys, "identify", str(config), "--json").out)
    names = [each["name"] for each in told["estimates"]]
    assert "errors.revolution.cos" not in names
    turn = told["reassembly"]["turn_deg"]["errors.planet_1"]
    assert turn / 7.2 == pytest.approx(round(turn / 7.2), abs=1e-9)
    assert told["reassembly"]["after_arcmin"] <= told["reassembly"]["before_arcmin"]


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"were": []}, 'did you mean "where"'),
        ({"where": "errors.planet_1"}, "must be a list of names"),
        ({"where": ["errors.planet_9"]}, 'did you mean "errors.planet_'),
        ({"priors": {"errors.planet_9": "1 um"}}, 'did you mean "errors.planet_'),
        ({"priors": {"errors.planet_1": "1 deg"}}, "is an angle"),
        ({"priors": {"errors.planet_1": "0 um"}}, "standard deviation above 0"),
        ({"offset_spread": "1 um"}, "is a length"),
        ({"orders": "some"}, 'must be "find"'),
        ({"starts": 0}, "must be"),
        ({"reassemble": {"where": ["errors.ring"]}}, "is not an identified eccentricity"),
        ({"reassemble": {"metric": "mean"}}, "valid: std, peak_to_peak"),
        ({"measured": ["no_such.csv"]}, "cannot be read"),
    ],
)
def test_faults_of_the_section_end_in_one_line(section, words, tmp_path, capsys):
    tables = tomllib.loads(CONFIG.read_text(encoding="utf-8")) | {"identify": section}
    config = tmp_path / "mine.toml"
    config.write_text(tomli_w.dumps(tables), encoding="utf-8")
    record = recorded(random_unit(3), 40.0, 1, rows=300)
    given = [] if "measured" in section else ["--measured", file_of(record, tmp_path)]
    told = told_by(capsys, "identify", str(config), *given, "--json", code=2)
    last = told.err.strip().splitlines()[-1]
    assert last.startswith("gearjax: error: ")
    assert words in last


def test_without_a_recording_it_says_what_to_give(capsys):
    assert "give --measured FILE.csv" in told_by(capsys, "compare", str(CONFIG), code=2).err


# compare --------------------------------------------------------------------------------------------------------


def test_orders_stand_side_by_side_with_their_phases():
    """Of a known wave: amplitude and phase of both, and what the difference leaves."""
    scene = two_kv()
    record = gj.synthetic_measurement(scene, 100.0, rows=4000, noise=0.0, waves={13 / RATIO: (0.1 * arcmin, 0.6)})
    beside = gj.compare(scene, record).records[0]
    wave = next(each for each in beside.orders if each.name == "13 per turn of the output")
    assert wave.measured == pytest.approx(0.1 * arcmin, rel=1e-2)
    assert wave.phase_measured == pytest.approx(0.6, abs=0.02)
    assert wave.computed < 0.002 * arcmin
    others = [each for each in beside.orders if each is not wave]
    assert all(each.measured == pytest.approx(each.computed, abs=1e-3 * arcmin) for each in others)
    assert beside.explained == pytest.approx(1 - 0.5 * (0.1 * arcmin) ** 2 / np.var(beside.measured), abs=1e-3)


@pytest.mark.parametrize("start", [0.3, -1.7, 9.0])
def test_small_start_angles_are_told_from_a_turn_of_a_body(start):
    scene = two_kv()
    record = gj.synthetic_measurement(scene, 100.0, rows=2000, noise=0.02 * arcmin)
    moved = dataclasses.replace(record, theta=record.theta - start, output=record.output - start / RATIO)
    assert gj.compare(scene, moved, shift="find").records[0].start == pytest.approx(start, abs=0.03)


@pytest.mark.slow
def test_start_angles_of_uneven_outputs_are_refused():
    elliptic = gj.load(ROOT / "configs" / "elliptic" / "dong_2020.toml")
    record = gj.synthetic_measurement(elliptic, rows=400)
    with pytest.raises(gj.SceneError, match="needs an output that turns evenly"):
        gj.compare(elliptic, record, shift="find")


@pytest.mark.slow
def test_a_start_angle_is_found():
    scene = two_kv()
    record = gj.synthetic_measurement(scene, 100.0, rows=3000, noise=0.02 * arcmin, offset=2 * arcmin)
    moved = dataclasses.replace(record, theta=record.theta - 40.0, output=record.output - 40.0 / RATIO)
    beside = gj.compare(scene, moved, shift="find").records[0]
    assert beside.start == pytest.approx(40.0, abs=0.05)
    assert beside.offset == pytest.approx(2 * arcmin, abs=0.02 * arcmin)
    assert beside.explained > 0.99
    assert gj.compare(scene, moved).records[0].explained < 0.8


# a synthetic bench ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_synthetic_bench_has_encoders_ripple_and_directions():
    scene = two_kv()
    plain = gj.synthetic_measurement(scene, 40.0, rows=2000, noise=0.0)
    unit = TwoKVUnit(10j * um, -20 * um, 10 * um * np.exp(-0.75j * np.pi), 10j * um, 9.245e7)
    np.testing.assert_allclose(plain.error(scene), unit.te(plain.theta, 40.0), atol=1e-12)
    steps = gj.synthetic_measurement(scene, 40.0, rows=2000, noise=0.0, input_counts=2**16, output_counts=2**20)
    assert np.abs(np.diff(steps.output) * 2**20 / (2 * np.pi) % 1.0 - 0.5).min() > 0.49
    assert steps.resolution == pytest.approx(2 * np.pi / 2**20)
    uneven = gj.synthetic_measurement(scene, 40.0, rows=2000, noise=0.0, ripple=0.2)
    assert np.diff(uneven.theta).max() > 1.3 * np.diff(uneven.theta).min()
    np.testing.assert_allclose(uneven.error(scene), unit.te(uneven.theta, 40.0), atol=1e-12)
    back = gj.synthetic_measurement(scene, rows=2000, noise=0.0, backward=True)
    assert back.turns_back
    np.testing.assert_allclose(back.error(scene), np.minimum(*unit.edges(back.theta, -1)), atol=1e-12)
    turned = gj.synthetic_measurement(scene, 40.0, rows=2000, noise=0.0, turned={"errors.planet_1": 0.5})
    other = dataclasses.replace(unit, planet_1=unit.planet_1 * np.exp(0.5j))
    np.testing.assert_allclose(turned.error(scene), other.te(turned.theta, 40.0), atol=1e-12)
    noisy = gj.synthetic_measurement(scene, 40.0, rows=2000, noise=0.1 * arcmin)
    assert (noisy.output - plain.output).std() == pytest.approx(0.1 * arcmin, rel=0.1)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"ripple": 1.0}, "would turn back"),
        ({"output_counts": 0}, "at least 1"),
        ({"waves": {1.0: 3.0}}, "pair of amplitude and phase"),
        ({"waves": [1.0]}, "must be pairs"),
        ({"turned": {"errors.x": 1.0}}, 'turned = "errors.x": is no eccentricity of this scene; .*errors.planet_1'),
        ({"torque": np.nan}, "must be finite"),
        ({"rows": 2}, "at least 3"),
    ],
)
def test_benches_that_cannot_be(given, words):
    with pytest.raises(gj.GearjaxError, match=words):
        gj.synthetic_measurement(two_kv(), **given)


# reassembly -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_turning_a_body_is_its_phase(found):
    """What reassembly promises for one draw is what the scene with that phase has."""
    from gearjax.identification.reassembly import _Turning

    turning = _Turning(found, ["errors.output_wheel"], {}, "std", 40.0)
    values = found.fit.values[: len(found.unknowns.each)]
    angle = 0.8
    told = turning.values(values[None], np.array([[0.0], [angle]]))[:, 0]
    scene = found.scene
    theta = np.linspace(0.0, scene.system.cycle, turning._rows, endpoint=False)
    for turn, metric in zip((0.0, angle), told, strict=True):
        error = scene.errors["output_wheel"]
        moved = dataclasses.replace(error, phase=error.phase + turn)
        own = dataclasses.replace(scene, errors={**scene.errors, "output_wheel": moved})
        te = gj.transmission_error(own, jnp.asarray(theta), 40.0, extremes="samples").te
        assert metric == pytest.approx(float(te.std()), rel=1e-9)


@pytest.mark.slow
@pytest.mark.runs_long
def test_reassembly_tells_gain_risk_and_what_another_recording_would_do(found, monkeypatch):
    monkeypatch.setattr("gearjax.identification.reassembly.PLACES", 12)  # on the grid: most of the time
    advice = gj.reassemble(found, ["errors.planet_1", "errors.planet_2"], draws=60)
    assert advice.after <= advice.before * (1 + 1e-9)
    assert advice.gain.low <= advice.gain.median <= advice.gain.high
    assert 0.0 <= advice.gain.worse <= 1.0
    assert advice.second is not None
    assert advice.second.median < advice.gain.median
    assert advice.second.worse <= advice.gain.worse
    assert "after turning planet_1 by 90 deg" in advice.second_words
    places = gj.reassemble(found, "errors.planet_1", steps={"errors.planet_1": 8}, draws=20, metric="peak_to_peak")
    turns = places.turns["errors.planet_1"] / (45 * deg)
    assert turns == pytest.approx(round(turns))
    for given, words in (
        ({"where": ["errors.x"]}, "is not an identified eccentricity"),
        ({"steps": {"errors.planet_1": 0}}, "at least 1"),
        ({"metric": "mean"}, "valid: std, peak_to_peak"),
        ({"where": ["errors.planet_1"], "steps": {"errors.planet_2": 5}}, "is not among the errors in where"),
    ):
        with pytest.raises(gj.GearjaxError, match=words):
            gj.reassemble(found, **given)
    with pytest.raises(gj.ParameterError, match=r"must be a result of gj\.identify"):
        gj.reassemble(found.scene)


# handing on -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def handed(tmp_path_factory):
    scene = gj.load(CONFIG)
    folder = tmp_path_factory.mktemp("joint")
    gj.export_joint(scene, folder, torque=150.0)
    return scene, folder


def module(folder):
    """The function that was written, run as it stands."""
    names: dict = {}
    exec(compile((folder / "te_model.py").read_text(encoding="utf-8"), "te_model.py", "exec"), names)
    return names


@pytest.mark.parametrize("torque", [2.0, 30.0, 120.0, -60.0])
def test_the_function_of_numpy_is_the_static_te(handed, torque):
    scene, folder = handed
    model = module(folder)
    theta = np.linspace(0.3, 400.0, 301)
    te = np.asarray(gj.transmission_error(scene, jnp.asarray(theta), torque, extremes="samples").te)
    allowed = 0.06 * arcmin  # of straight lines between the torques, where pairs begin to share
    assert np.abs(model["te"](theta, torque) - te).max() < allowed
    h = 1e-5
    slope = (model["te"](theta + h, torque) - model["te"](theta - h, torque)) / (2 * h)
    np.testing.assert_allclose(model["slope"](theta, torque), slope, atol=1e-9)
    for angle in theta[::60]:
        position = model["te"](angle, torque)
        assert model["torque_of"](angle, position) == pytest.approx(torque, rel=1e-6)
    several = model["te"](theta[:, None], np.array([torque, 2 * torque]))
    np.testing.assert_allclose(several[:, 0], model["te"](theta, torque), rtol=1e-12, atol=1e-18)
    inside = 0.5 * (model["te"](1.0, 1e-9) + model["te"](1.0, -1e-9))
    assert model["torque_of"](1.0, inside) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "apart"), [("two_kv/measured", 1e-12), ("helical/guo_2018_measured", 0.08)])
def test_a_joint_has_the_damping_of_its_meshes(name, apart):
    """2 zeta sqrt(k J), where each pair has a damper, or dampers of slices follow their stiffness."""
    scene = gj.load(ROOT / "configs" / f"{name}.toml")
    joint = gj.joint_model(scene, float(scene.run.torques[-1]))
    critical = 2 * np.sqrt(joint.stiffness * joint.inertia)
    assert joint.damping == pytest.approx(float(scene.damping.ratio) * critical, rel=apart)


@pytest.mark.slow
def test_shafts_follow_a_joint():
    """Its swing dies away as the slowest mode of the two-stage gearbox does."""
    scene = gj.load(ROOT / "configs" / "helical" / "two_stage.toml")
    joint, modes = gj.joint_model(scene, 300.0), gj.natural_modes(scene, 300.0)
    assert joint.inertia is not None
    frequency = 2 * np.pi * float(modes.frequencies[0])
    assert np.sqrt(joint.stiffness / joint.inertia) == pytest.approx(frequency, rel=0.05)
    assert joint.damping / (2 * joint.inertia) == pytest.approx(float(modes.damping[0]) * frequency, rel=0.1)


@pytest.mark.slow
def test_the_joint_keeps_its_energy(handed):
    """Without damping no work is left once motor and output have gone round a loop, loaded and unloaded on the way."""
    _, folder = handed
    names = module(folder)
    text = (folder / "joint_mujoco.py").read_text(encoding="utf-8")
    joint = {"te_model": types.SimpleNamespace(**names), "mujoco": None}
    exec(compile(re.sub(r"^import .*$", "", text, flags=re.MULTILINE), "joint_mujoco.py", "exec"), joint)
    joint["DAMPING"] = 0.0
    around = np.linspace(0.0, 2 * np.pi, 4001)
    theta = 3.0 + 1.5 * np.sin(around)
    rest = np.array([names["te"](angle, 60.0) for angle in theta])
    output = theta / 79 + rest + 2e-4 * np.cos(around)
    forces = np.array([joint["forces"](a, 0.0, b, 0.0) for a, b in zip(theta, output, strict=True)])
    middle = 0.5 * (forces[1:] + forces[:-1])
    work = middle[:, 0] @ np.diff(theta) + middle[:, 1] @ np.diff(output)
    moved = np.abs(middle[:, 1] * np.diff(output - theta / 79)).sum()
    assert forces[:, 1].max() > 100
    assert forces[:, 1].min() < 5
    assert abs(work) < 2e-3 * moved


@pytest.mark.slow
def test_without_back_flanks_nothing_pulls(tmp_path):
    scene = dataclasses.replace(gj.load(CONFIG), backlash=None)
    gj.export_joint(scene, tmp_path, torque=100.0)
    model = module(tmp_path)
    assert model["torque_of"](1.0, 1e-2) == 0.0
    assert model["torque_of"](1.0, model["te"](1.0, 40.0)) == pytest.approx(40.0)


@pytest.mark.slow
def test_tables_tell_the_same(handed):
    import xarray as xr

    _, folder = handed
    joint = json.loads((folder / "joint.json").read_text(encoding="utf-8"))
    assert joint["ratio"] == 79.0
    scene, _ = handed
    play = gj.backlash(scene, jnp.linspace(0.0, scene.system.cycle, 2001))
    assert joint["backlash_rad"] == pytest.approx(float(play.mean), rel=0.02)
    rows = (folder / "orders.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("torque [N m],order [per turn of the input]")
    assert len(rows) == 1 + len(joint["torque_N_m"]) * (1 + len(joint["orders_per_input_turn"]))
    with xr.open_dataset(folder / "orders.nc", engine="scipy") as table:
        np.testing.assert_allclose(table["cosine"].values, joint["te_cosine_rad"])
        assert table.attrs["ratio"] == 79.0
    assert "{" not in TE_FILE.format(ratio=1, orders=[], torques=[], mean=[], cosine=[], sine=[])


@pytest.mark.slow
def test_a_joint_in_mujoco_moves_as_gearjax_has_it(handed, monkeypatch):
    """A motor of great inertia turns evenly; the output swings as under gearjax's own motion, to 2 % in std."""
    mujoco = pytest.importorskip("mujoco")
    scene, folder = handed
    monkeypatch.syspath_prepend(str(folder))
    for name in ("te_model", "joint_mujoco"):
        sys.modules.pop(name, None)
    import joint_mujoco  # pyright: ignore[reportMissingImports]
    import te_model  # pyright: ignore[reportMissingImports]

    text = (folder / "joint.xml").read_text(encoding="utf-8").replace("1e-4 1e-4 1e-4", "1e4 1e4 1e4")
    model = mujoco.MjModel.from_xml_string(text)
    data, speed, torque = mujoco.MjData(model), float(scene.system.input_speed), 100.0
    joint_mujoco.install(model)
    try:
        data.qvel[0], data.ctrl[1] = speed, -torque
        data.qpos[1] = te_model.te(0.0, torque)
        data.qvel[1] = speed / te_model.RATIO + te_model.slope(0.0, torque) * speed
        swing = []
        for step in range(30_000):
            mujoco.mj_step(model, data)
            if step % 50 == 49:
                swing.append((data.time, data.qpos[1] - data.qpos[0] / te_model.RATIO))
    finally:
        mujoco.set_mjcb_passive(None)
    ts, position = np.array(swing).T
    own = np.asarray(gj.simulate(scene, jnp.concatenate([jnp.zeros(1), jnp.asarray(ts)]), torque).te)[1:]
    later = ts > 0.05
    assert position[later].std() == pytest.approx(own[later].std(), rel=0.02)
    assert position[later].mean() == pytest.approx(own[later].mean(), abs=0.02 * arcmin)


# the page in experiments ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_page_from_measurement_to_reassembly_runs_and_helps(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "experiments" / "notebooks" / "from_measurement_to_reassembly.py"))
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert last.startswith("standard deviation without load: ")
    assert float(last.rpartition(" ")[2]) < 0.8
