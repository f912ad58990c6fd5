"""The trade-off report: what it measures, what it recommends, and what it refuses."""

import json

import pytest

from gearjax.config import loads
from gearjax.studies.tradeoff import accurate_step, tradeoff
from gearjax.units import arcmin
from tests.test_cli import command


@pytest.fixture
def short(config_text, tmp_path):
    """The reducer over 0.2 s under one torque, from a file."""
    text = config_text.replace('duration = "3 s"', 'duration = "0.2 s"').replace("samples = 3001", "samples = 201")
    text = text.replace('["30 N*m", "100 N*m", "300 N*m"]', '["100 N*m"]').split("[[published]]")[0]
    path = tmp_path / "short.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_tradeoff(short, tmp_path, capsys):
    code, out, _ = command(capsys, "tradeoff", short, "--error", "0.01", "--out", tmp_path / "out", "--json")
    assert code == 0
    found = json.loads(out)
    rows = {f"{row['group']}: {row['name']}": row for row in found["settings"]}
    assert {row["group"] for row in found["settings"]} == {
        "solver",
        "contact",
        "samples",
        "harmonics",
        "fidelity",
        "precision",
    }
    errors = [rows[f"solver: fitted, {size} rad"]["error_arcmin"] for size in ("0.8", "0.2", "0.05")]
    assert errors[2] < errors[1] < errors[0]
    assert rows["contact: softplus, 1 um"]["error_arcmin"] > rows["contact: softplus, 0.01 um"]["error_arcmin"]
    assert rows["fidelity: quasi-static"]["gradient_seconds"] > 0
    best = rows[found["recommended"]]
    good = [row for row in found["settings"] if row["error_arcmin"] <= 0.01]
    assert best["seconds"] == min(row["seconds"] for row in good)
    for name in ("tradeoff.csv", "tradeoff.png"):
        assert (tmp_path / "out" / name).stat().st_size > 500


@pytest.mark.slow
def test_accuracy(short):
    """A stricter accuracy takes shorter steps; one that no step reaches is refused."""
    scene = loads(short.read_text(encoding="utf-8"))
    coarse, fine = (accurate_step(scene, error * arcmin) for error in (1e-2, 1e-5))
    assert fine.step < coarse.step


@pytest.mark.parametrize("option", [["--error", "0"], ["--error", "nan"]])
def test_wrong_errors(short, capsys, option):
    code, _, err = command(capsys, "tradeoff", short, *option)
    assert code == 2
    assert "--error" in err


def test_nothing_dynamic(scene):
    with pytest.raises(ValueError, match=r'must list "dynamic"'):
        tradeoff(scene, 1e-6)
