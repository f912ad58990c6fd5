"""Numbers that a compiled program works out once, and matrices of which only some are in memory at a time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import block_diag

import gearjax as gj
from gearjax.analysis import quasi_static
from gearjax.contact.springs import FEW_BLOCKS, block_diagonal
from gearjax.kernels import once
from tests.test_matrix import ROOT


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_values_and_derivatives_stay(shape, rng):
    x, way = (jnp.asarray(rng.standard_normal(shape)) for _ in range(2))

    def both(x):
        sine, cube = once(jnp.sin(x), x**3)
        return sine, cube

    value, change = jax.jit(lambda x, way: jax.jvp(both, (x,), (way,)))(x, way)
    np.testing.assert_array_equal(value[1], x**3)
    np.testing.assert_allclose(change[0], jnp.cos(x) * way, rtol=1e-15)
    slope = jax.grad(lambda x: sum(part.sum() for part in both(x)))(x)
    np.testing.assert_allclose(slope, jnp.cos(x) + 3 * x**2, rtol=1e-14)


@pytest.mark.parametrize("number", [1, 2, FEW_BLOCKS, FEW_BLOCKS + 1])
def test_blocks_on_the_diagonal(number, rng):
    blocks = rng.standard_normal((2, number, 3, 3))
    whole = jax.vmap(block_diagonal)(jnp.asarray(blocks))
    np.testing.assert_array_equal(whole, [block_diag(*each) for each in blocks])
    np.testing.assert_array_equal(block_diagonal(jnp.asarray(blocks)), whole)


def coupled() -> gj.Scene:
    return gj.load(ROOT / "configs/involute_rv/yang_2019.toml")


@pytest.mark.slow
def test_memory_of_coupled_contacts_does_not_grow_with_the_angles():
    """Each angle has a matrix of 110 x 110 numbers, which are in memory several times while it is worked out."""
    scene = coupled().precomputed("backlash", "compliance")

    def needed(angles: int) -> float:
        theta, torque = jnp.linspace(0.0, 1.0, angles), jnp.asarray(100.0)
        program = jax.jit(lambda theta: gj.transmission_error(scene, theta, torque).te)
        return program.lower(theta).compile().memory_analysis().temp_size_in_bytes / 2**20

    assert needed(2000) < needed(400) + 20
    assert needed(400) < 100  # MiB; the matrices alone of all angles would be 37


@pytest.mark.slow
@pytest.mark.parametrize("varying", [False, True])
def test_batches_of_angles_are_the_angles_one_by_one(monkeypatch, varying):
    scene = dataclasses.replace(coupled(), reference=None)
    theta = jnp.linspace(0.1, 0.4, 11)
    torque = jnp.linspace(50.0, 150.0, 11) if varying else jnp.asarray(80.0)
    whole = gj.transmission_error(scene, theta, torque)
    monkeypatch.setattr(quasi_static, "MOST_NUMBERS", 4 * 110**2)
    jax.clear_caches()
    parts = gj.transmission_error(scene, theta, torque)
    np.testing.assert_allclose(parts.te, whole.te, rtol=1e-12)
    np.testing.assert_allclose(parts.forces, whole.forces, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(parts.carriers, whole.carriers)
    jax.clear_caches()
