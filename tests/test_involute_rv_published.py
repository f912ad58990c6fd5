"""Yang, Tang and Liang (2019): what `gearjax reproduce involute_rv` prints, and the methods behind it."""

import json
import math
import sys
import time

import jax
import numpy as np
import pytest

import gearjax as gj
from gearjax.cli import main
from gearjax.cli.commands import _papers
from gearjax.plot import figures_kept
from gearjax.reproduce import NAMES, PAPERS, involute_rv
from gearjax.reproduce import involute_rv_methods as methods
from gearjax.reproduce import involute_rv_pair as own
from gearjax.reproduce.figures import save_deviations_figure
from gearjax.reproduce.rows import Row
from gearjax.units import mm, um
from tests import involute_pair
from tests.validation import assert_shown


@pytest.fixture(scope="module")
def elements():
    """Tables of both gears by depth of the rim, worked out once, and the processor time that the first took [s]."""
    start = time.process_time()
    found = {own.RIM: involute_pair.tables(own.RIM)}
    spent = time.process_time() - start
    found[involute_rv.OTHER_RIM] = involute_pair.tables(involute_rv.OTHER_RIM)
    return found, spent


@pytest.fixture(scope="module")
def rows(elements):
    """Those of the command, with tables that `test_tables_are_those_written_out_apart` holds to be its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(involute_rv, "tables", lambda rim=own.RIM: elements[0][rim])
        return involute_rv.rows()


@pytest.fixture(scope="module")
def by_item(rows):
    found = {row.item: row for row in rows}
    assert len(found) == len(rows)
    return found


# fast


@pytest.mark.slow
def test_candidates_are_those_written_out_apart():
    """At equal distances from tip circle to tip circle; `tests.involute_pair` finds gaps by another geometry."""
    points, pair = own.candidates(), own.pair()
    assert points.tooth.size == 1274
    for tooth, number in own.POINTS.items():
        radius, mate, gap = (
            part[points.tooth == tooth].reshape(number, -1)[:, 3] for part in (points.radius, points.mate, points.gap)
        )
        assert mate[0] == pytest.approx(float(pair.internal.tip_radius), rel=1e-10)
        assert radius[-1] == pytest.approx(float(pair.external.tip_radius), rel=1e-12)
        np.testing.assert_allclose(np.diff(radius), np.diff(radius).mean(), rtol=1e-9)
        if tooth in (13, 18):
            apart = involute_pair.opposite(tooth, radius, own.PHASE)
            np.testing.assert_allclose(gap, apart[0], atol=1e-12)
            np.testing.assert_allclose(mate, apart[1], rtol=1e-10)


def test_points_of_tables_7_and_8_are_ours():
    """Radii to what is printed, so that the points stand where those of the paper do."""
    points = own.candidates()
    listed = involute_rv._points()
    assert len(listed) == 27
    for point in listed:
        at = [involute_rv._nearest(points, point, column) for column in (0, 1)]
        assert at[0] == at[1]
        assert points.radius[at[0]] / mm == pytest.approx(float(point.radius[0]), abs=0.0065)
        assert points.mate[at[0]] / mm == pytest.approx(float(point.radius[1]), abs=0.0065)
        assert points.face[at[0]] / mm == pytest.approx(point.face[0], abs=1e-9)


def test_tables_are_those_written_out_apart(monkeypatch):
    """The same elements are asked for."""
    asked: list[dict] = []

    def asking(gear, **chosen):
        asked.append({"gear": gear} | chosen)
        return object.__new__(gj.InfluenceTable)

    for module in (gj, own):
        monkeypatch.setattr(module, "tooth_influence", asking)
    for make in (own.tables, involute_pair.tables):
        make(0.8 * mm)
    meeting = {"meeting": (0.0, 6.5 * mm)}  # of the external gear its whole face, which is what is meant without
    for one, other in zip(asked[:2], asked[2:], strict=True):
        other = meeting | other
        assert one.keys() == other.keys()
        numbers = [np.hstack([np.ravel(leaf) for leaf in jax.tree.leaves(each)]) for each in (one, other)]
        np.testing.assert_allclose(*numbers, rtol=1e-12)
        assert one["gear"].teeth == other["gear"].teeth


@pytest.mark.slow
def test_gaps_are_those_of_the_phase():
    """What the initial clearances of teeth 13 to 21 are, the least over each flank."""
    teeth = involute_pair.POINTS
    gaps = [
        involute_pair.opposite(tooth, involute_pair.own_points(tooth, own.PHASE), own.PHASE)[0].min() / um
        for tooth in teeth
    ]
    assert gaps == pytest.approx([3.724, 1.829, 0.593, 0.033, 0, 0.153, 1.012, 2.646, 5.077], abs=3e-3)


@pytest.mark.slow
def test_two_dimensional_loads_are_those_of_springs_side_by_side():
    """Eq. (9) says that all pairs approach alike; the seven loads of Table 2 add up to T / r_b1."""
    pairs = methods.pair_stiffness()
    loads = methods.two_dimensional(pairs, own.total_load())
    assert loads.sum() == pytest.approx(1554.906, abs=1e-3)
    carry = loads > 0
    assert list(pairs.tooth[carry]) == [20, 19, 18, 17, 16, 15, 14]
    approach = loads / pairs.stiffness + pairs.clearance
    np.testing.assert_allclose(approach[carry], approach[carry][0], rtol=1e-12)
    assert (pairs.clearance[~carry] > approach[carry][0]).all()


@pytest.mark.slow
def test_table_2_comes_out_with_nothing_fitted_to_it():
    found = {row.item: row for row in involute_rv._table_2()}
    assert found["Table 2, rms of the loads"].computed == pytest.approx(3.82, abs=0.01)
    assert all(row.status == "inferred" for item, row in found.items() if "tooth" in item)


@pytest.mark.slow
def test_the_validation_page_shows_them(rows):
    assert_shown("involute_rv", rows)


def test_the_linear_programme_finds_forces_and_approach(rng):
    """Of points on a soft bed, some of them far away: solved by hand with the points that carry."""
    place = np.arange(24)
    influence = 1e-9 * (np.exp(-np.abs(place[:, None] - place) / 3) + 0.5 * np.eye(24))
    gap = 1e-6 * rng.uniform(0, 4, 24)
    found = methods.by_programme(influence, gap, 3000.0)
    carry = found.forces > 0
    assert 3 < carry.sum() < 24
    assert found.forces.sum() == pytest.approx(3000, rel=1e-9)
    opening = influence @ found.forces + gap - found.approach
    np.testing.assert_allclose(opening[carry], 0, atol=1e-15)
    assert (opening[~carry] > -1e-15).all()


def test_a_paper_whose_extra_is_missing_says_so_in_a_line(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(SystemExit, match="2"):
        main(["reproduce", "involute_rv"])
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith("gearjax: error: ")
    assert told.endswith("needs the extra fem: pip install 'gearjax[fem]'")


def test_the_command_offers_every_paper(capsys):
    assert _papers("in") == ["involute_rv"]
    assert _papers("") == list(PAPERS) == list(NAMES)
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "--help"])
    assert "two_kv, rv_cycloidal, involute_rv" in " ".join(capsys.readouterr().out.split())


def test_papers_without_extras_are_reproduced_all_the_same(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "skfem", None)
    others = [name for name in PAPERS if name != "involute_rv"]
    for name in others:
        monkeypatch.setitem(PAPERS, name, PAPERS[name]._replace(rows=lambda _: [Row("item", "1", 1.0, "N", 0.1)]))
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "--json"])
    printed = capsys.readouterr()
    assert len(json.loads(printed.out)["papers"]) == len(others) == 4
    assert "left out: Yang, Tang, Liang (2019)" in printed.err
    assert "gearjax[fem]" in printed.err


def test_square_brackets_are_printed_as_they_are(monkeypatch, capsys, tmp_path):
    odd = Row("Table [a], load [N]", "1", 1.5, "[bold]", 0.1, why="in [mm], see [1] and :smile: of [/dim] it")
    bare = Row("alone", "", 2.0, "N", 0.0, why="not printed")
    monkeypatch.setitem(PAPERS, "two_kv", PAPERS["two_kv"]._replace(title="Paper [x]", rows=lambda _: [odd, bare]))
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "two_kv", "--out", str(tmp_path)])
    printed = capsys.readouterr()
    for words in ("Paper [x]", "Table [a], load [N]", "[bold]", "in [mm], see [1] and :smile: of [/dim] it"):
        assert words in printed.out
    assert "computing: Paper [x]" in printed.err
    assert (tmp_path / "published.csv").read_text().splitlines()[-1] == '"Paper [x]","alone",,2,,N,not published'
    assert (tmp_path / "two_kv_deviations.png").stat().st_size > 10_000


def test_deviations_are_drawn_over_the_published_values_beside_their_limits(tmp_path):
    rows = [
        Row("within", "2.0", 2.1, "N", 0.2),
        Row("beyond", "-4.0", -3.0, "N", 0.2),
        Row("inferred beyond", "1.0", 1.5, "N", 0.2, inferred=True),
        Row("printed as zero", "0", 1.0, "N", 0.2),
        Row("not computed", "1.0", math.nan, "N", 0.2),
        Row("not printed", "", 1.0, "N", 0.2),
    ]
    with figures_kept() as figures:
        save_deviations_figure("a paper", rows, tmp_path / "a.png")
    (ax,) = figures["a.png"].axes
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["within", "beyond", "inferred beyond"]
    points = {line.get_label(): line.get_xydata().tolist() for line in ax.lines if len(line.get_xdata()) == 1}
    assert points == {
        "reproduced": [[pytest.approx(5.0), 0.0]],
        "not reproduced": [[pytest.approx(25.0), 1.0]],
        "inferred": [[pytest.approx(50.0), 2.0]],
    }
    low, high = ([bar.get_width() for bar in bars] for bars in ax.containers)
    assert low == pytest.approx([-10.0, -5.0, 0.0])
    assert high == pytest.approx([10.0, 5.0, 0.0])


# slow: finite elements


@pytest.mark.slow
@pytest.mark.runs_long
def test_loads_written_out_apart_are_those_of_table_5(elements):
    """Gaps and loads of `tests.involute_pair`."""
    both, spent = elements[0][own.RIM], elements[1]
    found, approach = involute_pair.loads(both)
    assert involute_pair.deviation(found) < 1.0
    assert found.sum() == pytest.approx(1554.9, abs=0.05)
    assert found[[0, 7, 8]] == pytest.approx(0, abs=1e-9)  # teeth 13, 20 and 21 carry nothing
    assert approach == pytest.approx(2.43 * um, abs=0.03 * um)
    assert involute_pair.deviation(involute_pair.loads(both, 0.38)[0]) > 2.0  # the phase counts
    assert involute_pair.deviation(involute_pair.loads(elements[0][0.8 * mm])[0]) > 2.0  # the depth of the rim counts
    assert spent < 60  # CPU seconds: 16 on an idle machine


@pytest.mark.slow
@pytest.mark.runs_long
def test_loads_of_table_5(by_item):
    assert by_item["Table 5, sum of the loads"].computed == pytest.approx(1554.906, abs=1e-3)
    for tooth in (14, 15, 16, 17, 18, 19):
        assert abs(by_item[f"Table 5, tooth {tooth}"].deviation) < 1.0
        assert abs(by_item[f"Table 5, ANSYS, tooth {tooth}"].deviation) < 3.0
        assert by_item[f"Table 5, tooth {tooth}"].status == "inferred"  # two numbers are fitted
    assert all(by_item[f"Table 5, unloaded, tooth {tooth}"].computed == 0 for tooth in (13, 20, 21))
    told = "Table 5, rim {} mm, phase 0.3417, rms of the loads"
    assert by_item[told.format(0.72)].computed == pytest.approx(0.38, abs=0.02)
    assert by_item[told.format(0.8)].computed == pytest.approx(2.44, abs=0.05)


@pytest.mark.slow
@pytest.mark.runs_long
def test_what_the_loads_owe_to_the_fitted_numbers(by_item):
    for name, low, high in (("per 0.01 of the phase", -1.68, 1.97), ("per 0.1 mm of rim", -3.92, 4.06)):
        changes = [row.computed for item, row in by_item.items() if f"change {name}" in item]
        assert len(changes) == 6
        assert min(changes) == pytest.approx(low, abs=0.05)
        assert max(changes) == pytest.approx(high, abs=0.05)
        assert sum(changes) == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.runs_long
def test_the_programme_of_the_paper_gives_our_forces(by_item):
    assert by_item["Eqs. (3) and (4), linear programme against ours"].computed < 1e-7


@pytest.mark.slow
@pytest.mark.runs_long
def test_forces_at_points(by_item):
    for table in ("Table 7", "Table 8"):
        own_rows = [row for item, row in by_item.items() if item.startswith(f"{table}, tooth")]
        assert len(own_rows) == 27
        assert sum(row.status == "not reproduced" for row in own_rows) == 13
        assert by_item[f"{table}, rms of the forces"].computed == pytest.approx(0.123, abs=0.002)
    assert by_item["Text, points in contact"].status == "not reproduced"


@pytest.mark.slow
@pytest.mark.runs_long
def test_figure_and_json(rows, monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(PAPERS, "involute_rv", PAPERS["involute_rv"]._replace(rows=lambda _: rows))
    with pytest.raises(SystemExit, match="0"):
        main(["reproduce", "involute_rv", "--json", "--out", str(tmp_path)])
    printed = json.loads(capsys.readouterr().out)
    assert len(printed["rows"]) == len(rows)
    written = ["involute_rv_deviations.png", "involute_rv_loads.png", "published.csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == written
    assert (tmp_path / "involute_rv_loads.png").stat().st_size > 10_000
