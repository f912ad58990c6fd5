"""Derivatives of motions that are cut into windows: those of the same motion in one go."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj

CONFIGS = Path(__file__).parents[1] / "configs"


def hard() -> gj.Scene:
    return gj.load(CONFIGS / "two_kv" / "wang_2020.toml")


def smooth() -> gj.Scene:
    return dataclasses.replace(hard(), contact=gj.SoftplusContact(1e-7))


def uneven() -> gj.Scene:
    return gj.load(CONFIGS / "elliptic" / "dong_2020.toml")


CASES = {  # scene, torque [N m], samples, time between them [s], steps between them, number of windows
    "hard": (hard, 100.0, 251, 1e-3, 16, 3),
    "smooth, blocks between samples": (smooth, 30.0, 13, 2e-2, 400, 3),
    "uneven ratio": (uneven, 50.0, 301, 1e-3, 40, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_one_go(case, rng):
    """All numbers of a scene move together: errors, backlash, stiffness, damping, inertia, speed, geometry."""
    make, torque, samples, spacing, each, number = CASES[case]
    scene, times = make(), spacing * np.arange(samples)
    moving, fixed = eqx.partition(scene, eqx.is_inexact_array_like)
    ways = jax.tree.map(lambda leaf: 1e-3 * rng.normal() * jnp.asarray(leaf), moving)

    def results(share, windows):
        moved = jax.tree.map(lambda leaf, way: leaf + share * way, moving, ways)
        stepper = gj.FixedStep(per_sample=each, windows=windows)
        motion = gj.simulate(eqx.combine(moved, fixed), times, torque * (1 + 0.1 * share), stepper=stepper)
        return (motion.te, motion.velocity, motion.forces, motion.highest, motion.lowest), motion.defect

    def along(windows):
        return jax.jit(lambda share: jax.jvp(lambda share: results(share, windows), (share,), (1.0,)))(0.0)

    (whole, _), (whole_moves, _) = along(None)
    (parts, apart), (parts_moves, _) = along(gj.Windows(number, 0.06))
    assert 0 < apart < 1e-12, "cut, and joined without a step"
    for one, other, bound in ((whole, parts, 1e-10), (whole_moves, parts_moves, 1e-9)):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(b, a, rtol=0, atol=bound * float(abs(a).max()))


@pytest.mark.slow
def test_reverse_is_the_transpose_of_forward(rng):
    scene, times = hard(), 1e-3 * np.arange(251)
    stepper = gj.FixedStep(per_sample=16, windows=gj.Windows(3, 0.06))

    def results(numbers):
        torque, *phases = numbers
        names = ("planet_1", "output_wheel")
        errors = {n: dataclasses.replace(scene.errors[n], phase=p) for n, p in zip(names, phases, strict=True)}
        moved = dataclasses.replace(scene, errors=scene.errors | errors)
        motion = gj.simulate(moved, times, torque, stepper=stepper)
        return motion.te, motion.velocity, motion.forces

    given, way = jnp.array([80.0, 0.4, 2.0]), jnp.array([1.0, 0.1, -0.2])
    values, moves = jax.jit(lambda given: jax.jvp(results, (given,), (way,)))(given)
    weights = [jnp.asarray(rng.normal(size=one.shape)) / abs(one).max() for one in values]
    back = jax.jit(lambda given: jax.vjp(results, given)[1](tuple(weights))[0])(given)
    forth = sum(float((weight * move).sum()) for weight, move in zip(weights, moves, strict=True))
    assert float(back @ way) == pytest.approx(forth, rel=1e-9)
