"""One dynamic solve of the 2K-V reducer, 3 s, 3,001 samples, hard contacts: gearjax against other programs, in one run.

Writes its peers itself, for this one reducer (two pairs, four contacts, three slow sines, one mesh harmonic):
C (``-O3 -march=native -ffast-math``, sequential) with the same scheme and with Runge-Kutta, sines by rotation;
numba with Runge-Kutta; diffrax with Dopri5; scipy with LSODA on a numba right-hand side. Errors are those of the
3,001 samples against Runge-Kutta at 12 million steps in C. Prints medians of interleaved repeats, compile time apart.
The process is held to one core, as C has one thread. The adaptive peers are compared with the fewest steps of gearjax
whose largest error is smaller than theirs. ``XLA_FLAGS`` works as ever: see `gj.xla_options`. Needs
gcc and numba (``pip install numba``).

    python experiments/dynamics_bench.py [--torque 100] [--repeats 9]
"""

import argparse
import ctypes
import dataclasses
import functools
import os
from pathlib import Path

os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # before any thread starts

import diffrax
import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numba
import numpy as np
from peers import agree, compiled_c, interleaved, pointer, reducer, sized
from scipy.integrate import solve_ivp

import gearjax as gj
from gearjax.analysis import choice, dynamics
from gearjax.analysis.choice import suitable_step

SCENE = gj.load(Path(__file__).parents[1] / "configs" / "two_kv" / "wang_2020.toml")
PHYSICS = SCENE.physics("backlash", "compliance", "load", "inertia", "damping")

C = r"""
#include <math.h>
/* gap_i = g[i][0] + g[i][1] sin(w0 t) + g[i][2] cos(w0 t) + g[i][3] sin(w1 t) + g[i][4] cos(w1 t) [m], x in m.
   p: stiffness, its amplitude and phase, damping of a pair, mass, pull, three speeds */
typedef struct { double k, ka, kphi, c, m, pull, w[3]; } P;
typedef struct { double s[3], c[3], S[3], C[3]; } Turn;
static void start(Turn *t, const P *p, double h) {
    for (int i = 0; i < 3; i++) {
        t->s[i] = sin(i == 2 ? p->kphi : 0.0); t->c[i] = cos(i == 2 ? p->kphi : 0.0);
        t->S[i] = sin(p->w[i] * h); t->C[i] = cos(p->w[i] * h);
    }
}
static inline void turn(Turn *t) {
    for (int i = 0; i < 3; i++) {
        double s = t->s[i] * t->C[i] + t->c[i] * t->S[i];
        t->c[i] = t->c[i] * t->C[i] - t->s[i] * t->S[i]; t->s[i] = s;
    }
}
typedef struct { double gap[4], rate[2], k; } Drive;
static inline Drive drive(const double *g, const P *p, const Turn *t) {
    Drive d;
    for (int i = 0; i < 4; i++)
        d.gap[i] = g[5*i] + g[5*i+1] * t->s[0] + g[5*i+2] * t->c[0] + g[5*i+3] * t->s[1] + g[5*i+4] * t->c[1];
    for (int i = 0; i < 2; i++)
        d.rate[i] = p->w[0] * (g[5*i+1] * t->c[0] - g[5*i+2] * t->s[0])
                  + p->w[1] * (g[5*i+3] * t->c[1] - g[5*i+4] * t->s[1]);
    d.k = p->k * (1 + p->ka * t->c[2]);
    return d;
}
void fitted(const double *g, const P *p, double h, long samples, long each, double x, double v, double *out) {
    Turn t; start(&t, p, h);
    double u1 = 0.5 * p->c * h / p->m, e1 = exp(-u1), hh = h * h / p->m, d = v * h;
    for (long i = 0; i < samples; i++) {
        out[i] = x;
        for (long j = 0; j < each; j++) {
            Drive q = drive(g, p, &t);
            double o0 = -x - q.gap[0], o1 = -x - q.gap[1], o2 = x - q.gap[2], o3 = x - q.gap[3];
            double f = (o0 > 0 ? o0 : 0) + (o1 > 0 ? o1 : 0) - (o2 > 0 ? o2 : 0) - (o3 > 0 ? o3 : 0);
            double n = (o0 > 0) + (o1 > 0) + (o2 > 0) + (o3 > 0);
            int a = o0 > 0 || o2 > 0, b = o1 > 0 || o3 > 0;
            double push = hh * (q.k * f - p->pull - p->c * ((a ? q.rate[0] : 0) + (b ? q.rate[1] : 0)));
            double z = hh * q.k * n, u = u1 * (a + b), e = (a ? e1 : 1) * (b ? e1 : 1);
            double low = -u * u, high = z + low, mixed = 1, power = 1, coefficient = 0.5, total = 0.5;
            static const double ratio[4] = {12, 30, 56, 90};
            for (int r = 0; r < 4; r++) {
                coefficient = -coefficient / ratio[r]; power *= low;
                mixed = mixed * high + power; total += coefficient * mixed;
            }
            if (!i && !j) d = (d * (1 - z / 6) - 0.5 * push) / e;
            d = e * e * d + 2 * e * total * push; x += d;
            turn(&t);
        }
    }
}
static inline double force(const Drive *q, const P *p, double x, double v) {
    double o0 = -x - q->gap[0], o1 = -x - q->gap[1], o2 = x - q->gap[2], o3 = x - q->gap[3];
    double f = (o0 > 0 ? o0 : 0) + (o1 > 0 ? o1 : 0) - (o2 > 0 ? o2 : 0) - (o3 > 0 ? o3 : 0);
    double a = (o0 > 0 || o2 > 0) ? v + q->rate[0] : 0, b = (o1 > 0 || o3 > 0) ? v + q->rate[1] : 0;
    return (q->k * f - p->pull - p->c * (a + b)) / p->m;
}
void runge_kutta(const double *g, const P *p, double h, long samples, long each, double x, double v, double *out) {
    Turn t; start(&t, p, 0.5 * h);
    Drive one = drive(g, p, &t);
    for (long i = 0; i < samples; i++) {
        out[i] = x;
        for (long j = 0; j < each; j++) {
            turn(&t); Drive mid = drive(g, p, &t); turn(&t); Drive two = drive(g, p, &t);
            double a1 = force(&one, p, x, v);
            double v2 = v + 0.5 * h * a1, a2 = force(&mid, p, x + 0.5 * h * v, v2);
            double v3 = v + 0.5 * h * a2, a3 = force(&mid, p, x + 0.5 * h * v2, v3);
            double v4 = v + h * a3, a4 = force(&two, p, x + h * v3, v4);
            x += h * (v + 2 * v2 + 2 * v3 + v4) / 6; v += h * (a1 + 2 * a2 + 2 * a3 + a4) / 6;
            one = two;
        }
    }
}
"""


def by_c(function, gaps, constants, spacing, samples, each, first):
    out = np.empty(samples)
    x, v, h = (ctypes.c_double(value) for value in (*first, spacing / each))
    counts = ctypes.c_long(samples), ctypes.c_long(each)
    function(pointer(gaps), ctypes.byref(constants), h, *counts, x, v, pointer(out))
    return out


@numba.njit(fastmath=True)
def acceleration(t, x, v, g, p):
    s0, c0, s1, c1 = np.sin(p[6] * t), np.cos(p[6] * t), np.sin(p[7] * t), np.cos(p[7] * t)
    total = -p[5]
    k = p[0] * (1 + p[1] * np.cos(p[8] * t + p[2]))
    for i in range(2):
        a, b = g[i], g[i + 2]
        drive = -x - (a[0] + a[1] * s0 + a[2] * c0 + a[3] * s1 + a[4] * c1)
        back = x - (b[0] + b[1] * s0 + b[2] * c0 + b[3] * s1 + b[4] * c1)
        total += k * (max(drive, 0.0) - max(back, 0.0))
        if drive > 0 or back > 0:
            total -= p[3] * (v + p[6] * (a[1] * c0 - a[2] * s0) + p[7] * (a[3] * c1 - a[4] * s1))
    return total / p[4]


@numba.njit(fastmath=True)
def by_numba(g, p, h, samples, each, x, v):
    out = np.empty(samples)
    for i in range(samples):
        out[i] = x
        for j in range(each):
            t = (i * each + j) * h
            a1 = acceleration(t, x, v, g, p)
            v2 = v + 0.5 * h * a1
            a2 = acceleration(t + 0.5 * h, x + 0.5 * h * v, v2, g, p)
            v3 = v + 0.5 * h * a2
            a3 = acceleration(t + 0.5 * h, x + 0.5 * h * v2, v3, g, p)
            v4 = v + h * a3
            a4 = acceleration(t + h, x + h * v3, v4, g, p)
            x, v = x + h * (v + 2 * v2 + 2 * v3 + v4) / 6, v + h * (a1 + 2 * a2 + 2 * a3 + a4) / 6
    return out


@numba.njit(fastmath=True)
def scaled_rate(t, y, g, p):
    return np.array([y[1] * 7000.0, acceleration(t, 1e-5 * y[0], 0.07 * y[1], g, p) / 0.07])


def solve(ts, torque, stepper):
    """From a scene to its transmission error at the samples, with the method of a stepper."""
    method = choice.method_of(SCENE, ts, jnp.asarray(torque), stepper, choice.limits_of(PHYSICS))
    return lambda scene: dynamics._simulate(scene, ts, jnp.asarray(torque), jnp.zeros(()), "equilibrium", method).te


def ours(ts, torque, stepper):
    """A jitted solve with the scene's numbers as arguments."""
    run = jax.jit(solve(ts, torque, stepper))
    return lambda: run(PHYSICS)


def all_traced(ts, torque, stepper):
    """A jitted solve of which nothing is known but the number of steps: speeds, times and torque are arguments too."""
    run = jax.jit(lambda scene, ts, torque: gj.simulate(scene, ts, torque, stepper=stepper).te)
    return lambda: run(PHYSICS, ts, torque)


def all_constant(ts, torque, stepper):
    """A jitted solve with every number built in."""
    run, one = solve(ts, torque, stepper), jnp.ones(())
    program = jax.jit(lambda one: one * run(PHYSICS))
    return lambda: program(one)


def gradients(ts, torque, windows, repeats: int) -> None:
    """Gradient of the mean square with respect to the four phases, over one run of the same."""
    names = tuple(PHYSICS.errors)
    phases = jnp.stack([PHYSICS.errors[name].phase for name in names])

    def loss(stepper):
        run = solve(ts, torque, stepper)

        def value(phases):
            errors = {n: dataclasses.replace(PHYSICS.errors[n], phase=phases[i]) for i, n in enumerate(names)}
            return (run(dataclasses.replace(PHYSICS, errors=errors)) ** 2).mean()

        return value

    tasks = {}
    for words, stepper in (
        ("one go", gj.FixedStep(per_sample=16)),
        ("windows", gj.FixedStep(per_sample=16, windows=windows)),
    ):
        value = loss(stepper)
        for name, f in (("", value), (", reverse", jax.grad(value)), (", forward", jax.jacfwd(value))):
            tasks[words + name] = functools.partial(jax.jit(f), phases)
    _, first, medians = interleaved(tasks, repeats)
    print(f"\ngradient with respect to four phases, 48k steps{'ms':>12s} {'over a run':>11s} {'first [s]':>10s}")
    for name, median in medians.items():
        print(f"{name:47s} {1e3 * median:11.2f} {median / medians[name.split(',')[0]]:11.2f} {first[name]:10.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description="dynamic solves against C, numba, diffrax and scipy")
    parser.add_argument("--torque", type=float, default=100.0)
    given = sized(parser, repeats=(9, 1))
    torque, radius = given.torque, float(SCENE.system.radius)
    ts = jnp.linspace(0.0, 3.0, 3001)
    begun = gj.simulate(SCENE, ts[:2], torque, stepper=gj.FixedStep(per_sample=1024, solver=gj.RungeKutta4()))
    first = float(begun.te[0]) * radius, float(begun.velocity[0]) * radius
    gaps, constants = reducer(SCENE, torque)
    numbers = constants.array()
    library = compiled_c(C)
    truth = by_c(library.runge_kutta, gaps, constants, 1e-3, 3001, 4096, first)
    windows = suitable_step(SCENE, 3.0).windows

    def c(name, each, seconds=3):
        return lambda: by_c(getattr(library, name), gaps, constants, 1e-3, 1000 * seconds + 1, each, first)

    def lsoda():
        found = solve_ivp(
            lambda t, y: scaled_rate(t, y, gaps, numbers),
            (0.0, 3.0),
            [first[0] / 1e-5, first[1] / 0.07],
            method="LSODA",
            t_eval=np.asarray(ts),
            rtol=1e-4,
            atol=1e-4,
        )
        return 1e-5 * found.y[0]

    dopri5 = gj.AdaptiveStep(1e-4, 1e-4, solver=diffrax.Dopri5())
    found = lsoda(), radius * np.asarray(ours(ts, torque, dopri5)())
    adaptive = min(np.abs(one - truth).max() for one in found)
    each = next(each for each in range(3, 64) if np.abs(c("fitted", each)() - truth).max() < adaptive)
    few = f"{3 * each}k"
    long = jnp.linspace(0.0, 15.8, 15801)
    tasks = {
        "C, same scheme, 48k": c("fitted", 16),
        "C, Runge-Kutta by rotation, 48k": c("runge_kutta", 16),
        "gearjax, one go, 48k": ours(ts, torque, gj.FixedStep(per_sample=16)),
        "gearjax, windows, 48k": ours(ts, torque, gj.FixedStep(per_sample=16, windows=windows)),
        f"gearjax, one go, {few}": ours(ts, torque, gj.FixedStep(per_sample=each)),
        f"gearjax, windows, {few}": ours(ts, torque, gj.FixedStep(per_sample=each, windows=windows)),
        "gearjax, one go, 48k, constants": all_constant(ts, torque, gj.FixedStep(per_sample=16)),
        "gearjax, one go, 48k, all traced": all_traced(ts, torque, gj.FixedStep(per_sample=16)),
        "numba, Runge-Kutta, 24k": lambda: by_numba(gaps, numbers, 1e-3 / 8, 3001, 8, *first),
        "diffrax Dopri5, 1e-4": ours(ts, torque, dopri5),
        "scipy LSODA, 1e-4": lsoda,
        "C, Runge-Kutta, 15.8 s": c("runge_kutta", 16, 16),
        "gearjax, one go, 15.8 s": ours(long, torque, gj.FixedStep(per_sample=16)),
        "gearjax, windows, 15.8 s": ours(
            long, torque, gj.FixedStep(per_sample=16, windows=suitable_step(SCENE, 15.8).windows)
        ),
    }
    results, begin, medians = interleaved(tasks, given.repeats, slow=1.0)
    print(f"{torque:g} N m, hard contacts; {windows}; median of {given.repeats}")
    print(f"{'':34s} {'ms':>9s} {'first [s]':>9s} {'max [um]':>9s} {'rms [um]':>9s}")
    for name, median in medians.items():
        found = np.asarray(results[name]) * (radius if name.startswith(("gearjax", "diffrax")) else 1.0)
        number = min(len(found), 3001)
        error = 1e6 * np.abs(found[:number] - truth[:number])
        print(f"{name:34s} {1e3 * median:9.2f} {begin[name]:9.2f} {error.max():9.1e} {np.sqrt((error**2).mean()):9.1e}")
    one, cut = medians["gearjax, one go, 48k"], medians["gearjax, windows, 48k"]
    coarse = medians[f"gearjax, one go, {few}"], medians[f"gearjax, windows, {few}"]

    def ratio(words, peer, mine, faster):
        values = [medians[peer] / part if faster else part / medians[peer] for part in mine]
        print(f"{words:58s} {values[0]:8.2f} {values[1]:8.2f}")

    print(f"\n{'':58s} {'one go':>8s} {'windows':>8s}")
    ratio("48k, time over C with the same scheme", "C, same scheme, 48k", (one, cut), False)
    ratio("48k, time over C Runge-Kutta 48k", "C, Runge-Kutta by rotation, 48k", (one, cut), False)
    ratio("48k, times faster than numba Runge-Kutta 24k", "numba, Runge-Kutta, 24k", (one, cut), True)
    ratio(f"{few}, times faster than diffrax Dopri5 1e-4", "diffrax Dopri5, 1e-4", coarse, True)
    ratio(f"{few}, times faster than scipy LSODA 1e-4", "scipy LSODA, 1e-4", coarse, True)
    whole = medians["gearjax, one go, 15.8 s"], medians["gearjax, windows, 15.8 s"]
    ratio("15.8 s, time over C Runge-Kutta (16 s)", "C, Runge-Kutta, 15.8 s", whole, False)
    traced = medians["gearjax, one go, 48k, all traced"] / medians["gearjax, one go, 48k, constants"]
    print(f"{'48k, every number traced over every number constant':58s} {traced:8.2f}")
    for name in ("gearjax, one go, 48k", "gearjax, windows, 48k"):
        own = np.asarray(results[name]) * radius
        for words, other in (("the same scheme", results["C, same scheme, 48k"]), ("12 million steps", truth)):
            agree(f"{name}: largest difference from C with {words}", 1e6 * np.abs(own - other).max(), 3e-3, "um")
    if not given.short:  # gradients have no other program beside them
        gradients(ts, torque, windows, given.repeats)


if __name__ == "__main__":
    main()
