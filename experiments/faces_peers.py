"""Slices coupled along tooth faces by C, for one problem or for many side by side, as peers of gearjax."""

import ctypes

import numpy as np
from peers import compiled_c, pointer

SWEEPS = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Active set from all contacts. Arrays have the shape (face, slice, W): W problems side by side. Each step has three
   sweeps along every face: factorisation with both right-hand sides, forces, approach of all slices. */
static int some(int faces, int slices, const double *own, const double *low, const double *high, const double *decay,
                const double *lever, const double *gap, const double *load, double *force, double *place,
                double *work, char *closed) {
  const int n = faces * slices;
  double *scaled = work, *turn = scaled + n * W, *rest = turn + n * W, *above = rest + n * W;
  for (int i = 0; i < n * W; i++) closed[i] = lever[i] * load[i % W] > 0;
  for (int step = 1; step < 60; step++) {
    double steep[W] = {0}, pull[W];
    memcpy(pull, load, sizeof pull);
    for (int face = 0; face < faces; face++) {
      double spread[W] = {0}, turned[W] = {0}, pressed[W] = {0};
      for (int i = face * slices; i < (face + 1) * slices; i++)
        for (int w = 0; w < W; w++) {
          const int at = i * W + w;
          const double in = closed[at] ? 1.0 : 0.0, fall = decay[face * W + w];
          const double l = in * low[at], h = in * high[at];
          const double inverse = 1 / ((closed[at] ? own[at] : 1.0) - h * h * spread[w]);
          const double weight = l - fall * h * spread[w];
          const double arm = in * lever[at] - h * turned[w], held = in * gap[at] - h * pressed[w];
          scaled[at] = weight * inverse; turn[at] = arm * inverse; rest[at] = held * inverse;
          steep[w] += arm * turn[at]; pull[w] += arm * rest[at];
          spread[w] = fall * fall * spread[w] + weight * scaled[at];
          turned[w] = fall * turned[w] + weight * turn[at];
          pressed[w] = fall * pressed[w] + weight * rest[at];
        }
    }
    int changed = 0;
    for (int w = 0; w < W; w++) place[w] = pull[w] / steep[w];
    for (int face = 0; face < faces; face++) {
      double sum[W] = {0}, below[W] = {0};
      for (int i = (face + 1) * slices - 1; i >= face * slices; i--)
        for (int w = 0; w < W; w++) {
          const int at = i * W + w;
          above[at] = sum[w];
          force[at] = turn[at] * place[w] - rest[at] - scaled[at] * sum[w];
          sum[w] = decay[face * W + w] * sum[w] + high[at] * force[at];
        }
      for (int i = face * slices; i < (face + 1) * slices; i++)
        for (int w = 0; w < W; w++) {
          const int at = i * W + w;
          const double y = gap[at] - lever[at] * place[w] + own[at] * force[at] + high[at] * below[w]
                           + low[at] * above[at];
          const char next = closed[at] ? force[at] > 0 : y < -1e-13 * fabs(gap[at]);
          changed |= next != closed[at];
          closed[at] = next;
          below[w] = decay[face * W + w] * below[w] + low[at] * force[at];
        }
    }
    if (!changed) return step;
  }
  return 0;
}

int many(int groups, int faces, int slices, const double *own, const double *low, const double *high,
         const double *decay, const double *lever, const double *gap, const double *load, double *force,
         double *place) {
  const size_t n = (size_t)faces * slices * W;
  double *work = malloc(4 * n * sizeof(double));
  char *closed = malloc(n);
  int failed = 0;
  for (int g = 0; g < groups; g++)
    failed += !some(faces, slices, own + g * n, low + g * n, high + g * n, decay + (size_t)g * faces * W, lever + g * n,
                    gap + g * n, load + (size_t)g * W, force + g * n, place + (size_t)g * W, work, closed);
  free(work); free(closed);
  return failed;
}
"""


def by_c(faces, lever, gap, load, side_by_side: int):
    """Forces of problems with faces of their own, as a function without arguments.

    Args:
        faces: numbers of the faces, arrays of the shape (problem, face, slice) or (problem, face).
        lever, gap: arrays of the shape (problem, contact).
        load: shape (problem,).
        side_by_side: number of problems that C treats at the same time; it divides the number of problems.
    """
    library = compiled_c(SWEEPS, f"-DW={side_by_side}")
    number, count, slices = np.shape(faces.own)

    def laid(part) -> np.ndarray:
        apart = np.asarray(part, float).reshape(number // side_by_side, side_by_side, -1)
        return np.ascontiguousarray(apart.transpose(0, 2, 1))

    given = [laid(part) for part in (faces.own, faces.low, faces.high, np.exp(-np.asarray(faces.fall)))]
    given += [laid(part) for part in (lever, gap, load)]
    forces, place = np.empty_like(given[5]), np.empty_like(given[6])

    def run() -> np.ndarray:
        sizes = ctypes.c_int(number // side_by_side), ctypes.c_int(count), ctypes.c_int(slices)
        failed = library.many(*sizes, *map(pointer, (*given, forces, place)))
        assert failed == 0
        return forces.transpose(0, 2, 1).reshape(number, -1)

    return run
