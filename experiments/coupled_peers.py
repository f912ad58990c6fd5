"""Contacts coupled by a matrix: problems to measure with, and other solvers of them: C, numpy, scipy, HiGHS."""

import ctypes

import highspy
import numpy as np
from peers import compiled_c, pointer
from scipy import linalg, optimize

FAMILIES = ("kernel", "wishart", "gauss", "diagonal", "square_wishart")
MOST = 60  # steps of the active sets
HEAVY = 1e3  # weight of the row that stands for the load, of the largest number of the matrix's root

ACTIVE_SET = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* S f + gap - J q = y >= 0, f >= 0, f y = 0, J f = Q: carrying contacts are gathered, one factorisation a step */
static int one(int n, const double *S, const double *J, const double *gap, double Q, double *f, double *q,
               double *L, double *a, double *b, int *index, char *closed) {
  for (int i = 0; i < n; i++) closed[i] = J[i] * Q > 0;
  for (int step = 0; step < 60; step++) {
    int m = 0;
    for (int i = 0; i < n; i++) if (closed[i]) index[m++] = i;
    for (int i = 0; i < m; i++) {
      const double *row = S + (size_t)index[i] * n;
      double *mine = L + (size_t)i * n, left = J[index[i]], right = gap[index[i]];
      for (int j = 0; j <= i; j++) mine[j] = row[index[j]];
      for (int j = 0; j < i; j++) {
        const double *other = L + (size_t)j * n;
        double sum = mine[j];
        for (int k = 0; k < j; k++) sum -= mine[k] * other[k];
        mine[j] = sum * other[j];                        /* the diagonal holds its own inverse */
      }
      double sum = mine[i];
      for (int k = 0; k < i; k++) { sum -= mine[k] * mine[k]; left -= mine[k] * a[k]; right -= mine[k] * b[k]; }
      mine[i] = 1 / sqrt(sum);
      a[i] = left * mine[i]; b[i] = right * mine[i];
    }
    double steep = 0, pull = Q;
    for (int i = 0; i < m; i++) { steep += a[i] * a[i]; pull += a[i] * b[i]; }
    *q = pull / steep;
    for (int i = 0; i < m; i++) a[i] = a[i] * *q - b[i];
    memset(f, 0, n * sizeof(double));
    for (int i = m - 1; i >= 0; i--) {
      const double *mine = L + (size_t)i * n;
      double value = a[i] * mine[i];
      for (int k = 0; k < i; k++) a[k] -= mine[k] * value;
      f[index[i]] = value;
    }
    int changed = 0;
    for (int i = 0; i < n; i++) {
      char next;
      if (closed[i]) next = f[i] > 0;
      else {
        const double *row = S + (size_t)i * n;
        double y = gap[i] - J[i] * *q;
        for (int j = 0; j < n; j++) y += row[j] * f[j];
        next = y < -1e-13 * fabs(gap[i]);
      }
      changed |= next != closed[i];
      closed[i] = next;
    }
    if (!changed) return step + 1;
  }
  return 0;
}

int many(int lanes, int n, const double *S, const double *J, const double *gap, const double *Q, double *f, double *q) {
  double *L = malloc((size_t)n * n * sizeof(double)), *a = malloc(2 * n * sizeof(double));
  int *index = malloc(n * sizeof(int)), failed = 0;
  char *closed = malloc(n);
  for (int l = 0; l < lanes; l++)
    failed += !one(n, S, J, gap + (size_t)l * n, Q[l], f + (size_t)l * n, q + l, L, a, a + n, index, closed);
  free(L); free(a); free(index); free(closed);
  return failed;
}
"""


def by_c(matrix, lever, gaps, loads):
    """Forces of many gaps and loads, by an active set in C, as a function without arguments."""
    library = compiled_c(ACTIVE_SET)
    lanes, number = gaps.shape
    forces, places = np.empty((lanes, number)), np.empty(lanes)
    given = [np.ascontiguousarray(part, float) for part in (matrix, lever, gaps, loads)]

    def run() -> np.ndarray:
        sizes = ctypes.c_int(lanes), ctypes.c_int(number)
        failed = library.many(*sizes, *map(pointer, (*given, forces, places)))
        assert failed == 0
        return forces

    return run


def by_numpy(matrix, lever, gap, load, closed=None) -> tuple[float, np.ndarray]:
    """Position and forces by an active set: numpy's indexing, scipy's factorisation."""
    closed = lever * load > 0 if closed is None else closed
    position, forces = 0.0, np.zeros(len(gap))
    for _ in range(MOST):
        inside = np.flatnonzero(closed)
        factor = linalg.cho_factor(matrix[np.ix_(inside, inside)], lower=True, check_finite=False)
        right = np.stack([lever[inside], gap[inside]], axis=1)
        per_turn, at_rest = linalg.cho_solve(factor, right, check_finite=False).T
        position = (load + lever[inside] @ at_rest) / (lever[inside] @ per_turn)
        forces[:] = 0.0
        forces[inside] = per_turn * position - at_rest
        opening = matrix @ forces + gap - lever * position
        chosen = np.where(closed, forces > 0, opening < -1e-13 * np.abs(gap))
        if (chosen == closed).all():
            return position, forces
        closed = chosen
    raise ArithmeticError("the active set goes around in a circle")


def by_least_squares(matrix, lever, gap, load) -> np.ndarray:
    """Forces by scipy's non-negative least squares, the load as a heavy row."""
    root = linalg.cholesky(matrix, lower=True)
    heavy = HEAVY * np.abs(root).max() / np.abs(lever).max()
    rows = np.concatenate([root.T, heavy * lever[None]])
    right = np.append(-linalg.solve_triangular(root, gap, lower=True), heavy * load)
    return optimize.nnls(rows, right, maxiter=100 + 10 * len(gap))[0]


def by_highs(matrix, lever, gap, load) -> np.ndarray:
    """Forces by the quadratic programs of HiGHS: min f S f / 2 + gap f under J f = Q, f >= 0."""
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
    columns, rows = np.triu_indices(number)
    curvature.dim_, curvature.format_ = number, highspy.HessianFormat.kTriangular
    curvature.start_ = np.append(0, np.cumsum(np.arange(number, 0, -1)))
    curvature.index_, curvature.value_ = rows, matrix[rows, columns]
    highs = highspy.Highs()
    highs.setOptionValue("output_flag", False)
    highs.passModel(model)
    highs.run()
    return np.array(highs.getSolution().col_value)


def slices(number: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Three pairs of teeth in slices: a kernel along the face, one foundation for each pair, contact's own compliance;
    condition about 15. Matrix and levers."""
    each = number // 3
    pair, along = np.arange(number) // each, (np.arange(number) % each) / each
    apart = np.abs(along[:, None] - along[None])
    same = pair[:, None] == pair[None]
    matrix = np.where(same, 24 / each * np.exp(-8 * apart) + 1.0 / each, 0.0) + 0.45 * np.eye(number)
    return matrix, -rng.uniform(0.9, 1.1, number)


def slice_gaps(number: int, lanes: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Gaps and loads of many angles and errors of `slices`: about half of them carry."""
    each = number // 3
    along = np.linspace(-1, 1, each)
    pairs = rng.uniform(0, 0.4, (lanes, 3, 1)) + rng.uniform(-0.3, 0.3, (lanes, 3, 1)) * along
    gaps = pairs + rng.uniform(0.3, 1.0, (lanes, 3, 1)) * along**2 + 0.02 * rng.normal(size=(lanes, 3, each))
    return gaps.reshape(lanes, number), -rng.uniform(0.03, 0.1, lanes) * number


def tooth_points(rng, lanes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nine teeth of 14 layers and 10 or 11 points as finite elements see them, 1,274 contacts: a kernel that falls off
    on the flank, bending of the whole tooth, a little of the next teeth; condition about 41. Matrix, levers, gaps,
    loads, about 550 carry."""
    counts = [10] * 8 + [11]
    points = [(tooth, layer / 13, at / count) for tooth, count in enumerate(counts) for layer in range(14)
              for at in range(count)]  # fmt: skip
    tooth, layer, depth = np.array(points).T
    apart = np.hypot(3.0 * (layer[:, None] - layer[None]), depth[:, None] - depth[None])
    near = np.exp(-np.abs(tooth[:, None] - tooth[None]) * 4.0)
    kernel = np.where(tooth[:, None] == tooth[None], np.exp(-apart / 0.2), 0.0)
    bend = 0.12 * near * np.exp(-np.abs(layer[:, None] - layer[None])) * np.outer(0.2 + depth, 0.2 + depth)
    matrix = kernel + bend + 0.15 * np.eye(len(tooth))
    phase = rng.uniform(-0.5, 0.5, (lanes, 1))
    gaps = 0.55 * (tooth - 4 - phase) ** 2 + 1.5 * (depth - 0.5 - 0.3 * phase) ** 2
    gaps = gaps + 0.05 * rng.uniform(0, 1, (lanes, len(tooth)))
    return matrix, -rng.uniform(0.95, 1.05, len(tooth)), gaps, -rng.uniform(150.0, 200.0, lanes)


def random_problem(family: str, number: int, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Of one of five families, with conditions up to 1e5; both flanks in half of them."""
    places = np.sort(rng.uniform(0, 1, number))
    apart = np.abs(places[:, None] - places[None])
    if family == "kernel":
        matrix = np.exp(-5 * apart) + 0.3 * np.eye(number)
    elif family == "gauss":
        matrix = np.exp(-((apart * number / 2) ** 2)) + 1e-5 * np.eye(number)
    elif family == "diagonal":
        matrix = np.diag(rng.uniform(0.1, 1.0, number))
    else:
        spread = rng.normal(size=(number, number if family == "square_wishart" else 2 * number))
        matrix = spread @ spread.T / number + 1e-3 * np.eye(number)
    lever = -rng.uniform(0.5, 1.5, number)
    if rng.random() < 0.5:
        lever[1:] *= rng.choice([-1.0, 1.0], number - 1)
    return matrix, lever, rng.uniform(0, 1, number) * rng.choice([0.01, 1.0, 10.0]), -(10 ** rng.uniform(-6, 2))
