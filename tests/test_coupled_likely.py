"""Many gaps and loads that few contacts carry: the answers of single problems, also where the estimate errs."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.contact.conjugate import FEWER, Begin, descended
from gearjax.contact.coupled import ENOUGH, MANY, coupled_balance
from gearjax.contact.likely import (
    ALL_PRECONDITIONED,
    MANY_LANES,
    SIZES,
    WORTH_WHILE,
    Example,
    descended_among_few,
    inverse_of_all,
    linear_among_few,
    preconditioner_of,
)
from tests.test_coupled import balance, missed

pytestmark = pytest.mark.slow

NUMBER, LANES = 2 * MANY, WORTH_WHILE + 8
ALL = jnp.ones(NUMBER, bool)
over = jax.jit(jax.vmap(coupled_balance, (None, 0, 0, 0)))


def population(rng, spread: float = 0.05) -> tuple[np.ndarray, ...]:
    """Contacts in a row on an elastic body, whose gaps grow to both sides and move by little from lane to lane."""
    place = np.linspace(-1, 1, NUMBER)
    matrix = np.exp(-5 * np.abs(place[:, None] - place)) + 0.3 * np.eye(NUMBER)
    shift = rng.normal(size=(LANES, 1)) * spread
    gaps = 8 * (place - shift) ** 2 + 3 * spread * rng.normal(size=(LANES, 1)) + 0.2 * spread * rng.normal(size=NUMBER)
    levers = np.broadcast_to(-rng.uniform(0.8, 1.2, NUMBER), gaps.shape)
    return matrix, levers, gaps, np.full(LANES, -1.0)


def are_single_problems(matrix, levers, gaps, loads) -> np.ndarray:
    """Check every lane by itself; the forces."""
    positions, forces, results = (np.asarray(part) for part in over(matrix, levers, gaps, loads))
    np.testing.assert_array_equal(results, 0)
    for lane in range(LANES):
        position, alone, _ = balance(matrix, levers[lane], gaps[lane], loads[lane])
        np.testing.assert_allclose(forces[lane], alone, atol=1e-12 * float(alone.max()))
        assert positions[lane] == pytest.approx(float(position), rel=1e-12)
        if loads[lane]:
            assert missed(matrix, levers[lane], gaps[lane], loads[lane], positions[lane], forces[lane]) < 1e-12
    return forces


def columns(_, levers, gaps, loads) -> tuple:
    """Arguments of the solution of many lanes, with the lanes last."""
    apart = gaps - levers * (gaps / levers).max(axis=1, keepdims=True)
    return tuple(jnp.asarray(part) for part in (levers.T, apart.T, loads, levers.T < 0))


def example_of(matrix, levers, gaps, loads) -> Example:
    lever, apart, load, loaded = columns(matrix, levers, gaps, loads)
    return Example.of(jnp.asarray(matrix), lever.T, apart.T, load, loaded.T)


def test_the_estimate_names_all_that_carry_and_few_others(rng):
    given = population(rng)
    _, apart, load, loaded = columns(*given)
    likely = np.asarray(example_of(*given).likely(apart, load, loaded))
    carry = are_single_problems(*given) > 0
    assert not (carry & ~likely).any()
    assert likely.sum() <= 2 * carry.any(axis=0).sum() < 0.5 * NUMBER


def test_what_is_found_among_few_needs_no_step_among_all(rng):
    """Without the start among few, the same takes many products with the whole matrix."""
    given = population(rng)
    matrix, lanes = jnp.asarray(given[0]), columns(*given)
    at = descended_among_few(example_of(*given), None, matrix, *lanes, ENOUGH)
    assert at.done.all()
    assert int(at.step) == 0
    assert int(descended(matrix, *lanes, ENOUGH).step) > 15


@pytest.mark.parametrize("lacking", [(), (0,), (3, 4)])
def test_a_start_counts_as_found_only_if_all_contacts_agree(lacking, rng):
    """Forces that are exact without some contacts: in lanes in which one of these would carry, they are no result."""
    matrix, levers, gaps, loads = population(rng)
    lever, gap, load, loaded = columns(matrix, levers, gaps, loads)
    matrix, without = jnp.asarray(matrix), loaded
    right = descended(matrix, lever, gap, load, loaded, ENOUGH)
    for place in lacking:
        without = without.at[int(jnp.argsort(-right.forces[:, 0])[place])].set(False)
    part = descended(matrix, lever, gap, load, without, ENOUGH)
    begin = Begin(part.forces, part.inside, jnp.ones((1, LANES), bool), matrix @ part.forces + gap)
    at = descended(matrix, lever, gap, load, loaded, 0, begin=begin)
    np.testing.assert_array_equal(at.done, (part.inside == right.inside).all(axis=0))
    assert at.done.all() == (not lacking)
    ended = descended(matrix, lever, gap, load, loaded, ENOUGH, begin=begin)
    np.testing.assert_allclose(ended.forces, right.forces, atol=1e-11 * float(right.forces.max()))
    np.testing.assert_allclose(ended.place, right.place, rtol=1e-12)


def test_the_last_unfinished_lanes_continue_by_themselves(rng, monkeypatch):
    """Lanes that need many steps, between others: nothing moves, and no lane gets the forces of another."""
    matrix, levers, gaps, loads = population(rng)
    hard = [2, LANES - 1]
    gaps[hard] = 0.02 * rng.normal(size=(2, NUMBER)) ** 2
    lanes = columns(matrix, levers, gaps, loads)
    matrix = jnp.asarray(matrix)
    assert int(FEWER * LANES) >= len(hard)
    apart = descended(matrix, *lanes, ENOUGH)
    monkeypatch.setattr("gearjax.contact.conjugate.FEWER", 0.0)
    together = descended(matrix, *lanes, ENOUGH)
    assert apart.done.all()
    assert int(apart.step) == int(together.step)
    np.testing.assert_array_equal(apart.inside, together.inside)
    np.testing.assert_allclose(apart.forces, together.forces, atol=1e-13 * float(together.forces.max()))
    np.testing.assert_allclose(apart.place, together.place, rtol=1e-13)


def test_a_preconditioner_saves_steps_and_moves_nothing(rng):
    """Made for the contacts that carry in the first lane; in the others some differ."""
    matrix, levers, gaps, loads = population(rng, 0.005)
    middle = slice(NUMBER // 2 - 20, NUMBER // 2 + 20)
    lever, gap, load, loaded = columns(matrix, levers[:, middle], gaps[:, middle], loads)
    inner = jnp.asarray(matrix[middle, middle])
    held = descended(inner, lever[:, :1], gap[:, :1], load[:1], loaded[:, :1], ENOUGH).forces
    near, forces = preconditioner_of(inner, held[:, 0] > 0), jnp.broadcast_to(held, gap.shape)
    begin = Begin(forces, forces > 0, jnp.ones((1, LANES), bool))
    plain = descended(inner, lever, gap, load, loaded, ENOUGH, begin=begin)
    quick = descended(inner, lever, gap, load, loaded, ENOUGH, begin=begin, preconditioner=near)
    assert plain.done.all()
    assert quick.done.all()
    np.testing.assert_array_equal(quick.inside, plain.inside)
    np.testing.assert_allclose(quick.forces, plain.forces, atol=1e-11 * float(plain.forces.max()))
    assert int(quick.step) < 0.6 * int(plain.step)
    # if the contacts are known, the lane that it was made for takes a step, and one to look at the result
    first = lever[:, :1], gap[:, :1], load[:1], plain.inside[:, :1]
    exact = descended(inner, *first, ENOUGH, one_sided=False, preconditioner=near)
    assert int(exact.step) <= 4 < int(descended(inner, *first, ENOUGH, one_sided=False).step)
    np.testing.assert_allclose(exact.forces[:, 0], plain.forces[:, 0], atol=1e-11 * float(plain.forces.max()))
    assert preconditioner_of(jnp.asarray(matrix), jnp.ones(NUMBER, bool)) is None  # of many it would take longer


def test_the_inverse_of_the_whole_matrix_saves_steps_and_moves_nothing(rng):
    """Of contacts that carry in other places in every lane."""
    matrix = jnp.asarray(population(rng)[0])
    gaps, loads = rng.uniform(0.0, 1.0, (LANES, NUMBER)), np.full(LANES, -20.0)
    lanes = columns(matrix, np.full(gaps.shape, -1.0), gaps, loads)
    inverse = inverse_of_all(matrix, MANY_LANES, ALL)
    assert inverse is not None
    np.testing.assert_allclose(inverse @ matrix, np.eye(NUMBER), atol=1e-12)
    plain, quick = (descended(matrix, *lanes, ENOUGH, preconditioner=each) for each in (None, inverse))
    assert plain.done.all()
    assert quick.done.all()
    np.testing.assert_array_equal(quick.inside, plain.inside)
    np.testing.assert_allclose(quick.forces, plain.forces, atol=1e-11 * float(plain.forces.max()))

    def steps(each, *lane):
        return descended(matrix, *(part[..., None] for part in lane), ENOUGH, preconditioner=each).step

    alone = [jax.jit(jax.vmap(partial(steps, each), -1))(*lanes) for each in (None, inverse)]
    assert int(alone[1].sum()) < 0.7 * int(alone[0].sum())


def test_there_is_no_inverse_where_it_does_not_pay_or_does_not_exist(rng):
    matrix = jnp.asarray(population(rng)[0])
    assert inverse_of_all(matrix, MANY_LANES - 1, ALL) is None
    more = ALL_PRECONDITIONED + 1
    assert inverse_of_all(jnp.eye(more), MANY_LANES, jnp.ones(more, bool)) is None
    np.testing.assert_array_equal(inverse_of_all(matrix, MANY_LANES, ALL.at[NUMBER // 3 :].set(False)), np.eye(NUMBER))
    twice = matrix.at[1].set(matrix[0]).at[:, 1].set(matrix[:, 0]).at[1, 1].set(matrix[0, 0])
    for nearly in (0.0, 1e-14, 1e-9, 1e-4, 3e-3):
        np.testing.assert_array_equal(inverse_of_all(twice.at[1, 1].add(nearly), MANY_LANES, ALL), np.eye(NUMBER))


def test_many_lanes_of_contacts_that_all_carry_somewhere_are_single_problems(rng):
    """So many lanes that the inverse of the whole matrix is used; their slopes too, against the exact steps."""
    matrix, number = population(rng)[0], MANY_LANES + 5
    gaps, loads = rng.uniform(0.0, 1.0, (number, NUMBER)), -rng.uniform(0.1, 40.0, number)
    levers = -rng.uniform(0.8, 1.2, (number, NUMBER))

    def weighed(matrix, lever, gap, load):
        place, forces, _ = coupled_balance(matrix, lever, gap, load)
        return place + forces @ jnp.cos(jnp.arange(NUMBER))

    slopes = jax.jit(jax.vmap(jax.grad(weighed, (1, 2, 3)), (None, 0, 0, 0)))(matrix, levers, gaps, loads)
    positions, forces, results = (np.asarray(part) for part in over(matrix, levers, gaps, loads))
    np.testing.assert_array_equal(results, 0)
    alone = jax.jit(jax.grad(weighed, (1, 2, 3)))
    for lane in (0, 100, number - 1):
        position, own, _ = balance(matrix, levers[lane], gaps[lane], loads[lane])
        np.testing.assert_allclose(forces[lane], own, atol=1e-12 * float(own.max()))
        assert positions[lane] == pytest.approx(float(position), rel=1e-12)
        for many, one in zip(slopes, alone(matrix, levers[lane], gaps[lane], loads[lane]), strict=True):
            np.testing.assert_allclose(many[lane], one, atol=1e-10 * float(np.abs(one).max()))


@pytest.mark.parametrize(
    "kind",
    [
        "another place",
        "the other sense",
        "back flanks",
        "light",
        "without load",
        "own levers",
        "many carry",
        "one carries",
        "no size fits",
    ],
)
def test_every_lane_is_a_single_problem(kind, rng):
    matrix, levers, gaps, loads = population(rng)
    odd = [3, LANES - 2]  # lanes that the estimate knows nothing about
    if kind == "another place":
        gaps[odd] = np.roll(gaps[odd], NUMBER // 3, axis=1)
    elif kind == "the other sense":
        levers = levers * np.where(np.arange(NUMBER) % 2, 1.0, -1.0)
        loads[odd] = 1.0
    elif kind == "back flanks":  # the gaps to both sides are narrow, so that the other flank must stay open
        levers = levers * np.where(np.arange(NUMBER) % 2, 1.0, -1.0)
        gaps = gaps + 0.5
    elif kind == "light":
        loads[:] = -np.geomspace(1e-9, 1.0, LANES)
    elif kind == "without load":
        loads[odd] = 0.0
    elif kind == "own levers":
        levers = levers * rng.uniform(0.7, 1.4, levers.shape)
    elif kind == "many carry":
        levers, loads = np.full(levers.shape, -1.0), np.full(LANES, -300.0)
    elif kind == "one carries":
        gaps[:, NUMBER // 2] -= 5.0
    elif kind == "no size fits":
        gaps = 0.1 * gaps
        loads[odd] = -30.0
    forces = are_single_problems(matrix, levers, gaps, loads)
    if kind == "many carry":
        assert ((forces > 0).any(axis=0)).mean() > max(SIZES)
    if kind == "one carries":
        assert ((forces > 0).sum(axis=1) == 1).all()


def test_a_lane_that_is_not_a_number_leaves_the_others_alone(rng):
    matrix, levers, gaps, loads = population(rng)
    known = np.asarray(over(matrix, levers, gaps, loads)[1])
    gaps[0] = np.nan
    loads[9] = np.nan
    forces = np.asarray(over(matrix, levers, gaps, loads)[1])
    well = np.delete(np.arange(LANES), [0, 9])
    np.testing.assert_allclose(forces[well], known[well], atol=1e-12 * known.max())
    assert not np.isfinite(forces[[0, 9]]).any()


def test_lanes_of_known_contacts_are_solved_among_them(rng):
    """Also with forces that pull, and with more contacts than any size holds."""
    matrix, levers, gaps, loads = population(rng)
    for share in (0.2, 0.9):
        closed = np.broadcast_to(rng.random(NUMBER) < share, gaps.shape) & (rng.random(gaps.shape) < 0.9)
        given = (jnp.asarray(part) for part in (levers.T, gaps.T, loads, closed.T))
        forces, places, done = (
            np.asarray(part) for part in linear_among_few(None, jnp.asarray(matrix), *given, ENOUGH)
        )
        assert done.all()
        for lane in range(LANES):
            own = closed[lane]
            border = levers[lane, own][:, None]
            whole = np.block([[matrix[np.ix_(own, own)], -border], [border.T, np.zeros((1, 1))]])
            known = np.linalg.solve(whole, np.append(-gaps[lane, own], loads[lane]))
            np.testing.assert_allclose(forces[own, lane], known[:-1], atol=1e-10 * np.abs(known[:-1]).max())
            assert places[lane] == pytest.approx(known[-1], rel=1e-10)
            assert not forces[~own, lane].any()


def test_gradients_of_a_population_are_those_of_single_problems(rng):
    matrix, levers, gaps, loads = population(rng)
    weights = jnp.asarray(rng.normal(size=NUMBER))

    def told(*given):
        position, forces, _ = coupled_balance(*given)
        return position + weights @ forces

    slopes = jax.grad(told, argnums=(0, 1, 2, 3))
    together, alone = jax.jit(jax.vmap(slopes, (None, 0, 0, 0)))(matrix, levers, gaps, loads), jax.jit(slopes)
    for lane in (0, 7, LANES - 1):
        known = alone(matrix, levers[lane], gaps[lane], loads[lane])
        for one, other in zip(together, known, strict=True):
            np.testing.assert_allclose(one[lane], other, rtol=1e-8, atol=1e-10 * float(jnp.abs(other).max()))
