"""Contacts coupled by a matrix against other programs: scipy's least squares and the quadratic programs of HiGHS."""

import highspy
import numpy as np
import pytest
from scipy import linalg, optimize

from tests.test_coupled import FAMILIES, balance, problem

SIZES = {2: 40, 3: 30, 5: 30, 9: 30, 20: 25, 50: 20, 120: 20, 300: 5}  # contacts: problems
CARRIES = 1e-5  # of the largest force: HiGHS stops within 1e-7


def of_set(matrix, lever, gap, load, carrying) -> tuple[float, np.ndarray]:
    """Position and forces of the contacts that carry, by one linear solve."""
    inner = matrix[np.ix_(carrying, carrying)]
    column = lever[carrying][:, None]
    whole = np.block([[inner, -column], [column.T, np.zeros((1, 1))]])
    *found, position = np.linalg.solve(whole, np.append(-gap[carrying], load))
    forces = np.zeros(len(gap))
    forces[carrying] = found
    return position, forces


def by_least_squares(matrix, lever, gap, load) -> tuple[float, np.ndarray]:
    """At a held position the forces are a least squares problem with f >= 0; the position is where they carry the
    load, found by Brent's method."""
    root = linalg.cholesky(matrix, lower=True)
    way = np.sign(load)

    def forces(position):
        rigid = linalg.solve_triangular(root, lever * position - gap, lower=True)
        return optimize.nnls(root.T, rigid, maxiter=100 + 10 * len(gap))[0]

    def more(position):
        return way * (lever @ forces(way * position) - load)

    near, far = -1.0, 1.0  # in the sense of the load
    while more(far) < 0:
        near, far = far, 2 * far
    while more(near) > 0:
        near = 2 * near - far
    position = way * optimize.brentq(more, near, far, xtol=1e-14, rtol=1e-14)
    return of_set(matrix, lever, gap, load, forces(position) > 0)


def by_highs(matrix, lever, gap, load) -> tuple[float, np.ndarray]:
    """min f S f / 2 + gap f under J f = Q, f >= 0; which contacts carry is HiGHS's answer, their forces are solved for
    again, to rounding."""
    number = len(gap)
    model = highspy.HighsModel()
    program, curvature = model.lp_, model.hessian_
    program.num_col_, program.num_row_ = number, 1
    program.col_cost_, program.col_lower_ = gap, np.zeros(number)
    program.col_upper_ = np.full(number, highspy.kHighsInf)
    program.row_lower_ = program.row_upper_ = np.array([load])
    program.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    program.a_matrix_.start_ = np.arange(number + 1)
    program.a_matrix_.index_, program.a_matrix_.value_ = np.zeros(number, int), lever
    columns, rows = np.triu_indices(number)  # the lower triangle, column by column
    curvature.dim_, curvature.format_ = number, highspy.HessianFormat.kTriangular
    curvature.start_ = np.append(0, np.cumsum(np.arange(number, 0, -1)))
    curvature.index_, curvature.value_ = rows, matrix[rows, columns]
    highs = highspy.Highs()
    highs.setOptionValue("output_flag", False)
    highs.passModel(model)
    highs.run()
    assert highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
    rough = np.array(highs.getSolution().col_value)
    position, forces = of_set(matrix, lever, gap, load, rough > CARRIES * rough.max())
    np.testing.assert_allclose(rough, forces, atol=CARRIES * rough.max())
    return position, forces


@pytest.mark.slow
@pytest.mark.parametrize("program", [by_least_squares, by_highs])
def test_two_hundred_problems_of_two_to_three_hundred_contacts(program, rng):
    assert sum(SIZES.values()) == 200
    for number, problems in SIZES.items():
        for turn in range(problems):
            *given, _ = problem(FAMILIES[turn % len(FAMILIES)], number, rng)
            load = -float(10 ** rng.uniform(-2, 2))
            position, forces, result = (np.asarray(part) for part in balance(*given, load))
            known = program(*given, load)
            assert result == 0
            assert position == pytest.approx(known[0], rel=1e-9)
            np.testing.assert_allclose(forces, known[1], rtol=0, atol=1e-9 * known[1].max())
