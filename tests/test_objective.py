"""Objectives: hard against the analyses, smooth within its bound, pieces with exact derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gearjax as gj
from gearjax.analysis.spectrum import order_amplitude
from gearjax.studies.objective import Objective
from gearjax.studies.select import numbers, pick
from gearjax.units import arcmin, deg, um
from tests import rv
from tests.conftest import ROOT

PHASES = [f"errors.{body}.phase" for body in ("planet_1", "planet_2", "revolution", "output_wheel")]
TERMS = {
    "amplitude": gj.Term("no_load_amplitude"),
    "peak_to_peak": gj.Term("static_peak_to_peak", 100.0),
    "std": gj.Term("no_load_std"),
    "order": gj.Term("no_load_order", order="planet"),
    "backlash": gj.Term("backlash_peak_to_peak"),
}


@pytest.fixture(scope="module")
def angles(scene):
    return jnp.linspace(0.0, scene.system.cycle, 1001)


SLOW = ("peak_to_peak", "backlash")


@pytest.mark.slow
def test_pieces_hold_the_highest_sample_however_few_there_are():
    """One sample for each pin: slopes tell of turning points far below the top alone."""
    one = gj.load(ROOT / "configs" / "rv_cycloidal" / "hu_2020_phases.toml")
    phases = pick(one, [f"errors.{name}_{disc}.phase" for name in ("disc", "pitch") for disc in (1, 2)])
    one = phases.set(one, jnp.deg2rad(jnp.array([-34.1215, 96.4101, 3.84334, -149.912])))
    theta = jnp.linspace(0.0, one.system.cycle, 39 * 40 + 1)
    with pytest.warns(gj.FewAngles, match="40 cycles per turn of the input"):
        objective = Objective.of("static_peak_to_peak", one, theta, 784.0)
    spread = np.ptp(np.asarray(gj.transmission_error(one, theta, 784.0).te))
    assert float(jax.jit(lambda scene: objective.refined(scene))(one)) >= spread * (1 - 1e-9) > 0


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in TERMS]
)
def test_hard_smooth_and_pieces(scene, angles, name):
    """The hard objective is the analysis' own; the smooth one lies above by no more than its bound; the largest
    pieces, and their derivatives, are those of the hard one."""
    term = TERMS[name]
    objective = gj.Objective.of(term, scene, angles)
    free = pick(scene, PHASES)
    physics = objective.physics(scene, free)
    here = free.get(scene)
    tabulated = objective.tabulated(scene, free)

    @jax.jit
    def all_of_it(x):
        def hard(x):
            return objective.hard(free.set(physics, x))

        def from_pieces(x):
            return jnp.stack(
                [p.weight * p.values[jnp.argmax(p.values)] for p in tabulated.pieces(free.set(physics, x))]
            ).sum()

        smooth = tabulated.smooth(free.set(physics, x), 0.01 * arcmin)
        sampled = tabulated.sampled(free.set(physics, x))
        return hard(x), from_pieces(x), smooth, sampled, jax.grad(hard)(x), jax.grad(from_pieces)(x)

    hard, pieced, smooth, sampled, slope, pieced_slope = (np.asarray(part) for part in all_of_it(here))
    if name == "backlash":
        expected = gj.backlash(scene, angles).peak_to_peak
    elif name == "order":
        expected = order_amplitude(gj.transmission_error(scene, angles).te, angles, scene.system.orders["planet"])
    else:
        expected = getattr(gj.transmission_error(scene, angles, term.torque), term.metric)
    assert hard == pytest.approx(float(expected), rel=1e-12)
    assert pieced == pytest.approx(float(hard), rel=2e-5)
    np.testing.assert_allclose(pieced_slope, slope, atol=2e-4 * np.abs(slope).max())
    sides = 2 if name in ("peak_to_peak", "backlash") else 1
    bound = sides * 0.01 * arcmin * (np.log(2 * angles.size) + 1)
    assert abs(smooth - sampled) < bound
    if name in ("amplitude", "peak_to_peak", "backlash"):
        assert smooth > sampled


@pytest.mark.slow
def test_smooth_gradients_under_vmap_and_jit(scene, angles, rng):
    objective = gj.Objective.of("no_load_amplitude", scene, angles)
    free = pick(scene, PHASES)
    objective = objective.tabulated(scene, free)
    physics = objective.physics(scene, free)

    def smooth(x):
        return objective.smooth(free.set(physics, x), 0.02 * arcmin) / arcmin

    points = jnp.asarray(rng.uniform(-3, 3, (5, 4)))
    slopes = np.asarray(jax.jit(jax.vmap(jax.grad(smooth)))(points))
    evaluate = jax.jit(jax.vmap(smooth))
    step = 1e-4
    for index in range(4):
        ways = [evaluate(points.at[:, index].add(k * step)) for k in (-2, -1, 1, 2)]
        difference = (ways[0] - 8 * ways[1] + 8 * ways[2] - ways[3]) / (12 * step)
        np.testing.assert_allclose(slopes[:, index], difference, rtol=2e-6, atol=1e-7)


@pytest.mark.slow
def test_a_weighted_sum(scene, angles):
    terms = [gj.Term("no_load_amplitude", weight=2.0), gj.Term("static_std", 30.0), gj.Term("static_std", 300.0, 0.5)]
    found = float(gj.Objective.of(terms, scene, angles[:201]).hard(scene))
    parts = [
        2 * gj.transmission_error(scene, angles[:201]).amplitude,
        gj.transmission_error(scene, angles[:201], 30.0).std,
        0.5 * gj.transmission_error(scene, angles[:201], 300.0).std,
    ]
    assert found == pytest.approx(float(sum(parts)), rel=1e-12)


@pytest.mark.slow
def test_a_dynamic_term(scene):
    theta = scene.system.input_speed * jnp.linspace(0.0, 0.02, 21)
    objective = gj.Objective.of(gj.Term("dynamic_amplitude", 100.0), scene, theta)
    motion = gj.simulate(scene, jnp.linspace(0.0, 0.02, 21), 100.0)
    assert float(objective.hard(scene)) == pytest.approx(float(motion.amplitude), rel=1e-9)
    smooth = float(objective.smooth(objective.physics(scene, pick(scene, PHASES)), 1e-4 * arcmin))
    assert smooth == pytest.approx(float(motion.amplitude), rel=5e-3)


@pytest.mark.slow
def test_zero_amplitudes_have_zero_gradients(scene):
    free = pick(scene, PHASES)
    still = pick(scene, [path.replace("phase", "amplitude") for path in PHASES]).set(scene, jnp.zeros(4))
    objective = gj.Objective.of("no_load_amplitude", still, jnp.linspace(0.0, 6.0, 33))
    for loss in (objective.hard, lambda s: objective.smooth(s, 1e-9)):
        slope = jax.jit(jax.grad(lambda x, loss=loss: loss(free.set(objective.physics(still, free), x))))(
            free.get(still)
        )
        assert (np.asarray(slope) == 0).all()


@pytest.mark.slow
def test_order_amplitude_is_exact():
    """On whole turns other whole orders leave nothing; a window leaves little."""
    theta = jnp.linspace(0.0, 4 * jnp.pi, 401)
    record = 0.5 + 0.3 * jnp.sin(3 * theta + 0.4) + 0.2 * jnp.cos(5 * theta)
    assert float(order_amplitude(record, theta, 3.0)) == pytest.approx(0.3, abs=1e-12)
    assert float(order_amplitude(record, theta, 4.0)) == pytest.approx(0.0, abs=1e-12)
    part = theta < 8.7
    windowed = order_amplitude(record[part], theta[part], 3.0)
    assert float(windowed) == pytest.approx(0.3, abs=0.02)
    assert float(jax.grad(lambda a: order_amplitude(a * record, theta, 4.0))(0.0)) == 0.0


def test_numbers_of_a_series_are_free_too(scene):
    assert "compliance.phases[0]" in numbers(scene)
    free = pick(scene, ["compliance.relative_amplitudes[0]", "compliance.phases[0]"], None)
    changed = free.set(scene, jnp.array([0.2, 1.5]))
    assert float(changed.compliance.relative_amplitudes[0]) == 0.2
    np.testing.assert_allclose(free.get(changed), [0.2, 1.5])
    by_function = pick(scene, lambda s: [s.errors["planet_2"].phase, s.compliance.phases])
    assert by_function.paths == ("errors.planet_2.phase", "compliance.phases[0]")


def test_a_star_stands_for_a_whole_series():
    one = rv.scene(with_errors=True)
    every = tuple(f"errors.pins.around[{pin}]" for pin in range(40))
    star = "errors.pins.around[*]"
    free = pick(one, star, {star: (-1e-6, 1e-6)})
    assert free.paths == every
    assert set(free.bounds) == {(-1e-6, 1e-6)}
    spread = gj.Normal(0.0, 1e-6)
    assert gj.Tolerances(one, {star: spread}).paths == every
    with pytest.raises(gj.ParameterError, match=r"errors.pins.around\[3\] .* is listed twice, once as .*\[\*\]"):
        gj.Tolerances(one, {every[3]: spread, star: spread})
    with pytest.raises(gj.ParameterError, match="no number of this scene"):
        pick(one, "errors.pin.around[*]")


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"name": "no_load_amplitud"}, 'did you mean "no_load_amplitude"?'),
        ({"name": "static_std"}, "needs a torque"),
        ({"name": "no_load_std", "torque": 3.0}, "takes no torque"),
        ({"name": "no_load_amplitude", "order": "crank"}, "takes no order; no_load_order has one"),
        ({"name": "no_load_order"}, "needs an order"),
        ({"name": "no_load_std", "weight": 0.0}, "must be above 0"),
    ],
)
def test_mistakes(asked, words):
    with pytest.raises(gj.ParameterError) as caught:
        gj.Term(**asked)
    assert words in str(caught.value)


def test_an_unknown_order_is_named(scene):
    with pytest.raises(gj.ParameterError, match=r'did you mean "crank"'):
        gj.Objective.of(gj.Term("no_load_order", order="crnk"), scene, jnp.linspace(0.0, 1.0, 9))


def test_bounds_round_trip(scene):
    path = "errors.planet_1.amplitude"
    free = pick(scene, [path, PHASES[0]], {path: (5 * um, 20 * um)})
    values = jnp.array([12 * um, 40 * deg])
    np.testing.assert_allclose(free.constrained(free.unconstrained(values)), values, rtol=1e-12)
    assert free.wrapped(np.array([1.0, 3 * np.pi / 2 + 2 * np.pi])) == pytest.approx([20 * um, -np.pi / 2])
