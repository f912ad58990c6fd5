"""Single precision works, and its error is known."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.units import arcmin
from tests.conftest import ROOT
from tests.helical_pairs import GUO_1, TEETH, scene_of
from tests.test_matrix import KINDS, MOVES, TORQUE, Case, on_supports


@pytest.fixture
def single(scene):
    return jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene)


@pytest.mark.slow
def test_quasi_static(scene, single, theta):
    """No-load and static TE within 5e-5 arcmin over 3 s, metrics too; forces within a part in 10^4."""
    narrow = theta.astype(jnp.float32)
    for torque in (None, 30.0, 300.0):
        wide, found = gj.transmission_error(scene, theta, torque), gj.transmission_error(single, narrow, torque)
        assert found.te.dtype == jnp.float32
        assert np.abs(np.asarray(found.te, np.float64) - np.asarray(wide.te)).max() / arcmin < 5e-5
        for name in ("peak_to_peak", "amplitude", "mean", "std"):
            assert float(getattr(found, name)) == pytest.approx(float(getattr(wide, name)), abs=1e-4 * arcmin)
        if torque is not None:
            worst = np.abs(np.asarray(found.forces) - np.asarray(wide.forces)).max()
            assert worst < 1e-3 * float(wide.forces.max())


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, True])
def test_long_records_in_motion(held, scene, single):
    """Rounding of their times is more than a thousandth of their spacing; a trace tells samples that are uneven."""
    if held:
        scene, single = (on_supports(one) for one in (scene, single))
        single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), single)
    ts = np.linspace(0.0, 2.0, 20_001)
    wide, narrow = gj.simulate(scene, ts, 100.0), gj.simulate(single, ts.astype(np.float32), 100.0)
    assert int(narrow.result) == 0
    assert narrow.te.dtype == jnp.float32
    assert np.abs(np.asarray(narrow.te, float) - np.asarray(wide.te)).max() < 1e-4 * float(wide.peak_to_peak)
    uneven = jnp.asarray(ts, jnp.float32).at[7].add(2e-5)
    stepper = gj.FixedStep(per_sample=4)
    assert int(jax.jit(lambda ts: gj.simulate(single, ts, 100.0, stepper=stepper).result)(uneven)) == 5


@pytest.mark.slow
def test_gradients_are_close(scene, single, theta):
    def loss(scene, theta):
        return gj.transmission_error(scene, theta, 100.0).std

    wide = jax.grad(loss)(scene, theta).errors["planet_2"].phase
    narrow = jax.grad(loss)(single, theta.astype(jnp.float32)).errors["planet_2"].phase
    assert float(narrow) == pytest.approx(float(wide), rel=1e-3)


def test_a_user_who_sets_nothing_gets_float32():
    """Without x64 the library loads, runs and warns of nothing."""
    with jax.enable_x64(False):
        scene = gj.loads("""
            [system]
            kind = "two_kv"
            sun_teeth = 12
            first_stage_planet_teeth = 36
            planet_teeth = 50
            ring_teeth = 52
            module = "2.5 mm"
            cutting_pressure_angle = "20 deg"
            working_pressure_angle = "35.266 deg"
            input_speed = "300 rpm"
            te_radius = "planet"
            [errors.one]
            kind = "eccentricity"
            body = "planet_1"
            amplitude = "10 um"
            phase = "0 deg"
        """)
        te = gj.transmission_error(scene, np.linspace(0.0, 100.0, 501))
        assert te.te.dtype == jnp.float32
        assert bool(jnp.isfinite(te.peak_to_peak))


SLICES = "slices of a helical pair"


def _moving(gear_set: str) -> gj.Scene:
    if gear_set != SLICES:
        return on_supports(Case(gear_set, *KINDS).scene)
    moving = {"load": gj.ConstantLoad(), "inertia": gj.MomentOfInertia(0.39), "damping": gj.DampingRatio(0.07)}
    return dataclasses.replace(scene_of(GUO_1, {}, gj.LineStiffness(1.4e10), slices=4), **moving)


@pytest.mark.slow
@pytest.mark.parametrize("gear_set", [*MOVES, SLICES])
def test_single_precision_after_double_precision_in_one_process(gear_set):
    """Layouts are kept, with the indices that they have made: JAX refused those that it had seen in float64."""
    moving, found = _moving(gear_set), []
    for wide in (True, False):
        with jax.enable_x64(wide):
            scene = moving if wide else jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), moving)
            theta, ts = np.linspace(0.1, 1.0, 11), np.linspace(0.0, 0.002, 5)
            te, motion = gj.transmission_error(scene, theta, TORQUE), gj.simulate(scene, ts, TORQUE)
            found.append([np.asarray(part) for part in (te.te, te.load_sharing, motion.te)])
    for wide, narrow in zip(*found, strict=True):
        assert narrow.dtype == np.float32
        np.testing.assert_allclose(narrow, wide, rtol=0.0, atol=2e-3 * np.abs(wide).max())


def _few_teeth() -> gj.Scene:
    """An involute RV reducer whose external gear has its root below the base circle."""
    scene = gj.load(ROOT / "configs/involute_rv/yang_2019.toml")
    given = {"external_teeth": 30, "internal_teeth": 34, "pairs": 1, "profile_points": 2, "internal_shift": 0.6}
    given |= {"module": 2e-3, "external_addendum": 0.7, "internal_addendum": 0.6, "centre_distance": 4.6e-3}
    teeth = dataclasses.replace(scene.compliance, rim=2e-3, neighbours=0)
    return dataclasses.replace(scene, system=dataclasses.replace(scene.system, **given), compliance=teeth)


@pytest.mark.slow
@pytest.mark.parametrize("teeth", ["straight root", "hertz", "elastic_teeth"])
def test_gradients_by_all_numbers_of_teeth(teeth):
    """At the base circle slopes are infinite: in float32 the beginning of a flank was at the base circle itself."""
    found = []
    for wide in (True, False):
        with jax.enable_x64(wide):
            if teeth == "elastic_teeth":
                scene, torque = _few_teeth(), 40.0
            else:
                own = dataclasses.replace(TEETH, contact="hertz") if teeth == "hertz" else TEETH
                scene, torque = scene_of(GUO_1, {}, own, slices=2), 830.0
            kind = jnp.float64 if wide else jnp.float32
            scene = jax.tree.map(lambda leaf, kind=kind: jnp.asarray(leaf, kind), scene)

            def position(scene, torque=torque):
                return gj.transmission_error(scene, jnp.asarray([0.3]), torque, extremes="samples").te[0]

            slopes = jax.tree.leaves(eqx.filter_jit(eqx.filter_grad(position))(scene))
            found.append([np.asarray(slope, float) for slope in slopes])
    sizes = [np.abs(np.asarray(leaf, float)) for leaf in jax.tree.leaves(scene)]
    largest = max(float((np.abs(slope) * size).max()) for slope, size in zip(found[0], sizes, strict=True))
    assert largest > 0
    for one, other, size in zip(*found, sizes, strict=True):
        np.testing.assert_allclose(other * size, one * size, rtol=2e-3, atol=1e-4 * largest)
