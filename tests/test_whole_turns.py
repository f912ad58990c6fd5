"""Encoders of a single turn: whole turns that their angles do not show, from the other encoder."""

import dataclasses

import numpy as np
import pytest

import gearjax as gj
from gearjax.identification.measurement import ideal
from gearjax.identification.whole_turns import check_joined, farthest, joined
from gearjax.units import arcmin, deg

TURN = 2 * np.pi
FILES = {
    "two_kv": "configs/two_kv/measured.toml",
    "rv_cycloidal": "configs/rv_cycloidal/hu_2020.toml",
    "helical_pair": "configs/helical/guo_2018.toml",
}


@pytest.fixture(params=[*FILES, "a cycle of 68 1/6 turns", "an uneven ratio"], scope="module")
def scene(request) -> gj.Scene:
    if request.param in FILES:
        return gj.load(FILES[request.param])
    if request.param == "an uneven ratio":
        return gj.Scene(gj.EllipticPair(47, 3e-3, 0.22, 20.0, driven_lobes=2))
    scene = gj.load(FILES["two_kv"])
    return dataclasses.replace(scene, system=dataclasses.replace(scene.system, first_stage_planet_teeth=31))


def run(scene: gj.Scene, begin: float, span: float, offset: float = 0.0, rows: int = 4001) -> gj.Measurement:
    """A run with a TE that all bodies contribute to, with the true angles."""
    theta = begin + np.linspace(0.0, span, rows)
    slow = theta * TURN / scene.system.cycle
    te = 0.4 * arcmin * np.sin(slow + 1.0) + 0.2 * arcmin * np.cos(7 * slow)
    return gj.Measurement(theta, ideal(scene, theta) + te + offset, torque=40.0, name=f"from {begin:.3g}")


def wrapped(record: gj.Measurement) -> gj.Measurement:
    """The same run as encoders of a single turn show it, read as `gj.read_measurement` does."""
    theta, output = (np.unwrap(part % TURN) for part in (record.theta, record.output))
    return dataclasses.replace(record, theta=theta, output=output, input_wraps=True)


def off_by_cycles(scene: gj.Scene, theta, right) -> float:
    """Largest deviation of angles from others, but for whole cycles of the gear set."""
    cycle = scene.system.cycle
    return float(np.abs(np.remainder(theta - right + cycle / 2, cycle) - cycle / 2).max())


@pytest.mark.parametrize("turns", [0, 1, 5, -2])
def test_a_later_run_is_where_its_output_shows_it(scene, turns):
    """Also one that turns backward, and with a zero of the output encoder far from that of the phases."""
    moved = min(8 * arcmin, 0.08 * 2 * farthest(scene))
    first, second = run(scene, 0.4, 60.0, 1.9), run(scene, 60.4 + TURN * turns, -50.0, 1.9 + moved)
    (one, other), notes = joined(scene, [wrapped(first), wrapped(second)])
    assert off_by_cycles(scene, one.theta, first.theta) < 1e-9
    assert off_by_cycles(scene, other.theta, second.theta) < 1e-9
    between = other.error(scene) - one.error(scene).mean()
    np.testing.assert_allclose(between, second.error(scene) - first.error(scene).mean(), atol=1e-9)
    assert min(one.theta.max(), other.theta.max()) > max(one.theta.min(), other.theta.min())
    assert all("turns of its input angle" in words for words in notes)
    check_joined(scene, [one, other], 0.02 * arcmin)


def test_whole_turns_of_the_output_are_no_error(scene):
    """An output angle that falls just below zero shows nearly a turn."""
    ahead, behind = run(scene, 0.0, 60.0, -2 * arcmin), run(scene, 0.0, 60.0, 3 * arcmin)
    records = [dataclasses.replace(wrapped(each), input_wraps=False) for each in (ahead, behind)]
    assert records[0].output[0] - records[1].output[0] > 0.9 * TURN
    moved, notes = joined(scene, records)
    assert not notes
    for record, true in zip(moved, (ahead, behind), strict=True):
        np.testing.assert_array_equal(record.theta, true.theta)
        np.testing.assert_allclose(record.error(scene), true.error(scene), atol=1e-9)


def test_angles_that_do_not_wrap_are_left_alone(scene):
    """An encoder that was zeroed anew by chance where whole turns of the input would be."""
    first = run(scene, 0.0, 60.0)
    gained = float(np.diff(ideal(scene, np.array([0.0, TURN])))[0])
    second = run(scene, 0.0, 55.0, gained - TURN * round(gained / TURN))
    (_, other), notes = joined(scene, [first, second])
    np.testing.assert_array_equal(other.theta, second.theta)
    assert len(notes) == 1
    assert "zeroed anew" in notes[0]
    with pytest.raises(gj.GearjaxError, match=r"whole turns of the input are missing.*offset_spread"):
        check_joined(scene, [first, other], 0.02 * arcmin)
    check_joined(scene, [first, other], 180 * deg)


def test_a_zero_that_whole_turns_do_not_explain_moves_nothing():
    scene = gj.load(FILES["two_kv"])
    first, second = run(scene, 0.0, 60.0), run(scene, 0.0, 55.0, TURN / 79 * 3.4)
    (_, other), notes = joined(scene, [wrapped(first), wrapped(second)])
    np.testing.assert_array_equal(other.theta, second.theta)
    assert f"{np.degrees(TURN / 79 * 3.4):.4g} deg" in notes[0]


def test_an_output_that_turns_unevenly_tells_no_turns():
    scene = gj.load("configs/elliptic/dong_2020.toml")
    first, second = run(scene, 0.0, 20.0), run(scene, TURN, 20.0)
    (_, other), _ = joined(scene, [wrapped(first), wrapped(second)])
    assert abs(float(other.error(scene).mean())) < 1 * deg


@pytest.mark.slow
def test_lost_motion_and_errors_of_wrapped_files_are_those_of_unwrapped_ones(tmp_path):
    """A run ahead under torque, and one back from where it ended, as a bench with encoders of a single turn writes."""
    scene = gj.load(FILES["two_kv"])
    records = []
    for torque, backward in ((80.0, False), (-80.0, True)):
        made = gj.synthetic_measurement(scene, torque, rows=6000, turns=1.3, noise=2e-6, backward=backward)
        file = tmp_path / f"{torque:g}.csv"
        rows = np.stack([made.time, *(np.degrees(part) % 360 for part in (made.theta, made.output)), made.torque], 1)
        head = "time [s],input angle [deg],output angle [deg],torque [N m]"
        np.savetxt(file, rows, delimiter=",", header=head, comments="", fmt="%.9f")
        with pytest.warns(gj.RepairedData):
            records.append(gj.read_measurement(file))
    beside = gj.compare(scene, records)
    assert beside.lost_motion is not None
    assert beside.lost_motion[0] == pytest.approx(beside.lost_motion[1], rel=1e-3)
    assert all(record.explained > 0.98 for record in beside.records)
    found = gj.identify(dataclasses.replace(scene, reference=None), records, suggest=False)
    assert found.estimate("backlash.initial").value == pytest.approx(150, rel=1e-3)


@pytest.mark.slow
def test_a_run_that_may_begin_in_a_later_turn_is_told_so():
    """Not that the sign of its TE is wrong, although the other sign would explain some of it."""
    scene = gj.load(FILES["two_kv"])
    made = gj.synthetic_measurement(scene, 80.0, rows=4000, turns=1.0, noise=2e-6)
    early = dataclasses.replace(made, theta=made.theta - 23 * TURN, input_wraps=True)
    output = early.output - float(np.mean(early.error(scene)))
    (note,) = gj.compare(scene, dataclasses.replace(early, output=output)).notes
    assert "wraps around: it may begin in a later turn of the input" in note
    found = gj.compare(scene, dataclasses.replace(early, output=output), shift="find")
    assert found.records[0].explained > 0.97
    assert np.remainder(found.records[0].start, scene.system.cycle) == pytest.approx(23 * TURN, abs=1e-3)
    assert not found.notes


def test_the_order_of_the_recordings_changes_nothing(scene):
    """A recording whose angles do not wrap tells where the others are, wherever it stands in the list."""
    late, whole = run(scene, 0.3 + TURN, 40.0), run(scene, 0.0, 60.0)
    given = [wrapped(late), whole]
    ahead, _ = joined(scene, given)
    (one, other), _ = joined(scene, given[::-1])
    for record, true in ((ahead[0], late), (ahead[1], whole), (other, late), (one, whole)):
        assert off_by_cycles(scene, record.theta, true.theta) < 1e-9
    np.testing.assert_array_equal(ahead[1].theta, whole.theta)


def test_zeros_that_may_differ_tell_no_turns(scene):
    """With a wide `offset_spread`, or bodies turned in their seats, which moves the output."""
    first, second = run(scene, 0.0, 60.0), run(scene, TURN, 55.0)
    given = [wrapped(first), wrapped(second)]
    (_, counted), _ = joined(scene, given)
    assert off_by_cycles(scene, counted.theta, second.theta) < 1e-9
    (_, wide), _ = joined(scene, given, np.pi)
    turned = dataclasses.replace(given[1], turned={"errors.planet_1": 1.0})
    (_, seated), notes = joined(scene, [given[0], turned])
    for record in (wide, seated):
        np.testing.assert_array_equal(record.theta, given[1].theta)
    assert not notes
    check_joined(scene, [given[0], turned], 1e-6)


def test_places_closer_than_lost_motion_tell_no_turns():
    """Hunting teeth: in a cycle of 4,087 turns of the input, the nearest places of the output are 5 arcmin apart."""
    scene = gj.load("configs/helical/two_stage.toml")
    system = dataclasses.replace(scene.system, pinion_teeth=[19, 17], wheel_teeth=[61, 67])
    scene = dataclasses.replace(scene, system=system)
    first, second = run(scene, 0.0, 60.0), run(scene, 0.0, 55.0, 5.0 * arcmin)
    (_, other), notes = joined(scene, [wrapped(first), wrapped(second)])
    np.testing.assert_array_equal(other.theta, wrapped(second).theta)
    assert not notes
    check_joined(scene, [first, other], 1e-6)


@pytest.mark.parametrize("path", ["involute_rv/yang_2019.toml", "rv_cycloidal/hu_2020.toml", "two_kv/measured.toml"])
def test_a_large_lost_motion_is_no_missing_turn(path):
    scene = gj.load(f"configs/{path}")
    records = [run(scene, 0.0, 60.0), run(scene, 60.0, -60.0, 30.0 * arcmin)]
    moved, notes = joined(scene, records)
    assert not notes
    check_joined(scene, moved, 1e-6)


@pytest.mark.slow
def test_lost_motion_is_that_of_recordings_with_one_zero():
    """One of two runs on the back flanks was made after the encoder was zeroed anew."""
    scene = gj.load(FILES["two_kv"])
    runs = [
        gj.synthetic_measurement(
            scene, torque, rows=2000, turns=0.5, noise=0.0, offset=offset * deg, backward=torque < 0
        )
        for torque, offset in ((80.0, 0.0), (-80.0, 10.0), (-80.0, 0.0))
    ]
    runs[1] = dataclasses.replace(runs[1], name="zeroed anew")
    found = gj.compare(scene, runs)
    assert found.lost_motion is not None
    assert found.lost_motion[0] == pytest.approx(found.lost_motion[1], rel=1e-6)
    assert any("zeroed anew: its output angle lies 10." in note for note in found.notes)


@pytest.mark.slow
def test_a_wrong_sign_or_unit_of_a_wrapping_recording_is_named():
    scene = gj.load(FILES["two_kv"])
    made = gj.synthetic_measurement(scene, 80.0, rows=2000, turns=1.0, noise=0.0)
    te = made.error(scene)
    for factor, words in ((-1.0, "the other sign of te"), (60.0, "may have the wrong unit")):
        record = gj.Measurement(made.theta, te=factor * te, torque=80.0, input_wraps=True)
        notes = gj.compare(scene, record).notes
        assert any(words in note for note in notes)
        assert not any("wraps around" in note for note in notes)
