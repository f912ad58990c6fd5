"""The 2K-V reducer against its equations, written out apart from the package."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import deg, mm, rpm, um

ALPHA = math.radians(35.266)
RADIUS = 62.5e-3 * math.cos(math.radians(20))
SIZES = {"planet_1": 10e-6, "planet_2": 20e-6, "revolution": 10e-6, "output_wheel": 10e-6}
PHASES = {name: math.radians(p) for name, p in zip(SIZES, (90, 180, -135, 90), strict=True)}


def along_line(name, order, theta, sign, shift=0.0, ratio=79.0):
    """Eqs. 1-4: projection of one eccentricity, less its value at the start."""
    start = PHASES[name] + sign * ALPHA + shift
    return SIZES[name] * (np.sin(order * theta / ratio + start) - np.sin(start))


def increments(theta, sign):
    """Meshing-line increments of both pairs, driving (-1) or back (+1) side [m]."""
    shared = [along_line("revolution", 26, theta, sign), along_line("output_wheel", 25, theta, sign)]
    first = along_line("planet_1", 26, theta, sign) + sum(shared)
    second = along_line("planet_2", 26, theta, sign) - sum(shared)
    return first, second


def two_kv(**changes):
    keywords = {
        "sun_teeth": 12,
        "first_stage_planet_teeth": 36,
        "planet_teeth": 50,
        "ring_teeth": 52,
        "module": 2.5 * mm,
        "cutting_pressure_angle": 20 * deg,
        "working_pressure_angle": 35.266 * deg,
        "input_speed": 300 * rpm,
        "te_radius": "planet",
    }
    return gj.TwoKV(**{**keywords, **changes})


def test_no_load_is_the_larger_increment(scene, theta):
    expected = np.maximum(*increments(np.asarray(theta), -1)) / RADIUS
    np.testing.assert_allclose(gj.transmission_error(scene, theta).te, expected, rtol=0, atol=1e-15)


def test_backlash_is_eq_9(scene, theta):
    drive, back = increments(np.asarray(theta), -1), increments(np.asarray(theta), +1)
    play = gj.backlash(scene, theta)
    upper = (np.minimum(*back) + 0.15e-3) / RADIUS
    np.testing.assert_allclose(play.upper, upper, rtol=0, atol=1e-15)
    np.testing.assert_allclose(play.backlash, upper - np.maximum(*drive) / RADIUS, rtol=0, atol=1e-15)
    pairs = [back[i] - drive[i] + 0.15e-3 for i in range(2)]  # eq. 7
    each = np.minimum(*(np.asarray(drive[i]) + pairs[i] for i in range(2))) - np.maximum(*drive)
    np.testing.assert_allclose(play.backlash, each / RADIUS, rtol=0, atol=1e-15)


@pytest.mark.parametrize("torque", [0.3, 30.0, 100.0, 300.0, 1e4])
def test_static_is_eq_18(scene, theta, torque):
    first, second = increments(np.asarray(theta), -1)
    q = torque / (RADIUS * 9.245e7)
    both = np.abs(first - second) < q
    expected = np.where(both, (first + second) / 2 - q / 2, np.maximum(first, second) - q) / RADIUS
    te = gj.transmission_error(scene, theta, torque)
    np.testing.assert_allclose(te.te, expected, rtol=1e-12, atol=1e-17)
    forces = [
        np.clip((torque / RADIUS + sign * 9.245e7 * (first - second)) / 2, 0, torque / RADIUS) for sign in (1, -1)
    ]
    np.testing.assert_allclose(te.forces[:, :2], np.stack(forces, 1), rtol=1e-9, atol=1e-6)
    assert not np.asarray(te.forces[:, 2:]).any()


def test_orders_come_from_the_teeth():
    orders = two_kv().orders
    assert {name: round(order * 79, 9) for name, order in orders.items()} == {
        "output": 1,
        "crank": 25,
        "planet": 26,
        "mesh": 1300,
    }
    assert two_kv().cycle == pytest.approx(2 * math.pi * 79)
    other = two_kv(sun_teeth=20, first_stage_planet_teeth=30, planet_teeth=39, ring_teeth=42)
    assert 1 / other.orders["output"] == pytest.approx(1 + 1.5 * 14)
    assert other.orders["planet"] / other.orders["output"] == pytest.approx(14)
    assert other.orders["crank"] / other.orders["output"] == pytest.approx(13)
    assert other.orders["mesh"] / other.orders["output"] == pytest.approx(39 * 14)
    uneven = two_kv(planet_teeth=49)  # 52 / 3 turns of the crank: the errors repeat after three output turns
    assert uneven.cycle * uneven.orders["planet"] / (2 * math.pi) == pytest.approx(52)


def test_other_teeth_move_the_curve(scene, theta):
    system = dataclasses.replace(scene.system, planet_teeth=48, ring_teeth=51)
    te = gj.transmission_error(dataclasses.replace(scene, system=system), theta).te
    ratio = 1 + 3 * 17
    sides = []
    for wheel, sign in (("planet_1", 1), ("planet_2", -1)):
        shared = along_line("revolution", 17, np.asarray(theta), -1, ratio=ratio)
        shared = shared + along_line("output_wheel", 16, np.asarray(theta), -1, ratio=ratio)
        sides.append(along_line(wheel, 17, np.asarray(theta), -1, ratio=ratio) + sign * shared)
    np.testing.assert_allclose(te, np.maximum(*sides) / (60e-3 * math.cos(math.radians(20))), rtol=0, atol=1e-15)


def test_geometry():
    system = two_kv()
    assert float(system.radius) == pytest.approx(58.7308e-3, abs=5e-8)
    assert float(two_kv(te_radius="ring").radius) == pytest.approx(61.0800e-3, abs=5e-8)
    assert float(two_kv(te_radius=61.08 * mm).radius) == pytest.approx(61.08e-3)
    assert float(system.centre_distance) == pytest.approx(2.8773e-3, abs=5e-8)


@pytest.mark.slow
def test_three_planets(scene, theta):
    """Each pair sees revolution and output wheel a third of a turn later."""
    errors = {**scene.errors, "planet_3": gj.Eccentricity("planet_3", 5 * um, 20 * deg)}
    three = dataclasses.replace(scene, system=dataclasses.replace(scene.system, planets=3), errors=errors)
    angle = np.asarray(theta) / 79
    wheels = [(10e-6, 90), (20e-6, 180), (5e-6, 20)]
    curves = []
    for place, (size, phase) in enumerate(wheels):
        shift = -2 * math.pi * place / 3
        terms = [(size, math.radians(phase), 26), (10e-6, math.radians(-135) + shift, 26)]
        terms.append((10e-6, math.radians(90) + shift, 25))
        curves.append(sum(e * (np.sin(n * angle + p - ALPHA) - np.sin(p - ALPHA)) for e, p, n in terms))
    te = gj.transmission_error(three, theta)
    np.testing.assert_allclose(te.te, np.max(curves, axis=0) / RADIUS, rtol=0, atol=1e-15)
    loaded = gj.transmission_error(three, theta, torque=1000.0)
    np.testing.assert_allclose(loaded.forces.sum(axis=1), 1000 / RADIUS, rtol=1e-12)
    assert 1.0 <= float(loaded.load_sharing.min()) <= float(loaded.load_sharing.max()) <= 3.0


def test_absolute_reference_leaves_the_start_in(scene, theta):
    cycle = jnp.linspace(0.0, scene.system.cycle, 15801)
    absolute = gj.transmission_error(dataclasses.replace(scene, reference=None), cycle)
    assert float(absolute.peak_to_peak) / gj.units.arcmin == pytest.approx(2.101, abs=1e-3)
    assert float(absolute.amplitude) / gj.units.arcmin == pytest.approx(1.447, abs=1e-3)
    assert float(gj.transmission_error(scene, theta).te[0]) == 0.0


def test_the_errors_repeat_after_a_cycle(scene):
    theta = jnp.linspace(0.0, 30.0, 101)
    first = gj.transmission_error(scene, theta).te
    again = gj.transmission_error(scene, theta + scene.system.cycle).te
    np.testing.assert_allclose(first, again, rtol=0, atol=1e-15)
    half = gj.transmission_error(scene, theta + scene.system.cycle / 2).te
    assert float(abs(half - first).max()) > 1e-5


def test_perfect_bodies_have_no_error(scene, theta):
    perfect = dataclasses.replace(scene, errors={})
    assert not np.asarray(gj.transmission_error(perfect, theta).te).any()
