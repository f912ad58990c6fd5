"""Samples are functions of the seed and their own index; intervals of estimates hold what they say."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import gearjax as gj
from gearjax.tolerance import statistics
from gearjax.tolerance.sampling import REPLICATES, SAMPLERS, points, replicate_sizes

NAMES = ("a", "b", "c")
SETS = 4  # of numbers that are drawn at once: quicker than one by one


@pytest.mark.parametrize("sampler", SAMPLERS)
@settings(max_examples=30, deadline=None)
@given(number=st.integers(2, 700), begin=st.integers(0, 699), length=st.integers(0, 700), seed=st.integers(0, 2**31))
def test_a_part_of_the_samples_is_bit_for_bit_that_part(sampler, number, begin, length, seed):
    begin = min(begin, number)
    end = min(begin + length, number)
    whole = points(sampler, seed, NAMES, number, 0, number)
    assert whole.shape == (number, 3)
    assert (whole > 0).all()
    assert (whole < 1).all()
    part = points(sampler, seed, NAMES, number, begin, end)
    assert part.tobytes() == whole[begin:end].tobytes()


def test_numbers_are_the_same_on_every_machine():
    found = points("monte_carlo", 7, ("errors.planet_1.amplitude",), 3, 0, 3)[:, 0]
    assert found.tolist() == [0.6119850120584932, 0.3344208006222339, 0.4007177017096425]


@pytest.mark.parametrize("sampler", ["monte_carlo", "latin_hypercube"])
def test_another_number_beside_it_changes_nothing(sampler):
    alone = points(sampler, 3, ("b",), 100, 0, 100)
    among = points(sampler, 3, ("a", "b", "c"), 100, 0, 100)
    assert alone[:, 0].tobytes() == among[:, 1].tobytes()
    assert not np.isclose(among[:, 0], among[:, 1]).any()


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_points_are_uniform_and_independent(sampler):
    found = points(sampler, 11, NAMES, 20_000, 0, 20_000)
    for column in found.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4
    assert np.abs(np.corrcoef(found.T) - np.eye(3)).max() < 0.03
    assert np.abs(np.corrcoef(found[1:, 0], found[:-1, 0])[0, 1]) < 0.03
    assert (points(sampler, 12, NAMES, 100, 0, 100) != found[:100]).all()


def test_a_latin_hypercube_visits_each_stratum_once():
    sizes = replicate_sizes("latin_hypercube", 1000)
    assert (len(sizes), sizes.sum()) == (REPLICATES, 1000)
    found = points("latin_hypercube", 0, NAMES, 1000, 0, 1000)
    edge = 0
    for size in sizes:
        strata = np.floor(found[edge : edge + size] * size).astype(int)
        assert (np.sort(strata, axis=0) == np.arange(size)[:, None]).all()
        edge += size


def test_an_unknown_sampler_is_refused():
    with pytest.raises(gj.ParameterError, match="did you mean"):
        points("sobal", 0, NAMES, 10, 0, 10)


def populations(sampler, seed, number, sets):
    """Sums that are normal with mean 1 and variance 4 + 9, of three numbers each."""
    names = [f"{name}{of}" for of in range(sets) for name in NAMES]
    cube = points(sampler, seed, names, number, 0, number)
    for low, radius, phase in cube.T.reshape(sets, 3, number):
        first = gj.Normal(1.0, 2.0).quantile(low)
        yield first + 3 * gj.Rayleigh(1.0).quantile(radius) * np.cos(gj.UniformPhase().quantile(phase))


def population(sampler, seed, number):
    return next(populations(sampler, seed, number, 1))


@pytest.mark.slow
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_intervals_hold_the_truth_as_often_as_they_say(sampler):
    truth, number, repeats = stats.norm(1.0, np.sqrt(13.0)), 512, 500  # 200 would scatter by 1.5 % themselves
    sizes = replicate_sizes(sampler, number)
    hits: dict = {}
    several = (populations(sampler, seed, number, SETS) for seed in range(repeats // SETS))
    for values in itertools.chain.from_iterable(several):
        for level in (0.05, 0.5, 0.95):
            found = statistics.quantile(values, level, sizes)
            hits.setdefault(f"quantile {level}", []).append(found.low <= truth.ppf(level) <= found.high)
        for limit in (-4.0, 2.0, 6.0):
            found = statistics.share(values <= limit, sizes)
            hits.setdefault(f"yield {limit}", []).append(found.low <= truth.cdf(limit) <= found.high)
    for what, held in hits.items():
        assert 0.925 <= np.mean(held) <= 0.975, what


@pytest.mark.parametrize("sampler", ["latin_hypercube", "sobol"])
def test_designs_are_closer_and_their_intervals_say_so(sampler):
    sizes, number = replicate_sizes(sampler, 2048), 2048
    wide = statistics.share(population("monte_carlo", 1, number) <= 1.0, np.array([number]))
    close = statistics.share(population(sampler, 1, number) <= 1.0, sizes)
    assert close.high - close.low < 0.7 * (wide.high - wide.low)


def test_wilson_is_the_published_interval():
    # 8 of 10 good: 49.0 to 94.3 % (Wilson 1927; Brown, Cai, DasGupta 2001)
    low, high = statistics.wilson(0.8, 10.0, 1.959964)
    assert (low, high) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    all_good = statistics.share(np.ones(100, bool), np.array([100]))
    assert (all_good.value, all_good.high) == (1.0, 1.0)
    assert all_good.low == pytest.approx(0.963, abs=1e-3)


def test_quantiles_of_nothing_and_of_one():
    assert np.isnan(statistics.quantile(np.empty(0), 0.5, np.array([0]))).all()
    assert statistics.quantile(np.array([3.0]), 0.5, np.array([1])) == (3.0, -np.inf, np.inf)


@pytest.mark.parametrize("number", [3, 10, 20, 40])
def test_intervals_of_few_samples_are_open_where_they_cannot_tell(number):
    rng = np.random.default_rng(number)
    held = []
    for _ in range(1000):
        found = statistics.quantile(rng.normal(size=number), 0.05, np.array([number]))
        held.append(found.low <= stats.norm.ppf(0.05) <= found.high)
    assert np.mean(held) > 0.92
