"""Cubic splines through the values of a grid, in one direction or two: B-splines on the grid's own places.

A spline through n values is ``sum_i c_i B_i(x)`` with as many coefficients, which follow from the values by the
collocation matrix ``B_i(x_j)`` (de Boor 1978, chapters IX and XIII). "Not a knot" leaves the second and the last but
one place out of the knots; three places then make a parabola, two a straight line, one a constant. The ends of Guo and
Fang (2018, appendix) repeat the outermost vertices instead, of splines whose parameter runs from 0 to 1 between any two
places, even or not: of first order only near the ends, and smooth only where places are even.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gearjax.typing import Array, Float, Int

ENDS = ("not_a_knot", "double_vertices")
CUBIC = 3


class GridSpline(eqx.Module):
    """A spline over the places of a grid in one direction.

    Args:
        places: in rising order, shape (place,).
        ends: ``"not_a_knot"`` or ``"double_vertices"``.
    """

    places: Float[Array, " place"]
    ends: str = eqx.field(static=True, default=ENDS[0])

    @property
    def degree(self) -> int:
        """3 where there are four places or more, else as many places as there are less one."""
        return min(CUBIC, self.places.shape[0] - 1)

    def coefficients(self, values: Float[Array, "place ..."]) -> Float[Array, "coefficient ..."]:
        """Coefficients of the spline through values along the first axis."""
        number = self.places.shape[0]
        if self.degree < 1:
            return values
        if self._doubled:
            # the equations of the ends, V_0 = V_1 and V_n-1 = V_n, put into those of the values
            matrix = np.diag(np.full(number, 4.0)) + np.diag(np.ones(number - 1), 1) + np.diag(np.ones(number - 1), -1)
            matrix[0, 0] = matrix[-1, -1] = 5.0
            inner = jnp.linalg.solve(jnp.asarray(matrix / 6, values.dtype), values.reshape(number, -1))
            vertices = jnp.concatenate([inner[:1], inner, inner[-1:]])
            return vertices.reshape(-1, *values.shape[1:])
        first, weights = self.weights(self.places)
        columns = _next(first, self.degree + 1)
        matrix = jnp.zeros((number, number), weights.dtype).at[np.arange(number)[:, None], columns].set(weights)
        return jnp.linalg.solve(matrix, values.reshape(number, -1)).reshape(values.shape)

    def weights(self, at: Float[Array, " point"]) -> tuple[Int[Array, " point"], Float[Array, "point weight"]]:
        """First coefficient that counts at each point, and the weights of it and the next ones; beyond the ends those
        at the end."""
        places, degree = self.places, self.degree
        if degree < 1:
            return jnp.zeros(at.shape, jnp.int32), jnp.ones((*at.shape, 1), at.dtype)
        at = jnp.clip(at, places[0], places[-1])
        if self._doubled:
            first = jnp.clip(jnp.searchsorted(places, at, side="right") - 1, 0, places.shape[0] - 2)
            return first, _even_weights((at - places[first]) / (places[first + 1] - places[first]))
        inner = places[2:-2] if degree == CUBIC else places[:0]
        ends = (jnp.broadcast_to(place, (degree + 1,)) for place in (places[0], places[-1]))
        start, stop = ends
        knots = jnp.concatenate([start, inner, stop])
        last = jnp.clip(jnp.searchsorted(knots, at, side="right") - 1, degree, places.shape[0] - 1)
        return last - degree, _weights(knots, at, last, degree)

    @property
    def _doubled(self) -> bool:
        return self.ends == ENDS[1] and self.degree == CUBIC


def _weights(
    knots: Float[Array, " knot"], at: Float[Array, " point"], last: Int[Array, " point"], degree: int
) -> Float[Array, "point weight"]:
    """Values of the B-splines that do not vanish at points between the knots ``last`` and ``last + 1``, by the
    recurrence of Cox and de Boor (de Boor 1978, chapter X)."""
    weights = [jnp.ones_like(at)]
    for order in range(1, degree + 1):
        carried, raised = jnp.zeros_like(at), []
        for place, weight in enumerate(weights):
            high, low = knots[last + place + 1], knots[last + place + 1 - order]
            share = weight / (high - low)
            raised.append(carried + (high - at) * share)
            carried = (at - low) * share
        weights = [*raised, carried]
    return jnp.stack(weights, axis=-1)


def _even_weights(s: Float[Array, " point"]) -> Float[Array, "point weight"]:
    """Weights of four vertices of a cubic spline on even places, at a share of one span."""
    whole = [(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3]
    return jnp.stack(whole, axis=-1) / 6


def _next(first: Int[Array, " point"], number: int) -> Int[Array, "point number"]:
    """A whole number and those that follow it."""
    return first[:, None] + jnp.arange(number, dtype=first.dtype)[None, :]


def surface(
    rows: GridSpline,
    columns: GridSpline,
    values: Float[Array, "grid row column"],
    grid: Int[Array, " point"],
    at: tuple[Float[Array, " point"], Float[Array, " point"]],
) -> Float[Array, " point"]:
    """Splines through the values of grids that share their places, at points of one grid each.

    Args:
        rows, columns: splines over the places of the grids in both directions.
        values: of the grids.
        grid: which one each point is of.
        at: place of each point in the direction of the rows' places and of the columns'.
    """
    along = rows.coefficients(jnp.moveaxis(values, 1, 0))  # row, grid, column
    both = columns.coefficients(jnp.moveaxis(along, 2, 0))  # column, row, grid
    (row, by_row), (column, by_column) = rows.weights(at[0]), columns.weights(at[1])
    row, column = _next(row, by_row.shape[1])[:, :, None], _next(column, by_column.shape[1])[:, None, :]
    near = both[column, row, grid[:, None, None]]
    return jnp.einsum("pr,prc,pc->p", by_row, near, by_column)
