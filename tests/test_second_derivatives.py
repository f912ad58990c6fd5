"""Second derivatives against differences of gradients: exact geometry, places of extremes that move; interference."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from tests.conftest import ROOT


def shipped(name: str, **system) -> gj.Scene:
    scene = gj.load(ROOT / "configs" / name)
    return dataclasses.replace(scene, system=dataclasses.replace(scene.system, **system))


def elliptic(clearance: str = "linear") -> gj.Scene:
    return shipped("elliptic/dong_2020.toml", clearance=clearance)


def cycloidal(clearance: str = "linear") -> gj.Scene:
    return shipped("rv_cycloidal/hu_2020.toml", clearance=clearance)


def phase(scene: gj.Scene):
    return scene.errors["planet_1"].phase


def eccentricity(scene: gj.Scene):
    return scene.system.eccentricity


WHERE = np.linspace(0.0, 6.28, 201)


def static(scene: gj.Scene, torque: float) -> gj.TransmissionError:
    return gj.transmission_error(scene, np.array([1.3]), torque)


# a scene, one of its numbers, what depends on it
CASES = {
    "elliptic, exact, loaded": (lambda: elliptic("exact"), lambda s: s.system.module, lambda s: static(s, 10.0).te[0]),
    "elliptic, exact, force": (
        lambda: elliptic("exact"),
        eccentricity,
        lambda s: (static(s, 10.0).forces ** 2).sum() / 1e4,
    ),
    "elliptic, exact, backlash": (
        lambda: elliptic("exact"),
        eccentricity,
        lambda s: gj.backlash(s, np.array([1.3])).upper[0],
    ),
    "RV, exact, no load": (
        lambda: cycloidal("exact"),
        eccentricity,
        lambda s: gj.transmission_error(s, np.array([1.3])).te[0],
    ),
    "RV, exact, loaded": (lambda: cycloidal("exact"), eccentricity, lambda s: static(s, 784.0).te[0]),
    "RV, exact, zero torque": (lambda: cycloidal("exact"), eccentricity, lambda s: static(s, 0.0).te[0]),
    "2K-V, kink": (
        lambda: shipped("two_kv/wang_2020.toml"),
        phase,
        lambda s: gj.transmission_error(s, np.linspace(0.0, 40.0, 801)).amplitude,
    ),
    "2K-V, loaded": (
        lambda: shipped("two_kv/wang_2020.toml"),
        phase,
        lambda s: gj.transmission_error(s, np.linspace(0.0, 40.0, 801), 100.0).peak_to_peak,
    ),
    "elliptic, highest": (elliptic, eccentricity, lambda s: gj.transmission_error(s, WHERE, 10.0).extremes.maximum),
    "elliptic, lowest": (elliptic, eccentricity, lambda s: gj.transmission_error(s, WHERE, 10.0).extremes.minimum),
    "elliptic, speed": (elliptic, eccentricity, lambda s: gj.separation_speed(s, 10.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_against_differences_of_gradients(case):
    make, where, measure = CASES[case]
    scene = make()

    def of(number):
        return measure(eqx.tree_at(where, scene, number))

    here = jnp.asarray(where(scene))
    slope, step = jax.jit(jax.grad(of)), 1e-3 * float(abs(here))
    near, far = ((slope(here + n * step) - slope(here - n * step)) / (2 * n * step) for n in (1, 2))
    difference = (4 * near - far) / 3  # of fourth order
    exact = pytest.approx(float(difference), rel=1e-4)
    assert float(jax.jit(jax.hessian(of))(here)) == exact
    assert float(jax.jacfwd(jax.jacfwd(of))(here)) == exact


@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda: shipped("two_kv/wang_2020.toml"), cycloidal, elliptic])
def test_gradients_of_interference(make):
    """The largest overlap, and the position where it is least, by every error at once: jitted, batched, both modes."""
    scene = make()
    if not scene.has_back:
        scene = dataclasses.replace(scene, backlash=gj.InitialBacklash(5e-6))
    theta = np.linspace(0.1, 5.0, 7)
    moving, still = eqx.partition(scene.errors, eqx.is_inexact_array)

    def of(factor):
        errors = eqx.combine(jax.tree.map(lambda part: part * factor, moving), still)
        found = gj.interference(dataclasses.replace(scene, errors=errors), theta)
        return jnp.stack([found.overlap * 1e6, found.position * 1e6])

    factors, step = jnp.array([1.0, 1.01]), 1e-5
    both = jax.jit(jax.vmap(of))
    central = (both(factors + step) - both(factors - step)) / (2 * step)
    assert (np.abs(central).max(axis=(0, 2)) > 0).all()
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(jax.vmap(mode(of)))(factors), central, rtol=1e-6, atol=1e-6)
