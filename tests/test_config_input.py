"""Missing keys, names, files and columns: what is refused, and what its one line says."""

import os
import subprocess
import sys

import pytest

import gearjax as gj
from gearjax.checks import check_name
from gearjax.cli import main
from gearjax.config import loads_optimise, loads_tolerance
from tests.conftest import ROOT

TOLERANCE = (ROOT / "configs" / "two_kv" / "wang_2020_tolerance.toml").read_text(encoding="utf-8")


def refusal(text: str, folder=".") -> str:
    with pytest.raises(gj.GearjaxError) as caught:
        gj.loads(text, folder)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
    return str(caught.value)


def test_all_missing_keys_are_told_at_once(config_text, rv_text):
    assert refusal('[system]\nkind = "two_kv"') == (
        "system = (9 keys missing): must have sun_teeth, first_stage_planet_teeth, planet_teeth, ring_teeth: a whole "
        'number; module: a length such as "10 um"; cutting_pressure_angle, working_pressure_angle: an angle such as '
        '"90 deg"; input_speed: an angular speed such as "300 rpm"; te_radius: "planet", "ring", "held_sun" or a '
        'length such as "10 um"; may be left out: planets = 2'
    )
    words = refusal(config_text.replace('mean = "9.245e7 N/m"', "").replace("relative_amplitudes = [0.13]", ""))
    assert words == (
        'compliance = (2 keys missing): must have mean: a stiffness such as "9.2e7 N/m"; relative_amplitudes: a list '
        "of numbers such as [0.1], [] for none"
    )
    words = refusal(config_text.replace("relative_amplitudes = [0.13]", ""))
    assert words == (
        "compliance.relative_amplitudes = (missing): must be given: a list of numbers such as [0.1], [] for none"
    )
    words = refusal(config_text[: config_text.index("[run]")] + "[run]")
    assert words.startswith('run = (3 keys missing): must have duration: a time such as "3 s"; samples: a whole number')
    assert 'may be left out: torques = [], start = "equilibrium", settle = "0 s"' in words
    assert 'clearance = "linear"' in refusal('[system]\nkind = "rv_cycloidal"')
    assert "outward, around: a list of lengths such as" in refusal(
        f'{rv_text}\n[errors.pegs]\nkind = "positions"\nbody = "pin_ring"'
    )
    old = '{ kind = "truncated_normal", mean = "0.15 mm", std = "5 um", low = "0.135 mm", high = "0.165 mm" }'
    assert old in TOLERANCE
    words = refusal(TOLERANCE.replace(old, '{ kind = "truncated_normal" }'))
    assert words.startswith("tolerance.backlash.initial = (4 keys missing): must have mean, ")
    assert 'a length such as "10 um"' in words
    words = refusal(TOLERANCE.replace('measure = "no_load.peak_to_peak"\nyield = 0.95', ""))
    assert words.startswith("tolerance.allocation = (2 keys missing): must have measure: ")
    words = refusal(config_text + "\n[optimise]")
    assert words.startswith("optimise = (2 keys missing): must have objective: ")
    assert refusal(config_text.replace('zero = "start"', "")).startswith("reference.zero = (missing): must be given")


@pytest.mark.parametrize("name", ["a.b", "", " ", "a b", "x[0]", '"', "1", "_x", "a/b", "é.", "x" * 41, "\u202e", "*"])
def test_names_that_no_path_leads_to_are_refused(name, scene):
    with pytest.raises(
        gj.ParameterError, match="a name begins with a letter and has at most 40 characters: letters, digits, _ and -"
    ):
        check_name("errors", name)
    with pytest.raises(gj.ParameterError, match="a name begins with a letter"):
        gj.Scene(scene.system, {name: gj.Eccentricity("planet_1", 1e-6, 0.0)})


def test_such_names_are_refused_in_files(config_text):
    assert 'errors = "a.b": a name begins with a letter' in refusal(
        config_text.replace("[errors.planet_1]", '[errors."a.b"]')
    )
    scene = gj.loads(config_text.replace("[errors.planet_1]", '[errors."exzentrizität-1"]'))
    assert "exzentrizität-1" in scene.errors


def test_lists_where_words_belong(config_text):
    study = '\n[optimise]\nobjective = "no_load_amplitude"\nwhere = [["x"]]'
    assert refusal(config_text + study).startswith("optimise.where = ['x']: no number of this scene; valid: ")
    assert "an energy" in refusal(config_text.replace('"30 N*m", ', '"30 J", '))
    assert 'unknown unit "dB"' in refusal(config_text.replace('"30 N*m", ', '"10 dB*m", '))


def test_many_valid_names_are_not_all_told(rv_text):
    study = '\n[optimise]\nobjective = "no_load_amplitude"\nwhere = ["system.pin_radios"]'
    words = refusal(rv_text + study)
    assert 'did you mean "system.pin_radius"?' in words
    assert words.endswith(" more")


def test_a_file_name_with_nul(tmp_path, capsys):
    with pytest.raises(gj.ParameterError, match="no character NUL"):
        gj.load("a\0b.toml")
    with pytest.raises(SystemExit) as stopped:
        main(["run", "a\0b.toml"])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert "tolerance.errors.planet_1.amplitude.file = " in refusal(column('"a\\u0000b.csv"'), tmp_path)


def column(file: str = '"measured.csv"', name: str = "e", rest: str = ', unit = "um"') -> str:
    spread = f'{{ kind = "empirical", file = {file}, column = "{name}"{rest} }}'
    return TOLERANCE.replace('{ kind = "rayleigh", scale = "6 um" }', spread, 1)


SECRET = "root:x:0:0:secret"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("n,e\n1,5.0\n2,1_000\n", "line 3, column 2: is no number"),
        ("n,e\n1,5.0\n2,0x10\n", "line 3, column 2: is no number"),
        ("n,e\n1,5.0\n2,nan\n", "line 3, column 2: is no number"),
        ("n,e\n1,1e999\n", "line 2, column 2: is no number"),
        ("n,e\n1,5.0\n2,\n", "line 3, column 2: is no number"),
        (f"n,e\n1,{SECRET}\n", "line 2, column 2: is no number"),
        ("n,e\n1\n", "line 2 has 1 values, the first line has 2"),
        ("n,e\n1,5.0,6.0\n", "line 2 has 3 values, the first line has 2"),
        ("e,e\n1,5.0\n", 'column = "e": two columns or more in line 1'),
        (f"{SECRET}\n{SECRET}\n", 'column = "e": none of the 1 columns in line 1'),
        ("n,e\n", "has no rows below its first line"),
        ("", 'column = "e": none of the 0 columns'),
        (b"\xff\xfe\x00secret", "not a CSV file in UTF-8"),
        ("n,e\n1,\0\n", "line 2, column 2: is no number"),
        ('n,e\n1,"5.0\n', "not a CSV file"),
    ],
)
def test_columns_are_read_strictly_and_nothing_of_them_is_shown(tmp_path, content, words):
    raw = content if isinstance(content, bytes) else content.encode()
    (tmp_path / "measured.csv").write_bytes(raw)
    message = refusal(column(), tmp_path)
    assert words in message
    assert "secret" not in message


def test_other_columns_are_refused(tmp_path):
    (tmp_path / "measured.csv").write_text("n,e\n1,5.0\n", encoding="utf-8")
    assert "is a mass; needs a length" in refusal(column(rest=', unit = "kg"'), tmp_path)
    assert "a unit in quotes" in refusal(column(rest=", unit = 3"), tmp_path)
    assert "unknown key" in refusal(column(rest=', unti = "um"'), tmp_path)
    assert "not a file" in refusal(column(file='"."'), tmp_path)
    if os.path.exists("/dev/zero"):
        assert "not a file" in refusal(column(file='"/dev/zero"'), tmp_path)
    assert "column = (missing)" in refusal(column().replace(', column = "e"', ""), tmp_path)


def test_the_unit_of_a_column_counts_for_ratios_too(tmp_path):
    (tmp_path / "measured.csv").write_text("n, e\n1,5\n2, 7.5 \n\n", encoding="utf-8")
    spread = '{ kind = "empirical", file = "measured.csv", column = "e", unit = "%" }'

    def drawn(text: str) -> tuple[float, ...]:
        return loads_tolerance(text, tmp_path)[2].tolerances.distributions["damping.ratio"].values

    text = TOLERANCE.replace('"backlash.initial"', f'"damping.ratio" = {spread}\n"backlash.initial"', 1)
    assert drawn(text) == pytest.approx((0.05, 0.075))
    assert drawn(text.replace(', unit = "%"', "")) == pytest.approx((5.0, 7.5))
    assert drawn(text.replace('unit = "%"', 'unit = ""')) == pytest.approx((5.0, 7.5))
    assert "is a length; needs a ratio" in refusal(text.replace('"%"', '"um"'), tmp_path)


def test_nothing_asked_for_is_answered_by_the_help(capsys):
    with pytest.raises(SystemExit) as stopped:
        main([])
    assert stopped.value.code == 2
    assert "reproduce" in capsys.readouterr().out


def completed(line: str, **environment: str) -> str:
    """What a shell would offer after some words."""
    words = {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1), "_GEARJAX_COMPLETE": "complete_bash"}
    command = [sys.executable, "-m", "gearjax"]
    ended = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **words, **environment}, capture_output=True, text=True, check=True
    )
    return ended.stdout


@pytest.mark.slow
def test_completion():
    assert completed("gearjax tol").split() == ["tolerance"]
    assert completed("gearjax new rv").split() == ["rv_cycloidal"]


@pytest.mark.slow
def test_completion_installs(tmp_path):
    assert completed("gearjax run x.toml --js").split() == ["--json"]
    environment = {**os.environ, "HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    for option in ("--show-completion", "--install-completion"):
        command = [sys.executable, "-m", "gearjax", option, "bash"]
        ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
        assert ended.stdout
    script = (tmp_path / ".bash_completions" / "gearjax.sh").read_text(encoding="utf-8")
    assert "_GEARJAX_COMPLETE=complete_bash" in script
    assert "gearjax.sh" in (tmp_path / ".bashrc").read_text(encoding="utf-8")


@pytest.mark.parametrize("word", ["optimise", "tolerance"])
@pytest.mark.parametrize("name", ["elliptic/two_lobes.toml", "two_kv/wang_2020.toml"])
def test_the_section_that_is_advised_can_be_pasted(name, word, capsys, tmp_path):
    """The line names a number of the gear set at hand."""
    text = (ROOT / "configs" / name).read_text()
    (tmp_path / "gears.toml").write_text(text)
    with pytest.raises(SystemExit):
        main([word, str(tmp_path / "gears.toml")])
    line = capsys.readouterr().err.strip().partition("section: ")[2]
    load = loads_optimise if word == "optimise" else loads_tolerance
    assert load(f"{line}\n{text}")
