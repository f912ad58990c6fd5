"""Grid of assembly phases, 37^4 combinations x 512 times: gearjax against C and numba, in one run.

Writes its peers itself: C with ``-O3 -march=native -ffast-math`` on two threads and numba ``prange``, both on the same
tables. Both are shown twice: direct, with the highest and the lowest value of every combination over all times, and by
gearjax's algorithm (highest values are separable, only the lowest ones need every combination). Prints medians of
interleaved repeats, compile time apart. Needs gcc and numba (``pip install numba``).

    python experiments/phase_grid_bench.py [--repeats 7]
"""

import argparse
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numba
import numpy as np
from peers import compiled_c, interleaved, pointer

import gearjax as gj
from gearjax.studies import separable
from gearjax.studies.select import pick

LEVELS, TIMES, PADDED = 37, 512, 40
PATHS = [f"errors.{body}.phase" for body in ("planet_1", "planet_2", "revolution", "output_wheel")]

C = r"""
#include <pthread.h>
#include <math.h>
#define N 37
#define P 40
#define T 512
#define BLOCK 64
/* s1[t][a], s2[t][b]: own curves; q1, q2[outer][t]: added by an outer combination. Result: amplitude of every one. */
typedef struct { const REAL *s1, *s2, *q1, *q2; REAL *out; int first, last; } Job;
#ifdef DIRECT
static void *work(void *given) {
    Job *job = (Job *)given;
    REAL one[T * P], two[T * P];
    for (int o = job->first; o < job->last; o++) {
        const REAL *q1 = job->q1 + (long)o * T, *q2 = job->q2 + (long)o * T;
        for (int t = 0; t < T; t++)
            for (int b = 0; b < P; b++) {
                one[t * P + b] = job->s1[t * P + b] + q1[t];
                two[t * P + b] = job->s2[t * P + b] + q2[t];
            }
        for (int a = 0; a < N; a++) {
            REAL low[P], high[P];
            for (int b = 0; b < P; b++) { low[b] = INFINITY; high[b] = -INFINITY; }
            for (int t = 0; t < T; t++) {
                REAL x = one[t * P + a];
                for (int b = 0; b < P; b++) {
                    REAL y = two[t * P + b], m = x > y ? x : y;
                    low[b] = m < low[b] ? m : low[b];
                    high[b] = m > high[b] ? m : high[b];
                }
            }
            for (int b = 0; b < N; b++)
                job->out[((long)o * N + a) * N + b] = high[b] > -low[b] ? high[b] : -low[b];
        }
    }
    return 0;
}
#else
static void *work(void *given) {
    Job *job = (Job *)given;
    REAL one[T * P], two[T * P], low[N * P], high1[P], high2[P];
    for (int o = job->first; o < job->last; o++) {
        const REAL *q1 = job->q1 + (long)o * T, *q2 = job->q2 + (long)o * T;
        for (int b = 0; b < P; b++) high1[b] = high2[b] = -INFINITY;
        for (int t = 0; t < T; t++)
            for (int b = 0; b < P; b++) {
                REAL x = job->s1[t * P + b] + q1[t], y = job->s2[t * P + b] + q2[t];
                one[t * P + b] = x; two[t * P + b] = y;
                high1[b] = x > high1[b] ? x : high1[b];
                high2[b] = y > high2[b] ? y : high2[b];
            }
        for (int i = 0; i < N * P; i++) low[i] = INFINITY;
        for (int start = 0; start < T; start += BLOCK)
            for (int a = 0; a < N; a++) {
                REAL row[P];
                for (int b = 0; b < P; b++) row[b] = low[a * P + b];
                for (int t = start; t < start + BLOCK; t++) {
                    REAL x = one[t * P + a];
                    for (int b = 0; b < P; b++) {
                        REAL y = two[t * P + b], m = x > y ? x : y;
                        row[b] = m < row[b] ? m : row[b];
                    }
                }
                for (int b = 0; b < P; b++) low[a * P + b] = row[b];
            }
        for (int a = 0; a < N; a++)
            for (int b = 0; b < N; b++) {
                REAL high = high1[a] > high2[b] ? high1[a] : high2[b], deep = -low[a * P + b];
                job->out[((long)o * N + a) * N + b] = high > deep ? high : deep;
            }
    }
    return 0;
}
#endif
void sweep(const REAL *s1, const REAL *s2, const REAL *q1, const REAL *q2, REAL *out, int outer) {
    pthread_t thread;
    Job jobs[2] = {{s1, s2, q1, q2, out, 0, outer / 2}, {s1, s2, q1, q2, out, outer / 2, outer}};
    pthread_create(&thread, 0, work, &jobs[1]);
    work(&jobs[0]);
    pthread_join(thread, 0);
}
"""


def by_c(sweep, curves, outer, out):
    sweep(*(pointer(array) for array in (*curves, *outer, out)), outer[0].shape[0])
    return out


@numba.njit(parallel=True, fastmath=True)
def by_numba(s1, s2, q1, q2, out):
    for o in numba.prange(q1.shape[0]):
        for a in range(s1.shape[1]):
            for b in range(s2.shape[1]):
                low, high = np.inf, -np.inf
                for t in range(s1.shape[0]):
                    value = max(s1[t, a] + q1[o, t], s2[t, b] + q2[o, t])
                    low = min(low, value)
                    high = max(high, value)
                out[o, a, b] = max(high, -low)
    return out


@numba.njit(parallel=True, fastmath=True)
def by_numba_separable(s1, s2, q1, q2, out):
    """The same algorithm as C: rows over b, highest values apart."""
    n, times = s2.shape[1], s1.shape[0]
    for o in numba.prange(q1.shape[0]):
        high1 = np.full(n, -np.inf, s1.dtype)
        high2 = np.full(n, -np.inf, s1.dtype)
        two = np.empty((times, n), s1.dtype)
        for t in range(times):
            for b in range(n):
                high1[b] = max(high1[b], s1[t, b] + q1[o, t])
                two[t, b] = s2[t, b] + q2[o, t]
                high2[b] = max(high2[b], two[t, b])
        row = np.empty(n, s1.dtype)
        for a in range(n):
            row[:] = np.inf
            for t in range(times):
                x = s1[t, a] + q1[o, t]
                for b in range(n):
                    row[b] = min(row[b], max(x, two[t, b]))
            for b in range(n):
                out[o, a, b] = max(max(high1[a], high2[b]), -row[b])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description="grid of assembly phases against C and numba")
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    numba.set_num_threads(2)
    scene = gj.load(Path(__file__).parents[1] / "configs" / "two_kv" / "wang_2020.toml")
    free = pick(scene, PATHS)
    theta = jnp.linspace(0.0, scene.system.cycle, TIMES)
    levels = tuple(jnp.linspace(-jnp.pi, jnp.pi, LEVELS) for _ in PATHS)
    wide = jax.block_until_ready(separable.contributions(scene, free, levels, theta))
    plan = separable.plan(wide)
    tasks = {}
    for real, dtype in (("double", np.float64), ("float", np.float32)):
        contributions = jax.tree.map(lambda leaf, dtype=dtype: leaf.astype(dtype), wide)
        grid = jax.block_until_ready(separable.lay_out(contributions, plan, TIMES))
        own = [np.asarray(curve) for curve in grid.own]
        curves = [np.zeros((TIMES, PADDED), dtype) for _ in own]
        for padded, curve in zip(curves, own, strict=True):
            padded[:, :LEVELS] = curve
        outer = [np.ascontiguousarray(np.asarray(grid.outer)[:, :, i]) for i in range(2)]
        out = np.empty((4, LEVELS**2, LEVELS, LEVELS), dtype)
        direct, same = (compiled_c(C, f"-DREAL={real}", *flags).sweep for flags in (("-DDIRECT",), ()))
        name = "float64" if real == "double" else "float32"
        tasks |= {
            f"C, {name}": lambda s=direct, c=curves, q=outer, o=out: by_c(s, c, q, o[0]),
            f"C by the same algorithm, {name}": lambda s=same, c=curves, q=outer, o=out: by_c(s, c, q, o[1]),
            f"numba, {name}": lambda c=own, q=outer, o=out: by_numba(*c, *q, o[2]),
            f"numba by the same algorithm, {name}": lambda c=own, q=outer, o=out: by_numba_separable(*c, *q, o[3]),
            f"gearjax full map, {name}": lambda t=contributions: separable.sweep(
                separable.lay_out(t, plan, TIMES), None, False
            ),
            f"gearjax certified minimum, {name}": lambda t=contributions: separable.certified(
                t, plan, spread=False, keep=1
            ).scores[:1],
        }
    results, first, medians = interleaved(tasks, repeats)
    print(f"{LEVELS}^4 combinations x {TIMES} times, median of {repeats}; two threads, two devices")
    print(f"{'':36s} {'ms':>8s} {'/ C':>6s} {'first call [s]':>15s} {'least [arcmin]':>15s}")
    for name, median in medians.items():
        precision = name.split(", ")[1]
        found = results[name][0] if "full map" in name else results[name]
        least = float(np.min(np.asarray(found))) / gj.units.arcmin
        ratio = median / medians[f"C, {precision}"]
        print(f"{name:36s} {1e3 * median:8.1f} {ratio:6.2f} {first[name]:15.2f} {least:15.6f}")
    same = "by the same algorithm"
    for precision in ("float64", "float32"):
        full, certified = (medians[f"gearjax {what}, {precision}"] for what in ("full map", "certified minimum"))
        print(
            f"{precision}: full map {full / medians[f'C, {precision}']:.2f} of C "
            f"({full / medians[f'C {same}, {precision}']:.2f} {same}), "
            f"{medians[f'numba, {precision}'] / full:.1f} times faster than numba "
            f"({medians[f'numba {same}, {precision}'] / full:.1f} {same}), certified minimum "
            f"{certified / medians['C, float64']:.2f} of the full C sweep in float64 "
            f"({certified / medians[f'C {same}, float64']:.2f} {same})"
        )


if __name__ == "__main__":
    main()
