"""The scan of the steps: the same alone, in batches of any of its arguments and nested, with its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.analysis.fast.recurrence import recur
from gearjax.analysis.metrics import top

STEPS = 30


def run(position, change, rows, factor):
    """A springy step that is driven by a number from a row and a constant, and has a constant of its own."""

    def step(position, change, push):
        return 0.9 * change - 0.1 * factor["stiffness"][1] * jnp.sin(position) + push

    def driven(row):  # or rows
        return row["push"] * factor["size"]

    (last, ended), path = recur(step, driven, driven, position, change, {"push": rows})
    return jnp.concatenate([path, last[None], ended[None]])


def plain(position, change, rows, factor):
    """The same with a loop."""
    path = []
    for push in rows:
        change_next = 0.9 * change - 0.1 * factor["stiffness"][1] * jnp.sin(position) + push * factor["size"]
        path.append(position)
        position, change = position + change_next, change_next
    return jnp.stack([*path, position, change])


@pytest.fixture
def given(rng):
    factor = {"stiffness": jnp.asarray(rng.uniform(0.5, 2.0, (4, 3))), "size": jnp.asarray(rng.uniform(0.5, 1.0, 4))}
    numbers = (rng.normal(size=4), rng.normal(size=4), rng.normal(size=(4, STEPS)))
    return *(jnp.asarray(number) for number in numbers), factor


@pytest.mark.parametrize("batched", [(0, 0, 0, 0), (0, None, None, None), (None, None, 0, None), (None, 0, None, 0)])
def test_batches_are_loops(given, batched):
    """With some arguments batched and the others shared."""
    shared = [
        value if axis == 0 else jax.tree.map(lambda leaf: leaf[0], value)
        for value, axis in zip(given, batched, strict=True)
    ]
    together = jax.jit(jax.vmap(run, batched))(*shared)
    for index in range(4):
        single = [
            jax.tree.map(lambda leaf, index=index: leaf[index], value) if axis == 0 else value
            for value, axis in zip(shared, batched, strict=True)
        ]
        np.testing.assert_allclose(together[index], plain(*single), rtol=0, atol=1e-13)


@pytest.mark.parametrize("lanes", [255, 256, 512])
def test_many_lanes_are_few(rng, lanes):
    """Vectors that would fight for places of the cache are longer than they need to be: none of it is seen."""
    factor = {"stiffness": jnp.ones(3), "size": jnp.asarray(rng.uniform(0.5, 1.0, lanes))}
    starts, pushes = jnp.asarray(rng.normal(size=lanes)), jnp.asarray(rng.normal(size=(lanes, STEPS)))
    over = jax.jit(jax.vmap(run, (0, None, 0, {"stiffness": None, "size": 0})))
    together = over(starts, jnp.ones(()), pushes, factor)
    assert together.shape == (lanes, STEPS + 2)
    for index in (0, lanes - 1):
        single = {"stiffness": factor["stiffness"], "size": factor["size"][index]}
        np.testing.assert_allclose(
            together[index], plain(starts[index], jnp.ones(()), pushes[index], single), rtol=0, atol=1e-13
        )


def test_nested_batches(given):
    position, change, rows, factor = given
    inner = jax.vmap(run, (0, None, None, None))
    outer = jax.vmap(inner, (None, 0, 0, 0))(position, change, rows, factor)
    assert outer.shape == (4, 4, STEPS + 2)
    single = run(position[2], change[1], rows[1], jax.tree.map(lambda leaf: leaf[1], factor))
    np.testing.assert_allclose(outer[1, 2], single, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_derivatives_are_those_of_the_loop(given):
    """Both modes, alone and under vmap and jit, with respect to every argument; and twice."""

    def total(function):
        return lambda arguments: (function(*arguments) ** 2).sum()

    expected = jax.vmap(jax.grad(total(plain)))(given)
    for gradient in (jax.grad, jax.jacfwd):
        found = jax.jit(jax.vmap(gradient(total(run))))(given)
        jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9), found, expected)
    one = jax.tree.map(lambda leaf: leaf[0], given)
    found = jax.hessian(lambda position: total(run)((position, *one[1:])))(one[0])
    second = jax.hessian(lambda position: total(plain)((position, *one[1:])))(one[0])
    np.testing.assert_allclose(found, second, rtol=1e-8)


@pytest.mark.parametrize("moved", ["position", "change", "rows", "stiffness", "size"])
def test_derivatives_where_the_rest_stays(given, moved):
    """What no derivative is asked for is left out of the work; the derivative is the same."""
    position, change, rows, factor = (jax.tree.map(lambda leaf: leaf[0], part) for part in given)
    numbers = {"position": position, "change": change, "rows": rows, **factor}

    def of(function):
        def ended(number):
            put = {**numbers, moved: number}
            factor = {"stiffness": put["stiffness"], "size": put["size"]}
            return function(put["position"], put["change"], put["rows"], factor)[-2]

        return ended

    expected = jax.grad(of(plain))(numbers[moved])
    assert np.any(np.asarray(expected) != 0)
    for gradient in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(jax.jit(gradient(of(run)))(numbers[moved]), expected, rtol=1e-10, atol=1e-12)


@pytest.mark.slow
def test_the_highest_of_equal_values_has_a_derivative():
    """The first of them carries it; the built-in maximum would share it, and lose it where it is rounded otherwise."""
    values = jnp.array([[1.0, 3.0, 3.0], [2.0, 0.0, 1.0]])
    assert top(values).tolist() == [3.0, 2.0]
    for slopes in (jax.jacrev(top)(values), jax.jacfwd(top)(values)):
        np.testing.assert_array_equal(slopes, [[[0, 1, 0], [0, 0, 0]], [[0, 0, 0], [1, 0, 0]]])
