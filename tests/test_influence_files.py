"""Files of influence tables, and numbers that are refused."""

import json

import numpy as np
import pytest

import gearjax as gj
from gearjax.config import loads, loads_optimise, loads_tolerance
from gearjax.influence.files import write_arrays
from gearjax.influence.table import gear_hash
from gearjax.units import mm
from tests.conftest import ROOT
from tests.test_influence import gear_of, table_of


@pytest.fixture(scope="module")
def gear():
    return gear_of()


@pytest.fixture(scope="module")
def table(gear):
    return table_of(gear)


def test_a_file_gives_the_table_back(gear, table, tmp_path):
    path = gj.save_influence(tmp_path / "teeth.npz", table, gear, {"by": "hand"})
    again = gj.read_influence(path, gear)
    for name in ("radius", "face", "matrix", "slopes"):
        np.testing.assert_array_equal(getattr(again, name), getattr(table, name))
    assert again.made_for == table.made_for
    with np.load(path) as file:
        header = json.loads(str(file["header"]))
    assert header["units"]["matrix"] == "m/N"
    assert header["gear"]["module"] == "0.001"
    assert header["made"] == {"by": "hand"}


def test_results_are_kept_and_found_again(gear, tmp_path, monkeypatch):
    first = table_of(gear, cache=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 1
    monkeypatch.setattr("gearjax.influence.teeth._loaded", None)
    again = table_of(gear, cache=tmp_path)
    np.testing.assert_array_equal(again.matrix, first.matrix)
    with pytest.raises(TypeError):
        table_of(gear, cache=tmp_path, rim=1.1 * mm)


def test_a_damaged_result_is_worked_out_again(gear, table, tmp_path):
    table_of(gear, cache=tmp_path)
    (kept,) = tmp_path.glob("*.npz")
    kept.write_bytes(kept.read_bytes()[:1000])
    np.testing.assert_array_equal(table_of(gear, cache=tmp_path).matrix, table.matrix)
    assert gj.read_influence(kept, gear).made_for == table.made_for  # and kept again


def test_a_table_of_another_gear_is_refused(gear, table, tmp_path):
    path = gj.save_influence(tmp_path / "teeth.npz", table, gear)
    with pytest.raises(gj.GearjaxError, match=r"made for another gear, with profile_shift = 0.2, not 0.21"):
        gj.read_influence(path, gear_of(shift=0.21))
    with pytest.raises(gj.GearjaxError, match="made for another gear"):
        table.check_gear(gear_of(41))
    with pytest.raises(gj.GearjaxError, match="made for another gear"):
        gj.save_influence(path, table, gear_of(internal=True))
    table.check_gear(gear)


def test_damaged_files_are_refused_in_one_line(gear, table, tmp_path):
    path = gj.save_influence(tmp_path / "teeth.npz", table, gear)
    whole = path.read_bytes()
    for place in (0, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :])
        with pytest.raises(gj.GearjaxError, match=r"teeth\.npz: ") as caught:
            gj.read_influence(path, gear)
        assert "\n" not in str(caught.value)
    for length in (0, 100, len(whole) // 2):
        path.write_bytes(whole[:length])
        with pytest.raises(gj.GearjaxError, match=r"teeth.npz: (damaged|cannot be read)"):
            gj.read_influence(path, gear)


def test_a_table_of_text_is_called_no_archive(gear, tmp_path):
    path = tmp_path / "teeth.npz"
    path.write_text("radius,face\n1,2\n")
    with pytest.raises(gj.GearjaxError, match=r"no influence table \(no archive .npz of numpy\)$"):
        gj.read_influence(path, gear)


def changed_header(path, **changed):
    with np.load(path) as file:
        arrays = dict(file)
    arrays["header"] = np.array(json.dumps(json.loads(str(arrays["header"])) | changed))
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"units": {"radius": "mm"}}, "header has units"),
        ({"version": 2}, "header has version = 2; right is 1"),
        ({"made": {"rim": "2"}}, "sha256 does not match gear and made"),
        ({"gear": None}, "header has no gear"),
    ],
)
def test_headers_of_another_layout_are_refused(gear, table, tmp_path, changed, message):
    path = gj.save_influence(tmp_path / "teeth.npz", table, gear)
    changed_header(path, **changed)
    with pytest.raises(gj.GearjaxError, match=message):
        gj.read_influence(path, gear)


def spoilt(matrix, what):
    matrix = np.array(matrix)
    if what == "nan":
        matrix[1, 0, 0] = np.nan
    elif what == "uneven":
        matrix[0, 0, 1] *= 1.01
    elif what == "indefinite":
        matrix[0] -= 2 * np.linalg.eigvalsh(matrix[0])[0] * np.eye(len(matrix[0]))
    elif what == "shape":
        matrix = matrix[:, :-1]
    return matrix


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("nan", "matrix has numbers that are not finite"),
        ("uneven", r"matrix\[0\] is not symmetric"),
        ("indefinite", r"not positive definite, smallest eigenvalue -[0-9.]+e-"),
        ("shape", r"right are \(r,\), \(f,\)"),
    ],
)
def test_numbers_that_are_no_influence_are_refused(gear, table, tmp_path, what, message):
    path = tmp_path / "teeth.npz"
    write_arrays(path, gear, {}, np.asarray(table.radius), np.asarray(table.face), spoilt(table.matrix, what))
    with pytest.raises(gj.GearjaxError, match=f"teeth.npz: influence table: .*{message}"):
        gj.read_influence(path, gear)


def test_neighbours_that_outweigh_a_tooth_are_refused(table, gear):
    blocks = np.array(table.matrix)
    blocks[1] = 0.6 * blocks[0]
    with pytest.raises(gj.GearjaxError, match="not positive definite"):
        gj.InfluenceTable(table.radius, table.face, blocks, made_for=gear_hash(gear))


@pytest.mark.parametrize("read", [loads, loads_optimise, loads_tolerance])
def test_a_configuration_names_files_from_its_own_folder_on(read, tmp_path, monkeypatch):
    text = (ROOT / "configs" / "involute_rv" / "yang_2019.toml").read_text(encoding="utf-8")
    files = 'kind = "influence_matrix"\nexternal_file = "one.npz"\ninternal_file = "../other.npz"\n'
    monkeypatch.chdir("/")
    with pytest.raises(gj.GearjaxError) as caught:
        read(text.replace('kind = "elastic_teeth" ', files).replace("neighbours = 2 ", "layers = 13 "), tmp_path)
    assert str(tmp_path / "one.npz") in str(caught.value)
    assert "\n" not in str(caught.value)
