"""Guo and Fang (2018): vibration of their pairs, harmonic balance against steps, damping of table 3."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.periodic import shoot
from gearjax.analysis.return_map import Problem
from gearjax.units import rpm, um
from tests.helical_pairs import GUO_1, GUO_2, TEETH, meshes_of, pair_of, scene_of
from tests.test_clearance_oscillator import RATE, STATIC, TORQUE, oscillator
from tests.test_natural_modes import published

WAYS = ("x", "y", "z", "rx", "ry")
DAMPERS = {"pinion": (401, 401, 283, 40.2, 40.2), "wheel": (883, 883, 624, 147, 147)}  # table 3 [N s/m, N m s/rad]
LOAD = 830.0  # N m


def on_dampers(scene: gj.Scene, **system) -> gj.Scene:
    """The pair of table 1 in all coordinates, with the dampers of table 3."""
    supports = {
        body: dataclasses.replace(
            scene.supports[body], **{f"{way}_damping": float(c) for way, c in zip(WAYS, each, strict=True)}
        )
        for body, each in DAMPERS.items()
    }
    own = dataclasses.replace(scene.system, input_speed=jnp.asarray(2104 * rpm), **system)
    return dataclasses.replace(
        scene, system=own, supports=supports, load=gj.ConstantLoad(), damping=gj.DampingRatio(0.07)
    )


def along_normal(pair) -> float:
    return float(pair.gears[1].base_radius * jnp.cos(pair.base_helix_angle))


@pytest.mark.slow
def test_dampers_of_table_3_are_half_a_percent_and_tilting_five():
    """``2 zeta sqrt(k m)`` of the bearings: the modes that hardly move the mesh have it."""
    modes = gj.natural_modes(on_dampers(published(1e-3)), LOAD)
    of = dict(zip(np.round(np.asarray(modes.frequencies)), np.asarray(modes.damping), strict=True))
    for frequency in (255.0, 360.0, 557.0, 794.0):  # of x, y and z
        assert of[frequency] == pytest.approx(0.0050, rel=0.012)
    for frequency in (1081.0, 3955.0):
        assert of[frequency] == pytest.approx(0.0499, rel=0.01)


@pytest.mark.slow
def test_twelve_coordinates_at_2104_rpm():
    """Harmonic balance against periodic steps, 1e-4 um asked: the input turns evenly, so there are eleven."""
    scene = on_dampers(published(75e-3), slices=8)
    mesh = 2 * math.pi / 19 / (2104 * rpm)
    balance = gj.harmonic_balance(scene, LOAD, mesh, harmonics=128, samples=2048)
    steps = gj.shooting(scene, LOAD, mesh, steps=2048)
    assert int(balance.result) == int(steps.result) == 0
    assert len(balance.coordinates) == 11
    off = np.asarray(balance.te - steps.te) * along_normal(scene.system.pair) / um
    swing = np.ptp(np.asarray(steps.te)) * along_normal(scene.system.pair) / um
    assert 5 < swing < 20
    assert np.abs(off).max() < 5e-6
    moved = np.asarray(balance.moved - steps.moved)
    assert np.abs(moved).max() < 1e-5 * np.ptp(np.asarray(steps.moved), axis=0).max()


@pytest.mark.slow
def test_section_4_3_with_run_outs():
    """Table 2 with a stiffness along contact lines and 10 um of both gears, 2000 rpm, 500 N m; 1e-6 um asked."""
    pair = pair_of(**GUO_2)
    length = GUO_2["face_width"] * float(pair.transverse_contact_ratio) / float(jnp.cos(pair.base_helix_angle))
    errors = {body: gj.Eccentricity(body, 10 * um, phase) for body, phase in (("pinion", 0.0), ("wheel", 0.4))}
    scene = dataclasses.replace(
        scene_of(GUO_2, errors, gj.LineStiffness(7.652e8 / length), slices=10, input_speed=2000 * rpm),
        inertia=gj.MomentOfInertia(0.6285 * float(pair.gears[1].base_radius) ** 2),
        damping=gj.DampingRatio(0.07),
        load=gj.ConstantLoad(),
    )
    modes = gj.natural_modes(scene, 500.0)
    assert float(modes.frequencies[0]) == pytest.approx(5097.0, rel=2e-3)
    cycle = scene.system.cycle / (2000 * rpm)
    balance = gj.harmonic_balance(scene, 500.0, cycle, harmonics=40 * 256, samples=40 * 1024)
    steps = gj.shooting(scene, 500.0, cycle, steps=40 * 1024)
    assert int(balance.result) == int(steps.result) == 0
    off = np.asarray(balance.te - steps.te) * along_normal(pair) / um
    assert np.abs(off).max() < 1e-6


@pytest.mark.slow
def test_unmodified_flanks_under_load():
    """The reference's own program: mean 5.01 um, first harmonic 0.587 um along the normals at 830 N m."""
    scene = scene_of(GUO_1, {}, TEETH, slices=40)
    te = np.asarray(gj.transmission_error(scene, meshes_of(scene.system, 64), LOAD).te)
    te = te * along_normal(scene.system.pair) / um
    assert te.mean() == pytest.approx(-5.01, rel=0.01)
    assert np.abs(np.fft.rfft(te)[1]) / 32 == pytest.approx(0.587, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("amplitude", "rate"), [(1.5, 0.918982), (2.0, 0.821021), (3.0, 0.662915)])
def test_backbone_of_the_free_oscillator_with_clearance(amplitude, rate):
    """Period of free motion that leaves contact: ``2 (pi - acos(1/A)) + 2 sqrt(A^2 - 1)``, in closed form."""
    period = 2 * (math.pi - math.acos(1 / amplitude)) + 2 * math.sqrt(amplitude**2 - 1)
    assert 2 * math.pi / period == pytest.approx(rate, abs=1e-6)
    scene = oscillator(None, rate, zeta=0.0, kappa=0.0)
    start = jnp.array([[-(1 + amplitude) * STATIC], [0.0]])  # furthest into the driving flanks
    free = shoot(Problem.of(scene, TORQUE, period / RATE), 2048, start, 0, 0)  # without a search
    te = np.asarray(free.te) / STATIC
    assert te.min() == pytest.approx(-1 - amplitude, rel=1e-9)
    assert te.max() == pytest.approx((amplitude**2 - 1) / 2, rel=1e-4)  # the height of a throw
    assert te[-1] == pytest.approx(te[1], rel=1e-4)  # the same on the way back, a step from the end as from the start
    assert float(free.residual) < 1e-4
