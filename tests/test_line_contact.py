"""Elastic line contacts against other formulas and against their own definition."""

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.geometry.line_contact import Radii
from gearjax.units import mm
from tests.rv import HERTZ, HU

WEIGHT = (1 - 0.3**2) / (2.06e11 * 11 * mm)  # (1 - nu^2) / (E b)


def approach(law, pin: float, curvature: float, force: float) -> float:
    springs = law.springs(Radii(jnp.asarray([pin]), jnp.asarray([curvature])))
    return float(springs.approach(jnp.asarray([force]))[0])


def johnson(pin: float, flank: float, force: float) -> float:
    """Johnson (1985), eqs. 4.43 and 5.58, each body from the contact to its centre."""
    relative = 1 / (1 / pin + 1 / flank)
    half = np.sqrt(8 * force * WEIGHT * relative / np.pi)
    return 2 * force * WEIGHT / np.pi * (np.log(4 * pin / half) + np.log(4 * abs(flank) / half) - 1)


def roark(pin: float, flank: float, force: float) -> float:
    """Roark: two cylinders, with the full width of the contact."""
    relative = 1 / (1 / pin + 1 / flank)
    full = 2 * np.sqrt(8 * force * WEIGHT * relative / np.pi)
    return 2 * force * WEIGHT / np.pi * (2 / 3 + np.log(4 * pin / full) + np.log(4 * abs(flank) / full))


@pytest.mark.parametrize("force", [10.0, 500.0, 2000.0])
@pytest.mark.parametrize("flank", [2 * mm, 15 * mm, 43.6 * mm, -20 * mm, -60 * mm])
def test_hertz_is_johnsons_approach_near_roarks(flank, force):
    ours = approach(HERTZ, 3 * mm, 1 / flank, force)
    assert ours == pytest.approx(johnson(3 * mm, flank, force), rel=5e-4)  # the depth is limited to 1 m, smoothly
    assert ours == pytest.approx(roark(3 * mm, flank, force), rel=0.03)


def test_a_flat_flank_counts_a_metre_deep():
    """Its approach would be endless: the reference point lies a metre away, and 0.1 m would be a sixth less."""
    flat = approach(HERTZ, 3 * mm, 0.0, 1000.0)
    half = np.sqrt(8 * 1000.0 * WEIGHT * 3 * mm / np.pi)
    expected = 2 * 1000.0 * WEIGHT / np.pi * (np.log(4 * 3 * mm / half) + np.log(4 * 1.0 / half) - 1)
    assert flat == pytest.approx(expected, rel=1e-4)
    near = [approach(HERTZ, 3 * mm, c, 1000.0) for c in (-0.01, 0.0, 0.01)]
    assert max(near) / min(near) == pytest.approx(1.0, abs=2e-3)
    assert approach(HERTZ, 3 * mm, 1 / 0.1, 1000.0) / flat == pytest.approx(0.84, abs=0.03)


def test_the_papers_contact_is_twice_as_soft():
    soft, stiff = (approach(law, 3 * mm, 1 / (43.603 * mm), 1910.0) for law in (HU, HERTZ))
    assert soft / stiff == pytest.approx(2.0, abs=0.05)


def test_pressure_is_untouched_by_the_approach():
    radii = Radii(jnp.asarray([3 * mm]), jnp.asarray([1 / (43.6 * mm)]))
    relative = 1 / (1 / (3 * mm) + 1 / (43.6 * mm))
    pressure = float(HERTZ.pressure(radii, jnp.asarray([1000.0]))[0])
    assert pressure == pytest.approx(np.sqrt(1000.0 / (2 * np.pi * WEIGHT * relative)) / (11 * mm), rel=1e-12)
    assert isinstance(HERTZ, gj.HertzLineContact)
