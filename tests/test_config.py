"""Configurations: what a file lists becomes the scene, and every mistake is one line that says what would be right."""

import dataclasses
import time

import jax
import numpy as np
import pytest

import gearjax as gj
from gearjax.checks import nearest
from gearjax.config.quantities import read_quantity
from gearjax.reproduce import two_kv
from gearjax.units import ANGLE, ANGULAR_SPEED, LENGTH, TORQUE


def test_the_shipped_config_is_the_reducer_of_the_paper(config_text):
    ours, paper = gj.loads(config_text), two_kv.scene()
    bare = dataclasses.replace(ours, run=None)
    assert jax.tree.structure(bare) == jax.tree.structure(paper)
    for one, other in zip(jax.tree.leaves(bare), jax.tree.leaves(paper), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)
    assert ours.run is not None
    assert (ours.run.duration, ours.run.samples, ours.run.settle) == (3.0, 3001, 0.05)
    assert ours.run.torques == (30.0, 100.0, 300.0)


def test_only_what_a_file_lists_is_there(config_text):
    system = config_text[config_text.index("[system]") : config_text.index("[errors.planet_1]")]
    scene = gj.loads(system)
    assert scene.errors == {}
    for slot in ("reference", "backlash", "compliance", "load", "inertia", "damping", "run"):
        assert getattr(scene, slot) is None
    assert isinstance(scene.contact, gj.HardContact)


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("10 um", LENGTH, 1e-5),
        ("10 µm", LENGTH, 1e-5),
        ("-1.5e-3mm", LENGTH, -1.5e-6),
        (".5 inch", LENGTH, 0.0127),
        ("90 deg", ANGLE, np.pi / 2),
        ("1 arcmin", ANGLE, np.pi / 10800),
        ("0.25 turn", ANGLE, np.pi / 2),
        ("300 rpm", ANGULAR_SPEED, 10 * np.pi),
        ("2 turn/s", ANGULAR_SPEED, 4 * np.pi),
        ("30 N*m", TORQUE, 30.0),
        ("30 N m", TORQUE, 30.0),
        ("3 kN·mm", TORQUE, 3.0),
        ("2 kg*m^2/s^2", TORQUE, 2.0),
    ],
)
def test_quantities(text, dimension, value):
    assert read_quantity("x", text, dimension) == pytest.approx(value, rel=1e-12)


# what is replaced, by what, and words that the message must have
MISTAKES = [
    ('module = "2.5 mm"', 'module = "-2.5 mm"', ["system.module", '"-2.5 mm"', "at least 1e-06 m"]),
    ('module = "2.5 mm"', 'module = "0 mm"', ["system.module", "at least 1e-06 m"]),
    ('module = "2.5 mm"', "module = 2.5", ["system.module = 2.5", "no unit", '"10 um"']),
    ('module = "2.5 mm"', 'module = "2.5"', ["system.module", "no unit"]),
    ('module = "2.5 mm"', 'module = "2.5 kg"', ["system.module", "is a mass; needs a length"]),
    ('module = "2.5 mm"', 'module = "2.5 mn"', ["system.module", 'unknown unit "mn"']),
    ('module = "2.5 mm"', 'modul = "2.5 mm"', ["system.modul ", "unknown key", 'did you mean "module"?']),
    ('module = "2.5 mm"\n', "", ["system.module", "(missing)", "a length"]),
    ('module = "2.5 mm"', "module = true", ["system.module", "give a length"]),
    ('module = "2.5 mm"', 'module = ["2.5 mm"]', ["system.module", "give a length"]),
    ('module = "2.5 mm"', 'module = "1e300 km"', ["system.module", "at most 1 m"]),
    ("\nplanet_teeth = 50", "\nplanet_teeth = 52", ["system.planet_teeth = 52", "below ring_teeth (52)"]),
    ("\nplanet_teeth = 50", "\nplanet_teeth = 60", ["system.planet_teeth = 60", "below ring_teeth (52)"]),
    ("\nplanet_teeth = 50", "\nplanet_teeth = 50.5", ["system.planet_teeth = 50.5", "whole number"]),
    ("\nplanet_teeth = 50", "\nplanet_teeth = -50", ["system.planet_teeth = -50", "at least 2"]),
    ("sun_teeth = 12", "sun_teeth = 0", ["system.sun_teeth = 0", "at least 1"]),
    ('"35.266 deg"', '"95 deg"', ["system.working_pressure_angle", "95 deg", "below 90 deg"]),
    (
        '"35.266 deg"',
        '"15 deg"',
        ["working_pressure_angle", '"15 deg"', "centre distance a must be at least", "20 deg to 90"],
    ),
    (
        '"300 rpm"',
        '"5 Hz"',
        ["system.input_speed", "is a frequency; needs an angular speed", "rpm, 1/min, deg/s or rad/s"],
    ),
    ('"300 rpm"', '"-300 rpm"', ["system.input_speed", "at least"]),
    ('te_radius = "planet"', 'te_radius = "planets"', ["system.te_radius", 'did you mean "planet"?', "or a length"]),
    ('te_radius = "planet"', 'te_radius = "61.08"', ["system.te_radius", "no unit"]),
    ('kind = "two_kv"', 'kind = "two_k"', ["system.kind", "unknown kind", "two_kv"]),
    (
        'body = "planet_1"',
        'body = "planet_3"',
        ["errors.planet_1.body", '"planet_3"', "planet_1, planet_2, revolution"],
    ),
    ('body = "revolution"', 'body = "revoluton"', ["errors.revolution.body", 'did you mean "revolution"?']),
    ('amplitude = "20 um"', 'amplitude = "20 deg"', ["errors.planet_2.amplitude", "is an angle; needs a length"]),
    ('amplitude = "20 um"', 'amplitude = "-20 um"', ["errors.planet_2.amplitude", '"-20 um"', "at least 0 m"]),
    ('phase = "-135 deg"', 'phase = "-135"', ["errors.revolution.phase", "no unit", "an angle"]),
    ('zero = "start"', 'zero = "end"', ["reference.zero", '"end"', '"start" or "absolute"']),
    ('initial = "0.15 mm"', 'initial = "-0.15 mm"', ["backlash.initial", "at least 0 m"]),
    ('mean = "9.245e7 N/m"', 'mean = "-9e7 N/m"', ["compliance.mean", '"-9e7 N/m"', "at least 0.001 N/m"]),
    ("= [0.13]", "= [1.13]", ["compliance.relative_amplitudes", "[1.13]", "stiffness becomes negative"]),
    ("= [0.13]", "= [0.13, 0.1]", ["compliance.phases", "one per relative amplitude, 2"]),
    ("= [0.13]", '= ["0.13"]', ["compliance.relative_amplitudes[0]", "without unit"]),
    ("= [0.13]", "= [inf]", ["compliance.relative_amplitudes[0] = inf", "finite"]),
    ("= [0.13]", "= 0.13", ["compliance.relative_amplitudes", "must be a list"]),
    ('mass = "3 kg"', 'mass = "0 kg"', ["inertia.mass", "at least 1e-09 kg"]),
    ("ratio = 0.1", 'ratio = "0.1"', ["damping.ratio", "without unit"]),
    ("ratio = 0.1", "ratio = -0.1", ["damping.ratio = -0.1", "at least 0"]),
    ("ratio = 0.1", "ratio = nan", ["damping.ratio = nan", "finite"]),
    ('kind = "constant"', 'kind = "sinusoid"', ["load.kind", 'did you mean "sinusoidal"?']),
    ('kind = "constant"', 'kind = "sinusoidal"', ["load.frequency", "(missing)"]),
    ('kind = "constant"', 'kind = "sinusoidal"\nfrequency = "cranc"', ["load.frequency", 'did you mean "crank"?']),
    (
        'kind = "constant"',
        'kind = "sinusoidal"\nfrequency = "10 rpm"',
        ["load.frequency", "is an angular speed; needs a frequency"],
    ),
    (
        'kind = "constant"',
        'kind = "constant"\nfrequency = "1 Hz"',
        ["load.frequency", 'unknown key of kind "constant"'],
    ),
    ('kind = "hard"', 'kind = "softplus"', ["contact.width", "(missing)"]),
    ('kind = "hard"', 'kind = "softplus"\nwidth = "-1 um"', ["contact.width", "at least 1e-15 m"]),
    ('kind = "hard"', 'kind = "hard"\nwidth = "1 um"', ["contact.width", 'unknown key of kind "hard"']),
    ('[inertia]\nmass = "3 kg"', "", ["run.analyses", '"dynamic" needs [inertia]']),
    ('[load]\nkind = "constant"', "", ["run.analyses", '"dynamic" needs [load]']),
    ('[backlash]\ninitial = "0.15 mm"', "", ["run.analyses", '"backlash" needs [backlash]']),
    ('[run]\nduration = "3 s"', '[run]\nduration = "3 m"', ["run.duration", "is a length; needs a time"]),
    ('[run]\nduration = "3 s"', '[run]\nduration = "-3 s"', ["run.duration", "at least 1e-9 s"]),
    ("samples = 3001", "samples = 1", ["run.samples = 1", "from 2 to"]),
    ("samples = 3001", "samples = 1000000000000", ["run.samples", "10000000"]),
    ('start = "equilibrium"', 'start = "zeros"', ["run.start", 'did you mean "zero"?']),
    ('settle = "0.05 s"', 'settle = "5 s"', ["run.settle", "below run.duration"]),
    ('"static", "dynamic"]', '"static", "dinamic"]', ["run.analyses", 'did you mean "dynamic"?']),
    ('["30 N*m", "100 N*m", "300 N*m"]', "[]", ["run.torques", '"static" needs a list']),
    ('["30 N*m", "100 N*m", "300 N*m"]', '["30 N"]', ["run.torques[0]", "is a force; needs a torque"]),
    ("[run]", "[runn]", ["runn", "unknown section", 'did you mean "run"?']),
    ("samples = 3001", "sampels = 3001", ["run.sampels", 'did you mean "samples"?']),
    ('analysis = "no_load"', 'analysis = "noload"', ["published[0].analysis", "no_load"]),
    ('"5b58db43"\nduration = "3 s"', '"5b58db43"\nduration = "3 N"', ["published[0].duration", "needs a time"]),
    ('std = "0.637 arcmin"', 'std = "0.637 mm"', ["published[0].std", "is a length; needs an angle"]),
    ("[reference]", "[reference]\nzero = 3", ["not a TOML configuration"]),
    ("[reference]", "x = [[[[", ["not a TOML configuration"]),
]


@pytest.mark.parametrize(("old", "new", "words"), MISTAKES, ids=[f"{m[2][0]}-{i}" for i, m in enumerate(MISTAKES)])
def test_mistakes(config_text, old, new, words):
    assert old in config_text
    with pytest.raises(gj.GearjaxError) as caught:
        gj.loads(config_text.replace(old, new))
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    for word in words:
        assert word in message


@pytest.mark.parametrize("body", ["ring", "output_wheel"])
def test_an_error_that_no_body_can_carry_is_refused_by_its_kind(config_text, body):
    """Naming the bodies that there are would send its user round them all."""
    section = f'[errors.ring]\nkind = "cumulative_pitch"\nbody = "{body}"\namplitude = "2 um"\nphase = "0 deg"\n'
    with pytest.raises(gj.ParameterError, match="each body of this two_kv has no rim of pins or teeth") as caught:
        gj.loads(config_text.replace("[reference]", f"{section}\n[reference]"))
    assert caught.value.key == "errors.ring.kind"


def test_published_values_of_other_gears_are_left_out(config_text):
    """So are those of a record of another length, where the values tell theirs; the samples may differ."""
    with_values = gj.loads(config_text.replace("3001", "2001")).run.published
    shorter = config_text.replace('[run]\nduration = "3 s"', '[run]\nduration = "2 s"')
    for entry in gj.loads(shorter).run.published:
        assert not entry.metrics
        assert entry.note == "published values left out: they are of a record of 3 s, and this has 2 s"
    of_any = "\n".join(line for line in shorter.splitlines() if line != 'duration = "3 s"')
    assert all(entry.metrics for entry in gj.loads(of_any).run.published)
    others = gj.loads(config_text.replace("ring_teeth = 52", "ring_teeth = 53")).run.published
    assert len(with_values) == len(others) == 7
    assert all(entry.metrics for entry in with_values)
    for entry in others:
        assert not entry.metrics
        assert entry.note.startswith("published values left out: they are of configuration ")
    unnamed = "\n".join(line for line in config_text.splitlines() if not line.startswith("configuration = "))
    assert all(entry.metrics for entry in gj.loads(unnamed.replace("ring_teeth = 52", "ring_teeth = 53")).run.published)


@pytest.mark.parametrize(
    "absurd",
    [
        '"9**9**9 m"',
        '"2.5 m**9**9**9"',
        '"2.5 m**99999999"',
        '"(2.5) mm"',
        '"1+1 mm"',
        '"nan mm"',
        '"inf mm"',
        '"-inf mm"',
        '"1e999 mm"',
        '"2.5 mm; 3"',
        "\"__import__('os') mm\"",
        '"0x10 mm"',
        '"²5 mm"',
        '"٣ mm"',
        "0x" + "f" * 20_000,
        "[0x" + "f" * 20_000 + "]",
        "{a" + ".a" * 40 + " = 1}",
        '""',
        '" "',
        '"mm"',
        "nan",
        "inf",
        '"' + "9" * 900_000 + ' mm"',
        '"2.5 ' + "m*" * 400_000 + 'm"',
        '"2.5 ' + "m" * 900_000 + '"',
        "9" * 4000,
    ],
    ids=lambda text: text[:24],
)
def test_absurd_strings_are_refused_at_once(config_text, absurd):
    began = time.process_time()
    with pytest.raises(gj.GearjaxError) as caught:
        gj.loads(config_text.replace('"2.5 mm"', absurd))
    assert time.process_time() - began < 2.0
    assert "system.module" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_absurd_files(tmp_path):
    for text, words in (
        ("a = " + "[" * 100_000, "not a TOML"),
        ("teeth = " + "9" * 5000, "4300 digits"),
        ("", "no [system]"),
        ("a" + ".a" * 150_000 + " = 1", "too many parts"),
        ("[a" + ".a" * 150_000 + "]", "too many parts"),
        ("a" + ".1" * 150_000 + " = 1", "too many parts"),
        ("foo = 0x" + "f" * 20_000, "foo = (a int too large"),
        ("[system]\nkind = [0x" + "f" * 20_000 + "]", "system.kind"),
        ("[system]\nkind.a" + ".a" * 45 + " = 1", "system.kind"),
        ('["a\\u001b[31mb' + "x" * 1000 + '"]', "unknown section"),
        ('[system]\nkind = "two_kv"\n[[published]]\nanalysis = 3', "system = (9 keys missing): must have sun_teeth"),
        ("system = 3", "must be a section"),
        ("[errors]\nx = 3\n[system]\nkind = 4", "system.kind = 4"),
    ):
        with pytest.raises(gj.GearjaxError) as caught:
            gj.loads(text)
        assert words in str(caught.value)
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 400
    for name, content, words in (
        ("missing.toml", None, "cannot be read (No such file"),
        ("binary.toml", b"\xff\xfe\x00\x01", "not a text file"),
        ("large.toml", b"#" * 8_100_000, "more than a configuration can have"),
    ):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(gj.GearjaxError, match="toml") as caught:
            gj.load(path)
        assert words in str(caught.value)
    for unreadable in (tmp_path, "/dev/null"):
        with pytest.raises(gj.GearjaxError, match="cannot be read"):
            gj.load(unreadable)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('mass = "3 kg"', 'mass = "1e-300 kg"'),
        ('mean = "9.245e7 N/m"', 'mean = "1e-307 N/m"'),
        ('module = "2.5 mm"', 'module = "1e-160 m"'),
        ('input_speed = "300 rpm"', 'input_speed = "1e-320 rpm"'),
        ('duration = "3 s"', 'duration = "1e-320 s"'),
        ('duration = "3 s"', 'duration = "1e300 s"'),
        ('"100 N*m"', '"1e300 N*m"'),
    ],
)
def test_values_beyond_sense_name_their_key(config_text, old, new):
    with pytest.raises(gj.ParameterError, match=r"(at least|at most)") as caught:
        gj.loads(config_text.replace(old, new))
    assert caught.value.key.split(".")[-1].split("[")[0] in (
        "mass",
        "mean",
        "module",
        "input_speed",
        "duration",
        "torques",
    )


def test_a_byte_order_mark_and_windows_lines_are_read(tmp_path, config_text):
    path = tmp_path / "notepad.toml"
    path.write_bytes(b"\xef\xbb\xbf" + config_text.replace("\n", "\r\n").encode())
    assert gj.load(path).run is not None


def test_a_stiffness_that_dips_below_zero_between_coarse_samples_is_refused():
    with pytest.raises(gj.ParameterError, match="negative"):
        gj.HarmonicStiffness(9.2e7, [0.0] * 719 + [5.0], [0.0] * 720)
    with pytest.raises(gj.ParameterError, match="negative"):
        gj.HarmonicStiffness(9.2e7, [0.0, 1.01], [0.0, 2.0])
    gj.HarmonicStiffness(9.2e7, [0.0, 0.99], [0.0, 2.0])


def test_a_torque_that_turns_negative_needs_back_flanks(config_text):
    bare = config_text.replace('[backlash]\ninitial = "0.15 mm"', "").replace('"no_load", "backlash", ', "")
    with pytest.raises(gj.SceneError, match=r"run.torques: .*need \[backlash\]"):
        gj.loads(bare.replace('"30 N*m", ', '"-30 N*m", '))
    with pytest.raises(gj.SceneError, match=r"run.torques: .*need \[backlash\]"):
        gj.loads(bare.replace('kind = "constant"', 'kind = "sinusoidal"\nfrequency = "crank"'))
    assert gj.loads(bare).backlash is None


def test_constructors_check_too(scene):
    with pytest.raises(gj.ParameterError, match=r"amplitude = -1.*: must be at least 0 m"):
        gj.Eccentricity("planet_1", -1.0, 0.0)
    with pytest.raises(gj.ParameterError, match=r"errors\.wheel\.body"):
        dataclasses.replace(scene, errors={"wheel": gj.Eccentricity("wheel", 1e-6, 0.0)})
    with pytest.raises(gj.ParameterError, match="te_radius"):
        dataclasses.replace(scene.system, te_radius="sun")
    with pytest.raises(gj.ParameterError, match="planets = 6"):
        dataclasses.replace(scene.system, planets=6)
    with pytest.raises(gj.ParameterError, match="width = 0"):
        gj.QuadraticContact(0.0)
    with pytest.raises(gj.GearjaxError, match='mass = "3 kg": must be a number, in SI'):
        gj.EquivalentMass("3 kg")


def test_three_planets_from_a_config(config_text):
    three = config_text.replace('te_radius = "planet"', 'te_radius = "ring"\nplanets = 3').replace(
        'body = "revolution"', 'body = "planet_3"'
    )
    scene = gj.loads(three)
    assert scene.system.bodies == ("planet_1", "planet_2", "planet_3", "revolution", "output_wheel")


def test_names_that_would_be_right_are_told_in_one_line():
    pins = [f"errors.pins.outward[{index}]" for index in range(40)]
    told = nearest("errors.pin.outward[3]", ["torque", *pins, "x[1]", "x[2]", "x[4]"])
    assert told == 'did you mean "errors.pins.outward[3]"? valid: torque, errors.pins.outward[0..39], x[1], x[2], x[4]'


def test_names_that_look_like_numbers_need_quotes():
    assert nearest(2013, ["2013", "1995"]) == 'did you mean "2013", in quotes? valid: 2013, 1995'
    assert nearest(2014, ["2013", "1995"]) == "valid: 2013, 1995"
