"""Files of measuring machines: rows in any order, gaps, outliers, faults, and configurations that name them."""

import warnings

import jax
import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.checks import GearjaxError, ParameterError
from gearjax.units import um
from tests.conftest import ROOT
from tests.helical_pairs import meshes_of

MEASURED = ROOT / "configs" / "helical" / "guo_2018_measured.toml"
HEADER = "tooth,flank,roll [mm],across [mm],deviation [um]"


def rows_of(teeth=(0, 4), flanks=("driving",), rows=6, columns=5):
    """Rows of a file, of a smooth flank."""
    return [
        [str(tooth), flank, f"{roll:g}", f"{across:g}", f"{tooth + 0.1 * (roll - 15) ** 2 + 0.2 * across:.4f}"]
        for tooth in teeth
        for flank in flanks
        for roll in np.linspace(6, 30, rows)
        for across in np.linspace(-30, 30, columns)
    ]


def written(folder, rows, header=HEADER, name="flank.csv"):
    path = folder / name
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n", encoding="utf-8")
    return path


def test_rows_come_in_any_order(tmp_path, rng):
    rows = rows_of()
    plain = gj.read_flank(written(tmp_path, rows), "driving")
    shuffled = [rows[place] for place in rng.permutation(len(rows))]
    again = gj.read_flank(written(tmp_path, shuffled, name="shuffled.csv"), "driving")
    for key in ("roll", "across", "deviation", "teeth"):
        np.testing.assert_array_equal(plain[key], again[key])
    flank = gj.MeasuredFlank("pinion", **plain)
    assert flank.grid.shape == (2, 6, 5)
    np.testing.assert_allclose(flank.grid[1, :, 0], (4 + 0.1 * (np.linspace(6, 30, 6) - 15) ** 2 - 6) * um, atol=1e-10)
    np.testing.assert_array_equal(flank.teeth, [0, 4])


def test_columns_may_be_left_out_and_have_any_unit(tmp_path):
    path = written(tmp_path, [["10", "0.5"], ["20", "1.5"]], "roll (mm), deviation [1e-6 m]".replace("1e-6 m", "µm"))
    read = gj.read_flank(path)
    np.testing.assert_allclose(read["deviation"], [0.5e-6, 1.5e-6])
    np.testing.assert_array_equal(read["across"], [0.0])
    assert read["teeth"].size == 0


def test_missing_points_are_filled_in_and_told(tmp_path):
    rows = rows_of()
    whole = gj.read_flank(written(tmp_path, rows), "driving")["deviation"]
    rows[7][-1], rows[12][-1] = "", "nan"
    del rows[3]
    with pytest.warns(gj.RepairedData, match="3 of 60 points are missing: they are filled in"):
        filled = gj.read_flank(written(tmp_path, rows), "driving")["deviation"]
    assert np.isfinite(filled).all()
    np.testing.assert_allclose(filled, whole, atol=2.5 * um)  # of flanks that change by 10 um from row to row
    assert (filled != whole).sum() == 3


def test_gaps_are_filled_in_by_places(tmp_path):
    """A straight line on uneven places, with gaps within and at its end: filled exactly, and nothing stands out."""
    places = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 30, 31, 40]
    rows = [[f"{place}", "" if place in (30, 40) else f"{2 * place}"] for place in places]
    with pytest.warns(gj.RepairedData, match="2 of 20 points are missing") as told:
        read = gj.read_flank(written(tmp_path, rows, "roll [mm],deviation [um]"))
    np.testing.assert_allclose(read["deviation"], 2 * np.array(places) * um, rtol=1e-12)
    assert len(told) == 1


def test_outliers_are_told(tmp_path):
    rows = rows_of()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gj.read_flank(written(tmp_path, rows), "driving")
    rows[17][-1] = "80"
    with pytest.warns(gj.RepairedData, match="1 of 60 points are outliers, up to"):
        gj.read_flank(written(tmp_path, rows), "driving")


def test_a_tooth_far_from_its_neighbours_is_told(tmp_path):
    """Also the first and the last tooth, which are neighbours; scatter of every size is no outlier."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        waves = 15 * np.sin(2 * np.pi * np.arange(47) / 47 + seed) + rng.uniform(0.5, 3) * rng.standard_normal(47)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            gj.read_pitch(_pitch(tmp_path, waves))
        tooth = (0, 20, 46)[seed % 3]
        waves[tooth] += 120
        with pytest.warns(gj.RepairedData, match=f"tooth {tooth} is 1[0-9][0-9] um beside its neighbours"):
            assert gj.read_pitch(_pitch(tmp_path, waves))["deviation"][tooth] == pytest.approx(1e-6 * waves[tooth])


def _pitch(folder, waves):
    return written(
        folder, [[str(tooth), repr(float(each))] for tooth, each in enumerate(waves)], "tooth,cumulative [um]"
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: [*rows, rows[3]], r"line 62: repeats a point of an earlier line"),
        (lambda rows: rows[::2], "more than a tenth"),
        (lambda rows: [*rows[:5], ["0", "driving", "7", "-30", "two"], *rows[5:]], "line 7, column 5: is no number"),
        (lambda rows: [["-1", *row[1:]] for row in rows], "line 2, column 1: must be the number of a tooth"),
        (lambda rows: [["1e12", *row[1:]] for row in rows], "line 2, column 1: must be the number of a tooth"),
        (lambda rows: [[*row[:2], "1e308", *row[3:]] for row in rows], "line 2, column 3: is more than 10 m"),
        (lambda rows: [[row[0], "left", *row[2:]] for row in rows], "line 2, column 2: must be driving or back"),
        (lambda rows: [row[:4] for row in rows], "line 2 has 4 values"),
        (lambda _: [], "no rows"),
        (lambda rows: rows[:1], "has one point of a flank: a form needs at least two"),
    ],
)
def test_files_with_faults_are_refused_in_one_line(tmp_path, change, words):
    with pytest.raises(GearjaxError, match=words) as caught:
        gj.read_flank(written(tmp_path, change(rows_of())), "driving")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("tooth,flank,roll,across [mm],deviation [um]", r"roll needs its unit, such as roll \[um\]"),
        ("tooth,flank,roll [mm],across [mm],deviation [N]", "is a force; needs a length"),
        ("tooth,flank,roll [mm],across [mm],depth [um]", "column 5 is not known"),
        ("tooth,flank,roll [mm],roll [mm],deviation [um]", "two columns are named roll"),
    ],
)
def test_columns_that_are_not_known_are_refused(tmp_path, header, words):
    with pytest.raises(GearjaxError, match=words):
        gj.read_flank(written(tmp_path, rows_of(), header), "driving")


def test_a_file_without_a_column_is_refused(tmp_path):
    with pytest.raises(GearjaxError, match="must name a column deviation"):
        gj.read_flank(written(tmp_path, [["1"]], "roll [mm]"))
    with pytest.raises(GearjaxError, match="cannot be read"):
        gj.read_flank(tmp_path / "none.csv")
    with pytest.raises(ParameterError, match='must be "driving" or "back"'):
        gj.read_flank(written(tmp_path, rows_of(flanks=("driving", "back"))))
    with pytest.raises(ParameterError, match='must be "driving" or "back"'):  # of one kind too
        gj.read_flank(written(tmp_path, rows_of()))
    with pytest.raises(GearjaxError, match="separated by commas"):
        gj.read_flank(written(tmp_path, [["10;1"]], "roll [mm];deviation [um]"))
    with pytest.raises(GearjaxError, match="has no rows of the back flank"):
        gj.read_flank(written(tmp_path, rows_of()), "back")


def test_pitches_of_files(tmp_path):
    path = written(tmp_path, [["1", "2"], ["0", "0"], ["2", "-1"]], "tooth,cumulative [um]")
    np.testing.assert_allclose(gj.read_pitch(path)["deviation"], [0.0, 2e-6, -1e-6])
    path = written(tmp_path, [["0", "2"], ["1", "-3"], ["2", "1"]], "tooth,single [um]")
    np.testing.assert_allclose(gj.read_pitch(path)["deviation"], [0.0, 2e-6, -1e-6], atol=1e-18)
    path = written(tmp_path, [["0", "3"], ["1", "-2"], ["2", "2"]], "tooth,single [um]")
    with pytest.warns(gj.RepairedData, match="add up to 3 um"):
        np.testing.assert_allclose(gj.read_pitch(path)["deviation"], [0.0, 2e-6, -1e-6], atol=1e-18)
    for rows, header, words in (
        ([["0", "1"], ["2", "1"]], "tooth,single [um]", "tooth 1 is missing: give all teeth from 0 to 2"),
        ([["0", "1"], ["0", "1"]], "tooth,single [um]", "line 3: repeats a tooth of"),
        ([["0"]], "tooth", "cumulative .um. or single"),
        ([["0", "1", "1"]], "tooth,single [um],cumulative [um]", "must name either cumulative"),
    ):
        with pytest.raises(GearjaxError, match=words):
            gj.read_pitch(written(tmp_path, rows, header))


@pytest.mark.slow
def test_configurations_name_files(tmp_path):
    """Next to the configuration, in the same numbers as by hand; faults by the section that names the file."""
    tables = gj.config.read_tables(MEASURED.read_text(encoding="utf-8"))
    tables["errors"] = {"m": {"kind": "measured_flank", "body": "pinion", "file": "flank.csv", "flank": "driving"}}
    path = written(tmp_path, rows_of())
    (tmp_path / "pair.toml").write_text(tomli_w.dumps(tables), encoding="utf-8")
    error = gj.load(tmp_path / "pair.toml").errors["m"]
    by_hand = gj.MeasuredFlank("pinion", **gj.read_flank(path, "driving"))
    for found, expected in zip(jax.tree.leaves(error), jax.tree.leaves(by_hand), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-14)
    again = gj.loads(gj.config.self_contained(tomli_w.dumps(tables), tmp_path)).errors["m"]
    np.testing.assert_array_equal(again.deviation, error.deviation)
    for change, words in (
        ({"file": "other.csv"}, "errors.m: file: .*cannot be read"),
        ({"file": 3}, "errors.m.file = 3"),
        ({"roll": ["1 mm"]}, "errors.m.roll .*in the file too"),
        ({"flank": "back"}, "errors.m: file: .*no rows of the back"),
    ):
        tables["errors"]["m"] = tables["errors"]["m"] | {"file": "flank.csv", "flank": "driving"} | change
        with pytest.raises(GearjaxError, match=words):
            gj.loads(tomli_w.dumps(tables), tmp_path)
        tables["errors"]["m"].pop("roll", None)


@pytest.mark.slow
def test_points_of_a_grid_are_numbers_like_others(tmp_path):
    """Sensitivity to a point that a file holds, and the configuration with another one."""
    scene = gj.load(MEASURED)
    around = gj.local_sensitivity(
        "static_peak_to_peak",
        scene,
        where=["errors.pinion_flank.deviation[97]"],
        bounds={"errors.pinion_flank.deviation[97]": (-20 * um, 20 * um)},
        theta=meshes_of(scene.system, 21),
        torque=830.0,
    )
    assert np.isfinite(around.gradient).all()
    text, path = MEASURED.read_text(encoding="utf-8"), "errors.pinion_flank.deviation[97]"
    changed = gj.config.with_numbers(text, {path: 5 * um}, {path: _declared(scene)}, MEASURED.parent)
    again = gj.loads(changed, tmp_path).errors["pinion_flank"]
    assert float(again.deviation[97]) == pytest.approx(5 * um)
    np.testing.assert_allclose(np.delete(again.deviation, 97), np.delete(scene.errors["pinion_flank"].deviation, 97))


def _declared(scene):
    from gearjax.parameters import declared

    return declared(scene.errors["pinion_flank"])["deviation"]
