"""Geometry of cycloidal discs: profile, gaps, curvature, undercut, and the closed formulas of Hu et al. (2020)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.geometry import cycloid
from gearjax.geometry.cycloid_errors import (
    FACTORS,
    coefficients,
    compensation,
    geometric_error,
    mean_and_tolerance,
    printed_coefficients,
    printed_throw_coefficient,
    sensitivity_indices,
)
from gearjax.plot.cycloid import placed_outline
from gearjax.units import arcmin, mm, um
from tests.rv import system

ANGLES = jnp.linspace(-np.pi, np.pi, 2001)


def disc(design: str = "initial") -> cycloid.Cycloid:
    return system(design).profile


def test_the_profile_is_the_equidistant_curve_of_the_trochoid():
    own = disc()
    phase = jnp.linspace(0.0, 2 * np.pi * own.teeth, 4001)
    (x, y), (dx, dy) = jax.jvp(lambda p: cycloid.trochoid(own, p), (phase,), (jnp.ones_like(phase),))
    offset, size = own.pin_radius + own.isometric, jnp.sqrt(dx * dx + dy * dy)
    expected = jnp.stack([x - offset * dy / size, -(y + offset * dx / size)], axis=-1)
    np.testing.assert_allclose(cycloid.profile(own, phase), expected, atol=1e-14)


def test_the_clearance_is_zero_at_the_longest_lever_and_is_the_gap_turned_back():
    own = disc()._replace(shifting=jnp.asarray(-1e-9), isometric=jnp.asarray(-0.5e-9))  # K1 is K to 1e-8
    short = own.modified_short_width
    assert abs(float(cycloid.clearance(own, jnp.arccos(short)))) < 1e-24
    lever = cycloid.touch(short, ANGLES).lever
    side = jnp.sqrt(1 - short * short)
    turned = cycloid.gap(own, ANGLES) - (own.isometric - own.shifting * side) * lever
    np.testing.assert_allclose(cycloid.clearance(own, ANGLES), turned, atol=1e-16)


@pytest.mark.parametrize(("design", "worst"), [("initial", 1.24), ("modified", 0.45)])
def test_the_linear_gap_is_as_far_from_the_exact_one_as_the_study_found(design, worst):
    own = disc(design)
    apart = jnp.abs(cycloid.gap(own, ANGLES) - cycloid.exact_gap(own, ANGLES)).max()
    assert float(apart) / um == pytest.approx(worst, abs=0.006)


@pytest.mark.slow
def test_the_exact_gap_is_the_distance_to_the_drawn_profile():
    own = disc()
    phase = jnp.linspace(-1.0, 2 * np.pi + 1.0, 400_001)  # a tooth
    outline = cycloid.profile(own, phase) * jnp.array([[1.0, -1.0]])
    for angle in (0.4, 1.3, 2.5, 4.0, 5.9):
        unmodified = own._replace(shifting=jnp.zeros(()))
        pin = jnp.stack(cycloid.trochoid(unmodified, jnp.asarray(angle)))
        distance = jnp.sqrt(((outline - pin[None]) ** 2).sum(axis=1)).min() - own.pin_radius
        assert float(cycloid.exact_gap(own, jnp.asarray(angle)) - distance) == pytest.approx(0.0, abs=1e-10)


@pytest.mark.slow
def test_the_derivative_of_the_exact_gap_holds_the_foot():
    own, step = disc(), 1e-7
    for name in ("shifting", "isometric", "throw"):
        value = getattr(own, name)
        change = [cycloid.exact_gap(own._replace(**{name: value + s * step}), ANGLES[7::100]) for s in (1, -1)]
        slope = jax.jacfwd(lambda v, n=name: cycloid.exact_gap(own._replace(**{n: v}), ANGLES[7::100]))(value)
        np.testing.assert_allclose(slope, (change[0] - change[1]) / (2 * step), atol=2e-6)


@pytest.mark.slow
def test_curvature_is_that_of_the_profile():
    own = disc()
    phase = jnp.linspace(0.05, 2 * np.pi - 0.05, 301)

    def each(p):
        def point(q):
            return cycloid.profile(own, q[None])[0]

        first = jax.jacfwd(point)(p)
        second = jax.jacfwd(jax.jacfwd(point))(p)
        return (first[0] * second[1] - first[1] * second[0]) / (first**2).sum() ** 1.5

    np.testing.assert_allclose(cycloid.curvature(own, phase), -jax.vmap(each)(phase), rtol=1e-9)
    printed = own._replace(isometric=jnp.zeros(()))
    at_longest_lever = 1 / cycloid.curvature(printed, jnp.arccos(printed.modified_short_width))
    assert float(at_longest_lever) / mm == pytest.approx(43.6, abs=0.03)  # eq. 40, r_p + shifting in place of r_p


def test_too_large_a_pin_is_refused_with_the_largest_allowed():
    with pytest.raises(gj.ParameterError, match=r"pin_radius = \"7 mm\": undercuts the disc: must be below 5.7\d* mm"):
        system(pin_radius=7 * mm)
    largest = cycloid.largest_offset(40, 76 * mm - 43.7 * um, float(disc().modified_short_width)) + 22 * um
    system(pin_radius=largest * (1 - 1e-6))
    with pytest.raises(gj.ParameterError, match="undercuts"):
        system(pin_radius=largest * (1 + 1e-6))


@pytest.mark.slow
def test_a_looped_profile_is_refused_and_one_just_short_of_it_is_not():
    with pytest.raises(gj.ParameterError, match=r"eccentricity = \"1.9 mm\": looped profile.*at most 1.8989"):
        system(eccentricity=1.9 * mm)
    near = system("conjugate", eccentricity=1.8999 * mm, pin_radius=0.05 * mm)
    assert float(near.profile.short_width) > 0.9999
    scene = gj.Scene(near, compliance=gj.HarmonicStiffness(1.6465e8, [], []))
    te = gj.transmission_error(scene, jnp.linspace(0.0, 6.2, 64), 784.0)
    assert bool(jnp.isfinite(te.te).all())


@pytest.mark.slow
def test_sensitivity_indices_have_the_printed_digits():
    printed = (1.0, -1.6308, 0.8154, 0.4077, 1.2882, 1.6308, -1.0, -0.6441)
    found = sensitivity_indices(disc())
    for name, value in zip(FACTORS, printed, strict=False):
        assert round(float(found[name]), 4) == value, name
    assert round(float(printed_throw_coefficient(disc())), 5) == -0.00024


def test_coefficients_by_differentiation_are_the_printed_ones_but_for_the_throw():
    own = disc()
    ours, theirs = coefficients(own), printed_coefficients(own)
    for name in FACTORS:
        if name != "throw":
            assert float(ours[name]) == pytest.approx(float(theirs[name]), rel=1e-12), name
    per_throw = float(ours["throw"] / own.rolling_radius) * mm
    assert per_throw == pytest.approx(-2 * 5.61e-4, rel=2e-3)  # rad/mm: 2 k_n = 4.7e-4 is not the derivative


def test_coefficients_are_central_differences_under_jit_and_vmap():
    own, step = disc(), 1e-8
    isometrics = own.isometric * jnp.array([0.5, 1.0, 2.0])
    slopes = jax.jit(jax.vmap(lambda value: coefficients(own._replace(isometric=value))))(isometrics)
    for index, isometric in enumerate(isometrics):
        design = own._replace(isometric=isometric)
        for name in ("pin_circle", "run_out", "isometric", "cumulative_pitch"):
            high, low = (geometric_error(design, {name: jnp.asarray(s * step)}) for s in (1, -1))
            slope = float((high - low) / (2 * step) * own.rolling_radius)
            assert float(slopes[name][index]) == pytest.approx(slope, rel=1e-6)


def test_mean_tolerance_and_compensation():
    own = disc()
    mean, tolerance = mean_and_tolerance(own, {"pin_circle": 10e-6}, {"pin_radius": 3e-6, "isometric": 4e-6})
    alone = float(geometric_error(own, {}))
    side = np.sqrt(1 - float(own.modified_short_width) ** 2)
    assert float(mean) == pytest.approx(alone + 2 * 10e-6 * side / 58.5e-3, rel=1e-12)
    assert float(tolerance) == pytest.approx(2 * 5e-6 / 58.5e-3, rel=1e-12)
    change = compensation(own, {"pin_radius": jnp.asarray(1 * arcmin)})
    left = geometric_error(own, {"pin_radius": change["pin_radius"]})
    assert float(left) == pytest.approx(alone - 1 * arcmin, abs=1e-15)
    with pytest.raises(gj.ParameterError, match="pin_radii"):
        geometric_error(own, {"pin_radii": jnp.asarray(0.0)})


@pytest.mark.parametrize("crank", [0.0, 1.1, 40.0])
def test_the_drawn_disc_touches_all_pins_of_a_conjugate_stage(crank):
    own = system("conjugate")
    outline = placed_outline(own, crank)
    places = 2 * np.pi * np.arange(40) / 40
    pins = 76 * mm * np.stack([np.cos(places), np.sin(places)], axis=1)
    apart = np.sqrt(((outline[:, None] - pins[None]) ** 2).sum(axis=2)).min(axis=0)
    np.testing.assert_allclose(apart, 3 * mm, atol=20 * um)  # the outline is a polygon
