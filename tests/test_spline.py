"""Splines on grids: against scipy, by their orders, at the extremes of grids, with gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from gearjax.geometry.spline import ENDS, GridSpline, surface

surface_once = eqx.filter_jit(surface)  # one program, where each operation would be one


def at_points(rows, columns, values, grid, at, ends="not_a_knot"):
    splines = GridSpline(jnp.asarray(rows), ends), GridSpline(jnp.asarray(columns), ends)
    return surface_once(*splines, jnp.asarray(values), jnp.asarray(grid), tuple(jnp.asarray(part) for part in at))


def along(places, values, at, ends="not_a_knot"):
    """A spline in one direction."""
    nothing = np.zeros(len(at), at.dtype)
    return at_points(places, nothing[:1], values[None, :, None], nothing.astype(int), (at, nothing), ends)


@pytest.mark.parametrize("shape", [(42, 47), (3, 3), (4, 5), (2, 7), (500, 500)])
def test_surfaces_are_those_of_scipy(shape, rng):
    rows, columns = (np.sort(rng.uniform(-20.0, 30.0, number)) for number in shape)
    values = rng.normal(size=(2, *shape))
    at = rng.uniform(rows[0], rows[-1], 500), rng.uniform(columns[0], columns[-1], 500)
    grid = rng.integers(0, 2, 500)
    degrees = {"kx": min(3, shape[0] - 1), "ky": min(3, shape[1] - 1)}
    each = [RectBivariateSpline(rows, columns, one, s=0, **degrees).ev(*at) for one in values]
    expected = np.where(grid == 0, *each)
    found = at_points(rows, columns, values, grid, at)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize(("ends", "order"), [("not_a_knot", 4), ("double_vertices", 1)])
def test_orders(ends, order):
    """The paper's ends are of first order; values at the grid's own places are met by both."""
    at = np.linspace(0.0, 1.0, 2001)
    errors = []
    for number in (21, 41, 81):
        places = np.linspace(0.0, 1.0, number)
        values = np.sin(3 * places + 0.4)
        errors.append(float(np.abs(along(places, values, at, ends) - np.sin(3 * at + 0.4)).max()))
        np.testing.assert_allclose(along(places, values, places, ends), values, atol=1e-14)
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), order, atol=0.2)


def test_double_vertices_are_those_of_the_paper(rng):
    """Guo and Fang (2018), equations A.1, A.2 and 3, written out, on uneven places."""
    places, values = np.sort(rng.uniform(0.0, 1.0, 8)), rng.normal(size=8)
    matrix = np.zeros((10, 10))
    for i in range(8):
        matrix[i, i : i + 3] = 1 / 6, 2 / 3, 1 / 6
    matrix[8, :2], matrix[9, -2:] = (1, -1), (1, -1)
    vertices = np.linalg.solve(matrix, np.append(values, [0.0, 0.0]))
    basis = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
    for span, s in ((0, 0.3), (3, 0.8), (6, 0.5)):
        at = places[span] + s * (places[span + 1] - places[span])
        expected = s ** np.arange(4) @ basis @ vertices[span : span + 4]
        assert float(along(places, values, np.array([at]), "double_vertices")[0]) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("ends", ENDS)
def test_beyond_its_ends_a_spline_stays_as_it_is_there(ends, rng):
    places, values = np.linspace(1.0, 2.0, 6), rng.normal(size=6)
    np.testing.assert_allclose(along(places, values, np.array([0.0, 3.0]), ends), values[[0, -1]], atol=1e-14)


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_few_places_make_what_they_determine(number, rng):
    """A constant, a straight line, a parabola, a cubic: each goes through itself."""
    polynomial = np.polynomial.Polynomial(rng.normal(size=number))
    places, at = np.sort(rng.uniform(0.0, 1.0, number)), rng.uniform(0.0, 1.0, 20)
    at = np.clip(at, places[0], places[-1])
    np.testing.assert_allclose(along(places, polynomial(places), at), polynomial(at), atol=1e-12)


@pytest.mark.slow
def test_gradients_are_differences_under_vmap_and_jit(rng):
    """With respect to values, places of the grid, and where it is looked at."""
    rows, columns = np.sort(rng.uniform(0.0, 1.0, 6)), np.sort(rng.uniform(0.0, 1.0, 5))
    values, grid = rng.normal(size=(2, 6, 5)), np.array([0, 1])

    def looked_at(numbers):
        row, column, value, x = numbers
        return surface(GridSpline(row), GridSpline(column), value, jnp.asarray(grid), (x[0], x[1])).sum()

    numbers = [jnp.asarray(part) for part in (rows, columns, values, rng.uniform(0.3, 0.6, (2, 2)))]
    ways = [jnp.asarray(rng.normal(size=(3, *part.shape))) for part in numbers]
    slopes = jax.jit(jax.vmap(lambda way: jax.jvp(looked_at, (numbers,), (way,))[1]))(ways)
    value, step = jax.jit(looked_at), 1e-6
    for place, slope in enumerate(slopes):
        ahead, back = (
            value([part + sign * step * way[place] for part, way in zip(numbers, ways, strict=True)])
            for sign in (1, -1)
        )
        assert float(slope) == pytest.approx(float(ahead - back) / (2 * step), rel=1e-6, abs=1e-8)


@pytest.mark.slow
def test_single_precision_is_single_precision(rng):
    places, at = np.linspace(4e-3, 34e-3, 42), rng.uniform(4e-3, 34e-3, 100)
    values = 1e-5 * np.cos(200 * places)
    short = along(*(np.asarray(part, np.float32) for part in (places, values, at)))
    assert short.dtype == jnp.float32
    np.testing.assert_allclose(short, along(places, values, at), atol=1e-5 * 1e-5)  # of 10 um
