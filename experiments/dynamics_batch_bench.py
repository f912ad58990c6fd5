"""Dynamic solves of 10,240 reducers that differ in their assembly phases: gearjax against other programs, in one run.

C (structure of arrays, 64 lanes, same scheme, ``-O3 -march=native -ffast-math``) and gearjax (one ``vmap``, 1,024
scenes at a time) on one core, both precisions; diffrax with a fixed classical Runge-Kutta, its steps batched by
``vmap``; all again with XLA's option for whole loops (`gj.xla_options`), 128 scenes at a time; then gearjax on one and
on two devices by sharding. 75 ms, 1,200 steps, position at the end. Prints nanoseconds per scene and step, medians of
interleaved repeats, compile time apart. Needs gcc.

    python experiments/dynamics_batch_bench.py [--scenes 10240] [--repeats 5]
"""

import argparse
import ctypes
import dataclasses
import functools
import os
import subprocess
import sys
from pathlib import Path

import diffrax
import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from peers import compiled_c, interleaved, pointer, reducer

import gearjax as gj
from gearjax.analysis.equation import Equation
from gearjax.xla import LOOPS

CONFIG = Path(__file__).parents[1] / "configs" / "two_kv" / "wang_2020.toml"
BODIES = ("planet_1", "planet_2", "revolution", "output_wheel")
TORQUE, SPACING, EACH, SAMPLES = 100.0, 1e-3, 16, 76
STEPS = EACH * (SAMPLES - 1)

C = r"""
#include <math.h>
#define W 64
#define B 48
typedef struct { double k, ka, kphi, c, m, pull, w[3]; } P;
/* gaps [lane][4][5] of sines [m]; a quadratic in time for each gap and block; x in 10 um */
void batch(const double *gaps, const P *p, double h, long steps, long lanes, const double *x0, const double *v0,
           REAL *out) {
    const REAL u1 = 0.5 * p->c * h / p->m, e1 = exp(-u1), hh = h * h / p->m, c = p->c, scale = 1e5;
    for (long first = 0; first < lanes; first += W) {
        REAL q[4][3][W], x[W], d[W];
        for (int l = 0; l < W; l++) { x[l] = scale * x0[first + l]; d[l] = scale * h * v0[first + l]; }
        for (long s = 0; s < steps; s += B) {
            double basis[3][5];
            for (int n = 0; n < 3; n++) {
                basis[n][0] = n == 0;
                for (int i = 0; i < 2; i++) {
                    double a = p->w[i] * (s + 0.5 * B) * h, r = p->w[i] * h;
                    basis[n][1 + 2 * i] = n == 0 ? sin(a) : n == 1 ? r * cos(a) : -0.5 * r * r * sin(a);
                    basis[n][2 + 2 * i] = n == 0 ? cos(a) : n == 1 ? -r * sin(a) : -0.5 * r * r * cos(a);
                }
            }
            for (int i = 0; i < 4; i++)
                for (int n = 0; n < 3; n++)
                    for (int l = 0; l < W; l++) {
                        const double *g = gaps + (first + l) * 20 + 5 * i, *b = basis[n];
                        q[i][n][l] = scale * (g[0]*b[0] + g[1]*b[1] + g[2]*b[2] + g[3]*b[3] + g[4]*b[4]);
                    }
            long end = steps - s < B ? steps - s : B;
            for (long j = 0; j < end; j++) {
                const REAL z = j - 0.5 * B, k = p->k * (1 + p->ka * cos(p->w[2] * (s + j) * h + p->kphi));
                const REAL hk = hh * k, hc = hh * c / h, pull = -hh * scale * p->pull;
                for (int l = 0; l < W; l++) {
                    REAL o[4], r[2], f = 0, n = 0;
                    for (int i = 0; i < 4; i++) {
                        REAL gap = q[i][0][l] + z * (q[i][1][l] + z * q[i][2][l]);
                        o[i] = (i < 2 ? -x[l] : x[l]) - gap;
                        f += o[i] > 0 ? (i < 2 ? o[i] : -o[i]) : 0;
                        n += o[i] > 0 ? (REAL)1 : 0;
                    }
                    for (int i = 0; i < 2; i++) r[i] = q[i][1][l] + 2 * z * q[i][2][l];
                    REAL a = o[0] > 0 ? (REAL)1 : o[2] > 0 ? (REAL)1 : 0;
                    REAL b = o[1] > 0 ? (REAL)1 : o[3] > 0 ? (REAL)1 : 0;
                    REAL push = hk * f + pull - hc * (a * r[0] + b * r[1]);
                    REAL w = hk * n, u = u1 * (a + b), e = (a > 0 ? e1 : 1) * (b > 0 ? e1 : 1);
                    REAL low = -u * u, high = w + low, mixed = 1, power = 1, part = 0.5, total = 0.5;
                    const REAL ratio[4] = {1.0 / 12, 1.0 / 30, 1.0 / 56, 1.0 / 90};
                    for (int i = 0; i < 4; i++) {
                        part *= -ratio[i]; power *= low; mixed = mixed * high + power; total += part * mixed;
                    }
                    if (!s && !j) d[l] = (d[l] * (1 - w / 6) - (REAL)0.5 * push) / e;
                    d[l] = e * e * d[l] + 2 * e * total * push; x[l] += d[l];
                }
            }
        }
        for (int l = 0; l < W; l++) out[first + l] = x[l] / scale;
    }
}
"""


class ClassicalRungeKutta(diffrax.AbstractERK):
    """The classical Runge-Kutta method by diffrax's own machinery; its error estimate is not used."""

    tableau = diffrax.ButcherTableau(
        a_lower=(np.array([0.5]), np.array([0.0, 0.5]), np.array([0.0, 0.0, 1.0])),
        b_sol=np.array([1, 2, 2, 1]) / 6,
        b_error=np.zeros(4),
        c=np.array([0.5, 0.5, 1.0]),
    )
    interpolation_cls = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

    def order(self, terms):
        return 4


@functools.cache
def reference(precision: str = "float64"):
    """The reducer; read when it is asked for, so that a process can be held to a core before its threads start."""
    with jax.ensure_compile_time_eval():
        scene = gj.load(CONFIG).physics("backlash", "compliance", "load", "inertia", "damping")
        return jax.tree.map(lambda leaf: leaf.astype(precision), scene)


def scene_of(phases, scene=None):
    """The reducer with other assembly phases."""
    scene = reference() if scene is None else scene
    errors = {name: dataclasses.replace(scene.errors[name], phase=phases[i]) for i, name in enumerate(BODIES)}
    return dataclasses.replace(scene, errors=errors)


def by_gearjax(phases, chunk=1024):
    """Position at the end along the line of action [m], of many assemblies."""
    scene = reference(str(phases.dtype))
    ts = SPACING * np.arange(SAMPLES)

    def end(row):
        motion = gj.simulate(scene_of(row, scene), ts, TORQUE, stepper=gj.FixedStep(per_sample=EACH))
        return motion.te[-1] * scene.system.radius

    return jax.lax.map(end, phases, batch_size=chunk)


def by_diffrax(phases):
    """The same by vmapped diffrax."""

    def end(row):
        equation = Equation.of(scene_of(row), jnp.asarray(TORQUE))

        def field(t, y, _):
            return equation.frequency * equation.rate(equation.excitation(t), y)

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            ClassicalRungeKutta(),
            t0=0.0,
            t1=SPACING * (SAMPLES - 1),
            dt0=SPACING / EACH,
            y0=equation.initial(jnp.zeros(()), "equilibrium"),
            stepsize_controller=diffrax.ConstantStepSize(),
            max_steps=STEPS + 8,
        )
        return jnp.asarray(solution.ys)[-1, 0] * equation.scale * reference().system.radius

    return jax.vmap(end)(phases)


def one_core(scenes: int, repeats: int, chunk: int) -> None:
    """gearjax, some scenes at a time, against C and diffrax; the process is held to one core."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    phases = np.random.default_rng(0).uniform(-np.pi, np.pi, (scenes, len(BODIES)))
    _, constants = reducer(reference(), TORQUE)
    speed = float(reference().system.input_speed)
    times = jnp.linspace(0.0, 20.0, 40)
    wide = jax.jit(jax.vmap(lambda row: jax.vmap(lambda t: scene_of(row).contacts(speed * t).gap)(times)))
    turns = [f(w * np.asarray(times)) for w in (constants.w0, constants.w1) for f in (np.sin, np.cos)]
    basis = np.linalg.pinv(np.stack([np.ones(len(times)), *turns], axis=1))
    gaps = np.ascontiguousarray(np.einsum("kt,nti->nik", basis, np.asarray(wide(jnp.asarray(phases)))))

    def begin(row):
        equation = Equation.of(scene_of(row), jnp.asarray(TORQUE))
        state = equation.initial(jnp.zeros(()), "equilibrium") * jnp.stack([jnp.ones(()), equation.frequency])
        return state * equation.scale * reference().system.radius

    x0, v0 = np.ascontiguousarray(np.asarray(jax.jit(jax.vmap(begin))(jnp.asarray(phases))).T)

    def by_c(real, dtype):
        batch, out = compiled_c(C, f"-DREAL={real}").batch, np.empty(scenes, dtype)
        sizes = ctypes.c_double(SPACING / EACH), ctypes.c_long(STEPS), ctypes.c_long(scenes)
        given = ctypes.byref(constants)

        def run():
            batch(pointer(gaps), given, *sizes, pointer(x0), pointer(v0), pointer(out))
            return out

        return run

    few, program = min(scenes, 1024), jax.jit(functools.partial(by_gearjax, chunk=chunk))
    peer = jax.jit(by_diffrax)
    tasks = {
        "C, float64": by_c("double", np.float64),
        "gearjax, float64": lambda: program(jnp.asarray(phases)),
        "C, float32": by_c("float", np.float32),
        "gearjax, float32": lambda: program(jnp.asarray(phases, jnp.float32)),
        f"diffrax, Runge-Kutta, float64, {few} scenes": lambda: peer(jnp.asarray(phases[:few])),
    }
    results, first, medians = interleaved(tasks, repeats, slow=30.0)
    truth = np.asarray(results["gearjax, float64"])
    numbers = {name: few if name.startswith("diffrax") else scenes for name in tasks}
    each = {name: 1e9 * median / numbers[name] / STEPS for name, median in medians.items()}
    print(f"{scenes} scenes x {STEPS} steps, gearjax {chunk} at a time, one core, median of {repeats}")
    print(f"XLA_FLAGS: {os.environ.get('XLA_FLAGS', '')}")
    print(f"{'':44s} {'ns':>8s} {'first [s]':>10s} {'from gearjax float64, at most [um]':>36s}")
    for name, found in results.items():
        off = 1e6 * np.abs(np.asarray(found) - truth[: numbers[name]]).max()
        print(f"{name:44s} {each[name]:8.2f} {first[name]:10.2f} {off:36.1e}")
    for precision in ("float64", "float32"):
        print(f"{precision}: {each[f'gearjax, {precision}'] / each[f'C, {precision}']:.2f} times C")
    print(f"{each[list(tasks)[-1]] / each['gearjax, float64']:.0f} times the throughput of diffrax")


def two_devices(scenes: int, repeats: int) -> None:
    """The same program on one device and on two, each with its share of the scenes."""
    jax.config.update("jax_num_cpu_devices", 2)
    phases = jnp.asarray(np.random.default_rng(0).uniform(-np.pi, np.pi, (scenes, len(BODIES))))
    mesh = jax.make_mesh((2,), ("scene",), axis_types=(jax.sharding.AxisType.Auto,))
    split = jax.device_put(phases, NamedSharding(mesh, PartitionSpec("scene")))
    alone = jax.jit(by_gearjax)
    both = jax.jit(
        jax.shard_map(by_gearjax, mesh=mesh, in_specs=PartitionSpec("scene"), out_specs=PartitionSpec("scene"))
    )
    results, _, medians = interleaved({"one": lambda: alone(phases), "two": lambda: both(split)}, repeats)
    apart = 1e6 * np.abs(np.asarray(results["one"]) - np.asarray(results["two"])).max()
    print(f"two devices: {medians['one'] / medians['two']:.2f} times one device, {apart:.0e} um apart at most")


def main() -> None:
    parser = argparse.ArgumentParser(description="batches of dynamic solves against C and diffrax")
    parser.add_argument("--scenes", type=int, default=10240)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--part", choices=("one_core", "loops", "two_devices"))
    given = parser.parse_args()
    if given.part == "two_devices":
        two_devices(given.scenes, given.repeats)
    elif given.part:
        one_core(given.scenes, given.repeats, 128 if given.part == "loops" else 1024)
    else:
        for part, flags in (("one_core", ""), ("loops", LOOPS), ("two_devices", "")):
            command = [sys.executable, __file__, "--scenes", str(given.scenes), "--repeats", str(given.repeats)]
            subprocess.run([*command, "--part", part], check=True, env={**os.environ, "XLA_FLAGS": flags})


if __name__ == "__main__":
    main()
