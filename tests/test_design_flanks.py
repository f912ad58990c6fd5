"""Measured flanks that contain a designed modification: taken out, each counts once, and grades are of the rest."""

import dataclasses
import re

import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.checks import ParameterError
from gearjax.config import read_file, read_tables
from gearjax.units import mm, um
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, RING, TEETH, meshes_of, scene_of

DESIGN = {
    "tip": gj.TipRelief("pinion", [20 * um], 8 * mm),
    "root": gj.RootRelief("pinion", [15 * um], 6 * mm, exponent=2),
    "crowning": gj.Crowning("pinion", [12 * um]),
}


def measured_of(system, body="pinion", design=(), slope=0.0, number=41) -> gj.MeasuredFlank:
    """What a machine would measure from the involute, by formulas of ISO 21771 written out once more."""
    size = system.gear_size(body)
    low, high = (float(end) for end in size.roll)
    tip, root = (low, high) if size.internal else (high, low)
    half = 0.5 * float(size.width)
    roll, across = np.linspace(low, high, number), np.linspace(-half, half, 13)
    grid = np.zeros((number, 13))
    for error in design:
        if isinstance(error, gj.TipRelief | gj.RootRelief):
            distance = np.abs((tip if isinstance(error, gj.TipRelief) else root) - roll)
            share = np.clip(1 - distance / float(error.length), 0, None) ** error.exponent
            grid -= float(error.amount[0]) * share[:, None]
        else:
            grid -= float(error.amount[0]) * (across / half)[None, :] ** 2
    grid += slope * (roll - low)[:, None] / (high - low) - 0.5 * slope
    return gj.MeasuredFlank(body, roll, grid.ravel(), across)


@pytest.mark.slow
def test_what_a_design_asks_for_is_no_deviation():
    system = scene_of(GUO_1).system
    whole = measured_of(system, design=DESIGN.values(), slope=4 * um)
    rest = whole.without(list(DESIGN.values()), system.gear_size("pinion"))
    np.testing.assert_allclose(rest.deviation, measured_of(system, slope=4 * um).deviation, rtol=0, atol=1e-18)
    graded = gj.accuracy_grades(gj.Scene(system, {"flank": rest}), "pinion")
    assert graded["f_H_alpha"].value == pytest.approx(4 * um)
    assert graded["f_f_alpha"].value < 1e-12
    assert graded["F_beta"].value < 1e-12
    before = gj.accuracy_grades(gj.Scene(system, {"flank": whole}), "pinion")
    assert before["F_alpha"].grade > graded["F_alpha"].grade


@pytest.mark.slow
def test_of_an_internal_gear_the_tip_is_at_the_least_roll():
    system = scene_of(RING).system
    design = [gj.TipRelief("wheel", [10 * um], 2 * mm)]
    rest = measured_of(system, "wheel", design).without(design, system.gear_size("wheel"))
    np.testing.assert_allclose(rest.deviation, 0.0, atol=1e-18)


@pytest.mark.slow
def test_reliefs_of_single_teeth():
    system = scene_of(GUO_1).system
    own = gj.TipRelief("pinion", np.linspace(0.0, 18.0, 19) * um, 8 * mm)
    flank = measured_of(system)
    points = flank.deviation.size
    some = gj.MeasuredFlank("pinion", flank.roll, np.zeros(2 * points), flank.across, teeth=[3.0, 7.0])
    rest = some.without([own], system.gear_size("pinion")).grid
    np.testing.assert_allclose(rest.max(axis=(1, 2)), [3 * um, 7 * um], rtol=1e-12)


@pytest.mark.slow
def test_together_they_are_what_was_measured():
    """The TE of the measured flank alone, and of the design with the rest: equal up to the splines between points."""
    measured = measured_of(scene_of(GUO_1).system, design=DESIGN.values(), slope=4 * um, number=161)
    system = scene_of(GUO_1).system
    rest = measured.without(list(DESIGN.values()), system.gear_size("pinion"))
    theta = meshes_of(system, 32)
    te = [
        np.asarray(gj.transmission_error(scene_of(GUO_1, errors, TEETH), theta, 830.0).te)
        for errors in ({"flank": measured}, DESIGN | {"flank": rest}, {"flank": rest})
    ]
    swing = np.ptp(te[0])
    assert np.abs(te[1] - te[0]).max() < 0.01 * swing
    assert np.abs(te[2] - te[0]).max() > 0.2 * swing


def tables(**changes):
    """The shipped measured pair, with reliefs that its flanks contain."""
    found = read_tables(read_file(ROOT / "configs" / "helical" / "guo_2018_measured.toml"))
    found["errors"] |= {
        "tip": {"kind": "tip_relief", "body": "pinion", "amount": ["20 um"], "length": "8 mm"},
        "other": {"kind": "crowning", "body": "wheel", "amount": ["5 um"]},
    }
    found["errors"]["pinion_flank"] |= changes
    return found


@pytest.mark.slow
def test_a_configuration_names_what_its_flanks_contain():
    folder = ROOT / "configs" / "helical"
    plain = gj.loads(tomli_w.dumps(tables()), folder)
    scene = gj.loads(tomli_w.dumps(tables(contains=["tip"])), folder)
    own = plain.errors["pinion_flank"].without([plain.errors["tip"]], plain.system.gear_size("pinion"))
    np.testing.assert_array_equal(scene.errors["pinion_flank"].deviation, own.deviation)
    alone = dataclasses.replace(plain, errors={k: e for k, e in plain.errors.items() if k not in ("tip", "other")})
    both = dataclasses.replace(scene, errors={k: e for k, e in scene.errors.items() if k != "other"})
    theta = np.linspace(0.0, 0.3, 15)
    te = [np.asarray(gj.transmission_error(one, theta, 830.0).te) for one in (alone, both, plain)]
    assert np.abs(te[1] - te[0]).max() < 0.02 * np.abs(te[2] - te[0]).max()


@pytest.mark.parametrize(
    ("contains", "words"),
    [
        (["tipp"], "errors.pinion_flank.contains = "),
        ("tip", "must be a list of names of [errors.NAME]"),
        (["other"], 'must be modifications of "pinion"'),
        (["pinion_pitch"], "is no modification along the profile or across the face"),
        (["pinion_flank"], "errors.pinion_flank.contains = "),
    ],
)
def test_wrong_names_are_refused_in_one_line(contains, words):
    with pytest.raises(ParameterError, match=re.escape(words)) as refused:
        gj.loads(tomli_w.dumps(tables(contains=contains)), ROOT / "configs" / "helical")
    assert "\n" not in str(refused.value)
