"""Stored samples: what is damaged is noticed and worked out again, what is foreign is left alone."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from gearjax.checks import GearjaxError
from gearjax.config import loads_tolerance
from gearjax.results.further import Further
from gearjax.results.store import NAME, Store
from gearjax.results.tolerance import prepared
from tests.test_tolerance_command import command, small

SAMPLES, CHUNK = 21, 5


class Finished:
    """A finished study in a folder, and its numbers: worked out once, so that thousands of damages are tried soon."""

    def __init__(self, folder: Path, text: str):
        self.text = text
        self.tables, _, section = loads_tolerance(self.text)
        self.work, self.folder = prepared(section), folder
        self.chunks = dict(self.work.each(self.work.chunks))
        self.again(folder)
        self.values = np.concatenate([found[0] for found in self.chunks.values()])

    def again(self, folder: Path) -> Store:
        """A run of the study in a folder: what is missing is put there."""
        store = Store(folder, self.tables, self.work, self.text)
        for chunk in store.pending:
            store.put(chunk, self.chunks[chunk])
        return store

    def copied(self, folder: Path) -> Path:
        shutil.copytree(self.folder, folder)
        return folder


@pytest.fixture(autouse=True)
def hasty(monkeypatch):
    """Thousands of files need not reach the disk; that they would is tested with `gearjax.files`."""
    monkeypatch.setattr("os.fsync", lambda _: None)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Finished:
    return Finished(tmp_path_factory.mktemp("finished"), small(samples=SAMPLES, chunk=CHUNK))


def files(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / NAME).rglob("*") if path.is_file())


def flip(path: Path, _others: list[Path], rng: np.random.Generator) -> None:
    content = bytearray(path.read_bytes())
    content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
    path.write_bytes(content)


def truncate(path: Path, _others: list[Path], rng: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(len(content))])


def delete(path: Path, _others: list[Path], _rng: np.random.Generator) -> None:
    path.unlink()


def empty(path: Path, _others: list[Path], _rng: np.random.Generator) -> None:
    path.write_bytes(b"")


def zero(path: Path, _others: list[Path], _rng: np.random.Generator) -> None:
    path.write_bytes(bytes(path.stat().st_size))


def lengthen(path: Path, _others: list[Path], rng: np.random.Generator) -> None:
    path.write_bytes(path.read_bytes() + rng.bytes(int(rng.integers(1, 100))))


def swap(path: Path, others: list[Path], rng: np.random.Generator) -> None:
    other = others[rng.integers(len(others))]
    here, there = path.read_bytes(), other.read_bytes()
    path.write_bytes(there)
    other.write_bytes(here)


def duplicate(path: Path, others: list[Path], rng: np.random.Generator) -> None:
    path.write_bytes(others[rng.integers(len(others))].read_bytes())


def exchange_chunks(path: Path, _others: list[Path], rng: np.random.Generator) -> None:
    """Every file of one chunk and its mark in the place of another."""
    root = path.parents[next(i for i, level in enumerate(path.parents) if level.name == NAME)]
    first, second = rng.choice(SAMPLES // CHUNK, 2, replace=False)
    for array in root.iterdir():
        if array.is_dir() and (array / "c" / str(first)).exists() and (array / "c" / str(second)).exists():
            (array / "c" / str(first)).rename(array / "c" / "away")
            (array / "c" / str(second)).rename(array / "c" / str(first))
            (array / "c" / "away").rename(array / "c" / str(second))


def remove_folder(path: Path, _others: list[Path], _rng: np.random.Generator) -> None:
    if path.parent.name != NAME:
        shutil.rmtree(path.parent)


def add(path: Path, _others: list[Path], rng: np.random.Generator) -> None:
    (path.parent / f"extra{rng.integers(9)}").write_bytes(rng.bytes(20))


DAMAGES = (flip, truncate, delete, empty, zero, lengthen, swap, duplicate, exchange_chunks, remove_folder, add)


@pytest.mark.filterwarnings("ignore:Object at extra")  # as zarr says of what is none of its own
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
@pytest.mark.parametrize("kind", ["chunks", "metadata"])
def test_a_damaged_study_ends_with_the_same_numbers_or_a_line(finished, tmp_path, damage, kind):
    """Random damages of a kind, one to three at once: never other numbers, never another exception."""
    rng = np.random.default_rng(sum(damage.__name__.encode()))
    refused: list[str] = []
    for trial in range(12):
        folder = finished.copied(tmp_path / str(trial))
        for _ in range(rng.integers(1, 4)):
            there = [path for path in files(folder) if (path.name == "zarr.json") == (kind == "metadata")]
            if there:
                damage(there[rng.integers(len(there))], there, rng)
        try:
            finished.again(folder)
        except GearjaxError as fault:
            refused.append(str(fault))
            continue
        values, codes = Store(folder, finished.tables, finished.work, "").load()
        np.testing.assert_array_equal(values, finished.values)
        assert (codes == 0).all()
        with xr.open_zarr(folder / NAME, consolidated=False, chunks=None) as known:  # healed for others too
            for column, name in enumerate(finished.work.names):
                np.testing.assert_array_equal(known[name].values, finished.values[:, column])
    assert kind == "metadata" or not refused
    for line in refused:  # what a group says that it is of may be that of another
        assert "\n" not in line
        assert "not a study of gearjax" in line or "holds another study" in line


def test_what_is_damaged_is_told(finished, tmp_path):
    folder = finished.copied(tmp_path / "out")
    assert Store(folder, finished.tables, finished.work, "").remarks == []
    name = finished.work.names[0]
    flip(folder / NAME / name / "c" / "1", [], np.random.default_rng(1))
    (folder / NAME / "result" / "c" / "4").unlink()
    store = Store(folder, finished.tables, finished.work, "")
    assert store.pending == [(5, 10), (20, 21)]
    assert "2 of 5 chunks are damaged or missing: 6 samples are computed again" in store.remarks[0]
    (folder / NAME / name / "zarr.json").write_text("{")
    assert "metadata were damaged" in Store(folder, finished.tables, finished.work, "").remarks[0]
    for content in ("", "{", None):  # whose samples these are, their marks tell too
        (folder / NAME / "zarr.json").unlink()
        if content is not None:
            (folder / NAME / "zarr.json").write_text(content)
        assert "metadata were damaged" in Store(folder, finished.tables, finished.work, "").remarks[0]


def test_all_chunks_exist_also_those_equal_to_what_zarr_fills_in(finished, tmp_path):
    store = Store(tmp_path / "out", finished.tables, finished.work, "")
    nothing = np.full((CHUNK, len(store.work.names)), np.nan), np.full(CHUNK, -1, np.int32)
    store.put((0, CHUNK), nothing)
    for name in (*store.work.names, "result", "done"):
        assert (tmp_path / "out" / NAME / name / "c" / "0").is_file()
    again = Store(tmp_path / "out", finished.tables, finished.work, "")
    assert again.done.tolist() == [True, False, False, False, False]
    shutil.rmtree(tmp_path / "out" / NAME / "result" / "c")
    assert Store(tmp_path / "out", finished.tables, finished.work, "").samples_done == 0


@pytest.mark.slow
def test_a_chunk_of_another_study_is_not_taken(finished, tmp_path):
    text = finished.text.replace("seed = 0", "seed = 1", 1)
    other = Finished(tmp_path / "other", text)
    folder = finished.copied(tmp_path / "out")
    for name in (*other.work.names, "result", "done"):
        shutil.copy(other.folder / NAME / name / "c" / "2", folder / NAME / name / "c" / "2")
    assert Store(folder, finished.tables, finished.work, "").pending == [(10, 15)]


def test_a_study_belongs_to_the_contents_of_the_files_it_names(finished, tmp_path):
    table = tmp_path / "external.npz"
    named = {"kind": "influence_matrix", "external_file": str(table), "internal_file": str(tmp_path / "missing.npz")}
    tables = finished.tables | {"compliance": named}
    table.write_bytes(b"one")
    Store(tmp_path / "out", tables, finished.work, "")
    Further(tmp_path / "out", tables).get("kept", lambda: {"from": "one"})
    Store(tmp_path / "out", tables, finished.work, "")
    assert Further(tmp_path / "out", tables).get("kept", lambda: {"from": "other"}) == {"from": "one"}
    table.write_bytes(b"other")
    with pytest.raises(GearjaxError, match=r"another study \(contents of compliance.external_file: .* there, .* now"):
        Store(tmp_path / "out", tables, finished.work, "")
    assert Further(tmp_path / "out", tables).get("kept", lambda: {"from": "other"}) == {"from": "other"}


def test_what_changes_while_a_run_works_is_noticed_at_its_end(finished, tmp_path):
    folder = finished.copied(tmp_path / "out")
    store = Store(folder, finished.tables, finished.work, "")
    flip(folder / NAME / finished.work.names[1] / "c" / "3", [], np.random.default_rng(0))
    with pytest.raises(GearjaxError, match="samples 15 to 19 were damaged during this run"):
        store.load()


def test_a_study_opens_with_xarray(finished):
    with xr.open_zarr(finished.folder / NAME, consolidated=False, chunks=None) as known:
        for column, name in enumerate(finished.work.names):
            assert known[name].attrs["units"] == "rad"
            np.testing.assert_array_equal(known[name].values, finished.values[:, column])
        assert known["result"].values.tolist() == [0] * SAMPLES
        assert (known["done"].values != 0).all()
        assert known.attrs["config"] == finished.text


def test_the_text_inside_is_that_of_the_last_run(finished, tmp_path):
    folder = finished.copied(tmp_path / "out")
    assert Store(folder, finished.tables, finished.work, "new limits").remarks == []
    assert json.loads((folder / NAME / "zarr.json").read_text())["attributes"]["config"] == "new limits"


@pytest.mark.parametrize("foreign", ["group", "empty", "file", "old", "dangling"])
def test_what_is_foreign_is_refused_and_left_as_it_is(finished, tmp_path, foreign):
    path = tmp_path / NAME
    if foreign == "group":
        xr.Dataset({"te": ("time", np.arange(3.0))}).to_zarr(path, consolidated=False)
    elif foreign == "old":
        xr.Dataset({"te": ("time", np.arange(3.0))}).to_zarr(path, consolidated=False, zarr_format=2)
    elif foreign == "empty":
        path.mkdir()
    elif foreign == "file":
        path.write_text("mine")
    else:
        path.symlink_to(tmp_path / "nowhere")
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    with pytest.raises(GearjaxError, match="not a study of gearjax: choose another"):
        Store(tmp_path, finished.tables, finished.work, "")
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


def test_samples_of_another_version_are_another_study(finished, monkeypatch):
    monkeypatch.setattr("gearjax.__version__", "0.0.1")
    with pytest.raises(GearjaxError, match=r'another study \(gearjax: ".*" there, "0.0.1" now\)'):
        Store(finished.folder, finished.tables, finished.work, "")


@pytest.mark.slow
def test_the_command_says_what_it_works_out_again(tmp_path, capsys):
    config, out = tmp_path / "study.toml", tmp_path / "out"
    config.write_text(small(samples=130), encoding="utf-8")
    assert command(str(config), "--out", str(out), "--json") == 0
    first = json.loads(capsys.readouterr().out)
    name = "no_load.peak_to_peak"
    (out / NAME / name / "c" / "1").unlink()
    assert command(str(config), "--out", str(out), "--json") == 0
    printed = capsys.readouterr()
    again = json.loads(printed.out)
    assert (again["computed"], again["measures"]) == (64, first["measures"])
    assert "1 of 3 chunks are damaged or missing: 64 samples are computed again" in printed.err
