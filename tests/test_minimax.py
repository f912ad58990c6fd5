"""The polish and its quadratic programme, against problems with known answers and another solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from gearjax.studies.minimax import least_slope, polish, proximal_step
from gearjax.studies.objective import Pieces

FREE = np.full(2, np.inf)


GROUP = np.array([0, 0, 0, 1, 1, 1, 1])


def by_slsqp(values, slopes, weights, bend, below, above):
    return scipy.optimize.minimize(
        lambda z: weights @ z[3:] + 0.5 * z[:3] @ bend @ z[:3],
        np.concatenate([np.zeros(3), np.full(2, 5.0)]),
        bounds=[*zip(below, above, strict=True), (None, None), (None, None)],
        constraints={"type": "ineq", "fun": lambda z: z[3 + GROUP] - values - slopes @ z[:3]},
        tol=1e-12,
    )


def test_the_step_is_that_of_another_solver(rng):
    """Two weighted sums of largest values with a curvature, in a box, against SLSQP on the same problem."""
    solve = jax.jit(lambda *args: proximal_step(*args[:3], GROUP, *args[3:]))
    for _ in range(5):
        root = rng.normal(size=(3, 3))
        problem = (
            rng.normal(size=7),
            rng.normal(size=(7, 3)),
            rng.uniform(0.2, 2, 2),
            root @ root.T + 0.1 * np.eye(3),
            -rng.uniform(0.05, 1, 3),
            rng.uniform(0.05, 1, 3),
        )
        step, value = solve(*(jnp.asarray(part) for part in problem))
        answer = by_slsqp(*problem)
        np.testing.assert_allclose(step, answer.x[:3], atol=2e-5)
        assert float(value) == pytest.approx(answer.fun, abs=1e-6)


def test_it_reaches_a_kinked_optimum_quadratically():
    """Chebyshev centre of three curved constraints: the optimum has three active values in two numbers."""

    def pieces(x):
        values = jnp.stack([x[0] ** 2 + x[1], x[1] ** 2 - x[0], 2 - x[0] - x[1] + 0.3 * jnp.sin(x[0])])
        return [Pieces(values, jnp.ones(()))]

    found = jax.jit(lambda start: polish(pieces, start, -FREE, FREE, 30))(jnp.array([-2.0, 3.0]))
    active = np.asarray(pieces(found.numbers)[0].values)
    answer = scipy.optimize.minimize(
        lambda z: z[2],
        np.array([0.5, 0.5, 5.0]),
        constraints={"type": "ineq", "fun": lambda z: z[2] - np.asarray(pieces(jnp.asarray(z[:2]))[0].values)},
        tol=1e-14,
    )
    assert float(found.value) == pytest.approx(answer.fun, rel=1e-7)
    assert np.ptp(np.sort(active)[-2:]) < 1e-6
    assert float(found.promise) < 1e-6
    assert (np.diff(np.asarray(found.history)) <= 0).all()
    slope = jax.jit(lambda x: least_slope(pieces, x))(found.numbers)
    np.testing.assert_allclose(slope, 0, atol=1e-3)


def test_bounds_are_reached_exactly():
    def pieces(x):
        return [Pieces(jnp.stack([x[0], -x[0] - 5]), jnp.ones(())), Pieces(jnp.abs(x[1:] - 2), 0.5 * jnp.ones(()))]

    low, high = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    found = jax.jit(lambda start: polish(pieces, start, low, high, 20))(jnp.array([0.5, 0.0]))
    np.testing.assert_allclose(found.numbers, [-1, 1], atol=1e-9)


def test_a_smooth_objective_uses_its_curvature():
    """A long quadratic valley: straight pieces alone would need hundreds of steps."""
    matrix = jnp.diag(jnp.array([1.0, 1e-3]))

    def smooth(x):
        return 1 + 0.5 * x @ matrix @ x

    def pieces(x):
        return [Pieces(smooth(x)[None], jnp.ones(()))]

    start = jnp.array([1.0, 3.0])
    bent = jax.jit(lambda s: polish(pieces, s, -FREE, FREE, 15, jax.hessian(smooth)))(start)
    straight = jax.jit(lambda s: polish(pieces, s, -FREE, FREE, 15))(start)
    assert float(bent.value) - 1 < 1e-6 < float(straight.value) - 1


def test_a_start_that_is_not_finite_stays_that_way():
    def pieces(x):
        return [Pieces(jnp.sqrt(x), jnp.ones(()))]

    found = jax.jit(lambda start: polish(pieces, start, -FREE, FREE, 3))(jnp.array([-1.0, jnp.nan]))
    assert not np.isfinite(found.value)
