"""Gradients of every metric against central differences: reverse and forward mode, jitted and batched."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from tests.conftest import ROOT

METRICS = ("peak_to_peak", "amplitude", "mean", "std")
# the smooth laws take long to compile
HARD_FIRST = ["hard", *(pytest.param(law, marks=pytest.mark.slow) for law in ("softplus", "quadratic"))]
LAWS = {"hard": gj.HardContact(), "softplus": gj.SoftplusContact(3e-7), "quadratic": gj.QuadraticContact(3e-7)}
# what a parameter is: where it stands, and a step for central differences
PARAMETERS: dict[str, tuple[Callable, float]] = {
    "amplitude": (lambda s: s.errors["planet_2"].amplitude, 1e-10),
    "phase": (lambda s: s.errors["revolution"].phase, 1e-5),
    "mean stiffness": (lambda s: s.compliance.mean, 1e3),
    "stiffness amplitude": (lambda s: s.compliance.relative_amplitudes, 1e-5),
    "damping": (lambda s: s.damping.ratio, 1e-5),
    "backlash": (lambda s: s.backlash.initial, 1e-9),
    "module": (lambda s: s.system.module, 1e-8),
    "torque": (lambda s: s, 1e-3),
}
TORQUE = 87.0


def changed(scene, amounts):
    """The scene and the torque with each named parameter moved by its amount."""
    torque = jnp.asarray(TORQUE)
    for parameter, amount in amounts.items():
        if parameter == "torque":
            torque = torque + amount
        else:
            where = PARAMETERS[parameter][0]
            scene = eqx.tree_at(where, scene, where(scene) + amount)
    return scene, torque


def check(measure, scene, parameters, rtol=1e-6):
    """Every metric of ``measure(scene, torque)``, shape (metric,), against central differences in every parameter.

    Reverse and forward mode run under vmap and jit, over a batch of two points.
    """
    steps = jnp.array([PARAMETERS[name][1] for name in parameters])

    def metrics(amounts):
        return measure(*changed(scene, dict(zip(parameters, amounts, strict=True))))

    points = jnp.array([0.0, 40.0])[:, None] * steps[None, :]
    reverse = jax.jit(jax.vmap(jax.jacrev(metrics)))(points)
    forward = jax.jit(jax.vmap(jax.jacfwd(metrics)))(points)
    plain = jax.jit(jax.vmap(metrics))
    for index, name in enumerate(parameters):
        step = jnp.zeros(len(parameters)).at[index].set(steps[index])[None, :]
        # fourth-order central differences: truncation far below the tolerance
        near, far = ((plain(points + n * step) - plain(points - n * step)) / (2 * n * steps[index]) for n in (1.0, 2.0))
        central = np.asarray(4 * near - far) / 3
        scale = np.abs(central).max(axis=0, keepdims=True)
        floor = 1e-12 * np.abs(np.asarray(plain(points))).max(axis=0, keepdims=True) / steps[index]  # their rounding
        for found in (reverse[:, :, index], forward[:, :, index]):
            assert bool(jnp.isfinite(found).all()), name
            assert (np.abs(np.asarray(found) - central) <= rtol * scale + floor).all(), name


def stacked(result):
    return jnp.stack([getattr(result, name) for name in METRICS])


@pytest.fixture(scope="module")
def angles(scene):
    return scene.system.input_speed * jnp.linspace(0.0, 3.0, 401)


@pytest.mark.slow
@pytest.mark.parametrize("law", HARD_FIRST)
def test_no_load(scene, angles, with_contact, law):
    parameters = ["amplitude", "phase", "module"]
    check(lambda s, _: stacked(gj.transmission_error(s, angles)), with_contact(scene, LAWS[law]), parameters)


@pytest.mark.parametrize(
    "law", ["hard", *(pytest.param(law, marks=pytest.mark.slow) for law in ("softplus", "quadratic"))]
)
def test_static(scene, angles, with_contact, law):
    parameters = ["amplitude", "phase", "mean stiffness", "torque"]
    check(lambda s, t: stacked(gj.transmission_error(s, angles, t)), with_contact(scene, LAWS[law]), parameters)


@pytest.mark.slow
def test_backlash(scene, angles):
    check(lambda s, _: stacked(gj.backlash(s, angles)), scene, ["amplitude", "phase", "backlash"])


@pytest.mark.slow
@pytest.mark.parametrize("law", ["hard", "quadratic"])
def test_dynamic_mean_and_std(scene, with_contact, law):
    """The hard law under a torque that keeps both pairs closed, a smooth law where pairs open and close.

    The other smooth law differs in its force alone, which is derived above."""
    ts = jnp.linspace(0.0, 0.25, 126)
    extra = 400.0 if law == "hard" else 0.0

    def measure(scene, torque):
        motion = gj.simulate(scene, ts, torque + extra, settle=0.05)
        return jnp.stack([motion.mean, motion.std])

    parameters = ["amplitude", "phase", "mean stiffness", "stiffness amplitude", "damping", "torque"]
    check(measure, with_contact(scene, LAWS[law]), parameters)


@pytest.mark.slow
def test_zero_torque_has_a_gradient_with_a_smooth_law(scene, angles):
    """The smooth static form holds at zero torque, and so does its slope in torque: between 1 / k and 1 / (2 k)."""
    smooth = dataclasses.replace(scene, contact=gj.SoftplusContact(3e-7))
    slope = jax.grad(lambda torque: gj.transmission_error(smooth, angles, torque).mean)(jnp.asarray(0.0))
    one = 1.0 / (9.245e7 * float(scene.system.radius) ** 2)
    assert -one < float(slope) < -one / 2


@pytest.mark.slow
def test_random_points(scene, angles, rng):
    """All phases at random, amplitude of the error: the gradient as a whole, against differences along a line."""
    names = list(scene.errors)

    def amplitude(phases):
        errors = {n: dataclasses.replace(scene.errors[n], phase=p) for n, p in zip(names, phases, strict=True)}
        return gj.transmission_error(dataclasses.replace(scene, errors=errors), angles).amplitude

    points = jnp.asarray(rng.uniform(-np.pi, np.pi, (20, 4)))
    along = jnp.asarray(rng.normal(size=4))
    slopes = jax.jit(jax.vmap(jax.grad(amplitude)))(points) @ along
    step = 1e-6
    ahead, behind = (jax.vmap(amplitude)(points + sign * step * along[None, :]) for sign in (1, -1))
    central = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(slopes, central, rtol=1e-6, atol=1e-10)


@pytest.mark.slow
def test_the_check_can_fail(scene, angles):
    """A metric whose slope is wrong by a thousandth does not pass."""

    def wrong(s, _):
        te = gj.transmission_error(s, angles)
        return stacked(te) + 1e-3 * (te.mean - jax.lax.stop_gradient(te.mean))

    with pytest.raises(AssertionError):
        check(wrong, scene, ["amplitude"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "torque"),
    [("two_kv/wang_2020", 100.0), ("rv_cycloidal/hu_2020", 784.0), ("helical/two_stage", 100.0)],
)
@pytest.mark.parametrize("law", [gj.SoftplusContact, gj.QuadraticContact])
def test_the_width_of_a_smooth_law(name, torque, law):
    """In reverse mode too: equilibria in closed form, by a search of many contacts, and of several meshes."""
    width = 5e-7
    scene = dataclasses.replace(gj.load(ROOT / "configs" / f"{name}.toml"), contact=law(width))

    def mean(width):
        own = eqx.tree_at(lambda s: s.contact.width, scene, width)
        return gj.transmission_error(own, jnp.array([0.5, 1.3]), torque).te.sum()

    forward, reverse = jax.jit(jax.jacfwd(mean))(width), jax.jit(jax.grad(mean))(width)
    central = (mean(width * 1.001) - mean(width * 0.999)) / (0.002 * width)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-9, abs=1e-9)
    assert float(reverse) == pytest.approx(float(central), rel=1e-4, abs=1e-6)
