"""Contact laws: limits, slopes, reach, and the maximum that belongs to each."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gearjax.contact import HardContact, QuadraticContact, SoftplusContact

WIDTH = 0.4e-6
SMOOTH = [SoftplusContact(WIDTH), QuadraticContact(WIDTH)]
LAWS = [HardContact(), *SMOOTH]
IDS = ["hard", "softplus", "quadratic"]


@pytest.mark.parametrize("law", LAWS, ids=IDS)
def test_far_from_contact_all_agree(law):
    overlap = jnp.array([-1e-3, -5e-5, 5e-5, 1e-3])
    np.testing.assert_allclose(law.penetration(overlap), jnp.maximum(overlap, 0), rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(law.closed(overlap), [0, 0, 1, 1], atol=1e-12)


@pytest.mark.parametrize("law", SMOOTH, ids=IDS[1:])
def test_closed_is_the_slope_of_penetration(law):
    overlap = jnp.linspace(-3 * WIDTH, 3 * WIDTH, 41) + 1e-9
    np.testing.assert_allclose(law.closed(overlap), jax.vmap(jax.grad(law.penetration))(overlap), rtol=1e-9, atol=1e-12)


def test_the_quadratic_blend_does_not_act_at_a_distance():
    overlap = jnp.array([-1.0000001 * WIDTH, -1e-3])
    assert not np.asarray(QuadraticContact(WIDTH).penetration(overlap)).any()
    assert float(SoftplusContact(WIDTH).penetration(overlap)[0]) > 0.1 * WIDTH


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS, ids=IDS)
def test_weights_are_the_gradient_of_the_maximum(law, rng):
    for _ in range(30):
        values = jnp.asarray(rng.uniform(-1e-6, 1e-6, 5))
        weights = law.weights(values)
        assert float(weights.sum()) == pytest.approx(1.0, abs=1e-12)
        assert bool((weights >= 0).all())
        np.testing.assert_allclose(jax.grad(law.maximum)(values), weights, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("law", SMOOTH, ids=IDS[1:])
def test_the_maximum_of_two_blends_their_difference(law):
    for lead in np.linspace(-2 * WIDTH, 2 * WIDTH, 9):
        values = jnp.array([3e-6 + lead, 3e-6])
        expected = 3e-6 + float(law.penetration(jnp.asarray(lead)))
        assert float(law.maximum(values)) == pytest.approx(expected, rel=1e-12)


def test_the_maximum_is_bounded(rng):
    for _ in range(30):
        values = jnp.asarray(rng.uniform(-1e-6, 1e-6, 7))
        top = float(values.max())
        assert top - 1e-20 <= float(SoftplusContact(WIDTH).maximum(values)) <= top + WIDTH * np.log(7)
        assert top - 1e-20 <= float(QuadraticContact(WIDTH).maximum(values)) <= top + WIDTH / 2


@pytest.mark.parametrize("law", LAWS, ids=IDS)
def test_huge_values_beside_small_ones(law):
    values = jnp.array([-1e3, 2e-6, 1e-6])
    assert float(law.maximum(values)) == pytest.approx(2e-6, abs=WIDTH)
    assert np.isfinite(np.asarray(jax.grad(law.maximum)(values))).all()
