"""Elimination of small positive definite problems, and that batches of coupled contacts end."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gearjax.elimination import LIBRARY_FROM, WRITTEN_OUT, eliminated, solved_definite

WAITING = """
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from gearjax.contact.coupled import coupled_balance

rng = np.random.default_rng(0)
root = rng.normal(size=(13, 13))
matrix = 1e-9 * jnp.asarray(root @ root.T + 13 * np.eye(13))
gap = jnp.asarray(1e-6 * rng.random((1000, 13)))
batch = jax.vmap(lambda gap, torque: coupled_balance(matrix * torque, 0.05 * jnp.ones(13), gap, 1e3 * torque))
program = jax.jit(lambda gap: [batch(gap, jnp.full(1000, torque)) for torque in (1.0, 1.1, 1.2, 1.3)])
for _ in range(30):
    jax.block_until_ready(program(gap))
"""


def definite(rng, rows, lanes=1):
    root = rng.normal(size=(lanes, rows, rows))
    return jnp.asarray(root @ root.swapaxes(1, 2) + 0.1 * np.eye(rows))


@pytest.mark.parametrize("rows", [1, 2, WRITTEN_OUT, WRITTEN_OUT + 1, 23, LIBRARY_FROM - 1, LIBRARY_FROM])
def test_solutions_are_those_of_numpy(rng, rows):
    matrix, right = definite(rng, rows, 3), jnp.asarray(rng.normal(size=(3, rows, 2)))
    wanted = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(jax.vmap(eliminated)(matrix, right), wanted, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(jax.vmap(solved_definite)(matrix, right[..., 0]), wanted[..., 0], rtol=1e-9, atol=1e-12)
    single = eliminated(matrix[0].astype(jnp.float32), right[0].astype(jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, wanted[0], rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("rows", [1, 5, WRITTEN_OUT + 1, LIBRARY_FROM])
def test_an_indefinite_matrix_gives_nan(rng, rows):
    matrix = definite(rng, rows)[0]
    lowest = np.linalg.eigvalsh(matrix)[0]
    found = eliminated(matrix - (lowest + 1e-3) * jnp.eye(rows), jnp.ones((rows, 1)))
    assert np.isnan(found).any()


@pytest.mark.parametrize("rows", [3, WRITTEN_OUT + 2])
def test_derivatives_are_differences(rng, rows):
    matrix, right = definite(rng, rows, 2), jnp.asarray(rng.normal(size=(2, rows)))

    def solution(root, right):
        return jax.jit(jax.vmap(solved_definite))(root + root.swapaxes(1, 2), right)

    check_grads(solution, (0.5 * matrix, right), order=2, modes=("fwd", "rev"), rtol=1e-4)


@pytest.mark.slow
def test_batches_do_not_wait_for_each_other():
    """Two threads, four batches that start together: with JAX's factorisations this program stood still for ever."""
    environment = os.environ | {"NPROC": "2", "JAX_PLATFORMS": "cpu", "XLA_FLAGS": ""}
    subprocess.run([sys.executable, "-c", WAITING], env=environment, check=True, timeout=120)
