"""Batches equal loops, numbers do not retrace, and what a scene does not list is not computed."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

import gearjax as gj
from gearjax.units import deg


def with_phase(scene, phase):
    return eqx.tree_at(lambda s: s.errors["planet_1"].phase, scene, phase)


def batched(scenes):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)


ANALYSES = {
    "no_load": lambda s, ts: gj.transmission_error(s, s.system.input_speed * ts),
    "static": lambda s, ts: gj.transmission_error(s, s.system.input_speed * ts, 60.0),
    "backlash": lambda s, ts: gj.backlash(s, s.system.input_speed * ts),
    "dynamic": lambda s, ts: gj.simulate(s, ts, 60.0),
}


@pytest.mark.parametrize("analysis", ANALYSES)
@pytest.mark.parametrize(
    "law",
    [gj.HardContact(), pytest.param(gj.QuadraticContact(2e-7), marks=pytest.mark.slow)],
    ids=["hard", "quadratic"],
)
def test_a_batch_of_scenes_equals_a_loop(scene, with_contact, analysis, law, rng):
    """Scenes that differ in every number."""
    ts = jnp.linspace(0.0, 0.1, 51)
    base = with_contact(scene, law)
    scenes = [
        jax.tree.map(lambda leaf: leaf * (1 + 0.05 * jnp.asarray(rng.uniform(-1, 1, leaf.shape))), base)
        for _ in range(4)
    ]
    run = ANALYSES[analysis]
    together = jax.vmap(lambda s: run(s, ts))(batched(scenes))
    leaves_of = {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(together)}
    alone = jax.jit(lambda s: run(s, ts))
    for index, single in enumerate(scenes):
        apart = alone(single)
        for name in ("peak_to_peak", "amplitude", "mean", "std"):
            np.testing.assert_allclose(getattr(together, name)[index], getattr(apart, name), rtol=1e-12, atol=1e-18)
        if analysis in ("static", "dynamic"):
            np.testing.assert_allclose(together.load_sharing[index], apart.load_sharing, rtol=1e-9)
        for path, other in jax.tree_util.tree_leaves_with_path(apart):
            name = jax.tree_util.keystr(path)
            one, scale = leaves_of[name][index], float(jnp.abs(other).max()) + 1e-300
            if name.endswith(("theta_maximum", "theta_minimum")) and analysis in ("no_load", "static"):
                # the curve is flat at its top: rounding of its values moves the place by the root of that rounding
                assert float(jnp.abs(one - other)) <= 1e-6 * scale
                one, other = (run(single, place[None] / single.system.input_speed).te[0] for place in (one, other))
                scale = float(jnp.abs(apart.te).max())
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * scale)


@pytest.mark.slow
def test_a_batch_of_torques_equals_a_loop(scene):
    ts = jnp.linspace(0.0, 0.1, 51)
    torques = jnp.array([3.0, 30.0, 300.0])
    together = jax.vmap(lambda torque: gj.simulate(scene, ts, torque).te)(torques)
    for index, torque in enumerate(torques):
        np.testing.assert_allclose(together[index], gj.simulate(scene, ts, torque).te, rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("analysis", ANALYSES)
def test_a_changed_number_does_not_retrace(scene, with_contact, analysis):
    """Every number of a scene, the width of a smooth law and the torque among them."""
    traces = []
    ts = jnp.linspace(0.0, 0.05, 26)

    @jax.jit
    def run(scene):
        traces.append(analysis)
        return ANALYSES[analysis](scene, ts).mean

    base = with_contact(scene, gj.SoftplusContact(1e-7))
    values = [float(run(jax.tree.map(lambda leaf, s=size: leaf * s, base))) for size in (1.0, 1.01, 0.98)]
    assert len(traces) == 1
    assert len(set(values)) == 3


def test_the_public_functions_do_not_retrace(scene, theta):
    """Counted at the innermost: the system's own frame, called once per trace."""
    calls = []

    class Counting(gj.HardContact.__mro__[1]):  # the abstract law
        kind = "counting"

        def penetration(self, overlap):
            return jnp.maximum(overlap, 0.0)

        def closed(self, overlap):
            return jnp.where(overlap > 0, 1.0, 0.0)

        def weights(self, values):
            return jax.nn.one_hot(jnp.argmax(values), values.shape[0], dtype=values.dtype)

        def maximum(self, values):
            calls.append(1)
            return jnp.max(values)

    counted = dataclasses.replace(scene, contact=Counting())
    gj.transmission_error(counted, theta)
    first = len(calls)
    assert first > 0
    for phase in (10.0, 20.0, 30.0):
        gj.transmission_error(with_phase(counted, jnp.asarray(phase * deg)), theta)
    gj.transmission_error(dataclasses.replace(counted, run=gj.Run(3.0, 3001, ("no_load",))), theta)
    assert len(calls) == first


def equations(jaxpr) -> int:
    """Equations of a program, inner programs included."""
    inner = [sub for eqn in jaxpr.eqns for sub in jaxprs_in_params(eqn.params)]
    return len(jaxpr.eqns) + sum(equations(getattr(sub, "jaxpr", sub)) for sub in inner)


def program(scene, analysis="no_load"):
    ts = jnp.linspace(0.0, 0.01, 11)
    return jax.make_jaxpr(lambda s: ANALYSES[analysis](s, ts).te)(scene)


def test_each_effect_adds_equations_and_its_absence_leaves_none(scene):
    full = dict(scene.errors)
    bare = dataclasses.replace(scene, errors={}, reference=None, backlash=None, compliance=None, load=None)
    bare = dataclasses.replace(bare, inertia=None, damping=None)
    sizes = [equations(program(bare).jaxpr)]
    for key in full:
        grown = dataclasses.replace(bare, errors={k: full[k] for k in full if k <= key})
        sizes.append(equations(program(grown).jaxpr))
    assert all(size > sizes[0] for size in sizes[1:])
    one = dataclasses.replace(bare, errors={"planet_1": full["planet_1"]})
    started = dataclasses.replace(one, reference=gj.ZeroAtStart())
    assert equations(program(started).jaxpr) > equations(program(one).jaxpr)


@pytest.mark.parametrize("slot", ["compliance", "load", "inertia", "damping"])
def test_unused_slots_leave_the_no_load_program_as_it_is(scene, slot):
    """Nothing of the loaded analyses is in the no-load program, byte for byte but for its unused inputs."""
    without = dataclasses.replace(scene, **{slot: None})
    assert equations(program(scene).jaxpr) == equations(program(without).jaxpr)


@pytest.mark.slow
@pytest.mark.parametrize("slot", ["backlash", "damping", "reference"])
def test_absent_slots_shrink_the_dynamic_program(scene, slot):
    without = dataclasses.replace(scene, **{slot: None})
    assert equations(program(without, "dynamic").jaxpr) < equations(program(scene, "dynamic").jaxpr)


@pytest.mark.slow
def test_harmonics_shrink_to_nothing(scene):
    constant = dataclasses.replace(scene, compliance=gj.HarmonicStiffness(9e7, [], []))
    assert equations(program(constant, "dynamic").jaxpr) < equations(program(scene, "dynamic").jaxpr)
    assert " sin " in str(program(constant, "dynamic"))
    perfect = dataclasses.replace(constant, errors={})
    assert " sin " not in str(program(perfect, "dynamic"))


def test_the_same_scene_is_the_same_program(scene):
    assert str(program(scene)) == str(program(dataclasses.replace(scene)))


@pytest.mark.slow
def test_many_pairs_are_one_vector_in_a_batch_too(scene, monkeypatch):
    """Pairs that are too many to be written out one by one."""
    ts = jnp.linspace(0.0, 0.01, 11)

    def run(torque):
        return gj.simulate(scene, ts, torque, stepper=gj.FixedStep(per_sample=24)).te

    torques = jnp.array([30.0, 100.0, 300.0])
    expected = [jax.jit(run)(torque) for torque in torques]
    monkeypatch.setattr("gearjax.analysis.fast.oscillator.FEW", 1)
    jax.clear_caches()
    np.testing.assert_allclose(jax.jit(jax.vmap(run))(torques), expected, rtol=1e-12)
    jax.clear_caches()
