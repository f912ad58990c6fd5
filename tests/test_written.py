"""A folder of results holds the results of one run of each command; ``gearjax show`` opens the last ones."""

import json

import pytest

from gearjax.cli.written import NAME, Folder
from tests.test_cli import command


def made(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("x", encoding="utf-8")
    return [folder / name for name in names]


def test_what_only_the_run_before_wrote_is_removed(tmp_path):
    assert Folder(tmp_path).keep("run", made(tmp_path, "a.csv", "pair.png", "report.html")) == [
        f"written to {tmp_path}: a.csv, pair.png, report.html"
    ]
    Folder(tmp_path).keep("identify", made(tmp_path, "report.html", "joint/joint.xml"))
    made(tmp_path, "of_the_user.png")
    lines = Folder(tmp_path).keep("run", made(tmp_path, "a.csv"))
    assert lines[1:] == ["removed, of the gearjax run before: pair.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.csv",
        "joint",
        "of_the_user.png",
        "report.html",
        NAME,
    ]
    assert Folder(tmp_path).last == "run"
    assert Folder(tmp_path).of("report.html") == "identify"
    assert Folder(tmp_path).keep("identify", made(tmp_path, "report.html"))[1:] == [
        "removed, of the gearjax identify before: joint/joint.xml"
    ]


@pytest.mark.parametrize("text", ["", "[]", '{"run": 1}', '{"run": ["../outside"]}', "\x00"])
def test_a_note_that_is_not_ours_removes_nothing(tmp_path, text):
    outside = tmp_path / "outside"
    outside.write_text("kept", encoding="utf-8")
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / NAME).write_text(text, encoding="utf-8")
    assert len(Folder(folder).keep("run", made(folder, "a.csv"))) == 1
    assert outside.exists()
    assert json.loads((folder / NAME).read_text(encoding="utf-8"))["run"] == ["a.csv"]


def test_show_opens_no_report_of_another_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gearjax.cli.show._has_display", lambda: False)
    Folder(tmp_path).keep("run", made(tmp_path, "report.html", "a.png"))
    assert command(capsys, "show", tmp_path)[1].split() == [str(tmp_path / "report.html")]
    Folder(tmp_path).keep("identify", made(tmp_path, "b.png"))
    _, out, err = command(capsys, "show", tmp_path)
    assert out.split() == [str(tmp_path / name) for name in ("a.png", "b.png")]
    assert "report.html is of gearjax run, and gearjax identify wrote here last" in err
