"""Derivatives of the steps of constant modes: slopes of all steps at once, against that of the loop itself."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis import chebyshev
from gearjax.analysis.choice import MODELLED
from gearjax.analysis.modes import Steps, StructureEquation, recurrence

STEP, SPAN, NODES = 4e-5, 96, 12
TO_AND_FRO = gj.SinusoidalLoad(150.0)  # through the clearance, to both flanks
CASES = {
    "dampers that come and go, a load that changes": {"load": TO_AND_FRO},
    "dampers that always act": {"damping": gj.DampingRatio(0.05, "always"), "load": TO_AND_FRO},
    "no dampers, a constant load": {"damping": None},
    "a smooth law": {"contact": gj.QuadraticContact(2e-7), "load": TO_AND_FRO},
}


def recorded(changes: dict, nodes: int | None):
    """A function of all that the steps follow from, which gives where they end, and that with arrays of numbers."""
    scene = gj.load("configs/two_kv/wang_2020.toml")
    supports = dict.fromkeys(scene.system.coordinates, gj.Support(x=2e8, y=2.6e8, x_damping=300.0, y_damping=200.0))
    inertia = dict.fromkeys(supports, gj.BodyInertia(0.8))
    scene = dataclasses.replace(scene, supports=supports, body_inertia=inertia, **changes)
    equation = StructureEquation.of(scene.physics(*MODELLED), jnp.asarray(20.0))
    steps = Steps.of(equation, jnp.zeros(()), jnp.asarray(STEP))
    begun = steps.start(1e-7 * equation.scale, jnp.zeros_like(equation.scale))
    ends = np.arange(1, SPAN + 1, dtype=float)
    places, shares = ends, None
    if nodes is not None:
        places = chebyshev.nodes(SPAN, nodes)
        shares = chebyshev.weights(SPAN, nodes, ends).reshape(2, SPAN // 2, nodes)
    table = jax.vmap(steps.lines.driving)(jnp.asarray(places) * STEP)
    given = steps.lines, steps.products, begun, table
    moving, still = eqx.partition(given, eqx.is_inexact_array)

    def record(moving, rule=True):
        lines, *others = eqx.combine(moving, still)
        march = recurrence.recur if rule else automatic
        return march(lines, *others, shares)

    return record, moving


def automatic(lines, products, begun, table, shares):
    """The same march, whose derivative is that of the loop."""
    kept, recurrence._recur = recurrence._recur, recurrence._primal
    try:
        return recurrence.recur(lines, products, begun, table, shares)
    finally:
        recurrence._recur = kept


def closeness(found, expected):
    """Largest difference of trees, of each leaf as a share of its largest number."""
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    return max(float(jnp.abs(one - two).max() / (jnp.abs(two).max() + 1e-30)) for one, two in pairs if two.size)


@pytest.mark.slow
@pytest.mark.parametrize(("case", "nodes"), list(zip(CASES, (NODES, None, NODES, None), strict=True)))
def test_the_derivative_is_that_of_the_loop(case, nodes, rng):
    """With respect to everything at once, in both modes, also of several at once: all flanks come and go."""
    record, moving = recorded(CASES[case], nodes)
    path = record(moving)[1]
    assert np.isfinite(np.asarray(path)).all()
    weights = jnp.asarray(rng.normal(size=path.shape)) / jnp.abs(path).max(axis=0, keepdims=True)
    directions = jax.tree.map(lambda leaf: leaf[None] * rng.normal(size=(3, *leaf.shape)), moving)

    def size(moving, rule=True):
        ended, path = record(moving, rule)
        return (path * weights).sum() + 1e3 * ended.now.gap.sum() / STEP

    reverse, expected = (jax.jit(jax.grad(size), static_argnums=1)(moving, rule) for rule in (True, False))
    assert closeness(reverse, expected) < 1e-9

    def along(way, rule):
        return jax.jvp(lambda moving: record(moving, rule)[1], (moving,), (way,))[1]

    forward, expected = (
        jax.jit(jax.vmap(along, (0, None)), static_argnums=1)(directions, rule) for rule in (True, False)
    )
    assert float(jnp.abs(expected).max()) > 0
    assert closeness(forward, expected) < 1e-9


@pytest.mark.slow
def test_second_derivatives(rng):
    record, moving = recorded(CASES["a smooth law"], NODES)
    way = jax.tree.map(lambda leaf: leaf * rng.normal(size=leaf.shape), moving)

    def bend(rule):
        def slope(factor):
            moved = jax.tree.map(lambda leaf, way: leaf + factor * way, moving, way)
            return (record(moved, rule)[1][:, 0] ** 2).sum() * 1e12

        return jax.jit(jax.grad(jax.grad(slope)))(0.0)

    assert float(bend(True)) == pytest.approx(float(bend(False)), rel=1e-9)
    assert float(bend(True)) != 0
