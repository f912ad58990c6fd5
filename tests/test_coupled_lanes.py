"""Many gaps and loads under one matrix: the answers and derivatives of one problem after the other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.contact.coupled import MANY, coupled_balance
from tests.test_coupled import balance, missed, problem

NUMBER, LANES = MANY + 12, 6
over = jax.vmap(coupled_balance, (None, 0, 0, 0))


def lanes(family: str, rng) -> tuple:
    """One matrix, levers of both flanks, gaps and loads from hardly any to much, and none."""
    given = [problem(family, NUMBER, rng) for _ in range(LANES)]
    loads = -np.array([0.0, 1e-9, 1e-2, 1.0, 30.0, 300.0])
    return tuple(
        jnp.asarray(part) for part in (given[0][0], *(np.stack([one[i] for one in given]) for i in (1, 2)), loads)
    )


@pytest.mark.slow
@pytest.mark.parametrize("family", ["kernel", "gauss"])
def test_lanes_of_one_matrix_are_single_problems(family, rng):
    matrix, levers, gaps, loads = lanes(family, rng)
    position, forces, result = jax.jit(over)(matrix, levers, gaps, loads)
    np.testing.assert_array_equal(result, 0)
    for lane in range(LANES):
        known = balance(matrix, levers[lane], gaps[lane], loads[lane])
        np.testing.assert_allclose(forces[lane], known[1], atol=1e-10 * float(known[1].max()))
        assert float(position[lane]) == pytest.approx(float(known[0]), rel=1e-10)
        if lane:
            given = (np.asarray(part) for part in (matrix, levers[lane], gaps[lane], loads[lane]))
            assert missed(*given, position[lane], np.asarray(forces[lane])) < 1e-12


@pytest.mark.slow
def test_lanes_in_float32_follow_those_in_float64(rng):
    """Slices of teeth, whose matrix has a condition of 15: forces to 2e-5 of the largest."""
    number, many = 99, 200
    place = np.arange(number)
    matrix = 0.2 * np.eye(number) + np.exp(-np.abs(place[:, None] - place) / 3) * (1 + 0.02 * rng.normal(size=number))
    matrix = 0.5 * (matrix + matrix.T)
    given = matrix, np.ones((many, number)), rng.exponential(size=(many, number)), np.geomspace(3, 300, many)
    doubles, singles = ([jnp.asarray(part, dtype) for part in given] for dtype in (jnp.float64, jnp.float32))
    known, near = (np.asarray(jax.jit(over)(*parts)[1]) for parts in (doubles, singles))
    assert near.dtype == np.float32
    assert (np.abs(near - known).max(axis=1) / known.max(axis=1)).max() < 2e-5


@pytest.mark.slow
def test_gradients_of_lanes_are_those_of_single_problems(rng):
    matrix, levers, gaps, loads = lanes("kernel", rng)
    weights = jnp.asarray(rng.normal(size=NUMBER))

    def told(*given):
        position, forces, _ = coupled_balance(*given)
        return position + weights @ forces

    slopes = jax.grad(told, argnums=(0, 1, 2, 3))
    found = jax.jit(jax.vmap(slopes, (None, 0, 0, 0)))(matrix, levers, gaps, loads)
    alone = jax.jit(slopes)
    for lane in range(1, LANES):
        known = alone(matrix, levers[lane], gaps[lane], loads[lane])
        for one, other in zip(found, known, strict=True):
            np.testing.assert_allclose(one[lane], other, rtol=1e-8, atol=1e-10 * float(jnp.abs(other).max()))
