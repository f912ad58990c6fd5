"""The highest value of a curve between its samples, of curves whose highest value is known."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.tolerance.refined import GROUPS, STEPS, highest_between, in_search_order

MANY = 2 * GROUPS + 5


def lines(slopes, samples, places):
    """The lowest of several lines: a roof with kinks, anywhere between the samples."""
    at = samples[None].astype(places.dtype) + places
    return (slopes[:, 0, None, None] + slopes[:, 1, None, None] * at[None]).min(axis=0)


def waves(numbers, samples, places):
    at = samples[None].astype(places.dtype) + places
    amplitude, order, phase = (numbers[:, i, None, None] for i in range(3))
    return (amplitude * jnp.sin(order * at[None] + phase)).sum(axis=0)


def at_samples(curve, numbers, number, dtype=float):
    values = curve(numbers, jnp.arange(number, dtype=jnp.int32), jnp.zeros((1, number), dtype))[0]
    return values[in_search_order(number)]


UP, DOWN = jnp.asarray(1.0), jnp.asarray(-1.0)


@pytest.mark.parametrize("number", [3, 4, 31, 32, 33, 63, 64, 65, 100, 1000, 1023, 1024, 1025])
def test_the_best_sample_is_found_in_every_group(number, rng):
    """Every sample comes once, and a curve that is high at one sample only is as high as that sample."""
    order = in_search_order(number)
    assert sorted(order) == list(range(number))

    def near(values, samples, places):
        return jnp.where(places == jnp.round(places), values[samples[None] + places.astype(jnp.int32)], 0.0)

    found = jax.jit(functools.partial(highest_between, near))
    for place in {*rng.integers(number, size=20), *order[:2], *order[-2:], 0, number - 1}:
        values = jnp.asarray(rng.uniform(0.0, 0.5, number)).at[int(place)].set(1.0)
        assert float(found(values, values[order], UP)) == 1.0
        assert float(found(-values, -values[order], DOWN)) == 1.0


@pytest.mark.parametrize("number", [3, 31, 32, 33, 64, 101])
def test_a_roof_between_two_samples(rng, number):
    """Two lines that cross at the ridge."""
    ridge = rng.uniform(1.0, number - 2.0)
    slopes = jnp.asarray([[1.0 - 0.3 * ridge, 0.3], [1.0 + 0.2 * ridge, -0.2]])
    found = highest_between(lines, slopes, at_samples(lines, slopes, number), UP)
    assert 1.0 - 0.3 / STEPS < float(found) <= 1.0 + 1e-14
    lowest = highest_between(lines, slopes, at_samples(lines, slopes, number), DOWN)
    ends = [float(lines(slopes, jnp.asarray([end], jnp.int32), jnp.zeros((1, 1)))[0, 0]) for end in (0, number - 1)]
    assert -float(lowest) == pytest.approx(min(ends), abs=1e-14)


@pytest.mark.slow
def test_waves_of_random_orders(rng):
    """The highest of places everywhere, within what their distance allows."""
    places = np.arange(-STEPS, STEPS + 1) / STEPS
    for _ in range(20):
        numbers = jnp.asarray(rng.uniform([0.1, 0.02, 0.0], [1.0, 0.4, 6.3], size=(4, 3)))
        everywhere = waves(
            numbers, jnp.arange(200, dtype=jnp.int32), jnp.broadcast_to(places[:, None], (len(places), 200))
        )
        values = at_samples(waves, numbers, 200)
        found = float(highest_between(waves, numbers, values, UP))
        assert float(values.max()) <= found <= float(everywhere.max()) + 1e-14
        assert found > float(everywhere.max()) - 2e-3


@pytest.mark.slow
def test_derivatives_are_those_of_the_place(rng):
    """Differences, in batches and compiled; exact where the place of the highest value moves smoothly or not at all."""
    numbers = jnp.asarray(rng.uniform([0.1, 0.05, 0.0], [1.0, 0.3, 6.3], size=(5, 4, 3)))

    def value(numbers):
        return highest_between(waves, numbers, at_samples(waves, numbers, 150), UP)

    slopes = jax.jit(jax.vmap(jax.grad(value)))(numbers)
    forward = jax.vmap(jax.jacfwd(value))(numbers)
    np.testing.assert_allclose(slopes, forward, rtol=1e-12)
    for row, slope in zip(numbers, slopes, strict=True):
        for place in ((0, 0), (1, 2), (3, 0)):
            step = 1e-7 * jnp.zeros_like(row).at[place].set(1.0)
            difference = (value(row + step) - value(row - step)) / 2e-7
            assert float(slope[place]) == pytest.approx(float(difference), abs=1e-6)


def test_single_precision_and_values_that_are_no_numbers():
    numbers = jnp.asarray([[1.0, 0.3, 0.2]], jnp.float32)
    found = highest_between(waves, numbers, at_samples(waves, numbers, MANY, jnp.float32), UP.astype(jnp.float32))
    assert found.dtype == jnp.float32
    assert float(found) == pytest.approx(1.0, abs=1e-3)
    numbers = numbers * jnp.nan
    lost = highest_between(waves, numbers, at_samples(waves, numbers, MANY, jnp.float32), UP.astype(jnp.float32))
    assert np.isnan(float(lost))


@pytest.mark.slow
def test_a_batch_is_a_loop(rng):
    numbers = jnp.asarray(rng.uniform([0.1, 0.05, 0.0], [1.0, 0.3, 6.3], size=(6, 3, 3)))

    def one(numbers, values):
        return highest_between(waves, numbers, values, UP)

    values = jnp.stack([at_samples(waves, row, 90) for row in numbers])
    together = jax.vmap(one)(numbers, values)
    np.testing.assert_allclose(together, [one(*each) for each in zip(numbers, values, strict=True)], rtol=1e-14)
