"""Which errors explain recordings: of gear sets written out apart from the package (`tests/bench_units.py`)."""

import dataclasses
import json
import sys

import numpy as np
import pytest

import gearjax as gj
from gearjax.identification.unknowns import priors_of, unknowns_of
from gearjax.identification.visible import block_length
from gearjax.units import arcmin, deg, um
from tests.bench_units import (
    RATIO,
    PinStageUnit,
    TwoKVUnit,
    estimates,
    pin_stage,
    pin_stage_runs,
    random_unit,
    recorded,
    runs,
    truth,
    two_kv,
)

ROWS = 1500
QUIET = {"noise": 1e-4 * arcmin, "rows": ROWS}


@pytest.fixture(scope="module")
def scene():
    return two_kv()


@pytest.fixture(scope="module")
def unit():
    return random_unit(3)


@pytest.fixture(scope="module")
def found(scene, unit):
    return gj.identify(scene, runs(unit, 3, rows=ROWS))


def scores(found, unit) -> np.ndarray:
    """How many standard errors each number is off, under the better of both names."""
    values, errors = estimates(found)
    return min((np.abs(values - one) / errors for one in truth(unit)), key=np.max)


# 2K-V -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_unit_is_found_within_its_errors(found, unit):
    assert scores(found, unit).max() < 3.5
    assert found.sigma / arcmin == pytest.approx(0.05, rel=0.05)
    assert not found.orders
    _, errors = estimates(found)
    assert (errors[:6] < 0.1).all()  # um


@pytest.mark.slow
def test_without_noise_the_truth_is_met(scene, unit):
    found = gj.identify(scene, runs(unit, 3, **QUIET), suggest=False)
    values, _ = estimates(found)
    off = min((np.abs(values - one) for one in truth(unit)), key=np.max)
    assert off[:6].max() < 0.015  # um: encoders of 20 bits
    assert off[6] < 1e-3
    assert off[7] < 1.5  # um, of the play: the offsets have their own priors


@pytest.mark.slow
def test_what_nothing_shows_is_told(found):
    """Two directions, exactly: planets and revolution, on both flanks."""
    assert found.visible.hidden.shape == (2, 10)
    told = [each.words for each in found.visible.combinations]
    assert told == [
        f"errors.planet_{i}.{part} {sign} errors.revolution.{part}"
        for i, sign in ((1, "+"), (2, "-"))
        for part in ("cos", "sin")
    ]
    assert found.estimate("errors.planet_1.cos").error is None
    assert found.estimate("errors.output_wheel.cos").error is not None
    assert "do not change with errors.planet_1.cos + d" in found.hidden[0]


def test_exchanged_names_are_told_as_another_solution(found):
    other = found.alternatives[0]
    output = [found.estimate(f"errors.output_wheel.{part}").value for part in ("cos", "sin")]
    exchanged = [-other[f"errors.output_wheel.{part}"] for part in ("cos", "sin")]
    np.testing.assert_allclose(exchanged, output, atol=0.1)
    assert any("explain the recordings equally well" in words for words in found.notes)


@pytest.mark.slow
def test_another_recording_after_turning_a_planet_is_asked_for_and_settles_it(found, scene, unit):
    best = found.suggestions[0]
    assert "after turning planet_1 by 90 deg" in best.words
    assert best.hidden == 0
    turned = dataclasses.replace(unit, planet_1=unit.planet_1 * 1j)
    again = recorded(turned, 150.0, 9, rows=ROWS)
    again = dataclasses.replace(again, turned={"errors.planet_1": 90 * deg}, name="turned")
    settled = gj.identify(scene, [*runs(unit, 3, rows=ROWS), again])
    assert not len(settled.visible.hidden)
    assert not settled.alternatives
    assert not settled.suggestions
    for name in ("planet_1", "planet_2", "revolution"):
        vector = getattr(unit, name) / um
        for part, true in zip(("cos", "sin"), (vector.real, vector.imag), strict=True):
            each = settled.estimate(f"errors.{name}.{part}")
            assert abs(each.value - true) < 4 * each.error < 1.0


@pytest.mark.slow
def test_small_errors_that_always_share_are_not_taken_for_told(scene):
    """Between 40 and 150 N m both pairs always carry: a light torque is asked for."""
    rng = np.random.default_rng(5)
    unit = TwoKVUnit(*(1 * um * np.exp(2j * np.pi * rng.random(4))))
    found = gj.identify(scene, runs(unit, 5, (40.0, 150.0, -40.0), rows=ROWS))
    assert len(found.visible.hidden) > 2 or found.alternatives
    assert any("light torque" in each.words for each in found.suggestions)
    better = gj.identify(scene, runs(unit, 5, (2.0, 150.0, -40.0), rows=ROWS), suggest=False)
    assert len(better.visible.hidden) == 2
    assert scores(better, unit).max() < 4


@pytest.mark.slow
@pytest.mark.parametrize("order", [3, 17])
def test_an_order_of_the_rig_is_named_and_set_free(scene, unit, order):
    records = runs(unit, 4, rows=ROWS, extra=lambda theta: 0.2 * arcmin * np.cos(order * theta / RATIO + 1.0))
    found = gj.identify(scene, records, suggest=False)
    assert found.orders[0].order * RATIO == pytest.approx(order)
    assert found.orders[0].amplitude == pytest.approx(0.2, rel=0.05)
    assert found.orders[0].phase == pytest.approx(1.0, abs=0.05)
    assert len(found.orders) == 1
    assert scores(found, unit).max() < 4
    ignored = gj.identify(scene, records, orders=[], suggest=False)
    assert ignored.visible.blocks > 1
    assert any("an effect is not modelled" in words for words in ignored.notes)


@pytest.mark.slow
def test_wild_rows_are_weighed_down(scene, unit):
    records = runs(unit, 6, rows=ROWS)
    wild = records[0].output.copy()
    wild[::97] += np.random.default_rng(0).normal(0, 20 * arcmin, wild[::97].size)
    records[0] = dataclasses.replace(records[0], output=wild)
    found = gj.identify(scene, records, suggest=False)
    assert scores(found, unit).max() < 4
    assert any("rows are outliers" in words for words in found.notes)
    plain = gj.identify(scene, records, loss="least_squares", orders=[], suggest=False)
    assert plain.sigma > 5 * found.sigma


@pytest.mark.slow
def test_rows_that_hang_together_have_wider_errors(scene, unit):
    records = []
    for i, record in enumerate(runs(unit, 7, rows=ROWS, noise=0.0)):
        rng, noise = np.random.default_rng(i), np.zeros(ROWS)
        for k in range(1, ROWS):
            noise[k] = 0.9 * noise[k - 1] + 0.02 * arcmin * rng.standard_normal()
        records.append(dataclasses.replace(record, output=record.output + noise))
    found = gj.identify(scene, records, orders=[], suggest=False)
    assert found.visible.blocks > 40
    assert scores(found, unit).max() < 4.5
    white = np.random.default_rng(0).standard_normal(1000)
    assert block_length(white, np.zeros(1000, int)) == 1


@pytest.mark.slow
def test_priors_settle_what_recordings_hide(scene, unit):
    records = runs(unit, 3, rows=ROWS)
    priors = {"errors.revolution": 1e-9, "compliance.mean": (1e8, 2e7)}
    found = gj.identify(scene, records, priors=priors, suggest=False)
    assert found.estimate("errors.revolution.cos").value == pytest.approx(0.0, abs=0.01)
    assert all(each.error is not None for each in found.estimates)
    given = gj.identify(scene, records, priors={"errors.revolution.amplitude": gj.Rayleigh(6e-6)}, suggest=False)
    assert given.estimate("errors.revolution.sin").error < 6.5
    draws = given.draws(4000)
    np.testing.assert_allclose(draws[::2, 4].std(), given.estimate("errors.revolution.cos").error, rtol=0.1)


@pytest.mark.slow
def test_play_of_both_directions_is_found_to_a_percent(scene, unit):
    """Without torque, forward and backward: the distance of both edges."""
    theta = np.arange(ROWS) * (2 * np.pi * RATIO / ROWS)
    ahead = unit.te(theta, 0.0)
    behind = np.minimum(*unit.edges(theta, -1))
    rng = np.random.default_rng(1)
    noise = 0.05 * arcmin * rng.standard_normal((2, ROWS))
    records = [
        gj.Measurement(theta, te=ahead + noise[0], name="forward"),
        gj.Measurement(theta[::-1], te=(behind + noise[1])[::-1], name="backward"),
    ]
    found = gj.identify(scene, records, suggest=False, offset_spread=1e-7)
    assert found.estimate("backlash.initial").value == pytest.approx(unit.play / um, rel=0.01)
    beside = gj.compare(found.scene, records)
    true = np.mean(behind - ahead)
    assert beside.lost_motion is not None
    np.testing.assert_allclose(beside.lost_motion, [true, true], rtol=0.01)


@pytest.mark.slow
def test_a_torque_of_the_other_sign_is_named(scene, unit):
    records = [dataclasses.replace(record, torque=-record.loads) for record in runs(unit, 3, rows=ROWS)]
    with pytest.raises(gj.GearjaxError, match="torque seems to have the wrong sign"):
        gj.identify(scene, records, suggest=False)


@pytest.mark.slow
def test_a_zero_at_the_start_is_left_out_where_recordings_know_none(unit):
    scene = gj.load("configs/two_kv/wang_2020.toml")
    found = gj.identify(scene, runs(unit, 3, rows=ROWS), suggest=False)
    assert scores(found, unit).max() < 3.5
    assert found.scene.reference is None
    assert any("[reference] is left out" in words for words in found.notes)


def test_it_can_be_written_and_looked_up(found):
    told = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert {"estimates", "hidden", "alternatives", "suggestions", "orders"} <= set(told)
    with pytest.raises(gj.ParameterError, match=r'did you mean "compliance\.mean"'):
        found.estimate("compliance.men")
    _, measured, computed = found.curves()[1]
    assert np.std(measured - computed) == pytest.approx(found.sigma, rel=0.1)


@pytest.mark.slow
def test_another_unit_compiles_nothing(scene):
    """Programs depend on how many rows there are, not on what they hold."""
    from jax._src import compiler

    gj.identify(scene, runs(random_unit(10), 10, rows=ROWS), suggest=False)  # a worker may have dropped its programs
    compiled = []
    before = compiler.backend_compile_and_load

    def counted(*args, **keywords):
        compiled.append(args)
        return before(*args, **keywords)

    compiler.backend_compile_and_load = counted
    try:
        gj.identify(scene, runs(random_unit(11), 11, rows=ROWS), suggest=False)
    finally:
        compiler.backend_compile_and_load = before
    assert len(compiled) <= 3


@pytest.mark.slow
def test_a_posterior_checks_the_intervals(scene, unit):
    """Means and spreads of least squares, but where one number is held by nothing but its prior."""
    records = runs(unit, 3, rows=400)
    found = gj.identify(scene, records, priors={"errors.revolution": 5e-6}, suggest=False)
    drawn = gj.posterior(found, chains=2, draws=400)
    assert drawn.draws.shape == (2, 400, len(found.names))
    assert drawn.scale_reduction.max() < 1.05
    assert drawn.differs == []
    told = {name: i for i, name in enumerate(drawn.names)}
    for name in ("errors.output_wheel.cos", "compliance.mean", "errors.revolution.sin"):
        each, i = found.estimate(name), told[name]
        assert drawn.std[i] == pytest.approx(each.error, rel=0.15)
        assert drawn.mean[i] == pytest.approx(each.value, abs=0.3 * each.error)
    low, high = drawn.interval[:, told["errors.output_wheel.sin"]]
    each = found.estimate("errors.output_wheel.sin")
    np.testing.assert_allclose([low, high], each.interval, atol=0.4 * each.error)


@pytest.mark.slow
def test_a_posterior_of_few_rows_that_is_no_ellipse_is_told(scene):
    """A stiffness from some rows of much noise is told on one side better than on the other."""
    records = runs(random_unit(1), 1, (1.0, 12.0, -6.0), rows=60, noise=0.4 * arcmin)
    found = gj.identify(scene, records, priors={"errors.revolution": 5e-6}, orders=[], suggest=False)
    drawn = gj.posterior(found, chains=2, draws=400)
    assert drawn.differs


# what is hidden stays harmless ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_hidden_numbers_are_moved_only_where_no_curve_changes(scene):
    """One run on the back flanks hides stiffness, play and offset in each other."""
    record = gj.synthetic_measurement(scene, -100.0, rows=ROWS)
    found = gj.identify(scene, record, suggest=False)
    theta, measured, computed = found.curves()[0]
    assert theta.shape == (ROWS,)
    assert np.std(measured - computed) == pytest.approx(found.sigma, rel=0.05)
    assert found.estimate("backlash.initial").error is None
    assert found.estimate("backlash.initial").value > 20
    assert found.estimate("compliance.mean").value > 0
    plain = dataclasses.replace(scene, errors={})
    record = gj.synthetic_measurement(plain, 100.0, rows=ROWS)
    alone = gj.identify(plain, record, ["compliance.mean"], orders=[], suggest=False)
    assert alone.estimate("compliance.mean").error is None
    assert alone.estimate("compliance.mean").value == pytest.approx(9.245e7, rel=1e-3)


@pytest.mark.slow
def test_draws_and_fit_share_a_strong_prior(scene, unit):
    records = runs(unit, 3, rows=ROWS)
    found = gj.identify(
        scene, records, priors={"errors.output_wheel": 0.01e-6, "errors.revolution": 5e-6}, suggest=False
    )
    name = "errors.output_wheel.cos"
    place = found.names.index(name)
    drawn = found.shown(found.gaussian(1.0)[0])[place]
    assert drawn == pytest.approx(found.estimate(name).value, abs=1e-6)
    number = gj.identify(scene, records[2], priors={"backlash.initial": 20e-6}, suggest=False)
    assert number.estimate("backlash.initial").value == pytest.approx(150, abs=40)


@pytest.mark.slow
def test_a_prior_of_one_number_leaves_the_others_near_none(scene, unit):
    records = runs(unit, 3, rows=ROWS)
    found = gj.identify(scene, records, priors={"compliance.mean": (1e8, 1e8)}, suggest=False)
    plain = gj.identify(scene, records, suggest=False)
    for name in ("planet_1", "revolution"):
        sizes = [
            np.hypot(*(each.estimate(f"errors.{name}.{part}").value for part in ("cos", "sin")))
            for each in (found, plain)
        ]
        assert max(sizes) < 25  # um: along the hidden directions a search may end anywhere


@pytest.mark.slow
def test_recordings_without_noise_do_not_break_what_follows(scene, unit):
    records = runs(unit, 3, rows=600, noise=0.0)
    found = gj.identify(scene, records, suggest=False)
    assert np.isfinite(gj.reassemble(found, ["errors.planet_1"], draws=6).after)


def test_noise_of_a_torque_sensor_is_no_load(scene):
    plain = gj.synthetic_measurement(scene, rows=ROWS)
    noise = 0.02 * np.random.default_rng(0).standard_normal(ROWS)
    record = dataclasses.replace(plain, torque=noise)
    assert not record.is_loaded
    beside = gj.compare(scene, record)
    assert beside.records[0].explained == pytest.approx(gj.compare(scene, plain).records[0].explained)
    assert any("is taken as zero" in words for words in beside.notes)
    forth = np.concatenate([plain.theta, plain.theta[::-1]])
    both = gj.Measurement(forth, np.concatenate([plain.output, plain.output[::-1]]))
    with pytest.raises(gj.GearjaxError, match="goes forth and back"):
        gj.identify(scene, both)


def test_noise_of_a_torque_sensor_is_no_change_of_the_load(scene):
    plain = gj.synthetic_measurement(scene, torque=10.0, rows=ROWS)
    noise = 10.0 + 5.0 * np.random.default_rng(0).standard_normal(ROWS)
    record = dataclasses.replace(plain, torque=noise)
    np.testing.assert_allclose(record.loads, noise.mean())
    assert any("changes only by noise" in words for words in gj.compare(scene, record).notes)
    wave = dataclasses.replace(plain, torque=10.0 + 5.0 * np.sin(plain.theta / 10))
    np.testing.assert_array_equal(wave.loads, wave.torque)


@pytest.mark.slow
def test_long_recordings_are_averaged(scene, unit, monkeypatch):
    monkeypatch.setattr(sys.modules["gearjax.identification.identify"], "MOST_ROWS", 3000)
    found = gj.identify(scene, runs(unit, 3, rows=4000), suggest=False)
    assert sum(record.theta.size for record in found.records) <= 3000
    assert scores(found, unit).max() < 4
    assert any("are averaged" in words for words in found.notes)


# RV, exact ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.runs_long
def test_pins_of_a_wrong_size_are_found_by_exact_geometry():
    """The truth is a curve of the plane against circles; what first order gaps would say is off."""
    larger = np.zeros(24)
    larger[[4, 15]] = 2.5 * um, -1.8 * um
    unit = PinStageUnit(larger, 3 * um * np.exp(0.7j), 1.3e8)
    records = pin_stage_runs(unit, 2, per_turn=30)
    found = gj.identify(pin_stage(), records, starts=1, suggest=False)
    own = found.estimates[:27]
    values, errors = np.array([each.value for each in own]), np.array([each.error for each in own])
    true = np.concatenate([larger / um, [unit.run_out.real / um, unit.run_out.imag / um, unit.stiffness]])
    off = np.abs(values - true) / errors
    assert off.max() < 4
    assert (np.abs(values[[4, 15]]) > 5 * errors[[4, 15]]).all()
    assert found.sigma / arcmin == pytest.approx(0.02, rel=0.05)
    rough = gj.identify(pin_stage("linear"), records, starts=1, suggest=False, orders=[])
    stiffness = rough.estimate("compliance.mean")
    assert abs(stiffness.value - unit.stiffness) > 0.005 * unit.stiffness


# what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"where": ["errors.planet_3"]}, 'did you mean "errors.planet_2'),
        ({"where": ["errors.planet_1.phase"]}, "is half of a vector"),
        ({"where": ["errors.planet_1", "errors.planet_1"]}, "is listed twice"),
        ({"priors": {"errors.planet_7": 1e-6}}, "is not among the unknowns"),
        ({"priors": {"errors.planet_1": -1.0}}, "must be a standard deviation"),
        ({"priors": {"errors.planet_1": "5 um"}}, "must be a standard deviation"),
        ({"loss": "huber"}, "valid: robust, least_squares"),
        ({"orders": "all"}, 'must be "find"'),
        ({"orders": [0.0]}, "cycles per turn of the input"),
        ({"orders": [1e-9]}, "cycles per turn of the input"),
        ({"orders": [np.nan]}, "must be finite"),
        ({"orders": [0.5, 0.5]}, "is too close to another"),
        ({"priors": {"errors.planet_1": gj.Normal(0.0, 0.0)}}, "above 0|standard deviation"),
        ({"offset_spread": 0.0}, "must be above 0"),
        ({"starts": 0}, "must be at least 1"),
        ({"measured": []}, "must contain a recording"),
        ({"measured": "te.csv"}, "must be a Measurement"),
    ],
)
def test_wrong_arguments_end_in_one_line(scene, unit, given, words):
    with pytest.raises(gj.GearjaxError, match=words) as caught:
        gj.identify(scene, **({"measured": runs(unit, 3, rows=100)} | given))
    assert "\n" not in str(caught.value)


def test_what_a_scene_lacks_is_named(scene, unit):
    records = runs(unit, 3, rows=100)
    with pytest.raises(gj.SceneError, match=r"need a \[compliance\]"):
        gj.identify(dataclasses.replace(scene, compliance=None), records)
    with pytest.raises(gj.SceneError, match=r"lacks: list a \[backlash\]"):
        gj.identify(dataclasses.replace(scene, backlash=None), records)
    with pytest.raises(gj.ParameterError, match="has no errors to find"):
        gj.identify(dataclasses.replace(scene, errors={}), dataclasses.replace(records[0], torque=None))
    with pytest.raises(gj.ParameterError, match="turned of x = "):
        gj.identify(scene, dataclasses.replace(records[0], turned={"errors.ring": 1.0}, name="x"))


def test_priors_are_of_each_component(scene):
    unknowns = unknowns_of(scene, ["errors.planet_1", "compliance.mean"], back=False, loaded=True)
    mean, precision = priors_of(unknowns, {"errors.planet_1": 4e-6, "compliance.mean": (9.245e7, 9.245e6)})
    np.testing.assert_allclose(mean, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(precision**-0.5, [4.0, 4.0, 0.1])
