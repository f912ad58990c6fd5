"""A folder of results holds the results of one run of each command; ``gearjax show`` opens the last ones."""

import json
import os

import pytest

from gearjax.cli.written import NAME, Folder, replacing
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


def broken_off(folder, fault):
    """A command that ends while it writes."""
    with replacing(folder, "run", print) as new:
        new.add(made(new.folder, "a.csv"))
        raise fault


def test_new_results_come_all_together(tmp_path):
    said, out = [], tmp_path / "new" / "out"
    with replacing(out, "run", said.append) as new:
        new.add(made(new.folder, "a.csv", "joint/joint.xml"))
        assert [path.name for path in out.iterdir()] == [new.folder.name]
    assert said == [f"written to {out}: a.csv, joint.xml"]
    assert sorted(path.name for path in out.rglob("*")) == ["a.csv", "joint", "joint.xml", NAME]
    (out / "a.csv").write_text("old", encoding="utf-8")
    with pytest.raises(KeyboardInterrupt):
        broken_off(out, KeyboardInterrupt())
    assert (out / "a.csv").read_text(encoding="utf-8") == "old"
    assert sorted(path.name for path in out.rglob("*")) == ["a.csv", "joint", "joint.xml", NAME]
    made(out, ".run.1.part/b.csv", ".run.2.part/b.csv")  # of a process that was killed, and of one that is writing
    os.utime(out / ".run.1.part", (0.0, 0.0))
    with replacing(out, "run", said.append) as new:
        new.add(made(new.folder, "c.csv"))
    assert sorted(path.name for path in out.iterdir()) == [".run.2.part", "c.csv", "joint", NAME]
    assert said[1:] == [f"written to {out}: c.csv", "removed, of the gearjax run before: a.csv, joint/joint.xml"]


def test_nothing_is_left_of_a_folder_that_was_never_filled(tmp_path):
    with pytest.raises(ValueError, match="no figure"):
        broken_off(tmp_path / "new" / "out", ValueError("no figure"))
    assert list(tmp_path.iterdir()) == []


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
