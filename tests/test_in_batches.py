"""Rows side by side in even batches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.batches import in_batches


@pytest.mark.parametrize("number", [1, 5, 8, 9, 17, 24])
def test_every_row_once_and_one_program(number):
    rows = {"x": jnp.arange(float(number)), "y": jnp.ones((number, 2)) * jnp.arange(float(number))[:, None]}
    shapes = []

    def one(row):
        shapes.append(row["y"].shape)
        return row["x"] ** 2, row["y"].sum()

    square, total = jax.jit(lambda rows: in_batches(one, rows, 8))(rows)
    np.testing.assert_array_equal(square, np.arange(number) ** 2.0)
    np.testing.assert_array_equal(total, 2.0 * np.arange(number))
    assert len(shapes) == 1, "a second batch size would be a second program"


def test_derivatives_are_those_of_the_rows():
    """Rows that fill the last batch have no part in them."""
    slope = jax.grad(lambda rows: in_batches(lambda x: x**3, rows, 4).sum())(jnp.arange(9.0))
    np.testing.assert_allclose(slope, 3 * np.arange(9.0) ** 2)
