"""Sums of hidden numbers in words, with numbers and units that mean what they say."""

import dataclasses

import numpy as np
import pytest

import gearjax as gj
from gearjax.identification.unknowns import unknowns_of
from gearjax.identification.visible import _change, _leading, _told
from gearjax.units import um
from tests.bench_units import two_kv

FORCE = 1277.0  # N


@pytest.fixture
def unknowns():
    scene = dataclasses.replace(two_kv(), backlash=gj.InitialBacklash(10 * um))
    return unknowns_of(scene, ["compliance.mean", "backlash.initial"], back=True, loaded=True)


def test_a_stiffness_and_a_length(unknowns):
    """The play plus the deflection under a force: both lengths."""
    stiffness, play = 4e7, 12 * um
    scales = [each.scale for each in unknowns.each]
    values = np.array([scales[0] / stiffness, play / scales[1]])
    weights = np.array([FORCE / scales[0] / scales[1], 1.0])  # per unit of the search
    first = _leading(unknowns, np.arange(2))
    assert unknowns.names[first] == "backlash.initial"
    told = _told(unknowns, weights, first, float(weights @ values), 0.5)
    assert told.words == "1277 N / compliance.mean + backlash.initial"
    assert told.unit == "um"
    assert told.value == pytest.approx((play + FORCE / stiffness) / um, rel=1e-12)
    assert told.coefficients["1 / compliance.mean"] == pytest.approx(FORCE)
    assert told.coefficients["backlash.initial"] == 1.0


def test_what_hides_it(unknowns):
    """More play and a stiffer pair: the sum does not change along the direction that the words tell."""
    scales = [each.scale for each in unknowns.each]
    row = np.array([-scales[0] * scales[1] / FORCE, 1.0])
    words = [_change(unknowns, row, place, 1) for place in range(2)]
    assert words == ["1 / compliance.mean - d / (1277 N)", "backlash.initial + d"]
    sums = np.array([FORCE / scales[0] / scales[1], 1.0])
    assert abs(sums @ row) < 1e-12
