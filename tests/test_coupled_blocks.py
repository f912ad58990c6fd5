"""Contacts coupled within small blocks alone: what the whole matrix gives, in lanes of every kind."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.contact.coupled import coupled_balance
from gearjax.contact.springs import CoupledSprings, block_diagonal


def problem(rng, blocks=6, own=3, sides=True):
    """Random blocks, levers of both sides (driving first), gaps and a load that presses some of them."""
    spread = rng.normal(size=(blocks, own, 2 * own))
    matrix = (spread @ spread.transpose(0, 2, 1) / own + 0.3 * np.eye(own)) * 1e-9
    lever = -rng.uniform(0.9, 1.1, blocks * own)
    if sides:
        lever[blocks * own // 2 :] *= -1
    gap = rng.uniform(0, 3e-6, blocks * own)
    return matrix, lever, gap


def both(matrix, lever, gap, load, sided):
    """By blocks, and by the whole matrix."""
    return coupled_balance(matrix, lever, gap, load, sided), coupled_balance(block_diagonal(matrix), lever, gap, load)


@pytest.mark.slow
@pytest.mark.parametrize("sided", [False, True])
def test_blocks_give_what_the_whole_matrix_gives(sided, rng):
    """Loads of both signs, slight ones, none, and flanks of both sides that are pressed together."""
    solve = jax.jit(jax.vmap(lambda *given: both(*given, sided)))
    given = [problem(rng) for _ in range(40)]
    matrix, lever, gap = (jnp.asarray(np.array(part)) for part in zip(*given, strict=True))
    gap = gap.at[::5].add(-4e-6)  # closed on both sides, whatever the position
    load = jnp.asarray(rng.choice([-1e4, 3e3, -1e-3, 0.0, -20.0], 40))
    mine, known = solve(matrix, lever, gap, load)
    assert not np.asarray(mine[2]).any()
    np.testing.assert_allclose(mine[0], known[0], rtol=1e-10)
    np.testing.assert_allclose(mine[1], known[1], rtol=1e-9, atol=1e-10 * float(known[1].max()))
    pressed = np.asarray(mine[1] > 0)
    assert (pressed[:, :9].any(axis=1) & pressed[:, 9:].any(axis=1)).sum() >= 5


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [1, 3])
def test_a_block_may_have_flanks_of_both_sides(blocks, rng):
    """An odd number of blocks has driving flanks in the first half of its contacts all the same."""
    matrix, lever, gap = problem(rng, blocks=blocks, own=4)
    for load in (-4e3, 4e3, 0.0):
        mine, known = both(*map(jnp.asarray, (matrix, lever, gap, load)), sided=True)
        np.testing.assert_allclose(mine[0], known[0], rtol=1e-10, atol=1e-18)
        np.testing.assert_allclose(mine[1], known[1], rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_a_matrix_of_ones_own_for_a_few_contacts(scene, theta):
    """Of both flanks, as a reducer with backlash has; far from the back flanks it is what driving flanks give alone."""

    class OneMatrix(gj.AbstractCoupledCompliance):
        kind: ClassVar[str] = "one_matrix"
        compliance: float = 1e-8

        def influence(self, layout):
            return self.compliance * (0.9 * jnp.eye(len(layout.side)) + 0.1)

    own = dataclasses.replace(scene, compliance=OneMatrix(), backlash=gj.InitialBacklash(1e-3))
    alone = dataclasses.replace(own, backlash=None)
    both_flanks, driving = (gj.transmission_error(one, theta[:64], 100.0) for one in (own, alone))
    np.testing.assert_allclose(both_flanks.te, driving.te, rtol=1e-12)
    np.testing.assert_allclose(both_flanks.forces[:, :2], driving.forces, rtol=1e-10, atol=1e-9)


@pytest.mark.slow
def test_lanes_of_every_kind_are_single_problems(rng):
    """Gaps under one matrix, matrices with gaps of their own, and gaps under each of several matrices, in either
    order; more of them than are worked on at once."""
    several = [problem(rng, sides=False) for _ in range(3)]
    matrix, lever, _ = (jnp.asarray(np.array(part)) for part in zip(*several, strict=True))
    gaps, load = jnp.asarray(rng.uniform(0, 3e-6, (3, 90, 18))), jnp.asarray(-4e3)

    def forces(matrix, lever, gap):
        return coupled_balance(matrix, lever, gap, load)[1]

    one = jax.jit(forces)
    known = np.array([[one(matrix[i], lever[i], gaps[i, j]) for j in range(0, 90, 30)] for i in range(3)])
    under_each = jax.vmap(jax.vmap(forces, (None, None, 0)), (0, 0, 0))
    across = jax.vmap(jax.vmap(forces, (0, 0, 0)), (None, None, 1), 1)
    own = jax.vmap(jax.vmap(forces))
    found = [under_each(matrix, lever, gaps), across(matrix, lever, gaps)]
    found.append(own(jnp.repeat(matrix[:, None], 90, axis=1), jnp.repeat(lever[:, None], 90, axis=1), gaps))
    for each in found:
        np.testing.assert_allclose(each[:, ::30], known, rtol=1e-11, atol=1e-9)


@pytest.mark.slow
def test_derivatives_are_those_of_the_whole_matrix(rng):
    """In reverse and forward, with lanes; with respect to matrix, levers, gaps and load."""
    matrix, lever, gap = (jnp.asarray(part) for part in problem(rng))
    weights = jnp.asarray(rng.normal(size=gap.shape))

    def number(matrix, lever, gap, load, whole):
        given = block_diagonal(matrix) if whole else matrix
        place, forces, _ = coupled_balance(given, lever, gap, load, not whole)
        return 1e6 * place + 1e-3 * weights @ forces

    load = jnp.asarray([-4e3, -1e4])
    for derivative in (jax.grad, jax.jacfwd):
        mine, known = (
            jax.jit(
                jax.vmap(
                    derivative(lambda *given, whole=whole: number(*given, whole), (0, 1, 2, 3)), (None, None, None, 0)
                )
            )(matrix, lever, gap, load)
            for whole in (False, True)
        )
        for one, other in zip(mine, known, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-9 * float(np.abs(other).max()))


@pytest.mark.slow
def test_a_load_that_nothing_holds_is_told(rng):
    matrix, lever, gap = problem(rng, sides=False)
    place, forces, code = coupled_balance(jnp.asarray(matrix), jnp.asarray(lever), jnp.asarray(gap), jnp.asarray(1.0))
    assert int(code) == 1
    assert np.isnan(np.append(forces, place)).all()


def only_the_middle_has_none(balance, lanes):
    """Of three lanes, whose first and last are the same problem, the second has no solution."""
    place, forces, code = jax.jit(balance)(lanes)
    assert np.asarray(code).tolist() == [0, 2, 0]
    assert np.isnan(place[1])
    assert np.isnan(forces[1]).all()
    assert np.isfinite(forces[0]).all()
    np.testing.assert_array_equal(forces[0], forces[2])


@pytest.mark.slow
@pytest.mark.parametrize("sided", [False, True])
def test_blocks_that_are_not_positive_definite_have_no_solution(sided, rng):
    """One of six blocks; in lanes, the others have theirs."""
    matrix, lever, gap = problem(rng)
    lever, gap = jnp.asarray(lever), jnp.asarray(gap)
    wrong = matrix.copy()
    wrong[1] -= 1.2 * np.linalg.eigvalsh(wrong[1])[0] * np.eye(3)
    lanes = jnp.asarray(np.array([matrix, wrong, matrix]))
    only_the_middle_has_none(jax.vmap(lambda own: coupled_balance(own, lever, gap, jnp.asarray(-1e4), sided)), lanes)


def test_springs_show_the_whole_matrix(rng):
    matrix, *_ = problem(rng, blocks=2, own=2)
    whole = CoupledSprings(jnp.asarray(matrix)).influence
    np.testing.assert_array_equal(whole[:2, :2], matrix[0])
    np.testing.assert_array_equal(whole[:2, 2:], 0.0)
    np.testing.assert_array_equal(CoupledSprings(whole).influence, whole)
