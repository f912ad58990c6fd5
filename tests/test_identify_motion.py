"""Which errors explain recordings of a gear set that runs: of a joint written out apart from the package."""

import dataclasses
import json

import jax
import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.config import read_file, read_tables
from gearjax.identification.model import Model, Problem
from gearjax.identification.moving import WIDE, MovingModel, moving_error
from gearjax.identification.rows import rows_of
from gearjax.identification.tables import positions_at
from gearjax.identification.unknowns import unknowns_of
from gearjax.units import arcmin
from tests.bench_units import RATIO, TwoKVUnit, estimates, random_unit, truth, two_kv
from tests.conftest import BODIES, CONFIG
from tests.test_bench_commands import file_of, told_by
from tests.test_matrix import GEAR_SETS

MASS, DAMPING = 2000.0, 0.1  # a robot's arm: 6.9 kg m2, 36 Hz on one pair, errors turn at 16 Hz
SPEED, SLOW = 314.0, 15.0  # rad/s
LOAD = gj.ConstantLoad()


def in_motion(scene: gj.Scene, mass=MASS) -> gj.Scene:
    return dataclasses.replace(
        scene,
        inertia=gj.EquivalentMass(mass),
        damping=gj.DampingRatio(DAMPING),
        load=LOAD,
        compliance=gj.HarmonicStiffness(9e7, np.zeros(0), np.zeros(0)),
    )


def run(unit: TwoKVUnit, torque: float, *, rows=1500, noise=0.05 * arcmin, speed=SPEED, seed=0) -> gj.Measurement:
    """A turn of the output of a unit in motion."""
    theta = np.linspace(0.0, 2 * np.pi * RATIO, rows) * np.sign(speed)
    te = unit.motion(theta, speed, torque, MASS, DAMPING)
    output = theta / RATIO + te + noise * np.random.default_rng(seed).standard_normal(rows)
    return gj.Measurement(theta, output, None, torque, theta / speed, f"{torque:g} N m at {speed:g}")


@pytest.fixture(scope="module")
def scene():
    return in_motion(two_kv())


@pytest.fixture(scope="module")
def unit():
    return random_unit(3)


def of_unit(scene: gj.Scene, unit: TwoKVUnit) -> gj.Scene:
    """The scene with the errors of a unit."""
    vectors = dict(zip(BODIES, (unit.planet_1, unit.planet_2, unit.revolution, unit.output), strict=True))
    errors = {name: gj.Eccentricity(name, abs(v), np.angle(v)) for name, v in vectors.items()}
    compliance = gj.HarmonicStiffness(unit.stiffness, np.zeros(0), np.zeros(0))
    return dataclasses.replace(scene, errors=errors, compliance=compliance, backlash=gj.InitialBacklash(unit.play))


@pytest.mark.slow
@pytest.mark.parametrize(("torque", "speed"), [(100.0, SPEED), (300.0, SPEED), (100.0, -SPEED)])
def test_a_motion_is_that_of_an_equation_of_its_own(scene, unit, torque, speed):
    record = run(unit, torque, noise=0.0, speed=speed)
    te = moving_error(of_unit(scene, unit), record)[0]
    np.testing.assert_allclose(te, record.error(scene), atol=3e-3 * arcmin)
    still = unit.te(record.theta, torque)
    assert np.std(te - still) > 0.08 * np.std(still)  # it shakes: otherwise nothing is tried here


@pytest.fixture(scope="module")
def records(unit):
    """Two fast ones, and slow ones under light torques that load either flank."""
    bench = (15.0, SLOW), (150.0, SPEED), (300.0, SPEED), (-40.0, SLOW)
    return [run(unit, torque, speed=speed, seed=i) for i, (torque, speed) in enumerate(bench)]


@pytest.fixture(scope="module")
def found(records):
    """With inertia and damping unknown too, from a scene that has them wrong."""
    errors = [f"errors.{body}" for body in BODIES]
    where = [*errors, "compliance.mean", "backlash.initial", "inertia.mass", "damping.ratio"]
    off = dataclasses.replace(in_motion(two_kv(), 0.9 * MASS), damping=gj.DampingRatio(0.15))
    return gj.identify(off, records, where, analysis="dynamic", suggest=False, starts=8)


@pytest.mark.slow
@pytest.mark.runs_long
def test_an_arm_that_shakes_is_found_within_its_errors(found, unit, records):
    values, errors = estimates(found)
    assert min((np.abs(values - one) / errors for one in truth(unit)), key=np.max).max() < 3.5
    assert found.sigma / arcmin == pytest.approx(0.05, rel=0.05)
    assert not found.orders
    assert not found.alternatives or len(found.alternatives) == 1  # exchanged planet wheels
    beside = gj.compare(found.scene, records, analysis="dynamic")
    for record in beside.records:  # hard contacts too leave no more than the noise
        assert np.std(record.measured - record.computed) < 0.053 * arcmin
    still = gj.identify(in_motion(two_kv()), records, suggest=False, orders=[], starts=16)
    assert still.sigma > 2 * found.sigma  # at rest the recordings mean something else


@pytest.mark.slow
@pytest.mark.runs_long
def test_inertia_and_damping_are_found_too(found):
    mass, ratio = (found.estimate(path) for path in ("inertia.mass", "damping.ratio"))
    assert abs(mass.value - MASS) < 3.5 * mass.error < 0.05 * MASS
    assert abs(ratio.value - DAMPING) < 3.5 * ratio.error < 0.05


@pytest.mark.slow
def test_recordings_without_torque_and_of_other_lengths_go_beside(scene, unit):
    """Those without torque are at rest; lengths and speeds of the others differ."""
    rest = gj.Measurement(
        np.linspace(0, 2 * np.pi * RATIO, 300), te=unit.te(np.linspace(0, 2 * np.pi * RATIO, 300), 0.0), name="rest"
    )
    records = [run(unit, 150.0, noise=0.0, rows=400), run(unit, 60.0, noise=0.0, rows=300, speed=200.0), rest]
    own = of_unit(scene, unit)
    unknowns = unknowns_of(own, None, back=False, loaded=True)
    still = Model.of(unknowns, records, loaded=True)
    model = MovingModel.of_static(still, unknowns, records, own)
    curve, _ = Problem(model, rows_of(records, own)).curve(np.append(unknowns.start, np.zeros(4)))
    wanted = np.concatenate([record.error(own) for record in records]) / arcmin
    np.testing.assert_allclose(curve, wanted, atol=3e-3)
    beside = gj.compare(own, records, analysis="dynamic")
    assert min(record.explained for record in beside.records) > 1 - 1e-6
    assert any("without torque" in words for words in beside.notes)


@pytest.mark.slow
def test_draws_of_a_motion_are_refused(found):
    with pytest.raises(gj.GearjaxError, match="would take hours"):
        gj.posterior(found)
    assert gj.reassemble(found, ["errors.planet_1"], draws=6).after > 0  # of the errors found, at rest


@pytest.mark.slow
@pytest.mark.parametrize("acting", ["always", "contact"])
def test_derivatives_of_a_motion_are_central_differences(scene, unit, acting):
    """Under jit, with contacts that come and go over a width."""
    record = run(unit, 150.0, rows=60, noise=0.0)
    own = dataclasses.replace(of_unit(scene, unit), damping=gj.DampingRatio(DAMPING, acting))
    unknowns = unknowns_of(own, None, back=False, loaded=True)
    still = Model.of(unknowns, [record], loaded=True)
    model = MovingModel.of_static(still, unknowns, [record], own, WIDE).at(rows_of([record], own))
    points = unknowns.start + 0.1 * np.random.default_rng(1).standard_normal((2, unknowns.start.size))
    _, rate = positions_at(model, points)
    step = 1e-3
    off = []
    for i in range(unknowns.start.size):
        way = step * np.eye(unknowns.start.size)[i]
        ahead, behind = (np.asarray(positions_at(model, points + sign * way)[0]) for sign in (1, -1))
        off.append(np.abs(rate[..., i] - (ahead - behind) / (2 * step)) / np.abs(rate).max())
    assert np.max(off) < 1e-2
    assert np.quantile(off, 1.0 if acting == "always" else 0.95) < 1e-3


@pytest.mark.slow
def test_teeth_that_lose_contact_are_told(scene, unit):
    told = gj.compare(of_unit(scene, unit), run(unit, 20.0, rows=300), analysis="dynamic").notes
    assert any("lose contact in" in words for words in told)


@pytest.mark.slow
def test_speeds_and_torques_that_vary_are_told(scene, unit):
    record = run(unit, 300.0, rows=600)
    wave = record.time + 0.05 * np.sin(3 * record.time) / 3
    uneven = dataclasses.replace(record, time=wave, torque=300.0 + 15 * np.sin(record.theta / 9))
    told = gj.compare(of_unit(scene, unit), uneven, analysis="dynamic").notes
    assert any("input speed varies by 3." in words for words in told)
    assert any("torque varies by 3.5 %" in words for words in told)
    even = gj.compare(of_unit(scene, unit), record, analysis="dynamic").notes
    assert not any("varies" in words or "lose contact" in words for words in even)


STILL = np.concatenate([np.zeros(55), [1.0, 2.0, 3.0, 4.0, 5.0]])
TOLD = ("never die out", "load] is not used", "is the unit of time right")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"record": {"time": None}}, "needs the time of each row"),
        ({"record": {"torque": 0.0}}, "under torque: there is none"),
        ({"record": {"torque": np.repeat([50.0, -50.0], 30)}}, "changes its sign: give one recording for each torque"),
        ({"record": {"torque": np.linspace(50.0, 150.0, 60)}}, "its torque varies by 29 %"),
        ({"record": {"time": np.full(60, 2.0)}}, "time is 2 s in every row"),
        ({"record": {"time": np.linspace(1.0, 0.0, 60)}}, "time goes back after row 0"),
        ({"record": {"theta": STILL, "output": None, "te": np.zeros(60)}}, "stands still in most rows"),
        ({"scene": {"inertia": None}}, r'"dynamic" needs \[inertia\]'),
        ({"analysis": "dinamic"}, "static, dynamic"),
        ({"record": {"time": np.linspace(0.0, 1e5, 60)}}, r"need .* steps of motion, more than 2\.1e\+06"),
        ({"scene": {"damping": None}}, "never die out"),
        ({"scene": {"load": gj.SinusoidalLoad("mesh")}}, "load] is not used"),
        ({"record": {"time": np.linspace(0.0, 1.6e3, 60)}}, "is the unit of time right"),
    ],
)
def test_what_cannot_be_computed_is_refused_and_what_is_doubtful_told(scene, unit, change, words):
    record = dataclasses.replace(run(unit, 100.0, rows=60, noise=0.0), **change.get("record", {}))
    own = dataclasses.replace(of_unit(scene, unit), **change.get("scene", {}))
    if words in TOLD:
        assert any(words in told for told in gj.compare(own, record, analysis="dynamic").notes)
        return
    for function in (gj.compare, gj.identify):
        with pytest.raises((gj.GearjaxError, gj.SceneError, gj.ParameterError), match=words):
            function(own, record, analysis=change.get("analysis", "dynamic"))


@pytest.mark.slow
def test_a_bench_makes_recordings_in_motion(scene, unit):
    own = dataclasses.replace(of_unit(scene, unit), system=dataclasses.replace(scene.system, input_speed=SPEED))
    record = gj.synthetic_measurement(own, 100.0, rows=500, noise=0.0, analysis="dynamic")
    np.testing.assert_allclose(
        record.error(own), unit.motion(record.theta, SPEED, 100.0, MASS, DAMPING), atol=3e-3 * arcmin
    )
    back = gj.synthetic_measurement(own, 100.0, rows=500, noise=0.0, backward=True, analysis="dynamic")
    np.testing.assert_allclose(
        back.error(own), unit.motion(back.theta, -SPEED, 100.0, MASS, DAMPING), atol=3e-3 * arcmin
    )
    with pytest.raises(gj.ParameterError, match="must be one number"):
        gj.synthetic_measurement(own, np.linspace(1.0, 2.0, 50), rows=50, analysis="dynamic")


@pytest.mark.slow
def test_the_commands_take_recordings_in_motion(found, unit, tmp_path, capsys, monkeypatch):
    """The section of a configuration says it, and an option does: what is identified then is tested above."""
    tables = read_tables(read_file(CONFIG))
    tables |= {"inertia": {"mass": f"{MASS} kg"}, "damping": {"ratio": DAMPING}}
    tables["compliance"] |= {"mean": f"{unit.stiffness} N/m", "relative_amplitudes": [], "phases": []}
    vectors = unit.planet_1, unit.planet_2, unit.revolution, unit.output
    for name, vector in zip(BODIES, vectors, strict=True):
        tables["errors"][name] |= {"amplitude": f"{abs(vector)} m", "phase": f"{np.angle(vector)} rad"}
    tables.pop("reference")
    file = file_of(run(unit, 150.0, rows=600), tmp_path)
    sections = {"section": {"identify": {"measured": [file], "analysis": "dynamic", "orders": []}}, "option": {}}
    for name, section in sections.items():
        (tmp_path / f"{name}.toml").write_text(tomli_w.dumps(tables | section))
    by_section = [str(tmp_path / "section.toml"), "--json"]
    by_option = [str(tmp_path / "option.toml"), "--measured", file, "--dynamic", "--json"]
    beside = [json.loads(told_by(capsys, "compare", *asked).out)["records"][0] for asked in (by_section, by_option)]
    assert beside[0] == beside[1]
    at_rest = json.loads(told_by(capsys, "compare", *by_section, "--static").out)["records"][0]
    assert 1 - beside[0]["explained"] < 0.25 * (1 - at_rest["explained"])

    asked = []

    def known(scene, records, *_, **options):
        asked.append(options["analysis"])
        return dataclasses.replace(found, records=tuple(records), scene=scene)

    monkeypatch.setattr("gearjax.results.identification.identify", known)
    for options in (by_section, by_option):
        told = json.loads(told_by(capsys, "identify", *options).out)
        assert told["comparison"]["records"][0]["explained"] == beside[0]["explained"]
    assert asked == ["dynamic", "dynamic"]


MOVING_SETS = [name for name in GEAR_SETS if name not in ("two_kv", "helical_pair")]


@pytest.mark.slow
@pytest.mark.parametrize("name", MOVING_SETS)
def test_other_gear_sets_are_found_in_motion_too(name):
    """Steps of constant modes, levers that turn, an output that is not even."""
    scene = dataclasses.replace(GEAR_SETS[name].scene, run=None)
    record = gj.synthetic_measurement(
        scene, 20.0, rows=64, turns=0.3 * scene.system.orders["output"], analysis="dynamic"
    )
    first = next(path for path, error in scene.errors.items() if isinstance(error, gj.Eccentricity))
    found = gj.identify(scene, record, f"errors.{first}", orders=[], suggest=False, starts=1, analysis="dynamic")
    assert found.sigma / arcmin == pytest.approx(0.05, rel=0.3)
    for part, true in zip(("cos", "sin"), (np.cos, np.sin), strict=True):
        each = found.estimate(f"errors.{first}.{part}")
        if each.error is not None:
            expected = scene.errors[first].amplitude * true(scene.errors[first].phase) / 1e-6
            assert abs(each.value - expected) < 4 * each.error


def test_a_pair_whose_springs_do_not_move_apart_is_refused():
    scene = dataclasses.replace(GEAR_SETS["helical_pair"].scene, run=None)
    with pytest.raises(gj.SceneError, match="one_contact"):
        gj.synthetic_measurement(scene, 20.0, rows=64, analysis="dynamic")


@pytest.mark.slow
def test_ripple_and_float32_are_refused(scene, unit):
    with pytest.raises(gj.ParameterError, match="must be 0"):
        gj.synthetic_measurement(of_unit(scene, unit), 100.0, rows=50, ripple=0.1, analysis="dynamic")
    narrow = jax.tree.map(
        lambda x: jax.numpy.asarray(x, np.float32) if isinstance(x, jax.Array) else x, of_unit(scene, unit)
    )
    with pytest.raises(gj.SceneError, match="need float64"):
        gj.compare(narrow, run(unit, 100.0, rows=60), analysis="dynamic")


@pytest.mark.slow
def test_a_stiffness_that_the_static_fit_cannot_tell():
    """Elliptic gears at one speed: the static fit ends at any stiffness, so motion starts from that of the scene."""
    scene = gj.load(CONFIG.parents[1] / "elliptic" / "dong_2020.toml")
    ts = np.linspace(0.0, 0.6, 1201)
    theta = float(scene.system.input_speed) * ts
    te = np.asarray(gj.simulate(scene, ts, torque=10.0).te)
    noise = 0.02 * arcmin * np.random.default_rng(2).standard_normal(len(ts))
    record = gj.Measurement(theta, None, te + noise, 10.0, ts, "shaking")
    found = gj.identify(scene, [record], analysis="dynamic", suggest=False)
    stiffness = next(each for each in found.estimates if each.name == "compliance.mean")
    assert stiffness.error is not None
    assert abs(stiffness.value - 3e8) < 3 * stiffness.error
    assert stiffness.error < 1e8
    assert found.sigma == pytest.approx(0.02 * arcmin, rel=0.1)
