"""Contacts coupled by a matrix: conditions that make the answer unique, other solvers, differences, limits."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import linalg, optimize

from gearjax.contact import ContactSet, HardContact, Layout, LinearSprings
from gearjax.contact.coupled import coupled_balance
from gearjax.contact.equilibrium import equilibrium

FAMILIES = ("kernel", "wishart", "gauss", "diagonal", "square_wishart")
SIZES = (1, 2, 5, 30, 100)
balance = jax.jit(coupled_balance)


def influence(family: str, number: int, rng) -> np.ndarray:
    """Symmetric, positive definite; conditions up to 1e5."""
    places = np.sort(rng.uniform(0, 1, number))
    apart = np.abs(places[:, None] - places[None])
    if family == "kernel":  # of an elastic body along a face
        return np.exp(-5 * apart) + 0.3 * np.eye(number)
    if family == "gauss":
        return np.exp(-((apart * number / 2) ** 2)) + 1e-5 * np.eye(number)
    if family == "diagonal":
        return np.diag(rng.uniform(0.1, 1.0, number))
    spread = rng.normal(size=(number, number if family == "square_wishart" else 2 * number))
    return spread @ spread.T / number + 1e-3 * np.eye(number)


def problem(family: str, number: int, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    lever = -rng.uniform(0.5, 1.5, number)
    if rng.random() < 0.5:  # both flanks
        lever[1:] *= rng.choice([-1.0, 1.0], number - 1)
    gap = rng.uniform(0, 1, number) * rng.choice([0.01, 1.0, 10.0])
    return influence(family, number, rng), lever, gap, -rng.choice([1e-12, 1e-6, 1e-2, 1.0, 100.0])


def missed(matrix, lever, gap, load, position, forces) -> float:
    """How far all conditions of the problem are missed, relative; zero for its one solution."""
    opening = matrix @ forces + gap - lever * position
    longest, largest = np.abs(gap).max() + np.abs(matrix @ forces).max(), forces.max()
    return max(
        -forces.min() / largest,
        -opening.min() / longest,
        np.abs(forces * opening).max() / (largest * longest),
        abs(lever @ forces - load) / abs(load),
    )


@pytest.mark.slow
@pytest.mark.parametrize("number", SIZES)
def test_all_conditions_hold(number, rng):
    """Convex: what fulfils them is the one solution."""
    for family, _ in itertools.product(FAMILIES, range(20)):
        given = problem(family, number, rng)
        position, forces, result = (np.asarray(part) for part in balance(*given))
        assert result == 0
        assert missed(*given, position, forces) < 1e-12


@pytest.mark.parametrize("seed", [26, 62, 86, 125, 145])
def test_searches_that_take_more_than_a_hundred_steps_end(seed):
    """Three of a hundred problems of 300 contacts with a condition of 1e6 do."""
    matrix, lever, gap, _ = problem("gauss", 300, np.random.default_rng(seed))
    position, forces, result = (np.asarray(part) for part in balance(matrix, lever, gap, -0.4))
    assert result == 0
    assert missed(matrix, lever, gap, -0.4, position, forces) < 1e-12


def test_least_squares_find_the_same_forces(rng):
    """min f S f / 2 + gap f under J f = Q, f >= 0, by scipy's active set, the load as a heavy row."""
    for family in FAMILIES:
        matrix, lever, gap, _ = problem(family, 20, rng)
        load, heavy = -3.0, 1e4
        root = linalg.cholesky(matrix, lower=True)
        rows = np.concatenate([root.T, heavy * lever[None]])
        known, _ = optimize.nnls(rows, np.append(-linalg.solve_triangular(root, gap, lower=True), heavy * load))
        _, forces, _ = balance(matrix, lever, gap, load)
        np.testing.assert_allclose(forces, known, atol=1e-5 * known.max())


@pytest.mark.slow
def test_without_coupling_it_is_the_closed_form(rng):
    for number in (2, 4, 40):
        matrix, lever, gap, load = problem("diagonal", number, rng)
        lever = -np.abs(lever)
        layout = Layout.of_flanks(number, back=False)
        contacts = ContactSet(
            jnp.asarray(lever[:, None]), jnp.asarray(gap), LinearSprings(jnp.asarray(1 / np.diag(matrix))), layout
        )
        known = equilibrium(contacts, jnp.asarray(load), HardContact())
        position, forces, _ = balance(matrix, lever, gap, load)
        assert float(position) == pytest.approx(float(known.position), rel=1e-12)
        np.testing.assert_allclose(forces, known.forces, rtol=1e-10, atol=1e-12 * abs(load))


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_gradients_are_those_of_differences_under_vmap_and_jit(family, rng):
    """In matrix, levers, gaps and load, forwards and backwards."""
    sets = [np.stack(parts) for parts in zip(*(problem(family, 8, rng)[:3] for _ in range(4)), strict=True)]
    loads, weights = -rng.uniform(1.0, 5.0, 4), rng.normal(size=8)

    def told(matrix, lever, gap, load):
        position, forces, _ = coupled_balance(matrix, lever, gap, load)
        return position + weights @ forces

    ways = [jnp.asarray(rng.normal(size=part.shape) * 1e-2) for part in (*sets, loads)]
    ways[0] = ways[0] + jnp.swapaxes(ways[0], 1, 2)
    arguments = tuple(jnp.asarray(part) for part in (*sets, loads))
    value = jax.jit(jax.vmap(told))

    @jax.jit
    def both(*given):
        forward = jax.jvp(jax.vmap(told), given, tuple(ways))[1]
        back = jax.vmap(jax.grad(told, argnums=(0, 1, 2, 3)))(*given)
        return forward, sum((slope * way).reshape(4, -1).sum(axis=1) for slope, way in zip(back, ways, strict=True))

    def moved(step):
        return value(*(part + step * way for part, way in zip(arguments, ways, strict=True)))

    step = 1e-5
    difference = (moved(-2 * step) - 8 * moved(-step) + 8 * moved(step) - moved(2 * step)) / (12 * step)
    forward, back = both(*arguments)
    np.testing.assert_allclose(forward, difference, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(back, forward, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_second_derivatives_are_right(rng):
    matrix, lever, gap, _ = (jnp.asarray(part) for part in problem("kernel", 6, rng))
    load = jnp.asarray(-3.0)

    def place(lever):
        return coupled_balance(matrix, lever, gap, load)[0]

    bends, step = jax.jit(jax.hessian(place))(lever), 1e-5
    slope = jax.jit(jax.grad(place))
    for index in range(6):
        difference = (slope(lever.at[index].add(step)) - slope(lever.at[index].add(-step))) / (2 * step)
        np.testing.assert_allclose(bends[index], difference, rtol=1e-5, atol=1e-8)


def test_forces_do_the_work_of_the_load(rng):
    """The strain energy falls off with the position as the load says: d(f S f / 2) = Q dq at held gaps."""
    matrix, lever, gap, _ = (jnp.asarray(part) for part in problem("kernel", 12, rng))

    def energy(load):
        position, forces, _ = coupled_balance(matrix, lever, gap, load)
        return 0.5 * forces @ matrix @ forces, position

    slopes = jax.jit(jax.jacfwd(energy))
    for load in (-0.3, -2.0, -20.0):
        work, turn = slopes(load)
        assert float(work) == pytest.approx(load * float(turn), rel=1e-10)


@pytest.mark.slow
def test_float32_follows_float64(rng):
    for family in ("kernel", "wishart", "diagonal"):
        matrix, lever, gap, _ = problem(family, 30, rng)
        exact = np.asarray(balance(matrix, lever, gap, -5.0)[1])
        given = (jnp.asarray(part, jnp.float32) for part in (matrix, lever, gap, -5.0))
        _, forces, result = balance(*given)
        assert forces.dtype == jnp.float32
        assert result == 0
        np.testing.assert_allclose(forces, exact, atol=3e-5 * exact.max())


def test_extremes():
    matrix, lever = jnp.array([[2.0, 0.5], [0.5, 1.0]]), jnp.array([-1.0, -2.0])
    gap, load = jnp.array([0.3, 0.4]), jnp.asarray(-1.0)
    nothing = balance(matrix, lever, gap, jnp.asarray(0.0))
    assert float(nothing[0]) == pytest.approx(-0.2, rel=1e-15)  # gap / lever of the second, which touches first
    np.testing.assert_array_equal(nothing[1], 0.0)
    _, forces, result = balance(matrix, lever, gap, -load)
    assert result == 1  # no back flank
    assert np.isnan(forces).all()
    _, forces, result = balance(jnp.array([[1.0, 2.0], [2.0, 1.0]]), lever, gap, load)
    assert result == 2  # not positive definite
    assert np.isnan(forces).all()
    _, forces, _ = balance(matrix, lever, gap, jnp.asarray(-1e-300))
    np.testing.assert_allclose(forces, [0.0, 5e-301], rtol=1e-12)
    _, forces, _ = balance(matrix, lever, jnp.zeros(2), jnp.asarray(-1e12))  # all closed
    assert float(lever @ forces) == pytest.approx(-1e12, rel=1e-14)
    # two contacts that depend on each other all but share their load
    alike = jnp.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]])
    _, forces, result = balance(alike, jnp.array([-1.0, -1.0]), jnp.zeros(2), load)
    assert result == 0
    np.testing.assert_allclose(forces, 0.5, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("torque", [0.0, 1e-200, 1e-30])
@pytest.mark.parametrize("in_blocks", [False, True])
def test_contacts_that_touch_together_hardly_loaded(in_blocks, torque, rng):
    """Gaps that tie to rounding: a fifth of such sets found no end, as none of those that tie could carry alone."""
    number = 2000
    part = rng.normal(size=(number, 4, 4))
    influence = 1e-9 * (part @ part.transpose(0, 2, 1) / 4 + 0.3 * np.eye(4))
    lever = -0.06 * rng.uniform(0.8, 1.2, (number, 4))
    gap = lever * rng.uniform(-1e-4, 1e-4, (number, 1))
    gap[:, 3] += 1e-6 * rng.uniform(0, 1, number)
    given = influence[:, None] if in_blocks else influence
    found = jax.jit(jax.vmap(lambda *each: coupled_balance(*each, jnp.asarray(-torque))))(given, lever, gap)
    position, forces, result = map(np.asarray, found)
    assert (result == 0).all()
    np.testing.assert_allclose(position, gap[:, 0] / lever[:, 0], rtol=1e-14)
    assert (forces >= 0).all()
    np.testing.assert_allclose((-lever * forces).sum(axis=1), torque, rtol=1e-12)
