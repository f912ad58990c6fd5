"""Identification with encoders that were zeroed anew between recordings, and unknowns that the recordings hide."""

import dataclasses

import pytest

import gearjax as gj
from gearjax.units import arcmin, um


@pytest.fixture(scope="module")
def scene():
    scene = gj.load("configs/two_kv/wang_2020.toml")
    stiffer = dataclasses.replace(scene.compliance, mean=8.3e7)
    return dataclasses.replace(scene, backlash=gj.InitialBacklash(160 * um), compliance=stiffer)


def recordings(scene, size):
    """Three recordings; the offsets of their encoders differ by some ``size`` arcmin."""
    return [
        gj.synthetic_measurement(
            scene, torque=torque, noise=0.05 * arcmin, key=i, offset=own * size * arcmin, name=f"r{i}", rows=2000
        )
        for i, (torque, own) in enumerate(((10.0, 0.4), (150.0, -1.3), (-40.0, 0.9)))
    ]


def told(found):
    return [note for note in found.notes if "offset_spread" in note]


@pytest.mark.slow
def test_offsets_wider_than_assumed_are_told(scene):
    assert not told(gj.identify(scene, recordings(scene, 0.01), suggest=False))
    (note,) = told(gj.identify(scene, recordings(scene, 1.0), suggest=False))
    assert "give a larger offset_spread" in note


@pytest.mark.slow
@pytest.mark.parametrize("spread", [1.0, 1e-2])
def test_free_offsets_hide_the_backlash_alone(scene, spread):
    found = gj.identify(scene, recordings(scene, 1.0), offset_spread=spread, suggest=False)
    assert not told(found)
    stiffness, backlash = found.estimate("compliance.mean"), found.estimate("backlash.initial")
    assert abs(stiffness.value - 8.3e7) < 4 * stiffness.error < 1e7
    assert backlash.error is None or backlash.error > 100  # um
    assert found.estimate("errors.output_wheel.cos").error is not None  # as with narrow offsets


def test_an_unknown_that_nothing_holds_stays_within_its_bounds(scene):
    record = gj.synthetic_measurement(scene, torque=150.0, key=3, rows=400)
    turned = {name: dataclasses.replace(error, phase=error.phase + 2.0) for name, error in scene.errors.items()}
    turned = {name: dataclasses.replace(error, phase=error.phase + 2.0) for name, error in scene.errors.items()}
    wrong = dataclasses.replace(scene, errors=turned)
    found = gj.identify(wrong, record, ["system.module"], suggest=False).estimate("system.module")
    assert 1e-3 <= found.value <= 1e3  # mm


def test_no_unknowns_are_refused(scene):
    record = gj.synthetic_measurement(scene, torque=150.0, rows=64)
    with pytest.raises(gj.ParameterError, match=r"where = \(\): is empty"):
        gj.identify(scene, record, [])
