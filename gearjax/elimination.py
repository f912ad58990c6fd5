"""Linear problems with small positive definite matrices, in batches too, without a library of linear algebra.

JAX 0.10 to 0.11.1 divide a batch of factorisations on a CPU among the threads that run the program. If every
thread starts one at the same time, all wait for each other for ever. Elimination is a part of the program itself.
"""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve

from gearjax.typing import Array, Float

LIBRARY_FROM = 48  # rows; a library solves larger problems faster, and they are solved one after the other
WRITTEN_OUT = 8  # rows up to which a loop is not worth while


def eliminated(
    matrix: Float[Array, "row row"], right: Float[Array, "row side"], library_from: int = LIBRARY_FROM
) -> Float[Array, "row side"]:
    """Solution of a linear problem with a symmetric positive definite matrix, for several right-hand sides.

    The solution is nan if the matrix is not positive definite. Where derivatives are needed, use `solved_definite`.
    With many right-hand sides, the library divides them among threads of its own, which wait for each other on a busy
    machine; ``library_from`` is the number of rows from which the library is used all the same.
    """
    rows = matrix.shape[0]
    if rows >= library_from:
        return cho_solve(cho_factor(matrix, lower=True), right)
    table, place = jnp.concatenate([matrix, right], axis=1), jnp.arange(rows)[:, None]

    def step(row: int | Array, table: Array) -> Array:
        """One step of Gauss' and Jordan's elimination: afterwards this column is one of the unit matrix."""
        own = jax.lax.dynamic_slice_in_dim(table, row, 1, axis=0)
        pivot = jax.lax.dynamic_slice_in_dim(own, row, 1, axis=1)
        own = own / jnp.where(pivot > 0, pivot, jnp.nan)
        column = jax.lax.dynamic_slice_in_dim(table, row, 1, axis=1)
        return jnp.where(place == row, own, table - column * own)

    if rows <= WRITTEN_OUT:
        for row in range(rows):
            table = step(row, table)
    else:
        table = jax.lax.fori_loop(0, rows, step, table)
    return table[:, rows:]


def solved_definite(
    matrix: Float[Array, "row row"], right: Float[Array, " row"] | Float[Array, "row side"]
) -> Float[Array, " row"] | Float[Array, "row side"]:
    """As `eliminated`, for one or several right-hand sides, differentiable to any order."""

    def solve(_: object, right: Array) -> Array:
        frozen = jax.lax.stop_gradient(matrix)
        return eliminated(frozen, right) if right.ndim == 2 else eliminated(frozen, right[:, None])[:, 0]

    return jax.lax.custom_linear_solve(lambda unknown: matrix @ unknown, right, solve, symmetric=True)
