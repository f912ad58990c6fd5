"""What the input angle does not change is worked out once: results stay, programs shrink, and nothing outlives its
parameters."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax import evaluate
from gearjax.compliance.elastic_teeth import ElasticTeeth
from gearjax.compliance.tooth_slices import ToothSlices
from gearjax.evaluate import evaluated_or_traced
from tests.conftest import ROOT

SETS = {
    "pair": ("helical/guo_2018.toml", ToothSlices, "_along_path"),
    "train": ("helical/two_stage.toml", ToothSlices, "_along_path"),
    "involute_rv": ("involute_rv/yang_2019.toml", ElasticTeeth, "_layer"),
}
SLOTS = "backlash", "compliance"


@pytest.fixture(scope="module", params=SETS)
def case(request):
    name, compliance, method = SETS[request.param]
    return gj.load(ROOT / "configs" / name), compliance, method


@pytest.mark.slow
def test_contacts_are_the_same_and_the_program_has_less_to_do(case, monkeypatch):
    scene, compliance, method = case
    plain, known = scene.physics(*SLOTS), scene.precomputed(*SLOTS)
    calls = []
    own = getattr(compliance, method)
    monkeypatch.setattr(compliance, method, lambda *given: calls.append(method) or own(*given))

    def leaves(scene, theta):
        contacts = scene._contacts(theta, "mean", None)
        return [part for part in jax.tree.leaves(contacts) if eqx.is_array(part)]

    angles = jnp.asarray([0.0, 0.37, 41.3])
    results, sizes, called = [], [], []
    for each in (plain, known):
        calls.clear()
        program = jax.make_jaxpr(lambda theta, each=each: leaves(each, theta))(angles[0])
        called.append(len(calls))
        sizes.append(_equations(program.jaxpr))
        results.append(jax.jit(jax.vmap(lambda theta, each=each: leaves(each, theta)))(angles))
    assert called[0] > 0
    assert called[1] == 0
    assert sizes[1] < 0.75 * sizes[0]
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-11, atol=1e-11 * float(jnp.abs(one).max()))


def _equations(program) -> int:
    """Number of operations in a program, with those of the functions that it calls."""
    inner = [part.jaxpr for own in program.eqns for part in own.params.values() if hasattr(part, "jaxpr")]
    return len(program.eqns) + sum(map(_equations, inner))


@pytest.mark.slow
def test_a_number_of_the_gears_has_its_gradient_under_jit_and_vmap():
    """Of the face width of the second mesh of a train, with gears that are known and with traced ones."""
    scene = gj.load(ROOT / "configs" / "helical" / "two_stage.toml")
    theta = np.linspace(0.0, 0.3, 5)

    def mean(width):
        wide = eqx.tree_at(lambda s: s.system.face_width, scene, scene.system.face_width.at[1].set(width))
        return gj.transmission_error(wide, theta, torque=20.0).te.mean()

    widths, step = jnp.asarray([0.03, 0.034]), 1e-6
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(mean)))(widths)
    for width, value, slope in zip(widths.tolist(), values, slopes, strict=True):
        assert mean(width) == pytest.approx(float(value), rel=1e-10)
        difference = (mean(width + step) - mean(width - step)) / (2 * step)
        assert float(slope) == pytest.approx(float(difference), rel=1e-5)


def test_what_is_known_does_not_outlive_its_parameters():
    scene = gj.load(ROOT / "configs" / "helical" / "guo_2018.toml")
    known = scene.precomputed(*SLOTS)
    assert known.system.known_pair is not None
    assert known.compliance.known_bodies is not None
    assert scene.system.known_pair is None
    wider = dataclasses.replace(known.system, face_width=2 * known.system.face_width)
    assert wider.known_pair is None
    assert float(wider.pair.face_width) == 2 * float(scene.system.face_width)
    softer = dataclasses.replace(known.compliance, poissons_ratio=0.2)
    assert softer.known_bodies is None


def test_gear_sets_with_nothing_to_know_are_left_alone(scene):
    physics = scene.precomputed(*SLOTS)
    assert eqx.tree_equal(physics, scene.physics(*SLOTS))


def test_in_a_trace_it_is_a_part_of_the_trace():
    """A program of its own could not be started from there."""
    traced = jax.make_jaxpr(lambda x: x * evaluated_or_traced(jnp.sin, jnp.asarray(0.5)))(1.0)
    assert any(equation.primitive.name == "sin" for equation in traced.jaxpr.eqns)
    assert float(evaluated_or_traced(jnp.sin, jnp.asarray(0.5))) == pytest.approx(np.sin(0.5))


def test_results_of_the_same_arrays_are_kept_and_those_of_others_are_not(monkeypatch):
    ran = []
    monkeypatch.setattr(evaluate, "_program", lambda function: lambda *given: ran.append(given) or function(*given))
    monkeypatch.setattr(evaluate, "_results", {})
    first, equal = jnp.asarray(1.5), jnp.asarray(1.5)
    for argument, runs in ((first, 1), (first, 1), (equal, 2), (first, 2), (np.asarray(1.5), 3), (np.asarray(1.5), 4)):
        assert float(evaluate.evaluated_or_traced(jnp.sin, argument)) == pytest.approx(np.sin(1.5))
        assert len(ran) == runs
    for number in range(3 * evaluate.MOST_KEPT):  # whose identities may be those of arrays that are gone
        assert float(evaluate.evaluated_or_traced(jnp.sin, jnp.asarray(0.1 * number))) == pytest.approx(
            np.sin(0.1 * number)
        )
    assert len(evaluate._results) == evaluate.MOST_KEPT


def test_known_numbers_are_numbers_inside_traces_too(monkeypatch):
    """Derivatives of kept results would be lost, so that what has tracers is never kept."""
    monkeypatch.setattr(evaluate, "_results", {})
    known, seen = jnp.asarray(0.25), []
    jax.jit(lambda x: seen.append(float(evaluate.evaluated(jnp.sin, known))) or x)(1.0)
    assert seen == [float(jnp.sin(known))]
    assert float(jax.grad(lambda x: evaluated_or_traced(jnp.sin, x))(known)) == pytest.approx(np.cos(0.25))
    assert len(evaluate._results) == 1


def test_a_motion_again_looks_at_its_scene_no_more(monkeypatch):
    scene, times = gj.load(ROOT / "configs/two_kv/wang_2020.toml"), np.linspace(0.0, 0.01, 21)
    gj.simulate(scene, times, 100.0)
    monkeypatch.setattr(evaluate, "_program", lambda function: pytest.fail(f"{function} ran again"))
    gj.simulate(scene, times, 50.0)
