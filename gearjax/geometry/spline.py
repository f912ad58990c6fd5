"""Cubic B-splines through the values of a grid, in one direction or two.

A spline through n values is ``sum_i c_i B_i(x)`` with n coefficients, which follow from the values by the collocation
matrix ``B_i(x_j)`` (de Boor 1978, chapters IX and XIII). The end condition "not a knot" omits the second place and the
last place but one from the knots. Three places then give a parabola, two a straight line and one a constant. The end
condition of Guo and Fang (2018, appendix) repeats the outermost vertices instead. Their splines have a parameter from 0
to 1 between any two places, evenly spaced or not. They are accurate to first order only near the ends, and smooth only
on evenly spaced places.
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
        places: places of the grid in rising order, shape (place,).
        ends: end condition, ``"not_a_knot"`` or ``"double_vertices"``.
    """

    places: Float[Array, " place"]
    ends: str = eqx.field(static=True, default=ENDS[0])

    @property
    def degree(self) -> int:
        """Degree of the spline: 3 with four places or more, else the number of places minus one."""
        return min(CUBIC, self.places.shape[0] - 1)

    def coefficients(self, values: Float[Array, "place ..."]) -> Float[Array, "coefficient ..."]:
        """Coefficients of the spline through values along the first axis."""
        number = self.places.shape[0]
        if self.degree < 1:
            return values
        if self._doubled:
            # the end conditions V_0 = V_1 and V_n-1 = V_n are substituted into the equations of the values
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
        """Number of the first coefficient that acts at each point, and the weights of it and the following ones.

        Points beyond the ends have the weights of the end.
        """
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
    """Values of the non-vanishing B-splines at points between the knots ``last`` and ``last + 1``.

    They follow from the recurrence of Cox and de Boor (de Boor 1978, chapter X).
    """
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
    """Weights of four vertices of a cubic spline on evenly spaced places, at a share s of one interval."""
    whole = [(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3]
    return jnp.stack(whole, axis=-1) / 6


def _next(first: Int[Array, " point"], number: int) -> Int[Array, "point number"]:
    """Each first number and the numbers that follow it, shape (point, number)."""
    return first[:, None] + jnp.arange(number, dtype=first.dtype)[None, :]


def surface(
    rows: GridSpline,
    columns: GridSpline,
    values: Float[Array, "grid row column"],
    grid: Int[Array, " point"],
    at: tuple[Float[Array, " point"], Float[Array, " point"]],
) -> Float[Array, " point"]:
    """Values of bicubic splines at points; each point belongs to one of several grids that share their places.

    Args:
        rows, columns: splines over the places of the grids in both directions.
        values: values on the grids.
        grid: number of the grid that each point belongs to.
        at: place of each point in the direction of the rows' places and in that of the columns' places.
    """
    along = rows.coefficients(jnp.moveaxis(values, 1, 0))  # row, grid, column
    both = columns.coefficients(jnp.moveaxis(along, 2, 0))  # column, row, grid
    (row, by_row), (column, by_column) = rows.weights(at[0]), columns.weights(at[1])
    row, column = _next(row, by_row.shape[1])[:, :, None], _next(column, by_column.shape[1])[:, None, :]
    near = both[column, row, grid[:, None, None]]
    return jnp.einsum("pr,prc,pc->p", by_row, near, by_column)
