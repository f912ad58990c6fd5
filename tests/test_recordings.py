"""Files of test benches: what is read, what is mended and counted, and what is refused in one line."""

import dataclasses
import warnings

import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import RepairedData
from gearjax.config import recording
from gearjax.units import arcmin, deg
from tests.bench_units import RATIO, random_unit, recorded, two_kv
from tests.conftest import ROOT

HEADER = "time [s],input angle [deg],output angle [deg],torque [N m]"
ROWS = 600
THETA = np.linspace(0.0, 2 * np.pi * RATIO, ROWS)
TE = 0.4 * arcmin * np.sin(26 * THETA / RATIO + 0.3)
TABLE = np.stack([np.arange(ROWS) * 2e-3, THETA / deg, (THETA / RATIO + TE) / deg, np.full(ROWS, 40.0)], axis=1)


@pytest.fixture(scope="module")
def scene():
    return two_kv()


def written(folder, table=TABLE, header=HEADER, beside=None, form="%.9g"):
    """A file of that table."""
    path = folder / "te.csv"
    lines = [",".join("" if np.isnan(value) else form % value for value in row) for row in table]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    if beside is not None:
        (folder / "te.toml").write_text(beside, encoding="utf-8")
    return path


def read(*args, **keywords) -> gj.Measurement:
    """A recording, and no word about it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RepairedData)
        return gj.read_measurement(*args, **keywords)


def refused(words, path, **keywords) -> None:
    with pytest.raises(gj.GearjaxError, match=words) as caught:
        read(path, **keywords)
    assert "\n" not in str(caught.value)


def same_te(record, scene, allowed=1e-7):
    place = np.interp(record.theta, THETA, TE)
    np.testing.assert_allclose(record.error(scene), place, rtol=0, atol=allowed)


def test_angles_and_torque_are_read_in_their_units(tmp_path, scene):
    record = read(written(tmp_path))
    assert not record.repairs
    np.testing.assert_allclose(record.theta, THETA, rtol=1e-8)
    assert record.loads[0] == 40.0
    same_te(record, scene)
    other = np.stack([THETA, TE / arcmin * 60], axis=1)
    record = read(written(tmp_path, other, "Input_Angle (rad),TE [arcsec]"), torque=-3.0)
    same_te(record, scene, 1e-10)
    assert record.back.all()


def test_a_file_beside_names_columns_signs_counts_and_what_was_turned(tmp_path, scene):
    counts = np.round(np.stack([-THETA / (2 * np.pi) * 2**20, TABLE[:, 2] / 360 * 2**24], axis=1))
    beside = """
torque = "0.15 kN*m"
input_counts = 1048576
output_counts = 16777216
turned = {"errors.planet_1" = "30 deg"}
name = "run 7"
[columns]
"input angle" = {column = "phi", unit = "counts", sign = -1}
"output angle" = {column = "psi", unit = "counts"}
"""
    record = read(written(tmp_path, counts, "phi,psi", beside))
    assert record.name == "run 7"
    assert record.loads[0] == 150.0
    assert record.resolution == pytest.approx(2 * np.pi / 2**24)
    assert record.turned["errors.planet_1"] == pytest.approx(30 * deg)
    np.testing.assert_allclose(record.theta, THETA, atol=1e-5)
    same_te(record, scene, 1e-6)


MENDED = {
    "nan": (lambda table: _with(table, (50, 2), np.nan), "rows with missing values left out", 1),
    "repeated": (lambda table: np.insert(table, 100, table[100], axis=0), "repeated rows left out", 1),
    "unsorted": (lambda table: table[[*range(200), 201, 200, *range(202, ROWS)]], "out of the order of time sorted", 2),
    "zeros": (lambda table: _with(table, (300, 2), 0.0), "a zero in place of the", 1),
    "wrapped": (lambda table: _column(table, 1, table[:, 1] % 360), "jumps of the input angle", 79),
    "output wrapped": (lambda table: _column(table, 2, (table[:, 2] + 180) % 360), "jumps of the output angle", 1),
}  # fmt: skip


def _column(table, place, values):
    return np.column_stack([values if i == place else column for i, column in enumerate(table.T)])


def _with(table, place, value):
    table = table.copy()
    table[place] = value
    return table


@pytest.mark.parametrize("name", MENDED)
def test_what_is_mended_is_counted_and_told(name, tmp_path, scene):
    change, words, number = MENDED[name]
    fine = TABLE if name != "wrapped" else _finer(TABLE)
    path = written(tmp_path, change(fine))
    with pytest.warns(RepairedData, match=words.replace(" ", ".")) as told:
        record = gj.read_measurement(path)
    assert f"{number} " in str(told[0].message)
    shift = 180 * deg if name == "output wrapped" else 0.0
    off = record.error(scene) - shift - np.interp(record.theta, THETA, TE)
    assert np.abs(off).max() < (3e-4 if name == "wrapped" else 1e-7)


def test_turns_within_a_gap_are_counted_by_the_time(tmp_path, scene):
    """Of a wrapped angle 40 rows are missing, in which the input makes more than half a turn."""
    fine = _finer(TABLE)
    wrapped = _column(fine, 1, fine[:, 1] % 360)
    gap = slice(3000, 3000 + int(0.8 * 360 / np.median(np.abs(np.diff(fine[:, 1])))))
    kept = np.delete(wrapped, gap, axis=0)
    whole = np.delete(fine, gap, axis=0)
    with pytest.warns(RepairedData, match="in gaps counted by the time"):
        record = gj.read_measurement(written(tmp_path, kept))
    np.testing.assert_allclose(record.theta, whole[:, 1] * deg, atol=1e-4)
    assert any("has a gap" in words for words in record.check(scene))


@pytest.mark.parametrize("size", [300.0, 180 / np.pi * 60])
def test_a_transmission_error_of_several_pitches_is_impossible(size, scene):
    """Values that are far too large, as those in arcmin are that are taken for radians."""
    record = gj.Measurement(THETA, te=TE * size, name="bench")
    with pytest.raises(gj.GearjaxError, match=r"tooth pitches .* the unit of a column is wrong") as told:
        record.check(scene)
    assert len(str(told.value)) < 300


def test_zeros_of_a_long_dropout_are_left_out(tmp_path):
    table = TABLE.copy()
    table[100:220, 2] = 0.0
    assert sum(read(written(tmp_path, table)).repairs.values()) == 120


@pytest.mark.parametrize(
    ("first", "words"),
    [
        ("input angle [deg];te [arcmin]\n0;1,5\n1;2,5", "separated by commas"),
        ("# bench 3\ninput angle [deg],te [arcmin]\n0,1\n1,2", "line 1 must name the columns"),
    ],
)
def test_files_of_other_habits_are_told_what_is_right(tmp_path, first, words):
    path = tmp_path / "run.csv"
    path.write_text(first + "\n", encoding="utf-8")
    with pytest.raises(gj.GearjaxError, match=words):
        gj.read_measurement(path)


def _finer(table):
    place = np.linspace(0, ROWS - 1, 6 * ROWS)
    return np.stack([np.interp(place, np.arange(ROWS), column) for column in table.T], axis=1)


def test_text_among_numbers_counts_as_missing(tmp_path):
    path = written(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[20] = "0.04,oops,0.1,40"
    path.write_text("\n".join(lines), encoding="utf-8")
    assert read(path).repairs == {"rows with missing values left out": 1}


INPUT_AND_TE = "input angle [deg],te [arcmin]"
FAULTS = {
    "no input angle": ("time [s],output angle [deg]", TABLE[:, [0, 2]], "column input angle .time cannot replace it"),
    "no output": ("time [s],input angle [deg]", TABLE[:, :2], "must name a column output angle, or te"),
    "no unit": ("input angle,te [arcmin]", TABLE[:, 1:3], "input angle needs its unit"),
    "wrong unit": ("input angle [mm],te [arcmin]", TABLE[:, 1:3], "is a length"),
    "counts": ("input angle [counts],te [arcmin]", TABLE[:, 1:3], r"give input_counts \(counts per turn\)"),
    "twice": ("te [deg],input angle [deg],te [arcmin],x", TABLE, "two columns are named te"),
    "misspelt": ("time [s],input angle [deg],te [arcmin],torqe [N m]", TABLE, '"torqe" would be ignored; .* "torque"'),
    "constant": (INPUT_AND_TE, np.stack([0 * THETA, TE], axis=1), "input angle holds the same value"),
    "stuck": ("input angle [deg],output angle [deg]", np.stack([THETA, 0 * TE + 1], axis=1), "output angle holds the"),
    "missing": (INPUT_AND_TE, np.stack([THETA, np.where(np.arange(ROWS) % 2, np.nan, TE)], axis=1), "300 of 600 rows"),
    "few": (INPUT_AND_TE, TABLE[:2, 1:3], "0 of 2 rows lack|at least 3"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_faults_of_a_file_end_in_one_line(name, tmp_path):
    header, table, words = FAULTS[name]
    refused(words, written(tmp_path, table, header))


def test_what_is_no_table_is_refused(tmp_path):
    path = tmp_path / "te.csv"
    refused("cannot be read", path)
    path.write_text("", encoding="utf-8")
    refused("must name a column input angle; it has none", path)
    path.write_bytes(b"\x89PNG\r\n\x1a\n\x00\xff\xfe" * 50)
    refused("not a CSV file|must name|cannot be read", path)
    path.write_text("input angle [deg];te [arcmin]\n0;1\n1;2\n", encoding="utf-8")
    refused("separated by commas", path)
    path.write_text("input angle [deg],te [arcmin]\n", encoding="utf-8")
    refused("no rows", path)
    path.write_text("input angle [deg],te [arcmin]\n0,1\n1,2\n2,3,4\n", encoding="utf-8")
    refused("line 4 has 3 values, the first line has 2", path)
    refused("is a folder|not a file", tmp_path)
    written(tmp_path, beside='torque = "3 mm"')
    refused("torque", tmp_path / "te.csv")
    written(tmp_path, TABLE[:, :3], "time [s],input angle [deg],output angle [deg]", beside="torqe = 3")
    refused('did you mean "torque"', tmp_path / "te.csv")


def test_angles_that_wrap_too_fast_are_refused(tmp_path):
    coarse = np.stack([(THETA[::3] / deg * 1.0) % 360, TE[::3] / arcmin], axis=1)
    refused("its turns cannot be counted", written(tmp_path, coarse, "input angle [deg],te [arcmin]"))


def test_rows_beyond_a_million_are_averaged_as_they_are_read(tmp_path, scene, monkeypatch):
    monkeypatch.setattr(recording, "CHUNK", 1000)
    monkeypatch.setattr(recording, "MOST_KEPT", 2000)
    fine = np.linspace(0.0, THETA[-1], 20_000)
    output = fine / RATIO + np.interp(fine, THETA, TE)
    table = np.stack([fine * 1e-2, (fine / deg) % 360, (output / deg) % 360, 40 + 0 * fine], axis=1)
    record = read(written(tmp_path, table, form="%.10g"))
    assert record.averaged in (10, 11, 12)
    assert record.theta.size == pytest.approx(20_000 / record.averaged, abs=60)
    off = record.error(scene) - np.interp(record.theta, THETA, TE)
    assert np.abs(off[:-1]).max() < 2e-6


WRONG = {
    "ratio": (lambda r: dataclasses.replace(r, output=r.output * 79 / 80), r"fits a ratio of 80\.\d* .* set has 79"),
    "other way": (lambda r: dataclasses.replace(r, output=-r.output), "turns in the opposite direction"),
    "degrees": (lambda r: dataclasses.replace(r, theta=r.theta * 57.29578), "the input angle seems to be in degrees"),
    "radians": (lambda r: dataclasses.replace(r, theta=r.theta / 57.29578), "the input angle seems to be in radians"),
    "turns": (lambda r: dataclasses.replace(r, output=r.output * 360), "in turns"),
    "exchanged": (lambda r: dataclasses.replace(r, theta=r.output, output=r.theta), "look exchanged"),
    "aliased": (lambda r: dataclasses.replace(r, theta=r.theta * 300, output=r.output * 300), "aliased"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_recordings_of_another_gear_set_are_named(name, scene):
    change, words = WRONG[name]
    record = change(recorded(random_unit(0), 40.0, 0, rows=2000))
    with pytest.raises(gj.GearjaxError, match=words) as caught:
        gj.compare(scene, record)
    assert "\n" not in str(caught.value)


def test_a_short_record_and_a_gap_are_told(scene):
    record = recorded(random_unit(0), 40.0, 0, rows=2000, turns=0.2)
    assert "covers 0.2 turns of the output" in record.check(scene)[0]
    record = recorded(random_unit(0), 40.0, 0, rows=2000)
    keep = np.r_[0:500, 700:2000]
    record = dataclasses.replace(record, theta=record.theta[keep], output=record.output[keep], torque=40.0, time=None)
    assert any("has a gap" in words for words in record.check(scene))


def test_a_recording_that_states_no_torque_is_told(scene):
    plain = gj.synthetic_measurement(scene, rows=ROWS)  # it states zero
    silent = dataclasses.replace(plain, torque=None)
    told = f"{silent.name} states no torque: it is taken as a recording without load"
    assert told in silent.check(scene)
    assert told not in plain.check(scene)
    assert told not in silent.check(dataclasses.replace(scene, compliance=None))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"theta": [0.0, 1.0]}, "at least 3"),
        ({"theta": [0.0, np.nan, 1.0]}, r"theta\[1\] = nan: must be finite"),
        ({"theta": [0.0, 1.0, 2.0], "te": [0.0, 1.0]}, "is a shape"),
        ({"theta": [0.0, 1.0, 2.0], "te": ["a", "b", "c"]}, "must be numbers"),
        ({"theta": [0.0, 1.0, 2.0], "te": None}, "give either the output angle or the transmission error"),
        ({"theta": [1.0, 1.0, 1.0]}, "the input does not turn"),
    ],
)
def test_measurements_made_in_python(given, words):
    with pytest.raises(gj.GearjaxError, match=words):
        gj.Measurement(**({"te": np.zeros(len(given["theta"]))} | given))


def test_a_configuration_of_the_same_name_is_not_taken_for_notes(tmp_path):
    path = written(tmp_path)
    path.with_suffix(".toml").write_text((ROOT / "configs/two_kv/measured.toml").read_text())
    with pytest.raises(gj.GearjaxError, match=r"is a configuration, but beside .*\.csv .*: rename one of them$"):
        gj.read_measurement(path)


@pytest.mark.parametrize(
    ("te", "words"),
    [(-1.0, "with the other sign of te"), (60.0, "may have the wrong unit"), (1 / 60, "may have the wrong unit")],
)
def test_a_comparison_says_what_seems_wrong(te, words, scene):
    record = gj.synthetic_measurement(scene, 100.0, rows=ROWS)
    ideal = record.theta / RATIO
    spoilt = dataclasses.replace(record, output=ideal + te * (record.output - ideal))
    assert not any("wrong" in told or "sign" in told for told in gj.compare(scene, record).notes)
    (told,) = (told for told in gj.compare(scene, spoilt).notes if words in told)
    assert told.startswith(record.name)


def test_a_torque_of_each_row_stays_with_its_row_when_the_input_turns_backward(scene):
    """Evenly spaced in time, as without turning backward; each row has the TE under its own torque."""
    torque = np.linspace(-20.0, -120.0, 50)
    ahead = gj.synthetic_measurement(scene, torque[::-1], rows=50, noise=0.0)
    back = gj.synthetic_measurement(scene, torque, rows=50, noise=0.0, backward=True)
    np.testing.assert_array_equal(back.torque, torque)
    np.testing.assert_array_equal(back.theta, ahead.theta[::-1])
    np.testing.assert_allclose(back.output, ahead.output[::-1], rtol=0, atol=1e-15)
