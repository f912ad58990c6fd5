"""Identification from recordings with spikes, of too few rows, in wrong units, and the stiffness that it frees."""

import dataclasses
import re

import numpy as np
import pytest
import tomli_w

import gearjax as gj
from gearjax.config import read_tables
from gearjax.identification.rows import rows_of
from gearjax.identification.unknowns import unknowns_of
from gearjax.identification.weights import of_spikes
from gearjax.units import arcmin, deg
from tests.bench_units import estimates, random_unit, recorded, truth, two_kv
from tests.test_matrix import GEAR_SETS

STIFFNESS = {
    '{kind = "harmonic_stiffness", mean = "1e8 N/m", relative_amplitudes = [], phases = []}': "compliance.mean",
    '{kind = "line_stiffness", per_length = "14 N/mm/um"}': "compliance.per_length",
    '{kind = "tooth_slices", youngs_modulus = "206 GPa", poissons_ratio = 0.3}': "compliance.youngs_modulus",
    '{kind = "iso_6336"}': None,
}


@pytest.fixture(scope="module")
def scene():
    return two_kv()


@pytest.fixture(scope="module")
def elliptic():
    return dataclasses.replace(gj.load("configs/elliptic/two_lobes.toml"), reference=None)


def spiked(record: gj.Measurement, places, size: float) -> gj.Measurement:
    output = np.array(record.output)
    output[places] += size
    return dataclasses.replace(record, output=output)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.1, 2.0, 90.0], ids="{} deg".format)
def test_a_spike_in_a_single_recording_changes_nothing(size, scene):
    """A search from a start that follows one row of 120 arcmin ended at eccentricities of a metre."""
    unit = random_unit(5)
    record = recorded(unit, 150.0, 3, rows=1500)
    spikes = spiked(record, [700], size * deg)
    found, clean = (gj.identify(scene, each, suggest=False) for each in (spikes, record))
    assert found.as_json()["outlying_rows"] == 1 + clean.as_json()["outlying_rows"]
    assert found.sigma == pytest.approx(clean.sigma, rel=0.01)
    curves = [record.error(scene) / arcmin - each.fit.residual for record, each in ((spikes, found), (record, clean))]
    np.testing.assert_allclose(*curves, rtol=0, atol=0.01)


@pytest.mark.slow
def test_spikes_in_every_fiftieth_row_are_outliers(scene):
    unit = random_unit(2)
    records = [recorded(unit, torque, i, rows=1500) for i, torque in enumerate((10.0, 150.0, -40.0))]
    found = gj.identify(scene, [spiked(each, np.s_[7::50], 0.5 * deg) for each in records], suggest=False, orders=[])
    values, errors = estimates(found)
    assert min(np.max(np.abs(values - one) / errors) for one in truth(unit)) < 4
    assert found.as_json()["outlying_rows"] >= 90


def test_only_rows_far_from_their_neighbours_are_spikes(scene):
    plain = recorded(random_unit(0), 150.0, 0, rows=600)
    assert of_spikes(rows_of([plain], scene)).all()
    steps = dataclasses.replace(plain, output=plain.output + np.where(np.arange(600) > 300, 0.3, 0.0) * deg)
    assert of_spikes(rows_of([steps], scene)).all()  # a slip of an encoder is no spike
    both = [spiked(plain, [50, 51, 300], 1 * deg), plain]
    np.testing.assert_array_equal(np.flatnonzero(of_spikes(rows_of(both, scene)) == 0), [50, 51, 300])


def test_too_few_rows_are_refused(scene):
    record = recorded(random_unit(0), 150.0, 0, rows=20, turns=0.1)
    with pytest.raises(gj.GearjaxError, match="20 rows are too few for 9 unknowns and the offset: at least 30") as told:
        gj.identify(scene, record)
    assert "\n" not in str(told.value)


@pytest.mark.slow
def test_errors_as_large_as_teeth_are_told(elliptic):
    """A TE in arcmin that is labelled as degrees."""
    record = gj.synthetic_measurement(elliptic, rows=400, noise=0.02 * arcmin, turns=2.0)
    wrong = dataclasses.replace(record, output=None, te=60 * record.error(elliptic))
    remark = "errors.driven of .* mm is more than a quarter of system.module"
    for given, told in ((wrong, True), (record, False)):
        found = gj.identify(elliptic, given, ["errors.driver", "errors.driven"], orders=[], suggest=False)
        assert any(re.match(remark, words) for words in found.notes) is told


@pytest.mark.slow
def test_an_input_angle_of_the_other_sign_is_named(elliptic):
    """The errors of a pair whose ratio changes cannot explain its mirror image."""
    record = gj.synthetic_measurement(elliptic, 20.0, rows=600, noise=0.02 * arcmin, turns=2.0)
    mirrored = gj.Measurement(-record.theta, te=record.error(elliptic), torque=20.0)
    gj.identify(elliptic, dataclasses.replace(mirrored, theta=record.theta), suggest=False)
    with pytest.raises(gj.GearjaxError, match="the input angle seems to have the wrong sign"):
        gj.identify(elliptic, mirrored, suggest=False)


@pytest.mark.parametrize("compliance", STIFFNESS)
def test_the_stiffness_is_among_the_unknowns(compliance):
    tables = GEAR_SETS["helical_pair"].tables
    tables |= read_tables(f"compliance = {compliance}")
    tables.pop("damping"), tables.pop("inertia")
    tables["system"]["slices"] = 3
    scene = gj.loads(tomli_w.dumps(tables))
    of = [each.path for each in unknowns_of(scene, None, back=False, loaded=True).each]
    assert [path for path in of if path.startswith("compliance.")] == [path for path in [STIFFNESS[compliance]] if path]


def test_a_modulus_that_is_among_the_unknowns_by_default_is_found():
    """An RV stage under line contacts whose modulus the configuration has 15 % too low."""
    tables = GEAR_SETS["rv_cycloidal"].tables
    tables["compliance"] = {"kind": "hertz_line_contact", "youngs_modulus": "206 GPa", "poissons_ratio": 0.3}
    tables["compliance"] |= {"face_width": "10 mm"}
    tables["errors"] = {"disc_1": tables["errors"]["disc_1"]}
    true = dataclasses.replace(gj.loads(tomli_w.dumps(tables)), reference=None)
    guess = dataclasses.replace(true, compliance=dataclasses.replace(true.compliance, youngs_modulus=175e9))
    turns = 2 * true.system.orders["output"]
    runs = [gj.synthetic_measurement(true, torque, rows=150, turns=turns, noise=1e-7) for torque in (5.0, 60.0)]
    found = gj.identify(guess, runs, orders=[], suggest=False)
    modulus = found.estimate("compliance.youngs_modulus")
    assert modulus.value == pytest.approx(206e9, abs=4 * modulus.error)
    assert modulus.error < 8e9
